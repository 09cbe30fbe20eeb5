"""Linear problems whose posterior is known, sampled."""

from typing import Any

import numpy as np
import numpy.typing as npt

from fmuid import Parameter, Result, sample_posterior
from fmuid.estimation import LeastSquares
from fmuid.identification import Posterior, SamplerSettings
from tests.support.results import identify_white as identify

Array = npt.NDArray[np.float64]


def linear(samples: int = 30, **words: Any) -> tuple[LeastSquares, Array]:
    """Return a problem linear in two parameters, and its regressors."""
    rng = np.random.default_rng(5)
    phi = rng.normal([1.0, 0.0], 1.0, (samples, 2))
    measured = phi @ [2.0, -0.3] + 0.7 * rng.normal(size=samples)
    parameters = words.pop("parameters", {"a": Parameter(1.0), "b": Parameter(1.0)})
    return LeastSquares.from_function(lambda theta: phi @ theta, measured, parameters, **words), phi


def sampled(problem: LeastSquares, **settings: Any) -> tuple[Posterior, Result]:
    result = identify(problem)
    return sample_posterior(problem, result, SamplerSettings(**settings)), result
