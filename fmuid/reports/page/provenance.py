"""Where results come from: study, versions, digests, date."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath

from fmuid.reports.page.document import details, table
from fmuid.runs import Provenance


def origin(found: Provenance | None, more: Mapping[str, str] | None = None) -> str:
    """Return what a report says at its end of where a part of it comes from, as HTML.

    Parameters
    ----------
    found : Provenance or None
    more : mapping of str to str, optional
        Further rows.
    """
    rows = {} if found is None else {"fmuid": found.version, "run": found.date}
    study = None if found is None else found.study
    if study is not None:
        rows["study"] = f"{PurePosixPath(study.file).name}, SHA-256 {study.digest}"
    rows |= {} if found is None else {name: f"SHA-256 {digest}" for name, digest in found.files.items()}
    rows = {name: said for name, said in (rows | dict(more or {})).items() if said}
    shown = table({"": list(rows), "what this page comes from": list(rows.values())})
    if study is None or not study.text:
        return shown
    heading = "Study file" + (", of which values were replaced for this run" if study.changed else "")
    return shown + details(heading, study.text)
