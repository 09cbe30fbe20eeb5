"""Ways to spoil the text of a table, drawn from a random generator; the last 120 lines are its samples."""

from collections.abc import Callable
from random import Random

from tests.support.fuzz_spoil import spoil_bytes

ROWS = 120
GARBAGE = [
    "",
    "x",
    "-",
    "1e",
    "--",
    "OL",
    "nan",
    "∞",
    "1.2.3",
    "0x1F",
    "1e999",
    "9.9E+37",
    "1_000",
    "#REF!",
    "'",
    '"',
    "\0",
]


def cut(rng: Random, text: str) -> str:
    """Cut it off anywhere."""
    return text[: rng.randrange(len(text) + 1)]


def few_samples(rng: Random, text: str) -> str:
    """Keep at most two rows of samples, and perhaps half a header."""
    lines = text.splitlines(keepends=True)
    head, rows = lines[:-ROWS], lines[-ROWS:]
    return "".join(head if rng.random() < 0.8 else head[: rng.randrange(len(head) + 1)]) + "".join(
        rows[: rng.randrange(3)]
    )


def cells(rng: Random, text: str) -> str:
    """Write garbage or nothing into a few cells."""
    return _of_lines(rng, text, [1, 1, 3, 20], lambda row: _set(rng, row), rng.randrange)


def cells_of_header(rng: Random, text: str) -> str:
    """Write garbage or nothing into a few cells of the header."""
    return _of_lines(rng, text, [1, 1, 2, 4], lambda row: _set(rng, row), lambda count: rng.randrange(_head(count)))


def counts(rng: Random, text: str) -> str:
    """Remove or add cells in a few rows."""

    def change(row: list[str]) -> list[str]:
        place, way = rng.randrange(len(row)), rng.randrange(3)
        if way == 0:
            return [*row[:place], *row[place + 1 :]]
        return [*row[:place], rng.choice(["1", "x", ""]), *row[place:]] if way == 1 else row[:place]

    return _of_lines(rng, text, [1, 1, 3], change, lambda count: _anywhere(rng, count))


def lines(rng: Random, text: str) -> str:
    """Remove, repeat or insert a few lines."""
    found = text.split("\n")
    for _ in range(rng.choice([1, 1, 3])):
        place, way = _anywhere(rng, len(found)), rng.randrange(3)
        if way == 0 and len(found) > 1:
            del found[place]
        else:
            found.insert(place, found[place] if way == 1 else rng.choice(["", "garbage", ",,,", "1", "1,2"]))
    return "\n".join(found)


def bits(rng: Random, text: str) -> bytes:
    """Change, move or remove bytes."""
    return spoil_bytes(rng, text.encode())


Way = Callable[[Random, str], str | bytes]
WAYS: dict[str, Way] = {each.__name__: each for each in (cut, few_samples, cells, cells_of_header, counts, lines, bits)}


def separator(line: str) -> str:
    """Return what separates the cells of a line."""
    return next((mark for mark in "\t;," if mark in line), " ")


def _set(rng: Random, row: list[str]) -> list[str]:
    row[rng.randrange(len(row))] = rng.choice(GARBAGE)
    return row


def _head(count: int) -> int:
    return max(count - ROWS + 5, 1)


def _anywhere(rng: Random, count: int) -> int:
    return rng.randrange(count if rng.random() < 0.5 else _head(count))


def _of_lines(
    rng: Random, text: str, times: list[int], change: Callable[[list[str]], list[str]], place: Callable[[int], int]
) -> str:
    found = text.split("\n")
    for _ in range(rng.choice(times)):
        k = place(len(found))
        mark = separator(found[k])
        found[k] = mark.join(change(found[k].split(mark)))
    return "\n".join(found)
