"""What a study does with its data: preprocessing, segments, fixed values and parameters of groups, held inputs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, InputError, Simulator, Study
from fmuid.array_types import Floats
from fmuid.data import Preprocessing, preprocess
from tests.support.coil_study import COIL, coil_table

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
data = "{table}"
inputs = ["u"]
outputs = {{ i = "current" }}
interpolation = "{interpolation}"
[experiments.preprocess]
{prepare}
[parameters]
R = {{ start = 4.0, min = 0.0 }}
L = {{ start = 0.1, min = 1e-4 }}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    coil_table(tmp_path / "run.csv", 0.0, seed=1)
    frame = pd.read_csv(tmp_path / "run.csv")
    frame = frame.assign(current=frame["i"], shunt=frame["i"] * 50.0 - 3.0, t=20.0)
    frame.to_csv(tmp_path / "run.csv", index=False)
    return tmp_path


def study(folder: Path, prepare: str, table: str = "run.csv", interpolation: str = "zoh") -> Study:
    text = STUDY.format(fmu=COIL.as_posix(), table=table, prepare=prepare, interpolation=interpolation)
    (folder / "study.toml").write_text(text)
    return Study.read(folder / "study.toml")


def test_preprocessing_is_the_same_as_by_hand(folder: Path) -> None:
    by_hand = pd.read_csv(folder / "run.csv")
    by_hand = by_hand[(by_hand["time"] > 0.0995) & (by_hand["time"] < 0.4005)]
    by_hand.to_csv(folder / "cut.csv", index=False)
    (expected,) = study(folder, "", "cut.csv").tables
    keys = 'computed_columns = { current = "(shunt + 3) / 50" }\nstart_time = 0.1\nend_time = 0.4'
    (found,) = study(folder, keys).tables
    np.testing.assert_array_equal(found.times, expected.times)
    np.testing.assert_allclose(found.output_values, expected.output_values, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        ('computed_columns = { current = "shnt / 50" }', "'shnt' .*'shunt'"),
        ("lowpass_frequency = 60.0", "'u' has interpolation"),
        ("start_time = 3.0\nend_time = 1.0", r"experiments\[0\].preprocess: start_time = 3 is after end_time = 1"),
        ("start_time = 300.0", "300 s .*0 samples"),
        ("segments = [[0.0, 0.2], [0.5, 0.3]]", "segments: must be a list of pairs of times.*earlier time first"),
        ("segments = [[0.0, 0.2, 0.3]]", "segments: must be a list of pairs of times"),
        ("segments = [[0.0, 0.2]]\nend_time = 3.0", "segments and end_time cannot be combined"),
        ('fill_missing = { u = "pchip" }', 'fill_missing.u: must be "linear" or "zoh", not "pchip"'),
        ('fill_missing = { current = "zoh" }', "preprocess.fill_missing: 'current' is the output 'i'. Remove it"),
        ("max_gap = 0.1", "preprocess: max_gap"),
        ('park = [{ source = ["u", "i"], target = ["a", "b"], angle = "t" }]', "source and target"),
    ],
)
def test_wrong_preprocessing_is_refused(folder: Path, prepare: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        _ = study(folder, prepare).tables


# --- what differs between experiments -----------------------------------------------------

STEP, L = 1e-3, 0.1
RUNS = {"run1": (4.0, 0.0), "run2": (4.0, 0.5), "run3": (5.0, 1.0)}
"""Resistance and initial current of each experiment."""
EXPERIMENT = """
[[experiments]]
data = "{name}.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
[experiments.fixed]
i_start = {start}
"""
PARAMETERS = """
[parameters]
R = { start = 3.0, min = 0.0, per_experiment = { cold = ["run1", "run2"], warm = ["run3"] } }
L = { start = 0.15, min = 1e-4 }
"""
U: Floats = np.asarray(np.repeat(np.random.default_rng(3).choice([0.0, 10.0], 15), 20))


def current(u: Floats, R: float, start: float) -> Floats:
    """Return the current under a voltage u[k] held from sample k to the next, in closed form."""
    i, decay = np.full(u.size, start), np.exp(-R / L * STEP)
    for k in range(1, u.size):
        i[k] = u[k - 1] / R + (i[k - 1] - u[k - 1] / R) * decay
    return i


def grouped(folder: Path, old: str = "", new: str = "") -> Study:
    text = f'[model]\nfmu = "{COIL.as_posix()}"\n'
    for name, (resistance, start) in RUNS.items():
        text += EXPERIMENT.format(name=name, start=start)
        table = {"time": STEP * np.arange(U.size), "u": U, "i": current(U, resistance, start)}
        pd.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    assert old in text + PARAMETERS
    (folder / "study.toml").write_text((text + PARAMETERS).replace(old, new))
    return Study.read(folder / "study.toml")


def test_values_and_groups(tmp_path: Path) -> None:
    found = grouped(tmp_path).identify()
    assert found.names == ("R[cold]", "R[warm]", "L")
    np.testing.assert_allclose(found.values, [4.0, 5.0, L], rtol=1e-4)


def test_values_of_the_experiment_go_before_those_of_the_model() -> None:
    frame = pd.DataFrame({"time": STEP * np.arange(U.size), "u": U})
    one, other = (
        Experiment(frame, ["u"], ["i"], interpolation="zoh", measured=False, values=values)
        for values in ({"i_start": 0.5}, {"R": 5.0})
    )
    simulator = Simulator(COIL, one, values={"i_start": 2.0, "R": 4.0, "L": L})
    np.testing.assert_allclose(simulator([])[:, 0], current(U, 4.0, 0.5), atol=1e-4)
    np.testing.assert_allclose(simulator.over(other)([])[:, 0], current(U, 5.0, 2.0), atol=1e-4)


def test_zoh_next() -> None:
    """A recorder that notes the command of the step that ends: the same as one that notes it a sample earlier."""
    late = np.concatenate([U[:1], U[:-1]])
    frame = pd.DataFrame({"time": STEP * np.arange(U.size), "u": late, "i": current(U, 4.0, 0.0)})
    experiment = Experiment(frame, ["u"], ["i"], interpolation="zoh-next")
    assert experiment.held.tolist() == [True]
    np.testing.assert_array_equal(experiment.input_values[:-1, 0], U[:-1])
    simulated = Simulator(COIL, experiment, values={"R": 4.0, "L": L})([])
    np.testing.assert_allclose(simulated, experiment.output_values, atol=1e-4)
    mixed = Experiment(frame.assign(w=late), {"u": "u", "w": "w"}, ["i"], interpolation={"u": "zoh-next"})
    np.testing.assert_array_equal(mixed.input_values[:, 1], late)
    coarse = preprocess(experiment, Preprocessing(resample_interval=20 * STEP))
    np.testing.assert_array_equal(coarse.input_values[:-1, 0], U[:-20:20][: coarse.times.size - 1])


GROUPS = '{ cold = ["run1", "run2"], warm = ["run3"] }'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (GROUPS, '{ cold = ["run1", "run2"], warm = ["rum3"] }', r"'run3' is in none .*did you mean"),
        (GROUPS, '{ cold = ["run1", "run2"], warm = ["run2", "run3"] }', "'run2' is in cold and warm"),
        (GROUPS, '{ cold = "run1" }', "per_experiment.cold: must be a list of names"),
        (GROUPS, '"cold"', "per_experiment: must be"),
        ("i_start = 0.5", "i_strt = 0.5", "'i_strt'"),
        ("i_start = 0.5", 'i_start = "x"', "'i_start' .*Real .*'x'"),
        ("i_start = 0.5", "L = 0.5", "'L' is both a parameter and"),
        ("i_start = 0.5", "u = 0.5", "'u' is an input"),
        ("i_start = 0.5", "i_start = [1]", r"experiments\[1\].fixed.i_start: 1 values given"),
        ("i_start = 0.5", "i_start = { a = 1 }", r"experiments\[1\].fixed.i_start: must be a number, true"),
    ],
)
def test_wrong_groups_and_values(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        grouped(tmp_path, old, new).problem()
