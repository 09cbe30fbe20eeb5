"""An FMU file: safe unpacking, cached by content (FMI 2.0.4, section 2.3)."""

from __future__ import annotations

import platform
import sys
from functools import cached_property
from os import PathLike
from pathlib import Path, PurePosixPath

from fmuid.display_mixins import HtmlTableMixin
from fmuid.errors import InputError, check_kind
from fmuid.files import is_file
from fmuid.models.archive import CheckedArchive, file_digest, unpacked
from fmuid.models.description import Description
from fmuid.models.reading import read_description

_MACHINE = "aarch64" if platform.machine().lower() in ("arm64", "aarch64") else "x86_64"
_SYSTEM, BINARY_ENDING = {"win32": ("win", ".dll"), "darwin": ("darwin", ".dylib")}.get(sys.platform, ("linux", ".so"))
PLATFORMS = {2: _SYSTEM + "64", 3: f"{_MACHINE}-{'windows' if _SYSTEM == 'win' else _SYSTEM}"}
"""What the versions of FMI call the folder with binaries of this machine (FMI 2.0.4, 2.3; FMI 3.0.2, 2.5.1.4.1)."""


class FMU(HtmlTableMixin):
    """An FMU file; unpacked and loaded at first use.

    Parameters
    ----------
    path : path-like
        The ``.fmu`` file.

    Attributes
    ----------
    file : Path
        Absolute path for reading.
    path : Path
        Name in messages; readers of a copy may set the original's name.

    Raises
    ------
    InputError
        If the file is missing, refused, or no FMU of FMI 2.0 or 3.0.

    Examples
    --------
    >>> fmu = fmuid.FMU(fmuid.datasets.coil().fmu)
    >>> fmu.name, fmu.description.variables["R"].unit
    ('Coil', 'Ohm')
    """

    def __init__(self, path: str | Path) -> None:
        check_kind(path, (str, PathLike), "a model must be a fmuid.System, a fmuid.FMU or the path of one")
        self.path = Path(path)
        self.file = self.path.absolute()  # isolated processes and later calls may work in other folders
        self.description: Description = read_description(self.path)

    def __repr__(self) -> str:
        return f"FMU({str(self.path)!r})"

    @property
    def name(self) -> str:
        """The model's name."""
        return self.description.model_name

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the file: key of cache and results."""
        return file_digest(self.file)

    @cached_property
    def _binaries(self) -> tuple[PurePosixPath, ...]:
        """Files below ``binaries/``, in folders of platforms."""
        with CheckedArchive(self.file, self.path) as archive:
            paths = map(PurePosixPath, archive.names)
            return tuple(path for path in paths if path.parts[:1] == ("binaries",) and len(path.parts) > 2)

    @cached_property
    def platforms(self) -> tuple[str, ...]:
        """The platform folders below ``binaries/``."""
        return tuple(sorted({path.parts[1] for path in self._binaries}))

    @cached_property
    def directory(self) -> Path:
        """Folder of the unpacked FMU in the user's cache; an `InputError` if refused or not writable."""
        return unpacked(self.file, self.digest, self.path)

    def library(self, identifier: str) -> Path:
        """Return the shared library of one interface for this platform; an `InputError` if there is none."""
        name = identifier + BINARY_ENDING
        packed = {str(path).lower() for path in self._binaries}  # some file systems do not tell the cases of letters
        for place in (f"binaries/{folder}/{name}" for folder in PLATFORMS.values()):
            if place.lower() in packed and is_file(path := self.directory / place):  # unpacked only where it has one
                return path
        here = PLATFORMS[2]
        there = f"binaries for {', '.join(self.platforms)}" if self.platforms else "no binaries at all"
        if here in self.platforms:
            there = f"binaries/{here} has no {name if len(name) < 200 else name[:200] + '…'}"
        raise InputError(f"{self.path}: no binary for this platform ({here}): {there}. Export it for this platform.")
