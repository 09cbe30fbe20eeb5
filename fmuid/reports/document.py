"""Documents: sections, messages and tables of findings, as data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any, Literal

from fmuid.display_mixins import renderer
from fmuid.reports.chart import Figure

if TYPE_CHECKING:
    from fmuid.runs import Provenance

Tone = Literal["plain", "good", "doubt", "bad"]
Place = Literal["console", "detail", "page"]
EVERYWHERE: frozenset[Place] = frozenset(("console", "detail", "page"))
CONSOLE: frozenset[Place] = frozenset(("console", "detail"))
DETAIL: frozenset[Place] = frozenset(("detail",))  # on a terminal with ``--verbose`` only
PAGE: frozenset[Place] = frozenset(("page",))
TERMINAL_ROWS = 60  # rows of a table on a terminal; more scroll away the first. A pipe gets them all


class Message(Enum):
    """Messages of a topic, made by `plain`, `doubt` and `bad`. ``docs/messages.md`` lists them."""

    section: str

    def __init_subclass__(cls, section: str = "") -> None:
        cls.section = section  # key of the section that shows them

    def __init__(self, text: str, meaning: str = "", remedy: str = "", tone: Tone = "plain") -> None:
        self.text, self.meaning, self.remedy, self.tone = text, meaning, remedy, tone

    def said(self, section: str | None = None, tone: Tone | None = None, /, **values: object) -> Remark:
        """Return the message with values; capitalized unless a value or a symbol begins it."""
        told = self.text.format(**values)
        told = told if self.text[0] in "{σ" else capitalized(told)
        place, key = self.section if section is None else section, f"{type(self).__name__}.{self.name}"
        return Remark(told, tone or self.tone, place, key, values, self.remedy.format(**values))


Row = tuple[str, str, str, Tone]


def plain(text: str, meaning: str = "", remedy: str = "") -> Row:
    """Return a message that states a fact: template, meaning and remedy."""
    return text, meaning, remedy, "plain"


def doubt(text: str, meaning: str = "", remedy: str = "") -> Row:
    """Return a message that casts doubt on the findings."""
    return text, meaning, remedy, "doubt"


def bad(text: str, meaning: str = "", remedy: str = "") -> Row:
    """Return a message on findings that cannot be used."""
    return text, meaning, remedy, "bad"


@dataclass(frozen=True, eq=False)
class Remark:
    """A sentence with its remedy."""

    text: str
    tone: Tone = "plain"
    section: str = ""  # key of the section that shows it
    message: str = ""  # key of its `Message`
    values: Mapping[str, Any] = field(default_factory=dict)  # of the message
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.text}\n→ {self.remedy}" if self.remedy else self.text


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    head: str
    cells: tuple[str, ...]
    number: bool = False  # aligned as numbers
    rank: int = 0  # a narrow terminal leaves out the highest rank first; 0: never


Table = tuple[Column, ...]


@dataclass(frozen=True, eq=False)
class Section:
    """A part with a heading of its own."""

    key: str  # letters, digits, hyphens: its anchor and the name of its file
    heading: str
    caption: str = ""  # how to read it
    table: Table = ()
    charts: tuple[Figure, ...] = ()
    beside: int = 3  # charts beside each other at most
    zoom: Figure | None = None  # interval of the only chart, for print
    shown: frozenset[Place] = EVERYWHERE  # of the table
    remarks: tuple[Remark, ...] = ()  # below the table


@dataclass(frozen=True, eq=False)
class Document:
    """Report of findings: remarks, tables and charts.

    Attributes
    ----------
    kind, heading : str
        Noun of the command: ``identification``, ``diagnosis``, ``batch``.
    state, tone : str
        Verdict in a word, and its tone.
    remarks : tuple of Remark
        The verdict first.
    reason : str
        What follows the verdict in its line.
    summary : tuple of (str, str)
        Lines for a terminal: a word and a text each. Without them it shows all remarks.
    remedy : str
        Of the verdict; without it a terminal shows that of the gravest remark.
    sections : tuple of Section
        The first ones, without charts, are tables of the verdict.
    origin, study, title : tuple of Column, str, str
        Provenance, study file and its title.
    """

    kind: str
    heading: str
    state: str
    tone: Tone
    remarks: tuple[Remark, ...] = ()
    sections: tuple[Section, ...] = ()
    origin: Table = ()
    study: str = ""
    title: str = ""
    reason: str = ""
    summary: tuple[tuple[str, str], ...] = ()
    remedy: str = ""

    @classmethod
    def of(cls, found: object) -> Document:
        """Return the document of findings; printed, it shows its remarks, one a line.

        Parameters
        ----------
        found : object
            Findings of `fmuid.run`, a result, a diagnosis, a monitor, or what `fmuid.assess` and its like return.

        Raises
        ------
        InputError
            If there is none of this type.

        Examples
        --------
        >>> problem = fmuid.datasets.coil().problem()
        >>> print(fmuid.Document.of(fmuid.identify(problem)))
        Converged after 4 iterations.
        Solver error is below 0.005 σ.
        Solver check: FMI 2.0 Model Exchange, rk45, tolerance 1e-09.
        """
        made: Document = renderer().document(found)
        return made

    def __str__(self) -> str:
        return "\n".join(map(str, self.remarks))

    def html(self) -> str:
        """Return heading, remarks and tables as HTML, without charts."""
        shown: str = renderer().verdict(self)
        return shown

    def _repr_html_(self) -> str:
        return self.html()

    def section(self, key: str) -> Section:
        """Return the section of a key."""
        return next(each for each in self.sections if each.key == key)


def table_of(columns: Mapping[str, Iterable[str]], words: Iterable[str] = (), ranks: Iterable[str] = ()) -> Table:
    """Return a table; columns are numbers except the first and `words`."""
    order = list(ranks)[::-1]
    return tuple(
        Column(head, tuple(cells), k > 0 and head not in words, order.index(head) + 1 if head in order else 0)
        for k, (head, cells) in enumerate(columns.items())
    )


def table_of_rows(
    heads: Sequence[str], rows: Iterable[Sequence[str]], words: Iterable[str] = (), ranks: Iterable[str] = ()
) -> Table:
    """Return a table from its rows."""
    cells = list(rows)
    return table_of({head: [row[k] for row in cells] for k, head in enumerate(heads)}, words, ranks)


def capitalized(words: str) -> str:
    """Return words with a capital."""
    return words[:1].upper() + words[1:]


def origin_of(found: Provenance | None, more: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return the provenance fields of a document, with further rows."""
    rows = {} if found is None else {"fmuid": found.version, "run": found.date}
    study = None if found is None else found.study
    if study is not None:
        rows["study"] = f"{PurePosixPath(study.file).name}, SHA-256 {study.digest}"
        rows["study file"] = "values were replaced for this run" if study.changed else ""
    rows |= {} if found is None else {name: f"SHA-256 {digest}" for name, digest in found.files.items()}
    rows = {name: said for name, said in (rows | dict(more or {})).items() if said}
    columns = {"": list(rows), "what this page comes from": list(rows.values())}
    table = table_of(columns, columns) if rows else ()
    text, title = "" if study is None else study.text, "" if found is None else found.title
    return {"origin": table, "study": text, "title": title}
