"""What `fmuid init` shows and asks: which columns are which variables, and what is wrong with the table."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from rich.markup import escape
from rich.prompt import Prompt

from fmuid.errors import InputError
from fmuid.formatting import two_digits, unit_text
from fmuid.reports.document import Remark, table_of
from fmuid.reports.render.console import console, rich_table, show_remarks
from fmuid.reports.shared_phrases import dropout_words, size_words, time_words
from fmuid.studies import SHOWN_CHANGE, Candidate, ColumnMatch, Draft, MatchedDataFile, Reason, proposal

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


def show_record(record: MatchedDataFile) -> None:
    """Print which columns are which variables, and what is wrong with the table."""
    out = console()
    cells = [link_cells(link) for link in record.links]
    columns = {head: [row[k] for row in cells] for k, head in enumerate(LINK_HEADS)}
    out.print(rich_table(table_of(columns, columns), heading(record, str(record.path)), out))
    if record.unused:
        out.print(f"columns that are no input or output: {escape(', '.join(record.unused))}", soft_wrap=True)
    _warn(remarks(record))


def _warn(sentences: Iterable[str]) -> None:
    show_remarks(Remark(each, "doubt") for each in sentences)


def heading(record: MatchedDataFile, name: str) -> str:
    """Return what a table of this name has."""
    span = record.frame[record.time]
    return f"{name}: {len(record.frame)} samples, {span.min():.6g} to {span.max():.6g} s"


def link_cells(link: ColumnMatch) -> tuple[str, ...]:
    """Return what is said of a variable, under `LINK_HEADS`."""
    unit = unit_text(link.unit)
    if link.column is None or link.reason is None:
        why = f"may be {' or '.join(link.choices)}: undecided" if link.choices else "no such column"
        return link.variable, unit, link.role, "", "", why
    said = link.column_unit or (f"taken for {unit}" if unit else "")
    return link.variable, unit, link.role, link.column, said, REASONS[link.reason]


def remarks(record: MatchedDataFile) -> list[str]:
    """Return what is to be said of a table, a sentence each."""
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
    """Return whether somebody sits there who can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def asked_about(record: MatchedDataFile) -> MatchedDataFile:
    """Show what the columns are taken for, and let who sits at a terminal correct it where it is a guess."""
    show_record(record)
    if not on_terminal() or all(link.sure for link in record.links):
        return record
    while answer := Prompt.ask(escape(QUESTION), default="", show_default=False, console=console()).strip():
        variable, equals, column = (part.strip() for part in answer.partition("="))
        try:
            if not equals:
                raise InputError(f"{answer!r} is not understood: write variable=column")
            changed = record.with_columns({variable: column})
            show_record(changed)
            record = changed
        except InputError as error:
            _warn([str(error)])
    return record


def show_draft(made: Draft, output: Path) -> None:
    """Say which parameters are proposed, and what comes next."""
    found, out = made.survey, console()
    if found.candidates:
        heads = ["parameter", "start", "unit", f"{100 * SHOWN_CHANGE:g} % change", "proposed"]
        title = "What the parameters change of the outputs' spread"
        rows = [_proposed(each) for each in found.candidates]
        columns = {head: [row[k] for row in rows] for k, head in enumerate(heads)}
        out.print(rich_table(table_of(columns, ("unit", "proposed")), title, out))
    _warn(time_words(each) for each in found.doubts)
    _warn(size_words(*each) for each in found.sizes)
    if found.failure:
        _warn([f"nothing is known of the parameters: {found.failure}"])
    text = "free the parameters to identify in it, under \\[parameters]."
    if made.runs:
        text = f"fmuid identify {escape(str(output))}"
    out.print(f"Written: [bold]{escape(str(output))}[/]. Next: {text}", soft_wrap=True)


def _proposed(given: Candidate) -> tuple[str, ...]:
    unit = unit_text(given.variable.unit)
    return given.variable.name, f"{given.start:.6g}", unit, f"{two_digits(100 * given.effect)} %", proposal(given)
