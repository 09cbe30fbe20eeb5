"""`fmuid validate`: checks of an FMU."""

from __future__ import annotations

import re
import signal
from collections.abc import Sequence
from textwrap import shorten

from fmuid.reports.document import Document, Message, Section, Tone, plain, table_of
from fmuid.reports.topics.solver_check import run_words
from fmuid.simulation import TIME_LIMIT, Binary, Check, InterfaceTest, Stage, Subject, Tool, Validation

MAX_REMARKS, MAX_LETTERS = 5, 300
"""Remarks of a check on a terminal, and letters of each; FMPy lists all variables in one."""

_STAGES = {
    Stage.START: "at the start",
    Stage.INSTANTIATION: "during instantiation",
    Stage.SIMULATION: "during the simulation",
    Stage.REPETITION: "during the second simulation",
    Stage.END: "when freed",
}


class ValidationMessage(Message):
    """Results of the checks of an FMU."""

    STANDARD = plain("conforms to the standard (FMPy)")
    REPEATABLE = plain("second simulation: same outputs")
    NOT_REPEATABLE = plain(
        "second simulation: different outputs",
        remedy="Export the FMU again without static variables.",
    )
    NEEDS_TOOL = plain("runs only with {tool} on this machine ({interfaces})", remedy="Export it as a standalone FMU.")
    SIMULATED = plain("{run}{span}: {samples} samples, {outputs}{seconds}")
    TIMED_OUT = plain("stopped after {limit:g} s {stage}")
    CRASHED = plain("{how} {stage}")
    LICENSE = plain(
        "{error}; check the tool's license", remedy="Get a license, or export the FMU with a tool that needs none."
    )


_PLAIN = {
    (Subject.DESCRIPTION, "ok"): ValidationMessage.STANDARD,
    (Subject.RESET, "ok"): ValidationMessage.REPEATABLE,
    (Subject.RESET, "failed"): ValidationMessage.NOT_REPEATABLE,
}


def check_words(check: Check) -> list[str]:
    """Return the results of a check, one sentence each."""
    said = [_evidence_words(check.subject, each) for each in check.evidence]
    plain = _PLAIN.get((check.subject, check.result))
    return said or ([plain.text] if plain else [])


def _evidence_words(subject: Subject, evidence: Tool | Binary | InterfaceTest | str) -> str:
    match evidence:
        case Tool():
            interfaces = ", ".join(evidence.interfaces)
            tool = evidence.name or "the tool that exported it"
            return ValidationMessage.NEEDS_TOOL.text.format(tool=tool, interfaces=interfaces)
        case Binary():
            return evidence.library + (f"; also for {', '.join(evidence.others)}" if evidence.others else "")
        case InterfaceTest() if subject is Subject.SIMULATION:
            return _simulation_words(evidence)
        case InterfaceTest():
            said = _trouble_words(evidence)
            licensed = re.search(r"licen[cs]", said, re.IGNORECASE)
            return ValidationMessage.LICENSE.text.format(error=said) if licensed else said
        case _:
            return evidence


def _simulation_words(trial: InterfaceTest) -> str:
    report = trial.report
    part = f" ({100 * trial.share:g} % of the default experiment)" if trial.share < 1 else ""
    span = f"{report.start:g} to {report.stop:g} s{part}"
    if not report.simulated:
        return f"{span}: {_trouble_words(trial)}"
    duration = f"{report.seconds:.2g} s" if report.seconds >= 0.1 else f"{1e3 * report.seconds:.2g} ms"
    return ValidationMessage.SIMULATED.text.format(
        run="" if report.run is None else f"{run_words(report.run)}, ",
        span=span,
        samples=report.samples,
        outputs=f"{report.outputs} outputs finite" if report.outputs else "no outputs",
        seconds=f", in {duration}" if report.repeated else "",
    )


def _trouble_words(trial: InterfaceTest) -> str:
    stage = _STAGES[trial.report.doing]
    if trial.code is None:
        return ValidationMessage.TIMED_OUT.text.format(limit=trial.limit, stage=stage)
    if not trial.code:
        return trial.report.error
    try:
        how = f"crashed with {signal.Signals(-trial.code).name}"
    except ValueError:
        how = f"exited with code {trial.code}"
    how += f' (last output: "{trial.last_words}")' if trial.last_words else ""
    return ValidationMessage.CRASHED.text.format(how=how, stage=stage)


def binary_notes(checks: Sequence[Check]) -> list[str]:
    """Return missing binaries and the simulations that follow."""
    notes = dict.fromkeys(text for check in checks if check.result == "failed" for text in check_words(check))
    if any(check.result != "failed" for check in checks):
        notes[f"simulating each interface (at most {TIME_LIMIT:g} s)"] = None
    return list(notes)


def validation_document(found: Validation, *, terminal: bool = False) -> Document:
    """Return the checks of an FMU, remarks shortened for a terminal."""
    remarks = []
    for check in found.checks:
        said = check_words(check)
        if terminal:
            more = len(said) - MAX_REMARKS
            said = [shorten(text, MAX_LETTERS, placeholder=" …") for text in said[:MAX_REMARKS]]
            said += [f"{more} more; all: fmuid validate FMU | less"] if more > 0 else []
        remarks.append("\n".join(said))
    columns = {"check": [e.name for e in found.checks], "result": [e.result for e in found.checks], "remark": remarks}
    failed, warned = found.count("failed"), found.count("warning")
    state = f"{failed} of {len(found.checks)} checks failed" if failed else "no problems found"
    state += f", {warned} with warnings" if warned else ""
    section = Section("checks", found.path.name, table=table_of(columns, columns))
    tone: Tone = "bad" if failed else "doubt" if warned else "good"
    return Document("validation", "Validation", state, tone, sections=(section,))
