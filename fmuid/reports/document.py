"""Documents: what a person reads of findings, as data. Topics make them, renderers show them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar, Literal

from fmuid.reports.chart import WITH_ARRAYS, Figure

Tone = Literal["plain", "good", "doubt", "bad"]
Place = Literal["console", "page"]
EVERYWHERE: frozenset[Place] = frozenset(("console", "page"))
CONSOLE: frozenset[Place] = frozenset(("console",))
PAGE: frozenset[Place] = frozenset(("page",))


class Message(Enum):
    """Sentences of a topic: a template each, what it means, and what to do. ``docs/messages.md`` is made of them."""

    def __init__(self, text: str, meaning: str = "", action: str = "") -> None:
        self.text, self.meaning, self.action = text, meaning, action

    def said(self, tone: Tone = "plain", section: str = "", names: Iterable[str] = (), /, **values: object) -> Remark:
        """Return the sentence with these values; it begins with a capital, unless one of the names stands there."""
        told = self.text.format(**values)
        return Remark(capitalised(told, names), tone, section, f"{type(self).__name__}.{self.name}", values)


@dataclass(frozen=True, eq=False)
class Remark:
    """A sentence.

    Attributes
    ----------
    text : str
    tone : str
        ``doubt``: something is doubtful, and the sentence says what helps.
    section : str
        Key of the section that shows it, "" for none.
    message : str
        Key of its `Message`, "" for a sentence that is none.
    values : mapping
        What the message was filled with.
    """

    text: str
    tone: Tone = "plain"
    section: str = ""
    message: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    head : str
    cells : tuple of str
    number : bool
        Whether it is aligned as numbers.
    rank : int
        A narrow terminal leaves out columns of a rank, the highest first; 0: never.
    """

    head: str
    cells: tuple[str, ...]
    number: bool = False
    rank: int = 0


Table = tuple[Column, ...]


@dataclass(frozen=True, eq=False)
class Section:
    """A part with a heading of its own.

    Attributes
    ----------
    key : str
        Of letters, digits and hyphens: its anchor, and the name of its file for print.
    heading : str
    caption : str
        How to read it.
    table : tuple of Column
    charts : tuple of Chart or ChartGrid
    beside : int
        So many charts stand beside each other at most.
    zoom : ChartGrid, optional
        A stretch of the only chart, which print shows beside it.
    shown : frozenset of str
        Where its table is shown: ``console``, ``page``.
    remarks : tuple of Remark
        Below the table.
    """

    key: str
    heading: str
    caption: str = ""
    table: Table = ()
    charts: tuple[Figure, ...] = ()
    beside: int = 3
    zoom: Figure | None = None
    shown: frozenset[Place] = EVERYWHERE
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True, eq=False)
class Document:
    """What a person reads of the findings of one command.

    Attributes
    ----------
    kind : str
        The command's noun: ``identification``, ``diagnosis``, ``batch``.
    heading : str
    state : str
        In a word.
    tone : str
        Of the state.
    remarks : tuple of Remark
        The verdict first.
    sections : tuple of Section
        The first ones, without charts, are tables of the verdict.
    origin : tuple of Column
        What it was made from.
    study : str
        Text of the study file.
    title : str
        Of the study.
    """

    __pydantic_config__: ClassVar[Mapping[str, bool]] = WITH_ARRAYS

    kind: str
    heading: str
    state: str
    tone: Tone
    remarks: tuple[Remark, ...] = ()
    sections: tuple[Section, ...] = ()
    origin: Table = ()
    study: str = ""
    title: str = ""

    def section(self, key: str) -> Section:
        """Return the section of a key."""
        return next(each for each in self.sections if each.key == key)

    def sections_of(self, keys: Iterable[str]) -> list[Section]:
        """Return the sections of these keys that there are."""
        return [each for each in self.sections if each.key in keys]


def table_of(columns: Mapping[str, Iterable[str]], words: Iterable[str] = (), ranks: Iterable[str] = ()) -> Table:
    """Return a table; all columns but the first and the `words` are numbers, the first of `ranks` is left out first."""
    order = list(ranks)[::-1]
    return tuple(
        Column(head, tuple(cells), k > 0 and head not in words, order.index(head) + 1 if head in order else 0)
        for k, (head, cells) in enumerate(columns.items())
    )


def capitalised(words: str, names: Iterable[str] = ()) -> str:
    """Return words with a capital at their beginning; one of these names that stands there is kept as it is."""
    kept = any(words.startswith(name) and not words[len(name) :][:1].isalnum() for name in names)
    return words if kept else words[:1].upper() + words[1:]
