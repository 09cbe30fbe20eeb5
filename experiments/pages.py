"""What the experiments share: tables between comments of their pages, CSV files, looks of figures."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from fmuid.reports.render.matplotlib_renderer import DPI, style
from fmuid.reports.render.style import COLORS

AMBER, BLUE, GREY, INK = (COLORS[name] for name in ("amber", "blue", "grey", "ink"))


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return rows below their heads as Markdown; short rows are filled."""
    cells = [*map(str, heads)], *([*map(str, row), *[""] * (len(heads) - len(row))] for row in rows)
    lines = ["|" + "|".join(each) + "|" for each in cells]
    return "\n".join([lines[0], "|---" * len(heads) + "|", *lines[1:]])


def insert(page: str, tables: Mapping[str, str]) -> str:
    """Return a page with each table put between its comments, ``<!-- name -->`` and ``<!-- end of name -->``."""
    for name, text in tables.items():
        begin, end = f"<!-- {name} -->\n", f"\n<!-- end of {name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"the page needs one place for the table {name}")
        page = re.sub(f"(?<={begin}).*(?={end})", lambda _: text, page, flags=re.DOTALL)  # noqa: B023
    return page


def rewrite(folder: Path, tables: Mapping[str, str]) -> None:
    """Put tables into the README.md of an experiment."""
    readme = folder / "README.md"
    readme.write_text(insert(readme.read_text(encoding="utf-8"), tables), encoding="utf-8")


def save(figure: Figure, path: Path) -> None:
    """Write a figure; ticks take their style when they are drawn."""
    with style():
        figure.savefig(path, dpi=DPI)


def write(frame: pd.DataFrame, path: Path, numbers: str = "%.6g") -> pd.DataFrame:
    """Write a table as CSV; return it as it will be read."""
    frame.to_csv(path, index=False, float_format=numbers, lineterminator="\n")
    return pd.read_csv(path)


def continued(
    file: Path, key: tuple[str, object], counter: str, wanted: Iterable[int], row: Callable[[int], Mapping[str, object]]
) -> None:
    """Add the missing rows of a key, a column and its value, to a CSV file."""
    column, value = key
    done = pd.read_csv(file, keep_default_na=False) if file.exists() else pd.DataFrame({column: [], counter: []})
    begun = set(done.loc[done[column] == value, counter])
    made = [row(k) for k in wanted if k not in begun]
    if made:
        write(pd.concat([done, pd.DataFrame(made)], ignore_index=True), file, "%.5g")
    print(f"{value}: {len(made)} records", flush=True)
