"""Study files as TOML: reading, and showing values in sentences."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fmuid.errors import InputError
from fmuid.studies.toml_text import UnreadableError, parsed
from fmuid.text import nearest


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
