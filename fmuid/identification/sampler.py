"""Sampling of the posterior by emcee (docs/method/profiles-and-posterior.md).

References: Foreman-Mackey et al., PASP 125, 2013; ter Braak, Statistics and Computing 16, 2006. Robust losses keep
variances at their estimates.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import emcee
import numpy as np

from fmuid.array_types import Floats
from fmuid.blas import single_threaded
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import Evaluator, GlobalSearch, LeastSquares, Result, TerminationReason
from fmuid.events import Progress, SamplingStep
from fmuid.identification.acquisition_delay import delayed
from fmuid.identification.likelihood_scaling import adjustment
from fmuid.identification.posterior import Posterior, SamplerSettings
from fmuid.identification.profile_likelihood import reach
from fmuid.identification.proposal_archive import ARCHIVE_SETTINGS, Archive, student


@dataclass(frozen=True)
class SamplerNumbers:
    """Numbers of the sampler that no user sets."""

    least_walkers: int = 16  # enough for two halves that keep all cores busy, ...
    walkers_per_parameter: int = 4  # ... and for differences in all directions
    first_look: int = 100  # steps before the first check of convergence, ...
    look_growth: float = 1.3  # ... and growth of the chain between checks
    local_share: float = 0.5  # of proposals from the local approximation, ...
    local_freedom: float = 5.0  # ... a Student t of so many degrees of freedom, ...
    jump_share: float = 0.1  # ... and of the others that are whole differences between optima (ter Braak)
    searches: int = 12  # from points of the box, for other optima, ...
    least_log_share: float = 7.0  # ... whose log posterior may be so much less
    own_stds: float = 3.0  # σ; nearer optima are the estimate's own
    open_spread: float = 0.01  # of walkers at the start, relative to the magnitude, where σ is infinite
    inside_stds: float = 3.0  # σ within which walkers start that would be outside the bounds
    most_halvings: int = 40  # moves of a failing walker half way to the estimate
    batch_samples: int = 8_000_000  # simulated samples held at a time, 64 MB


SETTINGS = SamplerNumbers()


@single_threaded
def sample_posterior(
    problem: LeastSquares, result: Result, settings: SamplerSettings | None = None, progress: Progress | None = None
) -> Posterior:
    """Sample the posterior, starting around a result.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of its identification.
    settings : SamplerSettings, optional
    progress : callable, optional
        Called after every step with a `fmuid.events.SamplingStep`.

    Returns
    -------
    Posterior
        Also without convergence or after an interruption.

    Raises
    ------
    InputError
        If the result is of another problem, walkers are too few, or the model fits exactly.
    SimulationError
        If the simulation fails at the result.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> settings = fmuid.identification.SamplerSettings(max_steps=40, effective_size=10)
    >>> posterior = fmuid.sample_posterior(problem, result, settings)
    >>> posterior.table.shape
    (480, 2)
    """
    found = _Sampler(*delayed(problem, result), settings or SamplerSettings(), progress).run()
    return found.first(len(result.names))


def log_density(
    evaluator: Evaluator[LeastSquares], variance: Floats | None = None, result: Result | None = None
) -> Callable[[Floats], Floats]:
    """Return the posterior log density of thetas (m, N); −∞ out of bounds and for failed simulations.

    `variance` (n_outputs,) is NaN where integrated out; a `result` scales the data's part to its colored noise.
    """
    problem = evaluator.problem
    parameters, known = problem.parameters, problem.variance if variance is None else variance
    which = (problem.groups[:, None] == np.arange(problem.counts.size)).astype(np.float64)
    given = ~np.isnan(known)
    weights = (1.0 / np.sqrt(np.where(given, known, 1.0)))[problem.groups]
    batch = max(1, SETTINGS.batch_samples // problem.measured.size)

    def likelihood(thetas: Floats) -> Floats:
        with np.errstate(over="ignore", invalid="ignore"):  # simulations may explode without failing
            rows = (problem.measured - evaluator.predict(thetas)) * weights
            rows = (rows if problem.loss is None else problem.loss.root(rows)) ** 2
        # einsum keeps to this thread: BLAS would start its own beside those of the simulations
        squares: Floats = np.einsum("mn,ng->mg", rows, which)
        with np.errstate(divide="ignore"):
            implied = problem.levels.pooled(squares, problem.counts)[:, ~given]
            terms = squares[:, given].sum(axis=1) + np.log(implied) @ problem.counts[~given]
        return np.asarray(-0.5 * terms, dtype=np.float64)

    free = math.inf if result is None or given.all() else result.fit.degrees_of_freedom
    adjust = None if result is None else adjustment(problem, result, free)
    at_estimate = math.nan if result is None else float(likelihood(result.values[None])[0])

    def density(thetas: Floats) -> Floats:
        found = np.full(len(thetas), -np.inf)
        inside = np.flatnonzero(((thetas >= parameters.lower) & (thetas <= parameters.upper)).all(axis=1))
        for first in range(0, inside.size, batch):
            rows = inside[first : first + batch]
            own = likelihood(thetas[rows])
            if adjust is not None and math.isfinite(at_estimate):
                with np.errstate(invalid="ignore"):
                    own = adjust(thetas[rows], own, at_estimate)
            terms = own - 0.5 * np.sum(parameters.prior_residual(thetas[rows]) ** 2, axis=1)
            found[rows] = np.where(np.isnan(terms), -np.inf, terms)
        return found

    return density


class _Sampler:
    def __init__(
        self, evaluator: Evaluator[LeastSquares], result: Result, settings: SamplerSettings, progress: Progress | None
    ) -> None:
        self.evaluator, self.problem = evaluator, evaluator.problem
        self.result, self.settings, self.progress = result, settings, progress
        self.estimate: Floats = np.array(result.values)
        self.clock, self.simulations = time.perf_counter(), evaluator.simulations
        count = len(self.problem.parameters)
        self.walkers = settings.walkers or max(SETTINGS.least_walkers, SETTINGS.walkers_per_parameter * count)
        if self.walkers < 2 * count:
            raise InputError(f"walkers: {self.walkers} are too few for {count} parameters. Use at least {2 * count}.")
        self.random = np.random.default_rng(settings.seed)
        self.far = reach(self.problem, result)
        # a robust loss is no log density, its variances cannot be integrated out: they stay at their estimates
        robust = np.array([result.fit.variance[name] for name in self.problem.output_names])
        self.density = log_density(evaluator, None if self.problem.loss is None else robust, result)
        self._check_start()
        self.root = _root(result.covariance)
        self.sampler = emcee.EnsembleSampler(self.walkers, count, self._target, moves=self._moves(), vectorize=True)
        self.sampler.random_state = np.random.RandomState(settings.seed).get_state()
        self.effective = math.nan
        self.interrupted = False
        self.optima = [result]
        self.archive: Archive | None = None

    def run(self) -> Posterior:
        steps, look = 0, SETTINGS.first_look
        try:
            self.optima += self._other_optima()
            shares = np.array_split(np.arange(self.walkers), len(self.optima))
            state: object = np.vstack([self._around(*each) for each in zip(self.optima, map(len, shares), strict=True)])
            while steps < self.settings.max_steps:
                look = min(look, self.settings.max_steps)
                # emcee's check of the start is left out: it takes strongly correlated parameters for dependent walkers
                for _ in self.sampler.sample(state, iterations=look - steps, skip_initial_state_check=True):
                    steps += 1
                    if self.progress is not None:
                        self.progress(self._step(steps))
                    if self.interrupted:
                        raise KeyboardInterrupt
                found = self._posterior()
                self.effective = float(np.min(found.effective_size))
                if found.converged or found.runaway:
                    break
                look, state = math.ceil(SETTINGS.look_growth * steps), self.sampler.get_last_sample()
                if found.acceptance < ARCHIVE_SETTINGS.poor_acceptance or len(self.optima) > 1:
                    self.archive = Archive.of(found.samples)
        except KeyboardInterrupt:
            self.interrupted = True
        return self._posterior()

    def _target(self, thetas: Floats) -> Floats:
        """Return the log density; −∞ after an interruption, because emcee prints exceptions."""
        try:
            return self.density(thetas)
        except KeyboardInterrupt:
            self.interrupted = True
            return np.full(len(thetas), -np.inf)

    def _step(self, steps: int) -> SamplingStep:
        return SamplingStep(
            step=steps,
            steps=self.settings.max_steps,
            effective_size=self.effective,
            wanted=self.settings.effective_size,
            acceptance=float(np.mean(self.sampler.acceptance_fraction)),
        )

    def _check_start(self) -> None:
        at = self.density(self.estimate[None])[0]
        if at == -np.inf:
            raise self.evaluator.failure(self.estimate) or InputError(
                "the result is outside the bounds of the problem. Give a result of this problem."
            )
        if at == np.inf:
            raise InputError("the model fits an output exactly; its noise variance is unknown. Set noise.variance.")

    def _other_optima(self) -> list[Result]:
        """Return other optima with a share of the posterior."""
        search = GlobalSearch("multi-start", starts=SETTINGS.searches, seed=self.settings.seed)
        try:
            search.check(self.problem)
            found = search.search(self.evaluator, self.progress)
        except (InputError, SimulationError):  # no box, or nothing in it can be simulated
            return []
        if found.outcome is TerminationReason.INTERRUPTED:
            raise KeyboardInterrupt
        near = SETTINGS.own_stds * self.result.std
        others = [
            each.fit
            for each in found.history.optima
            if each.converged and (np.abs(each.theta - self.estimate) > near).any()
        ]
        share = [self._log_share(each) for each in (self.result, *others)]
        order = np.argsort([-each for each in share[1:]], kind="stable")[: self.walkers // 4 - 1]
        return [others[i] for i in order if share[1 + i] > max(share) - SETTINGS.least_log_share]

    def _log_share(self, optimum: Result) -> float:
        """Return the log share of an optimum, by the normal approximation."""
        root = _root(optimum.covariance)
        volume = 0.0 if root is None else float(np.log(np.diag(root)).sum())
        return float(self.density(optimum.values[None])[0]) + volume

    def _around(self, optimum: Result, walkers: int) -> Floats:
        """Return feasible walkers (walkers, N) from the local covariance."""
        parameters, estimate, root = self.problem.parameters, optimum.values, _root(optimum.covariance)
        spread = np.where(np.isfinite(optimum.std), optimum.std, SETTINGS.open_spread * parameters.magnitudes(estimate))
        draws = self.random.standard_normal((walkers, estimate.size))
        thetas = estimate + (draws * spread if root is None else draws @ root.T)
        low = np.maximum(parameters.lower, estimate - SETTINGS.inside_stds * spread)
        high = np.minimum(parameters.upper, estimate + SETTINGS.inside_stds * spread)
        inside = (thetas >= parameters.lower) & (thetas <= parameters.upper)
        thetas = np.where(inside, thetas, self.random.uniform(low, high, thetas.shape))
        for _ in range(SETTINGS.most_halvings):
            failed = ~np.isfinite(self.density(thetas))
            if not failed.any():
                break
            thetas[failed] = 0.5 * (thetas[failed] + estimate)
        return thetas

    def _moves(self) -> list[tuple[emcee.moves.Move, float]]:
        local = SETTINGS.local_share if self.root is not None else 0.0
        moves = [
            (emcee.moves.DEMove(), (1.0 - local) * (1.0 - SETTINGS.jump_share)),
            (emcee.moves.DEMove(gamma0=1.0), (1.0 - local) * SETTINGS.jump_share),
            (emcee.moves.MHMove(self._propose), local),
        ]
        return moves if local else moves[:2]

    def _propose(self, thetas: Floats, random: np.random.RandomState) -> tuple[Floats, Floats]:
        """Draw from the archive or Student's t; also return the log density ratio."""
        if self.archive is not None and random.uniform() < ARCHIVE_SETTINGS.share:
            return self.archive.propose(thetas, random)
        assert self.root is not None
        freedom = SETTINGS.local_freedom
        draws = student(random, thetas.shape, freedom)
        before = (thetas - self.estimate) @ np.linalg.inv(self.root).T
        power = -0.5 * (freedom + thetas.shape[1])
        here, there = (power * np.log1p(np.sum(z**2, axis=1) / freedom) for z in (before, draws))
        return self.estimate + draws @ self.root.T, here - there

    def _posterior(self) -> Posterior:
        if not self.sampler.iteration:
            raise KeyboardInterrupt
        chain, parameters = self.sampler.get_chain().copy(), self.problem.parameters
        return Posterior(
            runaway=self._runaway(chain[-1]),
            interrupted=self.interrupted,
            wanted=self.settings.effective_size,
            undetermined=self.result.identifiability.non_identifiable,
            optima=np.array([each.values for each in self.optima]),
            names=parameters.names,
            lower=parameters.lower,
            upper=parameters.upper,
            chain=chain,
            log_density=self.sampler.get_log_prob().copy(),
            burn=int(self.settings.burn_in * len(chain)),
            acceptance=float(np.mean(self.sampler.acceptance_fraction)),
            simulations=self.evaluator.simulations - self.simulations,
            elapsed_s=time.perf_counter() - self.clock,
        )

    def _runaway(self, thetas: Floats) -> str:
        """Return a parameter that runs away on an unbounded side, "" for none."""
        parameters, beyond = self.problem.parameters, thetas - self.estimate
        above = np.isinf(parameters.upper) & (beyond > self.far).any(axis=0)
        below = np.isinf(parameters.lower) & (beyond < -self.far).any(axis=0)
        return next((name for name, gone in zip(parameters.names, above | below, strict=True) if gone), "")


def _root(covariance: Floats) -> Floats | None:
    """Return the Cholesky factor, None if not finite and positive definite."""
    std = np.sqrt(np.diag(covariance))
    if not (np.isfinite(covariance).all() and (std > 0).all()):
        return None
    try:  # of the correlations: units must not decide
        return np.asarray(std[:, None] * np.linalg.cholesky(covariance / np.outer(std, std)), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
