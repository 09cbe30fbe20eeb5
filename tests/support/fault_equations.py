"""Equations of the fault models, of our own."""

from typing import Any

import numpy as np


def faulty_coil(x: Any, u: Any, p: Any) -> Any:
    """R and L of the healthy coil, and dR (1 + 2 tau s) in series: resistance and inductance add up."""
    resistance, inductance = p["R"] + p["dR"], p["L"] + 2 * p["tau"] * p["dR"]
    return np.array([(u[0] - resistance * x[0]) / inductance])


def towards(angle: Any) -> Any:
    """Q of docs/method/machine-faults.md."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c**2, c * s], [c * s, s**2]])


def short_circuit(_: Any, u: Any, p: Any) -> Any:
    """The sum over phases as it stands in docs/method/machine-faults.md."""
    there, back = rotation(u[2]), rotation(-u[2])
    ratios = zip("abc", (0, 2 * np.pi / 3, 4 * np.pi / 3), strict=True)
    return sum(2 / 3 * p[f"eta_{phase}"] / p["Rs"] * back @ towards(angle) @ there @ u[:2] for phase, angle in ratios)


def leaking_turns(x: Any, u: Any, p: Any) -> Any:
    """As `short_circuit_with_contact` with leakage, at some current of the healthy machine that changes at some rate.

    Unknown: the rates of the zero sequence and of the short circuits, the voltage of the star point, and the e.m.f.
    """
    ratios = np.array([p[f"eta_{phase}"] for phase in "abc"])
    park = park_of(u[2])
    healthy, rates, voltages = park.T @ np.array([1.3, -0.4]), park.T @ np.array([170.0, 60.0]), park.T @ u[:2]
    lines, right = np.zeros((8, 8), dtype=np.result_type(park, x)), np.zeros(8, dtype=np.result_type(park, x))
    zero, shorts, star, emf = 0, slice(1, 4), 4, slice(5, 8)
    lines[0, zero], lines[0, shorts] = 3, ratios
    drop = p["Rs"] * (healthy - ratios @ x / 3) + p["Lf"] * rates
    lines[1:4, emf], lines[1:4, star], lines[1:4, zero] = np.eye(3), 1, p["Lf"]
    right[1:4] = voltages - drop
    lines[4:7, emf], lines[4:7, zero] = np.eye(3), p["Lf"]
    lines[4:7, shorts] = -p["own"] * p["Lf"] * np.diag(1 - ratios)
    right[4:7] = p["Rs"] * (1 - ratios + p["contact"]) * x - drop
    lines[7, emf] = 1
    return np.linalg.solve(lines, right)[shorts]


def leaking_turns_currents(x: Any, u: Any, p: Any) -> Any:
    return park_of(u[2]) @ (np.array([p[f"eta_{phase}"] for phase in "abc"]) * x)


def park_of(theta: Any) -> Any:
    """Return the transform of phases to Park axes (2, 3)."""
    angles = theta - np.array([0, 2 * np.pi / 3, -2 * np.pi / 3])
    return np.sqrt(2 / 3) * np.array([np.cos(angles), -np.sin(angles)])


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


def coil_turns(x: Any, u: Any, p: Any) -> Any:
    """Resistance with the turns that are left, inductance with their square."""
    left = 1 - p["lost"]
    return np.array([(u[0] - p["R"] * left * x[0]) / (p["L"] * left**2)])


def short_circuit_with_contact(_: Any, u: Any, p: Any) -> Any:
    """Kirchhoff's laws of three phases, their shorted turns and the star point, at some current of the healthy machine.

    Unknown: the zero sequence of what makes flux, the currents of the short circuits, the voltage of the star point,
    and the e.m.f. of the three phases, whose sum is zero.
    """
    ratios = np.array([p[f"eta_{phase}"] for phase in "abc"])
    park = park_of(u[2])
    healthy, voltages = park.T @ np.array([1.3, -0.4]), park.T @ u[:2]
    lines, right = np.zeros((8, 8), dtype=park.dtype), np.zeros(8, dtype=park.dtype)
    zero, shorts, star, emf = 0, slice(1, 4), 4, slice(5, 8)
    lines[0, zero], lines[0, shorts] = 3, ratios  # the currents of the phases add up to nothing
    lines[1:4, emf], lines[1:4, star], lines[1:4, zero] = np.eye(3), 1, p["Rs"]
    right[1:4] = voltages - p["Rs"] * healthy
    contacts = p["contact"] * ratios * p["Rs"]
    lines[4:7, emf], lines[4:7, zero] = np.diag(ratios), ratios * p["Rs"]
    lines[4:7, shorts] = np.diag(ratios * p["Rs"] * (ratios - 1) - contacts)
    right[4:7] = -ratios * p["Rs"] * healthy
    lines[7, emf] = 1
    found = np.linalg.solve(lines, right)
    return park @ (found[zero] + ratios * found[shorts])


def mesh_resistance(p: Any) -> Any:
    """R_eq of a cage as a mesh of loops between bars: bars, pieces of both rings, and what the cracks add."""
    bars = round(complex(p["bars"]).real)
    step = np.roll(np.eye(bars), 1, axis=0)
    along = np.eye(bars) - step  # a bar's current is that of the loop on its one side less that on the other
    gamma = 2 * np.pi * p["p"] / bars
    at = p["theta0"] - np.pi / 2 + gamma * (np.arange(bars) + 0.5)  # a bar acts across the loops beside it
    axes = np.array([np.cos(at), np.sin(at)])
    extra = np.zeros(bars, dtype=np.array(list(p.values())).dtype)
    extra[0], extra[1] = (p[name] / (1 - p[name]) for name in ("crack0", "crack1"))

    def conductance(more: Any) -> Any:
        resistance = 2 * p["ring"] * np.eye(bars) + along.T @ np.diag(1 + more) @ along
        return axes @ np.linalg.solve(resistance, axes.T)

    return p["Rr"] * conductance(0 * extra)[0, 0] * np.linalg.inv(conductance(extra))


def cracked_bars(x: Any, u: Any, p: Any) -> Any:
    """As `broken_bars`, with the resistance of the mesh."""
    currents, phi, turn = x[:2], x[2:], np.array([[0, -1], [1, 0]])
    rates = mesh_resistance(p) @ (currents - phi / p["Lm"])
    whole = u[:2] - p["Rs"] * currents - u[2] * turn @ (p["Lf"] * currents + phi)
    return np.concatenate([(whole - rates) / p["Lf"], rates])
