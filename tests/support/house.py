"""The files of the package, each parsed once."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import fmuid

PACKAGE = Path(fmuid.__file__).parent


@cache
def modules() -> dict[str, Path]:
    """Return every module of the package by its name, packages' own files left out."""
    paths = sorted(path for path in PACKAGE.rglob("*.py") if path.name != "__init__.py")
    return {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in paths}


@cache
def tree(path: Path) -> ast.Module:
    """Return a parsed file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def statements(path: Path) -> Iterator[ast.AST]:
    """Yield all statements of a file, at any depth."""
    todo: list[ast.AST] = [tree(path)]
    while todo:
        node = todo.pop()
        yield node
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, field, [])
            todo += inner if isinstance(inner, list) else []


@cache
def imported(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """Return the imports of a file, wherever they stand."""
    return tuple(node for node in statements(path) if isinstance(node, ast.Import | ast.ImportFrom))


@cache
def face(package: str) -> dict[str, str]:
    """Return the modules of the names that a package shows."""
    stub = PACKAGE / package / "__init__.pyi"
    nodes = [node for node in imported(stub) if isinstance(node, ast.ImportFrom)] if stub.is_file() else []
    return {alias.name: f"{package}.{node.module}" for node in nodes for alias in node.names}


@cache
def uses(path: Path) -> frozenset[str]:
    """Return the modules that a file imports or whose names it imports, also through faces and for annotations."""
    found = set()
    for node in imported(path):
        if isinstance(node, ast.Import):
            found |= {alias.name.removeprefix("fmuid.") for alias in node.names}
        elif (node.module or "").partition(".")[0] == "fmuid":
            above = (node.module or "").removeprefix("fmuid").removeprefix(".")
            for alias in node.names:
                found |= {above, f"{above}.{alias.name}".removeprefix("."), face(above).get(alias.name, above)}
    return frozenset(found)
