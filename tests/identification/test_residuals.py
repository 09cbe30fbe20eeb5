"""Residual diagnostics: rows and gaps, tests and their words, the scatter of estimates in coloured noise, figures."""

import json
import math
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, InputError, Noise, Normal, Parameter, analyze_residuals
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import LeastSquares
from fmuid.estimation.predictors import FunctionPredictor
from fmuid.identification import ResidualAnalysis, ResidualDefect, ResidualSeries, identify
from fmuid.identification.residual_series import examine_outputs
from tests.support.problems import ar1
from tests.support.results import changed

COUNT = 1000
TIMES: Floats = 0.01 * np.arange(float(COUNT))
INPUT = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], COUNT // 10), 10)
REGRESSORS = np.column_stack([np.ones(COUNT), np.sin(2.0 * TIMES), np.sin(200.0 * TIMES)])
TRUTH = np.array([2.0, 1.0, 0.5])
PARAMETERS = {"level": Parameter(1.0), "slow": Parameter(2.0), "fast": Parameter(1.0)}


def examined(errors: Floats, **words: Any) -> ResidualAnalysis:
    """Examine the residuals of a model linear in its parameters whose one output is measured with `errors`."""
    frame = pd.DataFrame({"time": TIMES, "u": INPUT, "y": REGRESSORS @ TRUTH + errors})
    experiment = Experiment(frame, inputs=["u"], outputs=["y"], warmup=words.pop("warmup", 0.0))
    predictor = FunctionPredictor(lambda theta: REGRESSORS @ theta, (COUNT, 1))
    problem = LeastSquares([predictor], [experiment], PARAMETERS | words.pop("parameters", {}), **words)
    return analyze_residuals(problem, identify(problem))


def white(seed: int) -> Floats:
    return np.random.default_rng(seed).standard_normal(COUNT)


def only(found: ResidualAnalysis) -> ResidualSeries:
    (series,) = found.series
    return series


def traits(found: ResidualAnalysis) -> list[tuple[ResidualDefect, bool]]:
    return [(each.trait, each.large) for each in found.findings]


def test_white_noise_has_no_defect() -> None:
    found = examined(white(1))
    assert traits(found) == []
    assert found.widening == {name: pytest.approx(1.0, abs=0.15) for name in ("level", "slow", "fast")}
    series = only(found)
    assert (series.samples, series.whiteness.lags) == (COUNT, 25)
    assert series.std == pytest.approx(1.0, rel=0.1)


@pytest.mark.slow
def test_defects_are_rarely_found_in_white_noise() -> None:
    """Of 40 draws of white normal noise, hardly any has one."""
    assert sum(bool(traits(examined(white(seed)))) for seed in range(40)) <= 4


def test_colored_noise_is_a_defect() -> None:
    found = examined(ar1(np.random.default_rng(3), 0.9, COUNT))
    assert traits(found) == [(ResidualDefect.COLORED, True)]
    assert only(found).noise.variance_factor() == pytest.approx(19.0, rel=0.4)
    assert found.table["correlation_time"][0] == pytest.approx(0.19, rel=0.4)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_low_frequency_noise(share: float) -> None:
    """Of 98 % from sample to sample: a time constant of 50 samples, 0.5 s, and 20 % of the variance."""
    rng = np.random.default_rng(3)
    noise = np.sqrt(1.0 - share) * white(23) + np.sqrt(share) * ar1(rng, 0.98, COUNT)
    found = examined(noise)
    assert len(found.slow) == (share > 0.0)
    for each in found.slow:
        assert each.time_constant == pytest.approx(0.5, rel=0.5)
        assert each.share == pytest.approx(share, abs=0.08)
        assert as_json(found)["slow"][0]["output"] == "y"


@pytest.mark.parametrize("share", [0.0, 0.8, 0.999])
def test_noise_too_slow_for_its_data(share: float) -> None:
    """A time constant of 1000 samples in 1000; of 4.5, and none."""
    found = examined(ar1(np.random.default_rng(2), share, COUNT))
    assert len(found.long_memory) == (share > 0.9)
    for each in found.long_memory:
        assert (each.output, each.experiments) == ("y", ("experiment",))
        assert 2.0 < each.time_constant <= 10.0
        assert as_json(found)["long_memory"][0]["record"] == pytest.approx(10.0)


@pytest.mark.parametrize(("share", "seeds"), [(-0.8, range(5, 6)), (0.9, range(100, 108))])
def test_the_scatter_of_estimates_in_coloured_noise(share: float, seeds: range) -> None:
    """A sine of ω radians a sample meets noise of the spectral density (1 − a²)/(1 + a² − 2 a cos ω)."""
    draws = [examined(ar1(np.random.default_rng(seed), share, COUNT)).widening for seed in seeds]
    for name, omega in (("level", 0.0), ("slow", 0.02), ("fast", 2.0)):
        density = (1.0 - share**2) / (1.0 + share**2 - 2.0 * share * math.cos(omega))
        assert np.mean([each[name] for each in draws]) == pytest.approx(math.sqrt(density), rel=0.2)


def test_a_prior_feels_no_colour() -> None:
    """An estimate that rests on its prior does not scatter with the noise."""
    noise = ar1(np.random.default_rng(6), 0.9, COUNT)
    alone = examined(noise).widening
    prior = {"level": Parameter(1.0, prior=Normal(2.0, 1e-4))}
    with_prior = examined(noise, parameters=prior).widening
    assert alone["level"] > 3.0
    assert with_prior["level"] == pytest.approx(1.0, abs=0.01)
    assert with_prior["slow"] == pytest.approx(alone["slow"], rel=0.05)


def test_a_forgotten_input_is_named() -> None:
    noise = white(8)
    noise[5:] += 0.6 * INPUT[:-5]
    found = examined(noise)
    (one,) = only(found).inputs
    assert one.input == "u"
    assert one.lag == pytest.approx(0.05)
    assert one.correlation == pytest.approx(0.6 / math.sqrt(1.36), abs=0.08)
    assert (ResidualDefect.INPUT, True) in traits(found)
    assert found.table["input"].tolist() == ["u"]


def test_residuals_that_cannot_be_examined() -> None:
    assert not only(examined(np.zeros(COUNT), noise=Noise(1.0))).is_tested
    series = only(examined(white(1), warmup=TIMES[-1] - 0.1))
    assert (series.samples, series.is_tested) == (11, False)
    assert math.isnan(series.whiteness.statistic)


def test_rows_of_several_outputs_and_experiments() -> None:
    """Two experiments of two outputs each, with gaps and a transient that does not count."""
    rng = np.random.default_rng(11)
    experiments = []
    for name in ("first", "second"):
        noise = rng.standard_normal((COUNT, 2)) * [1, 30]
        y = np.column_stack([REGRESSORS @ TRUTH, 100.0 * REGRESSORS @ TRUTH]) + noise
        y[rng.random(y.shape) < 0.1] = np.nan
        frame = pd.DataFrame({"time": TIMES, "u": INPUT, "a": y[:, 0], "b": y[:, 1]})
        experiments.append(Experiment(frame, inputs=["u"], outputs=["a", "b"], warmup=0.5, name=name))
    predictor = FunctionPredictor(lambda t: np.column_stack([REGRESSORS @ t, 100.0 * REGRESSORS @ t]), (COUNT, 2))
    problem = LeastSquares([predictor, predictor], experiments, PARAMETERS)
    result = identify(problem)
    found = analyze_residuals(problem, result)
    assert [(each.experiment, each.output) for each in found.series] == [
        (experiment, output) for experiment in ("first", "second") for output in ("a", "b")
    ]
    assert result.fit.linearization is not None
    rows = np.concatenate([each.noise.series.rows for each in found.series])
    assert sorted(rows.tolist()) == list(range(problem.measured.size))
    for each in found.series:
        assert np.isnan(each.residual[each.times < 0.5]).all()
        whitened = each.residual[np.isfinite(each.residual)] / math.sqrt(result.fit.variance[each.output])
        np.testing.assert_allclose(whitened, result.fit.linearization.residual[each.noise.series.rows], rtol=1e-9)
        kept = np.flatnonzero(np.isfinite(each.residual))
        np.testing.assert_array_equal(each.noise.series.places, kept)
        assert each.noise.series.step == pytest.approx(0.01)
    written = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert len(written["findings"]) == len(found.findings)
    assert set(written["widening"]) == {"level", "slow", "fast"}
    assert [row["output"] for row in written["series"]] == found.table["output"].tolist()
    assert written["series"][3]["inputs"][0]["input"] == "u"
    assert written["series"][0]["std"] == found.table["std"][0]
    with pytest.raises(InputError, match="Identify the study again"):
        analyze_residuals(problem, changed(result, noise=None))


def test_correlations_with_inputs_are_those_of_the_definition() -> None:
    """Mean of the products over the pairs there are; y and z count alike, g has gaps, c does not move."""
    rng = np.random.default_rng(21)
    times = 0.01 * np.arange(300.0)
    inputs = rng.standard_normal((300, 2)).cumsum(axis=0)
    simulated = np.column_stack([np.sin(times), np.cos(times), times])
    measured = simulated + rng.standard_normal((300, 3))
    measured[2:, 1] += 0.3 * inputs[:-2, 0]
    measured[40:60, 2] = np.nan
    columns = dict(zip("tuvyzg", [times, *inputs.T, *measured.T], strict=True))
    frame = pd.DataFrame(columns | {"c": 5.0})
    experiment = Experiment(frame, inputs=["u", "v", "c"], outputs=["y", "z", "g"], time="t", warmup=0.5)
    series = examine_outputs(experiment, simulated)
    assert [each.output for each in series] == ["y", "z", "g"]
    for column, each in enumerate(series):
        there = np.flatnonzero(experiment.counted[:, column])
        residual = (experiment.output_values - simulated)[there, column]
        assert [one.input for one in each.inputs] == ["u", "v"]
        for one, values in zip(each.inputs, experiment.input_values.T, strict=False):
            on_grid = values[there[0] : there[-1] + 1]
            for lag in range(len(one.values)):
                product = (residual - residual.mean()) * (values[there - lag] - on_grid.mean())
                assert one.values[lag] == pytest.approx(product.mean() / residual.std() / on_grid.std(), abs=1e-9)
            assert one.lags == pytest.approx(0.01 * np.arange(len(one.values)))


def test_an_output_that_one_experiment_lacks() -> None:
    """Tables that are no experiments may have outputs without a sample that counts."""
    y = REGRESSORS @ TRUTH + white(14)
    values = np.column_stack([y, np.full(COUNT, np.nan)])
    tables = [
        Experiment.of_arrays(name, TIMES, ("a", "b"), v, np.isfinite(v))
        for name, v in (("one", values), ("two", values[:, ::-1]))
    ]
    predictor = FunctionPredictor(lambda theta: np.column_stack([REGRESSORS @ theta] * 2), (COUNT, 2))
    problem = LeastSquares([predictor, predictor], tables, PARAMETERS)
    found = analyze_residuals(problem, identify(problem))
    assert [(each.experiment, each.output) for each in found.series] == [("one", "a"), ("two", "b")]
