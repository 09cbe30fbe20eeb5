"""Identify the physical parameters of models packaged as FMUs from tables of measurements.

Everything public is here; what a name needs is imported when the name is first used, so that ``import fmuid`` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmuid.errors import FmuidError as FmuidError
    from fmuid.errors import InputError as InputError
    from fmuid.errors import ModelicaError as ModelicaError
    from fmuid.errors import SimulationError as SimulationError
    from fmuid.experiment import Experiment as Experiment
    from fmuid.fmi.archive import FMU as FMU
    from fmuid.identification import identify as identify
    from fmuid.noise import Noise as Noise
    from fmuid.parameters import JointPrior as JointPrior
    from fmuid.parameters import Normal as Normal
    from fmuid.parameters import Parameter as Parameter
    from fmuid.problem import Problem as Problem
    from fmuid.result import Result as Result
    from fmuid.simulator import Simulator as Simulator
    from fmuid.study import Study as Study
    from fmuid.system import System as System
    from fmuid.tables import read_table as read_table
    from fmuid.transforms import concordia as concordia
    from fmuid.transforms import park as park

__version__ = "0.1.0"

_HOMES = {
    "Experiment": "experiment",
    "FMU": "fmi.archive",
    "FmuidError": "errors",
    "InputError": "errors",
    "JointPrior": "parameters",
    "ModelicaError": "errors",
    "Noise": "noise",
    "Normal": "parameters",
    "Parameter": "parameters",
    "Problem": "problem",
    "Result": "result",
    "SimulationError": "errors",
    "Simulator": "simulator",
    "Study": "study",
    "System": "system",
    "concordia": "transforms",
    "identify": "identification",
    "park": "transforms",
    "read_table": "tables",
}
"""The module below this one that each public name comes from."""

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
