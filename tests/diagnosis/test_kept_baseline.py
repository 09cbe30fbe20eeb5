"""The stored baseline of a healthy study: records examined once for all diagnoses."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import fmuid
from fmuid.apps.cli.app import run
from fmuid.diagnosis import BaselineSource, StoredBaseline
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.reports.topics.diagnosis import UNLIKE, basis_notes
from fmuid.runs import FollowStatus
from tests.support.paths import FMUS
from tests.support.running import run_following, run_monitoring, run_study

COIL = Path(__file__).parents[2] / "experiments" / "coil"
MODEL = {"fmu": str(FMUS / "Coil/Coil.fmu")}
EXPERIMENT = {"data": "healthy.csv", "inputs": ["u"], "outputs": ["i"], "interpolation": "zoh"}
FAULTS = {"turns": {"fmu": str(FMUS / "CoilTurns/CoilTurns.fmu"), "parameters": {"lost": {"nominal": 0.1, "max": 0.9}}}}
STUDY = f"""
model.fmu = "{FMUS}/Coil/Coil.fmu"
experiments = [{{ data = "test1.csv", inputs = ["u"], outputs = ["i"], interpolation = "zoh" }}]
[diagnosis]
baseline = "healthy/result.json"
std_factor = {{ R = 10.0 }}
causes.sensor_delay = false
faults.turns = {{ fmu = "{FMUS}/CoilTurns/CoilTurns.fmu", parameters.lost = {{ nominal = 0.1, max = 0.9 }} }}
"""
START = {"R": {"start": 3.0}, "L": {"start": 0.2}}


def identified(folder: Path, **more: Any) -> None:
    words = {"model": MODEL, "experiments": [EXPERIMENT], "parameters": START} | more
    run_study(fmuid.Study.of(words, folder / "healthy.toml"), folder / "healthy")


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which the healthy coil was identified with the faults of later diagnoses."""
    folder = tmp_path_factory.mktemp("kept")
    for name in ("healthy.csv", "test1.csv", "test2.csv"):
        pd.read_csv(COIL / name).head(400).to_csv(folder / name, index=False)
    identified(folder, diagnosis={"faults": FAULTS})
    assert (folder / "healthy" / "baseline.npz").is_file()
    return folder


def asked(folder: Path, top: dict[str, Any] | None = None, **said: Any) -> fmuid.Study:
    known = {"baseline": "healthy/result.json", "faults": FAULTS, "std_factor": {"R": 10.0}}
    words = {"model": MODEL, "experiments": [EXPERIMENT | {"data": "test1.csv"}], "diagnosis": known | said}
    return fmuid.Study.of(words | (top or {}), folder / "test.toml")


def made(study: fmuid.Study) -> BaselineComparator:
    """Return the comparator of a diagnosis."""
    search = study.diagnosis
    assert search is not None
    faults = search.fault_models(study.system, study.model, study.data)
    baseline = search.healthy(study.model, study.parameters, study.noise, study.experiments[0].read_experiment)
    return BaselineComparator.of(study.system, baseline, faults, search.causes, study.tables)


def test_file_and_records_agree(kept: Path, tmp_path: Path) -> None:
    without = shutil.copytree(kept, tmp_path / "a")
    (without / "healthy/baseline.npz").unlink()
    from_file, records = made(asked(kept)), made(asked(without, healthy_data=["healthy.csv"]))
    fewer = {"sensor_gain": False, "sensor_delay": False}
    few = made(asked(without, causes=fewer, healthy_data=["healthy.csv"]))
    assert (from_file.healthy.basis, records.healthy.basis) == (BaselineSource.FILE, BaselineSource.RECORDS)
    assert from_file.healthy.known.mean == pytest.approx(records.healthy.known.mean, rel=1e-9)
    assert from_file.healthy.known.covariance == pytest.approx(records.healthy.known.covariance, rel=1e-9)
    # of fewer causes: the noise is that beside all of them
    assert from_file.shown is not None and from_file.shown.subject is not None
    assert few.shown is not None and few.shown.subject is not None
    among = from_file.shown.subject.among(from_file.shown, few.shown.subject)
    assert among.said[0].matrix == pytest.approx(few.shown.said[0].matrix, rel=0.02, abs=1e-6)


def test_diagnosis_and_monitoring_use_the_file(kept: Path) -> None:
    found = asked(kept).diagnose()
    assert found.evidence.basis is BaselineSource.FILE
    assert {"turns.lost", "gain(i)", "delay(i)"} <= {each.change.label for each in found.evidence.suspects}
    assert "from baseline.npz" in str(fmuid.Document.of(found))
    assert run_monitoring(asked(kept), [kept / "test1.csv"]).basis is BaselineSource.FILE
    wider = {"sensor_offset": {"healthy_std": 0.5, "change_std": 1.0}}  # not of the healthy machine
    assert made(asked(kept, causes=wider, healthy_data=["healthy.csv"])).healthy.basis is BaselineSource.FILE
    assert made(asked(kept, healthy_data=["test2.csv"])).healthy.basis is BaselineSource.OTHER_RECORDS


@pytest.mark.parametrize(
    ("top", "own", "basis"),
    [
        ({}, {"faults": FAULTS | {"other": FAULTS["turns"]}}, BaselineSource.OTHER_MODELS),
        ({"model": MODEL | {"fixed": {"i_start": 0.1}}}, {}, BaselineSource.OTHER_MODELS),
        ({}, {"causes": {"sensor_gain": False}}, BaselineSource.OTHER_CAUSES),
        ({"noise": {"variance": {"i": 1e-3}}}, {}, BaselineSource.OTHER_NOISE),
    ],
)
def test_a_file_that_does_not_fit(kept: Path, top: dict[str, Any], own: dict[str, Any], basis: BaselineSource) -> None:
    with pytest.raises(fmuid.InputError, match=f"made with {basis.value} than in this study"):
        made(asked(kept, top, **own))
    found = made(asked(kept, top, healthy_data=["healthy.csv"], **own)).healthy.basis
    assert found is basis
    assert f"not used ({UNLIKE[basis]})" in basis_notes(found)[0].text


@pytest.mark.parametrize(("words", "message"), [({"healthy_data": ["healthy.csv"]}, "healthy_data"), ({}, "baseline")])
def test_a_diagnosis_without_baseline(kept: Path, words: dict[str, Any], message: str) -> None:
    study = {"model": MODEL, "experiments": [EXPERIMENT], "diagnosis": {"faults": FAULTS} | words}
    with pytest.raises(fmuid.InputError, match=message):
        fmuid.Study.of(study, kept / "test.toml").diagnose()


def test_a_damaged_file(kept: Path, tmp_path: Path) -> None:
    """With healthy records a monitoring goes on without it, and says so; without them it gives the remedy."""
    folder = shutil.copytree(kept, tmp_path / "a")
    (folder / "records").mkdir()

    def followed(record: str, *names: str) -> fmuid.Monitor:
        pd.read_csv(folder / f"{record}.csv").to_parquet(folder / "records" / f"{record}.parquet")
        study, seen = asked(folder, healthy_data=list(names)), list[FollowStatus]()
        run_following(study, folder / "records", folder / "out", until=lambda at: at.idle, show=seen.append)
        return seen[-1].monitor

    assert followed("test1", "healthy.csv").basis is BaselineSource.FILE
    path = folder / "healthy/baseline.npz"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = followed("test2", "healthy.csv")
    assert (found.records, found.basis) == (("test1", "test2"), BaselineSource.DAMAGED)
    assert "not used (damaged)" in basis_notes(found.basis)[0].text
    with pytest.raises(fmuid.InputError, match=r"no complete file.*Identify the healthy study again"):
        followed("test1")


def test_a_run_without_faults_removes_the_file(kept: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(kept, tmp_path / "a")
    identified(folder)
    assert not (folder / "healthy/baseline.npz").is_file()


def test_a_baseline_is_made_and_extended(kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Made of one record, extended by another: as of both at once; a record counts once."""
    folder = shutil.copytree(kept, tmp_path / "a")
    study = folder / "test.toml"
    study.write_text(STUDY)
    file = folder / "healthy" / "baseline.npz"
    file.unlink()
    warm = pd.read_csv(COIL / "test2.csv").head(400)
    warm["u"] *= 2.0
    warm["i"] *= 2.0
    warm.to_csv(folder / "warm.csv", index=False)

    def baseline(*names: str) -> tuple[int, str]:
        code = run(["baseline", str(study), *(str(folder / name) for name in names)])
        given = capsys.readouterr()
        return code, " ".join((given.out + given.err).split())

    code, said = baseline("healthy.csv")
    assert code == 0 and "in the baseline: 1." in said and "rms(u) 1 1" in said
    first = StoredBaseline.read(file)
    code, said = baseline("warm.csv")
    assert code == 0 and "in the baseline: 2." in said
    both = StoredBaseline.read(file)
    assert both.said[0].matrix == pytest.approx(first.said[0].matrix)
    assert (len(both.said), len(both.structure.records), both.points.ranges()["rms(u)"]) == (2, 2, (1.0, 2.0))
    code, said = baseline("warm.csv")
    assert code == 2 and "already. Remove it from the list." in said
    found = asked(folder, causes={"sensor_delay": False}).diagnose()
    assert found.coverage is not None and (found.coverage.records, found.coverage.outside) == (2, ())
    frame = pd.read_csv(folder / "test1.csv")
    frame[["u", "i"]] *= 4.0
    frame.to_csv(folder / "test1.csv", index=False)
    far = asked(folder, causes={"sensor_delay": False}).diagnose()
    assert far.coverage is not None and "rms(u)" in [each.name for each in far.coverage.outside]
    words = str(fmuid.Document.of(far))
    assert "outside the baseline)" in words and "Outside the baseline: rms(u) = 4" in words
