"""Result files of OpenModelica and Dymola: "trajectory" files in MAT version 4, stored either way round.

The format is described in the OpenModelica User's Guide, "The MATv4 Result File Format".
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fmuid.data.formats.columns import FileColumns
from fmuid.errors import InputError


def result_columns(source: str, arrays: dict[str, npt.NDArray[Any]]) -> FileColumns:
    """Return the table in a result file (Aclass version 1.1, and 1.0 of Dymola's export); its time is called ``time``.

    Parameters and constants become constant columns, because the tools store inputs that do not move as such. Of three
    or more rows at the time of an event the first and the last are kept: the values before and after.

    Raises
    ------
    InputError
        Where the file holds something else, or not all of it.
    """
    kind = ["".join(row).strip(" \0") for row in arrays["Aclass"]]
    if kind[0] != "Atrajectory" or len(kind) < 4 or kind[3] not in ("binTrans", "binNormal"):
        raise InputError(f"{source}: the file holds {kind[0]!r} data and no trajectories: give a simulation result")
    if kind[3] == "binTrans":
        arrays = {name: value if name == "Aclass" else value.T for name, value in arrays.items()}
    try:
        columns = _version_1_0(arrays) if "data" in arrays else _version_1_1(arrays)
    except (KeyError, IndexError, ValueError):
        raise InputError(f"{source}: the result file is incomplete: simulate again") from None
    names = ["time" if name.lower() == "time" else name for name in columns]
    if "time" not in names:
        raise InputError(f"{source}: the result file has no time: simulate again")
    values = list(columns.values())
    times = values[names.index("time")]
    inside = np.zeros(len(times), dtype=bool)
    inside[1:-1] = (times[1:-1] == times[:-2]) & (times[1:-1] == times[2:])
    return FileColumns(tuple(names), tuple(each[~inside] for each in values), units_in_headers=False)


def _version_1_0(arrays: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    return {_text(name): arrays["data"][:, k] for k, name in enumerate(arrays["names"])}


def _version_1_1(arrays: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Take each variable from where dataInfo says.

    Column 1 of dataInfo is the matrix: 0 for time, 1 for data_1 (constants: their start and stop values), 2 for
    data_2 (one row a sample, time first). Column 2 is the column there, from 1, negative for a negated alias.
    """
    samples = len(arrays["data_2"])
    columns: dict[str, npt.NDArray[Any]] = {}
    for name, info in zip(arrays["name"], arrays["dataInfo"].astype(int), strict=True):
        matrix, place = int(info[0]), int(info[1])
        if matrix == 1:
            values = np.full(samples, arrays["data_1"][0, abs(place) - 1])
        else:
            values = arrays["data_2"][:, abs(place) - 1]
        columns[_text(name)] = -values if place < 0 else values
    return columns


def _text(characters: npt.NDArray[np.str_]) -> str:
    """Join single characters to a name; the tools write UTF-8 bytes, which the MAT format takes for characters."""
    joined = "".join(characters).strip(" \0")
    try:
        return joined.encode("latin-1").decode("utf-8")
    except UnicodeError:  # from a tool that writes characters indeed
        return joined
