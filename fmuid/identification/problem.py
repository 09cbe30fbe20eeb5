"""The problem of an identification whose predictors run FMUs: where models and estimation meet."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

from fmuid.array_types import Floats
from fmuid.data import Experiment, JointPrior, Noise, Parameter, ParameterSet
from fmuid.errors import InputError
from fmuid.estimation import SENSITIVITIES, LeastSquares, Result, RunFields, UsedModel
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
    """A model, experiments and parameters; it never changes, and other forms of it are new problems.

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
        combination of them. "all": those that the FMU declares.

    Attributes
    ----------
    system : System
        As it was asked for.
    values : mapping of str to float, int, bool or str
        Variables held at a value, with the first of each of the `choices`, or those chosen (`holding`).
    refinement : Refinement
        How much finer than asked for it is simulated (`finer`).
    predictors : tuple of Simulator
        What simulates the experiments, one each.
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

    substituted = False
    """Whether its simulators are not those of the model as declared (`simulated_by`)."""

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
    ) -> None:
        if sensitivity not in SENSITIVITIES:
            near = nearest(sensitivity, SENSITIVITIES)
            raise InputError(f"sensitivity {sensitivity!r} is not known{near}: give {' or '.join(SENSITIVITIES)}")
        self.system, self.step_size = System.of(model), step_size
        # of what is no experiment a simulator says so
        listed: list[Any] = list(experiments) if isinstance(experiments, list | tuple) else [experiments]
        self.choices = choices_of(self.system, choices or {})
        both = next((name for name in self.choices if name in parameters), None)
        if both is not None:
            raise InputError(f"{both!r} is to be identified and takes few values: keep one of the two")
        self.values: Mapping[str, Value] = dict(values or {}) | {name: few[0] for name, few in self.choices.items()}
        self.refinement, self.observer = AS_ASKED, None
        simulators = self._lay_out(listed, tuple(parameters), self.values)
        super().__init__(
            simulators,
            listed,
            parameters,
            noise=noise,
            joint_prior=joint_prior,
            loss=loss,
            sensitivity=sensitivity,
            derivatives=_derivatives(simulators, sensitivity),
        )

    def _lay_out(
        self, experiments: Sequence[Experiment], names: tuple[str, ...], held: Mapping[str, Value]
    ) -> list[Simulator]:
        return [Simulator(self.system, each, names, values=held, step_size=self.step_size) for each in experiments]

    # --- other forms

    def finer(self, refinement: Refinement) -> Self:
        """Return this problem with a solver refinement of what was asked for.

        Raises
        ------
        InputError
            If an FMU cannot step that way.
        """
        if refinement == self.refinement:
            return self
        return self._by([refined(each, self.system, refinement) for each in self.simulators], refinement=refinement)

    def holding(self, values: Mapping[str, Value]) -> Self:
        """Return this problem with variables held at these values, simulated as was asked for."""
        held, experiments = {**self.values, **values}, [each.experiment for each in self.simulators]
        if held == self.values and not self.refinement.any:
            return self
        simulators = self._lay_out(experiments, tuple(self.given_parameters), held)
        return self._by(simulators, values=held, refinement=AS_ASKED)

    def measuring(self, experiments: Sequence[Experiment], parameters: Mapping[str, Parameter] | None = None) -> Self:
        """Return this problem with other measurements of the same samples, and perhaps other starts.

        What has switched to another solver meanwhile is laid out anew, so that no problem depends on another.
        """
        own = self.afresh() if any(each.stiff for each in self.simulators) else self
        return LeastSquares.measuring(own, experiments, parameters)

    def afresh(self) -> Self:
        """Return this problem with simulators that have simulated nothing yet."""
        return self._by([each.over(each.experiment) for each in self.simulators])

    def simulated_by(
        self, simulators: Sequence[Simulator], parameters: ParameterSet | None = None, observer: float | None = None
    ) -> Self:
        """Return this problem by other simulators of its experiments, with derivatives by differences.

        Parameters
        ----------
        simulators : sequence of Simulator
        parameters : ParameterSet, optional
            These parameters within other bounds.
        observer : float, optional
            Time constant, samples, of the observer that these simulators have.
        """
        own = self.parameters if parameters is None else parameters
        changed = {"parameters": own, "observer": observer, "substituted": True}
        return self._by(simulators, sensitivity="finite-difference", **changed)

    def as_in(self, result: Result) -> Self:
        """Return this problem as a result of it was simulated, with the values that it has chosen."""
        chosen = self.holding(result.chosen) if result.chosen else self
        return chosen if result.accuracy is None else chosen.finer(refinement_of(result))

    def _by(self, simulators: Sequence[Simulator], **changed: Any) -> Self:
        sensitivity = changed.get("sensitivity", self.sensitivity)
        derivatives = tuple(_derivatives(simulators, sensitivity))
        return self._with(predictors=tuple(simulators), derivatives=derivatives, **changed)

    # --- what it is

    @cached_property
    def layout(self) -> Hashable:
        """Everything but the measurements, by content; of other simulators these themselves."""
        if self.substituted:
            return self.predictors
        components = {name: (m.fmu.digest, m.numerics) for name, m in self.system.components.items()}
        parts: list[object] = [
            components,
            self.system.connections,
            self.system.connectors,
            self.system.master,
            self.system.values,
        ]
        parts += [self.values, self.step_size, self.refinement, self.sensitivity, self.parameters.names]
        found, bounds = hashlib.sha256(repr(parts).encode()), (self.parameters.lower, self.parameters.upper)
        for experiment, kept in zip([each.experiment for each in self.simulators], self.kept, strict=True):
            given = experiment.output_names, experiment.input_names, experiment.interpolation
            found.update(repr((*given, dict(experiment.units), dict(experiment.values))).encode())
            for array in (experiment.times, experiment.input_values, kept, *bounds):
                found.update(array.tobytes())
        found.update(b"" if self.levels.scale is None else self.levels.scale.tobytes())
        return found.digest()

    @property
    def made_with(self) -> ModelReference:
        """What its results are made with."""
        return ModelReference(self.system, self.values, self.given_parameters, self.step_size)

    @property
    def models(self) -> dict[str, UsedModel]:
        """``name``, ``digest`` and ``run`` (a `fmuid.models.SolverConfiguration`) of each component's FMU."""
        run = self.how_run
        return {
            name: {"name": model.fmu.name, "digest": model.fmu.digest, "run": run[name]}
            for name, model in self.system.components.items()
        }

    @property
    def units(self) -> dict[str, str]:
        """The units of the parameters that have one."""
        names = self.parameters.names
        return {name: unit for name, unit in zip(names, parameter_units(self.system, names), strict=True) if unit}

    @property
    def how_run(self) -> dict[str, RunFields]:
        """How each component is run (a `fmuid.models.SolverConfiguration`), as far as it is known which are stiff."""
        stiff = frozenset[str]().union(*(each.stiff for each in self.simulators))
        return {
            name: cast(RunFields, dict(vars(run))) for name, run in how_run(self.system, self.refinement, stiff).items()
        }

    @property
    def simulators(self) -> tuple[Simulator, ...]:
        """What simulates the experiments, one each."""
        return cast(tuple[Simulator, ...], self.predictors)

    @property
    def corrected(self) -> bool:
        """Whether measurements correct the states at the samples: nothing finer can be compared with that."""
        return any(each.corrects for each in self.simulators)

    @property
    def next_refinement(self) -> Refinement | None:
        """The next finer way to simulate the model, None where there is none."""
        return next_refinement(self.system, self.refinement)

    @property
    def next_sure_refinement(self) -> Refinement | None:
        """The next one by which a search can go on: it is the same model beyond doubt."""
        return next_refinement(self.system, self.refinement, surely=True)


def refinement_of(result: Result) -> Refinement:
    """Return how much finer than asked for a result was simulated: what is compared with it must be, too."""
    accuracy = result.accuracy
    return AS_ASKED if accuracy is None else Refinement(accuracy.tolerance, accuracy.divisor)


def _derivatives(simulators: Sequence[Simulator], sensitivity: str) -> list[Callable[[Floats], Floats]]:
    return [] if sensitivity == "finite-difference" else [derivatives_of(each, sensitivity) for each in simulators]
