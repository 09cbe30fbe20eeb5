"""Pictures of docs/gallery.md and docs/index.md, from real runs: ``python -m experiments.regenerate gallery``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

import fmuid
from fmuid.formatting import with_std
from fmuid.reports.render.style import COLORS

AMBER, BLUE, GREY, INK = (COLORS["amber"], COLORS["blue"], COLORS["grey"], COLORS["ink"])

HERE = Path(__file__).parent
PICTURES = HERE.parent / "docs" / "pictures"
COIL = HERE / "coil"
# Wide enough for a page, with few enough colours to stay small.
WIDTH, COLOURS = 1000, 64


def main() -> None:
    """Draw all pictures anew."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        landing(Path(folder))
        _identified(Path(folder))
        _diagnosed(Path(folder))


def landing(folder: Path) -> None:
    """Draw what fmuid does: a record and two simulations of it, and what is known of each parameter after."""
    record = fmuid.datasets.induction_machine()
    problem = record.problem()
    result = fmuid.identify(problem)
    simulator = fmuid.Simulator(record.fmu, record.experiment, parameters=list(record.parameters))
    start, found = simulator([result.estimates.start, result.values])
    figure = Figure(figsize=(9.2, 3.4), dpi=110, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    times = record.table["time"]
    left.plot(times, record.table["ids"], ".", color=GREY, markersize=3.5, label="measured")
    left.plot(times, start[:, 0], "--", color=AMBER, linewidth=1.2, label="simulated at the start")
    left.plot(times, found[:, 0], color=BLUE, linewidth=1.2, label="at the estimate")
    left.set(xlabel="time (s)", ylabel="ids (A)", title="A table and an FMU ...", xlim=(0.0, 0.3))
    left.legend(frameon=False, fontsize=8.5, loc="upper right")
    right.set(title="... become parameters", xlim=(0, 1), ylim=(0, 1))
    right.set_axis_off()
    for i, name in enumerate(result.names):
        each = result[name]
        unit = {"Ohm": "Ω"}.get(each.unit or "", each.unit)
        right.text(0.02, 0.82 - 0.24 * i, name, fontsize=14, color=INK, weight="bold")
        right.text(0.17, 0.82 - 0.24 * i, f"{with_std(each.value, each.std)} {unit}", fontsize=14, color=BLUE)
        right.text(0.17, 0.74 - 0.24 * i, f"the search began at {each.start:g}", fontsize=9, color=GREY)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(folder / "landing.png")
    _keep(folder / "landing.png", "landing")


def _identified(folder: Path) -> None:
    """Draw an identification with its profiles, posterior and map."""
    asked = ["uncertainty.profile_likelihood=true", "uncertainty.posterior=true", 'uncertainty.cost_map=[["Rs","Lf"]]']
    study = HERE / "induction_machine" / "study.toml"
    _run("identify", study, folder / "machine", *(word for each in asked for word in ("--set", each)))
    for name in ("fit", "parameters", "cost", "residuals", "profiles", "posterior", "maps"):
        _keep(folder / "machine" / "figures" / f"{name}.png", name)


def _diagnosed(folder: Path) -> None:
    """Draw the diagnosis of a coil that has lost turns."""
    _run("identify", COIL / "healthy.toml", folder / "healthy")
    healthy = f"diagnosis.baseline={folder / 'healthy' / 'result.json'}"
    _run("diagnose", COIL / "test.toml", folder / "coil", "--set", healthy)
    for drawn in sorted((folder / "coil" / "figures").glob("*.png")):
        _keep(drawn, drawn.stem)


def _run(word: str, study: Path, output: Path, *options: str) -> None:
    """Run a command that draws; a fault that is found is no failure."""
    command = [sys.executable, "-m", "fmuid", word, str(study), "-o", str(output), "--no-report", "--figures", "png"]
    if subprocess.run([*command, *options], stdout=subprocess.DEVNULL, check=False).returncode > 1:
        raise SystemExit(f"fmuid {word} {study} failed")


def _keep(drawn: Path, name: str) -> None:
    """Keep a picture, small: no wider than a page, of few colours."""
    with Image.open(drawn) as picture:
        small = picture.convert("RGB")
        small.thumbnail((WIDTH, 4 * WIDTH))
        small.quantize(COLOURS, dither=Image.Dither.NONE).save(PICTURES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
