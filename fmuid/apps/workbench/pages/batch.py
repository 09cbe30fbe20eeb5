"""Page of a batch: progress, also of another process; its cases."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import pandas as pd
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, DataTable, NumberFormatter, TableColumn, TextInput

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address
from fmuid.apps.workbench.page_layout import argument, dress, sections
from fmuid.apps.workbench.pages.live import in_scheme
from fmuid.apps.workbench.pages.panels import LOOK_EVERY, side_by_side
from fmuid.apps.workbench.project_folder import Folder, FoundResult, FoundStudy, read_json
from fmuid.apps.workbench.widgets import SHEET, WIDE, choice, line, on_change, typed, words
from fmuid.errors import InputError
from fmuid.files import is_file, relative
from fmuid.reports.render.html import text as escaped
from fmuid.reports.topics.case_charts import over_cases
from fmuid.runs import BatchColumns, CaseList, parts_in, read_part
from fmuid.studies import Study

WIDTHS = {"case": 60, "status": 110, "cost": 90, "message": 600}  # pixels, of columns
_GRID = """
.slick-header-columns,.slick-header-column{background:var(--card)!important;color:var(--soft)!important}
.slick-row,.slick-cell{background:var(--card)!important;color:var(--ink)!important;border-color:var(--faint)!important}
.slick-cell.selected{background:var(--faint)!important}.bk-data-table{background:var(--card)!important}
"""


class BatchPage:
    """Page of a batch, in a document."""

    def __init__(self, doc: Any, bench: Any) -> None:
        folder: Folder = bench.folder
        place, scheme = folder.path(argument(doc, "file")), argument(doc, SCHEME)
        if not is_file(place / "batch.json"):
            raise InputError(f"{folder.name(place)} has no batch.json. Choose the folder of a batch.")
        self.doc, self.folder, self.place, self.scheme = doc, folder, place, scheme
        self.manifest: Mapping[str, Any] = read_json(place / "batch.json")
        self._wrong: list[str] = []  # messages on unreadable files
        self.frame, self._seen, self._counts = pd.DataFrame(), object(), list[tuple[float, int]]()
        self.state = words("state")
        self.status = choice("cases", ["all"], "status", "all")
        self.text = TextInput(title="containing", value="", name="filter", stylesheets=[SHEET])
        self.number = typed("case number", "", "number", 110)
        self.source = ColumnDataSource({"case": []}, name="cases")
        self.table = DataTable(source=self.source, height=420, index_position=None, reorderable=False, **WIDE)
        self.table.autosize_mode = "none"  # otherwise a narrow window squeezes all columns
        self.table.stylesheets = [_GRID]
        self.case = words("case", "<p>Choose a case in the table.</p>")
        self.drawn = column([words("none", "<p>No case has converged yet.</p>")], name="drawn", **WIDE)
        on_change(self._filter, self.status, self.text)
        on_change(self._choose, self.source.selected, name="indices")
        on_change(self._sought, self.number)
        self.look()
        doc.add_periodic_callback(self.look, LOOK_EVERY)
        cases = column(line(self.status, self.text, self.number), self.table, name="table", **WIDE)
        heads = ("", "<h3>Estimates</h3>", "<h3>Cases</h3>", "<h3>The case</h3>")
        pieces = sections(doc, dict(zip(heads, (self.state, self.drawn, cases, self.case), strict=True)))
        if urlsplit(dashboard := str(self.manifest.get("dashboard") or "")).scheme in ("http", "https"):
            link = f'<p><a href="{escaped(dashboard)}" target="_blank" rel="noreferrer">Workers (Dask)</a></p>'
            pieces.insert(1, (link, ""))
        title = self.place.name if self.found is None else self.found.title
        dress(doc, title, pieces, "bokeh-widgets", "bokeh-tables")

    def look(self) -> None:
        """Show the rows written since the last look."""
        parts = parts_in(self.place)
        seen = tuple((path.name, path.stat().st_size) for path in parts if path.exists())
        if seen != self._seen:
            frames, self._wrong = [], []
            for path in parts:
                try:
                    frames.append(_rows(path))
                except InputError as error:
                    if path.exists():  # otherwise merged by now
                        self._wrong.append(str(error))
            self._seen = seen
            known = pd.concat(frames, ignore_index=True) if frames else pd.DataFrame({"case": [], "status": []})
            self.frame = known.drop_duplicates("case").sort_values("case", ignore_index=True)
            self._counts = [*self._counts, (time.monotonic(), len(self.frame))][-30:]
            self._filter()
            self._draw()
        self._tell(parts)

    def _tell(self, parts: list[Path]) -> None:
        done, total = len(self.frame), int(self.manifest.get("cases") or 0)
        failed = int((self.frame["status"].astype(str) == "failed").sum()) if done else 0
        words = [f"{done} of {total} cases" if total else f"{done} cases"] + ([f"{failed} failed"] if failed else [])
        last = max((path.stat().st_mtime for path in parts if path.exists()), default=math.nan)
        silent = time.time() - last
        if done < total:
            (first, before), (now, count) = self._counts[0], self._counts[-1]
            rate = (count - before) / (now - first) if now > first else 0.0
            if rate > 0 and silent < 10.0:
                words += [f"{rate:.3g} cases/s", f"about {(total - done) / rate:.0f} s left"]
            elif silent >= 10.0:
                words.append(f"nothing written for {silent:.0f} s")
        bar = f"<progress value={done} max={max(total, 1)}></progress>" if total else ""
        text = f"{bar}<p>{escaped(', '.join(words))}</p>"
        text += "".join(f"<p class=error>{escaped(error)}</p>" for error in self._wrong)
        if is_file(self.place / "summary.json"):  # it has ended
            text += f'<p><a href="{address("results", self.folder, self.place)}">All figures</a></p>'
        if text != self.state.text:
            self.state.text = text

    def _draw(self) -> None:
        if "status" in self.frame and (self.frame["status"].astype(str) == "converged").any():
            truth = {name: value for name, value in (self.manifest.get("truth") or {}).items() if value is not None}
            charts = over_cases(self.frame, truth, self._units())
            self.drawn.children = [side_by_side(in_scheme(charts, self.scheme))]

    def _units(self) -> Mapping[str, str | None]:
        """Return the units of the estimates, known after the batch."""
        summary = self.place / "summary.json"
        try:
            return read_json(summary).get("units") or {} if is_file(summary) else {}
        except InputError as error:
            self._wrong.append(str(error))
            return {}

    def _filter(self) -> None:
        frame = self.frame
        if not len(frame):
            return
        kinds = sorted(set(frame["status"].astype(str)))
        self.status.options = ["all", *kinds]
        if self.status.value in kinds:
            frame = frame[frame["status"].astype(str) == self.status.value]
        sought = self.text.value.strip().lower()
        if sought:
            found = [any(sought in str(each).lower() for each in row) for row in frame.itertuples(index=False)]
            frame = frame[found]
        shown = frame.iloc[:5000]  # more are slow; the filter finds them
        names = [name for name in _columns(frame) if name in shown]
        if [each.field for each in self.table.columns] != names:
            *others, last = (_column(name, shown[name]) for name in names)
            last.width = max(last.width, 1430 - sum(each.width for each in others))
            self.table.columns = [*others, last]
        chosen = [self.source.data["case"][k] for k in self.source.selected.indices]
        self.source.data = {name: _plain(shown[name]) for name in names}
        self.table.height = min(420, 45 + 25 * len(shown))
        self.source.selected.indices = [k for k, case in enumerate(shown["case"]) if case in chosen]

    def _choose(self) -> None:
        """Show the case of a row of the table."""
        if indices := self.source.selected.indices:
            self._show(int(self.source.data["case"][indices[0]]))

    def _sought(self) -> None:
        """Show the case with a typed number."""
        text = self.number.value
        if text.strip().isdecimal() and int(text) in set(self.frame["case"]):
            self._show(int(text))
        elif text.strip():
            self.case.text = f"<p class=error role=alert>No case {escaped(text)} yet.</p>"

    def _show(self, case: int) -> None:
        found = self.frame[self.frame["case"] == case].iloc[0]
        cells = "".join(
            f"<tr><th scope=row>{escaped(name)}</th><td>{escaped(value)}</td></tr>"
            for name, value in found.items()
            if pd.notna(value) and value != ""
        )
        log = self.place / "logs" / f"case-{case:06d}.txt"
        said = ""
        with contextlib.suppress(OSError):  # it printed nothing
            said = f"<h3>Output</h3><pre>{escaped(log.read_text(errors='replace'))}</pre>"
        self.case.text = f"{self._what_if(found)}<div class=scroll><table><tbody>{cells}</tbody></table></div>{said}"

    def _what_if(self, found: pd.Series[Any]) -> str:
        """Return the link to the study with the values of a case."""
        if self.found is None:
            return ""
        study = self.found.path
        try:
            given = case_settings(study, int(found["case"]), found)
        except InputError as error:
            return f"<p class=error>{escaped(error)}</p>"
        link = address("study", self.folder, study) + "".join(f"&set={quote(each, safe='')}" for each in given)
        drawn = " (without its noise realization, which is not stored)" if "draw" in found else ""
        return f'<p><a href="{escaped(link)}">Simulate this case</a>{drawn}</p>'

    @cached_property
    def found(self) -> FoundStudy | None:
        """The study of the batch; None if it changed or is elsewhere."""
        mine = FoundResult.of(self.place / "batch.json")
        return next((each for each in self.folder.look()[0] if each.has_run(mine)), None)


def case_settings(path: Path, number: int, found: pd.Series[Any]) -> list[str]:
    """Return the ``--set`` arguments of a case at its estimates; refuse a missing case."""
    study = Study.read(path)
    cases = CaseList(study)
    if not 0 <= number < len(cases):
        raise InputError(f"{path} has no case {number} any more")
    case = cases[number]
    table = [] if case.table is None else [f"experiments.0.data={json.dumps(relative(case.table, path.parent))}"]
    held = [
        f'{"parameters" if name in study.parameters else "model.fixed"}."{name}"={json.dumps(value)}'
        for name, value in case.held.items()
    ]
    starts = []
    for name, parameter in study.parameters.items():
        if name in case.held:
            continue
        value = float(found.get(f"value.{name}", math.nan))
        value = value if math.isfinite(value) else float(case.starts.get(name, parameter.start))
        starts += [f'parameters."{name}"' + (f".start={value:.9g}" if name in case.free else f"={value:.9g}")]
    return [*table, *held, *starts]


def _rows(path: Path) -> pd.DataFrame:
    """Return the rows of a batch part; raise `InputError` if damaged."""
    frame: pd.DataFrame = read_part(path).to_pandas(ignore_metadata=True)
    numbers = [name for name in map(str, frame) if name == "case" or name.startswith(("value.", "std."))]
    wrong = [name for name in numbers if not _is_numeric(frame[name], "iu" if name == "case" else "iuf")]
    if missing := {"case", "status"} - set(frame):
        raise InputError(f"{path.name} has no column {', '.join(sorted(missing))}. Run the same command again.")
    if wrong:
        raise InputError(f"{path.name}: {', '.join(wrong)}: not numeric. Run the same command again.")
    return frame


def _is_numeric(values: pd.Series[Any], kinds: str) -> bool:
    return values.dtype.kind in kinds or bool(values.isna().all())


def _columns(frame: pd.DataFrame) -> list[str]:
    known = BatchColumns.of(frame)
    values = [f"value.{name}" for name in known.parameters]
    return ["case", "status", *known.design, *known.repeats, *values, "cost", "message"]


def _column(name: str, values: pd.Series[Any]) -> TableColumn:
    more = {"formatter": NumberFormatter(format="0.00000")} if values.dtype.kind == "f" else {}
    width = WIDTHS.get(name, max(70, 9 * len(name.removeprefix("value.")) + 20))
    return TableColumn(field=name, title=escaped(name.removeprefix("value.")), width=width, **more)


def _plain(values: pd.Series[Any]) -> Any:
    return values.to_numpy() if values.dtype.kind in "fiub" else values.astype(str).to_list()
