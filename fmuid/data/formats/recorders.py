"""Files of data loggers: TDMS of National Instruments, and MDF of automotive tools."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from fmuid.data.formats.columns import RawTable
from fmuid.data.formats.libraries import library
from fmuid.errors import InputError

_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "unit")


def read_tdms(path: Path, source: str) -> RawTable:
    """Read the channels of the longest group of a TDMS file, with their units.

    Channels of a waveform have no column of time: it comes from their increment, as `time`.

    Raises
    ------
    InputError
        Where the file cannot be read or has no channels.
    """
    nptdms = library("nptdms", "tdms", source)
    with _refusing(source, "TDMS"):
        groups = [group.channels() for group in nptdms.TdmsFile.read(path).groups()]
    channels: list[Any] = max(groups, key=lambda found: sum(len(channel) for channel in found), default=[])
    length = max((len(channel) for channel in channels), default=0)
    kept = [channel for channel in channels if len(channel) == length]
    if not length:
        raise InputError(f"{source}: the file has no channels with samples: record it again")
    columns = {channel.name: channel[:] for channel in kept}
    units = {
        channel.name: str(channel.properties[name])
        for channel in kept
        for name in _UNIT_PROPERTIES
        if channel.properties.get(name)
    }
    if "wf_increment" in kept[0].properties and "time" not in columns:
        return RawTable(pd.DataFrame({"time": kept[0].time_track(), **columns}), units, "time")
    return RawTable(pd.DataFrame(columns), units)


def read_mdf(path: Path, source: str) -> RawTable:
    """Read all channels of an MDF file (3 or 4), with their units, at the union of their times.

    A channel is missing where it has no sample.

    Raises
    ------
    InputError
        Where the file cannot be read or has no channels.
    """
    asammdf = library("asammdf", "mdf", source)
    with _refusing(source, "MDF"), asammdf.MDF(path) as file:
        signals = [signal for signal in file.iter_channels() if signal.samples.dtype.kind in "biuf"]
    if not signals:
        raise InputError(f"{source}: the file has no channels with samples: record it again")
    series = {signal.name: pd.Series(signal.samples, index=signal.timestamps) for signal in signals}
    frame = pd.concat({name: each[~each.index.duplicated()] for name, each in series.items()}, axis="columns")
    units = {signal.name: signal.unit for signal in signals if signal.unit}
    return RawTable(frame.sort_index().rename_axis("time").reset_index(), units, "time")


@contextmanager
def _refusing(source: str, kind: str) -> Iterator[None]:
    """Say of whatever goes wrong inside that the file cannot be read."""
    try:
        yield
    except Exception:  # the readers raise errors of many kinds on broken files
        raise InputError(f"{source}: the file is no readable {kind} file: write it again") from None
