"""A slider for each parameter: its range, shades of what is known of it, a value to type, a switch that holds it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from bokeh.layouts import column, row
from bokeh.models import Div, InlineStyleSheet, Slider, TextInput, Toggle

from fmuid.apps.workbench.page_layout import LINE, SHEET, WIDE, button
from fmuid.data import Normal, Parameter
from fmuid.formatting import label

PLACES = 1000
"""Steps of a slider."""
# A range that goes over more than this ratio is logarithmic.
LOG_RATIO = 20.0
# A range reaches from this part of the estimate, or else of the start, to so many times it.
SPAN_RATIO = 5.0
# It has so many standard deviations of the estimate and of the prior.
ESTIMATE_STDS, PRIOR_STDS = 10.0, 4.0
# What is shaded: two standard deviations of a prior, and the interval of 95 % of an estimate.
SHADED_STDS = 1.96
# A prior that is asked for is proposed with this share of the start as its standard deviation.
PRIOR_SHARE = 0.5

_CENTRED = ":host{align-items:center}"


@dataclass(frozen=True)
class SliderRange:
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

    def including(self, value: float) -> SliderRange:
        """Return a range that has this value too."""
        if self.low <= value <= self.high:
            return self
        low, high = min(self.low, value), max(self.high, value)
        return SliderRange(low, high, self.logarithmic and low > 0)


def reach_of(parameter: Parameter, estimate: tuple[float, float] | None = None, *, near: bool = False) -> SliderRange:
    """Return the range of a slider within the bounds.

    Parameters
    ----------
    parameter : Parameter
    estimate : (float, float), optional
        Value and standard deviation of the last result; without it, two bounds are the range.
    near : bool
        Whether the range is that of `ESTIMATE_STDS` alone, where the standard deviation is known.

    Returns
    -------
    Reach
    """
    if estimate is None or not math.isfinite(estimate[0]):
        bounded = math.isfinite(parameter.min) and math.isfinite(parameter.max)
        return _within(parameter, [parameter.min, parameter.max] if bounded else _span(parameter, parameter.start))
    half = ESTIMATE_STDS * estimate[1] if math.isfinite(estimate[1]) else 0.0
    places = [estimate[0] - half, estimate[0] + half]
    return _within(parameter, places if near and half > 0 else [*places, *_span(parameter, estimate[0])])


def _span(parameter: Parameter, centre: float) -> list[float]:
    """Return values that a range has around an estimate or a start: the start, a span by ratio, the prior."""
    size, prior = abs(parameter.start) or parameter.nominal or 1.0, parameter.prior
    span = [centre / SPAN_RATIO, centre * SPAN_RATIO] if centre else [-2 * size, 2 * size]
    room = [] if prior is None else [prior.mean + side * PRIOR_STDS * prior.std for side in (-1.0, 1.0)]
    return [parameter.start, *span, *room]


def _within(parameter: Parameter, places: Sequence[float]) -> SliderRange:
    """Return the range over some values within the bounds; that around the start where they are all outside."""
    low, high = max(min(places), parameter.min), min(max(places), parameter.max)
    return SliderRange(low, high, low > 0 and high / low >= LOG_RATIO) if low < high else reach_of(parameter)


class ParameterRow:
    """One parameter on the page.

    Parameters
    ----------
    name, unit : str, str or None
    parameter : Parameter
    changed : callable
        Called when somebody has moved, typed or held something; with True once a drag has ended.

    Attributes
    ----------
    text : str
        The name with its unit.
    """

    def __init__(self, name: str, unit: str | None, parameter: Parameter, changed: Callable[[bool], object]) -> None:
        self.name, self.parameter, self._changed = name, parameter, changed
        self.text = label(name, unit)
        self.value = parameter.start
        self.estimate: tuple[float, float] | None = None
        self.reach, self._near, self._quiet = reach_of(parameter), False, False
        self._shades = InlineStyleSheet(css="")
        self.slider = Slider(start=0, end=PLACES, step=1, value=0, show_value=False, tooltips=False, name=name, **WIDE)
        self.typed = TextInput(value="", name=f"typed {name}", stylesheets=[SHEET], width=104)
        self.hold = Toggle(label="hold", name=f"hold {name}", stylesheets=[SHEET], width=56)
        self.slider.stylesheets = [SHEET, self._shades]
        self.slider.on_change("value", lambda _attr, _old, new: self._moved(new))
        self.slider.on_change("value_throttled", lambda _attr, _old, _new: self._told(ended=True))
        self.typed.on_change("value", lambda _attr, _old, new: self._entered(new))
        self.hold.on_change("active", lambda _attr, _old, _new: self._told(ended=True))
        self.title = Div(text="", name=f"title {name}", **WIDE)
        head = row(self.title, self.typed, self.hold, sizing_mode="stretch_width", stylesheets=[_CENTRED])
        self.mean, self.std = (
            TextInput(title=f"prior {word} of {name}", value="", name=f"{word} {name}", width=120, stylesheets=[SHEET])
            for word in ("mean", "std")
        )
        for each in (self.mean, self.std):
            each.on_change("value", lambda _attr, _old, _new: self._told(ended=True))
        leave = button("no prior", self._take_prior, name=f"no prior {name}")
        self._given = row(self.mean, self.std, leave, visible=False, stylesheets=[LINE], sizing_mode="stretch_width")
        self.layout = column(head, self.slider, self._given, sizing_mode="stretch_width")
        self.know(None)

    @property
    def held(self) -> bool:
        """Whether an identification leaves it alone."""
        return bool(self.hold.active)

    @property
    def prior(self) -> Normal | None:
        """What was typed as its prior, or else that of the study."""
        mean, std = _number(self.mean.value), _number(self.std.value)
        if self._given.visible and math.isfinite(mean) and std > 0:
            return Normal(mean, std)
        return self.parameter.prior

    def give_prior(self) -> None:
        """Show where to type what is known of it; until then it is the start, to within a half."""
        size = abs(self.parameter.start) or self.parameter.nominal or 1.0
        self._quiet = True
        try:
            self.mean.value, self.std.value = f"{self.parameter.start:.6g}", f"{PRIOR_SHARE * size:.3g}"
        finally:
            self._quiet = False
        self._given.visible = True
        self._told(ended=True)

    def _take_prior(self) -> None:
        self._given.visible = False
        self._told(ended=True)

    def know(self, estimate: tuple[float, float] | None) -> None:
        """Take the value and standard deviation of the last result: range and shades follow."""
        self.estimate = estimate
        self.reach = reach_of(self.parameter, estimate, near=self._near).including(self.value)
        self._shade()
        self.put(self.value)

    def show_near(self, near: bool) -> None:
        """Show the values near the estimate alone, or all."""
        self._near = near
        self.know(self.estimate)

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
        value = _number(text)
        good = math.isfinite(value) and self.parameter.min <= value <= self.parameter.max
        self.put(value if good else self.value)
        if good:
            self._told(ended=True)

    def _told(self, *, ended: bool) -> None:
        if not self._quiet:
            if ended:
                self._shade()
            self._changed(ended)

    # --- what is shown

    def _write(self) -> None:
        self.typed.value = f"{self.value:.6g}"
        self.title.text = f"<b>{escape(self.text)}</b><br><small>{self._distance()}</small>"

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
        if self.prior is not None:
            bands.append((self.prior.mean, self.prior.std, "#d99a1c"))
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


def _number(text: str) -> float:
    """Return the number that was typed, NaN for none."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return math.nan


def stacked(rows: list[ParameterRow]) -> Any:
    """Return the rows below each other."""
    return column(*[each.layout for each in rows], sizing_mode="stretch_width", spacing=10)
