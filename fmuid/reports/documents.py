"""Which topic makes the document of which findings."""

from __future__ import annotations

from functools import singledispatch

from fmuid.errors import InputError
from fmuid.reports.document import Document
from fmuid.reports.topics.model_comparison import comparison_document
from fmuid.runs import ComparisonRun


@singledispatch
def document(found: object) -> Document:
    """Return the document of findings.

    Raises
    ------
    InputError
        If they are of no kind that has one.
    """
    raise InputError(f"a {type(found).__name__} has no document")


document.register(ComparisonRun, comparison_document)
