"""What `fmuid info` and `fmuid validate` print of an FMU."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import chain
from textwrap import shorten
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fmuid.formatting import bounded, unit_text
from fmuid.models import Description, FmuSummary, Variable, VariableRow, lines
from fmuid.reports.document import table_of
from fmuid.reports.render.console import TERMINAL_ROWS, console, rich_table, show_notes
from fmuid.reports.topics.solver_check import capability_words, run_words
from fmuid.studies import skeleton

if TYPE_CHECKING:
    from fmuid.simulation import Check, Validation

# Inputs that are named where an output depends on them; how many there are besides is said.
INPUTS_NAMED = 4
# Remarks of one check on a terminal, and letters of each: FMPy lists all variables of a model in one.
TERMINAL_REMARKS, REMARK_LENGTH = 5, 300
# Letters that a description has at least on a terminal; it ends where the line does.
SHORT_DESCRIPTION = 25
# Between two columns.
COLUMN_GAP = 3
# Letters of a name, and of any other text: an FMU can have names of any length.
NAME_LENGTH, TEXT_LENGTH = 200, 1000
# Into a pipe, where lines are searched: one line a variable, however long.
PIPE_WIDTH = 1000

RESULTS = {"ok": "green", "warning": "yellow", "failed": "bold red"}
"""How results of checks are painted."""

Column = Callable[[Variable], str]
"""What a column of a table says of a variable."""


# --- fmuid info -------------------------------------------------------------------------


def show_facts(found: FmuSummary) -> None:
    """Print what an FMU declares, and a study to begin with."""
    described, out = found.fmu.description, console()
    if not out.is_terminal:
        out.width = PIPE_WIDTH
    remark = _text(described.description.removeprefix(described.model_name).lstrip(": "))
    out.print(f"[bold]{escape(_name(described.model_name))}[/]" + (f": {escape(remark)}" if remark else ""))
    out.print(_head(found))
    for title, variables, columns in (
        ("Parameters ({}), fixed: set before the initialisation", found.fixed, {}),
        ("Parameters ({}), tunable: set before the initialisation, too", found.tunable, {}),
        ("Parameters ({}), calculated from others: they cannot be set", found.calculated, {}),
        ("Parameters ({}), structural: they size arrays and keep their start values", found.structural, {}),
        ("Inputs ({})", found.inputs, {"changes": _changes}),
        ("Outputs ({})", found.outputs, {"depends directly on": _direct(found), "start can be set": _settable}),
        ("States ({})", found.states, {"start can be set": _settable}),
        ("Other variables ({}) whose start values can be set", found.starts, {}),
    ):
        _show_variables(out, title.format(len(variables)), variables, columns)
    _show_units(out, found)
    if found.others:
        out.print(f"\n{found.others} other variable{'s' * (found.others != 1)}")
    out.print("\n[bold]A study to begin with[/] [dim](fmuid init FMU TABLE writes a longer one)[/]\n")
    for line in skeleton(found.fmu).splitlines():
        out.print(line if len(line) <= TEXT_LENGTH else _text(line), markup=False, soft_wrap=True)


def _name(text: str) -> str:
    return bounded(text, NAME_LENGTH)


def _text(text: str) -> str:
    return bounded(text, TEXT_LENGTH)


def _head(found: FmuSummary) -> Table:
    described, platforms = found.fmu.description, found.fmu.platforms
    rows = Table.grid(padding=(0, 2))
    rows.add_row("FMI version", described.fmi_version)
    for kind, declared in found.capabilities.items():
        unused = "" if kind in described.interfaces else " (fmuid does not use it)"
        rows.add_row(
            kind, escape(_text(", ".join(capability_words(kind, declared))) or "no optional capabilities") + unused
        )
    rows.add_row("fmuid runs it as", escape(run_words(found.run_as)))
    there = ", ".join(f"{name} (this machine)" if name == found.here else _name(name) for name in platforms)
    if found.here is None:
        there = f"{there or 'no binaries at all'}; none for this machine ({found.machine})"
    rows.add_row("platforms", escape(_text(there)))
    if found.states or described.indicators:
        rows.add_row("continuous states", f"{len(found.states)}, with {described.indicators} event indicators")
    if described.default_experiment:
        rows.add_row("default experiment", _default_experiment(described))
    if described.generation_tool:
        rows.add_row("made by", escape(_name(described.generation_tool)))
    return rows


def _default_experiment(described: Description) -> str:
    words = {"start": "start {:g} s", "stop": "stop {:g} s", "step_size": "step {:g} s", "tolerance": "tolerance {:g}"}
    given = described.default_experiment
    return ", ".join(text.format(given[word]) for word, text in words.items() if word in given)


def _show_variables(out: Console, title: str, variables: Sequence[Variable], more: Mapping[str, Column]) -> None:
    """Print a table of variables, with the columns that some of them have anything to say in."""
    if not variables:
        return
    every = lines(variables)
    rows = every[:TERMINAL_ROWS] if out.is_terminal else every
    shown = list(chain.from_iterable(line.variables for line in rows))
    columns: dict[str, Column] = {"start": lambda v: _plain(v.start), "unit": lambda v: unit_text(v.unit)}
    if any(v.type != "Real" for v in shown):
        columns["type"] = lambda v: v.type
    if any(v.min is not None or v.max is not None for v in shown):
        columns |= {"min": lambda v: _plain(v.min), "max": lambda v: _plain(v.max)}
    columns |= {head: column for head, column in more.items() if any(column(v) for v in shown)}
    columns["description"] = _remark
    heads = ["name", *columns]
    cells = [[_name(line.name) for line in rows], *(_cells(rows, column) for column in columns.values())]
    right = ("start", "min", "max")
    if out.is_terminal:
        widths = [max(map(len, [head, *texts])) for head, texts in zip(heads, cells, strict=True)]
        room = max(out.width - sum(widths[:-1]) - COLUMN_GAP * (len(widths) - 1), SHORT_DESCRIPTION)
        cells[-1] = [shorten(text, room, placeholder="…") for text in cells[-1]]
        words = [head for head in heads if head not in right]
        _print_titled(out, title, rich_table(table_of(dict(zip(heads, cells, strict=True)), words), "", out))
    else:
        out.print(f"\n[bold]{title}[/]")
        out.file.writelines(_plain_table(heads, cells, right))
    if len(rows) < len(every):
        out.print(f"and {len(every) - len(rows)} more; all of them: fmuid info FMU | less")


def _plain_table(heads: Sequence[str], columns: Sequence[Sequence[str]], right: Collection[str]) -> Iterator[str]:
    """Yield the lines of a table: of a hundred thousand, Rich takes a minute for them."""
    filled = [_filled([head, *texts], flush_right=head in right) for head, texts in zip(heads, columns, strict=True)]
    for number, row in enumerate(zip(*filled, strict=True)):
        line = (" " * COLUMN_GAP).join(row)
        yield line.rstrip() + "\n"
        if number == 0:
            yield "─" * cell_len(line) + "\n"


def _filled(texts: Sequence[str], *, flush_right: bool) -> list[str]:
    """Return texts filled up to one width with blanks; some letters take two columns, some none."""
    plain = "".join(texts).isascii()
    widths = [(len if plain or text.isascii() else cell_len)(text) for text in texts]
    widest = max(widths)
    if plain:
        return [text.rjust(widest) if flush_right else text.ljust(widest) for text in texts]
    blanks = [" " * (widest - width) for width in widths]
    return [blank + text if flush_right else text + blank for text, blank in zip(texts, blanks, strict=True)]


def _cells(rows: Sequence[VariableRow], column: Column) -> list[str]:
    """Return what the lines say in a column."""
    said = [column(line.variables[0]) if len(line.variables) == 1 else _cell(line, column) for line in rows]
    return [text if len(text) <= TEXT_LENGTH and text.isprintable() else _text(text) for text in said]


def _cell(line: VariableRow, column: Column) -> str:
    """Return what several variables say in a column: all the same, a range of numbers, or the first and last."""
    said = list(dict.fromkeys(column(v) for v in line.variables))
    if len(said) == 1:
        return said[0]
    try:
        numbers = sorted(said, key=float)
    except ValueError:
        return f"{said[0]} … {said[-1]}"
    return f"{numbers[0]} to {numbers[-1]}"


def _plain(value: float | int | bool | str | None) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _remark(variable: Variable) -> str:
    """Return the description, a free text that FMUs fill as they like, in one line."""
    constant = " (constant)" if variable.variability == "constant" else ""
    return (" ".join(variable.description.split()) + constant).strip()


def _changes(variable: Variable) -> str:
    return "continuously" if variable.continuous else "in steps" if variable.variability != "fixed" else "never"


def _settable(variable: Variable) -> str:
    return "yes" if variable.settable else ""


def _direct(found: FmuSummary) -> Column:
    """Return the column that names the inputs which act on an output at once."""

    def words(output: Variable) -> str:
        names = found.direct.get(output.name)
        if not found.inputs:
            return ""
        if names is None:
            return "all inputs (nothing is declared)"
        if len(names) == len(found.inputs) > 1:
            return "all inputs"
        more = len(names) - INPUTS_NAMED
        return ", ".join(names[:INPUTS_NAMED]) + (f" and {more} more" if more > 0 else "") or "none"

    return words


def _show_units(out: Console, found: FmuSummary) -> None:
    others = {unit: names for unit, names in found.units.items() if names}
    if not others:
        return
    instead = [_text(", ".join(names)) for names in others.values()]
    columns = {"unit": list(map(_name, others)), "instead": instead}
    table = rich_table(table_of(columns, columns), "", out)
    _print_titled(out, "Units that a table may have instead", table)


def _print_titled(out: Console, title: str, table: Table) -> None:
    """Print a table below a title, which a narrow table's own would wrap."""
    out.print(f"\n[bold]{title}[/]")
    out.print(table)


# --- fmuid validate ---------------------------------------------------------------------


def show_binaries(checks: Sequence[Check]) -> None:
    """Print before a validation which binaries are missing, and what is simulated."""
    from fmuid.reports.topics.validation import check_words
    from fmuid.simulation import TIME_LIMIT

    notes = dict.fromkeys(text for check in checks if check.result == "failed" for text in check_words(check))
    if any(check.result != "failed" for check in checks):
        notes[f"simulating each interface; one that does not end is stopped after {TIME_LIMIT:g} s"] = None
    show_notes(notes)


def show_validation(found: Validation) -> None:
    """Print the checks of an FMU, and a sentence that sums them up."""
    from fmuid.reports.topics.validation import check_words  # and with it all that simulates

    out = console()
    remarked = []
    for check in found.checks:
        said = check_words(check)
        remarks = said
        if out.is_terminal:
            remarks = [shorten(text, REMARK_LENGTH, placeholder=" …") for text in said[:TERMINAL_REMARKS]]
        more = len(said) - len(remarks)
        remarked.append(
            "\n".join([*remarks, *([f"and {more} more; all of them: fmuid validate FMU | less"] if more else [])])
        )
    columns = {"check": [e.name for e in found.checks], "result": [e.result for e in found.checks], "remark": remarked}
    out.print(rich_table(table_of(columns, columns), str(found.path.name), out, RESULTS))
    failed, warned = found.count("failed"), found.count("warning")
    verdict = f"{failed} of {len(found.checks)} checks failed" if failed else "no problems found"
    out.print(f"\n{verdict}" + (f", {warned} with warnings" if warned else ""))
