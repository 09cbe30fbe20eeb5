"""Whole identifications: estimates, variances, coverage, undetermined directions, and the files they leave."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.optimize import minimize
from scipy.stats import norm

import fmuid
from fmuid import InputError, Marquardt, Noise, Normal, Parameter, Result
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import TerminationReason
from fmuid.estimation import local_search as estimation
from fmuid.events import Event, SearchStep
from fmuid.identification import identify
from fmuid.runs import at_minimum
from tests.support.problems import two_output_problem, two_outputs
from tests.support.results import RESULT


def test_every_output_gets_its_own_variance() -> None:
    result = identify(two_output_problem())
    assert result.converged
    assert result.outcome is TerminationReason.CONVERGED
    assert result.fit.noise_variance["u"] == pytest.approx(400.0, rel=0.3)
    assert result.fit.noise_variance["i"] == pytest.approx(1e-8, rel=0.3)
    assert (np.abs(result.values - [1.5, 2.0]) < 3.5 * result.std).all()

    # the optimum is that of the likelihood with both variances unknown
    measured = np.column_stack([result.fit.frames[0]["measured.u"], result.fit.frames[0]["measured.i"]])

    def likelihood(theta: Floats) -> float:
        return float(np.sum(np.log(np.sum((measured - two_outputs(theta)) ** 2, axis=0))))

    best = minimize(likelihood, [1.5, 2.0], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-14}).x
    assert (np.abs(result.values - best) < 0.02 * result.std).all()


def test_variances_settle_from_any_start() -> None:
    """The rounds of docs/method/noise-variances.md: few; the log-likelihood compares, the cost not."""
    results = [identify(two_output_problem(noise=Noise(initial_variance=s))) for s in (1e-8, 1.0, 1e4)]
    for result in results:
        assert result.converged
        rounds = pd.DataFrame(result.history.rounds)
        assert len(rounds) <= 4
        assert rounds["used.u"].iloc[1] == rounds["estimated.u"].iloc[0]
        assert rounds["estimated.i"].iloc[-1] == pytest.approx(rounds["used.i"].iloc[-1], rel=0.02)
        np.testing.assert_allclose(result.values, results[0].values, atol=0.02 * results[0].std.min())
        assert result.fit.log_likelihood == pytest.approx(results[0].fit.log_likelihood, abs=1e-3)
    assert as_json(results[0])["fit"]["log_likelihood"] == results[0].fit.log_likelihood
    robust = identify(two_output_problem(loss="huber"))
    assert math.isnan(robust.fit.log_likelihood)
    assert as_json(robust)["fit"]["log_likelihood"] is None


def densities(result: Result, **std: float) -> float:
    """Return the sum of the normal log densities of the residuals of result.fit."""
    fit = result.fit.frames[0]
    rows = [(fit[f"measured.{n}"] - fit[f"simulated.{n}"], s) for n, s in std.items()]
    return float(sum(norm.logpdf(residual[residual.notna()], scale=s).sum() for residual, s in rows))


@pytest.mark.parametrize("prior", [None, Normal(1.4, 0.05)])
def test_log_likelihood_is_that_of_the_data(prior: Normal | None) -> None:
    """However much is known of the noise; a prior is no part of it."""
    words: dict[str, Any] = {"parameters": {"k": Parameter(0.8, prior=prior)}}
    known = {"u": 20.0, "i": 1e-4}
    given = identify(two_output_problem(noise=Noise({name: std**2 for name, std in known.items()}), **words))
    assert given.fit.log_likelihood == pytest.approx(densities(given, **known), rel=1e-12)
    free = identify(two_output_problem(**words))
    (fit,) = free.fit.frames
    likely = {n: math.sqrt(float(np.mean((fit[f"measured.{n}"] - fit[f"simulated.{n}"]) ** 2))) for n in known}
    assert free.fit.log_likelihood == pytest.approx(densities(free, **likely), rel=1e-12)
    mixed = identify(two_output_problem(noise=Noise({"i": 1e-8}), **words))
    # one estimated variance is never less likely than a known one
    limit = given.fit.log_likelihood + 3.0
    assert given.fit.log_likelihood < mixed.fit.log_likelihood < free.fit.log_likelihood < limit


def test_given_variances_are_used_as_they_are() -> None:
    free = identify(two_output_problem())
    given = identify(two_output_problem(noise=Noise({"u": 4.0 * 400.0, "i": 4e-8})))
    assert given.fit.given_variance == {"u": 1600.0, "i": 4e-8}
    assert free.fit.given_variance == {}
    assert given.fit.noise_variance["u"] == pytest.approx(free.fit.noise_variance["u"], rel=0.05)
    np.testing.assert_allclose(given.std, 2.0 * free.std, rtol=0.15)
    assert len(given.history.rounds) == 1
    assert math.isinf(given.fit.degrees_of_freedom)
    assert free.fit.degrees_of_freedom == pytest.approx(198.0)
    width = given.intervals()["upper"] - given.intervals()["lower"]
    # the variances are known, their correlation is not
    np.testing.assert_allclose(width, 2.0 * stats.t.ppf(0.975, given.estimates.variance_dof) * given.std, rtol=1e-6)
    assert (given.estimates.variance_dof > free.estimates.variance_dof).all()


def test_an_interrupted_search_keeps_its_best_point() -> None:
    seen: list[SearchStep] = []

    def stop(event: Event) -> None:
        assert isinstance(event, SearchStep)
        seen.append(event)
        if event.number == 3:
            raise KeyboardInterrupt

    result = identify(two_output_problem(), progress=stop)
    assert not result.converged
    assert result.outcome is TerminationReason.INTERRUPTED
    best = min((i for i in seen if i.accepted), key=lambda i: i.cost)
    assert dict(zip(result.names, result.values.tolist(), strict=True)) == best.values
    assert np.isfinite(result.std).all()
    assert len(result.trace) == len(seen)


def test_unsettled_variances_and_iteration_limit_are_not_convergence(monkeypatch: pytest.MonkeyPatch) -> None:
    limited = identify(two_output_problem(), Marquardt(max_iterations=1))
    assert (limited.outcome, limited.history.iterations) == (TerminationReason.ITERATION_LIMIT, 1)
    monkeypatch.setattr(estimation, "ROUNDS", estimation.EstimateSettings(most_rounds=1))
    unsettled = identify(two_output_problem())
    assert unsettled.outcome is TerminationReason.UNSETTLED
    assert not (limited.converged or unsettled.converged or at_minimum(unsettled))


# --- files


@pytest.fixture(scope="module")
def found() -> Result:
    return identify(two_output_problem())


def saved(folder: Path, result: Result) -> Path:
    path = folder / "result.json"
    path.write_text(json.dumps(RESULT | as_json(result), allow_nan=False), encoding="utf-8")
    return path


def test_result_json_keeps_the_contract(tmp_path: Path) -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, prior=Normal(1.4, 0.1))}))
    data = as_json(result)
    keys = {"outcome", "converged", "parameters", "covariance", "at_bounds", "fit", "identifiability", "history"}
    assert set(data) >= keys | {"setup", "accuracy"}
    keys = {"value", "std", "std_white_noise", "variance_dof", "start", "lower", "upper"}
    assert set(data["parameters"]["k"]) == keys | {"prior_mean", "prior_std", "prior_z_score", "unit"}
    assert data["parameters"]["gain"]["prior_mean"] is None
    assert data["parameters"]["gain"]["upper"] == "inf"
    assert data["covariance"]["names"] == ["k", "gain"]
    assert data["setup"]["version"] == fmuid.__version__
    back = Result.from_json(saved(tmp_path, result))
    for name in ("values", "start", "covariance", "covariance_white_noise", "variance_dof", "lower", "prior_mean"):
        np.testing.assert_array_equal(getattr(back.estimates, name), getattr(result.estimates, name))
    pd.testing.assert_frame_equal(back.intervals(), result.intervals())
    assert as_json(back) == data
    assert back.fit.linearization is None


def test_result_as_prior(found: Result) -> None:
    joint = found.prior(["gain", "k"], inflate=10.0)
    # with the standard deviations whose normal intervals are those of the result
    wider = np.asarray(stats.t.ppf(0.975, found.estimates.variance_dof)) / stats.norm.ppf(0.975)
    expected = 100.0 * found.covariance * np.outer(wider, wider)
    np.testing.assert_allclose(joint.covariance, expected[::-1, ::-1])
    assert joint.mean.tolist() == [found["gain"], found["k"]]
    assert found.normal("k", inflate=2.0).std == pytest.approx(2.0 * wider[0] * found.std[0])
    for words, said in (({"names": ["x"]}, "'x'"), ({"inflate": 0.0}, "inflate")):
        with pytest.raises(InputError, match=said):
            found.prior(**words)


def test_damaged_result_is_refused_by_its_place(tmp_path: Path, found: Result) -> None:
    path, whole = tmp_path / "result.json", RESULT | as_json(found)
    coil, names = {"name": "Coil", "digest": "0"}, whole["covariance"] | {"names": ["x", "y"]}
    direction = {"names": ["k"], "coefficients": [1.0], "values": [1.0], "magnitudes": [1.0], "std": 1.0}
    short, place = direction | {"level": "hidden", "values": []}, "identifiability.weakly_identifiable[0]"

    def setup(model: object) -> dict[str, Any]:
        return {"setup": whole["setup"] | {"models": {"": model}}}

    def weak(one: object) -> dict[str, Any]:
        return {"identifiability": {"weakly_identifiable": [one]}}

    cases: list[tuple[dict[str, Any], str]] = [
        *(({key: None}, f"'{key}'") for key in ("outcome", "fit", "identifiability", "history", "setup")),
        *(({key: [["of old"]]}, key) for key in whole.keys() - {"schema", "converged"}),
        (setup("of old"), "setup.models."),
        (setup({"name": "Coil"}), "'setup.models..digest'"),
        (setup(coil | {"run": {"stiff": False}}), "'setup.models..run.divisor'"),
        (setup(coil | {"steps": 1}), "'setup.models..steps'"),
        (weak(direction), f"'{place}.level'"),
        (weak(short), place),
        ({"covariance": whole["covariance"] | {"matrix": [[1.0, 0.0], [0.0, -1.0]]}}, "negative"),
        ({"covariance": names}, "names"),
        ({"covariance": whole["covariance"] | {"matrix": [[1.0]]}}, "2 parameters"),
    ]
    for change, said in cases:
        content = {key: value for key, value in (whole | change).items() if value is not None or key in ("accuracy",)}
        path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError, match=re.escape(said)) as caught:
            Result.from_json(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_estimates_as_a_table(found: Result) -> None:
    table = found.to_frame()
    assert table.index.tolist() == ["k", "gain"]
    np.testing.assert_array_equal(table["value"], found.values)
    assert table["prior_mean"].isna().all()
    correlation = found.estimates.correlation
    assert correlation.loc["k", "k"] == pytest.approx(1.0)
    assert correlation.loc["k", "gain"] == pytest.approx(found.covariance[0, 1] / np.prod(found.std))
    assert (found.intervals(0.99)["lower"] < found.intervals(0.5)["lower"]).all()
    with pytest.raises(InputError, match="between 0 and 1"):
        found.intervals(95)
