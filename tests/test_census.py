"""How large the house is: lines, fields, arguments, numbers that are constants of a module. Limits only go down."""

import ast
from collections.abc import Iterator

from tests.support.house import PACKAGE, statements, tree

FILES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in sorted(PACKAGE.rglob("*.py"))}

MAX_LINES = 65_735
"""Lines of Python, the exporter included; the plan has 41,700."""
MAX_CONSTANTS = 131
"""Numbers that capitals of a module stand for; those of an algorithm belong to its settings. The plan has 150."""
MAX_FIELDS, MAX_ARGUMENTS = 15, 6
MANY_FIELDS = {"export.explicit_model.ExplicitModel"}
"""Classes with more fields that are still to be divided."""
MANY_ARGUMENTS = {
    "data.data_file.read_data",
    "data.signals.multisine",
    "data.signals.prbs",
    "estimation.equation_error.instrumental_variables",
    "estimation.problem.__init__",
    "estimation.problem.from_function",
    "identification.problem.__init__",
    "models.system.__init__",
    "reports.run.run",
    "simulation.simulator.__init__",
}
"""Functions with more arguments that are still to be divided."""


def test_lines() -> None:
    assert sum(path.read_text(encoding="utf-8").count("\n") for path in FILES.values()) <= MAX_LINES


def test_constants_are_few() -> None:
    found = [f"{module}.{name}" for module, path in FILES.items() for name in numbers(tree(path))]
    assert len(found) <= MAX_CONSTANTS, found


def numbers(tree: ast.Module) -> Iterator[str]:
    """Yield the capitals that stand for a number."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        value = getattr(node, "value", None)
        value = value.operand if isinstance(value, ast.UnaryOp) else value
        number = isinstance(value, ast.Constant) and type(value.value) in (int, float)
        if number or isinstance(value, ast.BinOp):
            yield from (each.id for each in targets if isinstance(each, ast.Name) and each.id.lstrip("_").isupper())


def test_numbers_are_seen() -> None:
    """What is counted: numbers, also negative and computed ones, not texts, tuples or names in lower case."""
    text = "A = 1\n_B: float = -2.0\nC = 2**20\nD = 'd'\nE = (1, 2)\nf = 3\nG = True\n"
    assert list(numbers(ast.parse(text))) == ["A", "_B", "C"]


def test_fields_and_arguments_are_few() -> None:
    fields, arguments = set(), set()
    for module, path in FILES.items():
        for node in statements(path):
            if isinstance(node, ast.ClassDef):
                count = sum(isinstance(each, ast.AnnAssign) for each in node.body)
                fields |= {f"{module}.{node.name}"} if count > MAX_FIELDS else set()
            if isinstance(node, ast.FunctionDef) and not module.startswith("apps.cli"):  # commands have their options
                names = [each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                count = len([name for name in names if name not in ("self", "cls")])
                arguments |= {f"{module}.{node.name}"} if count > MAX_ARGUMENTS else set()
    assert fields == MANY_FIELDS
    assert arguments == MANY_ARGUMENTS
