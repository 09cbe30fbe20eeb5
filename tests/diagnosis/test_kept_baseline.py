"""What fmuid identify of a healthy study keeps of faults and sensors: the records, examined once for all diagnoses."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.apps.cli.app import run
from fmuid.diagnosis import BaselineSource
from fmuid.diagnosis.baseline_comparator import BaselineComparator
from fmuid.reports.topics.diagnosis_phrases import UNLIKE, basis_notes
from fmuid.runs import FollowStatus
from tests.support.paths import FMUS
from tests.support.running import run_following, run_monitoring, run_study

COIL = Path(__file__).parents[2] / "experiments" / "coil"
WORDS: dict[str, Any] = {
    "model": {"fmu": str(FMUS / "Coil/Coil.fmu")},
    "experiments": [{"data": "healthy.csv", "inputs": ["u"], "outputs": ["i"], "interpolation": "zoh"}],
}
FAULTS = {
    "turns": {"fmu": str(FMUS / "CoilTurns/CoilTurns.fmu"), "parameters": {"lost": {"nominal": 0.1, "max": 0.9}}},
}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which the healthy coil was identified with the faults to look for later."""
    folder = tmp_path_factory.mktemp("kept")
    for name in ("healthy.csv", "test1.csv", "test2.csv"):
        pd.read_csv(COIL / name).head(400).to_csv(folder / name, index=False)
    words = WORDS | {"parameters": {"R": {"start": 3.0}, "L": {"start": 0.2}}, "diagnosis": {"faults": FAULTS}}
    found = run_study(fmuid.Study.of(words, folder / "healthy.toml"), folder / "healthy")
    assert folder / "healthy" / "baseline.npz" in found.files
    return folder


def asked(folder: Path, **said: Any) -> fmuid.Study:
    known = {"baseline": "healthy/result.json", "faults": FAULTS, "std_factor": {"R": 10.0}}
    tested = {"experiments": [WORDS["experiments"][0] | {"data": "test1.csv"}], "diagnosis": known | said}
    return fmuid.Study.of(WORDS | tested, folder / "test.toml")


def made(study: fmuid.Study) -> BaselineComparator:
    """Return what a diagnosis compares records with."""
    search = study.diagnosis
    assert search is not None
    faults = search.fault_models(study.system, study.model, study.data)
    baseline = search.healthy(study.model, study.parameters, study.noise, study.experiments[0].read_experiment)
    return BaselineComparator.of(study.system, baseline, faults, search.causes, study.tables)


def test_the_file_says_what_the_records_say(kept: Path) -> None:
    from_file, records = made(asked(kept)), made(asked(kept, healthy_data=["test2.csv"]))
    assert (from_file.basis, records.basis) == (BaselineSource.FILE, BaselineSource.OTHER_RECORDS)
    wider = {"sensor_offset": {"healthy_std": 0.5, "change_std": 1.0}}
    assert (
        made(asked(kept, causes=wider, healthy_data=["healthy.csv"])).basis is BaselineSource.FILE
    )  # no matter of the healthy one
    shutil.move(kept / "healthy/baseline.npz", kept / "baseline.npz")
    examined = made(asked(kept, healthy_data=["healthy.csv"]))
    few = made(asked(kept, causes={"sensor_gain": False, "sensor_delay": False}, healthy_data=["healthy.csv"]))
    shutil.move(kept / "baseline.npz", kept / "healthy/baseline.npz")
    assert examined.basis is BaselineSource.RECORDS
    assert from_file.healthy.known.mean == pytest.approx(examined.healthy.known.mean, rel=1e-9)
    assert from_file.healthy.known.covariance == pytest.approx(examined.healthy.known.covariance, rel=1e-9)
    # of fewer causes: the noise is what all of them leave
    assert from_file.shown is not None
    assert few.shown is not None
    assert from_file.shown.subject is not None
    assert few.shown.subject is not None
    among = from_file.shown.subject.among(from_file.shown, few.shown.subject)
    assert among.said[0].matrix == pytest.approx(few.shown.said[0].matrix, rel=0.02, abs=1e-6)


def test_a_diagnosis_and_a_monitoring_take_it(kept: Path) -> None:
    found = asked(kept).diagnose()
    assert found.evidence is not None
    assert found.evidence.basis is BaselineSource.FILE
    assert {"turns.lost", "gain(i)", "delay(i)"} <= {each.change.label for each in found.evidence.suspects}
    assert "from baseline.npz" in str(fmuid.Document.of(found))
    again = fmuid.Diagnosis.from_json(found.to_json(kept / "diagnosis.json"))
    assert again.evidence == found.evidence
    assert run_monitoring(asked(kept), [kept / "test1.csv"]).basis is BaselineSource.FILE


@pytest.mark.parametrize(
    ("said", "basis"),
    [
        ({"faults": FAULTS | {"other": FAULTS["turns"]}}, BaselineSource.OTHER_MODELS),
        ({"faults": {"turns": FAULTS["turns"] | {"fixed": {"i_start": 0.1}}}}, BaselineSource.OTHER_MODELS),
        ({"model": WORDS["model"] | {"fixed": {"i_start": 0.1}}}, BaselineSource.OTHER_MODELS),
        ({"causes": {"sensor_gain": False}}, BaselineSource.OTHER_CAUSES),
        ({"noise": {"variance": {"i": 1e-3}}}, BaselineSource.OTHER_NOISE),
    ],
)
def test_a_file_that_does_not_fit(kept: Path, said: dict[str, Any], basis: BaselineSource) -> None:
    top = {key: value for key, value in said.items() if key not in ("faults", "causes")}
    own = {key: value for key, value in said.items() if key in ("faults", "causes")}
    study = asked(kept, **own)
    with pytest.raises(fmuid.InputError, match=f"baseline.npz is of {basis.value} than this study: identify"):
        made(fmuid.Study.of({**study.data, **top}, study.path))
    study = asked(kept, healthy_data=["healthy.csv"], **own)
    found = made(fmuid.Study.of({**study.data, **top}, study.path))
    assert found.basis is basis
    assert f"not used ({UNLIKE[basis]})" in basis_notes(found.basis)[0].text


def test_wrong_words(kept: Path) -> None:
    for words, message in (
        ({"healthy_data": ["healthy.csv"], "faults": FAULTS}, "has healthy_data and no baseline"),
        ({"faults": FAULTS}, "there is no healthy machine: give baseline"),
    ):
        with pytest.raises(fmuid.InputError, match=message):
            fmuid.Study.of(WORDS | {"diagnosis": words}, kept / "test.toml").diagnose()
    whole = (kept / "healthy/baseline.npz").read_bytes()
    (kept / "healthy/baseline.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(fmuid.InputError, match="is not of fmuid identify, or not whole"):
        made(asked(kept))
    (kept / "healthy/baseline.npz").write_bytes(whole)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_damaged_file_serves_nobody_and_ends_nothing(kept: Path, tmp_path: Path, share: float) -> None:
    """With healthy records a monitoring goes on without it, and says so; without them it says what to do."""
    folder = tmp_path / "a"
    shutil.copytree(kept, folder)
    (folder / "records").mkdir()
    pd.read_csv(folder / "test1.csv").to_parquet(folder / "records" / "a.parquet")

    def followed(*names: str) -> fmuid.Monitor:
        study, seen = asked(folder, healthy_data=list(names)), list[FollowStatus]()
        run_following(study, folder / "records", folder / "out", until=lambda at: at.idle, show=seen.append)
        return seen[-1].monitor

    assert followed("healthy.csv").basis is BaselineSource.FILE
    path = folder / "healthy/baseline.npz"
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    pd.read_csv(folder / "test2.csv").to_parquet(folder / "records" / "b.parquet")
    found = followed("healthy.csv")
    assert found.records == ("a", "b")
    assert found.basis is BaselineSource.DAMAGED
    (said,) = basis_notes(found.basis)
    assert "not used (damaged)" in said.text
    with pytest.raises(fmuid.InputError, match=r"not whole .*: identify the healthy study again"):
        followed()


def test_a_later_run_without_faults_leaves_no_file(kept: Path, tmp_path: Path) -> None:
    shutil.copytree(kept, tmp_path / "a")
    (tmp_path / "a/healthy.toml").write_text(
        f'[model]\nfmu = "{WORDS["model"]["fmu"]}"\n[[experiments]]\ndata = "healthy.csv"\ninputs = ["u"]\n'
        'outputs = ["i"]\ninterpolation = "zoh"\n[parameters]\nR = { start = 3.0 }\nL = { start = 0.2 }\n'
    )
    assert (tmp_path / "a/healthy/baseline.npz").is_file()
    assert run(["identify", str(tmp_path / "a/healthy.toml"), "-o", str(tmp_path / "a/healthy"), "--no-report"]) == 0
    assert not (tmp_path / "a/healthy/baseline.npz").is_file()
    assert np.isfinite(fmuid.Result.from_json(tmp_path / "a/healthy/result.json").values).all()
