"""Two walks through the house: each step is an import, so that a reader can follow it, and neither is long."""

from __future__ import annotations

import ast
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

import fmuid

PACKAGE = Path(fmuid.__file__).parent
COLUMN = (
    *("studies.study", "studies.model", "data.data_file", "data.readers.text", "data.headers", "data.clock"),
    *("data.preprocessing", "data.experiment", "identification.problem", "estimation.problem"),
    *("estimation.cost_function", "estimation.estimate", "estimation.result"),
    *("runs.findings", "reports.topics.fit", "reports.chart", "reports.render.bokeh_renderer", "reports.render.html"),
)
"""From a column of a CSV file to its figure in the report."""
PRIOR = (
    *("studies.parameters", "data.priors", "data.parameters", "estimation.problem", "estimation.cost_function"),
    *("identification.conditional_optimum", "identification.sampler", "identification.posterior"),
    *("identification.assessment", "runs.findings", "reports.topics.uncertainty_charts", "reports.chart"),
    *("reports.render.bokeh_renderer", "reports.render.html"),
)
"""From a parameter's prior to the figure of its posterior."""


@cache
def face(package: str) -> dict[str, str]:
    """Return the modules of the names that a package shows."""
    stub = PACKAGE / package / "__init__.pyi"
    body = ast.parse(stub.read_text(encoding="utf-8")).body if stub.is_file() else []
    nodes = [node for node in body if isinstance(node, ast.ImportFrom)]
    return {alias.name: f"{package}.{node.module}" for node in nodes for alias in node.names}


@cache
def imported(module: str) -> frozenset[str]:
    """Return the modules whose names a module imports, through faces too."""
    found = set()
    path = PACKAGE / f"{module.replace('.', '/')}.py"
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("fmuid"):
            package = node.module.removeprefix("fmuid").removeprefix(".")
            for alias in node.names:
                found |= {package, f"{package}.{alias.name}".removeprefix("."), face(package).get(alias.name, package)}
    return frozenset(found)


def is_step(one: str, other: str) -> bool:
    """Return whether one of two modules imports the other, or a module of the package of one imports both."""
    if other in imported(one) or one in imported(other):
        return True
    packages = {each.rpartition(".")[0] for each in (one, other)}
    beside = [path for package in packages for path in (PACKAGE / package.replace(".", "/")).glob("*.py")]
    names = [".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in beside]
    return any({one, other} <= imported(name) for name in names)


@pytest.mark.parametrize(("walk", "most"), [(COLUMN, 18), (PRIOR, 14)], ids=["column", "prior"])
def test_a_walk_is_short_and_no_room_is_entered_twice(walk: tuple[str, ...], most: int) -> None:
    assert len(walk) == len(set(walk)) <= most
    assert [step for step in pairwise(walk) if not is_step(*step)] == []


def test_a_step_that_nobody_takes_is_seen() -> None:
    assert not is_step("data.clock", "reports.chart")
