"""The baseline of healthy recordings: their number and operating points."""

from __future__ import annotations

from fmuid.diagnosis import StoredBaseline
from fmuid.reports.document import Document, Message, Section, doubt, plain, table_of_rows

ENOUGH = 10  # healthy recordings from which the model's error between operating points is known well


class BaselineMessage(Message, section="baseline"):
    """Content of a baseline file."""

    COVERS = plain("Healthy recordings in the baseline: {count}.")
    FEW = doubt(
        "Fewer than ten recordings: the model's error between operating points is poorly known.",
        remedy="Add healthy data of other operating points, up to ten or more.",
    )


def baseline_document(found: StoredBaseline) -> Document:
    """Return the document of a baseline file."""
    count = len(found.said)
    said = [BaselineMessage.COVERS.said(count=count)]
    said += [BaselineMessage.FEW.said("")] if count < ENOUGH else []
    rows = [(name, f"{low:.4g}", f"{high:.4g}") for name, (low, high) in found.points.ranges().items()]
    table = table_of_rows(("quantity", "lowest", "highest"), rows, ("quantity",))
    section = Section("baseline", "Operating points of the healthy recordings", table=table)
    return Document("baseline", "Baseline", "made", "good", tuple(said), (section,))
