"""Units as people and tools write them: rpm, n/min, Nm, µs, °C, and Modelica's rad/s, Ohm, N.m, W/(m2.K)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

BASE = ("kilogram", "meter", "second", "ampere", "kelvin", "mole", "candela", "radian")
"""The base units of FMI, in the order of its exponents (FMI 2.0.4, section 2.2.2)."""

SECONDS = {
    "s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6,
    "usec": 1e-6, "ns": 1e-9, "min": 60.0, "minutes": 60.0, "h": 3600.0, "hr": 3600.0, "hours": 3600.0, "d": 86400.0,
}  # fmt: skip
"""Units of time columns, in s."""

TIME_UNITS = ("s", "ms", "us", "ns", "min", "h", "d")
"""One spelling of each, for who writes a study."""

# What pint would take for something else, or not know. Speeds in 1/min are turns, as DIN and IEC write them.
_SPELLINGS = {
    **dict.fromkeys(("rpm", "RPM", "1/min", "n/min", "U/min", "r/min", "rev/min", "Upm"), "turn/min"),
    **dict.fromkeys(("min-1", "min^-1", "min⁻¹"), "turn/min"),
    "Nm": "N*m", "mNm": "mN*m", "kNm": "kN*m", "As": "A*s", "Vs": "V*s", "Ws": "W*s", "mVs": "mV*s",
    "°C": "degC", "deg C": "degC", "°F": "degF", "°": "deg", "1": "", "-": "", "p.u.": "", "pu": "",
}  # fmt: skip
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_POWER_OF_A_NUMBER = re.compile(r"[\d)]\s*(\^|\*\*)")
"""In no unit, and may take for ever."""
_IN_NAMES = re.compile(r".+[_ ](rpm|[mkuµ]A|[mkuµ]V|[mk]W|[mk]?Nm|[kM]Pa|mbar|degC|deg|mOhm|kOhm|[mc]m|kHz)")
"""Names of columns that end in a unit which is hardly a word of the name: ``R_s``, ``i_d`` and ``p_bar`` are names."""
_ROUNDING = 1e-9
_LONGEST = 40
"""Characters that a unit may have: longer texts are descriptions."""


@dataclass(frozen=True)
class BaseUnit:
    """A unit by those of FMI's base: ``base = factor * value + offset``, with the exponents of `BASE`."""

    exponents: tuple[int, ...]
    factor: float
    offset: float


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> BaseUnit | None:
    """Return what a unit is in base units, None where the text is no unit that is known (pint's, with Modelica's).

    Unlike in the SI, angles have a dimension of their own, as in FMI: 1 Hz is not 1 rad/s.
    """
    text = text.strip()
    if len(text) > _LONGEST or _POWER_OF_A_NUMBER.search(text):
        return None
    registry = _registry()
    try:
        unit = registry.parse_units(_as_pint(text))
        origin, one, two = (registry.Quantity(value, unit).to_base_units() for value in (0.0, 1.0, 2.0))
    except Exception:  # pint raises errors of many kinds on texts that are none
        return None
    powers = {str(name): power for name, power in one.unit_items()}
    exponents = tuple(powers.pop(name, 0) for name in BASE)
    if powers or any(power != int(power) for power in exponents):
        return None
    offset, factor = float(origin.magnitude), float(one.magnitude - origin.magnitude)
    if abs(two.magnitude - one.magnitude - factor) > _ROUNDING * abs(factor):  # decibels and their like
        return None
    return BaseUnit(tuple(int(power) for power in exponents), factor, offset)


def _as_pint(text: str) -> str:
    """Return a unit as pint reads it: ``N.m2/s`` as ``N*m**2/s``."""
    text = _SPELLINGS.get(text, text).translate(_SUPERSCRIPTS).replace("Ohm", "ohm").replace("·", "*")
    text = re.sub(r"(?<=[A-Za-zµμΩ])\^?(-?\d+)", r"**(\1)", text)
    return re.sub(r"(?<=[A-Za-zµμΩ)\d])\.(?=[A-Za-zµμΩ(])", "*", text)


@cache
def _registry() -> Any:
    import pint  # slow to import, and needed where tables or models name units only

    registry: Any = pint.UnitRegistry(on_redefinition="ignore")
    registry.define("radian = [angle] = rad")
    return registry


def unit_in_name(column: str, variable: str = "") -> str | None:
    """Return the unit in which a column's name ends, ``w_rpm``; None where that of its variable ends so too."""
    found = _IN_NAMES.fullmatch(column)
    return found[1] if found and not variable.endswith(found[1]) else None
