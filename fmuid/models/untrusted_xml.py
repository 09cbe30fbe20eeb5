"""XML from untrusted files: model descriptions, system structures, parameter values.

A document type is refused: it excludes entity expansion (CWE-776) and external entities (CWE-611).
"""

from __future__ import annotations

import gc
import io
from collections.abc import Iterator
from contextlib import contextmanager
from xml.etree import ElementTree
from xml.parsers import expat

from fmuid.errors import InputError

LARGEST_XML = 256 * 2**20
"""Bytes of an XML file: about 800 000 variables; parsed, they take ten times as much memory."""
DEEPEST_NESTING = 200
"""Elements inside each other: FMI needs 5, SSP 2 for each level of nested systems; readers are recursive."""


def parse_xml(text: bytes, what: str) -> ElementTree.Element:
    """Return the root element of an XML text.

    Parameters
    ----------
    text : bytes
        Content in its declared encoding.
    what : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If it is not well-formed, has a document type, or is nested too deeply.
    """
    _check_head(text, what)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, UnicodeError, LookupError, ValueError) as error:
        raise InputError(f"{what}: not well-formed XML: {error}.") from None
    level = [root]
    for _ in range(DEEPEST_NESTING):
        level = [child for element in level for child in element]
        if not level:
            return root
    raise InputError(f"{what}: more than {DEEPEST_NESTING} nested elements. Nest it less deeply.")


def started_elements(text: bytes, what: str) -> Iterator[ElementTree.Element]:
    """Yield elements at their start tags; the caller may stop early."""
    _check_head(text, what)
    try:
        for _, element in ElementTree.iterparse(io.BytesIO(text), ("start",)):
            yield element
    except (ElementTree.ParseError, UnicodeError, LookupError, ValueError) as error:
        raise InputError(f"{what}: not well-formed XML: {error}.") from None


def xml_parser(what: str) -> expat.XMLParserType:
    """Return a parser with text positions that refuses a document type."""

    def refuse(*_: object) -> None:
        raise InputError(f"{what}: DOCTYPE is refused: it may load other files. Remove it.")

    made = expat.ParserCreate()
    made.StartDoctypeDeclHandler = refuse
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


class _RootReached(Exception):  # noqa: N818  # not an error
    """A document type precedes the root element (XML 1.0, 2.8)."""


def _check_head(text: bytes, what: str) -> None:
    def stop(*_: object) -> None:
        raise _RootReached

    head = xml_parser(what)
    head.StartElementHandler = stop
    try:
        head.Parse(text, True)
    except _RootReached:
        return
    except (expat.ExpatError, UnicodeError, LookupError, ValueError) as error:
        raise InputError(f"{what}: not well-formed XML: {error}.") from None
