"""Methods of identification: by one search, or in a whole box (`fmuid.estimation.global_search`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from numpy.typing import ArrayLike

from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.identification import estimate
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.estimation.search.marquardt import MarquardtSettings
from fmuid.progress import Progress


@runtime_checkable
class Method(Protocol):
    """How the least of a criterion is searched: `Marquardt`, from one start, or `GlobalSearch`, in a whole box."""

    @property
    def marquardt(self) -> Marquardt:
        """The settings of Marquardt's search, with which every method ends."""

    @property
    def whole_box(self) -> bool:
        """Whether the whole box of the bounds is searched, and other optima than the best one are met."""

    def check(self, problem: LeastSquares) -> None:
        """Check, without a simulation, that a problem has what the method needs, such as bounds.

        Raises
        ------
        InputError
            If it has not.
        """

    def search(
        self, evaluator: Evaluator[LeastSquares], progress: Progress | None = None, start: ArrayLike | None = None
    ) -> Result:
        """Search, from a start (N,) where one is given: an earlier result makes a search of the box needless.

        Returns
        -------
        Result
            Also where the search was interrupted: its outcome says so.

        Raises
        ------
        InputError, SimulationError, KeyboardInterrupt
            As `estimate`, or as `check`.
        """


@dataclass(frozen=True)
class Marquardt(MarquardtSettings):
    """Marquardt's search, from one start, and its settings.

    Parameters
    ----------
    max_iterations : int
        Steps tried, accepted or not.
    tolerance : float
        Where to stop: the largest change that is left for any parameter, relative to its magnitude. What is left must
        be small against the standard deviations too (the relative offset of Bates and Watts).
    first_radius : float
        Length of the first step relative to the parameters; smaller is more careful.

    Raises
    ------
    InputError
        If a setting is not positive.

    Examples
    --------
    >>> problem = fmuid.datasets.coil().problem()
    >>> fmuid.identify(problem, fmuid.Marquardt(max_iterations=2)).outcome.value
    'converged'
    """

    @property
    def marquardt(self) -> Marquardt:
        """These settings."""
        return self

    @property
    def whole_box(self) -> bool:
        """False: the search goes down from one start."""
        return False

    def check(self, problem: LeastSquares) -> None:
        """Any problem can be searched."""

    def search(
        self, evaluator: Evaluator[LeastSquares], progress: Progress | None = None, start: ArrayLike | None = None
    ) -> Result:
        """Search as `fmuid.identify` does."""
        return estimate(evaluator, self, progress, start)
