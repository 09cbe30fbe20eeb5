"""Write ``report.html`` from what a folder has of results."""

from __future__ import annotations

from pathlib import Path

from fmuid.errors import InputError
from fmuid.files import is_file, is_folder, replacing
from fmuid.reports.drawn import REPORT_FILE


def write_report(folder: str | Path) -> Path:
    """Write ``report.html`` into a folder of results and return its path.

    The page shows what the folder's files say, needs no other file and asks no host.

    Parameters
    ----------
    folder : path
        With a ``result.json``, as a command has left it.

    Raises
    ------
    InputError
        If the folder has no results, a file in it cannot be read, or nothing can be written there.
    """
    folder = Path(folder)
    if not is_folder(folder):
        raise InputError(f"{folder} is no folder of results")
    if not is_file(folder / "result.json"):
        raise InputError(f"{folder} has no result.json: give the folder that a command has written its results into")
    from fmuid.reports.page import identification
    from fmuid.reports.page.contents import read_json
    from fmuid.reports.page.document import page

    title = str(read_json(folder / "result.json").get("title", "")) or folder.absolute().parent.name
    text = page(title, [identification.part(folder)], identification.origin(folder))
    path = folder / REPORT_FILE
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path
