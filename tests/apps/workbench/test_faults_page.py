"""The page of a study's faults, without a browser: what it begins, and that it follows what is written meanwhile."""

import shutil
import threading
from pathlib import Path

import pytest
from bokeh.document import Document
from bokeh.models import Div

import fmuid
from fmuid import InputError, Study
from fmuid.apps.cli.options import NOT_SUCCEEDED
from fmuid.apps.workbench.pages.faults import FaultsPage
from fmuid.apps.workbench.pages.panels import ResultsView
from tests.support.results import result
from tests.support.running import run_diagnosis, run_monitoring, run_study
from tests.support.workbench import PATIENCE, asked_for, bench_of, coil_study, described, finished


def text(shown: ResultsView) -> str:
    return " ".join(each.text for each in shown.layout.children if isinstance(each, Div))


def test_results_view_follows_its_folder(tmp_path: Path) -> None:
    shown = ResultsView(Document(), tmp_path, "light", ("identification",))
    assert "No result yet" in text(shown)
    described(result(tmp_path, {"R": (4.0, 0.1)}))
    shown.look()
    assert "4.00 ± 0.10" in text(shown)
    before = shown.layout.children
    shown.look()
    assert shown.layout.children == before  # nothing is drawn again
    (tmp_path / "document.json").write_text("{half of")
    shown.look()
    assert shown.layout.children == before
    described(result(tmp_path, {"R": (5.0, 0.1)}))
    shown.look()
    assert "5.00 ± 0.10" in text(shown)


def test_study_without_diagnosis_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no \[diagnosis\]"):
        FaultsPage(asked_for(coil_study(tmp_path).name), bench_of(tmp_path))


@pytest.mark.slow
def test_diagnosis_is_started_and_results_are_followed(tmp_path: Path) -> None:
    coil, test = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    run_study(Study.of(coil.study, tmp_path / "coil.toml"), tmp_path / "healthy")
    (tmp_path / "records").mkdir()
    shutil.copy(test.path, tmp_path / "records/one.csv")
    fault = f'[diagnosis.faults.turns]\nfmu = "{test.fmu.as_posix()}"\nparameters = {{ dR = {{ nominal = 1.0 }} }}\n'
    (tmp_path / "faults.toml").write_text(
        f'[model]\nfmu = "{coil.fmu.as_posix()}"\n[[experiments]]\ndata = "records/one.csv"\ninputs = ["u"]\n'
        f'outputs = ["i"]\n[diagnosis]\nbaseline = "healthy/result.json"\n{fault}[monitoring]\n'
        "false_alarm_rate = 0.01\n"
    )
    study = tmp_path / "faults.toml"
    page = FaultsPage(asked_for("faults.toml"), bench_of(tmp_path))
    assert page.records.options == ["", "records/", "records/one.csv"]
    page.monitor()
    assert "Choose a data file" in page.run.state.text
    page.records.value, page.follow.active = "records/", True
    assert page.words() == ["monitor", "faults.toml", "records", "--follow"]

    page.diagnose()
    assert finished(page.run).code == NOT_SUCCEEDED  # a fault
    assert "turns" in text(page.shown)
    assert "Causes" in text(page.shown)

    elsewhere = threading.Thread(target=run_monitoring, args=(study, [tmp_path / "records"], tmp_path / "results"))
    elsewhere.start()
    elsewhere.join(PATIENCE)
    page.shown.look()
    assert "Monitoring" in text(page.shown)
    assert "ALARM" in text(page.shown)
    assert "Causes" in text(page.shown)
    found = run_diagnosis(study).diagnosis
    assert found.kind in text(page.shown)
