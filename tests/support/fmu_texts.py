"""Model descriptions of FMUs of both versions without binaries, for what is told of an FMU without loading it."""

# ruff: noqa: E501  # the model descriptions read best one variable a line

import zipfile
from pathlib import Path

FMI2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Motor" guid="motor" description="Motor: two windings" generationTool="a tool" numberOfEventIndicators="3">
<ModelExchange modelIdentifier="motor" providesDirectionalDerivative="true"/>
<UnitDefinitions>
<Unit name="rad/s"><BaseUnit s="-1" rad="1"/><DisplayUnit name="rpm" factor="9.549296585513721"/></Unit>
<Unit name="krad/s"><BaseUnit s="-1" rad="1" factor="1000"/></Unit>
<Unit name="Hz"><BaseUnit s="-1"/></Unit>
<Unit name="A"><BaseUnit A="1"/></Unit>
<Unit name="lap"/><Unit name="turn"/>
</UnitDefinitions>
<ModelVariables>
<ScalarVariable name="R" valueReference="0" causality="parameter" variability="tunable" description="resistance&#10;at  20 degrees"><Real start="2" min="0" max="1e100"/></ScalarVariable>
<ScalarVariable name="L" valueReference="1" causality="parameter" variability="fixed"><Real start="0.1" min="0.1" max="0.1"/></ScalarVariable>
<ScalarVariable name="J" valueReference="2" causality="parameter" variability="fixed"><Real start="0" min="1" max="2"/></ScalarVariable>
<ScalarVariable name="poles" valueReference="3" causality="parameter" variability="fixed"><Integer start="4"/></ScalarVariable>
<ScalarVariable name="tau" valueReference="4" causality="calculatedParameter" variability="fixed"><Real/></ScalarVariable>
<ScalarVariable name="half" valueReference="5" causality="local" variability="fixed"><Real/></ScalarVariable>
<ScalarVariable name="u" valueReference="6" causality="input" variability="continuous"><Real start="0"/></ScalarVariable>
<ScalarVariable name="on" valueReference="7" causality="input" variability="discrete"><Boolean start="true"/></ScalarVariable>
<ScalarVariable name="word" valueReference="8" causality="input" variability="discrete"><String start="go"/></ScalarVariable>
<ScalarVariable name="i" valueReference="9" causality="output" variability="continuous" initial="exact"><Real start="0" unit="A"/></ScalarVariable>
<ScalarVariable name="w" valueReference="10" causality="output" variability="continuous"><Real unit="rad/s"/></ScalarVariable>
<ScalarVariable name="torque" valueReference="11" causality="output" variability="continuous"><Real unit="lap"/></ScalarVariable>
<ScalarVariable name="angle" valueReference="12" causality="local" variability="continuous" initial="approx"><Real start="0.5"/></ScalarVariable>
<ScalarVariable name="guess" valueReference="13" causality="local" variability="continuous" initial="approx"><Real start="1"/></ScalarVariable>
<ScalarVariable name="der(angle)" valueReference="14" causality="local" variability="continuous"><Real derivative="13"/></ScalarVariable>
<ScalarVariable name="heat" valueReference="15" causality="local" variability="continuous"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="10" dependencies=""/><Unknown index="11" dependencies="7 13"/><Unknown index="12"/></Outputs>
<Derivatives><Unknown index="15"/></Derivatives>
</ModelStructure>
</fmiModelDescription>"""

FMI3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Linear" instantiationToken="linear">
<ModelExchange modelIdentifier="linear" needsCompletedIntegratorStep="true" providesAdjointDerivatives="true"/>
<CoSimulation modelIdentifier="linear" hasEventMode="true" canReturnEarlyAfterIntermediateUpdate="1" fixedInternalStepSize="0.01" maxOutputDerivativeOrder="2" canHandleVariableCommunicationStepSize="false"/>
<ScheduledExecution modelIdentifier="linear"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="2"/>
<Float64 name="length" valueReference="6" causality="structuralParameter" variability="fixed" start="0.5"/>
<Float64 name="A" valueReference="2" causality="parameter" variability="tunable" start="1 2 3 4 5 6"><Dimension start="2"/><Dimension start="3"/></Float64>
<Float64 name="b" valueReference="3" causality="parameter" variability="fixed" start="7 8"><Dimension start="2"/></Float64>
<Float64 name="u" valueReference="4" causality="input" variability="continuous" start="0 0"><Dimension start="2"/></Float64>
<Float64 name="y" valueReference="5" causality="output" variability="continuous"><Dimension start="5"/></Float64>
</ModelVariables>
<ModelStructure><Output valueReference="5" dependencies="4"/></ModelStructure>
</fmiModelDescription>"""


def write_fmu(path: Path, text: str | bytes, *files: str) -> Path:
    """Write an FMU of a model description and empty files."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        for name in files:
            archive.writestr(name, b"")
    return path


FMI_3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="M" instantiationToken="t">
<CoSimulation modelIdentifier="M"/>
<ModelVariables>
  <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
  <Float64 name="R" valueReference="1" causality="parameter" variability="fixed" start="4"/>
  <UInt64 name="n" valueReference="2" causality="structuralParameter" variability="fixed" start="3"/>
  <Float64 name="A" valueReference="3" causality="parameter" variability="fixed" start="1  2 3
    4 5 6"><Dimension start="2"/><Dimension valueReference="2"/></Float64>
  <Float32 name="B" valueReference="4" causality="parameter" variability="fixed" start="9"><Dimension start="3"/></Float32>
  <Int8 name="k" valueReference="5" causality="parameter" variability="fixed" start="-1"/>
</ModelVariables>
<ModelStructure/>
</fmiModelDescription>
"""
