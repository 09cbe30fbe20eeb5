"""The problem of an identification whose predictors run FMUs: where models and estimation meet."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment, JointPrior, Noise, Parameter
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, LeastSquares, Result, SimulationNoise
from fmuid.formatting import nearest
from fmuid.identification.discrete_parameters import Given, choices_of
from fmuid.models import FMU, System
from fmuid.simulation import (
    AS_ASKED,
    Refinement,
    Simulator,
    Value,
    derivatives_of,
    how_run,
    next_refinement,
    parameter_units,
    refined,
)


@dataclass(frozen=True, eq=False)
class ModelReference:
    """What a result was made with, by which it predicts; a result that is copied or sent elsewhere knows it no more.

    Attributes
    ----------
    system : System
    values : mapping of str to float, int, bool or str
        Variables held at a value.
    parameters : mapping of str to Parameter
    step_size : float, optional
    """

    system: System
    values: Mapping[str, Value]
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    step_size: float | None = None

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        return type(None), ()


class Problem(LeastSquares):
    """A model, experiments and parameters: everything that the estimators need, as functions of theta.

    Parameters
    ----------
    model : System, FMU or path
    experiments : Experiment or sequence of Experiment
    parameters : mapping of str to Parameter
        By FMU variable.
    noise : Noise
    values : mapping of str to float, int, bool or str, optional
        FMU variables held at a value.
    step_size : float, optional
        Largest step of the simulation, s.
    joint_prior : JointPrior, optional
        Beside the priors of single parameters.
    loss : "linear", "soft_l1", "huber" or "cauchy"
        How the criterion grows with a sample's residual in standard deviations of the noise: all but "linear", the
        plain square, keep outliers from pulling (`fmuid.data.losses`). Priors always count by their squares.
    sensitivity : "finite-difference", "forward" or "fmu"
        How the derivatives of the outputs by the parameters are found
        (`fmuid.estimation.model_sensitivities.SENSITIVITIES`).
    choices : mapping of str to sequence of values, or to "all", optional
        Variables that take few values, Integer, Boolean or of an enumeration: `fmuid.identify` searches with each
        combination of them and leaves the problem at the best. "all": those that the FMU declares.
    like : Problem, optional
        One that differs in its measurements only, the same samples counting: what it has laid out, and its noise,
        serve this one too.

    Attributes
    ----------
    system : System
        As it was asked for.
    refinement : Refinement
        How much finer than that it is simulated: a search whose simulation turns out too coarse goes on by a finer one
        (`fmuid.identify`), and so does all that is done with the problem from then on.
    laid_out : tuple of Simulator
        What simulates the experiments as it was asked for, with the first of each of the `choices`.
    observer : float or None
        The time constant, in samples, of an observer that corrects the states (`fmuid.identification.with_observer`).

    Raises
    ------
    InputError
        If there are no experiments, parameters, outputs or counted samples, too few for the parameters, or if there is
        no such loss or sensitivity.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, {"R": fmuid.Parameter(3.0, min=0.0)}, values={"L": 0.1})
    >>> fmuid.identify(problem).names
    ('R',)
    """

    def __init__(
        self,
        model: System | FMU | str | Path,
        experiments: Experiment | Sequence[Experiment],
        parameters: Mapping[str, Parameter],
        *,
        noise: Noise | None = None,
        values: Mapping[str, float | int | bool | str] | None = None,
        step_size: float | None = None,
        joint_prior: JointPrior | None = None,
        loss: str = "linear",
        sensitivity: str = "finite-difference",
        choices: Given | None = None,
        like: Problem | None = None,
    ) -> None:
        if sensitivity not in SENSITIVITIES:
            near = nearest(sensitivity, SENSITIVITIES)
            raise InputError(f"sensitivity {sensitivity!r} is not known{near}: give {' or '.join(SENSITIVITIES)}")
        self.system = System.of(model)
        # of what is no experiment a simulator says so
        listed: list[Any] = list(experiments) if isinstance(experiments, list | tuple) else [experiments]
        self.choices = choices_of(self.system, choices or {})
        both = next((name for name in self.choices if name in parameters), None)
        if both is not None:
            raise InputError(f"{both!r} is to be identified and takes few values: keep one of the two")
        held = dict(values or {}) | {name: few[0] for name, few in self.choices.items()}
        self._given, self._asked = (tuple(parameters), held, step_size), parameters
        self.laid_out: tuple[Simulator, ...] = like.laid_out if like else tuple(self._lay_out(listed, held))
        self._simulators = list(self.laid_out)
        self._noise_found: tuple[Floats, Floats, SimulationNoise] | None = None if like is None else like._noise_found
        self.refinement = AS_ASKED
        self.observer: float | None = None
        self._finer: dict[Refinement, Problem] = {}
        self._tables = listed
        self._known: tuple[Floats, Floats] | None = None
        self._due = 0
        super().__init__(
            self._simulators,
            listed,
            parameters,
            noise=noise,
            joint_prior=joint_prior,
            loss=loss,
            sensitivity=sensitivity,
            derivatives=_derivatives(self._simulators, sensitivity),
        )
        if like is not None:
            self.series, self.periods = like.series, like.periods

    def _lay_out(self, experiments: Sequence[Experiment], held: Mapping[str, Value]) -> list[Simulator]:
        names, _, step_size = self._given
        return [Simulator(self.system, each, names, values=held, step_size=step_size) for each in experiments]

    @property
    def made_with(self) -> ModelReference:
        """What its results are made with."""
        return ModelReference(self.system, self._given[1], self._asked, self._given[2])

    def choose(self, values: Mapping[str, Value]) -> None:
        """Hold parameters that take few values at these from now on, simulated as was asked for."""
        _, held, _ = self._given
        self._simulators = self._lay_out(self._tables, {**held, **values})
        self._predictors = tuple(self._simulators)
        self._derivatives = tuple(_derivatives(self._simulators, self.sensitivity))
        self.refinement, self._finer, self._known, self._reasons = AS_ASKED, {}, None, {}

    def become(self, result: Result) -> None:
        """Simulate as a result of this problem was, with the values that it has chosen."""
        if result.chosen:
            self.choose(result.chosen)
        self.simulate_by(refinement_of(result))

    @property
    def models(self) -> dict[str, dict[str, Any]]:
        """``name``, ``digest`` and ``run`` (a `fmuid.models.SolverConfiguration`) of each component's FMU."""
        run = self.how_run(self.refinement)
        return {
            name: {"name": model.fmu.name, "digest": model.fmu.digest, "run": run[name]}
            for name, model in self.system.components.items()
        }

    @property
    def units(self) -> dict[str, str]:
        """The units of the parameters that have one."""
        names = self.parameters.names
        return {name: unit for name, unit in zip(names, parameter_units(self.system, names), strict=True) if unit}

    def how_run(self, refinement: Refinement) -> dict[str, dict[str, Any]]:
        """Return how each component is run with a refinement, as far as it is known which are stiff.

        The fields of a `fmuid.models.SolverConfiguration` for each.
        """
        known = self if refinement == self.refinement else self._finer.get(refinement)
        stiff = frozenset[str]().union(*(each.stiff for each in (known._simulators if known is not None else ())))
        return {name: dict(vars(run)) for name, run in how_run(self.system, refinement, stiff).items()}

    @property
    def simulators(self) -> tuple[Simulator, ...]:
        """What simulates the experiments, one each."""
        return tuple(self._simulators)

    @property
    def corrected(self) -> bool:
        """Whether measurements correct the states at the samples: nothing finer can be compared with that."""
        return any(each.corrects for each in self._simulators)

    def noise_near(self, theta: Floats) -> tuple[Floats, SimulationNoise]:
        """Find out as `LeastSquares.noise_near` does, once for all problems that differ in their measurements only."""
        plain = self._simulators == list(self.laid_out) and self._known is None
        plain &= self.levels.scale is None  # which may follow from measurements
        known, failures = self._noise_found, self.failures
        if plain and known is not None and np.array_equal(known[0], theta):
            self.simulations += known[2].simulations
            return known[1], known[2]
        base, noise = super().noise_near(theta)
        if plain and self.failures == failures:
            self._noise_found = theta.copy(), base, noise
        return base, noise

    # --- finer simulations

    @property
    def next_refinement(self) -> Refinement | None:
        """The next finer way to simulate the model, None where there is none."""
        return next_refinement(self.system, self.refinement)

    @property
    def next_sure_refinement(self) -> Refinement | None:
        """The next one by which a search can go on: it is the same model beyond doubt."""
        return next_refinement(self.system, self.refinement, surely=True)

    def refined(self, refinement: Refinement) -> Problem:
        """Return this problem with finer simulations, which are counted by themselves.

        Raises
        ------
        InputError
            If an FMU cannot step that way.
        """
        if refinement not in self._finer:
            other = copy.copy(self)
            other._simulators = [refined(each, self.system, refinement) for each in self._simulators]
            other._predictors = tuple(other._simulators)
            other._derivatives = tuple(_derivatives(other._simulators, self.sensitivity))
            other.refinement, other._finer, other._known = refinement, {}, None
            other.simulations, other.failures, other._reasons = 0, 0, {}
            self._finer[refinement] = other
        return self._finer[refinement]

    def simulated_by(self, simulators: Sequence[Simulator]) -> Problem:
        """Return this problem by other simulators of its experiments; derivatives are differences, and it is counted.

        Parameters
        ----------
        simulators : sequence of Simulator
        """
        other = copy.copy(self)
        other._simulators, other._predictors = list(simulators), tuple(simulators)
        other.sensitivity, other._derivatives = "finite-difference", ()
        other._finer, other._known = {}, None
        other.simulations, other.failures, other._reasons = 0, 0, {}
        return other

    def simulate_by(self, refinement: Refinement) -> None:
        """Simulate in a finer way from now on."""
        if refinement == self.refinement:
            return
        other = self.refined(refinement)
        self._simulators, self._predictors, self._derivatives = other._simulators, other._predictors, other._derivatives
        self.refinement, self._finer, self._known, self._reasons = refinement, {}, None, {}

    def predict_by(self, refinement: Refinement, theta: Floats) -> Floats:
        """Return the counted samples (n,) of another simulation at theta (N,), NaN where it fails."""
        try:
            other = self.refined(refinement)
        except InputError:  # an FMU that takes no such steps
            return np.full(self.measured.size, np.nan)
        exact: Floats = other.predict(theta[None])[0]
        self.count(other)
        return exact

    @contextmanager
    def uncounted(self) -> Iterator[None]:
        """Leave the numbers of simulations and failures as they are."""
        before = self.simulations, self.failures
        yield
        self.simulations, self.failures = before

    def count(self, other: Problem) -> None:
        """Count what was simulated with another problem as simulated with this one."""
        self.simulations += other.simulations
        self.failures += other.failures
        other.simulations = other.failures = 0

    def remember(self, theta: Floats, predicted: Floats, due: int = 0) -> None:
        """Take a simulation (n,) at theta (N,) for the next one that is asked for there, and count it then as `due`."""
        self._known, self._due = (theta.copy(), predicted), due

    def predict(self, thetas: Floats) -> Floats:
        """Simulate as `LeastSquares.predict` does, but for what is known."""
        known, self._known = self._known, None
        if known is not None and np.array_equal(thetas, known[0][None]):
            self.simulations, self._due = self.simulations + self._due, 0
            return known[1][None].copy()
        return super().predict(thetas)


def refinement_of(result: Result) -> Refinement:
    """Return how much finer than asked for a result was simulated: what is compared with it must be, too."""
    accuracy = result.accuracy
    return AS_ASKED if accuracy is None else Refinement(accuracy.tolerance, accuracy.divisor)


def _derivatives(simulators: Sequence[Simulator], sensitivity: str) -> list[Callable[[Floats], Floats]]:
    return [] if sensitivity == "finite-difference" else [derivatives_of(each, sensitivity) for each in simulators]
