"""Sentences for people on what was found: the one place where they are made."""

from __future__ import annotations

from fmuid.estimation import Result
from fmuid.reports.words.result import capitalised, result_words


def describe(found: Result) -> str:
    """Say in words what was found, a sentence a line.

    Parameters
    ----------
    found : Result
        How its search ended and what the remedy is, what it leaves open, what its estimates do not show.
    """
    return "\n".join(map(capitalised, result_words(found)))
