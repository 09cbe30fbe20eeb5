"""Sampling of the posterior of the parameters, given data, prior and bounds, without linearisation.

With J_j(θ) the sum of squared residuals of output j and K_j its samples, the log density is, inside the bounds,

    ln p(θ | y*) = −½ [ (θ−θ₀)ᵀ M₀⁻¹ (θ−θ₀) + Σ_given J_j(θ)/σ_j² + Σ_estimated K_j ln J_j(θ) ] + const,

that is −J_C/2 of (1.37) for outputs whose noise variance is given. A variance that is estimated is as unknown as the
parameters: with the density 1/σ_j², uniform in ln σ_j, it is integrated out, ∫ σ^(−K) exp(−J/(2σ²)) dσ²/σ² ∝ J^(−K/2).
For one output, a model linear in its parameters and no prior this is Student's t around the estimate with K − N degrees
of freedom and the local covariance (1.31) as its scale, so that the posterior's intervals are the local ones.
With a robust loss the variances stay at their estimates, and −J_C/2 takes the place of a log density. Where the noise
is coloured, or the loss robust, the data's part is scaled to how the estimates really scatter
(`fmuid.identification.likelihood_scaling`).

Two kinds of moves take turns, drawn at random at each step: differential evolution, which takes its steps from the
distances of the walkers and adapts to any shape, and independent draws from the local approximation with heavy tails.
Where that is good, as it usually is, they make the samples nearly independent; where it is not, they are refused. Then,
and where there are several optima, draws in the shape of the chain's own past take the place of most of them
(`fmuid.identification.proposal_archive`).

The walkers set out around the optima at which searches from points all over the box ended, as far as these hold a share
of the posterior that would show; without a box to search, around the estimate alone.

References
----------
D. Foreman-Mackey et al., "emcee: the MCMC hammer", PASP 125, 2013; C. J. F. ter Braak, "A Markov chain Monte Carlo
version of the genetic algorithm differential evolution", Stat. Comput. 16, 2006; A. Gelman et al.,
"Bayesian Data Analysis", 3rd edition, section 3.2 (the variance integrated out).
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
from fmuid.identification.conditional_optimum import evaluator_of
from fmuid.identification.likelihood_scaling import adjustment
from fmuid.identification.posterior import Posterior, SamplerSettings
from fmuid.identification.profile_likelihood import reach
from fmuid.identification.proposal_archive import Archive
from fmuid.progress import Progress, SamplingStep


@dataclass(frozen=True)
class SamplerNumbers:
    """Numbers of the sampler that no user sets."""

    least_walkers: int = 16
    """Enough walkers for two halves that keep all cores busy, ..."""
    walkers_per_parameter: int = 4
    """... and for differences in all directions."""
    first_look: int = 100
    """Steps before convergence is checked first, ..."""
    look_growth: float = 1.3
    """... and the factor by which the chain grows between checks."""
    local_share: float = 0.5
    """Share of proposals from the local approximation, ..."""
    local_freedom: float = 5.0
    """... a Student t of so many degrees of freedom, ..."""
    jump_share: float = 0.1
    """... and share of the others that are whole differences, from one optimum to another (ter Braak)."""
    poor_acceptance: float = 0.3
    """With a smaller share of accepted moves the chain's own past says better where to go, ..."""
    archive_share: float = 0.7
    """... in so many of the moves."""
    searches: int = 12
    """Searches from points of the box that tell of other optima, ..."""
    least_log_share: float = 7.0
    """... around one of which the logarithm of the posterior may be so much less."""
    own_stds: float = 3.0
    """Optima nearer than so many standard deviations of the estimate are its own."""
    open_spread: float = 0.01
    """Spread of the walkers' start in a parameter that the data leave open, relative to its magnitude."""
    inside_stds: float = 3.0
    """A walker that would start outside the bounds starts inside, within so many standard deviations."""
    most_halvings: int = 40
    """How many times a walker whose simulation fails is moved half way to the estimate."""
    batch_samples: int = 8_000_000
    """Simulated samples held at a time, 64 MB."""


SETTINGS = SamplerNumbers()


@single_threaded
def sample_posterior(
    problem: LeastSquares, result: Result, settings: SamplerSettings | None = None, progress: Progress | None = None
) -> Posterior:
    """Sample the posterior of a problem, starting around its result.

    Parameters
    ----------
    problem : LeastSquares
    result : Result
        Of its identification.
    settings : SamplerSettings, optional
    progress : callable, optional
        Called after every step of all walkers with a `fmuid.progress.SamplingStep`.

    Returns
    -------
    Posterior
        Also where it did not converge or was interrupted from the keyboard, which it says.

    Raises
    ------
    InputError
        If the result is another problem's, there are too few walkers, or a noise variance cannot be estimated because
        the model fits exactly.
    SimulationError
        If the simulation fails at the result.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> result = fmuid.identify(problem)
    >>> posterior = fmuid.sample_posterior(problem, result, fmuid.SamplerSettings(max_steps=40, effective_size=10))
    >>> posterior.table.shape
    (480, 2)
    """
    return _Sampler(evaluator_of(problem, result), result, settings or SamplerSettings(), progress).run()


def log_density(
    evaluator: Evaluator[LeastSquares], variance: Floats | None = None, result: Result | None = None
) -> Callable[[Floats], Floats]:
    """Return the log density of the posterior, without its constant, as a function of thetas (m, N) that gives (m,).

    It is −∞ outside the bounds and where a simulation fails.

    Parameters
    ----------
    evaluator : Evaluator
    variance : (n_outputs,) array, optional
        The noise variances, NaN where they are integrated out; default the problem's own. A robust loss needs them all.
    result : Result, optional
        Of the problem: the data's part is scaled to the colour of the noise that it found. Default: white noise.
    """
    problem = evaluator.problem
    parameters, known = problem.parameters, problem.variance if variance is None else variance
    which = (problem.groups[:, None] == np.arange(problem.counts.size)).astype(np.float64)
    given = ~np.isnan(known)
    weights = (1.0 / np.sqrt(np.where(given, known, 1.0)))[problem.groups]
    batch = max(1, SETTINGS.batch_samples // problem.measured.size)

    def sums(thetas: Floats) -> Floats:
        """Return the sum of squares of each output (m, n_outputs), whitened where its variance is known."""
        with np.errstate(over="ignore", invalid="ignore"):  # simulations may explode without failing
            rows = (problem.measured - evaluator.predict(thetas)) * weights
            rows = (rows if problem.loss is None else problem.loss.root(rows)) ** 2
        # einsum keeps to this thread: BLAS would start its own beside those of the simulations
        return np.asarray(np.einsum("mn,ng->mg", rows, which), dtype=np.float64)

    def likelihood(thetas: Floats) -> Floats:
        squares = sums(thetas)
        with np.errstate(divide="ignore"):
            implied = problem.levels.pooled(squares, problem.counts)[:, ~given]
            terms = squares[:, given].sum(axis=1) + np.log(implied) @ problem.counts[~given]
        return np.asarray(-0.5 * terms, dtype=np.float64)

    free = math.inf if result is None or given.all() else result.degrees_of_freedom
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
    """One run of the sampler."""

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
            raise InputError(
                f"{self.walkers} walkers are too few for {count} parameters; the sampler needs at least {2 * count}"
            )
        self.random = np.random.default_rng(settings.seed)
        self.far = reach(self.problem, result)
        # a robust loss is no log density, its variances cannot be integrated out: they stay at their estimates
        robust = np.array([result.variance[name] for name in self.problem.output_names])
        self.density = log_density(evaluator, None if self.problem.loss is None else robust, result)
        self._check_start()
        self.root = _root(result.covariance)
        self.inverse_root = None if self.root is None else np.linalg.inv(self.root)
        self.sampler = emcee.EnsembleSampler(self.walkers, count, self._target, moves=self._moves(), vectorize=True)
        self.sampler.random_state = np.random.RandomState(settings.seed).get_state()
        self.effective = math.nan
        self.interrupted = False
        self.optima = [result]
        self.archive: Archive | None = None

    def run(self) -> Posterior:
        """Sample until the chain is good enough, or at its longest."""
        steps, look = 0, SETTINGS.first_look
        try:
            self.optima += self._other_optima()
            state: object = self._start()
            while steps < self.settings.max_steps:
                look = min(look, self.settings.max_steps)
                # emcee's check of the start is left out: it takes strongly correlated parameters for dependent walkers
                for _ in self.sampler.sample(state, iterations=look - steps, skip_initial_state_check=True):
                    steps += 1
                    self._tell(steps)
                    if self.interrupted:
                        raise KeyboardInterrupt
                found = self._posterior()
                self.effective = float(np.min(found.effective_size))
                if found.converged or found.runaway:
                    break
                look, state = math.ceil(SETTINGS.look_growth * steps), self.sampler.get_last_sample()
                if found.acceptance < SETTINGS.poor_acceptance or len(self.optima) > 1:
                    self.archive = Archive.of(found.samples)
        except KeyboardInterrupt:
            self.interrupted = True
        return self._posterior()

    def _target(self, thetas: Floats) -> Floats:
        """Return the log density; interrupted, as if all simulations failed: emcee prints whatever is raised here."""
        try:
            return self.density(thetas)
        except KeyboardInterrupt:
            self.interrupted = True
            return np.full(len(thetas), -np.inf)

    def _tell(self, steps: int) -> None:
        if self.progress is not None:
            acceptance = float(np.mean(self.sampler.acceptance_fraction))
            wanted = self.settings.effective_size
            step = SamplingStep(
                step=steps,
                steps=self.settings.max_steps,
                effective_size=self.effective,
                wanted=wanted,
                acceptance=acceptance,
            )
            self.progress(step)

    def _check_start(self) -> None:
        at = self.density(self.estimate[None])[0]
        if at == -np.inf:
            raise self.evaluator.failure(self.estimate) or InputError(
                "the result lies outside the problem's bounds; give the result of this problem's identification"
            )
        if at == np.inf:
            raise InputError(
                "the model fits an output exactly, and its noise variance cannot be estimated; give noise.variance"
            )

    def _other_optima(self) -> list[Result]:
        """Return the optima, other than the estimate, that hold a share of the posterior."""
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
            each.fit for each in found.optima if each.converged and (np.abs(each.theta - self.estimate) > near).any()
        ]
        share = [self._log_share(each) for each in (self.result, *others)]
        order = np.argsort([-each for each in share[1:]], kind="stable")[: self.walkers // 4 - 1]
        return [others[i] for i in order if share[1 + i] > max(share) - SETTINGS.least_log_share]

    def _log_share(self, optimum: Result) -> float:
        """Return the logarithm of what an optimum holds of the posterior, by the normal approximation."""
        root = _root(optimum.covariance)
        volume = 0.0 if root is None else float(np.log(np.diag(root)).sum())
        return float(self.density(optimum.values[None])[0]) + volume

    def _start(self) -> Floats:
        """Return walkers (walkers, N) around all optima."""
        numbers = np.array_split(np.arange(self.walkers), len(self.optima))
        return np.vstack([self._around(each, own.size) for each, own in zip(self.optima, numbers, strict=True)])

    def _around(self, optimum: Result, walkers: int) -> Floats:
        """Return walkers (walkers, N) drawn from the local covariance, inside the bounds, where the model works."""
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
        ]
        return [*moves, (emcee.moves.MHMove(self._propose), local)] if local else moves

    def _propose(self, thetas: Floats, random: np.random.RandomState) -> tuple[Floats, Floats]:
        """Draw independently of where the walkers are; with the log of the ratio of the densities there and here."""
        if self.archive is not None and random.uniform() < SETTINGS.archive_share:
            return self.archive.propose(thetas, random)
        return self._propose_locally(thetas, random)

    def _propose_locally(self, thetas: Floats, random: np.random.RandomState) -> tuple[Floats, Floats]:
        """Draw from Student's t around the estimate; with the log of the ratio of its densities there and here."""
        assert self.root is not None
        assert self.inverse_root is not None
        draws = random.standard_normal(thetas.shape) / np.sqrt(
            random.chisquare(SETTINGS.local_freedom, (len(thetas), 1)) / SETTINGS.local_freedom
        )
        before = (thetas - self.estimate) @ self.inverse_root.T
        power = -0.5 * (SETTINGS.local_freedom + thetas.shape[1])
        here, there = (power * np.log1p(np.sum(z**2, axis=1) / SETTINGS.local_freedom) for z in (before, draws))
        return self.estimate + draws @ self.root.T, here - there

    def _posterior(self) -> Posterior:
        if not self.sampler.iteration:
            raise KeyboardInterrupt
        chain, parameters = self.sampler.get_chain().copy(), self.problem.parameters
        return Posterior(
            runaway=self._runaway(chain[-1]),
            interrupted=self.interrupted,
            wanted=self.settings.effective_size,
            undetermined=self.result.undetermined,
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
        """Return the name of a parameter that runs away on a side without bound, empty if none does."""
        parameters, beyond = self.problem.parameters, thetas - self.estimate
        above = np.isinf(parameters.upper) & (beyond > self.far).any(axis=0)
        below = np.isinf(parameters.lower) & (beyond < -self.far).any(axis=0)
        return next((name for name, gone in zip(parameters.names, above | below, strict=True) if gone), "")


def _root(covariance: Floats) -> Floats | None:
    """Return the triangle L with L Lᵀ the covariance, None where that is not finite and positive definite."""
    std = np.sqrt(np.diag(covariance))
    if not (np.isfinite(covariance).all() and (std > 0).all()):
        return None
    try:  # of the correlations: units must not decide
        return np.asarray(std[:, None] * np.linalg.cholesky(covariance / np.outer(std, std)), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
