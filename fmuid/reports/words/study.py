"""What is to be known of a study before it is run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fmuid.studies import SourceDoubt

if TYPE_CHECKING:
    from fmuid.studies import SourceNote


def source_words(note: SourceNote) -> str:
    """Return why an earlier result, of which something is taken, is to be taken with care."""
    match note.doubt:
        case SourceDoubt.DID_NOT_SUCCEED:
            return f"{note.path}, an earlier result, did not succeed: {note.outcome.value}"
        case SourceDoubt.NO_MODEL:
            return f"{note.path} does not say of which model it is a result"
        case SourceDoubt.OTHER_BUILD:
            assert note.fmu is not None
            return f"{note.path} was made with another build of {note.fmu.name} than {note.fmu.path}"
