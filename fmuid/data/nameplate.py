"""Nameplate of an induction machine, as printed."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Gt

from fmuid.errors import InputError
from fmuid.units import parse_unit

_PRINTED = re.compile(r"\s*([-+]?\d+(?:\.(\d*))?|[-+]?\.(\d+))\s*(\S.*)?")
_APPARENT = re.compile(r"va\b|var\b|v\W*a$", re.IGNORECASE)
UNITS = {"P": "W", "U": "V", "I": "A", "cos_phi": "", "n": "rpm", "f": "Hz", "Is_In": "", "Ts_Tn": "", "Tb_Tn": ""}
"""Units of numbers without one."""


MOST_SLIP = 0.2
"""Largest rated slip: that of NEMA design D is 0.13."""


@dataclass(frozen=True)
class PrintedNumber:
    """Printed number, and half a step of its last digit."""

    value: float
    half: float

    @property
    def std(self) -> float:
        """Standard deviation of the rounding."""
        return float(self.half / 3.0**0.5)


@dataclass(frozen=True)
class Nameplate:
    """Nameplate and catalogue of a machine: numbers, or texts with the printed digits and unit.

    Examples
    --------
    >>> plate = fmuid.data.Nameplate(P="1.1 kW", U="400 V", I="2.6 A", n="1415", f=50, cos_phi="0.78")
    >>> plate.printed["P"].value, plate.printed["P"].half, plate.pole_pairs
    (1100.0, 50.0, 2)
    """

    P: str | float
    """rated mechanical power, such as "1.1 kW" """
    U: str | float
    """rated line voltage, V"""
    I: str | float  # noqa: E741 - as printed
    """rated line current, A"""
    n: str | float
    """rated speed, rpm"""
    f: str | float
    """rated frequency, Hz"""
    cos_phi: str | float | None = None
    """rated power factor"""
    Is_In: str | float | None = None
    """starting current over rated current"""
    Ts_Tn: str | float | None = None
    """starting torque over rated torque"""
    Tb_Tn: str | float | None = None
    """breakdown torque over rated torque"""
    std_factor: Annotated[float, Gt(0)] = 1.0
    """factor on σ, for tolerances of the type series beyond rounding"""

    def __post_init__(self) -> None:
        printed = self.printed
        for name, each in printed.items():
            if each.value <= 0.0:
                raise InputError(f"{name} must be above 0, not {each.value:g}.")
        if not 0.0 < self.slip.value < MOST_SLIP:
            said = f"n = {printed['n'].value:g} rpm is no rated speed at {printed['f'].value:g} Hz"
            raise InputError(f"{said}. Give the speed at full load, less than 20 % below 60 f/p.")
        taken = math.prod(each.value + each.half for name, each in printed.items() if name in ("U", "I", "cos_phi"))
        if printed["P"].value - printed["P"].half > 3.0**0.5 * taken:
            raise InputError(
                "P exceeds the electrical power of U, I and cos_phi. Give U between lines and I of a line."
            )

    @property
    def printed(self) -> dict[str, PrintedNumber]:
        """Given numbers by key."""
        given = {name: getattr(self, name) for name in UNITS}
        return {name: _read(name, value) for name, value in given.items() if value is not None}

    @property
    def pole_pairs(self) -> int:
        """Pole pairs: the largest number whose synchronous speed is above n."""
        printed = self.printed
        return max(1, int(60.0 * printed["f"].value / printed["n"].value))

    @property
    def slip(self) -> PrintedNumber:
        """Rated slip."""
        printed = self.printed
        turn = self.pole_pairs / (60.0 * printed["f"].value)
        return PrintedNumber(1.0 - turn * printed["n"].value, turn * printed["n"].half)


def _read(name: str, given: str | float) -> PrintedNumber:
    """Return a printed number."""
    text = (
        given.replace(",", ".")
        if isinstance(given, str)
        else f"{given:.12g}"
        if "e" in repr(given)
        else repr(given).removesuffix(".0")
    )
    if re.search(r"\d\s*/\s*\d", text):  # of star and delta
        raise InputError(f"{name} = {given!r} has two values. Give the one of the connection in use.")
    found = _PRINTED.fullmatch(text)
    if found is None:
        raise InputError(f'{name} = {text!r} is no printed number. Write it as "1.1 kW".')
    factor, said = 1.0, (found[4] or "").strip()
    if said and said != UNITS[name]:
        if name == "P" and _APPARENT.search(said):
            raise InputError(f"{name}: {said!r} is apparent power. Give the mechanical power in W.")
        own, wanted = parse_unit(said), parse_unit(UNITS[name])
        if own is None or wanted is None or own.exponents != wanted.exponents:
            raise InputError(f"{name}: unit {said!r} does not convert to {UNITS[name] or 'a plain number'!r}.")
        factor = own.factor / wanted.factor
    digits = found[2] if found[2] is not None else found[3]
    return PrintedNumber(float(found[1]) * factor, 0.5 * 10.0 ** -len(digits or "") * factor)
