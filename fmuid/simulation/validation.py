"""Whether an FMU keeps the standard and runs here: FMPy's checks, its binaries, a simulation of each interface."""

from __future__ import annotations

import re
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fmuid.errors import InputError
from fmuid.fmi import DESCRIPTION_FILE, FMU, Zipped, archive_of, parse_xml
from fmuid.processes import Child
from fmuid.simulation.smoke import Report

BUILD_FILE = "sources/buildDescription.xml"
"""How to compile an FMU that has its sources with it (FMI 3.0.2, section 2.5.1.5)."""
TIME_LIMIT = 60.0
"""How long the simulations of one try may take, s."""

# Shares of the default experiment that are simulated, the second where the first takes too long: it tells a model that
# is merely slow from one that hangs.
SHARES = (1.0, 0.01)


@dataclass(frozen=True)
class Check:
    """One check of an FMU.

    Attributes
    ----------
    name : str
    result : "ok", "warning", "failed" or "left out"
    remarks : tuple of str
        What there is to say, one sentence or figure each.
    """

    name: str
    result: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Validation:
    """All checks of an FMU (`validate`).

    Attributes
    ----------
    path : Path
    checks : tuple of Check
    """

    path: Path
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether no check failed; there may be warnings."""
        return not self.count("failed")

    def count(self, result: str) -> int:
        """Return how many checks have a result."""
        return sum(check.result == result for check in self.checks)


def validate(fmu: FMU | str | Path) -> Validation:
    """Check an FMU: what it declares, whether it can be loaded here, and whether its interfaces simulate.

    FMPy checks the model description against the schema and the rules of the standard. Each interface is then
    instantiated and simulated over the default experiment, inputs at their start values, in a process of its own: a
    crash or a hang is a failed check.

    Parameters
    ----------
    fmu : FMU or path

    Raises
    ------
    InputError
        If it is no FMU, or of a version that is not read.
    """
    fmu = fmu if isinstance(fmu, FMU) else FMU(fmu)
    checks = [_description(fmu), *_tool(fmu)]
    for kind, interface in fmu.description.interfaces.items():
        binary = _binary(fmu, kind, interface.identifier)
        checks.append(binary)
        checks += _interface(fmu, kind) if binary.result != "failed" else [Check(f"{kind}: simulation", "left out")]
    return Validation(fmu.path, tuple(checks))


def _description(fmu: FMU) -> Check:
    from fmpy.validation import validate_fmu

    with Zipped(fmu.path) as archive:
        texts = {name: archive.read(name) for name in (DESCRIPTION_FILE, BUILD_FILE) if name in archive.names}
    for name, text in texts.items():
        parse_xml(text, f"{fmu.path}: its {name}")
    problems = validate_fmu(archive_of(texts))
    said = tuple(" ".join(problem.split()) for problem in problems)
    return Check("model description", "failed" if said else "ok", said or ("keeps the standard, as FMPy checks it",))


def _tool(fmu: FMU) -> list[Check]:
    kinds = [kind for kind, interface in fmu.description.interfaces.items() if interface.needs_execution_tool]
    if not kinds:
        return []
    tool = fmu.description.generation_tool or "the tool that made it"
    return [Check("stands alone", "warning", (f"runs only with {tool} on this machine ({', '.join(kinds)})",))]


def _binary(fmu: FMU, kind: str, identifier: str) -> Check:
    try:
        library = fmu.library(identifier)
    except InputError as error:
        return Check(f"{kind}: binary", "failed", (str(error),))
    others = [name for name in fmu.platforms if name != library.parent.name]
    here = f"{library.parent.name}/{library.name}"
    return Check(f"{kind}: binary", "ok", (here + (f"; also for {', '.join(others)}" if others else ""),))


@dataclass(frozen=True)
class _Try:
    """One try: the report of its process, and what ended the process early, if anything did."""

    share: float
    report: Report
    crash: str = ""
    late: bool = False

    @property
    def words(self) -> str:
        """What was tried, as a message begins."""
        part = f" ({100 * self.share:g} % of the default experiment)" if self.share < 1 else ""
        return f"{self.report.start:g} to {self.report.stop:g} s{part}"

    @property
    def trouble(self) -> str:
        """What ended it, as a sentence; nothing where nothing did."""
        if self.late:
            return f"did not end within {TIME_LIMIT:g} s while it {self.report.doing}"
        return f"{self.crash} while it {self.report.doing}" if self.crash else self.report.error


def _interface(fmu: FMU, kind: str) -> list[Check]:
    tries: list[_Try] = []
    for share in SHARES:
        tries.append(_try(fmu, kind, share))
        if tries[-1].report.simulated or not (tries[-1].report.instantiated and tries[-1].late):
            break
    last = tries[-1]
    if not last.report.instantiated:
        return [Check(f"{kind}: instantiation", "failed", (_with_licence(last.trouble),))]
    checks = [Check(f"{kind}: instantiation", "ok"), _simulation(kind, tries)]
    if last.report.simulated:
        checks.append(_reset(kind, last))
    said = tuple(last.report.warnings)
    return [*checks, Check(f"{kind}: messages", "warning", said)] if said else checks


def _simulation(kind: str, tries: Sequence[_Try]) -> Check:
    name = f"{kind}: simulation"
    remarks = [f"{each.words}: {each.trouble}" for each in tries if not each.report.simulated]
    last = tries[-1]
    if not last.report.simulated:
        return Check(name, "failed", tuple(remarks))
    seen = f"outputs finite ({last.report.outputs})" if last.report.outputs else "no outputs to look at"
    figures = f"{last.report.run}, {last.words}: {last.report.samples} samples, {seen}"
    if last.report.repeated:
        figures += f", in {_duration(last.report.seconds)}"
    return Check(name, "warning" if remarks else "ok", (*remarks, figures))


def _reset(kind: str, last: _Try) -> Check:
    """Judge the second simulation, and whether it could be made with the same instance."""
    name, report = f"{kind}: reset", last.report
    if last.trouble:
        return Check(name, "warning" if last.late else "failed", (last.trouble,))
    if report.differs:
        return Check(name, "failed", ("a second simulation gives other outputs than the first",))
    lost = tuple(report.no_reset)
    return Check(name, "warning" if lost else "ok", lost or ("a second simulation gives the same outputs",))


def _duration(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds >= 0.1 else f"{1e3 * seconds:.2g} ms"


def _with_licence(sentence: str) -> str:
    """Return what an FMU that cannot be instantiated says, with the remedy where it is about a licence."""
    if re.search(r"licen[cs]", sentence, re.IGNORECASE):
        sentence += "; get a licence of the tool that made it, or export it with one that needs none to run"
    return sentence


def _try(fmu: FMU, kind: str, share: float) -> _Try:
    """Simulate one interface in a process of its own."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        report, printed = Path(folder) / "report.json", Path(folder) / "printed.txt"
        arguments = [str(fmu.path.resolve()), kind, str(share), str(report)]
        with printed.open("wb") as output:  # a file, since who still holds a pipe would keep us waiting
            child = Child("fmuid.simulation.smoke", *arguments, stdout=output, stderr=subprocess.STDOUT)
            try:
                code = child.wait(TIME_LIMIT)
            finally:
                child.end()
        if code is None:
            return _Try(share, Report.read(report), late=True)
        return _Try(share, Report.read(report), _crash(code, printed))


def _crash(code: int, printed: Path) -> str:
    """Return how a process ended that did not end well, with the last line that it printed."""
    if not code:
        return ""
    try:
        how = f"crashed with {signal.Signals(-code).name}"
    except ValueError:
        how = f"ended its process with code {code}"
    lines = printed.read_text(encoding="utf-8", errors="replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    return how + (f' (its last words: "{last}")' if last else "")
