"""FMU files: what is refused before anything is loaded, unpacking, and what a description says."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from fmuid.errors import InputError
from fmuid.models.description import Unit, Variable
from fmuid.models.fmu import FMU
from fmuid.simulation.instance import Instance
from tests.support.paths import FMUS
from tests.support.probe_fmu import ProbeMaker


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    cache = tmp_path / "cache"
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(cache / name))
    return cache


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
    with pytest.raises(InputError, match="'deg', the unit of the column of 'u', does not convert to 'rad/s'"):
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
        with pytest.raises(InputError, match=r"declares no unit of 'u', whose column is in .*: convert it .* \{ u = "):
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


def test_unpacked_once_by_content(probe: ProbeMaker, own_cache: Path, tmp_path: Path) -> None:
    fmu = FMU(probe())
    assert not own_cache.exists()
    directory = fmu.directory
    assert directory.is_relative_to(own_cache)
    marker = directory / "marker"
    marker.touch()
    copy = tmp_path / "copy.fmu"
    copy.write_bytes(fmu.path.read_bytes())
    assert FMU(copy).directory == directory
    assert marker.exists()
    assert [p.name for p in directory.parent.iterdir()] == [directory.name]  # nothing half unpacked is left


def test_missing_file_and_no_zip(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no\.fmu: there is no such FMU file"):
        FMU(tmp_path / "no.fmu")
    (tmp_path / "text.fmu").write_text("hello")
    with pytest.raises(InputError, match="not a zip archive"):
        FMU(tmp_path / "text.fmu")


def test_no_model_description_and_broken_xml(tmp_path: Path) -> None:
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "")
    with pytest.raises(InputError, match=r"no modelDescription\.xml"):
        FMU(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription")
    with pytest.raises(InputError, match="not well-formed"):
        FMU(path)


@pytest.mark.parametrize("version", ["1.0", "4.0"])
def test_other_fmi_versions(probe: ProbeMaker, version: str) -> None:
    with pytest.raises(InputError, match=rf"FMI {version}, and only FMI 2\.0 and 3\.0 are read"):
        FMU(probe(version=version))


def test_no_binary_for_this_platform_says_which_there_are(tmp_path: Path) -> None:
    import fmpy

    fmu = FMU(repack(FMUS / "Coil" / "Coil.fmu", tmp_path / "Coil.fmu", leave_out=f"binaries/{fmpy.platform}/"))
    others = {"linux64", "win64", "darwin64"} - {fmpy.platform}
    with pytest.raises(InputError, match=f"no binary for this platform.*{', '.join(sorted(others))}"):
        Instance(fmu, "co-simulation", "coil")


def test_a_damaged_binary_is_one_sentence(tmp_path: Path) -> None:
    import fmpy

    source = FMUS / "Coil" / "Coil.fmu"
    entry = zipfile.ZipInfo(f"binaries/{fmpy.platform}/Coil{fmpy.sharedLibraryExtension}")
    fmu = FMU(repack(source, tmp_path / "Coil.fmu", entry, leave_out=f"binaries/{fmpy.platform}/"))
    with pytest.raises(InputError, match=r"Coil\.fmu: instantiation failed"):
        Instance(fmu, "co-simulation", "coil")


def test_wrong_guid_gives_the_message_of_the_fmu() -> None:
    source = FMUS / "Coil" / "Coil.fmu"
    fmu = FMU(source)
    object.__setattr__(fmu.description, "guid", "{another}")
    with pytest.raises(InputError, match=r"instantiation failed: .*FMU: .*wrong token"):
        Instance(fmu, "co-simulation", "coil")
