"""``.npz`` files of arrays, with a digest."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data.readers.base import call_reader
from fmuid.files import ContentError, first_line, replacing


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> Path:
    """Write arrays durably as ``.npz`` with a digest; return the path."""
    with replacing(path) as draft, draft.open("wb") as file:
        np.savez(file, digest=np.frombuffer(_digest_of(arrays), np.uint8), **arrays)
        file.flush()
        os.fsync(file.fileno())
    return path


def read_arrays(path: Path) -> dict[str, Any]:
    """Read the arrays of `write_arrays`, in the reader process.

    Raises
    ------
    ValueError
        If the file is unreadable or damaged, or the process is lost.
    """
    return call_reader(_arrays, path)


def _arrays(path: Path) -> dict[str, Any]:
    try:
        content = path.read_bytes()
        if not content.startswith(b"PK"):
            raise ContentError("it is no .npz file")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = dict(file)
        if arrays.pop("digest").tobytes() != _digest_of(arrays):
            raise ContentError("its content is not what was written")
    except Exception as error:  # numpy, zipfile and tokenize raise errors of many kinds for damaged files
        raise ContentError(first_line(error)) from None
    return arrays


def _digest_of(arrays: Mapping[str, Any]) -> bytes:
    found = hashlib.sha256()
    for name in sorted(arrays):
        found.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}".encode())
        found.update(arrays[name].tobytes())
    return found.digest()
