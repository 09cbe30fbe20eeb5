"""Where a result comes from: study, versions, digests, date."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from fmuid.reports.document import Table, table_of
from fmuid.runs import Provenance


def origin_table(found: Provenance | None, more: Mapping[str, str] | None = None) -> Table:
    """Return what a document says of where it comes from, with further rows."""
    rows = {} if found is None else {"fmuid": found.version, "run": found.date}
    if found is not None and found.study is not None:
        rows["study"] = f"{PurePosixPath(found.study.file).name}, SHA-256 {found.study.digest}"
        rows["study file"] = "values were replaced for this run" if found.study.changed else ""
    rows |= {} if found is None else {name: f"SHA-256 {digest}" for name, digest in found.files.items()}
    rows |= more or {}
    rows = {name: said for name, said in rows.items() if said}
    columns = {"": list(rows), "what this page comes from": list(rows.values())}
    return table_of(columns, columns)


def origin_of(found: Provenance | None, more: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return the fields of a `Document` that say where it comes from."""
    text = "" if found is None or found.study is None else found.study.text
    return {"origin": origin_table(found, more), "study": text, "title": "" if found is None else found.title}
