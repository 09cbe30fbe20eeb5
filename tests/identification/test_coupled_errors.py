"""Errors of the model of coupled FMUs, on records of scipy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import fmuid
from fmuid.array_types import Floats
from fmuid.identification import ErrorKind, find_model_errors
from tests.support.coupled_motor import MOTOR, coupled_motor

R, L, K, J, B = MOTOR.values()
STEP, COUNT = 0.002, 400


def recorded(dead: float, drift: float) -> pd.DataFrame:
    """Return a record of the motor; its inverter loses a voltage, its resistance rises by a share."""
    rng, times = np.random.default_rng(8), STEP * np.arange(COUNT)
    volts = 12.0 * np.repeat(rng.choice([-1.0, 0.0, 1.0], COUNT // 40), 40)

    def rates(u: float) -> Callable[[float, Floats], list[float]]:
        def of(t: float, x: Floats) -> list[float]:
            resistance = R * (1.0 + drift * (t / times[-1] - 0.5))
            return [(u - dead * np.tanh(x[0] / 0.05) - resistance * x[0] - K * x[1]) / L, (K * x[0] - B * x[1]) / J]

        return of

    found = [np.zeros(2)]
    for k in range(COUNT - 1):
        solved = solve_ivp(rates(float(volts[k])), (times[k], times[k + 1]), found[-1], rtol=1e-9, atol=1e-11)
        found.append(solved.y[:, -1])
    i, w = np.array(found).T + np.array([[0.05], [0.3]]) * rng.standard_normal((2, COUNT))
    return pd.DataFrame({"time": times, "u": volts, "i": i, "w": w})


@pytest.mark.parametrize(
    ("dead", "drift", "named"), [(0.0, 0.0, None), (0.6, 0.0, ErrorKind.DEAD_TIME), (0.0, 0.2, ErrorKind.DRIFT)]
)
def test_errors_of_a_coupled_motor(
    made: Callable[[str], Path], dead: float, drift: float, named: ErrorKind | None
) -> None:
    columns = {"winding.i": "i", "rotor.w": "w"}
    experiment = fmuid.Experiment(recorded(dead, drift), {"winding.u": "u"}, columns, interpolation="zoh")
    free = {name: fmuid.Parameter(1.2 * value, min=0.0) for name, value in MOTOR.items()}
    problem = fmuid.Problem(coupled_motor(made, STEP / 20), experiment, free)
    errors = find_model_errors(problem, fmuid.identify(problem, solver_check="off"))
    assert errors is not None
    assert errors.covers_dynamics
    first = errors.errors[0].test if errors.errors else None
    assert (None if first is None else first.direction.kind) is named
    if first is not None:
        assert first.size == pytest.approx(max(dead, drift), abs=3.0 * first.std)
