"""Problem: system, experiments and parameters; frozen."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

from fmuid.array_types import Floats
from fmuid.data import Experiment, JointPrior, Noise, Observation, Parameter, ParameterSet, is_quantity
from fmuid.errors import InputError, check_kind
from fmuid.estimation import SENSITIVITIES, LeastSquares, Result, RunFields, UsedModel
from fmuid.formatting import nearest
from fmuid.identification.model_errors import Direction, ProcessNoise, Sizes
from fmuid.models import FMU, System
from fmuid.simulation import (
    AS_ASKED,
    AnySimulator,
    PointSimulator,
    Refinement,
    Simulator,
    Value,
    derivatives_of,
    finer_simulator,
    how_run,
    parameter_units,
    simulator_of,
)

MAX_COMBINATIONS = 1000  # of discrete parameters; each needs an optimization


@dataclass(frozen=True, eq=False)
class ModelReference:
    """Model of a result, for predictions; copies of the result lose it."""

    system: System
    values: Mapping[str, Value]  # fixed variables
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    step_size: float | None = None

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        return type(None), ()


class Problem(LeastSquares):
    """Model, experiments and parameters; frozen.

    Parameters
    ----------
    model : System, FMU or path
    experiments : Experiment or sequence of Experiment
    parameters : mapping of str to Parameter
        By FMU variable.
    noise : Noise
    values : mapping of str to float, int, bool or str, optional
        Fixed FMU variables.
    step_size : float, optional
        Largest communication step, s.
    joint_prior : JointPrior, optional
        Beside the priors of single parameters.
    loss : "linear", "soft_l1", "huber" or "cauchy"
        Robust loss of the residuals (`fmuid.data.losses`); "linear" is the plain square.
    sensitivity : "finite-difference", "forward" or "fmu"
        Method of the Jacobian (`fmuid.estimation.SENSITIVITIES`).
    choices : mapping of str to sequence of values, or to "all", optional
        Discrete parameters with their values; `fmuid.identify` tries each combination. "all": those the FMU declares.

    Attributes
    ----------
    system : System
    values : mapping of str to float, int, bool or str
        Fixed variables, with the first or the chosen values of the `choices` (`holding`).
    refinement : Refinement
        Solver refinement (`finer`).
    predictors : tuple of Simulator or PointSimulator
        One an experiment.
    observer : float or None
        Time constant of an observer, in samples (`fmuid.identification.with_observer`).

    Raises
    ------
    InputError
        If experiments, parameters, outputs or samples are missing, samples are too few, or a loss or sensitivity is
        unknown.

    Examples
    --------
    >>> coil = fmuid.datasets.coil()
    >>> problem = fmuid.Problem(coil.fmu, coil.experiment, {"R": fmuid.Parameter(3.0, min=0.0)}, values={"L": 0.1})
    >>> fmuid.identify(problem).names
    ('R',)
    """

    substituted = False  # True if its simulators are not those of the declared model (`simulated_by`)

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
        choices: Mapping[str, Sequence[Value] | str] | None = None,
    ) -> None:
        if sensitivity not in SENSITIVITIES:
            near = nearest(sensitivity, SENSITIVITIES)
            raise InputError(f"sensitivity: unknown value {sensitivity!r}{near}. Choose {', '.join(SENSITIVITIES)}.")
        self.system, self.step_size = System.of(model), step_size
        listed: list[Any] = list(experiments) if isinstance(experiments, list | tuple) else [experiments]
        self.choices = choices_of(self.system, choices or {})
        both = next((name for name in self.choices if name in parameters), None)
        if both is not None:
            raise InputError(f"{both!r} is in parameters and in choices. Keep one of the two.")
        self.values: Mapping[str, Value] = dict(values or {}) | {name: few[0] for name, few in self.choices.items()}
        self.refinement, self.observer = AS_ASKED, None
        check_kind(parameters, Mapping, "parameters must be a mapping of names to fmuid.Parameter(start)")
        observations = [each.observation for each in listed if isinstance(each, Experiment)]
        parameters = with_quantities(observations, parameters)
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
    ) -> list[AnySimulator]:
        return [simulator_of(self.system, each, names, held, self.step_size) for each in experiments]

    def finer(self, refinement: Refinement) -> Self:
        """Return this problem with a solver refinement.

        Raises
        ------
        InputError
            If an FMU cannot step that way.
        """
        if refinement == self.refinement:
            return self
        finer = [finer_simulator(each, self.system, refinement) for each in self.simulators]
        return self._by(finer, refinement=refinement)

    def holding(self, values: Mapping[str, Value]) -> Self:
        """Return this problem with other fixed values, without solver refinement."""
        held, experiments = {**self.values, **values}, [each.experiment for each in self.simulators]
        if held == self.values and not self.refinement.any:
            return self
        simulators = self._lay_out(experiments, tuple(self.given_parameters), held)
        return self._by(simulators, values=held, refinement=AS_ASKED)

    def measuring(self, experiments: Sequence[Experiment], parameters: Mapping[str, Parameter] | None = None) -> Self:
        """Return this problem with other measurements of the same samples.

        Simulators that switched to another solver are made anew: problems stay independent.
        """
        own = self.afresh() if any(each.stiff for each in self.simulators) else self
        return LeastSquares.measuring(own, experiments, parameters)

    def afresh(self) -> Self:
        """Return this problem with new simulators."""
        return self._by([each.over(each.experiment) for each in self.simulators])

    def simulated_by(
        self, simulators: Sequence[AnySimulator], parameters: ParameterSet | None = None, observer: float | None = None
    ) -> Self:
        """Return this problem with other simulators and bounds, with finite differences.

        `observer` is the time constant of the simulators' observer, in samples.
        """
        changed = {"parameters": parameters or self.parameters, "observer": observer, "substituted": True}
        return self._by(simulators, sensitivity="finite-difference", **changed)

    def as_in(self, result: Result) -> Self:
        """Return this problem as simulated for a result of it."""
        chosen = self.holding(result.chosen) if result.chosen else self
        return chosen if result.accuracy is None else chosen.finer(refinement_of(result))

    def _by(self, simulators: Sequence[AnySimulator], **changed: Any) -> Self:
        derivatives = tuple(_derivatives(simulators, changed.get("sensitivity", self.sensitivity)))
        return self._with(predictors=tuple(simulators), derivatives=derivatives, **changed)

    @cached_property
    def layout(self) -> Hashable:
        """Everything but the measurements, by content; substituted simulators themselves."""
        if self.substituted:
            return self.predictors
        system = self.system
        components = {name: (m.fmu.digest, m.numerics) for name, m in system.components.items()}
        parts: list[object] = [components, system.connections, system.connectors, system.master, system.values]
        parts += [self.values, self.step_size, self.refinement, self.sensitivity, self.parameters.names]
        found, bounds = hashlib.sha256(repr(parts).encode()), (self.parameters.lower, self.parameters.upper)
        for experiment, kept in zip([each.experiment for each in self.simulators], self.kept, strict=True):
            given = experiment.output_names, experiment.input_names, experiment.interpolation, experiment.design
            found.update(
                repr((*given, dict(experiment.units), dict(experiment.values), experiment.observation)).encode()
            )
            made = experiment.sensor_map
            readings = () if made is None else (made.angle, made.voltages)
            for array in (experiment.times, experiment.input_values, kept, *bounds, *readings):
                found.update(array.tobytes())
        found.update(b"" if self.levels.scale is None else self.levels.scale.tobytes())
        return found.digest()

    def directions(self, result: Result, sizes: Sizes | None = None) -> tuple[Direction, ...]:
        """Return the directions of model errors at a result; those in time are secants of their sizes."""
        from fmuid.identification.directions import model_directions

        own = self.as_in(result)
        return () if self.corrected else model_directions(own, own.simulators, result, sizes or {})

    def process_noise(self, result: Result) -> ProcessNoise | None:
        """Return the disturbance that explains the color of a result's residuals."""
        from fmuid.identification.process_noise import process_noise_of

        own = self.as_in(result)
        return None if self.corrected else process_noise_of(own, own.simulators, result)

    def doubtful_rows(self, result: Result) -> dict[str, tuple[int, str]]:
        """Return rows with several steady states or an event, with reason."""
        own = self.as_in(result)
        points = (each for each in own.simulators if isinstance(each, PointSimulator))
        found = {each.experiment.name: each.issue_at(result.values) for each in points}
        return {name: issue for name, issue in found.items() if issue is not None}

    def other_conventions(self, result: Result) -> Iterable[tuple[str, str, str, float]]:
        """Return the responses that fit with another convention."""
        from fmuid.identification.response_conventions import find_conventions

        own = self.as_in(result)

        def changed(experiments: Sequence[Experiment]) -> LeastSquares:
            simulators = [each.over(one) for each, one in zip(own.simulators, experiments, strict=True)]
            return own.simulated_by(simulators).measuring(experiments)

        return find_conventions(self.system, own.experiments, result, changed)

    @property
    def made_with(self) -> ModelReference:
        """Model of its results."""
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
        """Units of the parameters that have one."""
        names = self.parameters.names
        found = zip(names, parameter_units(self.system, names, self.experiments), strict=True)
        return {name: unit for name, unit in found if unit}

    @property
    def how_run(self) -> dict[str, RunFields]:
        """Solver configuration of each component, as far as stiff ones are known."""
        stiff = frozenset[str]().union(*(each.stiff for each in self.simulators))
        return run_fields(self.system, self.refinement, stiff)

    @property
    def simulators(self) -> tuple[AnySimulator, ...]:
        """Simulators of the experiments, one each."""
        return cast(tuple[AnySimulator, ...], self.predictors)

    @property
    def corrected(self) -> bool:
        """True if measurements correct the states: there is no solver check then."""
        return any(each.corrects for each in self.simulators)


def with_quantities(
    observations: Sequence[Observation | None], parameters: Mapping[str, Parameter]
) -> dict[str, Parameter]:
    """Return parameters and those of observations; given ones come first."""
    found, maps = dict(parameters), [each for each in observations if each is not None]
    known = [name for each in maps for name in each.names]
    for name in (name for name in parameters if is_quantity(name) and name not in known):
        raise InputError(f"parameter {name!r}: no experiment has this sensor or line{nearest(name, known)}.")
    for name, parameter in (pair for each in maps for pair in each.parameters.items()):
        if name not in parameters and found.setdefault(name, parameter) != parameter:
            raise InputError(f"{name!r} differs between experiments. Give both the same start and prior.")
    return found


def run_fields(system: System, refinement: Refinement, stiff: frozenset[str] = frozenset()) -> dict[str, RunFields]:
    """Return the solver configuration of each component with a refinement."""
    return {name: cast(RunFields, dict(vars(run))) for name, run in how_run(system, refinement, stiff).items()}


def refinement_of(result: Result) -> Refinement:
    """Return the solver refinement of a result."""
    used = result.accuracy
    return AS_ASKED if used is None else Refinement(used.tolerance, used.divisor)


def _derivatives(simulators: Sequence[AnySimulator], sensitivity: str) -> list[Callable[[Floats], Floats]]:
    if sensitivity == "finite-difference":
        return []
    for each in simulators:
        if not isinstance(each, Simulator):
            why = f"experiment {each.experiment.name!r} has no time"
            raise InputError(f'jacobian: {sensitivity!r}: {why}. Use "finite-difference".')
    return [derivatives_of(each, sensitivity) for each in simulators if isinstance(each, Simulator)]


def choices_of(system: System, given: Mapping[str, Sequence[Value] | str]) -> dict[str, tuple[Value, ...]]:
    """Return the checked values of each discrete parameter."""
    found = {name: _choices(system, name, values) for name, values in given.items()}
    count = math.prod(map(len, found.values()))
    if count > MAX_COMBINATIONS:
        raise InputError(
            f"{' and '.join(map(repr, found))} have {count} combinations of values, more than {MAX_COMBINATIONS}. "
            "Give fewer values."
        )
    return found


def _choices(system: System, name: str, given: Sequence[Value] | str) -> tuple[Value, ...]:
    variable = system.variables.get(name)
    if variable is None:
        raise InputError(f"choices: {system.label} has no {name!r}{nearest(name, system.variables)}")
    if given != "all":
        values = tuple(given)
        if not values or len({(type(each), each) for each in values}) < len(values):
            raise InputError(f"choices: {name!r} needs one or more different values, not {list(values)!r}.")
        return values
    if variable.type == "Boolean":
        return False, True
    if variable.items:
        return variable.items
    if variable.type == "Integer" and variable.min is not None and variable.max is not None:
        return tuple(range(int(variable.min), int(variable.max) + 1)[: MAX_COMBINATIONS + 1])
    raise InputError(f"choices: {system.label} declares no values of {name!r}. List them instead of 'all'.")
