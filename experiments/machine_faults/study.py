"""Which fault, and how large: short circuits and broken bars found in records of a machine in its windings.

    python -m experiments.machine_faults.study

Run from the project's folder; it rewrites draws.csv and sizes.png beside it and the tables in README.md.

Each draw has a healthy record of its own, from which the nominal parameters, their prior and the noise variance come. A
record in question is then diagnosed with short circuits of the stator and with broken bars as hypotheses.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import fmuid
from experiments import pages
from experiments.machine_faults import models
from experiments.machine_faults.machine import BARS, TURNS, bar_angle
from experiments.machine_faults.make_tables import CASES, add_noise, simulate, table
from experiments.pages import AMBER, BLUE, INK
from fmuid.diagnosis import EstimatedChange
from fmuid.reports.render.matplotlib_renderer import WIDTH, style

HERE = Path(__file__).parent

DRAWS = 10
HEALTHY_DRAWS = 50  # of each case without a fault: they show false alarms


def verdict(found: fmuid.Diagnosis) -> str:
    """Return ``none``, ``rotor``, ``stator a`` to ``stator c``, several joined by "or" or "and", or what else it is."""
    if found.kind in ("fault", "ambiguous"):
        each = (" and ".join(_short(change) for change in one.changes) for one in found.evidence.explanations)
        return " or ".join(each)
    return "none" if found.kind == "healthy" else found.kind


def _short(change: EstimatedChange) -> str:
    return "rotor" if change.fault == "rotor" else f"stator {change.variable[-1]}"


def row(found: fmuid.Diagnosis) -> dict[str, str | float]:
    """Return what draws.csv has of a diagnosis."""
    sizes, bars = {each[-1]: found[f"stator.{each}"] for each in models.RATIOS}, found["rotor.eta0"]
    statistics = {each.change.label: each.statistic for each in found.evidence.suspects}
    return {
        "verdict": verdict(found),
        "stator_D": max(value for label, value in statistics.items() if label.startswith("stator")),
        "rotor_D": statistics["rotor.eta0"],
        **{f"turns_{phase}": TURNS * size.value for phase, size in sizes.items()},
        **{f"std_{phase}": TURNS * size.std for phase, size in sizes.items()},
        **{"eta0": bars.value, "std_eta0": bars.std, "theta0": bars.angle_value},
        **{name: found.nominal[name][0] for name in ("Rs", "Rr")},
    }


def baseline(seed: int) -> fmuid.Baseline:
    """Return what a draw's healthy record says of the machine."""
    return models.healthy(add_noise(simulate(CASES["healthy"]), np.random.default_rng([seed, 1000])))


def draws() -> pd.DataFrame:
    """Return a row for each draw of each case."""
    rows = []
    for seed in range(HEALTHY_DRAWS):
        known = baseline(seed)
        for case, condition in CASES.items():
            if seed < DRAWS or not (condition.turns or condition.bars):
                rows.append({"case": case, "seed": seed, **row(models.diagnose(table(case, seed), known))})
        print(f"draw {seed}", flush=True)
    return pd.DataFrame(rows)


# ---- tables and figure


def words(case: str) -> str:
    """Return what a case is."""
    condition = CASES[case]
    warm = ", warm" if condition.warmth > 1 else ""
    if condition.turns:
        return f"{condition.turns} turn{'s' if condition.turns > 1 else ''} of {'abc'[condition.phase]}{warm}"
    if condition.bars:
        return f"{condition.bars} broken bar{'s' if condition.bars > 1 else ''}{warm}"
    return "warm: Rs and Rr 30 % up" if warm else "healthy"


def spread(values: pd.Series, digits: int = 2) -> str:
    """Return mean [least–most] of the draws; none is negative."""
    mean, least, most = (abs(round(each, digits)) for each in (values.mean(), values.min(), values.max()))
    return f"{mean:.{digits}f} [{least:.{digits}f}–{most:.{digits}f}]"


def summary(found: pd.DataFrame) -> str:
    """Return verdicts, statistics and mean turns of all cases as Markdown."""
    rows = []
    for case, part in found.groupby("case", sort=False):
        verdicts = ", ".join(f"{name}: {count}" for name, count in part["verdict"].value_counts().items())
        statistics = [f"{part[f'{fault}_D'].mean():.0f}" for fault in ("stator", "rotor")]
        turns = ["", ""]
        if CASES[str(case)].bars == 0:
            means = [round(part[f"turns_{phase}"].mean(), 2) + 0.0 for phase in "abc"]  # no minus zero
            turns = [", ".join(f"{mean:.2f}".replace("-", "−") for mean in means), f"{part['std_a'].mean():.2f}"]
        rows.append([words(str(case)), verdicts, *statistics, *turns])
    return pages.table(["case", "verdicts", "D, stator", "D, rotor", "turns of a, b, c", "std of one"], rows)


def rotor_table(found: pd.DataFrame) -> str:
    """Return size and angle of the broken bars as Markdown: mean [least–most]."""
    rows = []
    for case, part in found.groupby("case", sort=False):
        bars = CASES[str(case)].bars
        if CASES[str(case)].turns == 0:
            angles = [f"{bar_angle(bars):.2f}", spread(part["theta0"])] if bars else ["–", "–"]
            size = spread(part["eta0"], 3), f"{part['std_eta0'].mean():.4f}"
            rows.append([words(str(case)), f"{3 * bars / BARS:.3f}", *size, *angles])
    return pages.table(["case", "η₀ put in", "η₀", "std of one", "θ₀ put in (rad)", "θ₀ (rad)"], rows)


def tables(found: pd.DataFrame) -> dict[str, str]:
    """Return the tables of the page."""
    return {"verdicts": summary(found), "bars": rotor_table(found)}


def figure(found: pd.DataFrame) -> Figure:
    """Draw the sizes found against those put in."""
    with style():
        drawn = Figure(figsize=(WIDTH, 3.6), layout="constrained")
        turns, bars = drawn.subplots(1, 2)
        for phase, colour, aside in zip("abc", (BLUE, AMBER, INK), (-0.25, 0.0, 0.25), strict=True):
            _turns(turns, found, phase, colour, aside)
        turns.axhline(0.0, color=INK, lw=0.6)
        turns.set(xlabel="shorted turns of 464", ylabel="turns found in that phase, less those", title="Stator")
        turns.legend(ncols=3)
        part = found[[CASES[case].turns == 0 for case in found["case"]]]
        put = np.array([3 * CASES[case].bars / BARS for case in part["case"]])
        bars.errorbar(put, part["eta0"], 2 * part["std_eta0"], fmt="o", ms=3, lw=0.8, color=BLUE, label="± 2 std")
        bars.plot([0, 0.33], [0, 0.33], color=INK, lw=0.6)
        bars.set(xlabel="η₀ put in: 0 to 3 broken bars of 28", ylabel="η₀ found", title="Rotor")
        bars.legend()
    return drawn


def _turns(axes: Axes, found: pd.DataFrame, phase: str, colour: str, aside: float) -> None:
    """Draw by how much the turns found in a phase are wrong where that or none is faulty, beside the other phases."""
    number = "abc".index(phase)
    cases = [case for case in found["case"].unique() if CASES[case].bars == 0]
    part = found[found["case"].isin([c for c in cases if CASES[c].turns == 0 or CASES[c].phase == number])]
    put = np.array([CASES[case].turns for case in part["case"]])
    axes.errorbar(
        put + aside,
        part[f"turns_{phase}"] - put,
        2 * part[f"std_{phase}"],
        fmt="o",
        ms=3,
        lw=0.8,
        color=colour,
        label=f"{phase}, ± 2 std",
    )


def main() -> None:
    """Rewrite draws, figure, and the tables in README.md."""
    began = time.perf_counter()
    found = draws()
    print(f"{len(found)} records in {time.perf_counter() - began:.0f} s")
    found = pages.write(found, HERE / "draws.csv")  # as the page is checked against it
    pages.save(figure(found), HERE / "sizes.png")
    pages.rewrite(HERE, tables(found))


if __name__ == "__main__":
    main()
