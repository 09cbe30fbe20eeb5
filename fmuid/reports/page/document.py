"""A page of HTML that asks no host: sentences, tables, figures, and the library that draws them.

Whatever comes from a study, a table or an FMU is escaped. Besides, the page's own policy lets a browser run the two
scripts that were written into it, known by their digests, and load nothing from anywhere. One is the library,
compressed to a third as the figures are: the other unpacks it, and draws one section after the other.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fmuid.errors import InputError
from fmuid.formatting import visible
from fmuid.reports.page.verdict import ReportStatement

# More takes longer than it makes smaller.
PACKED = 4


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a page with a heading of its own.

    Attributes
    ----------
    name : str
        Its anchor, of letters and hyphens.
    heading : str
    caption : str
        How to read what it shows.
    figures : sequence
        Bokeh models that stand beside each other where there is room.
    columns : int
        So many at most.
    body : str
        HTML above the figures, in which all that is not ours is escaped.
    zoom : BokehSpec, optional
        A stretch of the only figure, which print shows beside it.
    fit : tuple
        What the only figure shows as much of as can be seen: arguments of `fmuid.reports.interactive.fit.fit`.
    """

    name: str
    heading: str
    caption: str = ""
    figures: Sequence[Any] = ()
    columns: int = 3
    body: str = ""
    zoom: Any = None
    fit: tuple[Any, ...] = ()


@dataclass(frozen=True, eq=False)
class Part:
    """What one command has found.

    Attributes
    ----------
    heading : str
    state, good : str, bool
        In a word, and whether that is good.
    said : sequence of ReportStatement
    table : str
        HTML, as for `Section`.
    sections : sequence of Section
    end : str
        HTML on where it comes from, at the end of the page.
    """

    heading: str
    state: str
    good: bool
    said: Sequence[ReportStatement]
    table: str
    sections: Sequence[Section]
    end: str = ""


def text(words: object) -> str:
    """Return a text as HTML."""
    return html.escape(visible(str(words)))


def table(columns: dict[str, list[str]], *, numbers: Sequence[str] = ()) -> str:
    """Return a table as HTML, its first column as the names of the rows.

    Parameters
    ----------
    columns : dict of str to list of str
        Texts that are escaped here.
    numbers : sequence of str
        The columns that are aligned as numbers.
    """
    heads = "".join(f"<th scope=col class={_kind(name, numbers)}>{text(name)}</th>" for name in columns)
    rows = []
    for cells in zip(*columns.values(), strict=True):
        first, *others = cells
        kinds = [_kind(name, numbers) for name in list(columns)[1:]]
        tail = "".join(f"<td class={kind}>{text(cell)}</td>" for kind, cell in zip(kinds, others, strict=True))
        rows.append(f"<tr><th scope=row>{text(first)}</th>{tail}</tr>")
    return f"<div class=scroll><table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"


def _kind(name: str, numbers: Sequence[str]) -> str:
    return "number" if name in numbers else "word"


def details(heading: str, words: str) -> str:
    """Return a text that opens at a click."""
    return f"<details><summary>{text(heading)}</summary><pre>{text(words)}</pre></details>"


def page(title: str, parts: Sequence[Part]) -> str:
    """Return a page."""
    body, drawings = written_parts(parts)
    scripts, tail = _drawing(drawings) if drawings else ("'none'", "")
    policy = (
        f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    head = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><meta name="referrer" content="no-referrer">'
        f"<title>{text(title)}</title><style>{_file('page.css')}</style></head>\n"
    )
    told = [part for part in parts if part.end]
    ends = "".join(f"<h3>{text(each.heading)}</h3>{each.end}" if len(told) > 1 else each.end for each in told)
    end = f"<section class=end>{ends}</section>" if ends else ""
    return f"{head}<body><header><h1>{text(title)}</h1></header>\n<main>{body}\n{end}</main>\n{tail}</body></html>\n"


def _drawing(drawings: Sequence[tuple[dict[str, Any], list[Any]]]) -> tuple[str, str]:
    """Return the digests of the scripts that draw, and the elements that hold them and what they draw."""
    from fmuid.reports.interactive.style import DARK

    library, own = _library(), f"const DARK = {json.dumps(DARK)};\n{_file('page.js')}"
    figures = json.dumps(drawings, separators=(",", ":"))
    digests = " ".join(f"'sha256-{_digest(each)}'" for each in (library, own))
    return digests, f"{_packed('library', library)}{_packed('figures', figures)}<script>{own}</script>\n"


def written_parts(parts: Sequence[Part]) -> tuple[str, list[tuple[dict[str, Any], list[Any]]]]:
    """Return what parts say, as HTML, and for each section with figures what Bokeh's library is told to draw them."""
    documents = [_document(each.figures) for part in parts for each in part.sections if each.figures]
    waiting = [place for *_, places in documents for place in places]
    body = "".join(_part(part, waiting, several=len(parts) > 1) for part in parts)
    return body, [(content, places) for content, places, _ in documents]


def drawn(figures: Sequence[Any]) -> tuple[str, str, Sequence[str]]:
    """Return the library, the script that draws figures, and the elements in which each of them appears."""
    content, where, divisions = _document(figures)
    texts = (json.dumps(each, separators=(",", ":")).replace("<", "\\u003c") for each in (content, where))
    return _library(), DRAW % tuple(texts), divisions


def _document(figures: Sequence[Any]) -> tuple[dict[str, Any], list[Any], list[str]]:
    """Return what Bokeh's library is told of figures and of their places, and the elements for these places."""
    from fmuid.reports.interactive.bokeh_spec import written

    roots, ids = written(figures)
    document = f"d{uuid.uuid4().hex}"
    elements = [f"{document}-{k}" for k in range(len(ids))]
    content = {document: {"version": version("bokeh"), "title": "", "roots": roots}}
    places = [{"docid": document, "roots": dict(zip(ids, elements, strict=True)), "root_ids": ids}]
    divisions = [
        f'<div id="{element}" data-root-id="{name}" style="display:contents"></div>'
        for element, name in zip(elements, ids, strict=True)
    ]
    return content, places, divisions


def _packed(name: str, content: str) -> str:
    packed = base64.b64encode(gzip.compress(content.encode(), compresslevel=PACKED, mtime=1)).decode()
    return f'<script type="text/plain" id="{name}">{packed}</script>\n'


DRAW = """(function draw(left) {
  if (typeof Bokeh !== "undefined") Bokeh.embed.embed_items(%s, %s);
  else if (left > 0) setTimeout(draw, 20, left - 1);
})(250);"""
"""What draws figures once the library is there, which in a notebook another cell may bring."""


def _library() -> str:
    """Return Bokeh's library for browsers; finding it imports nothing of Bokeh."""
    found = find_spec("bokeh")
    if found is None or not found.submodule_search_locations:  # it is a dependency: only a broken installation
        raise InputError("figures are drawn by Bokeh, which is not installed: pip install bokeh")
    path = Path(found.submodule_search_locations[0], "server", "static", "js", "bokeh.min.js")
    return path.read_text(encoding="utf-8")


def _file(name: str) -> str:
    return resources.files("fmuid.reports.render").joinpath(name).read_text(encoding="utf-8")


def _digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _part(part: Part, waiting: list[str], *, several: bool) -> str:
    here = {section.name for section in part.sections}
    verdict = "".join(_sentence(each, here) for each in part.said if not each.doubtful)
    doubts = "".join(_sentence(each, here) for each in part.said if each.doubtful)
    badge = f'<span class="badge {"good" if part.good else "bad"}">{text(part.state)}</span>'
    heading = f"<h2>{text(part.heading)} {badge}</h2>"
    unsure = f"<h3>What is doubtful, and what would help</h3><ul class=doubts>{doubts}</ul>" if doubts else ""
    first = f"<section>{heading}<ul class=verdict>{verdict}</ul>{unsure}{part.table}</section>"
    links = "".join(f'<a href="#{each.name}">{text(each.heading)}</a>' for each in part.sections)
    contents = f"<nav>{links}</nav>" if not several or links else ""
    return first + contents + "".join(_section(each, waiting) for each in part.sections)


def _sentence(said: ReportStatement, here: set[str]) -> str:
    words = text(said.text.rstrip("."))
    link = f' <a href="#{said.figure}">see the figure</a>' if said.figure in here else ""
    return f"<li>{words}.{link}</li>"


def _section(section: Section, waiting: list[str]) -> str:
    cells = "".join(f"<div class=cell>{waiting.pop(0)}</div>" for _ in section.figures)
    count = min(section.columns, max(1, len(section.figures)))
    grid = f'<div class="cells n{count}">{cells}</div>' if cells else ""
    caption = f"<p class=caption>{text(section.caption)}</p>" if section.caption else ""
    return f'<section id="{section.name}"><h3>{text(section.heading)}</h3>{caption}{section.body}{grid}</section>'
