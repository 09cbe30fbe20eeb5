"""XML from untrusted files: model descriptions, system structures, parameter values.

A document type is refused: it excludes entity expansion (CWE-776) and external entities (CWE-611).
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from xml.etree import ElementTree
from xml.parsers import expat

from fmuid.errors import InputError

LARGEST_XML = 256 * 2**20  # bytes of an XML file: about 800 000 variables; parsed, they take ten times as much memory
DEEPEST_NESTING = 200
"""Elements inside each other: FMI needs 5, SSP 2 for each level of nested systems; readers are recursive."""


def parse_xml(text: bytes, what: str) -> ElementTree.Element:
    """Return the root element of an XML text in its declared encoding; `what` names it in messages.

    `InputError`: it is not well-formed, has a document type, or is nested too deeply.
    """
    try:
        root = ElementTree.fromstring(text, ElementTree.XMLParser(target=_Builder(what)))
    except (ElementTree.ParseError, UnicodeError, LookupError, ValueError) as error:
        raise InputError(f"{what}: not well-formed XML: {error}.") from None
    level = [root]
    for _ in range(DEEPEST_NESTING):
        level = [child for element in level for child in element]
        if not level:
            return root
    raise InputError(f"{what}: more than {DEEPEST_NESTING} nested elements. Nest it less deeply.")


def located_parser(what: str) -> expat.XMLParserType:
    """Return a parser with text positions that refuses a document type."""
    made = expat.ParserCreate()
    made.StartDoctypeDeclHandler = _Builder(what).doctype
    return made


@contextmanager
def uncollected() -> Iterator[None]:
    """Switch off the garbage collector, which is slow over large models."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class _Builder(ElementTree.TreeBuilder):
    """Tree builder that refuses a document type; it precedes the root element (XML 1.0, 2.8)."""

    def __init__(self, what: str) -> None:
        super().__init__()
        self._what = what

    def doctype(self, *_: object) -> None:
        raise InputError(f"{self._what}: DOCTYPE is refused: it may load other files. Remove it.")


_ESCAPES = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
)


def xml_attribute(text: str) -> str:
    """Return a quoted value of an attribute; `xml.sax.saxutils` would load urllib and ssl."""
    return f'"{text.translate(_ESCAPES)}"'
