"""XML of FMUs that would harm or mislead."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import pytest

from fmuid.errors import InputError
from fmuid.models import untrusted_xml as safe_xml
from fmuid.models.fmu import FMU
from fmuid.models.ssp import read_ssp
from fmuid.models.ssv import read_ssv
from fmuid.models.start_values import with_starts
from fmuid.simulation.validation import _description
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.packing import pack

pytestmark = pytest.mark.usefixtures("cache")

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
    assert readers == {"untrusted_xml.py", "archive.py", "text.py", "spreadsheet.py"}


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
        (
            '<Float64 name="length"',
            '<Float65 name="length"',
            "'length': Float65 is no type of FMI 3.0",
        ),
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


def test_a_large_array_is_read_in_time_proportional_to_it(tmp_path: Path) -> None:
    """Of 200 000 elements; each would have listed all the others."""
    text = FMI3.replace('<Dimension start="5"/>', '<Dimension start="200000"/>')
    variables = FMU(write_fmu(tmp_path / "a.fmu", text)).description.variables
    assert variables["y[200000]"].array is variables["y[1]"].array
