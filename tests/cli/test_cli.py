"""The command line from end to end, on coil and machine FMUs with tables of known truth."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import fmuid
from experiments.batches.campaign import NOISE, L, R, coil_current
from fmuid.cli import app as cli
from fmuid.cli.options import DONE, NOT_SUCCEEDED, WRONG_INPUT
from fmuid.errors import ModelicaWarning
from fmuid.progress import Event, SearchStep
from fmuid.reports.console import progress
from fmuid.studies import begin, draft
from fmuid.studies.study import Study
from tests.support.coil_study import COIL, STUDY, coil_table, fmuid_, result
from tests.support.paths import FMUS

pytestmark = pytest.mark.usefixtures("blank_figures")

SECOND = """
i_start = { start = 0.0, nominal = 0.1, per_experiment = true }
[[experiments]]
table = "second.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "hold"
"""
# Nothing but a search that is given no time.
HASTY = ["--set", "estimator.max_iterations=1", "--set", "estimator.remedies=false"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    coil_table(tmp_path / "second.csv", 0.2, seed=2)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


# --- identify ----------------------------------------------------------------------------


def test_identify(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("identify", folder / "study.toml") == DONE
    found = result(folder / "results")
    assert found["outcome"] == "converged"
    assert found["converged"] is True
    for name, truth, start in (("R", R, 6.0), ("L", L, 0.05)):
        estimate = found["parameters"][name]
        assert abs(estimate["value"] - truth) < 4 * estimate["std"]
        assert 0 < estimate["std"] < 0.03 * truth
        assert estimate["start"] == start
        assert "pull" not in estimate
    assert found["covariance"]["names"] == ["R", "L"]
    diagonal = np.sqrt(np.diag(found["covariance"]["matrix"]))
    np.testing.assert_allclose(diagonal, [found["parameters"][name]["std"] for name in ("R", "L")])
    assert found["noise_variance"]["i"] == pytest.approx(NOISE**2, rel=0.2)
    assert found["version"] == fmuid.__version__
    assert {"criterion", "iterations", "simulations", "elapsed_s"} <= set(found)

    out, error = capsys.readouterr()
    assert error == ""
    assert "iteration 0 " in out
    assert f"iteration {found['iterations']} " in out
    for word in ("parameter", "rel. std", "95 % interval", "Ohm", "Converged", "Residual: i std 0.0", "result.json"):
        assert word in out


@pytest.mark.usefixtures("drawn_figures")
def test_identify_writes_tables_and_figures(folder: Path) -> None:
    assert fmuid_("identify", folder / "study.toml", "--output", folder / "deep/out", "--figures", "png") == DONE
    out = folder / "deep/out"
    assert {path.name for path in out.iterdir()} == {
        "result.json", "estimates.csv", "trace.csv", "rounds.csv", "fit.csv", "diagnostics.csv", "correlations.csv",
        "parameters.ssv", "report.html", "figures",
    }  # fmt: skip
    figures = {path.name for path in (out / "figures").iterdir()}
    assert figures == {"parameters.png", "criterion.png", "fit.png", "residuals.png"}
    found = result(out)

    estimates = pd.read_csv(out / "estimates.csv")
    assert estimates["parameter"].tolist() == ["R", "L"]
    assert estimates["unit"].tolist() == ["Ohm", "H"]
    assert estimates["value"].tolist() == [found["parameters"][name]["value"] for name in ("R", "L")]
    freedom = [each["degrees_of_freedom"] for each in found["parameters"].values()]
    half = stats.t.ppf(0.975, freedom) * estimates["std"]
    np.testing.assert_allclose(estimates["lower"], estimates["value"] - half, rtol=1e-6)
    np.testing.assert_allclose(estimates["upper"], estimates["value"] + half, rtol=1e-6)

    trace = pd.read_csv(out / "trace.csv")
    assert {"iteration", "criterion", "lambda", "accepted", "R", "L"} <= set(trace.columns)
    assert trace["iteration"].iloc[-1] == found["iterations"]
    assert trace["criterion"].iloc[-1] == pytest.approx(found["criterion"])
    assert (trace["R"].iloc[0], trace["L"].iloc[0]) == (6.0, 0.05)

    fit, table = pd.read_csv(out / "fit.csv"), pd.read_csv(folder / "first.csv")
    assert list(fit.columns) == ["time", "measured.i", "simulated.i"]
    np.testing.assert_array_equal(fit["measured.i"], table["i"])
    exact = coil_current(table["u"].to_numpy(), 0.0)
    assert np.abs(fit["simulated.i"] - exact).max() < NOISE / 5


def test_identify_several_experiments(folder: Path) -> None:
    study = folder / "study.toml"
    study.write_text(STUDY + SECOND)
    assert fmuid_("identify", study) == DONE
    found = result(folder / "results")["parameters"]
    assert list(found) == ["R", "L", "i_start[first]", "i_start[second]"]
    assert found["i_start[first]"]["value"] == pytest.approx(0.0, abs=0.03)
    assert found["i_start[second]"]["value"] == pytest.approx(0.2, abs=0.03)
    fit = pd.read_csv(folder / "results/fit.csv")
    assert list(fit.columns) == ["experiment", "time", "measured.i", "simulated.i"]
    assert fit["experiment"].value_counts().to_dict() == {"first": 600, "second": 600}
    units = pd.read_csv(folder / "results/estimates.csv")["unit"]
    assert units.tolist() == ["Ohm", "H", "A", "A"]


def test_identify_with_prior(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    prior = "parameters.R.prior={mean = 5.0, std = 0.01}"
    assert fmuid_("identify", folder / "study.toml", "--set", prior, "--set", "noise.variance=4e-4") == DONE
    found = result(folder / "results")["parameters"]["R"]
    assert (found["prior_mean"], found["prior_std"]) == (5.0, 0.01)
    assert found["pull"] == pytest.approx((found["value"] - 5.0) / 0.01)
    assert found["pull"] < -1
    out = capsys.readouterr().out
    assert "5.000 ± 0.010" in out
    assert f"{found['pull']:+.2f} std" in out


def test_api_gives_what_the_command_writes(folder: Path) -> None:
    assert fmuid_("identify", folder / "study.toml") == DONE
    study = fmuid.Study.read(folder / "study.toml")
    seen: list[Any] = []
    found = study.identify(seen.append)
    written = result(folder / "results")
    assert {name: found[name] for name in found.names} == {
        name: values["value"] for name, values in written["parameters"].items()
    }
    assert seen[-1].number == found.iterations


def test_not_converged(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("identify", folder / "study.toml", *HASTY) == NOT_SUCCEEDED
    assert result(folder / "results")["converged"] is False
    assert "raise max_iterations" in capsys.readouterr().out


def test_bound_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmuid_("identify", folder / "study.toml", "--set", "parameters.R.max=3.5", "--set", "parameters.R.start=3")
    assert result(folder / "results")["parameters"]["R"]["value"] == 3.5
    assert "R is at its bound 3.5" in capsys.readouterr().out


def test_undetermined(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At rest from start to end the inductance has no effect, and with the initial current free it has still none."""
    times = np.linspace(0.0, 0.1, 101)
    current = 0.25 + 0.01 * np.random.default_rng(8).normal(size=101)
    pd.DataFrame({"time": times, "u": 1.0, "i": current}).to_csv(folder / "first.csv", index=False)
    start = ["--set", "model.values.i_start=0.25", "--set", "parameters.R.start=4"]
    code = fmuid_("identify", folder / "study.toml", *start)
    assert code in (NOT_SUCCEEDED, WRONG_INPUT)
    assert "L" in "".join(capsys.readouterr())


def test_interrupted_keeps_the_best_so_far(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = progress.Display.__call__

    def interrupt(self: progress.Display, event: Event) -> None:
        shown(self, event)
        if isinstance(event, SearchStep) and event.number == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(progress.Display, "__call__", interrupt)
    assert fmuid_("identify", folder / "study.toml") == NOT_SUCCEEDED
    first = result(folder / "results")
    assert first["outcome"] == "interrupted"
    assert first["converged"] is False
    assert first["parameters"]["R"]["value"] != 6.0
    assert "Interrupted" in capsys.readouterr().out

    monkeypatch.undo()
    assert fmuid_("identify", folder / "study.toml", "--resume") == DONE
    second = result(folder / "results")
    assert second["parameters"]["R"]["start"] == first["parameters"]["R"]["value"]
    assert second["parameters"]["R"]["value"] == pytest.approx(R, rel=0.05)


def test_interrupted_before_the_search(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Study, "read", interrupt)
    assert fmuid_("identify", folder / "study.toml") == NOT_SUCCEEDED
    assert capsys.readouterr().err == "error: interrupted\n"


def test_failing_simulation(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the model cannot simulate at the start ends with one sentence and code 1."""
    assert fmuid_("identify", folder / "study.toml", "--set", "model.values.i_start=1e308") == NOT_SUCCEEDED
    sentence = capsys.readouterr().err
    assert sentence.startswith("error: simulation of ")
    assert "Coil.fmu failed at t = 0 s with R = 6, L = 0.05" in sentence
    assert sentence.count("\n") == 1


def test_resume_of_another_study(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("identify", folder / "study.toml") == DONE
    other = STUDY.replace("R = ", "i_start = ").replace("L = ", "# ")
    (folder / "study.toml").write_text(other)
    capsys.readouterr()
    assert fmuid_("identify", folder / "study.toml", "--resume") == WRONG_INPUT
    assert "of another study: its parameters are R, L, not i_start" in capsys.readouterr().err


def test_a_failed_write_leaves_the_earlier_result(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fmuid_("identify", folder / "study.toml") == DONE
    before = (folder / "results/result.json").read_bytes()

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    assert fmuid_("identify", folder / "study.toml", "--set", "parameters.R.start=5") == WRONG_INPUT
    assert (folder / "results/result.json").read_bytes() == before
    assert not list((folder / "results").glob(".*"))


# --- priors, global search, uncertainty -------------------------------------------------


def test_prior_from_an_earlier_result(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The second machine is another one: its estimate lies between the first one's and what its own data say."""
    study = folder / "study.toml"
    assert fmuid_("identify", study, "--output", folder / "healthy") == DONE
    healthy = result(folder / "healthy")
    assert healthy["models"][""]["name"] == "Coil"
    capsys.readouterr()
    study.write_text(STUDY.replace("first", "second") + '[prior]\nresult = "healthy/result.json"\ninflate = 2\n')
    assert fmuid_("identify", study, "--set", "model.values.i_start=0.2") == DONE
    found = result(folder / "results")
    for name in ("R", "L"):
        prior, estimate = healthy["parameters"][name], found["parameters"][name]
        assert estimate["prior_mean"] == prior["value"]
        # the standard deviation whose normal interval is that of the first estimate
        std = 2 * prior["std"] * stats.t.ppf(0.975, prior["degrees_of_freedom"]) / stats.norm.ppf(0.975)
        assert estimate["prior_std"] == pytest.approx(std)
        assert estimate["pull"] == pytest.approx((estimate["value"] - prior["value"]) / std)
    reading = pd.read_csv(folder / "results/reading.csv")
    inside = (reading["combined"] - reading["prior"]) * (reading["data"] - reading["combined"])
    assert reading["parameter"].tolist() == ["R", "L"]
    assert (inside >= -1e-12).any()
    assert (reading["combined_std"] < reading["data_std"]).all()
    assert "consistency" in found
    out, error = capsys.readouterr()
    assert error == ""
    heads = next(line for line in out.splitlines() if "data alone" in line)
    columns = ["parameter", "prior", "data alone", "both", "pull", "moved by prior", "unit"]
    assert re.split(r"\s{2,}", heads.strip()) == columns


def test_what_takes_long_says_what_it_does(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fmuid.reports.run.QUICK_SECONDS", 0.0)
    assert fmuid_("identify", folder / "study.toml") == DONE
    assert capsys.readouterr().err == ""
    prior = "parameters.R.prior={mean = 4.0, std = 0.1}"
    assert fmuid_("identify", folder / "study.toml", "--set", prior) == DONE
    assert "searching the optimum of the data alone" in capsys.readouterr().err


def test_prior_from_the_result_of_another_model(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = folder / "study.toml"
    assert fmuid_("identify", study, "--output", folder / "healthy") == DONE
    content = result(folder / "healthy")
    content["models"][""]["name"] = "Spool"
    (folder / "healthy/result.json").write_text(json.dumps(content))
    capsys.readouterr()
    study.write_text(STUDY + '[prior]\nresult = "healthy/result.json"\n')
    assert fmuid_("identify", study) == WRONG_INPUT
    assert "is a result of another model, Spool, and this study has Coil" in capsys.readouterr().err
    content["models"][""] = {"name": "Coil", "digest": "of an earlier build"}
    (folder / "healthy/result.json").write_text(json.dumps(content))
    assert fmuid_("identify", study) == DONE
    assert "was made with another build of Coil" in capsys.readouterr().err


BOUNDED = STUDY.replace("min = 0.0", "min = 0.5, max = 50.0").replace("min = 1e-3", "min = 1e-3, max = 1.0")


def test_global_search(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = folder / "study.toml"
    study.write_text(BOUNDED + '[estimator]\nmethod = "global"\nstarts = 6\nseed = 3\n')
    assert fmuid_("identify", study) == DONE
    found = result(folder / "results")
    best = found["optima"][0]
    assert sum(optimum["hits"] for optimum in found["optima"]) == 6
    assert best["parameters"]["R"] == pytest.approx(R, rel=0.05)
    assert found["parameters"]["R"]["value"] == best["parameters"]["R"]
    table = pd.read_csv(folder / "results/optima.csv")
    assert list(table.columns) == ["criterion", "hits", "converged", "R", "L"]
    assert len(table) == len(found["optima"])
    out = capsys.readouterr().out
    assert "Optima found by 6 searches" in out
    assert "fits" in out
    api = Study.read(study)
    assert api.identify()["R"] == found["parameters"]["R"]["value"]
    assert len(api.identify().optima) == len(table)

    capsys.readouterr()
    assert fmuid_("identify", study, "--resume") == DONE
    again = result(folder / "results")
    assert again["parameters"]["R"]["start"] == found["parameters"]["R"]["value"]
    assert "optima" not in again
    assert not (folder / "results/optima.csv").exists()


def test_global_search_needs_bounds(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("identify", folder / "study.toml", "--set", "estimator.method=global") == WRONG_INPUT
    assert "parameter 'R' has no max" in capsys.readouterr().err


ASKED = """
[uncertainty]
level = 0.9
profile = true
posterior = { steps = 400, seed = 5 }
map = [["R", "L"]]
"""


def test_uncertainty(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "study.toml").write_text(STUDY + ASKED)
    code = fmuid_("identify", folder / "study.toml", "--figures", "svg")
    out, results = capsys.readouterr().out, folder / "results"
    found = result(results)
    assert code == (DONE if found["posterior"]["converged"] else NOT_SUCCEEDED)
    assert {"profiles.csv", "posterior.csv", "map-R-L.csv"} <= {path.name for path in results.iterdir()}
    figures = {path.name for path in (results / "figures").iterdir()}
    assert {"parameters.svg", "profiles.svg", "posterior.svg", "map-R-L.svg"} <= figures
    estimates = pd.read_csv(results / "estimates.csv").set_index("parameter")
    for name in ("R", "L"):
        assert found["profiles"][name]["lower"] == pytest.approx(estimates["lower"][name], rel=0.01)
        assert found["posterior"]["parameters"][name]["upper"] == pytest.approx(estimates["upper"][name], rel=0.01)
    samples = pd.read_csv(results / "posterior.csv")
    assert samples["R"].mean() == pytest.approx(found["posterior"]["parameters"]["R"]["mean"])
    assert len(pd.read_csv(results / "map-R-L.csv")) == 41**2
    assert {"profile", "posterior", "map"} <= {line.split()[0] for line in out.splitlines() if line.strip()}
    assert "Intervals at 90 %" in out
    assert "90 % interval" in out

    # the next run without them leaves none behind
    assert fmuid_("identify", folder / "study.toml", "--set", "uncertainty={}") == DONE
    assert not list((results / "figures").iterdir())
    assert not {path.name for path in results.iterdir()} & {"profiles.csv", "posterior.csv", "map-R-L.csv"}


def test_uncertainty_interrupted(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was found before is written, and so is what there is of the rest."""

    def interrupt(_: progress.Display, event: Event) -> None:
        if event.task == "posterior":
            assert "profiles" not in result(folder / "results")  # the result was written before the long work
            raise KeyboardInterrupt

    monkeypatch.setattr(progress.Display, "__call__", interrupt)
    (folder / "study.toml").write_text(STUDY + ASKED)
    assert fmuid_("identify", folder / "study.toml") == NOT_SUCCEEDED
    found = result(folder / "results")
    assert found["converged"] is True
    assert list(found["profiles"]) == ["R", "L"]
    assert (folder / "results/profiles.csv").is_file()
    assert "Interrupted: this is what there is" in capsys.readouterr().out


def test_uncertainty_needs_a_minimum(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "study.toml").write_text(STUDY + ASKED)
    assert fmuid_("identify", folder / "study.toml", *HASTY) == NOT_SUCCEEDED
    assert "[uncertainty] is left out" in capsys.readouterr().err
    assert "profiles" not in result(folder / "results")


def test_loss(folder: Path) -> None:
    """Gross outliers pull the plain sum of squares away, and hardly a robust one."""
    table = pd.read_csv(folder / "first.csv")
    table.loc[::20, "i"] += 1.0
    table.to_csv(folder / "first.csv", index=False)
    away = {}
    for loss in ("linear", "cauchy"):
        fmuid_("identify", folder / "study.toml", "--set", f"estimator.loss={loss}")
        away[loss] = abs(result(folder / "results")["parameters"]["R"]["value"] - R)
    assert away["cauchy"] < 0.1 * away["linear"]


# --- simulate ----------------------------------------------------------------------------


def test_simulate(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("--set", "parameters.R.start=4.0", "--set", "parameters.L.start=0.1")
    assert fmuid_("simulate", folder / "study.toml", *arguments) == DONE
    table = pd.read_csv(folder / "first.csv")
    simulated = pd.read_csv(folder / "results/simulated.csv")
    assert list(simulated.columns) == ["time", "i"]
    exact = coil_current(table["u"].to_numpy(), 0.0)
    np.testing.assert_allclose(simulated["i"], exact, atol=1e-9)
    misfit = np.linalg.norm(table["i"] - exact) / np.linalg.norm(table["i"])
    assert f"{100 * misfit:.3g} %" in capsys.readouterr().out
    assert [path.name for path in (folder / "results/figures").iterdir()] == ["fit.png"]


def test_simulate_several_experiments_and_api(folder: Path) -> None:
    study = folder / "study.toml"
    study.write_text(STUDY + SECOND)
    assert fmuid_("simulate", study, "-o", folder / "out") == DONE
    written = pd.read_csv(folder / "out/simulated.csv")
    frames = Study.read(study).simulate()
    assert len(frames) == 2
    for name, frame in zip(("first", "second"), frames, strict=True):
        part = written[written["experiment"] == name].drop(columns="experiment").reset_index(drop=True)
        pd.testing.assert_frame_equal(part, frame)


def test_simulate_without_parameters(folder: Path) -> None:
    (folder / "study.toml").write_text(STUDY.partition("[parameters]")[0])
    assert fmuid_("simulate", folder / "study.toml") == DONE


def test_input_that_nothing_feeds_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("simulate", folder / "study.toml", "--set", "experiments.0.inputs=[]") == DONE
    assert "feeds no u: kept at the start value" in capsys.readouterr().err


# --- info, init, export, help ------------------------------------------------------------


def test_info(capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("info", FMUS / "InductionMachine/InductionMachine.fmu") == DONE
    out = capsys.readouterr().out
    for text in (
        "InductionMachine",
        "FMI version",
        "2.0",
        "co-simulation",
        "model-exchange",
        "variable communication steps, interpolates inputs",
        "directional derivatives",
        "linux64",
        "step 0.0007 s",
        "Parameters (8)",
        "Inputs (3)",
        "Outputs (2)",
        "States (4)",
        "magnetising inductance",
        "rad/s",
        "4 other variables",
    ):
        assert text in out
    (line,) = [line for line in out.splitlines() if line.startswith("Rs ")]
    assert line.split()[:4] == ["Rs", "9.81", "Ohm", "0"]


def test_init_gives_a_study_that_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = pd.read_csv(folder / "first.csv").assign(temperature=20.0).rename(columns={"time": "t"})
    frame.to_csv(folder / "first.csv", index=False)
    study = folder / "new.toml"
    assert fmuid_("init", COIL, folder / "first.csv", "--output", study) == DONE
    out = capsys.readouterr().out
    assert out.count("same name") == 2
    assert "temperature" in out
    text = study.read_text()
    content = tomllib.loads(text)
    assert content["experiments"] == [
        {
            "table": "first.csv",
            "time": "time",  # which t is too
            "inputs": ["u"],
            "outputs": ["i"],
            "interpolation": "hold",  # as the voltage shows
            "discard": 0.0,
        }
    ]
    assert content["parameters"] == {"R": {"start": 4.0, "min": 0.0}, "L": {"start": 0.1, "min": 1e-9}}
    assert re.search(r"^R = {.*}  # Ohm: resistance; [\d.]+ %$", text, re.MULTILINE)
    assert "# i_start = { start = 0.0, nominal = 1.0 }  # A: initial current; " in text
    assert "temperature" in text
    assert "Next: fmuid identify " in out

    assert fmuid_("identify", study) == DONE
    assert result(folder / "results")["parameters"]["R"]["value"] == pytest.approx(R, rel=0.05)


def test_every_line_of_a_draft_is_valid(folder: Path) -> None:
    """All parameters, taken out of their comments, are a valid study."""
    machine = FMUS / "InductionMachine/InductionMachine.fmu"
    pd.DataFrame({"time": [0.0, 1.0], "uds": 1.0, "w": 0.0, "ids": 0.1}).to_csv(folder / "run.csv", index=False)
    made = draft(machine, begin(machine, [folder / "run.csv"]), folder / "sub/study.toml")
    assert made.records[0].lacking("input") == ("uqs",)
    assert made.records[0].lacking("output") == ("iqs",)
    lines = [
        line.removeprefix("# ") if line.startswith("# ") and " = { start" in line else line
        for line in made.text.splitlines()
    ]
    (folder / "sub").mkdir()
    study = folder / "sub/study.toml"
    study.write_text("\n".join(lines))
    read = Study.read(study)
    assert list(read.parameters)[:4] == ["Rs", "Rr", "Lm", "Lf"]
    assert read.experiments[0].table.resolve() == (folder / "run.csv").resolve()


def test_every_word_that_init_comments_on_is_one(folder: Path) -> None:
    """With all its comments uncommented, what `fmuid init` writes is a study still."""
    assert fmuid_("identify", folder / "study.toml", "--output", folder / "healthy") == DONE
    made = draft(COIL, begin(COIL, [folder / "first.csv"]), folder / "study.toml")
    text = made.text.replace('"a", "b"', '"R", "L"').replace('"marquardt"', '"global"').replace('"soft_l1"', '"linear"')
    words = re.compile(r"^# (?=\[?(?!prior |per_experiment )[a-zA-Z_]+\]?( = |  #))")
    (folder / "study.toml").write_text("\n".join(words.sub("", line) for line in text.splitlines()))
    read = Study.read(folder / "study.toml")
    assert read.joint_prior is not None
    assert read.noise.start == 0.01
    assert read.uncertainty_settings.maps == (("R", "L"),)


def test_export(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The command passes paths and options on and says where the FMU is; the export has its own tests."""
    import fmuid.export

    calls = []

    def fake(source: Path, output: Path | None = None, **options: object) -> Path:
        calls.append((source, output, options))
        warnings.warn(ModelicaWarning("Coil.mo", 7, "parameter 'a' is used nowhere"), stacklevel=2)
        return folder / "Coil.fmu"

    monkeypatch.setattr(fmuid.export, "export_fmu", fake)
    assert fmuid_("export", "Coil.mo") == DONE
    assert fmuid_("export", "Coil.mo", "--output", "x/Y.fmu") == DONE
    assert fmuid_("export", "Coil.mo", "--fmi", "3.0", "--sensitivities", "R, L") == DONE
    assert fmuid_("export", "Coil.mo", "--sensitivities", "all") == DONE
    assert calls == [
        (Path("Coil.mo"), None, {"fmi": "2.0", "sensitivities": []}),
        (Path("Coil.mo"), Path("x/Y.fmu"), {"fmi": "2.0", "sensitivities": []}),
        (Path("Coil.mo"), None, {"fmi": "3.0", "sensitivities": ["R", "L"]}),
        (Path("Coil.mo"), None, {"fmi": "2.0", "sensitivities": "all"}),
    ]
    out = capsys.readouterr().out
    assert "Coil.fmu" in out
    assert out.count("note: Coil.mo:7: parameter 'a' is used nowhere\n") == 4


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("--version") == DONE
    assert capsys.readouterr().out == f"fmuid {fmuid.__version__}\n"
    assert fmuid_("--help") == DONE
    out = capsys.readouterr().out
    assert all(command in out for command in ("info", "init", "simulate", "identify", "export"))
    assert fmuid_() == DONE
    assert capsys.readouterr().out == out


def test_exit_code_of_the_process(folder: Path) -> None:
    """The installed entry point is `main`; ``python -m fmuid`` is the same."""
    run_ = subprocess.run(
        [sys.executable, "-m", "fmuid", "info", str(folder / "none.fmu")], capture_output=True, text=True, check=False
    )
    assert run_.returncode == WRONG_INPUT
    assert run_.stderr.startswith("error: ")
    with pytest.raises(SystemExit) as end:
        cli.main(["--version"])
    assert end.value.code == DONE
