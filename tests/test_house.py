"""The habits of the house: what may import what, what is documented, what is imported when."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest

import fmuid
from tests.support.house import PACKAGE, face, imported, modules, tree, uses

# Packages in a package that others import from module by module: there is no use for one face of all figures.
OPEN = (
    "fmuid.apps.cli",
    "fmuid.reports.render",
    "fmuid.reports.topics",
    "fmuid.reports.documents",
    "fmuid.reports.publish",
    "fmuid.reports.chart",
    "fmuid.reports.document",
)
EXTRAS = {"casadi", "pymoca", "antlr4", "ziglang"}


def test_layers() -> None:
    """The contracts in pyproject.toml: arrows run one way, and some never."""
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=PACKAGE.parent)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 broken" in run.stdout


def test_no_circles_between_modules() -> None:
    """Not even through annotations: who reads one module need not read all others of its package at once."""
    found = modules()
    order = TopologicalSorter({name: uses(path) & found.keys() - {name} for name, path in found.items()})
    order.prepare()  # raises CycleError, which names a circle
    assert "estimation.result" in uses(found["estimation.local_search"])


def test_no_circles_between_files_of_the_core() -> None:
    """Each includes the headers of what it calls, and what others call of it stands in its own header."""
    files = {path: path.read_text(encoding="utf-8") for path in (PACKAGE / "simulation" / "native").glob("*.[ch]")}
    used: dict[str, set[str]] = {}
    for path, text in files.items():
        included = {name for name in re.findall(r'^#include "(\w+)\.h"', text, re.M) if name != path.stem}
        used[path.stem] = used.get(path.stem, set()) | included
    order = list(TopologicalSorter(used).static_order())  # raises CycleError, which names a circle
    assert order.index("plan") < order.index("events") < order.index("components") < order.index("master")
    defined = r"^(?!static|INLINE|EXPORT|typedef|extern)[A-Za-z_][\w \*]*?\b(\w+)\([^;{}]*\) \{"
    for path, text in files.items():
        for function in re.findall(defined, text, re.M) if path.suffix == ".c" else ():
            assert re.search(rf"\b{function}\(", files[path.with_suffix(".h")]), f"{path.name}: {function}"


def test_other_packages_are_seen_by_their_faces() -> None:
    for module, path in modules().items():
        for node in imported(path):
            others = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            assert not getattr(node, "level", 0), f"{path}:{node.lineno}: relative import"
            for other in (each for each in others if each.startswith("fmuid.")):
                package, _, inner = other.removeprefix("fmuid.").partition(".")
                seen = package == module.partition(".")[0] or not inner or other.startswith(OPEN)
                assert seen, f"{module} imports {other}: give the name to the face of {package}, import it there"


def test_names_of_faces_are_there() -> None:
    for stub in PACKAGE.glob("*/__init__.pyi"):
        package = importlib.import_module(f"fmuid.{stub.parent.name}")
        assert face(stub.parent.name)
        for name in face(stub.parent.name):
            assert getattr(package, name) is not None, name


def test_no_two_classes_share_a_name() -> None:
    places: dict[str, list[str]] = {}
    for module, path in modules().items():
        for node in tree(path).body:
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(module)
    assert "LeastSquares" in places
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_the_listing_shows_the_plan() -> None:
    assert len(list(PACKAGE.glob("*.py"))) <= 13
    for path in PACKAGE.rglob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 420, f"{path} is long: split it where a seam is"


def test_public_is_documented() -> None:
    for name in modules():
        if not name.startswith("export") and name != "__main__":
            check_documented(importlib.import_module(f"fmuid.{name}"))


def check_documented(module: ModuleType) -> None:
    """See that a module, its public functions, classes and their members have docstrings."""
    assert module.__doc__, module
    for name, value in vars(module).items():
        if name.startswith("_") or getattr(value, "__module__", None) != module.__name__:
            continue
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{module.__name__}.{name} has no docstring"
        if inspect.isclass(value):
            for member, method in vars(value).items():
                if not member.startswith("_") and isinstance(
                    method, property | classmethod | staticmethod
                ) | inspect.isfunction(method):
                    said = inspect.getdoc(getattr(value, member)) or inspect.getdoc(method)
                    assert said, f"{module.__name__}.{name}.{member}"


def test_public_names_are_those_of_the_stub() -> None:
    """Also where a package below has been imported, or a helper is in use."""
    stub = [node for node in imported(PACKAGE / "__init__.pyi") if isinstance(node, ast.ImportFrom)]
    importlib.import_module("fmuid.reports.render.notebook")
    assert dir(fmuid) == sorted(alias.name for node in stub for alias in node.names)
    for value in (getattr(fmuid, name) for name in set(dir(fmuid)) - {"__version__"}):
        assert inspect.ismodule(value) or (callable(value) and value.__module__ != "fmuid")
    with pytest.raises(AttributeError, match="Fmu"):
        getattr(fmuid, "F" + "mu")


HEAVY = {"numpy", "pandas", "threadpoolctl", "matplotlib", "fmpy", "scipy", "pyarrow", "pydantic", "bokeh", *EXTRAS}
SIMULATE = (
    "import fmuid, fmuid.simulation.executor; "
    "fmuid.Simulator, fmuid.Experiment, fmuid.simulation.executor_of, fmuid.simulation.executor"
)
STUDY = (PACKAGE.parent / "experiments/induction_machine/study.toml").as_posix()
IDENTIFY = (
    f"from fmuid.apps.cli.app import run; run(['identify', '{STUDY}', '-o', '.', '--no-isolation', '--no-report'])"
)
OTHERS = {
    *("fmuid.reports.topics.monitoring", "fmuid.diagnosis.monitor", "pint", "emcee", "bokeh"),
    *("scipy.optimize", "scipy.signal", "scipy.stats", "distributed"),
}


@pytest.mark.parametrize(
    ("code", "needed", "unneeded"),
    [
        ("import fmuid.apps.cli.app", {"fmuid"}, HEAVY),
        (
            SIMULATE,
            {"fmuid.simulation.native.library", "pandas"},
            {"fmpy", "scipy", "pydantic", "matplotlib", "psutil", "urllib.request"},
        ),
        (IDENTIFY, {"fmuid.reports.topics.identification", "scipy.linalg"}, OTHERS),
    ],
    ids=["command", "simulation", "identification"],
)
def test_imports_are_only_the_needed_ones(code: str, needed: set[str], unneeded: set[str], tmp_path: Path) -> None:
    """Of a command, of a simulation, of an identification, which makes its own document alone."""
    command = [sys.executable, "-c", f"import sys; {code}; print(*sys.modules)"]
    said = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path).stdout
    loaded = set(said.splitlines()[-1].split())
    assert needed <= loaded
    assert not loaded & unneeded


def test_tests_mirror_the_packages() -> None:
    tests = Path(__file__).parent
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    packages |= {"support", "experiments", "fmus", "golden"}
    assert {path.name for path in tests.iterdir() if path.is_dir() and path.name != "__pycache__"} <= packages
    for path in tests.rglob("*.py"):
        assert not re.search(r"^\s*(from|import) tests\.[\w.]*test_", path.read_text(encoding="utf-8"), re.M), path


# --- two walks: each step is an import, so that a reader can follow it, and neither is long

COLUMN = (
    *("studies.study", "studies.model", "data.data_file", "data.readers.text", "data.clock", "data.column_lookup"),
    *("data.preprocessing", "data.experiment", "identification.problem", "estimation.problem"),
    *("estimation.cost_function", "estimation.local_search", "estimation.result"),
    *("runs.findings", "reports.topics.fit", "reports.chart", "reports.render.bokeh_renderer", "reports.render.html"),
)
"""From a column of a CSV file to its figure in the report."""
PRIOR = (
    *("studies.parameters", "data.priors", "data.parameters", "estimation.problem", "estimation.cost_function"),
    *("identification.acquisition_delay", "identification.sampler", "identification.posterior"),
    *("identification.assessment", "runs.findings", "reports.topics.uncertainty_charts", "reports.chart"),
    *("reports.render.bokeh_renderer", "reports.render.html"),
)
"""From a parameter's prior to the figure of its posterior."""


def is_step(one: str, other: str) -> bool:
    """Return whether one of two modules imports the other, or a module of the package of one imports both."""
    if other in uses(modules()[one]) or one in uses(modules()[other]):
        return True
    packages = {each.rpartition(".")[0] for each in (one, other)}
    beside = [path for package in packages for path in (PACKAGE / package.replace(".", "/")).glob("*.py")]
    return any({one, other} <= uses(path) for path in beside)


@pytest.mark.parametrize(("walk", "most"), [(COLUMN, 18), (PRIOR, 14)], ids=["column", "prior"])
def test_a_walk_is_short_and_no_room_is_entered_twice(walk: tuple[str, ...], most: int) -> None:
    assert len(walk) == len(set(walk)) <= most
    assert [step for step in pairwise(walk) if not is_step(*step)] == []
    assert not is_step("data.clock", "reports.chart")
