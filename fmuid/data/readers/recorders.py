"""TDMS of National Instruments and MDF of automotive tools."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fmuid.data.cells import Array
from fmuid.data.expressions import evaluate
from fmuid.data.readers.base import FileColumns, array_of_cells, library, padded
from fmuid.errors import InputError
from fmuid.formatting import bounded

_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "unit")


def read_tdms(path: Path, source: str, _sheet: object) -> FileColumns:
    """Read the longest group of a TDMS file, and waveforms of others; these get their time by increment."""
    nptdms = library("nptdms", "tdms", source)
    groups = [group.channels() for group in nptdms.TdmsFile.read(path).groups()]
    longest: list[Any] = max(groups, key=lambda found: sum(len(channel) for channel in found), default=[])
    channels = [*longest, *_beside(longest, groups)]
    elsewhere = {each.name: f"a channel of group {each.group_name!r}" for group in groups for each in group}
    length = max((len(channel) for channel in channels), default=0)
    if not length:
        raise InputError(f"{source}: the file has no channels with samples: record it again")
    headers = [channel.name for channel in channels]
    values = [_plain(channel[:]) for channel in channels]
    units = {
        k: str(channel.properties[name])
        for k, channel in enumerate(channels)
        for name in _UNIT_PROPERTIES
        if channel.properties.get(name)
    }
    tracks: dict[tuple[int, float, float], int] = {}  # waveforms: samples, begin and increment, and place of their time
    clocks: dict[int, int] = {}
    for k, channel in enumerate(channels):
        found = channel.properties
        if "wf_increment" not in found or "time" in headers[: len(channels)]:
            continue
        start = float(found.get("wf_start_offset", 0.0)) + _seconds_between(channels[0], channel)
        key = len(channel), start, float(found["wf_increment"])
        if key not in tracks:
            tracks[key] = len(headers)
            headers.append("time" if len(tracks) == 1 else f"time {len(tracks)}")
            values.append(key[1] + key[2] * np.arange(key[0]))
        clocks[k] = tracks[key]
    timed = [k for k, each in enumerate(values) if k in clocks or each.size == length or k >= len(channels)]
    left_out = {name: said for name, said in elsewhere.items() if name not in headers}
    left_out |= {
        headers[k]: f"{each.size} samples in place of {length}, without times of their own"
        for k, each in enumerate(values)
        if k not in timed
    }
    place = {k: new for new, k in enumerate(timed)}
    return FileColumns(
        tuple(headers[k] for k in timed),
        padded([values[k] for k in timed]),
        {place[k]: unit for k, unit in units.items() if k in place},
        time=place[min(tracks.values())] if tracks else None,
        units_in_headers=False,
        clocks={place[k]: place[clock] for k, clock in clocks.items()} if len(tracks) > 1 else {},
        left_out=left_out,
    )


def _beside(longest: list[Any], groups: list[list[Any]]) -> list[Any]:
    """Return waveforms of other groups, if all channels are waveforms."""
    others = [each for group in groups if group is not longest for each in group if len(each)]
    names = [each.name for each in (*longest, *others)]
    timed = all("wf_increment" in each.properties for each in (*longest, *others))
    return others if timed and len({*names}) == len(names) else []


def _seconds_between(first: Any, channel: Any) -> float:
    """Return how much later than another a waveform begins, s; 0 where a start is not said."""
    starts = [each.properties.get("wf_start_time") for each in (first, channel)]
    if None in starts:
        return 0.0
    begin, own = (np.datetime64(each, "us") for each in starts)
    return float((own - begin) / np.timedelta64(1, "s"))


def read_mdf(path: Path, source: str, _sheet: object) -> FileColumns:
    """Read an MDF file (3 or 4) at all times of channels."""
    asammdf = library("asammdf", "mdf", source)
    with _formulas_as_expressions(source), asammdf.MDF(path) as file:
        signals = [signal for signal in file.iter_channels() if signal.samples.dtype.kind in "biuf"]
    if not signals:
        raise InputError(f"{source}: the file has no channels with samples: record it again")
    times = np.unique(np.concatenate([signal.timestamps for signal in signals]))
    columns = {signal.name: _at(times, signal.timestamps, signal.samples) for signal in signals}
    units = {signal.name: signal.unit for signal in signals if signal.unit}
    headers = ("time", *columns)
    said = {k: units[name] for k, name in enumerate(headers) if name in units}
    return FileColumns(headers, (times, *columns.values()), said, time=0, units_in_headers=False)


def _at(times: Array, own: Array, samples: Array) -> Array:
    """Return samples at other times: the first of several, NaN where none."""
    found, first = np.unique(own, return_index=True)
    if len(found) == len(times):
        return samples[first]
    values = np.full(len(times), np.nan)
    values[np.searchsorted(times, found)] = samples[first]
    return values


@contextmanager
def _formulas_as_expressions(source: str) -> Iterator[None]:
    """Have asammdf compute formulas by `evaluate`; without numexpr and SymPy, which run Python's `eval`."""
    from asammdf.blocks import v2_v3_blocks, v4_blocks

    wrong: list[str] = []

    def computed(text: str) -> Array:
        scope = sys._getframe(1).f_locals  # as numexpr finds the variables of a formula
        try:
            count = len(scope["X" if "X" in scope else "X1"])
            return evaluate(text, lambda name: np.asarray(scope[name], dtype=np.float64), count)
        except Exception:
            wrong.append(text)
            raise

    before = [(module, module.evaluate, module.lambdify) for module in (v2_v3_blocks, v4_blocks)]
    try:
        for module, *_ in before:
            module.evaluate, module.lambdify = computed, None
        yield
    finally:
        for module, *functions in before:
            module.evaluate, module.lambdify = functions
    if wrong:
        said = f"conversion formula {bounded(wrong[0], 60)!r} cannot be computed"
        raise InputError(f"{source}: {said}. Convert the file with the recorder's tool.")


def _plain(values: Any) -> Array:
    """Return the samples of a channel as numbers, dates or cells."""
    found = np.asarray(values)
    return found if found.dtype.kind in "biufmM" else array_of_cells(found.tolist())
