"""Safe unpacking of archives into the user's cache, by content: FMUs (FMI 2.0.4, section 2.3) and SSPs (SSP 1.0)."""

from __future__ import annotations

import hashlib
import shutil
import stat
import tempfile
import zipfile
from pathlib import Path, PurePosixPath

import platformdirs

from fmuid.errors import InputError


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, the key of the unpacking cache."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unpacked(path: Path, digest: str) -> Path:
    """Return the folder of an unpacked archive in the user's cache; it is unpacked where it is not there yet.

    Parameters
    ----------
    path : Path
        The archive.
    digest : str
        Its `file_digest`.

    Raises
    ------
    InputError
        If an entry of the archive would be written outside that folder, or nothing can be written there.
    """
    target = Path(platformdirs.user_cache_dir("fmuid")) / "unpacked" / digest
    if not target.is_dir():
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            _unpack(path, target)
        except (OSError, zipfile.BadZipFile) as error:
            raise InputError(f"{path} cannot be unpacked below {target.parent}: {error}") from error
    return target


def _unpack(path: Path, target: Path) -> None:
    """Unpack beside the target and rename, so that an interrupted or parallel run leaves no half archive."""
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            _check_entry(path, entry)
        fresh = Path(tempfile.mkdtemp(dir=target.parent))
        try:
            archive.extractall(fresh)
            try:
                fresh.rename(target)
            except OSError:
                if not target.is_dir():  # else another process was faster with the same content
                    raise
        finally:
            shutil.rmtree(fresh, ignore_errors=True)


def _check_entry(path: Path, entry: zipfile.ZipInfo) -> None:
    name = PurePosixPath(entry.filename)
    outside = name.is_absolute() or ".." in name.parts or "\\" in entry.orig_filename or ":" in entry.filename
    if outside or stat.S_ISLNK(entry.external_attr >> 16):
        raise InputError(
            f"{path} is refused: its entry {entry.orig_filename!r} would be written outside the archive's folder"
        )
