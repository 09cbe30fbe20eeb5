"""Texts of dates, times of day and durations, in seconds."""

from __future__ import annotations

import itertools
import re
from contextlib import suppress
from datetime import timezone
from typing import Any

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.errors import InputError
from fmuid.units import SECONDS

_ORDERS = (
    "%d{0}%m{0}%Y",
    "%m{0}%d{0}%Y",
    "%Y{0}%m{0}%d",
    "%d{0}%b{0}%Y",
    "%d{0}%m{0}%y",
    "%m{0}%d{0}%y",
    "%y{0}%m{0}%d",
    "%d{0}%b{0}%y",
    "%m{0}%d",
    "%d{0}%m",
)
_DOTTED = ("%d{0}%m{0}%Y", "%d{0}%m{0}%y")
"""With dots the day is first."""
_ORDER_SAID = re.compile(r"\b(DD|MM|YYYY|YY)[./-](DD|MM|YYYY|YY)[./-](DD|MM|YYYY|YY)\b")
_FORMS = {"DD": "%d", "MM": "%m", "YYYY": "%Y", "YY": "%y"}
_MINUTES_SAID = re.compile(r"(?<![hH:])\bm{1,2}(?:in)?:s{1,2}(?:ec)?", re.IGNORECASE)
_ONE_DAY = pd.Timedelta(days=1)
_CLOCKS = (" %H:%M:%S.%f", " %H:%M:%S", " %H:%M", " %I:%M:%S.%f %p", " %I:%M:%S %p", " %I:%M %p")
_DATED = re.compile(r"\d+[./-]\w+(?:[./-]\d+)?.*:")
_DAY_ALONE = re.compile(r"\d{1,4}([./-])\w{1,9}\1\d{1,4}")
_MIDNIGHT = re.compile(r"(?<=[ T])24:00(?=:00|$)")
_CLOCK = re.compile(r"(\d+ days )?\d{1,3}:\d{1,2}(:\d{1,2}([.,]\d+)?)?")
_OFFSET = r"(?:Z|[+-]\d{2}:?\d{2})$"
_WITH_UNIT = re.compile(r"\s*(?P<number>[+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(?P<unit>[a-zµ]+)\s*")
_REWRITTEN = (
    (re.compile(r"^\s+|\s+$"), ""),
    (re.compile(r"\s\s+"), " "),
    (re.compile(r"^(\d{1,2})\.(\d{2})(?=\s?[AaPp]\.?[Mm]\.?$)"), r"\1:\2"),
    (re.compile(r"(?<=\d)\s?([AaPp])\.?\s?[Mm]\.?$"), r" \1m"),
    (re.compile(r"^(\d{1,3}:\d{2}[.,]\d+)$"), r"0:\1"),
    (re.compile(r" (?:UTC|GMT)$"), "Z"),
    (re.compile(r"^(\d{4})年(\d{1,2})月(\d{1,2})日 ?"), r"\1-\2-\3 "),
    (re.compile(r"^[A-Z][a-z]{2} ([A-Z][a-z]{2}) (\d{1,2}) ([\d:.]+)( [A-Z][^ ]*)? (\d{4})$"), r"\2-\1-\5 \3\4"),
    (re.compile(r"^([A-Z][a-z]{2})[a-z]* (\d{1,2}),? (\d{4}),? "), r"\2-\1-\3 "),
    (re.compile(r"^(\d{1,2}) ([A-Z][a-z]{2})[a-z]* (\d{4}),? "), r"\1-\2-\3 "),
    (re.compile(r"^(\d{4}-\d{2}-\d{2})[-_ ](\d{2})-(\d{2})-(\d{2})$"), r"\1T\2:\3:\4"),
    (re.compile(r"^([^/ ]+T[^/ ]+)/[^/ ]+T[^/ ]+$"), r"\1"),
    (re.compile(r"^(\d{4})(\d{2})(\d{2})[:_ -](\d{2}):?(\d{2})$"), r"\1-\2-\3T\4:\5:00"),
    (re.compile(r"^(\d{4})(\d{2})(\d{2})[:_ -](\d{2}):?(\d{2}):?(\d{2}(?:\.\d+)?)$"), r"\1-\2-\3T\4:\5:\6"),
    (re.compile(r"^(\d+)d\s+(?=\d{1,2}:)"), r"\1 days "),
    (re.compile(r"^(\d+)d (\d{1,2})h (\d{1,2})m ([\d.]+)s$"), r"\1 days \2:\3:\4"),
    (re.compile(r"(?<=\d) (\d{1,2})\.(\d{2})\.(\d{2})$"), r" \1:\2:\3"),
)
"""Spellings of loggers and battery cyclers, and the usual ones."""
_OFFSETS = """UTC=+00:00 GMT=+00:00 Z=+00:00 WET=+00:00 WEST=+01:00 BST=+01:00 CET=+01:00 MEZ=+01:00 CEST=+02:00
MESZ=+02:00 EET=+02:00 EEST=+03:00 MSK=+03:00 EST=-05:00 EDT=-04:00 CST=-06:00 CDT=-05:00 MST=-07:00 MDT=-06:00
PST=-08:00 PDT=-07:00 JST=+09:00 AEST=+10:00 AEDT=+11:00"""
_ZONES = {zone: offset for zone, _, offset in (each.partition("=") for each in _OFFSETS.split())}
"""Offsets of zones from UTC; only their differences matter to times from the first sample."""
_ZONED = re.compile(
    rf"(?P<local>.*\d(?: [AaPp][Mm])?)\s?"
    rf"(?:(?P<zone>{'|'.join(_ZONES)})|(?:GMT|UTC)?(?P<offset>[+-]\d{{2}}:?(?:\d{{2}})?))"
)
_MONTH = re.compile(r"(?P<day>\d{1,2})[. -]+(?P<month>[^\W\d_]{3,9})\.?[ -](?=\d{2,4}\b)")
_MONTHS = dict(
    each.split("=")
    for each in (
        *("jän=Jan", "mär=Mar", "mrz=Mar", "mai=May", "okt=Oct", "dez=Dec", "janv=Jan", "fév=Feb", "mars=Mar"),
        *("avr=Apr", "juin=Jun", "juil=Jul", "aoû=Aug", "déc=Dec", "ene=Jan", "abr=Apr", "ago=Aug", "dic=Dec"),
        *("gen=Jan", "mag=May", "giu=Jun", "lug=Jul", "set=Sep", "ott=Oct", "out=Oct", "maj=May", "mei=May"),
        *("jan=Jan", "feb=Feb", "mar=Mar", "apr=Apr", "jun=Jun", "jul=Jul", "aug=Aug", "sep=Sep", "oct=Oct", "nov=Nov"),
    )
)
"""Begins of months in German, French, Spanish, Italian, Portuguese, Swedish and Dutch, in English."""
_FOURTH = re.compile(r"(\d:\d{2}:\d{2})[:;](\d{1,6})(?=$| [AaPp]\.?[Mm]\.?$)")
"""Times with a fourth part."""
_HALF_DAY = re.compile(r"\d{1,2}:\d{2}(:\d{2}(\.\d+)?)? [ap]m", re.IGNORECASE)
_HOUR, _DAY = 3600.0, 86_400.0


def times_of(series: pd.Series[Any], column: str, source: str, form: str = "") -> tuple[Any, pd.Timestamp | None]:
    """Return dates and times of day in s; else the series unchanged. `form` may say the order of dates."""
    if pd.api.types.is_timedelta64_dtype(series.dtype):
        return series.dt.total_seconds(), None
    if pd.api.types.is_datetime64_any_dtype(series.dtype):
        return seconds_of(series)
    is_text = series.dtype == object or pd.api.types.is_string_dtype(series.dtype)
    texts = series.dropna().astype(str) if is_text else series[:0]
    if texts.empty:
        return series, None
    texts = _in_24_hours(_usual(texts))
    first = str(texts.iloc[0])
    if _CLOCK.fullmatch(first) and texts.map(lambda text: _CLOCK.fullmatch(text) is not None).all():
        if _MINUTES_SAID.search(form):
            texts = "0:" + texts
        elif _may_be_minutes(texts):
            said = f"{first!r}, {texts.iloc[1]!r} may be hours or minutes"
            raise InputError(f"{source}: column {column!r}: {said}. Write times as 0:00:00.")
        clock = texts.str.replace(",", ".").map(lambda text: f"{text}:00" if text.count(":") == 1 else text)
        seconds = pd.to_timedelta(clock).dt.total_seconds()
        if seconds.max() < _DAY:
            seconds += _DAY * (seconds.diff() < -_DAY / 2).cumsum()  # past midnight
        return (seconds - seconds.iloc[0]).reindex(series.index), None
    if _WITH_UNIT.fullmatch(first):
        cells = texts.map(_WITH_UNIT.fullmatch)
        if cells.notna().all() and all(cell["unit"] in SECONDS for cell in cells):  # 0.01 sec
            return cells.map(lambda cell: float(cell["number"]) * SECONDS[cell["unit"]]).reindex(series.index), None
    dates = _dates(texts, column, source, form)
    return (series, None) if dates is None else seconds_of(dates.reindex(series.index))


def _may_be_minutes(texts: pd.Series[Any]) -> bool:
    """Return whether times from 0:00 in odd steps may be minutes."""
    if len(texts) < 2 or not re.fullmatch(r"0?0:\d{2}", str(texts.iloc[0])):
        return False
    parts = texts.head(100).str.extract(r"^(\d+):(\d+)$").astype(float)
    steps = (60 * parts[0] + parts[1]).diff().dropna()
    return bool(steps.notna().all() and (steps % 5 != 0).any())


def _usual(texts: pd.Series[Any]) -> pd.Series[Any]:
    """Return texts in the usual spelling; the first tells the kind of many."""
    if _MONTH.match(str(texts.iloc[0])):
        texts = texts.str.replace(_MONTH, _in_english, regex=True)
    texts = _with_fractions(texts)
    for form, usual in _REWRITTEN:
        if form.search(str(texts.iloc[0])):
            texts = texts.str.replace(form, usual, regex=True)
    return texts


def _with_fractions(texts: pd.Series[Any]) -> pd.Series[Any]:
    """Return ``12:00:00:250`` as 12:00:00.250; two digits below 30 may be frames and stay as they are."""
    if not _FOURTH.search(str(texts.iloc[0])):
        return texts
    parts = texts.str.extract(_FOURTH)[1]
    widths, highest = parts.str.len(), pd.to_numeric(parts).max()
    if parts.isna().any() or (widths.max() == 2 and highest < 30):
        return texts
    width = 3 if widths.min() < widths.max() and highest < 1000 else 0  # ms without leading zeros
    return texts.str.replace(_FOURTH, lambda found: f"{found[1]}.{found[2].zfill(width)}", regex=True)


def _in_english(date: re.Match[str]) -> str:
    """Return day and month with an English name."""
    name = date["month"].lower()
    known = next((month for word, month in _MONTHS.items() if name.startswith(word)), None)
    return date[0] if known is None else f"{date['day']}-{known}-"


def _in_24_hours(texts: pd.Series[Any]) -> pd.Series[Any]:
    """Return times with am and pm as those of 24 hours."""
    first = str(texts.iloc[0])
    if _HALF_DAY.fullmatch(first):
        with suppress(ValueError):
            seconds = "" if first.count(":") == 1 else ":%S.%f" if "." in first else ":%S"
            return pd.to_datetime(texts, format=f"%I:%M{seconds} %p").dt.strftime(f"%H:%M{seconds or ':00'}")
    return texts


def days_of(series: pd.Series[Any], column: str, source: str, form: str = "") -> tuple[Any, pd.Timestamp] | None:
    """Return a column of dates without times in s, and the first; None if it is none or of one day."""
    if pd.api.types.is_datetime64_any_dtype(series.dtype):
        days = series
    else:
        texts = series.dropna().astype(str)
        known = texts.drop_duplicates()
        if len(known) < 2 or len(texts) < len(series) or known.str.contains(":").any():
            return None
        dates = _dates(_usual(known) + " 00:00", column, source, form)
        if dates is None:
            return None
        days = texts.map(dict(zip(known, dates, strict=True)))
    if days.isna().any() or days.nunique() < 2 or (days != days.dt.normalize()).any():
        return None
    return seconds_of(days)


def time_of_day(series: pd.Series[Any]) -> Any:
    """Return times of the day in s, else None."""
    is_text = series.dtype == object or pd.api.types.is_string_dtype(series.dtype)
    if not is_text or series.isna().any() or series.empty:
        return None
    texts = _in_24_hours(_usual(series.astype(str)))
    if not texts.map(lambda text: _CLOCK.fullmatch(text) is not None).all() or texts.str.contains("day").any():
        return None
    whole = texts.str.replace(",", ".").map(lambda text: f"{text}:00" if text.count(":") == 1 else text)
    return pd.to_timedelta(whole).dt.total_seconds()


def seconds_of(dates: pd.Series[Any]) -> tuple[Any, pd.Timestamp]:
    """Return dates as seconds from the first, and the first."""
    begin = dates.iloc[0]
    return (dates - begin).dt.total_seconds(), begin


def check_local_times(dates: pd.Series[Any], clock: tuple[Floats, pd.Timestamp], column: str, source: str) -> None:
    """Refuse local dates that go back or leap by one hour."""
    seconds, begin = clock
    steps = np.diff(seconds)
    usual = float(np.median(steps)) if steps.size else 0.0
    back, leaps = np.flatnonzero(steps < 0), np.flatnonzero(steps > 1.5 * usual)
    for places, way, hour in ((back, "goes back", _HOUR), (leaps, "leaps", -_HOUR)):
        if places.size != 1 or not 0 <= steps[places[0]] + hour <= 2 * usual:
            continue
        night = begin + pd.Timedelta(seconds=float(seconds[places[0]]))
        if hour < 0 and (night.day_of_week != 6 or night.hour > 2):  # clocks are put forward on Sundays
            continue
        before, after = dates.iloc[places[0] : places[0] + 2]
        said = f"{way} by an hour in row {places[0] + 2} ({before} to {after})"
        raise InputError(f"{source}: time column {column!r} {said}. Write times in UTC or with offsets (+01:00).")


def _dates(texts: pd.Series[Any], column: str, source: str, form: str = "") -> pd.Series[Any] | None:
    """Return texts as dates, None if they are none; 24:00 is midnight of the next day."""
    with suppress(ValueError, TypeError):  # the other orders are tried below; pandas converts its own texts twice
        return pd.Series(pd.to_datetime(texts.to_numpy(dtype=object), format="ISO8601"), texts.index)
    late = pd.to_timedelta(texts.str.contains(_MIDNIGHT).astype(int), unit="D")
    if late.any():
        texts = texts.str.replace(_MIDNIGHT, "00:00", regex=True)
        with suppress(ValueError, TypeError):
            return pd.to_datetime(texts, format="ISO8601") + late
    with suppress(ValueError, TypeError):  # offsets that change where the clock is put forward or back
        if re.search(_OFFSET, str(texts.iloc[0])) and texts.str.contains(_OFFSET, regex=True).all():
            in_utc = pd.to_datetime(texts, format="ISO8601", utc=True)
            return in_utc.dt.tz_convert(pd.Timestamp(texts.iloc[0]).tz)
    if _ZONED.fullmatch(str(texts.iloc[0])):
        return _zoned(texts, column, source)
    if _DAY_ALONE.fullmatch(str(texts.iloc[0])) and texts.is_unique:  # else of times beside them
        texts = texts + " 00:00"
    if not _DATED.search(str(texts.iloc[0])) or not texts.str.contains(_DATED).all():
        return None
    points = texts.str.replace(",", ".")
    dotted = re.match(r"\d{1,2}\.\d{1,2}\.", str(texts.iloc[0]))
    order = _ORDER_SAID.search(form.upper())
    orders = ("{0}".join(_FORMS[part] for part in order.groups()),) if order else _DOTTED if dotted else _ORDERS
    forms = [order.format(mark) + clock for order, mark, clock in itertools.product(orders, "./-", _CLOCKS)]
    fitting = [form for form in forms if not pd.isna(pd.to_datetime(points.iloc[0], format=form, errors="coerce"))]
    every = [pd.to_datetime(points, format=form, errors="coerce") for form in fitting]
    readings = [read + late for read in every if not read.isna().any()]
    readings = [read for read in readings if not _leaps(read)] or readings
    longest = {k: read.diff().abs().max() for k, read in enumerate(readings)}
    if min(longest.values(), default=pd.NaT) <= _ONE_DAY:  # day after day, not month after month
        readings = [read for k, read in enumerate(readings) if longest[k] < 20 * _ONE_DAY]
    if any(not (read - read.iloc[0] == readings[0] - readings[0].iloc[0]).all() for read in readings[1:]):
        said = f"day and month of {texts.iloc[0]!r} are ambiguous"
        raise InputError(f"{source}: column {column!r}: {said}. Write dates as 2026-02-28 12:00:00.")
    return readings[0] if readings else None


def _zoned(texts: pd.Series[Any], column: str, source: str) -> pd.Series[Any] | None:
    """Return dates with a zone or an offset at their end."""
    cells = texts.map(_ZONED.fullmatch)
    if cells.isna().any():
        return None
    local = _dates(cells.map(lambda cell: cell["local"]), column, source)
    if local is None or local.dt.tz is not None:
        return local
    offsets = cells.map(lambda cell: (cell["offset"] or _ZONES[cell["zone"]]).replace(":", "").ljust(5, "0"))
    known = {each: pd.Timedelta(f"{each[0]}{each[1:3]}:{each[3:]}:00") for each in offsets.unique()}
    utc = (local - offsets.map(known)).dt.tz_localize("UTC")
    found: pd.Series[Any] = utc.dt.tz_convert(timezone(known[offsets.iloc[0]].to_pytimedelta()))
    return found


def _leaps(dates: pd.Series[Any]) -> bool:
    """Return whether dates go back or leap, as with months for days."""
    steps = np.diff(dates.to_numpy())
    return bool(steps.size and ((steps < np.timedelta64(0)).any() or steps.max() > 100 * np.median(steps)))
