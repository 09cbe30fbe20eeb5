"""Untrusted zip archives, read under limits (FMI 2.0.4, 2.3; SSP 1.0, 3).

An archive may name files outside its folder, or fill disk and memory (D. Fifield, WOOT 2019).
All systems refuse the same archives, since FMUs move between systems.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import os
import shutil
import stat
import struct
import sys
import tempfile
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import platformdirs

from fmuid.errors import InputError
from fmuid.models.untrusted_xml import LARGEST_XML

LARGEST_TOTAL_VARIABLE = "FMUID_LARGEST_ARCHIVE_GB"  # environment variable: limit of the unpacked size, GB


@dataclass(frozen=True)
class ArchiveLimits:
    """Limits of an accepted archive."""

    # unpacked size, GB (2³⁰ bytes), an entry half of it. FMUs have about 100 MB, with an interpreter 2 GB
    total_gb: float = 4.0
    entries: int = 100_000  # an FMU that carries an interpreter has some ten thousand
    directory: int = 16 * 2**20  # bytes of its directory, read at once: as many entries with names of 120 characters
    ratio: int = 200  # largest compression: text shrinks to a thirtieth, a bomb to a thousandth
    ratio_from: int = 64 * 2**20  # unpacked bytes below which any compression is accepted
    name: int = 255  # bytes in the name of a file or folder: what file systems take
    path: int = 1000  # bytes in all of an entry's name, less the cache's path
    chunk: int = 2**20  # bytes that are unpacked at a time


LIMITS = ArchiveLimits()

_REMEDY = f"If you trust it, set the environment variable {LARGEST_TOTAL_VARIABLE} to its GB."
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
STRICT_NAMES = sys.platform in ("win32", "darwin")  # letter case does not count, or device names are reserved
_RESERVED = {"CON", "PRN", "AUX", "NUL", *(f"{port}{n}" for port in ("COM", "LPT") for n in range(1, 10))}
# Errors of zipfile for damaged archives, the RuntimeError NotImplementedError among them.
_DAMAGES = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, OSError, OverflowError, ValueError)


class CheckedArchive:
    """A zip archive with checked entries; a context manager that closes it.

    `path` is its name in messages. `InputError`: the file is no readable zip archive, or an entry is refused.
    """

    entries: tuple[zipfile.ZipInfo, ...]  # files and folders in the archive's order, with slashes as separators
    names: tuple[str, ...]  # names of the files

    def __init__(self, file: Path, path: Path | None = None) -> None:
        self.path, self.limit, self._written = path or file, _largest_total(), 0
        try:
            self._file = _Bounded(io.FileIO(file))
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror or error}.") from None
        try:
            self._archive = zipfile.ZipFile(self._file)
            self.entries = tuple(self._archive.infolist())
            for entry in self.entries:  # some tools on Windows write them, against the format's specification
                entry.filename = entry.filename.replace("\\", "/")
            self._size = file.stat().st_size
            self._check()
        except _DAMAGES as error:
            self._file.close()
            raise self._damaged(error) from None
        except InputError as error:
            self._file.close()
            raise self._refused(str(error)) from None
        self._files = {entry.filename: entry for entry in self.entries if not entry.is_dir()}
        self.names = tuple(self._files)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._archive.close()
        self._file.close()

    @property
    def comment(self) -> bytes:
        """The archive's own comment."""
        return self._archive.comment

    def read(self, name: str, largest: int = LARGEST_XML) -> bytes:
        """Return the content of one file of `names`; an `InputError` if damaged or larger than `largest` bytes."""
        return b"".join(self.chunks(self._files[name], largest))

    def chunks(self, entry: zipfile.ZipInfo, largest: int | None = None) -> Iterator[bytes]:
        """Yield the content of an entry, counted; stated sizes may be wrong; an `InputError` as `read`."""
        largest, written = self.limit // 2 if largest is None else largest, 0
        try:
            with self._archive.open(entry) as file:
                while chunk := file.read(LIMITS.chunk):
                    written += len(chunk)
                    self._written += len(chunk)
                    if written > largest:
                        raise InputError(f"entry {_shown(entry)} is larger than {_size(largest)}. {_REMEDY}")
                    self._check_total(self._written)
                    yield chunk
        except InputError as error:
            raise self._refused(str(error)) from None
        except _DAMAGES as error:
            raise self._damaged(error) from None

    # --- checks

    def _refused(self, why: str) -> InputError:
        return InputError(f"{self.path}: refused: {why}")

    def _damaged(self, error: BaseException) -> InputError:
        return InputError(f"{self.path}: damaged archive ({error or type(error).__name__}). Export it again.")

    def _check(self) -> None:
        if len(self.entries) > LIMITS.entries:
            raise InputError(f"{len(self.entries)} entries; at most {LIMITS.entries} are unpacked.")
        there: dict[str, zipfile.ZipInfo] = {}
        folders: dict[str, zipfile.ZipInfo] = {}
        for entry in self.entries:
            _check_entry(entry)
            name = _folded(entry)
            if entry.is_dir():
                folders.setdefault(name, entry)
            elif _content(there.setdefault(name, entry)) != _content(entry):  # tools do pack a file twice
                raise InputError(
                    f"entries {_shown(there[name])} and {_shown(entry)} are one file on some systems. Keep one."
                )
            while (name := name.rpartition("/")[0]) and name not in folders:
                folders[name] = entry
        for name in there.keys() & folders.keys():
            raise InputError(f"entry {_shown(there[name])} is both a file and a folder.")
        self._check_overlaps()
        self._check_total(sum(entry.file_size for entry in self.entries))

    def _check_overlaps(self) -> None:
        """Refuse overlapping entries: bombs made of them have no suspicious ratio."""
        placed = sorted(self.entries, key=lambda entry: entry.header_offset)
        for entry, following in itertools.pairwise(placed):
            end = entry.header_offset + 30 + len(entry.filename) + entry.compress_size
            if end > following.header_offset:
                raise InputError(f"entries {_shown(entry)} and {_shown(following)} overlap.")

    def _check_total(self, total: int) -> None:
        if total > self.limit:
            raise InputError(f"unpacks to more than {_size(self.limit)}. {_REMEDY}")
        if total > max(LIMITS.ratio_from, LIMITS.ratio * self._size):
            raise InputError(f"unpacks to more than {LIMITS.ratio} times its size, as zip bombs do.")


class _Bounded(io.BufferedReader):
    """A file without large reads: `zipfile` reads a whole directory at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > LIMITS.directory:
            raise InputError(f"its directory is larger than {_size(LIMITS.directory)}.")
        return super().read(size)


def parts_of(entry: zipfile.ZipInfo) -> tuple[str, ...]:
    """Return folders and file name of an entry."""
    return tuple(part for part in entry.filename.split("/") if part not in ("", "."))


def _check_entry(entry: zipfile.ZipInfo) -> None:
    """Refuse an entry without use in an FMU or outside its folder."""
    name, shown = entry.orig_filename.replace("\\", "/"), _shown(entry)
    parts = parts_of(entry)
    mode = entry.external_attr >> 16
    outside = name.startswith("/") or ":" in name or any(not part.rstrip(". ") for part in parts)
    if outside or stat.S_ISLNK(mode):
        raise InputError(f"entry {shown} is outside the archive's folder.")
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise InputError(f"entry {shown} is neither a file nor a folder.")
    if not name.isprintable() and any(unicodedata.category(letter) == "Cc" for letter in name):
        raise InputError(f"entry {shown} has a control character in its name.")
    if not parts and not name.endswith("/"):
        raise InputError("an entry has no name.")
    if STRICT_NAMES and any(part.partition(".")[0].rstrip().upper() in _RESERVED for part in parts):
        raise InputError(f"entry {shown} has a name reserved by Windows. Rename it.")
    sizes = [len(part.encode("utf-8", "surrogatepass")) for part in parts]
    if max(sizes, default=0) > LIMITS.name or sum(sizes) + len(sizes) > LIMITS.path:
        raise InputError(
            f"entry {shown}: name too long. Use at most {LIMITS.name} bytes per part, {LIMITS.path} in all."
        )
    if entry.flag_bits & 0x41:  # encrypted, by the old or the strong method
        raise InputError(f"entry {shown} is encrypted. Pack it without a password.")
    if entry.compress_type not in _METHODS:
        raise InputError(f"entry {shown} is neither stored nor deflated. Pack it again.")


def _folded(entry: zipfile.ZipInfo) -> str:
    """Return a file's key: case, composed accents, final dots may not count."""
    parts = parts_of(entry)
    if not STRICT_NAMES:
        return "/".join(parts)
    name = "/".join(part.rstrip(". ") for part in parts)
    return name.lower() if name.isascii() else unicodedata.normalize("NFC", name).casefold()


def _content(entry: zipfile.ZipInfo) -> tuple[str, int, int]:
    return entry.orig_filename, entry.file_size, entry.CRC


def _shown(entry: zipfile.ZipInfo) -> str:
    name = entry.orig_filename
    return repr(name if len(name) <= 80 else f"{name[:80]}…")


def _size(count: int) -> str:
    return f"{count / 2**30:.3g} GB" if count >= 2**30 else f"{count / 2**20:.3g} MB"


def _largest_total() -> int:
    text = os.environ.get(LARGEST_TOTAL_VARIABLE, "")
    try:
        found = float(text) if text else LIMITS.total_gb
        return int(found * 2**30)
    except (ValueError, OverflowError):
        raise InputError(
            f"environment variable {LARGEST_TOTAL_VARIABLE} = {text!r} is no number of GB, such as 8."
        ) from None


_PRIVATE = 0o700
# Files of these must have the size given by the archive; an FMU may write into its other files.
_SIZED = ("binaries", "modelDescription.xml")


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, the key of the unpacking cache."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unpacked(file: Path, digest: str, path: Path | None = None) -> Path:
    """Return an archive's folder in the user's cache; missing files, and binaries of another size, are unpacked."""
    cache = Path(platformdirs.user_cache_dir("fmuid"))
    shelf = cache / "unpacked"
    target = shelf / digest
    with CheckedArchive(file, path) as archive, ExitStack() as undo:
        try:
            if not target.exists():
                undo.callback(shutil.rmtree, target, ignore_errors=True)
            for folder in (cache, shelf, target):
                _make_private(folder)
            for entry in archive.entries:
                if _is_missing(target, entry):
                    _unpack(archive, entry, target)
            undo.pop_all()
        except (OSError, UnicodeError) as error:  # the latter of names that the file system cannot write
            raise InputError(f"{archive.path}: cannot be unpacked below {shelf}: {error}") from error
    return target


def _make_private(folder: Path) -> None:
    """Make a folder private to the user; refuse links and others' folders."""
    folder.mkdir(_PRIVATE, parents=True, exist_ok=True)
    said = folder.lstat()
    remedy = "Remove it, or set the environment variable XDG_CACHE_HOME."
    if not stat.S_ISDIR(said.st_mode):
        raise InputError(f"cache folder {folder} is a symbolic link. {remedy}")
    if sys.platform != "win32":
        if said.st_uid != os.geteuid():
            raise InputError(f"cache folder {folder} belongs to another user. {remedy}")
        if stat.S_IMODE(said.st_mode) != _PRIVATE:
            folder.chmod(_PRIVATE)


def _unpack(archive: CheckedArchive, entry: zipfile.ZipInfo, folder: Path) -> None:
    """Unpack an entry in one step: interrupted runs leave no partial file."""
    place = folder.joinpath(*parts_of(entry))
    _make_folder(place if entry.is_dir() else place.parent)
    if not entry.is_dir():
        handle, name = tempfile.mkstemp(dir=folder.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.writelines(archive.chunks(entry))
            Path(name).replace(place)
        except OSError:
            if _is_missing(folder, entry):  # else another process was faster with the same content, and uses it
                raise
        finally:
            Path(name).unlink(missing_ok=True)


def _make_folder(folder: Path) -> None:
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(_PRIVATE, exist_ok=True)


def _is_missing(folder: Path, entry: zipfile.ZipInfo) -> bool:
    parts = parts_of(entry)
    try:
        said = folder.joinpath(*parts).lstat()
    except OSError:
        return True
    if entry.is_dir():
        return False
    return not stat.S_ISREG(said.st_mode) or (bool(parts) and parts[0] in _SIZED and said.st_size != entry.file_size)
