"""Model descriptions: read as FMPy reads them; start values are replaced, and nothing else."""

# ruff: noqa: E501  # the model descriptions read best one variable a line
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from fmpy import read_model_description

from fmuid import InputError
from fmuid.models import Description, read_description, with_starts
from fmuid.models.description import SI_BASE_UNITS
from tests.support.fmu_texts import FMI2, FMI3, FMI_3, write_fmu
from tests.support.paths import FMUS
from tests.support.quick import first

KINDS = {2: ("Real", "Integer", "Enumeration", "Boolean", "String"), 3: ("Float64", "UInt8", "Enumeration", "Clock")}
CAUSALITIES = (
    None,
    *["parameter", "calculatedParameter", "input", "output", "local", "independent", "structuralParameter"],
)
VARIABILITIES = (None, *["constant", "fixed", "tunable", "discrete", "continuous"])

TYPED_2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Typed" guid="t" numberOfEventIndicators="2" description="d" generationTool="g">
<ModelExchange modelIdentifier="typed" completedIntegratorStepNotNeeded="true" needsExecutionTool="1"/>
<CoSimulation modelIdentifier="typed" canBeInstantiatedOnlyOncePerProcess="false" canInterpolateInputs="true"/>
<UnitDefinitions><Unit name="K"><BaseUnit K="1" offset="2"/><DisplayUnit name="degC" factor="1" offset="-273.15"/></Unit><Unit name="?"/>
</UnitDefinitions>
<TypeDefinitions>
<SimpleType name="Temperature"><Real unit="K" min="0" max="1e3" nominal="300"/></SimpleType>
<SimpleType name="Gear"><Enumeration min="1" max="2"><Item name="low" value="1"/><Item name="high" value="2"/></Enumeration></SimpleType>
</TypeDefinitions>
<DefaultExperiment startTime="1" stopTime="2.5" stepSize="1e-3"/>
<ModelVariables>
<!-- no variable --><ScalarVariable valueReference="9"><Real/></ScalarVariable>
<ScalarVariable name="T" valueReference="0" causality="output"><Annotations><Tool name="x"/></Annotations><Real declaredType="Temperature" max="500"/></ScalarVariable>
<ScalarVariable name="der(T)" valueReference="1"><Real derivative="1" unit=""/></ScalarVariable>
<ScalarVariable name="gear" valueReference="2" causality="parameter" variability="fixed"><Enumeration declaredType="Gear" start="2"/></ScalarVariable>
<ScalarVariable name="on" valueReference="3" causality="input" variability="discrete"><Boolean start="1"/></ScalarVariable>
<ScalarVariable name="word" valueReference="4" causality="input" variability="discrete" description="&lt;two  lines&#10;"><String start=""/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="1" dependencies="4 5"/></Outputs><Derivatives><Unknown index="2"/></Derivatives></ModelStructure>
</fmiModelDescription>"""

TYPED_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0.2" modelName="Typed" instantiationToken="t">
<CoSimulation modelIdentifier="typed" hasEventMode="true" canHandleVariableCommunicationStepSize="1"/>
<ModelExchange modelIdentifier="typed" canBeInstantiatedOnlyOncePerProcess="true"/>
<TypeDefinitions><Float64Type name="Length" unit="m" min="0"/><EnumerationType name="Gear"><Item name="low" value="1"/></EnumerationType>
</TypeDefinitions>
<ModelVariables>
<Float64 name="x" valueReference="7" declaredType="Length" start="1 2"><Dimension start="2"/><Alias name="same" description="other"/><Alias name="again"/></Float64>
<Float64 name="der(x)" valueReference="8" derivative="7"><Dimension valueReference="3"/></Float64>
<UInt64 name="n" valueReference="3" causality="structuralParameter" start="2"/>
<Float64 name="z" valueReference="9" causality="output"><Dimension start="2"/><Dimension start="3"/></Float64>
<Enumeration name="gear" valueReference="4" declaredType="Gear" causality="parameter" start="1"/>
<String name="word" valueReference="5" causality="parameter"><Start value="go on"/></String>
<Binary name="raw" valueReference="6" causality="parameter"><Start value="00ff"/></Binary>
<Clock name="tick" valueReference="1" causality="input" intervalVariability="triggered"/>
</ModelVariables>
<ModelStructure><Output valueReference="9" dependencies="7 3"/><ContinuousStateDerivative valueReference="8" dependencies=""/>
<EventIndicator valueReference="9"/></ModelStructure>
</fmiModelDescription>"""


def elements(variable: Any) -> list[str]:
    """Return the names of all that a variable of FMPy stands for."""
    subscripts = itertools.product(*(range(1, size + 1) for size in variable.shape or ()))
    return [variable.name + (f"[{','.join(map(str, each))}]" if each else "") for each in subscripts]


def by_fmpy(path: Path) -> dict[str, Any]:
    """Return what FMPy reads, in our words."""
    read = read_model_description(str(path), validate=False)
    units = {unit.name: unit for unit in read.unitDefinitions}
    return {
        "variables": [
            (name, v.valueReference, v.causality, v.variability, v.initial)
            for v in read.modelVariables
            for name in elements(v)
        ],
        "units": {
            name: (unit.baseUnit and tuple(getattr(unit.baseUnit, si) for si in SI_BASE_UNITS))
            for name, unit in units.items()
        },
        "factors": [(d.name, d.factor, d.offset) for unit in units.values() for d in unit.displayUnits],
        "derivatives": [name for u in read.derivatives for name in elements(u.variable)],
        "states": [name for u in read.derivatives for name in elements(u.variable.derivative)],
        "dependencies": {
            name: None if u.dependencies is None else tuple(n for v in u.dependencies for n in elements(v))
            for u in read.outputs
            for name in elements(u.variable)
        },
        "indicators": read.numberOfEventIndicators,
        "experiment": [
            float(text)
            for word in ("startTime", "stopTime", "tolerance", "stepSize")
            if (text := getattr(read.defaultExperiment, word, None)) is not None
        ],
        "root": (read.modelName, read.fmiVersion, read.guid, read.description or "", read.generationTool or ""),
        "interfaces": {
            kind: (each.modelIdentifier, each.needsExecutionTool, each.canBeInstantiatedOnlyOncePerProcess)
            for kind, each in (("co-simulation", read.coSimulation), ("model-exchange", read.modelExchange))
            if each is not None
        },
    }


def as_read(found: Description) -> dict[str, Any]:
    """Return the same of our reading."""
    return {
        "variables": [
            (name, v.reference, v.causality, v.variability, v.initial) for name, v in found.variables.items()
        ],
        "units": {name: unit.exponents for name, unit in found.units.items()},
        "factors": [(name, *linear) for unit in found.units.values() for name, linear in unit.display_units.items()],
        "derivatives": list(found.derivatives),
        "states": list(found.states),
        "dependencies": dict(found.dependencies),
        "indicators": found.indicators,
        "experiment": list(found.default_experiment.values()),
        "root": (found.model_name, found.fmi_version, found.guid, found.description, found.generation_tool),
        "interfaces": {
            kind: (each.identifier, each.needs_execution_tool, each.once_per_process)
            for kind, each in found.interfaces.items()
        },
    }


def compare_values(path: Path, found: Description) -> None:
    """Compare what is in the units of each variable: its own, then those of its declared type."""
    for given in read_model_description(str(path), validate=False).modelVariables:
        names, declared = elements(given), given.declaredType
        if given.type in ("String", "Binary"):
            starts = [given.start]
        else:
            starts = [None if given.start is None else word for word in (given.start or "").split() or [None]]
        for name, start in zip(names, starts if len(starts) == len(names) else starts * len(names), strict=True):
            own = found.variables[name]
            for word in ("min", "max", "nominal", "unit"):
                text = getattr(given, word) or getattr(declared, word, None) or None
                assert getattr(own, word) == (text if word == "unit" or text is None else float(text)), (name, word)
            assert own.description == (given.description or "")
            assert own.array == (tuple(names) if names != [given.name] else ())
            if start is None or own.type in ("String", "Binary"):
                assert own.start == start
            else:
                assert own.start == (start in ("true", "1") if own.type == "Boolean" else float(start))


@pytest.mark.parametrize("path", sorted(FMUS.glob("*/*.fmu")), ids=lambda path: path.stem)
def test_our_fmus_read_as_by_fmpy(path: Path) -> None:
    found = read_description(path)
    assert as_read(found) == by_fmpy(path)
    compare_values(path, found)


@pytest.mark.parametrize("text", [FMI2, FMI3, FMI_3, TYPED_2, TYPED_3], ids=["2", "3", "arrays", "typed2", "typed3"])
def test_written_descriptions_read_as_by_fmpy(tmp_path: Path, text: str) -> None:
    path = write_fmu(tmp_path / "a.fmu", text)
    found = read_description(path)
    assert as_read(found) == by_fmpy(path)
    compare_values(path, found)


@pytest.mark.parametrize("variability", VARIABILITIES)
@pytest.mark.parametrize("causality", CAUSALITIES)
@pytest.mark.parametrize("version", first(1, [3, 2]))
def test_defaults_and_what_they_exclude(
    tmp_path: Path, version: int, causality: str | None, variability: str | None
) -> None:
    """Of the roles that a variable may have, and which go together: a reader refuses what the other refuses."""
    roles = "".join(
        f' {word}="{value}"' for word, value in (("causality", causality), ("variability", variability)) if value
    )
    for kind in KINDS[version]:
        if version == 2:
            text, variable = FMI2, f'<ScalarVariable name="v" valueReference="99"{roles}><{kind}/></ScalarVariable>'
        else:
            text, variable = FMI3, f'<{kind} name="v" valueReference="99"{roles}/>'
        path = write_fmu(tmp_path / "a.fmu", text.replace("</ModelVariables>", f"{variable}</ModelVariables>"))
        try:
            theirs = by_fmpy(path)
        except Exception as error:
            assert "illegal combination" in str(error)
            with pytest.raises(InputError, match=r"'v': FMI does not allow causality .* with variability"):
                read_description(path)
        else:
            assert as_read(read_description(path)) == theirs


FMI_2 = """<?xml version="1.0" encoding="UTF-8"?>
<!-- <ScalarVariable name="a"><Real start="7"/></ScalarVariable> -->
<fmiModelDescription fmiVersion="2.0" modelName="Ä" guid='{g}' generationTool="fmuid">
<CoSimulation modelIdentifier="x"/>
<UnitDefinitions><Unit name="V"><BaseUnit/></Unit></UnitDefinitions>
<ModelVariables>
  <ScalarVariable
      description='start="1" > 0'
      name="a" valueReference="0" causality="parameter" variability="fixed" ><Real
      unit="V" start = '4.0' min="0"
  /></ScalarVariable>
  <!-- b --><ScalarVariable name="b &amp; &quot;c&quot;" valueReference="1" causality="parameter" variability="fixed"><Real/>\t</ScalarVariable>
  <ScalarVariable name="alias" valueReference="0" causality="local"><Real min="0"/></ScalarVariable>
  <ScalarVariable name="n" valueReference="0" causality="parameter" variability="fixed"><Integer start="1"/><Annotations>
    <Tool name="other"><Real start="5"/></Tool></Annotations></ScalarVariable>
  <ScalarVariable name="on" valueReference="0" causality="parameter" variability="fixed"><Boolean start="false"></Boolean></ScalarVariable>
  <ScalarVariable name="x[2]" valueReference="7" causality="parameter" variability="fixed"><Real start="1e-3"/></ScalarVariable>
</ModelVariables><ModelStructure/>
</fmiModelDescription><!-- end -->
"""


def note_2(*names: str) -> str:
    listed = "".join(f"<Start name={name}/>" for name in names)
    return f'<VendorAnnotations><Tool name="fmuid"><Applied>{listed}</Applied></Tool></VendorAnnotations>\n'


def replaced(text: str, *pairs: tuple[str, str]) -> str:
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def applied(folder: Path, text: str | bytes) -> Mapping[str, float | int | bool | str]:
    return read_description(write_fmu(folder / "applied.fmu", text)).applied


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("encoding", ["UTF-8", "utf-8-sig", "ISO-8859-1", "UTF-16"])
def test_only_the_starts_and_the_annotation_change(tmp_path: Path, encoding: str, newline: str) -> None:
    text = FMI_2.replace("\n", newline).replace("UTF-8", encoding.replace("-sig", ""))
    changed = with_starts(text.encode(encoding), {"a": 0.1 + 0.2, "on": True, 'b & "c"': -2e-30, "n": 3.0, "x[2]": 5})
    expected = replaced(
        text,
        ("'4.0'", "'0.30000000000000004'"),
        ("<Real/>", '<Real start="-2e-30"/>'),
        ('<Integer start="1"/>', '<Integer start="3"/>'),
        ('"false"', '"true"'),
        ('"1e-3"', '"5.0"'),
        (
            f"<ModelVariables>{newline}",
            note_2('"a"', '"on"', '"b &amp; &quot;c&quot;"', '"n"', '"x[2]"') + f"<ModelVariables>{newline}",
        ),
    )
    assert changed.decode(encoding) == expected
    assert applied(tmp_path, changed) == {"a": 0.1 + 0.2, "on": True, 'b & "c"': -2e-30, "n": 3, "x[2]": 5.0}


def test_arrays_are_changed_element_by_element(tmp_path: Path) -> None:
    values = {"R": 5.5, "A[2,1]": 40.0, "A[1,3]": 30.0, "B[2]": 0.5, "k": 7.0}
    changed = with_starts(FMI_3.encode(), values).decode()
    listed = "".join(f'<Start name="{name}"/>' for name in values)
    note = f'<Annotations><Annotation type="org.fmuid.applied"><Applied>{listed}</Applied></Annotation></Annotations>\n'
    assert changed == replaced(
        FMI_3,
        ('start="4"', 'start="5.5"'),
        ("1  2 3\n    4 5 6", "1  2 30.0\n    40.0 5 6"),
        ('start="9"', 'start="9 0.5 9"'),
        ('start="-1"', 'start="7"'),
        ("</fmiModelDescription>", note + "</fmiModelDescription>"),
    )
    assert applied(tmp_path, changed) == values


@pytest.mark.parametrize("text", [FMI_2, FMI_3])
def test_what_is_applied_later_joins_what_was_applied_before(tmp_path: Path, text: str) -> None:
    first, second = ("a", "x[2]") if text is FMI_2 else ("R", "B[1]")
    once = with_starts(text.encode(), {first: 1.0})
    twice = with_starts(once, {first: 2.0, second: 3.0})
    assert applied(tmp_path, once) == {first: 1.0}
    assert applied(tmp_path, twice) == {first: 2.0, second: 3.0}
    assert twice == with_starts(text.encode(), {first: 2.0, second: 3.0})


def test_annotations_of_others_stay(tmp_path: Path) -> None:
    theirs = '<VendorAnnotations><Tool name="other"><Start name="a"/></Tool></VendorAnnotations>'
    text = FMI_2.replace("<ModelVariables>", theirs + "<ModelVariables>")
    assert applied(tmp_path, text) == {}
    changed = with_starts(text.encode(), {"x[2]": 2.0})
    own = '<Tool name="fmuid"><Applied><Start name="x[2]"/></Applied></Tool>'
    assert changed.decode() == replaced(
        text, ('"1e-3"', '"2.0"'), ("</VendorAnnotations>", own + "</VendorAnnotations>")
    )
    assert applied(tmp_path, changed) == {"x[2]": 2.0}


@pytest.mark.parametrize(
    ("text", "values", "message"),
    [
        (FMI_2, {"gone": 1.0}, "no scalar variable 'gone'"),
        (FMI_2, {"a[1]": 1.0}, r"no scalar variable 'a\[1\]'"),
        (FMI_2, {"n": 1.5}, "variable 'n': 1.5 is no start value of type Integer"),
        (FMI_2, {"n": True}, "True is no start value of type Integer"),
        (FMI_2, {"a": float("nan")}, "nan is no start value of type Real"),
        (FMI_2, {"n": float("inf")}, "inf is no start value of type Integer"),
        (FMI_2, {"on": 0.5}, "0.5 is no start value of type Boolean"),
        (FMI_3, {"A": 1.0}, "no scalar variable 'A'"),
        (FMI_3, {"A[3,1]": 1.0}, r"no scalar variable 'A\[3,1\]'"),
        (FMI_3, {"A[1]": 1.0}, r"no scalar variable 'A\[1\]'"),
        (FMI_3, {"A[0,1]": 1.0}, r"no scalar variable 'A\[0,1\]'"),
        (FMI_3.replace("4 5 6", "4 5"), {"A[1,1]": 1.0}, "array of 6 elements: start values .* must be one or 6"),
        ("<a", {"a": 1.0}, "not well-formed XML"),
    ],
)
def test_what_cannot_be_written_is_one_sentence(text: str, values: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_starts(text.encode(), values)
