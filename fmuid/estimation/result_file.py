"""Write a result as ``result.json``, and read it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.array_types import Floats
from fmuid.data import MeasuredSeries
from fmuid.estimation.covariance import ActiveBound, WeakDirection
from fmuid.estimation.marquardt.outcome import TerminationReason
from fmuid.estimation.model_sensitivities import SensitivityMethod
from fmuid.estimation.saved.check import check_types
from fmuid.estimation.saved.schema import ResultContent
from fmuid.estimation.solver_check.outcome import SolverCheck
from fmuid.estimation.starting_points.outcome import CombinationFit, RestartAttempt
from fmuid.files import ContentError, as_json, content_of
from fmuid.formatting import with_std

# Parameters that a result names where it is printed in a line.
LINE_PARAMETERS = 8
_AS_THEY_ARE = (
    *("noise_variance", "given_variance", "criterion", "log_likelihood", "degrees_of_freedom", "iterations"),
    *("simulations", "elapsed_s", "undetermined", "weak", "prior_determined", "at_bounds", "version", "models"),
    *("sensitivity", "moved_start", "data", "attempts", "combinations", "observer"),
)


def line(result: Any) -> str:
    """Return a `fmuid.Result` in a line, of many parameters the first ones."""
    pairs = zip(result.names, result.values.tolist(), result.std.tolist(), strict=True)
    told = [f"{name} = {with_std(value, std)}" for name, value, std in pairs]
    more = f", {len(told) - LINE_PARAMETERS} more" if len(told) > LINE_PARAMETERS else ""
    return f"Result({result.outcome.value}: {', '.join(told[:LINE_PARAMETERS])}{more})"


def content(result: Any) -> dict[str, Any]:
    """Return what ``result.json`` has of a `fmuid.Result`, which imports this; what is not a finite number is None."""
    columns = {
        "value": result.values,
        "std": result.std,
        "white_std": result.white_std,
        "degrees_of_freedom": result.freedom,
        "start": result.start,
        "min": result.lower,
        "max": result.upper,
        "numerical_shift": result.numerical_shift,
        "prior_mean": result.prior_mean,
        "prior_std": result.prior_std,
        "pull": result.pull,
    }
    without_prior = list(columns)[:8]
    parameters = {
        name: {key: columns[key][i] for key in (without_prior if math.isnan(result.prior_mean[i]) else columns)}
        | ({"unit": result.units[name]} if name in result.units else {})
        for i, name in enumerate(result.names)
    }
    accuracy = None if result.accuracy is None else {**vars(result.accuracy)}
    if accuracy is not None:
        del accuracy["shift"]  # each parameter has its own
    found: dict[str, Any] = as_json(
        {
            "outcome": result.outcome,
            "converged": result.converged,
            "parameters": parameters,
            "covariance": {"names": result.names, "matrix": result.covariance, "white": result.white_covariance},
            **{key: getattr(result, key) for key in _AS_THEY_ARE},
            "accuracy": accuracy,
        }
    )
    return found


def read(path: Path) -> dict[str, Any]:
    """Return the fields of a `Result` that a ``result.json`` has.

    Raises
    ------
    InputError
        If the file cannot be read or is not such a result.
    """
    with content_of(path, "the result.json of an identification", "run fmuid identify again") as data:
        return _fields(data)


def _fields(data: Mapping[str, Any]) -> dict[str, Any]:
    check_types(data, ResultContent)
    parameters = data["parameters"]
    names = tuple(parameters)
    column = {
        key: _array([parameters[name].get(key) for name in names], np.nan)
        for key in ("value", "start", "prior_mean", "prior_std", "numerical_shift")
    }
    if any(found.shape != (len(names),) for found in column.values()):
        raise ContentError("a value of a parameter is no number")
    if list(names) != data["covariance"]["names"]:
        raise ContentError("the names of parameters and covariance differ")
    outcome = TerminationReason(data["outcome"])
    matrix = data["covariance"]["matrix"]
    covariance = _covariance(matrix, names, outcome)
    white = _covariance(data["covariance"].get("white", matrix), names, outcome)
    each = [parameters[name].get("degrees_of_freedom", data.get("degrees_of_freedom")) for name in names]
    bounds = {
        key: _array([parameters[name].get(key) for name in names], none)
        for key, none in (("min", -np.inf), ("max", np.inf))
    }
    return {
        "outcome": outcome,
        "names": names,
        "values": column["value"],
        "start": column["start"],
        "lower": bounds["min"],
        "upper": bounds["max"],
        "prior_mean": column["prior_mean"],
        "prior_std": column["prior_std"],
        "covariance": covariance,
        "white_covariance": white,
        "freedom": _array(each, np.inf),
        "noise_variance": _floats(data["noise_variance"]),
        "given_variance": _floats(data.get("given_variance", {})),
        "criterion": _number(data["criterion"], math.nan),
        "log_likelihood": _number(data.get("log_likelihood"), math.nan),
        "degrees_of_freedom": _number(data.get("degrees_of_freedom"), math.inf),
        "iterations": int(data["iterations"]),
        "simulations": int(data["simulations"]),
        "elapsed_s": float(data["elapsed_s"]),
        "undetermined": tuple(map(WeakDirection.of_json, data.get("undetermined", ()))),
        "weak": tuple(map(WeakDirection.of_json, data.get("weak", ()))),
        "prior_determined": tuple(map(WeakDirection.of_json, data.get("prior_determined", ()))),
        "at_bounds": tuple(ActiveBound(str(b["name"]), float(b["value"])) for b in data.get("at_bounds", ())),
        "version": str(data["version"]),
        "models": {
            str(c): {"name": str(m.get("name", "")), "digest": str(m.get("digest", "")), "run": dict(m.get("run", {}))}
            for c, m in data.get("models", {}).items()
        },
        "sensitivity": SensitivityMethod(**data["sensitivity"]) if data.get("sensitivity") else None,
        "moved_start": tuple(map(str, data.get("moved_start", ()))),
        "accuracy": SolverCheck.of_json(data["accuracy"], column["numerical_shift"]) if data.get("accuracy") else None,
        "data": tuple(map(MeasuredSeries.of_json, data.get("data", ()))),
        "attempts": tuple(map(RestartAttempt.of_json, data.get("attempts", ()))),
        "combinations": tuple(map(CombinationFit.of_json, data.get("combinations", ()))),
        "observer": None if data.get("observer") is None else float(data["observer"]),
        "units": {name: str(parameters[name]["unit"]) for name in names if parameters[name].get("unit")},
    }


def _number(value: float | None, missing: float) -> float:
    return missing if value is None else float(value)


def _covariance(rows: Any, names: tuple[str, ...], outcome: TerminationReason) -> Floats:
    matrix = _array(rows, np.nan).reshape(len(names), len(names))
    if (np.diag(matrix) < 0).any():
        raise ContentError("a variance is negative")
    lost = np.isnan(np.diag(matrix))
    matrix[lost, lost] = np.nan if outcome is TerminationReason.STALLED else np.inf
    return matrix


def _floats(values: Any) -> dict[str, float]:
    return {str(name): float(value) for name, value in values.items()}


def _array(values: Any, missing: float) -> Floats:
    filled = np.array(values, dtype=object)
    return np.where(filled == None, missing, filled).astype(np.float64)  # noqa: E711
