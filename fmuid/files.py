"""Checks of paths from study files and command lines, and atomic writing of files.

`pathlib` raises an error for an impossible name (too long, or with a NUL in it); here such a file does not exist.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import socket
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from fmuid.errors import InputError
from fmuid.version import __version__

if TYPE_CHECKING:
    import pandas as pd

# Of longer tables pandas takes six times as long as pyarrow, which writes 1 for 1.0 and quotes every text.
MOST_BY_PANDAS = 1000
# Begin of a text that spreadsheets evaluate, or of one that was escaped.
_FORMULA = re.compile(r"'*[=+\-@\t\r\n]")
# No space left, quota exceeded, file larger than a limit.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def is_file(path: Path) -> bool:
    """Return whether the file exists."""
    return _holds(path.is_file)


def is_folder(path: Path) -> bool:
    """Return whether the folder exists."""
    return _holds(path.is_dir)


def exists(path: Path) -> bool:
    """Return whether a file or folder exists."""
    return _holds(path.exists)


def _holds(question: Callable[[], bool]) -> bool:
    try:
        return question()
    except (OSError, ValueError):
        return False


def full(path: Path) -> str:
    """Return the absolute path of a file, for messages."""
    try:
        return str(path.resolve())
    except (OSError, ValueError, RuntimeError):  # RuntimeError: circular links
        return repr(str(path.absolute()))


def make_folder(folder: Path) -> None:
    """Make the output folder, so that a wrong one is found before the work and not after.

    Raises
    ------
    InputError
        If it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be made a folder: {error.strerror}; choose another with --output") from None
    if not os.access(folder, os.W_OK):
        raise _unwritable(folder)


def _unwritable(folder: Path, why: str | None = None) -> InputError:
    return InputError(f"{folder} cannot be written to{f': {why}' if why else ''}; choose another folder with --output")


LOCK = ".lock"
"""The lock of who writes to a folder."""


@contextmanager
def locked(folder: Path, what: str) -> Iterator[None]:
    """Keep other processes from writing to a folder, which is made where needed; messages call them `what`.

    Raises
    ------
    InputError
        If the folder cannot be written to, or another process has it.
    """
    make_folder(folder)
    with _opened_lock(folder / LOCK, what) as file:
        with contextlib.suppress(OSError):  # a full disk: nobody is told who has it
            file.truncate(0)
            os.write(file.fileno(), f"process {os.getpid()} on {socket.gethostname()}".encode())
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # Windows keeps a file that is open
                (folder / LOCK).unlink()


def _opened_lock(path: Path, what: str) -> IO[str]:
    """Open a file and lock it; one that its owner removed meanwhile, at the end, is made anew."""
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
    """Lock an open file until it is closed, also by the end of the process; return whether nobody else has it."""
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined, unused-ignore]
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system without locks is used at one's own risk, not refused
        return True
    return True


_noted: list[Path] | None = None


@contextmanager
def noted() -> Iterator[list[Path]]:
    """Provide a list that receives the files written by `replacing` and told by `note`, in their order."""
    global _noted
    before, _noted = _noted, []
    mine = _noted
    try:
        yield mine
    finally:
        _noted = before
        if before is not None:
            before += mine


def note(path: Path) -> None:
    """Tell `noted` of a file that was written."""
    if _noted is not None:
        _noted.append(path)


class WriteError(InputError):
    """A file cannot be written, as where the disk is full.

    Attributes
    ----------
    path : Path
    """

    def __init__(self, path: Path, error: OSError) -> None:
        remedy = "make room, or choose" if error.errno in _FULL else "choose"
        super().__init__(f"{path} cannot be written: {error.strerror or error}; {remedy} another folder with --output")
        self.path = path


def rescued(name: str, write: Callable[[Path], Path]) -> Path | None:
    """Write a file into a new folder for temporary files; return its path, or None if that fails, too."""
    with contextlib.suppress(OSError):
        folder = Path(tempfile.mkdtemp(prefix="fmuid-"))
        with contextlib.suppress(WriteError):
            return write(folder / name)
        folder.rmdir()
    return None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Provide a path beside `path` to write to, which replaces `path` when it is complete.

    Raises
    ------
    WriteError
        If nothing can be written there.
    """
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
    """Write a CSV table with numbers that read back exactly, without formulas; return its path."""
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
    """Return a table whose names and texts no spreadsheet evaluates as formulas (CWE-1236).

    Such a text gets an apostrophe before it, and so does a text that already looks escaped. Numbers stay.
    """
    return _with_texts(frame, _escaped)


def with_formulas(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table as it was before `without_formulas`."""
    return _with_texts(frame, _unescaped)


def _with_texts(frame: pd.DataFrame, change: Callable[[Any], Any]) -> pd.DataFrame:
    """Return a table with changed names and texts."""
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


def as_json(value: Any) -> Any:
    """Return a value as JSON has it.

    Dataclasses become objects, enums their values, arrays lists, and numbers that are not finite None.
    """
    from pydantic_core import to_jsonable_python  # imported already where a study is read

    return to_jsonable_python(value, inf_nan_mode="null", fallback=lambda array: array.tolist())


def write_json(path: Path, content: Mapping[str, Any]) -> Path:
    """Write a JSON file of what `as_json` makes of a content; return its path."""
    with replacing(path) as draft:
        draft.write_text(json.dumps(as_json(content), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return path


def first_line(error: Exception) -> str:
    """Return the first line of what an error says."""
    said = error.strerror if isinstance(error, OSError) else str(error)
    return ((said or "").splitlines() or [type(error).__name__])[0]


class JsonContent(dict[str, Any]):
    """The object of a JSON file; it remembers which of its keys was asked for last."""

    asked = ""

    def __getitem__(self, key: str) -> Any:
        self.asked = key
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Return the value of a key, `default` where there is none."""
        self.asked = key
        return super().get(key, default)


class ContentError(ValueError):
    """What a file has contradicts itself; the text says how."""


@contextmanager
def content_of(path: Path, kind: str, remedy: str) -> Iterator[JsonContent]:
    """Provide what fmuid has written to a JSON file; what does not fit while it is read becomes one sentence.

    Parameters
    ----------
    path : Path
    kind : str
        What the file should be, for messages.
    remedy : str
        What to do where it is something else, or of another version.

    Raises
    ------
    InputError
        If the file cannot be read, is something else, or an error in the block tells that its content does not fit.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    with read_content(text, path, kind, remedy) as content:
        yield content


@contextmanager
def read_content(text: bytes, path: Path, kind: str, remedy: str) -> Iterator[JsonContent]:
    """Provide the same of a text that comes from a file; arguments and errors as those of `content_of`."""
    try:
        found = json.loads(text.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not JSON: {error}; give {kind}, or {remedy}") from None
    content = JsonContent(found if isinstance(found, dict) else {})
    if not isinstance(content.get("version"), str):
        raise InputError(f"{path} does not say which fmuid has written it: give {kind}, or {remedy}")
    written = f"{path}, which fmuid {content['version']} has written,"
    try:
        yield content
    except ContentError as error:
        raise InputError(f"{written} cannot be right: {error}; {remedy}") from None
    except KeyError as error:
        place = "" if error.args == (content.asked,) else f" in {content.asked!r}"
        raise InputError(f"{written} has no {error}{place}, which fmuid {__version__} needs: {remedy}") from None
    except (TypeError, ValueError, AttributeError, OverflowError):
        raise InputError(
            f"{written} has something in {content.asked!r} that fmuid {__version__} cannot read: {remedy}"
        ) from None


def file_name(text: str) -> str:
    """Return a text as part of a file name: other characters than letters, digits, ``_ . -`` become ``_``."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", text)
