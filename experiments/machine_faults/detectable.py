"""The smallest short circuit that is called: one test of all phases, and causes each by itself beside a healthy record.

    python -m experiments.machine_faults.detectable

Run from the project's folder; it rewrites the table "detectable" in README.md. In the linearized model, over a record
in phases as calls.py has them: what the information of a record and of the healthy one allows, without simulated noise.
"""

from __future__ import annotations

import math
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from experiments import pages
from experiments.machine_faults import calls, models
from experiments.machine_faults.machine import TURNS
from fmuid.array_types import Floats
from fmuid.diagnosis.causes import Cause, CauseKind
from fmuid.diagnosis.change_detection import MinPDistribution, detectable
from fmuid.diagnosis.information_matrix import ChangePrior, InformationMatrix, ScoreStatistics

HERE = Path(__file__).parent
LEVEL, MISS = 0.01, 0.1
LENGTHS = (math.inf, 100.0, 10.0, 3.0, 1.0)  # of the healthy record, in lengths of the new one
DRAWS, SEED = 20_000, 1


def fallen(scores: Floats, information: Floats) -> Floats:
    """Return by how much sizes that are not negative lower the criterion, for each score (draws, k)."""
    best = np.zeros(len(scores))
    for count in range(1, len(information) + 1):
        for kept in map(list, combinations(range(len(information)), count)):
            mine = scores[:, kept]
            sizes = mine @ np.linalg.inv(information[np.ix_(kept, kept)])
            best = np.maximum(best, np.where(np.all(sizes >= 0, axis=1), np.sum(sizes * mine, axis=1), 0.0))
    return best


def together(news: ScoreStatistics, columns: list[int], level: float) -> float:
    """Return the size of the first of some coordinates, none negative, that one test of all calls in 90 %."""
    information, _ = news.part(columns)
    noise = np.random.default_rng(SEED).standard_normal((DRAWS, len(columns))) @ np.linalg.cholesky(information).T
    threshold = float(np.quantile(fallen(noise, information), 1.0 - level))

    def missed(size: float) -> float:
        return float(np.mean(fallen(noise + size * information[0], information) < threshold)) - MISS

    std = information[0, 0] ** -0.5
    return float(brentq(missed, std, 9.0 * std, xtol=1e-3 * std))


def shown() -> str:
    """Return the page's table."""
    setting = calls.setting()
    coordinates = setting.coordinates
    _, columns = setting.machine("white noise", True).linearize(coordinates.healthy)
    white = columns.reshape(-1, columns.shape[-1]) / calls.STD
    zero = np.zeros(white.shape[1])
    said = InformationMatrix(white.T @ white, zero)
    own = coordinates.of(CauseKind.PARAMETER)
    spread = np.zeros(len(zero))
    spread[own] = np.sqrt(np.diag(np.linalg.inv(said.matrix[np.ix_(own, own)]))) * list(models.INFLATION.values())
    each = {cause.name: cause for cause in coordinates.causes}
    ratios = [each[f"stator.{name}"] for name in models.RATIOS]
    earlier = ScoreStatistics.of(said, ChangePrior(zero, np.diag(spread**2)))
    base = together(earlier, [cause.columns[0] for cause in ratios], LEVEL / 2)
    rows = []

    def add(name: str, length: str, news: ScoreStatistics, limit: float, size: float) -> None:
        std = TURNS * news.part(ratios[0].columns)[0][0, 0] ** -0.5
        rows.append((name, length, f"{std:.3f}", f"{limit:.1e}", f"{TURNS * size:.2f}", f"{size / base:.2f}"))

    add("three ratios in one test, bars in another", "its result, inflated", earlier, LEVEL / 2, base)
    named: dict[str, list[Cause]] = {
        "one phase and nothing else": ratios[:1],
        "phases and bars": [*ratios, each["rotor.eta0"]],
        f"all {len(each)}": list(coordinates.causes),
    }
    for name, causes in named.items():
        for length in LENGTHS if len(causes) == len(each) else LENGTHS[:1]:
            sure = np.zeros_like(said.matrix)
            longer = InformationMatrix(length * said.matrix, zero) if math.isfinite(length) else None
            known = ChangePrior(zero, sure) if longer is None else ChangePrior.after(longer, coordinates.normal)
            news = ScoreStatistics.of(said, known.drifting(setting.drift))
            limit = LEVEL if len(causes) == 1 else MinPDistribution.of(news, causes).limit(LEVEL)
            size = detectable(news, ratios[0], limit, MISS)
            add(name, "endless" if longer is None else f"{length:.0f} times", news, limit, size)
    heads = ["causes", "healthy record", "std of one phase, turns", "p of one cause", "called in 90 %, turns", "times"]
    return pages.table(heads, rows)


def main() -> None:
    """Rewrite the page's table."""
    pages.rewrite(HERE, {"detectable": shown()})


if __name__ == "__main__":
    main()
