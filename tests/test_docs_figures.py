"""Each figure of a report is on the page that says how to read it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from fmuid.reports.publish import KINDS
from tests.support.docs_rows import rows
from tests.support.paths import ROOT

TOPICS = ROOT / "fmuid" / "reports" / "topics"
# Keys of sections that are made up where they are drawn, by the module and how it writes them there.
MADE_UP = {
    ("preprocessing", "anchor"): {"preparation", "prepared", "monitored"},
    ("monitoring", "key"): {"timeline"},
    ("fit", "anchor"): {"fit", "prediction"},
    ("model_comparison", "key"): {"likelihood", "errors"},
    ("design", "key"): {"sensitivities"},
    ("batch", "f'over-{k + 1}'"): {"over"},
}
BEFORE_CHARTS = 4
"""So many arguments of a section stand before its charts."""


def drawn(module: Path) -> set[str]:
    """Return the keys of the sections with charts that a module makes."""
    calls = [node for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    made = [node for node in calls if isinstance(node.func, ast.Name) and node.func.id == "Section"]
    keys = [node.args[0] for node in made if has_charts(node)]
    fixed = {str(node.value) for node in keys if isinstance(node, ast.Constant)}
    made_up = [MADE_UP[module.stem, ast.unparse(node)] for node in keys if not isinstance(node, ast.Constant)]
    return fixed.union(*made_up)


def has_charts(section: ast.Call) -> bool:
    """Whether a section is made with charts, by their name or by their place."""
    return len(section.args) > BEFORE_CHARTS or any(each.arg == "charts" for each in section.keywords)


def test_each_figure_says_how_it_is_read() -> None:
    """The names on the page are those that a report can draw, each of them and no other; a new run clears them all."""
    said = {name for names, *_ in rows("figures.md", 4) for name in re.findall(r"`(\w+)`", names)}
    found = set().union(*(drawn(module) for module in TOPICS.glob("*.py")))
    assert said == found
    assert found <= set(KINDS)
