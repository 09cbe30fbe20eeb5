"""`fmuid init`: matched columns, warnings, questions."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from rich.markup import escape
from rich.prompt import Prompt

from fmuid.errors import InputError
from fmuid.formatting import two_digits, unit_text
from fmuid.reports.document import Document, Remark, Section, table_of
from fmuid.reports.render.console import console, show_remarks, show_section
from fmuid.reports.topics.study_notes import dropout_words, size_words, time_words
from fmuid.studies import SHOWN_CHANGE, ColumnMatch, Draft, MatchedDataFile, Reason, proposal

REASONS: Mapping[Reason, str] = {
    Reason.GIVEN: "given",
    Reason.NAME: "same name",
    Reason.SPELLING: "same name but for case and separators",
    Reason.ADDITION: "same name but for an addition",
    Reason.BEGINNING: "same beginning, and the units convert",
    Reason.QUANTITY: "the only one of its quantity",
}
LINK_HEADS = ("variable", "unit", "is the", "column", "unit of the column", "because")
QUESTION = "Is this right? Enter to go on, or variable=column to change it (variable= for none)"


def record_section(record: MatchedDataFile) -> Section:
    """Return matched columns and warnings of a data file."""
    cells = [link_cells(link) for link in record.links]
    columns = {head: [row[k] for row in cells] for k, head in enumerate(LINK_HEADS)}
    said = [Remark(each, "doubt") for each in remarks(record)]
    if record.unused:
        said.insert(0, Remark(f"columns that are no input or output: {', '.join(record.unused)}"))
    title = heading(record, str(record.path))
    return Section("columns", title, table=table_of(columns, columns), remarks=tuple(said))


def heading(record: MatchedDataFile, name: str) -> str:
    """Return the heading of a data file."""
    span = record.frame[record.time]
    return f"{name}: {len(record.frame)} samples, {span.min():.6g} to {span.max():.6g} s"


def link_cells(link: ColumnMatch) -> tuple[str, ...]:
    """Return the cells of a variable, in the order of `LINK_HEADS`."""
    unit = unit_text(link.unit)
    if link.column is None or link.reason is None:
        why = f"may be {' or '.join(link.choices)}: undecided" if link.choices else "no such column"
        return link.variable, unit, link.role, "", "", why
    said = link.column_unit or (f"taken for {unit}" if unit else "")
    return link.variable, unit, link.role, link.column, said, REASONS[link.reason]


def remarks(record: MatchedDataFile) -> list[str]:
    """Return the warnings about a data file."""
    said = [record.refusal] if record.refusal else []
    for role in ("input", "output"):
        lacking = record.lacking(role)
        if lacking and (role == "input" or not record.roles(role) or record.unused):
            left = "" if not record.roles(role) else ", or nothing is compared with it"
            left = f", or --map {lacking[0]}= to leave it at its start" if role == "input" else left
            said.append(
                f"{record.path}: no column is the {role} {', '.join(lacking)}: "
                f"say which is by --map {lacking[0]}=COLUMN{left}"
            )
    if not record.roles("output") and not record.lacking("output"):
        said.append(
            f"{record.path}: the FMU declares no outputs, and no column is called like one of its variables: say which "
            "is measured by --map VARIABLE=COLUMN"
        )
    rows = 0 if record.experiment is None else record.experiment.times.size
    said += [
        f"{record.path}: {count} of {rows} samples of {column!r} are missing; they do not count"
        for column, count in record.missing.items()
    ]
    if record.interpolation != "linear":
        said.append(
            f"{record.path}: taken as held between samples, since over most of them it stays what it was: "
            f'{", ".join(record.held)}; interpolation = "linear" for what was measured'
        )
    if record.dropouts:
        said.append(dropout_words(str(record.path), record.dropouts))
    said += [
        f"{record.path}: the output {column!r} is {value:g} throughout: if its channel measured nothing, remove it "
        "from the outputs"
        for column, value in record.constant.items()
    ]
    said += [
        f"{record.path}: {count} samples of {column!r} are {value:g}, far from all others: if that stands for missing "
        "ones, leave those cells empty"
        for column, (value, count) in record.marks.items()
    ]
    return said


def on_terminal() -> bool:
    """Tell if a user can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def asked_about(record: MatchedDataFile) -> MatchedDataFile:
    """Show matched columns, and let a user correct uncertain ones."""
    show_section(record_section(record))
    if not on_terminal() or all(link.sure for link in record.links):
        return record
    while answer := Prompt.ask(escape(QUESTION), default="", show_default=False, console=console()).strip():
        variable, equals, column = (part.strip() for part in answer.partition("="))
        try:
            if not equals:
                raise InputError(f"{answer!r} is not understood: write variable=column")
            record = record.with_columns({variable: column})
            show_section(record_section(record))
        except InputError as error:
            show_remarks([Remark(str(error), "doubt")])
    return record


def draft_document(made: Draft, output: Path) -> Document:
    """Return the proposed parameters and the next step."""
    found = made.survey
    rows = [
        (name, f"{one.start:.6g}", unit_text(unit), f"{two_digits(100 * one.effect)} %", proposal(one))
        for one in found.candidates
        for name, unit in [(one.variable.name, one.variable.unit)]
    ]
    heads = ["parameter", "start", "unit", f"{100 * SHOWN_CHANGE:g} % change", "proposed"]
    table = table_of({head: [row[k] for row in rows] for k, head in enumerate(heads)}, ("unit", "proposed"))
    section = Section("parameters", "What the parameters change of the outputs' spread", table=table if rows else ())
    said = [*map(time_words, found.doubts), *(size_words(*each) for each in found.sizes)]
    said += [f"nothing is known of the parameters: {found.failure}"] if found.failure else []
    text = f"fmuid identify {output}" if made.runs else "free the parameters to identify in it, under [parameters]."
    doubts = tuple(Remark(each, "doubt") for each in said)
    return Document("draft", "Written", f"{output}. Next: {text}", "plain", doubts, (section,))
