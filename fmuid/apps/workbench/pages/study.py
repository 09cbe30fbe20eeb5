"""Page of one study: simulation by sliders, and identification."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from bokeh.layouts import column
from bokeh.models import TabPanel, Tabs, Toggle

from fmuid.apps.workbench.access_control import SCHEME
from fmuid.apps.workbench.home import address
from fmuid.apps.workbench.jobs import command_text
from fmuid.apps.workbench.page_layout import argument, arguments, dress
from fmuid.apps.workbench.pages.identification_panel import IdentificationPanel
from fmuid.apps.workbench.pages.live import LatestOnlyWorker, LiveFit
from fmuid.apps.workbench.pages.remedy_panel import last_of, noise_of
from fmuid.apps.workbench.pages.sliders import ParameterRow
from fmuid.apps.workbench.project_folder import FoundResult
from fmuid.apps.workbench.widgets import SHEET, WIDE, button, choice, line, on_change, words
from fmuid.array_types import Floats
from fmuid.errors import FmuidError, InputError
from fmuid.estimation import Result
from fmuid.files import is_file
from fmuid.formatting import fit_text, with_unit
from fmuid.processes import AVAILABLE
from fmuid.reports.render.html import text as escaped
from fmuid.simulation import AnySimulator, close, executor_of, fit_of, parameter_units
from fmuid.studies import Study

HOLD, PRIOR = "hold", "prior"  # Address arguments: a parameter to fix, and one to give a prior


class StudyPage:
    """Page of a study, in a document."""

    def __init__(self, doc: Any, bench: Any, *, isolated: bool = AVAILABLE) -> None:
        self.doc, self.bench, self.scheme = doc, bench, argument(doc, SCHEME)
        self.path: Path = bench.folder.path(argument(doc, "file"))
        self._given = arguments(doc, "set")  # values that replace those of the file
        self.study = study = Study.read(self.path, self._given, isolated=isolated)
        study.check_parameters()
        self.simulators = study.simulators()
        self.simulator: AnySimulator = self.simulators[0]
        units = parameter_units(study.system, list(study.parameters))
        self.rows = [
            ParameterRow(name, unit, parameter, self._changed)
            for (name, parameter), unit in zip(study.parameters.items(), units, strict=True)
        ]
        self.optimum: Result | None = None
        self.shown = np.full(len(self.rows), np.nan)  # values of the shown simulation
        self._undone = [self._state()]
        self._newest: LatestOnlyWorker[Floats] = LatestOnlyWorker(
            self._simulate, executor_of(study.system).cancel, partial(close, study.system)
        )
        doc.on_session_destroyed(lambda _context: self._newest.close())
        self._make()
        self.identifying = IdentificationPanel(self)
        self.show_result(self.results)
        self._lay_out()
        held, doubted = arguments(doc, HOLD), arguments(doc, PRIOR)
        for each in self.rows:
            each.hold.active = each.name in held
            if each.name in doubted:
                each.give_prior()

    @property
    def results(self) -> Path:
        """Output folder of the command."""
        return self.path.parent / "results"

    def has_result(self, folder: Path) -> bool:
        """Return whether a folder has a result of this study."""
        path = folder / "result.json"
        return is_file(path) and FoundResult.of(path).study in (None, self.path.resolve())

    def _make(self) -> None:
        self.scores = words("scores", "<p class=soft>simulating …</p>")
        self.command = words("command")
        self.undo = button("Undo", self.go_back, disabled=True)
        self.to_starts = button("Initial guess", lambda: self.put({r.name: r.parameter.start for r in self.rows}))
        self.to_optimum = button("Optimum", self._go_to_optimum, disabled=True)
        self.near = Toggle(label="± 10 σ", name="sliders over ± 10 σ", disabled=True, stylesheets=[SHEET])
        on_change(self._show_near, self.near, name="active")
        names = [each.experiment.name for each in self.simulators]
        self.experiment = choice("experiment", names, "experiment", names[0])
        on_change(lambda: self._choose(names.index(self.experiment.value)), self.experiment)
        self.live = self._drawing()
        self.fit = column(self.live.figure, name="fit", **WIDE)

    def _drawing(self) -> LiveFit:
        nothing = np.full((len(self.simulator.experiment.times), len(self.simulator.output_names)), np.nan)
        record = fit_of(self.study.system, self.simulator.experiment, nothing)
        return LiveFit(record, self.doc.add_next_tick_callback, self.scheme)

    def _lay_out(self) -> None:
        buttons = line(self.undo, self.to_starts, self.to_optimum, self.near)
        chosen = [self.experiment] if len(self.simulators) > 1 else []
        sliders = column(*[each.layout for each in self.rows], sizing_mode="stretch_width", spacing=10)
        parts = (sliders, buttons, self.scores, self.identifying.controls)
        side = column(*chosen, *parts, name="side", sizing_mode="stretch_width")
        panels = [
            TabPanel(child=self.fit, title="Fit"),
            TabPanel(child=self.identifying.search, title="Optimization"),
            TabPanel(child=self.identifying.found, title="Result"),
        ]
        self.tabs = Tabs(tabs=panels, name="main", **WIDE)
        for root in (side, self.tabs, self.command):
            self.doc.add_root(root)
        pieces = [
            ('<div class="bench"><section aria-label="parameters">', "side"),
            ('</section><div><section aria-label="figures">', "main"),
            ("</section><section><h3>Command</h3>", "command"),
            ("</section></div></div>", ""),
        ]
        if self.study.diagnosis is not None:
            link = address("faults", self.bench.folder, self.path)
            pieces.insert(0, (f'<p><a href="{link}">Diagnosis and monitoring</a></p>', ""))
        dress(self.doc, self.study.title or self.path.stem, pieces, "bokeh-widgets")

    @property
    def theta(self) -> Floats:
        """Values of the sliders, (N,)."""
        return np.array([each.value for each in self.rows])

    def ask(self) -> None:
        """Request a simulation; only the latest request is kept."""
        self._newest.ask(self.theta)

    def put(self, values: dict[str, float], *, note: bool = True) -> None:
        """Move sliders."""
        for each in self.rows:
            if each.name in values:
                each.put(values[each.name])
        if note:
            self.note()
        self.ask()

    def _changed(self, ended: bool) -> None:
        self.ask()
        if ended:
            self.note()

    def _show_near(self) -> None:
        for each in self.rows:
            each.show_near(self.near.active)

    def _state(self) -> tuple[tuple[float, bool], ...]:
        return tuple((each.value, each.held) for each in self.rows)

    def try_change(self, settings: Sequence[str]) -> None:
        """Identify with other values of the study."""
        self._given = last_of(*self._given, *settings)
        self._tell_command()
        self.identifying.begin()

    def note(self) -> None:
        """Store a state for undo, and update the commands."""
        if self._state() != self._undone[-1]:
            self._undone = [*self._undone, self._state()][-100:]
        self.undo.disabled = len(self._undone) < 2
        self._tell_command()

    def go_back(self) -> None:
        """Undo the last change."""
        if len(self._undone) > 1:
            self._undone.pop()
        before = self._undone[-1]
        for each, (value, held) in zip(self.rows, before, strict=True):
            each.put(value)
            each.hold.active = held
        self.undo.disabled = len(self._undone) < 2
        self._tell_command()
        self.ask()

    def _simulate(self, theta: Floats) -> None:
        """Simulate in the worker thread, and show the result on the page."""
        simulator, begun = self.simulator, time.perf_counter()
        try:
            found = simulator.many(theta[None])
            outputs, error = found.outputs[0], found.errors[0]
            words = "" if error is None else str(error)
        except FmuidError as wrong:
            outputs, words = np.full((len(simulator.experiment.times), len(simulator.output_names)), np.nan), str(wrong)
        seconds = time.perf_counter() - begun
        # Bokeh reports a closed page after it has emptied the document
        with contextlib.suppress(AttributeError):
            self.doc.add_next_tick_callback(partial(self._show, simulator, theta, outputs, words, seconds))

    def _show(self, simulator: AnySimulator, theta: Floats, outputs: Floats, error: str, seconds: float) -> None:
        if simulator is not self.simulator:
            return  # another experiment is shown by now
        self.shown = theta
        if error:
            self.scores.text = f"<p class=error role=status>{escaped(error)}</p>"
            return
        self.live.draw(outputs)
        self.scores.text = self._scores(theta, seconds)

    def _choose(self, number: int) -> None:
        self.simulator = self.simulators[number]
        self.live = self._drawing()
        self.fit.children = [self.live.figure]
        self._haunt()
        self.ask()

    def _scores(self, theta: Floats, seconds: float) -> str:
        """Return fit and RMSE of each output as HTML."""
        record, known = self.live.record, self._noise()
        cells = []
        for name, fit, rmse, unit in zip(record.outputs, record.fit, record.rmse, record.units, strict=True):
            std = math.sqrt(known[name]) if known.get(name, 0.0) > 0 else math.nan
            times = f", {rmse / std:.3g} × noise level" if math.isfinite(rmse / std) else ""
            more = f"<small>RMSE {escaped(with_unit(rmse, unit))}{times}</small>" if math.isfinite(rmse) else ""
            cells.append(_cell(f"fit of {name}", fit_text(fit), more))
        away = self._distance(theta)
        cells += [_cell("from the optimum", f"{away:.3g} σ")] if math.isfinite(away) else []
        cells.append(_cell("simulated in", f"{seconds:.3g} s" if seconds >= 1.0 else f"{1000 * seconds:.3g} ms"))
        return f"<div class=numbers role=status>{''.join(cells)}</div>"

    def _noise(self) -> dict[str, float]:
        """Return the noise variance of each output: last result, or study."""
        return dict(self.optimum.fit.noise_variance) if self.optimum is not None else self.study.known_variance

    def _distance(self, theta: Floats) -> float:
        """Return the Mahalanobis distance from the last optimum."""
        result = self.optimum
        if result is None or list(result.names) != [each.name for each in self.rows]:
            return math.nan
        if not np.isfinite(result.covariance).all():
            return math.nan
        away = theta - result.values
        try:
            return math.sqrt(max(0.0, float(away @ np.linalg.solve(result.covariance, away))))
        except np.linalg.LinAlgError:  # not identifiable: no distance along that direction
            return math.nan

    def show_result(self, folder: Path, *, move: bool = False) -> None:
        """Show a result as the last optimum; `move` moves the sliders there."""
        try:
            self.optimum = Result.from_json(folder / "result.json") if self.has_result(folder) else None
        except InputError:
            self.optimum = None
        self._haunt()
        if move and self._at_optimum():
            self._go_to_optimum()
        else:
            self._tell_command()
            self.ask()

    def _at_optimum(self) -> dict[str, tuple[float, float]]:
        """Return value and σ of the parameters of the shown experiment."""
        result, found = self.optimum, dict[str, tuple[float, float]]()
        if result is None:
            return found
        place = {name: i for i, name in enumerate(result.names)}
        for each in self.rows:
            name = each.parameter.name_in(self.simulator.experiment.name, each.name)
            if name in place:
                found[each.name] = float(result.values[place[name]]), float(result.std[place[name]])
        return found

    def _haunt(self) -> None:
        """Show the last optimum at the sliders and in the figure."""
        values = self._at_optimum()
        for each in self.rows:
            each.know(values.get(each.name))
        self.to_optimum.disabled = self.near.disabled = not values
        if not values:
            self.live.haunt(None)
            return
        theta = np.array([values.get(each.name, (each.value, 0.0))[0] for each in self.rows])
        try:
            self.live.haunt(self.simulator(theta))
        except FmuidError:
            self.live.haunt(None)

    def _go_to_optimum(self) -> None:
        self.put({name: value for name, (value, _) in self._at_optimum().items()})

    def settings(self, command: str = "") -> list[str]:
        """Return ``--set`` arguments for a command at the slider values."""
        found = [word for each in self.rows for word in _said_of(each, hold=each.held)]
        found += self.identifying.settings() if command == "identify" else []
        found += noise_of(self.study, self.optimum) if command == "design" else []
        return [word for setting in last_of(*self._given, *found) for word in ("--set", setting)]

    def words(self, command: str) -> list[str]:
        """Return a command for the shown state, in the study's folder."""
        return [command, self.path.name, *self.settings(command)]

    def _tell_command(self) -> None:
        lines = (command_text(self.words("simulate")), command_text(self.words("identify")))
        self.command.text = f"<pre>{escaped(lines[0])}<br>{escaped(lines[1])}</pre>"
        # address to continue after a lost connection
        said = [word for each in self.rows for word in _said_of(each, hold=False)]
        shown = [("set", word) for word in last_of(*self._given, *said)]
        shown += [(HOLD, each.name) for each in self.rows if each.held]
        tail = "".join(f"&{name}={quote(value, safe='')}" for name, value in shown)
        self.command.tags = [address("study", self.bench.folder, self.path) + tail]


def _said_of(row: ParameterRow, *, hold: bool) -> list[str]:
    """Return the ``--set`` values of a parameter as its row shows it."""
    name = f'"{row.name}"' if any(mark in row.name for mark in " '") else row.name
    if hold:
        return [f"parameters.{name}={row.value:.9g}"]
    found = [f"parameters.{name}.start={row.value:.9g}"] if row.value != row.parameter.start else []
    if row.prior is not row.parameter.prior and row.prior is not None:
        found.append(f"parameters.{name}.prior={{ mean = {row.prior.mean:.9g}, std = {row.prior.std:.9g} }}")
    return found


def _cell(name: str, value: str, more: str = "") -> str:
    return f"<div>{escaped(name)}<b>{escaped(value)}</b>{more}</div>"
