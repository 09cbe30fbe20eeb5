"""Each figure of a report is on the page that says how to read it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.support.docs_rows import rows
from tests.support.paths import ROOT

PAGE = ROOT / "fmuid" / "reports" / "page"
# Names of parts that are made up where they are drawn, by the module and how it writes them there.
MADE_UP = {
    ("preparation", "anchor"): {"preparation", "prepared", "monitored"},
    ("faults", "name"): {"timeline"},
    ("fits", "anchor"): {"fit", "prediction"},
    ("validation", "name"): {"criteria", "errors"},
    ("validation", "anchor"): {"sensitivities"},
    ("batches", "f'over-{k + 1}'"): {"over"},
}


def drawn(module: Path) -> set[str]:
    """Return the names of the parts of a report that a module draws."""
    calls = [node for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    first = [node.args[0] for node in calls if isinstance(node.func, ast.Name) and node.func.id == "Section"]
    fixed = {str(node.value) for node in first if isinstance(node, ast.Constant)}
    made_up = [MADE_UP[module.stem, ast.unparse(node)] for node in first if not isinstance(node, ast.Constant)]
    return fixed.union(*made_up)


def test_each_figure_says_how_it_is_read() -> None:
    """The names on the page are those that a report can draw, each of them and no other."""
    said = {name for names, *_ in rows("report.md", 4) for name in re.findall(r"`(\w+)`", names)}
    assert said == set().union(*(drawn(module) for module in PAGE.glob("*.py")))
