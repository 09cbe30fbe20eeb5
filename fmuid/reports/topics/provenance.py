"""Where a result comes from: study, versions, digests, date."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from fmuid.reports.document import Table, table_of


def origin_table(content: Mapping[str, Any], more: Mapping[str, str] | None = None) -> Table:
    """Return what a document says of where it comes from.

    Parameters
    ----------
    content : mapping
        ``version``, ``date``, ``study`` and ``files`` of a run, as far as they are known.
    more : mapping of str to str, optional
        Further rows.
    """
    study = content.get("study") or {}
    rows = {"fmuid": str(content.get("version", "")), "run": str(content.get("date", ""))}
    if study:
        rows["study"] = f"{PurePosixPath(study.get('file', '')).name}, SHA-256 {study.get('digest', '')}"
        rows["study file"] = "values were replaced for this run" if study.get("changed") else ""
    rows |= {name: f"SHA-256 {digest}" for name, digest in (content.get("files") or {}).items()}
    rows |= more or {}
    rows = {name: said for name, said in rows.items() if said}
    columns = {"": list(rows), "what this page comes from": list(rows.values())}
    return table_of(columns, columns)


def origin_of(content: Mapping[str, Any], more: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return the fields of a `Document` that say where it comes from."""
    text = str((content.get("study") or {}).get("text", ""))
    return {"origin": origin_table(content, more), "study": text, "title": str(content.get("title", ""))}
