"""Remedies for parameters that are not identifiable: fix, prior, better excitation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import quote

from bokeh.layouts import column, row

from fmuid.apps.workbench.home import address
from fmuid.apps.workbench.jobs import Job
from fmuid.apps.workbench.pages.panels import CommandPanel
from fmuid.apps.workbench.pages.sliders import ParameterRow
from fmuid.apps.workbench.project_folder import Folder, tables
from fmuid.apps.workbench.widgets import LINE, WIDE, button, several, words
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.files import is_file, relative
from fmuid.formatting import of_parameter
from fmuid.reports.render.html import text as escaped
from fmuid.reports.topics.study_notes import change_line, change_title
from fmuid.runs import offered_change, study_of
from fmuid.studies import Study, quoted_key, read_toml, toml_text

DESIGN = "design"  # subfolder of the results for the comparison of excitations


class StudyPageProtocol(Protocol):
    """The page of a study, as its parts see it."""

    doc: Any
    path: Path
    scheme: str
    rows: list[ParameterRow]

    @property
    def bench(self) -> Any:
        """The workbench."""

    @property
    def results(self) -> Path:
        """Output folder of the command."""

    def has_result(self, folder: Path) -> bool:
        """Return whether a folder has a result of this study."""

    def words(self, command: str) -> list[str]:
        """Return the command."""

    def put(self, values: dict[str, float], *, note: bool = True) -> None:
        """Move sliders."""

    def try_change(self, settings: Sequence[str]) -> None:
        """Identify with other values of the study."""

    def note(self) -> None:
        """Store a state for undo, and update the command."""

    def show_result(self, folder: Path, *, move: bool = False) -> None:
        """Show a result as the last optimum."""


class ExcitationComparison:
    """Comparison of excitations for a study, by ``fmuid design``; `settings` returns the ``--set`` arguments."""

    def __init__(self, doc: Any, bench: Any, study: Path, results: Path, settings: Callable[[], Sequence[str]]) -> None:
        self.where, self.study, self.folder, self._settings = bench.folder, study, results / DESIGN, settings
        self.run = CommandPanel(doc, bench.jobs, self.folder, {"Compare excitations": self.compare}, ended=self._end)
        known = [self.where.name(path) for path in tables(self.where)]
        self.tables = several("excitations: data files with inputs", known, "excitations")
        self.compared = words("compared")
        advice = words(
            "advice",
            "<p>Or use another excitation: <code>fmuid design</code> compares excitations before the measurement.</p>",
        )
        self.layout = column(advice, self.tables, self.run.layout, self.compared, name="designing", **WIDE)

    def compare(self) -> None:
        """Start ``fmuid design`` with the chosen data files."""
        if not self.tables.value:
            self.run.refuse("No data files chosen. Choose files with the planned inputs.")
            return
        given = [relative(path, self.study.parent) for path in map(self.where.path, self.tables.value)]
        output = relative(self.folder, self.study.parent)
        self.run.begin(self.study, ["design", self.study.name, *given, "--output", output, *self._settings()])

    def _end(self, job: Job) -> None:
        link = address("results", self.where, self.folder)
        done = job.code == 0 and self.where.has(self.folder)
        self.compared.text = f'<p><a href="{link}">Comparison of excitations</a></p>' if done else ""


class RemedyPanel:
    """Remedies below a result with parameters that are not identifiable."""

    def __init__(self, page: StudyPageProtocol) -> None:
        self.page = page
        self.excitations = ExcitationComparison(
            page.doc, page.bench, page.path, page.results, lambda: page.words("design")[2:]
        )
        self.layout = column([], name="remedies", **WIDE)

    def tell(self, folder: Path) -> None:
        """Offer remedies for each parameter without a reliable estimate."""
        names = undetermined(Result.from_json(folder / "result.json"), [each.name for each in self.page.rows])
        lines = []
        for name in names:
            hold = button(f"Fix {name}", partial(self._hold, name))
            prior = button(f"Give {name} a prior", self._row(name).give_prior)
            text = words("which", f"<p>{_which(name)}</p>")
            lines.append(column(text, row(hold, prior, stylesheets=[LINE]), **WIDE))
        heading = words("remedy", "<h3>Remedies</h3>")
        remedies = [heading, *lines, self.excitations.layout] if names else []
        self.layout.children = [*self._offer(folder), *remedies]

    def _offer(self, folder: Path) -> list[Any]:
        """Return the button of the change that gains most, and its line."""
        change = offered_change(folder / "result.json")
        if change is None:
            return []
        said = words("offer", f"<p>{escaped(change_line(change))}</p>")
        return [column(said, button(change_title(change), partial(self.page.try_change, change.settings)), **WIDE)]

    def _hold(self, name: str) -> None:
        row = self._row(name)
        self.page.put({name: row.parameter.start}, note=False)  # the data do not determine it
        row.hold.active = True

    def _row(self, name: str) -> Any:
        return next(each for each in self.page.rows if each.name == name)


def undetermined(result: Result, parameters: Sequence[str]) -> list[str]:
    """Return the study's parameters that are not or weakly identifiable."""
    names = {name for name, std in zip(result.names, result.std, strict=True) if not math.isfinite(std)}
    names.update(
        name
        for each in (*result.identifiability.non_identifiable, *result.identifiability.weakly_identifiable)
        for name in each.names
    )
    return [each for each in parameters if any(of_parameter(name, each) for name in names)]


class UndeterminedResult:
    """Study of a result with the non-identifiable parameters `names`.

    `settings` are the ``--set`` values of the result, `designing` those for its design at the other estimates.
    """

    def __init__(self, folder: Folder, place: Path) -> None:
        self.names, self.settings = list[str](), list[str]()
        try:
            study, result = study_of(place), Result.from_json(place / "result.json")
            self.study, now = study.path, read_toml(study.path) if is_file(study.path) else {}
        except InputError:
            return
        if now and folder.has(self.study):
            self.names = undetermined(result, list(study.parameters))
            self.settings = list(_settings(now, study.data))
            known = dict(zip(result.names, result.values.tolist(), strict=True))
            found = [name for name in study.parameters if name in known and name not in self.names]
            more = [f"parameters.{quoted_key(name)}.start={known[name]!r}" for name in found]
            told = last_of(*self.settings, *more, *noise_of(study, result))
            self.designing = [word for each in told for word in ("--set", each)]
            self._address = address("study", folder, self.study)

    def links(self) -> str:
        """Return HTML links to the study with a remedy for each parameter."""
        more = "".join(f"&set={quote(each, safe='')}" for each in self.settings)
        acts = (("hold", "Fix {}"), ("prior", "Give {} a prior"))
        return "".join(
            f"<p>{_which(name)} "
            + "".join(
                f'<a class=go href="{escaped(f"{self._address}{more}&{act}={quote(name)}")}">'
                f"{escaped(label.format(name))}</a>"
                for act, label in acts
            )
            + "</p>"
            for name in self.names
        )


def last_of(*settings: str) -> list[str]:
    """Return settings without those replaced by later ones."""
    return list({each.partition("=")[0].replace('"', ""): each for each in settings}.values())


def noise_of(study: Study, result: Result | None) -> list[str]:
    """Return the ``--set`` value of noise variances that only the result has."""
    known = study.known_variance
    found = (
        {} if result is None else {name: each for name, each in result.fit.noise_variance.items() if name not in known}
    )
    return [f"noise.variance={toml_text(known | found)}"] if found else []


def _which(name: str) -> str:
    return f"<b>{escaped(name)}</b> is not identifiable:"


def _settings(before: Any, after: Any, where: str = "") -> Iterator[str]:
    """Yield the ``--set`` values that change a study's content into another."""
    if isinstance(before, dict) and isinstance(after, dict):
        if not where:  # fixed parameters move to [model]
            held = before.get("parameters", {}).keys() - after.get("parameters", {}).keys()
            yield from (f"parameters.{quoted_key(name)}={after['model']['fixed'][name]!r}" for name in sorted(held))
        for key, value in after.items():
            if before.get(key) != value:
                yield from _settings(before.get(key), value, f"{where}.{quoted_key(key)}" if where else key)
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for k, (old, new) in enumerate(zip(before, after, strict=True)):
            if old != new:
                yield from _settings(old, new, f"{where}.{k}")
    else:
        yield f"{where}={toml_text(after)}"
