"""Parameters worth freeing: effects at the FMU's own values.

Columns of one Jacobian, relative to the parameters and the spread of each output, are chosen by QR with column
pivoting (G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 5.4.2 and subset selection, 5.5.7). A column with
little left acts as others do. With less left than the noise, σ would exceed the magnitude.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import Experiment
from fmuid.errors import InputError, SimulationError
from fmuid.identification import TimeScaleWarning, doubt_of_time
from fmuid.models import KINDS, Description, Isolation, Numerics, System, Variable, read_description
from fmuid.simulation import Simulator, closing, simulator_of
from fmuid.studies.init.lines import declared_bounds
from fmuid.studies.init.start_parameters import direct_effects, started, starts_of


@dataclass(frozen=True)
class SurveySettings:
    """Numbers of the survey."""

    step: float = 1e-3  # relative change of a parameter: small for the curvature, large for the solver tolerance
    min_own_effect: float = 0.01  # fraction of an effect that other parameters must not explain
    starts_off: float = 4.0  # deviation of a first sample, in noise levels, that frees start values ...
    starts_floor: float = 1e-3  # ... and as a fraction of the output's spread, for low noise
    unit_ratio: float = 300.0  # of simulated to measured spread, for a wrong unit (milli is 1000)
    min_noise: float = 1e-4  # noise level, fraction of the output's spread: solver errors may be as large
    max_free: int = 12
    max_examined: int = 200
    times_as_long: float = 10.0  # of Co-Simulation over Model Exchange, for the latter ...
    longest: float = 1.0  # s: ... of a simulation with the start of its process, ...
    noticed: float = 0.1  # s: ... and of one without


SETTINGS = SurveySettings()
SHOWN_CHANGE = 0.1  # relative change of a parameter for the effects shown
# Settings of solvers that tools put among the parameters.
_SOLVER = re.compile(r"^_|(^|[._])(nle|solver|tol|tolerance|[ar]tol|eps|max_?iter\w*|step_?size|log\w*)([._]|$)", re.I)
# Quantities with a conventional sign or origin.
_SIGNED = ("degC", "°C", "degF", "rad", "deg")
_PLACE = re.compile(r"position|offset|bias|(^|[._])flange|\[\d+, ?\d", re.I)


class ParameterProposal(Enum):
    """Proposal for a parameter, as in the study file."""

    FREED = "free"
    START_FREED = "free: first samples differ"
    START_OPEN = "free: the only excitation"
    START = "start value, agrees with first samples"
    START_HIDDEN = "start value, which first samples do not show"
    NO_EFFECT = "no effect"
    ALIKE = "acts like"
    NOISE = "effect below the noise"
    ZERO = "0 in the FMU: free it if it matters"
    FAILS = "simulation fails after a change"
    ENOUGH = "others have more effect"


FREE = (ParameterProposal.FREED, ParameterProposal.START_FREED, ParameterProposal.START_OPEN)
KEPT_STARTS = (ParameterProposal.START, ParameterProposal.START_HIDDEN)
STARTS = (*KEPT_STARTS, ParameterProposal.START_FREED, ParameterProposal.START_OPEN)


@dataclass(frozen=True)
class Candidate:
    """Parameter with its proposal; `effect` is the RMS effect of `SHOWN_CHANGE`, in output spreads."""

    variable: Variable
    use: ParameterProposal
    start: float
    effect: float = 0.0
    like: tuple[str, ...] = ()


def proposal(given: Candidate) -> str:
    """Return the proposal for a parameter in words."""
    return " ".join([given.use.value, " and ".join(given.like)]).strip()


@dataclass(frozen=True)
class Survey:
    """Effects of the parameters, strongest first; `failure` is the failed simulation.

    Co-Simulation `lags` if it fails, or takes too long, where Model Exchange does not.
    """

    candidates: tuple[Candidate, ...] = ()
    doubts: tuple[TimeScaleWarning, ...] = ()
    sizes: tuple[tuple[str, str, float], ...] = ()
    failure: str = ""
    lags: bool = False

    @property
    def freed(self) -> tuple[Candidate, ...]:
        """Proposed parameters."""
        return tuple(each for each in self.candidates if each.use in FREE)


def survey(fmu: Path, experiments: Sequence[Experiment]) -> Survey:
    """Propose free parameters from their effects at the FMU's values."""
    failure, description = "", read_description(fmu)
    # solvers inside FMUs are often too inaccurate for differences
    for interface in sorted(set(KINDS) & set(description.interfaces), reverse=True):
        try:
            with closing(System(fmu, numerics=Numerics(interface), isolation=Isolation())) as system:
                found = _surveyed(system, description, experiments)
                both = interface == "model-exchange" and "co-simulation" in description.interfaces
                return replace(found, lags=both and _lags(system, fmu, experiments))
        except (InputError, SimulationError) as error:
            failure = str(error)
    return Survey(failure=failure)


def _lags(system: System, fmu: Path, experiments: Sequence[Experiment]) -> bool:
    """Return whether Co-Simulation fails, or takes too long beside a system."""
    for experiment in [each for each in experiments if each.kind == "time"][:1]:
        longest = SETTINGS.times_as_long * _duration(Simulator(system, experiment))
        isolation = Isolation(time_limit=max(longest, SETTINGS.longest))
        with closing(System(fmu, numerics=Numerics("co-simulation"), isolation=isolation)) as slow:
            found = Simulator(slow, experiment)
            failed = found.many(np.empty((1, 0))).errors[0] is not None
            return failed or _duration(found) > max(longest, SETTINGS.noticed)  # the first one starts a process
    return False


def _duration(simulator: Simulator) -> float:
    """Return the time of a simulation, s."""
    begun = time.perf_counter()
    simulator.many(np.empty((1, 0)))
    return time.perf_counter() - begun


def _surveyed(system: System, description: Description, experiments: Sequence[Experiment]) -> Survey:
    names = [v.name for v in candidates_of(description)][: SETTINGS.max_examined]
    changes = _changes(system, experiments, description, names, {})
    in_time = [each for each in experiments if each.kind == "time"]
    moved = _moved(changes.variables, changes.starts)
    begun = starts_of(system, in_time[0], description, names, moved) if in_time else []
    freed = _freed_starts(changes, begun)
    if freed:  # effects may depend on the initial state
        changes = _changes(system, experiments, description, names, freed)
    doubts = (doubt_of_time(Simulator(system, each), ()) for each in in_time)
    driven = any(each.input_names for each in experiments)
    proposed, doubtful = _proposed(changes, begun, freed, driven=driven), tuple(filter(None, doubts))
    return Survey(proposed, doubtful, changes.sizes if driven else ())


def candidates_of(description: Description) -> list[Variable]:
    """Return parameters, and states whose start no parameter fixes."""
    variables = description.variables.values()
    parameters = [v for v in variables if v.type == "Real" and v.causality == "parameter" and v.settable]
    parameters = [v for v in parameters if not is_solver_setting(v) and _number(v.start) is not None]
    fixed = {started(v, description) for v in parameters}
    states = [description.variables[name] for name in description.states]
    return parameters + [v for v in states if v.settable and v.type == "Real" and v.name not in fixed]


def is_solver_setting(variable: Variable) -> bool:
    """Return whether a parameter belongs to a tool's solver."""
    return _SOLVER.search(variable.name) is not None


@dataclass(frozen=True, eq=False)
class _Changes:
    """Jacobian (n, N) by relative changes, in spreads of the outputs.

    `weights` (n,) are spreads in σ of the noise. `first` (m,), `first_changes` (m, N) and `first_limits` (m,) are
    differences of first samples, measured less simulated, their changes and their limits.
    """

    variables: tuple[Variable, ...]
    starts: Floats
    jacobian: Floats
    weights: Floats
    first: Floats
    first_changes: Floats
    first_limits: Floats
    sizes: tuple[tuple[str, str, float], ...]


def _changes(
    system: System,
    experiments: Sequence[Experiment],
    description: Description,
    names: Sequence[str],
    moved_starts: Mapping[int, float],
) -> _Changes:
    variables = tuple(description.variables[name] for name in names)
    starts = np.array([moved_starts.get(k, _number(v.start) or 0.0) for k, v in enumerate(variables)])
    thetas, count = _moved(variables, starts), len(variables)
    relative = SETTINGS.step * np.sign(np.diag(thetas[1:] - starts))
    halves = starts + 0.5 * (thetas[1:] - starts)
    rows, weights, first, changed, limits, sizes = [], [], [], [], [], []
    for experiment in experiments:
        found = simulator_of(system, experiment, names).many(np.vstack([thetas, halves]))
        if found.errors[0] is not None:
            raise found.errors[0]
        base, whole, half = found.outputs[0], found.outputs[1 : count + 1], found.outputs[count + 1 :]
        moved = base + 4.0 * (half - base) - (whole - base)  # by Richardson: parameters that act alike do so to 1e-6
        direct = direct_effects(system, experiment) if experiment.kind == "time" else ()
        for j in range(base.shape[1]):
            spread = _spread(experiment, j)
            counted = experiment.counted[:, j]
            rows.append((moved[:, counted, j] - base[counted, j]).T / (relative * spread))
            size = float(np.std(base[counted, j])) / spread
            if size > SETTINGS.unit_ratio or 0.0 < size < 1 / SETTINGS.unit_ratio:
                sizes.append((experiment.source, experiment.columns[experiment.output_names[j]], size))
            noise = max(_noise(experiment, j) / spread, SETTINGS.min_noise)
            weights.append(np.full(int(counted.sum()), 1.0 / noise))
            measured = experiment.output_values[0, j]
            if experiment.kind == "time" and np.isfinite(measured):
                first.append((measured - base[0, j]) / spread)
                changed.append((moved[:, 0, j] - base[0, j]) / (relative * spread))
                limits.append(max(SETTINGS.starts_off * noise, SETTINGS.starts_floor) + direct[j] / spread)
    shape = (len(first), len(names))
    jacobian, weight = np.vstack(rows), np.concatenate(weights)
    told = np.array(first), np.array(changed).reshape(shape), np.array(limits)
    return _Changes(variables, starts, jacobian, weight, *told, tuple(sizes))


def _moved(variables: Sequence[Variable], starts: Floats) -> Floats:
    """Return starts (1 + N, N): unchanged, and each moved by its step."""
    return np.vstack([starts, starts + np.diag([_step(v, start) for v, start in zip(variables, starts, strict=True)])])


def _proposed(
    changes: _Changes, begun: Sequence[int], freed: Mapping[int, float], *, driven: bool
) -> tuple[Candidate, ...]:
    variables, jacobian = changes.variables, changes.jacobian
    finite = [bool(np.isfinite(column).all()) for column in jacobian.T]
    columns = np.where(finite, jacobian, 0.0) / math.sqrt(max(len(jacobian), 1))
    effects = np.sqrt(np.sum(columns**2, axis=0))
    starts = changes.starts.tolist()
    uses: list[ParameterProposal | None] = [None] * len(variables)
    for k in range(len(variables)):
        if not finite[k]:
            uses[k] = ParameterProposal.FAILS
        elif effects[k] == 0:
            uses[k] = ParameterProposal.NO_EFFECT
        elif starts[k] == 0:
            uses[k] = ParameterProposal.ZERO
    for k in begun:
        if uses[k] in (None, ParameterProposal.ZERO):
            agrees = ParameterProposal.START if changes.first_changes[:, k].any() else ParameterProposal.START_HIDDEN
            uses[k] = ParameterProposal.START_FREED if k in freed else agrees if driven else None
    weighted = np.where(finite, jacobian, 0.0) * changes.weights[:, None]
    likes = _select(columns, effects, uses, list(freed), weighted)
    # a study without free parameters cannot be identified
    for last in (ParameterProposal.ZERO, *KEPT_STARTS):
        if not any(use in FREE for use in uses):
            uses = [None if use is last else use for use in uses]
            likes = _select(columns, effects, uses, [], weighted)
    for k in begun:
        uses[k] = ParameterProposal.START_OPEN if uses[k] is ParameterProposal.FREED else uses[k]
    alike = [tuple(variables[i].name for i in like) for like in likes]
    found = [
        Candidate(v, uses[k] or ParameterProposal.ENOUGH, starts[k], SHOWN_CHANGE * float(effects[k]), alike[k])
        for k, v in enumerate(variables)
    ]
    return tuple(sorted(found, key=lambda each: (each.use not in FREE, -each.effect)))


def _freed_starts(changes: _Changes, which: Sequence[int]) -> dict[int, float]:
    """Return the start values that first samples contradict, with their new values."""
    if not which or not (np.abs(changes.first) > changes.first_limits).any():
        return {}
    effects = changes.first_changes[:, which]
    moves: Floats = np.asarray(np.linalg.lstsq(np.nan_to_num(effects), changes.first)[0])
    found = {}
    for k, effect, move in zip(which, effects.T, moves.tolist(), strict=True):
        if (np.abs(effect * move) > changes.first_limits).any():
            start = float(changes.starts[k])
            found[k] = float(f"{start + move * abs(_step(changes.variables[k], start)) / SETTINGS.step:.4g}")
    return found


def _select(
    columns: Floats, effects: Floats, uses: list[ParameterProposal | None], first: Sequence[int], weighted: Floats
) -> list[list[int]]:
    """Decide on open parameters; return the freed ones that each acts like."""
    likes: list[list[int]] = [[] for _ in uses]
    r: Floats = np.asarray(np.linalg.qr(columns, mode="r"))
    own: Floats = np.asarray(np.linalg.qr(weighted, mode="r"))
    rest, chosen = r.copy(), list(first)
    for k in chosen:
        _project_out(rest, k)
    while (open_ := [k for k, use in enumerate(uses) if use is None]) and len(chosen) < SETTINGS.max_free:
        left = np.sqrt(np.sum(rest[:, open_] ** 2, axis=0))
        k = open_[int(np.argmax(left))]
        if np.linalg.norm(own[:, k]) < 1.0:
            uses[k] = ParameterProposal.NOISE  # σ would exceed the magnitude
        elif left.max() < SETTINGS.min_own_effect * effects[k]:
            uses[k] = ParameterProposal.ALIKE
            shares = np.abs(np.linalg.lstsq(r[:, chosen], r[:, k])[0]) * effects[chosen]
            likes[k] = [i for i, share in zip(chosen, shares, strict=True) if share > 0.1 * shares.max()]
        elif np.linalg.norm(_left(own, chosen, k)) < 1.0:
            uses[k] = ParameterProposal.NOISE
        else:
            uses[k] = ParameterProposal.FREED
            chosen.append(k)
            _project_out(rest, k)
    return likes


def _left(columns: Floats, chosen: Sequence[int], k: int) -> Floats:
    """Return the part of a column that others do not explain."""
    if not chosen:
        return columns[:, k]
    return np.asarray(columns[:, k] - columns[:, chosen] @ np.linalg.lstsq(columns[:, chosen], columns[:, k])[0])


def _project_out(rest: Floats, k: int) -> None:
    """Subtract from all columns their part along one."""
    size = float(np.linalg.norm(rest[:, k]))
    if size > 0:
        along = rest[:, k] / size
        rest -= np.outer(along, along @ rest)


def _number(start: object) -> float | None:
    return float(start) if isinstance(start, int | float) and not isinstance(start, bool) else None


def _step(variable: Variable, start: float) -> float:
    """Return the step of a parameter, away from its bound."""
    size = SETTINGS.step * (abs(start) or abs(variable.nominal or 1.0))
    return -size if variable.max is not None and start + size > variable.max else size


def _spread(experiment: Experiment, j: int) -> float:
    """Return the standard deviation of an output, its size if constant."""
    values = experiment.output_values[experiment.counted[:, j], j]
    return float(np.std(values) or np.abs(values).max() or 1.0)


def _noise(experiment: Experiment, j: int) -> float:
    """Return the noise level of an output, from second differences."""
    values = experiment.output_values[:, j]
    second = np.diff(values[np.isfinite(values)], 2)
    return float(np.median(np.abs(second)) / (0.6745 * math.sqrt(6.0))) if second.size else 0.0


def bounds(given: Candidate) -> dict[str, float]:
    """Return the FMU's bounds, else the sign of a signed quantity."""
    variable, start = given.variable, given.start
    found = declared_bounds(variable, start)
    signed = (variable.unit or "") in _SIGNED or _PLACE.search(f"{variable.name} {variable.description}")
    if found or signed or given.use in STARTS or not start:
        return found
    return {"min": 0.0} if start > 0 else {"max": 0.0}
