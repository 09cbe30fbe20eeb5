"""The models that are fitted to a faulty machine, as today's `fmuid.Problem`: common mode with prior, fault free."""

from __future__ import annotations

from functools import cache
from math import pi
from pathlib import Path

import numpy as np
import pandas as pd

import fmuid

FMUS = Path(__file__).parents[2] / "fmus"

NOMINAL = {"Rs": 9.81, "Rr": 3.83, "Lm": 0.436, "Lf": 0.0762}
RATIOS = ("fault.eta_a", "fault.eta_b", "fault.eta_c")
INFLATION = {"Rs": 60.0, "Rr": 150.0, "Lm": 3.0, "Lf": 3.0}
"""By how much standard deviations of the healthy estimate grow: the temperature moves resistances, by 30 %."""

INPUTS = ("uds", "uqs", "w")


def path(model: str) -> Path:
    """Return the FMU of a model."""
    return FMUS / model / f"{model}.fmu"


@cache
def stator() -> fmuid.System:
    """Return the healthy machine and the short circuits beside it (figure 1.7), one name for what they share."""
    return fmuid.System(
        components={"machine": path("InductionMachine"), "fault": path("StatorShortCircuit")},
        connectors={
            **{name: [(f"{each}.{name}", 1.0, 0.0) for each in ("machine", "fault")] for name in ("uds", "uqs", "Rs")},
            **{name: [(f"machine.{name}", 1.0, 0.0)] for name in ("w", "Rr", "Lm", "Lf")},
            "theta": [("fault.theta", 1.0, 0.0)],
        },
    )


@cache
def healthy_machine() -> fmuid.System:
    """Return the healthy machine, loaded once."""
    return fmuid.System(path("InductionMachine"))


@cache
def rotor() -> fmuid.System:
    """Return the machine with broken bars."""
    return fmuid.System(path("InductionMachineRotorFault"))


def healthy(record: pd.DataFrame) -> fmuid.Result:
    """Identify a healthy machine from the data alone."""
    experiment = fmuid.Experiment(record, INPUTS, ("ids", "iqs"))
    parameters = {name: fmuid.Parameter(value) for name, value in NOMINAL.items()}
    return fmuid.identify(fmuid.Problem(healthy_machine(), experiment, parameters))


def common(known: fmuid.Result) -> dict[str, fmuid.Parameter]:
    """Return the nominal parameters with the inflated prior of the healthy estimate (1.66, 1.67)."""
    found = zip(known.names, known.values.tolist(), known.std.tolist(), strict=True)
    return {
        name: fmuid.Parameter(value, prior=fmuid.Normal(value, INFLATION[name] * std)) for name, value, std in found
    }


def noise(known: fmuid.Result) -> fmuid.Noise:
    """Return the noise variances of the healthy identification."""
    return fmuid.Noise(float(np.mean(list(known.noise_variance.values()))))


def nominal_fit(record: pd.DataFrame, known: fmuid.Result) -> fmuid.Result:
    """Identify the common mode alone: no fault."""
    experiment = fmuid.Experiment(record, INPUTS, ("ids", "iqs"))
    return fmuid.identify(fmuid.Problem(healthy_machine(), experiment, common(known), noise=noise(known)))


def stator_fit(record: pd.DataFrame, known: fmuid.Result, plain: fmuid.Result) -> fmuid.Result:
    """Identify the ratios of shorted turns of all three phases, free also to be negative, beside the common mode.

    Starts at the estimate without fault.
    """
    outputs = {f"machine.{name} + fault.{name}": name for name in ("ids", "iqs")}
    experiment = fmuid.Experiment(record, (*INPUTS, "theta"), outputs)
    parameters = common(known) | {name: fmuid.Parameter(0.0, nominal=0.01) for name in RATIOS}
    problem = fmuid.Problem(stator(), experiment, parameters, noise=noise(known))
    return fmuid.identify(problem, start=[*plain.values, 0.0, 0.0, 0.0])


def rotor_fit(record: pd.DataFrame, known: fmuid.Result, plain: fmuid.Result) -> fmuid.Result | None:
    """Identify size and angle of broken bars beside the common mode.

    Starts at the estimate without fault, off zero, where the angle means nothing, and from two angles at right angles;
    the better one counts. None where neither converges: the size ended at its bound 0.
    """
    experiment = fmuid.Experiment(record, INPUTS, ("ids", "iqs"))
    found = []
    for angle in (pi / 4, 3 * pi / 4):
        fault = {
            "eta0": fmuid.Parameter(0.03, min=0.0, max=1.4, nominal=0.1),
            "theta0": fmuid.Parameter(angle, nominal=1.0),
        }
        problem = fmuid.Problem(rotor(), experiment, common(known) | fault, noise=noise(known))
        result = fmuid.identify(problem, start=[*plain.values, 0.03, angle])
        if result.converged:
            found.append(result)
    return min(found, key=lambda result: result.criterion, default=None)
