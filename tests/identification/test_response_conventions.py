"""Conventions of readings: signs and units that the data show, and nothing where they are right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import fmuid
from fmuid.data import FrequencyExperiment, Response, RotatingFrame, SteadyExperiment
from fmuid.estimation import Grade, Reason
from fmuid.identification import DefectKind, find_data_defects, judge
from tests.support.exported import export_text
from tests.support.paths import FMUS
from tests.support.resting import MACHINE, three_tests

COIL = fmuid.datasets.coil().fmu
FREE = {"R": fmuid.Parameter(1.0, min=0.01), "L": fmuid.Parameter(1.0, min=1e-4)}
POLAR, COMPLEX = {"magnitude": "size", "phase": "angle"}, {"real": "re", "imaginary": "im"}


def spectrum(response: Response, kind: DefectKind | None = None) -> FrequencyExperiment:
    """Return a coil's spectrum of 4 Ohm and 0.1 H, saved by another convention."""
    random, frequencies = np.random.default_rng(2), np.logspace(-1.0, 3.0, 30)
    noise = 0.003 * (random.normal(size=30) + 1j * random.normal(size=30))
    values = (4.0 + 0.2j * np.pi * frequencies) * (1.0 + noise) * (-1.0 if kind is DefectKind.SIGN else 1.0)
    values = np.conj(values) if kind is DefectKind.CONJUGATE else values
    angle = np.angle(values) if kind is DefectKind.RADIANS else np.degrees(np.angle(values))
    table = {"f": frequencies, "re": values.real, "im": values.imag, "size": np.abs(values), "angle": angle}
    return FrequencyExperiment(pd.DataFrame(table), frequency="f", responses={"Z": response}, name="spectrum")


@pytest.mark.parametrize(
    ("kind", "parts"),
    [
        (DefectKind.RADIANS, POLAR),
        pytest.param(DefectKind.CONJUGATE, POLAR, marks=pytest.mark.slow),
        (DefectKind.CONJUGATE, COMPLEX),
        (DefectKind.SIGN, POLAR),
        pytest.param(DefectKind.SIGN, COMPLEX, marks=pytest.mark.slow),
    ],
)
def test_another_convention_is_named(kind: DefectKind, parts: dict[str, str]) -> None:
    problem = fmuid.Problem(COIL, spectrum(Response("u / i", **parts), kind), FREE)  # type: ignore[arg-type]
    result = fmuid.identify(problem)
    found = [each for each in find_data_defects(problem, result) if each.kind.explains_misfit]
    assert [(each.kind, each.output, each.experiment) for each in found][:1] == [(kind, "Z", "spectrum")]
    assert found[0].values["fit"] > 99.0
    verdict = judge(result, fmuid.assess(problem, result))
    assert (verdict.grade, verdict.reasons[0]) == (Grade.NOT_USABLE, Reason.CONVENTION)


@pytest.mark.parametrize(
    ("said", "column", "kind"),
    [
        ("voltage", "U", None),
        ("voltage", "UL", DefectKind.LINE_VOLTAGE),
        ("line_voltage", "UL", None),
        ("line_voltage", "U", DefectKind.PHASE_VOLTAGE),
    ],
)
def test_voltages_between_lines_are_named(said: str, column: str, kind: DefectKind | None) -> None:
    phase, line = (column, None) if said == "voltage" else (None, column)
    supply = RotatingFrame(50.0, phase, line, "s")
    experiment = SteadyExperiment(three_tests(), outputs={"I_rms": "I", "P": "P"}, supply=supply, name="tests")
    free = {name: fmuid.Parameter(1.3 * value, min=0.1 * value, max=10.0 * value) for name, value in MACHINE.items()}
    problem = fmuid.Problem(FMUS / "InductionMachine/InductionMachine.fmu", experiment, free)
    found = [each for each in find_data_defects(problem, fmuid.identify(problem)) if each.kind.explains_misfit]
    assert [each.kind for each in found] == ([] if kind is None else [kind])


@pytest.mark.parametrize("parts", [POLAR, COMPLEX, {"magnitude": "size"}])
def test_the_right_convention_is_not_doubted(parts: dict[str, str]) -> None:
    problem = fmuid.Problem(COIL, spectrum(Response("u / i", **parts)), FREE)  # type: ignore[arg-type]
    found = find_data_defects(problem, fmuid.identify(problem))
    assert not [each for each in found if each.kind.explains_misfit]


def test_a_model_that_fits_by_no_convention_is_not_excused() -> None:
    """An admittance that is read as an impedance."""
    experiment = replace(spectrum(Response("i / u", real="re", imaginary="im")), outputs=())
    problem = fmuid.Problem(COIL, experiment, FREE)
    result = fmuid.identify(problem)
    assert not [each for each in find_data_defects(problem, result) if each.kind.explains_misfit]


MOTOR = """model Motor
  parameter Real R = 1.7; parameter Real L = 0.011; parameter Real k = 0.35; parameter Real J = 6e-4;
  input Real u; input Real load; output Real i(start=0, fixed=true); output Real w(start=0, fixed=true);
equation
  L*der(i) = u - R*i - k*w;
  J*der(w) = k*i - 1e-3*w - load;
end Motor;"""


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("motor"), MOTOR)


@pytest.mark.parametrize(
    "signal", ["i", "u", *(pytest.param(x, marks=pytest.mark.slow) for x in ("w", "u, load or i, w", ""))]
)
def test_a_signal_with_the_wrong_sign_is_named(motor: Path, signal: str) -> None:
    """A DC motor by exact steps: a current that counts against its arrow is none that the motor takes."""
    random, step = np.random.default_rng(4), 2e-3
    voltage, load = np.repeat(random.uniform(-12.0, 12.0, 20), 25), np.repeat(random.uniform(-0.5, 0.5, 50), 10)
    rates = np.zeros((4, 4))
    rates[0, :3] = np.array([-1.2, -0.25, 1.0]) / 8e-3
    rates[1] = np.array([0.25, -1e-3, 0.0, -1.0]) / 4e-4
    ahead, states = expm(rates * step), np.zeros((len(voltage), 2))
    for n in range(len(voltage) - 1):
        states[n + 1] = ahead[:2] @ [*states[n], voltage[n], load[n]]
    i, w = (states + [0.03, 0.3] * random.standard_normal(states.shape)).T
    frame = pd.DataFrame({"time": step * np.arange(len(voltage)), "u": voltage, "load": load, "i": i, "w": w})
    frame[[each for each in signal.partition(" or ")[0].split(", ") if each]] *= -1.0
    experiment = fmuid.Experiment(frame, ["u", "load"], ["i", "w"], interpolation="zoh", name="motor")
    starts = {"R": 1.7, "L": 0.011, "k": 0.35, "J": 6e-4}
    problem = fmuid.Problem(motor, experiment, {name: fmuid.Parameter(each, min=0.0) for name, each in starts.items()})
    result = fmuid.identify(problem)
    found = [each for each in find_data_defects(problem, result) if each.kind.explains_misfit]
    assert [(each.kind, each.output) for each in found] == ([(DefectKind.SIGN, signal)] if signal else [])
    verdict = judge(result, fmuid.assess(problem, result))
    assert (Reason.CONVENTION in verdict.reasons) is bool(signal)
    assert result.history.simulations < 1000, "other starting points wait for the right sign"
