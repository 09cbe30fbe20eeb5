"""Remarks as texts, each with its remedy."""

from collections.abc import Callable, Iterable
from typing import Any

from fmuid.reports import shared_phrases
from fmuid.reports.document import Remark
from fmuid.reports.topics import solver_check, study_notes, termination


def texts(remarks: Callable[..., Iterable[Remark]]) -> Callable[..., tuple[str, ...]]:
    """Return a function of texts from a function of remarks."""
    return lambda *given: tuple(map(str, remarks(*given)))


def text(remarks: Callable[..., Any]) -> Callable[..., str]:
    """Return a function of one text from a function of remarks, or of one."""

    def said(*given: Any) -> str:
        found = remarks(*given)
        return str(found) if isinstance(found, Remark) else "\n".join(map(str, found))

    return said


ending = text(termination.ending_remarks)
result_words = texts(termination.result_remarks)
solver_words = texts(solver_check.solver_remarks)
direction_words = text(shared_phrases.direction_remark)
source_words = text(study_notes.source_remark)
