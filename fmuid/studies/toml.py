"""TOML texts: read with clear errors, and values shown as in a file."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fmuid.errors import InputError
from fmuid.formatting import nearest

# `tomllib` takes time with the square of a dotted key's length.
_LONG_KEY = re.compile(r"""(?:(?<![\w-])(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){100}""")


class TomlReadError(Exception):
    """TOML that is too deep or too long to read."""


def parsed(text: str) -> dict[str, Any]:
    """Return the content of a TOML text."""
    if _LONG_KEY.search(text):
        raise TomlReadError("a key has more than 100 parts")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise TomlReadError("lists or sections are nested too deeply") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:  # of `int`
        raise TomlReadError("a number has thousands of digits") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file; errors name file and line."""
    try:
        text = path.read_text(encoding="utf-8")
        return parsed(text)
    except FileNotFoundError:
        beside = sorted(p.name for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
        raise InputError(f"{path}: file not found{nearest(path.name, beside)}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder. Give a study file (.toml).") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text. Give a study file (.toml).") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}.") from None
    except TomlReadError as error:
        raise InputError(f"{path}: not a study file: {error}.") from None
    except tomllib.TOMLDecodeError as error:
        said = str(error)
        line = re.search(r"at line (\d+)", said)
        there = text.split("\n")[int(line[1]) - 1].strip() if line else ""
        raise InputError(
            f"{path}: not valid TOML: {said[0].lower()}{said[1:]}" + (f": {there}" if there else "")
        ) from None


def show(value: object) -> str:
    """Return a value as in a TOML file, shortened for messages."""
    if isinstance(value, Mapping):
        return "a section"
    if isinstance(value, list):
        return "a list" if len(value) > 4 else "[" + ", ".join(show(item) for item in value) + "]"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


def toml_text(value: object) -> str:
    """Return a value as in one line of a TOML file."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{quoted_key(name)} = {toml_text(each)}' for name, each in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml_text, value))}]"
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)


def quoted_key(name: str) -> str:
    """Return a name as a key in TOML, in quotes where needed."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)
