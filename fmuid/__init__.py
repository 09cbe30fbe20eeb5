"""Identify the physical parameters of models packaged as FMUs from tables of measurements.

Everything public is here; what a name needs is imported when the name is first used, so that ``import fmuid`` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fmuid.version import __version__ as __version__

if TYPE_CHECKING:
    from fmuid.alarms import Rule as Rule
    from fmuid.batch import Batch as Batch
    from fmuid.batch import BatchResult as BatchResult
    from fmuid.component import Component as Component
    from fmuid.component import Isolation as Isolation
    from fmuid.component import Numerics as Numerics
    from fmuid.criterion_map import map_criterion as map_criterion
    from fmuid.detectability import Design as Design
    from fmuid.detectability import trial as trial
    from fmuid.diagnosis import diagnose as diagnose
    from fmuid.errors import FmuidError as FmuidError
    from fmuid.errors import InputError as InputError
    from fmuid.errors import ModelicaError as ModelicaError
    from fmuid.errors import SimulationError as SimulationError
    from fmuid.estimators.global_search import GlobalSearch as GlobalSearch
    from fmuid.estimators.global_search import search_globally as search_globally
    from fmuid.estimators.marquardt import Marquardt as Marquardt
    from fmuid.excitation import multisine as multisine
    from fmuid.excitation import prbs as prbs
    from fmuid.excitation import steps as steps
    from fmuid.experiment import Experiment as Experiment
    from fmuid.faults import Angle as Angle
    from fmuid.faults import Fault as Fault
    from fmuid.fmi.archive import FMU as FMU
    from fmuid.identification import identify as identify
    from fmuid.monitoring import Monitor as Monitor
    from fmuid.noise import Noise as Noise
    from fmuid.parameters import JointPrior as JointPrior
    from fmuid.parameters import Normal as Normal
    from fmuid.parameters import Parameter as Parameter
    from fmuid.posterior import Sampling as Sampling
    from fmuid.posterior import sample as sample
    from fmuid.problem import Problem as Problem
    from fmuid.profile import profiles as profiles
    from fmuid.reading import read_result as read_result
    from fmuid.residuals import examine_residuals as examine_residuals
    from fmuid.result import Result as Result
    from fmuid.simulator import Simulator as Simulator
    from fmuid.study import Study as Study
    from fmuid.system import System as System
    from fmuid.tables import read_table as read_table
    from fmuid.transforms import concordia as concordia
    from fmuid.transforms import park as park
    from fmuid.validation import validate as validate
    from fmuid.verdict import Diagnosis as Diagnosis

_HOMES = {
    "Angle": "faults",
    "Batch": "batch",
    "BatchResult": "batch",
    "Component": "component",
    "Design": "detectability",
    "Diagnosis": "verdict",
    "Experiment": "experiment",
    "FMU": "fmi.archive",
    "Fault": "faults",
    "FmuidError": "errors",
    "GlobalSearch": "estimators.global_search",
    "InputError": "errors",
    "Isolation": "component",
    "JointPrior": "parameters",
    "Marquardt": "estimators.marquardt",
    "ModelicaError": "errors",
    "Monitor": "monitoring",
    "Noise": "noise",
    "Normal": "parameters",
    "Numerics": "component",
    "Parameter": "parameters",
    "Problem": "problem",
    "Result": "result",
    "Rule": "alarms",
    "Sampling": "posterior",
    "SimulationError": "errors",
    "Simulator": "simulator",
    "Study": "study",
    "System": "system",
    "concordia": "transforms",
    "diagnose": "diagnosis",
    "examine_residuals": "residuals",
    "identify": "identification",
    "map_criterion": "criterion_map",
    "multisine": "excitation",
    "park": "transforms",
    "prbs": "excitation",
    "profiles": "profile",
    "read_result": "reading",
    "read_table": "tables",
    "sample": "posterior",
    "search_globally": "estimators.global_search",
    "steps": "excitation",
    "trial": "detectability",
    "validate": "validation",
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
