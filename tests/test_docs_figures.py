"""Each figure of a report is on the page that says how to read it."""

from __future__ import annotations

import ast
import re

from fmuid.reports.publish import KINDS
from tests.support.docs_rows import rows
from tests.support.paths import ROOT


def test_each_figure_says_how_it_is_read() -> None:
    """The names on the page are those that a report can draw, each of them and no other; a new run clears them all."""
    said = {name for names, *_ in rows("figures.md", 4) for name in re.findall(r"`(\w+)`", names)}
    assert said == set(KINDS)
    for module in (ROOT / "fmuid" / "reports" / "topics").glob("*.py"):
        calls = [node for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        made = [node for node in calls if isinstance(node.func, ast.Name) and node.func.id == "Section"]
        drawn = [node for node in made if len(node.args) > 4 or any(each.arg == "charts" for each in node.keywords)]
        assert {str(node.args[0].value) for node in drawn if isinstance(node.args[0], ast.Constant)} <= said
