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
from fmuid.arrays import Floats
from fmuid.data.noise import Noise
from fmuid.data.parameters import Normal, Parameter
from fmuid.data.predictors import Table
from fmuid.errors import InputError
from fmuid.estimation import identification
from fmuid.estimation.covariance import AtBound, Determined
from fmuid.estimation.identification import identify
from fmuid.estimation.least_squares import LeastSquares
from fmuid.estimation.marquardt.linear import linear_least_squares
from fmuid.estimation.marquardt.outcome import Outcome
from fmuid.estimation.method import Marquardt
from fmuid.estimation.result import Result
from fmuid.progress import Event, SearchStep
from fmuid.reports.findings import at_minimum
from fmuid.reports.words.directions import direction_words
from fmuid.reports.words.result import ending
from fmuid.version import __version__
from tests.support.problems import Fake, coil_problem

TIMES = np.linspace(0.0, 3.0, 100)
TRUTH = {"k": 1.5, "gain": 2.0}


def two_outputs(theta: Floats) -> Floats:
    k, gain = theta
    return np.column_stack([1e3 * gain * np.exp(-k * TIMES), 1e-3 * gain * np.sin(k * TIMES)])


def two_output_problem(seed: int = 1, **words: Any) -> LeastSquares:
    noise = np.random.default_rng(seed).standard_normal((100, 2)) * [20.0, 1e-4]
    parameters = {"k": Parameter(0.8, min=0.0), "gain": Parameter(3.0)} | words.pop("parameters", {})
    measured = two_outputs(np.array([1.5, 2.0])) + noise
    return LeastSquares.from_function(two_outputs, measured, parameters, outputs=("u", "i"), times=TIMES, **words)


def test_every_output_gets_its_own_variance() -> None:
    result = identify(two_output_problem())
    assert result.converged
    assert result.outcome is Outcome.CONVERGED
    assert result.noise_variance["u"] == pytest.approx(400.0, rel=0.3)
    assert result.noise_variance["i"] == pytest.approx(1e-8, rel=0.3)
    assert (np.abs(result.values - [1.5, 2.0]) < 3.5 * result.std).all()

    # the optimum is that of the likelihood with both variances unknown
    measured = np.column_stack([result.fit[0]["measured.u"], result.fit[0]["measured.i"]])

    def likelihood(theta: Floats) -> float:
        return float(np.sum(np.log(np.sum((measured - two_outputs(theta)) ** 2, axis=0))))

    best = minimize(likelihood, [1.5, 2.0], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-14}).x
    assert (np.abs(result.values - best) < 0.02 * result.std).all()


def test_the_variances_settle_whatever_their_start() -> None:
    """The repetition of docs/method.md section 7: kept as rounds, one or two of them from any start."""
    results = [identify(two_output_problem(noise=Noise(start=s))) for s in (1e-8, 1.0, 1e4)]
    for result in results:
        assert result.converged
        assert len(result.rounds) <= 4
        assert result.rounds["used.u"].iloc[1] == result.rounds["estimated.u"].iloc[0]
        last = result.rounds.iloc[-1]
        assert last["estimated.i"] == pytest.approx(last["used.i"], rel=0.02)
        np.testing.assert_allclose(result.values, results[0].values, atol=0.02 * results[0].std.min())


def densities(result: Result, **std: float) -> float:
    """Return the sum of the normal log densities of the residuals of result.fit."""
    fit = result.fit[0]
    rows = [(fit[f"measured.{n}"] - fit[f"simulated.{n}"], s) for n, s in std.items()]
    return float(sum(norm.logpdf(residual[residual.notna()], scale=s).sum() for residual, s in rows))


def test_the_log_likelihood_is_that_of_the_data() -> None:
    """Whatever is known of the noise, and however many outputs; a prior is no part of it."""
    priors: dict[str, Any] = {"parameters": {"k": Parameter(0.8, prior=Normal(1.4, 0.05))}}
    known = {"u": 20.0, "i": 1e-4}
    variances = {name: std**2 for name, std in known.items()}
    for words in ({}, priors):
        given = identify(two_output_problem(noise=Noise(variances), **words))
        assert given.log_likelihood == pytest.approx(densities(given, **known), rel=1e-12)
        free = identify(two_output_problem(**words))
        likely = {
            n: math.sqrt(float(np.mean((free.fit[0][f"measured.{n}"] - free.fit[0][f"simulated.{n}"]) ** 2)))
            for n in known
        }
        assert free.log_likelihood == pytest.approx(densities(free, **likely), rel=1e-12)
        mixed = identify(two_output_problem(noise=Noise({"i": 1e-8}), **words))
        # one estimated variance is never less likely than a known one
        assert given.log_likelihood < mixed.log_likelihood < free.log_likelihood < given.log_likelihood + 3.0


def test_the_log_likelihood_compares_where_the_criterion_does_not() -> None:
    results = [identify(two_output_problem(noise=Noise(start=start))) for start in (1e-4, 1e4)]
    assert results[0].log_likelihood == pytest.approx(results[1].log_likelihood, abs=1e-3)
    content = results[0].to_json_dict()
    assert content["log_likelihood"] == results[0].log_likelihood
    robust = identify(two_output_problem(loss="huber"))
    assert math.isnan(robust.log_likelihood)
    assert robust.to_json_dict()["log_likelihood"] is None


def test_given_variances_are_used_as_they_are() -> None:
    free = identify(two_output_problem())
    given = identify(two_output_problem(noise=Noise({"u": 4.0 * 400.0, "i": 4e-8})))
    assert given.given_variance == {"u": 1600.0, "i": 4e-8}
    assert free.given_variance == {}
    assert given.noise_variance["u"] == pytest.approx(free.noise_variance["u"], rel=0.05)
    np.testing.assert_allclose(given.std, 2.0 * free.std, rtol=0.15)
    assert len(given.rounds) == 1
    assert math.isinf(given.degrees_of_freedom)
    assert free.degrees_of_freedom == pytest.approx(198.0)
    width = given.intervals()["upper"] - given.intervals()["lower"]
    # the variances are known, their correlation is not
    np.testing.assert_allclose(width, 2.0 * stats.t.ppf(0.975, given.freedom) * given.std, rtol=1e-6)
    assert (given.freedom > free.freedom).all()


def test_the_variances_that_weigh() -> None:
    """A given variance goes before the estimated one; the local model is whitened by both and not written to a file."""
    result = identify(two_output_problem(noise=Noise({"u": 900.0})))
    assert result.variance == {"u": 900.0, "i": result.noise_variance["i"]}
    assert result.local is not None
    whitened = (result.fit[0]["measured.u"] - result.fit[0]["simulated.u"]) / 30.0
    np.testing.assert_allclose(result.local.residual[::2], whitened, rtol=1e-9, atol=1e-12)
    stacked = np.linalg.inv(result.local.jacobian.T @ result.local.jacobian)
    np.testing.assert_allclose(stacked, result.white_covariance, rtol=1e-5)
    assert result.local.prior_residual.size == 0


def test_the_barycentre_of_prior_and_data() -> None:
    """On a linear model θ_C = [M₀⁻¹ + P⁻¹]⁻¹ (M₀⁻¹ θ₀ + P⁻¹ θ_opt), section 7, with its covariance."""
    rng = np.random.default_rng(8)
    phi = np.column_stack([np.ones(60), np.linspace(0.0, 1.0, 60)])
    y = phi @ [1.0, 2.0] + 0.2 * rng.standard_normal(60)
    parameters = {"a": Parameter(2.0, prior=Normal(0.9, 0.02)), "b": Parameter(1.0, prior=Normal(2.6, 0.1))}
    result = identify(LeastSquares.from_function(lambda theta: phi @ theta, y, parameters, noise=Noise(0.04)))
    data = linear_least_squares(phi, y)
    precision = np.linalg.inv(data.covariance) * data.noise_variance / 0.04
    prior = np.diag([1 / 0.02**2, 1 / 0.1**2])
    expected = np.linalg.solve(prior + precision, prior @ [0.9, 2.6] + precision @ data.theta)
    np.testing.assert_allclose(result.values, expected, rtol=1e-6)
    np.testing.assert_allclose(result.white_covariance, np.linalg.inv(prior + precision), rtol=1e-6)
    np.testing.assert_allclose(result.pull, (expected - [0.9, 2.6]) / [0.02, 0.1], rtol=1e-4)


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say() -> None:
    """200 draws of a nonlinear problem with 12 samples, where Student's t differs from the normal distribution."""
    times = np.linspace(0.0, 2.0, 12)

    def decay(theta: Floats) -> Floats:
        return np.asarray(theta[0] * np.exp(-theta[1] * times))

    inside = np.zeros(2)
    for seed in range(200):
        y = decay(np.array([3.0, 1.0])) + 0.1 * np.random.default_rng(seed).standard_normal(12)
        result = identify(LeastSquares.from_function(decay, y, {"a": Parameter(2.0), "k": Parameter(1.5)}))
        assert result.converged
        interval = result.intervals()
        inside += (interval["lower"] < [3.0, 1.0]) & (interval["upper"] > [3.0, 1.0])
    assert (inside >= 182).all()
    assert (inside <= 197).all()


def test_what_cannot_be_told_apart_is_named() -> None:
    result = identify(coil_problem(prior=False))
    assert not result.converged
    told = re.match(
        r"undetermined: R, L and dR cannot be told apart: raising dR by 1 % while "
        r"R falls by (\S+) % and L falls by (\S+) % changes no output; ",
        ending(result),
    )
    assert told is not None
    shares = [result["dR"] / result["R"], 0.0494 * result["dR"] / result["L"]]
    assert [float(share) for share in told.groups()] == pytest.approx(shares, rel=0.01)
    assert "only R + dR and L + 0.0494 dR are determined" in ending(result)
    assert "give a prior" in ending(result)
    assert np.isinf(result.std).all()
    assert result["R"] + result["dR"] == pytest.approx(5.0, abs=0.3)
    assert result["L"] + 0.0494 * result["dR"] == pytest.approx(0.1494, abs=0.01)
    written = result.to_json_dict()
    assert written["parameters"]["R"]["std"] is None
    json.dumps(written, allow_nan=False)


def test_a_prior_tells_them_apart() -> None:
    result = identify(coil_problem(prior=True))
    assert result.converged
    assert result.undetermined == ()
    assert len(result.prior_determined) == 1
    assert "only R + dR and L + 0.0494 dR are determined" in direction_words(result.prior_determined[0])
    assert result["dR"] == pytest.approx(1.0, abs=4 * result.std[2])
    assert result.std[2] < 0.3
    assert result.correlation.to_numpy()[0, 2] < -0.5


def test_two_alike_and_one_lost() -> None:
    """Two directions at once: a and b act as a sum, and c acts on nothing beyond the start."""
    parameters = {"a": Parameter(1.0), "b": Parameter(2.0), "c": Parameter(1.0)}
    result = identify(
        LeastSquares.from_function(
            lambda theta: (theta[0] + theta[1]) * TIMES + (theta[2] if theta[0] + theta[1] < 3.2 else 0.0),
            5.0 * TIMES + 0.01 * np.random.default_rng(1).standard_normal(100),
            parameters,
        )
    )
    assert all(each.determined is Determined.NOT for each in result.undetermined)
    assert {each.names for each in result.undetermined} == {("c",), ("a", "b")}
    assert {direction_words(each) for each in result.undetermined} == {
        "c is not determined: changing it changes no output",
        "a and b cannot be told apart: only a + b is determined",
    }


def test_a_hardly_determined_parameter_is_named() -> None:
    y = 2.0 * TIMES + 0.1 * np.random.default_rng(1).standard_normal(100)
    parameters = {"slope": Parameter(1.0), "bend": Parameter(1.0)}
    result = identify(
        LeastSquares.from_function(lambda theta: theta[0] * TIMES + 1e-4 * theta[1] * TIMES**2, y, parameters)
    )
    assert result.converged
    (direction,) = result.weak
    assert (direction.determined, direction.names) == (Determined.HARDLY, ("bend",))
    assert direction_words(direction).startswith("bend is hardly determined: its standard deviation is ")


def test_strong_correlations_are_listed() -> None:
    """A line whose abscissas lie far from zero: intercept and slope are correlated by −mean(t)/rms(t)."""
    t = np.linspace(10.0, 11.0, 40)
    y = 1.0 + 2.0 * t + 0.01 * np.random.default_rng(1).standard_normal(40)
    parameters = {"offset": Parameter(2.0), "slope": Parameter(1.0)}
    result = identify(LeastSquares.from_function(lambda theta: theta[0] + theta[1] * t, y, parameters))
    ((first, second, value),) = result.strong_correlations
    assert (first, second) == ("offset", "slope")
    assert value == pytest.approx(-np.mean(t) / np.sqrt(np.mean(t**2)), abs=1e-4)


def test_bounds_are_named() -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, min=0.0, max=1.2)}))
    assert result.converged
    assert result.at_bounds == (AtBound("k", 1.2),)
    assert "widen the bound" in ending(result)
    assert result["k"] == 1.2
    # one-sided where the estimate stands on a bound
    lower, upper = result.intervals(0.9).to_numpy()[0].tolist()
    assert upper == 1.2
    assert lower == pytest.approx(1.2 - stats.t.ppf(0.9, result.freedom[0]) * result.std[0])


def test_intervals_end_at_bounds() -> None:
    free = identify(two_output_problem())
    lower, upper = free.intervals().to_numpy()[0].tolist()
    bound = 0.5 * (free["k"] + upper)
    held = identify(two_output_problem(parameters={"k": Parameter(1.0, min=0.0, max=bound)}))
    assert held.intervals().to_numpy()[0].tolist() == pytest.approx([lower, bound], rel=1e-5)
    assert not held.at_bounds


def test_few_samples_of_an_output_widen_what_depends_on_them_alone() -> None:
    """Three samples, of which one parameter takes one: Student's t of two degrees of freedom."""

    def both(theta: Floats) -> Floats:
        return np.column_stack([theta[0] * np.exp(-TIMES), np.full(100, theta[1])])

    y = both(np.array([1.0, 2.0])) + np.random.default_rng(4).standard_normal((100, 2)) * [0.1, 0.3]
    y[[*range(20), *range(21, 50), *range(51, 90), *range(91, 100)], 1] = np.nan
    parameters = {"a": Parameter(0.5), "c": Parameter(1.0)}
    result = identify(LeastSquares.from_function(both, y, parameters, outputs=("u", "i"), times=TIMES))
    assert result.freedom[1] == pytest.approx(2.0, rel=0.02)
    assert result.freedom[0] > 20.0
    assert result.std[1] == pytest.approx(np.nanstd(y[:, 1], ddof=1) / math.sqrt(3.0), rel=0.02)


def test_parameters_shared_and_per_experiment() -> None:
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 2.0, 50)

    def simulate(k: float, gain: float) -> Floats:
        return np.column_stack([1e3 * gain * np.exp(-k * times), 1e-3 * gain * np.sin(k * times)])

    tables = [
        Table(name, times, ("a", "b"), y, np.ones((50, 2), dtype=np.bool_))
        for name, gain in (("first", 2.0), ("second", 5.0))
        for y in [simulate(1.5, gain) + rng.standard_normal((50, 2)) * [5.0, 1e-5]]
    ]
    parameters = {"k": Parameter(1.0, min=0.0), "gain": Parameter(3.0, per_experiment=True)}
    result = identify(LeastSquares([Fake(), Fake()], tables, parameters))
    assert result.names == ("k", "gain[first]", "gain[second]")
    assert (np.abs(result.values - [1.5, 2.0, 5.0]) < 3.5 * result.std).all()
    assert len(result.fit) == 2
    assert list(result.fit[1].columns) == ["time", "measured.a", "simulated.a", "measured.b", "simulated.b"]
    np.testing.assert_allclose(result.fit[1]["simulated.a"], simulate(*result.values[[0, 2]])[:, 0])


def test_an_interrupted_search_keeps_its_best_point() -> None:
    seen: list[SearchStep] = []

    def stop(event: Event) -> None:
        assert isinstance(event, SearchStep)
        seen.append(event)
        if event.number == 3:
            raise KeyboardInterrupt

    result = identify(two_output_problem(), progress=stop)
    assert not result.converged
    assert result.outcome is Outcome.INTERRUPTED
    best = min((i for i in seen if i.accepted), key=lambda i: i.criterion)
    assert dict(zip(result.names, result.values.tolist(), strict=True)) == best.values
    assert np.isfinite(result.std).all()
    assert len(result.trace) == len(seen)


def test_an_interruption_inside_a_simulation() -> None:
    calls = 0

    def function(theta: Floats) -> Floats:
        nonlocal calls
        calls += 1
        if calls == 25:
            raise KeyboardInterrupt
        return np.asarray(theta[0] * np.exp(-theta[1] * TIMES))

    y = 3.0 * np.exp(-TIMES) + 0.01 * np.sin(50.0 * TIMES)
    result = identify(LeastSquares.from_function(function, y, {"a": Parameter(1.0), "k": Parameter(3.0)}))
    assert result.outcome is Outcome.INTERRUPTED
    assert result.criterion < result.trace["criterion"].iloc[0]


def test_the_iteration_limit_is_not_convergence() -> None:
    result = identify(two_output_problem(), Marquardt(max_iterations=1))
    assert not result.converged
    assert result.outcome is Outcome.ITERATION_LIMIT
    assert "raise max_iterations" in ending(result)
    assert result.iterations == 1


def test_variances_that_do_not_settle_are_not_convergence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identification, "MAX_ROUNDS", 1)
    result = identify(two_output_problem())
    assert result.outcome is Outcome.UNSETTLED
    assert not result.converged
    assert not at_minimum(result)
    assert "give them as noise.variance" in ending(result)


def test_the_trace() -> None:
    events: list[Event] = []
    result = identify(two_output_problem(), progress=events.append)
    seen = [event for event in events if isinstance(event, SearchStep)]
    assert len(seen) == len(events)
    assert list(result.trace.columns) == ["round", "iteration", "criterion", "lambda", "accepted", "k", "gain"]
    assert result.trace["iteration"].tolist() == [i.number for i in seen]
    assert result.trace["iteration"].iloc[-1] == result.iterations
    assert result.trace[["k", "gain"]].iloc[0].tolist() == result.start.tolist()
    assert result.trace["round"].iloc[-1] == len(result.rounds)
    assert result.simulations < 45
    assert result.elapsed_s > 0


def test_start_elsewhere() -> None:
    result = identify(two_output_problem(), start=[1.4, 2.1])
    assert result.start.tolist() == [1.4, 2.1]
    np.testing.assert_allclose(result.values, identify(two_output_problem()).values, rtol=1e-4)


def test_result_json_keeps_the_contract(tmp_path: Path) -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, prior=Normal(1.4, 0.1))}))
    data = result.to_json_dict()
    keys = {"outcome", "converged", "parameters", "covariance", "noise_variance", "criterion", "iterations"}
    assert keys | {"simulations", "elapsed_s", "version"} <= set(data)
    keys = {"value", "std", "white_std", "degrees_of_freedom", "start", "min", "max", "numerical_shift"}
    assert set(data["parameters"]["k"]) == keys | {"prior_mean", "prior_std", "pull"}
    assert set(data["parameters"]["gain"]) == keys
    assert data["covariance"]["names"] == ["k", "gain"]
    assert data["version"] == fmuid.__version__
    path = tmp_path / "result.json"
    path.write_text(json.dumps(data, allow_nan=False), encoding="utf-8")
    back = Result.from_json(path)
    for name in (
        "values",
        "start",
        "covariance",
        "std",
        "white_covariance",
        "freedom",
        "lower",
        "upper",
        "prior_mean",
        "prior_std",
    ):
        np.testing.assert_array_equal(getattr(back, name), getattr(result, name))
    pd.testing.assert_frame_equal(back.intervals(), result.intervals())
    assert back.to_json_dict() == data
    assert back.local is None


def test_undetermined_results_come_back(tmp_path: Path) -> None:
    result = identify(coil_problem(prior=False))
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result.to_json_dict(), allow_nan=False), encoding="utf-8")
    back = Result.from_json(path)
    assert np.isinf(back.std).all()
    assert back.undetermined == result.undetermined
    with pytest.raises(InputError, match="'R' is not determined"):
        back.prior()


def test_a_result_as_prior() -> None:
    result = identify(two_output_problem())
    joint = result.prior(["gain", "k"], inflate=10.0)
    # with the standard deviations whose normal intervals are those of the result
    wider = np.asarray(stats.t.ppf(0.975, result.freedom)) / norm.ppf(0.975)
    expected = 100.0 * result.covariance * np.outer(wider, wider)
    np.testing.assert_allclose(joint.covariance, expected[::-1, ::-1])
    assert joint.mean.tolist() == [result["gain"], result["k"]]
    assert result.normal("k", inflate=2.0).std == pytest.approx(2.0 * wider[0] * result.std[0])
    with pytest.raises(InputError, match="no parameter 'x'"):
        result.prior(["x"])
    with pytest.raises(InputError, match="inflate"):
        result.prior(inflate=0.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not JSON"),
        ("{}", "does not say which fmuid has written it: give the result.json of .*, or run fmuid identify again$"),
        ('{"version": 1}', "does not say which fmuid has written it"),
        ("[]", "does not say which fmuid has written it"),
        ('{"version": "0.1.0"}', r"which fmuid 0\.1\.0 has written, has no 'parameters', .*: run fmuid identify again"),
    ],
)
def test_files_that_are_no_results(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "result.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        Result.from_json(path)
    with pytest.raises(InputError, match="cannot be read"):
        Result.from_json(tmp_path / "missing.json")


def test_results_of_other_versions_are_one_sentence(tmp_path: Path) -> None:
    path, whole = tmp_path / "result.json", identify(two_output_problem()).to_json_dict() | {"version": "0.0.9"}

    def said(content: object) -> str:
        path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError) as caught:
            Result.from_json(path)
        text = str(caught.value)
        assert text.startswith(f"{path}, which fmuid 0.0.9 has written, ")
        assert text.endswith("run fmuid identify again") and "\n" not in text
        return text

    for key in ("outcome", "parameters", "covariance", "noise_variance", "criterion", "iterations", "elapsed_s"):
        assert f"has no '{key}', which fmuid {__version__} needs" in said({k: v for k, v in whole.items() if k != key})
    for key in whole.keys() - {"version", "converged", "moved_start"}:
        assert f"has something in '{key}' that fmuid {__version__} cannot read" in said(whole | {key: "of old"})
    models = {"": {"name": "Coil", "digest": "1", "run": "co-simulation"}}
    assert "has something in 'models'" in said(whole | {"models": models})
    direction = {"names": ["k"], "coefficients": [1.0], "values": [1.0], "magnitudes": [1.0], "std": 1.0}
    assert "has no 'determined' in 'weak'" in said(whole | {"weak": [direction]})
    negative = {"names": list(whole["parameters"]), "matrix": np.diag([1.0, -1.0]).tolist()}
    assert "cannot be right: a variance is negative" in said(whole | {"covariance": negative})
    assert "the names of parameters and covariance differ" in said(
        whole | {"covariance": negative | {"names": ["x", "y"]}}
    )


def test_the_level_of_an_interval() -> None:
    result = identify(two_output_problem())
    wide, narrow = result.intervals(0.99), result.intervals(0.5)
    assert (wide["lower"] < narrow["lower"]).all()
    with pytest.raises(InputError, match="between 0 and 1"):
        result.intervals(95)


def test_estimates_as_a_table() -> None:
    result = identify(two_output_problem())
    table = result.to_frame()
    assert table.index.tolist() == ["k", "gain"]
    np.testing.assert_array_equal(table["value"], result.values)
    assert table["prior_mean"].isna().all()
    correlation = result.correlation
    assert correlation.loc["k", "k"] == pytest.approx(1.0)
    expected = result.covariance[0, 1] / np.prod(result.std)
    assert correlation.loc["k", "gain"] == pytest.approx(expected)
