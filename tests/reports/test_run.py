"""A run of a study from Python: what the command does, with the same numbers and files."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import codec, files
from fmuid.apps.cli.options import DONE
from fmuid.estimation import RESULT_SCHEMA
from fmuid.events import Event, GlobalStep, ProfileStep, Progress, SearchStep
from fmuid.runs import IdentificationRun, identified
from tests.support.coil_study import STUDY, coil_table, fmuid_, result
from tests.support.running import run_study

PRIOR = STUDY.replace("min = 0.0", "min = 0.0, prior = { mean = 4.0, std = 1.0 }")
ASKED = '[uncertainty]\nprofile_likelihood = ["R"]\n'
BOUNDED = STUDY.replace("min = 0.0", "min = 0.5, max = 50.0").replace("min = 1e-3", "min = 1e-3, max = 1.0")
GLOBAL = '[estimation]\nmethod = "multi-start"\nn_starts = 6\nseed = 3\n'


@pytest.fixture
def study(tmp_path: Path) -> Path:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    (tmp_path / "study.toml").write_text(PRIOR + ASKED)
    return tmp_path / "study.toml"


def stopping(where: type[Event]) -> Progress:
    """Return a progress that does what Ctrl-C does at the first event of a kind."""

    def progress(event: Event) -> None:
        if isinstance(event, where):
            raise KeyboardInterrupt

    return progress


def test_rows_that_are_missing_are_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    table = pd.read_csv(tmp_path / "first.csv")
    table.drop(index=range(100, 110)).to_csv(tmp_path / "first.csv", index=False)
    (tmp_path / "study.toml").write_text(STUDY)
    assert fmuid_("identify", tmp_path / "study.toml", "--no-isolation", "--output", tmp_path) == DONE
    said = f"first: rows missing after {table['time'][99]:.6g} s; inputs are interpolated"
    found = result(tmp_path)
    assert capsys.readouterr().out.count(said) == 1
    assert found["dropouts"] == {"first": [table["time"][99]]}
    assert (tmp_path / "report.html").read_text().count(said) == 1


def test_without_a_folder_nothing_is_written(study: Path) -> None:
    before = sorted(study.parent.rglob("*"))
    found = run_study(fmuid.Study.read(study))
    assert found.succeeded
    assert found.files == ()
    assert math.isfinite(found.assessment.profiles[0].upper)
    assert sorted(study.parent.rglob("*")) == before
    with pytest.raises(fmuid.InputError, match="in a folder"):
        fmuid.run(study, figures="png")
    with pytest.raises(fmuid.InputError, match="needs the folder"):
        run_study(study, resume=True)
    with pytest.raises(fmuid.InputError, match="png, svg, pdf"):
        fmuid.run(study, study.parent, figures="jpg")


def test_events_come_in_their_order(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fmuid.runs.run.QUICK_SECONDS", 0.0)
    events: list[Event] = []
    found = run_study(study, progress=events.append)
    tasks = list(dict.fromkeys(event.task for event in events))
    assert tasks == ["search", "data alone", "uncertainty", "profile"]
    steps = [event for event in events if isinstance(event, SearchStep)]
    assert steps[0].values == {"R": 6.0, "L": 0.05}
    assert math.isnan(steps[0].share)
    assert steps[-1].values["R"] == pytest.approx(found.result["R"], abs=found.result["R"].std)
    first, last = identified(fmuid.Study.read(study))
    np.testing.assert_array_equal(last.result.values, first.result.values)
    assert not first.assessment.is_explored
    assert last.assessment.is_explored


def test_a_folder_that_another_run_writes_to(study: Path, tmp_path: Path) -> None:
    """As where the workbench was killed and opened again while its command goes on."""
    with files.locked(tmp_path / "out", "identification"):
        refused = pytest.raises(fmuid.InputError, match=r"out is written to by another identification \(process \d+ on")
        with refused:
            run_study(study, tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []
    assert run_study(study, tmp_path / "out").succeeded


def test_interrupted_run_keeps_what_is_known(study: Path, tmp_path: Path) -> None:
    found = run_study(study, tmp_path / "out", progress=stopping(ProfileStep))
    assert found.result.converged and found.assessment.interrupted and not found.succeeded
    assert result(tmp_path / "out")["converged"] is True
    study.write_text(BOUNDED + GLOBAL)
    found = run_study(study, tmp_path / "out", progress=stopping(GlobalStep))
    assert found.assessment.residuals is None
    written = json.loads((tmp_path / "out/result.json").read_text())
    assert written["parameters"]["R"]["value"] == found.result["R"]
    assert {path.name for path in found.files} == {"result.json", "estimates.csv", "document.json"}
    again = codec.read(tmp_path / "out/result.json", RESULT_SCHEMA, IdentificationRun, "")
    assert codec.as_json(again) == codec.as_json(found)
