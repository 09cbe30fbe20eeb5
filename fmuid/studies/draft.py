"""A first study file for an FMU and a table, with everything in it that the two say of themselves."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

from fmuid.errors import InputError
from fmuid.files import exists

if TYPE_CHECKING:
    from fmuid.fmi import FMU, Description, Variable
    from fmuid.studies.words import Words

# What a table can hold, and what an output of an experiment can be.
NUMBERS, OBSERVED = ("Real", "Integer", "Boolean"), ("output", "local")
# How many names a comment lists, and how many parameters a skeleton: what can be read at a glance.
NAMES_LISTED, PARAMETERS_LISTED = 20, 12
LINE_LENGTH, REMARK_LENGTH = 110, 80
# Modelica tools write their largest numbers for bounds that are none.
NO_BOUND = 1e60


@dataclass(frozen=True)
class Draft:
    """A study file to begin with, and what could not be matched.

    Attributes
    ----------
    text : str
        The file.
    inputs, outputs : tuple of str
        Variables of the FMU that are columns of the table too; an output may be a local variable.
    missing_inputs, missing_outputs : tuple of str
        Inputs and outputs of the FMU that are not.
    unused : tuple of str
        Columns that are neither.
    """

    text: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    missing_inputs: tuple[str, ...]
    missing_outputs: tuple[str, ...]
    unused: tuple[str, ...]


def draft(fmu: Path, table: Path, output: Path) -> Draft:
    """Write down a study of an FMU and a table, without writing the file.

    Parameters
    ----------
    fmu, table
        The files.
    output
        Where the study file is to be: its paths are relative to that.

    Raises
    ------
    InputError
        If one of the files cannot be read.
    """
    from fmuid.data import read_table
    from fmuid.fmi import read_description
    from fmuid.studies.model import ExperimentSettings

    description = read_description(fmu)
    frame, time = read_table(table), "time"
    columns = [str(column) for column in frame.columns if column != time]
    inputs, missing_inputs = _match(_of_tables(description, "input"), columns)
    outputs, missing_outputs = _match(_of_tables(description, "output"), columns)
    outputs += _match(_of_tables(description, "local"), columns)[0]
    unused = tuple(column for column in columns if column not in (*inputs, *outputs))
    lines = [
        f"# A study of {description.model_name}, begun by `fmuid init`.",
        f"# Remove the # before each parameter to identify, below [parameters], and run: fmuid identify {output.name}",
        "",
        f"title = {_text(description.model_name)}",
        "",
        "[model]",
        f"fmu = {_text(_relative(fmu, output))}  # paths are relative to this file",
        *_numerics(description),
        "",
        "[model.values]  # parameters held at another value than the FMU's own: name = value",
        "",
        "[[experiments]]  # repeat this table for further experiments",
        f"table = {_text(_relative(table, output))}",
        f"time = {_text(time)}  # or what the table calls so: Time (ms), t, timestamp",
        *_roles("inputs", inputs, missing_inputs),
        *_roles("outputs", outputs, missing_outputs),
        *([f"# columns that are no input or output of the FMU: {_listed(unused)}"] if unused else []),
        '# where a column has another name: outputs = { fmu_variable = "column" }',
        *(ExperimentSettings.example_line(key) for key in ("interpolation", "discard")),
        "",
        *_parameters(description),
        "",
        *_rest(),
    ]
    return Draft("\n".join(lines) + "\n", inputs, outputs, missing_inputs, missing_outputs, unused)


def skeleton(fmu: FMU) -> str:
    """Return a short study of an FMU and a table that is still to come: what `fmuid info` shows to be pasted.

    An FMU without outputs is observed by its states, which may be measured like any local variable.
    """
    description = fmu.description
    outputs, remark = _of_tables(description, "output"), ""
    if not outputs:
        outputs = [name for name in description.states if description.variables[name].causality in OBSERVED]
        remark = "  # the FMU declares no outputs: states or other local variables that are measured"
    lines = [
        "[model]",
        f"fmu = {_text(fmu.path.name)}  # relative to the study file",
        *_numerics(description),
        "",
        "[[experiments]]",
        'table = "table.csv"  # its first column is time, s',
        *_roles("inputs", _of_tables(description, "input"), ()),
        _names("outputs", outputs) + remark,
        "",
    ]
    freed = _free(description)
    lines.append("[parameters]  # " + ("remove the # before those to identify" if freed else "none can be set"))
    lines += [_parameter(variable) for variable in freed[:PARAMETERS_LISTED]]
    if len(freed) > PARAMETERS_LISTED:
        lines.append(f"# and {len(freed) - PARAMETERS_LISTED} more, all of which `fmuid init` writes")
    return "\n".join(lines) + "\n"


def write_draft(fmu: Path, table: Path, output: Path) -> Draft:
    """Write the study file that `draft` makes up.

    Raises
    ------
    InputError
        If a file of that name is there already, or `draft` refuses.
    """
    if exists(output):
        raise InputError(f"{output} is there already: choose another name with --output, or remove it")
    made = draft(fmu, table, output)
    try:
        with output.open("x", encoding="utf-8") as file:
            file.write(made.text)
    except OSError as error:
        raise InputError(f"{output} cannot be written: {error.strerror}") from None
    return made


def _of_tables(description: Description, causality: str) -> list[str]:
    """Return the variables of one causality that the column of a table can stand for."""
    return [
        variable.name
        for variable in description.with_causality(causality)
        if variable.type in NUMBERS and variable.variability in ("continuous", "discrete")
    ]


def _match(names: Sequence[str], columns: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the variables that are columns, and those that are not."""
    there = set(columns)
    return tuple(n for n in names if n in there), tuple(n for n in names if n not in there)


def _numerics(description: Description) -> list[str]:
    """Return the words on how the FMU is run, commented out, as far as its interfaces have use for them."""
    from fmuid.studies.model import NumericsWords

    words = ["interface"] if len(description.interfaces) > 1 else []
    words += ["integrator"] if "model-exchange" in description.interfaces else []
    return [NumericsWords.example_line(word) for word in (*words, "tolerance", "step_size")]


def _rest() -> list[str]:
    """Return what does not depend on FMU and table; the tables that few studies need are commented out."""
    from fmuid.studies.parameters import JointPriorWords
    from fmuid.studies.settings import EstimatorWords, NoiseWords, UncertaintyWords

    return [
        *_table(JointPriorWords, "prior", asked=False),
        "",
        *_table(NoiseWords, "noise", asked=True),
        "",
        *_table(EstimatorWords, "estimator", asked=True),
        "",
        *_table(UncertaintyWords, "uncertainty", asked=False),
    ]


def _table(table: type[Words], name: str, *, asked: bool) -> list[str]:
    """Return those words of a table that have an example; all commented out where it is not asked for."""
    lines = [table.example_line(key) for key, field in table.model_fields.items() if field.examples]
    if asked:
        return [f"[{name}]", *lines]
    meaning = (table.__doc__ or "").rstrip(".")
    return [f"# [{name}]  # {meaning[0].lower()}{meaning[1:]}", *(f"# {line.removeprefix('# ')}" for line in lines)]


def _roles(word: str, matched: Sequence[str], missing: Sequence[str]) -> list[str]:
    lines = [_names(word, matched)]
    if missing:
        lines.append(f"# {word} of the FMU that are no column: {_listed(missing)}")
    return lines


def _names(word: str, names: Sequence[str]) -> str:
    """Return a list of names, on several lines where it is long."""
    lines = [f"{word} = ["]
    for name in names:
        item = _text(name) + ", "
        if len(lines[-1] + item) > LINE_LENGTH:
            lines.append("    ")
        lines[-1] += item
    if len(lines) == 1:
        return lines[0].removesuffix(", ") + "]"
    return "\n".join([*(line.rstrip() for line in lines), "]"])


def _listed(names: Sequence[str]) -> str:
    rest = len(names) - NAMES_LISTED
    return ", ".join(names[:NAMES_LISTED]) + (f" and {rest} more" if rest > 0 else "")


def _free(description: Description) -> list[Variable]:
    """Return all that can be identified: Real parameters, then other variables whose start values can be set."""
    settable = [
        variable
        for variable in description.variables.values()
        if variable.type == "Real" and variable.settable and variable.causality not in ("input", "structuralParameter")
    ]
    return sorted(settable, key=lambda variable: variable.causality != "parameter")


def _parameters(description: Description) -> list[str]:
    """Return the table of parameters, all of them commented out."""
    free = _free(description)
    lines = [
        "# Start, min, max and unit are the FMU's. Further keys: nominal = 1.0 (size, needed where the start is 0),",
        '# prior = { mean = 1.0, std = 0.1 } or { result = "healthy/result.json", inflate = 10 },',
        "# per_experiment = true (one value for each experiment).",
        "[parameters]",
    ]
    lines += [_parameter(variable) for variable in free if variable.causality == "parameter"]
    starts = [variable for variable in free if variable.causality != "parameter"]
    if starts:
        lines += ["# start values of variables:", *(_parameter(variable) for variable in starts)]
    return lines


def _parameter(variable: Variable) -> str:
    """Return the commented line of one parameter."""
    start = float(variable.start) if isinstance(variable.start, int | float) else 0.0
    keys = {"start": start}
    for word in ("min", "max"):
        bound = getattr(variable, word)
        # a bound that the FMU's own start breaks would only be refused
        if bound is not None and abs(bound) < NO_BOUND and (start >= bound if word == "min" else start <= bound):
            keys[word] = bound
    if "min" in keys and keys["min"] == keys.get("max"):
        del keys["min"], keys["max"]
    if start == 0:
        keys["nominal"] = abs(variable.nominal or 1.0)
    given = ", ".join(f"{key} = {value!r}" for key, value in keys.items())
    unit = variable.unit if variable.unit not in (None, "1") else ""
    remark = shorten(": ".join(part for part in (unit, variable.description) if part), REMARK_LENGTH, placeholder="…")
    return f"# {_key(variable.name)} = {{ {given} }}" + (f"  # {remark}" if remark else "")


def _relative(path: Path, output: Path) -> str:
    try:
        return Path(os.path.relpath(path.resolve(), output.resolve().parent)).as_posix()
    except ValueError:  # another drive
        return path.resolve().as_posix()


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)
