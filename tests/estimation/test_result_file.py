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
    keys = {"outcome", "converged", "parameters", "covariance", "at_bounds", "fit", "identifiability", "history"}
    assert set(data) == keys | {"setup", "accuracy", "verdict"}
    keys = {"value", "std", "std_white_noise", "variance_dof", "start", "lower", "upper"}
    assert set(data["parameters"]["k"]) == keys | {"prior_mean", "prior_std", "prior_z_score", "unit"}
    assert data["parameters"]["gain"]["prior_mean"] is None
    assert data["parameters"]["gain"]["upper"] == "inf"
    assert data["covariance"]["names"] == ["k", "gain"]
    assert data["setup"]["version"] == fmuid.__version__
    path = tmp_path / "result.json"
    path.write_text(json.dumps(RESULT | data, allow_nan=False), encoding="utf-8")
    back = Result.from_json(path)
    for name in (
        "values",
        "start",
        "covariance",
        "covariance_white_noise",
        "variance_dof",
        "lower",
        "upper",
        "prior_mean",
        "prior_std",
    ):
        np.testing.assert_array_equal(getattr(back.estimates, name), getattr(result.estimates, name))
    pd.testing.assert_frame_equal(back.intervals(), result.intervals())
    assert as_json(back) == data
    assert back.fit.linearization is None


def test_undetermined_results_come_back(tmp_path: Path) -> None:
    result = identify(coil_problem(prior=False))
    path = tmp_path / "result.json"
    path.write_text(json.dumps(RESULT | as_json(result), allow_nan=False), encoding="utf-8")
    back = Result.from_json(path)
    assert np.isinf(back.std).all()
    assert back.identifiability.non_identifiable == result.identifiability.non_identifiable
    with pytest.raises(InputError, match="'R' is not determined"):
        back.prior()


def test_a_result_as_prior() -> None:
    result = identify(two_output_problem())
    joint = result.prior(["gain", "k"], inflate=10.0)
    # with the standard deviations whose normal intervals are those of the result
    wider = np.asarray(stats.t.ppf(0.975, result.estimates.variance_dof)) / norm.ppf(0.975)
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
        ('{"schema": "fmuid/result/2"}', "cannot be right: parameters: the value should be an object"),
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

    for key in ("outcome", "fit", "identifiability", "history", "setup"):
        assert f"it has no '{key}'" in said({k: v for k, v in whole.items() if k != key})
    for key in whole.keys() - {"schema", "converged"}:
        assert f"right: {key}" in said(whole | {key: [["of old"]]})

    def setup(coil: object) -> str:
        return said(whole | {"setup": whole["setup"] | {"models": {"": coil}}})

    assert "cannot be right: setup.models." in setup("of old")
    assert "it has no 'setup.models..digest'" in setup({"name": "Coil"})
    coil = {"name": "Coil", "digest": "0"}
    assert "it has no 'setup.models..run.divisor'" in setup(coil | {"run": {"stiff": False}})
    assert "it has 'setup.models..steps', which is no key there" in setup(coil | {"steps": 1})
    direction = {"names": ["k"], "coefficients": [1.0], "values": [1.0], "magnitudes": [1.0], "std": 1.0}

    def weak(one: object) -> str:
        return said(whole | {"identifiability": {"weakly_identifiable": [one]}})

    place = "identifiability.weakly_identifiable[0]"
    assert f"it has no '{place}.level'" in weak(direction)
    direction |= {"level": "hidden", "values": []}
    assert f"{place}: a direction has not as many numbers as names" in weak(direction)
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
    correlation = result.estimates.correlation
    assert correlation.loc["k", "k"] == pytest.approx(1.0)
    expected = result.covariance[0, 1] / np.prod(result.std)
    assert correlation.loc["k", "gain"] == pytest.approx(expected)
