"""The models of probe/stepping.c as FMUs, whose co-simulation integrates in a plain way."""

from pathlib import Path

from tests.support.compiled import real, write_fmu
from tests.support.paths import HERE

LAG, MOTOR = ("lag", ("x",), ("k",)), ("motor", ("i", "w"), ("R", "L", "K", "J", "F"))
"""x' = u − k x, and L i' = u − R i − K w, J w' = K i − F w: name, states, parameters."""
Model = tuple[str, tuple[str, ...], tuple[str, ...]]
# Value references, as in probe/stepping.c.
X, DX, U, P = 0, 2, 4, 5


def stepping_fmu(
    folder: Path,
    model: Model,
    *,
    order: int = 1,
    internal: float = 0.0,
    exchange: bool = False,
    told: bool = True,
    memory: float = 0.0,
    seed: str = "0",
    least: float = 0.0,
) -> Path:
    """Return an FMU of a model: explicit Euler (order 1) or Runge–Kutta (4) inside, in `internal` steps, s, of its own.

    `exchange`: it offers Model Exchange; `told`: its description names the states. `memory` is added to the input after
    each simulation in the process, `seed` times in the first. Communication steps shorter than `least`, s, fail.
    """
    name, states, parameters = model
    path = folder / f"{name}{order}-{internal:g}-{exchange}-{told}-{memory:g}-{len(seed)}-{least:g}.fmu"
    lines = [real(x, X + i, "output", said='initial="exact"|start="0"') for i, x in enumerate(states)]
    known = [f'derivative="{i + 1}"' if told else "" for i in range(len(states))]
    lines += [real(f"der({x})", DX + i, said=known[i]) for i, x in enumerate(states)]
    lines.append(real("u", U, "input", said='start="0"'))
    lines += [real(p, P + i, "parameter", "fixed", 'start="1"') for i, p in enumerate(parameters)]
    unknowns = [f'<Unknown index="{i + 1}"/>' for i in range(2 * len(states))]
    derivatives = f"<Derivatives>{''.join(unknowns[len(states) :])}</Derivatives>" if told else ""
    interfaces = ['<CoSimulation modelIdentifier="stepping" canHandleVariableCommunicationStepSize="true"/>']
    interfaces = ['<ModelExchange modelIdentifier="stepping"/>'] * exchange + interfaces
    text = (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name}">'
        f"{''.join(interfaces)}<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure><Outputs>"
        f"{''.join(unknowns[: len(states)])}</Outputs>{derivatives}</ModelStructure></fmiModelDescription>"
    )
    defines = [f"-DMODEL={name.upper()}", f"-DORDER={order}", f"-DINTERNAL={internal!r}", f"-DLEAST={least!r}"]
    defines += [f"-DMEMORY={memory!r}", f"-DSEED={seed}"] * (memory != 0.0)
    return write_fmu(path, text, HERE / "probe" / "stepping.c", *defines)
