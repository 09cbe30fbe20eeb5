"""Each row of docs/tables.md and docs/time-columns.md: such a table is made, and read as the row says."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import Experiment, InputError, Study
from fmuid.runs import CaseList
from fmuid.studies import InitOptions, match_data_files
from tests.support.coil_study import COIL
from tests.support.docs_rows import RowChecks, rows
from tests.support.table_variants import writers

T = np.arange(100.0) * 1e-3
PLAIN = pd.DataFrame({"time": T, "u": np.where(T < 0.05, 12.0, 0.0), "i": np.sin(40 * T)})
ROLES = 'inputs = ["u"]\noutputs = ["i"]\n'
row = ROWS = RowChecks()
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "COMTRADE, PSCAD": ("comtrade.dat", "comtrade.cfg", "comtrade.cff", "pscad_01.out"),
    "`;` between columns, `3,14`, Excel's CSV, UTF-16, lines above the header": (
        "semicolons",
        "German",
        "UTF-16",
        "preamble",
        "a.csv.gz",
    ),
    "a spreadsheet": ("a.xlsx", "a.ods"),
    "MAT v7.3, HDF5; TDMS; MDF": ("v73.mat", "vectors.mat", "a.h5", "a.tdms", "a.mf4"),
    "a result of OpenModelica or Dymola, `.mat` or `.csv`": ("Motor_res.mat", "dsres.mat", "CSV of OpenModelica"),
    "`Time (ms)`, `time_ms`, `t [min]`": ("Time (ms)", "time_ms", "min"),
    "dates, or times of the day": ("dates", "times of the day"),
    "times that jump back, or are shuffled": ("shuffled",),
    "`w (rpm)`, `ids [mA]`, `U/V`, a row of units below the header": ("w (rpm)", "i [mA]", "u/V", "unit row"),
    "one signal per row (`VarName;TimeString;VarValue`)": ("WinCC",),
    "`12.1 V` in cells": ("Tinytag",),
    "missing samples of an output: empty cells, `-`, `NaN`": ("missing: empty", "missing: -", "missing: NaN"),
}
"""Rows whose files are written and read in `tests.data.test_table_variants`, by the names that they have there."""
PREPROCESS = "[experiments.preprocess]\n"


def written(folder: Path, table: pd.DataFrame = PLAIN, name: str = "run.csv") -> Path:
    table.to_csv(folder / name, index=False)
    return folder / name


def begun(path: Path, **asked: Any) -> Experiment:
    """Return the experiment that `fmuid init` makes of a data file and the coil."""
    (record,) = match_data_files(COIL, [path], InitOptions(**asked))
    assert record.experiment is not None, record.refusal
    return record.experiment


def studied(path: Path, words: str = ROLES, more: str = "") -> tuple[Experiment, ...]:
    """Return the experiments of a study of the coil with one data file."""
    text = f'[model]\nfmu = "{COIL.as_posix()}"\n[[experiments]]\ndata = "{path.name}"\n{words}\n{more}\n'
    (path.parent / "study.toml").write_text(text + "[parameters]\nR = { start = 4.0 }\n")
    return Study.read(path.parent / "study.toml").tables


def assert_plain(*found: Experiment) -> None:
    for each in found:
        np.testing.assert_allclose(each.times - each.times[0], T, atol=1e-7)
        np.testing.assert_allclose(each.input_values[:, 0], PLAIN["u"])
        np.testing.assert_allclose(each.output_values[:, 0], PLAIN["i"], atol=1e-12)


def test_each_row_is_here() -> None:
    heads = [cells[0] for page in ("tables.md", "time-columns.md") for cells in rows(page, 2)]
    assert sorted(heads) == sorted([*ROWS, *VARIANTS])
    assert {name for names in VARIANTS.values() for name in names} <= writers().keys()


@pytest.mark.parametrize("head", ROWS)
def test_row(head: str, tmp_path: Path) -> None:
    ROWS[head](tmp_path)


@row("`Zeit` in ms, without a unit")
def _(folder: Path) -> None:
    path = written(folder, PLAIN.assign(time=1e3 * T).rename(columns={"time": "Zeit"}))
    assert_plain(*studied(path, ROLES + 'time = "Zeit"\ntime_unit = "ms"'), begun(path, time="Zeit", time_unit="ms"))


@row("the model counts time in hours")
def _(folder: Path) -> None:
    path = written(folder, PLAIN.assign(time=60.0 * T).rename(columns={"time": "Time (min)"}))
    assert_plain(*studied(path, ROLES + 'model_time_unit = "h"'), begun(path, model_time_unit="h"))


@row("durations that pandas wrote into .xlsx or .ods as days")
def _(folder: Path) -> None:
    PLAIN.assign(time=pd.to_timedelta(T, unit="s")).to_excel(folder / "run.xlsx", index=False)
    with pytest.raises(InputError, match="time_unit"):
        studied(folder / "run.xlsx")
    assert_plain(*studied(folder / "run.xlsx", ROLES + 'time_unit = "d"'))


@row("local times across a clock change")
def _(folder: Path) -> None:
    utc = pd.Timestamp("2026-10-25T00:59:59.950") + pd.to_timedelta(T, unit="s")  # the clock goes back at 01:00
    ahead = np.where(T < 0.05, 2, 1)
    local = [each + pd.Timedelta(hours=hours) for each, hours in zip(utc, ahead, strict=True)]
    texts = [f"{each.isoformat(timespec='milliseconds')}+0{hours}:00" for each, hours in zip(local, ahead, strict=True)]
    assert_plain(*(begun(written(folder, PLAIN.assign(time=each))) for each in (texts, utc)))
    with pytest.raises(InputError, match=r"row 51 .*UTC"):
        match_data_files(COIL, [written(folder, PLAIN.assign(time=local))])


@row("no times, 10 kHz")
def _(folder: Path) -> None:
    np.testing.assert_allclose(begun(written(folder, PLAIN[["u", "i"]]), sample_rate=10e3).times, T / 10)


@row("rpm, without a unit")
def _(folder: Path) -> None:
    path = written(folder, PLAIN.assign(i=1e3 * PLAIN["i"]))
    (found,) = studied(path, ROLES + 'units = { i = "mA" }')
    assert found.units["i"] == begun(path, units={"i": "mA"}).units["i"] == "mA"
    simulated = [fmuid.Simulator(COIL, each)([]) for each in (found, *studied(written(folder)))]
    np.testing.assert_allclose(simulated[0], 1e3 * simulated[1])


@row("an input that stays at the FMU's start value")
def _(folder: Path) -> None:
    path = written(folder, PLAIN[["time", "i"]])
    for asked, lacking in ((InitOptions(), ("u",)), (InitOptions(columns={"u": ""}), ())):
        (record,) = match_data_files(COIL, [path], asked)
        assert record.lacking("input") == lacking
    assert record.experiment is not None
    assert record.experiment.input_names == ()


@row("other names than the FMU's")
def _(folder: Path) -> None:
    path = written(folder, PLAIN.rename(columns={"u": "Ud_soll", "i": "Kanal 7"}))
    named = studied(path, 'inputs = { u = "Ud_soll" }\noutputs = { i = "Kanal 7" }')
    assert_plain(*named, begun(path, columns={"u": "Ud_soll", "i": "Kanal 7"}))


@row("missing samples of an input")
def _(folder: Path) -> None:
    for length, longest in ((10, ""), (30, "max_gap = 0.5")):
        table = PLAIN.copy()
        table.loc[10 : 10 + length, "u"] = np.nan
        path = written(folder, table)
        with pytest.raises(InputError, match="row 11"):
            studied(path)
        for how in ("linear", "zoh"):
            assert_plain(*studied(path, more=f'{PREPROCESS}fill_missing = {{ u = "{how}" }}\n{longest}'))
    with pytest.raises(InputError, match="20"):
        studied(path, more=PREPROCESS + 'fill_missing = { u = "zoh" }')


@row("missing rows, a logger's pause")
def _(folder: Path) -> None:
    path = written(folder, PLAIN.drop(index=range(10, 20)))
    (record,) = match_data_files(COIL, [path])
    assert record.dropouts == pytest.approx((0.009,))
    assert begun(path).times.size == 90
    path = written(folder, PLAIN.drop(index=range(10, 45)))
    with pytest.raises(InputError, match="row 10"):
        studied(path)
    (found,) = studied(path, more=PREPROCESS + 'fill_missing = { u = "zoh" }\nmax_gap = 0.036')
    np.testing.assert_allclose(found.input_values[:, 0], PLAIN["u"])


@row("three phases, and the model has two axes")
def _(folder: Path) -> None:
    phases = {f"i{name}": 3.0 * np.cos(50 * T - k * 2 * np.pi / 3) for k, name in enumerate("abc")}
    path = written(folder, PLAIN.assign(**phases, theta=50 * T))
    park = 'park = [{ source = ["ia", "ib", "ic"], target = ["ids", "iqs"], angle = "theta" }]'
    (found,) = studied(path, 'inputs = ["u"]\noutputs = { i = "ids" }', PREPROCESS + park)
    np.testing.assert_allclose(found.output_values[:, 0], 3.0 * np.sqrt(1.5))


@row("encoder pulses, a shunt's voltage")
def _(folder: Path) -> None:
    path, computed = written(folder, PLAIN.assign(pulses=1000.0)), 'computed_columns = { x = "pulses * 35.1e-6" }'
    (found,) = studied(path, 'inputs = ["u"]\noutputs = { i = "x" }', PREPROCESS + computed)
    np.testing.assert_allclose(found.output_values, 0.0351)


@row("a transient at the beginning")
def _(folder: Path) -> None:
    (found,) = studied(written(folder), ROLES + "warmup = 0.02")
    assert (found.times.size, found.counted.sum()) == (100, 80)


@row("a long recording, of which two segments are useful")
def _(folder: Path) -> None:
    found = studied(written(folder), more=PREPROCESS + "segments = [[0.005, 0.02], [0.031, 0.04]]")
    ends = [(each.name, each.times[0], each.times[-1]) for each in found]
    assert ends == [("run 1", 0.005, 0.02), ("run 2", 0.031, 0.04)]


@row("a digital controller that holds the voltage")
def _(folder: Path) -> None:
    for how, first in (("zoh", 50), ("zoh-next", 49)):  # sample from which on the input is 0
        (found,) = studied(written(folder), ROLES + f'interpolation = "{how}"')
        assert found.held.all()
        assert int(np.flatnonzero(found.input_values[:, 0] == 0)[0]) == first


@row("a sampling rate far above the machine's bandwidth")
def _(folder: Path) -> None:
    path = written(folder, PLAIN.assign(i=np.sin(40 * T) + np.sin(2 * np.pi * 400 * T)))
    (found,) = studied(path, more=PREPROCESS + "lowpass_frequency = 50.0\nresample_interval = 0.01")
    assert np.diff(found.times) == pytest.approx(0.01)
    np.testing.assert_allclose(found.output_values[2:-2, 0], np.sin(40 * found.times[2:-2]), atol=0.03)
    asked = begun(path, prepare={"lowpass_frequency": 50.0, "resample_interval": 0.01})
    np.testing.assert_array_equal(asked.output_values, found.output_values)


@row("inputs and outputs in two files")
def _(folder: Path) -> None:
    table = PLAIN[["time", "u"]].merge(PLAIN[["time", "i"]].iloc[1::7].assign(time=T[1::7] + 5e-4), how="outer")
    (found,) = studied(written(folder, table), more='preprocess = { fill_missing = { u = "zoh" } }')
    counted = np.isfinite(found.output_values[:, 0])
    np.testing.assert_allclose(found.output_values[counted, 0], PLAIN["i"][1::7])
    np.testing.assert_allclose(found.input_values[:, 0], np.where(found.times < 0.05, 12.0, 0.0))


@row("several files")
def _(folder: Path) -> None:
    written(folder, name="b.csv")
    found = studied(written(folder), more=f'[[experiments]]\ndata = "b.csv"\n{ROLES}')
    assert [each.name for each in found] == ["run", "b"]


@row("hundreds of files, one machine each")
def _(folder: Path) -> None:
    for k in range(30):
        written(folder, name=f"rig{k}.csv")
    studied(written(folder), more='[batch]\ndata = "rig*.csv"')
    assert len(CaseList.of(Study.read(folder / "study.toml"))) == 30


def test_rows_of_several_devices(tmp_path: Path) -> None:
    both = pd.concat([PLAIN.assign(device=name) for name in ("drive 1", "drive 2")]).sort_values("time", kind="stable")
    with pytest.raises(InputError, match="drive 1"):
        studied(written(tmp_path, both))
    assert_plain(*studied(written(tmp_path, both[both["device"] == "drive 1"])))
