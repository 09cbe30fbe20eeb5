"""The change of the study that should gain most, in one line."""

from __future__ import annotations

import shlex

from fmuid.formatting import listed
from fmuid.reports.document import Message
from fmuid.runs import ChangeKind, StudyChange


class ChangeMessage(Message):
    """Offered changes of a study, by `ChangeKind`; the score is the expected fall of −2 ln L."""

    FREE = ("Free {subject}", "a fixed parameter has another value")
    INTERPOLATION = ('Interpolate {subject} by "{value}"', "held where linear was assumed, or the reverse")
    WARMUP = ("Set a warm-up of {value} s in {subject}", "most of the residual sits there")
    OFFSET = ("Subtract {value} from {subject}", "a sensor's zero")


def change_title(found: StudyChange) -> str:
    """Return what a change does."""
    return ChangeMessage[ChangeKind(found.kind).name].text.format(subject=listed(found.subject), value=found.value)


def change_line(found: StudyChange) -> str:
    """Return a change with its score and the arguments of a command."""
    words = " ".join(f"--set {shlex.quote(each)}" for each in found.settings)
    return f"{change_title(found)} (−2 ln L falls by {found.gain:.3g}): `{words}`"
