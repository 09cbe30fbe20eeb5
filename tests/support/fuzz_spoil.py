"""Ways to spoil studies, XML and bytes, drawn from a random generator."""

import copy
import datetime
import io
import json
import math
import re
import zipfile
from collections.abc import Iterator, Mapping
from random import Random
from typing import Any
from xml.etree import ElementTree

Tree = dict[str, Any]

WORDS = ["", " ", "R ", "x" * 300, *"\0\n\t\u2028\u202e\x7f\\'\"", "\x1b[2J", "\\[", "$\\frac"]
_PLAIN = '''
R L i u i_start der(i) time coil R[1] x[1,2] a.b .. ../x a/b / /dev/null . ~ é µΩ·m 🧲 [red] [/] [/red] {} {0} %s
% $x$ $ _ ^{ # nan inf -inf 1e400 1e-400 0 -0 1,5 1_0 0x10 true True NaT NA null None ١ ½ estimate linear zoh
pchip rk4 rk45 cvode model-exchange co-simulation forward fmu global marquardt multi-start
differential-evolution huber run.csv study.toml Coil.fmu *.csv **
""" '''
WORDS += _PLAIN.split()
"""Texts that trip readers, printers, figures and file systems, and words that mean something elsewhere."""
NUMBERS: list[int | float] = [0, 1, -1, 2, 3, 10, 1000, 10**30, -(10**30), 10**400, 2**31 - 1, 2**31, 2**32, 2**53 + 1]
NUMBERS += [2**63 - 1, 2**63, 2**64, 0.0, -0.0, 0.5, 1.0, 1.5, -1.5, 1e-3, 1e-12, 1e-300, 5e-324, 1e12, 1e150, 1e300]
NUMBERS += [1.7976931348623157e308, -1e300, math.inf, -math.inf, math.nan]


def nasty(rng: Random, depth: int = 0) -> Any:
    """Return a value of any kind that TOML has."""
    kind = rng.randrange(12 if depth < 3 else 8)
    if kind < 3:
        return rng.choice(WORDS)
    if kind < 7:
        return rng.choice(NUMBERS)
    if kind < 8:
        return rng.choice([True, False, datetime.date(2024, 2, 29), datetime.datetime(1, 1, 1), datetime.time(23, 59)])
    if kind < 10:
        return [nasty(rng, depth + 1) for _ in range(rng.choice([0, 1, 1, 2, 3, 5]))]
    return {rng.choice(WORDS): nasty(rng, depth + 1) for _ in range(rng.choice([0, 1, 1, 2, 3]))}


def places(node: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all nodes below one."""
    if isinstance(node, dict | list):
        for key in node if isinstance(node, dict) else range(len(node)):
            yield (*above, key)
            yield from places(node[key], (*above, key))


def spoil_tree(rng: Random, given: Tree) -> Tree:
    """Return a copy of nested tables and lists with one to three changes anywhere in it."""
    data = copy.deepcopy(given)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        found = list(places(data))
        if not found:
            return data
        *above, key = rng.choice(found)
        node: Any = data
        for step in above:
            node = node[step]
        way = rng.randrange(18)
        if way >= 10:
            node[key] = scaled(rng, node[key])
        elif way < 5:
            node[key] = nasty(rng)
        elif way == 5:
            del node[key]
        elif way == 6 and isinstance(node, dict):
            node[rng.choice(WORDS) if rng.random() < 0.5 else str(key) + rng.choice("sx_ ")] = node.pop(key)
        elif way == 7 and isinstance(node, dict):
            node[rng.choice(WORDS)] = nasty(rng)
        elif way == 8:
            node[key] = [node[key]] * rng.choice([1, 2, 3])
        else:
            other: Any = data
            for step in (path := rng.choice(found)):
                other = other[step] if isinstance(other, dict) or step in range(len(other or ())) else other
            node[key] = copy.deepcopy(other) if path[: len(above) + 1] != (*above, key) else nasty(rng)
    return data


OTHERS: tuple[Any, ...] = (None, True, 7, -1.5, "text", [], ["text"], [1.0, 2.0], {}, {"key": [1]}, [[{}]])
"""Values that stand where another one stood."""


def with_changed_type(given: Tree, rng: Random) -> tuple[Tree, str]:
    """Return a copy with one value of another type, and where it is; all keys of a depth are as likely."""
    data, found = copy.deepcopy(given), list(places(given))
    depth = rng.choice(sorted({len(place) for place in found}))
    *above, key = rng.choice([place for place in found if len(place) == depth])
    node: Any = data
    for step in above:
        node = node[step]
    node[key] = copy.deepcopy(rng.choice([each for each in OTHERS if type(each) is not type(node[key])]))
    return data, f"{'.'.join(map(str, [*above, key]))} = {node[key]!r}"


def scaled(rng: Random, value: Any) -> Any:
    """Return a value of the same kind, numbers larger, smaller or of the other sign."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value * rng.choice([-1, 0, 2, 0.5, 1e-3, 1e3, 1e12, 1e-12, 1e150])
    if isinstance(value, list):
        return [scaled(rng, item) for item in value]
    return {key: scaled(rng, item) for key, item in value.items()} if isinstance(value, dict) else value


def toml_text(value: Any) -> str:
    """Return a value as TOML writes it, tables inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return {math.inf: "inf", -math.inf: "-inf"}.get(value, "nan" if math.isnan(value) else repr(value))
    if isinstance(value, int):
        return str(value)
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_text, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{quoted(str(key))} = {toml_text(item)}" for key, item in value.items()) + "}"
    return quoted(str(value))


def quoted(text: str) -> str:
    """Return a text as a TOML basic string."""
    return json.dumps(text).replace("\x7f", "\\u007f") if text.isascii() else json.dumps(text, ensure_ascii=False)


def toml_file(data: Tree) -> bytes:
    """Return a study file."""
    return "".join(f"{quoted(key)} = {toml_text(value)}\n" for key, value in data.items()).encode()


def spoil_bytes(rng: Random, given: bytes) -> bytes:
    """Return some bytes with a few of them changed, cut off, removed, doubled or moved."""
    data = bytearray(given)
    for _ in range(rng.choice([1, 1, 2, 4, 16])):
        if not data:
            break
        place, length = rng.randrange(len(data)), rng.choice([1, 1, 2, 4, 8, 32, 256])
        way = rng.randrange(7)
        if way == 0:
            data[place] ^= 1 << rng.randrange(8)
        elif way == 1:
            data[place] = rng.choice([0, 0xFF, 0x7F, 0x80, 0x0A, 0x22, 0x5B, rng.randrange(256)])
        elif way == 2:
            del data[place : place + length]
        elif way == 3:
            data[place:place] = data[place : place + length] * rng.choice([1, 2, 50])
        elif way == 4:
            data[place : place + 4] = rng.choice([0, 1, 2**31, 2**32 - 1]).to_bytes(4, "little")
        elif way == 5:
            data[place:place] = rng.randbytes(length)
        elif rng.random() < 0.3:
            del data[place:]
    return bytes(data)


def mutated(rng: Random, data: bytes) -> bytes:
    """Return damaged bytes; of a packed file every other time with a damaged member, packed anew."""
    if data[:2] != b"PK" or rng.random() < 0.5:
        return spoil_bytes(rng, data)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice([name for name, content in files.items() if content])
    return packed(files | {name: spoil_bytes(rng, files[name])})


def packed(files: Mapping[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    """Return an archive of files."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def spoil_xml(rng: Random, text: str) -> bytes:
    """Return an XML text with a few changes of its elements, attributes or bytes."""
    if rng.random() < 0.2:
        return spoil_bytes(rng, text.encode())
    root = ElementTree.fromstring(text)
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        parents = {child: parent for parent in root.iter() for child in parent}
        element = rng.choice(list(root.iter()))
        way = rng.randrange(9)
        if way < 5 and element.attrib:
            value = rng.choice([*WORDS, *map(str, NUMBERS), "-5", "4294967295", "1 2 3", "INF", "NaN", "9" * 5000])
            element.set(rng.choice(list(element.attrib)), _xml_safe(value))
        elif way == 5 and element.attrib:
            del element.attrib[rng.choice(list(element.attrib))]
        elif way == 6:
            element.tag = rng.choice(list(root.iter())).tag
        elif way == 7 and element in parents:
            parents[element].remove(element)
        elif element in parents:
            target = rng.choice([e for e in root.iter() if e not in set(element.iter())])
            target.insert(rng.randrange(len(target) + 1), copy.deepcopy(element))
    written: bytes = ElementTree.tostring(root, rng.choice(["utf-8", "utf-8", "utf-16", "iso-8859-1"]))
    return written


def _xml_safe(text: str) -> str:
    return re.sub(r"[\0-\x08\x0b\x0c\x0e-\x1f]", "?", text)
