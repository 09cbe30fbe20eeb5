"""FMU files that would harm or mislead are refused before anything is loaded; units, and what a description says."""

import re
import zipfile
from pathlib import Path

import fmpy
import pytest

from fmuid import FMU, InputError
from fmuid.models import Variable, read_ssv, with_starts
from fmuid.models import untrusted_xml as safe_xml
from fmuid.models.ssp import read_ssp
from fmuid.simulation.instance import Instance
from fmuid.simulation.validation import _description
from tests.support.compiled import ProbeMaker
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.packing import pack
from tests.support.paths import FMUS

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


def test_units_convert_both_ways(probe: ProbeMaker) -> None:
    description = FMU(probe()).description
    speed = description.variables["u"]
    assert description.conversion(speed, "rad/s") == (1.0, 0.0)
    assert description.conversion(speed, "rpm")[0] == pytest.approx(3.141592653589793 / 30)
    assert description.conversion(speed, "krad/s") == (1000.0, 0.0)
    assert description.conversion(speed, "deg/s")[0] == pytest.approx(
        3.141592653589793 / 180
    )  # which it does not define
    assert description.conversion(speed._replace(unit="K"), "C") == (1.0, 273.15)
    with pytest.raises(InputError, match="u: column unit 'deg' does not convert to 'rad/s'"):
        description.conversion(speed, "deg")


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


# --- XML --------------------------------------------------------------------------------

BOMB = """<!DOCTYPE lolz [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>"""
FETCH = """<!DOCTYPE r [<!ENTITY b SYSTEM "file:///etc/passwd">]>"""
REMOTE = """<!DOCTYPE fmiModelDescription SYSTEM "http://example.com/a.dtd">"""


@pytest.mark.parametrize("kind", [BOMB, FETCH, REMOTE])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_document_types_are_refused(tmp_path: Path, kind: str, encoding: str) -> None:
    value = "&b;" if "ENTITY" in kind else "b"
    for text in (FMI2, FMI3):
        described = text.partition("?>")[2].replace("a tool", value).replace('"linear"', f'"{value}"', 1)
        whole = f'<?xml version="1.0" encoding="{encoding}"?>{kind}{described}'.encode(encoding)
        with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
            archive.writestr("modelDescription.xml", whole)
        with pytest.raises(InputError, match=r"modelDescription\.xml: DOCTYPE is refused"):
            FMU(tmp_path / "a.fmu")
        with pytest.raises(InputError, match="DOCTYPE is refused"):
            with_starts(whole, {})
    (tmp_path / "a.ssv").write_bytes(f"{kind}<ParameterSet version='1.0'>{value}</ParameterSet>".encode(encoding))
    with pytest.raises(InputError, match=r"a\.ssv: DOCTYPE is refused"):
        read_ssv(tmp_path / "a.ssv")
    pack(tmp_path / "a.ssp", ("SystemStructure.ssd", f"{kind}<SystemStructureDescription/>".encode(encoding)))
    with pytest.raises(InputError, match=r"SystemStructure\.ssd: DOCTYPE is refused"):
        read_ssp(tmp_path / "a.ssp")


def test_document_type_of_a_build_description(tmp_path: Path) -> None:
    """FMPy reads this file, too."""
    text = f'{FETCH}<fmiBuildDescription fmiVersion="3.0">&b;</fmiBuildDescription>'
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", FMI3)
        archive.writestr("sources/buildDescription.xml", text)
    fmu = FMU(tmp_path / "a.fmu")
    with pytest.raises(InputError, match=r"buildDescription\.xml: DOCTYPE is refused"):
        _description(fmu)


def test_deep_nesting(tmp_path: Path) -> None:
    for depth, fits in ((safe_xml.DEEPEST_NESTING, True), (safe_xml.DEEPEST_NESTING + 1, False), (100_000, False)):
        text = b"<a>" * depth + b"</a>" * depth
        if fits:
            assert safe_xml.parse_xml(text, "it").tag == "a"
        else:
            with pytest.raises(InputError, match="more than 200 nested elements"):
                safe_xml.parse_xml(text, "it")
    system = "<System name='s'><Elements>" * 5000 + "</Elements></System>" * 5000
    text = f"<SystemStructureDescription version='1.0'>{system}</SystemStructureDescription>".encode()
    with pytest.raises(InputError, match="nested elements"):
        read_ssp(pack(tmp_path / "a.ssp", ("SystemStructure.ssd", text)))


def test_xml_and_archives_are_read_in_one_place() -> None:
    """So that no reader is left open; archives are written and asked whether they are archives elsewhere.

    Tables are their user's own and read as they stream: the last two of the files are theirs.
    """
    package, readers = Path(safe_xml.__file__).parents[1], set[str]()
    reads = re.compile(r"ElementTree\.(parse|fromstring|iterparse|XML)|ParserCreate|etree\.parse|ZipFile\([^\"]*\)")
    for path in package.rglob("*.py"):
        if reads.search(path.read_text(encoding="utf-8")):
            readers.add(path.name)
    assert readers == {"untrusted_xml.py", "archive.py", "unpacking.py", "spreadsheet.py"}


# --- what a description may declare -----------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<Dimension start="5"/>', '<Dimension start="1000000000"/>', "1000000013 variables and elements"),
        ('<Dimension start="5"/>', '<Dimension start="5"/>' * 20, "at most 1000000 are read"),
        ('valueReference="3" causality', 'valueReference="4294967296" causality', "no unsigned 32-bit integer"),
        ('valueReference="3" causality', 'valueReference="-1" causality', "no unsigned 32-bit integer"),
        ('valueReference="5" causality', 'valueReference="7" causality', "refers to 5, which is not declared"),
        ('modelIdentifier="linear" has', 'modelIdentifier="../../evil" has', "names no binary"),
        ('modelIdentifier="linear" has', 'modelIdentifier="..\\evil" has', "names no binary"),
        ('modelIdentifier="linear" has', "has", "names no binary"),
        ('start="0.5"', 'start="half"', "'length': wrong value: could not convert"),
        (' instantiationToken="linear"', "", "no guid or instantiationToken"),
        (' modelName="Linear"', "", "fmiModelDescription without a name"),
        ('<Float64 name="length"', '<Float65 name="length"', "'length': Float65 is no type of FMI 3.0"),
        (' dependencies="4"', ' dependencies="4 u"', "reference to a variable = u"),
        ('<Dimension start="5"/>', "<Dimension/>", "reference to a variable = None"),
        ('<Dimension start="5"/>', '<Dimension start="-5"/>', "the size of an array = -5"),
        ('causality="input"', 'causality="input" declaredType="V"', "'u': type 'V' is not defined"),
        ('causality="input" variability="continuous"', 'causality="input" variability="fixed"', "FMI does not allow"),
    ],
)
def test_descriptions_that_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in FMI3
    with pytest.raises(InputError, match=re.escape(said)):
        FMU(write_fmu(tmp_path / "a.fmu", FMI3.replace(old, new)))


@pytest.mark.parametrize("factor", ["0", "nan", "INF", "twice"])
def test_units_that_do_not_convert(tmp_path: Path, factor: str) -> None:
    for old in ('factor="1000"', 'factor="9.549296585513721"'):
        with pytest.raises(InputError, match="is not a usable number"):
            FMU(write_fmu(tmp_path / "a.fmu", FMI2.replace(old, f'factor="{factor}"')))
    with pytest.raises(InputError, match="unit 'A': wrong exponent"):
        FMU(write_fmu(tmp_path / "a.fmu", FMI2.replace('<BaseUnit A="1"/>', '<BaseUnit A="1.5"/>')))
