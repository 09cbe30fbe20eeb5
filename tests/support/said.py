"""Remarks as texts, each with its remedy."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from fmuid.reports import shared_phrases
from fmuid.reports.document import Remark
from fmuid.reports.topics import prior_and_data, residual_analysis, solver_check, study_notes, termination, uncertainty


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
attempt_words = text(termination.attempt_remarks)
result_words = texts(termination.result_remarks)
reading_words = texts(prior_and_data.reading_remarks)
residual_words = texts(residual_analysis.residual_remarks)
solver_words = texts(solver_check.solver_remarks)
uncertainty_words = texts(uncertainty.uncertainty_remarks)
profile_words = texts(uncertainty.profile_remarks)
posterior_words = text(uncertainty.posterior_remarks)
direction_words = text(shared_phrases.direction_remark)
source_words = text(study_notes.source_remark)
