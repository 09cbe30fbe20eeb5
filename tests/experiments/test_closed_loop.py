"""The study of the closed-loop bias (docs/method/covariance.md): its loop, its prediction, and what the page says."""

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments.closed_loop_bias import study

OPEN, WHITE, COLORED, WHOLE = study.KINDS


@pytest.fixture(scope="module")
def committed() -> pd.DataFrame:
    return pd.read_csv(study.HERE / "bias.csv")


def test_the_noise_is_stationary_and_as_correlated_as_it_says() -> None:
    rng = np.random.default_rng(5)
    drawn = np.array([study.noise(rng, study.COLOR) for _ in range(400)])
    for lag in (0, 1, 5):
        products = drawn[:, lag:] * drawn[:, : study.SAMPLES - lag]
        assert products.mean() == pytest.approx(study.COLOR**lag, abs=0.02)
    assert drawn[:, 0].var() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 400))


def test_sensitivities_are_those_of_the_model() -> None:
    """Against central differences of the FMU."""
    record = study.simulate(np.zeros(study.SAMPLES))
    experiment = fmuid.Experiment(record, ["u"], ["i"], interpolation="zoh")
    simulator = fmuid.Simulator(study.coil(), experiment, study.NAMES)
    found = study.sensitivities(record["u"].to_numpy())
    for k, step in enumerate(1e-4 * np.diag(study.TRUTH)):
        difference = (simulator(study.TRUTH + step) - simulator(study.TRUTH - step)) / (2 * step[k])
        np.testing.assert_allclose(found[:, k], difference[:, 0], rtol=0, atol=1e-6 * np.abs(difference).max())


def test_only_colored_noise_in_closed_loop_makes_a_bias(committed: pd.DataFrame) -> None:
    """At a ratio of 3; other noise is off by chance, and by its squared std (section 4 is of first order)."""
    weak = committed[committed["ratio"] == 3.0]
    by_chance = weak[weak["kind"] != COLORED]
    assert {*by_chance["kind"]} == {OPEN, WHITE, WHOLE}
    assert (by_chance["bias"].abs() < 3.5 * by_chance["error"] + by_chance["std"] ** 2).all()
    biased = weak[weak["kind"] == COLORED]
    assert (biased["bias"] > 10 * biased["error"]).all()
    assert biased["bias"].to_numpy() == pytest.approx(biased["predicted"].to_numpy(), rel=0.25)


def test_the_bias_grows_as_the_signal_gets_weaker_and_as_predicted(committed: pd.DataFrame) -> None:
    colored = committed[committed["kind"] == COLORED]
    for _, part in colored.groupby("parameter"):
        strong = part[part["ratio"] >= 10]
        assert (np.diff(part["bias"]) > 0).all()  # ratios fall
        assert ((strong["bias"] - strong["predicted"]).abs() < 3 * strong["error"]).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [COLORED, OPEN, WHITE])
def test_the_committed_numbers_are_these(kind: str, committed: pd.DataFrame) -> None:
    """All draws at a signal-to-noise ratio of 3, drawn anew; the loop identified whole takes longer."""
    weak = study.cell(kind, 3.0)
    assert len(committed) == len(study.KINDS) * len(study.RATIOS) * len(study.NAMES)
    numbers = ["bias", "error", "std", "predicted"]
    found = weak.merge(committed, on=["kind", "ratio", "parameter"], suffixes=("", " committed"))
    assert len(found) == len(weak)
    for name in numbers:  # a search ends within a small part of a standard deviation of the optimum
        assert found[name].to_numpy() == pytest.approx(found[f"{name} committed"].to_numpy(), rel=1e-3, abs=1e-5)


def test_the_loop_identified_whole_keeps_its_sampled_control() -> None:
    """A controller that acts more often than once a sample would make L some 2 % too large."""
    record = study.simulate(1e-4 * np.random.default_rng(6).standard_normal(study.SAMPLES))
    assert study.estimate(record, whole=True).values == pytest.approx(study.TRUTH, rel=5e-3)
