"""Words and numbers for people: how values, deviations and intervals are written, and which words end a search."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fmuid.data import Parameter
from fmuid.estimation.local_search import Marquardt
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.search.state import TerminationReason
from fmuid.files import file_name
from fmuid.formatting import rounded, with_std
from fmuid.identification import identify
from fmuid.reports.topics import uncertainty
from fmuid.runs.findings import at_minimum


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


def search(iterations: int) -> Result:
    x = np.linspace(0.0, 1.0, 20)
    problem = LeastSquares.from_function(lambda t: np.exp(-t[0] * x), np.exp(-2.0 * x), {"a": Parameter(20.0)})
    return identify(problem, Marquardt(iterations))


def test_at_minimum_by_termination_reason() -> None:
    """A cost whose noise variances still change is none either."""
    ends = {TerminationReason.CONVERGED, TerminationReason.ACCURACY, TerminationReason.UNDETERMINED}
    assert search(1).outcome is TerminationReason.ITERATION_LIMIT
    result = search(1000)
    for outcome in TerminationReason:
        ended = replace(result, outcome=outcome)
        assert at_minimum(ended) is (outcome in ends)
        assert ended.converged is (outcome in ends - {TerminationReason.UNDETERMINED})
