"""MAT files of MATLAB; results of OpenModelica and Dymola (its User's Guide, "The MATv4 Result File Format")."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fmuid.data.cells import Array
from fmuid.data.readers.base import FileColumns, columns_of_vectors
from fmuid.data.readers.hdf import variables_of_hdf
from fmuid.data.time_names import is_time_name
from fmuid.errors import InputError

Arrays = dict[str, npt.NDArray[Any]]


def read_mat(path: Path, source: str, _sheet: object) -> FileColumns:
    """Read numeric vectors of a MAT file, or variables of a result."""
    try:
        content = _content(path)
    except NotImplementedError:  # version 7.3 is HDF5
        return _of_variables(source, variables_of_hdf(path, source))
    if "Aclass" in content and content["Aclass"].dtype.kind == "U":
        return _result_columns(source, content)
    variables = {name: _plain(value) for name, value in content.items()}
    if not any(_vectors(variables)) and "MatlabOpaque" in str({value.dtype for value in content.values()}):
        said = "MATLAB objects, tables and timetables are not readable"
        raise InputError(f"{source}: {said}. Use writetimetable, parquetwrite or vectors.")
    return _of_variables(source, variables)


def _of_variables(source: str, variables: Mapping[str, Any]) -> FileColumns:
    found = list(_vectors(variables))
    units = {name: unit for name, _, unit in found if unit}
    return columns_of_vectors(source, {name: values for name, values, _ in found}, units, ".")


def _content(path: Path) -> Arrays:
    from scipy.io import loadmat  # slow to import, and needed for this format only

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what else is in the file, such as functions and objects
        warnings.filterwarnings("error", r'Duplicate variable name "(?!None")|.*may be corrupt')
        # Characters stay single: names of a transposed result file stand in columns.
        content = loadmat(path, chars_as_strings=False)
    return {name: value for name, value in content.items() if isinstance(value, np.ndarray) and name[:2] != "__"}


def _plain(value: Any) -> Any:
    """Return structures as mappings, cells as lists, characters as text."""
    if not isinstance(value, np.ndarray):
        return value
    if value.dtype.names:
        if value.size >= 10 and all(np.size(one) == 1 for row in value.ravel().tolist() for one in row):  # rows
            return {name: np.array([np.ravel(one)[0] for one in value[name].ravel()]) for name in value.dtype.names}
        each = [{name: _plain(one[name]) for name in value.dtype.names} for one in value.ravel()]
        return each[0] if len(each) == 1 else each
    if value.dtype.kind == "O":
        return [_plain(one) for one in value.ravel()]
    return "".join(value.ravel()).strip() if value.dtype.kind in "US" else value


def _vectors(variables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Array, str]]:
    """Yield name, values and unit of each numeric vector, ``structure.field`` in structures."""
    texts = [value for value in variables.values() if isinstance(value, list) and _are_texts(value)]
    rows = {value.size for name, value in variables.items() if _is_vector(value) and is_time_name(name)}
    for name, value in variables.items():
        if isinstance(value, Mapping) and {"time", "signals"} <= set(value):
            yield from _of_simulink(value, f"{prefix}{name}.")
        elif isinstance(value, Mapping) and {"InputData", "OutputData", "Ts"} <= set(value):
            yield from _of_identification(value, f"{prefix}{name}.")
        elif isinstance(value, Mapping) and {"X", "Y"} <= set(value) and all(map(_is_axis, _all(value["Y"]))):
            yield from _of_control_desk(value, f"{prefix}{name}.")
        elif isinstance(value, Mapping):
            yield from _vectors(value, f"{prefix}{name}.")
        elif _is_vector(value):
            yield prefix + name, value.ravel(), ""
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim == 2:
            named = next((each for each in texts if len(each) == value.shape[1]), [])
            if not named and value.shape[0] in rows:
                named = [f"{name}{k + 1}" for k in range(value.shape[1])]
            yield from ((each, value[:, k], "") for k, each in enumerate(named))


def _is_vector(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size == max(value.shape, default=0)


def _are_texts(cells: Sequence[Any]) -> bool:
    return bool(cells) and all(isinstance(each, str) for each in cells)


def _all(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _of_simulink(given: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Array, str]]:
    """Yield time and signals of a structure with time, by their labels."""
    yield f"{prefix}time", given["time"].ravel(), ""
    for k, signal in enumerate(_all(given["signals"]), start=1):
        name = str(signal.get("label", "") or signal.get("title", "") or f"signal{k}")
        values = np.atleast_1d(np.squeeze(signal["values"]))
        if values.ndim == 1:
            yield prefix + name, values, ""
        elif values.ndim == 2:
            yield from ((f"{prefix}{name}{j + 1}", values[:, j], "") for j in range(values.shape[1]))


def _of_identification(given: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Array, str]]:
    """Yield times and signals of the first experiment of iddata."""
    first = {key: value[0] if isinstance(value, list) and value else value for key, value in given.items()}
    outputs, step, start = (np.asarray(first[key]) for key in ("OutputData", "Ts", "Tstart"))
    sampled = np.asarray(first.get("SamplingInstants", []))
    times = sampled if sampled.size else np.sum(start) + np.sum(step) * np.arange(len(outputs))
    if sampled.size or step.size == 1:
        yield f"{prefix}time", np.ravel(times), str(given.get("TimeUnit", "") or "")
    for role in ("Input", "Output"):
        data = np.asarray(first[f"{role}Data"])
        names, units = (_all(given.get(f"{role}{word}", [])) for word in ("Name", "Unit"))
        if data.ndim == 2 and data.shape[1] == len(names):
            yield from ((f"{prefix}{name}", data[:, k], units[k]) for k, name in enumerate(names))


def _is_axis(value: Any) -> bool:
    return isinstance(value, Mapping) and {"Name", "Data"} <= set(value)


def _of_control_desk(given: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Array, str]]:
    """Yield axes and signals of a recording of dSPACE ControlDesk; each signal may have an axis of its own."""
    for signal in (*_all(given["X"]), *_all(given["Y"])):
        name, unit = str(signal["Name"]).strip('"').rpartition("/")[2].strip('"'), str(signal.get("Unit", "") or "")
        yield prefix + name, np.ravel(signal["Data"]), "" if unit == "-" else unit


def _result_columns(source: str, arrays: Arrays) -> FileColumns:
    """Return the variables of a result, Aclass 1.0 or 1.1; of rows at one time the first and last."""
    kind = ["".join(row).strip(" \0") for row in arrays["Aclass"]]
    if kind[0] != "Atrajectory" or len(kind) < 4 or kind[3] not in ("binTrans", "binNormal"):
        raise InputError(f"{source}: holds {kind[0]!r} data, no trajectories. Give a simulation result.")
    if kind[3] == "binTrans":
        arrays = {name: value if name == "Aclass" else value.T for name, value in arrays.items()}
    try:
        if "data" in arrays:  # version 1.0
            columns = {_text(name): arrays["data"][:, k] for k, name in enumerate(arrays["names"])}
        else:
            columns = _version_1_1(arrays)
    except (KeyError, IndexError, ValueError):
        raise InputError(f"{source}: incomplete result file. Simulate again.") from None
    names = ["time" if name.lower() == "time" else name for name in columns]
    if "time" not in names:
        raise InputError(f"{source}: no time in the result file. Simulate again.")
    values = list(columns.values())
    times = values[names.index("time")]
    inside = np.zeros(len(times), dtype=bool)
    inside[1:-1] = (times[1:-1] == times[:-2]) & (times[1:-1] == times[2:])
    return FileColumns(tuple(names), tuple(each[~inside] for each in values), units_in_headers=False)


def _version_1_1(arrays: Arrays) -> Arrays:
    """Return variables by dataInfo: matrix (1: constants in data_1) and column from 1, negative if negated."""
    samples = len(arrays["data_2"])
    columns: Arrays = {}
    for name, (matrix, place, *_) in zip(arrays["name"], arrays["dataInfo"].astype(int).tolist(), strict=True):
        values = arrays[f"data_{1 if matrix == 1 else 2}"][:, abs(place) - 1]
        values = np.full(samples, values[0]) if matrix == 1 else values
        columns[_text(name)] = -values if place < 0 else values
    return columns


def _text(characters: npt.NDArray[np.str_]) -> str:
    """Return a name; tools write UTF-8 bytes as MAT characters."""
    joined = "".join(characters).strip(" \0")
    try:
        return joined.encode("latin-1").decode("utf-8")
    except UnicodeError:  # from a tool that writes characters indeed
        return joined
