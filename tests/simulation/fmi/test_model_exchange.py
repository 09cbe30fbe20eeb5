"""Model exchange through the master loop: inputs of every kind against closed forms and scipy, couplings, rates."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

from fmuid import Component, InputError, Numerics, SimulationError, Simulator, System
from fmuid.reports.topics.solver_check import run_words
from tests.support.closed_forms import coil_response, park_rates
from tests.support.compiled import ProbeMaker
from tests.support.experiments import record
from tests.support.exported import export_text
from tests.support.paths import FMUS

COIL = FMUS / "Coil" / "Coil.fmu"
Array = NDArray[np.float64]

INTEGRATORS: dict[str, dict[str, Any]] = {
    "rk4": {"integrator": "rk4", "step_size": 5e-5},
    "rk45": {"integrator": "rk45", "tolerance": 1e-11},
    "cvode": {"integrator": "cvode", "tolerance": 1e-11},
}


@pytest.fixture
def drawn() -> tuple[Array, Array]:
    """Irregular times with a step of the input (a time given twice), and the input."""
    rng = np.random.default_rng(3)
    times = 0.3 + np.cumsum(rng.uniform(1e-4, 2e-3, 300))
    times[200] = times[199]
    return times, rng.normal(size=300)


@pytest.fixture(scope="module")
def coil3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("coil3"), COIL.with_suffix(".mo").read_text(encoding="utf-8"), fmi="3.0")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", [*INTEGRATORS, "co-simulation"])
@pytest.mark.parametrize("interpolation", ["zoh", "linear"])
def test_coil_equals_its_closed_form(
    version: int, name: str, interpolation: str, drawn: tuple[Array, Array], coil3: Path
) -> None:
    times, u = drawn
    given = {"interface": "model-exchange", **INTEGRATORS[name]} if name in INTEGRATORS else {"interface": name}
    path = COIL if version == 2 else coil3
    simulator = Simulator(path, record(times, {"u": u}, ["i"], interpolation), ["R", "L"], **given)
    got = simulator([[3.0, 0.05], [4.0, 0.1], [3.0, 0.05]])
    expected = coil_response(times, u, 3.0, 0.05, interpolation == "linear")
    # co-simulation of FMI 3.0 has no input slopes: ten substeps an interval hold the values at their middles
    tolerance = 5e-4 if (version, name, interpolation) == (3, "co-simulation", "linear") else 2e-8
    assert np.abs(got[0, :, 0] - expected).max() < tolerance * np.abs(expected).max()
    assert np.abs(got[2] - got[0]).max() < 1e-9 * np.abs(expected).max()  # whatever was simulated in between


def test_versions_and_kinds_mix(coil3: Path) -> None:
    """Current of a coil of FMI 3.0 as the voltage of one of FMI 2.0, against the product of their time constants."""
    times = np.linspace(0.0, 0.2, 41)
    T = 0.1 / 4.0
    expected = (1.0 - np.exp(-times / T) * (1.0 + times / T)) / 16.0
    for first, second in (("co-simulation", "model-exchange"), ("model-exchange", "co-simulation")):
        system = System(
            components={"one": Component(coil3, Numerics(first)), "two": Component(COIL, Numerics(second))},
            connections=[("one.i", "two.u", 1.0, 0.0)],
            numerics=Numerics(step_size=1e-5),
        )
        got = Simulator(system, record(times, {"one.u": 1.0}, ["two.i"], "linear"))([])[:, 0]
        assert np.abs(got - expected).max() < 3e-4 * expected.max()  # values held over 10 us, of 25 ms: first order


def curved_response(times: Array, u: Array, R: float, L: float) -> Array:
    """L di/dt = u - R i with u a monotone cubic curve, which does not go across a step."""
    i = [0.0]
    parts = np.split(np.arange(times.size), np.flatnonzero(np.diff(times) == 0) + 1)
    for part in parts:
        curve = PchipInterpolator(times[part], u[part])
        if part[0] > 0:
            i.append(i[-1])
        for a, b in zip(times[part][:-1], times[part][1:], strict=True):

            def slope(t: float, x: Array, curve: PchipInterpolator = curve) -> Array:
                return np.asarray((curve(t) - R * x) / L)

            i.append(solve_ivp(slope, (a, b), [i[-1]], "DOP853", rtol=1e-12, atol=1e-14).y[0, -1])
    return np.array(i)


def test_cubic_inputs(drawn: tuple[Array, Array]) -> None:
    times, u = drawn
    experiment = record(times, {"u": u}, ["i"], "pchip")
    got = Simulator(COIL, experiment, interface="model-exchange", **INTEGRATORS["rk45"])([])[:, 0]
    expected = curved_response(times, u, 4.0, 0.1)
    assert np.abs(got - expected).max() < 2e-8 * np.abs(expected).max()


def test_interpolation_is_chosen_for_each_input() -> None:
    """One record under three machines' inputs: what is held, straight and curved stays so beside the others."""
    times = np.linspace(0.0, 0.02, 30)
    rng = np.random.default_rng(5)
    uds, uqs, w = (values * rng.normal(size=30) for values in (100.0, 100.0, 10.0))
    words = {"uds": "zoh", "uqs": "pchip", "w": "linear"}
    experiment = record(times, {"uds": uds, "uqs": uqs, "w": 150 + w}, ["ids", "iqs"], words)
    path = FMUS / "InductionMachine" / "InductionMachine.fmu"
    got = Simulator(path, experiment, interface="model-exchange", integrator="rk45", tolerance=1e-11)([])
    declared = System(path).variables
    theta = [float(declared[name].start) for name in ("Rs", "Rr", "Lm", "Lf")]  # type: ignore[arg-type]
    curve = PchipInterpolator(times, uqs)
    x, expected = np.zeros(4), [[0.0, 0.0]]
    for k in range(29):

        def slope(t: float, x: Array, k: int = k) -> list[float]:
            return park_rates(x, [uds[k], float(curve(t)), np.interp(t, times, 150 + w)], theta)

        x = solve_ivp(slope, times[k : k + 2].tolist(), x, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        expected.append([x[0], x[1]])
    assert np.abs(got - expected).max() < 1e-7 * np.abs(expected).max()


def test_gauss_seidel_passes_on_what_was_just_reached(probe: ProbeMaker) -> None:
    """x_a' = 1, x_b' = x_a in steps of 1 s: Jacobi sums the values at their beginnings, Gauss-Seidel at their ends."""
    path = probe()
    experiment = record(np.arange(5.0), {}, ["b.x"])
    parts: dict[str, Any] = {"components": {"a": path, "b": path}, "connections": [("a.z", "b.u", 1.0, 0.0)]}
    found = {}
    for master in ("jacobi", "gauss-seidel"):
        found[master] = Simulator(System(**parts, master=master), experiment, values={"a.u": 1.0})([])[:, 0].tolist()
    assert found == {"jacobi": [0.0, 0.0, 1.0, 3.0, 6.0], "gauss-seidel": [0.0, 1.0, 3.0, 6.0, 10.0]}
    with pytest.raises(InputError, match=r"master: unknown value 'gauss'.*gauss-seidel"):
        System(**parts, master="gauss")


def test_components_with_steps_of_their_own(probe: ProbeMaker) -> None:
    """b steps every 0.4 s with what a had at the beginning of the step, a every 0.1 s; both meet at samples."""
    path = probe()
    system = System(
        components={"a": Component(path, Numerics(step_size=0.1)), "b": Component(path, Numerics(step_size=0.4))},
        connections=[("a.z", "b.u", 1.0, 0.0)],
    )
    got = Simulator(system, record([0.0, 1.0, 2.0], {}, ["b.x", "a.x"]), values={"a.u": 1.0})([])
    # a = t; b holds a(0), a(0.4), a(0.8) over steps of 0.4, 0.4 and 0.2 s, and again from 1 s on
    one = 0.4 * 0.0 + 0.4 * 0.4 + 0.2 * 0.8
    two = one + 0.4 * 1.0 + 0.4 * 1.4 + 0.2 * 1.8
    assert got[:, 1] == pytest.approx([0.0, 1.0, 2.0])
    assert got[:, 0] == pytest.approx([0.0, one, two])


@pytest.mark.parametrize("way", ["DISCARDS=1", "DISCARDS=2"])
def test_discarded_steps_are_shortened(probe: ProbeMaker, way: str) -> None:
    """The probe built so takes 0.3 s at most, of a longer step that much or nothing: x' = u, u held."""
    experiment = record(np.arange(4.0), {"u": 2.0}, ["x"])
    assert Simulator(probe(way), experiment)([])[:, 0] == pytest.approx([0.0, 2.0, 4.0, 6.0])
    with pytest.raises(SimulationError, match="the FMU ended the simulation"):
        Simulator(probe(way, "ENDS"), experiment)([])


def test_a_stiff_model_is_integrated_as_such() -> None:
    """R/L = 4e8/s: the default integrator finds it stiff, and the simulation goes on with CVODE; by name it refuses."""
    times = np.linspace(0.0, 1.0, 11)
    experiment = record(times, {"u": np.cos(times)}, ["i"], "linear")
    simulator = Simulator(COIL, experiment, values={"L": 1e-8}, interface="model-exchange")
    assert simulator([])[1:, 0] == pytest.approx(np.cos(times[1:]) / 4.0, rel=1e-5)
    assert simulator.stiff == {""}
    assert "cvode (rk45 found the model stiff)" in run_words(simulator.system.components[""].how_run(stiff=True))
    mild = Simulator(simulator.system, experiment, values={"L": 0.1})
    mild([])
    assert not mild.stiff
    named = Simulator(COIL, experiment, values={"L": 1e-8}, interface="model-exchange", integrator="rk45")
    with pytest.raises(SimulationError, match=r"stiff.*solver = \"cvode\""):
        named([])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ({"interface": "modelexchange"}, r"interface: unknown value 'modelexchange'.*model-exchange"),
        ({"integrator": "euler"}, r"integrator: unknown value 'euler'.*rk4 or rk45 or cvode"),
        ({"integrator": "rk4"}, r"probe.*\.fmu: solver = .* needs interface = \"model-exchange\""),
        ({"interface": "model-exchange"}, r"no model-exchange interface; offered: co-simulation"),
        ({"tolerance": -1.0}, "tolerance must be a positive number"),
        ({"step_size": 0.0}, "must be a positive number of seconds"),
    ],
)
def test_wrong_numerics_are_one_sentence(probe: ProbeMaker, words: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        System(probe(), numerics=Numerics(**words))
    with pytest.raises(InputError, match="a System has its own solver settings"):
        System.of(System(COIL), Numerics(tolerance=1e-3))


def test_a_connector_sets_several_variables(drawn: tuple[Array, Array]) -> None:
    """One R and one voltage for two coils: twice the current of one, whose resistance is half the parameter."""
    times, u = drawn
    system = System(
        components={"one": COIL, "other": COIL},
        connectors={
            "R": [("one.R", 0.5, 0.0), ("other.R", 0.5, 0.0)],
            "u": [("one.u", 1.0, 0.0), ("other.u", 1.0, 0.0)],
        },
    )
    simulator = Simulator(system, record(times, {"u": u}, ["one.i + other.i"]), ["R"])
    got = simulator([[6.0], [8.0]])[..., 0]
    assert simulator.unfed_inputs == ()
    for found, R in zip(got, (3.0, 4.0), strict=True):
        assert np.abs(found - 2.0 * coil_response(times, u, R, 0.1, False)).max() < 1e-8
    held = Simulator(system, simulator.experiment, values={"R": 6.0})([])[:, 0]
    assert np.abs(held - got[0]).max() == 0.0


@pytest.mark.parametrize(
    ("connectors", "sentence"),
    [
        ({"R": ["one.R", "one.u"]}, r"'R' joins 'one\.R' \(parameter, Real\) and 'one\.u' \(input, Real\)"),
        ({"R": ["one.Q"]}, r"no variable behind 'R' 'one\.Q'"),
        ({"one": ["one.R"]}, "named like a component"),
        ({"i": ["one.i", "other.i"]}, "joins several outputs"),
        ({"u": ["other.u"]}, r"sets 'other\.u', which a connection feeds"),
    ],
)
def test_wrong_connectors_are_one_sentence(connectors: dict[str, list[str]], sentence: str) -> None:
    ports = {name: [(each, 1.0, 0.0) for each in some] for name, some in connectors.items()}
    with pytest.raises(InputError, match=sentence):
        System(components={"one": COIL, "other": COIL}, connections=[("one.i", "other.u", 1.0, 0.0)], connectors=ports)
