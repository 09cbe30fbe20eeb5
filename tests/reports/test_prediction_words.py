"""Sentences on predictions and comparisons, each where it must be said and where it must not."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fmuid.estimation import TerminationReason
from fmuid.reports.topics.prediction import fold_remark, prediction_remarks


def fold_text(predictions: list[Any]) -> str:
    return fold_remark(predictions).text


def prediction_texts(found: Any) -> list[str]:
    return [each.text for each in prediction_remarks(found)]


def prediction(ratio: float, **more: Any) -> Any:
    expected = 0.2 / ratio if ratio > 0 else math.nan
    score = SimpleNamespace(
        output="i", fit=93.5, rmse=0.2, unit="A", expected=expected, inside=0.94, samples=50, ratio=ratio
    )
    own = {"scores": [score], "undetermined": (), "estimated": None, "level": 0.95, "residuals": None}
    return SimpleNamespace(fit=SimpleNamespace(experiment="run", outputs=("i",), units=("A",)), **own | more)


@pytest.fixture(autouse=True)
def no_residuals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.reports.topics.prediction.residual_words", lambda *_: ())


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (1.2, "as noise and estimates let expect (0.1667 A): 94 % of 50 samples lie in the 95 % band"),
        (2.0, "2 times what noise and estimates let expect (0.1 A): 94 % of 50 samples lie in the 95 % band; the"),
        (math.nan, "the result was not made from such an output, so nothing says how large the residual should be"),
    ],
)
def test_how_good_a_prediction_is(ratio: float, said: str) -> None:
    (words,) = prediction_texts(prediction(ratio))
    assert words.startswith("i in run is predicted with a fit of 93.5 % (RMSE 0.2 A)")
    assert said in words
    assert ("or the machine has changed" in words) == (ratio == 2.0)


def test_what_a_prediction_leaves_open() -> None:
    value = np.array([0.1])
    again = SimpleNamespace(
        converged=False, names=("i_start",), values=value, std=value, outcome=TerminationReason.ITERATION_LIMIT
    )
    _, open_, values, estimated = prediction_texts(prediction(1.0, undetermined=("R", "dR"), estimated=again))
    assert open_ == "The result leaves R and dR undetermined: the band is that of the noise alone"
    assert values == "Estimated again on run: i_start = 0.10 ± 0.10"
    assert estimated.startswith("Estimated again on this record, i_start: ")


def test_what_leaving_out_each_experiment_says() -> None:
    assert fold_text([prediction(math.nan)]) == "Nothing says how large the residuals should be"
    assert fold_text([prediction(0.9), prediction(1.1)]).endswith("as noise and estimates let expect (1.1 times)")
    assert "predicted up to 3.5 times worse than" in fold_text([prediction(0.9), prediction(3.5)])
