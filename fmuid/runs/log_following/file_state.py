"""How far a file is read, and what tells it from others of its name: loggers rename, truncate and write anew."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

# So many bytes, at the begin and before where reading is, tell a file from others.
MARK = 4096


@dataclass
class Followed:
    """A file that is followed.

    Attributes
    ----------
    file : str
        Its name.
    record : str
        What is read from it is called so.
    head : int
        Bytes before the first row of samples, -1 where they are not known yet.
    reference : str
        The first row of the record, from which its dates are counted.
    position : int
        Byte at which the first row begins that is still needed.
    rows : int
        Rows of the record before that.
    end : int
        Byte up to which the file was read.
    begun, done : bool
        Whether windows of the record were examined, and whether nothing more is expected.
    begins : (int, str)
        How many bytes of the file's begin, and their digest.
    ends : str
        Digest of the bytes before `end`.
    said : str
        What was said of it last.
    """

    file: str
    record: str
    head: int = -1
    reference: str = ""
    position: int = 0
    rows: int = 0
    end: int = 0
    begun: bool = False
    done: bool = False
    begins: tuple[int, str] = (0, "")
    ends: str = ""
    said: str = ""
    seen: tuple[int, int] = field(default=(-1, -1), repr=False)
    """Size and time of change when it was looked at last."""
    read: tuple[int, int] = field(default=(-2, -2), repr=False)
    """The same when it was read last."""
    since: float = field(default=0.0, repr=False)
    """Since when it is as it was then, by a clock that runs evenly, s."""

    def mark(self, path: Path, end: int) -> None:
        """Note that a file was read up to a byte."""
        self.end = end
        with path.open("rb") as file:
            start = file.read(min(MARK, end))
            file.seek(max(0, end - MARK))
            self.ends = _digest(file.read(min(MARK, end)))
        self.begins = (len(start), _digest(start))

    def is_of(self, path: Path) -> bool:
        """Whether a file still begins with what was read of it."""
        count, digest = self.begins
        with path.open("rb") as file:
            if _digest(file.read(count)) != digest:
                return False
            file.seek(max(0, self.end - MARK))
            return _digest(file.read(min(MARK, self.end))) == self.ends


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def moved(lost: Sequence[Followed], path: Path) -> Followed | None:
    """Return the file that is called otherwise now, of those that are not where they were; None for a new one."""
    return next((each for each in lost if each.end and each.is_of(path)), None)
