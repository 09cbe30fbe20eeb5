"""What the checks of an FMU have shown."""

from __future__ import annotations

import re
import signal

from fmuid.reports.topics.solver_check import run_words
from fmuid.simulation import Binary, Check, InterfaceTest, Stage, Subject, Tool

_DOING = {
    Stage.START: "was starting",
    Stage.INSTANTIATION: "was being loaded and instantiated",
    Stage.SIMULATION: "was being simulated",
    Stage.REPETITION: "was being simulated a second time",
    Stage.END: "was being freed",
}
_PLAIN = {
    (Subject.DESCRIPTION, "ok"): "keeps the standard, as FMPy checks it",
    (Subject.RESET, "ok"): "a second simulation gives the same outputs",
    (Subject.RESET, "failed"): "a second simulation gives other outputs than the first",
}


def check_words(check: Check) -> list[str]:
    """Return what there is to say of a check, one sentence or figure each."""
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
            return _with_licence(_trouble_words(evidence))
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
    took = f", in {_duration(report.seconds)}" if report.repeated else ""
    return f"{run}{span}: {report.samples} samples, {seen}{took}"


def _trouble_words(trial: InterfaceTest) -> str:
    """Return what ended a try."""
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


def _with_licence(sentence: str) -> str:
    """Return what an FMU that cannot be instantiated says, with the remedy where it is about a licence."""
    if re.search(r"licen[cs]", sentence, re.IGNORECASE):
        sentence += "; get a licence of the tool that made it, or export it with one that needs none to run"
    return sentence


def _duration(seconds: float) -> str:
    return f"{seconds:.2g} s" if seconds >= 0.1 else f"{1e3 * seconds:.2g} ms"
