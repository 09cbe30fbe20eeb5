"""Old names of keys and values, refused by their new names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_MODEL = {
    "master": "coupling",
    "integrator": "solver",
    "most_steps": "max_solver_steps",
    "values": "fixed",
    "connectors": "shared_variables",
}
_COMPONENT = {"integrator": "solver", "most_steps": "max_solver_steps", "samples": "discrete_time"}
_NOISE = {"relative": "relative_std", "period": "excitation_period"}
RENAMED_KEYS: Mapping[str, Mapping[str, str]] = {
    "": {"estimator": "estimation"},
    "model": _MODEL,
    "model.components": _COMPONENT,
    "experiments": {"table": "data", "discard": "warmup", "values": "fixed", "prepare": "preprocess"},
    "experiments.noise": _NOISE,
    "experiments.preprocess": {"columns": "computed_columns", "fill": "fill_missing", "longest_gap": "max_gap",
        "axes": "park", "from": "start_time", "to": "end_time", "pieces": "segments", "low_pass": "lowpass_frequency",
        "resample": "resample_interval"},
    "experiments.preprocess.park": {"from": "source", "to": "target", "start": "initial_angle"},
    "parameters.*": {"values": "choices"},
    "parameters.*.prior": {"inflate": "std_factor"},
    "prior": {"inflate": "std_factor"},
    "noise": {**_NOISE, "start": "initial_variance", "common": "shared_variance"},
    "estimation": {"search": "part of method", "starts": "n_starts", "sensitivity": "jacobian",
        "accuracy": "solver_check", "remedies": "restarts", "observer": "observer_memory",
        "tolerance": "relative_step_tolerance", "first_radius": "initial_trust_radius"},
    "uncertainty": {"level": "confidence_level", "profile": "profile_likelihood", "map": "cost_map"},
    "uncertainty.posterior": {"burn": "burn_in", "steps": "max_steps"},
    "diagnosis": {"healthy": "baseline", "inflate": "std_factor", "level": "false_alarm_rate",
        "records": "healthy_data", "trials": "known_fault_data", "model_error": "fault_model_error"},
    "diagnosis.causes": {"gain": "sensor_gain", "offset": "sensor_offset", "delay": "sensor_delay",
        "parameter": "parameter_drift"},
    "diagnosis.causes.*": {"normal": "healthy_std", "size": "change_std"},
    "diagnosis.faults.*": {**_MODEL, "names": "variable_map", "angle": "angles"},
    "diagnosis.faults.*.components": _COMPONENT,
    "diagnosis.faults.*.angles.*": {"size": "magnitude"},
    "monitoring": {"window": "window_length", "transient": "warmup", "level": "false_alarm_rate",
        "horizon": "false_alarm_horizon", "command": "alarm_command", "limits": "size_limits"},
    "batch": {"tables": "data", "starts": "starting_points", "subsets": "free_parameters", "values": "sweep",
        "sample": "space_filling", "noise": "monte_carlo"},
    "batch.space_filling": {"count": "points"},
    "batch.monte_carlo": {"draws": "realizations", "truth": "true_values"},
    "isolation": {"memory": "memory_limit_mb", "recycle": "max_simulations_per_process"},
}  # fmt: skip
"""Of each section, the old names of its keys and the new ones; ``*`` is any name."""

DROPPED_KEYS: Mapping[str, Mapping[str, str]] = {"noise": {"coloured": "confidence intervals allow for colored noise"}}
"""Keys without a new name, and why they are not needed."""

_HOLD = {"hold": "zoh", "hold-previous": "zoh-next", "cubic": "pchip"}
RENAMED_VALUES: Mapping[str, Mapping[str, str]] = {
    "experiments.interpolation": _HOLD,
    "experiments.interpolation.*": _HOLD,
    "experiments.preprocess.fill_missing.*": {"hold": "zoh"},
    "estimation.method": {"marquardt": "levenberg-marquardt", "global": 'multi-start" or "differential-evolution'},
    "estimation.solver_check": {"switch": "refine", "check": "report"},
    "batch.combine": {"list": "zip"},
}
"""Of each key, old values and new ones."""


def refuse_renamed(data: Any, place: Any, path: str = "") -> None:
    """Refuse old keys and values in and below the section `path`."""
    if isinstance(data, list):
        for k, each in enumerate(data):
            refuse_renamed(each, place.below(k), path)
    if not isinstance(data, dict):
        return
    for key, value in data.items():
        if key in RENAMED_KEYS.get(path, {}):
            raise place.below(key).error(f"this key is now {RENAMED_KEYS[path][key]}.")
        if key in DROPPED_KEYS.get(path, {}):
            raise place.below(key).error(f"dropped: {DROPPED_KEYS[path][key]}. Remove it.")
        below = f"{path}.{key}".lstrip(".")
        if below not in _PATHS:
            below = f"{path}.*"
        new = RENAMED_VALUES.get(below, {}).get(value) if isinstance(value, str) else None
        if new is not None:
            raise place.below(key).error(f'"{value}" is now "{new}".')
        if below in _PATHS:
            refuse_renamed(value, place.below(key), below)


_PATHS = {
    ".".join(parts[:k]) for path in (*RENAMED_KEYS, *RENAMED_VALUES) for parts in [path.split(".")]
    for k in range(1, len(parts) + 1)
}  # fmt: skip
