"""The page of the coil by its equation: its table is what the committed draws say, and these are what comes out."""

import numpy as np
import pandas as pd
import pytest

from experiments.coil import study as coil
from experiments.equation_error import study
from fmuid.estimation import Term
from fmuid.estimation.equation_error import StateVariableFilter
from tests.support.quick import first


@pytest.fixture(scope="module")
def committed() -> pd.DataFrame:
    return pd.read_csv(study.HERE / "bias.csv")


def test_the_filter_of_the_theory_is_that_of_the_package() -> None:
    signal = coil.current(coil.R, coil.L)
    own = StateVariableFilter(study.TIMES, study.NEAR, 2).columns([Term(signal), Term(signal, 1)])
    assert study.lags(study.NEAR, signal) == pytest.approx(own, abs=1e-10)


@pytest.mark.parametrize("method", first(2, study.METHODS))
def test_the_draws_come_out_and_agree_with_theory(committed: pd.DataFrame, method: str) -> None:
    for ratio in (1000.0, 3.0):
        errors = 100.0 * study.draws(method, ratio, 2)
        part = committed[(committed["method"] == method) & (committed["ratio"] == ratio)]
        expected = 100.0 * study.theory(method, ratio)
        assert part["theory"].to_numpy() == pytest.approx(expected, abs=1e-3)
        assert (np.abs(part["mean"] - part["theory"]) < 4.0 * part["std"] / np.sqrt(study.DRAWS)).all()
        assert (np.abs(errors - part["mean"].to_numpy()) < 4.0 * part["std"].to_numpy()).all()


def test_what_the_page_says(committed: pd.DataFrame) -> None:
    means = committed.set_index(["method", "ratio", "parameter"])["mean"]
    unbiased = means[[name.startswith(("IV", "output")) for name in means.index.get_level_values("method")]]
    assert (unbiased.abs() <= 0.4).all()
    assert means["difference equation", 10.0, "R"] > 100.0
    assert means["filter at 400 rad/s", 10.0, "L"] < -15.0 < means["filter at 40 rad/s", 10.0, "L"]
