"""`fmuid init`: matched columns, warnings, questions."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from rich.markup import escape
from rich.prompt import Prompt

from fmuid.errors import InputError
from fmuid.formatting import two_digits, unit_text
from fmuid.reports.document import Document, Message, Remark, Section, Table, doubt, plain, table_of_rows
from fmuid.reports.render.console import console, show_remarks, show_section
from fmuid.reports.topics.study_notes import gap_remark, missing_remark, size_remark, time_remark
from fmuid.studies import SHOWN_CHANGE, ColumnMatch, Draft, MatchedDataFile, MatchReason, proposal


class InitMessage(Message, section="columns"):
    """Notes of `fmuid init` on a data file."""

    UNUSED = plain("Columns without role: {columns}.")
    NOTE = plain("{column!r}: {why}.")
    CLOCKS = plain("Several time columns: {clocks}.")
    REFUSED = doubt("{words}")
    NO_INPUT = doubt(
        "{file}: no column for the input {names}.",
        remedy="Add --map {first}=COLUMN, or --map {first}= to keep its start value.",
    )
    NO_OUTPUT = doubt("{file}: no column for the output {names}.", remedy="Add --map {first}=COLUMN.")
    NO_OUTPUTS = doubt("{file}: no column has the name of an output.", remedy="Add --map VARIABLE=COLUMN.")
    UNIT = doubt(
        "{file}: unit {unit!r} of {column!r} does not convert to {wanted!r}.",
        remedy=(
            "Add --unit {name}={wanted} for numbers in {wanted}, "
            '"--unit={name}={share} of 10 {wanted}" for {counted} of 10 {wanted}.'
        ),
    )
    HELD = doubt(
        "{file}: zero-order hold assumed for {names}.", remedy='Set interpolation = "linear" for measured inputs.'
    )
    CONSTANT = doubt(
        "{file}: output {column!r} is constant ({value:g}).",
        remedy="Remove it from the outputs if nothing was measured.",
    )
    MARKS = doubt(
        "{file}: {count} samples of {column!r} are {value:g}, taken as missing.",
        remedy="Set missing = [] if they were measured.",
    )
    NO_SURVEY = doubt("Effects of the parameters unknown: {failure}")


REASONS: Mapping[MatchReason, str] = {
    MatchReason.GIVEN: "given",
    MatchReason.NAME: "same name",
    MatchReason.SPELLING: "same name except case and separators",
    MatchReason.ADDITION: "same name with an addition",
    MatchReason.BEGINNING: "same beginning, convertible units",
    MatchReason.QUANTITY: "only column of this quantity",
}
LINK_HEADS = ("variable", "unit", "role", "column", "column unit", "reason")
QUESTION = "Correct? Enter: continue; variable=column: change; variable=: no column"


def record_section(record: MatchedDataFile) -> Section:
    """Return matched columns and warnings of a data file."""
    title = heading(record, str(record.path))
    return Section("columns", title, table=links_table(record), remarks=(*notes(record), *remarks(record)))


def rows_section(record: MatchedDataFile) -> Section:
    """Return the first rows of a data file as read."""
    title = "First rows as read, time in s" if record.in_time else "First rows as read"
    return Section("rows", title, table=rows_table(record))


def rows_table(record: MatchedDataFile) -> Table:
    """Return the first rows of a data file as read."""
    first = record.frame.head(5)
    columns = {
        str(name): [f"{each:.6g}" if isinstance(each, float) else str(each) for each in first[name]]
        for name in [*([record.time] if record.in_time else []), *record.columns]
    }
    return table_of_rows([*columns], zip(*columns.values(), strict=True), ())


def notes(record: MatchedDataFile) -> list[Remark]:
    """Return unused columns, what was left out and why, and time columns."""
    said = [InitMessage.UNUSED.said("", columns=", ".join(record.unused))] if record.unused else []
    said += [InitMessage.NOTE.said("", column=column, why=why) for column, why in record.notes.items()]
    if record.clocks:
        said.append(InitMessage.CLOCKS.said("", clocks=", ".join(f"{a} at {b}" for a, b in record.clocks.items())))
    return said


def heading(record: MatchedDataFile, name: str) -> str:
    """Return the heading of a data file."""
    if not record.in_time:
        return f"{name}: {len(record.frame)} rows"
    span = record.frame[record.time]
    return f"{name}: {len(record.frame)} samples, {span.min():.6g} to {span.max():.6g} s"


def links_table(record: MatchedDataFile) -> Table:
    """Return the matched columns of a data file."""
    return table_of_rows(LINK_HEADS, map(link_cells, record.links), LINK_HEADS)


def link_cells(link: ColumnMatch) -> tuple[str, ...]:
    """Return the cells of a variable, in the order of `LINK_HEADS`."""
    unit = unit_text(link.unit)
    if link.column is None or link.reason is None:
        why = f"undecided: {' or '.join(link.choices)}" if link.choices else "no column"
        return link.variable, unit, link.role, "", "", why
    said = link.column_unit or (f"assumed {unit}" if unit else "")
    return link.variable, unit, link.role, link.column, said, REASONS[link.reason]


def remarks(record: MatchedDataFile) -> list[Remark]:
    """Return the warnings about a data file."""
    found, file = list[Remark](), str(record.path)

    def say(message: InitMessage, **values: object) -> None:
        found.append(message.said(file=file, **values))

    if record.refusal:
        say(InitMessage.REFUSED, words=record.refusal)
    for role, message in (("input", InitMessage.NO_INPUT), ("output", InitMessage.NO_OUTPUT)):
        lacking = record.lacking(role)
        if lacking and (role == "input" or not record.roles(role) or record.unused):
            say(message, names=", ".join(lacking), first=lacking[0])
    if not record.measured_columns and not record.lacking("output"):
        say(InitMessage.NO_OUTPUTS)
    for link in record.foreign_units:
        unit = record.asked.units.get(link.variable, link.column_unit)
        share, counted = ("%", "percent") if "%" in (unit or "") else ("pu", "multiples")
        words = {"wanted": link.unit or "1", "share": share, "counted": counted}
        say(InitMessage.UNIT, unit=unit, column=link.column, name=link.variable, **words)
    rows = 0 if record.experiment is None else record.experiment.times.size
    for column, count in record.missing.items():
        found.append(missing_remark(file, column, count, rows))
    if record.interpolation != "linear":
        say(InitMessage.HELD, names=", ".join(record.held))
    if record.dropouts:
        found.append(gap_remark(file, record.dropouts))
    for column, value in record.constant.items():
        say(InitMessage.CONSTANT, column=column, value=value)
    for column, own in record.marks.items():
        for value, count in own.items():
            say(InitMessage.MARKS, column=column, value=value, count=count)
    return found


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
                raise InputError(f"{answer!r}: not understood. Write variable=column.")
            record = record.with_columns({variable: column})
            show_section(record_section(record))
        except InputError as error:
            show_remarks([Remark(str(error), "doubt")])
    return record


def draft_document(made: Draft, output: Path) -> Document:
    """Return the proposed parameters and the next command."""
    found = made.survey
    rows = [
        (name, f"{one.start:.6g}", unit_text(unit), f"{two_digits(100 * one.effect)} %", proposal(one))
        for one in found.candidates
        for name, unit in [(one.variable.name, one.variable.unit)]
    ]
    heads = ["parameter", "start", "unit", f"{100 * SHOWN_CHANGE:g} % change", "proposed"]
    table = table_of_rows(heads, rows, ("unit", "proposed"))
    section = Section("parameters", "Effect of the parameters (% of the outputs' spread)", table=table if rows else ())
    said = [*map(time_remark, found.doubts), *(size_remark(*each) for each in found.sizes)]
    said += [InitMessage.NO_SURVEY.said("", failure=found.failure)] if found.failure else []
    text = "list the parameters to identify under [parameters]."
    if not all(record.is_ready for record in made.records):
        text = "follow the remedies (→), and run fmuid init again."
    text = f"fmuid identify {output}" if made.runs else text
    return Document("draft", "Written", f"{output}. Next: {text}", "plain", tuple(said), (section,))
