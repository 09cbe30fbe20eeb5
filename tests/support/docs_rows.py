"""Rows of tables and blocks of code on pages of docs."""

import re
from collections.abc import Callable
from pathlib import Path

from tests.support.paths import ROOT


class RowChecks(dict[str, Callable[[Path], None]]):
    """Checks of the rows of a page by their first cell; called with that cell, it takes the function below."""

    def __call__(self, head: str) -> Callable[[Callable[[Path], None]], None]:
        return lambda check: self.update({head: check})


def rows(page: str, width: int) -> list[tuple[str, ...]]:
    """Return the cells of the rows of all tables of a page, without their heads."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    heads = set(re.findall(r"^(\| .*)\n\|---", text, re.MULTILINE))
    cells = [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in lines if line not in heads]
    assert all(len(each) == width for each in cells)
    return cells


def blocks(page: str, kind: str) -> list[str]:
    """Return the blocks of a page in a language."""
    return re.findall(rf"```{kind}\n(.*?)```", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.DOTALL)
