"""What differs between experiments: values held, parameters of groups, inputs that hold before their sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid.apps.cli.options import WRONG_INPUT
from fmuid.array_types import Floats
from fmuid.data import Experiment, Parameter, ParameterSet, Preprocessing, preprocess
from fmuid.errors import InputError
from fmuid.simulation import Simulator
from fmuid.studies import Study
from tests.support.coil_study import COIL, fmuid_

STEP, L = 1e-3, 0.1
RESISTANCES = {"run1": 4.0, "run2": 4.0, "run3": 5.0}
STARTS = {"run1": 0.0, "run2": 0.5, "run3": 1.0}
TABLE = """
[[experiments]]
data = "{name}.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "{interpolation}"
[experiments.fixed]
i_start = {start}
"""
PARAMETERS = """
[parameters]
R = { start = 3.0, min = 0.0, per_experiment = { cold = ["run1", "run2"], warm = ["run3"] } }
L = { start = 0.15, min = 1e-4 }
"""


def current(u: Floats, R: float, start: float) -> Floats:
    """Return the current under a voltage u[k] held from sample k to the next, in closed form."""
    i, decay = np.full(u.size, start), np.exp(-R / L * STEP)
    for k in range(1, u.size):
        i[k] = u[k - 1] / R + (i[k - 1] - u[k - 1] / R) * decay
    return i


@pytest.fixture
def u() -> Floats:
    return np.asarray(np.repeat(np.random.default_rng(3).choice([0.0, 10.0], 15), 20))


def study(folder: Path, u: Floats, parameters: str = PARAMETERS, interpolation: str = "zoh") -> Study:
    text = f'[model]\nfmu = "{COIL.as_posix()}"\n'
    for name, start in STARTS.items():
        text += TABLE.format(name=name, start=start, interpolation=interpolation)
        table = {"time": STEP * np.arange(u.size), "u": u, "i": current(u, RESISTANCES[name], start)}
        pd.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    (folder / "study.toml").write_text(text + parameters)
    return Study.read(folder / "study.toml")


def test_values_and_groups(tmp_path: Path, u: Floats) -> None:
    found = study(tmp_path, u).identify()
    assert found.names == ("R[cold]", "R[warm]", "L")
    np.testing.assert_allclose(found.values, [4.0, 5.0, L], rtol=1e-4)


def test_the_experiment_s_values_go_before_the_model_s(u: Floats) -> None:
    frame = pd.DataFrame({"time": STEP * np.arange(u.size), "u": u})
    words = {"interpolation": "zoh", "measured": False}
    one = Experiment(frame, ["u"], ["i"], values={"i_start": 0.5}, **words)  # type: ignore[arg-type]
    other = Experiment(frame, ["u"], ["i"], values={"R": 5.0}, **words)  # type: ignore[arg-type]
    simulator = Simulator(COIL, one, values={"i_start": 2.0, "R": 4.0, "L": L})
    np.testing.assert_allclose(simulator([])[:, 0], current(u, 4.0, 0.5), atol=1e-4)
    np.testing.assert_allclose(simulator.over(other)([])[:, 0], current(u, 5.0, 2.0), atol=1e-4)


def test_hold_previous(u: Floats) -> None:
    """A recorder that notes the command of the step that ends: the same as one that notes it a sample earlier."""
    late = np.concatenate([u[:1], u[:-1]])
    frame = pd.DataFrame({"time": STEP * np.arange(u.size), "u": late, "i": current(u, 4.0, 0.0)})
    experiment = Experiment(frame, ["u"], ["i"], interpolation="zoh-next")
    assert experiment.held.tolist() == [True]
    np.testing.assert_array_equal(experiment.input_values[:-1, 0], u[:-1])
    simulated = Simulator(COIL, experiment, values={"R": 4.0, "L": L})([])
    np.testing.assert_allclose(simulated, experiment.output_values, atol=1e-4)
    mixed = Experiment(frame.assign(w=late), {"u": "u", "w": "w"}, ["i"], interpolation={"u": "zoh-next"})
    np.testing.assert_array_equal(mixed.input_values[:, 1], late)
    coarse = preprocess(experiment, Preprocessing(resample_interval=20 * STEP))
    np.testing.assert_array_equal(coarse.input_values[:-1, 0], u[:-20:20][: coarse.times.size - 1])


@pytest.mark.parametrize(
    ("groups", "said"),
    [
        ('{ cold = ["run1", "run2"] }', "the experiment 'run3' in none"),
        ('{ cold = ["run1", "run2"], warm = ["rum3"] }', r"'run3' in none \(did you mean"),
        (
            '{ cold = ["run1", "run2"], warm = ["run2", "run3"] }',
            "'run2' in cold and warm: name each in one",
        ),
        ('{ cold = "run1" }', r"per_experiment\] cold must be a list of names"),
        ('"cold"', "per_experiment must be"),
    ],
)
def test_wrong_groups(tmp_path: Path, u: Floats, groups: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = f"[parameters]\nR = {{ start = 3.0, per_experiment = {groups} }}\n"
    with pytest.raises(InputError, match=said):
        study(tmp_path, u, text).problem()
    assert fmuid_("simulate", tmp_path / "study.toml") == WRONG_INPUT
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("i_start = 0.5", "i_strt = 0.5", r"variable 'i_strt'|'i_strt'"),
        ("i_start = 0.5", 'i_start = "x"', "'i_start' is of type Real and cannot have the value 'x'"),
        ("i_start = 0.5", "L = 0.5", "'L' is both a parameter and fixed at a value"),
        ("i_start = 0.5", "u = 0.5", "'u' is an input"),
        ("i_start = 0.5", "i_start = [1]", r"'i_start' has 1 values and is one number in"),
        ("i_start = 0.5", "i_start = { a = 1 }", r"\[experiments.fixed\] i_start must be a number, true"),
        ('"zoh"', '"hold_previous"', "zoh-next"),
    ],
)
def test_wrong_values(tmp_path: Path, u: Floats, old: str, new: str, said: str) -> None:
    study(tmp_path, u)
    path = tmp_path / "study.toml"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=said):
        Study.read(path).problem()


def test_names_of_groups() -> None:
    given = {"a": Parameter(1.0, per_experiment={"x": ["one"], "y": ["two", "three"]}), "b": Parameter(1.0)}
    parameters = ParameterSet(given, ["one", "two", "three"])
    assert parameters.names == ("a[x]", "a[y]", "b")
    assert [parameters.for_experiment(k)[1].tolist() for k in range(3)] == [[0, 2], [1, 2], [1, 2]]
