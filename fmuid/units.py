"""Units of people and tools: rpm, Nm, µs, °C; Modelica's N.m, W/(m2.K)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

BASE = ("kilogram", "meter", "second", "ampere", "kelvin", "mole", "candela", "radian")
"""Base units of FMI in its order (FMI 2.0.4, section 2.2.2)."""

SECONDS = {
    "s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6,
    "usec": 1e-6, "ns": 1e-9, "min": 60.0, "minutes": 60.0, "h": 3600.0, "hr": 3600.0, "hours": 3600.0, "d": 86400.0,
}  # fmt: skip
"""Units of time columns, in s."""

TIME_UNITS = ("s", "ms", "us", "ns", "min", "h", "d")  # spellings for studies

# Units that pint misreads or does not know; 1/min is a speed (DIN, IEC).
_SPELLINGS = {
    **dict.fromkeys(("rpm", "RPM", "1/min", "n/min", "U/min", "r/min", "rev/min", "Upm"), "turn/min"),
    **dict.fromkeys(("min-1", "min^-1", "min⁻¹"), "turn/min"),
    "Nm": "N*m", "mNm": "mN*m", "kNm": "kN*m", "As": "A*s", "Vs": "V*s", "Ws": "W*s", "mVs": "mV*s",
    "°C": "degC", "deg C": "degC", "°F": "degF", "°": "deg", "1": "", "-": "", "p.u.": "", "pu": "",
}  # fmt: skip
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_POWER_OF_A_NUMBER = re.compile(r"[\d)]\s*(\^|\*\*)")  # in no unit; slow in pint
_IN_NAMES = re.compile(r".+[_ ](rpm|[mkuµ]A|[mkuµ]V|[mk]W|[mk]?Nm|[kM]Pa|mbar|degC|deg|mOhm|kOhm|[mc]m|kHz)")
"""Column names that end in a unit; ``R_s``, ``i_d`` and ``p_bar`` do not."""


@dataclass(frozen=True)
class BaseUnit:
    """Unit in FMI's base units: ``base = factor * value + offset``."""

    exponents: tuple[int, ...]
    factor: float
    offset: float


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> BaseUnit | None:
    """Return a unit in base units, None for unknown text.

    Angles have their own dimension, as in FMI: 1 Hz is not 1 rad/s.
    """
    text = text.strip()
    if len(text) > 40 or _POWER_OF_A_NUMBER.search(text):  # longer texts are descriptions
        return None
    registry = _registry()
    try:
        unit = registry.parse_units(_as_pint(text))
        origin, one, two = (registry.Quantity(value, unit).to_base_units() for value in (0.0, 1.0, 2.0))
    except Exception:  # pint raises many types of errors
        return None
    powers = {str(name): power for name, power in one.unit_items()}
    exponents = tuple(powers.pop(name, 0) for name in BASE)
    if powers or any(power != int(power) for power in exponents):
        return None
    offset, factor = float(origin.magnitude), float(one.magnitude - origin.magnitude)
    if abs(two.magnitude - one.magnitude - factor) > 1e-9 * abs(factor):  # such as decibels
        return None
    return BaseUnit(tuple(int(power) for power in exponents), factor, offset)


def _as_pint(text: str) -> str:
    """Return a unit as pint reads it: ``N.m2/s`` as ``N*m**2/s``."""
    text = _SPELLINGS.get(text, text).translate(_SUPERSCRIPTS).replace("Ohm", "ohm").replace("·", "*")
    text = re.sub(r"(?<=[A-Za-zµμΩ])\^?(-?\d+)", r"**(\1)", text)
    return re.sub(r"(?<=[A-Za-zµμΩ)\d])\.(?=[A-Za-zµμΩ(])", "*", text)


@cache
def _registry() -> Any:
    import pint  # slow to import

    registry: Any = pint.UnitRegistry(on_redefinition="ignore")
    registry.define("radian = [angle] = rad")
    return registry


def unit_in_name(column: str, variable: str = "") -> str | None:
    """Return the unit at the end of a column's name, ``w_rpm``.

    None if the name of its variable ends so too.
    """
    found = _IN_NAMES.fullmatch(column)
    return found[1] if found and not variable.endswith(found[1]) else None
