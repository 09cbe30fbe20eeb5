"""What the chapter's estimates of the induction machine show, and that the page says so."""

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments import pages
from experiments.induction_machine import chapter

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
