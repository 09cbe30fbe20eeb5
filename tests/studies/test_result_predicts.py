"""`fmuid.predict`: by what the result was made with, wherever it came from."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import fmuid
from fmuid.codec import as_json
from fmuid.identification import ModelReference, predict_by_model
from tests.support.results import RESULT
from tests.support.running import run_study


def test_a_result_predicts_by_the_model_that_it_was_made_with() -> None:
    coil = fmuid.datasets.coil()
    held = fmuid.Problem(coil.fmu, coil.experiment, {"R": coil.parameters["R"]}, values={"L": 0.2}, step_size=1e-3)
    result = fmuid.identify(held)
    known = ModelReference(fmuid.System.of(coil.fmu), {"L": 0.2}, step_size=1e-3)
    expected = predict_by_model(known, result, coil.experiment)
    found = fmuid.predict(result, coil.experiment)
    np.testing.assert_array_equal(found.fit.simulated, expected.fit.simulated)
    np.testing.assert_array_equal(found.half_width, expected.half_width)
    other = fmuid.predict(result, coil.experiment, values={"L": 0.05})
    assert not np.allclose(other.fit.simulated, expected.fit.simulated)
    given = fmuid.predict(result, coil.experiment, coil.fmu)  # which holds nothing: L is the FMU's own
    assert given.fit.simulated == pytest.approx(predict_by_model(coil.fmu, result, coil.experiment).fit.simulated)
    again = fmuid.predict(result, coil.experiment, free="R").estimated
    assert again is not None and again["R"] == pytest.approx(result["R"], rel=1e-3)
    assert again.estimates.lower == [0.0]  # its bound there was


def test_so_does_one_of_a_study_and_one_of_a_file(tmp_path: Path) -> None:
    coil = fmuid.datasets.coil()
    study = fmuid.Study.of(coil.study | {"model": {"fmu": str(coil.fmu), "fixed": {"i_start": 0.0}}}, tmp_path / "s")
    findings = run_study(study, tmp_path)
    expected = predict_by_model(coil.fmu, findings.result, coil.experiment).scores[0].rmse
    for result in (findings.result, fmuid.Result.from_json(tmp_path / "result.json")):
        assert fmuid.predict(result, coil.experiment).scores[0].rmse == pytest.approx(expected, rel=1e-6)
        assert fmuid.predict(result, coil.experiment, free=["i_start"]).estimated is not None


def test_one_that_knows_no_model_asks_for_it(tmp_path: Path) -> None:
    coil = fmuid.datasets.coil()
    result = fmuid.identify(coil.problem())
    sent = pickle.loads(pickle.dumps(result))
    with pytest.raises(fmuid.InputError, match="No model recorded"):
        fmuid.predict(sent, coil.experiment)
    assert fmuid.predict(sent, coil.experiment, coil.fmu).fit.outputs == ("i",)
    (tmp_path / "result.json").write_text(json.dumps(RESULT | as_json(result)))
    with pytest.raises(fmuid.InputError, match=r"no study recorded.*, or pass model="):
        fmuid.predict(fmuid.Result.from_json(tmp_path / "result.json"), coil.experiment)
