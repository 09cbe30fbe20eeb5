"""Words and numbers for people: how values, deviations and intervals are written, and which words end a search."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fmuid.data import Parameter
from fmuid.estimation.local_search import Marquardt
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.search.loop import TerminationReason
from fmuid.files import file_name
from fmuid.formatting import rounded, with_std
from fmuid.identification import identify
from fmuid.reports.topics import uncertainty
from fmuid.runs.findings import at_minimum
from tests.support.said import ending


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (9.8434, 0.0418, "9.843 ± 0.042"),
        (0.0012345678, 1.2e-7, "0.00123457 ± 0.00000012"),
        (1234.5, 98.0, "1234 ± 98"),
        (1234567.0, 23456.0, "1.235e+06 ± 2.3e+04"),
        (-4.7e3, 1.6e10, "0 ± 1.6e+10"),  # nothing of the value is known
        (2.6e10, 1.6e10, "2.6e+10 ± 1.6e+10"),
        (4.0, math.inf, "4"),
        (4.0, 0.0, "4"),
    ],
)
def test_value_and_standard_deviation(value: float, std: float, shown: str) -> None:
    assert with_std(value, std) == shown


def test_rounded_without_deviation() -> None:
    assert rounded(math.pi, math.nan) == "3.14159"


@pytest.mark.parametrize(
    ("ends", "shown"),
    [
        ((3.608, 3.915), "3.608 to 3.915"),
        ((-math.inf, math.inf), "not identifiable"),
        ((0.0013772, math.inf), "above 0.001"),
        ((-math.inf, 0.05), "below 0.0500"),
        ((math.nan, 1.0), ""),
    ],
)
def test_interval(ends: tuple[float, float], shown: str) -> None:
    assert uncertainty._interval(*ends, value=0.04) == shown


def test_file_name() -> None:
    assert file_name("i_start[run 1]-drive.M/x") == "i_start_run_1_-drive.M_x"


@pytest.mark.parametrize(("iterations", "ended"), [(1000, True), (1, False)])
def test_at_minimum(iterations: int, ended: bool) -> None:
    x = np.linspace(0.0, 1.0, 20)
    problem = LeastSquares.from_function(lambda t: np.exp(-t[0] * x), np.exp(-2.0 * x), {"a": Parameter(20.0)})
    result = identify(problem, Marquardt(iterations))
    assert at_minimum(result) is ended
    assert (result.outcome is TerminationReason.ITERATION_LIMIT) is not ended


ENDED = {TerminationReason.CONVERGED, TerminationReason.ACCURACY, TerminationReason.UNDETERMINED}


@pytest.mark.parametrize("outcome", TerminationReason)
def test_what_may_be_asked_for_more(outcome: TerminationReason) -> None:
    """Not a criterion whose noise variances still move, either: it is another one the next time."""
    x = np.linspace(0.0, 1.0, 20)
    problem = LeastSquares.from_function(lambda t: np.exp(-t[0] * x), np.exp(-2.0 * x), {"a": Parameter(20.0)})
    result = replace(identify(problem), outcome=outcome)
    assert at_minimum(result) is (outcome in ENDED)
    assert result.converged is (outcome in ENDED - {TerminationReason.UNDETERMINED})
    assert ending(result)
