"""Experiments by the variables of a model."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from fmuid import Experiment


def record(
    times: ArrayLike,
    inputs: Mapping[str, ArrayLike],
    outputs: Sequence[str] | Mapping[str, ArrayLike],
    interpolation: Any = "zoh",
    **more: Any,
) -> Experiment:
    """Return an experiment whose columns are named as its variables; outputs without values are zero."""
    measured = outputs if isinstance(outputs, Mapping) else dict.fromkeys(outputs, 0.0)
    frame = pd.DataFrame({"time": np.asarray(times, float), **inputs, **measured})
    return Experiment(frame, tuple(inputs), tuple(measured), interpolation=interpolation, **more)
