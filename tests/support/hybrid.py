"""The models of probe/hybrid.c as whole FMUs, for the tests of what runs them through the master loop."""

from __future__ import annotations

import subprocess
import zipfile
from functools import cache
from pathlib import Path

import fmpy

from fmuid.simulation.native.build import compiler_here
from tests.support.paths import HERE

# As in probe/hybrid.c.
MODELS = ("ball", "triangle", "robertson", "van_der_pol", "linear", "chatter", "stairs", "decay", "switch", "threshold")
STATES, INDICATORS = (2, 1, 3, 2, 1, 1, 1, 1, 0, 1), (1, 0, 0, 0, 0, 1, 3, 0, 1, 1)
X, DX, P, U, COUNT, START = 0, 3, 6, 10, 13, 23


@cache
def _library(folder: Path, version: int) -> bytes:
    headers = Path(fmpy.__file__).parent / "c-code"
    path = folder / f"hybrid{version}{fmpy.sharedLibraryExtension}"
    command = [*compiler_here(), "-O1", "-shared", "-fPIC", f"-I{headers}", f"-DFMI={version}"]
    subprocess.run([*command, "-o", str(path), str(HERE / "probe" / "hybrid.c")], check=True, capture_output=True)
    return path.read_bytes()


def hybrid_fmu(folder: Path, model: str, version: int = 2, attributes: str = "") -> Path:
    """Return an FMU of one model: states x0, ..., parameters p0 ... p3 and start0, ..., inputs u[1] and u[2].

    ``count`` is the number of events. In FMI 3.0 the inputs
    are an array. `attributes` are further ones of <ModelExchange>.
    """
    number = MODELS.index(model)
    path = folder / f"{model}{version}{abs(hash(attributes))}.fmu"
    xml = (_description2 if version == 2 else _description3)(number, attributes)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", xml)
        system = fmpy.platform if version == 2 else fmpy.platform_tuple
        archive.writestr(f"binaries/{system}/hybrid{fmpy.sharedLibraryExtension}", _library(folder, version))
    return path


PARAMETERS = [(f"p{i}", P + i) for i in range(4)] + [(f"start{i}", START + i) for i in range(3)]


def _description2(number: int, attributes: str) -> str:
    n = STATES[number]
    lines = [
        _real2(f"x{i}", X + i, 'causality="output" variability="continuous" initial="calculated"') for i in range(n)
    ]
    lines += [
        _real2(f"der(x{i})", DX + i, 'causality="local" variability="continuous"', f'derivative="{i + 1}"')
        for i in range(n)
    ]
    lines += [
        _real2(name, reference, 'causality="parameter" variability="fixed"', 'start="0"')
        for name, reference in PARAMETERS
    ]
    lines += [_real2(f"u[{i + 1}]", U + i, 'causality="input" variability="continuous"', 'start="0"') for i in range(2)]
    outputs = "".join(f'<Unknown index="{i + 1}" dependencies=""/>' for i in range(n))
    lines.append(_real2("count", COUNT, 'causality="local" variability="discrete"'))
    derivatives = "".join(f'<Unknown index="{n + i + 1}"/>' for i in range(n))
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{MODELS[number]}" '
        f'guid="{number}" numberOfEventIndicators="{INDICATORS[number]}"><ModelExchange modelIdentifier="hybrid" '
        f"{attributes}/><ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure><Outputs>{outputs}</Outputs>"
        f"<Derivatives>{derivatives}</Derivatives></ModelStructure></fmiModelDescription>"
    )


def _real2(name: str, reference: int, said: str, more: str = "") -> str:
    return f'<ScalarVariable name="{name}" valueReference="{reference}" {said}><Real {more}/></ScalarVariable>'


def _description3(number: int, attributes: str) -> str:
    n = STATES[number]
    said = 'causality="output" variability="continuous" initial="calculated"'
    lines = [f'<Float64 name="x{i}" valueReference="{X + i}" {said}/>' for i in range(n)]
    said = 'causality="local" variability="continuous"'
    lines += [f'<Float64 name="der(x{i})" valueReference="{DX + i}" {said} derivative="{X + i}"/>' for i in range(n)]
    lines += [
        f'<Float64 name="{name}" valueReference="{reference}" causality="parameter" variability="fixed" start="0"/>'
        for name, reference in PARAMETERS
    ]
    lines.append(
        f'<Float64 name="u" valueReference="{U}" causality="input" variability="continuous" start="0 0.5">'
        '<Dimension start="2"/></Float64>'
    )
    lines.append(f'<Float64 name="count" valueReference="{COUNT}" causality="local" variability="discrete"/>')
    outputs = "".join(f'<Output valueReference="{X + i}" dependencies=""/>' for i in range(n))
    derivatives = "".join(f'<ContinuousStateDerivative valueReference="{DX + i}"/>' for i in range(n))
    indicators = "".join(f'<EventIndicator valueReference="{P}"/>' for _ in range(INDICATORS[number]))
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="{MODELS[number]}" '
        f'instantiationToken="{number}"><ModelExchange modelIdentifier="hybrid" {attributes}/>'
        f"<ModelVariables>{''.join(lines)}</ModelVariables>"
        f"<ModelStructure>{outputs}{derivatives}{indicators}</ModelStructure></fmiModelDescription>"
    )
