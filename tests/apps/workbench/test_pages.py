"""Pages without a browser: the folder, results, batches, new studies; commands that are followed."""

import base64
import html
import json
import math
import re
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.events import ButtonClick
from bokeh.models import Button, ColumnDataSource, FileInput

import fmuid
from fmuid import Result, Study
from fmuid.apps.cli.options import DONE
from fmuid.apps.workbench import Folder
from fmuid.apps.workbench.home import _results, _studies
from fmuid.apps.workbench.pages.batch import BatchPage, case_settings
from fmuid.apps.workbench.pages.live import LiveFit, ZoomedFit
from fmuid.apps.workbench.pages.new import NewPage
from fmuid.apps.workbench.pages.remedy_panel import UndeterminedResult
from fmuid.apps.workbench.pages.results import PredictAction, WriteAction, _compared, build
from fmuid.apps.workbench.project_folder import FoundResult, FoundStudy
from fmuid.events import EVENTS, BatchStep, Event, GlobalStep, SearchStep, of_line
from fmuid.reports.render.document_json import read_documents
from fmuid.reports.render.progress import Display
from fmuid.reports.topics.fit import fit_charts
from fmuid.runs import CaseList, made_from
from fmuid.runs.batch.study_package import BatchStudy
from fmuid.simulation import OutputFit
from tests.support.begun_batch import batch
from tests.support.coil_study import COIL, STUDY, coil_table
from tests.support.results import result
from tests.support.running import run_study
from tests.support.workbench import asked_for, bench_of, coil_study, described, finished

EVENTS_SEEN: tuple[Event, ...] = (
    Event(task="uncertainty", share=0.0),
    SearchStep(number=2, cost=math.inf, damping=0.1, accepted=False, values={"R": 4.0}),
    GlobalStep(task="spread", done=3, total=9, cost=1.5, values={"R": 4.0}, simulations=30),
    BatchStep(done=1, total=4, failed=0, rate=0.0, left=math.inf, threads=2),
)


def test_commands_write_their_events_as_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(EVENTS, str(tmp_path / "events"))
    with Display() as display:
        for event in EVENTS_SEEN:
            display(event)
    told = (tmp_path / "events").read_text().splitlines()
    assert repr(tuple(map(of_line, told))) == repr(EVENTS_SEEN)  # NaN is not itself
    with pytest.raises(ValueError, match="no event"):
        of_line("{}")


def test_first_page_lists_studies_and_results(tmp_path: Path) -> None:
    evil = "<img src=x onerror=alert(1)>"
    (tmp_path / "a/results").mkdir(parents=True)
    (tmp_path / "a/study.toml").write_text(STUDY.replace('"Coil"', f'"{evil}"'))
    (tmp_path / "a/broken.toml").write_text("[model\n")
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "none"\n')
    told = {"file": "../study.toml", "content": {}}
    result(tmp_path / "a/results", {"R": (4.0, 0.1)}, study=told, outcome="converged")
    folder = Folder(tmp_path)
    studies, results = folder.look()
    assert [each.path.name for each in studies] == ["broken.toml", "study.toml"]
    page = _studies(folder, studies, results, set()) + _results(folder, results)
    assert evil not in page
    links = ("/study?file=a/study.toml", "/results?file=a/results")
    for said in ("&lt;img", "broken.toml: ", "R = 4.00 ± 0.10", "2 parameters, 1 data file", *links):
        assert said in page, said
    bare = FoundStudy(tmp_path / "a/broken.toml", "faults")
    for name, kind, word in (("b/c", "monitoring", "monitored"), ("", "diagnosis", "diagnosed")):
        (tmp_path / "a" / name).mkdir(parents=True, exist_ok=True)
        kept = tmp_path / "a" / name / f"{kind}.json"
        kept.write_text(json.dumps({"study": {"file": "broken.toml", "digest": "0"}}))
        page = _studies(folder, [bare], [FoundResult.of(kept)], set())
        assert f">{word}<" in page and "Last result" in page
    assert ">running<" in _studies(folder, studies, results, {(tmp_path / "a/study.toml").resolve()})


def test_results_lead_to_remedies(tmp_path: Path) -> None:
    for k, name in enumerate(("first.csv", "other.csv")):
        coil_table(tmp_path / name, 0.0, seed=k)
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("[parameters]", "[parameters]\nk = { start = 2.0 }\n"))
    given = ["experiments.0.data=other.csv", "parameters.R.start=7.5", "parameters.k=3", "title=A b"]
    given += ["parameters.L.prior={ mean = 0.1, std = 1e-3 }"]
    run = Study.read(path, given)
    for name, std in (("open", None), ("known", 0.1)):
        (tmp_path / name).mkdir()
        origin = made_from(run, folder=tmp_path / name)
        described(result(tmp_path / name, {"R": (4.0, 0.1), "L": (0.1, std)}, origin=origin))
    doc = asked_for("open")
    build(doc, bench_of(tmp_path))
    text = "".join(each for each, _ in doc.template_variables["pieces"])
    study, hold, prior = (html.unescape(each) for each in re.findall('class=go href="([^"]*)"', text))
    assert study == "/study?file=study.toml"
    for link, act in ((hold, "hold"), (prior, "prior")):
        asked = parse_qs(urlsplit(link).query)
        assert asked["file"] == ["study.toml"]
        assert asked[act] == ["L"]
        assert Study.read(path, asked["set"]).data == run.data
    designing = next(each for each in doc.roots if each.name == "designing")
    assert "compare excitations" in {each.name for each in designing.select({"type": Button})}
    words = UndeterminedResult(Folder(tmp_path), tmp_path / "open").designing
    design = Study.read(path, [word for word in words if word != "--set"])
    assert design.known_variance == {"i": 1.0}  # as the result says
    assert [(name, each.start) for name, each in design.parameters.items()] == [("R", 4.0), ("L", 0.05)]
    build(doc := asked_for("known"), bench_of(tmp_path))
    assert "designing" not in {each.name for each in doc.roots}
    body, _ = _compared(Folder(tmp_path), [tmp_path / "open", tmp_path / "known"])
    assert body.count("Fix L") == 1
    assert 'href="/results?file=open#remedies"' in body
    path.unlink()
    assert UndeterminedResult(Folder(tmp_path), tmp_path / "open").names == []


def test_figures_of_results_have_places_on_their_page(tmp_path: Path) -> None:
    names = ("first", "second")
    for name in names:
        (tmp_path / name).mkdir()
        described(result(tmp_path / name, {"R": (4.0, 0.1), "L": (0.1, 0.01)}))
    for asked in (names[:1], names):
        doc = asked_for(*asked)
        build(doc, bench_of(tmp_path))
        told = doc.template_variables
        assert [root for _, root in told["pieces"] if root] == [root.name for root in doc.roots]
        drawings = json.loads(told["figures"])["drawings"]
        places = [place for _, (where,) in drawings for place in where["roots"].values()]
        assert places
        body = "".join(text for text, _ in told["pieces"])
        assert all(f'id="{place}"' in body for place in places)


def test_long_fit_is_downsampled_for_each_interval() -> None:
    times, rng = np.linspace(0.0, 10.0, 50_001), np.random.default_rng(1)
    simulated = np.sin(times)[:, None]
    half, counted = np.full_like(simulated, 0.3), np.ones_like(simulated, dtype=bool)
    measured = simulated + rng.normal(0.0, 0.1, simulated.shape)
    record = OutputFit("first", times, ("i",), ("A",), measured, simulated, counted)
    due = list[Any]()
    zoomed = ZoomedFit(due.append, times, fit_charts(record, (half, 0.95)), "light")
    across = zoomed.window.across

    def shown() -> dict[str, dict[str, Any]]:
        return {each.mark: dict(each.data) for each in zoomed.grid.charts[0].layers}

    assert len(shown()["line"]["x"]) < 5000
    across.update(start=2.0, end=2.1)
    assert len(due) == 1  # once for both ends
    due.pop()()
    rows = slice(9999, 10_501)  # one more at the beginning
    line, dots, band = shown()["line"], shown()["points"], shown()["band"]
    for each in (line, dots):
        np.testing.assert_array_equal(each["x"], times[rows])
    np.testing.assert_allclose(dots["y"], measured[rows, 0], rtol=1e-6)
    np.testing.assert_allclose(line["r"], (measured - simulated)[rows, 0], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(band["y1"], (simulated + half)[rows, 0], rtol=1e-6)
    sources = zoomed.figure.select({"type": ColumnDataSource})
    assert any(len(source.data["c0"]) == 502 for source in sources if "c0" in source.data)  # they are exchanged
    across.update(start=0.0, end=10.0)
    due.pop()()
    assert shown()["line"]["x"][[0, -1]].tolist() == [0.0, 10.0]
    assert len(shown()["line"]["x"]) < 5000


def test_a_spectrum_is_drawn_over_its_frequencies() -> None:
    """Rows fall in frequency; a zoom shows those between two frequencies."""
    frequency = np.logspace(3.0, -1.0, 41)
    measured, simulated = np.sqrt(frequency)[:, None], 1.1 * np.sqrt(frequency)[:, None]
    axis = {"frequency": frequency}
    counted, rows = np.ones((41, 1), dtype=bool), np.arange(41.0)
    record = OutputFit("sweep", rows, ("Z.real",), ("Ohm",), measured, simulated, counted, "frequency", axis)
    due = list[Any]()
    drawn = LiveFit(record, due.append, "light")
    across = drawn.grid.charts[0].x
    assert (across.kind, across.label) == ("log", "frequency (Hz)")
    drawn.across.update(start=0.95, end=10.5)
    due.pop()()
    drawn.draw(2.0 * simulated)
    drawn_layers = (each for each in drawn.grid.charts[0].layers if each.label != "last optimum")
    layers: dict[str, dict[str, Any]] = {each.mark: dict(each.data) for each in drawn_layers}
    inside = slice(9, 22)  # one more at each end
    np.testing.assert_allclose(layers["points"]["x"], frequency[::-1][inside])
    np.testing.assert_allclose(layers["points"]["y"], measured[::-1][inside, 0], rtol=1e-6)
    np.testing.assert_allclose(layers["line"]["y"], 2.0 * simulated[::-1][inside, 0], rtol=1e-6)


def test_pages_without_their_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(fmuid.InputError, match="Choose results on the first page"):
        build(Document(), bench_of(tmp_path))
    with pytest.raises(fmuid.InputError, match=r"has no batch\.json"):
        BatchPage(asked_for("."), bench_of(tmp_path))


def test_batch_of_another_process_is_followed(tmp_path: Path) -> None:
    batch(tmp_path / "out", 2)
    page = BatchPage(asked_for("out"), bench_of(tmp_path))
    assert "2 of 5 cases, 1 failed" in page.state.text
    batch(tmp_path / "out", 4)
    page.look()
    assert "4 of 5 cases, 1 failed" in page.state.text
    assert list(page.source.data["case"]) == [0, 1, 2, 3]
    page.status.value = "failed"
    assert list(page.source.data["case"]) == [1]
    page.status.value = "all"
    page.text.value = "WALL"
    assert list(page.source.data["case"]) == [1]
    (tmp_path / "out/logs").mkdir()
    (tmp_path / "out/logs/case-000001.txt").write_text("the FMU said <so>")
    page.source.selected.indices = [0]
    assert "hit &lt;b&gt;a wall" in page.case.text
    assert "the FMU said &lt;so&gt;" in page.case.text
    page.text.value = ""
    assert page.source.selected.indices == [1]  # the case, wherever its row is
    page.number.value = "3"
    assert "<td>4.03</td>" in page.case.text
    page.number.value = "7"
    assert "No case 7 yet" in page.case.text


def test_case_leads_to_its_study_and_values(tmp_path: Path) -> None:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    (tmp_path / "records").mkdir()
    for k in range(2):
        coil_table(tmp_path / f"records/r{k}.csv", 0.0, seed=k)
    words = '[batch]\ndata = "records/*.csv"\nsweep = { L = [0.1, 0.2] }\n'
    (tmp_path / "study.toml").write_text(STUDY + words)
    batch(tmp_path / "out", 3)
    manifest = json.loads((tmp_path / "out/batch.json").read_text())
    manifest |= BatchStudy(Study.read(tmp_path / "study.toml"), isolated=False, versions={}).manifest()
    manifest |= {"dashboard": "http://host:8787/status?a=<b>"}
    (tmp_path / "out/batch.json").write_text(json.dumps(manifest))
    page = BatchPage(doc := asked_for("out"), bench_of(tmp_path))
    page.source.selected.indices = [2]
    link = re.search(r'href="([^"]*)">Simulate this case', page.case.text)
    assert link is not None
    asked = parse_qs(urlsplit(html.unescape(link[1])).query)
    assert asked["file"] == ["study.toml"]
    study = Study.read(tmp_path / "study.toml", asked["set"])
    case = CaseList(Study.read(tmp_path / "study.toml"))[2]
    assert case.table is not None
    assert Path(study.path.parent, study.experiments[0].data).resolve() == case.table.resolve()
    assert study.model.values["L"] == case.held["L"]
    assert {name: each.start for name, each in study.parameters.items()} == {"R": 4.02}
    with pytest.raises(fmuid.InputError, match=r"study\.toml has no case 4 any more"):
        case_settings(tmp_path / "study.toml", 4, page.frame.iloc[0])
    assert doc.title == "Coil"
    told = " ".join(text for text, _ in doc.template_variables["pieces"])
    assert 'href="http://host:8787/status?a=&lt;b&gt;"' in told
    (tmp_path / "out/batch.json").write_text(json.dumps(manifest | {"dashboard": "javascript:alert(1)", "study": {}}))
    page = BatchPage(doc := asked_for("out"), bench_of(tmp_path))
    page.source.selected.indices = [2]
    assert "javascript" not in " ".join(text for text, _ in doc.template_variables["pieces"])
    assert "Simulate this case" not in page.case.text


@pytest.mark.slow
def test_result_is_exported_by_commands(tmp_path: Path) -> None:
    assert run_study(coil_study(tmp_path), tmp_path / "results").succeeded
    doc: Any = Document()
    page = WriteAction(doc, bench_of(tmp_path), tmp_path / "results")
    assert page.fmus[page.fmu.value] == COIL.resolve()
    assert "fmuid report" in page.command.text
    assert "fmuid apply" in page.command.text
    for act, written in (("Write the report", "report.html"), ("Apply to the FMU", "Coil-identified.fmu")):
        (tmp_path / "results" / written).unlink(missing_ok=True)
        pressed = next(each for each in page.run.buttons if each.label == act)
        pressed._trigger_event(ButtonClick(pressed))
        assert finished(page.run).code == DONE
        assert (tmp_path / "results" / written).is_file()
        assert f"results/{written}<" in page.said.text
    found = fmuid.FMU(tmp_path / "results/Coil-identified.fmu").description.variables["R"].start
    assert found == pytest.approx(float(Result.from_json(tmp_path / "results/result.json")["R"]))


def test_wrong_data_file_is_not_predicted(tmp_path: Path) -> None:
    page = PredictAction(Document(), bench_of(tmp_path), tmp_path)
    for given, said in (
        (FileInput(filename="", value=""), "Choose or drop one"),
        (FileInput(filename="../../evil.exe", value="bm8="), "evil.exe: not a data file"),
        (FileInput(filename="torn.csv", value="dGlt%"), "torn.csv: upload incomplete"),
    ):
        page.dropped = given
        page.begin()
        assert said in page.run.state.text
        assert page.run.job is None


@pytest.mark.slow
def test_dropped_data_file_is_predicted(tmp_path: Path) -> None:
    coil_table(tmp_path / "second.csv", 0.0, seed=2)
    assert run_study(coil_study(tmp_path), tmp_path / "results").succeeded
    doc: Any = Document()
    page = PredictAction(doc, bench_of(tmp_path), tmp_path / "results")
    assert page.chosen.options == ["", "first.csv", "second.csv"]
    content = base64.b64encode((tmp_path / "second.csv").read_bytes()).decode()
    page.dropped = FileInput(filename="../third.csv", value=content)
    page.begin()
    assert finished(page.run).code == DONE
    assert (tmp_path / "results/prediction/dropped/third.csv").is_file()
    assert "Done" in page.run.state.text
    assert "Prediction" in page.said.text
    (part,) = read_documents(tmp_path / "results/prediction").values()
    scores, *drawn = part.sections
    assert "third" in scores.table[0].cells
    assert [each.key for each in drawn] == ["prediction", "residuals"]


@pytest.fixture
def page(tmp_path: Path) -> NewPage:
    (tmp_path / "coil.fmu").write_bytes(COIL.read_bytes())
    coil_table(tmp_path / "bench.csv", 0.0, seed=1)
    text = (tmp_path / "bench.csv").read_text().replace("time,u,i", "time,U_soll,strom")
    (tmp_path / "bench.csv").write_text(text)
    return NewPage(Document(), bench_of(tmp_path))


def test_data_files_are_shown_as_read(page: NewPage) -> None:
    assert page.fmu.value == "coil.fmu"  # there is one
    assert page.run.buttons[0].disabled
    page.tables.value = ["bench.csv"]
    assert "600 samples" in page.said.text
    assert "only column of this quantity" in page.said.text
    assert "time,U_soll,strom" in page.said.text  # of the file
    assert set(page.maps) == {"u", "i"}
    assert not page.run.buttons[0].disabled
    page.unit.value = "ms"
    assert f"{0.599e-3:.6g} s" in page.said.text
    page.time.value = "zeit"
    assert "role=alert" in page.said.text
    assert page.run.buttons[0].disabled
    page.rate.value = "-3"
    assert "sample rate: -3 is not a number above 0" in page.said.text


def test_rows_without_a_time_are_shown(page: NewPage, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("u,i\n2,0.5\n4,1.01\n8,1.99\n", encoding="utf-8")
    page.tables.options = [*page.tables.options, "points.csv"]
    page.tables.value = ["points.csv"]
    assert "a kind for rows without times" in page.said.text
    page.kind.value = "steady"
    assert "3 rows" in page.said.text
    assert page.words()[-2:] == ["--kind", "steady"]


def test_chosen_columns_are_in_the_command(page: NewPage) -> None:
    page.tables.value = ["bench.csv"]
    page.maps["i"].value = "(none)"
    assert "no column for the output i" in page.said.text
    assert page.words() == ["init", "coil.fmu", "bench.csv", "--output", "study.toml", "--map", "i="]
    page.maps["i"].value = "strom"
    page.maps["u"].value = "U_soll"
    assert page.words()[-4:] == ["--map", "u=U_soll", "--map", "i=strom"]
    assert "given" in page.said.text


@pytest.mark.slow
def test_study_is_written_by_the_shown_command(page: NewPage, tmp_path: Path) -> None:
    page.tables.value = ["bench.csv"]
    page.maps["u"].value, page.maps["i"].value = "U_soll", "strom"
    page.prepare["end_time"].value = "0.5"
    page.output.value = "../evil.toml"
    page.write()
    assert "not a .toml file in this folder" in page.run.state.text
    page.output.value = "made.toml"
    assert "--output made.toml" in page.command.text
    page.write()
    assert finished(page.run).code == DONE, page.run.state.text
    assert "study?file=made.toml" in page.run.state.text
    study = Study.read(tmp_path / "made.toml")
    assert sorted(study.parameters) == ["L", "R"]
    assert study.tables[0].times[-1] == pytest.approx(0.5)
    shown = page.records[0].experiment
    assert shown is not None
    np.testing.assert_array_equal(shown.output_values, study.tables[0].output_values)
