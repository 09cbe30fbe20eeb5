"""A fault model beside the common mode, fitted to one window of a record by a few Gauss-Newton steps.

The extended vector θ_e = [θ_n; θ_f] (1.64) minimises the compound criterion (1.68). Close to its minimum the
criterion is a parabola with the information matrix Λ = M₀⁻¹ + SᵀS/σ² (1.47), and all that a window says is Λ and the
minimum. A fault that an angle locates is searched as a vector of the plane, size times cosine and sine, which is
smooth where the size is zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fmuid.arrays import Floats
from fmuid.data import Experiment, Normal, Parameter
from fmuid.diagnosis.decision import Reference, orthant_weights
from fmuid.diagnosis.faults import Fault
from fmuid.diagnosis.monitoring.belief import Belief, nearest
from fmuid.errors import InputError, SimulationError
from fmuid.estimation import Rows, Sandwich, sandwich, series_of
from fmuid.models import System
from fmuid.simulation import AS_ASKED, Refinement, Simulator, refined

# Differences are central, over this share of a parameter's magnitude: their error is of its square.
DIFFERENCE_STEP = 1e-3
# A fit has ended where the last step is shorter than this in standard deviations; what is left is of its square.
ENDED_STDS, MOST_STEPS, MOST_HALVINGS = 0.1, 12, 6
# Directions of parameters with unit information that have less than this are not determined: differences leave about
# their own error, STEP², squared.
LEAST_INFORMATION = 1e-9


@dataclass(frozen=True, eq=False)
class WindowFit:
    """What one window says of one fault.

    Attributes
    ----------
    values, std : (N,) arrays
        θ_e by the names of the model, within its bounds; infinite standard deviations where not determined.
    statistic : float
        D, by how much the fault lowers the parabola: about the fall of the compound criterion, of large faults less (of
        one of 20 standard deviations three quarters).
    reference : Reference
        Its distribution without a fault.
    active : int
        Fault parameters that are not at their bound.
    squares : float
        Σ ε²/σ² over the counted samples.
    samples : int
    share : float
        Of the variance of the fault parameters, what the healthy record's errors make, the same in all windows.
    point : (N,) array
        The minimum within the bounds, in the coordinates of the search: where the next window begins.
    belief : Belief
        After this window, bounds left out.
    ended : bool
    colour : float
        By which factor the residual's colour widens the scatter of the fault parameters, at most.
    """

    values: Floats
    std: Floats
    statistic: float
    reference: Reference
    active: int
    squares: float
    samples: int
    share: float
    point: Floats
    belief: Belief
    ended: bool
    colour: float


class Extended:
    """A fault model with the prior of the common mode.

    Parameters
    ----------
    name : str
    fault : Fault
    common : mapping of str to Parameter
        The nominal parameters by the healthy machine's names (`fmuid.diagnosis.faults.common_mode`).
    variance : mapping of str to float
        Noise variance of each output by the healthy machine's names.
    freedom : float
        Its degrees of freedom.
    refinement : Refinement
        How much finer than asked for the model is simulated.

    Attributes
    ----------
    names : tuple of str
        θ_e by the names of this model, the fault's own last.
    prior : Belief

    Raises
    ------
    InputError
        If the fault has a parameter of the healthy machine's.
    """

    def __init__(
        self,
        name: str,
        fault: Fault,
        common: Mapping[str, Parameter],
        variance: Mapping[str, float],
        freedom: float = math.inf,
        refinement: Refinement = AS_ASKED,
    ) -> None:
        self.name, self.fault, self.freedom, self.refinement = name, fault, freedom, refinement
        self.system = System.of(fault.model)
        nominal = {fault.names.get(each, each): parameter for each, parameter in common.items()}
        for each in fault.parameters:
            if each in nominal:
                raise InputError(
                    f"fault {name!r}: the parameter {each!r} is the fault's and the healthy machine's: "
                    "it can be only one"
                )
        self.parameters = nominal | fault.searched
        self.names = tuple(self.parameters)
        self.first = len(nominal)
        self._variance = {fault.names.get(each, each): value for each, value in variance.items()}
        place = {each: i for i, each in enumerate(self.names)}
        self._located = [(place[size], place[angle]) for size, angle in fault.located.items()]
        self._periods = [found.period for each in fault.located.values() if (found := fault.angle(each)) is not None]
        self._constrained = [place[each] - self.first for each in fault.constrained]
        self.scale = np.array([parameter.nominal or abs(parameter.start) or 1.0 for parameter in nominal.values()])
        self.scale = np.append(self.scale, [self._fault_scale(each) for each in fault.parameters])
        self.lower = np.array([parameter.min for parameter in self.parameters.values()])
        self.upper = np.array([parameter.max for parameter in self.parameters.values()])
        for pair in self._located:
            self.lower[list(pair)], self.upper[list(pair)] = -np.inf, np.inf
        self.prior = self._prior()

    def _fault_scale(self, name: str) -> float:
        size = next((size for size, angle in self.fault.located.items() if angle == name), name)
        return self.fault.parameters[size].nominal or 1.0

    def _prior(self) -> Belief:
        mean, weight = np.zeros(len(self.names)), np.zeros(len(self.names))
        for i, parameter in enumerate(self.parameters.values()):
            if i < self.first:
                mean[i] = parameter.start
            if isinstance(parameter.prior, Normal):
                mean[i], weight[i] = parameter.prior.mean, parameter.prior.std**-2.0
        return Belief(mean, np.diag(weight), np.zeros((mean.size, mean.size)))

    def simulator(self, experiment: Experiment) -> Simulator:
        """Return the simulator of an experiment that has this model's names.

        Raises
        ------
        InputError
            If the experiment has other inputs or outputs than the model.
        """
        found = Simulator(self.system, experiment, self.names, values=self.fault.values)
        return refined(found, self.system, self.refinement) if self.refinement.any else found

    def thetas(self, points: Floats) -> Floats:
        """Return parameters of the model (m, N) from points of the search (m, N)."""
        found = points.copy()
        for (i, j), period in zip(self._located, self._periods, strict=True):
            found[:, i] = np.hypot(points[:, i], points[:, j])
            found[:, j] = np.arctan2(points[:, j], points[:, i]) % (2.0 * math.pi) * period / (2.0 * math.pi)
        return found

    def weights(self, experiment: Experiment) -> Floats:
        """Return 1/σ of all counted samples (n,).

        Raises
        ------
        InputError
            If the noise of an output is not known.
        """
        for name in experiment.output_names:
            if name not in self._variance:
                raise InputError(f"the noise variance of {name!r} is not known, only of {', '.join(self._variance)}")
        columns = np.array([self._variance[name] ** -0.5 for name in experiment.output_names])
        return np.broadcast_to(columns, experiment.counted.shape)[experiment.counted]

    def linearise(self, simulator: Simulator, point: Floats) -> tuple[Floats, Floats]:
        """Return counted outputs (n,) and sensitivities (n, N) over σ, at a point of the search.

        Raises
        ------
        SimulationError
            If a simulation fails.
        """
        experiment, count, step = simulator.experiment, point.size, DIFFERENCE_STEP * self.scale
        # beside a bound both points lie on the other side of it
        offsets = np.tile([-1.0, 1.0], (count, 1))
        offsets[point - step < self.lower] = [1.0, 2.0]
        offsets[point + step > self.upper] = [-1.0, -2.0]
        points = np.tile(point, (2 * count + 1, 1))
        for i in range(count):
            points[[2 * i + 1, 2 * i + 2], i] += offsets[i] * step[i]
        batch = simulator.many(self.thetas(points))
        for error in batch.errors:
            if error is not None:
                raise error
        found = batch.outputs[:, experiment.counted] * self.weights(experiment)
        base, a, b = found[0], offsets[:, 0] * step, offsets[:, 1] * step
        low, high = found[1::2] - base, found[2::2] - base
        # the slope of the parabola through three points
        slopes = (low.T * (b / a) - high.T * (a / b)) / (b - a)
        return base, slopes

    def fit(self, simulator: Simulator, start: Floats, prior: Belief) -> WindowFit:
        """Fit a window, from a start (N,) in the coordinates of the search.

        Raises
        ------
        SimulationError
            If the simulation fails at the start.
        """
        experiment = simulator.experiment
        measured = experiment.output_values[experiment.counted] * self.weights(experiment)
        point, halvings, ended = np.clip(start, self.lower, self.upper), 0, False
        last: tuple[Floats, float] | None = None  # the point before, and the criterion there
        for _ in range(MOST_STEPS):
            try:
                base, slopes = self.linearise(simulator, point)
            except SimulationError:
                if last is None:
                    raise
                base = slopes = np.empty(0)
            away = point - prior.mean
            residual = measured - base if base.size else base
            criterion = float(residual @ residual + away @ prior.information @ away) if base.size else math.inf
            if last is not None and criterion > last[1] * (1.0 + 1e-9) and halvings < MOST_HALVINGS:
                point, halvings = 0.5 * (point + last[0]), halvings + 1
                continue
            if not base.size:
                break
            information = prior.information + slopes.T @ slopes
            if not self.determined(information):
                return self._nothing(residual, point, prior)
            gradient = slopes.T @ residual - prior.information @ away
            free = point + np.linalg.solve(information, gradient)
            target = self._within(free, information)
            move = target - point
            ended = float(np.sqrt(move @ information @ move)) < ENDED_STDS
            if ended:
                break
            last, point, halvings = (point, criterion), target, 0
        rest = residual - slopes @ (target - point)
        noise = self._noise(slopes, rest, information, prior, experiment)
        white = Belief(free, information, prior.scatter + slopes.T @ slopes)
        coloured = replace(white, scatter=prior.scatter + noise.noise.gram(slopes))
        ratio = np.diag(self.covariance(coloured)) / np.diag(self.covariance(white))
        colour = float(np.sqrt(ratio[self.first :].max()))
        # the variance is that of the healthy record, its colour that of the window
        inverse = 1.0 / self.freedom + float(np.mean(1.0 / noise.freedom[self.first :]))
        freedom = 1.0 / inverse if inverse > 0.0 else math.inf
        return self._found(coloured, target, float(rest @ rest), rest.size, ended, colour, freedom)

    def _noise(
        self, slopes: Floats, residual: Floats, information: Floats, prior: Belief, experiment: Experiment
    ) -> Sandwich:
        """Return how the minimum scatters under the noise that the residual (n,) shows."""
        sizes = np.sqrt(np.sum(slopes**2, axis=0))
        basis, singular, _ = np.linalg.svd(slopes / np.where(sizes > 0, sizes, 1.0), full_matrices=False)
        basis = basis[:, singular**2 > LEAST_INFORMATION]
        outputs, kinds = experiment.output_names, np.zeros(len(experiment.output_names), dtype=np.bool_)
        known = self.prior.information + prior.scatter
        own = residual - basis @ (basis.T @ residual)
        inverse = np.asarray(np.linalg.inv(information), dtype=np.float64)
        rows = Rows(own, basis, slopes, inverse, known, ~kinds, kinds)
        return sandwich(rows, series_of([experiment], outputs))

    def determined(self, information: Floats) -> bool:
        """Return whether an information matrix (N, N) determines all parameters."""
        alone = np.sqrt(np.diag(information))
        if not (alone > 0).all():
            return False
        return bool(np.linalg.eigvalsh(information / np.outer(alone, alone))[0] > LEAST_INFORMATION)

    def _within(self, free: Floats, information: Floats) -> Floats:
        """Return the minimum of the parabola within the bounds (N,)."""
        if (free >= self.lower).all() and (free <= self.upper).all():
            return free
        return nearest(free, information, self.lower, self.upper)

    def _nothing(self, residual: Floats, point: Floats, prior: Belief) -> WindowFit:
        """Return the fit of a window that does not determine the fault."""
        theta = self.thetas(point[None])[0]
        return WindowFit(
            theta,
            np.full(theta.size, math.inf),
            0.0,
            Reference(1),
            0,
            float(residual @ residual),
            residual.size,
            0.0,
            point,
            prior,
            False,
            1.0,
        )

    def covariance(self, belief: Belief) -> Floats:
        """Return the covariance of the estimate (N, N): of the prior's errors, and of the noise."""
        inverse = np.linalg.inv(belief.information)
        return np.asarray(inverse @ (self.prior.information + belief.scatter) @ inverse)

    def _found(
        self, after: Belief, target: Floats, squares: float, samples: int, ended: bool, colour: float, freedom: float
    ) -> WindowFit:
        whole = self.covariance(after)
        inverse = np.linalg.inv(after.information)
        own = whole[self.first :, self.first :]
        by_prior = (inverse @ self.prior.information @ inverse)[self.first :, self.first :]
        statistic, kept = self.statistic(after.mean[self.first :], own)
        return WindowFit(
            self.thetas(target[None])[0],
            self._std(target, whole),
            statistic,
            self.reference(own, freedom),
            max(1, int(np.count_nonzero(kept))),
            squares,
            samples,
            float(np.max(np.diag(by_prior) / np.diag(own))),
            target,
            after,
            ended,
            colour,
        )

    def statistic(self, fault: Floats, covariance: Floats) -> tuple[float, Floats]:
        """Return D of fault parameters (k,) without bounds, and the nearest ones within theirs (k,)."""
        information = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        lower: Floats = np.full(fault.size, -np.inf)
        upper: Floats = np.full(fault.size, np.inf)
        lower[self._constrained] = self.lower[self.first :][self._constrained]
        upper[self._constrained] = self.upper[self.first :][self._constrained]
        kept = fault if (fault >= lower).all() and (fault <= upper).all() else nearest(fault, information, lower, upper)
        off = fault - kept
        return max(0.0, float(fault @ information @ fault - off @ information @ off)), kept

    def reference(self, covariance: Floats, freedom: float) -> Reference:
        """Return the distribution of D without a fault, by the covariance of the fault parameters (k, k)."""
        kept = np.ix_(self._constrained, self._constrained)
        return Reference(len(covariance) - len(self._constrained), orthant_weights(covariance[kept]), freedom)

    def _std(self, point: Floats, covariance: Floats) -> Floats:
        std = np.sqrt(np.diag(covariance))
        for (i, j), period in zip(self._located, self._periods, strict=True):
            size = math.hypot(point[i], point[j])
            along = np.array([point[i], point[j]]) / size if size else np.array([1.0, 0.0])
            own = covariance[np.ix_([i, j], [i, j])]
            across = np.array([-along[1], along[0]])
            std[i] = math.sqrt(along @ own @ along)
            std[j] = math.sqrt(across @ own @ across) / size * period / (2.0 * math.pi) if size else math.inf
        return std
