"""Parameters of a test of which only some run with the quick tests."""

from collections.abc import Iterable
from typing import Any

import pytest


def first(count: int, values: Iterable[Any]) -> list[Any]:
    """Return the values; those after the first ones run with the slow tests."""
    return [
        value if k < count else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.slow)
        for k, value in enumerate(values)
    ]
