"""Priors in study files: given, from earlier results, joint; and every refusal in one sentence."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid.data import Normal
from fmuid.errors import InputError
from fmuid.estimation import TerminationReason
from fmuid.reports.topics.study_notes import source_words
from fmuid.studies import SourceIssue
from fmuid.studies.study import Study
from tests.support.paths import FMUS
from tests.support.results import result

COIL = FMUS / "Coil/Coil.fmu"
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


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a table and the result of an earlier identification of the coil."""
    (tmp_path / "run.csv").write_text("time,u,i\n0,1,0\n0.001,1,0.01\n0.002,1,0.02\n0.003,1,0.03\n")
    earlier(tmp_path)
    return tmp_path


def earlier(folder: Path, **changes: Any) -> None:
    """Write a result of the coil, with some of its entries changed."""
    content = {"covariance": covariance(), "noise_variance": {"i": 1.6e-3}} | changes
    result(folder, ESTIMATES, **content).replace(folder / "healthy.json")


def covariance(matrix: object = COVARIANCE, names: Sequence[str] = ("R", "L")) -> dict[str, object]:
    """Return a covariance as it stands in a result."""
    return {"names": names, "matrix": matrix, "white_noise": matrix}


def read(folder: Path, extra: str = "", *, prior_of_r: str = "") -> Study:
    text = STUDY.replace("max = 9.0", f"max = 9.0, prior = {prior_of_r}") if prior_of_r else STUDY
    (folder / "study.toml").write_text(text + extra)
    return Study.read(folder / "study.toml")


def refused(folder: Path, extra: str = "", *, prior_of_r: str = "", when: str = "read") -> str:
    """Return the sentence with which the study is refused."""
    with pytest.raises(InputError) as refusal:
        study = read(folder, extra, prior_of_r=prior_of_r)
        assert when == "problem"
        study.problem()
    sentence = str(refusal.value)
    assert sentence.startswith(str(folder / "study.toml"))
    assert not re.search(r"\.\s+[A-Z]", sentence)
    return sentence


# --- what is taken ----------------------------------------------------------------------


def test_prior_of_one_parameter_from_a_result(folder: Path) -> None:
    study = read(folder, prior_of_r='{ result = "healthy.json", std_factor = 10 }')
    prior = study.parameters["R"].prior
    assert prior is not None
    assert prior.mean == 4.0
    assert prior.std == pytest.approx(0.2)
    assert study.parameters["L"].prior is None
    assert read(folder, prior_of_r='{ result = "healthy.json" }').parameters["R"].prior == Normal(4.0, 0.02)
    assert study.problem().parameters.prior_std[0] == pytest.approx(0.2)


def test_joint_prior_from_a_result(folder: Path) -> None:
    """By default of all parameters that both have, standard deviations inflated and correlations kept."""
    joint = read(folder, '[prior]\nresult = "healthy.json"\nstd_factor = 3').joint_prior
    assert joint is not None
    assert joint.names == ("R", "L")
    assert joint.mean.tolist() == [4.0, 0.1]
    np.testing.assert_allclose(joint.covariance, 9 * np.array(COVARIANCE))
    alone = read(folder, '[prior]\nresult = "healthy.json"\nnames = ["L"]').joint_prior
    assert alone is not None
    assert (alone.names, alone.covariance.tolist()) == (("L",), [[1e-8]])


def test_joint_prior_of_the_parameters_that_both_have(folder: Path) -> None:
    rows = json.loads((folder / "healthy.json").read_text())["parameters"]
    earlier(folder, parameters={"dR": rows["R"], "L": rows["L"]}, covariance=covariance(names=["dR", "L"]))
    joint = read(folder, '[prior]\nresult = "healthy.json"').joint_prior
    assert joint is not None
    assert joint.names == ("L",)


def test_given_joint_prior(folder: Path) -> None:
    study = read(folder, '[prior]\nnames = ["L", "R"]\nmean = [0.1, 4]\ncovariance = [[1e-6, 0], [0, 0.04]]')
    assert study.joint_prior is not None
    assert study.joint_prior.names == ("L", "R")
    parameters = study.problem().parameters
    np.testing.assert_allclose(parameters.prior_mean, [4.0, 0.1])
    np.testing.assert_allclose(parameters.prior_std, [0.2, 1e-3])


def test_joint_prior_of_a_parameter_per_experiment(folder: Path) -> None:
    extra = 'i_start = { start = 0.0, nominal = 0.1, per_experiment = true }\n[prior]\nnames = ["i_start[run]"]\n'
    text = STUDY.replace("[model.fixed]\ni_start = 0.0\n", "") + extra + "mean = [0.0]\ncovariance = [[0.01]]"
    (folder / "study.toml").write_text(text)
    parameters = Study.read(folder / "study.toml").problem().parameters
    assert parameters.prior_std[parameters.index("i_start[run]")] == pytest.approx(0.1)


def test_known_variance_is_the_given_one_or_that_of_the_earlier_result(folder: Path) -> None:
    assert read(folder).known_variance == {}
    prior = '[prior]\nresult = "healthy.json"\n'
    assert read(folder, prior).known_variance == {"i": 1.6e-3}
    assert read(folder, prior + "[noise]\nvariance = 2e-3").known_variance == {"i": 2e-3}


def test_overrides_begin_priors(folder: Path) -> None:
    read(folder)
    settings = ['prior.result="healthy.json"', "prior.std_factor=2", 'prior.names=["R"]']
    joint = Study.read(folder / "study.toml", settings).joint_prior
    assert joint is not None
    assert joint.covariance.tolist() == [[pytest.approx(1.6e-3)]]
    settings = ['parameters.R.prior={ result = "healthy.json" }']
    assert Study.read(folder / "study.toml", settings).parameters["R"].prior == Normal(4.0, 0.02)


# --- the model of the earlier result ------------------------------------------------------


def test_result_of_the_same_fmu(folder: Path) -> None:
    from fmuid.models.fmu import FMU

    earlier(folder, models={"": {"name": "Coil", "digest": FMU(COIL).digest}})
    assert read(folder, '[prior]\nresult = "healthy.json"').notes == ()


def test_another_build_is_noted(folder: Path) -> None:
    (note,) = read(folder, '[prior]\nresult = "healthy.json"', prior_of_r="").notes
    assert (note.doubt, note.path.name) == (SourceIssue.OTHER_BUILD, "healthy.json")
    assert "healthy.json was made with another build of Coil than" in source_words(note)


def test_result_without_model_and_result_that_failed_are_noted(folder: Path) -> None:
    earlier(folder, models={}, outcome="iteration_limit")
    failed, unknown = read(folder, '[prior]\nresult = "healthy.json"').notes
    assert (failed.doubt, failed.outcome) == (SourceIssue.DID_NOT_SUCCEED, TerminationReason.ITERATION_LIMIT)
    assert "did not succeed: iteration_limit" in source_words(failed)
    assert unknown.doubt is SourceIssue.NO_MODEL
    assert "does not say of which model it is" in source_words(unknown)


def test_result_of_another_model(folder: Path) -> None:
    earlier(folder, models={"": {"name": "InductionMachine", "digest": "0" * 64}})
    for prior in ({"extra": '[prior]\nresult = "healthy.json"'}, {"prior_of_r": '{ result = "healthy.json" }'}):
        sentence = refused(folder, **prior, when="problem")
        assert "healthy.json is a result of another model, InductionMachine, and this study has Coil" in sentence


def test_result_of_other_components(folder: Path) -> None:
    earlier(folder, models={"machine": {"name": "Coil", "digest": "0" * 64}})
    assert "another model" in refused(folder, '[prior]\nresult = "healthy.json"', when="problem")


# --- refusals -----------------------------------------------------------------------------

JOINT = '[prior]\nnames = ["R", "L"]\nmean = [4.0, 0.1]\ncovariance = '


@pytest.mark.parametrize(
    ("extra", "named"),
    [
        (JOINT + "[[1.0, 0.1], [0.2, 1.0]]", ("[prior]", "R, L", "not symmetric", "row R and column L stands 0.1")),
        (JOINT + "[[1.0, 2.0], [2.0, 1.0]]", ("[prior]", "R, L", "not positive definite")),
        (JOINT + "[[1.0, 0.0], [0.0, 0.0]]", ("[prior]", "variance of 'L' must be greater than 0, not 0")),
        (JOINT + "[[-1.0, 0.0], [0.0, 1.0]]", ("[prior]", "variance of 'R' must be greater than 0, not -1")),
        (JOINT + "[[1.0]]", ("[prior]", "2 means and a 2 x 2 covariance")),
        (JOINT + "[[1.0, 0.0], [0.0]]", ("[prior] covariance must be a list of rows of numbers",)),
        (JOINT + "[1.0, 1.0]", ("[prior] covariance must be a list of rows of numbers",)),
        (JOINT.replace("[4.0, 0.1]", "[4.0]") + "[[1.0, 0.0], [0.0, 1.0]]", ("2 means",)),
        (JOINT.replace("[4.0, 0.1]", '[4.0, "x"]') + "[[1.0, 0.0], [0.0, 1.0]]", ("[prior] mean must be a list",)),
        (JOINT.replace("[4.0, 0.1]", "[12.0, 0.1]") + "[[1.0, 0.0], [0.0, 1.0]]", ("12 of 'R' lies outside its bo",)),
        (JOINT.replace('"L"', '"i_start"') + "[[1.0, 0.0], [0.0, 1.0]]", ("'i_start'", "[model.fixed] holds at 0.0")),
        (JOINT.replace('"L"', '"R0"') + "[[1.0, 0.0], [0.0, 1.0]]", ("'R0'", "no parameter", "did you mean 'R'")),
        (JOINT.replace('"L"', '"R"') + "[[1.0, 0.0], [0.0, 1.0]]", ("'R' is there twice",)),
        ("[prior]\nmean = [4.0]\ncovariance = [[1.0]]", ("[prior] needs the key 'names'",)),
        ('[prior]\nnames = ["R"]\nmean = [4.0]', ("[prior] needs the key 'covariance'",)),
        ('[prior]\nresult = "healthy.json"\nmean = [4.0]', ("[prior] has both result and mean",)),
        ('[prior]\nresult = "healthy.json"\nstd_factor = 0', ("[prior] std_factor must be a number above 0, not 0",)),
        (JOINT + "[[1.0, 0.0], [0.0, 1.0]]\nstd_factor = 2", ("[prior] has std_factor, which goes with result",)),
        ('[prior]\nreslt = "healthy.json"', ("[prior] has no key 'reslt' (did you mean 'result'?)",)),
        ('[prior]\nresult = "sick.json"', ("[prior]", "sick.json", "there is no file")),
        ('[prior]\nresult = "run.csv"', ("[prior]", "run.csv is not JSON")),
    ],
)  # fmt: skip
def test_joint_prior_refused(folder: Path, extra: str, named: tuple[str, ...]) -> None:
    sentence = refused(folder, extra)
    assert all(word in sentence for word in named), sentence


@pytest.mark.parametrize(
    ("prior", "named"),
    [
        ("{ mean = 4.0, std = 0.0 }", ("[parameters.R.prior] std must be a number above 0, not 0",)),
        ("{ mean = 4.0, std = -1.0 }", ("[parameters.R.prior] std must be a number above 0, not -1",)),
        ("{ mean = 40.0, std = 1.0 }", ("[parameters.R]", "mean 40 lies outside the bounds, 0 to 9")),
        ("{ mean = 4.0 }", ("[parameters.R.prior] needs the key 'std'",)),
        ("{ mean = 4.0, std = 1.0, std_factor = 2 }", ("[parameters.R.prior] has std_factor, which goes with result",)),
        ('{ mean = 4.0, result = "healthy.json" }', ("[parameters.R.prior] has both result and mean",)),
        ('{ result = "healthy.json", std_factor = -1 }', ("std_factor must be a number above 0, not -1",)),
        ('{ result = "sick.json" }', ("[parameters.R.prior]", "sick.json", "there is no file")),
    ],
)  # fmt: skip
def test_single_prior_refused(folder: Path, prior: str, named: tuple[str, ...]) -> None:
    sentence = refused(folder, prior_of_r=prior)
    assert all(word in sentence for word in named), sentence


def test_both_a_single_and_a_joint_prior(folder: Path) -> None:
    sentence = refused(folder, '[prior]\nresult = "healthy.json"', prior_of_r="{ mean = 4.0, std = 1.0 }")
    assert "'R' has a prior of its own and is in the joint prior too; keep one of them" in sentence


def test_result_outside_the_bounds(folder: Path) -> None:
    rows = json.loads((folder / "healthy.json").read_text())["parameters"]
    earlier(folder, parameters={"R": rows["R"] | {"value": 14.0}, "L": rows["L"]})
    assert "14 of 'R' lies outside its bounds" in refused(folder, '[prior]\nresult = "healthy.json"')
    assert "mean 14 lies outside the bounds" in refused(folder, prior_of_r='{ result = "healthy.json" }')


def test_result_without_the_parameter(folder: Path) -> None:
    rows = json.loads((folder / "healthy.json").read_text())["parameters"]
    earlier(folder, parameters={"Rs": rows["R"], "Ls": rows["L"]}, covariance=covariance(names=["Rs", "Ls"]))
    single = refused(folder, prior_of_r='{ result = "healthy.json" }')
    assert "takes 'R' from" in single
    assert "it has Rs, Ls" in single
    joint = refused(folder, '[prior]\nresult = "healthy.json"')
    assert "takes nothing from" in joint
    assert "it has Rs, Ls, and this study R, L" in joint
    assert "takes 'L' from" in refused(folder, '[prior]\nresult = "healthy.json"\nnames = ["L"]')


@pytest.mark.parametrize("unknown", ["inf", None])
def test_result_that_does_not_determine_the_parameter(folder: Path, unknown: str | None) -> None:
    earlier(folder, covariance=covariance([[unknown, None], [None, 1e-8]]))
    for case in (
        {"extra": '[prior]\nresult = "healthy.json"'},
        {"prior_of_r": '{ result = "healthy.json" }'},
    ):
        sentence = refused(folder, **case)
        assert "healthy.json" in sentence
        assert "'R' is not determined in this result" in sentence


def test_result_with_zero_variance(folder: Path) -> None:
    earlier(folder, covariance=covariance([[0.0, 0.0], [0.0, 1e-8]]))
    single = refused(folder, prior_of_r='{ result = "healthy.json" }')
    for sentence in (single, refused(folder, '[prior]\nresult = "healthy.json"')):
        assert "healthy.json" in sentence
        assert "variance of 'R' must be greater than 0, not 0" in sentence


@pytest.mark.parametrize(
    "content", ["{}", "[]", "nothing", '{"parameters": {}}', "", '{"schema": "fmuid/result/2", "outcome": "converged"}']
)
def test_broken_result(folder: Path, content: str) -> None:
    (folder / "healthy.json").write_text(content)
    for case in ({"extra": '[prior]\nresult = "healthy.json"'}, {"prior_of_r": '{ result = "healthy.json" }'}):
        sentence = refused(folder, **case)
        assert "healthy.json" in sentence
        assert sentence.endswith("run fmuid identify again")


def test_prior_without_parameters(folder: Path) -> None:
    (folder / "study.toml").write_text(STUDY.partition("[parameters]")[0] + '[prior]\nresult = "healthy.json"')
    with pytest.raises(InputError, match=r"has a \[prior\] and no parameters"):
        Study.read(folder / "study.toml")
