"""Whatever a user gives wrongly ends in one clear sentence on stderr that names it, and exit code 2."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fmuid.apps.cli.app import run
from fmuid.apps.cli.options import WRONG_INPUT
from tests.support.bad_input import SOUND, refused, rezip

# --- variables --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("R = {", "Rs = {", ("'Rs'", "'R'")),
        ("R = {", "i_strat = {", ("'i_strat'", "did you mean 'i_start'")),
        ('inputs = ["u"]', 'inputs = { v = "u" }', ("'v'",)),
        ('outputs = ["i"]', 'outputs = { i_start1 = "i" }', ("'i_start1'", "'i_start'")),
        ('[[experiments]]', '[model.fixed]\nLL = 0.1\n[[experiments]]', ("'LL'", "'L'")),
        ('inputs = ["u"]', 'inputs = { u = "u", i = "i" }', ("'i'", "output")),
        ('outputs = ["i"]', 'outputs = { R = "i" }', ("'R'", "'parameter'")),
        ('inputs = ["u"]', 'inputs = { R = "u" }', ("'R'", "not as input", "'parameter'")),
        ("R = { start = 3.0, min = 0.0, max = 10.0 }", "u = { start = 1.0 }", ("'u'", "input")),
        ("R = { start = 3.0, min = 0.0, max = 10.0 }", "i = { start = 1.0 }", ("'i'", "cannot be set")),
        ('[[experiments]]', '[model.fixed]\nR = 4.0\n[[experiments]]', ("'R'", "parameter and fixed")),
        ('[[experiments]]', '[model.fixed]\nL = "big"\n[[experiments]]', ("'L'", "big")),
        ('[[experiments]]', '[model.fixed]\nL = 1' + "0" * 400 + '\n[[experiments]]', ("'L'", "finite number")),
        ('[[experiments]]', '[model.fixed]\nL = inf\n[[experiments]]', ("'L'", "finite number")),
        ('outputs = ["i"]', 'outputs = ["i"]\nunits = { i = "parsec" }', ("'parsec'", "'i'")),
    ],
)  # fmt: skip
def test_wrong_variable(
    coil_folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, named: tuple[str, ...]
) -> None:
    assert old in SOUND
    (coil_folder / "study.toml").write_text(SOUND.replace(old, new))
    sentence = refused(capsys, "identify", coil_folder / "study.toml")
    assert all(word in sentence for word in named)


@pytest.mark.parametrize("variability", ["constant", "fixed"])
def test_fixed_parameter_set(coil_folder: Path, capsys: pytest.CaptureFixture[str], variability: str) -> None:
    """A calculated parameter and a constant cannot be set from outside."""

    def fix(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"].decode()
        found = re.search(r'<ScalarVariable[^>]*name="R".*?</ScalarVariable>', text, re.DOTALL)
        assert found
        exact = variability == "constant"
        causality, initial = ("local", "exact") if exact else ("calculatedParameter", "calculated")
        kind = f'causality="{causality}" variability="{variability}" initial="{initial}"'
        new = f'<ScalarVariable name="R" valueReference="0" {kind}>'
        value = ' start="4"' if exact else ""
        files["modelDescription.xml"] = text.replace(
            found[0], f'{new}<Real unit="Ohm"{value}/></ScalarVariable>'
        ).encode()

    rezip(coil_folder / "Coil.fmu", fix)
    sentence = refused(capsys, "identify", coil_folder / "study.toml")
    assert "'R'" in sentence
    assert "cannot be set" in sentence


# --- the study --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("[parameters]", "[paramaters]", ("study.toml", "'paramaters'", "'parameters'")),
        ("inputs =", "imputs =", ("[experiments][0]", "'imputs'", "'inputs'")),
        ("R = {", "R = { strt = 1,", ("[parameters.R]", "'strt'", "'start'")),
        ("start = 3.0", "start = 30.0", ("[parameters.R]", "start 30 lies outside its bounds")),
        ("R = { start = 3.0, min = 0.0, max = 10.0 }", "", ("no parameters", "[parameters]")),
        ('outputs = ["i"]', "outputs = []", ("[experiments][0]", "no outputs")),
        ('outputs = ["i"]', "", ("[experiments][0]", "'outputs'")),
        ('"run.csv"', '"other.csv"', ("other.csv", "no file")),
        ('"Coil.fmu"', '"other.fmu"', ("other.fmu", "no file")),
        ('"run.csv"', '"Coil.fmu"', ("Coil.fmu", ".csv")),
        ('variance = "estimate"', "variance = 0", ("[noise]", "variance")),
        ('variance = "estimate"', "variance = { j = 1.0 }", ("noise.variance", "'j'")),
        ('inputs = ["u"]', 'inputs = ["u"]\nwarmup = 5.0', ("warmup", "run.csv")),
        ('inputs = ["u"]', 'inputs = ["u"]\ninterpolation = { i = "zoh" }', ("interpolation", "'i'")),
        ('inputs = ["u"]', 'inputs = ["w"]', ("'w'", "run.csv")),
        ('"levenberg-marquardt"', '"linear"', ("[estimation]", "linear")),
        ("fmu =", "fmu ==", ("study.toml", "line 3")),
    ],
)  # fmt: skip
def test_wrong_study(
    coil_folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, named: tuple[str, ...]
) -> None:
    assert old in SOUND
    (coil_folder / "study.toml").write_text(SOUND.replace(old, new))
    sentence = refused(capsys, "identify", coil_folder / "study.toml")
    assert all(word in sentence for word in named)


def test_missing_study(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "stduy.toml" in refused(capsys, "identify", coil_folder / "stduy.toml")
    assert "study.toml" in refused(capsys, "simulate", coil_folder / "stduy.toml")


def test_missing_fmu(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "Koil.fmu" in refused(capsys, "info", coil_folder / "Koil.fmu")
    assert "is" in refused(capsys, "info", coil_folder)


# --- the table --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ("run.csv", "empty")),
        ("time,u,i\n", ("run.csv",)),
        ("time,u,i\n0,1,0\n0.1,on,0\n0.2,1,0\n", ("run.csv", "'u'", "on", "row 2")),
        ("time,u,i\n0,1,0\nsoon,1,0\n0.2,1,0\n", ("run.csv", "'time'", "soon")),
        ("time,u,i\n0,1,0\n0.2,1,0\n0.1,1,0\n", ("run.csv", "'time'", "row 3")),
        ("time,u,i\n0,1,0\n0.1,,0\n0.2,1,0\n", ("run.csv", "'u'", "row 2")),
        ("time,u,i\n0,1,0\n0.1,inf,0\n0.2,1,0\n", ("run.csv", "'u'", "row 2")),
        ("time,u,i\n0,1,\n0.1,1,\n0.2,1,\n", ("run.csv", "'i'", "no sample")),
        ("clock,u,i\n0,1,0\n0.1,1,0\n", ("run.csv", "'time'")),
        ("time,u\n0,1\n0.1,1\n", ("run.csv", "'i'")),
        ("time;u;i\n0;1,2,3;0\n1;1;0\n", ("run.csv", "'u'", "row 1")),
    ],
)  # fmt: skip
def test_wrong_table(coil_folder: Path, capsys: pytest.CaptureFixture[str], text: str, named: tuple[str, ...]) -> None:
    (coil_folder / "run.csv").write_text(text)
    sentence = refused(capsys, "identify", coil_folder / "study.toml")
    assert all(word in sentence for word in named)


# --- the command line -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("identify",), "STUDY"),
        (("identfy", "study.toml"), "'identify'"),
        (("identify", "study.toml", "--ouptut", "x"), "--output"),
        (("identify", "study.toml", "--set"), "--set"),
        (("info", "a.fmu", "b.fmu"), "b.fmu"),
        (("--no-such",), "--no-such"),
    ],
)
def test_wrong_usage(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], named: str) -> None:
    sentence = refused(capsys, *arguments)
    assert named in sentence
    assert "--help" in sentence


def test_wrong_override(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = coil_folder / "study.toml"
    assert "'L'" in refused(capsys, "identify", study, "--set", "parameters.L.start=9")
    assert "path=value" in refused(capsys, "identify", study, "--set", "parameters.R.start")


def test_output_that_cannot_be_written(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (coil_folder / "results").write_text("a file where the coil_folder should be")
    assert run(["identify", str(coil_folder / "study.toml")]) == WRONG_INPUT
    assert "results" in capsys.readouterr().err


def test_init_overwrites_nothing(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = coil_folder / "study.toml"
    sentence = refused(capsys, "init", coil_folder / "Coil.fmu", coil_folder / "run.csv", "--output", study)
    assert "study.toml is there already" in sentence
    assert study.read_text() == SOUND


def test_no_earlier_result_to_resume(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "result.json" in refused(capsys, "identify", coil_folder / "study.toml", "--resume")
