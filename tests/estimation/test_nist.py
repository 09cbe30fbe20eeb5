"""NIST reference problems of higher difficulty, from both certified starts, counted beside scipy's `lm`."""

from functools import cache

import pytest

from experiments.nist.study import DIGITS, MODELS, Reference, digits, read, scipy_digits, solve
from fmuid import Result
from tests.support.paths import HERE

FOLDER = HERE / "nist"
NAMES = [name for name in MODELS if (FOLDER / f"{name}.dat").exists()]
CASES = [(name, start) for name in NAMES for start in (0, 1)]
LONG = {"Bennett5", "MGH10", "BoxBOD"}


@cache
def solved(name: str, start: int) -> tuple[Reference, Result]:
    reference = read(FOLDER, name)
    return reference, solve(name, reference, start)


@pytest.mark.parametrize(
    ("name", "start"), [pytest.param(*each, marks=pytest.mark.slow if each[0] in LONG else ()) for each in CASES]
)
def test_certified_values(name: str, start: int) -> None:
    reference, result = solved(name, start)
    assert result.converged, result.outcome
    assert digits(result.values, reference.certified) >= DIGITS
    assert digits(result.estimates.std_white_noise, reference.std) >= 2
    residual = reference.y - result.fit.frames[0]["simulated.y"].to_numpy()
    assert residual @ residual == pytest.approx(reference.sum_of_squares, rel=1e-6)
    free = reference.y.size - reference.certified.size
    assert result.fit.noise_variance["y"] == pytest.approx(reference.sum_of_squares / free, rel=1e-5)


@pytest.mark.slow
def test_solved_as_often_as_by_scipy() -> None:
    ours = sum(digits(solved(*case)[1].values, solved(*case)[0].certified) >= DIGITS for case in CASES)
    assert ours >= sum(scipy_digits(name, solved(name, start)[0], start) >= DIGITS for name, start in CASES)
