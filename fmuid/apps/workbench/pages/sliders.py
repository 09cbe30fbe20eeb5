"""A slider per parameter: range, prior and estimate, typed value, hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

from bokeh.layouts import column, row
from bokeh.models import Div, InlineStyleSheet, Slider, TextInput, Toggle

from fmuid.apps.workbench.widgets import SHEET, WIDE, button, line, on_change, typed
from fmuid.data import Normal, Parameter
from fmuid.formatting import label

PLACES = 1000  # steps of a slider
NEAR_STDS = 10.0  # half range around an estimate, σ


@dataclass(frozen=True)
class SliderRange:
    """Range of a slider, linear or logarithmic."""

    low: float
    high: float
    logarithmic: bool

    def value(self, place: float) -> float:
        """Return the value at a place, 0 to `PLACES`."""
        share = place / PLACES
        if self.logarithmic:
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + share * (self.high - self.low))

    def place(self, value: float) -> float:
        """Return the place of a value, clipped to 0 and `PLACES`."""
        if value <= self.low:
            return 0.0
        if self.logarithmic:
            share = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return PLACES * min(share, 1.0)

    def including(self, value: float) -> SliderRange:
        """Return a range that includes a value."""
        if self.low <= value <= self.high:
            return self
        low, high = min(self.low, value), max(self.high, value)
        return SliderRange(low, high, self.logarithmic and low > 0)


def reach_of(parameter: Parameter, estimate: tuple[float, float] | None = None, *, near: bool = False) -> SliderRange:
    """Return the range of a slider within the bounds: around value and σ of the last result, if there is one."""
    if estimate is None or not math.isfinite(estimate[0]):
        bounded = math.isfinite(parameter.min) and math.isfinite(parameter.max)
        return _within(parameter, [parameter.min, parameter.max] if bounded else _span(parameter, parameter.start))
    half = NEAR_STDS * estimate[1] if math.isfinite(estimate[1]) else 0.0
    places = [estimate[0] - half, estimate[0] + half]
    return _within(parameter, places if near and half > 0 else [*places, *_span(parameter, estimate[0])])


def _span(parameter: Parameter, center: float) -> list[float]:
    """Return values around an estimate or initial guess: ratio, prior."""
    size, prior = abs(parameter.start) or parameter.nominal or 1.0, parameter.prior
    span = [center / 5.0, center * 5.0] if center else [-2 * size, 2 * size]
    room = [] if prior is None else [prior.mean + side * 4.0 * prior.std for side in (-1.0, 1.0)]
    return [parameter.start, *span, *room]


def _within(parameter: Parameter, places: Sequence[float]) -> SliderRange:
    """Return the range of values within the bounds."""
    low, high = max(min(places), parameter.min), min(max(places), parameter.max)
    return SliderRange(low, high, low > 0 and high / low >= 20.0) if low < high else reach_of(parameter)


class ParameterRow:
    """One parameter on the page; `changed` is called for each change, with True at the end of a drag."""

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
        on_change(self._moved, self.slider)
        on_change(self._told, self.slider, name="value_throttled")
        on_change(self._entered, self.typed)
        on_change(self._told, self.hold, name="active")
        self.title = Div(text="", name=f"title {name}", **WIDE)
        head = row(
            self.title, self.typed, self.hold, sizing_mode="stretch_width", stylesheets=[":host{align-items:center}"]
        )
        self.mean, self.std = (typed(f"prior {word} of {name}", "", f"{word} {name}", 120) for word in ("mean", "std"))
        on_change(self._told, self.mean, self.std)
        leave = button("no prior", self._take_prior, name=f"no prior {name}")
        self._given = line(self.mean, self.std, leave, visible=False)
        self.layout = column(head, self.slider, self._given, sizing_mode="stretch_width")
        self.know(None)

    @property
    def held(self) -> bool:
        """Whether an identification fixes it."""
        return bool(self.hold.active)

    @property
    def prior(self) -> Normal | None:
        """The typed prior, or else that of the study."""
        mean, std = _number(self.mean.value), _number(self.std.value)
        if self._given.visible and math.isfinite(mean) and std > 0:
            return Normal(mean, std)
        return self.parameter.prior

    def give_prior(self) -> None:
        """Show fields for a prior, at first the initial guess ± 50 %."""
        size = abs(self.parameter.start) or self.parameter.nominal or 1.0
        self._quiet = True
        try:
            self.mean.value, self.std.value = f"{self.parameter.start:.6g}", f"{0.5 * size:.3g}"
        finally:
            self._quiet = False
        self._given.visible = True
        self._told()

    def _take_prior(self) -> None:
        self._given.visible = False
        self._told()

    def know(self, estimate: tuple[float, float] | None) -> None:
        """Show value and σ of the last result."""
        self.estimate = estimate
        self.reach = reach_of(self.parameter, estimate, near=self._near).including(self.value)
        self._shade()
        self.put(self.value)

    def show_near(self, near: bool) -> None:
        """Show the range near the estimate, or all."""
        self._near = near
        self.know(self.estimate)

    def put(self, value: float) -> None:
        """Show a value without a call of `changed`."""
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

    def _moved(self) -> None:
        if not self._quiet:
            self.value = self.reach.value(self.slider.value)
            self._quiet = True
            try:
                self._write()
            finally:
                self._quiet = False
            self._told(ended=False)

    def _entered(self) -> None:
        """Take a typed number within the bounds, or restore the old one."""
        if self._quiet:
            return
        value = _number(self.typed.value)
        good = math.isfinite(value) and self.parameter.min <= value <= self.parameter.max
        self.put(value if good else self.value)
        if good:
            self._told()

    def _told(self, ended: bool = True) -> None:
        if not self._quiet:
            if ended:
                self._shade()
            self._changed(ended)

    def _write(self) -> None:
        self.typed.value = f"{self.value:.6g}"
        self.title.text = f"<b>{escape(self.text)}</b><br><small>{self._distance()}</small>"

    def _distance(self) -> str:
        """Return the distance from the last optimum in words."""
        if self.estimate is None or not self.estimate[1] > 0 or not math.isfinite(self.estimate[1]):
            return ""
        away = (self.value - self.estimate[0]) / self.estimate[1]
        if abs(away) < 0.05:
            return "at the optimum"
        return f"{away:+.0f} σ" if abs(away) >= 10 else f"{away:+.2g} σ"

    def _shade(self) -> None:
        """Shade the prior amber and the confidence interval blue."""
        bands = []
        if self.estimate is not None and math.isfinite(self.estimate[1]):
            bands.append((*self.estimate, "#0b61d0"))
        if self.prior is not None:
            bands.append((self.prior.mean, self.prior.std, "#d99a1c"))
        shades = [self._band(*each) for each in bands]
        css = f".noUi-base{{background:{','.join(shades)};border-radius:4px}}" if shades else ""
        self._shades.css = css

    def _band(self, center: float, std: float, color: str) -> str:
        first, last = (100 * self.reach.place(center + side * 1.96 * std) / PLACES for side in (-1.0, 1.0))
        last = max(last, first + 0.8)  # at least a line
        return (
            f"linear-gradient(90deg,transparent {first:.2f}%,{color}b0 {first:.2f}%,{color}b0 {last:.2f}%,"
            f"transparent {last:.2f}%)"
        )


def _number(text: str) -> float:
    """Return a typed number, NaN for none."""
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return math.nan
