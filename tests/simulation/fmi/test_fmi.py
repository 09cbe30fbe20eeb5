"""FMU files: what is refused before anything is loaded, unpacking, and what a description says."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import pytest

from fmuid.errors import InputError
from fmuid.models.description import Unit, Variable
from fmuid.models.fmu import FMU
from fmuid.simulation.instance import Instance
from tests.support.paths import FMUS
from tests.support.probe_fmu import ProbeMaker

pytestmark = pytest.mark.usefixtures("cache")


def repack(source: Path, target: Path, entry: zipfile.ZipInfo | None = None, leave_out: str = "\0") -> Path:
    """Copy an FMU with one more entry, or without those whose names contain a text."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for item in old.infolist():
            if leave_out not in item.filename:
                new.writestr(item, old.read(item))
        if entry is not None:
            new.writestr(entry, b"evil")
    return target


def test_coil_describes_itself() -> None:
    description = FMU(FMUS / "Coil" / "Coil.fmu").description
    assert description.model_name == "Coil"
    assert description.fmi_version == "2.0"
    resistance = description.variables["R"]
    assert (resistance.unit, resistance.start, resistance.min) == ("Ohm", 4.0, 0.0)
    assert resistance.description
    assert description.inputs == ("u",)
    assert description.variables["i"].is_state
    assert description.dependencies == {"i": ("i",)}
    assert description.interfaces["co-simulation"].interpolates_inputs
    assert description.interfaces["model-exchange"].directional_derivatives


def test_units_convert_both_ways(probe: ProbeMaker) -> None:
    description = FMU(probe()).description
    speed = description.variables["u"]
    assert description.conversion(speed, "rad/s") == (1.0, 0.0)
    assert description.conversion(speed, "rpm")[0] == pytest.approx(3.141592653589793 / 30)
    assert description.conversion(speed, "krad/s") == (1000.0, 0.0)
    assert description.conversion(speed, "deg/s")[0] == pytest.approx(
        3.141592653589793 / 180
    )  # which it does not define
    with pytest.raises(InputError, match="u: column unit 'deg' does not convert to 'rad/s'"):
        description.conversion(speed, "deg")


def test_display_units_are_the_fmus_own() -> None:
    """Of one with an offset, as the standard's example has it: degF = 1.8 K - 459.67."""
    kelvin = Unit("K", (0, 0, 0, 0, 1, 0, 0, 0), 1.0, 0.0, {"my_degF": (1.8, -459.67)})
    described = replace(FMU(FMUS / "Coil" / "Coil.fmu").description, units={"K": kelvin})
    warm = next(iter(described.variables.values()))._replace(unit="K")
    factor, offset = described.conversion(warm, "my_degF")
    assert factor * 212.0 + offset == pytest.approx(373.15)


def test_a_variable_without_a_unit_takes_what_needs_no_conversion(probe: ProbeMaker) -> None:
    description = FMU(probe()).description
    bare = description.variables["u"]._replace(unit=None)
    assert description.conversion(bare, "N.m") == (1.0, 0.0)
    assert description.conversion(bare, "1") == (1.0, 0.0)
    for unit in ("rpm", "mA", "degC", "smoots of ale"):
        with pytest.raises(InputError, match=r"u: column unit .* declares none.* \{ u = "):
            description.conversion(bare, unit)


@pytest.mark.parametrize(
    ("causality", "variability", "initial", "settable"),
    [
        ("parameter", "fixed", "exact", True),
        ("parameter", "tunable", "exact", True),
        ("input", "continuous", None, True),
        ("local", "continuous", "exact", True),
        ("output", "continuous", "approx", True),
        ("output", "continuous", "calculated", False),
        ("local", "constant", "exact", False),
        ("calculatedParameter", "fixed", "calculated", False),
        ("independent", "continuous", None, False),
    ],
)
def test_what_may_be_set(causality: str, variability: str, initial: str | None, settable: bool) -> None:
    assert Variable("v", 0, "Float64", causality, variability, initial).settable is settable


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (None, r"a\.fmu: FMU not found"),
        ({}, "no zip archive"),
        ({"readme.txt": ""}, r"no modelDescription\.xml"),
        ({"modelDescription.xml": "<fmiModelDescription"}, "not well-formed"),
        ({"modelDescription.xml": '<fmiModelDescription fmiVersion="1.0"/>'}, r"FMI 1\.0 is not supported"),
        ({"modelDescription.xml": '<fmiModelDescription fmiVersion="4.0"/>'}, r"FMI 4\.0 is not supported"),
    ],
)
def test_unreadable_fmus_are_refused(tmp_path: Path, files: dict[str, str] | None, words: str) -> None:
    path = tmp_path / "a.fmu"
    if files == {}:
        path.write_text("hello")
    elif files is not None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in files.items():
                archive.writestr(name, text)
    with pytest.raises(InputError, match=words):
        FMU(path)


def test_missing_damaged_and_refusing_binaries_are_one_sentence(tmp_path: Path) -> None:
    coil, here = FMUS / "Coil" / "Coil.fmu", f"binaries/{fmpy.platform}/"
    entry = zipfile.ZipInfo(f"{here}Coil{fmpy.sharedLibraryExtension}")
    others = sorted({"linux64", "win64", "darwin64"} - {fmpy.platform})
    fmu = FMU(coil)
    object.__setattr__(fmu.description, "guid", "{another}")
    for each, words in (
        (FMU(repack(coil, tmp_path / "none.fmu", leave_out=here)), f"no binary for this platform.*{', '.join(others)}"),
        (FMU(repack(coil, tmp_path / "bad.fmu", entry, leave_out=here)), r"bad\.fmu: instantiation failed"),
        (fmu, "instantiation failed: .*FMU: .*wrong token"),
    ):
        with pytest.raises(InputError, match=words):
            Instance(each, "co-simulation", "coil")
