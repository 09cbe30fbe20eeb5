"""Damaged files of fmuid's own: what reads them gives a value or one sentence."""

import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import Experiment, FmuidError
from fmuid.codec import as_json
from fmuid.runs import read_fits
from fmuid.runs.faults import build_monitor, rule_of
from tests.support.fuzz_spoil import mutated, spoil_tree
from tests.support.paths import FMUS, ROOT
from tests.support.running import run_monitoring, run_study

COIL = {
    "model": {"fmu": str(FMUS / "Coil/Coil.fmu")},
    "experiments": [{"data": "healthy.csv", "inputs": ["u"], "outputs": ["i"], "interpolation": "zoh"}],
    "parameters": {"R": {"start": 3.0}, "L": {"start": 0.2}},
}
TURNS = {"fmu": str(FMUS / "CoilTurns/CoilTurns.fmu"), "parameters": {"lost": {"nominal": 0.1, "max": 0.9}}}
FAULTS: dict[str, Any] = {"faults": {"turns": TURNS}}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a healthy result and a monitoring."""
    folder = tmp_path_factory.mktemp("sound")
    for name in ("healthy.csv", "test1.csv"):
        pd.read_csv(ROOT / "experiments/coil" / name).head(120).to_csv(folder / name, index=False)
    healthy = COIL | {"diagnosis": FAULTS}
    run_study(fmuid.Study.of(healthy, folder / "healthy.toml"), folder / "healthy")
    tables = [folder / "healthy.csv", folder / "test1.csv"]
    run_monitoring(asked(folder), tables[:1], folder / "monitoring")
    return folder


def asked(folder: Path) -> fmuid.Study:
    """Return the study of a monitoring, which takes the healthy result."""
    known = {"baseline": "healthy/result.json", **FAULTS}
    tested = {name: COIL[name] for name in ("model", "experiments")}
    return fmuid.Study.of(tested | {"diagnosis": known}, folder / "test.toml")


def change_json(rng: Random, data: bytes) -> bytes:
    """Return a damaged JSON text: bytes, or values of other types and sizes at any depth."""
    if rng.random() < 0.3:
        return mutated(rng, data)
    return json.dumps(spoil_tree(rng, json.loads(data)), default=str).encode()


def change_arrays(rng: Random, data: bytes) -> bytes:
    """Return a damaged archive of arrays, at times with another text in it."""
    if rng.random() < 0.5:
        return mutated(rng, data)
    with np.load(io.BytesIO(data)) as file:
        arrays = dict(file)
    name = rng.choice([*arrays])
    if name == "text" or rng.random() < 0.5:
        arrays["text"] = np.frombuffer(change_json(rng, arrays["text"].tobytes()), np.uint8)
    else:
        changes: list[Callable[[Any], Any]] = [np.ravel, lambda x: x[:-1], lambda x: x * np.nan, lambda x: 1e150 * x]
        changes += [lambda x: np.stack([x, x]), lambda x: x.astype(str), lambda _: np.zeros((0, 3)), np.sum]
        with np.errstate(all="ignore"):
            arrays[name] = rng.choice(changes)(arrays[name])
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def read_result(folder: Path, _: Experiment) -> None:
    read_fits(folder / "healthy")
    result = fmuid.Result.from_json(folder / "healthy/result.json")
    assert repr(result)
    assert str(fmuid.Document.of(result))
    as_json(result)


def read_baseline(folder: Path, _: Experiment) -> None:
    study = asked(folder)
    build_monitor(study, rule_of(study))


def read_monitoring(folder: Path, record: Experiment) -> None:
    study = asked(folder)
    monitor = build_monitor(study, rule_of(study))
    monitor.resume(folder / "monitoring")
    monitor.add(record)


Change = Callable[[Random, bytes], bytes]
FILES: dict[str, tuple[Change, Callable[[Path, Experiment], None]]] = {
    "healthy/result.json": (change_json, read_result),
    "healthy/baseline.npz": (change_arrays, read_baseline),
    "monitoring/monitoring.npz": (change_arrays, read_monitoring),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize(
    "draws", [pytest.param(60, marks=pytest.mark.slow), pytest.param(500, marks=pytest.mark.campaign)]
)
def test_damaged_results(sound: Path, tmp_path: Path, name: str, draws: int) -> None:
    folder, (change, read) = tmp_path / "a", FILES[name]
    shutil.copytree(sound, folder)
    path = folder / name
    given, rng, refused = path.read_bytes(), Random(name), 0
    record = replace(asked(folder).experiments[0].read_experiment(folder / "test1.csv"), name="test1")
    for _ in range(draws):
        content = change(rng, given)
        if content == given:
            continue
        path.write_bytes(content)
        try:
            read(folder, record)
        except FmuidError as error:
            assert "\n" not in str(error)
            assert len(str(error)) > 8
            refused += 1
    assert refused > draws / 4


def test_solver_errors_of_other_parameters_are_refused(sound: Path, tmp_path: Path) -> None:
    content = json.loads((sound / "healthy/result.json").read_text())
    content["accuracy"]["shift"].pop()
    (tmp_path / "result.json").write_text(json.dumps(content))
    with pytest.raises(fmuid.InputError, match=r"accuracy\.shift"):
        fmuid.Result.from_json(tmp_path / "result.json")
