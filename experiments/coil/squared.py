"""Turns squared, and why a gain hides: what a fault model that is linear in the turns misses.

    python -m experiments.coil.squared

Run from the project's folder; it rewrites squared.csv and the tables "squared" and "hidden" in README.md. The data are
the closed form of a coil with (1 − η) R and (1 − η)² L, made without any FMU.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import special

import fmuid
from experiments import calls, pages
from experiments.coil import calls as coil
from experiments.coil import study
from fmuid.diagnosis import Causes
from fmuid.diagnosis.causes import SignalScale, coordinates_of
from fmuid.diagnosis.change_detection import MinPDistribution, detectable
from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix, ScoreStatistics
from fmuid.diagnosis.linearized_machine import LinearizedMachine

HERE = Path(__file__).parent
SHARES, DRAWS, SEED = (0.02, 0.05, 0.10, 0.25, -0.10), 50, 23
MODELS = {"linear": ("FaultyCoil", "dR", 0.5, {"tau": study.TAU}), "exact": ("CoilTurns", "lost", 0.1, {})}
GAIN = 0.03


def record(share: float) -> fmuid.Experiment:
    """Return a record without noise of the coil without a share of its turns."""
    current = study.current((1.0 - share) * study.R, (1.0 - share) ** 2 * study.L)
    frame = {"time": study.STEP * np.arange(study.SAMPLES), "u": study.voltage(), "i": current}
    return study.experiment(pd.DataFrame(frame))


def setting(kind: str) -> calls.Setting:
    """Return what the records of a fault model have in common; a case is a share of turns lost."""
    model, name, nominal, values = MODELS[kind]
    system, _ = study.models()
    known = {each: fmuid.Parameter(value, min=0.0) for each, value in (("R", study.R), ("L", study.L))}
    size = fmuid.Parameter(0.0, nominal=nominal)
    faults = {"turns": fmuid.Fault(study.FMUS / model / f"{model}.fmu", {name: size}, values=values)}
    coordinates = coordinates_of(system, known, faults, record(0.0), SignalScale({"i": coil.STD}), Causes())
    drift = np.zeros(len(coordinates.each))
    drift[:2] = coil.DRIFT["R"], coil.DRIFT["L"]

    def machine(case: str, new: bool) -> LinearizedMachine:
        return LinearizedMachine(system, {}, coordinates, record(float(case) if new else 0.0))

    def truth(case: str) -> dict[str, float]:
        return {f"turns.{name}": float(case) * (1.0 if kind == "exact" else -study.R)}

    return calls.Setting(
        coordinates, drift, coil.STD, machine, lambda case, _: (record(0.0), record(float(case))), truth, lambda _: 0.0
    )


def counted() -> pd.DataFrame:
    """Return what each model says of each share of turns in fresh records."""
    rows = []
    for kind, (_, name, _, _) in MODELS.items():
        campaign = calls.Campaign(setting(kind), HERE / "squared.csv")
        unit = 1.0 if kind == "exact" else -study.R
        for share in SHARES:
            for k in range(DRAWS):
                found = campaign.examined(f"{share:g}", np.random.default_rng([SEED, k]))
                mine = [each for each in found.naming.named if each.names == (f"turns.{name}",)]
                size, std = (mine[0].fit.sizes[0], mine[0].fit.covariance[0, 0] ** 0.5) if mine else (math.nan,) * 2
                first = " + ".join(found.naming.named[0].names) if found.naming.named else ""
                values = (100 * size / unit, 100 * std / abs(unit), found.evidence.ratio)
                rows.append((kind, 100 * share, k, first, *values))
    return pd.DataFrame(rows, columns=["model", "lost", "record", "first", "size", "std", "ratio"])


def squared_table(found: pd.DataFrame) -> str:
    """Return what the models say of turns, as Markdown."""
    heads = ["turns lost, %", "model", "named (%)", "said, %", "its std", "interval holds (%)"]
    rows = []
    for lost in (100.0 * np.array(SHARES)).tolist():
        for model in MODELS:
            part = found[np.isclose(found["lost"], lost) & (found["model"] == model)]
            said = part[part["size"].notna()]
            holds = calls.rate(((said["size"] - lost) / said["std"]).abs() <= float(special.ndtri(0.975)))
            size = f"{said['size'].mean():.2f}", f"{said['std'].mean():.2f}"
            rows.append((f"{lost:g}", model, calls.rate(part["size"].notna()), *size, holds))
    return pages.table(heads, rows)


def hidden_table() -> str:
    """Return how well a gain of the sensor is seen beside what else may be so, as Markdown."""
    common = coil.setting()
    coordinates = common.coordinates
    _, columns = common.machine("white noise", True).linearize(coordinates.healthy)
    said = InformationMatrix.of(columns[:, 0] / coil.STD, np.zeros(len(columns)))
    names, gain = [each.name for each in coordinates.each], next(c for c in coordinates.causes if c.name == coil.GAIN)
    drifts = {
        "nothing drifts": np.zeros(len(names)),
        "R drifts by 0.5 Ω": np.where(np.array(names) == "R", common.drift, 0.0),
        "R by 0.5 Ω and L by 1.3 %": common.drift,
    }
    rows = []
    for longer, label in ((1.0, "as long"), (10.0, "ten times")):
        healthy = ChangePrior.after(InformationMatrix(longer * said.matrix, longer * said.score), coordinates.normal)
        for text, drift in drifts.items():
            news = ScoreStatistics.of(said, healthy.drifting(drift))
            limit = MinPDistribution.of(news, coordinates.causes).limit(calls.LEVEL)
            own = float(news.part(gain.columns)[0][0, 0])
            seen = 1.0 - float(special.chndtr(special.chdtri(1, limit), 1, GAIN**2 * own))
            least = detectable(news, gain, limit, 0.1)
            rows.append((label, text, f"{100 * own**-0.5:.2f}", f"{100 * seen:.0f}", f"{100 * least:.1f}"))
    return pages.table(["healthy record", "", "std of a gain, %", "3 % called (%)", "called in 90 %, %"], rows)


def main() -> None:
    """Examine the records and rewrite the page's tables."""
    found = pages.write(counted(), HERE / "squared.csv", "%.5g")
    pages.rewrite(HERE, {"squared": squared_table(found), "hidden": hidden_table()})


if __name__ == "__main__":
    main()
