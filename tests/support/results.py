"""Results made up for tests."""

import dataclasses
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmuid import Result
from fmuid.array_types import Floats
from fmuid.codec import as_json
from fmuid.estimation import (
    RESULT_SCHEMA,
    Estimates,
    Fit,
    History,
    Identifiability,
    LeastSquares,
    Setup,
    TerminationReason,
)
from fmuid.identification import identify

RESULT = {"schema": RESULT_SCHEMA}


def result(folder: Path, values: dict[str, tuple[float, float | None]], **changes: Any) -> Path:
    """Write a result.json with these values and standard deviations, None where undetermined, and return its path."""
    variances = ["inf" if std is None else std**2 for _, std in values.values()]
    rest = {"start": 1.0, "lower": "-inf", "upper": "inf", "variance_dof": "inf"}
    matrix = [[v if i == j else 0.0 for j in range(len(variances))] for i, v in enumerate(variances)]
    content: dict[str, Any] = {
        "outcome": "converged",
        "parameters": {
            name: {"value": v, "std": "inf" if std is None else std, **rest} for name, (v, std) in values.items()
        },
        "covariance": {"names": list(values), "matrix": matrix, "white_noise": matrix},
        "fit": {"cost": 1.0, "log_likelihood": None, "degrees_of_freedom": "inf", "noise_variance": {"i": 1.0}}
        | {"given_variance": {}},
        "identifiability": {},
        "history": {"iterations": 3, "simulations": 9, "elapsed_s": 0.1},
        "setup": {"version": "0", "models": {"": {"name": "Coil", "digest": "0"}}},
    }
    path = folder / "result.json"
    for group in (content["fit"], content["setup"]):
        group |= {key: changes.pop(key) for key in [*changes] if key in group}
    path.write_text(json.dumps(RESULT | content | as_json(changes)))
    return path


def made_up(names: tuple[str, ...], values: Floats, start: Floats, covariance: Floats, **groups: Any) -> Result:
    """Return a converged result without bounds, priors and data; output i has a given variance of 1."""
    free, none = np.full(len(names), np.inf), np.full(len(names), np.nan)
    found = Estimates(names, values, start, -free, free, none, none, covariance, covariance, free)
    fit = Fit(10.0, 0.0, math.inf, {}, {"i": 1.0})
    weak = groups.pop("identifiability", Identifiability())
    return Result(TerminationReason.CONVERGED, found, fit, weak, History(3, 9, 0.1), Setup("0"), **groups)


def identify_white(problem: LeastSquares, *arguments: Any, **words: Any) -> Result:
    """Identify, and take the noise for white: what closed forms of textbooks are compared with."""
    return as_white(identify(problem, *arguments, **words))


def as_white(result: Result) -> Result:
    """Return a result whose noise is taken for white."""
    freedom = np.full(len(result.names), result.fit.degrees_of_freedom)
    return changed(result, covariance=result.estimates.covariance_white_noise, variance_dof=freedom)


def changed(result: Result, **fields: Any) -> Result:
    """Return a result with other values of some fields of its groups."""
    for name in ("estimates", "fit", "identifiability", "history", "setup"):
        group: Any = getattr(result, name)
        own = {each.name: fields.pop(each.name) for each in dataclasses.fields(group) if each.name in fields}
        result = replace(result, **{name: replace(group, **own)})
    return replace(result, **fields)
