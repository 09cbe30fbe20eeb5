"""Where a result comes from: study, versions, digests, date."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, TypedDict

from fmuid.reports.document import Table, table_of

if TYPE_CHECKING:
    from fmuid.runs import Provenance


class Origin(TypedDict):
    """The fields of a `Document` that say where it comes from."""

    origin: Table
    study: str
    title: str


def origin_of(found: Provenance | None, more: Mapping[str, str] | None = None) -> Origin:
    """Return what a document says of where it comes from.

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
        rows["study file"] = "values were replaced for this run" if study.changed else ""
    rows |= {} if found is None else {name: f"SHA-256 {digest}" for name, digest in found.files.items()}
    rows = {name: said for name, said in (rows | dict(more or {})).items() if said}
    columns = {"": list(rows), "what this page comes from": list(rows.values())}
    table = table_of(columns, columns) if rows else ()
    return Origin(origin=table, study="" if study is None else study.text, title="" if found is None else found.title)
