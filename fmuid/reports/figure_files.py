"""What a run has drawn into a folder: the formats there are, and what a new run takes away."""

from __future__ import annotations

from pathlib import Path

from fmuid.errors import InputError

FORMATS = ("png", "svg", "pdf")
"""Of figures for print."""
REPORT_FILE = "report.html"
# What the figures of a run are called, before a hyphen where there are several of a kind.
KINDS = """
fit preparation prepared monitored residuals parameters criterion optima belief parabolas correlation accuracy profiles
maps posterior walkers causes changes evidence sizes explained timeline cases distributions spread over starts failures
prediction criteria errors estimates excitations sensitivities
""".split()  # noqa: SIM905  # as a list a line each


def check_format(figures: str | None) -> None:
    """Check the format of figures for print.

    Raises
    ------
    InputError
        If there is no such format.
    """
    if figures is not None and figures not in FORMATS:
        raise InputError(f"figures are drawn as {', '.join(FORMATS)}, not {figures!r}")


def clear_figures(folder: Path) -> None:
    """Remove the figures of an earlier run, which would be taken for this one's; what else is there stays."""
    for old in folder.glob("*.*"):
        if old.suffix.lstrip(".") in FORMATS and old.stem.split("-")[0] in KINDS:
            old.unlink()
