"""System structures: read, connected, with values and their bindings."""

# ruff: noqa: E501  # the table of wrong structures reads best one case a line
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from fmuid import InputError, Simulator, System
from fmuid.models.ssp import read_ssp
from tests.support.experiments import record
from tests.support.ssp_texts import (
    CONTROLLER,
    DRIVE,
    LENGTHS,
    LOOP,
    MODES,
    SPACES,
    Maker,
    add_types,
    binding,
    connection,
    connector,
    content,
    controller,
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


def test_a_closed_loop_simulates_as_the_same_system_put_together_by_hand(package: Maker) -> None:
    inputs = connector("reference", "input", "m")
    path = package(
        content(drive() + controller(), LOOP + connection("reference", "controller.qg")),
        inputs,
        rest=LENGTHS + '<ssd:DefaultExperiment startTime="0.5" stopTime="2"/>',
    )
    structure = read_ssp(path)
    assert {name: fmu.path.name for name, (fmu, _) in structure.components.items()} == {
        "drive": "Drive.fmu", "controller": "Controller.fmu"
    }  # fmt: skip
    assert structure.components["drive"][0].file.read_bytes() == DRIVE.read_bytes()
    assert structure.connectors == {"reference": [("controller.qg", 1.0, 0.0)]}
    assert structure.values == {}
    by_hand = System(
        components={"drive": DRIVE, "controller": CONTROLLER},
        connections=[("drive.q", "controller.q"), ("drive.dq", "controller.dq"), ("controller.v", "drive.v")],
    )
    times = np.arange(200) * 1e-3
    outputs = ["drive.q", "controller.v"]
    experiment = record(times, {"controller.qg": 0.01 * np.sin(20 * times)}, outputs)
    simulated = Simulator(System.read_ssp(path), experiment)([])
    assert np.abs(simulated).max() > 1e-3
    np.testing.assert_array_equal(simulated, Simulator(by_hand, experiment)([]))


def test_start_and_end_do_not_tell_the_direction(package: Maker) -> None:
    pairs = [
        ("drive.q", "controller.q"),
        ("controller.v", "drive.v"),
        ("reference", "controller.qg"),
        ("drive.q", "where"),
    ]
    ports = connector("reference", "input") + connector("where", "output")
    forth, back = (
        read_ssp(package(content(drive() + controller(), "".join(joined)), ports))
        for joined in ([connection(a, b) for a, b in pairs], [connection(b, a) for a, b in pairs])
    )
    assert forth.connections == back.connections
    assert set(forth.connections) == {("drive.q", "controller.q"), ("controller.v", "drive.v")}
    own = {"reference": [("controller.qg", 1.0, 0.0)], "where": [("drive.q", 1.0, 0.0)]}
    assert forth.connectors == back.connectors == own


def test_nested_systems_are_flattened_and_transformations_composed(package: Maker) -> None:
    """The drive is two systems deep; q goes out through x -> 2x + 1 and in through x -> 3x - 4."""
    inner = element(
        "System", "inner", connector("out", "output") + connector("u", "input"),
        content(drive(), connection("drive.q", "out", linear(2.0, 1.0)) + connection("u", "drive.v")),
    )  # fmt: skip
    outer = element(
        "System", "outer", connector("out", "output") + connector("u", "input"),
        content(inner, connection("inner.out", "out") + connection("u", "inner.u")),
    )  # fmt: skip
    joined = connection("outer.out", "controller.q", linear(3.0, -4.0)) + connection("u", "outer.u", linear(5.0))
    joined += connection("u", "controller.qg") + connection("outer.out", "position")
    path = package(content(outer + controller(), joined), connector("u", "input") + connector("position", "output"))
    structure = read_ssp(path)
    assert set(structure.components) == {"outer.inner.drive", "controller"}
    # 3 (2 q + 1) - 4
    assert structure.connections == (("outer.inner.drive.q", "controller.q", 6.0, -1.0),)
    assert set(structure.connectors["u"]) == {("outer.inner.drive.v", 5.0, 0.0), ("controller.qg", 1.0, 0.0)}
    assert structure.connectors["position"] == [("outer.inner.drive.q", 2.0, 1.0)]
    assert System.read_ssp(path).connections[0].factor == 6.0


@pytest.mark.parametrize(
    ("source", "target", "inside", "suppress", "expected"),
    [
        ("m", "mm", "", False, (1000.0, 0.0)),
        ("mm", "m", "", False, (0.001, 0.0)),
        ("mm", "", "", False, (0.001, 0.0)),  # the controller's variable is in m
        ("", "mm", "", False, (1000.0, 0.0)),  # and so is the drive's
        ("m", "m", "", False, (1.0, 0.0)),
        ("", "", "", False, ()),
        ("", "", "", True, (1.0, 0.0)),
        ("m", "mm", "", True, (1.0, 0.0)),
        ("m", "mm", linear(2.0, 5.0), False, (2000.0, 5.0)),  # the transformation follows the conversion
        ("m", "mm", linear(2.0, 5.0), True, (2.0, 5.0)),
        ("m", "V", linear(2.0), False, (2.0, 0.0)),  # a transformation may lead to another dimension
    ],
)
def test_units_along_a_connection(
    package: Maker, source: str, target: str, inside: str, suppress: bool, expected: tuple[float, ...]
) -> None:
    joined = connection("drive.q", "controller.q", inside, suppress)
    structure = read_ssp(package(content(drive(unit=source) + controller(unit=target), joined), rest=LENGTHS))
    assert structure.connections[0][2:] == pytest.approx(expected, rel=1e-12)


def test_a_connector_without_unit_passes_the_unit_on(package: Maker) -> None:
    """The structure defines mm alone; that the controller's variable is in m, and what this is, its FMU says."""
    inner = element(
        "System", "inner", connector("out", "output"), content(drive(unit="mm"), connection("drive.q", "out"))
    )
    path = package(
        content(inner + controller(), connection("inner.out", "controller.q")), rest=units(mm=("m", 1e-3, 0.0))
    )
    assert read_ssp(path).connections[0][2:] == pytest.approx((1e-3, 0.0), rel=1e-14)


def test_a_bus_passes_on_what_is_written_to_it(package: Maker) -> None:
    dictionary = (
        '<ssd:SignalDictionary name="Bus"><ssb:SignalDictionary version="1.0"><ssb:DictionaryEntry name="position">'
        "<ssc:Real/></ssb:DictionaryEntry></ssb:SignalDictionary></ssd:SignalDictionary>"
    )
    here, inside = (
        element("SignalDictionaryReference", name, connector("position", "inout"), dictionary="Bus")
        for name in ("bus", "same")
    )
    inner = element("System", "inner", "", content(controller() + inside, connection("controller.q", "same.position")))
    joined = connection("drive.q", "bus.position", linear(2.0))
    structure = read_ssp(package(content(drive() + here + inner, joined, dictionary)))
    assert structure.connections == (("drive.q", "inner.controller.q", 2.0, 0.0),)


def test_names_of_elements_may_have_dots_and_sources_escapes(package: Maker) -> None:
    part = element("Component", "a.b", connector("M", "parameter"), source="resources/My%20drive.fmu")
    path = package(content(drive("a") + part), bindings=binding(parameter("a.b.M", 7.0)), check=False)
    with zipfile.ZipFile(path, "a") as archive:
        archive.write(DRIVE, "resources/My drive.fmu")
    structure = read_ssp(path)
    assert structure.values == {"a.b.M": 7.0}
    assert System.read_ssp(path).values == {"a.b.M": 7.0}


def test_ssp_2_is_read(package: Maker) -> None:
    ports = connector("v", "input", of="Float64") + connector("q", "output", of="Float64")
    part = element("Component", "drive", ports, source="resources/Drive.fmu")
    path = package(content(part, connection("drive.q", "drive.v", linear(-1.0))), version="2.0", check=False)
    assert read_ssp(path).connections == (("drive.q", "drive.v", -1.0, 0.0),)


BOTH = drive() + controller()
INNER = element("System", "inner", connector("p", "calculatedParameter"), content(drive()))
BAD = [
    (content(drive(source="x" * 300)), "component 'drive': file 'x*' is not in the archive"),
    (content(drive(source="resources/Drvie.fmu")), "file 'resources/Drvie.fmu' is not in the archive .*'resources/Drive.fmu'"),
    (content(drive(source="../Drive.fmu")), r"component 'drive': source '\.\./Drive.fmu' is outside the archive"),
    (content(drive(source="file:///Drive.fmu")), "is outside the archive"),
    (content(drive(source="#other")), "is outside the archive"),
    (content(drive(source="SystemStructure.ssd")), "component 'drive': SystemStructure.ssd: not an FMU: no zip archive"),
    (content(drive(type="application/x-ssp-package")), "component 'drive': type application/x-ssp-package is not supported"),
    (content(drive() + drive()), "the top system: two elements 'drive'"),
    (content(drive("")), "the top system: an element has no name"),
    (content(drive() + element("Table", "map", "")), "element 'map' is a Table, which is not supported"),
    (content(drive(implementation="ScheduledExecution")), "component 'drive': ScheduledExecution is not supported"),
    (content(drive(more=connector("a", "output").replace("<ssc", "<ssc:Dimension/><ssc")) + controller(), connection("drive.a", "controller.q")), "connector drive.a is an array, which is not supported"),
    (content(""), "no components"),
    (content(BOTH, connection("drvie.q", "controller.q")), r"the top system has no element 'drvie' \(did you mean 'drive'"),
    (content(BOTH, connection("drive.p", "controller.q")), r"element 'drive' has no connector 'p'"),
    (content(BOTH, connection("drive.dqq", "controller.q")), r"no connector 'dqq' \(did you mean 'dq'"),
    (content(BOTH, connection("reference", "controller.q")), "the top system has no connector 'reference'"),
    (content(element("System", "inner", "", content(drive(), connection("x", "drive.v")))), "system 'inner' has no connector 'x'"),
    (content(BOTH, connection("drive.v", "controller.q")), r"connection drive.v -> controller.q connects drive.v \(input\) and controller.q \(input\)"),
    (content(BOTH, connection("drive.q", "controller.v")), r"drive.q \(output\) and controller.v \(output\)"),
    (content(BOTH, connection("drive.q", "controller.kp")), r"drive.q \(output\) cannot feed controller.kp \(parameter\)"),
    (content(BOTH + INNER, connection("inner.p", "controller.kp")), r"inner.p \(calculatedParameter\) cannot feed controller.kp"),
    (content(BOTH + INNER, connection("inner.p", "controller.q")), r"inner.p \(calculatedParameter\) cannot feed controller.q"),
    (content(BOTH, connection("drive.q", "controller.q") + connection("drive.dq", "controller.q")), "controller.q is fed twice, by connection drive.q -> controller.q and connection drive.dq -> controller.q"),
    (content(drive(unit="m") + controller(unit="V"), connection("drive.q", "controller.q")), "connection drive.q -> controller.q: units 'm' and 'V' do not convert"),
    (content(drive(unit="inch") + controller(unit="m"), connection("drive.q", "controller.q")), "units 'inch' and 'm' do not convert"),
    (content(drive(more=connector("port", "inout")) + controller(), connection("drive.port", "controller.q")), "connector drive.port: kind 'inout' is not supported"),
    (content(BOTH, connection("drive.q", "controller.q", table("Boolean", true="false"))), "tables are supported for parameters only"),
    (content(drive(bindings=binding(parameter("M", 1.0, unit="V"), rest=in_ssv(units(V=("A", 1.0, 0.0)))))), "parameter 'M': units 'V' and 'kg' do not convert"),
    (content(drive(bindings=binding(""))), "a parameter binding of drive: neither a source nor a ParameterSet"),
    (content(drive(bindings=binding("", type="text/csv", source="a.csv"))), "type text/csv is not supported"),
    (content(drive(bindings=binding("", sourceBase="component", source="a.ssv"))), "a.ssv inside a component is not supported"),
    (content(drive(bindings=binding("", source="a.ssv"))), "a parameter binding of drive: file 'a.ssv'"),
    (content(drive(bindings=binding("", source="resources/Drive.fmu"))), "resources/Drive.fmu: not well-formed XML"),
    (content(element("SignalDictionaryReference", "bus", "", dictionary="Bus") + drive()), "'bus': no signal dictionary 'Bus'"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "message"), BAD)
def test_what_is_wrong_is_one_sentence(package: Maker, body: str, message: str) -> None:
    path = package(body, rest=LENGTHS, check=False)
    with pytest.raises(InputError, match=message) as refusal:
        read_ssp(path)
    sentence = str(refusal.value)
    assert sentence.startswith(str(path))
    assert "cache" not in sentence
    assert "\n" not in sentence


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (connector("w", "output"), r"no connected variable 'drive\.w'"),
        (connector("M", "output"), r"'drive\.M' has causality 'parameter'"),
    ],
)
def test_what_the_fmus_know_is_checked_when_the_system_is_made(package: Maker, wrong: str, message: str) -> None:
    part = element("Component", "drive", wrong, source="resources/Drive.fmu")
    name = wrong.split('"')[1]
    path = package(content(part + controller(), connection(f"drive.{name}", "controller.q")))
    with pytest.raises(InputError, match=message):
        System.read_ssp(path)


def test_a_circle_without_a_component(package: Maker) -> None:
    through = element(
        "System", "inner", connector("i", "input") + connector("o", "output"), content(drive(), connection("i", "o"))
    )
    path = package(content(through, connection("inner.o", "inner.i")))
    with pytest.raises(InputError, match="closes a circle without a component"):
        read_ssp(path)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (None, "SSP file not found"),
        ("text", "not an SSP: no zip archive"),
        ({}, "no SystemStructure.ssd at its top level"),
        ({"SystemStructure.ssd": "<a"}, "SystemStructure.ssd: not well-formed XML"),
        ({"SystemStructure.ssd": "<a version='1.0'/>"}, "SystemStructure.ssd: not a system structure"),
        ({"SystemStructure.ssd": "<SystemStructureDescription version='3.0'/>"}, "SSP 3.0 is not supported"),
        ({"SystemStructure.ssd": "<SystemStructureDescription version='1.0'/>"}, "0 top-level systems"),
        ({"SystemStructure.ssd": "", "../evil": ""}, "'../evil' is outside the archive's folder"),
    ],
)
def test_files_that_are_no_structure(tmp_path: Path, entries: Mapping[str, str] | str | None, message: str) -> None:
    path = tmp_path / "x.ssp"
    if isinstance(entries, str):
        path.write_text(entries)
    elif entries is not None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in entries.items():
                archive.writestr(name, text)
    with pytest.raises(InputError, match=message) as refusal:
        read_ssp(path)
    assert str(refusal.value).startswith(str(path))


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
