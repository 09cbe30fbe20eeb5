"""What the chapter's estimates of the induction machine show, and that the page says so."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments import pages
from experiments.induction_machine import chapter, make_table

README = (chapter.HERE / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return fmuid.read_data(chapter.HERE / "table.csv")


@pytest.fixture(scope="module")
def repetition(table: pd.DataFrame) -> pd.DataFrame:
    return chapter.repetition(chapter.experiment(table))


@pytest.fixture(scope="module")
def pair(table: pd.DataFrame) -> dict[str, fmuid.Result]:
    return chapter.pair(chapter.experiment(table))


@pytest.fixture(scope="module")
def committed() -> np.ndarray:
    """The errors of the committed draws, (draws, 3, 4)."""
    rows = pd.read_csv(chapter.HERE / "draws.csv").to_numpy()
    return rows.reshape(len(rows), len(chapter.KINDS), -1)


def test_the_prior_study_gives_the_same_estimates(pair: dict[str, fmuid.Result]) -> None:
    result = fmuid.Study.read(chapter.HERE / "study_prior.toml").identify()
    assert result.converged
    assert (np.abs(result.values - pair["with prior"].values) < 0.01 * result.std).all()
    assert result.std == pytest.approx(pair["with prior"].std, rel=1e-3)


def test_the_prior_sharpens_every_estimate_as_the_barycentre_says(pair: dict[str, fmuid.Result]) -> None:
    """(1.54–1.56): the data-only paraboloid and the prior's add up, in curvature and in what they pull towards."""
    alone, both = pair["without prior"], pair["with prior"]
    data, prior = np.linalg.inv(alone.covariance), np.diag(chapter.PRIOR_STD**-2)
    covariance = np.linalg.inv(data + prior)
    assert both.std == pytest.approx(np.sqrt(np.diag(covariance)), rel=0.01)
    # the criterion weighs every sample alike, also where noise is slow
    weights = np.linalg.inv(alone.estimates.covariance_white_noise)
    barycentre = np.linalg.solve(weights + prior, weights @ alone.values + prior @ chapter.PRIOR_MEAN)
    assert (np.abs(both.values - barycentre) < 0.02 * both.std).all()
    assert (np.abs(both.values - chapter.TRUTH) < 3 * both.std).all()


@pytest.mark.parametrize("seed", [None, 7])
def test_one_repetition_finds_the_variance_of_the_noise_drawn(
    clean: pd.DataFrame, table: pd.DataFrame, seed: int | None
) -> None:
    if seed is not None:
        table = make_table.add_noise(clean, 2 * make_table.NOISE_VARIANCE, np.random.default_rng(seed))
    drawn, found = chapter.drawn_variance(clean, table), chapter.repetition(chapter.experiment(table))
    repeated = found[found["searches"] == 2]
    assert len(repeated) == 2 * len(chapter.FIRST_VARIANCES)
    assert repeated["both"].to_numpy() == pytest.approx(drawn["both"], rel=0.02)
    right = repeated[repeated["prior"] == "the chapter's"]
    for name in chapter.OUTPUTS:
        assert right[name].to_numpy() == pytest.approx(drawn[name], rel=0.003)
    # the repetition had something to do: a wrong prior that weighs too much shows in the first residual
    first = found[(found["searches"] == 1) & (found["first"] == 10.0) & (found["prior"] != "the chapter's")]
    assert first["both"].item() > 1.05 * drawn["both"]


def check_both_are_nearest(errors: np.ndarray) -> None:
    means = chapter.root_mean_squares(errors)
    assert (means.loc["both"] < means.loc["prior alone"]).all()
    assert (means.loc["both"] < means.loc["data alone"]).all()


@pytest.mark.slow
def test_prior_and_data_together_are_nearer_to_the_truth_than_either(
    clean: pd.DataFrame, pair: dict[str, fmuid.Result]
) -> None:
    errors = chapter.draws(clean, 40, seed=2)
    check_both_are_nearest(errors)
    # and as near as the covariance says: 160 squares, whose mean is known within 11 % (22 % for strong correlations)
    squares = np.mean((errors[:, 2] * chapter.PRIOR_STD / pair["with prior"].std) ** 2)
    assert squares == pytest.approx(1.0, abs=0.4)


def test_the_committed_draws_are_these(clean: pd.DataFrame, committed: np.ndarray) -> None:
    assert len(committed) == chapter.DRAWS
    check_both_are_nearest(committed)
    assert chapter.draws(clean, 3, chapter.SEED) == pytest.approx(committed[:3], abs=2e-3)


def test_the_page_shows_what_comes_out(
    clean: pd.DataFrame,
    table: pd.DataFrame,
    pair: dict[str, fmuid.Result],
    repetition: pd.DataFrame,
    committed: np.ndarray,
) -> None:
    tables = {
        "estimates": chapter.estimates_table(pair),
        "variance": chapter.variance_table(repetition, chapter.drawn_variance(clean, table)),
        "draws": chapter.draws_table(committed),
    }
    assert pages.insert(README, tables) == README, "run python -m experiments.induction_machine.chapter"
