"""Validation of an FMU: FMPy's checks, binaries, trials of each interface."""

from __future__ import annotations

import io
import subprocess
import tempfile
import zipfile
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from fmuid.errors import InputError
from fmuid.models import DESCRIPTION_FILE, FMU, CheckedArchive, parse_xml
from fmuid.processes import Child
from fmuid.simulation.smoke_test import SmokeReport

BUILD_FILE = "sources/buildDescription.xml"
"""How to compile an FMU that has its sources with it (FMI 3.0.2, section 2.5.1.5)."""
TIME_LIMIT = 60.0  # how long the simulations of one try may take, s

# Shares of the default experiment that are simulated, the second where the first takes too long: it tells a model that
# is merely slow from one that hangs.
DURATION_SHARES = (1.0, 0.01)


class Subject(Enum):
    """Subjects of checks; all but the first two are per interface."""

    DESCRIPTION = "model description"
    TOOL = "stands alone"
    BINARY = "binary"
    INSTANTIATION = "instantiation"
    SIMULATION = "simulation"
    RESET = "reset"
    MESSAGES = "messages"


@dataclass(frozen=True)
class Tool:
    """Tool needed to run an FMU; an empty name is undeclared."""

    name: str
    interfaces: tuple[str, ...]


@dataclass(frozen=True)
class Binary:
    """Library of an interface as ``platform/file``, and other platforms."""

    library: str
    others: tuple[str, ...]


@dataclass(frozen=True)
class InterfaceTest:
    """Trial of an interface in a separate process."""

    share: float  # requested fraction of the default experiment
    report: SmokeReport
    code: int | None = 0  # exit code, negative by a signal; None after the time limit
    last_words: str = ""  # last printed line
    limit: float = TIME_LIMIT  # time limit, s

    @property
    def troubled(self) -> bool:
        """Whether an error, a crash or the limit ended it."""
        return self.code != 0 or bool(self.report.error)


@dataclass(frozen=True)
class Check:
    """One check of an FMU."""

    subject: Subject
    interface: str | None
    result: str  # "ok", "warning", "failed" or "left out"
    # `Tool`, `Binary`, each `InterfaceTest`, or messages of FMPy or the FMU
    evidence: tuple[Tool | Binary | InterfaceTest | str, ...] = ()

    @property
    def name(self) -> str:
        """Interface and subject."""
        return f"{self.interface}: {self.subject.value}" if self.interface else self.subject.value


@dataclass(frozen=True)
class Validation:
    """All checks of an FMU (`validate`)."""

    path: Path
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed."""
        return not self.count("failed")

    def count(self, result: str) -> int:
        """Return the number of checks with a result."""
        return sum(check.result == result for check in self.checks)


def validate(fmu: FMU | str | Path) -> Validation:
    """Check an FMU: declarations, binaries, simulations of its interfaces.

    FMPy checks the model description. Each interface is simulated over the default experiment in a separate process:
    a crash or a hang is a failed check.

    Raises
    ------
    InputError
        If it is no FMU of FMI 2.0 or 3.0.

    Examples
    --------
    >>> fmuid.validate(fmuid.datasets.coil().fmu).passed
    True
    """
    fmu = fmu if isinstance(fmu, FMU) else FMU(fmu)
    checks = [_description(fmu)]
    kinds = tuple(kind for kind, interface in fmu.description.interfaces.items() if interface.needs_execution_tool)
    if kinds:
        checks.append(Check(Subject.TOOL, None, "warning", (Tool(fmu.description.generation_tool, kinds),)))
    for kind, binary in check_binaries(fmu).items():
        sound = binary.result != "failed"
        checks += [binary, *(_interface(fmu, kind) if sound else [Check(Subject.SIMULATION, kind, "left out")])]
    return Validation(fmu.path, tuple(checks))


def check_binaries(fmu: FMU) -> dict[str, Check]:
    """Check each interface's binary for this platform, unpacked only if present."""
    return {kind: _binary(fmu, kind, each.identifier) for kind, each in fmu.description.interfaces.items()}


def _description(fmu: FMU) -> Check:
    from fmpy.validation import validate_fmu

    with CheckedArchive(fmu.path) as archive:
        texts = {name: archive.read(name) for name in (DESCRIPTION_FILE, BUILD_FILE) if name in archive.names}
    for name, text in texts.items():
        parse_xml(text, f"{fmu.path}: its {name}")
    checked = io.BytesIO()  # for a reader that must see nothing else
    with zipfile.ZipFile(checked, "w") as packed:
        for name, text in texts.items():
            packed.writestr(name, text)
    checked.seek(0)
    said = tuple(" ".join(problem.split()) for problem in validate_fmu(checked))
    return Check(Subject.DESCRIPTION, None, "failed" if said else "ok", said)


def _binary(fmu: FMU, kind: str, identifier: str) -> Check:
    try:
        library = fmu.library(identifier)
    except InputError as error:
        return Check(Subject.BINARY, kind, "failed", (str(error),))
    others = tuple(name for name in fmu.platforms if name != library.parent.name)
    return Check(Subject.BINARY, kind, "ok", (Binary(f"{library.parent.name}/{library.name}", others),))


def _interface(fmu: FMU, kind: str) -> list[Check]:
    tries: list[InterfaceTest] = []
    for share in DURATION_SHARES:
        tries.append(_try(fmu, kind, share))
        report = tries[-1].report
        if report.simulated or not (report.instantiated and tries[-1].code is None):
            break
    last = tries[-1]
    if not report.instantiated:
        return [Check(Subject.INSTANTIATION, kind, "failed", (last,))]
    result = "failed" if not report.simulated else "warning" if len(tries) > 1 else "ok"
    checks = [Check(Subject.INSTANTIATION, kind, "ok"), Check(Subject.SIMULATION, kind, result, tuple(tries))]
    if report.simulated:
        checks.append(_reset(kind, last))
    said = tuple(report.warnings)
    return [*checks, Check(Subject.MESSAGES, kind, "warning", said)] if said else checks


def _reset(kind: str, last: InterfaceTest) -> Check:
    """Judge the second simulation, and its instance."""
    if last.troubled:
        return Check(Subject.RESET, kind, "warning" if last.code is None else "failed", (last,))
    if last.report.differs:
        return Check(Subject.RESET, kind, "failed")
    lost = tuple(last.report.no_reset)
    return Check(Subject.RESET, kind, "warning" if lost else "ok", lost)


def _try(fmu: FMU, kind: str, share: float) -> InterfaceTest:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        report, printed = Path(folder) / "report.json", Path(folder) / "printed.txt"
        arguments = [str(fmu.path.resolve()), kind, str(share), str(report)]
        with printed.open("wb") as output:  # a file, since who still holds a pipe would keep us waiting
            child = Child("fmuid.simulation.smoke_test", *arguments, stdout=output, stderr=subprocess.STDOUT)
            try:
                code = child.wait(TIME_LIMIT)
            finally:
                child.end()
        lines = printed.read_text(encoding="utf-8", errors="replace").split("\n")
        last_words = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return InterfaceTest(share, SmokeReport.read(report), code, last_words, TIME_LIMIT)
