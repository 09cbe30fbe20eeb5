"""Equations of the shipped models, of our own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

from fmuid.data.signals import T23
from tests.support.closed_forms import park_rates
from tests.support.fault_equations import (
    broken_bars,
    coil_turns,
    cracked_bars,
    faulty_coil,
    leaking_turns,
    leaking_turns_currents,
    rotation,
    short_circuit,
    short_circuit_with_contact,
)

Array = npt.NDArray[Any]
TOLERANCE = 1e-7  # of the largest value of each signal: an integration error is a parameter bias


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
    """docs/method/induction-machine.md, the state equations in Park axes linked to the rotor."""
    return np.array(park_rates(x, u, [p[name] for name in ("Rs", "Rr", "Lm", "Lf")]))


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
        [u[:3] - p["Rs"] * currents - w * dM @ J @ rotor, -p["Rr"] * rotor - w * T23 @ dM.T @ currents]
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
CAGE = {"bars": 22.0, "p": 2.0, "ring": 0.03, "crack0": 0.6, "crack1": 0.3, "theta0": 0.7}
FLUXES = {"phidr_start": 0.6, "phiqr_start": -0.4}
SPEED = {"K": 0.8, "Ti": 0.1, "Tr": 0.006, "torque_max": 60.0}
SPEED_STARTS = {"halfway_start": 76.0, "smooth_start": 75.0, "integral_start": 3.0}
CURRENT = {"Rs": 9.0, "Rr": 4.2, "Lm": 0.41, "Lf": 0.08, "p": 3.0, "flux_reference": 0.5, "gain": 12.0}
CURRENT |= {"T": 0.004, "Tf": 0.012}
CURRENT_LIMITS = {"i_max": 30.0, "u_max": 2000.0}  # never reached: a bend is integrated less precisely than 1e-7
CURRENT_STARTS = {"phid_start": 0.6, "phiq_start": -0.4, "wanted_start": 1.4, "vf_start": 20.0, "vt_start": -30.0}
DRIVE = {"M": 88.0, "Fv": 230.0, "Fc": 23.0, "offset": -4.0, "gtau": 33.0, "dq_eps": 1.2e-3}
MACHINE_STARTS = {"ids_start": 1.2, "iqs_start": -0.7} | FLUXES
RATIOS = {"eta_a": 0.011, "eta_b": 0.024, "eta_c": 0.043, "Rs": 8.5}
LEAKAGE = RATIOS | {"Lf": 0.06, "own": 0.3, "contact": 0.4, "ia_start": 0.3, "ib_start": -0.2, "ic_start": 0.1}
COIL = {"R": 3.3, "L": 0.08, "i_start": -0.4}
MOVES = {"q_start": 0.1, "dq_start": -0.02}
SHAFT = {"J": 0.017, "f": 0.06, "p": 3.0, "period": 1e-4, "speed_start": 70.0, "angle_start": 0.3}
INVERTER = {"T": 1.5e-3, "period": 1e-4, "uds_start": 40.0, "uqs_start": -70.0}


def machine(more: dict[str, float], rates: Callable[..., Any]) -> Reference:
    """Return a machine in Park axes linked to the rotor."""
    states, amplitudes = "ids iqs phidr phiqr", (300.0, 300.0, 10.0)
    values = MACHINE | more | MACHINE_STARTS
    return reference(states, "uds uqs w", states, values, (rates, first), amplitudes, 7e-4, (0.0, 0.0, 157.0))


def reference(
    states: str, inputs: str, outputs: str, parameters: dict[str, float], functions: Any, *signals: Any
) -> Reference:
    """Return a reference whose names are given in one text each."""
    x, u, y = (tuple(text.split()) for text in (states, inputs, outputs))
    return Reference(x, u, y, parameters, *functions, *signals)


REFERENCES = {
    "Coil": reference("i", "u", "i", COIL, (coil, first), (1.0,), 1e-3),
    "FaultyCoil": reference("i", "u", "i", COIL | {"dR": 0.7, "tau": 0.021}, (faulty_coil, first), (1.0,), 1e-3),
    "CoilTurns": reference("i", "u", "i", COIL | {"lost": 0.2}, (coil_turns, first), (1.0,), 1e-3),
    "InductionMachine": machine({}, park_machine),
    "InductionMachineRotorFault": machine({"eta0": 0.3, "theta0": 0.7}, broken_bars),
    "InductionMachineBrokenBars": machine(CAGE, cracked_bars),
    "StatorShortCircuit": reference(
        "", "uds uqs theta", "ids iqs", RATIOS, (nothing, short_circuit), (300.0, 300.0, 3.0), 7e-4
    ),
    "StatorShortCircuitLeakage": reference(
        "ia ib ic", "uds uqs theta", "ids iqs", LEAKAGE, (leaking_turns, leaking_turns_currents),
        (300.0, 300.0, 0.3), 7e-4,
    ),
    "StatorShortCircuitContact": reference(
        "", "uds uqs theta", "ids iqs", RATIOS | {"contact": 0.4}, (nothing, short_circuit_with_contact),
        (300.0, 300.0, 3.0), 7e-4,
    ),
    "ThreePhaseInductionMachine": reference(
        "ia ib ic theta phidr phiqr", "ua ub uc w", "ia ib ic theta phidr phiqr torque", MACHINE | PHASES | FLUXES,
        (three_phase, phases_and_torque), (300.0, 300.0, 300.0, 10.0), 7e-4, (0.0, 0.0, 0.0, 157.0),
    ),
    "SpeedController": reference(
        "halfway smooth integral", "reference speed", "torque", SPEED | SPEED_STARTS,
        (speed_controller, speed_control), (9.0, 9.0), 7e-4, (78.0, 78.0),
    ),
    "CurrentController": reference(
        "phid phiq wanted vf vt", "torque ia ib ic theta w", "uds uqs", CURRENT | CURRENT_LIMITS | CURRENT_STARTS,
        (current_controller, current_control), (4.0, 3.0, 3.0, 3.0, 0.05, 10.0), 7e-4, (0.0, 0.0, 0.0, 0.0, 0.7, 157.0),
    ),
    "CoilController": reference(
        "integral", "reference i", "u", {"K": 17.0, "Ti": 0.03, "integral_start": 1.3},
        (coil_controller, coil_control), (0.5, 0.5), 1e-3,
    ),
    "CurrentSensor": reference("", "i noise", "measured", {"gain": 0.9}, (nothing, sensor), (1.0, 0.1), 1e-3),
    "Inverter": reference(
        "uds uqs", "uds_wanted uqs_wanted theta w", "ua ub uc uds uqs", INVERTER, (inverter, modulated),
        (300.0, 300.0, 3.0, 10.0), 7e-4, (0.0, 0.0, 0.7, 157.0),
    ),
    "MechanicalLoad": reference("speed angle", "torque", "speed angle w", SHAFT, (shaft, shaft_speeds), (8.0,), 7e-4),
    "PositionDrive": reference("q dq", "v", "q dq", DRIVE | MOVES, (drive, first), (10.0,), 1e-3),
    "PositionController": reference(
        "", "qg q dq", "v", {"kp": 150.0, "kv": 230.0, "v_max": 9.0}, (nothing, controller), (3e-4, 3e-4, 0.03), 1e-3
    ),
}  # fmt: skip
LONG = {"InductionMachineBrokenBars", "StatorShortCircuitLeakage", "ThreePhaseInductionMachine"}
models = pytest.mark.parametrize(
    "model", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in REFERENCES]
)
