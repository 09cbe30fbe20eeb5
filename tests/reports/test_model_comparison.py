"""Messages on comparisons and predictions, and the conditions that give them."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fmuid.estimation import TerminationReason
from fmuid.identification import OutputScore
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


def test_comparison_by_likelihood() -> None:
    for behind, key in ((1.9, "ALIKE"), (2.1, "BEST"), (10.0, "CLEARLY_BEST")):
        assert keys(comparison_remarks(comparison(behind), {})) == [key]
    found = comparison(3.0, dependence=4.0, with_priors=("b",))
    found.ranks[1].corrected_bic = 0.5
    remarks = comparison_remarks(found, {})
    assert keys(remarks) == ["BEST", "BY_BIC", "COLORED", "PRIORS"]
    assert "600 samples count as 150 (log-likelihoods divided by 4)" in remarks[2].text
    for p, key, said in ((1e-9, "REJECTED", "below 1e-6"), (0.005, "REJECTED", "0.005"), (0.2, "NOT_REJECTED", "0.2")):
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
    score = OutputScore("i", "A", 50, 0.2, 0.0, 93.5, expected, ratio, 0.94)
    own = {"scores": [score], "undetermined": (), "estimated": None}
    fit = SimpleNamespace(experiment="run", outputs=("i",), units=("A",))
    return SimpleNamespace(fit=fit, level=0.95, residuals=None, **own | more)


def test_prediction_against_its_expected_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.reports.topics.prediction.residual_remarks", lambda *_: [])
    good, band = prediction_remarks(prediction(1.2))
    assert good.text == "run: i predicted as expected (fit 93.5 %, RMSE 0.2 A)."
    assert band.text == "run: 94 % of 50 samples of i are in the 95 % band."
    worse, _ = prediction_remarks(prediction(2.0))
    assert worse.text.startswith("run: i predicted 2 × worse than expected") and worse.tone == "doubt" and worse.remedy
    constant = prediction(math.nan)
    constant.scores = [replace(constant.scores[0], fit=math.nan)]
    (unknown,) = prediction_remarks(constant)
    assert keys([unknown]) == ["OPEN"]
    assert "RMSE 0.2 A; constant" in unknown.text
    one, end = np.array([0.1]), TerminationReason.ITERATION_LIMIT
    again = SimpleNamespace(converged=False, names=("i0",), values=one, std=one, outcome=end)
    remarks = prediction_remarks(prediction(1.0, undetermined=("R",), estimated=again))
    assert keys(remarks)[2:] == ["UNDETERMINED", "REFITTED", "REFIT_ENDED"]
    assert remarks[3].text == "run: estimated again: i0 = 0.10 ± 0.10."


def test_cross_validation_verdict() -> None:
    ends = {(math.nan,): ("FOLDS_OPEN", ""), (0.9, 1.1): ("FOLDS", "1.1"), (0.9, 3.5): ("FOLDS_WORSE", "3.5")}
    for ratios, (key, times) in ends.items():
        remark = fold_remark([prediction(each) for each in ratios])
        assert keys([remark]) == [key]
        assert times in remark.text
