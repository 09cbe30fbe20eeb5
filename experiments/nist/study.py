"""The 27 reference problems of NIST for nonlinear regression, from both starts, beside scipy's `lm`.

    python -m experiments.nist.study FOLDER

Run from the project's folder; it rewrites the table in README.md. FOLDER has NIST's files (Misra1a.dat and so on, of
www.itl.nist.gov/div898/strd); nine of them are in tests/support/nist.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

import fmuid
from experiments import pages
from fmuid.array_types import Floats

HERE = Path(__file__).parent
DIGITS = 4
# Lines of a file before its data.
HEAD = 60

Model = Callable[[Floats, Floats], Floats]


def _saturating(b: Floats, x: Floats) -> Floats:
    return np.asarray(b[0] * (1 - np.exp(-b[1] * x)))


def _chwirut(b: Floats, x: Floats) -> Floats:
    return np.asarray(np.exp(-b[0] * x) / (b[1] + b[2] * x))


def _peaks(b: Floats, x: Floats) -> Floats:
    first, second = (b[k] * np.exp(-(((x - b[k + 1]) / b[k + 2]) ** 2)) for k in (2, 5))
    return np.asarray(b[0] * np.exp(-b[1] * x) + first + second)


def _decays(b: Floats, x: Floats) -> Floats:
    return np.asarray(b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x))


def _cubic_ratio(b: Floats, x: Floats) -> Floats:
    return np.asarray((b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3))


def _pressures(b: Floats, x: Floats) -> Floats:
    waves = ((12.0, b[1], b[2]), (b[3], b[4], b[5]), (b[6], b[7], b[8]))
    return np.asarray(b[0] + sum(c * np.cos(2 * np.pi * x / p) + s * np.sin(2 * np.pi * x / p) for p, c, s in waves))


MODELS: dict[str, Model] = {
    "Misra1a": _saturating,
    "Chwirut2": _chwirut,
    "Chwirut1": _chwirut,
    "Lanczos3": _decays,
    "Gauss1": _peaks,
    "Gauss2": _peaks,
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2.0),
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Hahn1": _cubic_ratio,
    "Nelson": lambda b, x: b[0] - b[1] * x[:, 0] * np.exp(-b[2] * x[:, 1]),
    "MGH17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Lanczos1": _decays,
    "Lanczos2": _decays,
    "Gauss3": _peaks,
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "ENSO": _pressures,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "Thurber": _cubic_ratio,
    "BoxBOD": _saturating,
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
}
"""By NIST's names, in its order of difficulty."""


@dataclass(frozen=True, eq=False)
class Reference:
    """One file: starts (2, N), certified parameters and standard deviations (N,), residual sum of squares, data."""

    starts: Floats
    certified: Floats
    std: Floats
    sum_of_squares: float
    y: Floats
    x: Floats


def read(folder: Path, name: str) -> Reference:
    """Read a file of NIST's; of Nelson's, whose model is of log y, with the logarithms."""
    text = (folder / f"{name}.dat").read_text(encoding="ascii")
    rows = [row.split() for row in re.findall(r"^ *b\d+ *= *(.+)$", text, flags=re.MULTILINE)]
    table = np.array([[float(value) for value in row] for row in rows if len(row) == 4])
    found = re.search(r"Residual Sum of Squares: *(\S+)", text)
    if found is None:
        raise ValueError(f"{name}.dat is no file of NIST's: it has no residual sum of squares")
    data = np.array([[float(value) for value in line.split()] for line in text.splitlines()[HEAD:] if line.strip()])
    y = np.log(data[:, 0]) if name == "Nelson" else data[:, 0]
    x = data[:, 1] if data.shape[1] == 2 else data[:, 1:]
    return Reference(table[:, :2].T, table[:, 2], table[:, 3], float(found.group(1)), y, x)


def solve(name: str, reference: Reference, start: int) -> fmuid.Result:
    """Identify the parameters of a problem from one of its starts."""
    parameters = {f"b{i + 1}": fmuid.Parameter(value) for i, value in enumerate(reference.starts[start].tolist())}

    def predicted(b: Floats) -> Floats:
        with np.errstate(all="ignore"):  # what is not finite counts as a simulation that failed
            return MODELS[name](b, reference.x)

    return fmuid.identify(fmuid.estimation.LeastSquares.from_function(predicted, reference.y, parameters))


def digits(found: Floats, certified: Floats) -> float:
    """Return the number of correct digits of the worst parameter, −log₁₀ of its relative error, 0 at least."""
    error = np.max(np.abs(found - certified) / np.abs(certified))
    return max(0.0, -math.log10(float(error) + 1e-16))


def scipy_digits(name: str, reference: Reference, start: int) -> float:
    """Return the same by scipy's MINPACK with its tolerances at their tightest; an overflow is a very bad point."""

    def residual(b: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return np.nan_to_num(MODELS[name](b, reference.x) - reference.y, nan=1e100, posinf=1e100, neginf=-1e100)

    tight = 1e-15
    with np.errstate(all="ignore"):
        found = least_squares(
            residual, reference.starts[start], method="lm", max_nfev=20_000, xtol=tight, ftol=tight, gtol=tight
        )
    return digits(found.x, reference.certified)


def table(folder: Path) -> str:
    """Return the page's table, as Markdown."""
    rows, counts = list[tuple[object, ...]](), np.zeros(2, dtype=int)
    for name in MODELS:
        reference = read(folder, name)
        found = [solve(name, reference, start) for start in (0, 1)]
        ours = [digits(each.values, reference.certified) for each in found]
        spread = [digits(each.estimates.std_white_noise, reference.std) for each in found]
        theirs = [scipy_digits(name, reference, start) for start in (0, 1)]
        counts += [sum(each >= DIGITS for each in ours), sum(each >= DIGITS for each in theirs)]
        cells = [", ".join(f"{each:.1f}" for each in part) for part in (ours, spread, theirs)]
        rows.append((name, reference.certified.size, *cells))
    rows.append((f"**{DIGITS} digits and more**", "", f"**{counts[0]} of {2 * len(MODELS)}**", "", counts[1]))
    return pages.table(["problem", "parameters", "digits from start 1, 2", "of the std", "scipy's `lm`"], rows)


def main() -> None:
    """Rewrite the page's table."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    pages.rewrite(HERE, {"digits": table(Path(sys.argv[1]))})


if __name__ == "__main__":
    main()
