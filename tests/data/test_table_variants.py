"""The same measurements written in many ways: each is read as the same numbers, or refused in one sentence."""

from __future__ import annotations

import gzip
import io
import sys
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, InputError, read_data
from fmuid.data.headers import split_header
from tests.support.table_variants import FRAME, MS, SAID, TEXTS, text, writers

U, W = (FRAME[name].to_numpy() for name in "uw")
OTHERWISE = {"other names", "steps as two samples", "rpm, unsaid", "ms, unsaid", "missing: -999"}
OTHERWISE |= {
    "JSON lines, nested",
    "units beside values",
    "Tektronix TDS",
    "Keysight InfiniiVision",
    "scope-matrix.mat",
    "rates.tdms",
    "rates.h5",
}
"""Variants that are read, and are other numbers or names; `tests.studies.test_tables_to_estimates` has them all."""
WRITERS = {name: each for name, each in writers().items() if name not in {*OTHERWISE, *SAID}}
FACTORS = {"rpm": np.pi / 30, "1/min": np.pi / 30, "n/min": np.pi / 30, "mV": 1e-3, "kV": 1e3, "mA": 1e-3, "kA": 1e3}


def check(found: Experiment) -> None:
    """Compare with what was written, in the units in which it is said to be."""
    np.testing.assert_allclose(found.times - found.times[0], FRAME["time"], rtol=1e-9, atol=1e-9)
    values = np.column_stack([found.input_values, found.output_values])
    for name, column in zip(found.columns, values.T, strict=True):
        there = np.isfinite(column)
        assert there.sum() >= len(FRAME) - 3
        scaled = column[there] * FACTORS.get(found.units.get(name, ""), 1.0)
        np.testing.assert_allclose(scaled, FRAME[name][there], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("variant", WRITERS)
def test_as_it_was_written(tmp_path: Path, variant: str) -> None:
    name, write = WRITERS[variant]
    write(tmp_path / name)
    frame = read_data(tmp_path / name)
    columns = {each: each for each in frame.columns if each in FRAME and each != "time"}
    columns |= {each[0]: each for each in frame.columns if each in ("w_rpm", "i_mA")}
    check(Experiment(frame, {"u": "u"}, {name: columns[name] for name in "iw"}))


def test_no_times_but_a_rate(tmp_path: Path) -> None:
    FRAME[["u", "i", "w"]].to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match=r"time column 'time' not found \(columns: u, i, w\).* sample_rate"):
        read_data(tmp_path / "a.csv")
    check(Experiment(read_data(tmp_path / "a.csv", sample_rate=100.0), ["u"], ["i", "w"]))
    FRAME.to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(InputError, match="'time' and sample_rate are both given"):
        read_data(tmp_path / "b.csv", sample_rate=100.0)


def test_the_time_by_its_place_and_in_a_unit_that_is_given(tmp_path: Path) -> None:
    MS.rename(columns={"time": "clock"}).to_csv(tmp_path / "a.csv", index=False)
    check(Experiment(read_data(tmp_path / "a.csv", 1, time_unit="ms"), ["u"], ["i", "w"]))
    with pytest.raises(InputError, match="no time column 5; the table has 4"):
        read_data(tmp_path / "a.csv", 5)
    with pytest.raises(InputError, match="time_unit 'fortnight' is unknown"):
        read_data(tmp_path / "a.csv", 1, time_unit="fortnight")


def test_columns_may_be_named_with_the_units_of_their_headers(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        text("Time (ms),u (mV),i,shaft (rpm)", frame=MS.assign(u=1000 * U, w=W * 30 / np.pi))
    )
    frame = read_data(tmp_path / "a.csv", "Time (ms)")
    assert frame.attrs["units"] == {"u": "mV", "shaft": "rpm"}
    check(Experiment(frame, {"u": "u (mV)"}, {"i": "i", "w": "shaft (rpm)"}, "Time (ms)"))


def test_the_date_of_the_first_sample_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TEXTS["dates with zone"][1])  # type: ignore[arg-type]
    begin = read_data(tmp_path / "a.csv").attrs["begin"]
    assert begin.isoformat() == "2026-11-22T10:30:00+01:00"


def test_times_of_the_day_go_on_past_midnight(tmp_path: Path) -> None:
    clock = [f"{hour:02}:{minute:02}:00" for hour, minute in ((22, 30), (23, 59), (0, 0), (0, 1), (23, 0), (1, 0))]
    (tmp_path / "a.csv").write_text("time,u\n" + "".join(f"{each},1\n" for each in clock))
    minutes = [0, 89, 90, 91, 1470, 1590]
    np.testing.assert_array_equal(read_data(tmp_path / "a.csv")["time"], np.multiply(minutes, 60.0))


@pytest.mark.parametrize(("day", "offsets"), [("2026-10-25", (120, 60)), ("2026-03-29", (60, 120))])
def test_dates_over_a_change_of_clocks(tmp_path: Path, day: str, offsets: tuple[int, int]) -> None:
    """With their offsets they are read; without, the hour that is there twice is no matter of sorting."""
    utc = pd.Timestamp(f"{day} 00:00") + pd.to_timedelta(np.arange(0, 120, 20), unit="min")
    shifts = [offsets[k >= 3] for k in range(6)]
    local = [(each + pd.Timedelta(minutes=shift)).isoformat() for each, shift in zip(utc, shifts, strict=True)]
    path = tmp_path / "a.csv"
    path.write_text("time,u\n" + "".join(f"{a}+0{b // 60}:00,1\n" for a, b in zip(local, shifts, strict=True)))
    frame = read_data(path)
    np.testing.assert_array_equal(frame["time"], 1200.0 * np.arange(6))
    assert frame.attrs["begin"].isoformat() == f"{local[0]}+0{shifts[0] // 60}:00"
    path.write_text("time,u\n" + "".join(f"{each},1\n" for each in local))
    if offsets[1] < offsets[0]:
        with pytest.raises(InputError, match=r"goes back by an hour in row 4 .*02:00:00.*UTC"):
            read_data(path)


@pytest.mark.parametrize(
    ("module", "name", "extra"),
    [
        ("python_calamine", "a.xlsx", "excel"),
        ("h5py", "a.h5", "hdf"),
        ("nptdms", "a.tdms", "tdms"),
        ("asammdf", "a.mf4", "mdf"),
    ],
)
def test_a_library_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, name: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr("fmuid.processes.keeper.AVAILABLE", False)  # read in this process
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(InputError, match=rf'needs {module}\. Install it: pip install "fmuid\[{extra}\]"'):
        read_data(tmp_path / name)


@pytest.mark.parametrize("kind", ["cut gzip", "spoilt zip", "encrypted zip", "two in a zip"])
def test_what_cannot_be_unpacked(tmp_path: Path, kind: str) -> None:
    """Also beyond the part of the file in which its layout is looked for."""
    content = ("time,u,w\n" + "".join(f"{k},{k * 7919 % 10007},{k * k % 10007}\n" for k in range(40000))).encode()
    path, book = tmp_path / ("a.csv.gz" if "gzip" in kind else "a.zip"), io.BytesIO()
    with zipfile.ZipFile(book, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(2 if "two" in kind else 1):
            archive.writestr(f"{number}.csv", content)
    packed = bytearray(book.getvalue())
    if "cut" in kind:
        packed = bytearray(gzip.compress(content)[:-200])
    elif "spoilt" in kind:
        packed[len(packed) // 2] ^= 0xFF
    elif "encrypted" in kind:  # says the flag in both headers
        packed[6] |= 1
        packed[packed.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(packed)
    with pytest.raises(InputError, match=r"cannot be unpacked|2 files in the archive"):
        read_data(path)


def test_a_sheet_by_name_and_by_place(tmp_path: Path) -> None:
    path = tmp_path / "a.xlsx"
    with pd.ExcelWriter(path, engine="openpyxl") as book:
        FRAME.assign(u=0.0, x=1.0).to_excel(book, sheet_name="idle", index=False)
        FRAME.to_excel(book, sheet_name="run", index=False)
        pd.DataFrame({"remark": ["none"]}).to_excel(book, sheet_name="about", index=False)
    assert not read_data(path)["u"].any()
    given: tuple[str | int, ...] = ("run", 2)
    for sheet in given:
        pd.testing.assert_frame_equal(read_data(path, sheet=sheet)[[*FRAME]], FRAME)
    wrong: dict[str | int, str] = {
        "rum": "no sheet 'rum'.*'run'.*idle, run, about",
        4: "no sheet 4.*idle, run, about",
        "about": "the sheet 'about' does not hold a table",
    }
    for other, sentence in wrong.items():
        with pytest.raises(InputError, match=sentence):
            read_data(path, sheet=other)


def test_sheets_of_one_layout_are_to_be_chosen(tmp_path: Path) -> None:
    path = tmp_path / "a.xlsx"
    with pd.ExcelWriter(path, engine="openpyxl") as book:
        for name in ("rig 1", "rig 2"):
            FRAME.to_excel(book, sheet_name=name, index=False)
    with pytest.raises(InputError, match=r"2 sheets of one layout: rig 1, rig 2\. Choose one by sheet"):
        read_data(path)
    pd.testing.assert_frame_equal(read_data(path, sheet="rig 2")[[*FRAME]], FRAME)


@pytest.mark.parametrize("index", [range(3), ["a", "b", "c"], [3.0, 1.0, 2.0]])
def test_an_index_without_a_name_that_is_no_time(tmp_path: Path, index: object) -> None:
    pd.DataFrame({"u": [1.0, 2.0, 3.0]}, index=index).to_csv(tmp_path / "a.csv")  # type: ignore[call-overload]
    with pytest.raises(InputError, match=r"column 'time' not found \(columns: \(no name\), u\)"):
        read_data(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("a.xlsx", "not a readable spreadsheet"),
        ("a.h5", "not a readable HDF5 file"),
        ("a.tdms", "not a readable TDMS file|no channels with samples"),
        ("a.mf4", "not a readable MDF file"),
        ("a.parquet", "not a readable Parquet table"),
        ("a.feather", "not a readable Feather table"),
        ("a.json", "not a readable JSON table"),
    ],
)
def test_files_that_are_none(tmp_path: Path, name: str, sentence: str) -> None:
    for broken in (b"", b"hello world", bytes(range(256)) * 4):
        (tmp_path / name).write_bytes(broken)
        with pytest.raises(InputError, match=sentence):
            read_data(tmp_path / name)


@pytest.mark.parametrize("name", ["time", None])
@pytest.mark.parametrize("kind", ["xlsx", "ods", "csv", "parquet", "feather", "fixed.h5", "table.h5"])
def test_durations_of_pandas_are_no_other_numbers(tmp_path: Path, kind: str, name: str | None) -> None:
    """Into spreadsheets pandas writes them as numbers of days."""
    path = tmp_path / f"a.{kind}"
    frame = FRAME.set_index(pd.TimedeltaIndex(pd.to_timedelta(FRAME["time"], unit="s"), name=name))[["u", "w"]]
    unit = None
    if path.suffix == ".h5":
        frame.to_hdf(path, key="run", format="table" if "table" in kind else "fixed")
    elif kind in ("parquet", "feather"):
        getattr(frame, f"to_{kind}")(path)
    elif kind == "csv":
        frame.to_csv(path)
    else:
        frame.to_excel(str(path))
        with pytest.raises(InputError, match=r"(time|no name\))' may be in days\. Set time_unit = \"d\" or \"s\""):
            read_data(path)
        unit = "d"
    np.testing.assert_allclose(read_data(path, time_unit=unit)["time"], FRAME["time"], rtol=1e-12)


def test_durations_as_spreadsheets_show_them(tmp_path: Path) -> None:
    frame = pd.DataFrame({"time": FRAME["time"] / 86400, "u": U})
    with pd.ExcelWriter(tmp_path / "a.xlsx", engine="openpyxl") as book:
        frame.to_excel(book, index=False)
        for row in range(2, len(frame) + 2):
            book.sheets["Sheet1"].cell(row, 1).number_format = "[h]:mm:ss.00"
    np.testing.assert_allclose(read_data(tmp_path / "a.xlsx")["time"], FRAME["time"], atol=1e-9)


@pytest.mark.parametrize("name", ["Time", "t"])
def test_two_header_rows_of_pandas(tmp_path: Path, name: str) -> None:
    columns = pd.MultiIndex.from_product([["u", "w"], ["raw"]], names=["Variables", "Tags"])
    index = pd.Index(FRAME["time"], name=name)
    pd.DataFrame(FRAME[["u", "w"]].to_numpy(), index, columns).to_csv(tmp_path / "a.csv")
    frame = read_data(tmp_path / "a.csv")
    assert [*frame.columns] == ["time", "u", "w"]
    np.testing.assert_array_equal(frame["w"], W)


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("t/s", "t", "s"),
        ("U/V", "U", "V"),
        ("-Im(Z)/Ohm", "-Im(Z)", "Ohm"),
        ("n/1/min", "n", "1/min"),
        ("w in rad/s", "w", "rad/s"),
        ("m/s", "m/s", None),
        ("rad/s", "rad/s", None),
        ("mV/V", "mV/V", None),
        ("du/dt", "du/dt", None),
        ("Is/In", "Is/In", None),
        ("date/time", "date/time", None),
    ],
)
def test_a_unit_after_a_slash(header: str, name: str, unit: str | None) -> None:
    """DIN 1313 writes units after a slash; rates and ratios are names."""
    assert split_header(header) == (name, unit)


@pytest.mark.parametrize(
    ("header", "unit"),
    [("V(U)", None), ("I(A1)", None), ("V(A)", None), ("I(V)", None), ("V(mV)", "mV"), ("v(km/h)", "km/h")],
)
def test_nodes_of_circuits(header: str, unit: str | None) -> None:
    """Letters that are units of other quantities name nodes."""
    assert split_header(header) == (header if unit is None else header[0], unit)
