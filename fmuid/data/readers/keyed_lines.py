"""Logs with named numbers or stamped lines, rewritten as tables."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence

from fmuid.errors import InputError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_PAIR = re.compile(rf"(?P<name>[A-Za-z_][\w.]*)\s*[=:]\s*(?P<value>{_NUMBER}|nan)[i%]?(?=[\s,;]|$)")
_TOKEN = re.compile(r"(?P<name>[A-Za-z_][\w.]*)=(?P<value>\"[^\"]*\"|\S+)")
_STAMPED = re.compile(r"\[(?P<stamp>\d{4}-\d{2}-\d{2}[T ][\d:.]+)\]\s*(?P<rest>.*)")
_MONITOR = re.compile(r"(?:(?P<stamp>\d{1,2}:\d{2}:\d{2}\.\d+) -> )?(?P<rest>.*)")
_INFLUX = re.compile(r"(?P<series>\S+) (?P<rest>\S+) (?P<stamp>\d{19})")


Pairs = Sequence[tuple[str, str]]  # names and values of a line


def _table(lines: Iterable[Pairs], source: str) -> Iterator[str]:
    """Yield a header and rows; all lines must name the same."""
    names: list[str] | None = None
    for number, pairs in enumerate(lines, start=1):
        found = [name for name, _ in pairs]
        if names is None:
            names = found
            yield ",".join(names)
        if found != names:
            raise InputError(f"{source}: line {number} has other names than the first. Keep lines of one kind.")
        yield ",".join(f'"{value}"' if "," in value else value for _, value in pairs)


def _of_pairs(lines: Sequence[tuple[str, str]], source: str) -> Iterator[str]:
    """Yield a table of stamps and ``name=value``."""
    pairs = ([(each["name"], each["value"]) for each in _PAIR.finditer(rest)] for _, rest in lines)
    stamped = zip((stamp for stamp, _ in lines), pairs, strict=True)
    return _table(([("time", stamp), *own] if stamp else own for stamp, own in stamped), source)


def _logfmt(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield lines such as ``ts=2026-11-28T10:00:00Z u=12.1 i=0.3``."""
    written = filter(str.strip, lines)
    return _table(
        ([(each["name"], each["value"].strip('"')) for each in _TOKEN.finditer(line)] for line in written), source
    )


def _influx(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield InfluxDB's line protocol of one series."""
    found = [_INFLUX.fullmatch(line.strip()) for line in lines if line.strip() and not line.startswith("#")]
    whole = [each for each in found if each]
    if len({each["series"] for each in whole}) > 1 or len(whole) < len(found):
        raise InputError(f"{source}: several series. Query one of them as CSV.")
    yield from _of_pairs([(each["stamp"], each["rest"]) for each in whole], source)


def _monitor(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield lines of Arduino's monitor: ``12:00:00.123 -> u:12.1,i:0.3``."""
    found = [_MONITOR.fullmatch(line.strip()) for line in lines if line.strip()]
    yield from _of_pairs([(each["stamp"] or "", each["rest"]) for each in found if each], source)


def _stamped(lines: Sequence[str], source: str) -> Iterator[str]:
    """Yield lines after a time in brackets, below a line of names."""
    head, *rows = [line for line in lines if line.strip()]
    if _STAMPED.match(head):
        raise InputError(f"{source}: times in brackets without names. Insert a first line such as time,u,i.")
    yield head
    for number, line in enumerate(rows, start=2):
        found = _STAMPED.fullmatch(line.strip())
        if found is None:
            raise InputError(f"{source}: line {number} has no time in brackets. Remove it.")
        cells = [cell for cell in re.split(r"[\s,;]+", found["rest"]) if cell]
        yield ",".join((found["stamp"], *cells))


KEYED: tuple[tuple[re.Pattern[str], Callable[[Sequence[str], str], Iterator[str]]], ...] = (
    (re.compile(r"(?:[A-Za-z_][\w.]*=(?:\"[^\"\n]*\"|[^\s\"]+)[ \t]+)+[A-Za-z_][\w.]*=\S+\s*\n"), _logfmt),
    (re.compile(rf"\S+ (?:[\w.]+={_NUMBER}i?,?)+ \d{{19}}\s*\n"), _influx),
    (
        re.compile(
            rf"(?:\d{{1,2}}:\d{{2}}:\d{{2}}\.\d+ -> )?(?:[A-Za-z_]\w*:{_NUMBER}[,\t ]+)+[A-Za-z_]\w*:{_NUMBER}\s*\n"
        ),
        _monitor,
    ),
    (re.compile(r"(?:[^\n\[\]]*\n)?\[\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}:\d{2}[\d.]*\]\s*[-+\d]"), _stamped),
)
"""How the text begins, and who rewrites it."""
