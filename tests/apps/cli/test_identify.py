"""fmuid identify: what it writes, says and returns; global searches, profiles, posterior."""

import json
import re
import shutil
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import fmuid
from experiments.batches.campaign import NOISE, L, R, coil_current
from fmuid import Study
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, WRONG_INPUT
from fmuid.events import Event
from fmuid.reports.render import progress
from tests.support.coil_study import HASTY, STUDY, coil_table, fmuid_, result
from tests.support.quick import draw_nothing

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Identify the study of a coil with figures; return its folder and what is printed."""
    folder = tmp_path_factory.mktemp("coil")
    coil_table(folder / "first.csv", 0.0, seed=1)
    (folder / "study.toml").write_text(STUDY)
    with (
        redirect_stdout(StringIO()) as out,
        redirect_stderr(StringIO()) as error,
        pytest.MonkeyPatch.context() as patch,
    ):
        draw_nothing(patch)
        assert fmuid_("identify", folder / "study.toml", "--output", folder / "deep/out", "--figures", "png") == DONE
    assert error.getvalue() == ""
    return folder, out.getvalue()


@pytest.fixture
def known(identified: tuple[Path, str], folder: Path) -> Path:
    """Return a study's folder with the results of an earlier run."""
    shutil.copytree(identified[0] / "deep/out", folder / "results")
    return folder


def test_identify(identified: tuple[Path, str]) -> None:
    folder, out = identified
    found = result(folder / "deep/out")
    assert (found["outcome"], found["converged"]) == ("converged", True)
    for name, truth, start in (("R", R, 6.0), ("L", L, 0.05)):
        estimate = found["parameters"][name]
        assert abs(estimate["value"] - truth) < 4 * estimate["std"] < 0.12 * truth
        assert (estimate["start"], estimate["prior_z_score"]) == (start, None)
    assert found["covariance"]["names"] == ["R", "L"]
    diagonal = np.sqrt(np.diag(found["covariance"]["matrix"]))
    np.testing.assert_allclose(diagonal, [found["parameters"][name]["std"] for name in ("R", "L")])
    assert found["fit"]["noise_variance"]["i"] == pytest.approx(NOISE**2, rel=0.2)
    assert found["setup"]["version"] == fmuid.__version__
    assert {"cost", "log_likelihood"} <= found["fit"].keys()
    assert {"iterations", "simulations", "elapsed_s"} <= found["history"].keys()
    assert out.startswith(f"PASSED       converged after {found['history']['iterations']} iterations")
    for word in ("parameter", "relative σ", "95 % interval", "Ohm", "Fit  ", "Residuals", "Solver", "report.html"):
        assert word in out


def test_identify_writes_tables_and_figures(identified: tuple[Path, str]) -> None:
    folder, out = identified[0], identified[0] / "deep/out"
    assert {path.name for path in out.iterdir()} == {
        "result.json", "estimates.csv", "trace.csv", "fit.csv", "diagnostics.csv",
        "parameters.ssv", "document.json", "report.html", "figures",
    }  # fmt: skip
    drawn = ("forest", "fit", "residuals", "parameters", "cost", "correlation", "accuracy", "hiding")
    assert {path.name for path in (out / "figures").iterdir()} == {f"{name}.png" for name in drawn}
    found, estimates = result(out), pd.read_csv(out / "estimates.csv")
    assert estimates["parameter"].tolist() == ["R", "L"]
    assert estimates["unit"].tolist() == ["Ohm", "H"]
    assert estimates["value"].tolist() == [found["parameters"][name]["value"] for name in ("R", "L")]
    half = stats.t.ppf(0.975, [each["variance_dof"] for each in found["parameters"].values()]) * estimates["std"]
    for side, sign in (("lower", -1), ("upper", 1)):
        np.testing.assert_allclose(estimates[side], estimates["value"] + sign * half, rtol=1e-6)
    trace = pd.read_csv(out / "trace.csv")
    assert {"iteration", "cost", "damping", "accepted", "R", "L"} <= set(trace.columns)
    assert trace["iteration"].iloc[-1] == found["history"]["iterations"]
    assert trace["cost"].iloc[-1] == pytest.approx(found["fit"]["cost"])
    assert (trace["R"].iloc[0], trace["L"].iloc[0]) == (6.0, 0.05)
    fit, table = pd.read_csv(out / "fit.csv"), pd.read_csv(folder / "first.csv")
    assert list(fit.columns) == ["time", "measured.i", "simulated.i", "input.u"]
    np.testing.assert_array_equal(fit["input.u"], table["u"])
    np.testing.assert_array_equal(fit["measured.i"], table["i"])
    assert np.abs(fit["simulated.i"] - coil_current(table["u"].to_numpy(), 0.0)).max() < NOISE / 5


def test_not_converged_or_interrupted(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert fmuid_("identify", folder / "study.toml", *HASTY) == NOT_SUCCEEDED
    assert result(folder / "results")["converged"] is False
    assert "Raise `max_iterations`" in capsys.readouterr().out

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Study, "read", interrupt)
    assert fmuid_("identify", folder / "study.toml") == NOT_SUCCEEDED
    assert capsys.readouterr().err == "error: interrupted\n"


def test_failing_simulation(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the model cannot simulate at the start ends with one sentence and code 1."""
    assert fmuid_("identify", folder / "study.toml", "--set", "model.fixed.i_start=1e308") == NOT_SUCCEEDED
    sentence = capsys.readouterr().err
    assert sentence.startswith("error: simulation of ")
    assert "Coil.fmu failed at t = 0 s with R = 6, L = 0.05" in sentence
    assert sentence.count("\n") == 1


def test_resume_of_another_study(known: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (known / "study.toml").write_text(STUDY.replace("R = ", "i_start = ").replace("L = ", "# "))
    assert fmuid_("identify", known / "study.toml", "--resume") == WRONG_INPUT
    assert "of another study, with parameters R, L, not i_start" in capsys.readouterr().err


def test_a_failed_write_leaves_the_earlier_result(known: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (known / "results/result.json").read_bytes()

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    assert fmuid_("identify", known / "study.toml", "--set", "parameters.R.start=5") == WRONG_INPUT
    assert (known / "results/result.json").read_bytes() == before
    assert not list((known / "results").glob(".*"))


# --- priors ------------------------------------------------------------------------------


def test_prior_from_an_earlier_result(
    known: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second machine is another one: its estimate lies between the first one's and what its own data say."""
    monkeypatch.setattr("fmuid.runs.run.QUICK_SECONDS", 0.0)
    study, healthy = known / "study.toml", result((known / "results").rename(known / "healthy"))
    assert healthy["setup"]["models"][""]["name"] == "Coil"
    study.write_text(STUDY.replace("first", "second") + '[prior]\nresult = "healthy/result.json"\nstd_factor = 2\n')
    assert fmuid_("identify", study, "--set", "model.fixed.i_start=0.2", "--verbose") == DONE
    found = result(known / "results")
    for name in ("R", "L"):
        prior, estimate = healthy["parameters"][name], found["parameters"][name]
        assert estimate["prior_mean"] == prior["value"]
        # the standard deviation whose normal interval is that of the first estimate
        std = 2 * prior["std"] * stats.t.ppf(0.975, prior["variance_dof"]) / stats.norm.ppf(0.975)
        assert estimate["prior_std"] == pytest.approx(std)
        assert estimate["prior_z_score"] == pytest.approx((estimate["value"] - prior["value"]) / std)
    reading = pd.DataFrame(found["assessment"]["prior_and_data"]["parameters"]).T
    inside = (reading["combined"] - reading["prior_mean"]) * (reading["data"] - reading["combined"])
    assert reading.index.tolist() == ["R", "L"]
    assert (inside >= -1e-12).any()
    assert (reading["combined_std"] < reading["data_std"]).all()
    out, error = capsys.readouterr()
    assert "iteration 0" in error
    assert "Optimizing with the data alone" in error
    heads = next(line for line in out.splitlines() if "data alone" in line)
    columns = ["parameter", "prior", "data alone", "both", "distance", "moved by prior", "unit"]
    assert re.split(r"\s{2,}", heads.strip()) == columns


def test_prior_from_the_result_of_another_model(known: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study, content = known / "study.toml", result(known / "results")
    content["setup"]["models"][""]["name"] = "Spool"
    (known / "healthy.json").write_text(json.dumps(content))
    study.write_text(STUDY + '[prior]\nresult = "healthy.json"\n')
    assert fmuid_("identify", study) == WRONG_INPUT
    assert "is of another model, Spool" in capsys.readouterr().err
    content["setup"]["models"][""] = {"name": "Coil", "digest": "of an earlier build"}
    (known / "healthy.json").write_text(json.dumps(content))
    assert fmuid_("identify", study) == DONE
    assert "another build of Coil" in capsys.readouterr().err


BOUNDED = STUDY.replace("min = 0.0", "min = 0.5, max = 50.0").replace("min = 1e-3", "min = 1e-3, max = 1.0")


def test_global_search(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = folder / "study.toml"
    study.write_text(BOUNDED + '[estimation]\nmethod = "multi-start"\nn_starts = 6\nseed = 3\n')
    assert fmuid_("identify", study) == DONE
    found = result(folder / "results")
    best = dict(zip(found["parameters"], found["history"]["optima"][0]["theta"], strict=True))
    assert sum(optimum["hits"] for optimum in found["history"]["optima"]) == 6
    assert best["R"] == pytest.approx(R, rel=0.05)
    assert found["parameters"]["R"]["value"] == pytest.approx(best["R"], abs=found["parameters"]["R"]["std"])
    table = pd.read_csv(folder / "results/optima.csv")
    assert list(table.columns) == ["cost", "hits", "converged", "R", "L"]
    assert len(table) == len(found["history"]["optima"])
    out = capsys.readouterr().out
    assert "Optima" in out
    api = Study.read(study).identify()
    assert (api["R"], len(api.history.optima)) == (found["parameters"]["R"]["value"], len(table))
    assert fmuid_("identify", study, "--resume") == DONE
    again = result(folder / "results")
    assert again["parameters"]["R"]["start"] == found["parameters"]["R"]["value"]
    assert not again["history"]["optima"]
    assert not (folder / "results/optima.csv").exists()


ASKED = """
[uncertainty]
confidence_level = 0.9
profile_likelihood = true
posterior = { max_steps = 400, seed = 5 }
cost_map = [["R", "L"]]
"""


@pytest.mark.slow
def test_uncertainty(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "study.toml").write_text(STUDY + ASKED)
    code = fmuid_("identify", folder / "study.toml", "--figures", "svg")
    out, results = capsys.readouterr().out, folder / "results"
    found = json.loads((results / "result.json").read_text())["assessment"]
    assert code == (DONE if found["posterior"]["converged"] else NOT_SUCCEEDED)
    assert {"profiles.csv", "posterior.csv", "map-R-L.csv"} <= {path.name for path in results.iterdir()}
    figures = {path.name for path in (results / "figures").iterdir()}
    assert {"parameters.svg", "profiles.svg", "posterior.svg", "walkers.svg", "maps.svg"} <= figures
    estimates = pd.read_csv(results / "estimates.csv").set_index("parameter")
    for profile in found["profiles"]:
        assert profile["lower"] == pytest.approx(estimates["lower"][profile["name"]], rel=0.01)
    samples = pd.read_csv(results / "posterior.csv")
    for name in ("R", "L"):
        assert samples[name].quantile(0.95) == pytest.approx(estimates["upper"][name], rel=0.01)
    assert samples["R"].mean() == pytest.approx(found["posterior"]["mean"][0])
    assert len(pd.read_csv(results / "map-R-L.csv")) == 41**2
    assert "90 % intervals" in out
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
            early = result(folder / "results")  # written before the long work
            assert not early["assessment"]["profiles"]
            raise KeyboardInterrupt

    monkeypatch.setattr(progress.Display, "__call__", interrupt)
    (folder / "study.toml").write_text(STUDY + ASKED)
    assert fmuid_("identify", folder / "study.toml") == NOT_SUCCEEDED
    found = result(folder / "results")
    assert found["converged"] is True
    assert [each["name"] for each in found["assessment"]["profiles"]] == ["R", "L"]
    assert (folder / "results/profiles.csv").is_file()
    assert "NOT USABLE   interrupted" in capsys.readouterr().out


def test_uncertainty_needs_a_minimum(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "study.toml").write_text(STUDY + ASKED)
    assert fmuid_("identify", folder / "study.toml", *HASTY) == NOT_SUCCEEDED
    assert "[uncertainty] was skipped" in capsys.readouterr().err
    assert not result(folder / "results")["assessment"]["profiles"]
