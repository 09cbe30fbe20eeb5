"""`fmuid design` and `fmuid simulate --sensitivities` from end to end."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments.coil import study as coil
from fmuid.apps.cli.options import DONE, WRONG_INPUT
from fmuid.reports.topics.design import healthy_record_remarks
from fmuid.runs.faults import design_of
from tests.support.coil_study import STUDY, fmuid_

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture
def folder(folder: Path) -> Path:
    (folder / "study.toml").write_text(STUDY + "[noise]\nvariance = 4e-4\n")
    times = 1e-3 * np.arange(300)
    for name, voltage in {"constant": 1.0 + 0.0 * times, "square": np.sign(np.sin(120.0 * times + 1e-6))}.items():
        pd.DataFrame({"time": times, "u": voltage}).to_csv(folder / f"{name}.csv", index=False)
    return folder


@pytest.mark.usefixtures("drawn_figures")
def test_design(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = (folder / "study.toml", folder / "constant.csv", folder / "square.csv", "--no-isolation")
    assert fmuid_("design", *words, "-o", folder / "out", "--criterion", "worst") == DONE
    found = pd.read_csv(folder / "out" / "design.csv")
    assert list(found["excitation"]) == ["square", "constant"]
    assert found["worst"].is_monotonic_increasing
    assert "square" in capsys.readouterr().out
    assert "square, best of 2 excitations" in (folder / "out" / "report.html").read_text(encoding="utf-8")


def test_what_healthy_records_cost_the_best_excitation(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study, tables = coil.HERE / "test.toml", [folder / "constant.csv", folder / "square.csv"]
    words = ("--fault", "turns", "-o", folder / "out", "--no-isolation", "--no-report")
    assert fmuid_("design", study, *tables, *words) == DONE
    said = " ".join(capsys.readouterr().out.split())
    square = fmuid.diagnosis.planned_experiment(pd.read_csv(folder / "square.csv"), ["u"], ["i"])
    cost = design_of(fmuid.Study.read(study), "turns").cost(square, [1.0])
    (size,), (times,) = cost["turns.dR"], cost["turns.dR.times"]
    assert "as long as square" in said
    assert f"detectable size is {times:.3g} × its limit" in said
    assert f"{size:.4g}" in said and f"{times:.4g}" in said


def test_the_length_of_a_healthy_record_that_is_enough_is_said() -> None:
    cost = pd.DataFrame({"healthy": [1.0, 3.0, 10.0], "a": 1.0, "a.times": [1.4, 1.2, 1.05], "b": np.inf})
    found = [each.text for each in healthy_record_remarks(cost.assign(**{"b.times": np.nan}))]
    assert found[0].endswith("is 1.4 × its limit; with 10 × longer healthy data, 1.05 ×.")
    assert found[1] == "b: not detectable with this excitation."


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--criterion", "size"), '"determinant" or "worst"'),
        (("--fault", "x"), "no [diagnosis]"),
        (("--set", "noise.variance=estimate"), "no level of 'i'"),
    ],
)
def test_wrong_words(folder: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = fmuid_("design", folder / "study.toml", folder / "square.csv", *words, "--no-isolation")
    assert code == WRONG_INPUT
    assert said in capsys.readouterr().err


def test_sensitivities(folder: Path) -> None:
    words = (folder / "study.toml", "--sensitivities", "-o", folder / "out", "--no-isolation")
    assert fmuid_("simulate", *words) == DONE
    table = pd.read_csv(folder / "out" / "sensitivities.csv")
    assert list(table.columns) == ["time", "i/R", "i/L"]
    assert (folder / "out" / "figures" / "sensitivities.png").is_file()
