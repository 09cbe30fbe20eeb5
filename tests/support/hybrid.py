"""The models of probe/hybrid.c as whole FMUs, for the tests of what runs them through the master loop."""

from pathlib import Path

from tests.support.compiled import real, write_fmu
from tests.support.paths import HERE

# As in probe/hybrid.c.
MODELS = ("ball", "triangle", "robertson", "van_der_pol", "linear", "chatter", "stairs", "decay", "switch", "threshold")
STATES, INDICATORS = (2, 1, 3, 2, 1, 1, 1, 1, 0, 1), (1, 0, 0, 0, 0, 1, 3, 0, 1, 1)
X, DX, P, U, COUNT, START = 0, 3, 6, 10, 13, 23


def hybrid_fmu(folder: Path, model: str, version: int = 2, attributes: str = "") -> Path:
    """Return an FMU of one model: states x0, ..., parameters p0 ... p3 and start0, ..., inputs u[1] and u[2].

    ``count`` is the number of events. In FMI 3.0 the inputs are an array.
    `attributes` are further ones of <ModelExchange>.
    """
    xml = (_description2 if version == 2 else _description3)(MODELS.index(model), attributes)
    path = folder / f"{model}{version}{abs(hash(attributes))}.fmu"
    return write_fmu(path, xml, HERE / "probe" / "hybrid.c", f"-DFMI={version}", version=version)


PARAMETERS = [(f"p{i}", P + i) for i in range(4)] + [(f"start{i}", START + i) for i in range(3)]


def _description2(number: int, attributes: str) -> str:
    n = STATES[number]
    lines = [real(f"x{i}", X + i, "output", said='initial="calculated"|') for i in range(n)]
    lines += [real(f"der(x{i})", DX + i, said=f'derivative="{i + 1}"') for i in range(n)]
    lines += [real(name, reference, "parameter", "fixed", 'start="0"') for name, reference in PARAMETERS]
    lines += [real(f"u[{i + 1}]", U + i, "input", said='start="0"') for i in range(2)]
    outputs = "".join(f'<Unknown index="{i + 1}" dependencies=""/>' for i in range(n))
    lines.append(real("count", COUNT, variability="discrete"))
    derivatives = "".join(f'<Unknown index="{n + i + 1}"/>' for i in range(n))
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{MODELS[number]}" '
        f'guid="{number}" numberOfEventIndicators="{INDICATORS[number]}"><ModelExchange modelIdentifier="hybrid" '
        f"{attributes}/><ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure><Outputs>{outputs}</Outputs>"
        f"<Derivatives>{derivatives}</Derivatives></ModelStructure></fmiModelDescription>"
    )


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
