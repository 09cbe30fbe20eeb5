"""fmuid identify with a global search, profiles, posterior and losses."""

import json
from pathlib import Path

import pandas as pd
import pytest

from experiments.batches.campaign import R
from fmuid import Study
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from fmuid.events import Event
from fmuid.reports.render import progress
from tests.support.coil_study import HASTY, STUDY, fmuid_, result

pytestmark = pytest.mark.usefixtures("blank_figures")


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
