"""What the tool says of records with one error each, and plants that make them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import fmuid
from fmuid import assess
from fmuid.array_types import Floats
from fmuid.estimation import Verdict
from fmuid.identification import Assessment, ErrorKind, ModelErrors, find_model_errors, judge, refit, without_clipped


@dataclass(frozen=True)
class Flaw:
    """An error of a record.

    Attributes
    ----------
    kinds : tuple of ErrorKind
        Names of it, the best first; none: no error.
    size : float
        In the unit of the first kind; infinite: it must show; NaN: it may.
    has_truth : bool
        False if a parameter has no true value, or the error is none of the list: a doubt.
    """

    kinds: tuple[ErrorKind, ...] = ()
    size: float = math.nan
    has_truth: bool = True


@dataclass(frozen=True, eq=False)
class Plant:
    """A plant with errors.

    Attributes
    ----------
    flaws : mapping of str to Flaw
    truth : mapping of str to float
        Parameters.
    found : callable
        What the tool says of draws with an error (str) and colored noise (float).
    draws : int
    """

    flaws: Mapping[str, Flaw]
    truth: Mapping[str, float]
    found: Callable[[str, float], list[Found]]
    draws: int = 200


@dataclass(frozen=True, eq=False)
class Found:
    """What the tool says of a record.

    Attributes
    ----------
    verdict : Verdict
    names : tuple of frozenset of ErrorKind
        Kinds of each error found and its alternatives.
    parameters : tuple of str
        Parameters.
    values, std : (N,) arrays
    before, std_before : (N,) arrays
        Without freed errors.
    errors : ModelErrors or None
        Directed tests of the result without freed errors.
    """

    verdict: Verdict
    names: tuple[frozenset[ErrorKind], ...]
    parameters: tuple[str, ...]
    values: Floats
    std: Floats
    before: Floats
    std_before: Floats
    errors: ModelErrors | None


def found_in(problem: fmuid.Problem) -> Found:
    """Identify, test, refit and judge as `fmuid.run` does."""
    result = fmuid.identify(problem)
    before = result
    cut = without_clipped(problem, result)
    if cut is not None:
        problem = cut[0]
        result = fmuid.identify(problem)
    tested = problem.as_in(result)
    first = errors = find_model_errors(tested, result)
    again = refit(tested, result, errors) if errors is not None and errors.errors else None
    base, own = (tested, result) if again is None else (again.problem, again.result)
    errors = errors if again is None else again.found
    checks = assess(base, own, earlier=Assessment(model_errors=errors))
    checks = replace(checks, data_defects=(*(() if cut is None else cut[1]), *checks.data_defects))
    named = () if errors is None else tuple(each.kinds for each in (*errors.freed, *errors.errors))
    values, std = (each[: len(before.names)] for each in (own.values, own.std))
    return Found(judge(own, checks), named, before.names, values, std, before.values, before.std, first)
