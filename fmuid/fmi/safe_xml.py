"""XML from files that nobody vouches for: model descriptions, system structures, parameter values.

Neither FMI nor SSP has use for a document type. What one can do is refused with it: entities that multiply while they
are read ("billion laughs") and entities that stand for other files or addresses (CWE-776, CWE-611).
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.parsers import expat

from fmuid.errors import InputError

LARGEST_XML = 256 * 2**20
"""Bytes of an XML file: some 800 000 variables; what a reader makes of it takes ten times as much memory."""
DEEPEST = 200
"""Elements inside each other: FMI needs 5 and a nested system of SSP 2 for each level; readers are recursive."""


def parse(text: bytes, what: str) -> ElementTree.Element:
    """Return the root element of an XML text.

    Parameters
    ----------
    text : bytes
        The file's content; its encoding is what it says.
    what : str
        What messages call it.

    Raises
    ------
    InputError
        If it is not well-formed, has a document type, or is nested deeper than `DEEPEST`.
    """
    _check_head(text, what)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, UnicodeError, LookupError, ValueError) as error:
        raise InputError(f"{what} is not well-formed XML: {error}") from None
    level = [root]
    for _ in range(DEEPEST):
        level = [child for element in level for child in element]
        if not level:
            return root
    raise InputError(f"{what} has more than {DEEPEST} elements inside each other; it must be nested less deeply")


def started(text: bytes, what: str) -> Iterator[ElementTree.Element]:
    """Yield the elements of an XML text as they begin, with their attributes; who has seen enough reads no further.

    Raises
    ------
    InputError
        As `parse`, as far as the text is read.
    """
    _check_head(text, what)
    try:
        for _, element in ElementTree.iterparse(io.BytesIO(text), ("start",)):
            yield element
    except (ElementTree.ParseError, UnicodeError, LookupError, ValueError) as error:
        raise InputError(f"{what} is not well-formed XML: {error}") from None


def parser(what: str) -> expat.XMLParserType:
    """Return a parser, for whoever needs to know where in the text things stand; it refuses a document type."""

    def refuse(*_: object) -> None:
        raise InputError(
            f"{what} has a DOCTYPE, which may make a reader fetch other files or fill its memory; remove it, no FMI or "
            "SSP file needs one"
        )

    made = expat.ParserCreate()
    made.StartDoctypeDeclHandler = refuse
    return made


class _RootReached(Exception):  # noqa: N818  # not an error
    """A document type can only come before the root element (XML 1.0, section 2.8)."""


def _check_head(text: bytes, what: str) -> None:
    def stop(*_: object) -> None:
        raise _RootReached

    head = parser(what)
    head.StartElementHandler = stop
    try:
        head.Parse(text, True)
    except _RootReached:
        return
    except (expat.ExpatError, UnicodeError, LookupError, ValueError) as error:
        raise InputError(f"{what} is not well-formed XML: {error}") from None
