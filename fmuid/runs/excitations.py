"""Excitations compared by what they promise for a study: accuracy, or the smallest fault that they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from fmuid.data import Experiment, record_files
from fmuid.errors import InputError
from fmuid.identification import SensitivityFunctions, expected_accuracy, rank_excitations, sensitivity_functions
from fmuid.runs.faults import design_of
from fmuid.studies import Study


def ranked_excitations(
    study: Study, tables: Sequence[Path], *, by: str = "determinant", fault: str | None = None
) -> pd.DataFrame:
    """Compare excitations for a study: one row each, the best first.

    Parameters
    ----------
    study : Study
        Its model, the words of its first experiment, the starts of its parameters, their priors, and its noise.
    tables : sequence of Path
        Tables of inputs, and folders of them.
    by : "determinant" or "worst"
        By the accuracy of the estimates (`fmuid.identification.rank_excitations`).
    fault : str, optional
        By the smallest size of this fault that is found (`fmuid.Design`).

    Raises
    ------
    InputError
        If the study has no parameters, no such fault or does not say its noise, or a table does not fit.
    SimulationError
        If a simulation fails.
    """
    words = study.experiments[0]
    candidates = {path.stem: _excitation(study, path) for path in record_files(tables)}
    if fault is not None:
        return design_of(study, fault).rank(candidates)
    study.check_parameters()
    variance = study.known_variance
    for name in words.outputs:
        if name not in variance:
            raise InputError(
                f"{study.path} does not say how large the noise of {name!r} is: give its variance under [noise]"
            )
    parameters = {name: replace(each, per_experiment=False) for name, each in study.parameters.items()}
    values = study.model.values
    found = [expected_accuracy(study.system, each, parameters, variance, values) for each in candidates.values()]
    return rank_excitations(found, by=by)


def healthy_record_cost(study: Study, tables: Sequence[Path], fault: str, excitation: str) -> pd.DataFrame:
    """Return what healthy records of several lengths cost a test for a fault (`fmuid.Design.cost`).

    Parameters
    ----------
    study : Study
    tables : sequence of Path
        Tables of inputs, and folders of them.
    fault : str
    excitation : str
        The name of one of the tables, that of the test.

    Raises
    ------
    InputError
        If the study has no such fault, or the table does not fit.
    SimulationError
        If a simulation fails.
    """
    (path,) = (each for each in record_files(tables) if each.stem == excitation)
    return design_of(study, fault).cost(_excitation(study, path))


def _excitation(study: Study, path: Path) -> Experiment:
    """Read a table of inputs with the words of the study's first experiment."""
    words = study.experiments[0].model_copy(update={"name": path.stem})
    return words.read_experiment(path, measured=False)


def sensitivities_of(study: Study) -> tuple[SensitivityFunctions, ...]:
    """Return the normalised sensitivities (1.33) over every experiment of a study, at the parameters' starts.

    Raises
    ------
    InputError
        If the study has no parameters.
    SimulationError
        If a simulation fails.
    """
    study.check_parameters()
    parameters = {name: replace(each, per_experiment=False) for name, each in study.parameters.items()}
    return tuple(sensitivity_functions(study.system, each, parameters, study.model.values) for each in study.tables)
