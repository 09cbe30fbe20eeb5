"""A slider for each parameter: its range, shades of what is known of it, a value to type, a switch that holds it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Div, InlineStyleSheet, Slider, TextInput, Toggle

from fmuid.data import Parameter
from fmuid.text import label

PLACES = 1000
"""Steps of a slider."""
# A range that goes over more than this ratio is logarithmic.
LOG_RATIO = 20.0
# Where there are no bounds: so many standard deviations around an estimate, and around a prior; of a start alone, from
# this part of it to so many times it.
ESTIMATE_STDS, PRIOR_STDS, START_RATIO = 8.0, 4.0, 5.0
# What is shaded: two standard deviations of a prior, and the interval of 95 % of an estimate.
SHADED_STDS = 1.96

SHEET = """
:host{font:14px Inter,system-ui,sans-serif;color:var(--ink);min-width:0;max-width:100%}
small{color:var(--soft)}.bk-clearfix{display:block;width:100%}
.noUi-target{background:var(--faint);border:0!important;box-shadow:none!important;height:10px!important}
.noUi-connect{background:none!important}
.noUi-handle{border-radius:50%!important;width:18px!important;height:18px!important;right:-9px!important;top:-5px!important;
border:2px solid var(--link)!important;background:var(--card)!important;box-shadow:none!important}
.noUi-handle:before,.noUi-handle:after{display:none}
.noUi-handle:focus-visible{outline:3px solid var(--link);outline-offset:2px}
.bk-input{background:var(--card)!important;color:var(--ink)!important;border-color:var(--faint)!important;font:inherit;
font-variant-numeric:tabular-nums}
.bk-input:focus-visible,.bk-btn:focus-visible{outline:2px solid var(--link)!important;outline-offset:1px}
.bk-btn{border-radius:8px!important;font:inherit!important}
.bk-btn-default{background:var(--card)!important;color:var(--ink)!important;border-color:var(--faint)!important}
.bk-btn-default.bk-active{background:var(--ink)!important;color:var(--card)!important}
.bk-btn-primary{background:#0b61d0!important;border-color:#0b61d0!important;font-weight:600!important}
.bk-btn[disabled]{opacity:.5}
.bk-tab{border:0!important;border-bottom:2px solid transparent!important;padding:8px 12px!important;color:var(--soft)}
.bk-tab.bk-active{color:var(--link)!important;border-bottom-color:var(--link)!important;background:none!important}
.bk-tab:focus-visible{outline:2px solid var(--link)}
:host(.bk-Tabs){grid-template-columns:minmax(0,1fr)!important}
.bk-headers{border-bottom:1px solid var(--faint)!important}
label{color:var(--soft);font-size:12.5px}
"""
"""Style of widgets, into which the page's own does not reach but for its variables."""
_CENTRED = ":host{align-items:center}"


@dataclass(frozen=True)
class Reach:
    """The range of a slider.

    Attributes
    ----------
    low, high : float
    logarithmic : bool
    """

    low: float
    high: float
    logarithmic: bool

    def value(self, place: float) -> float:
        """Return the value at a place from 0 to `PLACES`."""
        share = place / PLACES
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + share * (self.high - self.low))

    def place(self, value: float) -> float:
        """Return the place of a value, 0 or `PLACES` where it lies outside."""
        if value <= self.low:
            return 0.0
        if self.logarithmic:
            share = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return PLACES * min(share, 1.0)

    def including(self, value: float) -> Reach:
        """Return a range that has this value too."""
        if self.low <= value <= self.high:
            return self
        low, high = min(self.low, value), max(self.high, value)
        return Reach(low, high, self.logarithmic and low > 0)


def reach_of(parameter: Parameter, estimate: tuple[float, float] | None = None) -> Reach:
    """Return the range of a slider: the bounds, or what is known of the parameter.

    Parameters
    ----------
    parameter : Parameter
    estimate : (float, float), optional
        Value and standard deviation of the last result.
    """
    start, prior = parameter.start, parameter.prior
    places = [start]
    if estimate is not None and math.isfinite(estimate[0]):
        half = ESTIMATE_STDS * estimate[1] if math.isfinite(estimate[1]) else 0.0
        places += [estimate[0] - half, estimate[0] + half]
    if prior is not None:
        places += [prior.mean - PRIOR_STDS * prior.std, prior.mean + PRIOR_STDS * prior.std]
    low, high = min(places), max(places)
    if len(places) == 1:
        size = abs(start) or parameter.nominal or 1.0
        low, high = (start / START_RATIO, start * START_RATIO) if start > 0 else (start - 2 * size, start + 2 * size)
    else:
        room = 0.1 * (high - low) or 0.5 * abs(high) or 1.0
        low, high = low - room, high + room
    low = parameter.min if math.isfinite(parameter.min) and math.isfinite(parameter.max) else max(low, parameter.min)
    high = parameter.max if math.isfinite(parameter.min) and math.isfinite(parameter.max) else min(high, parameter.max)
    return Reach(low, high, low > 0 and high / low >= LOG_RATIO)


class ParameterRow:
    """One parameter on the page.

    Parameters
    ----------
    name, unit : str, str or None
    parameter : Parameter
    changed : callable
        Called when somebody has moved, typed or held something; with True once a drag has ended.
    """

    def __init__(self, name: str, unit: str | None, parameter: Parameter, changed: Callable[[bool], object]) -> None:
        self.name, self.parameter, self._changed = name, parameter, changed
        self._text = label(name, unit)
        self.value = parameter.start
        self.estimate: tuple[float, float] | None = None
        self.reach, self._quiet = reach_of(parameter), False
        self._shades = InlineStyleSheet(css="")
        wide = {"sizing_mode": "stretch_width", "stylesheets": [SHEET]}
        self.slider = Slider(start=0, end=PLACES, step=1, value=0, show_value=False, tooltips=False, name=name, **wide)
        self.typed = TextInput(value="", name=f"typed {name}", stylesheets=[SHEET], width=104)
        self.hold = Toggle(label="hold", name=f"hold {name}", stylesheets=[SHEET], width=56)
        self.slider.stylesheets = [SHEET, self._shades]
        self.slider.on_change("value", lambda _attr, _old, new: self._moved(new))
        self.slider.on_change("value_throttled", lambda _attr, _old, _new: self._told(ended=True))
        self.typed.on_change("value", lambda _attr, _old, new: self._entered(new))
        self.hold.on_change("active", lambda _attr, _old, _new: self._told(ended=True))
        self.title = Div(text="", name=f"title {name}", **wide)
        head = row(self.title, self.typed, self.hold, sizing_mode="stretch_width", stylesheets=[_CENTRED])
        self.layout = column(head, self.slider, sizing_mode="stretch_width")
        self.know(None)

    @property
    def held(self) -> bool:
        """Whether an identification leaves it alone."""
        return bool(self.hold.active)

    def know(self, estimate: tuple[float, float] | None) -> None:
        """Take the value and standard deviation of the last result: range and shades follow."""
        self.estimate = estimate
        self.reach = reach_of(self.parameter, estimate).including(self.value)
        self._shade()
        self.put(self.value)

    def put(self, value: float) -> None:
        """Show a value; nobody is told of it."""
        self._quiet = True
        try:
            if self.reach.including(value) != self.reach:
                self.reach = self.reach.including(value)
                self._shade()
            self.value = value
            self.slider.value = self.reach.place(value)
            self._write()
        finally:
            self._quiet = False

    # --- by hand

    def _moved(self, place: float) -> None:
        if not self._quiet:
            self.value = self.reach.value(place)
            self._quiet = True
            try:
                self._write()
            finally:
                self._quiet = False
            self._told(ended=False)

    def _entered(self, text: str) -> None:
        """Take what was typed where it is a number within the bounds; else what was there comes back."""
        if self._quiet:
            return
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            value = math.nan
        good = math.isfinite(value) and self.parameter.min <= value <= self.parameter.max
        self.put(value if good else self.value)
        if good:
            self._told(ended=True)

    def _told(self, *, ended: bool) -> None:
        if not self._quiet:
            self._changed(ended)

    # --- what is shown

    def _write(self) -> None:
        self.typed.value = f"{self.value:.6g}"
        self.title.text = f"<b>{escape(self._text)}</b><br><small>{self._distance()}</small>"

    def _distance(self) -> str:
        """Say how far it is from the last optimum."""
        if self.estimate is None or not self.estimate[1] > 0 or not math.isfinite(self.estimate[1]):
            return ""
        away = (self.value - self.estimate[0]) / self.estimate[1]
        if abs(away) < 0.05:
            return "at the optimum"
        return f"{away:+.0f} std off" if abs(away) >= 10 else f"{away:+.2g} std off"

    def _shade(self) -> None:
        """Shade the prior amber and the interval of the estimate blue."""
        bands = []
        if self.estimate is not None and math.isfinite(self.estimate[1]):
            bands.append((*self.estimate, "#0b61d0"))
        if self.parameter.prior is not None:
            bands.append((self.parameter.prior.mean, self.parameter.prior.std, "#d99a1c"))
        shades = [self._band(*each) for each in bands]
        css = f".noUi-base{{background:{','.join(shades)};border-radius:4px}}" if shades else ""
        self._shades.css = css

    def _band(self, centre: float, std: float, color: str) -> str:
        first, last = (100 * self.reach.place(centre + side * SHADED_STDS * std) / PLACES for side in (-1.0, 1.0))
        last = max(last, first + 0.8)  # a line at least
        return (
            f"linear-gradient(90deg,transparent {first:.2f}%,{color}b0 {first:.2f}%,{color}b0 {last:.2f}%,"
            f"transparent {last:.2f}%)"
        )


def stacked(rows: list[ParameterRow]) -> Any:
    """Return the rows below each other."""
    return column(*[each.layout for each in rows], sizing_mode="stretch_width", spacing=10)
