"""The model of probe/choices.c as an FMI 3.0 FMU, with parameters that take few values."""

from pathlib import Path

from tests.support.compiled import write_fmu
from tests.support.paths import HERE

# Value references as in probe/choices.c.
_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Choices" instantiationToken="choices">
<CoSimulation modelIdentifier="choices" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<Float64 name="gain" valueReference="0" causality="parameter" variability="fixed" start="1"/>
<Float64 name="u" valueReference="1" causality="input" variability="continuous" start="0"/>
<Float64 name="x" valueReference="2" causality="output" variability="continuous" initial="exact" start="0"/>
<Int32 name="n" valueReference="3" causality="parameter" variability="fixed" start="1" min="1" max="4"/>
<Boolean name="b" valueReference="4" causality="parameter" variability="fixed" start="false"/>
</ModelVariables>
<ModelStructure><Output valueReference="2" dependencies=""/></ModelStructure>
</fmiModelDescription>"""


def choices_fmu(folder: Path) -> Path:
    """Return the FMU: x' = gain (u + b − n x), n from 1 to 4."""
    return write_fmu(folder / "choices.fmu", _DESCRIPTION, HERE / "probe" / "choices.c", version=3)
