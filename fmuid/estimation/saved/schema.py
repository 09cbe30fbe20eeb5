"""Types of the values in a ``result.json``, as far as a `fmuid.Result` reads them."""

from __future__ import annotations

from typing import NotRequired

from typing_extensions import TypedDict  # pydantic asks for it up to Python 3.11

Number = float | None
"""None stands for a number that is not finite."""


class ParameterContent(TypedDict, total=False):
    """Estimate of one parameter."""

    value: Number
    std: Number
    white_std: Number
    degrees_of_freedom: Number
    start: Number
    min: Number
    max: Number
    numerical_shift: Number
    prior_mean: Number
    prior_std: Number
    pull: Number
    unit: str | None


class CovarianceContent(TypedDict, total=False):
    """Covariance of all parameters."""

    names: list[str]
    matrix: list[list[Number]]
    white: list[list[Number]]


class DirectionContent(TypedDict, total=False):
    """A `fmuid.estimation.covariance.WeakDirection`."""

    determined: str
    names: list[str]
    coefficients: list[float]
    values: list[float]
    magnitudes: list[float]
    std: Number


class BoundContent(TypedDict, total=False):
    """A `fmuid.estimation.covariance.ActiveBound`."""

    name: str
    value: float


class RunContent(TypedDict):
    """The fields of a `fmuid.models.SolverConfiguration`, and no others."""

    __pydantic_config__ = {"extra": "forbid"}  # type: ignore[misc]  # noqa: RUF012

    fmi_version: str
    interface: str
    integrator: str | None
    stiff: bool
    tolerance: Number
    step_size: Number
    divisor: NotRequired[int]
    new_processes: NotRequired[bool]


class ModelContent(TypedDict, total=False):
    """An FMU."""

    name: str
    digest: str
    run: RunContent


class SensitivityContent(TypedDict, total=False):
    """A `fmuid.estimation.model_sensitivities.SensitivityMethod`."""

    method: str
    by_differences: bool
    refusal: str


class SwitchContent(TypedDict, total=False):
    """A `fmuid.estimation.solver_check.outcome.RefinementStep`."""

    cause: str
    size: Number
    before: dict[str, RunContent]
    after: dict[str, RunContent]
    simulations: int


class AccuracyContent(TypedDict, total=False):
    """A `fmuid.estimation.solver_check.outcome.SolverCheck`."""

    outcome: str
    used: dict[str, RunContent]
    finer: dict[str, RunContent]
    change: Number
    kept: str | None
    switches: list[SwitchContent]
    refused: int
    simulations: int
    tolerance: Number
    divisor: int


class SeriesContent(TypedDict, total=False):
    """A `fmuid.data.MeasuredSeries`."""

    experiment: str
    output: str
    unit: str
    samples: int
    digest: str


class AttemptContent(TypedDict, total=False):
    """A `fmuid.estimation.starting_points.outcome.RestartAttempt`."""

    remedy: str
    trouble: str
    noise_ratio: Number
    simulations: int
    kept: bool


class ChoiceContent(TypedDict, total=False):
    """A `fmuid.estimation.starting_points.outcome.CombinationFit`."""

    values: dict[str, bool | int | float | str]
    outcome: str | None
    behind: Number
    estimates: dict[str, float]


class ResultContent(TypedDict, total=False):
    """A `fmuid.Result`."""

    outcome: str
    converged: bool
    parameters: dict[str, ParameterContent]
    covariance: CovarianceContent
    noise_variance: dict[str, float]
    given_variance: dict[str, float]
    criterion: Number
    log_likelihood: Number
    degrees_of_freedom: Number
    iterations: int
    simulations: int
    elapsed_s: float
    undetermined: list[DirectionContent]
    weak: list[DirectionContent]
    prior_determined: list[DirectionContent]
    at_bounds: list[BoundContent]
    version: str
    models: dict[str, ModelContent]
    sensitivity: SensitivityContent | None
    moved_start: list[str]
    data: list[SeriesContent]
    attempts: list[AttemptContent]
    combinations: list[ChoiceContent]
    observer: Number
    accuracy: AccuracyContent | None
