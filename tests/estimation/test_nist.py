"""The NIST reference problems of higher difficulty, from both certified starts, counted beside scipy's `lm`."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from fmuid.arrays import Floats
from fmuid.data.parameters import Parameter
from fmuid.estimation.identification import identify
from fmuid.estimation.least_squares import LeastSquares
from fmuid.estimation.result import Result
from tests.support.paths import HERE

Model = Callable[[Floats, Floats], Floats]
FOLDER = HERE / "nist"
DIGITS = 4


def cubic_ratio(b: Floats, x: Floats) -> Floats:
    return np.asarray((b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3))


MODELS: dict[str, Model] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Hahn1": cubic_ratio,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Thurber": cubic_ratio,
}
CASES = [(name, start) for name in MODELS for start in (0, 1)]


@dataclass(frozen=True)
class Reference:
    """One file: starts (2, N), certified parameters and standard deviations (N,), residual sum of squares, data."""

    starts: Floats
    certified: Floats
    std: Floats
    sum_of_squares: float
    y: Floats
    x: Floats


def read(name: str) -> Reference:
    text = (FOLDER / f"{name}.dat").read_text(encoding="ascii")
    rows = [row.split() for row in re.findall(r"^ *b\d+ *= *(.+)$", text, flags=re.MULTILINE)]
    table = np.array([[float(value) for value in row] for row in rows if len(row) == 4])
    found = re.search(r"Residual Sum of Squares: *(\S+)", text)
    assert found is not None
    data = np.array([[float(value) for value in line.split()] for line in text.splitlines()[60:] if line.strip()])
    return Reference(table[:, :2].T, table[:, 2], table[:, 3], float(found.group(1)), data[:, 0], data[:, 1])


@cache
def solve(name: str, start: int) -> tuple[Reference, Result]:
    reference = read(name)
    parameters = {f"b{i + 1}": Parameter(value) for i, value in enumerate(reference.starts[start])}
    model = MODELS[name]
    return reference, identify(LeastSquares.from_function(lambda b: model(b, reference.x), reference.y, parameters))


def digits(found: Floats, certified: Floats) -> float:
    """Return the number of correct digits of the worst parameter, −log₁₀ of its relative error."""
    return float(np.min(-np.log10(np.abs(found - certified) / np.abs(certified) + 1e-16)))


def scipy_digits(name: str, start: int) -> float:
    """The same by scipy's MINPACK with its tolerances at their tightest; an overflow is a very bad point."""
    reference = read(name)

    def residual(b: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return np.nan_to_num(MODELS[name](b, reference.x) - reference.y, nan=1e100, posinf=1e100, neginf=-1e100)

    tight = 1e-15
    with np.errstate(all="ignore"):
        found = least_squares(
            residual, reference.starts[start], method="lm", max_nfev=20_000, xtol=tight, ftol=tight, gtol=tight
        )
    return digits(found.x, reference.certified)


@pytest.mark.parametrize(("name", "start"), CASES)
def test_certified_values(name: str, start: int) -> None:
    reference, result = solve(name, start)
    assert result.converged, result.outcome
    assert digits(result.values, reference.certified) >= DIGITS
    assert digits(result.white_std, reference.std) >= 2
    residual = reference.y - result.fit[0]["simulated.y"].to_numpy()
    assert residual @ residual == pytest.approx(reference.sum_of_squares, rel=1e-6)
    free = reference.y.size - reference.certified.size
    assert result.noise_variance["y"] == pytest.approx(reference.sum_of_squares / free, rel=1e-5)


def test_at_least_as_many_as_scipy() -> None:
    table = {
        (name, start): (digits(solve(name, start)[1].values, read(name).certified), scipy_digits(name, start))
        for name, start in CASES
    }
    lines = [
        f"{name} from start {start + 1}: {ours:.1f} digits, scipy {theirs:.1f}"
        for (name, start), (ours, theirs) in table.items()
    ]
    ours, theirs = (sum(pair[k] >= DIGITS for pair in table.values()) for k in (0, 1))
    assert ours >= theirs, "\n".join(lines)
