"""MAT files of version 4, as simulators write their results."""

import struct
from pathlib import Path
from typing import Any

import numpy as np


def characters(texts: list[str], padding: str) -> np.ndarray[Any, Any]:
    """Return UTF-8 bytes as the tools write them: one row a text, filled up to the longest."""
    raw = [text.encode() for text in texts]
    width = max(map(len, raw))
    if padding == "space":  # Dymola ends a name by a NUL where there is room, and fills up with spaces
        raw = [text + b"\0" if len(text) < width else text for text in raw]
    return np.array([list(text.ljust(width, b" " if padding == "space" else b"\0")) for text in raw], dtype=np.uint8)


def write_mat4(path: Path, matrices: dict[str, np.ndarray[Any, Any]]) -> None:
    """Write MAT-file level 4 by its specification: type, rows, columns, imaginary flag, length of the name; column by
    column. The digits of the type are machine, 0, precision (0 double, 2 int32, 5 uint8) and text or not.
    """
    kinds = {np.dtype(np.uint8): 51, np.dtype(np.int32): 20, np.dtype(np.float64): 0}
    with path.open("wb") as file:
        for name, matrix in matrices.items():
            file.write(struct.pack("<5i", kinds[matrix.dtype], *matrix.shape, 0, len(name) + 1))
            file.write(name.encode() + b"\0" + matrix.tobytes(order="F"))
