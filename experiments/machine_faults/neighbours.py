"""Broken bars, by a model of the cage whose neighbouring bars take over their current.

    python -m experiments.machine_faults.neighbours

Run from the project's folder; it rewrites the table "neighbours" in README.md: tables of make_tables.py with broken
bars, identified by both models of a cage.
"""

from __future__ import annotations

from math import pi, sin
from pathlib import Path

import numpy as np

import fmuid
from experiments import pages
from experiments.machine_faults import models
from experiments.machine_faults.machine import BARS, POLE_PAIRS, RINGS
from experiments.machine_faults.make_tables import NOISE_VARIANCE, table

HERE = Path(__file__).parent
# The rings' share in the resistance of the cage as the model has it: a piece of one ring over a bar.
RING = RINGS / (1.0 - RINGS) * 2.0 * sin(pi * POLE_PAIRS / BARS) ** 2
CRACK, ANGLE = fmuid.Parameter(0.7, min=0.0, max=1.0), fmuid.Parameter(1.7, min=0.0, max=pi)
FITS: dict[str, tuple[str, dict[str, fmuid.Parameter], dict[str, float]]] = {
    "size and angle": ("InductionMachineRotorFault", {"eta0": fmuid.Parameter(0.1, min=0.0)}, {}),
    "one bar": ("InductionMachineBrokenBars", {"crack0": CRACK}, {"ring": RING, "crack1": 0.0}),
    "two bars": ("InductionMachineBrokenBars", {"crack0": CRACK, "crack1": CRACK}, {"ring": RING}),
}


def shown() -> str:
    """Return the page's table."""
    nominal = {name: fmuid.Parameter(value) for name, value in models.NOMINAL.items()}
    rows = []
    for bars in (1, 2):
        record = fmuid.Experiment(table(f"bars_{bars}"), models.INPUTS, models.OUTPUTS)
        for name, (model, sizes, held) in FITS.items():
            searched = nominal | sizes | {"theta0": ANGLE}
            found = fmuid.identify(
                fmuid.Problem(
                    fmuid.System(models.path(model)), record, searched, values=held, noise=fmuid.Noise(delay_std=0.0)
                )
            )
            said = ", ".join(f"{size} = {found[size]:.3f}" for size in sizes)
            left = np.mean(list(found.fit.noise_variance.values())) / NOISE_VARIANCE
            rows.append((bars, name, said, f"{found['theta0']:.2f}", f"{left:.3f}"))
    return pages.table(["broken", "fitted", "sizes", "θ₀ (rad)", "variance left / noise"], rows)


def main() -> None:
    """Rewrite the page's table."""
    pages.rewrite(HERE, {"neighbours": shown()})


if __name__ == "__main__":
    main()
