"""Tables of benches beyond those of `tests.support.bench_texts`: clocks of regions, second files, units of time."""

from __future__ import annotations

from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, InputError, Study, datasets, read_data
from fmuid.units import parse_unit, unit_in_name
from tests.support.bench_texts import COMTRADE

HOUR = 3600.0


def local_times(day: str, form: str) -> str:
    """Return a table over a change of the clock in Berlin, a row each 10 minutes."""
    utc = pd.date_range(f"{day} 00:00", periods=12, freq="10min", tz="UTC").tz_convert(ZoneInfo("Europe/Berlin"))
    return "time;u\n" + "".join(f"{date.strftime(form)};{k}\n" for k, date in enumerate(utc))


@pytest.mark.parametrize("day", ["2026-10-25", "2026-03-29"])
@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M:%S %Z", "%d.%m.%Y %H:%M:%S %z", "%a %b %d %H:%M:%S %Z %Y"])
def test_zones_by_name_and_offset(tmp_path: Path, day: str, form: str) -> None:
    (tmp_path / "a.csv").write_text(local_times(day, form))
    frame = read_data(tmp_path / "a.csv")
    np.testing.assert_array_equal(frame["time"], 600.0 * np.arange(12))
    assert frame.attrs["begin"] == pd.Timestamp(f"{day} 00:00", tz="UTC")


@pytest.mark.parametrize(("day", "way"), [("2026-10-25", "goes back"), ("2026-03-29", "leaps")])
def test_local_times_over_a_change_of_the_clock(tmp_path: Path, day: str, way: str) -> None:
    (tmp_path / "a.csv").write_text(local_times(day, "%d.%m.%Y %H:%M:%S"))
    with pytest.raises(InputError, match=rf"{way} by an hour in row 7 .*with offsets \(\+01:00\)"):
        read_data(tmp_path / "a.csv")


def test_a_missing_hour_on_another_night(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(local_times("2026-03-29", "%d.%m.%Y %H:%M:%S").replace("29.03", "30.03"))
    assert read_data(tmp_path / "a.csv")["time"].iloc[-1] == 600.0 * 11 + HOUR


def test_unit_of_the_time_in_the_model(tmp_path: Path) -> None:
    """Dates and numbers come to hours of the FMU; a unit of numbers is refused for dates."""
    hours = pd.Timestamp("2026-11-28") + pd.to_timedelta(np.arange(5), unit="h")
    pd.DataFrame({"time": hours, "u": 1.0, "i": np.arange(5)}).to_csv(tmp_path / "dated.csv", index=False)
    pd.DataFrame({"time [min]": 60.0 * np.arange(5), "u": 1.0, "i": np.arange(5)}).to_csv(
        tmp_path / "minutes.csv", index=False
    )
    with pytest.raises(InputError, match=r"has dates; time_unit is for numbers\. Remove it, or set model_time_unit"):
        read_data(tmp_path / "dated.csv", time_unit="h")
    data = {**datasets.coil().study}
    for name in ("dated.csv", "minutes.csv"):
        roles = {"data": name, "inputs": ["u"], "outputs": ["i"], "model_time_unit": "h"}
        study = Study.of({**data, "experiments": [roles]}, tmp_path / "study.toml")
        np.testing.assert_allclose(study.problem().experiments[0].times, np.arange(5.0), rtol=1e-12)


def test_secondary_values_of_comtrade_become_primary(tmp_path: Path) -> None:
    settings = COMTRADE.replace("1,u,,,V,1e-12,0,0,-32767,32767,1,1,P", "1,u,,,V,0.5,2,0,-32767,32767,100,5,s")
    (tmp_path / "a.CFG").write_text(settings)
    (tmp_path / "a.DAT").write_text("1,0,10,0,0\r\n2,10000,99999,0,0\r\n3,20000,-10,0,0\r\n\x1a")
    frame = read_data(tmp_path / "a.DAT")
    np.testing.assert_allclose(frame["time"], [0.0, 0.01, 0.02])
    np.testing.assert_allclose(frame["u"], [140.0, np.nan, -60.0])
    assert frame.attrs["units"]["u"] == "V"


@pytest.mark.parametrize(
    ("settings", "row", "said"),
    [
        (COMTRADE.replace("ASCII", "BINARY"), "1,0,1,1,1", "in binary form. Convert it to ASCII"),
        (COMTRADE, "1,0,1,1", "row 1 has other cells than its .cfg says"),
        (COMTRADE[:40], "1,0,1,1,1", "damaged text of an instrument"),
    ],
)
def test_comtrade_that_is_not_read(tmp_path: Path, settings: str, row: str, said: str) -> None:
    (tmp_path / "a.cfg").write_text(settings)
    (tmp_path / "a.dat").write_text(f"{row}\n{row.replace('1', '2', 1)}\n")
    with pytest.raises(InputError, match=said):
        read_data(tmp_path / "a.dat")


def test_files_beside_must_fit(tmp_path: Path) -> None:
    (tmp_path / "a.cfg").write_text(COMTRADE)
    with pytest.raises(InputError, match=r"without samples\. Put the \.dat file beside it"):
        read_data(tmp_path / "a.cfg")
    (tmp_path / "b.inf").write_text('PGB(1) Output Desc="u" Group="" Units="kV"\n')
    (tmp_path / "b_01.out").write_text("0 1 2\n1 1 2\n")
    with pytest.raises(InputError, match=r"rows have other cells than the \.inf file says"):
        read_data(tmp_path / "b_01.out")


def test_a_unit_of_all_signals_above_the_header(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("Units,mV\ntime,u,v\n0,1,2\n1,3,4\n")
    assert read_data(tmp_path / "a.csv").attrs["units"] == {"u": "mV", "v": "mV"}


def test_seconds_that_pause_are_no_times_in_digits(tmp_path: Path) -> None:
    """A pause of 40 s alone tells no clock such as 125959: samples must be regular on that clock."""
    seconds = 12300 + np.r_[np.arange(40.0, 58.0), np.arange(100.0, 120.0)]
    (tmp_path / "a.csv").write_text("time,u\n" + "".join(f"{each},1\n" for each in seconds))
    np.testing.assert_array_equal(read_data(tmp_path / "a.csv")["time"], seconds)


def test_a_header_that_lacks_a_name_is_no_row_number(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("time u\n" + "".join(f"{k} {0.5 * k} 3\n" for k in range(1, 9)))
    with pytest.raises(InputError):
        read_data(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("months", "form"),
    [
        (("Mrz", "Mai", "Okt", "Dez"), "{:02}-{}-2026 12:00:00"),
        (("mars", "mai", "oct.", "déc."), "{} {} 2026 12:00:00"),
    ],
)
def test_months_of_other_languages(tmp_path: Path, months: tuple[str, ...], form: str) -> None:
    rows = "".join(f"{form.format(5, month)};{k}\n" for k, month in enumerate(months))
    (tmp_path / "a.csv").write_text(f"time;u\n{rows}", encoding="utf-8")
    days = pd.to_datetime([f"2026-{month}-05" for month in ("03", "05", "10", "12")])
    np.testing.assert_array_equal(read_data(tmp_path / "a.csv")["time"], (days - days[0]).total_seconds())


def test_two_runs_below_one_another_are_not_to_be_sorted() -> None:
    frame = pd.DataFrame({"time": [0.0, 1.0, 2.0, 0.0, 1.0, 2.0], "u": 1.0, "i": 2.0})
    with pytest.raises(InputError, match=r"row 4 goes back from 2 s to 0 s\. Split the data there\."):
        Experiment(frame, ["u"], ["i"])
    with pytest.raises(InputError, match=r"row 4 goes back .* Sort the rows or split the data\."):
        Experiment(frame.assign(time=[0.0, 2.0, 3.0, 1.0, 4.0, 5.0]), ["u"], ["i"])


def test_formulas_without_values_are_an_empty_column() -> None:
    frame = pd.DataFrame({"time": [0.0, 1.0, 2.0], "u": np.nan, "i": 2.0})
    with pytest.raises(InputError, match=r"input column 'u' is empty\. Write values, also of formulas\."):
        Experiment(frame, ["u"], ["i"])


def test_parts_of_seconds_after_a_colon(tmp_path: Path) -> None:
    """Milliseconds may lack zeros; hundredths reach 99; up to 29 they may be frames."""
    for steps, form, step in ((20, "{}", 0.05), (100, "{:02}", 0.01)):
        parts = [form.format(round(1e3 * step * k) if form == "{}" else k) for k in range(steps)]
        (tmp_path / "a.csv").write_text("time,u\n" + "".join(f"12:00:00:{part},1\n" for part in parts))
        np.testing.assert_allclose(read_data(tmp_path / "a.csv")["time"], step * np.arange(steps), atol=1e-9)


def test_units_in_capitals_are_either(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("TIME [S],U [MV],P [MW]\n0,1,2\n1,3,4\n")
    assert read_data(tmp_path / "a.csv").attrs["units"] == {"U": "MV or mV", "P": "MW"}
    (tmp_path / "a.csv").write_text("time [s],U [MV],P [MW]\n0,1,2\n1,3,4\n")
    assert read_data(tmp_path / "a.csv").attrs["units"] == {"U": "MV", "P": "MW"}


@pytest.mark.parametrize("separator", [",", " "])
def test_gaps_at_the_end_of_long_tables(tmp_path: Path, separator: str) -> None:
    """Missing last cells that are written are gaps; a row that lacks its cell is refused."""
    rows = [f"{k}{separator}{0.5 * k}{separator}{'NaN' if k % 7 == 3 else 1}" for k in range(60_000)]
    (tmp_path / "a.txt").write_text("\n".join([separator.join(("time", "u", "i")), *rows]))
    frame = read_data(tmp_path / "a.txt")
    np.testing.assert_array_equal(frame["i"].isna(), np.arange(60_000) % 7 == 3)
    rows[50_000] = rows[50_000].rpartition(separator)[0]
    (tmp_path / "a.txt").write_text("\n".join([separator.join(("time", "u", "i")), *rows]))
    with pytest.raises(InputError, match="3 names in the header, 2 cells in row 50001"):
        read_data(tmp_path / "a.txt")


def test_long_texts_in_wide_characters(tmp_path: Path) -> None:
    """Characters of four bytes and signs of typesetters may stand anywhere in UTF-16."""
    rows = "".join(f"{k}\t\u2212{k}\t\U0001d6fa{'x' * (k % 3)}\n" for k in range(30_000))
    (tmp_path / "a.txt").write_text("time\tu [µA]\tmark\n" + rows, encoding="utf-16")
    frame = read_data(tmp_path / "a.txt")
    np.testing.assert_array_equal(frame["u"], -np.arange(30_000.0))
    assert [*frame["mark"]] == [f"\U0001d6fa{'x' * (k % 3)}" for k in range(30_000)]


@pytest.mark.parametrize(
    ("dates", "seconds"),
    [
        (("2026-01-01 00:00:00", "", "2026-01-01 00:00:02.25"), (0.0, np.nan, 2.25)),
        (("2026-03-29T01:00:00+01:00", "2026-03-29T03:00:00+02:00"), (0.0, 3600.0)),
        (("2026-01-01T23:59:59", "2026-01-01T24:00:00"), (0.0, 1.0)),
        (("2026-01-01T00:00:00Z", "2026-01-01T00:00:01Z"), (0.0, 1.0)),
    ],
)
def test_dates_of_iso_8601(tmp_path: Path, dates: tuple[str, ...], seconds: tuple[float, ...]) -> None:
    (tmp_path / "a.csv").write_text("time;u\n" + "".join(f"{date};{k}\n" for k, date in enumerate(dates)))
    np.testing.assert_array_equal(read_data(tmp_path / "a.csv")["time"], seconds)


def test_units_before_the_number_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("Time (s) Run #1,Voltage (mV) Run #1\n0,1\n1,2\n2,3\n")
    frame = read_data(tmp_path / "a.csv")
    assert frame.attrs["units"] == {"Voltage Run #1": "mV"}
    np.testing.assert_array_equal(frame["time"], [0.0, 1.0, 2.0])


def test_points_between_parts_of_a_clock(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("Aika;u\n28.11.2026 9.59.59;1\n28.11.2026 10.00.00;2\n28.11.2026 10.00.02;3\n")
    np.testing.assert_array_equal(read_data(tmp_path / "a.csv")["time"], [0.0, 1.0, 3.0])


def test_hours_and_seconds_of_each(tmp_path: Path) -> None:
    """OpenDSS counts seconds anew in each hour."""
    rows = "".join(f"{60 * k // 3600}, {60 * k % 3600}, {k}\n" for k in range(130))
    (tmp_path / "a.csv").write_text("hour, t(sec), V1\n" + rows)
    np.testing.assert_array_equal(read_data(tmp_path / "a.csv")["time"], 60.0 * np.arange(130))


@pytest.mark.parametrize("zero", [739_948.0, 46_354.0])
def test_days_of_matlab_and_spreadsheets_in_days(tmp_path: Path, zero: float) -> None:
    """Days on a calendar count from the first where the unit is said."""
    days = zero + 0.25 + np.arange(20) / 86_400
    pd.DataFrame({"time": days, "u": 1.0}).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(InputError, match=r'may be in days\. Set time_unit = "d"'):
        read_data(tmp_path / "a.csv")
    frame = read_data(tmp_path / "a.csv", time_unit="d")
    np.testing.assert_allclose(frame["time"], np.arange(20.0), atol=2e-5)
    assert frame.attrs["begin"].hour == 6


def test_whole_numbers_in_large_steps_are_no_seconds(tmp_path: Path) -> None:
    for step, read in ((4000, False), (1234, False), (3600, True), (900, True)):
        (tmp_path / "a.csv").write_text("time,u\n" + "".join(f"{step * k},1\n" for k in range(9)))
        if read:
            assert read_data(tmp_path / "a.csv")["time"].iloc[-1] == 8 * step
            continue
        with pytest.raises(InputError, match=r'may be in ms, µs or ns\. Set time_unit, such as "us"'):
            read_data(tmp_path / "a.csv")
        assert read_data(tmp_path / "a.csv", time_unit="us")["time"].iloc[-1] == pytest.approx(8e-6 * step)


def test_waveforms_of_several_groups(tmp_path: Path) -> None:
    """Groups of one waveform each make one table, at their starts; others are named as left out."""
    nptdms = pytest.importorskip("nptdms")
    start = np.datetime64("2026-11-28T10:00:00")
    said = {"wf_increment": 0.1, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        for group, name, late in (("AI0", "u", 0), ("AI1", "i", 50)):
            own = said | {"wf_start_time": start + np.timedelta64(late, "ms")}
            file.write_segment([nptdms.ChannelObject(group, name, np.arange(9.0), properties=own)])
    frame = read_data(tmp_path / "a.tdms")
    there = frame["i"].notna()
    np.testing.assert_allclose(frame["time"][there], 0.05 + 0.1 * np.arange(9))
    with nptdms.TdmsWriter(tmp_path / "b.tdms") as file:
        file.write_segment([nptdms.ChannelObject("fast", name, np.arange(20.0)) for name in ("time", "u")])
        file.write_segment([nptdms.ChannelObject("slow", "i", np.arange(5.0))])
    frame = read_data(tmp_path / "b.tdms")
    assert [*frame] == ["time", "u"]
    assert frame.attrs["left out"] == {"i": "a channel of group 'slow'"}


def test_titles_and_notes_beside_a_table_in_a_sheet(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    sheet["A1"], sheet["H7"] = "Rig 4", "note"
    for k, row in enumerate((("t [s]", "u [V]"), *((0.1 * k, k) for k in range(9)))):
        for place, cell in enumerate(row):
            sheet.cell(5 + k, 3 + place, cell)
    book.save(tmp_path / "a.xlsx")
    frame = read_data(tmp_path / "a.xlsx")
    assert [*frame] == ["time", "u"]
    np.testing.assert_allclose(frame["u"], np.arange(9.0))


def test_structure_array_of_rows(tmp_path: Path) -> None:
    from scipy.io import savemat

    rows = np.zeros((1, 20), dtype=[("t", "O"), ("u", "O")])
    rows[0] = [(0.1 * k, k) for k in range(20)]
    savemat(tmp_path / "a.mat", {"data": rows})
    np.testing.assert_allclose(read_data(tmp_path / "a.mat")["u"], np.arange(20.0))


@pytest.mark.parametrize("module", ["bz2", "lzma"])
def test_other_packed_texts(tmp_path: Path, module: str) -> None:
    import importlib

    path = tmp_path / f"a.csv.{'xz' if module == 'lzma' else module}"
    path.write_bytes(importlib.import_module(module).compress(b"time,u\n0,1\n1,2\n"))
    assert read_data(path)["u"].tolist() == [1, 2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("u=1 i=2\nu=1 j=2\n", "line 2 has other names than the first"),
        ("a u=1,i=2 1795343400000000000\nb u=1,i=2 1795343400010000000\n", "several series"),
        ("IGOR\nWAVES t u\nBEGIN\n0 1\nEND\nWAVES t u\nBEGIN\n0 1\nEND\n", "2 tables of Igor"),
        ("Title: a\nFlags: complex\nNo. Variables: 1\nNo. Points: 1\nVariables:\n 0 f\nValues:\n0 1,0\n", "complex"),
    ],
)
def test_blocks_and_keys_that_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(InputError, match=said):
        read_data(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("DATE (MM/DD/YYYY),T,u\n04/03/2026,23:59,1\n04/04/2026,00:00,2\n", [60.0]),
        ("Datum;u\n03.04.2026 23:59;1\n04.04.2026 00:00;2\n", [60.0]),
        ("stamp,u\n01/02/2026 10:00,1\n01/02/2026 10:01,2\n", [60.0]),  # of either order
        ("stamp,u\n04/03/2026 23:59,1\n04/04/2026 00:00,2\n05/04/2026 00:00,3\n", None),
        ("time,u\n20260228:2350,1\n20260301:0010,2\n", [1200.0]),
        ("YY MM DD hh mm u\n26 2 28 23 50 1\n26 3 1 0 10 2\n", [1200.0]),
        (
            "A,ObsTime(UTC),ObsTime(LST)\n1,2026-02-28 10:00,2026-02-28 5:00\n2,2026-02-28 10:05,2026-02-28 5:05\n",
            [300.0],
        ),
        ("time (min:sec),u\n0:07,1\n0:09,2\n", [2.0]),
        ("time,u\n0:00,1\n0:15,2\n", [900.0]),
        ("period,u\n2026-02-28T10:00:00/2026-02-28T10:01:00,1\n2026-02-28T10:01:00/2026-02-28T10:02:00,2\n", [60.0]),
        ("Month,Day,Hour,u\n1,31,22,1\n1,31,23,2\n2,1,0,3\n", [3600.0, 3600.0]),
        (
            "stamp,u_min,u_TMn,u\n2026-02-28 10:00,1,2026-02-28 09:10,5\n2026-02-28 11:00,2,2026-02-28 10:50,6\n",
            [3600.0],
        ),
        ("время замера;T\n2026-02-28 10:00;7.5\n2026-02-28 10:05;6.5\n", [300.0]),
        ("t (millisec),u\n5,1\n10,2\n", [0.005]),
        ("Date,u\n28/02/2026,1\n01/03/2026,2\n02/03/2026,2\n", [86400.0, 86400.0]),
        ("elapsedMillis,u\n250,1\n300,2\n350,3\n", [0.05, 0.05]),
        (
            "Elapsed time,stamp,u\n0,2026-02-28 10:00,1\n90,2026-02-28 11:30,2\n180,2026-02-28 13:00,3\n",
            [5400.0, 5400.0],
        ),
    ],
)
def test_stamps_that_can_be_known(tmp_path: Path, text: str, steps: list[float] | None) -> None:
    """Orders of dates count only where they change the steps; units stand in names, or follow from dates beside."""
    (tmp_path / "a.csv").write_text(text)
    if steps is None:
        with pytest.raises(InputError, match=r"day and month of .* are ambiguous"):
            read_data(tmp_path / "a.csv")
        return
    np.testing.assert_allclose(np.diff(read_data(tmp_path / "a.csv")["time"]), steps)


def test_minutes_or_hours(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time,u\n0:00,1\n0:07,2\n0:14,3\n")
    with pytest.raises(InputError, match=r"'0:00', '0:07' may be hours or minutes\. Write times as 0:00:00"):
        read_data(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("# w [rpm]: speed\n# u: supply (mV)\ntime,u,w\n0,1,2\n1,3,4\n", {"w": "rpm", "u": "mV"}),
        ("time,T2m\n0,1\n1,3\n\nT2m: air temperature (degree Celsius)\n", {"T2m": "degree Celsius"}),
        ("time,T (C),u\n0,1,2\n1,3,4\n", {"T": "C"}),
        ("Elapsed Time    Motor u\n    (s)     (V)\n0\t1\n1\t2\n2\t3\n", {"Motor u": "V"}),
        ("time,u [V (Voltage)]\n0,1\n1,3\n", {"u": "V"}),
        ("time,i (mA),q (ccps)\n0,1,2\n1,3,4\n", {"i": "mA", "q": "ccps"}),
        ("time,n x1000 rpm,P*10 [W],m/%\n0,1,2,3\n1,3,4,5\n", {"n x1000 rpm": "x1000 rpm", "P*10": "*10 W", "m": "%"}),
        ("time,u,i\nfloat,float,float\n0,1,2\n1,3,4\n", {}),
        ("time,u [V]\nlog of the rig\n0,1\n1,2\n", {"u": "V"}),
        ("! rig\n! t_[s] u_[mV]\n! 4\n0.0 1.5\n0.1 2.5\n0.2 3.5\n", {"u_": "mV"}),
        ("# Columns:\n# 1. G. Irradiation at ground (W/m2)\n# time;G\n0;1\n1;3\n", {"G": "W/m2"}),
        ("Units,V,,Units,mA\nTIME,u,,TIME,i\n0,1,,0,2\n1,3,,1,4\n2,3,,2,4\n", {"u": "V", "i": "mA"}),
    ],
)
def test_units_in_legends_blocks_and_remarks(tmp_path: Path, text: str, units: dict[str, str]) -> None:
    (tmp_path / "a.txt").write_text(text)
    assert read_data(tmp_path / "a.txt").attrs["units"] == units


@pytest.mark.parametrize("last", ['42,"pump off, fan on"', "42.5,stop"])
def test_a_remark_in_the_last_row_is_no_event(tmp_path: Path, last: str) -> None:
    rows = "".join(f"{k},{k},\n" for k in range(9))
    (tmp_path / "a.csv").write_text(f"time,u,remark\n{rows}9,{last}\n")
    assert len(read_data(tmp_path / "a.csv")) == 10


def test_whole_times_in_uneven_steps_are_asked_for(tmp_path: Path) -> None:
    times = np.cumsum([118, 121, 117, 116, 122, 119, 118])
    (tmp_path / "a.csv").write_text("time,u\n" + "".join(f"{each},1\n" for each in times))
    with pytest.raises(InputError, match="may be in ms, µs or ns"):
        read_data(tmp_path / "a.csv")
    assert read_data(tmp_path / "a.csv", time_unit="s")["time"].iloc[-1] == times[-1]


def test_rows_of_several_devices(tmp_path: Path) -> None:
    rows = "".join(f"{k // 2},{k},{'AB'[k % 2]}\n" for k in range(60))
    (tmp_path / "a.csv").write_text("time,u,device\n" + rows)
    with pytest.raises(InputError, match=r"'device' has several values at one time\. Keep the rows of 'A'"):
        read_data(tmp_path / "a.csv")


def test_objects_of_json_in_any_text(tmp_path: Path) -> None:
    (tmp_path / "LOG.TXT").write_text("".join(f'{{"t": {k}, "u": {2 * k}}}\n' for k in range(5)))
    assert read_data(tmp_path / "LOG.TXT")["u"].tolist() == [0, 2, 4, 6, 8]


@pytest.mark.parametrize("form", ["SLIST", "TSPAIR"])
def test_series_of_iris(tmp_path: Path, form: str) -> None:
    rows = " 1 2\n 3\n" if form == "SLIST" else "".join(f"2026-11-28T10:00:00.{25 * k:03} {k + 1}\n" for k in range(3))
    (tmp_path / "a.txt").write_text(
        f"TIMESERIES X, 3 samples, 40 sps, 2026-11-28T10:00:00, {form}, FLOAT, RAD/S\n{rows}"
    )
    frame = read_data(tmp_path / "a.txt")
    np.testing.assert_allclose(frame["time"], [0.0, 0.025, 0.05])
    assert frame["X"].tolist() == [1, 2, 3] and frame.attrs["units"] == {"X": "rad/s"}


def test_units_at_the_end_of_names() -> None:
    names = ("mAmps", "Temp. Deg C", "Cell_Temperature_C", "p mBar", "Motor.rpm", "adc_mv", "R_C", "x bar", "R_s")
    said = ["mAmps", "Deg C", "degC", "mBar", "rpm", "mV", None, None, None]
    assert [unit_in_name(each) for each in names] == said
    assert parse_unit("kN-m") == parse_unit("kN.m")
