"""Verdict on a result: a grade and its reasons, as data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar

from fmuid.codec import Layout


class Grade(Enum):
    """Grade of a result; ``verdict.grade`` in ``result.json``."""

    PASSED = "passed"  # no check failed
    DOUBTFUL = "doubtful"  # a check failed: estimates or intervals may be wrong
    NOT_USABLE = "not_usable"  # no estimates, or not of the parameters that were asked for


class Reason(Enum):
    """Reason against `Grade.PASSED`, the gravest first."""

    INTERRUPTED = "interrupted"
    CONVENTION = "convention"  # a response fits with another sign or unit
    NOT_CONVERGED = "not_converged"
    NON_IDENTIFIABLE = "non_identifiable"
    BETTER_OPTIMUM = "better_optimum"  # on a profile or a cost map
    POOR_FIT = "poor_fit"  # NRMSE fit of an output below `MIN_FIT`
    LARGE_RESIDUAL = "large_residual"  # beside the noise level of the data, from all starting points
    SOLVER_UNCHECKED = "solver_unchecked"
    SOLVER_ERROR = "solver_error"  # added to σ
    FEEDBACK = "feedback"  # inputs follow the residual: a closed loop, or outputs ahead of them
    MODEL_ERROR = "model_error"  # named by a directed test
    DATA_DEFECT = "data_defect"  # of a recorded output
    EXPERIMENTS_CONFLICT = "experiments_conflict"  # estimates of one and of the others differ
    PRIOR_DATA_CONFLICT = "prior_data_conflict"
    NOISE_LEVEL = "noise_level"  # of the residual, beside the given one
    INPUT_CORRELATION = "input_correlation"
    COLORED_RESIDUAL = "colored_residual"
    PERIODIC_ERROR = "periodic_error"
    LOW_FREQUENCY_NOISE = "low_frequency_noise"
    LONG_MEMORY = "long_memory"  # noise too slow for its recording
    OFFSET = "offset"
    DISTRIBUTION = "distribution"  # not normal: outliers, or lopsided
    AT_BOUND = "at_bound"
    WEAKLY_IDENTIFIABLE = "weakly_identifiable"
    PRIOR_DOMINATED = "prior_dominated"
    SECOND_OPTIMUM = "second_optimum"
    NONLINEAR = "nonlinear"  # between prior and data
    OBSERVER = "observer"  # noise biases a fit of predictions
    SAMPLING = "sampling"  # posterior samples without convergence
    MISSING_ROWS = "missing_rows"
    ACQUISITION_DELAY = "acquisition_delay"  # the unknown delay within ±½ sample dominates σ

    @property
    def grade(self) -> Grade:
        """Best grade that the reason allows."""
        return Grade.NOT_USABLE if self in _FATAL else Grade.DOUBTFUL


_FATAL = frozenset(
    {
        Reason.INTERRUPTED,
        Reason.CONVENTION,
        Reason.NOT_CONVERGED,
        Reason.NON_IDENTIFIABLE,
        Reason.BETTER_OPTIMUM,
    }
)


@dataclass(frozen=True)
class Doubt:
    """A reason with its subject and values.

    Attributes
    ----------
    reason : Reason
    subject : tuple of str
        Parameters, outputs, inputs or experiments concerned.
    values : mapping of str to float
        Numbers of its message.
    alternatives : tuple of tuple of str
        Kind and subject of model errors that explain the data as well.
    """

    reason: Reason
    subject: tuple[str, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    alternatives: tuple[tuple[str, ...], ...] = ()

    @property
    def is_fatal(self) -> bool:
        """True if the result is not usable for this reason."""
        return self.reason.grade is Grade.NOT_USABLE


@dataclass(frozen=True)
class Verdict:
    """Grade of a result with its reasons.

    Attributes
    ----------
    doubts : tuple of Doubt
        The gravest first; empty if passed.
    freed : tuple of Doubt
        Model errors that are parameters of the result; a delay within ±½ sample where it dominates σ.

    Examples
    --------
    >>> Verdict.of([Doubt(Reason.OFFSET, ("y",)), Doubt(Reason.NOT_CONVERGED)]).grade
    <Grade.NOT_USABLE: 'not_usable'>
    """

    doubts: tuple[Doubt, ...] = ()
    freed: tuple[Doubt, ...] = ()

    json_layout: ClassVar = Layout(derived=("grade",))

    @classmethod
    def of(cls, doubts: Iterable[Doubt], freed: Iterable[Doubt] = ()) -> Verdict:
        """Return the verdict of doubts in any order."""
        order = list(Reason)
        return cls(tuple(sorted(doubts, key=lambda each: order.index(each.reason))), tuple(freed))

    @property
    def grade(self) -> Grade:
        """Grade of the gravest reason."""
        return self.doubts[0].reason.grade if self.doubts else Grade.PASSED

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """All reasons, each once."""
        return tuple(dict.fromkeys(each.reason for each in self.doubts))
