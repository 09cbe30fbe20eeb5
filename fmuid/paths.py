"""Questions about files whose names come from study files and command lines.

`pathlib` raises an error where a name is none that a file can have (too long, with a NUL in it); here the file is just
not there.
"""

from __future__ import annotations

from pathlib import Path


def is_file(path: Path) -> bool:
    """Whether there is such a file."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether there is such a folder."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def exists(path: Path) -> bool:
    """Whether there is a file or folder of this name."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def full(path: Path) -> str:
    """Return the whole path of a file, as messages show it."""
    try:
        return str(path.resolve())
    except (OSError, ValueError, RuntimeError):  # the last of links that go round in circles
        return repr(str(path.absolute()))
