"""Units of people and tools: rpm, Nm, µs, °C; Modelica's N.m, W/(m2.K)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

BASE = ("kilogram", "meter", "second", "ampere", "kelvin", "mole", "candela", "radian")
"""Base units of FMI in its order (FMI 2.0.4, section 2.2.2)."""

_TIMES = {
    1.0: "s, sec, secs, second, seconds, sek, sekunde, sekunden, seconde, secondes, с, сек, 秒",
    1e-3: "ms, msec, msecs, millisec, millisecs, millisecond, milliseconds, millisekunden, мс, 毫秒",
    1e-6: "us, µs, μs, usec, microsec, microsecond, microseconds, мкс, 微秒",
    1e-9: "ns, nsec, nanosecond, nanoseconds",
    60.0: "min, mins, minute, minutes, minuten, мин",
    3600.0: "h, hr, hrs, hour, hours, stunden, heures, ч",
    86400.0: "d, day, days, tage",
}
SECONDS = {name: seconds for seconds, names in _TIMES.items() for name in names.split(", ")}
"""Units of time columns, in s."""

TIME_UNITS = ("s", "ms", "us", "ns", "min", "h", "d")  # spellings for studies

# Units that pint misreads or does not know; 1/min is a speed (DIN, IEC).
_MEANT = {
    "turn/min": "rpm, RPM, Rpm, rpm., r.p.m., 1/min, 1/Min, /min, n/min, U/min, u/min, Umdr/min, Umdr./min, r/min, "
    "rev/min, revs/min, rot/min, Upm, upm, UPM, tr/min, tr/mn, giri/min, об/мин, 转/分, min-1, min^-1, min⁻¹, "
    "min^(-1), min**-1",
    "kiloturn/min": "krpm, x1000 rpm, rpm x1000, x1000 1/min, 1/min x1000",
    "turn/s": "rps, rev/s, revs/s, r/s, U/s, tr/s, turn/s, turns/s",
    "V": "Volt, Volts, volt, volts, VDC, Vdc, В",
    "A": "Amp, Amps, amp, amps, Ampere, Amperes, ampere, amperes, ADC, Adc, А",
    "mV": "mVDC, mVdc, mVolt, mVolts, milliVolts, millivolts, мВ",
    "mA": "mADC, mAdc, mAmp, mAmps, milliAmps, milliamps, мА",
    "kV": "кВ",
    "kW": "кВт",
    "Hz": "Гц",
    "l/min": "LPM, lpm, Lpm",
    "gal/min": "GPM, gpm",
    "mbar": "mBar, MBAR",
    "ohm": "Ohm, Ohms, ohms, Ω, Ω",
    "deg": "degrees, Degrees, degree, Degree, deg., °, º",
    "deg/s": "°/s, degrees/s, deg/sec, dps",
    "km/h": "kmh, kph, Km/h, KM/H",
    "m/s": "mps",
    "rad/s": "rad/sec, rads/s, rad s-1, rad s^-1, rad·s⁻¹, rad*s^-1, rad.s-1",
    "permille": "‰, o/oo, 0/00",
    "lx": "Lux, lux",
    "percent": "%, percent, Percent, pct, Prozent",
    "N": "Newton, Newtons",
    "W": "Watt, Watts, watts, Вт",
    "V*A": "var",
    "kV*A": "kvar",
    "N*m": "Nm, Nm., NM, N-m, N m, N·m, Newton-meter, Newton meters, NewtonMeter, Нм, Н·м",
    "N*cm": "Ncm",
    "N*mm": "Nmm",
    "daN*m": "daNm",
    "mN*m": "mNm",
    "kN*m": "kNm",
    "MN*m": "MNm",
    "ft*lbf": "ft-lb, ft-lbs, ft.lb, lb-ft, lbs-ft, lbf-ft, lbf.ft",
    "in*lbf": "in-lb, in-lbs, in.lb, lb-in, lbf-in",
    "A*s": "As",
    "mA*s": "mAs",
    "V*s": "Vs",
    "mV*s": "mVs",
    "uV*s": "uVs",
    "W*s": "Ws",
    "degC": "°C, ℃, ºC, oC, deg C, deg. C, Deg C, Deg. C, DEG C, deg_C, degrees C, degree C, Celsius, celsius, "
    "degrees Celsius, degree Celsius, °С, Grad Celsius, Grad C, grad C, \ufffdC, Â°C",
    "degF": "°F, deg F, deg_F, Fahrenheit",
    "K": "Kelvin, kelvin, °K",
    "": "1, -, p.u., p.u, pu, PU, per unit",
}
_SPELLINGS = {name: unit for unit, names in _MEANT.items() for name in names.split(", ")}
_NO_UNITS = (
    "grad",
    "Grad",
    "mils",
    "count",
    "counts",
    "cnt",
    "bit",
    "bits",
    "digit",
    "LSB",
    "dB",
    "Min",
    *"BCDEFPRabceklquxy",
)
"""Texts that pint takes for units, and people use for others."""
_OF_BASE = re.compile(
    r"(?P<kind>p\.?u\.?|PU|per unit|%|percent)\s*,?\s*[(\[]?\s*(?:of|base|basis|Basis|von|=|:|\*)?\s*"
    r"(?P<base>\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)\s*\*?\s*(?P<unit>[^\d\s()*][^()]*?)[)\]]?"
)
"""Per unit or percent of a base: ``p.u. of 157 rad/s``. Without the words, ``12 V`` may be a nominal value."""
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_POWER_OF_A_NUMBER = re.compile(r"[\d)]\s*(\^|\*\*)")  # in no unit; slow in pint
_CLEAR = (
    "rpm mA kA uA µA mV kV uV µV mW kW Nm mNm kNm kPa MPa mbar degC degF deg mOhm kOhm mm cm kHz kmh kph mph mps pct "
    "RPM hPa mBar mAmps mVolts mAh °C \ufffdC °F %"
)
_AFTER_WORDS = (
    "Deg C",
    "deg C",
    "Deg. C",
    "degrees C",
    "Deg F",
    "deg F",
    "bar",
    "psi",
    "Pa",
    "hp",
    "Amps",
    "Volts",
    "m/s",
    "km/h",
)
"""Units that names have after a space, ``Temp. Deg C``."""
SHORT_FORMS = {"C": "degC", "F": "degF", "c": "degC", "f": "degF", "mv": "mV", "ma": "mA"}
"""Units whose letters mean others elsewhere: those of charge and capacity, for example."""
_IN_NAMES = re.compile(
    rf"(?:.+[_ .:\-{{<])?(?P<unit>{'|'.join(_CLEAR.split())})[}}>]?"
    rf"|.*[^\W\d_]{{3,}}\.? (?P<last>{'|'.join(map(re.escape, _AFTER_WORDS))})"
    r"|.*[Tt](?:emp|EMP).*[_ .](?P<short>[CFcf])|.*[Tt]emp(?:erature)?(?P<camel>[CF])"
    r"|.*[a-z](?P<turns>RPM|Rpm)|.*(?:curr|amp).*_(?P<milli>ma)|.+_(?P<volts>mv)",
)
"""Column names that end in a unit or are one; ``R_s``, ``i_d`` and ``p_bar`` do not."""
_CAPITALS = {each.upper(): each for each in _CLEAR.split()}
_AT_END = re.compile(r".+[_ ]([^\W\d_]+)")


@dataclass(frozen=True)
class BaseUnit:
    """Unit in FMI's base units: ``base = factor * value + offset``."""

    exponents: tuple[int, ...]
    factor: float
    offset: float


_COMMON = {
    "A": (0, 0, 0, 1),
    "V": (1, 2, -3, -1),
    "W": (1, 2, -3, 0),
    "s": (0, 0, 1, 0),
    "m": (0, 1, 0, 0),
    "rad": (0, 0, 0, 0, 0, 0, 0, 1),
    "rad/s": (0, 0, -1, 0, 0, 0, 0, 1),
    "N.m": (1, 2, -2, 0),
}
"""Exponents of frequent units; most studies need no other, and pint is slow to import."""


def time_unit(text: str) -> str | None:
    """Return a unit of time as in `SECONDS`, None for others: ``S`` is s in a time column."""
    return next((each for each in (text, text.lower(), text.lower().rstrip(".")) if each in SECONDS), None)


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> BaseUnit | None:
    """Return a unit in base units, None for unknown text.

    Angles have their own dimension, as in FMI: 1 Hz is not 1 rad/s.
    """
    text = text.strip()
    if text in _COMMON:
        return BaseUnit((*_COMMON[text], *(0,) * len(BASE))[: len(BASE)], 1.0, 0.0)
    based = _OF_BASE.fullmatch(text)
    if based is not None and text not in _SPELLINGS and (unit := parse_unit(based["unit"])) is not None:
        share = 0.01 if based["kind"] in ("%", "percent") else 1.0
        scale = share * float(based["base"])
        return BaseUnit(unit.exponents, scale * unit.factor, 0.0) if unit.offset == 0 and scale > 0 else None
    if text in _NO_UNITS or len(text) > 40 or _POWER_OF_A_NUMBER.search(text):  # longer texts are descriptions
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
    text = re.sub(r"(?<=[NAWgf])-(?=(?:m|mm|cm|h|in|m2)\b)", "*", text)  # kN-m
    return re.sub(r"(?<=[A-Za-zµμΩ)\d])\.(?=[A-Za-zµμΩ(])", "*", text)


@cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(on_redefinition="ignore")
    registry.define("radian = [angle] = rad")
    registry._build_cache()  # keeps the dimension of before else: mrad would convert to no angle
    return registry


def unit_in_name(column: str, variable: str = "", own: str = "") -> str | None:
    """Return the unit at the end of a column's name, ``w_rpm``.

    None if the name of its variable ends so too. With the variable's own unit, any that converts: ``LEVEL_CM``.
    """
    found, end, known = _in_name(column.strip()), _AT_END.fullmatch(column), parse_unit(own) if own else None
    if not found and known is not None and end is not None:
        unit = parse_unit(text := _CAPITALS.get(end[1], end[1]) if column.isupper() else end[1])
        return text if unit and unit.exponents == known.exponents and not variable.endswith(end[1]) else None
    return None if not found or variable.endswith(found) else SHORT_FORMS.get(found, found)


def _in_name(column: str) -> str:
    """Return the clear unit at the end of a name; empty if none."""
    found = _IN_NAMES.fullmatch(column)
    return "" if found is None else next(each for each in found.groups() if each)
