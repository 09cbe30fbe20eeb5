"""Results in files: their contract, as priors, of other versions, damaged."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import fmuid
from fmuid.codec import as_json
from fmuid.data import Normal, Parameter
from fmuid.errors import InputError
from fmuid.estimation.result import Result
from fmuid.identification import identify
from tests.support.problems import coil_problem
from tests.support.results import RESULT
from tests.support.two_outputs import two_output_problem


@pytest.fixture(scope="module")
def found() -> Result:
    return identify(two_output_problem())


def saved(folder: Path, result: Result) -> Path:
    path = folder / "result.json"
    path.write_text(json.dumps(RESULT | as_json(result), allow_nan=False), encoding="utf-8")
    return path


def test_result_json_keeps_the_contract(tmp_path: Path) -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, prior=Normal(1.4, 0.1))}))
    data = as_json(result)
    keys = {"outcome", "converged", "parameters", "covariance", "at_bounds", "fit", "identifiability", "history"}
    assert set(data) >= keys | {"setup", "accuracy"}
    keys = {"value", "std", "std_white_noise", "variance_dof", "start", "lower", "upper"}
    assert set(data["parameters"]["k"]) == keys | {"prior_mean", "prior_std", "prior_z_score", "unit"}
    assert data["parameters"]["gain"]["prior_mean"] is None
    assert data["parameters"]["gain"]["upper"] == "inf"
    assert data["covariance"]["names"] == ["k", "gain"]
    assert data["setup"]["version"] == fmuid.__version__
    back = Result.from_json(saved(tmp_path, result))
    for name in ("values", "start", "covariance", "covariance_white_noise", "variance_dof", "lower", "prior_mean"):
        np.testing.assert_array_equal(getattr(back.estimates, name), getattr(result.estimates, name))
    pd.testing.assert_frame_equal(back.intervals(), result.intervals())
    assert as_json(back) == data
    assert back.fit.linearization is None


def test_result_without_identifiable_parameters_is_read(tmp_path: Path) -> None:
    result = identify(coil_problem(prior=False))
    back = Result.from_json(saved(tmp_path, result))
    assert np.isinf(back.std).all()
    assert back.identifiability.non_identifiable == result.identifiability.non_identifiable
    with pytest.raises(InputError, match="'R'"):
        back.prior()


def test_result_as_prior(found: Result) -> None:
    joint = found.prior(["gain", "k"], inflate=10.0)
    # with the standard deviations whose normal intervals are those of the result
    wider = np.asarray(stats.t.ppf(0.975, found.estimates.variance_dof)) / stats.norm.ppf(0.975)
    expected = 100.0 * found.covariance * np.outer(wider, wider)
    np.testing.assert_allclose(joint.covariance, expected[::-1, ::-1])
    assert joint.mean.tolist() == [found["gain"], found["k"]]
    assert found.normal("k", inflate=2.0).std == pytest.approx(2.0 * wider[0] * found.std[0])
    for words, said in (({"names": ["x"]}, "'x'"), ({"inflate": 0.0}, "inflate")):
        with pytest.raises(InputError, match=said):
            found.prior(**words)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "JSON"),
        ("{}", "schema.*'fmuid/result/2'"),
        ('{"schema": "fmuid/diagnosis/2"}', "'fmuid/diagnosis/2'"),
        ("[]", "schema"),
        ('{"schema": "fmuid/result/2"}', "parameters"),
        (None, "cannot be read"),
    ],
)
def test_file_that_is_no_result_is_refused(tmp_path: Path, text: str | None, said: str) -> None:
    path = tmp_path / "result.json"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        Result.from_json(path)


def test_damaged_result_is_refused_by_its_place(tmp_path: Path, found: Result) -> None:
    path, whole = tmp_path / "result.json", RESULT | as_json(found)
    coil, names = {"name": "Coil", "digest": "0"}, whole["covariance"] | {"names": ["x", "y"]}
    direction = {"names": ["k"], "coefficients": [1.0], "values": [1.0], "magnitudes": [1.0], "std": 1.0}
    short, place = direction | {"level": "hidden", "values": []}, "identifiability.weakly_identifiable[0]"

    def setup(model: object) -> dict[str, Any]:
        return {"setup": whole["setup"] | {"models": {"": model}}}

    def weak(one: object) -> dict[str, Any]:
        return {"identifiability": {"weakly_identifiable": [one]}}

    cases: list[tuple[dict[str, Any], str]] = [
        *(({key: None}, f"'{key}'") for key in ("outcome", "fit", "identifiability", "history", "setup")),
        *(({key: [["of old"]]}, key) for key in whole.keys() - {"schema", "converged"}),
        (setup("of old"), "setup.models."),
        (setup({"name": "Coil"}), "'setup.models..digest'"),
        (setup(coil | {"run": {"stiff": False}}), "'setup.models..run.divisor'"),
        (setup(coil | {"steps": 1}), "'setup.models..steps'"),
        (weak(direction), f"'{place}.level'"),
        (weak(short), place),
        ({"covariance": whole["covariance"] | {"matrix": [[1.0, 0.0], [0.0, -1.0]]}}, "negative"),
        ({"covariance": names}, "names"),
        ({"covariance": whole["covariance"] | {"matrix": [[1.0]]}}, "2 parameters"),
    ]
    for change, said in cases:
        content = {key: value for key, value in (whole | change).items() if value is not None or key in ("accuracy",)}
        path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError, match=re.escape(said)) as caught:
            Result.from_json(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_estimates_as_a_table(found: Result) -> None:
    table = found.to_frame()
    assert table.index.tolist() == ["k", "gain"]
    np.testing.assert_array_equal(table["value"], found.values)
    assert table["prior_mean"].isna().all()
    correlation = found.estimates.correlation
    assert correlation.loc["k", "k"] == pytest.approx(1.0)
    assert correlation.loc["k", "gain"] == pytest.approx(found.covariance[0, 1] / np.prod(found.std))
    assert (found.intervals(0.99)["lower"] < found.intervals(0.5)["lower"]).all()
    with pytest.raises(InputError, match="between 0 and 1"):
        found.intervals(95)
