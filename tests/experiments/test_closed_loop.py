"""The study of the closed-loop bias (docs/method/covariance.md): its loop, its prediction, and what the page says."""

import numpy as np
import pandas as pd
import pytest

from experiments.closed_loop_bias import study

OPEN, WHITE, COLORED, WHOLE = study.KINDS


@pytest.fixture(scope="module")
def committed() -> pd.DataFrame:
    return pd.read_csv(study.HERE / "bias.csv")


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
