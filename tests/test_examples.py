"""Every public name has an example in its docstring, and the examples give what they say.

They may take `fmuid`, `np` and `pd` for granted, and run in a folder of their own.
"""

import doctest
import inspect
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid

NAMES = sorted(name for name in set(dir(fmuid)) - {"__version__"} if not inspect.ismodule(getattr(fmuid, name)))
# They start processes of their own, or do a whole study and more.
SLOW = {"Batch", "BatchResult", "IdentificationRun", "SamplerSettings", "validate"}


def examples(name: str, found: object) -> list[doctest.DocTest]:
    """Return the examples of a class or function, those of a class's methods too."""
    known = {"fmuid": fmuid, "np": np, "pd": pd}
    return [each for each in doctest.DocTestFinder().find(found, name, globs=known) if each.examples]


SIGNALS = [name for name, each in inspect.getmembers(fmuid.signals, inspect.isfunction)
           if each.__module__ == fmuid.signals.__name__ and not name.startswith("_")]  # fmt: skip
NAMESPACES = [
    *((fmuid, name) for name in NAMES),
    *((fmuid.datasets, name) for name in fmuid.datasets.__all__),
    *((fmuid.signals, name) for name in SIGNALS),
    *((fmuid.data, name) for name in ("Observation", "ParkTransform", "preprocess")),
    *((fmuid.diagnosis, name) for name in ("DiagnosisSettings", "FaultAngle", "planned_experiment")),
    *((fmuid.estimation, name) for name in ("LeastSquares", "LinearEstimate", "Term", "equation_error")),
    *((fmuid.estimation, name) for name in ("instrumental_variables", "linear_least_squares")),
    *((fmuid.identification, name) for name in ("ModelCandidate", "Prediction", "SamplerSettings")),
    *((fmuid.runs, name) for name in ("BatchResult", "IdentificationRun")),
]


def marked(namespace: ModuleType, name: str) -> Any:
    return pytest.param(namespace, name, marks=pytest.mark.slow if name in SLOW else ())


@pytest.mark.parametrize(("namespace", "name"), [marked(*each) for each in NAMESPACES])
def test_examples(namespace: ModuleType, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(examples(name, getattr(namespace, name)), tmp_path, monkeypatch)


def test_every_name_has_an_example() -> None:
    assert not [name for namespace, name in NAMESPACES if not examples(name, getattr(namespace, name))]


def run(found: list[doctest.DocTest], folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run examples in a folder, none of them left out."""
    monkeypatch.chdir(folder)
    for each in found:
        assert not any(example.options.get(doctest.SKIP) for example in each.examples), f"{each.name} is left out"
        said: list[str] = []
        failed = doctest.DocTestRunner(verbose=False).run(each, out=said.append).failed
        assert not failed, "".join(said)


def test_a_wrong_example_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", None, 0)
    with pytest.raises(AssertionError, match="Expected"):
        run([wrong], tmp_path, monkeypatch)
