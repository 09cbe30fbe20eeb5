"""Every public name has an example in its docstring, and the examples give what they say.

They may take `fmuid`, `np` and `pd` for granted, and run in a folder of their own.
"""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid

NAMES = sorted(set(dir(fmuid)) - {"__version__", "datasets"})
# They start processes of their own, or do a whole study and more.
SLOW = {"Batch", "BatchResult", "validate"}


def examples(name: str, found: object) -> list[doctest.DocTest]:
    """Return the examples of a class or function, those of a class's methods too."""
    known = {"fmuid": fmuid, "np": np, "pd": pd}
    return [each for each in doctest.DocTestFinder().find(found, name, globs=known) if each.examples]


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_has_an_example(name: str) -> None:
    assert examples(name, getattr(fmuid, name)), f"fmuid.{name} has no example in its docstring"


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in NAMES])
def test_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(examples(name, getattr(fmuid, name)), tmp_path, monkeypatch)


@pytest.mark.parametrize("name", fmuid.datasets.__all__)
def test_examples_of_the_records(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = examples(name, getattr(fmuid.datasets, name))
    assert found
    run(found, tmp_path, monkeypatch)


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
