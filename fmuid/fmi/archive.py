"""An FMU file: safe unpacking, cached by content (FMI 2.0.4, section 2.3)."""

from __future__ import annotations

import hashlib
import shutil
import stat
import tempfile
import zipfile
from functools import cached_property
from pathlib import Path, PurePosixPath

import platformdirs

from fmuid.errors import InputError
from fmuid.fmi.description import Description, read_description


class FMU:
    """An FMU file; nothing is unpacked or loaded before it is needed.

    Parameters
    ----------
    path : path-like
        The ``.fmu`` file.

    Raises
    ------
    InputError
        If the file is missing, no zip archive, without a readable model description, or not FMI 2.0.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.description: Description = read_description(self.path)

    def __repr__(self) -> str:
        return f"FMU({str(self.path)!r})"

    @property
    def name(self) -> str:
        """The model's name."""
        return self.description.model_name

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the file, the key of the unpacking cache and what identifies the model in results."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    @cached_property
    def platforms(self) -> tuple[str, ...]:
        """The platform folders below ``binaries/``."""
        with zipfile.ZipFile(self.path) as archive:
            parts = [PurePosixPath(name).parts for name in archive.namelist()]
        return tuple(sorted({p[1] for p in parts if len(p) > 2 and p[0] == "binaries"}))

    @cached_property
    def directory(self) -> Path:
        """The folder of the unpacked FMU, in the user's cache.

        Raises
        ------
        InputError
            If an entry of the archive would be written outside that folder, or nothing can be written there.
        """
        target = Path(platformdirs.user_cache_dir("fmuid")) / "unpacked" / self.digest
        if not target.is_dir():
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                self._unpack(target)
            except (OSError, zipfile.BadZipFile) as error:
                raise InputError(f"{self.path} cannot be unpacked below {target.parent}: {error}") from error
        return target

    def library(self, identifier: str) -> Path:
        """Return the shared library of one interface for this platform.

        Raises
        ------
        InputError
            If the FMU has no binary for this platform; the sentence says which it has.
        """
        import fmpy

        name = identifier + fmpy.sharedLibraryExtension
        for folder in (fmpy.platform, fmpy.platform_tuple):
            path: Path = self.directory / "binaries" / folder / name
            if path.is_file():
                return path
        there = f"it has binaries for {', '.join(self.platforms)}" if self.platforms else "it has no binaries at all"
        if fmpy.platform in self.platforms:
            there = f"its folder binaries/{fmpy.platform} has no {name}"
        raise InputError(
            f"{self.path} has no binary for this platform ({fmpy.platform}): {there}; export it for this platform"
        )

    def _unpack(self, target: Path) -> None:
        """Unpack beside the target and rename, so that an interrupted or parallel run leaves no half FMU."""
        with zipfile.ZipFile(self.path) as archive:
            for entry in archive.infolist():
                self._check_entry(entry)
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

    def _check_entry(self, entry: zipfile.ZipInfo) -> None:
        name = PurePosixPath(entry.filename)
        outside = name.is_absolute() or ".." in name.parts or "\\" in entry.orig_filename or ":" in entry.filename
        if outside or stat.S_ISLNK(entry.external_attr >> 16):
            raise InputError(
                f"{self.path} is refused: its entry {entry.orig_filename!r} would be written outside the FMU's folder"
            )
