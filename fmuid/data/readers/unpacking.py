"""Texts in archives."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO

from fmuid.errors import InputError

_PLAIN: dict[str, Callable[[bytes], bytes]] = {".gz": gzip.decompress, ".bz2": bz2.decompress, ".xz": lzma.decompress}
PACKED = (*_PLAIN, ".zip")
"""Suffixes of packed texts."""
_OF_MACS = re.compile(r"(^|/)(__MACOSX/|\.)")
"""Entries that a Mac adds to archives."""


def opener(path: Path, source: str) -> Callable[[], IO[bytes]]:
    """Return an opener of the unpacked text."""
    suffix = path.suffix.lower()
    if suffix not in PACKED:
        return lambda: path.open("rb")
    try:
        if unpack := _PLAIN.get(suffix):
            return partial(io.BytesIO, unpack(path.read_bytes()))
        with zipfile.ZipFile(path) as archive:
            inside = [each for each in archive.namelist() if not each.endswith("/") and not _OF_MACS.search(each)]
            if len(inside) != 1:
                raise InputError(f"{source}: {len(inside)} files in the archive. Pack the table alone.")
            return partial(io.BytesIO, archive.read(inside[0]))
    except (
        OSError,
        EOFError,
        zlib.error,
        zipfile.BadZipFile,
        lzma.LZMAError,
        RuntimeError,
    ):  # the last of what is encrypted
        raise InputError(f"{source}: cannot be unpacked. Pack it again, or give the plain text.") from None
