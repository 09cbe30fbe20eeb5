"""Model description (modelDescription.xml) of FMI 2.0 and 3.0."""

from __future__ import annotations

from collections.abc import Iterable

from fmuid.export.explicit_model import ExplicitModel
from fmuid.export.variables import (
    DescribedVariable,
    Unknown,
    attribute,
    indicators,
    unit_definitions,
    unknowns,
    variables,
)

_HEAD = '<?xml version="1.0" encoding="UTF-8"?>'


def description(system: ExplicitModel, guid: str, fmi: str) -> str:
    """Return modelDescription.xml; the `guid` is that of the binary."""
    return "\n".join([_HEAD, *(_fmi2 if fmi == "2.0" else _fmi3)(system, guid), "</fmiModelDescription>", ""])


def build_description(model: str, source: str) -> str:
    """Return buildDescription.xml of FMI 3.0."""
    return "\n".join(
        [
            _HEAD,
            '<fmiBuildDescription fmiVersion="3.0">',
            f'  <BuildConfiguration modelIdentifier="{model}">',
            f'    <SourceFileSet language="C99"><SourceFile name="{source}"/></SourceFileSet>',
            "  </BuildConfiguration>",
            "</fmiBuildDescription>",
            "",
        ]
    )


def _fmi2(system: ExplicitModel, guid: str) -> list[str]:
    model, found, dependent = system.model, variables(system), unknowns(system)
    index = {each.name: k for k, each in enumerate(found, start=1)}
    capabilities = (
        f'modelIdentifier="{model.name}" canNotUseMemoryManagementFunctions="true" canGetAndSetFMUstate="true" '
        'canSerializeFMUstate="true" providesDirectionalDerivative="true"'
    )
    sources = '<SourceFiles><File name="fmi2.c"/></SourceFiles>'
    return [
        f'<fmiModelDescription fmiVersion="2.0" modelName="{model.name}" guid="{guid}"'
        f"{attribute('description', model.description)}"
        ' generationTool="fmuid" variableNamingConvention="structured"'
        f' numberOfEventIndicators="{len(system.indicator_names())}">',
        f'<ModelExchange {capabilities} completedIntegratorStepNotNeeded="true">{sources}</ModelExchange>',
        f'<CoSimulation {capabilities} canHandleVariableCommunicationStepSize="true"'
        f' canInterpolateInputs="true">{sources}</CoSimulation>',
        *unit_definitions(system),
        *_common(system),
        "<ModelVariables>",
        *(f"  <ScalarVariable {_described(each)}><Real{_real(each, index)}/></ScalarVariable>" for each in found),
        "</ModelVariables>",
        "<ModelStructure>",
        *_section("Outputs", dependent["outputs"], index),
        *_section("Derivatives", dependent["derivatives"], index),
        *_section("InitialUnknowns", dependent["initial"], index),
        "</ModelStructure>",
    ]


def _common(system: ExplicitModel) -> list[str]:
    model = system.model
    stop = attribute("stopTime", model.stop_time)
    return [
        '<LogCategories><Category name="logStatusError" description="why a call failed"/></LogCategories>',
        f'<DefaultExperiment startTime="0.0"{stop} stepSize="{model.step!r}"/>',
    ]


def _described(variable: DescribedVariable) -> str:
    """Return the attributes of a variable common to both versions."""
    return (
        f'name="{variable.name}" valueReference="{variable.reference}"'
        f'{attribute("description", variable.description)} causality="{variable.causality}"'
        f' variability="{variable.variability}"{attribute("initial", variable.initial)}'
    )


def _real(variable: DescribedVariable, numbers: dict[str, int]) -> str:
    """Return the attributes of a number; states are known by `numbers`."""
    derivative = attribute("derivative", str(numbers[variable.state]) if variable.state else None)
    return "".join(attribute(*each) for each in variable.attributes) + derivative


def _section(name: str, found: list[Unknown], index: dict[str, int]) -> list[str]:
    """Return a section of FMI 2.0's ModelStructure; `index` counts from 1."""
    lines = [f'    <Unknown index="{index[each.name]}" dependencies="{_numbers(each, index)}"/>' for each in found]
    return [f"  <{name}>", *lines, f"  </{name}>"] if lines else []


def _numbers(unknown: Unknown, numbers: dict[str, int]) -> str:
    return " ".join(map(str, sorted(numbers[name] for name in unknown.dependencies if name in numbers)))


def _fmi3(system: ExplicitModel, guid: str) -> list[str]:
    model, dependent = system.model, unknowns(system)
    time = DescribedVariable("time", len(system.names()) - 1, "independent", "simulation time")
    found = [*variables(system), *indicators(system), time]
    references = {each.name: each.reference for each in found}
    capabilities = (
        f'modelIdentifier="{model.name}" canGetAndSetFMUState="true" canSerializeFMUState="true" '
        'providesDirectionalDerivatives="true"'
    )
    structure: Iterable[tuple[str, str]] = (
        ("Output", "outputs"),
        ("ContinuousStateDerivative", "derivatives"),
        ("InitialUnknown", "initial"),
        ("EventIndicator", "indicators"),
    )
    return [
        f'<fmiModelDescription fmiVersion="3.0" modelName="{model.name}" instantiationToken="{guid}"'
        f"{attribute('description', model.description)}"
        ' generationTool="fmuid" variableNamingConvention="structured">',
        f"<ModelExchange {capabilities}/>",
        f'<CoSimulation {capabilities} canHandleVariableCommunicationStepSize="true"'
        ' canReturnEarlyAfterIntermediateUpdate="false" mightReturnEarlyFromDoStep="false" hasEventMode="false"/>',
        *unit_definitions(system),
        *_common(system),
        "<ModelVariables>",
        *(f"  <Float64 {_described(each)}{_real(each, references)}/>" for each in found),
        "</ModelVariables>",
        "<ModelStructure>",
        *(
            f'  <{element} valueReference="{references[each.name]}" dependencies="{_numbers(each, references)}"/>'
            for element, kind in structure
            for each in dependent[kind]
        ),
        "</ModelStructure>",
    ]
