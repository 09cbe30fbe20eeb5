"""Priors in study files: given, from earlier results, joint; and what is refused."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid import FMU, InputError, Normal, Study
from fmuid.estimation import TerminationReason
from fmuid.studies import SourceIssue
from tests.support.coil_study import COIL
from tests.support.results import result
from tests.support.said import source_words

COVARIANCE = [[4.0e-4, 1.0e-6], [1.0e-6, 1.0e-8]]
ESTIMATES: dict[str, tuple[float, float | None]] = {"R": (4.0, 0.02), "L": (0.1, 1e-4)}
STUDY = f"""
[model]
fmu = "{COIL.as_posix()}"
[model.fixed]
i_start = 0.0
[[experiments]]
data = "run.csv"
inputs = ["u"]
outputs = ["i"]
[parameters]
R = {{ start = 5.0, min = 0.0, max = 9.0 }}
L = {{ start = 0.05 }}
"""
FROM_RESULT, OF_RESULT = '[prior]\nresult = "healthy.json"\n', '{ result = "healthy.json" }'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with data and the result of an earlier identification of the coil."""
    (tmp_path / "run.csv").write_text("time,u,i\n0,1,0\n0.001,1,0.01\n0.002,1,0.02\n0.003,1,0.03\n")
    earlier(tmp_path)
    return tmp_path


def earlier(folder: Path, **changes: Any) -> None:
    """Write a result of the coil, with some of its entries changed."""
    content = {"covariance": covariance(), "noise_variance": {"i": 1.6e-3}} | changes
    result(folder, ESTIMATES, **content).replace(folder / "healthy.json")


def renamed(folder: Path, names: Sequence[str], value: float = 4.0) -> None:
    """Write a result of the coil with other names of its parameters, and another value of the first."""
    rows = list(json.loads((folder / "healthy.json").read_text())["parameters"].values())
    rows[0]["value"] = value
    earlier(folder, parameters=dict(zip(names, rows, strict=True)), covariance=covariance(names=names))


def covariance(matrix: object = COVARIANCE, names: Sequence[str] = ("R", "L")) -> dict[str, object]:
    return {"names": names, "matrix": matrix, "white_noise": matrix}


def read(folder: Path, extra: str = "", *, prior_of_r: str = "", overrides: Sequence[str] = ()) -> Study:
    text = STUDY.replace("max = 9.0", f"max = 9.0, prior = {prior_of_r}") if prior_of_r else STUDY
    (folder / "study.toml").write_text(text + extra)
    return Study.read(folder / "study.toml", overrides)


def refused(folder: Path, *said: str, **how: str) -> None:
    """Check the refusal of a study, or of its problem."""
    with pytest.raises(InputError) as refusal:
        read(folder, **how).problem()
    assert str(refusal.value).startswith(str(folder / "study.toml"))
    assert [each for each in said if each not in str(refusal.value)] == [], refusal.value


def both_refused(folder: Path, *said: str) -> None:
    """Check that the earlier result is refused for one parameter and for all."""
    refused(folder, *said, extra=FROM_RESULT)
    refused(folder, *said, prior_of_r=OF_RESULT)


# --- accepted ---------------------------------------------------------------------------


def test_prior_of_one_parameter_from_a_result(folder: Path) -> None:
    study = read(folder, prior_of_r='{ result = "healthy.json", std_factor = 10 }')
    prior = study.parameters["R"].prior
    assert prior is not None
    assert [prior.mean, prior.std] == pytest.approx([4.0, 0.2])
    assert study.parameters["L"].prior is None
    assert study.problem().parameters.prior_std[0] == pytest.approx(0.2)
    set_ = read(folder, overrides=[f"parameters.R.prior={OF_RESULT}"])
    assert set_.parameters["R"].prior == Normal(4.0, 0.02)


def test_joint_prior_from_a_result(folder: Path) -> None:
    """By default of all parameters that both have, standard deviations inflated and correlations kept."""
    joint = read(folder, FROM_RESULT + "std_factor = 3").joint_prior
    assert joint is not None
    assert (joint.names, joint.mean.tolist()) == (("R", "L"), [4.0, 0.1])
    np.testing.assert_allclose(joint.covariance, 9 * np.array(COVARIANCE))
    alone = read(folder, overrides=['prior.result="healthy.json"', 'prior.names=["L"]']).joint_prior
    assert alone is not None
    assert (alone.names, alone.covariance.tolist()) == (("L",), [[1e-8]])
    renamed(folder, ["dR", "L"])
    common = read(folder, FROM_RESULT).joint_prior
    assert common is not None and common.names == ("L",)


def test_given_joint_prior(folder: Path) -> None:
    study = read(folder, '[prior]\nnames = ["L", "R"]\nmean = [0.1, 4]\ncovariance = [[1e-6, 0], [0, 0.04]]')
    assert study.joint_prior is not None and study.joint_prior.names == ("L", "R")
    parameters = study.problem().parameters
    np.testing.assert_allclose(parameters.prior_mean, [4.0, 0.1])
    np.testing.assert_allclose(parameters.prior_std, [0.2, 1e-3])
    extra = 'i_start = { start = 0.0, nominal = 0.1, per_experiment = true }\n[prior]\nnames = ["i_start[run]"]\n'
    text = STUDY.replace("[model.fixed]\ni_start = 0.0\n", "") + extra + "mean = [0.0]\ncovariance = [[0.01]]"
    (folder / "study.toml").write_text(text)
    parameters = Study.read(folder / "study.toml").problem().parameters
    assert parameters.prior_std[parameters.index("i_start[run]")] == pytest.approx(0.1)


def test_known_variance_is_the_given_one_or_that_of_the_earlier_result(folder: Path) -> None:
    for extra, expected in (
        ("", {}),
        (FROM_RESULT, {"i": 1.6e-3}),
        (FROM_RESULT + "[noise]\nvariance = 2e-3", {"i": 2e-3}),
    ):
        assert read(folder, extra).known_variance == expected


# --- the model of the earlier result ------------------------------------------------------


def test_issues_of_results(folder: Path) -> None:
    (other,) = read(folder, FROM_RESULT).notes
    assert (other.doubt, other.path.name) == (SourceIssue.OTHER_BUILD, "healthy.json")
    assert "healthy.json" in source_words(other)
    earlier(folder, models={"": {"name": "Coil", "digest": FMU(COIL).digest}})
    assert read(folder, FROM_RESULT).notes == ()
    earlier(folder, models={}, outcome="iteration_limit")
    failed, unknown = read(folder, FROM_RESULT).notes
    assert (failed.doubt, failed.outcome) == (SourceIssue.DID_NOT_SUCCEED, TerminationReason.ITERATION_LIMIT)
    assert unknown.doubt is SourceIssue.NO_MODEL
    for models, theirs in (({"": "InductionMachine"}, "InductionMachine"), ({"machine": "Coil"}, "Coil")):
        earlier(folder, models={key: {"name": name, "digest": "0" * 64} for key, name in models.items()})
        both_refused(folder, f"healthy.json is of another model, {theirs}. This study has Coil")


# --- refusals -----------------------------------------------------------------------------

JOINT, UNIT = '[prior]\nnames = ["R", "L"]\nmean = [4.0, 0.1]\ncovariance = ', "[[1.0, 0.0], [0.0, 1.0]]"


def changed(old: str, new: str) -> str:
    assert old in JOINT
    return JOINT.replace(old, new) + UNIT


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (JOINT + "[[1.0, 0.1], [0.2, 1.0]]", ("prior: ", "R, L", "not symmetric")),
        (JOINT + "[[1.0]]", ("prior: ", "2 means")),
        (JOINT + "[[1.0, 0.0], [0.0]]", ("prior.covariance: must be a list of rows of numbers",)),
        (changed("[4.0, 0.1]", "[12.0, 0.1]"), ("12 of 'R'", "is outside [0, 9]")),
        (changed('"L"', '"i_start"'), ("prior.names: 'i_start' is fixed at 0.0 in [model.fixed]",)),
        (changed('"L"', '"R0"'), ("prior.names: unknown parameter 'R0'", "'R'")),
        ('[prior]\nnames = ["R"]\nmean = [4.0]', ("prior: missing key 'covariance'",)),
        (FROM_RESULT + "mean = [4.0]", ("prior: result and mean cannot be combined",)),
        (JOINT + UNIT + "\nstd_factor = 2", ("prior.std_factor: needs a result",)),
        ('[prior]\nresult = "sick.json"', ("prior.result: file", "sick.json not found")),
        ('[prior]\nresult = "run.csv"', ("prior: ", "run.csv is not JSON")),
    ],
)
def test_joint_prior_refused(folder: Path, extra: str, said: tuple[str, ...]) -> None:
    refused(folder, *said, extra=extra)


def test_single_prior_refused(folder: Path) -> None:
    for prior, said in (
        ("{ mean = 40.0, std = 1.0 }", "mean 40 is outside"),
        ("{ mean = 4.0 }", "parameters.R.prior: missing key 'std'"),
        ("{ mean = 4.0, std = 1.0, std_factor = 2 }", "parameters.R.prior.std_factor: needs a result"),
        ('{ mean = 4.0, result = "healthy.json" }', "parameters.R.prior: result and mean cannot be combined"),
    ):
        refused(folder, said, prior_of_r=prior)
    refused(folder, "'R' has its own prior", extra=FROM_RESULT, prior_of_r="{ mean = 4.0, std = 1.0 }")
    (folder / "study.toml").write_text(STUDY.partition("[parameters]")[0] + FROM_RESULT)
    with pytest.raises(InputError, match="prior: no free parameters"):
        Study.read(folder / "study.toml")


def test_result_that_does_not_fit(folder: Path) -> None:
    renamed(folder, ["R", "L"], value=14.0)
    both_refused(folder, "14", "outside")
    renamed(folder, ["Rs", "Ls"])
    refused(folder, "healthy.json has no parameter 'R'", "It has Rs, Ls", prior_of_r=OF_RESULT)
    refused(folder, "healthy.json has Rs, Ls; this study has R, L", extra=FROM_RESULT)
    refused(folder, "has no parameter 'L'", extra=FROM_RESULT + 'names = ["L"]')


def test_result_without_a_usable_variance(folder: Path) -> None:
    for variance, said in (("inf", "'R'"), (0.0, "variance of 'R'")):
        earlier(folder, covariance=covariance([[variance, 0.0 if variance == 0.0 else None], [0.0, 1e-8]]))
        both_refused(folder, "healthy.json", said)


@pytest.mark.parametrize("content", ["{}", "[]", "", '{"schema": "fmuid/result/2"}'])
def test_broken_result(folder: Path, content: str) -> None:
    (folder / "healthy.json").write_text(content)
    both_refused(folder, "healthy.json", "run fmuid identify again")
