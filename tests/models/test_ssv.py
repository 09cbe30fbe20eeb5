"""SSV files: what is written is read by FMPy's schema-checked reader and by ours; what is wrong is one sentence."""

import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp import ssd as fmpy_ssd

from fmuid import InputError
from fmuid.models import Quantity, Unit, read_ssv, write_ssv
from fmuid.models.ssv import mapping_entries, read_xml

KELVIN = Unit("K", (0, 0, 0, 0, 1, 0, 0, 0), 1.0, 0.0, {})
CELSIUS = Unit("degC", (0, 0, 0, 0, 1, 0, 0, 0), 1.0, 273.15, {})
RPM = Unit("rpm", (0, 0, -1, 0, 0, 0, 0, 1), math.pi / 30, 0.0, {})
SPEED = Unit("rad/s", (0, 0, -1, 0, 0, 0, 0, 1), 1.0, 0.0, {})
UNKNOWN = Unit("widgets", None, 1.0, 0.0, {})
UNITS = {unit.name: unit for unit in (KELVIN, CELSIUS, RPM, SPEED, UNKNOWN)}


def test_numbers_read_back_exactly_here_and_elsewhere(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    numbers = (rng.normal(size=50) * 10.0 ** rng.integers(-300, 300, 50)).tolist()
    values = {f"part.a[{k}]": Quantity(value, "rpm" if k % 2 else None) for k, value in enumerate(numbers)}
    write_ssv(tmp_path / "x.ssv", "estimates", values, UNITS)
    own = read_ssv(tmp_path / "x.ssv")
    assert own.values == values
    assert own.name == "estimates"
    assert own.units == {"rpm": RPM}  # those that are used
    theirs = fmpy_ssd.read_ssv(str(tmp_path / "x.ssv"), validate=True)
    assert {p.name: (float(p.value), p.unit) for p in theirs.parameters} == {
        name: (quantity.value, quantity.unit) for name, quantity in values.items()
    }


def test_all_types_and_awkward_names(tmp_path: Path) -> None:
    values = {
        'a "b" <c> & d': Quantity(True, None, "it's <here>"),
        "Ψ": Quantity(-7),
        "word": Quantity('say "so" & go'),
        "one": Quantity(1.0),
    }
    write_ssv(tmp_path / "x.ssv", "a & b", values, {})
    assert read_ssv(tmp_path / "x.ssv").values == values
    kinds = {p.name: p.type for p in fmpy_ssd.read_ssv(str(tmp_path / "x.ssv"), validate=True).parameters}
    assert list(kinds.values()) == ["Boolean", "Integer", "String", "Real"]


def test_what_is_not_finite_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="parameter 'R' is inf"):
        write_ssv(tmp_path / "x.ssv", "n", {"R": Quantity(math.inf)}, {})
    assert not (tmp_path / "x.ssv").exists()


SSV = (
    '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"'
    ' version="{version}" name="n"><ssv:Parameters>{body}</ssv:Parameters></ssv:ParameterSet>'
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<a", "not well-formed XML"),
        ("<ParameterMapping version='1.0'/>", "not an SSV file: root element ParameterMapping"),
        (SSV.format(version="3.0", body=""), "SSP 3.0 is not supported"),
        (SSV.format(version="1.0", body="<ssv:Parameter name='a'/>"), "parameter 'a' needs one value"),
        (
            SSV.format(version="1.0", body="<ssv:Parameter name='a'><ssv:Real value='x'/></ssv:Parameter>"),
            "parameter 'a': value of Real must be a finite number, not 'x'",
        ),
        (
            SSV.format(version="1.0", body="<ssv:Parameter name='a'><ssv:Integer value='1.5'/></ssv:Parameter>"),
            "parameter 'a': '1.5' is not an integer",
        ),
        (
            SSV.format(version="1.0", body="<ssv:Parameter name='a'><ssv:Boolean value='yes'/></ssv:Parameter>"),
            "must be true or false, not 'yes'",
        ),
        (
            SSV.format(version="1.0", body="<ssv:Parameter name='a'><ssv:Binary value='00'/></ssv:Parameter>"),
            "type Binary is not supported",
        ),
        (
            SSV.format(version="1.0", body="<ssv:Parameter name='a'><ssv:Real value='1'/></ssv:Parameter>" * 2),
            "parameter 'a' occurs twice",
        ),
    ],
)
def test_what_is_wrong_is_one_sentence(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "x.ssv").write_text(text)
    with pytest.raises(InputError, match=message) as refusal:
        read_ssv(tmp_path / "x.ssv")
    assert "x.ssv" in str(refusal.value)


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.ssv: cannot be read: No such file"):
        read_ssv(tmp_path / "gone.ssv")


SSM = '<ParameterMapping xmlns:c="urn:c" version="1.0">{}</ParameterMapping>'


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ('<MappingEntry target="b"/>', "needs both source and target"),
        ('<MappingEntry source="a" target="b"/><MappingEntry source="c" target="b"/>', "two entries map to 'b'"),
        ('<MappingEntry source="a" target="b"><c:LinearTransformation factor="?"/></MappingEntry>', "factor of Linear"),
        ('<MappingEntry source="a" target="b"><c:CubicTransformation/></MappingEntry>', "Cubic.* is not supported"),
        ('<MappingEntry source="a" target="b"><c:RealMappingTransformation/></MappingEntry>', "Real.* not supported"),
    ],
)
def test_wrong_mappings(tmp_path: Path, entries: str, message: str) -> None:
    (tmp_path / "x.ssm").write_text(SSM.format(entries))
    root = read_xml(tmp_path / "x.ssm", "ParameterMapping", "an SSM file")
    with pytest.raises(InputError, match=message):
        mapping_entries(root, "x.ssm")
