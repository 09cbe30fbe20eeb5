"""Sensitivities integrated with the model: against closed forms and against differences of whole simulations."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import fmuid
from fmuid import InputError, Numerics, Parameter, Problem, Simulator, System
from fmuid.array_types import Floats
from fmuid.errors import SensitivityUnavailableError
from fmuid.estimation import SensitivityMethod
from fmuid.simulation import derivatives_of
from fmuid.simulation.sensitivities import ForwardSensitivities
from tests.support.closed_forms import ball, coil_response
from tests.support.experiments import record
from tests.support.exported import export_text
from tests.support.hybrid import hybrid_fmu
from tests.support.modelica import FRICTION, friction
from tests.support.packing import changed
from tests.support.paths import FMUS
from tests.support.quick import first

COIL = FMUS / "Coil" / "Coil.fmu"
INTEGRATORS: dict[str, dict[str, Any]] = {
    "rk4": {"integrator": "rk4", "step_size": 1e-4},
    "rk45": {"integrator": "rk45", "tolerance": 1e-11},
    "cvode": {"integrator": "cvode", "tolerance": 1e-12},
}
every_integrator = pytest.mark.parametrize("name", first(2, reversed(INTEGRATORS)))
both_ways = pytest.mark.parametrize("hidden", [False, True], ids=["directional", "twins"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("forward")


def without_derivatives(path: Path, folder: Path) -> Path:
    return changed(path, folder, 'providesDirectionalDerivative="true"', "")


def forward(simulator: Simulator) -> ForwardSensitivities:
    found = derivatives_of(simulator, "forward")
    assert isinstance(found, ForwardSensitivities)
    return found


def model_exchange(path: Path, **numerics: Any) -> System:
    return System(path, numerics=Numerics("model-exchange", **numerics))


def differences(function: Callable[[Floats], Floats], theta: ArrayLike, step: float = 1e-3) -> Floats:
    """Return central differences, extrapolated once (error of fourth order), (N, ...)."""
    at = np.asarray(theta, float)
    rows = []
    for j, size in enumerate(np.where(at != 0, np.abs(at), 1.0)):
        move = np.eye(at.size)[j] * size
        wide, narrow = ((function(at + h * move) - function(at - h * move)) / (2 * h * size) for h in (step, step / 2))
        rows.append((4 * narrow - wide) / 3)
    return np.array(rows)


def worst(found: Floats, expected: Floats) -> float:
    """Return the largest error of any parameter's derivatives, of its largest derivative of that output."""
    axis = 1  # samples
    return float((np.abs(found - expected).max(axis) / np.abs(expected).max(axis)).max())


@pytest.fixture
def drawn() -> tuple[Floats, Floats]:
    """Irregular times with a step of the input (a time given twice), and the input."""
    rng = np.random.default_rng(11)
    times = 0.3 + np.cumsum(rng.uniform(1e-3, 9e-3, 80))
    times[50] = times[49]
    return times, rng.normal(size=80)


@both_ways
@every_integrator
@pytest.mark.parametrize("interpolation", first(1, ["linear", "zoh"]))
def test_coil_against_its_closed_form(
    name: str, hidden: bool, interpolation: str, drawn: tuple[Floats, Floats], folder: Path
) -> None:
    times, u = drawn
    experiment = record(times, {"u": u}, ["i"], interpolation, units={"i": "mA"})
    path = without_derivatives(COIL, folder) if hidden else COIL
    milli = '<Unit name="mA"><BaseUnit A="1" factor="0.001"/></Unit>'
    system = model_exchange(changed(path, folder, '<Unit name="A">', f'{milli}<Unit name="A">'), **INTEGRATORS[name])
    sensitivities = forward(Simulator(system, experiment, ["R", "L", "i_start"]))
    found = sensitivities(np.array([3.0, 0.05, 0.0]))

    def response(theta: Floats) -> Floats:
        R, L, start = theta
        free = start * np.exp(-R / L * (times - times[0]))
        current: Floats = coil_response(times, u, R, L, interpolation == "linear") + free
        return 1e3 * current[:, None]

    assert sensitivities.by_differences == hidden
    assert worst(found, differences(response, [3.0, 0.05, 0.0])) < 1e-6


TIMES = np.linspace(0.0, 2.3, 47)


def hybrid(folder: Path, model: str, version: int, name: str, parameters: list[str], *outputs: str) -> Simulator:
    settings = INTEGRATORS[name] | ({"step_size": 1e-3} if name == "rk4" else {})
    system = model_exchange(hybrid_fmu(folder, model, version), **settings)
    return Simulator(system, record(TIMES, {}, outputs), parameters)


both_versions = pytest.mark.parametrize("version", [2, 3])


def height(theta: Floats) -> Floats:
    """Return a ball's height (47, 1) from gravity, restitution and start height."""
    g, e, h = theta
    return np.array([[h * ball(t / np.sqrt(h), g, e)[0]] for t in TIMES])


def threshold(theta: Floats) -> Floats:
    """Return x' = -p0 down to p1, then p2 times as fast, (47, 1)."""
    a, b, c, start = theta
    late = (start - b) / a < TIMES
    return np.array(np.where(late, b - c * (a * TIMES - start + b), start - a * TIMES)[:, None])


def triangle(theta: Floats) -> Floats:
    """Return x' = 1, -1, 1, ... over p0 each, (47, 1)."""
    phase = TIMES / theta[0] % 2.0
    return np.array(theta[0] * np.minimum(phase, 2.0 - phase))[:, None]


EVENTS: dict[str, tuple[Callable[[Floats], Floats], dict[str, float]]] = {
    "ball": (height, {"p0": 9.81, "p1": 0.7, "start0": 1.0}),
    "threshold": (threshold, {"p0": 1.1, "p1": 0.3, "p2": 0.4, "start0": 1.0}),
    "triangle": (triangle, {"p0": 0.3137}),
}


@both_versions
@every_integrator
@pytest.mark.parametrize("model", EVENTS)
def test_through_events_against_closed_forms(folder: Path, model: str, version: int, name: str) -> None:
    """State events that reinitialize states, a threshold that is a parameter, time events whose times are one."""
    closed, values = EVENTS[model]
    found = forward(hybrid(folder, model, version, name, list(values), "x0"))(np.array(list(values.values())))
    assert worst(found, differences(closed, list(values.values()), 1e-6)) < 1e-6


@pytest.fixture(scope="module")
def exported(folder: Path) -> Callable[[str], Path]:
    made: dict[str, Path] = {}

    def make(text: str) -> Path:
        if text not in made:
            part = folder / f"model{len(made)}"
            part.mkdir()
            made[text] = export_text(part, text)
        return made[text]

    return make


@every_integrator
def test_an_event_that_changes_the_derivatives_is_left_to_twins(exported: Callable[[str], Path], name: str) -> None:
    times = np.linspace(0.0, 1.0, 34)
    experiment = record(times, {"F": -7.3}, ["x", "v"])
    simulator = Simulator(model_exchange(exported(FRICTION), **INTEGRATORS[name]), experiment, ["m", "Fc", "v_start"])
    sensitivities = forward(simulator)
    found = sensitivities(np.array([2.0, 3.0, 1.0]))

    def closed(theta: Floats) -> Floats:
        return np.array([friction(t, -7.3, *theta)[:2] for t in times])

    assert sensitivities.by_differences
    assert worst(found, differences(closed, [2.0, 3.0, 1.0], 1e-5)) < 1e-6


@both_versions
def test_directional_derivatives_that_are_refused_or_ignore_parameters_are_not_used(folder: Path, version: int) -> None:
    word = "providesDirectionalDerivative" + ("s" if version == 3 else "")
    for model, theta in (("van_der_pol", [2.0, 1.5]), ("linear", [2.0, 1.5])):
        path = hybrid_fmu(folder, model, version, f'{word}="true"')
        system = model_exchange(path, integrator="rk45", tolerance=1e-11)
        simulator = Simulator(system, record(TIMES, {}, ["x0"]), ["p0", "start0"])
        sensitivities = forward(simulator)
        found = sensitivities(np.array(theta))
        assert sensitivities.by_differences
        assert worst(found, differences(simulator, theta, 1e-4)) < 1e-6


def test_what_cannot_be_had_is_refused(folder: Path) -> None:
    ends, experiment = [0.0, 1.0], record([0.0, 1.0], {"u": 0.0}, ["i"])
    with pytest.raises(InputError, match=r'Coil.fmu: jacobian = "forward" needs Model Exchange. Set interface'):
        derivatives_of(Simulator(COIL, experiment, ["R"]), "forward")
    system = System(components={"a": COIL, "b": COIL}, numerics=Numerics("model-exchange"))
    with pytest.raises(InputError, match="needs a single FMU"):
        derivatives_of(Simulator(system, record(ends, {"a.u": 0.0}, ["a.i"]), ["a.R"]), "forward")
    once = hybrid_fmu(folder, "ball", 2, 'canBeInstantiatedOnlyOncePerProcess="true"')
    simulator = Simulator(model_exchange(once), record(ends, {}, ["x0"]), ["p0"])
    with pytest.raises(SensitivityUnavailableError, match=r"ball.*can be instantiated only once"):
        forward(simulator)(np.array([9.81]))
    switch = hybrid_fmu(folder, "switch", 2)  # an event of the input alone, in a model without states
    simulator = Simulator(model_exchange(switch), record(ends, {"u[1]": [0.0, 1.0]}, ["count"], "linear"), ["p0"])
    with pytest.raises(SensitivityUnavailableError, match="from t = 0 s on, sensitivities are undefined at an event"):
        forward(simulator)(np.array([0.5]))


def test_identification_equals_that_by_differences(folder: Path) -> None:
    """Also by sensitivities that the FMU outputs, from fewer simulations; the result says which served."""
    coil = export_text(folder, COIL.with_suffix(".mo").read_text(encoding="utf-8"), sensitivities=["R", "L"])
    rng, times = np.random.default_rng(8), np.linspace(0.0, 0.398, 200)
    u = np.array(rng.choice([-1.0, 1.0], 200))
    i = coil_response(times, u, 3.0, 0.05, True) + 1e-3 * rng.normal(size=200)
    noisy = record(times, {"u": u}, {"i": i}, "linear")
    system = model_exchange(coil, integrator="rk45", tolerance=1e-9)
    parameters = {"R": Parameter(start=4.0), "L": Parameter(start=0.1)}
    found = [fmuid.identify(Problem(system, noisy, parameters, sensitivity=word)) for word in METHODS]
    for each in found[1:]:
        assert each.values == pytest.approx(found[0].values, rel=1e-6)
        assert each.std == pytest.approx(found[0].std, rel=1e-4)
    assert found[2].history.simulations < found[0].history.simulations
    assert [each.setup.sensitivity for each in found] == [SensitivityMethod(word) for word in METHODS]


METHODS = ("finite-difference", "forward", "fmu")


def test_missing_sensitivities_are_one_sentence() -> None:
    experiment = record(np.arange(5.0), {"u": 0.0}, ["i"])
    with pytest.raises(InputError, match=r"output 'sens\.R\.i'.*--sensitivities"):
        Problem(COIL, experiment, {"R": Parameter(start=4.0)}, sensitivity="fmu")
    with pytest.raises(InputError, match=r"sensitivity: unknown value 'forwards'.*'forward'"):
        Problem(COIL, experiment, {"R": Parameter(start=4.0)}, sensitivity="forwards")
    system = System(components={"a": COIL, "b": COIL})
    coupled = record(np.arange(5.0), {}, ["a.i"])
    with pytest.raises(InputError, match="needs a single FMU"):
        Problem(system, coupled, {"a.R": Parameter(start=4.0)}, sensitivity="fmu")
