"""Results made up for tests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.codec import as_json
from fmuid.estimation import RESULT_SCHEMA
from fmuid.estimation.problem import LeastSquares
from fmuid.estimation.result import Result
from fmuid.identification import identify

RESULT = {"schema": RESULT_SCHEMA}


def result(folder: Path, values: dict[str, tuple[float, float | None]], **changes: Any) -> Path:
    """Write a result.json with these values and standard deviations, None where undetermined, and return its path."""
    variances = ["inf" if std is None else std**2 for _, std in values.values()]
    rest = {"start": 1.0, "lower": "-inf", "upper": "inf", "degrees_of_freedom": "inf"}
    matrix = [[v if i == j else 0.0 for j in range(len(variances))] for i, v in enumerate(variances)]
    content: dict[str, Any] = {
        "outcome": "converged",
        "parameters": {
            name: {"value": v, "std": "inf" if std is None else std, **rest} for name, (v, std) in values.items()
        },
        "covariance": {"names": list(values), "matrix": matrix, "white": matrix},
        "noise_variance": {"i": 1.0},
        "given_variance": {},
        "criterion": 1.0,
        "log_likelihood": None,
        "degrees_of_freedom": "inf",
        **{"iterations": 3, "simulations": 9, "elapsed_s": 0.1, "version": "0"},
        **{"undetermined": [], "weak": [], "prior_determined": [], "at_bounds": []},
        "models": {"": {"name": "Coil", "digest": "0"}},
    }
    path = folder / "result.json"
    path.write_text(json.dumps(RESULT | content | as_json(changes)))
    return path


def identify_white(problem: LeastSquares, *arguments: Any, **words: Any) -> Result:
    """Identify, and take the noise for white: what closed forms of textbooks are compared with."""
    return as_white(identify(problem, *arguments, **words))


def as_white(result: Result) -> Result:
    """Return a result whose noise is taken for white."""
    freedom = np.full(len(result.names), result.degrees_of_freedom)
    return replace(result, covariance=result.white_covariance, freedom=freedom)
