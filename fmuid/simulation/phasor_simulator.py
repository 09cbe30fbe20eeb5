"""Steady states of an AC machine: phasors of the model linearized at rest, in its own axes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import SteadyExperiment
from fmuid.errors import InputError
from fmuid.models import PHASOR_FORMULAS, OperatingPhasors, Phasors
from fmuid.simulation.point_model import PointModel, StateSpace
from fmuid.simulation.point_simulator import PointSimulator
from fmuid.simulation.steady_simulator import in_data_units, is_formula, terminals_of, unit_factor, values_of_formulas


@dataclass(frozen=True)
class PhasorSettings:
    """Numbers of the check of phasors."""

    linear: float = 1e-6  # largest relative error of the linear model at the amplitudes
    most_slip: float = 2.0  # braking at synchronous speed


SETTINGS = PhasorSettings()


class PhasorSimulator(PointSimulator):
    """Outputs of the operating points of an AC machine with symmetrical supply."""

    experiment: SteadyExperiment

    def _prepare(self) -> None:
        system, experiment = self.system, self.experiment
        assert experiment.supply is not None, "of such an experiment"
        found = terminals_of(system, experiment, ())
        assert found is not None, "refused without one"
        if experiment.guess:
            raise InputError(f"{experiment.source}: guess has no effect with frame. Remove it.")
        supplied = {*found.voltages, found.speed} & set(experiment.input_names)
        for name in sorted(each for each in supplied if each):
            raise InputError(f"{experiment.source}: frame gives the input {name!r}. Remove it from inputs.")
        self.terminals, self.pole_pairs = found, experiment.supply.pole_pairs
        for name in self.output_names:
            if not is_formula(system, name):
                known = ", ".join(PHASOR_FORMULAS)
                raise InputError(f"{experiment.source}: with frame, outputs are {known}, not {name!r}.")
            if PHASOR_FORMULAS[name].needs_torque:
                for key, place, there in (
                    ("pole_pairs", "frame", self.pole_pairs),
                    ("resistance", "the terminals beside the FMU", found.resistance),
                ):
                    if not there:
                        raise InputError(f"{experiment.source}: {name!r} needs {key}. Set it in {place}.")
        self._is_checked = False
        _ = self._points

    def _column(self, name: str, unit: str, default: str = "") -> Floats | None:
        """Return a quantity (K,) of the supply in a unit; None where it is not given."""
        if name not in self.experiment.input_names:
            return None
        values = self.experiment.input_values[:, self.experiment.input_names.index(name)]
        given = self.experiment.units.get(name, default or unit)
        return values * unit_factor(given, unit, f"{self.experiment.source}: frame: {name}")

    @cached_property
    def supply(self) -> tuple[Floats, Floats, Floats]:
        """Phase voltage, V rms, angular frequency, rad/s, and slip (K,)."""
        voltage, frequency, slip = (
            self._column("voltage", "V"),
            self._column("frequency", "Hz"),
            self._column("slip", ""),
        )
        if voltage is None:
            line = self._column("line_voltage", "V")
            assert line is not None, "one of the two is given"
            voltage = line / np.sqrt(3.0)
        assert frequency is not None, "it is required"
        angular = 2.0 * np.pi * frequency
        where = f"{self.experiment.source}: frame"
        for name, values, unit in (("frequency", angular, "Hz"), ("voltage", voltage, "V")):
            if (values <= 0.0).any():
                row = int(np.argmax(values <= 0.0)) + 1
                raise InputError(f"{where}: {name} must be above 0 {unit} in every row, not as in row {row}.")
        if slip is None:
            speed = self._column("speed", "rad/s", "rpm")
            assert speed is not None and self.pole_pairs is not None, "checked by the frame"
            slip = 1.0 - self.pole_pairs * speed / angular
        if (far := np.abs(slip) > SETTINGS.most_slip).any():
            row = int(far.argmax())
            raise InputError(
                f"{where}: slip {slip[row]:.3g} in row {row + 1} is no fraction. Check units and pole_pairs."
            )
        return voltage, angular, slip

    @cached_property
    def frequencies(self) -> Floats:
        """Angular frequency of the phasors in the axes (K,), rad/s."""
        _, angular, slip = self.supply
        return angular * slip if self.terminals.axes == "rotor" else angular

    @cached_property
    def vector(self) -> Phasors:
        """Amplitudes (2, K) of the voltages: the quadrature axis is a quarter of a turn behind."""
        voltage, _, _ = self.supply
        return np.asarray(self.terminals.amplitude * voltage * np.array([[1.0], [-1.0j]]))

    @cached_property
    def _points(self) -> PointModel:
        """The model at each speed: without voltages, then at their amplitudes."""
        _, angular, slip = self.supply
        voltages = np.hstack([np.zeros_like(self.vector.real), self.vector.real])
        inputs = dict(zip(self.terminals.voltages, voltages, strict=True))
        inputs |= {self.terminals.speed: np.tile(angular * (1.0 - slip), 2)} if self.terminals.speed else {}
        return self.points(inputs, self.terminals.voltages, self.terminals.currents, "frame")

    def _compute(self, thetas: Floats) -> tuple[Floats, list[str]]:
        """Return outputs (m, K, n_outputs) of all rows, and reasons of failures."""
        points, (_, angular, slip) = self._points, self.supply
        models = points.at(np.zeros((2 * slip.size, len(points.states))), thetas).of(np.s_[:, : slip.size])
        states = _states(models, self.frequencies, self.vector.T)
        currents = (models.c @ states + models.d @ self.vector.T[..., None])[..., 0]
        resistance = np.full(len(thetas), np.nan)
        if self.terminals.resistance:
            resistance = self.parameter(self.terminals.resistance, thetas)
        given = self.vector[:, None], np.moveaxis(currents, -1, 0), 0.5, angular, slip, resistance[:, None]
        at = OperatingPhasors(self.terminals, *given, self.pole_pairs or np.nan)
        values = values_of_formulas(self.output_names, at).items()
        outputs = np.stack([in_data_units(self.system, self.experiment, *each) for each in values], axis=-1)
        reasons = [""] * len(thetas)
        if not self._is_checked and np.isfinite(states[0]).all():
            reasons[0] = self._curvature(states[0, :, :, 0], models.a[0], thetas[:1])
            self._is_checked = not reasons[0]
        return outputs, reasons

    def _curvature(self, states: Phasors, a: Floats, theta: Floats) -> str:
        """Return why phasors do not hold; "" if the model is linear."""
        points = self._points.at(np.vstack([np.zeros_like(states.real), states.real]), theta)
        rates = points.rates[0, len(states) :]
        linear = (1j * self.frequencies[:, None] * states).real
        size = np.abs(a * states[:, None]).max(axis=(1, 2)) + np.abs(rates).max(axis=1)
        wrong = np.abs(rates - linear).max(axis=1) > SETTINGS.linear * size
        said = f"row {int(wrong.argmax()) + 1}: nonlinear at this amplitude. Use a model that is linear, or a transient"
        return said if wrong.any() else ""


def _states(models: StateSpace, frequencies: Floats, inputs: Phasors) -> Phasors:
    """Return phasors of the states (m, K, n_x, 1): (jω − A)⁻¹ B u."""
    one = np.eye(models.a.shape[2])
    found = np.linalg.solve(1j * frequencies[:, None, None] * one - models.a, models.b @ inputs[..., None])
    return np.asarray(found, dtype=np.complex128)
