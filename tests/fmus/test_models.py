"""The exported machine models against their equations, written here anew and integrated by scipy.

`Reference` knows nothing of the FMUs: plain formulas of docs/method.md section 8 and of the models' README files. The
FMUs run through FMPy's low-level calls (its `simulate_fmu` does not apply inputs inside an integrator).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi1
import fmpy.fmi2
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fmuid.data.transforms import T23, park
from tests.support.closed_forms import park_rates
from tests.support.paths import FMUS

Array = npt.NDArray[Any]
TOLERANCE = 1e-7  # of the largest value of each signal: an integration error is a parameter bias

# ---- the reference


@dataclass(frozen=True)
class Reference:
    """``dx/dt = rates(x, u, p)``, ``y = outputs(x, u, p)``; also for complex arguments (complex-step derivatives)."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: dict[str, float]  # not the defaults, nothing zero
    rates: Callable[..., Any]
    evaluate: Callable[..., Any]
    amplitudes: tuple[float, ...]  # of the inputs, around the means
    step: float  # s, sampling
    means: tuple[float, ...] = ()

    def integrate(self, times: Array, inputs: Array, linear: bool) -> Array:
        """Outputs at the times; inputs linear or held between them."""
        p = self.parameters
        x = np.array([p[f"{name}_start"] for name in self.states])
        rows = [self.evaluate(x, inputs[0], p)]
        for k in range(len(times) - 1):
            h = times[k + 1] - times[k]
            slope = (inputs[k + 1] - inputs[k]) / h * linear

            def rates(t: float, x: Array, u: Array = inputs[k], slope: Array = slope) -> Any:
                return self.rates(x, u + slope * t, p)

            if len(x):
                x = solve_ivp(rates, (0, h), x, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
            rows.append(self.evaluate(x, inputs[k + 1], p))  # what follows an input at once follows its new value
        return np.array(rows)

    def signals(self, count: int = 150) -> tuple[Array, Array]:
        """Irregular times and random inputs."""
        rng = np.random.default_rng(2)
        times = np.concatenate([[0.0], np.cumsum(self.step * rng.uniform(0.5, 1.0, count))])
        values = rng.uniform(-1, 1, (count + 1, len(self.inputs))) * np.array(self.amplitudes)
        return times, values + np.array(self.means or 0.0)


def first(x: Any, *_: Any) -> Any:
    return np.array(x)


def coil(x: Any, u: Any, p: Any) -> Any:
    return np.array([(u[0] - p["R"] * x[0]) / p["L"]])


def park_machine(x: Any, u: Any, p: Any) -> Any:
    """docs/method.md section 8, the state equations in Park axes linked to the rotor."""
    return np.array(park_rates(x, u, [p[name] for name in ("Rs", "Rr", "Lm", "Lf")]))


def faulty_coil(x: Any, u: Any, p: Any) -> Any:
    """R and L of the healthy coil, and dR (1 + 2 tau s) in series: resistance and inductance add up."""
    resistance, inductance = p["R"] + p["dR"], p["L"] + 2 * p["tau"] * p["dR"]
    return np.array([(u[0] - resistance * x[0]) / inductance])


def towards(angle: Any) -> Any:
    """Q of docs/method.md section 11."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c**2, c * s], [c * s, s**2]])


def short_circuit(_: Any, u: Any, p: Any) -> Any:
    """The sum over phases as it stands in docs/method.md section 11."""
    there, back = rotation(u[2]), rotation(-u[2])
    ratios = zip("abc", (0, 2 * np.pi / 3, 4 * np.pi / 3), strict=True)
    return sum(2 / 3 * p[f"eta_{phase}"] / p["Rs"] * back @ towards(angle) @ there @ u[:2] for phase, angle in ratios)


def broken_bars(x: Any, u: Any, p: Any) -> Any:
    """u = Rs i + dψ/dt + w J ψ with ψ = Lf i + φ, dφ/dt = R_eq (i - φ/Lm)."""
    alpha, turn = 2 / 3 * p["eta0"], np.array([[0, -1], [1, 0]])
    resistance = p["Rr"] * (np.eye(2) + alpha / (1 - alpha) * towards(p["theta0"]))
    currents, phi = x[:2], x[2:]
    rates = resistance @ (currents - phi / p["Lm"])
    whole = u[:2] - p["Rs"] * currents - u[2] * turn @ (p["Lf"] * currents + phi)
    return np.concatenate([(whole - rates) / p["Lf"], rates])


def rotation(theta: Any) -> Any:
    return np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])


def phase_matrices(theta: Any, p: Any) -> tuple[Any, Any, Any, Any]:
    """L_s, M_sr, dM_sr/dθ and L_r of (1.58)."""
    Lp, turn, eye = 2 / 3 * p["Lm"], 2 * np.pi / 3, np.eye(3)
    Lr = Lp * (1.5 * eye - 0.5)
    angles = np.array([[0, turn, -turn], [-turn, 0, turn], [turn, -turn, 0]])
    return Lr + p["Lf"] * eye, Lp * np.cos(theta + angles), -Lp * np.sin(theta + angles), Lr


def three_phase(x: Any, u: Any, p: Any) -> Any:
    """(1.58) as it stands, solved for the derivatives of all six currents; the rotor's have no zero sequence.

    The fluxes phi_dqr of the state give the rotor currents; the derivatives of the currents give those of phi_dqr.
    """
    currents, theta, phi, w = x[:3], x[3], x[4:], u[3]
    Ls, M, dM, Lr = phase_matrices(theta, p)
    J = T23.T  # rotor currents of two axes -> of three phases
    rotor = np.linalg.solve(T23 @ Lr @ J, phi - T23 @ M.T @ currents)
    whole = np.block([[Ls, M @ J], [T23 @ M.T, T23 @ Lr @ J]])
    right = np.concatenate(
        [
            u[:3] - p["Rs"] * currents - w * dM @ J @ rotor,
            -p["Rr"] * rotor - w * T23 @ dM.T @ currents,
        ]
    )
    derivatives = np.linalg.solve(whole, right)
    return np.concatenate([derivatives[:3], [w], -p["Rr"] * rotor])


def phases_and_torque(x: Any, _: Any, p: Any) -> Any:
    """The states, and the torque as derivative of the co-energy by the angle: p i_sᵀ (dM_sr/dθ) i_r."""
    _, M, dM, Lr = phase_matrices(x[3], p)
    J = T23.T
    rotor = np.linalg.solve(T23 @ Lr @ J, x[4:] - T23 @ M.T @ x[:3])
    return np.array([*x, p["p"] * x[:3] @ dM @ J @ rotor])


def limited(value: Any, most: float) -> Any:
    return value if abs(value.real) < most else most * np.sign(value.real)


def speed_controller(x: Any, u: Any, p: Any) -> Any:
    halfway, smooth, integral = x
    proportional = p["K"] * (smooth - u[1])
    cut = limited(proportional + integral, p["torque_max"]) - (proportional + integral)
    return np.array([(u[0] - halfway) / p["Tr"], (halfway - smooth) / p["Tr"], (proportional + cut) / p["Ti"]])


def speed_control(x: Any, u: Any, p: Any) -> Any:
    return np.array([limited(p["K"] * (x[1] - u[1]) + x[2], p["torque_max"])])


def vector_control(x: Any, u: Any, p: Any) -> tuple[Any, Any]:
    """Rates of the states and limited voltage in the axes of the rotor; flux axes: along and across the flux."""
    torque, *phase_currents, theta, w = u
    current = rotation(-theta) @ T23 @ np.array(phase_currents)
    flux = (x[0] ** 2 + x[1] ** 2) ** 0.5
    axes = np.array([[x[0], -x[1]], [x[1], x[0]]]) / flux  # from flux axes to those of the rotor
    along, across = axes.T @ current
    error = np.array([x[2] - along, torque / (p["p"] * p["flux_reference"]) - across])
    turning = w + p["Rr"] * across / (flux if flux.real > p["flux_reference"] / 2 else p["flux_reference"] / 2)
    induced = turning * np.array([-p["Lf"] * across, p["Lf"] * along + flux])
    voltage = p["Lf"] / p["T"] * error + x[3:] + induced
    size = (voltage @ voltage) ** 0.5
    reached = voltage if size.real < p["u_max"] else voltage * p["u_max"] / size
    wanted = p["flux_reference"] / p["Lm"] + p["gain"] * (p["flux_reference"] - flux)
    magnetising = ((p["i_max"] if wanted.real > p["i_max"] else wanted) - x[2]) / p["Tf"]
    integrals = ((p["Rs"] + p["Rr"]) * error + reached - voltage) / p["T"]
    return np.array([*(p["Rr"] * (current - x[:2] / p["Lm"])), magnetising, *integrals]), axes @ reached


def current_controller(x: Any, u: Any, p: Any) -> Any:
    return vector_control(x, u, p)[0]


def current_control(x: Any, u: Any, p: Any) -> Any:
    return vector_control(x, u, p)[1]


def coil_controller(_: Any, u: Any, p: Any) -> Any:
    return np.array([p["K"] / p["Ti"] * (u[0] - u[1])])


def coil_control(x: Any, u: Any, p: Any) -> Any:
    return p["K"] * (u[0] - u[1]) + x


def sensor(_: Any, u: Any, p: Any) -> Any:
    return np.array([p["gain"] * u[0] + u[1]])


def inverter(x: Any, u: Any, p: Any) -> Any:
    return (u[:2] - x) / p["T"]


def modulated(x: Any, u: Any, p: Any) -> Any:
    """Phases in the middle of the period, and the states."""
    half = p["period"] / 2
    return np.concatenate([T23.T @ rotation(u[2] + half * u[3]) @ (x + half * inverter(x, u, p)), x])


def shaft(x: Any, u: Any, p: Any) -> Any:
    return np.array([(u[0] - p["f"] * x[0]) / p["J"], x[0]])


def shaft_speeds(x: Any, u: Any, p: Any) -> Any:
    return np.array([*x, p["p"] * (x[0] + p["period"] / 2 * shaft(x, u, p)[0])])


def drive(x: Any, u: Any, p: Any) -> Any:
    friction = p["Fv"] * x[1] + p["Fc"] * np.tanh(x[1] / p["dq_eps"]) + p["offset"]
    return np.array([x[1], (p["gtau"] * u[0] - friction) / p["M"]])


def nothing(*_: Any) -> Any:
    return np.zeros(0)


def controller(_: Any, u: Any, p: Any) -> Any:
    qg, q, dq = u
    v = p["kv"] * (p["kp"] * (qg - q) - dq)
    return np.array([v if abs(v) < p["v_max"] else p["v_max"] * np.sign(v.real)])


MACHINE = {"Rs": 8.5, "Rr": 4.4, "Lm": 0.39, "Lf": 0.081}
PHASES = {"p": 3.0, "ia_start": 1.1, "ib_start": 0.3, "ic_start": -0.8, "theta_start": 0.7}
FLUXES = {"phidr_start": 0.6, "phiqr_start": -0.4}
SPEED = {"K": 0.8, "Ti": 0.1, "Tr": 0.006, "torque_max": 60.0}
SPEED_STARTS = {"halfway_start": 76.0, "smooth_start": 75.0, "integral_start": 3.0}
CURRENT = {
    "Rs": 9.0,
    "Rr": 4.2,
    "Lm": 0.41,
    "Lf": 0.08,
    "p": 3.0,
    "flux_reference": 0.5,
    "gain": 12.0,
    "T": 0.004,
    "Tf": 0.012,
}
CURRENT_LIMITS = {"i_max": 30.0, "u_max": 2000.0}  # never reached: a bend is integrated less precisely than 1e-7
CURRENT_STARTS = {"phid_start": 0.6, "phiq_start": -0.4, "wanted_start": 1.4, "vf_start": 20.0, "vt_start": -30.0}
DRIVE = {"M": 88.0, "Fv": 230.0, "Fc": 23.0, "offset": -4.0, "gtau": 33.0, "dq_eps": 1.2e-3}
REFERENCES = {
    "Coil": Reference(("i",), ("u",), ("i",), {"R": 3.3, "L": 0.08, "i_start": -0.4}, coil, first, (1.0,), 1e-3),
    "FaultyCoil": Reference(
        ("i",),
        ("u",),
        ("i",),
        {"R": 3.3, "L": 0.08, "dR": 0.7, "tau": 0.021, "i_start": -0.4},
        faulty_coil,
        first,
        (1.0,),
        1e-3,
    ),
    "InductionMachine": Reference(
        ("ids", "iqs", "phidr", "phiqr"),
        ("uds", "uqs", "w"),
        ("ids", "iqs", "phidr", "phiqr"),
        MACHINE | {"ids_start": 1.2, "iqs_start": -0.7} | FLUXES,
        park_machine,
        first,
        (300.0, 300.0, 10.0),
        7e-4,
        (0.0, 0.0, 157.0),
    ),
    "InductionMachineRotorFault": Reference(
        ("ids", "iqs", "phidr", "phiqr"),
        ("uds", "uqs", "w"),
        ("ids", "iqs", "phidr", "phiqr"),
        MACHINE | {"eta0": 0.3, "theta0": 0.7, "ids_start": 1.2, "iqs_start": -0.7} | FLUXES,
        broken_bars,
        first,
        (300.0, 300.0, 10.0),
        7e-4,
        (0.0, 0.0, 157.0),
    ),
    "StatorShortCircuit": Reference(
        (),
        ("uds", "uqs", "theta"),
        ("ids", "iqs"),
        {"eta_a": 0.011, "eta_b": 0.024, "eta_c": 0.043, "Rs": 8.5},
        nothing,
        short_circuit,
        (300.0, 300.0, 3.0),
        7e-4,
    ),
    "ThreePhaseInductionMachine": Reference(
        ("ia", "ib", "ic", "theta", "phidr", "phiqr"),
        ("ua", "ub", "uc", "w"),
        ("ia", "ib", "ic", "theta", "phidr", "phiqr", "torque"),
        MACHINE | PHASES | FLUXES,
        three_phase,
        phases_and_torque,
        (300.0, 300.0, 300.0, 10.0),
        7e-4,
        (0.0, 0.0, 0.0, 157.0),
    ),
    "SpeedController": Reference(
        ("halfway", "smooth", "integral"),
        ("reference", "speed"),
        ("torque",),
        SPEED | SPEED_STARTS,
        speed_controller,
        speed_control,
        (9.0, 9.0),
        7e-4,
        (78.0, 78.0),
    ),
    "CurrentController": Reference(
        ("phid", "phiq", "wanted", "vf", "vt"),
        ("torque", "ia", "ib", "ic", "theta", "w"),
        ("uds", "uqs"),
        CURRENT | CURRENT_LIMITS | CURRENT_STARTS,
        current_controller,
        current_control,
        (4.0, 3.0, 3.0, 3.0, 0.05, 10.0),
        7e-4,
        (0.0, 0.0, 0.0, 0.0, 0.7, 157.0),
    ),
    "CoilController": Reference(
        ("integral",),
        ("reference", "i"),
        ("u",),
        {"K": 17.0, "Ti": 0.03, "integral_start": 1.3},
        coil_controller,
        coil_control,
        (0.5, 0.5),
        1e-3,
    ),
    "CurrentSensor": Reference((), ("i", "noise"), ("measured",), {"gain": 0.9}, nothing, sensor, (1.0, 0.1), 1e-3),
    "Inverter": Reference(
        ("uds", "uqs"),
        ("uds_wanted", "uqs_wanted", "theta", "w"),
        ("ua", "ub", "uc", "uds", "uqs"),
        {"T": 1.5e-3, "period": 1e-4, "uds_start": 40.0, "uqs_start": -70.0},
        inverter,
        modulated,
        (300.0, 300.0, 3.0, 10.0),
        7e-4,
        (0.0, 0.0, 0.7, 157.0),
    ),
    "MechanicalLoad": Reference(
        ("speed", "angle"),
        ("torque",),
        ("speed", "angle", "w"),
        {"J": 0.017, "f": 0.06, "p": 3.0, "period": 1e-4, "speed_start": 70.0, "angle_start": 0.3},
        shaft,
        shaft_speeds,
        (8.0,),
        7e-4,
    ),
    "PositionDrive": Reference(
        ("q", "dq"), ("v",), ("q", "dq"), DRIVE | {"q_start": 0.1, "dq_start": -0.02}, drive, first, (10.0,), 1e-3
    ),
    "PositionController": Reference(
        (),
        ("qg", "q", "dq"),
        ("v",),
        {"kp": 150.0, "kv": 230.0, "v_max": 9.0},
        nothing,
        controller,
        (3e-4, 3e-4, 0.03),
        1e-3,
    ),
}
models = pytest.mark.parametrize("model", REFERENCES)

# ---- the FMUs


class Instance:
    """One instance of an FMU, variables by name."""

    def __init__(self, model: str, directory: Path, kind: type[Any] = fmpy.fmi2.FMU2Slave) -> None:
        if not (directory / "modelDescription.xml").exists():
            fmpy.extract(str(FMUS / model / f"{model}.fmu"), unzipdir=str(directory))
        self.description: Any = fmpy.read_model_description(str(directory))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(self.log)
        self.fmu: Any = kind(
            guid=self.description.guid, unzipDirectory=str(directory), modelIdentifier=model, instanceName="one"
        )
        self.fmu.instantiate(callbacks=self.callbacks)

    def log(self, _: Any, name: bytes, status: int, category: bytes, text: bytes) -> None:
        assert (name, status, category) == (b"one", fmpy.fmi2.fmi2Error, b"logStatusError")
        self.messages.append(text.decode())

    def initialise(self, values: dict[str, float] | None = None) -> None:
        self.fmu.setupExperiment()
        self.set(values or {})
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def start_model_exchange(self, values: dict[str, float]) -> None:
        self.initialise(values)
        assert self.fmu.newDiscreteStates() == (False, False, False, False, False, 0.0)
        self.fmu.enterContinuousTimeMode()

    def numbers(self, names: Sequence[str]) -> list[int]:
        return [self.references[name] for name in names]

    def set(self, values: dict[str, float]) -> None:
        self.fmu.setReal(self.numbers([*values]), [*values.values()])

    def get(self, *names: str) -> Array:
        return np.array(self.fmu.getReal(self.numbers(names)))

    def slopes(self, names: Sequence[str], values: Array, order: int = 1) -> None:
        n = len(names)
        self.fmu.fmi2SetRealInputDerivatives(
            self.fmu.component,
            (ctypes.c_uint * n)(*self.numbers(names)),
            n,
            (ctypes.c_int * n)(*[order] * n),
            (ctypes.c_double * n)(*values),
        )

    def derivatives(self, x: Array) -> Array:
        n = len(x)
        self.fmu.setContinuousStates((ctypes.c_double * n)(*x), n)
        rates = (ctypes.c_double * n)()
        self.fmu.getDerivatives(rates, n)
        return np.array(rates)

    def directional(self, unknowns: Sequence[str], known: str) -> Array:
        return np.array(self.fmu.getDirectionalDerivative(self.numbers(unknowns), self.numbers([known]), [1.0]))

    def run(self, reference: Reference, times: Array, inputs: Array, linear: bool) -> Array:
        """Co-simulate from the initialised state; outputs at the times."""
        names, rows = reference.inputs, []
        for k in range(len(times)):
            self.set(dict(zip(names, inputs[k], strict=True)))
            rows.append(self.get(*reference.outputs))
            if k + 1 < len(times):
                h = times[k + 1] - times[k]
                self.slopes(names, (inputs[k + 1] - inputs[k]) / h * linear)
                self.fmu.doStep(times[k], h)
        return np.array(rows)


Opener = Callable[..., Instance]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture
def opened(unpacked: Path) -> Iterator[Opener]:
    instances: list[Instance] = []

    def open_instance(model: str, kind: type[Any] = fmpy.fmi2.FMU2Slave) -> Instance:
        instances.append(Instance(model, unpacked / model, kind))
        return instances[-1]

    yield open_instance
    for instance in instances:
        instance.fmu.fmi2FreeInstance(instance.fmu.component)


def relative_error(found: Array, expected: Array) -> float:
    return float(np.max(np.abs(found - expected).max(0) / np.abs(expected).max(0)))


# ---- co-simulation


@pytest.mark.parametrize("linear", [True, False], ids=["linear", "held"])
@models
def test_co_simulation_follows_the_equations(opened: Opener, model: str, linear: bool) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals()
    instance = opened(model)
    instance.initialise(reference.parameters)
    found = instance.run(reference, times, inputs, linear)
    expected = reference.integrate(times, inputs, linear)
    assert relative_error(found, expected) < TOLERANCE
    assert np.all(np.ptp(found, axis=0) > 0)


def test_coil_against_its_closed_form(opened: Opener) -> None:
    """i(t) = A + B t + (i0 - A) exp(-R t/L) for u = u0 + a t, with B = a/R and A = (u0 - L B)/R."""
    R, L, i0, u0, a = 3.3, 0.08, -0.4, 1.7, -23.0
    t = np.linspace(0, 0.1, 101)
    B = a / R
    A = (u0 - L * B) / R
    expected = A + B * t + (i0 - A) * np.exp(-R / L * t)
    instance = opened("Coil")
    instance.initialise({"R": R, "L": L, "i_start": i0})
    found = instance.run(REFERENCES["Coil"], t, (u0 + a * t)[:, None], linear=True)
    assert relative_error(found, expected[:, None]) < 1e-10


def test_induction_machine_at_constant_speed_against_its_matrix_exponential(opened: Opener) -> None:
    """One substep a sample of 0.7 ms, the method's own, over 3 s."""
    p, w, h, count = REFERENCES["InductionMachine"].parameters, 157.0, 7e-4, 4300
    u = np.array([200.0, -100.0, w])
    A = np.array([park_machine(x, [0, 0, w], p) for x in np.eye(4)]).T
    steady = np.linalg.solve(A, -park_machine(np.zeros(4), u, p))
    x, step = np.array([p[f"{name}_start"] for name in ("ids", "iqs", "phidr", "phiqr")]), expm(A * h)
    rows = [x]
    for _ in range(count - 1):
        x = steady + step @ (x - steady)
        rows.append(x)
    instance = opened("InductionMachine")
    instance.initialise(p)
    found = instance.run(REFERENCES["InductionMachine"], h * np.arange(count), np.tile(u, (count, 1)), linear=False)
    assert relative_error(found, np.array(rows)) < TOLERANCE


def test_controller_is_limited(opened: Opener) -> None:
    instance = opened("PositionController")
    instance.initialise()
    for reference_position, expected in ((0.0, 0.0), (1e-4, 160.18 * 243.45 * 1e-4), (1.0, 10.0), (-1.0, -10.0)):
        instance.set({"qg": reference_position})
        assert instance.get("v") == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("model", "free", "limits"),
    [
        ("SpeedController", {}, {"torque_max": 0.2}),
        ("CurrentController", {}, {"u_max": 10.0}),
        ("CurrentController", {"flux_reference": 6.0}, {"i_max": 1.0}),  # flux is missing, and less than half is there
    ],
)
def test_limits_of_the_controllers(
    opened: Opener, model: str, free: dict[str, float], limits: dict[str, float]
) -> None:
    """What the limits leave, and how the integral parts follow; each limit makes a difference at every point."""
    reference = REFERENCES[model]
    both = [reference.parameters | free | each for each in ({}, limits)]
    instance = opened(model, fmpy.fmi2.FMU2Model)
    instance.start_model_exchange(both[1])
    for x, u in points(reference):
        x[:2] += np.sign(x[:2])
        instance.set(dict(zip(reference.inputs, u, strict=True)))
        found = np.concatenate([instance.derivatives(x), instance.get(*reference.outputs)])
        unlimited, expected = (np.concatenate([reference.rates(x, u, p), reference.evaluate(x, u, p)]) for p in both)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)
        assert np.abs(unlimited / expected - 1).max() > 0.01


def test_inputs_move_on_along_their_slopes(opened: Opener) -> None:
    """The value of an input is that at the present time, also after a step; a slope holds until it is changed."""
    instance = opened("PositionController")
    instance.initialise()
    instance.set({"qg": 1e-5})
    instance.slopes(["qg"], np.array([1e-2]))
    for k in (1, 2, 3):
        instance.fmu.doStep((k - 1) * 1e-3, 1e-3)
        assert instance.get("qg", "v") == pytest.approx([1e-5 * (1 + k), 160.18 * 243.45 * 1e-5 * (1 + k)], rel=1e-12)


@models
def test_long_steps_are_divided(opened: Opener, model: str) -> None:
    """Substeps of at most the model's Interval: a step of three is three steps of one."""
    reference = REFERENCES[model]
    interval = float(opened(model).description.defaultExperiment.stepSize)
    results = []
    for parts in (1, 3):
        instance = opened(model)
        instance.initialise(reference.parameters)
        instance.set(dict(zip(reference.inputs, np.array(reference.amplitudes) / 3, strict=True)))
        for k in range(parts):
            instance.fmu.doStep(k * 3 * interval / parts, 3 * interval / parts)
        results.append(instance.get(*reference.outputs))
    np.testing.assert_allclose(results[0], results[1], rtol=1e-12)


# ---- start values, life, state


@models
def test_parameters_give_the_start_values(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    instance = opened(model)
    instance.fmu.setupExperiment()
    instance.set(reference.parameters)
    expected = [reference.parameters[f"{name}_start"] for name in reference.states]
    assert list(instance.get(*reference.states)) == expected
    instance.fmu.enterInitializationMode()
    instance.set({f"{name}_start": k + 0.5 for k, name in enumerate(reference.states)})
    assert list(instance.get(*reference.states)) == [k + 0.5 for k in range(len(expected))]
    instance.set(reference.parameters)
    instance.fmu.exitInitializationMode()
    assert list(instance.get(*reference.states)) == expected
    instance.set({f"{name}_start": 9.0 for name in reference.states})  # too late to act
    assert list(instance.get(*reference.states)) == expected


@models
def test_tuning_a_parameter_between_steps(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals(10)
    tuned, fresh = opened(model), opened(model)
    tuned.initialise()
    tuned.run(reference, times, inputs, True)
    tuned.set(reference.parameters)
    fresh.initialise(reference.parameters | {f"{n}_start": float(tuned.get(n)[0]) for n in reference.states})
    assert np.array_equal(tuned.run(reference, times, inputs, True), fresh.run(reference, times, inputs, True))


@models
def test_reset_repeats_bit_for_bit(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals(40)
    instance = opened(model)
    runs = []
    for values in ({}, reference.parameters, {}, reference.parameters):
        instance.initialise(values)
        runs.append(instance.run(reference, times, inputs, True))
        instance.fmu.reset()
    assert np.array_equal(runs[0], runs[2])
    assert np.array_equal(runs[1], runs[3])
    assert not np.array_equal(runs[0], runs[1])


@models
def test_instances_are_independent(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals(20)
    alone, one, other = opened(model), opened(model), opened(model)
    for instance in (alone, one):
        instance.initialise(reference.parameters)
    other.initialise()
    expected = alone.run(reference, times, inputs, True)
    other.run(reference, times, -inputs, True)
    assert np.array_equal(one.run(reference, times, inputs, True), expected)


@models
def test_state_is_saved_restored_and_serialised(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals(40)
    instance, second = opened(model), opened(model)
    instance.initialise(reference.parameters)
    second.initialise()
    instance.run(reference, times[:20], inputs[:20], True)
    state = instance.fmu.getFMUstate()
    data = instance.fmu.serializeFMUstate(state)
    expected = instance.run(reference, times[20:], inputs[20:], True)
    instance.fmu.setFMUstate(state)
    assert np.array_equal(instance.run(reference, times[20:], inputs[20:], True), expected)
    copy = second.fmu.deSerializeFMUstate(data)
    second.fmu.setFMUstate(copy)
    assert np.array_equal(second.run(reference, times[20:], inputs[20:], True), expected)
    assert second.fmu.serializeFMUstate(copy) == data
    for owner, each in ((instance, state), (second, copy)):
        owner.fmu.freeFMUstate(each)


def test_state_of_another_model_is_refused(opened: Opener) -> None:
    coil_, drive_ = opened("Coil"), opened("PositionDrive")
    data = coil_.fmu.serializeFMUstate(coil_.fmu.getFMUstate())
    with pytest.raises(fmpy.fmi1.FMICallException):
        drive_.fmu.deSerializeFMUstate(data)
    assert "not a state of this FMU" in drive_.messages[0]


# ---- model exchange and derivatives


def points(reference: Reference) -> Iterator[tuple[Array, Array]]:
    rng = np.random.default_rng(5)
    for _ in range(5):
        x = rng.uniform(-1, 1, len(reference.states))
        if reference.rates is drive:
            x[1] *= 2e-3  # where friction changes sign
        yield x, rng.uniform(-1, 1, len(reference.inputs)) * np.array(reference.amplitudes)


@models
def test_derivatives_are_the_equations(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    instance = opened(model, fmpy.fmi2.FMU2Model)
    instance.start_model_exchange(reference.parameters)
    for x, u in points(reference):
        instance.set(dict(zip(reference.inputs, u, strict=True)))
        expected = reference.rates(x, u, reference.parameters)
        np.testing.assert_allclose(instance.derivatives(x), expected, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(
            instance.get(*reference.outputs), reference.evaluate(x, u, reference.parameters), rtol=1e-13
        )


@pytest.mark.parametrize("model", ["InductionMachine", "ThreePhaseInductionMachine"])
def test_model_exchange_integrated_by_scipy(opened: Opener, model: str) -> None:
    """The right-hand side at the times and inputs that the integrator asks for gives what the co-simulation gives."""
    reference = REFERENCES[model]
    times, inputs = reference.signals(30)
    instance = opened(model, fmpy.fmi2.FMU2Model)
    instance.start_model_exchange(reference.parameters)
    x = np.zeros(len(reference.states))
    start = (ctypes.c_double * len(x))()
    instance.fmu.getContinuousStates(start, len(x))
    x = np.array(start)
    rows = [reference.evaluate(x, inputs[0], reference.parameters)]
    for k in range(len(times) - 1):
        slope = (inputs[k + 1] - inputs[k]) / (times[k + 1] - times[k])

        def rates(t: float, x: Array, k: int = k, slope: Array = slope) -> Array:
            instance.fmu.setTime(t)
            instance.set(dict(zip(reference.inputs, inputs[k] + slope * (t - times[k]), strict=True)))
            return instance.derivatives(x)

        x = solve_ivp(rates, (float(times[k]), float(times[k + 1])), x, method="DOP853", rtol=1e-11, atol=1e-13).y[
            :, -1
        ]
        assert instance.fmu.completedIntegratorStep() == (False, False)
        rows.append(reference.evaluate(x, inputs[k + 1], reference.parameters))
    slave = opened(model)
    slave.initialise(reference.parameters)
    assert relative_error(slave.run(reference, times, inputs, True), np.array(rows)) < TOLERANCE


@models
def test_directional_derivatives(opened: Opener, model: str) -> None:
    """Exact: against the complex-step derivatives of the reference, and roughly against differences of the FMU."""
    reference = REFERENCES[model]
    instance = opened(model, fmpy.fmi2.FMU2Model)
    instance.start_model_exchange(reference.parameters)
    unknowns = [*(f"der({name})" for name in reference.states), *reference.outputs]
    active = [name for name in reference.parameters if not name.endswith("_start")]
    for x, u in points(reference):
        instance.set(dict(zip(reference.inputs, u, strict=True)))
        instance.derivatives(x)
        columns = {name: ("x", k) for k, name in enumerate(reference.states)}
        columns |= {name: ("u", k) for k, name in enumerate(reference.inputs)}
        columns |= {name: ("p", k) for k, name in enumerate(active)}
        for name, (kind, k) in columns.items():
            point = {"x": x.astype(complex), "u": u.astype(complex), "p": dict(reference.parameters)}
            if kind == "p":
                point["p"][name] += 1e-30j  # type: ignore[index]
            else:
                point[kind][k] += 1e-30j  # type: ignore[index]
            arguments = (point["x"], point["u"], point["p"])
            both = np.concatenate([reference.rates(*arguments), reference.evaluate(*arguments)])
            expected = both.imag / 1e-30
            scale = 1e-12 * max(1.0, np.abs(expected).max())
            np.testing.assert_allclose(instance.directional(unknowns, name), expected, rtol=1e-9, atol=scale)
    for k, name in enumerate(reference.states):  # at the last point
        eps = np.zeros(len(x))
        eps[k] = 1e-6 if reference.rates is drive else 1e-4
        difference = (instance.derivatives(x + eps) - instance.derivatives(x - eps)) / (2 * eps[k])
        instance.derivatives(x)
        found = instance.directional(unknowns[: len(x)], name)
        np.testing.assert_allclose(found, difference, rtol=1e-6, atol=1e-6 * np.abs(difference).max())


def test_directional_derivatives_in_initialization_mode(opened: Opener) -> None:
    """There the states are functions of the start parameters."""
    instance = opened("Coil")
    instance.fmu.setupExperiment()
    instance.fmu.enterInitializationMode()
    instance.set({"R": 3.0, "L": 0.5})
    assert list(instance.directional(["i", "der(i)"], "i_start")) == [1.0, -6.0]
    assert list(instance.directional(["i", "der(i)"], "u")) == [0.0, 2.0]


# ---- machines against each other


@pytest.mark.parametrize(("speed", "step", "tolerance"), [(0.0, 7e-4, 1e-8), (157.0, 1e-5, 2e-6)])
def test_three_phase_machine_is_the_park_machine(opened: Opener, speed: float, step: float, tolerance: float) -> None:
    """Seen through the transforms. Between samples, voltages are linear in one of two turning frames only: (wT)²/8."""
    count = 1000
    t = step * np.arange(count)
    frame = pd.DataFrame({"time": t, "w": np.full(count, speed), "theta": 0.7 + speed * t})
    for phase, name in enumerate(("ua", "ub", "uc")):
        frame[name] = 310 * np.cos(314 * t - phase * 2 * np.pi / 3) + 20  # the 20 V: a zero sequence
    three = REFERENCES["ThreePhaseInductionMachine"]
    machine = opened("ThreePhaseInductionMachine")
    machine.initialise(MACHINE | FLUXES | PHASES)
    phases = machine.run(three, t, frame[list(three.inputs)].to_numpy(), linear=True)
    frame[list(three.outputs)] = phases
    np.testing.assert_allclose(frame["theta"], 0.7 + speed * t, rtol=1e-12)
    frame = park(frame, ["ua", "ub", "uc"], ["uds", "uqs"])
    frame = park(frame, ["ia", "ib", "ic"], ["ids", "iqs"])
    two = REFERENCES["InductionMachine"]
    machine = opened("InductionMachine")
    starts = {f"{name}_start": float(frame[name].iloc[0]) for name in ("ids", "iqs")}
    machine.initialise(MACHINE | FLUXES | starts)
    found = machine.run(two, t, frame[list(two.inputs)].to_numpy(), linear=True)
    assert relative_error(found, frame[list(two.outputs)].to_numpy()) < tolerance


def test_zero_sequence_current_sees_resistance_and_leakage_only(opened: Opener) -> None:
    """Lf di0/dt = u0 - Rs i0, whatever the rotor does."""
    reference = REFERENCES["ThreePhaseInductionMachine"]
    t = 7e-4 * np.arange(100)
    inputs = np.tile([50.0, 50.0, 50.0, 150.0], (100, 1))
    machine = opened("ThreePhaseInductionMachine")
    machine.initialise(reference.parameters)
    found = machine.run(reference, t, inputs, linear=False)[:, :3].mean(1)
    final, start = 50 / MACHINE["Rs"], (1.1 + 0.3 - 0.8) / 3
    expected = final + (start - final) * np.exp(-MACHINE["Rs"] / MACHINE["Lf"] * t)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


# ---- refusals of the C code: one clear text each, and a way back


def refused(instance: Instance, call: Callable[[], Any]) -> str:
    with pytest.raises(fmpy.fmi1.FMICallException):
        call()
    assert len(instance.messages) == 1
    with pytest.raises(fmpy.fmi1.FMICallException):  # after an error only reset (or a saved state) helps
        instance.get("i")
    assert "after an error (reset the instance or restore a state)" in instance.messages[1]
    instance.fmu.reset()
    instance.initialise()
    assert list(instance.get("i")) == [0.0]
    return instance.messages[0]


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda c: c.set({"R": float("nan")}), "fmi2SetReal: the value given for R at t = 0 is not finite"),
        (lambda c: c.set({"u": float("inf")}), "the value given for u at t = 0 is not finite"),
        (lambda c: c.set({"i": 1.0}), "i is computed by the model: only inputs and parameters can be set"),
        (lambda c: c.fmu.setReal([99], [1.0]), "there is no variable of value reference 99"),
        (lambda c: c.fmu.getReal([99]), "there is no variable of value reference 99"),
        (lambda c: c.fmu.getInteger([0]), "fmi2GetInteger: all variables of the model are Real"),
        (lambda c: c.fmu.setString([0], ["a"]), "fmi2SetString: all variables of the model are Real"),
        (lambda c: c.slopes(["R"], np.array([1.0])), "is no input"),
        (lambda c: c.slopes(["u"], np.array([1.0]), order=2), "order 2 of u: only order 1 is supported"),
        (lambda c: c.slopes(["u"], np.array([np.nan])), "the value given for u at t = 0 is not finite"),
        (lambda c: c.fmu.doStep(0.0, -1e-3), "fmi2DoStep: from t = 0 by -0.001 is no step"),
        (lambda c: c.fmu.enterInitializationMode(), "fmi2EnterInitializationMode cannot be called between steps"),
        (lambda c: c.fmu.getDirectionalDerivative([0], [5], [1.0]), "value reference 5 is no state, input or param"),
        (lambda c: (c.set({"L": 0.0}), c.get("der(i)")), "der(i) is not finite at t = 0: parameters, inputs or"),
        (
            lambda c: (c.set({"L": 1e-9, "u": 1.0}), [c.fmu.doStep(k * 1e-3, 1e-3) for k in range(60)]),
            "state i is not finite at t = 0.0",
        ),
    ],
)
def test_refusals(opened: Opener, call: Callable[[Instance], Any], text: str) -> None:
    instance = opened("Coil")
    instance.initialise()
    assert text in refused(instance, lambda: call(instance))


def test_refusals_before_and_after(opened: Opener) -> None:
    instance = opened("Coil")
    assert "fmi2DoStep cannot be called before initialization mode" in refused(
        instance, lambda: instance.fmu.doStep(0.0, 1e-3)
    )
    instance.fmu.terminate()
    instance.messages.clear()
    assert "fmi2SetReal cannot be called after termination" in refused(instance, lambda: instance.set({"u": 1.0}))


def test_parameters_are_fixed_in_continuous_time_mode(opened: Opener) -> None:
    instance = opened("Coil", fmpy.fmi2.FMU2Model)
    instance.start_model_exchange({})
    instance.fmu.enterEventMode()
    instance.set({"R": 2.0})
    instance.fmu.enterContinuousTimeMode()
    with pytest.raises(fmpy.fmi1.FMICallException):
        instance.set({"R": 3.0})
    assert "parameter R cannot be set in continuous-time mode" in instance.messages[0]


def test_wrong_guid_is_refused(opened: Opener) -> None:
    instance = opened("Coil")
    instance.fmu.guid = "{another}"
    component = instance.fmu.component
    with pytest.raises(Exception, match="Failed to instantiate"):
        instance.fmu.instantiate(callbacks=instance.callbacks)
    assert "modelDescription.xml and binary are not of the same export" in instance.messages[0]
    instance.fmu.component = component
