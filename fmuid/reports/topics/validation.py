"""`fmuid validate`: checks of an FMU."""

from __future__ import annotations

import re
import signal
from collections.abc import Sequence
from textwrap import shorten

from fmuid.reports.document import Document, Section, Tone, table_of
from fmuid.reports.topics.solver_check import run_words
from fmuid.simulation import TIME_LIMIT, Binary, Check, InterfaceTest, Stage, Subject, Tool, Validation

# Remarks of one check on a terminal, and letters of each: FMPy lists all variables of a model in one.
TERMINAL_REMARKS, REMARK_LENGTH = 5, 300

_DOING = {
    Stage.START: "was starting",
    Stage.INSTANTIATION: "was being loaded and instantiated",
    Stage.SIMULATION: "was being simulated",
    Stage.REPETITION: "was being simulated a second time",
    Stage.END: "was being freed",
}
LICENCE = "; get a licence of the tool that made it, or export it with one that needs none to run"
_PLAIN = {
    (Subject.DESCRIPTION, "ok"): "keeps the standard, as FMPy checks it",
    (Subject.RESET, "ok"): "a second simulation gives the same outputs",
    (Subject.RESET, "failed"): "a second simulation gives other outputs than the first",
}


def check_words(check: Check) -> list[str]:
    """Return the results of a check, one sentence each."""
    said = [_evidence_words(check.subject, each) for each in check.evidence]
    plain = _PLAIN.get((check.subject, check.result))
    return said or ([plain] if plain else [])


def _evidence_words(subject: Subject, evidence: Tool | Binary | InterfaceTest | str) -> str:
    match evidence:
        case Tool():
            interfaces = ", ".join(evidence.interfaces)
            return f"runs only with {evidence.name or 'the tool that made it'} on this machine ({interfaces})"
        case Binary():
            return evidence.library + (f"; also for {', '.join(evidence.others)}" if evidence.others else "")
        case InterfaceTest() if subject is Subject.SIMULATION:
            return _simulation_words(evidence)
        case InterfaceTest():
            said = _trouble_words(evidence)
            return said + LICENCE if re.search(r"licen[cs]", said, re.IGNORECASE) else said
        case _:
            return evidence


def _simulation_words(trial: InterfaceTest) -> str:
    report = trial.report
    part = f" ({100 * trial.share:g} % of the default experiment)" if trial.share < 1 else ""
    span = f"{report.start:g} to {report.stop:g} s{part}"
    if not report.simulated:
        return f"{span}: {_trouble_words(trial)}"
    run = "" if report.run is None else f"{run_words(report.run)}, "
    seen = f"outputs finite ({report.outputs})" if report.outputs else "no outputs to look at"
    duration = f"{report.seconds:.2g} s" if report.seconds >= 0.1 else f"{1e3 * report.seconds:.2g} ms"
    took = f", in {duration}" if report.repeated else ""
    return f"{run}{span}: {report.samples} samples, {seen}{took}"


def _trouble_words(trial: InterfaceTest) -> str:
    doing = f"while it {_DOING[trial.report.doing]}"
    if trial.code is None:
        return f"did not end within {trial.limit:g} s {doing}"
    if not trial.code:
        return trial.report.error
    try:
        how = f"crashed with {signal.Signals(-trial.code).name}"
    except ValueError:
        how = f"ended its process with code {trial.code}"
    return how + (f' (its last words: "{trial.last_words}")' if trial.last_words else "") + f" {doing}"


def binary_notes(checks: Sequence[Check]) -> list[str]:
    """Return missing binaries and the simulations that follow."""
    notes = dict.fromkeys(text for check in checks if check.result == "failed" for text in check_words(check))
    if any(check.result != "failed" for check in checks):
        notes[f"simulating each interface; one that does not end is stopped after {TIME_LIMIT:g} s"] = None
    return list(notes)


def validation_document(found: Validation, *, terminal: bool = False) -> Document:
    """Return the checks of an FMU; a terminal gets the first remarks of each, shortened."""
    remarks = []
    for check in found.checks:
        said = check_words(check)
        if terminal:
            more = len(said) - TERMINAL_REMARKS
            said = [shorten(text, REMARK_LENGTH, placeholder=" …") for text in said[:TERMINAL_REMARKS]]
            said += [f"and {more} more; all of them: fmuid validate FMU | less"] if more > 0 else []
        remarks.append("\n".join(said))
    columns = {"check": [e.name for e in found.checks], "result": [e.result for e in found.checks], "remark": remarks}
    failed, warned = found.count("failed"), found.count("warning")
    state = f"{failed} of {len(found.checks)} checks failed" if failed else "no problems found"
    state += f", {warned} with warnings" if warned else ""
    section = Section("checks", found.path.name, table=table_of(columns, columns))
    tone: Tone = "bad" if failed else "doubt" if warned else "good"
    return Document("validation", "Validation", state, tone, sections=(section,))
