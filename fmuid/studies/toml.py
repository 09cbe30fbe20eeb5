"""Study files as TOML: reading, overriding single values, and checking table by table.

Nothing here knows what a study means; that is in `fmuid.studies.study`. Every refusal is one sentence that names the
file, the table, the key and what was expected there.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from fmuid.errors import InputError
from fmuid.studies.toml_text import UnreadableError, float_of, parsed
from fmuid.text import nearest

T = TypeVar("T")

TOP = "the file"
"""What messages call the part of a file above its first table."""

# Tables whose keys are names of FMU variables: `--set` takes all that is left of its path as one name there.
_NAME_TABLES = re.compile(
    r"model\.(values|connectors)|noise\.(variance|start)|experiments\.\d+\.(inputs|outputs|interpolation|units)"
    r"|batch\.(values|sample\.ranges|noise\.(std|truth))"
)
# Tables that `--set` may begin where the file has none.
_OPTIONAL_TABLES = re.compile(
    r"model|model\.(values|connectors)|isolation|parameters|prior|noise|estimator|uncertainty|experiments\.\d+\.units|parameters\..+\.prior"
    r"|uncertainty\.posterior|batch|batch\.(values|sample|sample\.ranges|noise|noise\.(std|truth))"
)
_SEGMENT = re.compile(r"""\s*(?:"([^"]*)"|'([^']*)'|([^."'\s]+))\s*(?:\.|$)""")


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    InputError
        If the file is missing, a folder, no UTF-8 text or no valid TOML (with the line).
    """
    try:
        text = path.read_text(encoding="utf-8")
        return parsed(text)
    except FileNotFoundError:
        beside = sorted(p.name for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
        raise InputError(f"{path}: there is no such study file{nearest(path.name, beside)}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder, not a study file (.toml)") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a study file: it is not UTF-8 text") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except UnreadableError as error:
        raise InputError(f"{path} is not a study file: {error}") from None
    except tomllib.TOMLDecodeError as error:
        said = str(error)
        line = re.search(r"at line (\d+)", said)
        there = text.split("\n")[int(line[1]) - 1].strip() if line else ""
        raise InputError(
            f"{path} is not valid TOML: {said[0].lower()}{said[1:]}" + (f": {there}" if there else "")
        ) from None


def show(value: object) -> str:
    """Return `value` as it would stand in a TOML file, shortened, for use in a sentence."""
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list):
        return "a list" if len(value) > 4 else "[" + ", ".join(show(item) for item in value) + "]"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


# --- overrides --------------------------------------------------------------------------


def override(data: dict[str, Any], setting: str, file: str) -> None:
    """Set one value of a study in place, as ``--set parameters.Rs.start=9`` asks.

    Parameters
    ----------
    data
        The content of the study file.
    setting
        ``path=value``. The path is dotted; list entries go by number (``experiments.0.table``); names that contain
        dots may be quoted (``parameters."drive.M".start``) and need not be where only one reading is possible. The
        value is TOML, or else a string.
    file
        The study file's name for messages.

    Raises
    ------
    InputError
        If the setting has no ``=``, or its path leads nowhere.
    """
    path, equals, text = setting.partition("=")
    segments = _segments(path)
    if not equals or not segments:
        raise InputError(f"--set {setting}: expected path=value, as in --set parameters.Rs.start=9")
    _assign(data, segments, _value(text.strip()), (), f"--set {setting}: {file}")


def _segments(path: str) -> list[str]:
    """Split a dotted path at the dots outside quotes; empty where it is not a path."""
    found, position = [], 0
    while position < len(path):
        match = _SEGMENT.match(path, position)
        if match is None:
            return []
        found.append(next(group for group in match.groups() if group is not None))
        position = match.end()
    return found if not path.rstrip().endswith(".") else []


def _value(text: str) -> Any:
    try:
        found = parsed(f"value = {text}")
    except (UnreadableError, tomllib.TOMLDecodeError):
        return text
    return found["value"] if len(found) == 1 else text


def _assign(node: Any, segments: Sequence[str], value: Any, above: tuple[str, ...], where: str) -> None:
    """Walk down `node` along `segments` and set the last one to `value`."""
    key: Any
    if isinstance(node, list):
        key, rest = _index(node, segments, above, where), segments[1:]
    elif isinstance(node, dict):
        key, rest = _key(node, segments, value, above, where)
    else:
        raise InputError(f"{where} has {show(node)} for {'.'.join(above)}, which has no key {segments[0]!r}")
    if rest:
        _assign(node[key], rest, value, (*above, str(key)), where)
    else:
        node[key] = value


def _index(node: list[Any], segments: Sequence[str], above: tuple[str, ...], where: str) -> int:
    if not segments[0].isdecimal() or int(segments[0]) >= len(node):
        name = ".".join(above)
        raise InputError(
            f"{where} has no {name}.{segments[0]}: the entries of {name} are numbered 0 to {len(node) - 1}"
        )
    return int(segments[0])


def _key(
    node: dict[str, Any], segments: Sequence[str], value: Any, above: tuple[str, ...], where: str
) -> tuple[str, Sequence[str]]:
    """Return the key of `node` that `segments` start with, and the segments left."""
    joined = [".".join(segments[: count + 1]) for count in range(len(segments))]
    here = ".".join(above)
    present = [count for count, name in enumerate(joined) if name in node]
    if len(present) > 1:
        names = " or ".join(f'"{joined[count]}"' for count in present)
        raise InputError(f"{where} has several keys this path may mean in {here}: quote the one meant, {names}")
    if present:
        return joined[present[0]], segments[present[0] + 1 :]
    if _NAME_TABLES.fullmatch(here) or (here == "parameters" and isinstance(value, dict)):
        return joined[-1], ()
    below = ".".join((*above, segments[0]))
    if len(segments) > 1 and _OPTIONAL_TABLES.fullmatch(below):
        node[segments[0]] = {}
        return segments[0], segments[1:]
    if len(segments) == 1 and here != "parameters":
        return segments[0], ()  # a new key: whether it is a known one is for the check of its table to say
    name = joined[-2] if here == "parameters" and len(segments) > 1 else segments[0]
    place = f"[{here}] has" if here else "the file has"
    raise InputError(f"{where}: {place} no {name!r}{nearest(name, node)}")


# --- checked tables ---------------------------------------------------------------------


class MismatchError(Exception):
    """A value is not of the kind that was expected; the text says what was."""


class Section:
    """One table of a study file, whose keys are taken with a check of their kind.

    Parameters
    ----------
    file
        The study file's name for messages.
    where
        The table's name as messages write it, such as ``[model]``.
    data
        The table.
    known
        The keys that it may have.

    Raises
    ------
    InputError
        If `data` is no table or has an unknown key.
    """

    def __init__(self, file: str, where: str, data: object, known: Iterable[str]) -> None:
        self.file, self.where = file, where
        if not isinstance(data, dict):
            raise InputError(f"{file}: {where} must be a table, not {show(data)}")
        self.data: dict[str, Any] = data
        known = list(known)
        for key in data:
            if key not in known:
                near = nearest(key, known) or f"; its keys are {', '.join(known)}"
                raise self.error(f"has no key {key!r}{near}")

    def error(self, text: str) -> InputError:
        """Return an error whose sentence is this table followed by `text`."""
        return InputError(f"{self.file}: {self.where} {text}")

    def wrong(self, key: str, expected: str) -> InputError:
        """Return the error that `key` is not what is `expected`."""
        place = key if self.where == TOP else f"{self.where} {key}"
        return InputError(f"{self.file}: {place} must be {expected}, not {show(self.data[key])}")

    def need(self, key: str, kind: Callable[[Any], T], meaning: str) -> T:
        """Return the value of a key that must be there; `meaning` says what it is for."""
        if key not in self.data:
            raise self.error(f"needs the key {key!r}: {meaning}")
        return self._checked(key, kind)

    def get(self, key: str, kind: Callable[[Any], T], default: T) -> T:
        """Return the value of a key, or `default` where it is not given."""
        return self._checked(key, kind) if key in self.data else default

    def table(self, key: str, known: Iterable[str]) -> Section:
        """Return the table at `key`, an empty one where it is not given."""
        return Section(self.file, f"[{self._below(key)}]", self.data.get(key, {}), known)

    def tables(self, key: str, known: Iterable[str]) -> list[Section]:
        """Return the tables of a list, ``[[key]]``, none where it is not given."""
        name, entries = self._below(key), self.data.get(key, [])
        if not isinstance(entries, list):
            raise InputError(
                f"{self.file}: {name} must be a list of tables, each begun with [[{name}]], not {show(entries)}"
            )
        return [Section(self.file, f"[{name}][{k}]", entry, known) for k, entry in enumerate(entries)]

    def _below(self, key: str) -> str:
        name = key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)
        return name if self.where == TOP else f"{self.where.strip('[]')}.{name}"

    def _checked(self, key: str, kind: Callable[[Any], T]) -> T:
        try:
            return kind(self.data[key])
        except MismatchError as mismatch:
            raise self.wrong(key, str(mismatch)) from None


# --- kinds of values --------------------------------------------------------------------


def text(value: object) -> str:
    """Check for a string that is not empty."""
    if isinstance(value, str) and value:
        return value
    raise MismatchError("a text in quotes")


def flag(value: object) -> bool:
    """Check for true or false."""
    if isinstance(value, bool):
        return value
    raise MismatchError("true or false")


def number(value: object) -> float:
    """Check for a number (inf is one, nan is not)."""
    if math.isnan(found := float_of(value)):
        raise MismatchError("a number")
    return found


def positive(value: object) -> float:
    """Check for a finite number above zero."""
    if 0 < (found := float_of(value)) < math.inf:
        return found
    raise MismatchError("a number above 0")


def not_negative(value: object) -> float:
    """Check for a finite number, zero or above."""
    if 0 <= (found := float_of(value)) < math.inf:
        return found
    raise MismatchError("a number, 0 or above")


def count(value: object) -> int:
    """Check for a whole number above zero."""
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return value
    raise MismatchError("a whole number above 0")


def natural(value: object) -> int:
    """Check for a whole number, zero or above."""
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    raise MismatchError("a whole number, 0 or above")


def share(value: object) -> float:
    """Check for a number between zero and one, neither of them."""
    if 0 < (found := float_of(value)) < 1:
        return found
    raise MismatchError("a number between 0 and 1")


def numbers(value: object) -> list[float]:
    """Check for a list of finite numbers."""
    if isinstance(value, list):
        try:
            found = [number(item) for item in value]
        except MismatchError:
            found = [math.inf]
        if all(map(math.isfinite, found)):
            return found
    raise MismatchError("a list of numbers")


def matrix(value: object) -> list[list[float]]:
    """Check for a list of rows of finite numbers, all of the same length."""
    if isinstance(value, list) and value:
        try:
            rows = [numbers(row) for row in value]
        except MismatchError:
            rows = []
        if len({len(row) for row in rows}) == 1:
            return rows
    raise MismatchError("a list of rows of numbers, [[4.0, 0.1], [0.1, 2.0]]")


def names(value: object) -> list[str]:
    """Check for a list of names, each of them once."""
    if isinstance(value, list) and value and all(isinstance(item, str) and item for item in value):
        return list(columns(value))
    raise MismatchError('a list of names, ["Rs", "Rr"]')


def scalar(value: object) -> float | int | bool | str:
    """Check for one value of any type that an FMU variable may have."""
    if isinstance(value, bool | int | float | str):
        return value
    raise MismatchError("a number, true, false or a text")


def columns(value: object) -> dict[str, str]:
    """Check for a list of names, or a table of names and columns; return the latter."""
    if isinstance(value, list) and all(isinstance(item, str) and item for item in value):
        repeated = [item for item in value if value.count(item) > 1]
        if repeated:
            raise MismatchError(f"a list that names each variable once ({repeated[0]!r} is there twice)")
        return {item: item for item in value}
    if isinstance(value, dict) and all(isinstance(item, str) and item for item in value.values()):
        return dict(value)
    raise MismatchError('a list of names, ["u", "w"], or a table { fmu_variable = "column" }')


def named(kind: Callable[[Any], T]) -> Callable[[Any], dict[str, T]]:
    """Return the check for a table whose values are all of one kind."""

    def check(value: object) -> dict[str, T]:
        if not isinstance(value, dict):
            raise MismatchError("a table { name = value }")
        found = {}
        for name, item in value.items():
            try:
                found[str(name)] = kind(item)
            except MismatchError as mismatch:
                raise MismatchError(f"a table of which each entry is {mismatch} ({name} is {show(item)})") from None
        return found

    return check


def one_of(*words: str, later: Sequence[str] = ()) -> Callable[[Any], str]:
    """Return the check for one of `words`; those in `later` are known but not built yet."""

    def check(value: object) -> str:
        if isinstance(value, str) and value in words:
            return value
        listed = " or ".join(f'"{word}"' for word in words)
        if value in later:
            raise MismatchError(f"{listed} in this version")
        raise MismatchError(f"{listed}{nearest(value, words) if isinstance(value, str) else ''}")

    return check
