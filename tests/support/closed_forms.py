"""Closed forms and equations that several tests compare with."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray


def ball(t: float, g: float, e: float) -> tuple[float, int, float]:
    """Return height, number of bounces, and time of the last one, of a ball dropped from 1 m."""
    bounce = float(np.sqrt(2 / g))
    if t < bounce:
        return 1 - g * t**2 / 2, 0, 0.0
    speed, count = g * bounce * e, 1
    while bounce + 2 * speed / g < t:
        bounce, speed, count = bounce + 2 * speed / g, speed * e, count + 1
    return speed * (t - bounce) - g * (t - bounce) ** 2 / 2, count, bounce


def coil_response(
    times: NDArray[np.float64], u: NDArray[np.float64], R: float, L: float, linear: bool
) -> NDArray[np.float64]:
    """Closed form of L di/dt = u - R i, u held or linear between samples."""
    i = [0.0]
    for k in range(len(times) - 1):
        h = times[k + 1] - times[k]
        a = np.exp(-R / L * h)
        held = (1 - a) / R
        ramp = (h - L / R * (1 - a)) / (R * h) if linear and h else 0.0  # response to a rise of 1 within h
        i.append(a * i[-1] + held * u[k] + ramp * (u[k + 1] - u[k]))
    return np.array(i)


def park_rates(
    x: Iterable[float] | NDArray[np.float64], inputs: Sequence[float] | NDArray[np.float64], theta: Sequence[float]
) -> list[float]:
    """Rates of ids, iqs and the rotor fluxes of Park's machine under uds, uqs and w; theta is Rs, Rr, Lm, Lf."""
    d, q, fd, fq = x  # docs/method/induction-machine.md
    ud, uq, w = inputs
    Rs, Rr, Lm, Lf = theta
    return [
        (ud - (Rs + Rr) * d + w * Lf * q + Rr / Lm * fd + w * fq) / Lf,
        (uq - (Rs + Rr) * q - w * Lf * d + Rr / Lm * fq - w * fd) / Lf,
        Rr * d - Rr / Lm * fd,
        Rr * q - Rr / Lm * fq,
    ]
