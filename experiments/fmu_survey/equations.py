"""What is known of some models from their equations: closed forms, or scipy on the equations written out here.

Each function takes ``start`` (the start value of the first of several variables that has one) and the times (K,), and
returns the trajectories of some variables and the times of events. `KNOWN` has them by the model's name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fmuid.array_types import Floats

Start = Callable[..., float]

BOUNCES = 200  # of a ball that never rests; later samples are NaN


class Known(NamedTuple):
    """Trajectories (K,) by variable, NaN where nothing is known, and event times, s."""

    values: dict[str, Floats]
    events: list[float]


def exponential(state: str, rate: str, sign: float) -> Callable[[Start, Floats], Known]:
    """Return the solution of x' = sign rate x."""

    def solve(start: Start, times: Floats) -> Known:
        return Known({state: start(f"{state}_start", state) * np.exp(sign * start(rate) * times)}, [])

    return solve


def linear(start: Start, times: Floats) -> Known:
    """Solve x' = A x of two states by the matrix exponential."""
    matrix = np.array([[start("a11"), start("a12")], [start("a21"), start("a22")]])
    x = np.array([expm(matrix * (t - times[0])) @ [start("x1_start"), start("x2_start")] for t in times])
    return Known({"x1": x[:, 0], "x2": x[:, 1]}, [])


def van_der_pol(start: Start, times: Floats) -> Known:
    """Integrate x0' = x1, x1' = mu (1 - x0²) x1 - x0."""
    mu = start("mu")
    solution = solve_ivp(
        lambda _, x: [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]],
        (times[0], times[-1]),
        [start("x0"), start("x1")],
        method="DOP853",
        t_eval=times,
        rtol=1e-12,
        atol=1e-13,
    )
    return Known({"x0": solution.y[0], "x1": solution.y[1]}, [])


def robertson(_start: Start, times: Floats) -> Known:
    """Integrate Robertson's chemical reaction, stiff, with y3 = 1 - y1 - y2 (Hairer and Wanner II, (1.4))."""

    def slopes(_: float, y: Floats) -> list[float]:
        first, second = -0.04 * y[0] + 1e4 * y[1] * (1 - y[0] - y[1]), 3e7 * y[1] ** 2
        return [first, -first - second]

    solution = solve_ivp(
        slopes, (times[0], times[-1]), [1.0, 0.0], method="Radau", t_eval=times, rtol=1e-12, atol=[1e-14, 1e-17]
    )
    y1, y2 = solution.y
    return Known({"y1": y1, "y2": y2, "y3": 1 - y1 - y2}, [])


def ball(  # the names of the variables, and what happens at the floor
    height: str, speed: str, gravity: str, restitution: str, *, floor: str = "", up: bool = False, rest: float = 0.0
) -> Callable[[Start, Floats], Known]:
    """Return parabolas from bounce to bounce: speed -> -restitution speed at the floor, at rest below a speed `rest`.

    `up` says that the gravity variable counts upwards (it is negative).
    """

    def solve(start: Start, times: Floats) -> Known:
        g, e = (9.81 if not gravity else abs(start(gravity)) if up else start(gravity)), start(restitution)
        low = start(floor) if floor else 0.0
        h, v = np.full(len(times), np.nan), np.full(len(times), np.nan)
        t0, h0, v0, events = float(times[0]), start(f"{height}_start", height), 0.0, []
        for _ in range(BOUNCES):
            hit = t0 + (v0 + np.sqrt(v0 * v0 + 2 * g * (h0 - low))) / g
            inside = (times >= t0) & (times < hit)
            tau = times[inside] - t0
            h[inside], v[inside] = h0 + v0 * tau - g * tau * tau / 2, v0 - g * tau
            v0, t0, h0 = e * (g * (hit - t0) - v0), hit, low
            events.append(float(hit))
            if v0 < rest:
                h[times >= hit], v[times >= hit] = low, 0.0
                break
            if hit > times[-1]:
                break
        return Known({height: h, speed: v}, events)

    return solve


def stair(_start: Start, times: Floats) -> Known:
    """Count the seconds, from 1."""
    return Known({"counter": 1.0 + np.floor(times + 1e-9)}, [float(t) for t in range(1, int(times[-1]) + 1)])


def state_space(start: Start, times: Floats) -> Known:
    """Solve x' = A x + B u, y = C x + D u with constant u, by the matrix exponential of the augmented system."""
    matrices = {m: np.array([[start(f"{m}[{i},{j}]") for j in (1, 2, 3)] for i in (1, 2, 3)]) for m in "ABCD"}
    x0, u = (np.array([start(f"{name}[{i}]") for i in (1, 2, 3)]) for name in ("x0", "u"))
    augmented = np.block([[matrices["A"], matrices["B"]], [np.zeros((3, 6))]])
    xu = np.array([expm(augmented * (t - times[0])) @ np.concatenate([x0, u]) for t in times])
    y = xu[:, :3] @ matrices["C"].T + u @ matrices["D"].T
    return Known({f"{n}[{i + 1}]": a[:, i] for n, a in (("x", xu[:, :3]), ("y", y)) for i in range(3)}, [])


def spring_pendulum(start: Start, times: Floats) -> Known:
    """Solve m s'' = -c (s - s_fixed - s_rel0): a harmonic oscillation."""
    middle = start("fixed.s0") + start("spring.s_rel0")
    omega = np.sqrt(start("spring.c") / start("mass.m"))
    s0, v0 = start("mass_s0"), start("mass_v0", "mass.v")
    s = middle + (s0 - middle) * np.cos(omega * times) + v0 / omega * np.sin(omega * times)
    v = -(s0 - middle) * omega * np.sin(omega * times) + v0 * np.cos(omega * times)
    return Known({"mass.s": s, "mass.v": v}, [])


def sine(start: Start, times: Floats) -> Known:
    """Evaluate Modelica.Blocks.Sources.Sine."""
    begin = start("startTime")
    wave = start("amplitude") * np.sin(2 * np.pi * start("freqHz") * (times - begin) + start("phase"))
    return Known({"y": start("offset") + np.where(times < begin, 0.0, wave)}, [begin])


def friction_pendulum(start: Start, times: Floats) -> Known:
    """Solve the pendulum of `spring_pendulum` with Coulomb, Stribeck and viscous friction (Modelica's friction model).

    MassWithStopAndFriction (Modelica Standard Library, Mechanics.Translational): sliding, m s'' = F_spring - F_prop v -
    sign(v) (F_Coulomb + F_Stribeck exp(-fexp |v|)); where v reaches zero it sticks until the spring exceeds
    F_Coulomb + F_Stribeck.
    """
    middle = start("fixed.s0") + start("spring.s_rel0")
    c, m, scale = start("spring.c"), start("mass.m"), start("fricScale")
    viscous, coulomb, stribeck, steep = 1 / scale, 5 / scale, 10 / scale, start("mass.fexp")
    s, v = np.full(len(times), np.nan), np.full(len(times), np.nan)
    t, state, events = float(times[0]), [start("s0", "mass_s0"), start("v0", "mass.v")], []
    while t < times[-1]:
        force = -c * (state[0] - middle)
        if abs(force) <= coulomb + stribeck:  # stuck for good: nothing else moves the spring
            s[times >= t], v[times >= t] = state[0], 0.0
            break
        way = np.sign(force)

        def slopes(_: float, x: Floats, way: float = way) -> list[float]:
            friction = viscous * x[1] + way * (coulomb + stribeck * np.exp(-steep * abs(x[1])))
            return [x[1], (-c * (x[0] - middle) - friction) / m]

        def stops(at: float, x: Floats, way: float = way, since: float = t) -> float:
            return way * float(x[1]) if at > since + 1e-9 else 1.0

        stops.terminal, stops.direction = True, -1.0  # type: ignore[attr-defined]
        solution = solve_ivp(
            slopes, (t, times[-1]), state, method="DOP853", events=stops, dense_output=True, rtol=1e-12, atol=1e-14
        )
        inside = (times >= t) & (times <= solution.t[-1])
        assert solution.sol is not None
        s[inside], v[inside] = solution.sol(times[inside])
        t, state = float(solution.t[-1]), [float(solution.y[0, -1]), 0.0]
        if solution.status == 1:
            events.append(t)
    return Known({"mass.s": s, "mass.v": v}, events)


KNOWN: dict[str, Callable[[Start, Floats], Known]] = {
    "Dahlquist": exponential("x", "k", -1.0),
    "VanDerPol": van_der_pol,
    "BouncingBall": ball("h", "v", "g", "e", up=True, rest=0.1),
    "bouncingBall": ball("h", "v", "g", "e"),
    "BouncingBallFMI20": ball("h", "v", "g", "e"),
    "BouncingBall1D": ball("mass_s", "mass_v", "", "damping", floor="mass_radius"),
    "Stair": stair,
    "StateSpace": state_space,
    "Roberts": robertson,
    "HelloWorld": exponential("x", "a", 1.0),
    "HelloFMI20World": exponential("x", "a", 1.0),
    "SpringPendulum1D": spring_pendulum,
    "SpringFrictionPendulum1D": friction_pendulum,
    "FmuExportCrossCompile": ball("h", "v", "g", "e"),
    "Lin2DimODE": linear,
    "Modelica.Blocks.Sources.Sine": sine,
}
