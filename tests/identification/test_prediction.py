"""Predictions against closed forms: errors, and bands by the noise, the estimates and what is estimated again."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from fmuid import Experiment, InputError, Parameter, Problem, Result, SimulationError, Simulator
from fmuid.array_types import Floats, Simulations
from fmuid.codec import as_json
from fmuid.data import FrequencyExperiment, Response
from fmuid.identification import OutputScore, identify, predict_by_model, prediction
from tests.support.paths import FMUS
from tests.support.results import changed

COIL = FMUS / "Coil/Coil.fmu"
R, L, STEP, NOISE, COUNT = 4.0, 0.1, 1e-3, 0.02, 400


def current(theta: Floats, voltage: Floats, start: float) -> Floats:
    """The current of a coil, exact for a held voltage."""
    decay = math.exp(-theta[0] / theta[1] * STEP)
    driven = lfilter([0.0, (1.0 - decay) / theta[0]], [1.0, -decay], voltage)
    return np.asarray(driven + start * decay ** np.arange(voltage.size))


def record(seed: int, start: float = 0.0, name: str = "new", noise: float = NOISE) -> Experiment:
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.choice([-1.0, 1.0], COUNT // 20), 20)
    y = current(np.array([R, L]), voltage, start) + noise * rng.standard_normal(COUNT)
    frame = pd.DataFrame({"time": STEP * np.arange(COUNT), "u": voltage, "i": y})
    return Experiment(frame, ["u"], ["i"], interpolation="zoh", name=name)


def identified(**more: Parameter) -> Result:
    parameters = {"R": Parameter(6.0, min=0.0), "L": Parameter(0.05, min=1e-3), **more}
    return identify(Problem(COIL, [record(1, name="first"), record(2, name="second")], parameters))


@pytest.fixture(scope="module")
def result() -> Result:
    return identified()


def test_scores_are_those_of_the_closed_form(result: Result) -> None:
    fresh = record(5)
    found = predict_by_model(COIL, result, fresh)
    measured, exact = fresh.output_values[:, 0], current(result.values, fresh.input_values[:, 0], 0.0)
    (score,) = found.scores
    error = measured - exact
    assert score.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-4)
    assert score.fit == pytest.approx(100 * (1 - np.linalg.norm(error) / np.linalg.norm(measured - measured.mean())))
    assert (score.output, score.unit, score.samples) == ("i", "A", COUNT)
    assert list(found.table.columns) == ["time", "measured.i", "simulated.i", "std.i", "lower.i", "upper.i", "input.u"]
    assert found.table["measured.i"].between(found.table["lower.i"], found.table["upper.i"]).mean() == score.inside
    content: dict[str, Any] = as_json(found)
    assert (content["scores"][0]["rmse"], content["estimated"]) == (score.rmse, None)


def test_the_band_is_that_of_noise_and_estimates(result: Result) -> None:
    fresh = record(5)
    found = predict_by_model(COIL, result, fresh, level=0.9)
    step = 1e-4 * result.values
    voltage = fresh.input_values[:, 0]
    slopes = np.column_stack(
        [(current(result.values + d, voltage, 0.0) - current(result.values - d, voltage, 0.0)) / (2 * d.sum())
         for d in np.diag(step)]
    )  # fmt: skip
    variance = np.sum((slopes @ result.covariance) * slopes, axis=1)
    np.testing.assert_allclose(found.std[1:, 0] ** 2, variance[1:], rtol=2e-2, atol=1e-12)
    noise = result.fit.noise_variance["i"]
    np.testing.assert_allclose(found.half_width[:, 0], 1.647 * np.sqrt(noise + variance), rtol=2e-3)
    assert found.scores[0].expected == pytest.approx(math.sqrt(noise + variance.mean()), rel=1e-3)


def test_the_band_allows_for_what_is_estimated_again(result: Result) -> None:
    """Against many draws of noise and estimates, each with its start estimated by linear least squares."""
    wide = changed(result, covariance=200.0 * result.covariance)  # so that both parts are seen
    fresh = record(7, start=0.4)
    found = predict_by_model(COIL, wide, fresh, free={"i_start": Parameter(0.4)})
    rng, voltage = np.random.default_rng(3), fresh.input_values[:, 0]
    sigma = math.sqrt(result.fit.noise_variance["i"])
    truth, predicted = current(result.values, voltage, 0.4), []
    for theta in rng.multivariate_normal(result.values, wide.covariance, 1500):
        regressor = current(theta, 0.0 * voltage, 1.0)
        rest = truth + sigma * rng.standard_normal(COUNT) - current(theta, voltage, 0.0)
        predicted.append(current(theta, voltage, float(regressor @ rest / (regressor @ regressor))))
    spread = np.std(predicted, axis=0)
    ratio = found.std[:, 0] / spread
    assert np.median(np.abs(ratio - 1.0)) < 0.06
    assert found.std[0, 0] == pytest.approx(spread[0], rel=0.1)


def test_parameters_that_are_not_determined_are_no_part_of_the_band(result: Result) -> None:
    covariance = result.covariance.copy()
    covariance[0, :] = covariance[:, 0] = np.nan
    covariance[0, 0] = np.inf
    found = predict_by_model(COIL, changed(result, covariance=covariance), record(5))
    assert found.undetermined == ("R",)
    assert np.isnan(found.std).all()
    np.testing.assert_allclose(found.half_width, 1.963 * math.sqrt(result.fit.noise_variance["i"]), rtol=2e-3)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_beside_what_cannot_be_simulated_slopes_are_one_sided(
    result: Result, sign: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Edge(Simulator):
        def many(self, thetas: ArrayLike) -> Simulations:
            found = super().many(thetas)
            errors = list(found.errors)
            for i in np.flatnonzero(sign * (np.asarray(thetas)[:, 0] - result["R"]) > 0):
                found.outputs[i], errors[i] = np.nan, SimulationError("Coil", 0.0, {}, "fmi2DoStep")
            return Simulations(found.outputs, tuple(errors))

    free = predict_by_model(COIL, result, record(5))
    monkeypatch.setattr(
        prediction, "simulator_of", lambda *given: Edge(*given[:3], values=given[3], step_size=given[4])
    )
    beside = predict_by_model(COIL, result, record(5))
    np.testing.assert_allclose(beside.std[1:], free.std[1:], rtol=0.05)


def test_values_for_each_experiment_are_those_of_the_record_it_was_made_from() -> None:
    start = Parameter(0.0, nominal=0.1, per_experiment=True)
    made = identified(i_start=start)
    first = predict_by_model(COIL, made, record(1, name="first"))
    assert first.scores[0].ratio == pytest.approx(1.0, abs=0.1)
    with pytest.raises(InputError, match=r"'i_start' for first, second but not for first.*--refit"):
        predict_by_model(COIL, made, record(9, name="first"))  # another record of that name
    again = predict_by_model(COIL, made, record(9, start=0.3, name="other"), free={"i_start": start})
    assert again.estimated is not None
    assert abs(again.estimated["i_start"] - 0.3) < 4 * again.estimated.std[0]
    assert again.scores[0].ratio == pytest.approx(1.0, abs=0.1)
    assert predict_by_model(COIL, identified(), record(9, start=0.3)).scores[0].ratio > 1.5


def test_another_model_is_refused(result: Result) -> None:
    other = FMUS / "PositionController/PositionController.fmu"
    with pytest.raises(InputError, match=r"the result is of another model: .* has no 'L'"):
        predict_by_model(other, changed(result, names=("kp", "L")), record(5))
    with pytest.raises(InputError, match="level of a band"):
        predict_by_model(COIL, result, record(5), level=1.0)
    with pytest.raises(SimulationError):
        predict_by_model(COIL, changed(result, values=np.array([R, 0.0])), record(5))


@pytest.mark.parametrize(
    ("samples", "ratio", "is_worse"), [(6, 1.6, False), (6, 1.7, True), (600, 1.2, False), (600, 1.3, True)]
)
def test_a_few_samples_are_worse_than_expected_beyond_chance(samples: int, ratio: float, is_worse: bool) -> None:
    """Of 6 samples, 1 % have √(χ²/6) above 1.674."""
    assert OutputScore("i", "A", samples, ratio, 0.0, 90.0, 1.0, ratio, 0.9).is_worse is is_worse


def test_errors_count_in_their_own_noise() -> None:
    """A spectrum has noise in proportion to its magnitude: the ratio is that of relative errors."""
    rows = np.logspace(-1.0, 2.0, 31)
    random = np.random.default_rng(1)
    noise = 0.002 * (random.normal(size=(2, 31)) + 1j * random.normal(size=(2, 31)))
    parts = (4.0 + 0.2j * np.pi * rows) * (1.0 + noise)
    made = [
        FrequencyExperiment(
            pd.DataFrame({"f": rows, "re": each.real, "im": each.imag}),
            frequency="f",
            responses={"Z": Response("u / i", real="re", imaginary="im")},
        )
        for each in parts
    ]
    free = {"R": Parameter(3.0, min=0.1), "L": Parameter(0.2, min=0.01)}
    result = identify(Problem(COIL, made[0], free))
    score, _ = predict_by_model(COIL, result, made[1]).scores
    relative = (parts[1].real - 4.0) / (0.002 * np.abs(parts[1]))
    assert score.ratio == pytest.approx(np.sqrt(np.mean(relative**2)), rel=0.25)
    assert not score.is_worse
