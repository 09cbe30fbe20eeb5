"""Messages on comparisons and predictions, and the conditions that give them."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fmuid.estimation import TerminationReason
from fmuid.identification.model_comparison import LikelihoodRatioTest
from fmuid.reports.document import Remark
from fmuid.reports.topics.model_comparison import comparison_remarks
from fmuid.reports.topics.prediction import fold_remark, prediction_remarks


def keys(remarks: list[Remark]) -> list[str]:
    return [each.message.partition(".")[2] for each in remarks]


def comparison(behind: float, **more: Any) -> Any:
    ranks = [SimpleNamespace(name="a", behind=0.0, corrected_bic=1.0)]
    ranks.append(SimpleNamespace(name="b", behind=behind, corrected_bic=2.0))
    own = {"ranks": ranks, "tests": (), "dependence": 1.0, "samples": 600, "with_priors": ()}
    return SimpleNamespace(**own | more)


@pytest.mark.parametrize(("behind", "key"), [(1.9, "ALIKE"), (2.1, "BEST"), (10.0, "CLEARLY_BEST")])
def test_comparison_verdict_by_aic(behind: float, key: str) -> None:
    assert keys(comparison_remarks(comparison(behind), {})) == [key]


def test_comparison_corrections_are_reported() -> None:
    found = comparison(3.0, dependence=4.0, with_priors=("b",))
    found.ranks[1].corrected_bic = 0.5
    remarks = comparison_remarks(found, {})
    assert keys(remarks) == ["BEST", "BY_BIC", "COLORED", "PRIORS"]
    assert "600 samples count as 150 (log-likelihoods divided by 4)" in remarks[2].text


@pytest.mark.parametrize(
    ("p", "key", "said"), [(1e-9, "REJECTED", "below 1e-6"), (0.005, "REJECTED", "0.005"), (0.2, "NOT_REJECTED", "0.2")]
)
def test_smaller_model_by_likelihood_ratio(p: float, key: str, said: str) -> None:
    test = LikelihoodRatioTest("b", "a", ("L",), 3.0, p, p)
    _, remark = comparison_remarks(comparison(5.0, tests=(test,)), {})
    assert keys([remark]) == [key]
    assert remark.text.endswith(f"(p = {said}).")


def test_comparison_on_common_data() -> None:
    for fits, key, said in (
        ({"a": math.nan, "b": 98.0, "c": 97.0}, "BEST_FIT", "b is best (fit 98 %; 97 % (c) and – (a))"),
        ({"a": 97.95, "b": 98.0}, "AS_GOOD", "b and a equally good (fit 98 % for b; 97.95 % (a))"),
        ({"a": math.nan, "b": math.nan}, "NO_FIT", "fit undefined"),
    ):
        (remark,) = comparison_remarks(None, fits)
        assert keys([remark]) == [key]
        assert said in remark.text


def prediction(ratio: float, **more: Any) -> Any:
    expected = 0.2 / ratio if ratio > 0 else math.nan
    score = SimpleNamespace(output="i", fit=93.5, rmse=0.2, unit="A", expected=expected, inside=0.94, samples=50)
    score.ratio = ratio
    own = {"scores": [score], "undetermined": (), "estimated": None, "level": 0.95, "residuals": None}
    return SimpleNamespace(fit=SimpleNamespace(experiment="run", outputs=("i",), units=("A",)), **own | more)


@pytest.fixture
def no_residuals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.reports.topics.prediction.residual_remarks", lambda *_: [])


@pytest.mark.usefixtures("no_residuals")
def test_prediction_against_its_expected_size() -> None:
    good, band = prediction_remarks(prediction(1.2))
    assert good.text == "run: i predicted as expected (fit 93.5 %, RMSE 0.2 A)."
    assert band.text == "run: 94 % of 50 samples of i are in the 95 % band."
    worse, _ = prediction_remarks(prediction(2.0))
    assert worse.text.startswith("run: i predicted 2 × worse than expected") and worse.tone == "doubt" and worse.remedy
    constant = prediction(math.nan)
    constant.scores[0].fit = math.nan
    (unknown,) = prediction_remarks(constant)
    assert keys([unknown]) == ["OPEN"]
    assert "RMSE 0.2 A; constant" in unknown.text


@pytest.mark.usefixtures("no_residuals")
def test_prediction_with_refit_that_does_not_converge() -> None:
    one = np.array([0.1])
    again = SimpleNamespace(converged=False, names=("i0",), values=one, std=one)
    again.outcome = TerminationReason.ITERATION_LIMIT
    remarks = prediction_remarks(prediction(1.0, undetermined=("R",), estimated=again))
    assert keys(remarks)[2:] == ["UNDETERMINED", "REFITTED", "REFIT_ENDED"]
    assert remarks[3].text == "run: estimated again: i0 = 0.10 ± 0.10."


def test_cross_validation_verdict() -> None:
    for ratios, key, times in (
        ((math.nan,), "FOLDS_OPEN", ""),
        ((0.9, 1.1), "FOLDS", "1.1"),
        ((0.9, 3.5), "FOLDS_WORSE", "3.5"),
    ):
        remark = fold_remark([prediction(each) for each in ratios])
        assert keys([remark]) == [key]
        assert times in remark.text
