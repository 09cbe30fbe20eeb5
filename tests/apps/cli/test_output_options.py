"""Options for the output of commands, and shell completion."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from fmuid import Document
from fmuid.apps.cli.app import COMPLETION, app, run
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from fmuid.reports.document import Column, Message, Remark, Section
from fmuid.reports.render import console
from tests.support.coil_study import STUDY, coil_table, fmuid_
from tests.support.paths import FMUS

pytestmark = pytest.mark.usefixtures("blank_figures")
Said = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("coil")
    coil_table(folder / "first.csv", 0.0, seed=1)
    frame = pd.read_csv(folder / "first.csv")
    frame.assign(i=frame["i"] + 0.1).to_csv(folder / "off.csv", index=False)
    (folder / "study.toml").write_text(STUDY)
    (folder / "off.toml").write_text(STUDY.replace("first.csv", "off.csv"))
    return folder


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Said:
    def of(*words: str | Path) -> tuple[int, str, str]:
        code = fmuid_(*words)
        return code, *capsys.readouterr()

    return of


def test_identify_prints_verdict_table_and_five_lines(folder: Path, said: Said) -> None:
    words = ("identify", folder / "study.toml", "--no-isolation", "-o", folder / "found")
    code, out, error = said(*words)
    first, _, heads, _, *rest = out.splitlines()
    assert (code, error) == (DONE, "")
    assert first.split(maxsplit=1)[0] == "PASSED"
    assert heads.split()[:4] == ["parameter", "estimate", "relative", "σ"]
    lines = rest[rest.index("") + 1 :]
    assert [line[:13].strip() for line in lines] == ["Fit", "Residuals", "Solver", "Could hide", "Report"]
    assert lines[-1].endswith("found/report.html")
    code, out, error = said(*words, "--verbose")
    assert code == DONE
    assert "iteration 0 " in error
    for words_ in ("Tests: whiteness", "Solver check: ", "Jacobian: ", "log-likelihood", "Written to", "estimates.csv"):
        assert words_ in out


def test_quiet_json_and_strict(folder: Path, said: Said) -> None:
    words = ("identify", folder / "off.toml", "--no-isolation", "--no-report", "-o", folder / "doubtful")
    assert said(*words, "--quiet", "--strict") == (NOT_SUCCEEDED, "", "")
    code, out, _ = said(*words, "--json")
    document = json.loads(out)["documents"]["identification"]
    assert code == DONE
    assert document["state"] == "DOUBTFUL"
    assert any("remedy" in each for each in document["remarks"])
    assert all("charts" not in each for each in document["sections"])
    code, out, _ = said("info", FMUS / "Coil/Coil.fmu", "--json")
    assert (code, list(json.loads(out))) == (DONE, ["schema", "documents", "arrays"])
    code, out, _ = said(*words)
    assert code == DONE
    assert out.startswith("DOUBTFUL")
    assert sum(line.startswith("→ ") for line in out.splitlines()) == 1


def test_all_commands_with_documents_have_the_options() -> None:
    shown = {
        getattr(each.callback, "__name__", "")
        for each in app.registered_commands
        if hasattr(each.callback, "__signature__")
    }
    analyses = {"baseline", "simulate", "identify", "diagnose", "monitor", "design", "batch"}
    assert shown == analyses | {"predict", "compare", "info", "validate"}


class Told(Message):
    """Messages of these tests."""

    BAD = ("{name} is wrong.", "", "Change {name}.", "bad")
    DOUBT = ("{name} is weak.", "", "Strengthen {name}.", "doubt")


def made(**changes: Any) -> Document:
    table = (Column("parameter", ("a",)), Column("value", ("1",), True, 1))
    remarks = (Told.DOUBT.said(name="y"), Told.BAD.said(name="x"), Remark("Plain."))
    shown = {"remarks": remarks, "sections": (Section("t", "", table=table),), "summary": (("Fit", "y 90 %"),)}
    return Document("identification", "Identification", "DOUBTFUL", "doubt", reason="x", **(shown | changes))


def test_most_severe_remedy_alone_and_nothing_twice(capsys: pytest.CaptureFixture[str]) -> None:
    console.show(made())
    out = capsys.readouterr().out
    assert out.index("parameter") < out.index("Fit          y 90 %") < out.index("→ Change x.")
    assert "Strengthen" not in out
    console.show(made(remedy="Look."))
    assert capsys.readouterr().out.splitlines()[-1] == "→ Look."
    console.show(made(summary=(("Fit", "y 90 %"), ("Doubts", "z"))), before=made())
    assert capsys.readouterr().out.split() == ["Doubts", "z"]


def test_columns_and_no_color(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    assert console.console().width == 40
    monkeypatch.delenv("COLUMNS")
    assert console.console().width == console.PLAIN_WIDTH
    monkeypatch.setenv("NO_COLOR", "1")
    assert console.console().no_color


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["completion", shell]) == DONE
    script = capsys.readouterr().out
    assert COMPLETION in script
    assert "fmuid" in script


@pytest.mark.parametrize(("line", "found"), [("fmuid ide", "identify"), ("fmuid identify --ver", "--verbose")])
def test_completions(line: str, found: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {COMPLETION: "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    done = subprocess.run([sys.executable, "-m", "fmuid"], capture_output=True, text=True, check=False)
    assert done.stdout.split() == [found]


def test_what_could_hide_stands_beside_passed_under_colored_noise(folder: Path, said: Said) -> None:
    coil_table(folder / "colored.csv", 0.0, seed=3, noise=0.0)
    table = pd.read_csv(folder / "colored.csv")
    table["i"] += lfilter([1.0], [1.0, -0.6], 0.005 * np.random.default_rng(3).standard_normal(len(table)))
    table.to_csv(folder / "colored.csv", index=False)
    (folder / "colored.toml").write_text(STUDY.replace("first.csv", "colored.csv"))
    _, out, _ = said("identify", folder / "colored.toml", "--no-isolation", "--no-report", "-o", folder / "colored")
    labels = [line[:13].strip() for line in out.splitlines()]
    assert labels[0] == "PASSED"
    assert {"Intervals", "Could hide"} < set(labels)
