"""SSV files: what is written is read by FMPy's schema-checked reader and by ours; what is wrong is one sentence."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp import ssd as fmpy_ssd

from fmuid.errors import InputError
from fmuid.models.description import Unit, unit_conversion
from fmuid.models.ssv import Quantity, mapping_entries, parameter_set, read_ssv, read_xml, write_ssv

KELVIN = Unit("K", (0, 0, 0, 0, 1, 0, 0, 0), 1.0, 0.0, {})
CELSIUS = Unit("degC", (0, 0, 0, 0, 1, 0, 0, 0), 1.0, 273.15, {})
FAHRENHEIT = Unit("degF", (0, 0, 0, 0, 1, 0, 0, 0), 5 / 9, 459.67 * 5 / 9, {})
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


def test_a_unit_that_cannot_be_defined_is_left_out(tmp_path: Path) -> None:
    write_ssv(tmp_path / "x.ssv", "n", {"a": Quantity(1.0, "widgets"), "b": Quantity(2.0, "unheard of")}, UNITS)
    read = fmpy_ssd.read_ssv(str(tmp_path / "x.ssv"), validate=True)
    assert [p.unit for p in read.parameters] == [None, None]


def test_what_is_not_finite_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="parameter 'R' is inf"):
        write_ssv(tmp_path / "x.ssv", "n", {"R": Quantity(math.inf)}, {})
    assert not (tmp_path / "x.ssv").exists()


@pytest.mark.parametrize(
    ("value", "source", "target", "expected"),
    [
        (20.0, CELSIUS, KELVIN, 293.15),
        (0.0, KELVIN, CELSIUS, -273.15),
        (60.0, RPM, SPEED, 2 * math.pi),
        (100.0, CELSIUS, FAHRENHEIT, 212.0),
    ],
)
def test_units_convert(value: float, source: Unit, target: Unit, expected: float) -> None:
    conversion = unit_conversion(source, target)
    assert conversion is not None
    assert conversion[0] * value + conversion[1] == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(("source", "target"), [(RPM, KELVIN), (UNKNOWN, UNKNOWN), (None, RPM)])
def test_units_that_do_not_convert(source: Unit | None, target: Unit) -> None:
    assert unit_conversion(source, target) is None


SSV = (
    '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"'
    ' version="{version}" name="n"><ssv:Parameters>{body}</ssv:Parameters></ssv:ParameterSet>'
)


def test_ssp_2_types_are_read(tmp_path: Path) -> None:
    body = "".join(
        f'<ssv:Parameter name="{kind}"><ssv:{kind} value="{value}"/></ssv:Parameter>'
        for kind, value in (("Float64", "2.5"), ("UInt8", "3"), ("Boolean", "1"), ("Enumeration", "on"))
    )
    (tmp_path / "x.ssv").write_text(SSV.format(version="2.0", body=body))
    values = read_ssv(tmp_path / "x.ssv").values
    assert {name: quantity.value for name, quantity in values.items()} == {
        "Float64": 2.5, "UInt8": 3, "Boolean": True, "Enumeration": "on"
    }  # fmt: skip


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


def test_enumerations_of_the_file_go_with_its_values(tmp_path: Path) -> None:
    body = '<Parameters><Parameter name="mode"><Enumeration name="Mode" value="fast"/></Parameter></Parameters>'
    items = '<Enumerations><Enumeration name="Mode"><Item name="slow" value="1"/><Item name="fast" value="4"/>'
    text = f'<ParameterSet version="1.0" name="n">{body}{items}</Enumeration></Enumerations></ParameterSet>'
    (tmp_path / "x.ssv").write_text(text)
    found = parameter_set(read_xml(tmp_path / "x.ssv", "ParameterSet", "an SSV file"), "x.ssv").values["mode"]
    assert found.value == "fast"
    assert found.items == {"slow": 1, "fast": 4}
