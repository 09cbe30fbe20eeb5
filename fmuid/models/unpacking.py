"""Unpacking of archives into the user's cache, by content: FMUs (FMI 2.0.4, section 2.3) and SSPs (SSP 1.0).

Unpacked binaries are executed later, so nobody else may write them: folders and files are private to the user.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import sys
import tempfile
import zipfile
from pathlib import Path

import platformdirs

from fmuid.errors import InputError
from fmuid.models.archive import CheckedArchive, parts_of

_PRIVATE, _PRIVATE_FILE = 0o700, 0o600
_BINARY = getattr(os, "O_BINARY", 0)  # of Windows
# Files of these must have the size given by the archive; an FMU may write into its other files.
_SIZED = ("binaries", "modelDescription.xml")


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, the key of the unpacking cache."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unpacked(file: Path, digest: str, path: Path | None = None) -> Path:
    """Return the folder of an unpacked archive in the user's cache.

    It is unpacked where it is not there yet, and files that are missing there, or binaries of another size, again.

    Parameters
    ----------
    file : Path
        The archive.
    digest : str
        Its `file_digest`.
    path : Path, optional
        What messages call it; default: the same.

    Raises
    ------
    InputError
        If the archive is refused (`CheckedArchive`), the cache is a symbolic link or somebody else's, or nothing
        can be written there.
    """
    cache = Path(platformdirs.user_cache_dir("fmuid"))
    shelf = cache / "unpacked"
    target = shelf / digest
    with CheckedArchive(file, path) as archive:
        try:
            for folder in (cache, shelf):
                _make_private(folder)
            if not target.is_dir():
                _unpack(archive, target)
            else:
                _make_private(target)
                _repair(archive, target)
        except (OSError, UnicodeError) as error:  # the latter of names that the file system cannot write
            raise InputError(f"{archive.path} cannot be unpacked below {shelf}: {error}") from error
    return target


def _make_private(folder: Path) -> None:
    """Make a folder private to the user, or check that it is."""
    folder.mkdir(_PRIVATE, parents=True, exist_ok=True)
    said = folder.lstat()
    remedy = "remove it, or name another place for caches by the environment variable XDG_CACHE_HOME"
    if not stat.S_ISDIR(said.st_mode):
        raise InputError(
            f"the cache folder {folder} is a symbolic link, through which others might be written; {remedy}"
        )
    if sys.platform != "win32":
        if said.st_uid != os.geteuid():
            raise InputError(
                f"the cache folder {folder} belongs to somebody else, who could change FMUs in it; {remedy}"
            )
        if stat.S_IMODE(said.st_mode) != _PRIVATE:
            folder.chmod(_PRIVATE)


def _unpack(archive: CheckedArchive, target: Path) -> None:
    """Unpack beside the target and rename, so that an interrupted or parallel run leaves no half archive."""
    fresh = Path(tempfile.mkdtemp(dir=target.parent))
    try:
        made = {fresh}
        for entry in archive.entries:
            place = _place(entry, fresh, made)
            if not entry.is_dir():
                place.unlink(missing_ok=True)  # of a file that is packed twice
                _write(archive, entry, os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, _PRIVATE_FILE))
        try:
            fresh.rename(target)
        except OSError:
            if not target.is_dir():  # else another process was faster with the same content
                raise
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _repair(archive: CheckedArchive, target: Path) -> None:
    """Unpack missing files, replacing each in one step, so that processes that use the folder see whole files."""
    made = {target}
    for entry in archive.entries:
        if _is_missing(target, entry):
            place = _place(entry, target, made)
            if entry.is_dir():
                continue
            handle, name = tempfile.mkstemp(dir=target.parent)
            try:
                _write(archive, entry, handle)
                Path(name).replace(place)
            finally:
                Path(name).unlink(missing_ok=True)


def _is_missing(folder: Path, entry: zipfile.ZipInfo) -> bool:
    parts = parts_of(entry)
    try:
        said = folder.joinpath(*parts).lstat()
    except OSError:
        return True
    if entry.is_dir():
        return False
    return not stat.S_ISREG(said.st_mode) or (bool(parts) and parts[0] in _SIZED and said.st_size != entry.file_size)


def _place(entry: zipfile.ZipInfo, folder: Path, made: set[Path]) -> Path:
    """Return the path of an entry, after making its folders."""
    parts = parts_of(entry)
    place = folder.joinpath(*parts)
    inner = place if entry.is_dir() else place.parent
    for above in (*reversed(inner.parents), inner) if inner not in made else ():
        if len(above.parts) > len(folder.parts) and above not in made:
            above.mkdir(_PRIVATE, exist_ok=True)
            made.add(above)
    return place


def _write(archive: CheckedArchive, entry: zipfile.ZipInfo, handle: int) -> None:
    with os.fdopen(handle, "wb") as file:
        for chunk in archive.chunks(entry):
            file.write(chunk)
