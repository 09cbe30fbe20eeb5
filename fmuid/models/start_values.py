"""Start values replaced in the text of a model description.

Other bytes are kept. A binary does not read the XML (FMI 2.0.4, 2.2.7; FMI 3.0.2, 2.4.7.5): importers must set
changed values. An annotation keeps their names: `Description.applied`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import cached_property
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from fmuid.errors import InputError
from fmuid.models.description import FLOATS, INTEGERS
from fmuid.models.untrusted_xml import located_parser, xml_attribute

Value = float | int | bool | str

TOOL, ANNOTATION = "fmuid", "org.fmuid.applied"
"""Identify the annotation: ``Tool name`` of FMI 2.0, ``Annotation type`` of FMI 3.0."""
_REALS = ("Real", *FLOATS)
_INTEGERS = ("Integer", "Enumeration", *INTEGERS)
_TAG = re.compile(r"""<[^\s/>]+(?P<attributes>(?:\s+[^\s=>/]+\s*=\s*(?:"[^"]*"|'[^']*'))*)\s*/?>""")
_ATTRIBUTE = re.compile(r"""\s+(?P<name>[^\s=]+)\s*=\s*(?P<quote>["'])(?P<value>.*?)(?P=quote)""", re.DOTALL)
_ELEMENT = re.compile(r"(?P<array>.+)\[(?P<subscripts>\d+(?:,\d+)*)\]")


def with_starts(text: bytes, values: Mapping[str, float | int | bool]) -> bytes:
    """Return a modelDescription.xml with other, annotated start values; elements of arrays are ``x[2,3]``.

    `InputError`: the XML is not well-formed, a variable is missing or an array, or a value does not fit its type.
    """
    located = _LocatedXml(text)
    sizes: dict[Element, int] = {}
    literals: dict[Element, dict[int | None, str]] = {}
    for name, value in values.items():
        found = located.find(name)
        if found is None:
            raise InputError(f"modelDescription.xml: no scalar variable {name!r} with a start value.")
        typed, sizes[typed], element = found
        literals.setdefault(typed, {})[element] = _literal(name, typed.tag, value)
    edits = [located.edited_tag(typed, some, sizes[typed]) for typed, some in literals.items()]
    edits.append(located.annotation(list(values)))
    decoded = located.text
    for begin, end, new in sorted(edits, reverse=True):
        decoded = decoded[:begin] + new + decoded[end:]
    return decoded.encode(located.encoding)


class _LocatedXml:
    """The elements of the text, with the byte positions of their tags."""

    def __init__(self, text: bytes) -> None:
        self.raw = text
        self.encoding = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}.get(text[:2], "utf-8")
        self.begins: dict[Element, int] = {}
        self.ends: dict[Element, int] = {}
        parser, tree = located_parser("modelDescription.xml"), TreeBuilder()

        def declaration(_version: str, encoding: str | None, _standalone: int) -> None:
            if encoding and not self.encoding.startswith("utf-16"):
                self.encoding = encoding

        def begin(tag: str, attributes: dict[str, str]) -> None:
            self.begins[tree.start(tag, attributes)] = parser.CurrentByteIndex

        def end(tag: str) -> None:
            self.ends[tree.end(tag)] = parser.CurrentByteIndex

        parser.XmlDeclHandler, parser.StartElementHandler, parser.EndElementHandler = declaration, begin, end
        try:
            parser.Parse(text, True)
            self.text = text.decode(self.encoding)
        except (expat.ExpatError, UnicodeError, LookupError) as error:
            raise InputError(f"modelDescription.xml: not well-formed XML: {error}.") from None
        self.root = tree.close()
        self.version_2 = self.root.get("fmiVersion", "").startswith("2")
        self.variables = {each.get("name", ""): each for each in self.root.iterfind("ModelVariables/*")}

    def find(self, name: str) -> tuple[Element, int, int | None] | None:
        """Return the element with a scalar's start, its size, and the index."""
        declared, index = self.variables.get(name), None
        match = _ELEMENT.fullmatch(name)
        array = self.variables.get(match["array"]) if match else None
        if declared is None and match and array is not None and array.find("Dimension") is not None:
            declared = array
            index = _linear(self._shape(array), [int(subscript) for subscript in match["subscripts"].split(",")])
        typed = None if declared is None else _typed(declared)
        if declared is None or typed is None or (declared.find("Dimension") is None) != (index is None):
            return None
        size = math.prod(self._shape(declared))
        if typed.get("start") is None:  # of variables with one reference one has the start (FMI 2.0.4, 2.2.7)
            reference = declared.get("valueReference")
            alike = (_typed(each) for each in self.variables.values() if each.get("valueReference") == reference)
            same = (
                each for each in alike if each is not None and each.tag == typed.tag and each.get("start") is not None
            )
            typed = next(same, typed)
        return typed, size, index

    def edited_tag(self, typed: Element, literals: Mapping[int | None, str], size: int) -> tuple[int, int, str]:
        """Return an edit (begin, end, new text) of a tag's starts: of a scalar (key None) or elements of an array."""
        begin = self._character(self.begins[typed])
        tag = _TAG.match(self.text, begin)
        if tag is None:
            raise InputError(f"modelDescription.xml: tag cannot be edited: {self.text[begin : begin + 40]!r}.")
        for attribute in _ATTRIBUTE.finditer(self.text, *tag.span("attributes")):
            if attribute["name"] == "start":
                return *attribute.span("value"), _with_elements(attribute["value"], literals, size)
        return tag.end("attributes"), tag.end("attributes"), f' start="{_with_elements("", literals, size)}"'

    def annotation(self, names: list[str]) -> tuple[int, int, str]:
        """Return an edit (begin, end, new text) that annotates these names."""
        if self.version_2:
            around, tag, key, mark = "VendorAnnotations", "Tool", "name", TOOL
        else:
            around, tag, key, mark = "Annotations", "Annotation", "type", ANNOTATION
        old = self.root.find(f"{around}/{tag}[@{key}='{mark}']")
        known = [] if old is None else [each.get("name", "") for each in old.iter("Start")]
        listed = "".join(f"<Start name={xml_attribute(name)}/>" for name in dict.fromkeys([*known, *names]))
        note = f'<{tag} {key}="{mark}"><Applied>{listed}</Applied></{tag}>'
        if old is not None:
            bracket = ">".encode(self.encoding)
            end = self.raw.index(bracket, self.ends[old]) + len(bracket)
            return self._character(self.begins[old]), self._character(end), note
        holder = self.root.find(around)
        if holder is not None:
            place = self._character(self.ends[holder])
            return place, place, note
        variables = self.root.find("ModelVariables") if self.version_2 else None
        place = self._character(self.ends[self.root] if variables is None else self.begins[variables])
        return place, place, f"<{around}>{note}</{around}>\n"

    def _character(self, position: int) -> int:
        return len(self.raw[:position].decode(self.encoding))

    def _shape(self, declared: Element) -> list[int]:
        return [
            int(each.get("start") or self._starts.get(each.get("valueReference")) or 0)
            for each in declared.iterfind("Dimension")
        ]

    @cached_property
    def _starts(self) -> dict[str | None, str | None]:
        return {each.get("valueReference"): each.get("start") for each in self.variables.values()}


def _typed(declared: Element) -> Element | None:
    """Return the element with a variable's type: its own in FMI 3.0."""
    if declared.tag != "ScalarVariable":
        return declared
    return next((each for each in declared if each.tag in (*_REALS, *_INTEGERS, "Boolean", "String")), None)


def _linear(shape: list[int], subscripts: list[int]) -> int | None:
    """Return an element's index, row by row (FMI 3.0.2, 2.4.7.5.1), if any."""
    if len(shape) != len(subscripts) or not all(1 <= i <= n for i, n in zip(subscripts, shape, strict=True)):
        return None
    place = 0
    for subscript, size in zip(subscripts, shape, strict=True):
        place = place * size + subscript - 1
    return place


def _literal(name: str, kind: str, value: float | int | bool) -> str:
    """Return a value as XML text; floats read back exactly."""
    if kind == "Boolean" and value in (0, 1):
        return "true" if value else "false"
    if kind in _REALS and not isinstance(value, bool) and math.isfinite(value):
        return repr(float(value))
    if kind in _INTEGERS and not isinstance(value, bool) and float(value).is_integer():
        return str(int(value))
    raise InputError(f"variable {name!r}: {value!r} is no start value of type {kind}.")


def _with_elements(starts: str, literals: Mapping[int | None, str], size: int) -> str:
    """Return an attribute's text with replaced starts; one stands for all."""
    if None in literals:
        return literals[None]
    parts = re.split(r"(\s+)", starts.strip())  # words at even indices, white space at odd ones
    if len(parts) == 1 and starts.strip():
        parts = [*(parts[0], " ") * (size - 1), parts[0]]
    if (len(parts) + 1) // 2 != size or not starts.strip():
        raise InputError(f"array of {size} elements: start values {starts!r} must be one or {size}.")
    for place, literal in literals.items():
        parts[2 * (place or 0)] = literal
    return "".join(parts)
