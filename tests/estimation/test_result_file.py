"""Results in files: their contract, as priors, of other versions, damaged."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.stats import norm

import fmuid
from fmuid.codec import as_json
from fmuid.data import Normal, Parameter
from fmuid.errors import InputError
from fmuid.estimation.result import Result
from fmuid.identification import identify
from tests.support.problems import coil_problem
from tests.support.results import RESULT
from tests.support.two_outputs import two_output_problem


def test_result_json_keeps_the_contract(tmp_path: Path) -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, prior=Normal(1.4, 0.1))}))
    data = as_json(result)
    keys = {"outcome", "converged", "parameters", "covariance", "noise_variance", "criterion", "iterations"}
    assert keys | {"simulations", "elapsed_s", "version"} <= set(data)
    keys = {"value", "std", "white_std", "degrees_of_freedom", "start", "lower", "upper", "numerical_shift"}
    assert set(data["parameters"]["k"]) == keys | {"prior_mean", "prior_std", "pull", "unit"}
    assert data["parameters"]["gain"]["prior_mean"] is None
    assert data["parameters"]["gain"]["upper"] == "inf"
    assert data["covariance"]["names"] == ["k", "gain"]
    assert data["version"] == fmuid.__version__
    path = tmp_path / "result.json"
    path.write_text(json.dumps(RESULT | data, allow_nan=False), encoding="utf-8")
    back = Result.from_json(path)
    for name in (
        "values",
        "start",
        "covariance",
        "std",
        "white_covariance",
        "freedom",
        "lower",
        "upper",
        "prior_mean",
        "prior_std",
    ):
        np.testing.assert_array_equal(getattr(back, name), getattr(result, name))
    pd.testing.assert_frame_equal(back.intervals(), result.intervals())
    assert as_json(back) == data
    assert back.local is None


def test_undetermined_results_come_back(tmp_path: Path) -> None:
    result = identify(coil_problem(prior=False))
    path = tmp_path / "result.json"
    path.write_text(json.dumps(RESULT | as_json(result), allow_nan=False), encoding="utf-8")
    back = Result.from_json(path)
    assert np.isinf(back.std).all()
    assert back.undetermined == result.undetermined
    with pytest.raises(InputError, match="'R' is not determined"):
        back.prior()


def test_a_result_as_prior() -> None:
    result = identify(two_output_problem())
    joint = result.prior(["gain", "k"], inflate=10.0)
    # with the standard deviations whose normal intervals are those of the result
    wider = np.asarray(stats.t.ppf(0.975, result.freedom)) / norm.ppf(0.975)
    expected = 100.0 * result.covariance * np.outer(wider, wider)
    np.testing.assert_allclose(joint.covariance, expected[::-1, ::-1])
    assert joint.mean.tolist() == [result["gain"], result["k"]]
    assert result.normal("k", inflate=2.0).std == pytest.approx(2.0 * wider[0] * result.std[0])
    with pytest.raises(InputError, match="no parameter 'x'"):
        result.prior(["x"])
    with pytest.raises(InputError, match="inflate"):
        result.prior(inflate=0.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", r"is not JSON \(.*\): run fmuid identify again$"),
        ("{}", "is of no schema, not 'fmuid/result/2': run fmuid identify again$"),
        ('{"schema": "fmuid/diagnosis/2"}', "is of schema 'fmuid/diagnosis/2', not 'fmuid/result/2'"),
        ("[]", "is of no schema"),
        ('{"schema": "fmuid/result/2"}', "cannot be right: it has no 'outcome'"),
    ],
)
def test_files_that_are_no_results(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "result.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        Result.from_json(path)
    with pytest.raises(InputError, match="cannot be read"):
        Result.from_json(tmp_path / "missing.json")


def test_damaged_results_are_one_sentence(tmp_path: Path) -> None:
    path, whole = tmp_path / "result.json", RESULT | as_json(identify(two_output_problem()))

    def said(content: object) -> str:
        path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError) as caught:
            Result.from_json(path)
        text = str(caught.value)
        assert text.startswith(f"{path} cannot be right: ")
        assert text.endswith("run fmuid identify again")
        assert "\n" not in text
        return text

    for key in ("outcome", "noise_variance", "criterion", "iterations", "elapsed_s"):
        assert f"it has no '{key}'" in said({k: v for k, v in whole.items() if k != key})
    for key in whole.keys() - {"schema", "converged", "version"}:
        assert f"right: {key}" in said(whole | {key: [["of old"]]})
    assert "cannot be right: models." in said(whole | {"models": {"": "of old"}})
    assert "it has no 'models..digest'" in said(whole | {"models": {"": {"name": "Coil"}}})
    coil = {"name": "Coil", "digest": "0"}
    assert "it has no 'models..run.divisor'" in said(whole | {"models": {"": coil | {"run": {"stiff": False}}}})
    assert "it has 'models..steps', which is no key there" in said(whole | {"models": {"": coil | {"steps": 1}}})
    direction = {"names": ["k"], "coefficients": [1.0], "values": [1.0], "magnitudes": [1.0], "std": 1.0}
    assert "it has no 'weak[0].determined'" in said(whole | {"weak": [direction]})
    direction |= {"determined": "hidden", "values": []}
    assert "weak[0]: a direction has not as many numbers as names" in said(whole | {"weak": [direction]})
    negative = whole["covariance"] | {"matrix": np.diag([1.0, -1.0]).tolist()}
    assert "a variance is negative" in said(whole | {"covariance": negative})
    assert "the names differ from those of the rows" in said(whole | {"covariance": negative | {"names": ["x", "y"]}})
    assert "is not of 2 parameters" in said(whole | {"covariance": whole["covariance"] | {"matrix": [[1.0]]}})


def test_the_level_of_an_interval() -> None:
    result = identify(two_output_problem())
    wide, narrow = result.intervals(0.99), result.intervals(0.5)
    assert (wide["lower"] < narrow["lower"]).all()
    with pytest.raises(InputError, match="between 0 and 1"):
        result.intervals(95)


def test_estimates_as_a_table() -> None:
    result = identify(two_output_problem())
    table = result.to_frame()
    assert table.index.tolist() == ["k", "gain"]
    np.testing.assert_array_equal(table["value"], result.values)
    assert table["prior_mean"].isna().all()
    correlation = result.correlation
    assert correlation.loc["k", "k"] == pytest.approx(1.0)
    expected = result.covariance[0, 1] / np.prod(result.std)
    assert correlation.loc["k", "gain"] == pytest.approx(expected)
