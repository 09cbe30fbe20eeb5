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


def check_both_are_nearest(errors: np.ndarray) -> None:
    means = chapter.root_mean_squares(errors)
    assert (means.loc["both"] < means.loc["prior alone"]).all()
    assert (means.loc["both"] < means.loc["data alone"]).all()


@pytest.mark.slow
def test_the_committed_draws_are_these(clean: pd.DataFrame, committed: np.ndarray) -> None:
    assert len(committed) == chapter.DRAWS
    check_both_are_nearest(committed)
    assert chapter.draws(clean, 3, chapter.SEED) == pytest.approx(committed[:3], abs=2e-3)


@pytest.mark.slow
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
