"""Model errors: directions in output space, their tests, and the errors found, as data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar

import numpy as np

from fmuid.array_types import Floats
from fmuid.codec import Layout

LEVEL = 0.01  # false alarms of all directed tests together


@dataclass(frozen=True)
class ModelErrorSettings:
    """Prior odds of model errors."""

    plausible: float = 20.0  # usual sizes: a dead time of 20 % of the voltage, a gain of 20 %, ten samples late
    rare_odds: float = -2.0  # ln of the odds of rare errors, and of sizes that are not plausible


SETTINGS = ModelErrorSettings()


class ErrorKind(Enum):
    """Kind of a model error; ``kind`` in ``result.json``."""

    DELAY = "delay"  # of an output, or of all
    ADVANCE = "advance"  # likewise; a fast path beside the model looks alike
    LAG = "lag"  # a low-pass behind an output
    CLOCK = "clock"  # outputs come later and later
    INPUT_DELAY = "input_delay"
    INPUT_ADVANCE = "input_advance"
    RESPONSE_DELAY = "response_delay"  # of a frequency response: its phase falls with the frequency
    INTERPOLATION = "interpolation"  # an input is held where it was taken as linear, or the other way round
    OFFSET = "offset"
    ZERO_DRIFT = "zero_drift"  # an offset that grows linearly in time
    INPUT_OFFSET = "input_offset"
    GAIN = "gain"
    NONLINEARITY = "nonlinearity"  # the gain of a sensor falls with the square of its output
    HYSTERESIS = "hysteresis"  # an output lacks a constant against the sign of its slope
    INPUT_GAIN = "input_gain"
    JOINT = "joint"  # a resistance in series with a line
    DEAD_TIME = "dead_time"  # an input lacks a constant against the sign of an output
    SATURATION = "saturation"  # a parameter depends on the square of outputs
    STATE_DEPENDENCE = "state_dependence"  # a parameter depends on the square of unmeasured states
    DRIFT = "drift"  # a parameter changes linearly in time
    STEP = "step"  # a parameter changes between the halves of the record
    INITIAL_STATE = "initial_state"
    FIXED = "fixed"  # a fixed parameter has another value
    PRIOR = "prior"  # the mean of a parameter's prior is elsewhere

    @property
    def is_relative(self) -> bool:
        """True if the size is a share, printed in %."""
        return self in _RELATIVE

    @property
    def is_output_delay(self) -> bool:
        """True for errors in the time of an output, or of all."""
        return self in OUTPUT_DELAYS


_RELATIVE = frozenset(
    {
        ErrorKind.GAIN,
        ErrorKind.NONLINEARITY,
        ErrorKind.INPUT_GAIN,
        ErrorKind.SATURATION,
        ErrorKind.STATE_DEPENDENCE,
        ErrorKind.DRIFT,
        ErrorKind.STEP,
        ErrorKind.FIXED,
        ErrorKind.INTERPOLATION,
    }
)


CHANGING = frozenset({ErrorKind.SATURATION, ErrorKind.STATE_DEPENDENCE, ErrorKind.DRIFT, ErrorKind.STEP})
"""Parameters that are none: the estimate is their value where the record sees them."""


OUTPUT_DELAYS = frozenset({ErrorKind.DELAY, ErrorKind.ADVANCE, ErrorKind.LAG, ErrorKind.CLOCK})
"""Errors in the time of an output, or of all."""
DELAYS = (OUTPUT_DELAYS | {ErrorKind.INPUT_DELAY, ErrorKind.INPUT_ADVANCE}) - {ErrorKind.CLOCK}

SENSOR_ERRORS = frozenset(
    {
        *OUTPUT_DELAYS,
        ErrorKind.RESPONSE_DELAY,
        ErrorKind.OFFSET,
        ErrorKind.ZERO_DRIFT,
        ErrorKind.GAIN,
        ErrorKind.NONLINEARITY,
        ErrorKind.HYSTERESIS,
    }
)
"""Errors behind the machine, whose own outputs are without them."""


OF_RECORD = frozenset(
    {
        ErrorKind.CLOCK,
        ErrorKind.ZERO_DRIFT,
        ErrorKind.NONLINEARITY,
        ErrorKind.INITIAL_STATE,
        ErrorKind.FIXED,
        *CHANGING,
    }
)
"""Errors with sizes of one record, by its duration or amplitude; fixed values are corrected in the model."""


UNSURE = frozenset({ErrorKind.ADVANCE, ErrorKind.INPUT_ADVANCE, ErrorKind.CLOCK})
"""Errors of several causes: a path that the model lacks, or a wrong clock; lost samples are no slow clock."""
RARE = frozenset({ErrorKind.CLOCK, ErrorKind.ZERO_DRIFT, ErrorKind.NONLINEARITY, ErrorKind.HYSTERESIS})
"""Errors that are thought of where usual ones explain less."""


ErrorKey = tuple[ErrorKind, tuple[str, ...]]  # kind and subject
Sizes = Mapping[ErrorKey, float]


@dataclass(frozen=True, eq=False)
class Direction:
    """A possible model error.

    Attributes
    ----------
    kind : ErrorKind
    subject : tuple of str
        Outputs, inputs, parameters or states concerned.
    unit : str
        Of its size; "" of a share.
    usual : float
        Usual size, σ.
    one_sided : bool
        True if its size is positive.
    value : float
        Assumed value of a fixed parameter, else NaN.
    column : (n,) array
        Change of the counted samples by one unit; over one experiment (K, n_y).
    prior : (q,) array
        Change of the prior's residual by one unit; empty: none.
    """

    kind: ErrorKind
    subject: tuple[str, ...]
    unit: str
    usual: float
    one_sided: bool = False
    value: float = math.nan
    column: Floats = field(default_factory=lambda: np.zeros(0))
    prior: Floats = field(default_factory=lambda: np.zeros(0))

    json_layout: ClassVar = Layout(omitted={"column", "prior"})

    @property
    def key(self) -> ErrorKey:
        """Kind and subject, which no other direction of a problem has."""
        return self.kind, self.subject


def fixed_values(directions: Iterable[Direction], sizes: Iterable[float]) -> dict[str, float]:
    """Return the fixed parameters among directions, with values corrected by sizes."""
    found = {each.subject[0]: each.value * (1.0 + size) for each, size in zip(directions, sizes, strict=True)}
    return {name: value for name, value in found.items() if math.isfinite(value)}


@dataclass(frozen=True, eq=False)
class DirectedTest:
    """Test of one direction.

    Attributes
    ----------
    direction : Direction
    share : float
        Part of the direction that the parameters leave, 0 to 1.
    score : float
        Normal score of the size; 0 where it cannot be tested.
    probability : float
        Of so large a score by chance among all directions.
    size, std : float
        In the direction's unit.
    detectable : float
        Size that shows in 95 % of records; infinite where it cannot be tested.
    shift : (N,) array
        Shift of the estimates by one unit, in their σ.
    """

    direction: Direction
    share: float
    score: float
    probability: float
    size: float
    std: float
    detectable: float
    shift: Floats

    @property
    def is_testable(self) -> bool:
        """True if the data can show this error."""
        return math.isfinite(self.detectable)

    @property
    def most(self) -> tuple[int, float]:
        """Parameter that moves most, and its shift by one unit, σ."""
        i = int(np.argmax(np.abs(self.shift)))
        return i, abs(float(self.shift[i]))

    @property
    def hidden(self) -> float:
        """Largest shift by an error that does not show, σ."""
        return self.most[1] * self.detectable if self.most[1] else 0.0

    @property
    def log_odds(self) -> float:
        """Odds of such an error and size; interpolation is one or the other, and has a size of 1."""
        if self.direction.kind is ErrorKind.INTERPOLATION:
            return -0.5 * ((self.size - 1.0) / self.std) ** 2
        return SETTINGS.rare_odds * ((self.direction.kind in RARE) + (not self.is_plausible))

    @property
    def evidence(self) -> float:
        """Gain of 2 ln L, with the odds of the error."""
        return self.score**2 + 2.0 * self.log_odds

    @property
    def is_plausible(self) -> bool:
        """True if an error has such a size."""
        return abs(self.size) <= SETTINGS.plausible * self.direction.usual


@dataclass(frozen=True, eq=False)
class ModelError:
    """A significant model error.

    Attributes
    ----------
    test : DirectedTest
        Beside the errors found before.
    alternatives : tuple of Direction
        Directions that explain as much.
    settled : bool
        False if its refits did not settle: it is not linear in its size.
    """

    test: DirectedTest
    alternatives: tuple[Direction, ...] = ()
    settled: bool = True

    @property
    def kinds(self) -> frozenset[ErrorKind]:
        """Kinds of the error and its alternatives."""
        return frozenset(each.kind for each in (self.test.direction, *self.alternatives))

    @property
    def may_be_freed(self) -> bool:
        """False if a prior explains as much: a conflict of prior and data changes no interval."""
        return ErrorKind.PRIOR not in self.kinds

    @property
    def is_explained(self) -> bool:
        """True if its size is sure, and its name says the cause."""
        return self.settled and not self.kinds & UNSURE


@dataclass(frozen=True)
class ProcessNoise:
    """Disturbance that explains colored residuals.

    Attributes
    ----------
    states : tuple of str
        The disturbed state; further ones explain the residuals as well.
    share : float
        Of the residuals' variance.
    """

    states: tuple[str, ...]
    share: float


@dataclass(frozen=True)
class Feedback:
    """An input that follows the residual.

    Attributes
    ----------
    input, experiment : str
    probability : float
        By chance.
    """

    input: str
    experiment: str
    probability: float


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """Directed tests of a result.

    Attributes
    ----------
    names : tuple of str
        Parameters.
    tests : tuple of DirectedTest
        Of all directions beside the parameters alone.
    errors : tuple of ModelError
        Significant errors, the strongest first.
    level : float
        False-alarm rate of all tests together.
    freed : tuple of ModelError
        Errors that are parameters of the result; the tests are beside them.
    covariance : (m, N + m) array
        Of the freed sizes with the estimates and with each other.
    interval : float
        Between samples, s: delays are in samples.
    process_noise : ProcessNoise or None
        Disturbance that explains the color of the residuals.
    feedback : Feedback or None
        An input that follows the residual; where it does beside freed errors, too, they have no names.
    """

    names: tuple[str, ...]
    tests: tuple[DirectedTest, ...]
    errors: tuple[ModelError, ...] = ()
    level: float = LEVEL
    freed: tuple[ModelError, ...] = ()
    process_noise: ProcessNoise | None = None
    feedback: Feedback | None = None
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    interval: float = math.nan

    @property
    def exposures(self) -> tuple[DirectedTest, ...]:
        """Tests, by the largest shift that the usual size makes."""
        return tuple(sorted(self.tests, key=lambda each: -each.most[1] * each.direction.usual))

    @property
    def corrected(self) -> dict[str, float]:
        """Fixed values as freed errors correct them; the estimates hold with these."""
        return fixed_values([each.test.direction for each in self.freed], [each.test.size for each in self.freed])

    @property
    def covers_dynamics(self) -> bool:
        """True if inputs, parameters and states were tested, too; a response holds both of its channels."""
        return any(each.direction.kind in (ErrorKind.DRIFT, ErrorKind.RESPONSE_DELAY) for each in self.tests)
