"""The probe FMU, which misbehaves on demand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

ProbeMaker = Callable[..., Path]
