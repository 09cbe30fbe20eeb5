"""Sentences on comparisons, each where it must be said and where it must not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from fmuid.identification.model_comparison import LikelihoodRatioTest
from fmuid.reports.topics.model_comparison import comparison_remarks


def _texts(found: Any, fits: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(each.text for each in comparison_remarks(found, fits))


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
    assert _texts(comparison(behind), {}) == (said,)


def test_what_else_a_comparison_says() -> None:
    found = comparison(3.0, dependence=4.0, with_priors=("b",))
    found.ranks[1].corrected_bic = 0.5
    _, schwarz, coloured, priors = _texts(found, {})
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
    test = LikelihoodRatioTest("b", "a", ("L",), 3.0, probability, probability)
    assert _texts(comparison(5.0, tests=(test,)), {})[1].endswith(said)


def test_which_result_common_tables_speak_for() -> None:
    (clear,) = _texts(None, {"a": math.nan, "b": 98.0, "c": 97.0})
    assert clear == "On the common tables b is the best: a fit of 98 % against 97 % (c) and – (a)"
    (near,) = _texts(None, {"a": 97.95, "b": 98.0})
    assert near.startswith("On the common tables b and a do as well as each other: a fit of 98 % (b) and 97.95 % (a)")
    (constant,) = _texts(None, {"a": math.nan, "b": math.nan})
    assert constant == "On the common tables no fit has a meaning: compare the RMSE"
