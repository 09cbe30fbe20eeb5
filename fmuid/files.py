"""Paths of users, atomic writing of files, locks of folders."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from fmuid.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

MOST_BY_PANDAS = 1000  # Rows; pandas is six times slower than pyarrow, which writes 1 for 1.0 and quotes texts
_FORMULA = re.compile(r"'*[=+\-@\t\r\n]")  # a text that spreadsheets evaluate, or an escaped one
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # No space left, quota exceeded, file larger than a limit


# To `pathlib` an impossible name (too long, NUL) is an error; to these such a file does not exist.
is_file, is_folder, exists = os.path.isfile, os.path.isdir, os.path.exists


def full(path: Path) -> str:
    """Return the absolute path of a file, for messages."""
    try:
        return str(path.resolve())
    except (OSError, ValueError, RuntimeError):  # RuntimeError: circular links
        return repr(str(path.absolute()))


def relative(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, with forward slashes; absolute on another drive."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def make_folder(folder: Path) -> None:
    """Make an output folder; raise `InputError` if it is not writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be made a folder: {error.strerror}; choose another with --output") from None
    if not os.access(folder, os.W_OK):
        raise _unwritable(folder)


def _unwritable(folder: Path, why: str | None = None) -> InputError:
    return InputError(f"{folder} cannot be written to{f': {why}' if why else ''}; choose another folder with --output")


LOCK = ".lock"  # lock file of a folder


@contextmanager
def locked(folder: Path, what: str) -> Iterator[None]:
    """Make an output folder and lock it; `what` names the kind of other processes."""
    make_folder(folder)
    with _opened_lock(folder / LOCK, what) as file:
        with contextlib.suppress(OSError):  # a full disk: without the owner's name
            file.truncate(0)
            os.write(file.fileno(), f"process {os.getpid()} on {socket.gethostname()}".encode())
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # Windows keeps a file that is open
                (folder / LOCK).unlink()


def _opened_lock(path: Path, what: str) -> IO[str]:
    """Open and lock a file; repeat if its owner removes it meanwhile."""
    while True:
        try:
            file = path.open("a+", encoding="utf-8")
        except OSError as error:
            raise _unwritable(path.parent, error.strerror) from None
        if not _lock(file.fileno()):
            with file:
                file.seek(0)
                raise InputError(
                    f"{path.parent} is written to by another {what} ({file.read().strip() or 'just begun'}): wait "
                    "until it has ended, or choose another folder with --output"
                )
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(path.stat(), os.fstat(file.fileno())):
                return file
        file.close()


def _lock(handle: int) -> bool:
    """Lock an open file; return False if another process has it."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined, unused-ignore]
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system without locks: at the user's risk
        return True
    return True


_noted: list[list[Path]] = []


@contextmanager
def noted() -> Iterator[list[Path]]:
    """Provide a list of the files that `replacing` and `note` report."""
    _noted.append([])
    try:
        yield _noted[-1]
    finally:
        _noted.pop()


def note(path: Path) -> None:
    """Report a written file to `noted`."""
    for each in _noted:
        each.append(path)


class WriteError(InputError):
    """A file that cannot be written, such as on a full disk."""

    def __init__(self, path: Path, error: OSError) -> None:
        remedy = "make room, or choose" if error.errno in _FULL else "choose"
        super().__init__(f"{path} cannot be written: {error.strerror or error}; {remedy} another folder with --output")
        self.path = path


def rescued(name: str, write: Callable[[Path], Path]) -> Path | None:
    """Write a file into a temporary folder; return None on failure."""
    with contextlib.suppress(OSError):
        folder = Path(tempfile.mkdtemp(prefix="fmuid-"))
        with contextlib.suppress(WriteError):
            return write(folder / name)
        folder.rmdir()
    return None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Provide a draft path that replaces `path` when complete; raises `WriteError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            yield draft
            draft.replace(path)
            note(path)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise WriteError(path, error) from None


def write_table(path: Path, frame: pd.DataFrame) -> Path:
    """Write a CSV table, exact and without formulas; return its path."""
    frame = without_formulas(frame)
    short = frame.iloc[:0] if len(frame) > MOST_BY_PANDAS else frame
    with replacing(path) as draft, draft.open("wb") as stream:
        short.to_csv(stream, index=False, lineterminator="\n")
        if len(short) < len(frame):
            from pyarrow import Table, csv

            options = csv.WriteOptions(include_header=False, quoting_style="needed")
            csv.write_csv(Table.from_pandas(frame, preserve_index=False), stream, options)
    return path


def without_formulas(frame: pd.DataFrame) -> pd.DataFrame:
    """Put an apostrophe before texts that spreadsheets evaluate (CWE-1236); also before escaped ones."""
    return _with_texts(frame, _escaped)


def with_formulas(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table as before `without_formulas`."""
    return _with_texts(frame, _unescaped)


def _with_texts(frame: pd.DataFrame, change: Callable[[Any], Any]) -> pd.DataFrame:
    found = frame.rename(columns=change)
    for k, kind in enumerate(frame.dtypes):
        if kind.kind == "O":
            found.isetitem(k, frame.iloc[:, k].map(change).array)
    return found


def _escaped(cell: Any) -> Any:
    return f"'{cell}" if isinstance(cell, str) and _FORMULA.match(cell) and not _is_number(cell) else cell


def _unescaped(cell: Any) -> Any:
    return cell[1:] if isinstance(cell, str) and cell[:1] == "'" and _FORMULA.match(cell) else cell


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def first_line(error: Exception) -> str:
    """Return the first line of the text of an error."""
    said = error.strerror if isinstance(error, OSError) else str(error)
    return ((said or "").splitlines() or [type(error).__name__])[0]


class ContentError(ValueError):
    """Contradiction in the content of a file."""


def file_name(text: str) -> str:
    """Return a text as part of a file name: only letters, digits and ``_ . -`` stay."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", text)
