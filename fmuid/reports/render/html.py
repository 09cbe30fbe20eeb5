"""Documents as one HTML page that loads nothing: all text is escaped, scripts are allowed by digest."""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
import re
import uuid
from collections.abc import Iterator, Sequence
from functools import cache
from importlib import resources
from importlib.metadata import version
from typing import Any

from fmuid.formatting import visible
from fmuid.reports.chart import LIMITS, Figure
from fmuid.reports.document import Document, Remark, Section, Table

DIGEST = "SHA-256 "


def page(title: str, documents: Sequence[Document]) -> str:
    """Return documents as one page."""
    body, drawings = written(documents)
    scripts, tail = _drawing(drawings) if drawings else ("'none'", "")
    policy = (
        f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    head = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}"><meta name="referrer" content="no-referrer">'
        f"<title>{text(title)}</title><style>{page_file('page.css')}</style></head>\n"
    )
    ends = "".join(_origin(each, several=len(documents) > 1) for each in documents)
    end = f"<section class=end>{ends}</section>" if ends else ""
    top = f"<header><h1>{text(title)}</h1>{_made_from(documents)}</header>"
    return f"{head}<body>{top}\n<main>{body}\n{end}</main>\n{tail}</body></html>\n"


def written(documents: Sequence[Document], live: frozenset[str] = frozenset()) -> tuple[str, list[tuple[Any, Any]]]:
    """Return documents as HTML, and the charts as Bokeh JSON."""
    drawings: list[tuple[Any, Any]] = []
    body = "".join(_document(each, drawings, live, several=len(documents) > 1) for each in documents)
    return body, drawings


def place_of(key: str) -> str:
    """Return the placeholder of a section that a server draws."""
    return f"<!-- figure {key} -->"


def text(words: object) -> str:
    """Return a text as HTML."""
    return html.escape(visible(str(words)))


def table(columns: Table) -> str:
    """Return a table as HTML, without columns of empty cells."""
    shown = [each for each in columns if any(each.cells)]
    if not shown:
        return ""
    wraps = [max(map(len, each.cells)) > 48 for each in shown]
    kinds = ["number" if c.number else "word long" if long else "word" for c, long in zip(shown, wraps, strict=True)]
    heads = "".join(f'<th scope=col class="{kind}">{text(c.head)}</th>' for c, kind in zip(shown, kinds, strict=True))
    rows = []
    for first, *others in zip(*(each.cells for each in shown), strict=True):
        cells = zip(shown[1:], kinds[1:], others, strict=True)
        tail = "".join(f'<td class="{kind}" data-head="{text(c.head)}">{text(cell)}</td>' for c, kind, cell in cells)
        rows.append(f"<tr><th scope=row>{text(first)}</th>{tail}</tr>")
    return f"<div class=scroll><table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"


def details(heading: str, words: str) -> str:
    """Return a text that opens at a click."""
    return f"<details><summary>{text(heading)}</summary><pre>{text(words)}</pre></details>"


def verdict(document: Document) -> str:
    """Return heading, reason, first tables and sentences of a document as HTML."""
    here = {section.key for section in document.sections}
    sure, doubts = (
        "".join(_sentence(each, here) for each in document.remarks if (each.tone in ("doubt", "bad")) is doubtful)
        for doubtful in (False, True)
    )
    badge = f'<span class="badge {document.tone}">{text(document.state)}</span>'
    heading = f"<h2>{text(document.heading)} {badge}</h2>"
    reason = f"<p class=reason>{text(document.reason)}</p>" if document.reason else ""
    reason += f"<p class=remedy>→ {_marked(document.remedy)}</p>" if document.remedy else ""
    unsure = f"<h3>Doubts</h3><ul class=doubts>{doubts}</ul>" if doubts else ""
    tables = ""
    for each in document.sections:
        rows = table(each.table) if not each.charts and "page" in each.shown else ""
        tables += f"<h3>{text(each.heading)}</h3>{rows}" if each.heading and rows else rows
    sure = f"<ul class=verdict>{sure}</ul>"
    if not reason:
        return f"<section>{heading}{sure}{unsure}{tables}</section>"
    return f"<section>{heading}{reason}{tables}{unsure}<details><summary>Details</summary>{sure}</details></section>"


def section_head(section: Section) -> str:
    """Return heading, caption, table and sentences of a section as HTML."""
    caption = f"<p class=caption>{text(section.caption)}</p>" if section.caption else ""
    said = "".join(_sentence(each, set()) for each in section.remarks)
    rows = table(section.table) if "page" in section.shown else ""
    return f"<h3>{text(section.heading)}</h3>{caption}{rows}" + (f"<ul>{said}</ul>" if said else "")


def drawn_sections(document: Document) -> Iterator[Section]:
    """Yield the sections that a page shows below the verdict."""
    return (each for each in document.sections if each.charts)


def _document(document: Document, drawings: list[Any], live: frozenset[str], *, several: bool) -> str:
    sections = list(drawn_sections(document))
    links = "".join(f'<a href="#{each.key}">{text(each.heading)}</a>' for each in sections)
    contents = f"<nav>{links}</nav>" if not several or links else ""
    return verdict(document) + contents + "".join(_section(each, drawings, live) for each in sections)


def _sentence(said: Remark, here: set[str]) -> str:
    words = _marked(said.text.rstrip("."))
    link = f' <a href="#{said.section}">see the figure</a>' if said.section in here else ""
    remedy = f"<br>→ {_marked(said.remedy)}" if said.remedy else ""
    return f"<li>{words}.{link}{remedy}</li>"


def _marked(words: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", text(words))


def _section(section: Section, drawings: list[Any], live: frozenset[str]) -> str:
    if section.key in live:
        cells = place_of(section.key)
    else:
        content, places, divisions = embedded(section.charts)
        drawings.append((content, places))
        count = min(section.beside, max(1, len(section.charts)))
        cells = "".join(f"<div class=cell>{each}</div>" for each in divisions)
        cells = f'<div class="cells n{count}">{cells}</div>'
    return f'<section id="{section.key}">{section_head(section)}{cells}</section>'


def _made_from(documents: Sequence[Document]) -> str:
    """Return date and files with short digests, of all documents."""
    origins = [each.origin for each in documents if each.origin]
    rows = {name: cell for each in origins for name, cell in zip(each[0].cells, each[-1].cells, strict=True)}
    date = rows.get("run", "").replace("T", " ").replace("+00:00", " UTC")
    known = {cell: name for name, cell in reversed(rows.items()) if cell.startswith(DIGEST)}
    files = [
        f"{text(name.rpartition('/')[2])} <code>{text(cell[len(DIGEST) :][:8])}</code>"
        for cell, name in reversed(known.items())
    ]
    shown = [
        text(date),
        *files[: LIMITS.files],
        *([f"{len(files) - LIMITS.files} more"] if len(files) > LIMITS.files else []),
    ]
    return f"<p class=made>{' · '.join(filter(None, shown))}</p>" if any(shown) else ""


def _origin(document: Document, *, several: bool) -> str:
    if not document.origin:
        return ""
    head = f"<h3>{text(document.heading)}</h3>" if several else ""
    return head + table(document.origin) + (details("Study file", document.study) if document.study else "")


def embedded(figures: Sequence[Figure]) -> tuple[dict[str, Any], list[Any], list[str]]:
    """Return Bokeh's JSON of figures and places, and their elements."""
    from fmuid.reports.render.bokeh_models import written as as_json
    from fmuid.reports.render.bokeh_renderer import drawing

    roots, ids = as_json(drawing(figures).figures)
    document = f"d{uuid.uuid4().hex}"
    elements = [f"{document}-{k}" for k in range(len(ids))]
    content = {document: {"version": version("bokeh"), "title": "", "roots": roots}}
    places = [{"docid": document, "roots": dict(zip(ids, elements, strict=True)), "root_ids": ids}]
    divisions = [
        f'<div id="{element}" data-root-id="{name}" style="display:contents"></div>'
        for element, name in zip(elements, ids, strict=True)
    ]
    return content, places, divisions


def _drawing(drawings: Sequence[Any]) -> tuple[str, str]:
    """Return digests of the scripts; elements with scripts and figures."""
    from fmuid.reports.render.style import DARK

    own, (known, library) = f"const DARK = {json.dumps(DARK)};\n{page_file('page.js')}", _library()
    figures = json.dumps(drawings, separators=(",", ":"))
    return f"{known} {_digest(own)}", f"{library}{_packed('figures', figures)}<script>{own}</script>\n"


@cache
def _library() -> tuple[str, str]:
    """Return the digest of Bokeh's library, and its element: packing takes a tenth of a second."""
    library = bokeh_library()
    return _digest(library), _packed("library", library)


def _digest(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"


def _packed(name: str, content: str) -> str:
    packed = base64.b64encode(gzip.compress(content.encode(), compresslevel=6, mtime=1)).decode()
    return f'<script type="text/plain" id="{name}">{packed}</script>\n'


def bokeh_library() -> str:
    """Return Bokeh's library for browsers."""
    path = resources.files("bokeh").joinpath("server", "static", "js", "bokeh.min.js")
    return path.read_text(encoding="utf-8")


def page_file(name: str) -> str:
    """Return a style or a script of pages."""
    return resources.files("fmuid.reports.render").joinpath(name).read_text(encoding="utf-8")
