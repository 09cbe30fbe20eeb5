"""Texts of a record by format strings, one line a row or one a sample of a signal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import pandas as pd

STATES = {6: "I/O Timeout", 7: "Bad Input", 59: "Comm Fail"}
Fields = dict[str, object]


def fields(frame: pd.DataFrame, dates: pd.Series) -> list[Fields]:
    """Return what formats may name, of a record of time, u, i, w in steps of 10 ms; with decimal commas in capitals."""

    def found() -> Iterator[Fields]:
        rows = frame[["time", "u", "i", "w"]].to_numpy().tolist()
        for k, ((t, u, i, w), d) in enumerate(zip(rows, dates, strict=True)):
            german = {name: str(x).replace(".", ",") for name, x in zip("TUIW", (t, u, i, w), strict=True)}
            times = {"h": t / 3600, "ms": 1e3 * t, "days": 46348.4375 + 1e3 * t / 864e5, "again": k % 40 / 100}
            times |= {"f": t % 1, "m": d.microsecond // 1000, "c": f"{t:06.3f}"}
            others = {"ma": 1e3 * i, "rpm": w * 9.549296585513721, "state": STATES.get(k, i)}
            yield {"k": k, "n": k + 1, "t": t, "d": d, "u": u, "i": i, "w": w} | german | times | others

    return list(found())


def tables(rows: Sequence[Fields], texts: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, str]]:
    """Return file name and text by name, of file name, head, format of a row and perhaps an end."""
    return {
        name: (file, head + "".join(f"{form.format(**row)}\n" for row in rows) + "".join(end))
        for name, (file, head, form, *end) in texts.items()
    }


def signals(rows: Sequence[Fields], head: str, form: str, *, by_signal: bool = False) -> str:
    """Return a text with one line a sample of a signal, by the number j, name, value and unit of the signal."""
    units = {"u": "V", "i": "A", "w": "rad/s"}
    found = [
        (j if by_signal else k, form.format(j=j, name=name, v=row[name], unit=units[name], **row))
        for k, row in enumerate(rows)
        for j, name in enumerate(units)
    ]
    return head + "".join(f"{line}\n" for _, line in sorted(found, key=lambda each: each[0]))
