"""Old names of keys and values, refused by their new names."""

from __future__ import annotations

from collections.abc import Container, Mapping

from fmuid.studies.toml import show

RENAMED_KEYS: Mapping[str, tuple[str, ...]] = {
    "accuracy": ("solver_check",), "angle": ("angles",), "axes": ("park",), "burn": ("burn_in",),
    "columns": ("computed_columns",), "command": ("alarm_command",), "common": ("shared_variance",),
    "connectors": ("shared_variables",), "count": ("points",), "delay": ("sensor_delay",), "discard": ("warmup",),
    "draws": ("realizations",), "estimator": ("estimation",), "fill": ("fill_missing",),
    "first_radius": ("initial_trust_radius",), "from": ("start_time", "source"), "gain": ("sensor_gain",),
    "healthy": ("baseline",), "horizon": ("false_alarm_horizon",), "inflate": ("std_factor",),
    "integrator": ("solver",), "level": ("confidence_level", "false_alarm_rate"), "limits": ("size_limits",),
    "longest_gap": ("max_gap",), "low_pass": ("lowpass_frequency",), "map": ("cost_map",), "master": ("coupling",),
    "memory": ("memory_limit_mb",), "model_error": ("fault_model_error",), "most_steps": ("max_solver_steps",),
    "names": ("variable_map",), "noise": ("monte_carlo",), "normal": ("healthy_std",), "observer": ("observer_memory",),
    "offset": ("sensor_offset",), "parameter": ("parameter_drift",), "period": ("excitation_period",),
    "pieces": ("segments",), "prepare": ("preprocess",), "profile": ("profile_likelihood",),
    "records": ("healthy_data",), "recycle": ("max_simulations_per_process",), "relative": ("relative_std",),
    "remedies": ("restarts",), "resample": ("resample_interval",), "sample": ("space_filling",),
    "samples": ("discrete_time",), "search": ("method",), "sensitivity": ("jacobian",),
    "size": ("change_std", "magnitude"), "start": ("initial_variance", "initial_angle"),
    "starts": ("n_starts", "starting_points"), "steps": ("max_steps",), "subsets": ("free_parameters",),
    "table": ("data",), "tables": ("data",), "to": ("end_time", "target"), "tolerance": ("relative_step_tolerance",),
    "transient": ("warmup",), "trials": ("known_fault_data",), "truth": ("true_values",),
    "values": ("fixed", "choices", "sweep"), "window": ("window_length",),
}  # fmt: skip
"""Old names of keys and their new names in one section or another."""
RENAMED_VALUES: Mapping[str, tuple[str, ...]] = {
    "hold": ("zoh",), "hold-previous": ("zoh-next",), "cubic": ("pchip",), "marquardt": ("levenberg-marquardt",),
    "global": ("multi-start", "differential-evolution"), "switch": ("refine",), "check": ("report",), "list": ("zip",),
}  # fmt: skip
"""Old values and their new ones."""
DROPPED_KEYS = {"coloured": "confidence intervals allow for colored noise"}
"""Keys without a new name, and why they are not needed."""


def renamed_key(key: str, known: Container[str]) -> str | None:
    """Return the message on an old key of a section, else None."""
    if key in DROPPED_KEYS:
        return f"{key!r} was dropped: {DROPPED_KEYS[key]}. Remove it."
    new = next((each for each in RENAMED_KEYS.get(key, ()) if each in known), None)
    return None if new is None else f"{key!r} is now {new!r}."


def renamed_value(value: object, known: Container[str]) -> str | None:
    """Return the message on an old value of a key, else None."""
    new = [each for each in RENAMED_VALUES.get(value, ()) if each in known] if isinstance(value, str) else []
    return f'"{value}" is now {" or ".join(map(show, new))}.' if new else None
