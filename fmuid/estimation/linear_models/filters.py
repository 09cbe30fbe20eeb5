"""State-variable filters: a signal and its derivatives, all seen through (λ/(s + λ))ᵐ, without differentiating it.

A chain of m lags z_j′ = λ (z_{j−1} − z_j), z_0 the signal, is integrated exactly for a signal that is held or linear
between its samples, whatever their times. Its states are the derivatives: Dᵖ z_m = λᵖ Σ_i C(p, i) (−1)^(p−i) z_{m−i}.

What an equation of derivatives says of signals it says of filtered ones too, but for what the filter does not know: the
derivatives at the start of the record. They add Σ c_k tᵏ e^(−λt), k < m, with free c_k.

References
----------
P. C. Young, "Parameter estimation for continuous-time models: a survey", Automatica 17 (1), 1981;
H. Garnier, L. Wang (ed.), "Identification of Continuous-time Models from Sampled Data", Springer 2008, chapter 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import special

from fmuid.array_types import Floats, numbers
from fmuid.errors import InputError
from fmuid.formatting import nearest

INTERPOLATIONS = ("linear", "zoh")
# Higher derivatives than any record knows: an equation that has one is mistyped.
MOST_DERIVATIVES = 20
# What is interpolated over a hole of so many time constants of the filter says nothing of the equation.
LONGEST_HOLE = 5.0


@dataclass(frozen=True, eq=False)
class Term:
    """A signal in a differential equation, or a derivative of it.

    Parameters
    ----------
    values : (K,) array
        Samples of the signal itself, which may be a product of measured ones; NaN where one is missing.
    derivative : int
        Which derivative of it is meant; 0 is the signal.
    interpolation : "linear" or "zoh"
        Between samples, also missing ones.

    Examples
    --------
    >>> times = np.linspace(0.0, 10.0, 1001)
    >>> terms = {"a": fmuid.Term(np.exp(-2.0 * times))}
    >>> rate = fmuid.Term(np.exp(-2.0 * times), derivative=1)
    >>> fmuid.equation_error(times, rate, terms, cutoff=5.0).values.round(2)
    array([-2.])
    """

    values: ArrayLike
    derivative: int = 0
    interpolation: str = "linear"

    def __post_init__(self) -> None:
        if self.interpolation not in INTERPOLATIONS:
            near = nearest(str(self.interpolation), INTERPOLATIONS)
            raise InputError(f"interpolation {self.interpolation!r} is not known{near}: give linear or hold")
        if self.derivative not in range(MOST_DERIVATIVES + 1):
            raise InputError(f"derivative must be 0, 1, ... {MOST_DERIVATIVES}, not {self.derivative!r}")
        object.__setattr__(self, "derivative", int(self.derivative))


class StateVariableFilter:
    """The filter (λ/(s + λ))ᵐ over given times.

    Parameters
    ----------
    times : (K,) array
        Increasing, s.
    cutoff : float
        λ, rad/s. Near the fastest time constant that matters: a much faster filter lets the noise through.
    order : int
        m, at least the highest derivative.

    Raises
    ------
    InputError
        If times do not increase, or the cutoff or the order is not positive.
    """

    def __init__(self, times: ArrayLike, cutoff: float, order: int) -> None:
        clock = numbers(times, "times")
        if clock.ndim != 1 or clock.size < 2 or not np.isfinite(clock).all() or not (np.diff(clock) > 0).all():
            raise InputError("times must be two or more finite numbers that increase from each to the next")
        if not (isinstance(cutoff, int | float | np.integer | np.floating) and math.isfinite(cutoff) and cutoff > 0):
            raise InputError(f"cutoff must be a positive number of rad/s, not {cutoff!r}")
        if order not in range(1, MOST_DERIVATIVES + 2):
            raise InputError(f"order must be 1, 2, ... {MOST_DERIVATIVES + 1}, not {order!r}")
        self.times, self.cutoff, self.order = clock, float(cutoff), int(order)
        self._steps = self._transitions()

    def _transitions(self) -> Floats:
        """Return of each step (K − 1) what the states, the signal and its change give for the states (m, m + 2).

        With x = λh: lags from rest answer a step by P(i, x), the incomplete gamma function, and a ramp to 1 by its
        mean over the step, P(i, x) − i P(i + 1, x)/x; what they hold moves on as xⁱ⁻ʲ e^(−x)/(i − j)!.
        """
        m, x = self.order, self.cutoff * np.diff(self.times)
        number, ahead = np.arange(1, m + 1), np.subtract.outer(np.arange(m), np.arange(m))
        found = np.zeros((x.size, m, m + 2))
        step = special.gammainc(number, x[:, None])
        found[:, :, m] = step
        found[:, :, m + 1] = step - number * special.gammainc(number + 1, x[:, None]) / x[:, None]
        lower = ahead >= 0
        held, along = ahead[lower], x[:, None]
        found[:, :, :m][:, lower] = np.exp(special.xlogy(held, along) - along - special.gammaln(held + 1))
        return found

    def columns(self, terms: Sequence[Term]) -> Floats:
        """Return terms as the filter sees them (K, n_terms), from rest.

        Raises
        ------
        InputError
            If a term has not a sample a time, none at all, or a derivative beyond the order.
        """
        signals = np.column_stack([self._filled(term) for term in terms])
        held = np.array([term.interpolation == "zoh" for term in terms])
        m, inner = self.order, np.zeros((self.order + 2, len(terms)))
        states = np.zeros((self.times.size, m + 1, len(terms)))
        states[:, 0] = signals
        changes = np.where(held, 0.0, np.diff(signals, axis=0))
        for k, step in enumerate(self._steps):
            inner[:m], inner[m], inner[m + 1] = states[k, 1:], signals[k], changes[k]
            np.matmul(step, inner, out=states[k + 1, 1:])
        return np.column_stack([self._derivative(states[:, :, i], term.derivative) for i, term in enumerate(terms)])

    def _derivative(self, states: Floats, p: int) -> Floats:
        parts = [math.comb(p, i) * (-1.0) ** (p - i) * states[:, self.order - i] for i in range(p + 1)]
        return np.asarray(self.cutoff**p * np.sum(parts, axis=0), dtype=np.float64)

    def _filled(self, term: Term) -> Floats:
        if term.derivative > self.order:
            raise InputError(
                f"a filter of order {self.order} knows no derivative {term.derivative}: give a higher order"
            )
        values = numbers(term.values, "the values of a term")
        if values.shape != self.times.shape:
            raise InputError(
                f"a term needs {self.times.size} values, one for each of the times; its shape is {values.shape}"
            )
        there = ~np.isnan(values)
        if not there.any() or not np.isfinite(values[there]).all():
            raise InputError("a term needs finite values, NaN only where a sample is missing, and not throughout")
        if there.all():
            return values
        known = np.concatenate([self.times[:1], self.times[there], self.times[-1:]])
        at = int(np.argmax(np.diff(known)))
        if known[at + 1] - known[at] > max(LONGEST_HOLE / self.cutoff, 2.0 * float(np.diff(self.times).max())):
            raise InputError(
                f"a term has no sample from {known[at]:g} to {known[at + 1]:g} s, which is more than "
                f"{LONGEST_HOLE:g} times the filter's 1/cutoff: leave that part of the record out"
            )
        if term.interpolation == "zoh":
            return np.asarray(pd.Series(values).ffill().bfill(), dtype=np.float64)
        return np.asarray(np.interp(self.times, self.times[there], values[there]), dtype=np.float64)

    def start_terms(self) -> Floats:
        """Return what unknown derivatives at the start may add, tᵏ e^(−λt) of length 1 (K, ≤ m)."""
        phase = self.cutoff * (self.times - self.times[0])
        columns = phase[:, None] ** np.arange(self.order) * np.exp(-phase)[:, None]
        lengths = np.linalg.norm(columns, axis=0)
        return np.asarray(columns[:, lengths > 0] / lengths[lengths > 0], dtype=np.float64)
