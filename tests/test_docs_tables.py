"""Each row of docs/tables.md: a table that looks like this is made, and read as the row says."""

from __future__ import annotations

import gzip
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.data import Experiment
from fmuid.errors import InputError
from fmuid.models import read_description
from fmuid.studies import InitOptions, Study, match_data_files
from tests.support.coil_study import COIL
from tests.support.docs_rows import rows
from tests.support.paths import FMUS
from tests.support.table_variants import FILES

Check = Callable[[Path, pytest.MonkeyPatch], None]
ROWS: dict[str, Check] = {}
T = np.arange(100.0) * 1e-3
PLAIN = pd.DataFrame({"time": T, "u": np.where(T < 0.05, 12.0, 0.0), "i": np.sin(40 * T)})
MS = PLAIN.assign(time=1e3 * T)


def row(head: str) -> Callable[[Check], None]:
    """Take a function for the check of the row with this first cell."""
    return lambda check: ROWS.update({head: check})


def written(folder: Path, table: pd.DataFrame = PLAIN, name: str = "run.csv") -> Path:
    table.to_csv(folder / name, index=False)
    return folder / name


def begun(path: Path, **asked: object) -> Experiment:
    """Return the record that `fmuid init` makes of a table and the coil."""
    (record,) = match_data_files(COIL, [path], InitOptions(**asked))  # type: ignore[arg-type]
    assert record.experiment is not None, record.refusal
    return record.experiment


def studied(path: Path, words: str = 'outputs = ["i"]\ninputs = ["u"]', more: str = "") -> tuple[Experiment, ...]:
    """Return the records of a study of the coil with the words of one table."""
    text = f'[model]\nfmu = "{COIL.as_posix()}"\n[[experiments]]\ndata = "{path.name}"\n{words}\n{more}\n'
    (path.parent / "study.toml").write_text(text + "[parameters]\nR = { start = 4.0 }\n")
    return Study.read(path.parent / "study.toml").tables


def same(found: Experiment) -> None:
    """Check that a record is the plain one."""
    np.testing.assert_allclose(found.times - found.times[0], T, atol=1e-7)
    np.testing.assert_allclose(found.input_values[:, 0], PLAIN["u"])
    np.testing.assert_allclose(found.output_values[:, 0], PLAIN["i"], atol=1e-12)


def test_each_row_is_here() -> None:
    assert [cells[0] for cells in rows("tables.md", 2)] == list(ROWS)


@pytest.mark.parametrize("head", ROWS)
def test_row(head: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ROWS[head](tmp_path, monkeypatch)


@row("`;` between columns, `3,14`, Excel's CSV, UTF-16, lines above the header")
def _dialects(folder: Path, _: pytest.MonkeyPatch) -> None:
    text = "Rig;4\nOperator;A;B\n\n" + PLAIN.to_csv(sep=";", decimal=",", index=False)
    for name, content in (("a.csv", text.encode("utf-16")), ("b.csv", text.encode("utf-8-sig"))):
        (folder / name).write_bytes(content)
        same(begun(folder / name))
    (folder / "c.csv.gz").write_bytes(gzip.compress(text.encode()))
    same(begun(folder / "c.csv.gz"))


def _needs(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str, extra: str) -> None:
    """Check that a file is read, and without its library the extra that brings it is named."""
    FILES[name](folder / name)
    assert {"u", "i", "w"} <= set(fmuid.read_data(folder / name).columns)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, module, None)
        without.setattr("fmuid.processes.keeper.AVAILABLE", False)  # read in this process
        with pytest.raises(InputError, match=rf'pip install "fmuid\[{extra}\]"'):
            fmuid.read_data(folder / name)


@row("a spreadsheet")
def _spreadsheet(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _needs(folder, monkeypatch, "a.xlsx", "python_calamine", "excel")
    with pd.ExcelWriter(folder / "run.xlsx") as book:
        PLAIN.assign(i=0.0).to_excel(book, sheet_name="run 1", index=False)
        PLAIN.to_excel(book, sheet_name="run 3", index=False)
    same(begun(folder / "run.xlsx", sheet="run 3"))
    assert not begun(folder / "run.xlsx").output_values.any()


@row("MAT v7.3, HDF5; TDMS; MDF")
def _loggers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, module, extra in (
        ("v73.mat", "h5py", "hdf"),
        ("a.h5", "h5py", "hdf"),
        ("a.tdms", "nptdms", "tdms"),
        ("a.mf4", "asammdf", "mdf"),
    ):
        _needs(folder, monkeypatch, name, module, extra)
    FILES["vectors.mat"](folder / "vectors.mat")
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "u" in fmuid.read_data(folder / "vectors.mat")


@row("a result of OpenModelica or Dymola, `.mat` or `.csv`")
def _simulators(folder: Path, _: pytest.MonkeyPatch) -> None:
    for name in ("Motor_res.mat", "dsres.mat"):
        FILES[name](folder / name)
        assert {"time", "u", "i", "w"} <= set(fmuid.read_data(folder / name).columns)
    (folder / "Coil_res.csv").write_text(
        '"time","u","i","der(i)"\n' + PLAIN.assign(d=0.0).to_csv(index=False, header=False)
    )
    same(begun(folder / "Coil_res.csv"))


@row("`Time (ms)`, `time_ms`, `t [min]`")
def _time_units(folder: Path, _: pytest.MonkeyPatch) -> None:
    for name, scale in (("Time (ms)", 1e3), ("time_ms", 1e3), ("t [min]", 1 / 60)):
        same(begun(written(folder, PLAIN.assign(time=scale * T).rename(columns={"time": name}))))


@row("`Zeit` in ms, without a unit")
def _unsaid_time(folder: Path, _: pytest.MonkeyPatch) -> None:
    path = written(folder, MS.rename(columns={"time": "Zeit"}))
    (found,) = studied(path, 'inputs = ["u"]\noutputs = ["i"]\ntime = "Zeit"\ntime_unit = "ms"')
    same(found)
    same(begun(path, time="Zeit", time_unit="ms"))


@row("durations that pandas wrote into .xlsx or .ods as days")
def _durations(folder: Path, _: pytest.MonkeyPatch) -> None:
    PLAIN.assign(time=pd.to_timedelta(T, unit="s")).to_excel(folder / "run.xlsx", index=False)
    with pytest.raises(InputError, match='Set time_unit = "d" or "s"'):
        studied(folder / "run.xlsx")
    same(*studied(folder / "run.xlsx", 'outputs = ["i"]\ninputs = ["u"]\ntime_unit = "d"'))


@row("dates, or times of the day")
def _dates(folder: Path, _: pytest.MonkeyPatch) -> None:
    dates = pd.Timestamp("2026-03-01T23:59:59.950") + pd.to_timedelta(T, unit="s")
    same(begun(written(folder, PLAIN.assign(time=dates.strftime("%Y-%m-%d %H:%M:%S.%f")))))
    early = pd.Timestamp("2026-03-01T10:00:00") + pd.to_timedelta(T, unit="s")
    same(begun(written(folder, PLAIN.assign(time=early.strftime("%H:%M:%S.%f")))))


@row("local times across a clock change")
def _clocks(folder: Path, _: pytest.MonkeyPatch) -> None:
    utc = pd.Timestamp("2026-10-25T00:59:59.950") + pd.to_timedelta(T, unit="s")  # the clock goes back at 01:00
    ahead = np.where(T < 0.05, 2, 1)
    local = [each + pd.Timedelta(hours=hours) for each, hours in zip(utc, ahead, strict=True)]
    texts = [f"{each.isoformat(timespec='milliseconds')}+0{hours}:00" for each, hours in zip(local, ahead, strict=True)]
    same(begun(written(folder, PLAIN.assign(time=texts))))
    same(begun(written(folder, PLAIN.assign(time=utc))))
    with pytest.raises(
        InputError, match=r"goes back by an hour in row 51 .*UTC or with off"
    ):
        match_data_files(COIL, [written(folder, PLAIN.assign(time=local))])


@row("no times, 10 kHz")
def _no_times(folder: Path, _: pytest.MonkeyPatch) -> None:
    found = begun(written(folder, PLAIN[["u", "i"]]), sample_rate=10e3)
    np.testing.assert_allclose(found.times, T / 10)


@row("times that jump back, or are shuffled")
def _shuffled(folder: Path, _: pytest.MonkeyPatch) -> None:
    for table in (PLAIN.sample(frac=1.0, random_state=2), pd.concat([PLAIN, PLAIN])):
        (record,) = match_data_files(COIL, [written(folder, table)])
        back = int(np.flatnonzero(np.diff(table["time"]) < 0)[0])
        assert f"row {back + 2} goes back" in record.refusal
        assert "Sort the rows" in record.refusal


@row("`w (rpm)`, `ids [mA]`, a row of units below the header")
def _units(folder: Path, _: pytest.MonkeyPatch) -> None:
    machine = read_description(FMUS / "InductionMachine/InductionMachine.fmu")
    table = pd.DataFrame({"t": T, "uds": 1.0, "uqs": 1.0, "w (rpm)": 1500.0, "ids [mA]": 2.0, "iqs [A]": 2.0})
    path = written(folder, table)
    (record,) = match_data_files(FMUS / "InductionMachine/InductionMachine.fmu", [path])
    assert record.experiment is not None
    for name, unit, value, own in (("w", "rpm", 1500.0, 50 * np.pi), ("ids", "mA", 2.0, 2e-3)):
        assert record.experiment.units[name] == unit
        assert machine.conversion(machine.variables[name], unit)[0] * value == pytest.approx(own)
    path.write_text(path.read_text().replace("w (rpm),ids [mA],iqs [A]\n", "w,ids,iqs\ns,V,V,rpm,mA,A\n"))
    (below,) = match_data_files(FMUS / "InductionMachine/InductionMachine.fmu", [path])
    assert below.experiment is not None
    assert below.experiment.units == {**record.experiment.units, "uds": "V", "uqs": "V"}


@row("rpm, without a unit")
def _unsaid_units(folder: Path, _: pytest.MonkeyPatch) -> None:
    path = written(folder, PLAIN.assign(i=1e3 * PLAIN["i"]))
    (found,) = studied(path, 'inputs = ["u"]\noutputs = ["i"]\nunits = { i = "mA" }')
    assert found.units["i"] == begun(path, units={"i": "mA"}).units["i"] == "mA"
    simulated = [fmuid.Simulator(COIL, each)([]) for each in (found, *studied(written(folder)))]
    np.testing.assert_allclose(simulated[0], 1e3 * simulated[1])


@row("an input that stays at the FMU's start value")
def _at_its_start(folder: Path, _: pytest.MonkeyPatch) -> None:
    (record,) = match_data_files(COIL, [written(folder, PLAIN[["time", "i"]])])
    assert record.lacking("input") == ("u",)
    (record,) = match_data_files(COIL, [folder / "run.csv"], InitOptions(columns={"u": ""}))
    assert record.lacking("input") == ()
    assert record.experiment is not None
    assert record.experiment.input_names == ()


@row("other names than the FMU's")
def _names(folder: Path, _: pytest.MonkeyPatch) -> None:
    path = written(folder, PLAIN.rename(columns={"u": "Ud_soll", "i": "Kanal 7"}))
    (found,) = studied(path, 'inputs = { u = "Ud_soll" }\noutputs = { i = "Kanal 7" }')
    same(found)
    same(begun(path, columns={"u": "Ud_soll", "i": "Kanal 7"}))


@row("missing samples of an output: empty cells, `-`, `NaN`")
def _gaps(folder: Path, _: pytest.MonkeyPatch) -> None:
    for mark in ("", "-", "NaN"):
        found = begun(written(folder, PLAIN.astype({"i": object}).assign(i=[mark, *PLAIN["i"][1:]])))
        assert found.counted[:, 0].tolist() == [False] + [True] * 99


@row("missing samples of an input")
def _gaps_in_an_input(folder: Path, _: pytest.MonkeyPatch) -> None:
    for length, longest in ((10, ""), (30, "max_gap = 0.5")):
        table = PLAIN.copy()
        table.loc[10 : 10 + length, "u"] = np.nan
        path = written(folder, table)
        with pytest.raises(InputError, match=r"input column 'u' has no value in row 11"):
            studied(path)
        for word in ("linear", "zoh"):
            (found,) = studied(path, more=f'[experiments.preprocess]\nfill_missing = {{ u = "{word}" }}\n{longest}')
            same(found)
    with pytest.raises(InputError, match="limit 20 intervals"):
        studied(path, more='[experiments.preprocess]\nfill_missing = { u = "zoh" }')


@row("missing rows, a logger's pause")
def _missing_rows(folder: Path, _: pytest.MonkeyPatch) -> None:
    path = written(folder, PLAIN.drop(index=range(10, 20)))
    (record,) = match_data_files(COIL, [path])
    assert record.dropouts == pytest.approx((0.009,))
    assert begun(path).times.size == 90
    path = written(folder, PLAIN.drop(index=range(10, 45)))
    with pytest.raises(InputError, match=r"rows missing from 0\.009 s \(row 10\) to 0\.045 s"):
        studied(path)
    (found,) = studied(path, more='[experiments.preprocess]\nfill_missing = { u = "zoh" }\nmax_gap = 0.036')
    np.testing.assert_allclose(found.input_values[:, 0], PLAIN["u"])


@row("three phases, and the model has two axes")
def _axes(folder: Path, _: pytest.MonkeyPatch) -> None:
    phases = {f"i{name}": 3.0 * np.cos(50 * T - k * 2 * np.pi / 3) for k, name in enumerate("abc")}
    path = written(folder, PLAIN.assign(**phases, theta=50 * T))
    axes = 'park = [{ source = ["ia", "ib", "ic"], target = ["ids", "iqs"], angle = "theta" }]'
    (found,) = studied(path, 'inputs = ["u"]\noutputs = { i = "ids" }', f"[experiments.preprocess]\n{axes}")
    np.testing.assert_allclose(found.output_values[:, 0], 3.0 * np.sqrt(1.5))


@row("encoder pulses, a shunt's voltage")
def _derived(folder: Path, _: pytest.MonkeyPatch) -> None:
    path = written(folder, PLAIN.assign(pulses=1000.0))
    derived = '[experiments.preprocess]\ncomputed_columns = { x = "pulses * 35.1e-6" }'
    (found,) = studied(path, 'inputs = ["u"]\noutputs = { i = "x" }', derived)
    np.testing.assert_allclose(found.output_values, 0.0351)


@row("a transient at the beginning")
def _discard(folder: Path, _: pytest.MonkeyPatch) -> None:
    (found,) = studied(written(folder), 'inputs = ["u"]\noutputs = ["i"]\nwarmup = 0.02')
    assert found.times.size == 100
    assert found.counted.sum() == 80


@row("a long recording, of which two segments are useful")
def _pieces(folder: Path, _: pytest.MonkeyPatch) -> None:
    found = studied(written(folder), more="[experiments.preprocess]\nsegments = [[0.005, 0.02], [0.031, 0.04]]")
    assert [(each.times[0], each.times[-1]) for each in found] == [(0.005, 0.02), (0.031, 0.04)]


@row("a digital controller that holds the voltage")
def _held(folder: Path, _: pytest.MonkeyPatch) -> None:
    for word, at in (("zoh", 50), ("zoh-next", 49)):
        (found,) = studied(written(folder), f'inputs = ["u"]\noutputs = ["i"]\ninterpolation = "{word}"')
        assert found.held.all()
        assert int(np.flatnonzero(found.input_values[:, 0] == 0)[0]) == at  # from this sample on the input is 0


@row("a sampling rate far above the machine's bandwidth")
def _slow(folder: Path, _: pytest.MonkeyPatch) -> None:
    path = written(folder, PLAIN.assign(i=np.sin(40 * T) + np.sin(2 * np.pi * 400 * T)))
    (found,) = studied(path, more="[experiments.preprocess]\nlowpass_frequency = 50.0\nresample_interval = 0.01")
    assert np.diff(found.times) == pytest.approx(0.01)
    np.testing.assert_allclose(found.output_values[2:-2, 0], np.sin(40 * found.times[2:-2]), atol=0.03)
    asked = begun(path, prepare={"lowpass_frequency": 50.0, "resample_interval": 0.01})
    np.testing.assert_array_equal(asked.output_values, found.output_values)


@row("inputs and outputs in two files")
def _two_files(folder: Path, _: pytest.MonkeyPatch) -> None:
    table = PLAIN[["time", "u"]].merge(PLAIN[["time", "i"]].iloc[1::7].assign(time=T[1::7] + 5e-4), how="outer")
    (found,) = studied(written(folder, table), more='preprocess = { fill_missing = { u = "zoh" } }')
    counted = np.isfinite(found.output_values[:, 0])
    np.testing.assert_allclose(found.output_values[counted, 0], PLAIN["i"][1::7])
    np.testing.assert_allclose(found.input_values[:, 0], np.where(found.times < 0.05, 12.0, 0.0))


@row("several files")
def _several(folder: Path, _: pytest.MonkeyPatch) -> None:
    written(folder, name="b.csv")
    found = studied(written(folder), more='[[experiments]]\ndata = "b.csv"\ninputs = ["u"]\noutputs = ["i"]')
    assert [each.name for each in found] == ["run", "b"]


@row("hundreds of files, one machine each")
def _hundreds(folder: Path, _: pytest.MonkeyPatch) -> None:
    from fmuid.runs.batch.case_list import CaseList

    for k in range(30):
        written(folder, name=f"rig{k}.csv")
    studied(written(folder), more='[batch]\ndata = "rig*.csv"')
    assert len(CaseList.of(Study.read(folder / "study.toml"))) == 30
