"""Libraries that only some formats need, which come with the extras of the package."""

from __future__ import annotations

import importlib
from types import ModuleType

from fmuid.errors import InputError


def library(name: str, extra: str, source: str) -> ModuleType:
    """Import a library.

    Raises
    ------
    InputError
        If it is not installed; the sentence names the extra that brings it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(
            f'{source}: files of this kind are read by {name}, which is not installed: pip install "fmuid[{extra}]"'
        ) from None
