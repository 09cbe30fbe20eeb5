"""`fmuid predict` from end to end, and what it says of wrong input."""

import hashlib
import json
from pathlib import Path

import pandas as pd
import pytest

from fmuid.apps.cli.options import DONE, WRONG_INPUT
from fmuid.models import read_description, read_ssv
from tests.support.coil_study import COIL, STUDY, coil_table, fmuid_

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a study, its result and three records."""
    folder = tmp_path_factory.mktemp("coil")
    for k, name in enumerate(("first", "second", "third")):
        coil_table(folder / f"{name}.csv", 0.1 * k, seed=k)
    (folder / "study.toml").write_text(STUDY)
    assert fmuid_("identify", folder / "study.toml", "--no-isolation") == DONE
    return folder


def test_predictions_hold_the_fixed_values_that_a_result_corrected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An inductance fixed 30 % too high is corrected in the result."""
    for k, name in enumerate(("first", "second")):
        coil_table(tmp_path / f"{name}.csv", 0.0, seed=k)
    study = STUDY.replace("L = { start = 0.05, min = 1e-3 }\n", "").replace('.fmu"\n', '.fmu"\nfixed = { L = 0.13 }\n')
    (tmp_path / "study.toml").write_text(study)
    assert fmuid_("identify", tmp_path / "study.toml", "--no-isolation", "--no-report") == DONE
    assert "freed: fixed L is off" in capsys.readouterr().out
    words = ("-o", tmp_path / "found", "--no-isolation", "--no-report")
    assert fmuid_("predict", tmp_path / "results", tmp_path / "second.csv", *words) == DONE
    content = json.loads((tmp_path / "found/prediction.json").read_text())
    assert content["corrected"]["L"] == pytest.approx(0.1, rel=0.05)
    assert content["predictions"][0]["scores"][0]["ratio"] < 1.1
    assert "Fixed values as the result corrected them: L = " in capsys.readouterr().out
    assert {"R", "L"} <= read_ssv(tmp_path / "results/parameters.ssv").values.keys()
    assert fmuid_("apply", tmp_path / "results", COIL, "-o", tmp_path / "New.fmu") == DONE
    start = read_description(tmp_path / "New.fmu").variables["L"].start
    assert start == pytest.approx(content["corrected"]["L"])


def test_predictions_have_freed_errors_or_say_that_they_lack_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k, name in enumerate(("first", "second")):
        coil_table(tmp_path / f"{name}.csv", 0.0, seed=k)
        table = pd.read_csv(tmp_path / f"{name}.csv")
        table.assign(i=table["i"] + 0.02).to_csv(tmp_path / f"{name}.csv", index=False)
    (tmp_path / "study.toml").write_text(STUDY)
    assert fmuid_("identify", tmp_path / "study.toml", "--no-isolation", "--no-report") == DONE
    words = ("-o", tmp_path / "found", "--no-isolation", "--no-report")
    for more, place, said in (
        ((), "errors", "second: predicted with freed errors: offset of i 0.0"),
        (("--refit", "R"), "freed", "Freed errors are not in predictions: offset of i 0.0"),
    ):
        capsys.readouterr()
        assert fmuid_("predict", tmp_path / "results", tmp_path / "second.csv", *words, *more) == DONE
        content = json.loads((tmp_path / "found/prediction.json").read_text())
        (freed,) = (content["predictions"][0] if place == "errors" else content)[place]
        assert freed["test"]["direction"]["kind"] == "offset"
        assert said in capsys.readouterr().out


def test_records_are_predicted(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables = (made / "second.csv", made / "third.csv")
    words = ("--refit", "i_start", "-o", tmp_path, "--no-isolation")
    assert fmuid_("predict", made / "results", *tables, *words, "--figures", "png") == DONE
    out, error = capsys.readouterr()
    assert error == ""
    for word in ("second", "third", "RMSE", "in band", "third: estimated again: i_start = 0.2"):
        assert word in out
    content = json.loads((tmp_path / "prediction.json").read_text())
    names = ("results/result.json", "second.csv", "third.csv")
    origin = content["origin"]
    digests = {name: hashlib.sha256((made / name).read_bytes()).hexdigest() for name in names}
    assert digests.items() <= origin["files"].items()
    assert any(name.endswith("Coil.fmu") for name in origin["files"])
    assert origin["study"]["digest"] == hashlib.sha256((made / "study.toml").read_bytes()).hexdigest()
    assert [record["fit"]["experiment"] for record in content["predictions"]] == ["second", "third"]
    assert content["predictions"][1]["estimated"]["parameters"]["i_start"]["value"] == pytest.approx(0.2, abs=0.05)
    scores = pd.read_csv(tmp_path / "scores.csv")
    assert list(scores["record"]) == ["second", "third"]
    assert scores["rmse"].tolist() == [record["scores"][0]["rmse"] for record in content["predictions"]]
    assert len(pd.read_csv(tmp_path / "prediction.csv")) == 1200
    figures = {path.stem for path in (tmp_path / "figures").iterdir()}
    assert {"prediction", "prediction-2", "residuals"} <= figures
    assert fmuid_("predict", made / "results", *tables, *words, "--no-report") == DONE
    assert list((tmp_path / "figures").iterdir()) == []  # those of an earlier run
    assert not (tmp_path / "report.html").exists()


@pytest.mark.usefixtures("drawn_figures")
def test_the_record_of_the_result_is_no_prediction(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fmuid_("predict", made / "results", made / "first.csv", "-o", tmp_path, "--no-isolation") == DONE
    out, error = capsys.readouterr()
    assert not error
    assert "predicted as expected" in out
    content = json.loads((tmp_path / "prediction.json").read_text())
    page, origin = (tmp_path / "report.html").read_text(encoding="utf-8"), content["origin"]
    assert "The result was estimated from first; this is no validation." in " ".join(out.split())
    told = [origin["study"]["digest"], *origin["files"].values(), origin["date"]]
    assert [each for each in (*told, "this is no validation.") if each not in page] == []
    assert "carries over</span>" not in page
    identified = json.loads((made / "results" / "result.json").read_text())
    rmse = content["predictions"][0]["scores"][0]["rmse"]
    assert rmse**2 == pytest.approx(identified["fit"]["noise_variance"]["i"] * 598 / 600, rel=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_figures")
def test_folds(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    several = [
        f'{{data="{name}.csv", inputs=["u"], outputs=["i"], interpolation="zoh"}}' for name in ("first", "second")
    ]
    with_both = ("--set", f"experiments=[{', '.join(several)}]", "--refit", "i_start")
    code = fmuid_("predict", made / "results", "--folds", "2", *with_both, "-o", tmp_path, "--no-isolation")
    assert code == DONE
    out = capsys.readouterr().out
    assert "Cross-validation" in " ".join(out.split())
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for part in ("Predicted: first", "Predicted: second", "Cross-validation", "second: i predicted"):
        assert part in page
    folds = json.loads((tmp_path / "prediction.json").read_text())["folds"]
    assert [fold["left_out"] for fold in folds] == [["first"], ["second"]]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("results",), "no data to predict"),
        (("results", "second.csv", "--folds", "2"), "Remove DATA"),
        (("results", "--folds", "2"), "cannot be cross-validated"),
        (("nothing", "second.csv"), "no such result"),
        (("results", "missing.csv"), "missing.csv"),
        (("results", "second.csv", "--refit", "Rr"), "'Rr'"),
        (("results", "second.csv", "--confidence", "2"), "the level of a band must lie between 0 and 1"),
        (("results", "second.csv", "--experiment", "x"), "unknown experiment 'x'"),
        (("results", "other.csv"), "'u'"),
        (("results", "volts.csv"), "V"),
    ],
)
def test_wrong_input_is_one_sentence(
    made: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (made / "second.csv").read_text()
    (made / "other.csv").write_text(text.replace("time,u,i", "time,v,i"))
    (made / "volts.csv").write_text(text.replace("time,u,i", "time,u,i [V]"))
    paths = [made / word if word in ("results", "nothing") or "." in word else word for word in words]
    assert fmuid_("predict", *paths, "--no-isolation") == WRONG_INPUT
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert len(error.splitlines()) == 1
    assert said in error
