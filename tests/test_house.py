"""The habits of the house: what may import what, what is documented, what is imported when."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Set
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

import fmuid

PACKAGE = Path(fmuid.__file__).parent
FACES = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.pyi"))
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


@cache
def tree(path: Path) -> ast.Module:
    """Return what a file says, parsed."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """Return the statements of a file that import, wherever they stand."""
    return tuple(node for node in ast.walk(tree(path)) if isinstance(node, ast.Import | ast.ImportFrom))


@cache
def modules() -> dict[str, Path]:
    """Return every module of the package below its name, packages' own files left out."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        if parts[-1] != "__init__":
            found[".".join(parts)] = path
    return found


def imports(path: Path) -> set[str]:
    """Return the modules of the package that a file imports, anywhere in it."""
    names = set()
    for node in imported(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        else:
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            names.add(node.module or "")
    return {name for name in names if name.startswith("fmuid.")}


def test_layers() -> None:
    """The contracts in pyproject.toml: arrows run one way, and some never."""
    command = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache"]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=PACKAGE.parent)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 broken" in run.stdout


def uses(path: Path, known: Set[str]) -> set[str]:
    """Return the modules that a file imports or whose names it imports, for annotations alone too."""
    found = set()
    for node in imported(path):
        if isinstance(node, ast.Import):
            found |= {alias.name.removeprefix("fmuid.") for alias in node.names}
        elif node.module:
            above = node.module.removeprefix("fmuid").removeprefix(".")
            found |= {above, *(f"{above}.{alias.name}".removeprefix(".") for alias in node.names)}
    return found & known


def test_no_circles_between_modules() -> None:
    """Not even through annotations: who reads one module need not read all others of its package at once."""
    found = modules()
    order = TopologicalSorter({name: uses(path, found.keys()) - {name} for name, path in found.items()})
    order.prepare()  # raises CycleError, which names a circle
    assert "estimation.result" in uses(found["estimation.estimate"], found.keys())


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
        for other in imports(path):
            package, _, inner = other.removeprefix("fmuid.").partition(".")
            seen = package == module.partition(".")[0] or not inner or other.startswith(OPEN)
            assert seen, f"{module} imports {other}: give the name to the face of {package}, import it there"


def test_imports_are_seen() -> None:
    assert {"fmuid.errors", "fmuid.data", "fmuid.identification"} <= imports(PACKAGE / "studies" / "study.py")


@pytest.mark.parametrize("face", FACES)
def test_what_a_face_names_is_there(face: str) -> None:
    stub = PACKAGE / face / "__init__.pyi"
    named = [a.name for n in ast.parse(stub.read_text()).body if isinstance(n, ast.ImportFrom) for a in n.names]
    package = importlib.import_module(f"fmuid.{face}")
    assert named
    for name in named:
        assert getattr(package, name) is not None


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


@pytest.mark.parametrize("name", sorted(set(dir(fmuid)) - {"__version__"}))
def test_public_names_resolve(name: str) -> None:
    value = getattr(fmuid, name)
    if inspect.ismodule(value):
        return
    assert callable(value)
    assert value.__module__ != "fmuid"


def test_the_listing_of_names_is_the_public_ones() -> None:
    """Also where a package below has been imported, or a helper is in use."""
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text())
    named = [alias.name for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    importlib.import_module("fmuid.reports.render.notebook")
    assert dir(fmuid) == sorted(named)


def test_unknown_name() -> None:
    name = "Fmu"
    with pytest.raises(AttributeError, match="Fmu"):
        getattr(fmuid, name)


@pytest.mark.parametrize("module", ["fmuid", "fmuid.apps.cli.app"])
def test_imports_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(*(name for name in sys.modules if '.' not in name))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "fmuid" in loaded
    assert not loaded & {"numpy", "pandas", "matplotlib", "fmpy", "scipy", "pyarrow", "pydantic", "bokeh", *EXTRAS}


def test_simulating_imports_nothing_that_only_others_need() -> None:
    faces = "fmuid.Simulator, fmuid.Experiment, fmuid.simulation.executor_of, fmuid.simulation.executor"
    code = f"import sys, fmuid, fmuid.simulation.executor; {faces}; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert {"fmuid.simulation.native.library", "pandas"} <= loaded
    assert not loaded & {"fmpy", "scipy", "pydantic", "matplotlib", "psutil", "urllib.request"}


def test_identifying_imports_nothing_that_only_others_need() -> None:
    code = "import sys, fmuid; fmuid.identify(fmuid.datasets.coil().problem()); print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert {"fmuid.identification.identify", "scipy.linalg"} <= loaded
    assert not loaded & {"fmuid.diagnosis.monitor", "scipy.optimize", "scipy.stats", "emcee", "distributed", "bokeh"}


def test_tests_mirror_the_packages() -> None:
    tests = Path(__file__).parent
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    packages |= {"support", "experiments", "fmus", "golden"}
    assert {path.name for path in tests.iterdir() if path.is_dir() and path.name != "__pycache__"} <= packages
    for path in tests.rglob("*.py"):
        assert not re.search(r"^\s*(from|import) tests\.[\w.]*test_", path.read_text(encoding="utf-8"), re.M), path
