"""Results in files: their contract, as priors, of other versions, damaged."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.stats import norm

import fmuid
from fmuid.data import Normal, Parameter
from fmuid.errors import InputError
from fmuid.estimation.result import Result
from fmuid.identification import identify
from fmuid.version import __version__
from tests.support.problems import coil_problem
from tests.support.two_outputs import two_output_problem


def test_result_json_keeps_the_contract(tmp_path: Path) -> None:
    result = identify(two_output_problem(parameters={"k": Parameter(0.8, prior=Normal(1.4, 0.1))}))
    data = result.to_json_dict()
    keys = {"outcome", "converged", "parameters", "covariance", "noise_variance", "criterion", "iterations"}
    assert keys | {"simulations", "elapsed_s", "version"} <= set(data)
    keys = {"value", "std", "white_std", "degrees_of_freedom", "start", "min", "max", "numerical_shift"}
    assert set(data["parameters"]["k"]) == keys | {"prior_mean", "prior_std", "pull"}
    assert set(data["parameters"]["gain"]) == keys
    assert data["covariance"]["names"] == ["k", "gain"]
    assert data["version"] == fmuid.__version__
    path = tmp_path / "result.json"
    path.write_text(json.dumps(data, allow_nan=False), encoding="utf-8")
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
    assert back.to_json_dict() == data
    assert back.local is None


def test_undetermined_results_come_back(tmp_path: Path) -> None:
    result = identify(coil_problem(prior=False))
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result.to_json_dict(), allow_nan=False), encoding="utf-8")
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
        ("{", "not JSON"),
        ("{}", "does not say which fmuid has written it: give the result.json of .*, or run fmuid identify again$"),
        ('{"version": 1}', "does not say which fmuid has written it"),
        ("[]", "does not say which fmuid has written it"),
        ('{"version": "0.1.0"}', r"which fmuid 0\.1\.0 has written, has no 'parameters', .*: run fmuid identify again"),
    ],
)
def test_files_that_are_no_results(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "result.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        Result.from_json(path)
    with pytest.raises(InputError, match="cannot be read"):
        Result.from_json(tmp_path / "missing.json")


def test_results_of_other_versions_are_one_sentence(tmp_path: Path) -> None:
    path, whole = tmp_path / "result.json", identify(two_output_problem()).to_json_dict() | {"version": "0.0.9"}

    def said(content: object) -> str:
        path.write_text(json.dumps(content), encoding="utf-8")
        with pytest.raises(InputError) as caught:
            Result.from_json(path)
        text = str(caught.value)
        assert text.startswith(f"{path}, which fmuid 0.0.9 has written, ")
        assert text.endswith("run fmuid identify again") and "\n" not in text
        return text

    for key in ("outcome", "parameters", "covariance", "noise_variance", "criterion", "iterations", "elapsed_s"):
        assert f"has no '{key}', which fmuid {__version__} needs" in said({k: v for k, v in whole.items() if k != key})
    assert f"has something in 'outcome' that fmuid {__version__} cannot read" in said(whole | {"outcome": "of old"})
    for key in whole.keys() - {"version", "outcome"}:
        assert f"cannot be right: {key}: the value should be" in said(whole | {key: "of old"})
    models = {"": {"name": "Coil", "digest": "1", "run": "co-simulation"}}
    assert "cannot be right: models..run: the value should be" in said(whole | {"models": models})
    direction = {"names": ["k"], "coefficients": [1.0], "values": [1.0], "magnitudes": [1.0], "std": 1.0}
    assert "has no 'determined' in 'weak'" in said(whole | {"weak": [direction]})
    negative = {"names": list(whole["parameters"]), "matrix": np.diag([1.0, -1.0]).tolist()}
    assert "cannot be right: a variance is negative" in said(whole | {"covariance": negative})
    assert "the names of parameters and covariance differ" in said(
        whole | {"covariance": negative | {"names": ["x", "y"]}}
    )


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
