"""Python, commands and output on the pages of docs; the page of messages."""

import re
import shlex
import shutil
import tomllib
from pathlib import Path

import pytest

import fmuid
from fmuid.apps.cli.app import run
from fmuid.studies.schema import schema
from tests.support.docs_rows import blocks
from tests.support.paths import ROOT
from tools import messages_page
from tools.commands_page import page as commands_page

DOCS = ROOT / "docs"


@pytest.mark.parametrize(
    "page",
    [
        "coupled.md",
        "faults.md",
        "how-it-works.md",
        "monitoring.md",
        "preprocessing.md",
        "priors.md",
        "tables.md",
    ],
)
def test_python_runs(page: str) -> None:
    found = blocks(page, "python")
    assert found
    for code in found:
        exec(compile(code, page, "exec"), {})


@pytest.mark.slow
def test_the_notebook_runs() -> None:
    """Its figures bring Bokeh along, which takes seconds."""
    names: dict[str, object] = {}
    for code in blocks("notebook.md", r"\{code-cell\} python"):
        exec(compile(code, "notebook.md", "exec"), names)
    result = names["result"]
    assert isinstance(result, fmuid.Result)
    assert result.converged


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_the_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Each line that is shown is printed, in this order; numbers to the digits shown."""
    one = fmuid.datasets.induction_machine()
    shutil.copy(one.fmu, tmp_path / "Motor.fmu")
    shutil.copy(one.path, tmp_path / "bench.csv")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    first, *shown = blocks("tutorial.md", "console")
    assert first.startswith("$ python -c ")
    for block in shown:
        command, *lines = block.splitlines()
        program, word, *rest = shlex.split(command.removeprefix("$ "))
        assert program == "fmuid"
        run([word, *rest, *(["--no-isolation"] if word in ("identify", "predict") else [])])
        captured = capsys.readouterr()
        printed = iter(" ".join(line.split()) for line in captured.out.splitlines())
        for line in lines:
            if line != "...":
                assert " ".join(line.split()) in printed, (command, line, captured)


@pytest.mark.parametrize(("page", "table"), [("machine-tests.md", "tests.csv"), ("spectra.md", "spectrum.csv")])
@pytest.mark.usefixtures("blank_figures")
def test_a_tutorial_without_a_time_runs(
    page: str, table: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In an empty folder; lines that are shown are printed, in this order."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    first, shown = blocks(page, "console")
    exec(shlex.split(first)[3], {})
    for name, kind in ((table, "text"), ("study.toml", "toml")):
        (tmp_path / name).write_text(blocks(page, kind)[0], encoding="utf-8")
    command, *lines = shown.splitlines()
    run([*shlex.split(command)[2:], "--no-isolation"])
    printed = iter(" ".join(line.split()) for line in capsys.readouterr().out.splitlines())
    for line in (each for each in lines if each != "..."):
        assert " ".join(line.split()) in printed, line


def test_study_keys_are_keys() -> None:
    """Sections that are shown without others may lack keys; the schema has no arrays, as on docs/parameters.md."""
    from jsonschema import Draft202012Validator

    check = Draft202012Validator(schema())
    for page in sorted(DOCS.glob("*.md")):
        for text in blocks(page.name, "toml") if page.name not in ("parameters.md", "tutorial.md") else ():
            study = tomllib.loads(text)
            if isinstance(study.get("experiments"), dict):  # [experiments.preprocess] alone
                study["experiments"] = [study["experiments"]]
            errors = [each.message for each in check.iter_errors(study) if each.validator != "required"]
            assert errors == [], page.name


def test_the_commands_are_those_that_there_are() -> None:
    """Written anew by: python -m tools.commands_page > docs/commands.md."""
    assert (DOCS / "commands.md").read_text(encoding="utf-8") == commands_page()


def test_every_public_name_has_its_page() -> None:
    listed = re.findall(r"^ +fmuid\.(\w+)$", (DOCS / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    public = re.findall(r"import \w+ as (\w+)", (ROOT / "fmuid" / "__init__.pyi").read_text(encoding="utf-8"))
    packages = {"data", "datasets", "diagnosis", "estimation", "identification", "runs", "signals"}
    assert sorted(listed) == sorted(set(public) - {"__version__", *packages})
    assert len(public) <= 45 + len(packages - {"datasets", "signals"})


def test_the_messages_are_those_that_there_are() -> None:
    """Written anew by: python -m tools.messages_page."""
    assert (DOCS / "messages.md").read_text(encoding="utf-8") == messages_page.page()


def test_every_explained_kind_of_message_has_its_place() -> None:
    kinds = {kind.__name__ for kind in messages_page.kinds() if messages_page.listed(kind)}
    places = [each[1] for each in messages_page.MARKED.finditer((DOCS / "messages.md").read_text(encoding="utf-8"))]
    assert sorted(places) == sorted(kinds)
