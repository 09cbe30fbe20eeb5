"""The page of a study without a browser: sliders are moved, callbacks run by hand."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.document.events import SessionCallbackAdded
from bokeh.events import ButtonClick
from bokeh.models import Button

from fmuid.apps.workbench import Folder
from fmuid.apps.workbench.jobs import Jobs
from fmuid.apps.workbench.pages.live import LatestOnlyWorker
from fmuid.apps.workbench.pages.sliders import PLACES, reach_of
from fmuid.apps.workbench.pages.study import StudyPage
from fmuid.data import Normal, Parameter
from fmuid.errors import InputError
from fmuid.estimation import Result
from fmuid.simulation import Simulator
from fmuid.studies import Study
from tests.support.coil_study import STUDY, coil_table
from tests.support.results import result
from tests.support.running import run_study

PATIENCE = 60.0


@dataclass
class Bench:
    folder: Folder
    jobs: Jobs = field(default_factory=Jobs)


class Page:
    """A page and what runs its callbacks."""

    def __init__(self, path: Path, given: Sequence[str] = ()) -> None:
        self.doc: Any = Document()
        self.due: list[Any] = []  # in the order in which a server would call them
        self.doc.on_change(self._note)
        study = Study.read(path, given)
        self.page = StudyPage(self.doc, Bench(Folder(path.parent)), path, study, "light", given)
        self.rows = {each.name: each for each in self.page.rows}
        self.settle()

    def _note(self, event: Any) -> None:
        if isinstance(event, SessionCallbackAdded):
            self.due.append(event.callback)

    def settle(self) -> None:
        """Wait for the simulation of what the sliders show now."""
        end, theta = time.monotonic() + PATIENCE, self.page.theta
        self.page._newest.ask(theta)  # what was asked for before comes before
        while self.page.shown is not theta:
            assert time.monotonic() < end
            while self.due:
                self.due.pop(0).callback()
            time.sleep(0.001)

    def layer(self, label: str) -> dict[str, Any]:
        """Return the data of a layer of the first chart."""
        return next(dict(each.data) for each in self.page.live.grid.charts[0].layers if each.label == label)

    def shown(self) -> np.ndarray[Any, Any]:
        return self.page.live.record.simulated[:, 0]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    coil_table(folder / "first.csv", 0.0, seed=1)
    (folder / "study.toml").write_text(STUDY)
    return folder / "study.toml"


@pytest.fixture(scope="module")
def opened(path: Path) -> Page:
    return Page(path)


@pytest.fixture
def page(opened: Page) -> Page:
    """Return the page as it is at first."""
    for row in opened.page.rows:
        row.hold.active = False
    opened.page.put({row.name: row.parameter.start for row in opened.page.rows})
    opened.page._undone = opened.page._undone[-1:]
    opened.page.live.across.update(start=0.0, end=1.0)
    opened.settle()
    return opened


def simulated(path: Path, R: float, L: float) -> np.ndarray[Any, Any]:
    study = Study.read(path)
    simulator = Simulator(study.system, study.tables[0], ["R", "L"], values=study.model.values)
    return simulator([R, L])[:, 0]


def test_a_slider_simulates_and_draws(page: Page, path: Path) -> None:
    row = page.rows["R"]
    row.slider.value = 250
    page.settle()
    assert row.value == row.reach.value(250) != row.parameter.start
    assert row.typed.value == f"{row.value:.6g}"
    expected = simulated(path, row.value, page.rows["L"].value)
    np.testing.assert_allclose(page.shown(), expected, rtol=1e-12)
    line = page.layer("simulated")
    drawn, times = line["y"], line["x"]
    np.testing.assert_allclose(drawn, np.interp(times, page.page.live.record.times, expected), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(line["r"], page.page.live.record.measured[:, 0] - expected, rtol=1e-4, atol=1e-6)


def test_the_lines_stay_in_the_ranges(page: Page) -> None:
    for value in (0.5, 40.0, 4.0):
        page.page.put({"R": value})
        page.settle()
        upper, lower = page.page.live.uppers[0], page.page.live.lowers[0]
        assert upper.start <= page.shown().min() <= page.shown().max() <= upper.end
        residual = page.page.live.record.measured[:, 0] - page.shown()
        assert np.abs(residual).max() <= lower.end == -lower.start


def test_typing_holding_and_going_back(page: Page) -> None:
    row = page.rows["R"]
    start = row.value
    row.typed.value = "7,5"
    assert row.value == 7.5
    row.typed.value = "-3"  # beyond the bound
    assert row.value == 7.5
    assert row.typed.value == "7.5"
    row.typed.value = "many"
    assert row.typed.value == "7.5"
    row.hold.active = True
    assert page.page.words("identify")[1:] == ["study.toml", "--set", "parameters.R=7.5"]
    assert "parameters.R=7.5" in page.page.command.text
    page.page.go_back()
    assert not row.held
    assert row.value == 7.5
    page.page.go_back()
    assert row.value == start
    assert page.page.undo.disabled
    assert page.page.settings() == []


def test_the_command_says_what_the_page_shows(page: Page, path: Path) -> None:
    page.rows["R"].hold.active = True
    page.rows["L"].typed.value = "0.2"
    _, _, *words = page.page.words("identify")
    study = Study.read(path, [word for word in words if word != "--set"])
    assert list(study.parameters) == ["L"]
    assert study.parameters["L"].start == 0.2
    assert study.model.values["R"] == page.rows["R"].value


def test_what_the_address_gave_is_said_once(path: Path) -> None:
    given = ['parameters."R".start=7', "estimation.max_iterations=9"]
    page = Page(path, given)
    page.rows["R"].typed.value = "8"
    assert page.page.words("identify")[2:] == ["--set", "parameters.R.start=8", "--set", given[1]]
    asked = parse_qs(urlsplit(page.page.command.tags[0]).query)
    assert asked["set"] == ["parameters.R.start=8", given[1]]


def test_what_another_study_found_is_not_shown_as_this_ones(path: Path, tmp_path: Path) -> None:
    for name in ("first.csv", "study.toml"):
        (tmp_path / name).write_bytes((path.parent / name).read_bytes())
    (tmp_path / "other.toml").write_text(path.read_text())
    (tmp_path / "results").mkdir()
    result(tmp_path / "results", {"R": (4.0, 0.1), "L": (0.1, None)}, study={"file": "../other.toml"})
    for name, own in (("study.toml", False), ("other.toml", True)):
        page = Page(tmp_path / name).page
        assert (page.optimum is not None) == own
        assert ("of another study" in page.identifying.text.text) != own
        assert bool(page.identifying.remedies.layout.children) == own


def test_what_is_asked_for_besides_is_what_a_study_says(page: Page, path: Path) -> None:
    identifying = page.page.identifying
    identifying.how.value, identifying.starts.value = "multi-start", 7
    identifying.also.value = ["profile likelihood", "posterior", "cost map of R, L"]
    assert "simulate study.toml<br>" in page.page.command.text  # is for the search alone
    _, _, *words = page.page.words("identify")
    study = Study.read(path, [word for word in words if word != "--set"])
    assert getattr(study.estimator, "starts", None) == 7
    asked = study.uncertainty_settings
    assert asked.profile
    assert asked.posterior is not None
    assert [tuple(pair) for pair in asked.maps] == [("R", "L")]
    identifying.how.value, identifying.also.value = "local", []
    assert page.page.words("identify") == ["identify", "study.toml"]


def test_from_not_determined_to_the_remedy(page: Page, path: Path, tmp_path: Path) -> None:
    remedies = page.page.identifying.remedies
    result(tmp_path, {"R": (4.0, 0.1), "L": (0.1, None)})
    remedies.tell(tmp_path)
    offered = {each.name: each for each in remedies.layout.select({"type": Button})}
    assert {"fix l", "give l a prior", "compare excitations"} <= set(offered)
    assert "fix r" not in offered
    offered["fix l"]._trigger_event(ButtonClick(offered["fix l"]))
    assert page.page.words("identify")[2:] == ["--set", "parameters.L=0.05"]
    page.rows["L"].hold.active = False
    offered["give l a prior"]._trigger_event(ButtonClick(offered["give l a prior"]))
    _, _, *words = page.page.words("identify")
    prior = Study.read(path, [word for word in words if word != "--set"]).parameters["L"].prior
    assert prior == Normal(0.05, 0.025)
    page.rows["L"].std.value = "0.01"
    assert "std = 0.01" in " ".join(page.page.words("identify"))
    page.rows["L"].std.value = "none"
    assert page.page.words("identify")[2:] == []
    page.rows["L"]._take_prior()
    remedies.excitations.compare()
    assert "No data files" in remedies.excitations.run.state.text
    result(tmp_path, {"R": (4.0, 0.1), "L": (0.1, 0.1)})
    remedies.tell(tmp_path)
    assert remedies.layout.children == []


@pytest.mark.slow
def test_the_last_result_is_shown_behind(path: Path, tmp_path: Path) -> None:
    (tmp_path / "first.csv").write_bytes((path.parent / "first.csv").read_bytes())
    (tmp_path / "study.toml").write_text(path.read_text())
    found = run_study(tmp_path / "study.toml", tmp_path / "results").result
    assert found.converged
    page = Page(tmp_path / "study.toml")
    values = dict(zip(found.names, found.values.tolist(), strict=True))
    ghost = page.layer("last optimum")["y"]
    np.testing.assert_allclose(ghost, simulated(path, values["R"], values["L"])[: len(ghost)], rtol=1e-5, atol=1e-6)
    assert "from the optimum" in page.page.scores.text
    page.page.put({"R": values["R"] + 3 * found.std[found.names.index("R")]})
    assert "+3 σ" in page.rows["R"].title.text
    page.page.put(values)
    page.settle()
    assert "at the optimum" in page.rows["R"].title.text
    assert "<b>0 σ</b>" in page.page.scores.text
    assert "converged" in page.page.identifying.text.text
    noise = Result.from_json(tmp_path / "results/result.json").fit.noise_variance["i"]
    counted = page.page.live.record.counted[:, 0]
    left = (page.page.live.record.measured[:, 0] - page.shown())[counted]
    assert f"{np.sqrt(np.mean(left**2) / noise):.3g} × noise level" in page.page.scores.text


def test_a_failing_simulation_is_a_line(page: Page) -> None:
    before = page.shown().copy()
    page.page.put({"L": 0.0})
    page.settle()
    assert "error" in page.page.scores.text
    np.testing.assert_array_equal(page.shown(), before)
    page.page.put({"L": 0.1})
    page.settle()
    assert "fit of i" in page.page.scores.text


def test_zooming_shows_more_of_less(page: Page) -> None:
    live, times = page.page.live, page.page.live.record.times
    live.across.update(start=float(times[100]), end=float(times[200]))
    page.settle()
    assert page.layer("simulated")["x"][0] == times[99]
    assert page.layer("simulated")["x"][-1] == times[200]
    assert page.layer("measured")["x"][0] == times[99]


def test_only_the_newest_is_done() -> None:
    done, begun, go = list[int](), threading.Event(), threading.Event()

    def work(what: int) -> None:
        done.append(what)
        begun.set()
        assert go.wait(PATIENCE)

    newest = LatestOnlyWorker(work)
    newest.ask(0)
    assert begun.wait(PATIENCE)
    for what in range(1, 50):
        newest.ask(what)
    go.set()
    end = time.monotonic() + PATIENCE
    while done != [0, 49]:
        assert time.monotonic() < end
        time.sleep(0.001)
    newest.close()


def test_a_page_dropped_while_it_simulates_ends_in_silence(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page, many = Page(path), Simulator.many
    begun, go, raised = threading.Event(), threading.Event(), list[object]()

    def slow(simulator: Simulator, theta: Any) -> Any:
        begun.set()
        assert go.wait(PATIENCE)
        return many(simulator, theta)

    monkeypatch.setattr(Simulator, "many", slow)
    monkeypatch.setattr(threading, "excepthook", raised.append)
    page.page.ask()
    assert begun.wait(PATIENCE)
    page.doc.callbacks.destroy()  # as a server does, which then says so
    go.set()
    (tell,) = page.doc.session_destroyed_callbacks
    tell(None)
    thread = page.page._newest._thread
    thread.join(PATIENCE)
    assert not thread.is_alive()
    assert raised == []


def test_ranges_of_sliders() -> None:
    bounded = reach_of(Parameter(2.0, min=1.0, max=5.0))
    assert (bounded.low, bounded.high, bounded.logarithmic) == (1.0, 5.0, False)
    wide = reach_of(Parameter(2.0, min=1e-3, max=1e3))
    assert wide.logarithmic
    assert wide.value(PLACES / 2) == pytest.approx(1.0)
    alone = reach_of(Parameter(10.0, min=0.0))
    assert alone.logarithmic
    assert (alone.low, alone.high) == (2.0, 50.0)
    signed = reach_of(Parameter(0.0, nominal=3.0))
    assert (signed.low, signed.high) == (-6.0, 6.0)
    known = reach_of(Parameter(9.0, prior=Normal(10.0, 0.5)), (9.8, 0.1))
    assert (known.low, known.high) == pytest.approx((1.96, 49.0))
    bent = reach_of(Parameter(-2.0, max=-1.0), (-3.0, 0.1))
    assert (bent.low, bent.high) == (-15.0, -1.0)
    for reach in (bounded, wide, alone, signed, known, bent):
        for place in (0.0, 123.0, PLACES):
            assert reach.place(reach.value(place)) == pytest.approx(place)
    assert wide.including(-1.0).logarithmic is False


def test_reach_of_an_estimate_is_not_its_interval() -> None:
    """An estimate does not shrink the range of its slider to values that move no curve; a switch does."""
    resistance, estimate = Parameter(14.7, min=0.0), (9.8, 0.05)
    reach = reach_of(resistance, estimate)
    assert (reach.low, reach.high) == pytest.approx((1.96, 49.0))
    near = reach_of(resistance, estimate, near=True)
    assert (near.low, near.high) == pytest.approx((9.3, 10.3))
    assert reach_of(resistance, (0.2, 0.05), near=True).low == 0.0  # the bound
    for std in (0.0, float("inf")):  # there is no interval
        assert reach_of(resistance, (9.8, std), near=True) == reach_of(resistance, (9.8, std))
    zero = reach_of(Parameter(0.0, nominal=3.0), (0.0, 0.1))
    assert (zero.low, zero.high) == (-6.0, 6.0)
    tiny = reach_of(Parameter(2.0), (1e-9, 0.1))
    assert (tiny.low, tiny.high) == pytest.approx((-1.0, 2.0))  # ten standard deviations and the start
    moved = Parameter(0.5, min=0.1, max=1.0)  # the bounds have changed since
    assert reach_of(moved, (9.8, 0.05), near=True) == reach_of(moved)


def test_the_switch_shows_ten_standard_deviations(path: Path, tmp_path: Path) -> None:
    for name in ("first.csv", "study.toml"):
        (tmp_path / name).write_bytes((path.parent / name).read_bytes())
    page = Page(tmp_path / "study.toml")
    assert page.page.near.disabled
    (tmp_path / "results").mkdir()
    result(tmp_path / "results", {"R": (4.0, 0.01), "L": (0.1, None)})
    page.page.show_result(tmp_path / "results")
    assert not page.page.near.disabled
    page.page.put({"R": 4.05, "L": 0.1})
    reach = {name: row.reach for name, row in page.rows.items()}
    page.page.near.active = True
    assert (page.rows["R"].reach.low, page.rows["R"].reach.high) == pytest.approx((3.9, 4.1))
    assert page.rows["R"].slider.value == pytest.approx(750.0)
    assert page.rows["R"].value == 4.05
    assert page.rows["L"].reach == reach["L"]  # it is not determined
    page.page.near.active = False
    assert {name: row.reach for name, row in page.rows.items()} == reach


def test_another_experiment_is_shown_with_what_is_known_of_it(path: Path, tmp_path: Path) -> None:
    text = path.read_text()
    entry = text[text.index("[[experiments]]") : text.index("[parameters]")]
    words = text.replace("[parameters]", entry.replace("first.csv", "second.csv") + "[parameters]")
    words = words.replace("R = {", "R = { per_experiment = true,")
    for name, seed in (("first", 1), ("second", 2)):
        coil_table(tmp_path / f"{name}.csv", 0.0, seed=seed)
    (tmp_path / "study.toml").write_text(words)
    (tmp_path / "results").mkdir()
    result(tmp_path / "results", {"R[first]": (4.1, 0.1), "L": (0.1, 0.01)})
    page = Page(tmp_path / "study.toml")
    assert "+19 σ" in page.rows["R"].title.text
    first, chosen = page.page.live.record.measured.copy(), page.page.simulators[1]
    page.page._choose(1)
    page.settle()
    assert page.page.simulator is chosen
    assert not np.array_equal(page.page.live.record.measured, first)
    np.testing.assert_allclose(page.shown(), chosen(page.page.theta)[:, 0], rtol=1e-12)
    assert "σ" not in page.rows["R"].title.text  # nothing is known of it here
    page.page._go_to_optimum()
    assert page.rows["L"].value == 0.1
    shown = page.shown().copy()
    page.page._show(page.page.simulators[0], page.page.theta, np.zeros((3, 1)), "", 0.0)  # of the one before: too late
    np.testing.assert_array_equal(page.shown(), shown)


def test_a_distance_is_told_only_where_there_is_one(page: Page, tmp_path: Path) -> None:
    """Of a direction that is open, one that is known for sure, and a file that cannot be read there is none."""
    for values, told in (((0.1, 0.01), True), ((0.1, None), False), ((0.1, 0.0), False), (None, False)):
        if values is None:
            (tmp_path / "result.json").write_text("{")
        else:
            result(tmp_path, {"R": (4.0, 0.1), "L": values})
        page.page.show_result(tmp_path)
        page.settle()
        assert ("from the optimum" in page.page.scores.text) == told, values
        assert page.page.to_optimum.disabled == (values is None)


def test_a_study_without_parameters_has_no_sliders(path: Path) -> None:
    study = Study.of({**Study.read(path).data, "parameters": {}}, path)
    with pytest.raises(InputError, match="no parameters: name at least one"):
        StudyPage(Document(), Bench(Folder(path.parent)), path, study, "light")
