"""Start values in the raw text of a modelDescription.xml, replaced in place: all other bytes are kept.

An FMU's binary has its own start values and does not read the XML (FMI 2.0.4, section 2.2.7, "start"; FMI 3.0.2,
section 2.4.7.5): values changed in the XML act only where the importer sets them. So the names of the
changed variables are kept in an annotation, and the importer sets `Description.applied` before the initialisation.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.parsers import expat

from fmuid.errors import InputError
from fmuid.models.untrusted_xml import xml_parser

Value = float | int | bool | str

TOOL, ANNOTATION = "fmuid", "org.fmuid.applied"
"""Identify the annotation: ``Tool name`` of FMI 2.0, ``Annotation type`` of FMI 3.0."""
_REALS = ("Real", "Float64", "Float32")
_NUMBERS = (*_REALS, "Integer", "Enumeration", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
_TAG = re.compile(r"""<[^\s/>]+(?P<attributes>(?:\s+[^\s=>/]+\s*=\s*(?:"[^"]*"|'[^']*'))*)\s*/?>""")
_ATTRIBUTE = re.compile(r"""\s+(?P<name>[^\s=]+)\s*=\s*(?P<quote>["'])(?P<value>.*?)(?P=quote)""", re.DOTALL)
_ELEMENT = re.compile(r"(?P<array>.+)\[(?P<subscripts>\d+(?:,\d+)*)\]")


@dataclass
class _Declared:
    """A variable as the text declares it; `position` is the first byte of the tag that carries the start."""

    name: str
    reference: str | None
    kind: str = ""
    start: str | None = None
    position: int = -1
    dimensions: list[Mapping[str, str]] = field(default_factory=list)


def with_starts(text: bytes, values: Mapping[str, float | int | bool]) -> bytes:
    """Return a model description with other start values, and with the annotation that names them.

    Parameters
    ----------
    text : bytes
        The modelDescription.xml.
    values : mapping of str to number or bool
        In the units of the variables; elements of arrays (FMI 3.0) as ``x[2,3]``.

    Raises
    ------
    InputError
        If the text is not well-formed XML, a variable is missing or a whole array, or its type cannot take the value.
    """
    scan = _Scan(text)
    sizes: dict[int, int] = {}
    literals: dict[int, dict[int | None, str]] = {}
    for name, value in values.items():
        found = scan.find(name)
        if found is None:
            raise InputError(f"the model description has no scalar variable {name!r} with a start value")
        declared, element = found
        literals.setdefault(declared.position, {})[element] = _literal(name, declared.kind, value)
        sizes[declared.position] = scan.size(declared)
    edits = [scan.edited_tag(position, some, sizes[position]) for position, some in literals.items()]
    edits.append(scan.annotation([*scan.applied, *(name for name in values if name not in scan.applied)]))
    decoded = scan.text
    for begin, end, new in sorted(edits, reverse=True):
        decoded = decoded[:begin] + new + decoded[end:]
    return decoded.encode(scan.encoding)


class _Scan:
    """One pass over the text: the byte positions of variables and of annotations, present or to be added."""

    def __init__(self, text: bytes) -> None:
        self.raw, self.version = text, ""
        self.encoding = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}.get(text[:2], "utf-8")
        self.variables: dict[str, _Declared] = {}
        self.references: dict[str | None, str | None] = {}
        self.applied: list[str] = []
        self.note: tuple[int, int] | None = None
        self.places: dict[str, int] = {}
        self._stack: list[str] = []
        self._current = _Declared("", None)
        self._parser = parser = xml_parser("modelDescription.xml")
        parser.XmlDeclHandler = self._declaration
        parser.StartElementHandler, parser.EndElementHandler = self._begin, self._end
        try:
            parser.Parse(text, True)
            self.text = text.decode(self.encoding)
        except (expat.ExpatError, UnicodeError, LookupError) as error:
            raise InputError(f"modelDescription.xml is not well-formed XML: {error}") from None

    def find(self, name: str) -> tuple[_Declared, int | None] | None:
        """Return the declaration with a scalar variable's start, and its index in the list of starts of an array."""
        declared, element = self.variables.get(name), None
        match = _ELEMENT.fullmatch(name)
        array = self.variables.get(match["array"]) if match else None
        if declared is None and match and array is not None and array.dimensions:
            declared = array
            element = _linear(self._shape(declared), [int(subscript) for subscript in match["subscripts"].split(",")])
        if declared is None or declared.position < 0 or bool(declared.dimensions) != (element is not None):
            return None
        if declared.start is None:  # of the variables that share a reference one has the start (FMI 2.0.4, 2.2.7)
            same = (v for v in self.variables.values() if (v.kind, v.reference) == (declared.kind, declared.reference))
            declared = next((v for v in same if v.start is not None), declared)
        return declared, element

    def size(self, declared: _Declared) -> int:
        """Return how many elements an array has."""
        return math.prod(self._shape(declared))

    def edited_tag(self, position: int, literals: Mapping[int | None, str], size: int) -> tuple[int, int, str]:
        """Return an edit (begin, end, new text) that gives the tag at a byte position these starts.

        They are the start of a scalar, under the key None, or those of some elements of an array of this size.
        """
        begin = self._character(position)
        tag = _TAG.match(self.text, begin)
        if tag is None:
            raise InputError(f"modelDescription.xml has a tag that cannot be edited: {self.text[begin : begin + 40]!r}")
        for attribute in _ATTRIBUTE.finditer(self.text, *tag.span("attributes")):
            if attribute["name"] == "start":
                return *attribute.span("value"), _with_elements(attribute["value"], literals, size)
        return tag.end("attributes"), tag.end("attributes"), f' start="{_with_elements("", literals, size)}"'

    def annotation(self, names: list[str]) -> tuple[int, int, str]:
        """Return an edit (begin, end, new text) after which the annotation lists these names."""
        from xml.sax.saxutils import quoteattr  # and with it urllib: who simulates needs neither

        listed = "".join(f"<Start name={quoteattr(name)}/>" for name in names)
        old = self.version.startswith("2")
        tag, mark = ("Tool", f'name="{TOOL}"') if old else ("Annotation", f'type="{ANNOTATION}"')
        note = f"<{tag} {mark}><Applied>{listed}</Applied></{tag}>"
        if self.note is not None:
            return self._character(self.note[0]), self._character(self.note[1]), note
        around = "VendorAnnotations" if old else "Annotations"
        if around in self.places:
            place = self._character(self.places[around])
            return place, place, note
        place = self._character(self.places["ModelVariables" if old else "end"])
        return place, place, f"<{around}>{note}</{around}>\n"

    def _character(self, position: int) -> int:
        return len(self.raw[:position].decode(self.encoding))

    def _shape(self, declared: _Declared) -> list[int]:
        """Return the sizes of an array's dimensions: given, or the start of a structural parameter."""
        sizes = (d.get("start") or self.references.get(d.get("valueReference")) for d in declared.dimensions)
        return [int(size or 0) for size in sizes]

    # --- handlers of the parser

    def _declaration(self, _version: str, encoding: str | None, _standalone: int) -> None:
        if encoding and not self.encoding.startswith("utf-16"):
            self.encoding = encoding

    def _begin(self, tag: str, attributes: dict[str, str]) -> None:
        inside, position = self._stack[1:], self._parser.CurrentByteIndex
        if not self._stack:
            self.version = attributes.get("fmiVersion", "")
        elif not inside:
            if tag == "ModelVariables":
                self.places[tag] = position
        elif inside == ["ModelVariables"]:
            self._current = _Declared(attributes.get("name", ""), attributes.get("valueReference"))
            self.variables[self._current.name] = self._current
            if tag != "ScalarVariable":  # FMI 3.0: the element itself is of a type
                self._type(tag, attributes, position)
        elif inside == ["ModelVariables", "ScalarVariable"] and tag in (*_NUMBERS, "Boolean", "String"):
            self._type(tag, attributes, position)
        elif inside[0] == "ModelVariables" and len(inside) == 2 and tag == "Dimension":
            self._current.dimensions.append(attributes)
        elif (inside, tag, attributes.get("name")) == (["VendorAnnotations"], "Tool", TOOL) or (
            inside,
            tag,
            attributes.get("type"),
        ) == (["Annotations"], "Annotation", ANNOTATION):
            self.note = (position, -1)
        elif self.note is not None and self.note[1] < 0 and tag == "Start":
            self.applied.append(attributes.get("name", ""))
        self._stack.append(tag)

    def _type(self, tag: str, attributes: dict[str, str], position: int) -> None:
        current = self._current
        current.kind, current.start, current.position = tag, attributes.get("start"), position
        self.references.setdefault(current.reference, current.start)

    def _end(self, tag: str) -> None:
        self._stack.pop()
        position = self._parser.CurrentByteIndex
        if not self._stack:
            self.places["end"] = position
        elif len(self._stack) == 1 and tag in ("VendorAnnotations", "Annotations"):
            self.places[tag] = position
        elif len(self._stack) == 2 and self.note is not None and self.note[1] < 0:
            bracket = ">".encode(self.encoding)
            self.note = (self.note[0], self.raw.index(bracket, position) + len(bracket))


def _linear(shape: list[int], subscripts: list[int]) -> int | None:
    """Return the index of an array's element, row by row (FMI 3.0.2, section 2.4.7.5.1); None outside the array."""
    if len(shape) != len(subscripts) or not all(1 <= i <= n for i, n in zip(subscripts, shape, strict=True)):
        return None
    place = 0
    for subscript, size in zip(subscripts, shape, strict=True):
        place = place * size + subscript - 1
    return place


def _literal(name: str, kind: str, value: float | int | bool) -> str:
    """Return a value as XML writes it for a type; floats read back exactly."""
    if kind == "Boolean" and value in (0, 1):
        return "true" if value else "false"
    if kind in _REALS and not isinstance(value, bool) and math.isfinite(value):
        return repr(float(value))
    if kind in _NUMBERS and kind not in _REALS and not isinstance(value, bool) and float(value).is_integer():
        return str(int(value))
    raise InputError(f"variable {name!r} is of type {kind} and cannot start at {value!r}")


def _with_elements(starts: str, literals: Mapping[int | None, str], size: int) -> str:
    """Return an attribute's text with some starts replaced; a single start of an array is that of all elements."""
    if None in literals:
        return literals[None]
    parts = re.split(r"(\s+)", starts.strip())  # words at even indices, white space at odd ones
    if len(parts) == 1 and starts.strip():
        parts = [*(parts[0], " ") * (size - 1), parts[0]]
    if (len(parts) + 1) // 2 != size or not starts.strip():
        raise InputError(f"an array of {size} elements has the start values {starts!r}; they must be one or {size}")
    for place, literal in literals.items():
        parts[2 * (place or 0)] = literal
    return "".join(parts)
