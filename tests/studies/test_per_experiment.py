"""What differs between experiments: fixed values, parameters of groups, inputs that hold before their sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid.array_types import Floats
from fmuid.data import Experiment, Parameter, ParameterSet, Preprocessing, preprocess
from fmuid.errors import InputError
from fmuid.simulation import Simulator
from fmuid.studies import Study
from tests.support.coil_study import COIL

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


def study(folder: Path, old: str = "", new: str = "") -> Study:
    text = f'[model]\nfmu = "{COIL.as_posix()}"\n'
    for name, (resistance, start) in RUNS.items():
        text += EXPERIMENT.format(name=name, start=start)
        table = {"time": STEP * np.arange(U.size), "u": U, "i": current(U, resistance, start)}
        pd.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    assert old in text + PARAMETERS
    (folder / "study.toml").write_text((text + PARAMETERS).replace(old, new))
    return Study.read(folder / "study.toml")


def test_values_and_groups(tmp_path: Path) -> None:
    found = study(tmp_path).identify()
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
        (GROUPS, '{ cold = ["run1", "run2"] }', "'run3' is in none"),
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
        study(tmp_path, old, new).problem()


def test_names_of_groups() -> None:
    given = {"a": Parameter(1.0, per_experiment={"x": ["one"], "y": ["two", "three"]}), "b": Parameter(1.0)}
    parameters = ParameterSet(given, ["one", "two", "three"])
    assert parameters.names == ("a[x]", "a[y]", "b")
    assert [parameters.for_experiment(k)[1].tolist() for k in range(3)] == [[0, 2], [1, 2], [1, 2]]
