"""Wrong input, also of newcomers to `fmuid init`, ends in one sentence that names it, and exit code 2."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.apps.cli.app import run
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from tests.support.bad_input import COIL, SOUND, refused, rezip, table
from tests.support.coil_study import fmuid_

Refused = Callable[..., str]
HUGE = "1" + "0" * 400


@pytest.fixture
def refuse(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Return the sentence by which a command refuses; paths are those of the coil's folder."""

    def said(*words: str) -> str:
        named = re.compile(r"[\w-]+\.(toml|fmu|csv|json|ssv)")
        return refused(capsys, *(coil_folder / word if named.fullmatch(word) else word for word in words))

    return said


# --- studies and data ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "old", "new", "named"),
    [
        ("study.toml", "R = {", "Rs = {", "'Rs'.*'R'"),
        ("study.toml", 'inputs = ["u"]', 'inputs = { v = "u" }', "'?v'?"),
        ("study.toml", 'outputs = ["i"]', 'outputs = { R = "i" }', "R.*parameter"),
        ("study.toml", 'inputs = ["u"]', 'inputs = { R = "u" }', "'R' as 'parameter', not as input"),
        ("study.toml", "R = { start = 3.0, min = 0.0, max = 10.0 }", "i = { start = 1.0 }", "'i' cannot be set"),
        ("study.toml", "[[experiments]]", "[model.fixed]\nR = 4.0\n[[experiments]]", "R.*fixed"),
        ("study.toml", "[[experiments]]", "[model.fixed]\nL = inf\n[[experiments]]", "L.*finite number"),
        ("study.toml", 'outputs = ["i"]', 'outputs = ["i"]\nunits = { i = "parsec" }', "parsec"),
        ("study.toml", "start = 3.0", f"start = {HUGE}", "parameters.R.start: must be a number"),
        ("study.toml", '"run.csv"', '"Coil.fmu"', "Coil.fmu"),
        ("study.toml", "run.csv", r"r\u0000", "not found"),
        ("study.toml", "Coil.fmu", "C" * 300, "not found"),
        ("study.toml", 'variance = "estimate"', "variance = { j = 1.0 }", "variance.*j"),
        ("study.toml", 'inputs = ["u"]', 'inputs = ["u"]\nwarmup = 5.0', "run.csv: warmup"),
        ("run.csv", "0.001,1.0,", "0.001,inf,", "run.csv: .*'u' is inf in row 2"),
        ("run.csv", "0.001,1.0,", "0.001,on,", "run.csv: .*u.*on.*row 2"),
    ],
)
def test_wrong_study_and_data(coil_folder: Path, refuse: Refused, file: str, old: str, new: str, named: str) -> None:
    text = (coil_folder / file).read_text()
    assert old in text
    (coil_folder / file).write_text(text.replace(old, new))
    assert re.search(named, refuse("identify", "study.toml"))


def test_columns_of_lists_and_slopes_that_overflow(coil_folder: Path, refuse: Refused) -> None:
    frame = pd.DataFrame({"time": [0.0, 1.0], "u": [[1.0, 2.0], [3.0]], "i": [0.0, 0.0]})
    frame.to_parquet(coil_folder / "run.parquet")
    (coil_folder / "study.toml").write_text(SOUND.replace("run.csv", "run.parquet"))
    assert "column 'u': 'list<element: double>'" in refuse("simulate", "study.toml")
    table(coil_folder, pd.DataFrame({"time": [0.0, 1e-10, 1.0, 2.0], "u": [0.0, 1e300, 0.0, -1e300], "i": 0.0}))
    (coil_folder / "study.toml").write_text(SOUND.replace('["i"]', '["i"]\ninterpolation = "pchip"'))
    assert "changes too fast" in refuse("simulate", "study.toml")


def test_numbers_that_overflow_warn_of_nothing(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The RMSE overflows; warnings are errors."""
    table(coil_folder, pd.DataFrame({"time": [0.0, 1e-3, 2e-3], "u": 1.0, "i": [0.0, 1e300, -1e300]}))
    assert run(["simulate", str(coil_folder / "study.toml"), "--no-isolation"]) == DONE
    assert "inf A" in capsys.readouterr().out


# --- FMUs ---------------------------------------------------------------------------------


def described(old: str, new: str) -> Callable[[dict[str, bytes]], None]:
    """Return a change of the model description."""

    def change(files: dict[str, bytes]) -> None:
        text = files["modelDescription.xml"].decode()
        assert re.search(old, text, re.DOTALL)
        files["modelDescription.xml"] = re.sub(old, new, text, count=1, flags=re.DOTALL).encode()

    return change


def replaced(content: bytes) -> Callable[[dict[str, bytes]], None]:
    return lambda files: files.update({"modelDescription.xml": content})


def stripped(files: dict[str, bytes]) -> None:
    for name in [name for name in files if name.startswith(f"binaries/{fmpy.platform}/")]:
        del files[name]


def inside(files: dict[str, bytes]) -> None:
    """Put all files into a folder of the archive, as some tools for archives do."""
    moved = {f"Coil/{name}": content for name, content in files.items()}
    files.clear()
    files.update(moved)


FMI1 = b'<?xml version="1.0"?><fmiModelDescription fmiVersion="1.0" modelName="C" modelIdentifier="C" guid="x"/>'
SECOND_R = '<ScalarVariable name="R" valueReference="99"><Real/></ScalarVariable></ModelVariables>'
R = '<ScalarVariable[^>]*name="R".*?</ScalarVariable>'
FIXED_R = '<ScalarVariable name="R" valueReference="0" causality="{}" variability="{}" initial="{}"><Real{}/>'
FIXED_R += "</ScalarVariable>"


@pytest.mark.parametrize(
    ("command", "change", "said"),
    [
        ("info", lambda files: files.pop("modelDescription.xml"), "modelDescription.xml"),
        *(("info", replaced(each), "modelDescription.xml") for each in (b"<fmi", b"", b"\xff\xfe")),
        ("identify", replaced(b'<fmiModelDescription fmiVersion="2.0"/>'), "modelDescription.xml"),
        ("info", inside, "not an FMU: no modelDescription.xml at its top level"),
        ("info", replaced(FMI1), "FMI 1.0"),
        ("identify", stripped, f"no binary for this platform \\({fmpy.platform}\\)"),
        ("validate", described("</ModelVariables>", SECOND_R), "'R' is declared twice"),
        ("info", described("<Unit name=", "<Unit named="), "Unit without a name"),
        ("info", described(" guid=", " named="), "no guid"),
        ("identify", described(R, FIXED_R.format("local", "constant", "exact", ' start="4"')), "'R' cannot be set"),
        (
            "identify",
            described(R, FIXED_R.format("calculatedParameter", "fixed", "calculated", "")),
            "'R' cannot be set",
        ),
        *(
            ("identify", lambda files, name=name: files.update({name: b"x"}), "escaped.txt.*outside")
            for name in ("../escaped.txt", "/tmp/escaped.txt", "..\\escaped.txt")
        ),
    ],
)
def test_wrong_fmu(coil_folder: Path, refuse: Refused, command: str, change: Any, said: str) -> None:
    rezip(coil_folder / "Coil.fmu", change)
    assert re.search(said, refuse(command, "study.toml" if command == "identify" else "Coil.fmu"))
    assert not Path("/tmp/escaped.txt").exists()


@pytest.mark.parametrize(("kept", "zeroed", "said"), [(9, 0, "zip"), (0.5, 0, "zip"), (1, 200, "Coil.fmu")])
def test_damaged_archives(coil_folder: Path, refuse: Refused, kept: float, zeroed: int, said: str) -> None:
    """Cut to a few bytes or to half; a directory that points to nothing."""
    content = bytearray(COIL.read_bytes())
    if zeroed:
        content[zeroed : len(content) // 2] = bytes(len(content) // 2 - zeroed)
    (coil_folder / "Coil.fmu").write_bytes(content[: int(kept if kept > 1 else kept * len(content))])
    assert said in refuse("identify", "study.toml")


# --- results and values -------------------------------------------------------------------

RESULT = """{"schema": "fmuid/result/2", "outcome": "converged", "converged": true,
"parameters": {"R": {"value": 4.0, "std": 0.1, "start": 3.0, "lower": "-inf", "upper": "inf"}},
"covariance": {"names": ["R"], "matrix": [[0.01]], "white_noise": [[0.01]]}, "fit": {"noise_variance": {"i": 1e-6},
"given_variance": {}, "cost": 1.0, "log_likelihood": null, "degrees_of_freedom": "inf"}, "identifiability": {},
"history": {"iterations": 1, "simulations": 2, "elapsed_s": 0.1}, "setup": {"version": "0"}}"""
VALUES = """<ParameterSet version="1.0" name="values"><Parameters><Parameter name="R"><Real value="4.5"/></Parameter>
</Parameters><Units><Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit></Units></ParameterSet>"""


@pytest.mark.parametrize(
    ("sound", "old", "new", "said"),
    [
        *((RESULT, "4.0", new, "dentify again") for new in ("[4.0]", '{"a": 1}', HUGE, "[" * 100_000)),
        (RESULT, '"iterations": 1', '"iterations": 1e999', "dentify again"),
        (RESULT, "0.01", "-0.01", "dentify again"),
        (RESULT, '"outcome": "converged"', '"outcome": "fine"', "dentify again"),
        (VALUES, 'm="1"', 'm="INF"', "m of BaseUnit must be a finite number"),
        (VALUES, 'factor="0.001"', 'factor="0"', "factor 0"),
        (VALUES, 'value="4.5"', 'value="INF"', "value of Real must be a finite number"),
    ],
)
def test_damaged_values(
    coil_folder: Path, refuse: Refused, capsys: pytest.CaptureFixture[str], sound: str, old: str, new: str, said: str
) -> None:
    name = "values.json" if sound is RESULT else "values.ssv"
    (coil_folder / name).write_text(sound)
    command = ("apply", coil_folder / name, coil_folder / "Coil.fmu", "--output", coil_folder / "new.fmu")
    assert run([str(word) for word in command]) == DONE
    capsys.readouterr()
    (coil_folder / name).write_text(sound.replace(old, new))
    assert said in refuse("apply", name, "Coil.fmu", "--output", "new.fmu")


# --- the command line ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("identify",), "STUDY.*--help"),
        (("identfy", "study.toml"), "'identify'.*--help"),
        (("identify", "study.toml", "--ouptut", "x"), "--output.*--help"),
        (("identify", "study.toml", "--set"), "--set.*--help"),
        (("info", "a.fmu", "b.fmu"), "b.fmu.*--help"),
        (("identify", "stduy.toml"), "stduy.toml.*study.toml"),
        (("info", "Koil.fmu"), "Koil.fmu"),
        (("identify", "study.toml", "--resume"), "result.json"),
        (("init", "Coil.fmu", "run.csv", "--output", "study.toml"), "study.toml: file exists"),
        (("completion", "cmd"), "bash, zsh or fish"),
        (("schema", "batch"), "study or result"),
    ],
)
def test_wrong_usage(coil_folder: Path, refuse: Refused, words: tuple[str, ...], named: str) -> None:
    assert re.search(named, refuse(*words))
    assert (coil_folder / "study.toml").read_text() == SOUND


def test_names_that_no_file_has(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coil, name = coil_folder / "Coil.fmu", "x" * 300 + ".fmu"
    for command in (
        ("info", name),
        ("init", coil, f"{name}.csv", "--output", coil_folder / "new.toml"),
        ("init", coil, coil_folder / "run.csv", "--output", coil_folder / name),
        ("simulate", name),
        ("apply", name, coil, "--output", coil_folder / "new.fmu"),
    ):
        assert name in refused(capsys, *command)


ROWS = "".join(f"{k / 100},{k % 20 // 10},{np.sin(k)}\n" for k in range(50))
TABLES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "empty. Give a header"),
    "a page": ("<html><body>Log in</body></html>\n", "a page in HTML or XML. Save it as"),
    "a PDF": (b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n1 0 obj\n", "not found (columns: %PDF-1.4)"),
    "binary": (bytes(range(1, 256)) * 9, "not text in UTF-8, UTF-16 or cp1252"),
    "times alone": ("time\n0\n1\n2\n", "no column for the input u"),
    "no sample": ("time,u,i\n0,1,nan\n1,1,nan\n", "output column 'i' has no sample"),
    "other letters": (f"первый,напряжение,電流\n{ROWS}", "(columns: первый, напряжение, 電流)"),
}


@pytest.mark.parametrize("table", TABLES)
def test_tables_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str], table: str) -> None:
    content, sentence = TABLES[table]
    path = tmp_path / "bench.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    said = said_of(capsys, COIL, path, "-o", tmp_path / "study.toml")
    assert "bench.csv: " in said
    assert sentence in said


def said_of(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Return what `fmuid init` prints when it does not succeed: one error, or remarks beside what was found."""
    assert fmuid_("init", *arguments) != DONE
    out, error = capsys.readouterr()
    assert "Traceback" not in out + error
    assert error.count("\n") == (1 if error else 0)
    return str(error or out)


def started(tmp_path: Path, capsys: pytest.CaptureFixture[str], frame: pd.DataFrame, *more: str) -> str:
    """Return what `fmuid init` says of a table of the coil."""
    frame.to_csv(tmp_path / "bench.csv", index=False)
    assert fmuid_("init", COIL, tmp_path / "bench.csv", "-o", tmp_path / "study.toml", *more) in (DONE, NOT_SUCCEEDED)
    (tmp_path / "study.toml").unlink()
    return str(capsys.readouterr().out)


def test_channels_that_measured_nothing_or_in_another_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frame = fmuid.datasets.coil().table[["time", "u", "i"]]
    said = started(tmp_path, capsys, frame)
    assert "is constant" not in said and "times as much as measured" not in said
    said = started(tmp_path, capsys, frame.assign(i=0.25))
    assert "bench.csv: output 'i' is constant (0.25)." in said
    said = started(tmp_path, capsys, frame.assign(u=1000 * frame["u"]))
    (ratio,) = re.findall(r"bench.csv: simulated 'i' varies (\S+) times as much as measured", said)
    assert float(ratio) == pytest.approx(1000, rel=0.3)
