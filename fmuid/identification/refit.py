"""Refit with the model errors freed that directed tests name (docs/method/directed-tests.md).

Each error adds its direction times a free size to the outputs; directions are taken anew at the new estimates.
Alternatives that explain the residual as well are averaged by their likelihoods, which widens the intervals.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fmuid.array_types import Flags, Floats, Simulations
from fmuid.blas import single_threaded
from fmuid.data import Parameter, usual_step
from fmuid.estimation import Estimates, Evaluator, LeastSquares, Marquardt, Result
from fmuid.events import Progress
from fmuid.identification.acquisition_delay import include_delay
from fmuid.identification.data_defects import DataDefect
from fmuid.identification.directed_tests import find_model_errors, whitened
from fmuid.identification.final_covariance import std_without_shift, with_solver_error
from fmuid.identification.model_errors import (
    DELAYS,
    SENSOR_ERRORS,
    DirectedTest,
    Direction,
    ErrorKind,
    ModelError,
    ModelErrors,
    ProcessNoise,
    Sizes,
    fixed_values,
)
from fmuid.identification.problem import Problem


@dataclass(frozen=True)
class RefitSettings:
    """Numbers of a refit."""

    fits: int = 8  # directions are taken at the estimates of the fit before: the sign of a current moves
    close_share: float = 0.6  # of the strongest score²: directions that fits tell apart, not linear scores
    most: int = 4  # directions fitted in turn
    most_errors: int = 3  # freed
    significant: float = 3.0  # σ; errors that are smaller beside the others are not freed
    settled: float = 0.01  # σ; estimates that move less end it
    rough: float = 0.05  # σ; estimates that move more at the end: the error is not linear in its size
    named: float = 2.0  # of ln L: alternatives that explain as much
    averaged: float = 4.0  # of ln L: alternatives in the average


SETTINGS = RefitSettings()
Fitted = tuple[list[ModelError], "CorrectedProblem", Result, tuple[Direction, ...]]


@dataclass(frozen=True, eq=False)
class Refit:
    """Result with model errors freed."""

    problem: LeastSquares  # with the freed errors as parameters
    result: Result  # of this problem; its last parameters are the sizes
    found: ModelErrors | None  # directed tests of this result
    excluded: tuple[DataDefect, ...] = ()  # stretches of the record that do not count in it


class CorrectedPredictor:
    """Predictor with sizes times directions (K, n_outputs, m) added; it simulates some sizes (m,) itself."""

    def __init__(self, predictor: Any, directions: Floats, simulated: Floats) -> None:
        self._predictor, self._directions, self._simulated = predictor, directions, simulated

    def many(self, thetas: ArrayLike) -> Simulations:
        """Simulate thetas (k, N_i + m); the last m numbers are sizes."""
        given, count = np.asarray(thetas, dtype=np.float64), self._directions.shape[2]
        found = self._predictor.many(np.ascontiguousarray(given[:, :-count]))
        return Simulations(found.outputs + self.added(given[:, -count:]), found.errors)

    def added(self, sizes: Floats, counted: Flags | bool = True) -> Floats:
        """Return what sizes (k, m) that are `counted` add, (k, K, n_outputs)."""
        return np.asarray(np.einsum("kjm,tm->tkj", self._directions, counted * (sizes - self._simulated)))


class CorrectedProblem(LeastSquares):
    """A problem with model errors freed: its outputs plus directions times sizes."""

    def __init__(
        self, base: LeastSquares, directions: Sequence[Direction], sizes: Mapping[str, Parameter], simulated: Floats
    ) -> None:
        vars(self)["base"], vars(self)["freed"] = base, tuple(directions)
        columns = [base.tables(base.unscaled(each.column)) for each in directions]
        predictors = [
            CorrectedPredictor(each, np.nan_to_num(np.stack([tables[i] for tables in columns], axis=2)), simulated)
            for i, each in enumerate(base.predictors)
        ]
        given = {**base.given_parameters, **sizes}
        super().__init__(predictors, base.experiments, given, noise=base.noise, joint_prior=base.joint_prior)

    def directions(self, result: Result, sizes: Sizes | None = None) -> tuple[Direction, ...]:
        """Return the directions that are not freed."""
        base: LeastSquares = vars(self)["base"]
        taken = {each.key for each in vars(self)["freed"]}
        found = base.directions(self.of_model(result), sizes)
        return tuple(each for each in found if each.key not in taken)

    def of_model(self, result: Result) -> Result:
        """Return a result with outputs free of errors of sensors."""
        count, sizes = len(vars(self)["base"].parameters), result.values[None]
        own, sensed = without_sizes(result, count), np.array([e.kind in SENSOR_ERRORS for e in vars(self)["freed"]])
        predictors = [each for each in self.predictors if isinstance(each, CorrectedPredictor)]
        parts = zip(own.fit.simulated, predictors, strict=True)
        simulated = tuple(each - by.added(sizes[:, count:], sensed)[0] for each, by in parts)
        return replace(own, fit=replace(own.fit, simulated=simulated))

    def process_noise(self, result: Result) -> ProcessNoise | None:
        """Return the process noise beside the errors freed."""
        base: LeastSquares = vars(self)["base"]
        noise: ProcessNoise | None = base.process_noise(without_sizes(result, len(base.parameters)))
        return noise

    def doubtful_rows(self, result: Result) -> dict[str, tuple[int, str]]:
        """Return the doubtful rows of the model itself."""
        base: LeastSquares = vars(self)["base"]
        return base.doubtful_rows(without_sizes(result, len(base.parameters)))

    def other_conventions(self, result: Result) -> Iterable[tuple[str, str, str, float]]:
        """Return the responses that the model itself fits with another convention."""
        base: LeastSquares = vars(self)["base"]
        return base.other_conventions(without_sizes(result, len(base.parameters)))


def without_sizes(result: Result, count: int) -> Result:
    """Return a result with its first parameters alone: the others are sizes of errors."""
    local = result.fit.linearization
    if local is not None:
        local = replace(
            local,
            jacobian=local.jacobian[:, :count],
            prior_jacobian=local.prior_jacobian[:, :count],
            magnitudes=local.magnitudes[:count],
        )
    delay = result.fit.delay
    delay = None if delay is None else replace(delay, widening=delay.widening[:count])
    fit, check = replace(result.fit, linearization=local, delay=delay), result.accuracy
    check = None if check is None else replace(check, shift=check.shift[:count])
    return replace(result, estimates=_first(result.estimates, count), fit=fit, accuracy=check)


def _first(found: Estimates, count: int) -> Estimates:
    names = found.names[:count]
    vectors = ("values", "start", "lower", "upper", "prior_mean", "prior_std", "variance_dof")
    return replace(
        found,
        names=names,
        **{name: getattr(found, name)[:count] for name in vectors},
        covariance=found.covariance[:count, :count],
        covariance_white_noise=found.covariance_white_noise[:count, :count],
        at_bounds=tuple(each for each in found.at_bounds if each.name in names),
    )


@single_threaded
def refit(problem: LeastSquares, result: Result, found: ModelErrors, progress: Progress | None = None) -> Refit | None:
    """Identify again with the errors found as parameters.

    None if that does not converge, or no size is significant beside the noise that is left. Where inputs follow that
    noise, the result stays, and errors have no names. Progress is called with every `SearchStep`.
    """
    again = _freed(problem, result, found, progress)
    last = found if again is None or again.found is None else again.found
    return again if last.feedback is None else Refit(problem, result, replace(found, errors=()))


def _freed(problem: LeastSquares, result: Result, found: ModelErrors, progress: Progress | None) -> Refit | None:
    """Return the result with errors freed one after the other."""
    count, now = len(result.names), found
    taken: Fitted | None = None
    while _free(now) and (taken is None or len(taken[0]) < SETTINGS.most_errors):
        more = _extended(problem, result, [] if taken is None else taken[0], now, progress)
        if more is None:
            break
        taken = more
        now = _tested(taken, found)
    if taken is None:
        return None
    pruned = _pruned(problem, result, taken, progress)
    if pruned is None:
        return None
    now = now if pruned is taken else _tested(pruned, found)
    errors, corrected, again, alternatives = pruned
    again = _continued(result, again, errors)
    sized = zip(errors, again.values[count:].tolist(), again.std[count:].tolist(), strict=True)
    freed = [replace(e, test=replace(_of_model(e.test, count), size=size, std=std)) for e, size, std in sized]
    freed[-1] = replace(freed[-1], alternatives=alternatives)
    tests = tuple(_of_model(each, count) for each in now.tests)
    rest = tuple(replace(each, test=_of_model(each.test, count)) for each in now.errors)
    now = replace(now, names=result.names, tests=tests, errors=rest, freed=tuple(freed))
    interval = usual_step(problem.experiments[0].times) or math.nan
    return Refit(corrected, again, replace(now, covariance=again.covariance[count:], interval=interval))


def _free(found: ModelErrors) -> list[ModelError]:
    """Return the errors that a refit may free, the strongest first."""
    return [each for each in found.errors if each.may_be_freed]


def _tested(fitted: Fitted, before: ModelErrors) -> ModelErrors:
    """Return the directed tests beside the freed errors."""
    _, corrected, again, _ = fitted
    return find_model_errors(corrected, again) or ModelErrors(before.names, before.tests)


def _extended(
    problem: LeastSquares, result: Result, before: list[ModelError], found: ModelErrors, progress: Progress | None
) -> Fitted | None:
    """Return the best fit with one more error, averaged over alternatives."""
    made = [_fit(problem, result, [*before, each], progress) for each in _candidates(found)]
    fits = [each for each in made if each is not None and _is_possible(each[0])]
    if not fits:
        return None
    likelihoods = _likelihoods(problem, [each[2] for each in fits])
    odds = likelihoods + np.array([each[0][-1].test.log_odds for each in fits])
    first = int(np.argmax(odds))
    errors, corrected, _ = fits[first]
    rough = [not all(error.settled for error in each[0]) for each in fits]  # their likelihoods say too little
    behind = np.where(rough, 0.0, odds[first] - odds)
    weights = np.where(behind < SETTINGS.averaged, np.exp(-behind), 0.0)
    if any(rough):
        errors = [*errors[:-1], replace(errors[-1], settled=False)]
    named = [each[0][-1].test.direction for k, each in enumerate(fits) if behind[k] < SETTINGS.named and k != first]
    delayed = [_delayed(each) if weight else each[2] for each, weight in zip(fits, weights.tolist(), strict=True)]
    again = _averaged(delayed, delayed[first], weights / weights.sum(), len(result.names))
    return errors, corrected, again, tuple(named)


def _is_possible(errors: Sequence[ModelError]) -> bool:
    """Return True if all sizes are plausible, and the last is significant."""
    last = errors[-1].test
    return all(each.test.is_plausible for each in errors) and abs(last.size) >= SETTINGS.significant * last.std


def _delayed(fitted: tuple[list[ModelError], CorrectedProblem, Result]) -> Result:
    """Return a fit that allows for a delay, unless one is freed."""
    errors, corrected, again = fitted
    free = any(each.kinds & DELAYS for each in errors)
    return again if free else include_delay(Evaluator(corrected), again)


def _pruned(problem: LeastSquares, result: Result, found: Fitted, progress: Progress | None) -> Fitted | None:
    """Return a refit without errors that are not significant beside the others; None without one that is."""
    errors, _, again, _ = found
    count = len(result.names)
    scores = np.abs(again.values[count:]) / again.std[count:]
    kept = [each for each, score in zip(errors, scores.tolist(), strict=True) if score >= SETTINGS.significant]
    if not kept:
        return None
    fitted = _fit(problem, result, kept, progress) if len(kept) < len(errors) else None
    return found if fitted is None else (*fitted[:2], _delayed(fitted), ())


def _candidates(found: ModelErrors) -> list[ModelError]:
    """Return the strongest error and those with close scores."""
    first = _free(found)[0]
    least = SETTINGS.close_share * first.test.score**2
    close = sorted((each for each in found.tests if each.score**2 > least), key=lambda each: -abs(each.score))
    others = [ModelError(each) for each in close if each.direction.key != first.test.direction.key]
    return [first, *others[: SETTINGS.most - 1]]


def _of_model(test: DirectedTest, count: int) -> DirectedTest:
    """Return a test with shifts of the model's parameters alone."""
    return replace(test, shift=test.shift[:count])


def _fit(
    problem: LeastSquares, result: Result, errors: Sequence[ModelError], progress: Progress | None
) -> tuple[list[ModelError], CorrectedProblem, Result] | None:
    """Identify with errors as parameters, around the estimates of the fit before; None without convergence."""
    sizes = {error_name(each): _size(each) for each in errors}
    start = np.concatenate([result.values, [each.start for each in sizes.values()]])
    count, now, base = len(result.names), result, problem
    simulated, keys = np.zeros(len(errors)), [each.test.direction.key for each in errors]
    for _ in range(SETTINGS.fits):
        directions = {each.key: each for each in base.directions(now, dict(zip(keys, start[count:], strict=True)))}
        if not all(key in directions for key in keys):
            return None
        chosen = [_in_share(directions[key], each) for key, each in zip(keys, errors, strict=True)]
        corrected = CorrectedProblem(base, chosen, sizes, simulated)
        again = Marquardt().search(Evaluator(corrected), progress, start)
        if not again.converged or not np.isfinite(again.std).all():
            return None
        moved = float(np.max(np.abs(again.values - start) / again.std))
        start, now = again.values, corrected.of_model(again)
        if moved < SETTINGS.settled:
            break
        base, simulated = _simulating(problem, errors, start[count:])
    found = zip(errors, again.values[count:].tolist(), again.std[count:].tolist(), strict=True)
    sized = [replace(error, test=replace(error.test, size=size, std=std)) for error, size, std in found]
    return [replace(each, settled=moved < SETTINGS.rough) for each in sized], corrected, again


def _simulating(problem: LeastSquares, errors: Sequence[ModelError], sizes: Floats) -> tuple[LeastSquares, Floats]:
    """Return a problem that simulates corrected fixed parameters, and their sizes (m,)."""
    directions = [each.test.direction for each in errors]
    fixed = [each.kind is ErrorKind.FIXED for each in directions]
    if not any(fixed) or not isinstance(problem, Problem):
        return problem, np.zeros(len(errors))
    values = fixed_values(directions, sizes.tolist())
    return problem.holding(values).finer(problem.refinement), np.where(fixed, sizes, 0.0)


def _in_share(direction: Direction, error: ModelError) -> Direction:
    """Return a fixed parameter's direction in shares of its given value."""
    given = error.test.direction.value
    return direction if math.isnan(given) else replace(direction, column=direction.column * given / direction.value)


def _likelihoods(problem: LeastSquares, results: Sequence[Result]) -> Floats:
    """Return the log-likelihoods of results under one noise model."""
    spread = [[each.fit.noise_variance[name] for name in results[0].fit.noise_variance] for each in results]
    best = results[int(np.argmin(np.sum(np.log(spread), axis=1)))]
    noise, local = best.fit.noise, best.fit.linearization
    assert noise is not None and local is not None, "fits keep their noise model"
    rows = np.stack([problem.measured - problem.stacked(each.fit.simulated) for each in results], axis=1)
    rows /= local.levels[:, None]
    return np.asarray(-0.5 * np.sum(whitened(noise, rows) ** 2, axis=0))


def _averaged(results: Sequence[Result], best: Result, weights: Floats, count: int) -> Result:
    """Return the best result, its first `count` estimates averaged over all."""
    values = np.array([each.values[:count] for each in results])
    mean = weights @ values
    away = values - mean
    inner = np.einsum("k,kij->ij", weights, np.array([each.covariance[:count, :count] for each in results]))
    found, covariance = best.estimates, best.covariance.copy()
    covariance[:count, :count] = inner + (away.T * weights) @ away
    own = np.concatenate([mean, best.values[count:]])
    return replace(best, estimates=replace(found, values=own, covariance=covariance))


def _continued(result: Result, again: Result, errors: Sequence[ModelError]) -> Result:
    """Return a refit as the continuation of the search before."""
    own, more = result.history, again.history
    units = {error_name(each): each.test.direction.unit for each in errors if each.test.direction.unit}
    history = replace(
        own,
        iterations=own.iterations + more.iterations,
        simulations=own.simulations + more.simulations,
        elapsed_s=own.elapsed_s + more.elapsed_s,
        restarts=(),  # they compared residuals of the model without these errors
    )
    start = np.concatenate([result.estimates.start, again.estimates.start[len(result.names) :]])
    estimates = replace(again.estimates, units={**result.estimates.units, **units}, start=start)
    again = replace(again, estimates=estimates, history=history, setup=result.setup, accuracy=None)
    return with_solver_error(again, result.accuracy, std_without_shift(result))


def error_name(error: ModelError) -> str:
    """Return the parameter name of an error's size: ``delay(ids)``."""
    direction = error.test.direction
    return f"{direction.kind.value}({', '.join(direction.subject)})"


def _size(error: ModelError) -> Parameter:
    test = error.test
    return Parameter(test.size, nominal=max(abs(test.size), test.std))
