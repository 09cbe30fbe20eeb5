"""Run experiments anew and rewrite their pages: data, figures, and tables between their comments.

    python -m experiments.regenerate [FOLDER...]     # all of them: half an hour on two cores, most of it machine_faults
    git diff --stat experiments                      # what moved

All draws have seeds. What is said around the tables is read again by eye. Not done here is what needs the files of
others (cascaded_tanks, emps, fmu_survey, nist), a machine without other work (benchmark.py, the campaigns of batches)
or an hour (interval_coverage.py, which prints its table; calls.py and onsets.py, which go on where they were).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from experiments import gallery, pages
from experiments.closed_loop_bias import study as closed_loop_bias
from experiments.coil import study as coil
from experiments.equation_error import study as equation_error
from experiments.induction_machine import chapter
from experiments.machine_faults import study as machine_faults
from experiments.simulation_error import campaign as simulation_error

HERE = Path(__file__).parent

BATCHES = {
    "monte_carlo": ("Estimates over all cases", "Fit (NRMSE)", "distributions.png"),
    "held": ("By setting", "Fit (NRMSE)", "over-1.png"),
}
"""Study to where begins and ends what the page shows of the command's words, and its figure."""


def fmuid(word: str, study: Path, output: str, *options: str) -> str:
    """Run a command on a study and return what it says."""
    command = [sys.executable, "-m", "fmuid", word, str(study), "--output", output, *options]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, encoding="utf-8").stdout


def induction_machine() -> None:
    """Rewrite what the chapter shows, and the figures of the identification."""
    chapter.main()
    folder = HERE / "induction_machine"
    with tempfile.TemporaryDirectory() as output:
        fmuid("identify", folder / "study.toml", output, "--no-report", "--figures", "png")
        for name in ("fit.png", "parameters.png"):
            shutil.copy(Path(output) / "figures" / name, folder / name)


def batches() -> None:
    """Rewrite what both batches say, and a figure of each."""
    folder, tables = HERE / "batches", {}
    for name, (first, end, figure) in BATCHES.items():
        with tempfile.TemporaryDirectory() as output:
            said = fmuid("batch", folder / f"{name}.toml", output, "--no-report", "--figures", "png")
            shutil.copy(Path(output) / "figures" / figure, folder / f"{name}.png")
        lines = said[said.index(first) : said.index(end)].rstrip().splitlines()
        tables[name] = "\n".join(f"    {line}".rstrip() for line in lines)
    pages.rewrite(folder, tables)


PAGES: dict[str, Callable[[], None]] = {
    "induction_machine": induction_machine,
    "batches": batches,
    "closed_loop_bias": closed_loop_bias.main,
    "coil": coil.main,
    "equation_error": equation_error.main,
    "gallery": gallery.main,
    "machine_faults": machine_faults.main,
    "simulation_error": simulation_error.main,
}


def main() -> None:
    """Rewrite the pages of the command line, or all."""
    for name in sys.argv[1:] or PAGES:
        if name not in PAGES:
            raise SystemExit(f"there is no page {name}: give some of {', '.join(PAGES)}")
        PAGES[name]()


if __name__ == "__main__":
    main()
