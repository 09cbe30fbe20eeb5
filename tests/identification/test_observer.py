"""Observers that keep the simulation of a plant that integrates with its record."""

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import fmuid
from fmuid.identification import with_observer
from fmuid.identification.observer import observer_gain
from tests.support.exported import export_text

CART = """model Cart
  parameter Real m = 1;
  parameter Real d = 1;
  input Real u;
  output Real q(start=0, fixed=true);
  Real v(start=0, fixed=true);
equation
  der(q) = v;
  m*der(v) = u - d*v;
end Cart;
"""
M, D = 2.0, 3.0
TIMES = np.linspace(0.0, 6.0, 601)


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("cart"), CART)


@cache
def record(stiction: float) -> pd.DataFrame:
    """Return that of a cart, driven by bits, with a force of Stribeck's kind that the model has not."""
    force = np.random.default_rng(1).choice([-4.0, 4.0], 61)[np.minimum((TIMES / 0.1).astype(int), 60)]
    x, places = np.zeros(2), [0.0]
    for k in range(600):

        def slope(_t: float, x: np.ndarray, u: float = float(force[k])) -> list[float]:
            return [x[1], (u - D * x[1] - stiction * np.tanh(8.0 * x[1]) * np.exp(-(x[1] ** 2)) - 0.3 * stiction) / M]

        x = solve_ivp(slope, (0.0, 0.01), x, rtol=1e-8, atol=1e-10).y[:, -1]
        places.append(float(x[0]))
    return pd.DataFrame({"time": TIMES, "u": force, "q": places})


def problem(cart: Path, stiction: float) -> fmuid.Problem:
    given = fmuid.Experiment(record(stiction), ["u"], ["q"], interpolation="zoh")
    return fmuid.Problem(cart, given, {"m": fmuid.Parameter(1.0, min=0.1), "d": fmuid.Parameter(1.0, min=0.0)})


def test_all_poles_are_where_they_are_asked_for() -> None:
    for count in (1, 2, 3):
        slopes = np.diag(np.ones(count - 1), 1) - 0.5 * np.eye(count)
        output = np.eye(count)[0]
        gain = observer_gain(slopes, output, 0.1, 4.0)
        error = (np.eye(count) - np.outer(gain, output)) @ expm(0.1 * slopes)
        assert np.poly(error) == pytest.approx(np.poly(np.full(count, np.exp(-0.25))), abs=1e-9)
    with pytest.raises(fmuid.InputError, match=r"not all states .* observable"):
        observer_gain(np.diag([-1.0, -2.0]), np.array([1.0, 0.0]), 0.1, 3.0)


def test_an_error_of_the_model_pulls_output_error_more(cart: Path) -> None:
    """What integrates keeps a force that the model has not; the observer forgets it."""
    whole = problem(cart, 0.3)
    long = fmuid.identify(whole, restart=False)
    short = fmuid.identify(with_observer(problem(cart, 0.3)))
    assert abs(short["m"] - M) < 0.5 * abs(long["m"] - M)


def test_an_observer_is_for_one_output_of_one_model(cart: Path) -> None:
    whole = problem(cart, 0.0)
    frame = pd.DataFrame({"time": TIMES, "u": 1.0, "q": 0.0, "w": 0.0})
    two = fmuid.Experiment(frame, ["u"], {"q": "q", "v": "w"}, interpolation="zoh")
    several = fmuid.System(components={"a": fmuid.Component(cart), "b": fmuid.Component(cart)})
    driven = fmuid.Experiment(record(0.0), {"a.u": "u"}, {"a.q": "q"})
    for given, samples, said in (
        (fmuid.Problem(cart, two, {"m": fmuid.Parameter(1.0)}), 3.0, "one output"),
        (fmuid.Problem(several, driven, {"a.m": fmuid.Parameter(1.0)}), 3.0, "not all states"),
        (whole, 0.0, "positive memory in samples"),
        (whole._with(choices={"mode": (1, 2)}), 3.0, "'mode'"),
    ):
        with pytest.raises(fmuid.InputError, match=said):
            with_observer(given, samples)


STUDY = """
model.fmu = "{fmu}"
experiments = [{{ data = "table.csv", inputs = ["u"], outputs = {outputs}, interpolation = "zoh" }}]
parameters = {{ m = {{ start = 1.0, min = 0.1 }}, d = {{ start = 1.0, min = 0.0 }} }}
[estimation]
observer_memory = 5
{more}
"""


def study(folder: Path, fmu: Path, *, outputs: str = '["q"]', more: str = "") -> fmuid.Study:
    text = STUDY.format(fmu=fmu.as_posix(), outputs=outputs, more=more)
    return fmuid.Study.of(tomllib.loads(text), folder / "study.toml")


def test_a_study_is_told_what_an_observer_cannot(cart: Path, tmp_path: Path) -> None:
    record(0.0).assign(w=0.0).to_csv(tmp_path / "table.csv", index=False)
    with pytest.raises(fmuid.InputError, match=r"study.toml: estimation.observer_memory: .*one output"):
        study(tmp_path, cart, outputs='{ q = "q", v = "w" }').problem()
    for more, said in (
        ('jacobian = "forward"', r'jacobian = "forward" and observer_memory cannot be combined'),
        ('[batch]\ndata = "*.csv"', r"\[batch\] and estimation.observer_memory cannot be combined"),
    ):
        with pytest.raises(fmuid.InputError, match=said):
            study(tmp_path, cart, more=more)
