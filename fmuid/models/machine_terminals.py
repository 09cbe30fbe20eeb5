"""Terminals of an AC machine: declaration ``<Model>.nameplate.toml`` beside the FMU, formulas of operating points."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from fmuid.array_types import Floats
from fmuid.codec import from_json
from fmuid.errors import InputError
from fmuid.files import ContentError, is_file
from fmuid.formatting import nearest
from fmuid.models.system import System

Phasors = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class MachineTerminals:
    """Variables of an FMU that are the terminals of a three-phase machine."""

    voltages: tuple[str, str]  # inputs of the direct and the quadrature axis, which lags in the phasor
    currents: tuple[str, str]  # outputs, likewise
    speed: str = ""  # input of the electrical speed, rad/s; "" without one
    axes: Literal["rotor", "stator"] = "rotor"  # to which the axes of the model are fixed
    transform: Literal["power-invariant", "amplitude-invariant"] = "power-invariant"  # transform from phases to axes
    resistance: str = ""  # parameter of the stator resistance; "" if unknown

    @property
    def amplitude(self) -> float:
        """Amplitude in the axes of one unit rms a phase."""
        return math.sqrt(3.0 if self.transform == "power-invariant" else 2.0)

    @property
    def power_factor(self) -> float:
        """Factor from products in the axes to the power."""
        return 1.0 if self.transform == "power-invariant" else 1.5


@dataclass(frozen=True, eq=False)
class OperatingPhasors:
    """Phasors of operating points: amplitudes (..., K) in both axes.

    `share` is the mean of a product of two signals over that of their amplitudes: 1/2, or 1 for constants. `supply`
    is the angular frequency of the supply (K,), rad/s; `slip` (K,).
    """

    terminals: MachineTerminals
    voltages: Phasors
    currents: Phasors
    share: float
    supply: Floats
    slip: Floats
    resistance: float | Floats
    pole_pairs: float

    @property
    def current(self) -> Floats:
        """Phase current (..., K), A rms."""
        square = 2.0 * self.share * np.sum(np.abs(self.currents) ** 2, axis=0) / 2.0
        return np.asarray(np.sqrt(square) / self.terminals.amplitude, dtype=np.float64)

    @property
    def power(self) -> Phasors:
        """Complex power P + jQ of three phases (..., K), VA."""
        (ud, uq), (id_, iq) = self.voltages, self.currents
        active = np.real(ud * np.conj(id_) + uq * np.conj(iq))
        reactive = np.real(uq * np.conj(id_) - ud * np.conj(iq))
        return np.asarray(self.terminals.power_factor * self.share * (active + 1j * reactive))

    @property
    def torque(self) -> Floats:
        """Air-gap torque (..., K), N.m: air-gap power over synchronous speed."""
        air_gap = self.power.real - 3.0 * self.resistance * self.current**2
        return np.asarray(air_gap * self.pole_pairs / self.supply, dtype=np.float64)


@dataclass(frozen=True)
class PhasorFormula:
    """Named output of operating points."""

    unit: str
    equation: str
    value: Callable[[OperatingPhasors], Floats]
    needs_torque: bool = False


def _cos_phi(at: OperatingPhasors) -> Floats:
    return np.asarray(at.power.real / np.abs(at.power), dtype=np.float64)


def _efficiency(at: OperatingPhasors) -> Floats:
    return np.asarray(at.torque * (1.0 - at.slip) * at.supply / at.pole_pairs / at.power.real, dtype=np.float64)


PHASOR_FORMULAS: Mapping[str, PhasorFormula] = {
    "I_rms": PhasorFormula("A", "sqrt(mean(id^2 + iq^2)) / k, k = sqrt(3) power-invariant", lambda at: at.current),
    "P": PhasorFormula("W", "c mean(ud id + uq iq), c = 1 power-invariant", lambda at: at.power.real),
    "Q": PhasorFormula("var", "c mean(uq id - ud iq)", lambda at: at.power.imag),
    "S": PhasorFormula("V.A", "sqrt(P^2 + Q^2)", lambda at: np.abs(at.power)),
    "cos_phi": PhasorFormula("", "P / S", _cos_phi),
    "torque": PhasorFormula("N.m", "p (P - 3 Rs I_rms^2) / (2 pi f)", lambda at: at.torque, True),
    "efficiency": PhasorFormula("", "torque (1 - s) 2 pi f / (p P)", _efficiency, True),
}
"""Formulas of machine terminals; amplitude-invariant axes have k = sqrt(2), c = 3/2."""


@dataclass(frozen=True)
class MachineDeclaration:
    """Terminals of a machine, and formulas of first parameter values."""

    path: Path
    terminals: MachineTerminals
    starts: Mapping[str, str]


def machine_of(system: System) -> MachineDeclaration | None:
    """Return the declaration beside the FMU of a system, None without one; an `InputError` if it is wrong."""
    if len(system.components) > 1:
        return None
    (model,) = system.components.values()
    path = model.fmu.path.with_suffix(".nameplate.toml")
    return _read(path) if is_file(path) else None


def _read(path: Path) -> MachineDeclaration:
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not readable as TOML ({error}). Correct it.") from None
    for key in (each for each in data if each not in ("terminals", "starts")):
        raise InputError(f"{path}: unknown section {key!r}. Use [terminals] and [starts].")
    starts = data.get("starts", {})
    if not isinstance(starts, dict) or not all(isinstance(each, str) for each in starts.values()):
        raise InputError(f'{path}: starts must be formulas in quotes, such as Rs = "0.05 * Z".')
    return MachineDeclaration(path, _terminals(path, data.get("terminals", {})), starts)


def _terminals(path: Path, given: Any) -> MachineTerminals:
    known = [each.name for each in fields(MachineTerminals)]
    if not isinstance(given, dict):
        raise InputError(f"{path}: terminals must be a section.")
    for key in (each for each in given if each not in known):
        raise InputError(f"{path}: terminals: unknown key {key!r}{nearest(key, known)}. Use {', '.join(known)}.")
    try:
        return from_json(MachineTerminals, given)
    except ContentError as error:
        raise InputError(f"{path}: terminals: {error}. Correct it.") from None
