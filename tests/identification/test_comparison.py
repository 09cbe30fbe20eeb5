"""Comparisons of results: criteria and likelihood ratios against chance, white and coloured."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from fmuid import InputError, Parameter, analyze_residuals, compare_models
from fmuid.array_types import Floats
from fmuid.estimation import Doubt, LeastSquares, Reason, Verdict
from fmuid.identification import IncomparableError, ModelCandidate, identify
from tests.support.problems import ar1
from tests.support.results import changed

TIMES = np.linspace(0.0, 1.0, 400)
MODEL = {"": {"name": "Line", "digest": "1", "run": {}}}


def candidate(y: Floats, order: int, name: str, held: dict[str, float] | None = None) -> ModelCandidate:
    """A polynomial of so many coefficients, those beyond held at zero."""
    names = [f"c{k}" for k in range(order)]
    problem = LeastSquares.from_function(
        lambda theta: sum(c * TIMES**k for k, c in enumerate(theta)),
        y,
        {each: Parameter(0.0, nominal=1.0) for each in names},
        times=TIMES,
    )
    result = identify(problem)
    (series,) = analyze_residuals(problem, result).series
    result = changed(result, models=MODEL)
    rest = {f"c{k}": 0.0 for k in range(order, 4)} if held is None else held
    return ModelCandidate(name, result, max(1.0, series.noise.variance_factor()), rest)


def line(seed: int, colour: float = 0.0) -> Floats:
    return 1.0 + 2.0 * TIMES + 0.1 * ar1(np.random.default_rng(seed), colour, TIMES.size)


@pytest.mark.slow
@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_a_right_model_is_rejected_as_rarely_as_the_level_says(colour: float) -> None:
    """The line against the cubic: 5 % within what 60 draws allow; without the correction, most of them."""
    corrected, plain = [], []
    for seed in range(60):
        y = line(seed, colour)
        (test,) = compare_models([candidate(y, 2, "line"), candidate(y, 4, "cubic")]).tests
        assert (test.smaller, test.larger, test.freed) == ("line", "cubic", ("c2", "c3"))
        corrected.append(test.probability)
        plain.append(test.uncorrected)
    assert np.mean(np.array(corrected) < 0.05) <= 0.15
    assert np.mean(np.array(corrected) < 0.5) > 0.2  # nor is it never rejected
    if colour:
        assert np.mean(np.array(plain) < 0.05) > 0.4


def test_a_wrong_model_is_rejected() -> None:
    y = line(2, 0.5) + TIMES**2
    found = compare_models([candidate(y, 2, "line"), candidate(y, 3, "parabola"), candidate(y, 4, "cubic")])
    assert [(test.smaller, test.larger) for test in found.tests] == [
        ("line", "parabola"),
        ("line", "cubic"),
        ("parabola", "cubic"),
    ]
    assert found.tests[0].probability < 1e-4
    assert found.tests[2].probability > 0.01
    assert found.ranks[-1].name == "line"
    assert found.dependence > 1.5
    squares = [np.sum((y - np.polynomial.Polynomial.fit(TIMES, y, order)(TIMES)) ** 2) for order in (1, 3)]
    ratio, test = TIMES.size * math.log(squares[0] / squares[1]), found.tests[1]  # n ln(S₁/S₂), two parameters freed
    assert test.statistic == pytest.approx(ratio / found.dependence, rel=1e-6)
    assert test.probability == pytest.approx(stats.chi2.sf(ratio / found.dependence, 2), rel=1e-5)
    assert test.uncorrected == pytest.approx(stats.chi2.sf(ratio, 2), rel=1e-5)


def test_nesting_is_claimed_only_where_it_is_known() -> None:
    y = line(1)
    small, large = candidate(y, 2, "small"), candidate(y, 3, "large")
    assert len(compare_models([small, large]).tests) == 1
    other = candidate(y, 2, "small", {"c2": 0.0, "c3": 5.0})  # another value of what both hold
    assert compare_models([other, large]).tests == ()
    stranger = changed(small.result, models={"": {"name": "Other", "digest": "1", "run": {}}})
    assert compare_models([replace(small, result=stranger), large]).tests == ()
    prior = np.array([np.nan, np.nan, 0.0])
    found = compare_models([small, replace(large, result=changed(large.result, prior_mean=prior))])
    assert (found.tests, found.with_priors) == ((), ("large",))


def test_incomparable_results_are_refused() -> None:
    one, other, again = candidate(line(1), 2, "one"), candidate(line(2), 2, "other"), candidate(line(1), 2, "again")
    with pytest.raises(IncomparableError, match=r"one and other .*different"):
        compare_models([one, other])
    cut = Verdict.of([], [Doubt(Reason.DATA_DEFECT, ("excluded", "y", "first"), {"limit": 1.0, "samples": 9.0})])
    with pytest.raises(IncomparableError, match="report"):
        compare_models([replace(one, result=replace(one.result, verdict=cut)), other])
    for given, said in (([one], "two results"), ([one, one], "one")):
        with pytest.raises(InputError, match=said):
            compare_models(given)
    for change in ({"log_likelihood": math.nan}, {"data": ()}):
        with pytest.raises(IncomparableError, match="again"):
            compare_models([one, replace(again, result=changed(again.result, **change))])
