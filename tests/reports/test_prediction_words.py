"""Sentences on predictions and comparisons, each where it must be said and where it must not."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from fmuid.estimation import Outcome
from fmuid.identification.comparison import LikelihoodRatio
from fmuid.reports.messages.prediction import comparison_words, fold_words, prediction_words


def prediction(ratio: float, **more: Any) -> Any:
    expected = 0.2 / ratio if ratio > 0 else math.nan
    score = SimpleNamespace(
        output="i", fit=93.5, rmse=0.2, unit="A", expected=expected, inside=0.94, samples=50, ratio=ratio
    )
    own = {"scores": [score], "undetermined": (), "estimated": None, "level": 0.95, "residuals": None}
    return SimpleNamespace(fit=SimpleNamespace(experiment="run", outputs=("i",), units=("A",)), **own | more)


@pytest.fixture(autouse=True)
def no_residuals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.reports.messages.prediction.residual_words", lambda *_: ())


@pytest.mark.parametrize(
    ("ratio", "said"),
    [
        (1.2, "as noise and estimates let expect (0.1667 A): 94 % of 50 samples lie in the 95 % band"),
        (2.0, "2 times what noise and estimates let expect (0.1 A): 94 % of 50 samples lie in the 95 % band; the"),
        (math.nan, "the result was not made from such an output, so nothing says how large the residual should be"),
    ],
)
def test_how_good_a_prediction_is(ratio: float, said: str) -> None:
    (words,) = prediction_words(prediction(ratio))
    assert words.startswith("i in run is predicted with a fit of 93.5 % (RMSE 0.2 A)")
    assert said in words
    assert ("or the machine has changed" in words) == (ratio == 2.0)


def test_what_a_prediction_leaves_open() -> None:
    again = SimpleNamespace(converged=False, names=("i_start",), outcome=Outcome.ITERATION_LIMIT)
    _, open_, estimated = prediction_words(prediction(1.0, undetermined=("R", "dR"), estimated=again))
    assert open_ == "The result leaves R and dR undetermined: the band is that of the noise alone"
    assert estimated.startswith("Estimated again on this record, i_start: ")


def test_what_leaving_out_each_experiment_says() -> None:
    assert fold_words([prediction(math.nan)]) == "Nothing says how large the residuals should be"
    assert fold_words([prediction(0.9), prediction(1.1)]).endswith("as noise and estimates let expect (1.1 times)")
    assert "predicted up to 3.5 times worse than" in fold_words([prediction(0.9), prediction(3.5)])


def comparison(behind: float, **more: Any) -> Any:
    ranks = [
        SimpleNamespace(name=name, behind=b, corrected_bic=k) for name, b, k in (("a", 0.0, 1.0), ("b", behind, 2.0))
    ]
    own = {"ranks": ranks, "tests": (), "dependence": 1.0, "samples": 600, "with_priors": ()}
    return SimpleNamespace(**own | more)


@pytest.mark.parametrize(
    ("behind", "said"),
    [
        (1.9, "The data do not tell a and b apart (Akaike's criterion differs by less than 2): prefer the simplest"),
        (2.1, "a is the best, not clearly, by Akaike's criterion: b is 2.1 behind"),
        (10.0, "a is clearly the best by Akaike's criterion: b is 10 behind"),
    ],
)
def test_which_result_the_criteria_speak_for(behind: float, said: str) -> None:
    assert comparison_words(comparison(behind), {}) == (said,)


def test_what_else_a_comparison_says() -> None:
    found = comparison(3.0, dependence=4.0, with_priors=("b",))
    found.ranks[1].corrected_bic = 0.5
    _, schwarz, coloured, priors = comparison_words(found, {})
    assert schwarz == "Schwarz's criterion, which charges more for parameters, prefers b"
    assert "600 samples are worth 150 independent ones, and log-likelihoods are divided by 4" in coloured
    assert priors.startswith("Priors cost b likelihood")


@pytest.mark.parametrize(
    ("probability", "said"),
    [
        (
            1e-9,
            "b is rejected against a: were it right, freeing L would gain as much with a probability of less than 1e-6",
        ),
        (0.005, "a probability of 0.005"),
        (0.2, "b is not rejected against a: freeing L gains no more than chance would (probability 0.2)"),
    ],
)
def test_a_smaller_model_is_rejected_or_not(probability: float, said: str) -> None:
    test = LikelihoodRatio("b", "a", ("L",), 3.0, probability, probability)
    assert comparison_words(comparison(5.0, tests=(test,)), {})[1].endswith(said)


def test_which_result_common_tables_speak_for() -> None:
    (clear,) = comparison_words(None, {"a": math.nan, "b": 98.0, "c": 97.0})
    assert clear == "On the common tables b is the best: a fit of 98 % against 97 % (c) and – (a)"
    (near,) = comparison_words(None, {"a": 97.95, "b": 98.0})
    assert near.startswith("On the common tables b and a do as well as each other: a fit of 98 % (b) and 97.95 % (a)")
    (constant,) = comparison_words(None, {"a": math.nan, "b": math.nan})
    assert constant == "On the common tables no fit has a meaning: compare the RMSE"
