"""The part of a page that shows what was done with tables before they were experiments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fmuid.formatting import listed
from fmuid.reports.interactive.preparation import preparation
from fmuid.reports.interactive.style import MAX_EXPERIMENTS
from fmuid.reports.page.document import Section
from fmuid.runs import PreprocessedTable

CAPTION = (
    "Grey is what was recorded, blue what the model is driven by and compared with. Columns that stay as they were "
    "are not drawn."
)
"""How to read it."""


def sections(done: Sequence[PreprocessedTable], name: str = "preparation") -> list[Section]:
    """Return a section for each experiment whose table was prepared; of more than are drawn, of the first.

    Parameters
    ----------
    done : sequence of PreprocessedTable
    name : str
        Of the sections.
    """
    shown: list[Section] = []
    for each in done:
        if not each.words or not len(each.table) or len(shown) == MAX_EXPERIMENTS:
            continue
        heading = "What was done with the table first" + (f": {each.experiment}" if len(done) > 1 else "")
        caption = f"{preparation_words(each.words)}." + ("" if shown else f" {CAPTION}")
        anchor = name if not shown else f"{name}-{len(shown) + 1}"
        shown.append(Section(anchor, heading, caption, [preparation(each.table, each.units)], 1))
    return shown


def preparation_words(words: Mapping[str, Any]) -> str:
    """Say what was done with a table, by the words of ``[experiments.preprocess]`` that are not their defaults."""
    done = list(_done(words))
    return f"The table was {listed(done)}" if done else "The table was left as it is"


def _done(words: Mapping[str, Any]) -> Iterator[str]:
    if words.get("computed_columns"):
        yield f"given the columns {', '.join(f'{name} = {text}' for name, text in words['computed_columns'].items())}"
    if words.get("fill_missing"):
        gap = f" of at most {words['max_gap']:g} s" if words.get("max_gap") else ""
        yield f"filled over gaps{gap} ({', '.join(f'{name}: {how}' for name, how in words['fill_missing'].items())})"
    for each in words.get("park", ()):
        yield f"turned from {', '.join(each['source'])} to {', '.join(each['target'])}"
    if "lowpass_frequency" in words:
        yield f"low-passed at {words['lowpass_frequency']:g} Hz, without a shift in time"
    ends = {"from": "start_time", "to": "end_time"}
    if cut := [f"{word} {words[key]:g} s" for word, key in ends.items() if key in words]:
        yield f"cut {' '.join(cut)}"
    if "resample_interval" in words:
        yield f"resampled in steps of {words['resample_interval']:g} s"
    if "detrend" in words:
        given = words["detrend"]
        each = ", ".join(f"{name}: {how}" for name, how in given.items()) if isinstance(given, dict) else given
        yield f"detrended ({each})"
