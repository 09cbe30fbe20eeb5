"""`fmuid compare` from end to end: likelihoods on the same data, errors on a common table."""

import json
from pathlib import Path

import pandas as pd
import pytest

from fmuid.apps.cli.options import DONE, WRONG_INPUT
from tests.support.coil_study import STUDY, coil_table, fmuid_
from tests.support.running import run_prediction

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a coil with both parameters free, with L held right and wrong, and one of another record."""
    folder = tmp_path_factory.mktemp("coil")
    for k, name in enumerate(("first", "second", "third")):
        coil_table(folder / f"{name}.csv", 0.0, seed=k)
    text = STUDY.replace("[[experiments]]", "[model.fixed]\n[[experiments]]")
    free_l = next(line for line in text.splitlines() if line.startswith("L ="))
    for name, held in {"both": "", "right": "L = 0.1", "wrong": "L = 0.15"}.items():
        study = text.replace(free_l, "") if held else text
        (folder / f"{name}.toml").write_text(study.replace("[model.fixed]", f"[model.fixed]\n{held}"))
        told = ("--no-report", "--set", 'estimation.model_error="report"')  # a wrong L is not freed
        assert fmuid_("identify", folder / f"{name}.toml", "-o", folder / name, "--no-isolation", *told) == DONE
    other = ("--set", "experiments.0.data=second.csv", "-o", folder / "other", "--no-report")
    assert fmuid_("identify", folder / "both.toml", *other, "--no-isolation") == DONE
    return folder


def rows(folder: Path) -> dict[str, dict[str, float]]:
    """Return the rows of the table by the name of the result."""
    frame = pd.read_csv(folder / "comparison.csv")
    return {str(row.pop("name")): row for row in frame.to_dict("records")}  # type: ignore[misc]


@pytest.mark.usefixtures("drawn_figures")
def test_on_the_same_data(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [made / name for name in ("both", "right", "wrong")]
    assert fmuid_("compare", *paths, "-o", tmp_path, "--no-isolation") == DONE
    out = " ".join(capsys.readouterr().out.split())
    assert "wrong is rejected against both" in out
    assert "right is not rejected against both" in out
    assert "equally good" in out or "is best by AIC, not clearly" in out
    content = json.loads((tmp_path / "comparison.json").read_text())
    likelihoods = {
        name: json.loads((made / name / "result.json").read_text())["fit"]["log_likelihood"]
        for name in ("both", "right")
    }
    tests = {test["smaller"]: test for test in content["comparison"]["tests"]}
    assert tests["right"]["freed"] == ["L"]
    twice = 2 * (likelihoods["both"] - likelihoods["right"]) / content["comparison"]["dependence"]
    assert tests["right"]["statistic"] == pytest.approx(twice)
    table = rows(tmp_path)
    assert table["both"]["parameters"] == table["right"]["parameters"] + 1 == 3
    assert list(table)[-1] == "wrong"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in ("wrong is rejected against both", "By likelihood", "estimates"):
        assert words in page
    told = pd.DataFrame(content["estimates"]).set_index(["result", "parameter"])
    assert told.index.to_list() == [("both", "R"), ("both", "L"), ("right", "R"), ("wrong", "R")]
    assert (told["lower"] < told["value"]).all() and (told["value"] < told["upper"]).all()


def test_on_a_common_table(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = (made / "both", made / "other", made / "wrong", "--data", made / "third.csv", "-o", tmp_path)
    assert fmuid_("compare", *words, "--no-isolation") == DONE
    out = " ".join(capsys.readouterr().out.split())
    assert "both and other have different data" in out
    assert "Common data" in out
    assert "equally good" in out
    table = rows(tmp_path)
    (alone,) = run_prediction(made / "both", [made / "third.csv"]).predictions
    assert table["both"]["rmse.i"] == pytest.approx(alone.scores[0].rmse)
    assert 100.0 - table["wrong"]["fit"] > 1.5 * (100.0 - table["both"]["fit"])
    assert "RMSE i (A)" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("both", "other"), "have different data. Their likelihoods are not comparable"),
        (("both",), "needs at least two results"),
        (("both", "both"), "given twice"),
        (("both", "nothing"), "no such result"),
        (("both", "other", "--data", "missing.csv"), "missing.csv"),
    ],
)
def test_wrong_input_is_one_sentence(
    made: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [word if word.startswith("--") else made / word for word in words]
    assert fmuid_("compare", *paths, "--no-isolation") == WRONG_INPUT
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert len(error.splitlines()) == 1
    assert said in error
