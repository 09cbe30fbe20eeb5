"""What `fmuid info` tells of FMUs of both versions: facts read off small model descriptions, and how they are shown."""

import io
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

import fmuid
from fmuid.apps.cli.app import run
from fmuid.apps.cli.options import DONE, WRONG_INPUT
from fmuid.models import FmuSummary, facts, lines
from fmuid.reports.render.console import console, show_listing, show_notes
from fmuid.reports.topics.models import facts_document
from fmuid.reports.topics.solver_check import capability_words, run_words
from fmuid.studies import skeleton
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.paths import FMUS


@pytest.fixture
def motor(tmp_path: Path) -> FmuSummary:
    return facts(fmuid.FMU(write_fmu(tmp_path / "Motor.fmu", FMI2, "binaries/other64/motor.bin")))


@pytest.fixture
def linear(tmp_path: Path) -> FmuSummary:
    return facts(fmuid.FMU(write_fmu(tmp_path / "Linear.fmu", FMI3)))


def test_arrays_and_capabilities(linear: FmuSummary, motor: FmuSummary) -> None:
    assert [v.name for v in (*linear.structural, *linear.fixed)] == ["n", "length", "b[1]", "b[2]"]
    assert [(line.name, len(line.variables)) for line in lines(linear.tunable)] == [("A[1..2,1..3]", 6)]
    assert linear.direct["y[3]"] == ("u[1]", "u[2]")
    words = {kind: capability_words(kind, declared) for kind, declared in linear.capabilities.items()}
    assert words == {
        "co-simulation": [
            "communication steps of one length",
            "event mode",
            "early return on demand",
            "internal steps of 0.01 s",
            "derivatives of outputs to order 2",
        ],
        "model-exchange": ["is told completed steps", "adjoint derivatives"],
        "scheduled-execution": [],
    }
    assert run_words(motor.run_as).startswith("FMI 2.0 Model Exchange, rk45")
    assert motor.here is None


Shown = Callable[..., str]


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Shown:
    """Return what prints the facts of an FMU, for a pipe or a terminal."""

    def show(found: FmuSummary, *, terminal: bool) -> str:
        out, width = io.StringIO(), 80 if terminal else 200
        made = type(console())(file=out, force_terminal=terminal, width=width, color_system=None, highlight=False)
        monkeypatch.setattr("fmuid.reports.render.console.console", lambda: made)
        show_listing(facts_document(found, width if terminal else None), "A study to begin with")
        return out.getvalue()

    return show


def test_shown(motor: FmuSummary, shown: Shown) -> None:
    text = shown(motor, terminal=False)
    for line in (
        r"Motor: two windings",
        r"model-exchange +is told completed steps, directional derivatives",
        r"platforms +other64; none for this machine \(\S+\)",
        r"continuous states +1, 3 event indicators",
        r"Parameters \(3\), fixed.*",
        r"Parameters \(1\), tunable.*",
        r"R +2 +0 +1e\+100 +resistance at 20 degrees",
        r"poles +4 +Integer.*",
        r"Parameters \(2\), calculated: not settable",
        r"on +True +Boolean +in steps",
        r"i +0 +A +none +yes",
        r"w +rad/s +u",
        r"torque +lap +all inputs \(none declared\)",
        r"angle +0.5 +yes",
        r"rad/s +rpm, krad/s",
        r"2 other variables",
    ):
        assert re.search(rf"^{line} *$", text, re.MULTILINE), line


def test_skeleton_is_a_study_with_the_names_of_the_fmu(
    motor: FmuSummary, linear: FmuSummary, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It identifies as soon as a parameter is freed and there is a table."""
    for found, names in (
        (motor, (["u", "on"], ["i", "w", "torque"])),
        (linear, (["u[1]", "u[2]"], [f"y[{i}]" for i in range(1, 6)])),
    ):
        content = tomllib.loads(skeleton(found.fmu))
        (experiment,) = content["experiments"]
        assert (experiment["inputs"], experiment["outputs"]) == names
        assert (content["model"], content["parameters"]) == ({"fmu": f"{found.fmu.name}.fmu"}, {})
    (tmp_path / "Coil.fmu").write_bytes((FMUS / "Coil/Coil.fmu").read_bytes())
    (tmp_path / "data.csv").write_text("time,u,i\n0,1,0\n0.1,1,0.24\n0.2,1,0.25\n", encoding="utf-8")
    assert run(["info", str(tmp_path / "Coil.fmu")]) == DONE
    text = capsys.readouterr().out
    (tmp_path / "study.toml").write_text(text[text.index("[model]") :].replace("# R =", "R ="), encoding="utf-8")
    assert list(fmuid.Study.read(tmp_path / "study.toml").parameters) == ["R"]


def test_every_fmu_of_the_house() -> None:
    for path in sorted(FMUS.glob("*/*.fmu")):
        (experiment,) = tomllib.loads(facts_document(facts(fmuid.FMU(path))).study)["experiments"]
        assert experiment["outputs"], path


# --- what nobody vouches for ------------------------------------------------------------

UNSEEN = re.compile(
    "[\\x00-\\x09\\x0b-\\x1f\\x7f-\\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\U000e0020-\U000e007f]"
)


@pytest.mark.parametrize("terminal", [False, True])
def test_what_is_printed_of_an_fmu_obeys_nobody_and_ends(tmp_path: Path, shown: Shown, terminal: bool) -> None:
    """Names that steer a terminal, turn the direction of writing, begin a line of their own, or do not end."""
    hostile = "&#x202E;R&#x9B;31m&#x2066;&#x200B;&#10;Inputs (9)&#xE0041;"
    text = FMI2.replace('name="R"', f'name="{hostile}{"x" * 100_000}"').replace('modelName="', f'modelName="{hostile}')
    text = text.replace('description="', f'description="{hostile}{"y" * 100_000}')
    found = facts(fmuid.FMU(write_fmu(tmp_path / "Motor.fmu", text)))
    assert "\u202e" in found.fmu.name
    printed = shown(found, terminal=terminal)
    assert UNSEEN.search(printed) is None
    assert not re.search("^Inputs .9.", printed, re.MULTILINE)
    assert "R31m" in printed
    assert max(map(len, printed.splitlines())) < 3000


def test_messages_obey_nobody(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_fmu(tmp_path / "Motor.fmu", FMI2.replace('modelIdentifier="', 'modelIdentifier="/\u202e\u0085'))
    assert run(["info", str(path)]) == WRONG_INPUT
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert UNSEEN.search(said.rstrip("\n")) is None
    show_notes(["a\u202eb\x1b[2J"])
    assert capsys.readouterr().err == "note: ab[2J\n"
