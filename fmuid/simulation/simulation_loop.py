"""Plan and grid bound to instances: memory and call of the core."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_char_p, c_void_p, cast
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmuid.array_types import Floats, Indices
from fmuid.models import Description
from fmuid.simulation import codes
from fmuid.simulation.codes import function_name
from fmuid.simulation.instance import Instance
from fmuid.simulation.native.library import COPY_ONE, GET_REALS, GET_SENSITIVITIES, OTHER, SET_REALS, SET_SLOPES, core
from fmuid.simulation.simulation_plan import Operation, SimulationPlan, TimeGrid, check_arrays, check_plan
from fmuid.simulation.solver import REQUIRED, IntegratedModel, Integrator, address, function_table


class SimulationLoop:
    """A plan bound to one instance per component; owner of the core's memory.

    `used` (n_components,) marks instances to be reset before their next simulation.
    """

    def __init__(self, plan: SimulationPlan, grid: TimeGrid, instances: Sequence[Instance], used: Indices) -> None:
        check_plan(plan, grid, [instance.version for instance in instances])
        self._core = core()
        self._plan_given, self._grid_given, self._instances = plan, grid, instances
        self._cancel = ctypes.c_int32(0)
        self._kept: list[Any] = [used]
        self._tables = [function_table(each.version, _functions(each)) for each in instances]
        self._integrators: list[Integrator | None] = []
        for i in range(len(instances)):  # twins precede their model
            self._integrators.append(self._integrator(i, plan, grid))
        components = (self._component(i, plan, used) for i in range(len(instances)))
        self._components = (self._core.Component * len(instances))(*components)
        self._signals = plan.signals.copy()
        self._words = np.zeros(len(plan.signals) + 1, np.uint64)  # values of other types on their way
        self._last = np.zeros(len(plan.signals) + 1)
        texts = [c_char_p(text) for text in plan.texts]
        self._strings = np.array([cast(text, c_void_p).value for text in texts], np.intp)
        self._kept.append(texts)
        self._operations = (self._core.Operation * len(plan.operations))(*map(self._operation, plan.operations))
        self._plan = self._lay_out(plan, grid)
        strides = grid.strides if (grid.strides > 1).any() else None
        arrays = (grid.times, grid.inputs, grid.slopes, grid.substeps, strides, grid.gain, grid.measured)
        self._grid = self._core.Grid(len(grid.times), -1 if grid.states is None else grid.states, *map(address, arrays))
        self._bound = tuple(map(ctypes.byref, (self._plan, self._grid, self._cancel)))

    def run(self, thetas: Floats, outputs: Floats, reports: Indices) -> None:
        """Simulate thetas (m, N) into outputs (m, K, n_outputs) and reports."""
        check_arrays(self._plan_given, self._grid_given, thetas, outputs, reports)
        plan, grid, cancel = self._bound
        arrays = thetas.ctypes.data, outputs.ctypes.data, reports.ctypes.data
        self._core.simulate(plan, grid, len(thetas), *arrays, cancel)

    def cancel(self) -> None:
        """Let current and later simulations fail soon."""
        self._cancel.value = 1

    # --- what the core works on

    def _keep(self, memory: Any) -> int | None:
        self._kept.append(memory)
        return address(memory)

    def _lay_out(self, plan: SimulationPlan, grid: TimeGrid) -> Any:
        stages = [self._core.Range(*map(int, plan.stages[i : i + 2])) for i in range(len(plan.stages) - 1)]
        after_step = (self._core.Range * len(self._instances))(*stages[5:]) if plan.gauss_seidel else None
        groups = self._groups(plan)
        by_midpoint = bool((plan.inputs.modes == codes.BY_MIDPOINT).any())
        return self._core.Plan(
            n_components=len(self._instances),
            n_signals=len(plan.signals),
            n_parameters=len(plan.parameter_signals),
            n_inputs=len(plan.inputs.signals),
            n_outputs=len(plan.output_terms) - 1,
            n_groups=0 if groups is None else len(groups),
            components=address(self._components),
            operations=address(self._operations),
            **dict(zip(("start_values", "inputs", "exchange", "outputs", "slopes"), stages, strict=False)),
            after_step=self._keep(after_step),
            groups=self._keep(groups),
            signals=address(self._signals),
            start_signals=address(plan.signals),
            parameter_signals=address(plan.parameter_signals),
            input_signals=address(plan.inputs.signals),
            slope_signals=address(plan.inputs.slopes),
            output_signals=address(plan.output_signals),
            output_terms=address(plan.output_terms),
            input_modes=address(plan.inputs.modes),
            curves=self._curves(plan),
            # where inputs go by midpoints, those that are held must be among the signals
            direct_inputs=None if by_midpoint else self._direct(plan, 1, codes.FLOAT64, plan.inputs.signals),
            direct_outputs=self._direct(plan, 3, codes.N_WIRES + codes.FLOAT64, plan.output_signals),
            ones=self._keep(np.ones(len(plan.references) + 1, np.int32)),
            curved=grid.slopes is not None,
            midpoints=by_midpoint,
            by_rows=self._goes_by_rows(plan, grid),
        )

    def _component(self, number: int, plan: SimulationPlan, used: Indices) -> Any:
        instance, table, integrator = self._instances[number], self._tables[number], self._integrators[number]
        if instance.version == 3 and instance.event_mode:
            for name in ("EnterEventMode", "UpdateDiscreteStates", "EnterStepMode"):
                instance.required(name)
        return self._core.Component(
            instance=instance.handle,
            integrator=integrator and integrator.handle,
            tolerance=plan.tolerances[number],
            used=used.ctypes.data + 8 * number,
            event_mode=instance.event_mode,
            **{f"fmi{instance.version}": address(table)},
        )

    def _integrator(self, number: int, plan: SimulationPlan, grid: TimeGrid) -> Integrator | None:
        instance, integration = self._instances[number], plan.integrations[number]
        if integration is None:
            return None
        for code in REQUIRED:
            instance.required(function_name(instance.version, code) or "")
        description = instance.fmu.description
        wanted = integration.sensitivities.twins if integration.sensitivities else ()
        model = IntegratedModel(
            instance.version,
            instance.handle,
            self._tables[number],
            len(description.derivatives),
            description.indicators,
            _references(description, description.states),
            _references(description, description.derivatives),
        )
        return Integrator(
            model,
            integration,
            limit=float(grid.times[-1]) if integration.autonomous else -np.inf,
            straight=grid.slopes is None,
            twins=[twin for twin in (self._integrators[i] for i in wanted) if twin is not None],
        )

    def _operation(self, given: Operation) -> Any:
        if given.function == codes.COPY:
            factor, offset = self._plan_given.conversions[given.n_references]
            return self._core.Operation(
                kind=COPY_ONE, signal=given.signal, source=given.reference, factor=factor, offset=offset
            )
        instance = self._instances[given.component]
        name = function_name(instance.version, given.function)
        if given.function != codes.SENSITIVITIES and name is not None:
            instance.required(name)
        memory = {codes.FLOAT64: self._signals, codes.STRING: self._strings}.get(given.wire, self._words)
        return self._core.Operation(
            kind=_kind(given, instance.version),
            function=given.function,
            component=given.component,
            wire=given.wire,
            when=given.when,
            count=given.n_references,
            references=self._plan_given.references.ctypes.data + 4 * given.reference,
            signal=given.signal,
            n_values=given.n_values,
            values=memory.ctypes.data + 8 * given.signal,
            last=self._last.ctypes.data + 8 * given.signal,
            instance=instance.handle,
            fmi2=address(self._tables[given.component]) if instance.version == 2 else None,
        )

    def _groups(self, plan: SimulationPlan) -> Any:
        """Return the parts of the exchange; None if one pass suffices."""
        eventful = any(each.kind == "model-exchange" or each.version == 3 for each in self._instances)
        if not eventful and not plan.loops:
            return None
        loops = (self._core.Loop * len(plan.loops))()
        for made, loop in zip(loops, plan.loops, strict=True):
            n = len(loop.signals)
            vectors = ("unknowns", "residual", "correction", "starts", "magnitudes")
            work = np.zeros((len(vectors) + 2 * n) * n)
            made.get = self._core.Range(loop.first, loop.setting)
            made.set = self._core.Range(loop.setting, loop.last)
            made.n, made.signals = n, self._keep(np.array(loop.signals, np.int64))
            made.nominals = self._keep(np.array(loop.nominals, np.float64))
            at = work.ctypes.data
            for i, name in enumerate(vectors):
                setattr(made, name, at + 8 * n * i)
            made.matrix, made.inverse = at + 8 * n * len(vectors), at + 8 * n * (len(vectors) + n)
            self._kept.append(work)
        groups = (self._core.Group * len(plan.groups))()
        for group, (first, last) in zip(groups, plan.groups.tolist(), strict=True):
            if first >= 0:
                group.range = self._core.Range(first, last)
            else:
                group.loop = address(loops[last])
        self._kept.append(loops)
        return groups

    def _curves(self, plan: SimulationPlan) -> int | None:
        own = np.zeros((len(plan.inputs.signals) + 1, 4))
        self._kept.append(own)
        found = []
        for mine, (component, row) in zip(own, plan.inputs.curves, strict=False):
            integrator = self._integrators[component] if component >= 0 else None
            found.append((mine if integrator is None else integrator.curves[row]).ctypes.data)
        return self._keep(np.array(found, np.intp))

    def _direct(self, plan: SimulationPlan, stage: int, function: int, signals: Indices) -> Any:
        """Return the one operation for a whole row of data, if any."""
        first, last = map(int, plan.stages[stage : stage + 2])
        if last != first + 1:
            return None
        given = plan.operations[first]
        summed = stage == 3 and len(signals) != len(plan.output_terms) - 1
        in_order = not summed and np.array_equal(signals, given.signal + np.arange(given.n_values))
        if not in_order or given.function != function or given.when != codes.ALWAYS:
            return None
        return address(self._operations[first])

    def _goes_by_rows(self, plan: SimulationPlan, grid: TimeGrid) -> bool:
        """Return whether a single FMU only takes and gives whole rows."""
        exchange, outputs, slopes, slopes_end = plan.stages[2:6].tolist()
        sloped = [plan.operations[i].signal + np.arange(plan.operations[i].n_values) for i in range(slopes, slopes_end)]
        if sloped:
            in_order = len(sloped) == 1 and np.array_equal(sloped[0], plan.inputs.slopes)
            uniform = in_order and (plan.inputs.modes == codes.BY_DERIVATIVE).all()
        else:
            uniform = (plan.inputs.modes == codes.HELD).all()
        return bool(
            uniform
            and [each.version for each in self._instances] == [2]
            and plan.integrations[0] is None
            and exchange == outputs
            and grid.slopes is None
            and (grid.substeps == 1).all()
            and (grid.strides == 1).all()
            and self._direct(plan, 1, codes.FLOAT64, plan.inputs.signals)
            and self._direct(plan, 3, codes.N_WIRES + codes.FLOAT64, plan.output_signals)
        )


def _kind(given: Operation, version: int) -> int:
    if given.function == codes.SENSITIVITIES:
        return GET_SENSITIVITIES
    if given.function == codes.SET_DERIVATIVES:
        return SET_SLOPES
    if version == 2 and given.when == codes.ALWAYS and given.function == codes.FLOAT64:
        return SET_REALS
    if version == 2 and given.function == codes.N_WIRES + codes.FLOAT64:
        return GET_REALS
    return OTHER


def _functions(instance: Instance) -> Any:
    """Return addresses by function names, 0 for functions not to call."""
    interface = instance.fmu.description.interfaces[instance.kind]
    unused = {
        "CompletedIntegratorStep": instance.kind == "model-exchange" and not interface.completed_step,
        "GetDirectionalDerivative": not interface.directional_derivatives,
    }
    return lambda name: 0 if unused.get(name, False) else instance.address(name)


def _references(description: Description, names: Sequence[str]) -> NDArray[np.uint32]:
    """Return value references; none with arrays, which share one reference."""
    variables = [description.variables[name] for name in names]
    if any(variable.array for variable in variables):
        return np.zeros(0, np.uint32)
    return np.array([variable.reference for variable in variables], np.uint32)
