"""A first study file for an FMU and a table, with everything in it that the two say of themselves."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fmuid.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from fmuid.fmi.description import Description, Variable

# The names that tables give their time column, in the order in which they are looked for.
TIME_COLUMNS = ("time", "Time", "t", "TIME", "T")


# What does not depend on FMU and table; the words that few studies need are commented out.
_REST = """
# [prior]  # what is known of several parameters together, here from an earlier result
# result = "healthy/result.json"
# inflate = 10  # factor on its standard deviations, for changes to be expected
# names = ["a", "b"]  # default: all parameters that it shares with this study; or names, mean and covariance

[noise]
variance = "estimate"  # or a number, or one for each output: { output = number }
# start = 0.01  # where the estimation of the variance starts; default: from the residual

[estimator]
method = "marquardt"  # or "global": search all of the bounds first
# starts = 50  # with method = "global": a search from each of so many starts; without it, an evolution
# loss = "soft_l1"  # or "huber", "cauchy": outliers in the table pull less than with "linear"
sensitivity = "finite-difference"

# [uncertainty]  # more than the standard deviations, which are local
# level = 0.95
# profile = true  # profile likelihood of all parameters, or of some: ["a", "b"]
# posterior = true  # samples of the posterior; or { steps = 20000, walkers = 32, seed = 0 }
# map = [["a", "b"]]  # the criterion over two parameters
""".strip().splitlines()


@dataclass(frozen=True)
class Draft:
    """A study file to begin with, and what could not be matched.

    Attributes
    ----------
    text : str
        The file.
    inputs, outputs : tuple of str
        Variables of the FMU that are columns of the table too.
    missing_inputs, missing_outputs : tuple of str
        Those that are not.
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
    from fmuid.fmi.description import read_description

    description = read_description(fmu)
    frame, time = _read(table)
    columns = [str(column) for column in frame.columns if column != time]
    inputs, missing_inputs = _match(description, "input", columns)
    outputs, missing_outputs = _match(description, "output", columns)
    unused = tuple(column for column in columns if column not in (*inputs, *outputs))
    lines = [
        f"# A study of {description.model_name}, begun by `fmuid init`.",
        f"# Remove the # before each parameter to identify, below [parameters], and run: fmuid identify {output.name}",
        "",
        f"title = {_text(description.model_name)}",
        "",
        "[model]",
        f"fmu = {_text(_relative(fmu, output))}  # paths are relative to this file",
        "# step_size = 1e-3  # largest internal step, s; default: from sample to sample",
        "",
        "[model.values]  # parameters held at another value than the FMU's own: name = value",
        "",
        "[[experiments]]  # repeat this table for further experiments",
        f"table = {_text(_relative(table, output))}",
        f"time = {_text(time)}",
        *_roles("inputs", inputs, missing_inputs),
        *_roles("outputs", outputs, missing_outputs),
        *([f"# columns that are no input or output of the FMU: {', '.join(unused)}"] if unused else []),
        '# where a column has another name: outputs = { fmu_variable = "column" }',
        'interpolation = "linear"  # between samples; "hold" for commands of a digital controller',
        "discard = 0.0  # s of transient at the beginning, simulated but not counted",
        "",
        *_parameters(description),
        "",
        *_REST,
    ]
    return Draft("\n".join(lines) + "\n", inputs, outputs, missing_inputs, missing_outputs, unused)


def write_draft(fmu: Path, table: Path, output: Path) -> Draft:
    """Write the study file that `draft` makes up.

    Raises
    ------
    InputError
        If a file of that name is there already, or `draft` refuses.
    """
    if output.exists():
        raise InputError(f"{output} is there already: choose another name with --output, or remove it")
    made = draft(fmu, table, output)
    try:
        with output.open("x", encoding="utf-8") as file:
            file.write(made.text)
    except OSError as error:
        raise InputError(f"{output} cannot be written: {error.strerror}") from None
    return made


def _read(table: Path) -> tuple[pd.DataFrame, str]:
    """Return the table and the name of its time column."""
    from fmuid.tables import read_table

    refusal: InputError | None = None
    for time in TIME_COLUMNS:
        try:
            return read_table(table, time), time
        except InputError as error:
            refusal = refusal or error
    assert refusal is not None
    raise refusal


def _match(description: Description, causality: str, columns: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the variables of one causality that are columns, and those that are not."""
    names = [variable.name for variable in description.with_causality(causality)]
    return tuple(n for n in names if n in columns), tuple(n for n in names if n not in columns)


def _roles(word: str, matched: Iterable[str], missing: Sequence[str]) -> list[str]:
    lines = [f"{word} = [{', '.join(_text(name) for name in matched)}]"]
    if missing:
        lines.append(f"# {word} of the FMU that are no column: {', '.join(missing)}")
    return lines


def _parameters(description: Description) -> list[str]:
    """Return the table of parameters, all of them commented out."""
    settable = [v for v in description.variables.values() if v.type == "Real" and v.settable and v.causality != "input"]
    lines = [
        "# Start, min, max and unit are the FMU's. Further keys: nominal = 1.0 (size, needed where the start is 0),",
        '# prior = { mean = 1.0, std = 0.1 } or { result = "healthy/result.json", inflate = 10 },',
        "# per_experiment = true (one value for each experiment).",
        "[parameters]",
    ]
    lines += [_parameter(variable) for variable in settable if variable.causality == "parameter"]
    states = [variable for variable in settable if variable.causality != "parameter"]
    if states:
        lines += ["# start values of variables:", *(_parameter(variable) for variable in states)]
    return lines


def _parameter(variable: Variable) -> str:
    """Return the commented line of one parameter."""
    start = variable.start if isinstance(variable.start, int | float) else 0.0
    keys = {"start": float(start), "min": variable.min, "max": variable.max}
    if start == 0:
        keys["nominal"] = variable.nominal or 1.0
    given = ", ".join(f"{key} = {value!r}" for key, value in keys.items() if value is not None and math.isfinite(value))
    unit = variable.unit if variable.unit not in (None, "1") else ""
    remark = ": ".join(part for part in (unit, " ".join(variable.description.split())) if part)
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
