"""Masters in plain Python: slow and short, to compare fmuid's compiled loops with.

They call an FMU through FMPy's thin wrappers, one FMI function at a time. A model-exchange FMU is integrated by scipy
(DOP853 for all but stiff models, Radau for those); events are found by bisection on scipy's dense output. Nothing here
is shared with fmuid but the reading of the model description.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853, Radau

import fmuid
from fmuid.array_types import Floats

RELATIVE = 1e-11
"""Relative tolerance of the reference; the absolute one is a hundredth of it times the nominal values."""
MOST_EVALUATIONS = 400_000
MOST_EVENTS = 10_000


class TooManyEvaluationsError(RuntimeError):
    """An explicit method takes too many steps: the model is stiff."""


class Reference(NamedTuple):
    """Outputs (K, n) at the times of a table, and when events happened, s."""

    outputs: Floats
    events: list[float]


class _Forgiving:
    """A library that has every function that one asks for, if only to report an error."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        try:
            return getattr(self._library, name)
        except AttributeError:
            return ctypes.CFUNCTYPE(ctypes.c_int)(lambda: 3)


class Plain:
    """One instance of an FMU under FMPy, FMI 2.0 or 3.0, with the differences of the two hidden."""

    def __init__(self, fmu: fmuid.FMU, kind: str) -> None:
        from fmpy import fmi2, fmi3

        self.description = fmu.description
        self.two = fmu.description.major_version == 2
        self.exchange = kind == "model-exchange"

        class FMU2Forgiving(fmi2.FMU2Slave):  # type: ignore[misc]
            """A co-simulation FMU whose binary may lack functions that are not called here."""

            def _loadFunctions(self) -> None:
                library: Any = self.dll
                self.dll: Any = _Forgiving(library)
                super()._loadFunctions()
                self.dll = library

        classes: dict[tuple[bool, bool], Any] = {
            (True, True): fmi2.FMU2Model,
            (True, False): FMU2Forgiving,
            (False, True): fmi3.FMU3Model,
            (False, False): fmi3.FMU3Slave,
        }
        identifier = fmu.description.interfaces[kind].identifier
        folder = os.getcwd()  # noqa: PTH109  # FMPy changes it
        self.fmu = classes[self.two, self.exchange](
            guid=fmu.description.guid,
            unzipDirectory=str(fmu.directory),
            modelIdentifier=identifier,
            instanceName="reference",
            libraryPath=str(fmu.library(identifier)),
            requireFunctions=False,
        )
        os.chdir(folder)
        self.event_mode = not self.two and not self.exchange and fmu.description.interfaces[kind].event_mode
        if self.event_mode:
            self.fmu.instantiate(eventModeUsed=True, earlyReturnAllowed=True)
        else:
            self.fmu.instantiate()
        self.next_event = np.inf

    def initialise(self, time: float, inputs: Mapping[str, float]) -> None:
        """Go through Initialization Mode with the inputs set; a model-exchange FMU then is in Event Mode."""
        if self.two:
            self.fmu.setupExperiment(startTime=time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time)
        self.set(inputs)
        self.fmu.exitInitializationMode()

    def set(self, values: Mapping[str, float]) -> None:
        """Set variables; the elements of an array (FMI 3.0) that are not given keep their values."""
        arrays: dict[int, dict[str, float]] = {}
        for name, value in values.items():
            variable = self.description.variables[name]
            if variable.array:
                arrays.setdefault(variable.reference, {})[name] = value
                continue
            given = {"Real": float, "Integer": int, "Boolean": bool}[variable.type](value)
            setter = f"set{variable.type if self.two else variable.wire}"
            getattr(self.fmu, setter)([variable.reference], [given])
        for reference, elements in arrays.items():
            names = self.description.variables[next(iter(elements))].array
            whole = self.fmu.getFloat64([reference], nValues=len(names))
            self.fmu.setFloat64([reference], [elements.get(name, old) for name, old in zip(names, whole, strict=True)])

    def get(self, names: Sequence[str]) -> Floats:
        """Get variables, as numbers."""
        found = []
        for name in names:
            variable = self.description.variables[name]
            if self.two:
                found.append(getattr(self.fmu, f"get{variable.type}")([variable.reference])[0])
            else:
                count = max(len(variable.array), 1)
                values = getattr(self.fmu, f"get{variable.wire}")([variable.reference], nValues=count)
                found.append(values[variable.array.index(name) if variable.array else 0])
        return np.array(found, np.float64)

    def step(self, time: float, end: float) -> None:
        """Step a co-simulation FMU from a time to another, with the events that it reports on its way."""
        if self.two:
            self.fmu.doStep(time, end - time)
            return
        while time < end - 1e-9 * (end - time):
            event, terminate, early, reached = self.fmu.doStep(time, end - time)
            if terminate:
                raise RuntimeError(f"the FMU ends the simulation at {reached}")
            time = reached if early else end
            if event:
                self.fmu.enterEventMode()
                self.update()

    def update(self) -> None:
        """Iterate the discrete states, from Event Mode on, and leave it."""
        for _ in range(1000):
            if self.two:
                needed, terminate, _, _, defined, event = self.fmu.newDiscreteStates()
            else:
                needed, terminate, _, _, defined, event = self.fmu.updateDiscreteStates()
            if terminate:
                raise RuntimeError("the FMU ends the simulation")
            if not needed:
                break
        else:
            raise RuntimeError("the event iteration does not end")
        self.next_event = event if defined else np.inf
        if self.exchange:
            self.fmu.enterContinuousTimeMode()
        else:
            self.fmu.enterStepMode()

    def completed(self) -> bool:
        """Report an accepted step; return whether the FMU wants an event."""
        wanted, terminate = self.fmu.completedIntegratorStep()
        if terminate:
            raise RuntimeError("the FMU ends the simulation")
        return bool(wanted)

    def vector(self, function: str, size: int) -> Floats:
        """Call a function that fills an array of doubles."""
        values = np.zeros(size)
        if size:
            getattr(self.fmu, function)(_pointer(values), size)
        return values

    def place(self, time: float, states: Floats) -> None:
        """Set time and continuous states."""
        self.fmu.setTime(time)
        if states.size:
            self.fmu.setContinuousStates(_pointer(np.ascontiguousarray(states)), states.size)

    @property
    def derivatives(self) -> str:
        """FMPy's name of the function that gives the derivatives of the states."""
        return "getDerivatives" if self.two else "getContinuousStateDerivatives"


def _pointer(values: Floats) -> Any:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def co_simulation(fmu: fmuid.FMU, times: Floats, inputs: Mapping[str, Floats], names: Sequence[str]) -> Reference:
    """Step a co-simulation FMU from sample to sample, its inputs held in between.

    The outputs of a sample are those with its inputs already set; where the FMU has an Event Mode, a change of its
    inputs is an event.
    """
    plain = Plain(fmu, "co-simulation")
    plain.initialise(times[0], {name: column[0] for name, column in inputs.items()})
    if plain.event_mode:
        plain.update()
    rows = [plain.get(names)]
    for k in range(1, len(times)):
        plain.step(times[k - 1], times[k])
        jump = plain.event_mode and any(column[k] != column[k - 1] for column in inputs.values())
        if jump:
            plain.fmu.enterEventMode()
        plain.set({name: column[k] for name, column in inputs.items()})
        if jump:
            plain.update()
        rows.append(plain.get(names))
    return Reference(np.array(rows), [])


class _Exchange:
    """A model-exchange simulation on its way: the FMU, and the inputs' straight lines in one interval."""

    def __init__(self, fmu: fmuid.FMU, times: Floats, inputs: Mapping[str, Floats]) -> None:
        self.plain = Plain(fmu, "model-exchange")
        variables = fmu.description.variables
        self.times = times
        self.inputs = {name: column for name, column in inputs.items() if variables[name].continuous}
        self.held = {name: column for name, column in inputs.items() if name not in self.inputs}
        self.interval, self.evaluations = 0, 0
        self.events: list[float] = []
        self.n_states = len(fmu.description.derivatives)
        self.n_indicators = fmu.description.indicators
        self.plain.initialise(times[0], {name: column[0] for name, column in inputs.items()})
        self.plain.update()
        self.states = self.plain.vector("getContinuousStates", self.n_states)
        nominals = self.plain.vector("getNominalsOfContinuousStates", self.n_states)
        self.nominals = np.where(nominals > 0, nominals, 1.0)  # some FMUs give zeros, against the standard

    def place(self, time: float, states: Floats) -> None:
        """Put the FMU at a time, with states and inputs as of then."""
        self.plain.place(time, states[: self.n_states])
        if not self.inputs:
            return
        k = min(self.interval, len(self.times) - 2)
        share = (time - self.times[k]) / (self.times[k + 1] - self.times[k])
        self.plain.set({name: (1 - share) * c[k] + share * c[k + 1] for name, c in self.inputs.items()})

    def right_hand_side(self, time: float, states: Floats) -> Floats:
        """Return the derivatives of the states (a model without states gets one that rests: scipy wants one)."""
        self.evaluations += 1
        if self.evaluations > MOST_EVALUATIONS:
            raise TooManyEvaluationsError(f"the reference needs more than {MOST_EVALUATIONS} evaluations")
        self.place(time, states)
        return self.plain.vector(self.plain.derivatives, self.n_states) if self.n_states else np.zeros(1)

    def begin(self, interval: int) -> None:
        """Enter an interval between two samples: inputs that are held change, which is an event."""
        fresh = {name: c[interval] for name, c in self.held.items() if c[interval] != c[self.interval]}
        self.interval = interval
        if fresh:
            self.plain.fmu.enterEventMode()
            self.plain.set(fresh)
            self.plain.update()
            self.states = self.plain.vector("getContinuousStates", self.n_states)

    def positive(self, time: float, states: Floats) -> NDArray[np.bool_]:
        """Tell which event indicators are above zero."""
        self.place(time, states)
        return self.plain.vector("getEventIndicators", self.n_indicators) > 0

    def steps(self, time: float, bound: float, method: Any) -> Iterator[tuple[float, float, Any, bool]]:
        """Integrate on to a bound: yield (start, end, dense output, whether an indicator changes at the end)."""
        if time >= bound:
            return
        start = self.states if self.n_states else np.zeros(1)
        scale = self.nominals if self.n_states else np.ones(1)
        longest = float(self.times[1] - self.times[0]) if self.n_indicators else np.inf
        before = self.positive(time, start)
        solver = method(
            self.right_hand_side, time, start, bound, rtol=RELATIVE, atol=1e-2 * RELATIVE * scale, max_step=longest
        )
        while solver.status == "running":
            message = solver.step()
            if solver.status == "failed":
                raise RuntimeError(f"scipy cannot integrate on: {message}")
            dense = solver.dense_output()
            crossed = bool((self.positive(solver.t, solver.y) != before).any())
            end = self.locate(dense, before, solver.t_old, solver.t) if crossed else float(solver.t)
            yield float(solver.t_old), end, dense, crossed

    def event(self, time: float) -> None:
        """Handle an event at a time."""
        self.events.append(time)
        if len(self.events) > MOST_EVENTS:
            raise RuntimeError(f"more than {MOST_EVENTS} events before {time} s")
        self.place(time, self.states)
        self.plain.fmu.enterEventMode()
        self.plain.update()
        self.states = self.plain.vector("getContinuousStates", self.n_states)

    def locate(self, dense: Any, before: NDArray[np.bool_], low: float, high: float) -> float:
        """Return the time just after the first change of an indicator in a step."""
        while high - low > 2e-15 * max(abs(high), 1e-3):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            if (self.positive(middle, dense(middle)) != before).any():
                high = middle
            else:
                low = middle
        return high


def model_exchange(
    fmu: fmuid.FMU, times: Floats, inputs: Mapping[str, Floats], names: Sequence[str], stiff: bool = False
) -> Reference:
    """Integrate a model-exchange FMU with scipy, its continuous inputs linear between samples, the others held."""
    run = _Exchange(fmu, times, inputs)
    outputs = np.full((len(times), len(names)), np.nan)
    outputs[0] = run.plain.get(names)
    time, k = float(times[0]), 1  # k: the next sample to be written
    while k < len(times):
        bound = min(float(times[k]) if inputs else float(times[-1]), run.plain.next_event)
        event = time >= bound
        for begin, end, dense, event in run.steps(time, bound, Radau if stiff else DOP853):
            while k < len(times) and begin <= times[k] < end:
                run.place(times[k], dense(times[k]))
                outputs[k] = run.plain.get(names)
                k += 1
            time = end
            run.states = dense(end)
            run.place(time, run.states)
            if run.plain.completed() or event:
                event = True
                break
        if event or time >= run.plain.next_event:
            run.event(time)
        while k < len(times) and times[k] <= time:
            run.begin(k)
            run.place(time, run.states)
            outputs[k] = run.plain.get(names)
            k += 1
    return Reference(outputs, run.events)
