"""EMPS in open loop: the recorded voltage drives a plant that integrates, and only its position is measured.

    FMUID_EMPS_DATA=/where/it/is/DATA_EMPS.mat python -m experiments.emps.open_loop

rewrites the table of README.md. An observer keeps the simulation with the record
(`fmuid.identification.with_observer`), the slower the weaker; without one the
parameters are pulled to where the drift is least.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.io import loadmat

import fmuid
from experiments import pages
from fmuid.identification import with_observer

HERE = Path(__file__).parent
DRIVE = HERE.parents[1] / "fmus" / "PositionDrive" / "PositionDrive.fmu"
PUBLISHED = {"M": 95.1089, "Fv": 203.5034, "Fc": 20.3935, "offset": -3.1648}
STARTS = {"M": 40.0, "Fv": 80.0, "Fc": 50.0, "offset": 5.0}
SAMPLES = (3.0, 10.0, 30.0, 100.0)


def problem(frame: pd.DataFrame, starts: dict[str, float]) -> fmuid.Problem:
    """Return the drive alone, from the voltage to the position."""
    experiment = fmuid.Experiment(frame, ["v"], ["q"], interpolation="zoh")
    least = {"M": 1.0, "Fv": 0.0, "Fc": 0.0, "offset": -np.inf}
    parameters = {
        name: fmuid.Parameter(start, min=least[name], nominal=1.0 if name == "offset" else None)
        for name, start in starts.items()
    }
    system = fmuid.System(DRIVE, numerics=fmuid.Numerics("model-exchange"))
    return fmuid.Problem(system, experiment, parameters, values={"q_start": float(frame["q"].iloc[0])})


def row(name: str, result: fmuid.Result) -> tuple[str, ...]:
    """Return a row of the table: estimates, how far they are from the published values, residual, simulations."""
    cells = [f"{result[each]:.4g} ({100.0 * (result[each] / value - 1.0):+.1f} %)" for each, value in PUBLISHED.items()]
    residual = 1e6 * float(np.sqrt(result.fit.noise_variance["q"]))
    return name, *cells, f"{residual:.3g}", f"{result.history.simulations}"


def main() -> None:
    """Fit with observers of several horizons and with none; print and write the table."""
    data = loadmat(os.environ.get("FMUID_EMPS_DATA", HERE / "DATA_EMPS.mat"))
    frame = pd.DataFrame({"time": data["t"].ravel(), "v": data["vir"].ravel(), "q": data["qm"].ravel()}, dtype=float)
    rows: list[tuple[str, ...]] = [("published", *(f"{value:.4g}" for value in PUBLISHED.values()))]
    starts = STARTS
    for samples in SAMPLES:
        result = fmuid.identify(with_observer(problem(frame, STARTS), samples))
        rows.append(row(f"{samples:g} ms", result))
        starts = dict(zip(result.names, result.values.tolist(), strict=True))
    rows.append(row("none: output error", fmuid.identify(problem(frame, starts), restart=False)))
    heads = ["observer", "M (kg)", "F_v (N s/m)", "F_c (N)", "offset (N)", "residual (µm)", "simulations"]
    pages.rewrite(HERE, {"open_loop": pages.table(heads, rows)})


if __name__ == "__main__":
    main()
