"""FMUs that cannot be read: one sentence each, from the command line."""

from __future__ import annotations

from pathlib import Path

import fmpy
import pytest

from tests.support.bad_input import COIL, refused, rezip

# --- the FMU ----------------------------------------------------------------------------


def test_not_a_zip(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (coil_folder / "Coil.fmu").write_text("no archive")
    for command in (("info", coil_folder / "Coil.fmu"), ("identify", coil_folder / "study.toml")):
        sentence = refused(capsys, *command)
        assert "Coil.fmu" in sentence
        assert "zip" in sentence


def test_truncated_zip(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = COIL.read_bytes()
    (coil_folder / "Coil.fmu").write_bytes(content[: len(content) // 2])
    assert "zip" in refused(capsys, "info", coil_folder / "Coil.fmu")


def test_damaged_zip(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The directory is whole, what it points to is not."""
    content = bytearray(COIL.read_bytes())
    content[200 : len(content) // 2] = bytes(len(content) // 2 - 200)
    (coil_folder / "Coil.fmu").write_bytes(content)
    assert "Coil.fmu" in refused(capsys, "identify", coil_folder / "study.toml")


def test_no_model_description(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rezip(coil_folder / "Coil.fmu", lambda files: files.pop("modelDescription.xml"))
    assert "modelDescription.xml" in refused(capsys, "info", coil_folder / "Coil.fmu")


@pytest.mark.parametrize("content", [b"<fmi", b"", b'<fmiModelDescription fmiVersion="2.0"/>', b"\xff\xfe"])
def test_unreadable_model_description(coil_folder: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    rezip(coil_folder / "Coil.fmu", lambda files: files.update({"modelDescription.xml": content}))
    for command in (("info", coil_folder / "Coil.fmu"), ("identify", coil_folder / "study.toml")):
        assert "modelDescription.xml" in refused(capsys, *command)


def test_no_binary_for_this_platform(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def strip(files: dict[str, bytes]) -> None:
        for name in [name for name in files if name.startswith(f"binaries/{fmpy.platform}/")]:
            del files[name]

    rezip(coil_folder / "Coil.fmu", strip)
    sentence = refused(capsys, "identify", coil_folder / "study.toml")
    assert f"no binary for this platform ({fmpy.platform})" in sentence
    others = {"linux64", "win64", "darwin64"} - {fmpy.platform}
    assert all(platform in sentence for platform in others)


@pytest.mark.parametrize("command", ["info", "validate", "simulate", "identify"])
def test_two_variables_of_one_name(coil_folder: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    """Setting one would set the other."""

    def repeat(files: dict[str, bytes]) -> None:
        more = b'<ScalarVariable name="R" valueReference="99"><Real/></ScalarVariable></ModelVariables>'
        files["modelDescription.xml"] = files["modelDescription.xml"].replace(b"</ModelVariables>", more)

    rezip(coil_folder / "Coil.fmu", repeat)
    name = "study.toml" if command in ("simulate", "identify") else "Coil.fmu"
    sentence = refused(capsys, command, coil_folder / name)
    assert "Coil.fmu: modelDescription.xml: variable 'R' is declared twice" in sentence


def test_fmi_1(coil_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old = (
        b'<?xml version="1.0"?><fmiModelDescription fmiVersion="1.0" modelName="Coil" modelIdentifier="Coil" guid="x"/>'
    )
    rezip(coil_folder / "Coil.fmu", lambda files: files.update({"modelDescription.xml": old}))
    sentence = refused(capsys, "info", coil_folder / "Coil.fmu")
    assert "FMI 1.0" in sentence
    assert "2.0" in sentence


@pytest.mark.parametrize(
    "name", ["../escaped.txt", "/tmp/escaped.txt", "binaries/../../escaped.txt", "..\\escaped.txt"]
)
def test_archive_that_writes_outside(coil_folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    rezip(coil_folder / "Coil.fmu", lambda files: files.update({name: b"x"}))
    sentence = refused(capsys, "identify", coil_folder / "study.toml")
    assert "escaped.txt" in sentence
    assert "outside" in sentence
    assert not Path("/tmp/escaped.txt").exists()
