"""`fmuid info`: declarations of an FMU."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from textwrap import shorten

from fmuid.formatting import bounded, unit_text
from fmuid.models import FmuSummary, Variable, VariableRow, lines
from fmuid.reports.document import TERMINAL_ROWS, Document, Remark, Section, table_of
from fmuid.reports.topics.solver_check import capability_words, run_words
from fmuid.studies import skeleton

# Inputs that are named where an output depends on them; how many there are besides is said.
INPUTS_NAMED = 4
# Letters that a description has at least on a terminal; it ends where the line does.
SHORT_DESCRIPTION = 25
# Between two columns.
COLUMN_GAP = 3
SETTABLE = "start can be set"
# Letters of a name, and of any other text: an FMU can have names of any length.
NAME_LENGTH, TEXT_LENGTH = 200, 1000

CellText = Callable[[Variable], str]
"""What a column of a table says of a variable."""


def facts_document(found: FmuSummary, width: int | None = None) -> Document:
    """Return the declarations of an FMU and a first study, for a terminal of a width or without limits."""
    described = found.fmu.description
    rows = list(_declared(found))
    head = table_of({"": [row[0] for row in rows], " ": [row[1] for row in rows]}, (" ",))
    sections = [Section("declarations", "", table=head)]
    for key, title, variables, columns in (
        ("fixed", "Parameters ({}), fixed: set before the initialisation", found.fixed, {}),
        ("tunable", "Parameters ({}), tunable: set before the initialisation, too", found.tunable, {}),
        ("calculated", "Parameters ({}), calculated from others: they cannot be set", found.calculated, {}),
        ("sizes", "Parameters ({}), structural: they size arrays and keep their start values", found.structural, {}),
        ("inputs", "Inputs ({})", found.inputs, {"changes": _changes}),
        ("outputs", "Outputs ({})", found.outputs, {"depends directly on": _direct(found), SETTABLE: _settable}),
        ("states", "States ({})", found.states, {SETTABLE: _settable}),
        ("starts", "Other variables ({}) whose start values can be set", found.starts, {}),
    ):
        if variables:
            sections.append(_variables(key, title.format(len(variables)), variables, columns, width))
    others = {_name(unit): _text(", ".join(names)) for unit, names in found.units.items() if names}
    if others:
        units = table_of({"unit": others, "instead": others.values()}, ("instead",))
        sections.append(Section("units", "Units that a table may have instead", table=units))
    said = (Remark(f"{found.others} other variable{'s' * (found.others != 1)}"),) if found.others else ()
    study = "\n".join(line if len(line) <= TEXT_LENGTH else _text(line) for line in skeleton(found.fmu).splitlines())
    state = _text(described.description.removeprefix(described.model_name).lstrip(": "))
    return Document("fmu", _name(described.model_name), state, "plain", said, tuple(sections), study=study)


def _name(text: str) -> str:
    return bounded(text, NAME_LENGTH)


def _text(text: str) -> str:
    return bounded(text, TEXT_LENGTH)


def _declared(found: FmuSummary) -> Iterator[tuple[str, str]]:
    """Yield how an FMU can be run."""
    described, platforms = found.fmu.description, found.fmu.platforms
    yield "FMI version", described.fmi_version
    for kind, declared in found.capabilities.items():
        unused = "" if kind in described.interfaces else " (fmuid does not use it)"
        yield kind, (_text(", ".join(capability_words(kind, declared))) or "no optional capabilities") + unused
    yield "fmuid runs it as", run_words(found.run_as)
    there = ", ".join(f"{name} (this machine)" if name == found.here else _name(name) for name in platforms)
    if found.here is None:
        there = f"{there or 'no binaries at all'}; none for this machine ({found.machine})"
    yield "platforms", _text(there)
    if found.states or described.indicators:
        yield "continuous states", f"{len(found.states)}, with {described.indicators} event indicators"
    if given := described.default_experiment:
        texts = {"start": "start {:g} s", "stop": "stop {:g} s", "step_size": "step {:g} s"}
        texts["tolerance"] = "tolerance {:g}"
        yield "default experiment", ", ".join(text.format(given[key]) for key, text in texts.items() if key in given)
    if described.generation_tool:
        yield "made by", _name(described.generation_tool)


def _variables(
    key: str, title: str, variables: Sequence[Variable], more: Mapping[str, CellText], width: int | None
) -> Section:
    every = lines(variables)
    rows = every if width is None else every[:TERMINAL_ROWS]
    shown = list(chain.from_iterable(line.variables for line in rows))
    columns: dict[str, CellText] = {"start": lambda v: _plain(v.start), "unit": lambda v: unit_text(v.unit)}
    if any(v.type != "Real" for v in shown):
        columns["type"] = lambda v: v.type
    if any(v.min is not None or v.max is not None for v in shown):
        columns |= {"min": lambda v: _plain(v.min), "max": lambda v: _plain(v.max)}
    columns |= {head: column for head, column in more.items() if any(column(v) for v in shown)}
    columns["description"] = _remark
    cells = {"name": [_name(line.name) for line in rows]}
    cells |= {head: _cells(rows, column) for head, column in columns.items()}
    if width is not None:
        *widths, _ = (max(map(len, [head, *texts])) for head, texts in cells.items())
        room = max(width - sum(widths) - COLUMN_GAP * len(widths), SHORT_DESCRIPTION)
        cells["description"] = [shorten(text, room, placeholder="…") for text in cells["description"]]
    left = len(every) - len(rows)
    said = (Remark(f"and {left} more; all of them: fmuid info FMU | less"),) if left else ()
    table = table_of(cells, [head for head in cells if head not in ("start", "min", "max")])
    return Section(key, title, table=table, remarks=said)


def _cells(rows: Sequence[VariableRow], column: CellText) -> list[str]:
    said = [column(line.variables[0]) if len(line.variables) == 1 else _cell(line, column) for line in rows]
    return [text if len(text) <= TEXT_LENGTH and text.isprintable() else _text(text) for text in said]


def _cell(line: VariableRow, column: CellText) -> str:
    """Return the common value, the range, or the first and last."""
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
    constant = " (constant)" if variable.variability == "constant" else ""
    return (" ".join(variable.description.split()) + constant).strip()


def _changes(variable: Variable) -> str:
    return "continuously" if variable.continuous else "in steps" if variable.variability != "fixed" else "never"


def _settable(variable: Variable) -> str:
    return "yes" if variable.settable else ""


def _direct(found: FmuSummary) -> CellText:
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
