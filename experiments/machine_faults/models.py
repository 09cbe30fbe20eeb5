"""What a record is compared with: the healthy machine, as a record of it shows it, and the models of its faults."""

from __future__ import annotations

from functools import cache
from math import pi
from pathlib import Path

import pandas as pd

import fmuid

FMUS = Path(__file__).parents[2] / "fmus"

NOMINAL = {"Rs": 9.81, "Rr": 3.83, "Lm": 0.436, "Lf": 0.0762}
RATIOS = ("fault.eta_a", "fault.eta_b", "fault.eta_c")
INFLATION = {"Rs": 60.0, "Rr": 150.0, "Lm": 3.0, "Lf": 3.0}
"""By how much standard deviations of the healthy estimate grow: the temperature moves resistances, by 30 %."""

INPUTS, OUTPUTS = ("uds", "uqs", "w"), ("ids", "iqs")


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
def faults() -> dict[str, fmuid.Fault]:
    """Return what may be wrong: short circuits, a ratio a phase, free also to be negative; broken bars."""
    ratios = {name: fmuid.Parameter(0.0, nominal=0.01) for name in RATIOS}
    own = {name: f"machine.{name} + fault.{name}" for name in OUTPUTS}
    rotor = fmuid.System(path("InductionMachineRotorFault"))
    size = fmuid.Parameter(0.0, min=0.0, max=1.4, nominal=0.1)
    angle = fmuid.Parameter(0.0, min=0.0, max=pi, nominal=1.0)
    return {
        "stator": fmuid.Fault(stator(), ratios, own, inputs={"theta": "theta"}),
        "rotor": fmuid.Fault(rotor, {"eta0": size, "theta0": angle}, angles=["theta0"]),
    }


def healthy(record: pd.DataFrame) -> fmuid.Baseline:
    """Identify a healthy machine from the data alone; return what it says, with room for other temperatures."""
    parameters = {name: fmuid.Parameter(value) for name, value in NOMINAL.items()}
    experiment = fmuid.Experiment(record, INPUTS, OUTPUTS)
    return fmuid.Baseline(
        fmuid.identify(fmuid.Problem(healthy_machine(), experiment, parameters, noise=fmuid.Noise(delay_std=0.0))),
        INFLATION,
    )


def diagnose(record: pd.DataFrame, known: fmuid.Baseline) -> fmuid.Diagnosis:
    """Look for both faults in a record."""
    return fmuid.diagnose(fmuid.Experiment(record, INPUTS, OUTPUTS), known, faults(), healthy_machine())
