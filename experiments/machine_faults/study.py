"""Which fault, and how large: short circuits and broken bars found in records of a machine in its windings.

    python -m experiments.machine_faults.study

Run from the project's folder; it rewrites draws.csv and sizes.png beside it and the tables in README.md.

Each draw has a healthy record of its own, from which the nominal parameters, their prior and the noise variance come. A
record in question is then fitted three times: common mode alone, with short circuits of the stator, with broken bars.
"""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

import fmuid
from experiments.machine_faults import models
from experiments.machine_faults.machine import BARS, TURNS, bar_angle
from experiments.machine_faults.make_tables import CASES, add_noise, simulate
from fmuid.arrays import Floats
from fmuid.reports.figures.style import AMBER, BLUE, DPI, INK, WIDTH, style

HERE = Path(__file__).parent

DRAWS = 10
HEALTHY_DRAWS = 50  # of each case without a fault: they show false alarms
FALSE_ALARM = 0.01  # both hypotheses together, half of it each (Bonferroni)


@dataclass(frozen=True)
class Finding:
    """The three fits of a record, and what they say; `rotor` is None where broken bars do not explain anything."""

    plain: fmuid.Result
    stator: fmuid.Result
    rotor: fmuid.Result | None

    @property
    def gains(self) -> tuple[float, float]:
        """By how much a fault of the stator and one of the rotor lower the compound criterion (1.68)."""
        rotor = self.rotor.criterion if self.rotor else self.plain.criterion
        return self.plain.criterion - self.stator.criterion, self.plain.criterion - rotor

    @property
    def turns(self) -> tuple[Floats, Floats]:
        """Shorted turns of the phases a, b, c (3,), and their standard deviations."""
        places = [self.stator.names.index(name) for name in models.RATIOS]
        return TURNS * self.stator.values[places], TURNS * self.stator.std[places]

    @property
    def bars(self) -> dict[str, float]:
        """``eta0`` and ``theta0`` in [0, pi) of the broken bars, and ``std_eta0``; no angle where there is no size."""
        if self.rotor is None:
            return {"eta0": 0.0, "std_eta0": np.nan, "theta0": np.nan}
        size, angle = (self.rotor.names.index(name) for name in ("eta0", "theta0"))
        values = self.rotor.values
        return {"eta0": values[size], "std_eta0": self.rotor.std[size], "theta0": values[angle] % pi}

    @property
    def verdict(self) -> str:
        """``none``, ``stator a`` to ``stator c``, or ``rotor``."""
        return verdict(*self.gains, self.turns[0])

    @property
    def best(self) -> fmuid.Result:
        """The fit that the verdict is for."""
        if self.rotor is not None and self.verdict == "rotor":
            return self.rotor
        return self.plain if self.verdict == "none" else self.stator


def verdict(stator_gain: float, rotor_gain: float, turns: Floats) -> str:
    """Return ``none``, ``stator a`` to ``stator c``, or ``rotor``.

    Twice the logarithm of the likelihood ratio of a fault that is not there follows chi square, with as many degrees of
    freedom as the fault has parameters. Of two faults above their thresholds the one further above is named, of the
    phases that with the largest ratio.
    """
    level = 1 - FALSE_ALARM / 2
    stator, rotor = stator_gain - chi2.ppf(level, 3), rotor_gain - chi2.ppf(level, 2)
    if max(stator, rotor) <= 0:
        return "none"
    return f"stator {'abc'[int(np.argmax(turns))]}" if stator > rotor else "rotor"


def examine(record: pd.DataFrame, known: fmuid.Result) -> Finding:
    """Fit a record without fault and with either fault.

    Raises
    ------
    RuntimeError
        If a search does not converge; that for broken bars may end at size 0.
    """
    plain = models.nominal_fit(record, known)
    found = Finding(plain, models.stator_fit(record, known, plain), models.rotor_fit(record, known, plain))
    for result in (found.plain, found.stator):
        if not result.converged:
            raise RuntimeError(f"the search did not converge: {fmuid.describe(result)}")
    return found


def draws() -> pd.DataFrame:
    """Return a row for each draw of each case."""
    clean = {case: simulate(condition) for case, condition in CASES.items()}
    rows = []
    for seed in range(HEALTHY_DRAWS):
        known = models.healthy(add_noise(clean["healthy"], np.random.default_rng([seed, 1000])))
        for number, (case, condition) in enumerate(CASES.items()):
            if seed >= DRAWS and (condition.turns or condition.bars):
                continue
            found = examine(add_noise(clean[case], np.random.default_rng([seed, number])), known)
            (turns, turns_std), best = found.turns, found.best
            rows.append(
                {
                    "case": case,
                    "seed": seed,
                    "verdict": found.verdict,
                    **dict(zip(("stator_gain", "rotor_gain"), found.gains, strict=True)),
                    **dict(zip(("turns_a", "turns_b", "turns_c"), turns.tolist(), strict=True)),
                    **dict(zip(("std_a", "std_b", "std_c"), turns_std.tolist(), strict=True)),
                    **found.bars,
                    **{name: best.values[best.names.index(name)] for name in ("Rs", "Rr")},
                }
            )
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


def spread(values: pd.Series) -> str:
    """Return mean (least to most) of the draws."""
    mean, least, most = (round(each, 2) + 0.0 for each in (values.mean(), values.min(), values.max()))  # no minus zero
    return f"{mean:.2f} ({least:.2f} to {most:.2f})".replace("-", "−")


def summary(found: pd.DataFrame) -> str:
    """Return the verdicts and the gains of all cases as Markdown."""
    lines = [
        "| case | draws | verdicts | gain, stator | gain, rotor | Rs (Ω) | Rr (Ω) |",
        "|---|---|---|---|---|---|---|",
    ]
    for case, part in found.groupby("case", sort=False):
        counts = part["verdict"].value_counts()
        verdicts = ", ".join(f"{name}: {count}" for name, count in counts.items())
        gains = [f"{part[f'{fault}_gain'].mean():.0f}" for fault in ("stator", "rotor")]
        means = [f"{part[name].mean():.2f}" for name in ("Rs", "Rr")]
        lines.append("| " + " | ".join([words(str(case)), str(len(part)), verdicts, *gains, *means]) + " |")
    return "\n".join(lines)


def stator_table(found: pd.DataFrame) -> str:
    """Return the shorted turns of the phases as Markdown: mean (least to most)."""
    lines = ["| case | phase a | phase b | phase c | std of one |", "|---|---|---|---|---|"]
    for case, part in found.groupby("case", sort=False):
        if CASES[str(case)].bars == 0:
            cells = [spread(part[f"turns_{phase}"]) for phase in "abc"]
            lines.append("| " + " | ".join([words(str(case)), *cells, f"{part['std_a'].mean():.2f}"]) + " |")
    return "\n".join(lines)


def rotor_table(found: pd.DataFrame) -> str:
    """Return size and angle of the broken bars as Markdown: mean (least to most)."""
    lines = ["| case | η₀ put in | η₀ | std of one | θ₀ put in (rad) | θ₀ (rad) |", "|---|---|---|---|---|---|"]
    for case, part in found.groupby("case", sort=False):
        bars = CASES[str(case)].bars
        if CASES[str(case)].turns == 0:
            put = [f"{3 * bars / BARS:.3f}", f"{bar_angle(bars):.2f}" if bars else "–"]
            size = f"{part['eta0'].mean():.3f} ({part['eta0'].min():.3f} to {part['eta0'].max():.3f})"
            angle = spread(part["theta0"]) if bars else "–"
            cells = [words(str(case)), put[0], size, f"{part['std_eta0'].mean():.4f}", put[1], angle]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def insert(page: str, tables: dict[str, str]) -> str:
    """Return a page with each table between its comments, ``<!-- name -->`` and ``<!-- end of name -->``."""
    for name, table in tables.items():
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        page = re.sub(f"(?<={begin}\n).*(?={end})", table + "\n", page, flags=re.DOTALL)
    return page


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
    found.to_csv(HERE / "draws.csv", index=False, float_format="%.6g", lineterminator="\n")
    drawn = figure(found)
    with style():
        drawn.savefig(HERE / "sizes.png", dpi=DPI)
    readme = HERE / "README.md"
    tables = {"verdicts": summary(found), "turns": stator_table(found), "bars": rotor_table(found)}
    readme.write_text(insert(readme.read_text(encoding="utf-8"), tables), encoding="utf-8")


if __name__ == "__main__":
    main()
