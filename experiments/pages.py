"""The pages of the experiments: tables stand between comments, where fresh ones take their place."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path


def insert(page: str, tables: Mapping[str, str]) -> str:
    """Return a page with each table put between its comments, ``<!-- name -->`` and ``<!-- end of name -->``.

    Raises
    ------
    ValueError
        If the page has not one such place for a table.
    """
    for name, table in tables.items():
        begin, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"the page needs one place for the table {name}")
        page = re.sub(f"(?<={begin}).*(?={end})", lambda _: table, page, flags=re.DOTALL)  # noqa: B023
    return page


def rewrite(folder: Path, tables: Mapping[str, str]) -> None:
    """Put tables into the README.md of an experiment.

    Raises
    ------
    ValueError
        If the page has not one such place for a table.
    """
    readme = folder / "README.md"
    readme.write_text(insert(readme.read_text(encoding="utf-8"), tables), encoding="utf-8")
