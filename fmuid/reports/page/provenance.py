"""Where results come from: study, versions, digests, date."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from fmuid.reports.page.document import details, table


def origin(content: Mapping[str, Any], more: Mapping[str, str] | None = None) -> str:
    """Return what a report says at its end of where a part of it comes from, as HTML.

    Parameters
    ----------
    content : mapping
        Of the JSON file that a command has written (`fmuid.reports.provenance`).
    more : mapping of str to str, optional
        Further rows.
    """
    study = content.get("study") or {}
    rows = {"fmuid": str(content.get("version", "")), "run": str(content.get("date", ""))}
    if study:
        rows["study"] = f"{PurePosixPath(study.get('file', '')).name}, SHA-256 {study.get('digest', '')}"
    rows |= {name: f"SHA-256 {digest}" for name, digest in (content.get("files") or {}).items()}
    rows = {name: said for name, said in (rows | dict(more or {})).items() if said}
    shown = table({"": list(rows), "what this page comes from": list(rows.values())})
    if not study.get("text"):
        return shown
    heading = "Study file" + (", of which values were replaced for this run" if study.get("changed") else "")
    return shown + details(heading, str(study["text"]))
