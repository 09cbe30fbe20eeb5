"""The page of a study without a browser: sliders are moved, callbacks run by hand."""

import json
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from bokeh.document.events import SessionCallbackAdded
from bokeh.events import ButtonClick
from bokeh.models import Button

from fmuid import InputError, Normal, Parameter, Simulator, Study
from fmuid.apps.workbench.pages.live import LatestOnlyWorker
from fmuid.apps.workbench.pages.sliders import PLACES, reach_of
from fmuid.apps.workbench.pages.study import StudyPage
from tests.support.coil_study import COIL, coil_table
from tests.support.isolated import wait_until
from tests.support.results import result
from tests.support.running import run_study
from tests.support.workbench import PATIENCE, asked_for, bench_of, coil_study, described


class Page:
    """A page and what runs its callbacks."""

    def __init__(self, path: Path, given: Sequence[str] = ()) -> None:
        self.doc = asked_for(path.name, settings=given)
        self.due: list[Any] = []  # in the order in which a server would call them
        self.doc.on_change(self._note)
        self.page = StudyPage(self.doc, bench_of(path.parent), isolated=False)
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
    return coil_study(tmp_path_factory.mktemp("page"))


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


@pytest.fixture
def copied(path: Path, tmp_path: Path) -> Path:
    """Return a copy of the study, with an empty folder for its result."""
    for name in ("first.csv", "study.toml"):
        (tmp_path / name).write_bytes((path.parent / name).read_bytes())
    (tmp_path / "results").mkdir()
    return tmp_path / "study.toml"


def simulated(path: Path, R: float, L: float) -> np.ndarray[Any, Any]:
    study = Study.read(path)
    return Simulator(study.system, study.tables[0], ["R", "L"], values=study.model.values)([R, L])[:, 0]


def as_told(page: Page, path: Path) -> Study:
    """Return the study that the command of the page reads."""
    return Study.read(path, [word for word in page.page.words("identify")[2:] if word != "--set"])


def test_slider_simulates_and_zoom_draws_each_sample(page: Page, path: Path) -> None:
    row, live = page.rows["R"], page.page.live
    row.slider.value = 250
    page.settle()
    assert row.value == row.reach.value(250) != row.parameter.start
    assert row.typed.value == f"{row.value:.6g}"
    expected, line = simulated(path, row.value, page.rows["L"].value), page.layer("simulated")
    np.testing.assert_allclose(page.shown(), expected, rtol=1e-12)
    drawn = np.interp(line["x"], live.record.times, expected)
    np.testing.assert_allclose(line["y"], drawn, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(line["r"], live.record.measured[:, 0] - expected, rtol=1e-4, atol=1e-6)
    for value in (0.5, 40.0, 4.0):  # the lines stay in the ranges
        page.page.put({"R": value})
        page.settle()
        upper, lower = live.uppers[0], live.lowers[0]
        assert upper.start <= page.shown().min() <= page.shown().max() <= upper.end
        assert np.abs(live.record.measured[:, 0] - page.shown()).max() <= lower.end == -lower.start
    times = live.record.times
    live.across.update(start=float(times[100]), end=float(times[200]))
    page.settle()
    assert page.layer("simulated")["x"][[0, -1]].tolist() == [times[99], times[200]]
    assert page.layer("measured")["x"][0] == times[99]


def test_typed_values_hold_and_undo(page: Page) -> None:
    row, start = page.rows["R"], page.rows["R"].value
    for typed, shown in (("7,5", "7.5"), ("-3", "7.5"), ("many", "7.5")):  # -3 is beyond the bound
        row.typed.value = typed
        assert (row.value, row.typed.value) == (7.5, shown)
    row.hold.active = True
    assert page.page.words("identify")[1:] == ["study.toml", "--set", "parameters.R=7.5"]
    assert "parameters.R=7.5" in page.page.command.text
    page.page.go_back()
    assert (row.held, row.value) == (False, 7.5)
    page.page.go_back()
    assert row.value == start
    assert page.page.undo.disabled
    assert page.page.settings() == []


def test_command_and_options_are_those_of_the_page(page: Page, path: Path) -> None:
    page.rows["R"].hold.active = True
    page.rows["L"].typed.value = "0.2"
    identifying = page.page.identifying
    identifying.how.value, identifying.starts.value = "multi-start", 7
    identifying.also.value = ["profile likelihood", "posterior", "cost map of R, L"]
    assert "simulate study.toml --set" in page.page.command.text
    assert "n_starts" not in page.page.command.text.partition("<br>")[0]  # options are for the optimization alone
    page.rows["R"].hold.active = False
    study = as_told(page, path)
    asked = study.uncertainty_settings
    assert study.parameters["L"].start == 0.2
    assert getattr(study.estimator, "starts", None) == 7
    assert asked.profile and asked.posterior is not None
    assert [tuple(pair) for pair in asked.maps] == [("R", "L")]
    identifying.how.value, identifying.also.value = "local", []
    page.rows["R"].hold.active = True
    study = as_told(page, path)
    assert (list(study.parameters), study.model.values["R"]) == (["L"], page.rows["R"].value)
    given = ['parameters."R".start=7', "estimation.max_iterations=9"]
    other = Page(path, given)
    other.rows["R"].typed.value = "8"
    assert other.page.words("identify")[2:] == ["--set", "parameters.R.start=8", "--set", given[1]]
    assert parse_qs(urlsplit(other.page.command.tags[0]).query)["set"] == ["parameters.R.start=8", given[1]]


def test_result_of_another_study_is_not_shown(copied: Path) -> None:
    (copied.parent / "other.toml").write_text(copied.read_text())
    told = {"file": "../other.toml"}
    described(result(copied.parent / "results", {"R": (4.0, 0.1), "L": (0.1, None)}, study=told))
    for name, own in (("study.toml", False), ("other.toml", True)):
        page = Page(copied.with_name(name)).page
        assert (page.optimum is not None) == own
        assert ("of another study" in page.identifying.text.text) != own
        assert bool(page.identifying.remedies.layout.children) == own


def test_remedies_of_a_parameter_that_is_not_identifiable(page: Page, path: Path, tmp_path: Path) -> None:
    remedies, row = page.page.identifying.remedies, page.rows["L"]
    result(tmp_path, {"R": (4.0, 0.1), "L": (0.1, None)})
    remedies.tell(tmp_path)
    offered = {each.name: each for each in remedies.layout.select({"type": Button})}
    assert {"fix l", "give l a prior", "compare excitations"} <= set(offered)
    assert "fix r" not in offered
    offered["fix l"]._trigger_event(ButtonClick(offered["fix l"]))
    assert page.page.words("identify")[2:] == ["--set", "parameters.L=0.05"]
    row.hold.active = False
    offered["give l a prior"]._trigger_event(ButtonClick(offered["give l a prior"]))
    assert as_told(page, path).parameters["L"].prior == Normal(0.05, 0.025)
    row.std.value = "0.01"
    assert "std = 0.01" in " ".join(page.page.words("identify"))
    row.std.value = "none"
    assert page.page.words("identify")[2:] == []
    row._take_prior()
    remedies.excitations.compare()
    assert "No data files" in remedies.excitations.run.state.text
    result(tmp_path, {"R": (4.0, 0.1), "L": (0.1, 0.1)})
    remedies.tell(tmp_path)
    assert remedies.layout.children == []


def test_the_offered_change_is_a_button(page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result(tmp_path, {"R": (4.0, 0.1), "L": (0.1, 0.1)})
    content = json.loads((tmp_path / "result.json").read_text())
    settings = ['experiments.0.interpolation="linear"']
    content["change"] = {
        "kind": "interpolation", "subject": ["u"], "value": "linear", "settings": settings, "gain": 37.0
    }  # fmt: skip
    (tmp_path / "result.json").write_text(json.dumps(content))
    begun: list[list[str]] = []
    monkeypatch.setattr(page.page.identifying, "begin", lambda: begun.append(page.page.words("identify")))
    page.page.identifying.remedies.tell(tmp_path)
    (offer,) = page.page.identifying.remedies.layout.select({"type": Button})
    offer._trigger_event(ButtonClick(offer))
    assert [words[-2:] for words in begun] == [["--set", *settings]]
    page.page._given = []


@pytest.mark.slow
def test_last_optimum_is_shown_behind(copied: Path) -> None:
    found = run_study(copied, copied.parent / "results").result
    assert found.converged
    page, R = Page(copied), found.names.index("R")
    values = dict(zip(found.names, found.values.tolist(), strict=True))
    ghost = page.layer("last optimum")["y"]
    np.testing.assert_allclose(ghost, simulated(copied, values["R"], values["L"])[: len(ghost)], rtol=1e-5, atol=1e-6)
    page.page.put({"R": values["R"] + 3 * found.std[R]})
    assert "+3 σ" in page.rows["R"].title.text
    page.page.put(values)
    page.settle()
    assert "at the optimum" in page.rows["R"].title.text
    assert "Converged" in page.page.identifying.text.text
    record = page.page.live.record
    left = (record.measured[:, 0] - page.shown())[record.counted[:, 0]]
    noise = found.fit.noise_variance["i"]
    for said in ("from the optimum", "<b>0 σ</b>", f"{np.sqrt(np.mean(left**2) / noise):.3g} × noise level"):
        assert said in page.page.scores.text


def test_failing_simulation_is_told(page: Page) -> None:
    before = page.shown().copy()
    page.page.put({"L": 0.0})
    page.settle()
    assert "error" in page.page.scores.text
    np.testing.assert_array_equal(page.shown(), before)
    page.page.put({"L": 0.1})
    page.settle()
    assert "fit of i" in page.page.scores.text


def test_worker_does_the_latest_request_only() -> None:
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
    wait_until(lambda: done == [0, 49], PATIENCE)
    newest.close()


def test_page_dropped_during_a_simulation_ends_in_silence(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    page.page._newest._thread.join(PATIENCE)
    assert not page.page._newest._thread.is_alive()
    assert raised == []


INF = float("inf")


@pytest.mark.parametrize(
    ("parameter", "estimate", "near", "low", "high", "logarithmic"),
    [
        (Parameter(2.0, min=1.0, max=5.0), None, False, 1.0, 5.0, False),
        (Parameter(2.0, min=1e-3, max=1e3), None, False, 1e-3, 1e3, True),
        (Parameter(10.0, min=0.0), None, False, 2.0, 50.0, True),
        (Parameter(0.0, nominal=3.0), None, False, -6.0, 6.0, False),
        (Parameter(9.0, prior=Normal(10.0, 0.5)), (9.8, 0.1), False, 1.96, 49.0, True),
        (Parameter(-2.0, max=-1.0), (-3.0, 0.1), False, -15.0, -1.0, False),
        (Parameter(14.7, min=0.0), (9.8, 0.05), True, 9.3, 10.3, False),
        (Parameter(14.7, min=0.0), (0.2, 0.05), True, 0.0, 0.7, False),  # the bound
        (Parameter(14.7, min=0.0), (9.8, INF), True, 1.96, 49.0, True),  # there is no interval
        (Parameter(0.5, min=0.1, max=1.0), (9.8, 0.05), True, 0.1, 1.0, False),  # the bounds have changed since
    ],
)
def test_reach_of_a_slider(
    parameter: Parameter, estimate: tuple[float, float] | None, near: bool, low: float, high: float, logarithmic: bool
) -> None:
    reach = reach_of(parameter, estimate, near=near)
    assert (reach.low, reach.high) == pytest.approx((low, high))
    assert reach.logarithmic == logarithmic
    for place in (0.0, 123.0, PLACES):
        assert reach.place(reach.value(place)) == pytest.approx(place)
    assert reach.including(-20.0).logarithmic is False


def test_near_switch_shows_ten_standard_deviations(copied: Path) -> None:
    page = Page(copied)
    assert page.page.near.disabled
    result(copied.parent / "results", {"R": (4.0, 0.01), "L": (0.1, None)})
    page.page.show_result(copied.parent / "results")
    page.page.put({"R": 4.05, "L": 0.1})
    reach = {name: row.reach for name, row in page.rows.items()}
    page.page.near.active = True
    R = page.rows["R"]
    assert (R.reach.low, R.reach.high, R.slider.value, R.value) == pytest.approx((3.9, 4.1, 750.0, 4.05))
    assert page.rows["L"].reach == reach["L"]  # it has no σ
    page.page.near.active = False
    assert {name: row.reach for name, row in page.rows.items()} == reach


def test_another_experiment_is_shown_with_its_estimates(copied: Path) -> None:
    text = copied.read_text()
    entry = text[text.index("[[experiments]]") : text.index("[parameters]")]
    text = text.replace("[parameters]", entry.replace("first.csv", "second.csv") + "[parameters]")
    coil_table(copied.with_name("second.csv"), 0.0, seed=2)
    copied.write_text(text.replace("R = {", "R = { per_experiment = true,"))
    result(copied.parent / "results", {"R[first]": (4.1, 0.1), "L": (0.1, 0.01)})
    page = Page(copied)
    assert "+19 σ" in page.rows["R"].title.text
    first, chosen = page.page.live.record.measured.copy(), page.page.simulators[1]
    page.page._choose(1)
    page.settle()
    assert page.page.simulator is chosen
    assert not np.array_equal(page.page.live.record.measured, first)
    np.testing.assert_allclose(page.shown(), chosen(page.page.theta)[:, 0], rtol=1e-12)
    assert "σ" not in page.rows["R"].title.text  # it has no estimate here
    page.page._go_to_optimum()
    assert page.rows["L"].value == 0.1
    shown = page.shown().copy()
    page.page._show(page.page.simulators[0], page.page.theta, np.zeros((3, 1)), "", 0.0)  # of the one before: too late
    np.testing.assert_array_equal(page.shown(), shown)


@pytest.mark.parametrize(("L", "told"), [((0.1, 0.01), True), ((0.1, None), False), ((0.1, 0.0), False), (None, False)])
def test_distance_needs_a_covariance(page: Page, tmp_path: Path, L: Any, told: bool) -> None:
    (tmp_path / "result.json").write_text("{")
    if L is not None:
        result(tmp_path, {"R": (4.0, 0.1), "L": L})
    page.page.show_result(tmp_path)
    page.settle()
    assert ("from the optimum" in page.page.scores.text) == told
    assert page.page.to_optimum.disabled == (L is None)


def test_study_without_parameters_is_refused(path: Path) -> None:
    fixed = ["parameters.R=1.0", "parameters.L=1.0"]
    with pytest.raises(InputError, match="no free parameter"):
        StudyPage(asked_for(path.name, settings=fixed), bench_of(path.parent))


@pytest.mark.parametrize(
    "table", ["f,re,im\n1,4.0,0.63\n10,4.0,6.3\n100,4.0,63\n", "u,i\n4,1\n"], ids=["spectrum", "row"]
)
def test_rows_without_a_time_follow_the_sliders(tmp_path: Path, table: str) -> None:
    """Impedance R + 2 pi f L j, and current u/R."""
    spectral = table.startswith("f")
    roles = 'responses.Z = { of = "u / i", real = "re", imaginary = "im" }\nfrequency = "f"' if spectral else ""
    kind = "frequency" if spectral else "steady"
    roles = roles or 'inputs = ["u"]\noutputs = ["i"]'
    (tmp_path / "table.csv").write_text(table)
    text = f'[model]\nfmu = "{COIL}"\n[[experiments]]\nkind = "{kind}"\ndata = "table.csv"\n{roles}\n[parameters]\n'
    path = coil_study(tmp_path, text + "R = { start = 4.0, min = 1.0, max = 9.0 }\n")
    page = Page(path)
    assert page.page.live.grid.charts[0].x.label == ("frequency (Hz)" if spectral else "row")
    page.rows["R"].slider.value = page.rows["R"].slider.end
    page.settle()
    value = page.rows["R"].value
    assert value > 4.5
    assert page.shown() == pytest.approx(np.full(3, value) if spectral else [4.0 / value], rel=1e-6)
