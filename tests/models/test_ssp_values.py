"""Parameter bindings of system structures: which variable they set to what."""

from pathlib import Path

import pytest

from fmuid import InputError
from fmuid.models.ssp import read_ssp
from tests.support.ssp_texts import (
    LENGTHS,
    MODES,
    SPACES,
    Maker,
    add_types,
    binding,
    connection,
    connector,
    content,
    drive,
    element,
    in_ssv,
    linear,
    mapping,
    parameter,
    parameter_set,
    table,
    units,
)

pytestmark = pytest.mark.usefixtures("own_cache")


def test_later_bindings_win_and_outer_ones_over_inner_ones(package: Maker) -> None:
    inner_bindings = binding(parameter("drive.Fv", 2.0) + parameter("drive.Fc", 2.0) + parameter("drive.offset", 2.0))
    parts = drive(bindings=binding("".join(parameter(name, 1.0) for name in ("M", "Fv", "Fc", "offset", "gtau"))))
    inner = element("System", "inner", "", content(parts), inner_bindings)
    top = binding(parameter("inner.drive.Fc", 3.0) + parameter("inner.drive.offset", 3.0))
    top += binding(parameter("inner.drive.offset", 4.0))
    values = read_ssp(package(content(inner), bindings=top)).values
    assert values == {
        "inner.drive.M": 1.0, "inner.drive.gtau": 1.0, "inner.drive.Fv": 2.0, "inner.drive.Fc": 3.0,
        "inner.drive.offset": 4.0,
    }  # fmt: skip


def test_external_values_with_prefix_mapping_and_units(package: Maker) -> None:
    """Units are converted first, then the mapping's factor and offset apply; what it does not map is left out."""
    values = parameter("mass", 5.0, unit="g") + parameter("where", 250.0, unit="mm") + parameter("M", 9.0)
    ssv = parameter_set(values, in_ssv(units(g=("kg", 1e-3, 0.0), mm=("m", 1e-3, 0.0))), f" {SPACES}")
    ssm = (
        f'<ssm:ParameterMapping {SPACES} version="1.0"><ssm:MappingEntry source="drive.mass" target="drive.M">'
        f"{linear(3.0, 1.0)}</ssm:MappingEntry>"
        '<ssm:MappingEntry source="drive.where" target="drive.q_start"/>'
        '<ssm:MappingEntry source="drive.where" target="drive.dq_start" suppressUnitConversion="true"/>'
        '<ssm:MappingEntry source="drive.other" target="drive.Fv"/></ssm:ParameterMapping>'
    )
    bound = '<ssd:ParameterBinding source="resources/v.ssv" prefix="drive.">'
    bound += '<ssd:ParameterMapping source="resources/m.ssm"/></ssd:ParameterBinding>'
    files = {"resources/v.ssv": ssv, "resources/m.ssm": ssm}
    structure = read_ssp(package(content(drive()), bindings=bound, files=files))
    assert structure.values == pytest.approx(
        {"drive.M": 3 * 5e-3 + 1, "drive.q_start": 0.25, "drive.dq_start": 250.0}, rel=1e-14
    )


def test_a_parameter_of_the_system_goes_to_all_that_it_feeds(package: Maker) -> None:
    inner = element(
        "System", "inner", connector("x", "parameter", "mm"), content(drive(), connection("x", "drive.q_start"))
    )
    joined = connection("start", "inner.x") + connection("start", "drive.q_start", linear(2.0))
    path = package(
        content(inner + drive(), joined),
        connector("start", "parameter", "m"),
        binding(parameter("start", 3.0, unit="mm")),
        rest=LENGTHS,
    )
    assert read_ssp(path).values == pytest.approx({"inner.drive.q_start": 0.003, "drive.q_start": 0.006}, rel=1e-14)


def test_names_that_match_nothing_are_ignored(package: Maker) -> None:
    bound = binding("".join(parameter(name, 1.0) for name in ("drive.mass", "gone.M", "M", "drive.M", "drive.q")))
    structure = read_ssp(package(content(drive()), bindings=bound))
    assert structure.values == {"drive.M": 1.0}


@pytest.mark.parametrize(
    ("given", "mapped", "expected"),
    [
        (parameter("x", 3, "Integer"), ("x", "types.r", ""), {"types.r": 3.0}),
        (parameter("x", 4.0), ("x", "types.n", ""), {"types.n": 4}),
        (parameter("x", "true", "Boolean"), ("x", "types.b", ""), {"types.b": True}),
        (parameter("x", "word", "String"), ("x", "types.s", ""), {"types.s": "word"}),
        (parameter("x", "on", "Enumeration", name="Mode"), ("x", "types.n", ""), {"types.n": 7}),
        (parameter("x", "true", "Boolean"), ("x", "types.b", table("Boolean", true="false")), {"types.b": False}),
        (parameter("x", 3, "Integer"), ("x", "types.n", table("Integer", _3="-5")), {"types.n": -5}),
        (
            parameter("x", "off", "Enumeration", name="Mode"),
            ("x", "types.n", table("Enumeration", off="on")),
            {"types.n": 7},
        ),
    ],
)
def test_types_and_tables(
    package: Maker, given: str, mapped: tuple[str, str, str], expected: dict[str, object], tmp_path: Path
) -> None:
    path = package(
        content(element("Component", "types", "", source="types.fmu")),
        bindings=binding(given, mapping(mapped)),
        rest=MODES.format("ssd"),
    )
    add_types(path, tmp_path)
    values = read_ssp(path).values
    assert values == expected
    assert [type(value) for value in values.values()] == [type(value) for value in expected.values()]


@pytest.mark.parametrize(
    ("given", "mapped", "message"),
    [
        (
            parameter("x", 3.5),
            ("x", "types.n", ""),
            "parameter 'x' for 'types.n' is 3.5, which does not fit .* Integer",
        ),
        (parameter("x", "on", "Enumeration"), ("x", "types.n", ""), "is 'on', which does not fit its type Integer"),
        (parameter("x", "a", "String"), ("x", "types.r", ""), "is 'a', which does not fit its type Real"),
        (parameter("x", 2, "Integer"), ("x", "types.n", table("Integer", _3="4")), "is 2, which its mapping lacks"),
    ],
)
def test_values_of_a_wrong_type(
    package: Maker, given: str, mapped: tuple[str, str, str], message: str, tmp_path: Path
) -> None:
    part = element("Component", "types", "", source="types.fmu")
    path = add_types(package(content(part), bindings=binding(given, mapping(mapped))), tmp_path)
    with pytest.raises(InputError, match=message):
        read_ssp(path)
