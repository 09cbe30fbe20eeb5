"""TOML of any content: what the standard library's reader cannot bear is refused in words."""

from __future__ import annotations

import re
import tomllib
from typing import Any

# `tomllib` takes time with the square of a dotted key's length.
_LONG_KEY = re.compile(r"""(?:(?<![\w-])(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){100}""")


class UnreadableError(Exception):
    """A text is TOML that cannot be read here; the text says why."""


def parsed(text: str) -> dict[str, Any]:
    """Return the content of a TOML text.

    Raises
    ------
    TOMLDecodeError
        If it is no TOML.
    UnreadableError
        If it is nested too deeply, or has numbers or keys of absurd length.
    """
    if _LONG_KEY.search(text):
        raise UnreadableError("a key has more than 100 parts, of which no study has more than ten")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise UnreadableError("its lists or tables are nested too deeply") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:  # of `int`
        raise UnreadableError("a number in it has thousands of digits") from None
