"""Frequency responses of a model about an operating point."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import DECIBEL, DEGREE, FrequencyExperiment, Response
from fmuid.errors import InputError
from fmuid.formatting import nearest
from fmuid.models import Phasors, System
from fmuid.simulation.point_model import PointModel
from fmuid.simulation.point_simulator import PointSimulator
from fmuid.simulation.steady_simulator import REASONS, unit_factor
from fmuid.simulation.steady_state import SteadyIssue, find_steady_states, is_at_rest
from fmuid.units import parse_unit


class FrequencySimulator(PointSimulator):
    """Parts of complex responses, from the linear model about an operating point.

    The steady state begins at the initial states; an event there is sought at the first theta.
    """

    experiment: FrequencyExperiment

    def _prepare(self) -> None:
        experiment = self.experiment
        excited = {name: self._excited(name, each) for name, each in experiment.responses.items()}
        self.seeds = tuple(dict.fromkeys(excited.values()))
        ratios = {name: each.signals for name, each in experiment.responses.items()}
        named = dict.fromkeys(name for each in ratios.values() for name in each if name)
        self.signals = [name for name in named if not self._is_input(name)]
        self._excitations, self._is_checked = excited, False
        _ = self._points, self.angular

    def _is_input(self, name: str) -> bool:
        return self.system.variable(name, "signal").causality == "input"

    def _excited(self, name: str, response: Response) -> str:
        inputs = [each for each in response.signals if each and self._is_input(each)]
        found = response.excited or next(iter(inputs), "")
        where = f"{self.experiment.source}: responses.{name}"
        if not found:
            raise InputError(f"{where}: no input in {response.of!r}. Set excited to the input that is varied.")
        if not self._is_input(found):
            raise InputError(f"{where}: {found!r} is no input. Set excited to an input.")
        for other in (each for each in inputs if each != found):
            raise InputError(f"{where}: the input {other!r} is not excited. Give one excited input.")
        return found

    @cached_property
    def angular(self) -> Floats:
        """Angular frequencies (K,), rad/s."""
        (values,), unit = self.experiment.input_values.T, parse_unit(self.experiment.units.get("frequency", "Hz"))
        for name, factor in (("Hz", 2.0 * np.pi), ("rad/s", 1.0)):
            own = parse_unit(name)
            if unit is not None and own is not None and unit.exponents == own.exponents:
                found = values * (factor * unit.factor / own.factor)
                if (found <= 0.0).any():
                    raise InputError(f"{self.experiment.source}: frequency must be above 0 in every row.")
                return np.asarray(found)
        raise InputError(f"{self.experiment.source}: frequency must be in Hz or rad/s. Correct its unit.")

    @cached_property
    def _points(self) -> PointModel:
        inputs = {name: np.array([float(value)]) for name, value in self.experiment.point.items()}
        for name in inputs:
            if not self._is_input(name):
                near = nearest(name, [v.name for v in self.system.variables.values() if v.causality == "input"])
                raise InputError(f"{self.experiment.source}: point: {name!r} is no input{near}.")
        for name in (each for each in self.seeds if each not in inputs):
            start = self.system.variable(name).start
            inputs[name] = np.array([float(start) if isinstance(start, int | float) else 0.0])
        return self.points(inputs, self.seeds, self.signals, 'kind = "frequency"')

    def _compute(self, thetas: Floats) -> tuple[Floats, list[str]]:
        """Return outputs (m, K, n_outputs) of all frequencies, and reasons of failures."""
        points, reasons = self._points, [""] * len(thetas)
        initial = points.initial(thetas)
        starts = np.zeros((len(thetas), len(points.states))) if initial is None else initial
        models = points.at(starts[:1], thetas)
        scale = np.maximum(np.abs(starts[:1]), points.nominals)
        rest = starts[:1]
        if not ((starts == starts[0]).all() and is_at_rest(models, scale).all()):
            found = find_steady_states(points, thetas, starts[:, None])
            rest, models = found.states[0], found.models
            wrong = f"operating point: {REASONS[SteadyIssue.NONE]}"
            reasons = ["" if each else wrong for each in found.found[:, 0]]
        if not self._is_checked and not reasons[0]:
            reasons[0] = "an event at the operating point. Change point" if points.events(rest, thetas[0]).any() else ""
            self._is_checked = not reasons[0]
        return self._outputs(*(getattr(models, name)[:, 0] for name in "abcd")), reasons

    def _outputs(self, a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
        """Return the outputs (m, K, n_outputs) of linear models (m, n, n)."""
        one = 1j * self.angular[:, None, None] * np.eye(a.shape[1])
        states = np.linalg.solve(one - a[:, None], b[:, None] + 0.0 * one[:, :, :1])
        transfer = np.asarray(c[:, None] @ states + d[:, None], dtype=np.complex128)
        found = np.empty((len(a), len(self.angular), len(self.output_names)))
        for name, response in self.experiment.responses.items():
            column = self.seeds.index(self._excitations[name])
            above, below = (self._signal(each, transfer[..., column]) for each in response.signals)
            values = response.sign * above / below * np.exp(-1j * self.angular * response.delay)
            values = np.conj(values) if response.conjugate else values
            for part in response.columns:
                output = self.output_names.index(f"{name}.{part}")
                found[..., output] = self._part(self.output_names[output], values)
        return found

    def _signal(self, name: str, transfer: Phasors) -> Phasors | float:
        """Return the response (m, K) of a signal to the excited input; 1 of that input, and of none."""
        return transfer[..., self.signals.index(name)] if name in self.signals else 1.0

    def _part(self, output: str, values: Phasors) -> Floats:
        """Return a part (m, K), phases near the measured ones."""
        _, _, part = self.experiment.part(output)
        if part == "decibel":
            return np.asarray(np.log(np.abs(values)) / DECIBEL)
        if part == "phase":
            measured = self.experiment.output_values[:, self.output_names.index(output)]
            found = np.angle(values) / DEGREE
            return np.asarray(found + np.nan_to_num(360.0 * np.round((measured - found) / 360.0)))
        made = {"real": values.real, "imaginary": values.imag, "magnitude": np.abs(values)}[part]
        own, unit = response_unit(self.system, self.experiment, output), self.experiment.units.get(output)
        return made * (unit_factor(own, unit, f"{self.experiment.source}: {output}") if own and unit else 1.0)


def response_unit(system: System, experiment: FrequencyExperiment, output: str) -> str | None:
    """Return the unit of a part of a response in the model; None if unknown."""
    _, response, part = experiment.part(output)
    if part in ("phase", "decibel"):
        return {"phase": "deg", "decibel": "dB"}[part]
    above, below = (each or response.excited or "" for each in response.signals)
    units = [system.unit(each) for each in (above, below)]
    return f"{units[0]}/({units[1]})" if all(units) else None
