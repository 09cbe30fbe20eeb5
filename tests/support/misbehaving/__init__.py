"""The misbehaving FMU of misbehaving.c: a first-order lag that takes its process down, or ties it up, when told to."""

from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fmuid.processes.channel import MARK
from tests.support.compiled import real, write_fmu

HERE = Path(__file__).parent
START_VALUES = {"gain": 1.0, "T": 1.0, "mode": 0.0, "at": 0.0, "bad_from": -1e300, "bad_to": 1e300} | {
    "where": 0.0,
    "amount": 4.0,
}

RELEASED = "FMUID_TEST_RELEASED"
"""Environment variable: the file with the number that `Mode.WAIT` waits for."""


class Mode(IntEnum):
    """What the FMU does where `mode` rounds to it; the C source is compiled with these."""

    SOUND = 0
    SEGFAULT = 1
    ABORT = 2
    ILLEGAL = 3  # instruction
    DIVISION = 4  # by zero: SIGFPE
    KILL = 5
    EXIT_0 = 6
    EXIT_3 = 7
    DOUBLE_FREE = 8
    STACK = 9  # overflows
    CLOSE = 10  # closes all files of its process
    LOOP = 11
    SLEEP = 12
    STUBBORN = 13  # loops with all signals blocked
    STOP = 14  # SIGSTOP
    RUNAWAY = 15  # takes memory without end, within one step
    RETURN_ERROR = 16
    RETURN_FATAL = 17
    RETURN_DISCARD = 18
    RETURN_NONSENSE = 19
    NOT_A_NUMBER = 20  # in steps only
    SLOW = 21  # `amount` ms in every step
    LEAK = 22  # `amount` MB in every step
    LEAK_ONCE = 23  # `amount` MB a simulation; this and what follows in one step only
    SPEAK = 24  # a line on stdout and on stderr
    MUTTER = 25  # the same without the ends of the lines
    CHATTER = 26  # `amount` MB on each
    LATER = 27  # ended by SIGALRM a second later
    SPAWN = 28  # forks a process that sleeps
    ESCAPE = 29  # the same in a session of its own and as a grandchild, whose parent has ended
    LIMIT = 30  # allows its process no more memory
    GARBLE = 31  # writes into all sockets of its process and sleeps
    SHARE = 32  # takes shared memory without end
    BROOD = 33  # the same by four children, each less than half
    ROUND_UPWARD = 34  # its thread rounds up from then on
    FLUSH = 35  # its thread takes denormal numbers for zero from then on, as code linked with -ffast-math does
    TRAP = 36  # a division by zero raises SIGFPE in its thread from then on
    LESS_PRECISE = 37  # x87 calculates its thread's long doubles with 53 bits from then on
    RETURN_TWICE = 38  # forks, and its child returns as well, `amount` ms later
    FORGE = 39  # writes the beginning of a message of 2^56 parts into all sockets of its process, and sleeps
    STOP_PARENT = 40  # SIGSTOP to the process that has forked its own
    WAIT = 41  # until the number in the file that `RELEASED` names is at least `amount`


class Where(IntEnum):
    """The call in which the FMU misbehaves: the steps from `at` on, or another one."""

    STEP = 0
    INITIALIZATION = 1
    RESET = 2
    FREEING = 3
    GETTING = 4


def misbehaving_fmu(
    folder: Path,
    *,
    token: str = "lag",
    version: int = 2,
    at_loading: Mode | None = None,
    tool: str = "",
    extra: int = 0,
    **attributes: str,
) -> Path:
    """Write the FMU into a folder where it is not there yet; return its path.

    Token ``at-instantiation-<mode>``: it misbehaves when instantiated; ``shared``: one state for all instances;
    ``alone``: it survives neither threads nor both interfaces nor that some instances are freed. `extra` parameters do
    nothing, `attributes` are those of <CoSimulation>.
    """
    words = [token, tool, *(f"{name}={value}" for name, value in attributes.items())]
    words += ([] if at_loading is None else [at_loading.name]) + ([str(extra)] if extra else [])
    path = folder / f"misbehaving{version}-{'-'.join(words)}.fmu"
    said = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    text = _description2(token, tool, said, extra) if version == 2 else _description3(token, tool, said)
    flags = ["-fno-sanitize=undefined", f"-DFMI={version}", f"-DMODES={','.join(mode.name for mode in Mode)}"]
    flags += [f"-DMARK={','.join(map(str, MARK))}", f'-DRELEASED="{RELEASED}"']
    flags += [] if at_loading is None else [f"-DAT_LOADING={at_loading.name}"]
    return write_fmu(path, text, HERE / "misbehaving.c", *flags, version=version)


def lag(times: NDArray[np.float64], u: NDArray[np.float64], gain: float, T: float) -> NDArray[np.float64]:
    """Return the state of T x' = gain u - x at the times (K,) for an input that is held: its closed form."""
    x = np.zeros(times.size)
    for k, h in enumerate(np.diff(times)):
        x[k + 1] = gain * u[k] + (x[k] - gain * u[k]) * np.exp(-h / T)
    return x


def _description2(token: str, tool: str, said: str, extra: int) -> str:
    starts = [(name, i, start) for i, (name, start) in enumerate(START_VALUES.items())]
    lines = [real(name, i, "parameter", "tunable", f'start="{start!r}"') for name, i, start in starts]
    lines += [real("u", 8, "input", said='start="0"'), real("x", 9, "output", said='initial="exact"|start="0"')]
    lines += [real("der(x)", 10, said='derivative="10"')]
    lines += [real(f"group{i // 100}.p{i}", 100 + i, "parameter", "tunable", 'start="1"') for i in range(extra)]
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="Misbehaving" '
        f'guid="{token}" generationTool="{tool}" numberOfEventIndicators="0">'
        f'<ModelExchange modelIdentifier="misbehaving" {said}/>'
        f'<CoSimulation modelIdentifier="misbehaving" canHandleVariableCommunicationStepSize="true" {said}/>'
        f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure>"
        '<Outputs><Unknown index="10" dependencies=""/></Outputs><Derivatives><Unknown index="11"/></Derivatives>'
        "</ModelStructure></fmiModelDescription>"
    )


def _description3(token: str, tool: str, said: str) -> str:
    lines = [
        f'<Float64 name="{name}" valueReference="{i}" causality="parameter" variability="tunable" start="{start!r}"/>'
        for i, (name, start) in enumerate(START_VALUES.items())
    ]
    lines += [
        '<Float64 name="u" valueReference="8" causality="input" start="0"/>',
        '<Float64 name="x" valueReference="9" causality="output" initial="exact" start="0"/>',
        '<Float64 name="der(x)" valueReference="10" causality="local" derivative="9"/>',
    ]
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="Misbehaving" '
        f'instantiationToken="{token}" generationTool="{tool}"><ModelExchange modelIdentifier="misbehaving" {said}/>'
        f'<CoSimulation modelIdentifier="misbehaving" canHandleVariableCommunicationStepSize="true" {said}/>'
        f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure>"
        '<Output valueReference="9" dependencies=""/><ContinuousStateDerivative valueReference="10"/>'
        "</ModelStructure></fmiModelDescription>"
    )
