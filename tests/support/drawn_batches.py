"""Tables of batches with drawn estimates."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from fmuid import Document
from fmuid.reports.render.console import show
from fmuid.reports.topics.batch import state_of, summary_remarks
from fmuid.reports.topics.batch_tables import noted, tables_of
from fmuid.runs import EstimateWarning, Summary

Array = npt.NDArray[np.float64]

TRUTH = {"R": 4.0, "L": 0.1}
UNITS = {"R": "Ohm", "L": "H", "N": "1"}
STD = {"R": 0.05, "L": 0.002}


def batch(
    settings: Mapping[str, object], spread: float = 1.0, seed: int = 7, noise: Array | float = 0.01, cases: int = 0
) -> pd.DataFrame:
    """Return the frame of a batch whose estimates scatter around the truth by `spread` times their stated std."""
    rng = np.random.default_rng(seed)
    cases = cases or max(len(np.atleast_1d(np.asarray(column))) for column in settings.values())
    frame = pd.DataFrame({"case": np.arange(cases), **settings, "status": "converged", "message": "converged"})
    for name, true in TRUTH.items():
        scatter = rng.normal(size=cases)
        if cases > 2:  # exactly centred and scaled, so that the words to expect are known
            scatter = (scatter - scatter.mean()) / scatter.std(ddof=1)
        frame[f"value.{name}"] = true + spread * STD[name] * scatter
    for name, std in STD.items():
        frame[f"std.{name}"] = std
    return frame.assign(**{"noise.i": noise, "cost": 1000.0, "iterations": 5, "simulations": 30, "rejected": 0})


def fail(frame: pd.DataFrame, rows: list[int], messages: list[str], status: str = "failed") -> pd.DataFrame:
    """Return the frame with failed cases."""
    frame = frame.copy()
    estimated = [str(name).startswith(("value.", "std.", "noise.", "cost")) for name in frame]
    frame.loc[rows, estimated] = np.nan
    frame.loc[rows, "status"], frame.loc[rows, "message"] = status, messages
    return frame


def show_batch(summary: Summary) -> None:
    """Print the tables and sentences of a summary."""
    tone, state = state_of(summary)
    show(Document("batch", "Batch", state, tone, tuple(summary_remarks(summary)), tuple(tables_of(summary))))


def summary_words(summary: Summary) -> list[str]:
    """Return what the numbers of a batch mean."""
    return [each.text for each in summary_remarks(summary)]


def row(summary: Summary, name: str) -> Mapping[Any, Any]:
    """Return the row of one parameter."""
    (found,) = noted(summary.parameters[summary.parameters["parameter"] == name]).to_dict("records")
    return found


def doubts(table: pd.DataFrame, name: str) -> list[tuple[EstimateWarning, ...]]:
    """Return what is doubted of one parameter, a tuple a row."""
    found: list[tuple[EstimateWarning, ...]] = table.loc[table["parameter"] == name, "doubts"].tolist()
    return found


# --- starts


def starts() -> pd.DataFrame:
    """Return two data sets with ten starts each; small starts end elsewhere, where the noise looks larger."""
    begin = np.tile(np.linspace(0.5, 9.5, 10), 2)
    draw = np.repeat([0, 1], 10)
    elsewhere = begin < 3.0
    frame = batch({"start.R": begin, "draw": draw}, spread=0.0, noise=np.where(elsewhere, 0.04, 0.01))
    frame["value.R"] = np.where(elsewhere, 2.0, 4.0 + 0.1 * draw)
    # estimated variances: the cost of each search is measured with variances of its own
    frame["cost"] = np.where(elsewhere, 10.0, 500.0)
    return frame
