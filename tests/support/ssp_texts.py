"""Texts of small system structures, and the packages made of them."""

# ruff: noqa: E501  # the model description reads best one variable a line

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

from fmpy.ssp import ssd as fmpy_ssd

from tests.support.paths import FMUS

DRIVE, CONTROLLER = (FMUS / name / f"{name}.fmu" for name in ("PositionDrive", "PositionController"))
ROOT = "http://ssp-standard.org/SSP1/SystemStructure"
SPACES = " ".join(
    f'xmlns:{short}="{ROOT}{name}"'
    for short, name in (
        ("ssd", "Description"),
        ("ssc", "Common"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
        ("ssb", "SignalDictionary"),
    )
)


def connector(name: str, kind: str, unit: str = "", of: str = "Real") -> str:
    stated = f' unit="{unit}"' if unit else ""
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:{of}{stated}/></ssd:Connector>'


def element(tag: str, name: str, connectors: str, body: str = "", bindings: str = "", **attributes: str) -> str:
    said = "".join(f' {key}="{value}"' for key, value in attributes.items())
    ports = f"<ssd:Connectors>{connectors}</ssd:Connectors>" if connectors else ""
    bound = f"<ssd:ParameterBindings>{bindings}</ssd:ParameterBindings>" if bindings else ""
    return f'<ssd:{tag} name="{name}"{said}>{ports}{bound}{body}</ssd:{tag}>'


def drive(name: str = "drive", unit: str = "", bindings: str = "", more: str = "", **attributes: str) -> str:
    ports = connector("v", "input") + connector("q", "output", unit) + connector("dq", "output")
    ports += connector("M", "parameter") + connector("q_start", "parameter") + more
    return element("Component", name, ports, bindings=bindings, **{"source": "resources/Drive.fmu", **attributes})


def controller(name: str = "controller", unit: str = "", bindings: str = "") -> str:
    ports = connector("qg", "input") + connector("q", "input", unit) + connector("dq", "input")
    ports += connector("v", "output") + connector("kp", "parameter")
    return element("Component", name, ports, bindings=bindings, source="resources/Controller.fmu")


def connection(start: str, end: str, inside: str = "", suppress: bool = False) -> str:
    """Return a connection between ``element.connector`` or just ``connector`` of the system itself."""
    said = ""
    for which, text in (("start", start), ("end", end)):
        owner, _, name = text.rpartition(".")
        said += (f' {which}Element="{owner}"' if owner else "") + f' {which}Connector="{name}"'
    said += ' suppressUnitConversion="true"' if suppress else ""
    return f"<ssd:Connection{said}>{inside}</ssd:Connection>"


def content(elements: str, connections: str = "", dictionaries: str = "") -> str:
    joined = f"<ssd:Connections>{connections}</ssd:Connections>" if connections else ""
    known = f"<ssd:SignalDictionaries>{dictionaries}</ssd:SignalDictionaries>" if dictionaries else ""
    return f"<ssd:Elements>{elements}</ssd:Elements>{joined}{known}"


def linear(factor: float, offset: float = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def parameter(name: str, value: object, kind: str = "Real", /, **attributes: str) -> str:
    said = "".join(f' {key}="{text}"' for key, text in attributes.items())
    return f'<ssv:Parameter name="{name}"><ssv:{kind} value="{value}"{said}/></ssv:Parameter>'


def parameter_set(parameters: str, rest: str = "", spaces: str = "") -> str:
    head = f'<ssv:ParameterSet{spaces} version="1.0" name="values">'
    return f"{head}<ssv:Parameters>{parameters}</ssv:Parameters>{rest}</ssv:ParameterSet>"


def binding(parameters: str, mapping: str = "", rest: str = "", **attributes: str) -> str:
    said = "".join(f' {key}="{value}"' for key, value in attributes.items())
    values = f"<ssd:ParameterValues>{parameter_set(parameters, rest)}</ssd:ParameterValues>" if parameters else ""
    return f"<ssd:ParameterBinding{said}>{values}{mapping}</ssd:ParameterBinding>"


def mapping(*entries: tuple[str, str, str]) -> str:
    listed = "".join(
        f'<ssm:MappingEntry source="{a}" target="{b}">{inside}</ssm:MappingEntry>' for a, b, inside in entries
    )
    content = f'<ssm:ParameterMapping version="1.0">{listed}</ssm:ParameterMapping>'
    return f"<ssd:ParameterMapping>{content}</ssd:ParameterMapping>"


def units(**factors: tuple[str, float, float]) -> str:
    """Return definitions of units: name -> (base attribute, factor, offset)."""
    listed = "".join(
        f'<ssc:Unit name="{name}"><ssc:BaseUnit {base}="1" factor="{factor}" offset="{offset}"/></ssc:Unit>'
        for name, (base, factor, offset) in factors.items()
    )
    return f"<ssd:Units>{listed}</ssd:Units>"


def in_ssv(definitions: str) -> str:
    """Return definitions of units as an SSV file has them."""
    return definitions.replace("ssd:Units", "ssv:Units")


LENGTHS = units(m=("m", 1.0, 0.0), mm=("m", 1e-3, 0.0), V=("A", 1.0, 0.0))
LOOP = connection("drive.q", "controller.q") + connection("drive.dq", "controller.dq")
LOOP += connection("controller.v", "drive.v")
Maker = Callable[..., Path]


def pack(
    folder: Path,
    body: str,
    connectors: str = "",
    bindings: str = "",
    rest: str = "",
    version: str = "1.0",
    files: Mapping[str, str] | None = None,
    check: bool = True,
) -> Path:
    """Pack a top system, drive, controller and files; where asked, FMPy's schemas check the structure."""
    path = folder / "loop.ssp"
    system = element("System", "top", connectors, body, bindings)
    text = f'<ssd:SystemStructureDescription {SPACES} version="{version}" name="loop">{system}{rest}'
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", text + "</ssd:SystemStructureDescription>")
        archive.write(DRIVE, "resources/Drive.fmu")
        archive.write(CONTROLLER, "resources/Controller.fmu")
        for name, inside in (files or {}).items():
            archive.writestr(name, inside)
    if check:
        fmpy_ssd.read_ssd(str(path), validate=True)
    return path


TYPES = """<fmiModelDescription fmiVersion="2.0" modelName="Types" guid="g"><CoSimulation modelIdentifier="t"/>
<ModelVariables>
<ScalarVariable name="r" valueReference="0" causality="parameter" variability="fixed"><Real start="0"/></ScalarVariable>
<ScalarVariable name="n" valueReference="0" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="b" valueReference="0" causality="parameter" variability="fixed"><Boolean start="false"/></ScalarVariable>
<ScalarVariable name="s" valueReference="0" causality="parameter" variability="fixed"><String start=""/></ScalarVariable>
</ModelVariables><ModelStructure/></fmiModelDescription>"""
MODES = '<{0}:Enumerations><ssc:Enumeration name="Mode"><ssc:Item name="off" value="0"/><ssc:Item name="on" value="7"/>'
MODES += "</ssc:Enumeration></{0}:Enumerations>"


def table(kind: str, **entries: object) -> str:
    rows = "".join(f'<ssc:MapEntry source="{a.strip("_")}" target="{b}"/>' for a, b in entries.items())
    return f"<ssc:{kind}MappingTransformation>{rows}</ssc:{kind}MappingTransformation>"


def add_types(path: Path, folder: Path, text: str = TYPES) -> Path:
    with zipfile.ZipFile(folder / "types.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", text)
    with zipfile.ZipFile(path, "a") as archive:
        archive.write(folder / "types.fmu", "types.fmu")
    return path
