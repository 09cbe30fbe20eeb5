"""Reading tables: every format against what was written, every broken file with its one sentence."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from fmuid import Experiment, InputError, read_data
from fmuid.data import numeric_column
from fmuid.units import SECONDS
from tests.support.mat4 import characters, write_mat4

TIMES = np.array([0.0, 0.1, 0.25, 0.25, 0.4])
SPEED = np.array([1.0, 2.0, 4.0, -4.0, 8.0])


def written(tmp_path: Path, text: str | bytes, name: str = "run.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


NAN = np.nan
SIGNALS = "".join(f"{k},a b,{k},V\n{k},c,{2 * k},mA\n" for k in range(4))
WITHIN = "".join(f"{k % 5},01.01.2026 10:00:0{k},{k},1\n" for k in range(8))
READ: dict[str, tuple[str, dict[str, list[float]], dict[str, str]]] = {
    "names as they are, empty cells": (
        '\ufeff\ntime, u,"x[1,2]",der(y)\n0,1.5,2,\n0.1,2.5,3,0.30000000000000004\n',
        {"time": [0, 0.1], "u": [1.5, 2.5], "x[1,2]": [2, 3], "der(y)": [NAN, 0.30000000000000004]}, {},
    ),
    "empty cells at the end of rows, blank lines": (
        "time,u,y\n0,1,2\n  \n1,2,\n\n2,,\n", {"time": [0, 1, 2], "u": [1, 2, NAN], "y": [2, NAN, NAN]}, {},
    ),
    "signals in rows": (
        f"Time,Signal,Value,Unit\n{SIGNALS}4,c,,mA\n5,c,7,mA\n",
        {"time": [0, 1, 2, 3, 5], "a b": [0, 1, 2, 3, NAN], "c": [0, 2, 4, 6, 7]}, {"a b": "V", "c": "mA"},
    ),
    "units beside values": ("time,i,i unit\n0,1,A\n1,500,mA\n", {}, {"i": "A or mA"}),
    "units beside values, in rows": ("time,name,value,unit\n0,i,1,A\n1,i,500,mA\n", {}, {"i": "A or mA"}),
    "parts of dates": (
        "Year,Month,Day,Hour,Minute,Second,u\n2026,2,28,23,58,30,1\n2026,2,28,23,59,30,1\n2026,3,1,0,0,30,1\n",
        {"time": [0, 60, 120]}, {},
    ),
    "marks in each line": (
        '\ufeff"Time","Flow smL/min"\n\ufeff"2026-01-31 10:00:00",1\n\ufeff"2026-01-31 10:01:00",2\n',
        {"time": [0, 60]}, {"Flow": "smL/min"},
    ),
    "times within a step": (f"step time,date,total time,u\n{WITHIN}", {"time": [*range(8)]}, {}),
    "times of day beside dates": (
        "Date,Time,u\n01/30/2026,23:00:00,1\n01/30/2026,24:00,2\n02/02/2026,01:00:00,3\n",
        {"time": [0, 3600, 180000]}, {},
    ),
    "unknown unit beside units": ("Time[s],q[ccps],w[rpm],x[1]\n0,1,2,3\n1,2,3,4\n", {}, {"q": "ccps", "w": "rpm"}),
    "header below words": ("of the rig\nrun\ntime u\n0 1\n1 2\n2 4\n", {"time": [0, 1, 2], "u": [1, 2, 4]}, {}),
}  # fmt: skip
"""Texts with values and units of columns."""


@pytest.mark.parametrize("name", READ)
def test_texts(tmp_path: Path, name: str) -> None:
    text, columns, units = READ[name]
    frame = read_data(written(tmp_path, text))
    for column, values in columns.items():
        np.testing.assert_array_equal(frame[column], values)
    assert frame.attrs.get("units", {}) == units
    if "dates" in name:
        assert not frame.attrs.get("clocks")
        assert frame.attrs["begin"].isoformat() == ("2026-02-28T23:58:30" if "parts" in name else "2026-01-30T23:00:00")


HOSTS = "time,host,name,value\n" + "".join(f"{k},{host},u,{k}\n" for k in range(6) for host in "ab")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "empty. Give a header"),
        ("time,u\n", "no samples below the header"),
        ("time,u\n0,0,1,5\n0,1,2,5\n", "2 names in the header, 4 cells in row 1"),
        ("time,x[1,2]\n0,1\n1,1\n", r"3 names in the header, 2 cells in row 1\. Quote names"),
        ("time,u\n0,1\n1,2,3\n", "2 names in the header, 3 cells in row 2. .*as many cells as the header"),
        ("time,u,y\n0,1,2\n\n1,2,\n2,3\n", "3 names in the header, 2 cells in row 3"),
        ("time,u,y\n0,1,2\n1", "3 names in the header, 1 cell in row 2"),
        ('time,u,text\n0,1,"a\nb,"\n1,2\n', "3 names in the header, 2 cells in row 2"),
        ("0,1\n1,2\n", "no header. Write the names"),
        ("Times,u\n0,1\n", r"time column 'time' not found \(did you mean 'Times'\?\)"),
        ("This is\nno table\n", r"not found \(did you mean 'This is'|columns: This is\)"),
        (",u,\n0,1,2\n", "columns 1, 3 have no name"),
        ('time,u\n"0,1",1.5\n', "'time': '0,1' in row 1 .*decimal points"),
        ("time,u\n2026-01-01T00:00,1\nsoon,2\n", "'time': 'soon' in row 2|2026-01-01T00:00' in row 1"),
        ("time,u\n01/02/2026 10:00,1\n02/03/2026 10:01,2\n", "day and month of .* are ambiguous"),
        (b"time,gr\x81\xfce\n0,1\n", "not text in UTF-8, UTF-16 or cp1252"),
        (b"PK\x03\x04\x00\x00\xff\xfe\x00", "is a spreadsheet or packed file"),
        ("  0.0000E+0  1.09E+2\n  4.0000E-2  1.13E+2\n  8.0000E-2  1.16E+2\n", "no header"),
        (
            "of the rig\nrun\n0 1\n1 2\n2 4\n",
            r"no header above the 2 numbers of line 3\. Insert a line with their names",
        ),
        (
            HOSTS,
            r"'u' has several values at one time, by column 'host'\. Keep the rows",
        ),
    ],
)
def test_csv_that_is_none(tmp_path: Path, text: str | bytes, sentence: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=sentence) as caught:
        read_data(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cell", ["１.５", "1_000", "+nan", "\xa05"])
def test_a_cell_that_only_python_takes_for_a_number_is_named_with_its_row(tmp_path: Path, cell: str) -> None:
    rows = [f"{k},{k}.5\n" for k in range(12)]
    rows[9] = f"9,{cell}\n"
    table = read_data(written(tmp_path, "time,u\n" + "".join(rows)))
    with pytest.raises(InputError) as caught:
        numeric_column(table, "u", "file.csv")
    assert str(caught.value).startswith(f"file.csv: column 'u': {cell!r} in row 10 ")


def test_columns_of_one_name_have_numbers_and_are_not_chosen(tmp_path: Path) -> None:
    frame = read_data(written(tmp_path, "Time (s),Voltage (V),Voltage (V)\n0,1,2\n1,3,4\n"))
    assert [*frame.columns] == ["time", "Voltage 1", "Voltage 2"]
    assert frame.attrs["units"] == {"Voltage 1": "V", "Voltage 2": "V"}
    with pytest.raises(InputError, match=r"'Voltage' not found \(did you mean 'Voltage 2' or 'Voltage 1'"):
        Experiment(frame, {"u": "Voltage"}, {"y": "Voltage 2"})


@pytest.mark.parametrize(
    ("text", "times"),
    [
        ("2026-01-31-09-01-24", "2026-01-31-09-02-24"),
        ("31.01.2026 11:29:45am", "31.01.2026 11:30:45am"),
        ("11.59am", "12.00pm"),
        ("0d 00:01:0", "0d 00:02:0"),
        ("\t01/31/2026 08:32:34.558", "\t01/31/2026 08:33:34.558"),
        ("11:59:30 a. m.", "12:00:30 p. m."),
        ("10:59:30:120", "11:00:30:120"),
        ("0:59.125", "1:59.125"),
        ("20260131235959", "20260201000059"),
        ("2026-01-31 08:32:34.558 UTC", "2026-01-31 08:33:34.558 UTC"),
        ("2026年1月31日 23:59:30", "2026年2月1日 00:00:30"),
        ("Sat Jan 31 23:59:30 2026", "Sun Feb 1 00:00:30 2026"),
        ("Jan 31, 2026 11:59:30 PM", "Feb 1, 2026 12:00:30 AM"),
        ("31 Jan 2026 23:59:30", "01 Feb 2026 00:00:30"),
        ("31-Jan-26 23:59:30", "01-Feb-26 00:00:30"),
        (" 01/31  23:59:00", " 01/31  24:00:00"),
    ],
)
def test_spellings_of_times(tmp_path: Path, text: str, times: str) -> None:
    frame = read_data(written(tmp_path, f"time;u\n{text};1\n{times};2\n"))
    np.testing.assert_allclose(frame["time"], [0.0, 60.0])


def test_texts_among_numbers_have_a_remedy_that_works(tmp_path: Path) -> None:
    path = written(tmp_path, "time,u\n" + "".join(f"{k},{'Idle' if k == 3 else k}\n" for k in range(9)))
    with pytest.raises(InputError, match=r'Set missing = \["Idle"\] if they stand for no sample'):
        numeric_column(read_data(path), "u", "F")
    assert np.isnan(numeric_column(read_data(path, missing=["Idle"]), "u", "F")).tolist() == [k == 3 for k in range(9)]
    with pytest.raises(InputError, match=r"'22h 10:30:00' in row 1 .*Write dates as 2026-02-28 12:00:00"):
        read_data(written(tmp_path, "time,u\n22h 10:30:00,1\n22h 10:31:00,2\n"))


def test_units_in_cells_of_one_quantity(tmp_path: Path) -> None:
    frame = read_data(written(tmp_path, "time,i,x,y\n0,1.5 A,1 A,8 V\n1,-,2 V,OL\n2,250 mA,3 A,9 V\n"))
    np.testing.assert_allclose(frame["i"], [1.5, np.nan, 0.25])
    assert frame.attrs["units"] == {"i": "A", "y": "V"}
    with pytest.raises(InputError, match="'1 A' in row 1 is no real number"):
        numeric_column(frame, "x", "F")


def test_days_of_matlab_are_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path, "time,u\n737812.25,1\n737812.5,2\n")
    with pytest.raises(InputError, match=r'may be in days\. Set time_unit = "d" or "s"'):
        read_data(path)
    np.testing.assert_allclose(np.diff(read_data(path, time_unit="d")["time"]), 21600.0)


@pytest.mark.parametrize(("step", "unit"), [(1.0, "d"), (10.0, "d"), (60.0, "min"), (3600.0, "h")])
def test_unsaid_units_of_loggers_are_those_of_dates_or_asked_for(tmp_path: Path, step: float, unit: str) -> None:
    seconds = step * np.arange(5.0)
    dates = pd.to_datetime("2026-01-31") + pd.to_timedelta(seconds, unit="s")
    table = pd.DataFrame({"Time": seconds / SECONDS[unit], "u": 1.0, "DPT Time": dates.strftime("%Y-%m-%d %H:%M:%S")})
    for columns in [[*table], ["Time", "u"]][: 1 + (unit == "d")]:
        path = written(tmp_path, table[columns].to_csv(index=False))
        if "DPT Time" in columns:
            np.testing.assert_allclose(read_data(path)["time"], seconds, rtol=1e-9)
            continue
        with pytest.raises(InputError, match=f'Set time_unit = "{unit}"'):
            read_data(path)
        np.testing.assert_allclose(read_data(path, time_unit=unit)["time"], seconds, rtol=1e-9)


@pytest.mark.parametrize("rate", [10_000.0, 48_000.0, 44_100.0, 51_200.0, 128.0, 60.0, 1000.0])
def test_sampling_rates_are_no_days(tmp_path: Path, rate: float) -> None:
    text = "Time,u\n" + "".join(f"{k / rate!r},1\n" for k in range(9))
    np.testing.assert_allclose(read_data(written(tmp_path, text))["time"], np.arange(9) / rate)


def test_each_column_of_two_lengths_has_its_times(tmp_path: Path) -> None:
    """Also where the columns of the longer one are most."""
    one = {"time": np.arange(5.0), "u": np.arange(5.0)}
    two = {"time": np.arange(12.0) / 2, "y": np.arange(12.0), "z": np.arange(12.0)}
    savemat(tmp_path / "a.mat", {"id": one, "val": two})
    frame = read_data(tmp_path / "a.mat")
    there = frame["val.y"].notna()
    np.testing.assert_array_equal(frame["time"][there], np.arange(12.0) / 2)
    np.testing.assert_array_equal(frame["time"][frame["id.u"].notna()], np.arange(5.0))
    savemat(tmp_path / "b.mat", {"id": one, "t": one["time"], "val": two})
    np.testing.assert_array_equal(read_data(tmp_path / "b.mat")["time"][there], np.arange(12.0) / 2)


def test_waveforms_without_an_offset_begin_at_zero(tmp_path: Path) -> None:
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([ChannelObject("run", "u", np.arange(5.0), properties={"wf_increment": 0.5})])
    np.testing.assert_array_equal(read_data(tmp_path / "a.tdms")["time"], np.arange(5) / 2)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: file not found"):
        read_data(tmp_path / "none.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputError, match=r"folder\.csv: is a folder"):
        read_data(tmp_path / "folder.csv")
    with pytest.raises(InputError, match=r"run\.docx: unknown format '\.docx'\. Save it as \.csv"):
        read_data(written(tmp_path, "", "run.docx"))
    with pytest.raises(InputError, match="'without suffix'"):
        read_data(written(tmp_path, "", "run"))


@pytest.mark.parametrize("version", ["4", "5"])
def test_mat_vectors_of_the_common_length(tmp_path: Path, version: Any) -> None:
    content = {"t": TIMES[:, np.newaxis], "w": SPEED[np.newaxis, :], "gain": 35.15, "A": np.eye(5), "long": np.ones(9)}
    content |= {"label": "hello"}
    content |= {"count": np.arange(5, dtype=np.int16)} if version == "5" else {}
    savemat(tmp_path / "run.mat", content, format=version)
    table = read_data(tmp_path / "run.mat", time="t")
    assert set(table.columns) == ({"t", "w", "count"} & set(content)) | {f"A{k}" for k in range(1, 6)}
    assert list(table.attrs["left out"]) == ["long"]
    np.testing.assert_array_equal(table["t"], TIMES)
    np.testing.assert_array_equal(table["w"], SPEED)


def test_mat_that_is_none(tmp_path: Path) -> None:
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with pytest.raises(InputError, match=r"run\.mat: not a readable HDF5 file"):
        read_data(written(tmp_path, header.ljust(600, b"\0"), "run.mat"))
    savemat(tmp_path / "whole.mat", {"time": TIMES})
    whole = (tmp_path / "whole.mat").read_bytes()
    for broken in (b"", b"hello", b"time,u\n0,1\n" * 40, whole[:-20], whole[:100]):
        with pytest.raises(InputError, match=r"run\.mat: not a readable MAT file"):
            read_data(written(tmp_path, broken, "run.mat"))


@pytest.mark.parametrize("name", ["run.csv", "run.mat", "run.h5", "run.xlsx", "run.tdms", "run.parquet"])
def test_a_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Whatever reads it; to whoever runs the tests as root all files are open."""

    def refused(path: Path, *_: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    path = written(tmp_path, b"time,u\n0,1\n", name)
    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(InputError, match="permission denied"):
        read_data(path)


def result_file(path: Path, transposed: bool, padding: str = "nul", time: str = "time") -> None:
    """Write a result file by the description in the OpenModelica User's Guide (The MATv4 Result File Format)."""
    names = [time, "w", "minus_w", "clock", "Rs", "minus_Rs", "größe", "x[1,2]"]
    place = [(0, 1), (2, 2), (2, -2), (2, 1), (1, 2), (1, -2), (2, 3), (1, 3)]
    matrices: dict[str, np.ndarray[Any, Any]] = {
        "name": characters(names, padding),
        "description": characters([f"{name} [1]" for name in names], padding),
        "dataInfo": np.array([[matrix, column, 0, -1] for matrix, column in place], dtype=np.int32),
        "data_1": np.array([[TIMES[0], 9.8, 0.5], [TIMES[-1], 9.8, 0.5]]),
        "data_2": np.column_stack([TIMES, SPEED, SPEED**2]),
    }
    if transposed:
        matrices = {name: matrix.T for name, matrix in matrices.items()}
    aclass = characters(["Atrajectory", "1.1", "", "binTrans" if transposed else "binNormal"], padding)
    write_mat4(path, {"Aclass": aclass, **matrices})


@pytest.mark.parametrize("transposed", [True, False])
@pytest.mark.parametrize("padding", ["nul", "space"])
@pytest.mark.parametrize("time", ["time", "Time"])
def test_result_files_either_way_round(tmp_path: Path, transposed: bool, padding: str, time: str) -> None:
    result_file(tmp_path / "run_res.mat", transposed, padding, time)
    expected = {
        "time": TIMES,
        "w": SPEED,
        "minus_w": -SPEED,
        "clock": TIMES,
        "Rs": np.full(5, 9.8),
        "minus_Rs": np.full(5, -9.8),
        "größe": SPEED**2,
        "x[1,2]": np.full(5, 0.5),
    }
    pd.testing.assert_frame_equal(read_data(tmp_path / "run_res.mat"), pd.DataFrame(expected), check_exact=True)


def test_of_many_rows_at_an_event_the_first_and_last_stay(tmp_path: Path) -> None:
    times = np.array([0.0, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
    content = {
        "Aclass": characters(["Atrajectory", "1.1", "", "binTrans"], "nul"),
        "name": characters(["time", "u"], "nul").T,
        "dataInfo": np.array([[0, 1, 0, -1], [2, 2, 0, -1]], dtype=np.int32).T,
        "data_1": np.zeros((0, 0)),
        "data_2": np.column_stack([times, np.arange(8.0)]).T,
    }
    write_mat4(tmp_path / "r.mat", content)
    table = read_data(tmp_path / "r.mat")
    np.testing.assert_array_equal(table["time"], [0.0, 0.5, 0.5, 1.0, 1.0])
    np.testing.assert_array_equal(table["u"], [0, 1, 4, 5, 7])


def test_what_dymola_exports_as_plotted(tmp_path: Path) -> None:
    content = {
        "Aclass": characters(["Atrajectory", "1.0", "Stored by Dymola", "binNormal"], "space"),
        "names": characters(["Time", "w"], "space"),
        "data": np.column_stack([TIMES, SPEED]),
    }
    write_mat4(tmp_path / "plotted.mat", content)
    table = read_data(tmp_path / "plotted.mat")
    np.testing.assert_array_equal(table[["time", "w"]], np.column_stack([TIMES, SPEED]))


def test_result_files_without_a_trajectory(tmp_path: Path) -> None:
    linear = characters(["AlinearSystem", "1.0", "", "binNormal"], "nul")
    write_mat4(tmp_path / "dslin.mat", {"Aclass": linear, "ABCD": np.eye(3)})
    with pytest.raises(InputError, match=r"dslin\.mat: holds 'AlinearSystem' data, no trajectories"):
        read_data(tmp_path / "dslin.mat")
    trajectory = characters(["Atrajectory", "1.1", "", "binTrans"], "nul")
    write_mat4(tmp_path / "half.mat", {"Aclass": trajectory, "name": characters(["time"], "nul").T})
    with pytest.raises(InputError, match=r"half\.mat: incomplete result file"):
        read_data(tmp_path / "half.mat")


def test_a_place_of_the_time_beside_a_column_of_that_name(tmp_path: Path) -> None:
    path = written(tmp_path, "u,time\n0,1\n1,2\n")
    with pytest.raises(InputError, match="time is column 1, 'u', but there is a column 'time'"):
        read_data(path, 1)
    assert [*read_data(path, 2)["time"]] == [1.0, 2.0]


LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Decimal_Separator\t,
X_Columns\t{columns}
Date\t2013/02/19
***End_of_Header***\t
\t
Channels\t2\t\t
Samples\t{samples}\t
Y_Unit_Label\t{units}\t
X_Dimension\tTime\tTime\t
X0\t0,0E+0\t0,0E+0\t
Delta_X\t0,25\t0,25\t
***End_of_Header***\t\t\t
"""


def test_short_texts_of_labview(tmp_path: Path) -> None:
    """Lines above the header outnumber the samples; a number of samples counts those of each writing."""
    path = tmp_path / "a.lvm"
    head = LABVIEW.format(columns="No", samples="2\t2", units="mA\tm/s^2") + "X_Value\ti\ta\tComment\n"
    path.write_text(head + "".join(f"\t{k},5\t{k},25\n" for k in range(4)))
    frame = read_data(path)
    assert frame.attrs["units"] == {"i": "mA", "a": "m/s^2"}
    np.testing.assert_array_equal(frame["i"], [0.5, 1.5, 2.5, 3.5])
    np.testing.assert_array_equal(frame["time"], [0.0, 0.25, 0.5, 0.75])
    path.write_text(head + "".join(f"\t{k},5\t{k},25\n" for k in range(3)))
    with pytest.raises(InputError, match="3 rows of samples, 2 by the lines above"):
        read_data(path)
    head = LABVIEW.format(columns="Multi", samples="3\t\t3", units="Volts\t\tg") + "X_Value\tu\tX_Value\ta\tComment\n"
    path.write_text(head + "".join(f"{k},0\t{k},5\t{k},0\t{k},25\n" for k in range(3)))
    frame = read_data(path)
    assert frame.attrs["units"] | {"X_Value 2": ""} == {"u": "Volts", "a": "g", "X_Value 2": ""}
    np.testing.assert_array_equal(frame["a"], [0.25, 1.25, 2.25])


@pytest.mark.slow
def test_text_far_down_a_long_table(tmp_path: Path) -> None:
    """Pandas reads long tables in parts, of which each may have a type of its own."""
    rows = [f"{k / 1000},{k % 17}" for k in range(100_000)]
    (tmp_path / "a.csv").write_text("\n".join(["time,u", *rows, "100.0,OL", "100.001, 5", "100.002,---"]))
    frame = read_data(tmp_path / "a.csv")
    assert frame["u"].isna().sum() == 2
    assert frame["u"][50_000] == 50_000 % 17
    assert frame["u"][100_001] == 5.0
    (tmp_path / "a.csv").write_text("\n".join(["time,u", *rows, "100.0,x", "100.001,5"]))
    with pytest.raises(InputError, match="'x' in row 100001"):
        Experiment(read_data(tmp_path / "a.csv"), [], ["u"])
