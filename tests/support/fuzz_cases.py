"""Cases of the fuzz tests, and what must hold of every command whatever it is given."""

import contextlib
import faulthandler
import io
import json
import re
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import pytest

from fmuid import FmuidError, Study
from fmuid.apps.cli.app import run
from fmuid.runs import CaseList
from fmuid.runs.batch.case import VOLATILE, CaseRunner
from tests.support import fuzz_inputs as good
from tests.support import fuzz_spoil as spoil

HANG = 600.0
"""What takes longer than this, s, hangs: each case takes some hundredths of a second."""


@dataclass(frozen=True)
class Ending:
    """How a command ended."""

    code: int
    out: str
    err: str


def ending(place: Path, *arguments: str | Path) -> Ending:
    """Run a command and check what must hold whatever it was given.

    It ends in time, by itself, with one of the exit codes, and where it refuses with one sentence; it warns of nothing,
    and below `place` it changes files in the folder ``out`` only.
    """
    out, err = io.StringIO(), io.StringIO()
    with watched(place), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run([str(argument) for argument in arguments])
    found = Ending(code, out.getvalue(), err.getvalue())
    assert code in (0, 1, 2), found
    assert "Traceback" not in found.err, found
    refusals = [line for line in found.err.splitlines() if line.startswith("error: ")]
    assert len(refusals) <= 1, found
    if code == 2:
        assert found.err.endswith(refusals[0] + "\n"), found
        check_sentence(refusals[0].removeprefix("error: "))
    return found


def check_sentence(text: str) -> None:
    """Check that a text may be one for a user."""
    assert len(text) > 8, text
    assert not re.search(r"<class|object at 0x|Error\(|Exception|Traceback", text), text


@contextlib.contextmanager
def watched(place: Path) -> Iterator[None]:
    """Check that something ends in time, warns of nothing and leaves files alone, but for those below ``out``."""
    before = tree(place)
    faulthandler.dump_traceback_later(HANG, exit=True)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        yield
    faulthandler.cancel_dump_traceback_later()
    assert not said, [str(warning) for warning in said]
    assert tree(place) == before


def tree(place: Path) -> dict[str, bytes]:
    """Return all files below a folder with their content, but not those below its folder ``out``."""
    return {
        path.relative_to(place).as_posix(): path.read_bytes() if path.is_file() else b""
        for path in sorted(place.rglob("*"))
        if path.relative_to(place).parts[0] != "out"
    }


def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run FMUs in this process, and make figures but write none, which takes longer than all the rest.

    Their names must be those of files.
    """

    def save(figures: dict[str, Any], folder: Path, kind: str = "png") -> list[Path]:
        for name in figures:
            assert Path(f"{name}.{kind}").name == f"{name}.{kind}", name
            assert "\0" not in name
            assert len(name) < 250
        return [folder / f"{name}.{kind}" for name in figures]

    monkeypatch.setattr("fmuid.reports.render.matplotlib_renderer.save", save)
    monkeypatch.setattr("fmuid.reports.render.html.embedded", lambda figures: ({}, [], [""] * len(figures)))
    read = Study.read
    monkeypatch.setattr(Study, "read", lambda path, overrides=(), **_: read(path, overrides))


# --- cases ------------------------------------------------------------------------------

Case = Callable[[Random, Path], None]
"""What spoils some of the good input in the folder ``in`` of a place and runs commands on it."""


def study(rng: Random, place: Path) -> None:
    """Spoil a study; where that may make a right answer take long, nothing is simulated."""
    path = place / "in" / "study.toml"
    given = rng.choice([*good.STUDIES, *good.BATCHES])
    data = spoil.spoil_tree(rng, given)
    raw = spoil.toml_file(data)
    if rng.random() < 0.2:
        raw = spoil.spoil_bytes(rng, raw)
    path.write_bytes(raw)
    command = "simulate" if rng.random() < 0.6 else "identify"
    if good.may_take_long(given, raw):
        (place / "in" / "Coil.fmu").write_bytes(b"no archive")
    ending(place, command, path, "--output", place / "out")


def override(rng: Random, place: Path) -> None:
    """Override a value of a study by something odd."""
    given = rng.choice([*good.STUDIES, *good.BATCHES])
    (place / "in" / "study.toml").write_bytes(spoil.toml_file(given))
    path = [str(step) for step in rng.choice(list(spoil.places(given)))]
    if rng.random() < 0.3:
        path[rng.randrange(len(path))] = rng.choice(spoil.WORDS)
    value = rng.choice([*spoil.WORDS, spoil.toml_text(spoil.nasty(rng)), "[" * 5000])
    setting = ".".join(path) + rng.choice(["=", "=", "=", " = ", ""]) + value
    if good.TOO_LONG.search(setting):
        (place / "in" / "Coil.fmu").write_bytes(b"no archive")
    ending(place, "simulate", place / "in" / "study.toml", "--output", place / "out", "--set", setting)


def nested(rng: Random, place: Path) -> None:
    """Nest lists or tables deeper than readers can follow, or write numbers of more digits than they take."""
    depth = rng.choice([10, 500, 5000, 100_000])
    text = rng.choice(["a = " + "[" * depth + "]" * depth, "[" + ".".join("a" * depth) + "]", "a = " + "{a=" * depth])
    text = rng.choice([text, "a = " + "9" * depth, "a." * depth + "a = 1", "# " + "x" * depth])
    (place / "in" / "study.toml").write_text(text)
    (place / "in" / "result.json").write_text("[" * depth + rng.choice(["]" * depth, "9" * depth]))
    ending(place, "simulate", place / "in" / "study.toml", "--output", place / "out")
    ending(place, "apply", place / "in" / "result.json", place / "in" / "Coil.fmu", "--output", place / "out" / "x.fmu")


def table(rng: Random, place: Path) -> None:
    """Spoil a table."""
    path = good.spoil_table(rng, place / "in")
    data = {**good.STUDIES[0], "experiments": [{"data": path.name, "inputs": ["u"], "outputs": ["i"]}]}
    data["experiments"][0]["interpolation"] = rng.choice(["linear", "zoh", "pchip"])
    (place / "in" / "study.toml").write_bytes(spoil.toml_file(data))
    way = rng.randrange(3)
    if way == 0:
        ending(place, "init", place / "in" / "Coil.fmu", path, "--output", place / "out" / "drafted.toml")
    else:
        command = "simulate" if way == 1 else "identify"
        ending(place, command, place / "in" / "study.toml", "--output", place / "out")


def fmu(rng: Random, place: Path) -> None:
    """Spoil an FMU, in its description or as an archive."""
    path = good.spoil_fmu(rng, place / "in" / "Coil.fmu")
    described = ending(place, "info", path)
    (place / "out").mkdir(exist_ok=True)
    way = rng.randrange(3)
    if way == 0:
        ending(place, "init", path, place / "in" / "run.csv", "--output", place / "out" / "study.toml")
    elif way == 1:
        source = place / "in" / "result.json"
        if rng.random() < 0.5:
            source = place / "in" / "values.ssv"
            source.write_text(good.good_ssv())
        ending(place, "apply", source, path, "--output", place / "out" / "x.fmu")
    else:
        simulated = ending(place, "simulate", place / "in" / "study.toml", "--output", place / "out")
        assert simulated.code == 2  # there is no binary
    if described.code == 0 and (place / "out" / "x.fmu").exists():
        assert ending(place, "info", place / "out" / "x.fmu").code == 0


def result(rng: Random, place: Path) -> None:
    """Spoil an earlier result, or a file of parameter values."""
    path = place / "in" / "result.json"
    if rng.random() < 0.3:
        path = place / "in" / "values.ssv"
        path.write_bytes(spoil.spoil_xml(rng, good.good_ssv()))
    else:
        data = spoil.spoil_tree(rng, json.loads(path.read_text()))
        raw = json.dumps(data, default=str).encode()
        path.write_bytes(spoil.spoil_bytes(rng, raw) if rng.random() < 0.3 else raw)
    if path.suffix == ".json" and rng.random() < 0.5:
        (place / "in" / "study.toml").write_bytes(spoil.toml_file(good.WITH_RESULT))
        ending(place, "simulate", place / "in" / "study.toml", "--output", place / "out")
    else:
        ending(place, "apply", path, place / "in" / "Coil.fmu", "--output", place / "out" / "x.fmu")


def package(rng: Random, place: Path) -> None:
    """Spoil a system structure; its FMUs are whole."""
    text, path = good.good_ssd(place / "in")
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    files["SystemStructure.ssd"] = spoil.spoil_xml(rng, text)
    path.write_bytes(spoil.packed(files))
    data = {
        "model": {"fmu": path.name},
        "experiments": [{"data": "run.csv", "inputs": {"qg": "u"}, "outputs": {"drive.q": "i"}}],
        "parameters": {"drive.M": {"start": 90.0}},
    }
    (place / "in" / "study.toml").write_bytes(spoil.toml_file(data))
    ending(place, "simulate", place / "in" / "study.toml", "--output", place / "out")


def batch(rng: Random, place: Path) -> None:
    """Spoil a study of many cases, and run some of them."""
    path = place / "in" / "study.toml"
    given = rng.choice(good.BATCHES)
    path.write_bytes(spoil.toml_file(spoil.spoil_tree(rng, given)))
    if good.may_take_long(given, path.read_bytes()):
        (place / "in" / "Coil.fmu").write_bytes(b"no archive")
    with watched(place):
        try:
            read = Study.read(path)
            cases, runner = CaseList.of(read), CaseRunner(read)
            rows = [runner(rng.randrange(len(cases))).row for _ in range(3)]
        except FmuidError as error:
            check_sentence(str(error))
            return
    for row in rows:
        assert set(row) | set(VOLATILE) == {*runner.columns, *VOLATILE}
        assert row["status"] in ("converged", "not converged", "failed")
        check_sentence(str(row["message"]))


CASES: dict[str, Case] = {each.__name__: each for each in (study, override, nested, table, fmu, result, package, batch)}


@contextlib.contextmanager
def prepared(result_text: str) -> Iterator[Path]:
    """Give a place with good input, which is removed afterwards."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "in").mkdir()
        good.write_inputs(place / "in", result_text)
        yield place


def first_result(folder: Path) -> str:
    """Return the result of the first study."""
    good.write_inputs(folder, "")
    assert run(["identify", str(folder / "study.toml")]) == 0
    return (folder / "results" / "result.json").read_text()
