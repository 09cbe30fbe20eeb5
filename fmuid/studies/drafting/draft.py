"""A first study file for an FMU and tables, with everything in it that they say of themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fmuid.errors import InputError
from fmuid.files import exists
from fmuid.studies.drafting.lines import free, listed, numerics, parameter, relative, rest, role, text
from fmuid.studies.drafting.record import Asked, Record

if TYPE_CHECKING:
    from fmuid.fmi import Description


@dataclass(frozen=True)
class Draft:
    """A study file to begin with, and what could not be matched.

    Attributes
    ----------
    text : str
        The file.
    records : tuple of Record
        The tables, and what their columns are taken for.
    """

    text: str
    records: tuple[Record, ...]

    @property
    def lacking(self) -> bool:
        """Whether the tables are not yet what can be simulated and compared."""
        return any(record.experiment is None or record.lacking("input") for record in self.records)


def begin(fmu: Path, tables: Sequence[Path], asked: Asked | None = None) -> tuple[Record, ...]:
    """Read an FMU's description and tables, and guess which columns are which variables.

    Raises
    ------
    InputError
        If a file cannot be read, or something asked for is not there.
    """
    from fmuid.fmi import read_description

    description = read_description(fmu)
    records = tuple(Record.read(table, description, asked or Asked()) for table in tables)
    for record in records:
        _ = record.links  # checks what is given
    return records


def draft(fmu: Path, records: Sequence[Record], output: Path) -> Draft:
    """Write down a study of an FMU and tables, without writing the file.

    Parameters
    ----------
    fmu
        The file.
    records
        What `begin` returned.
    output
        Where the study file is to be: its paths are relative to that.
    """
    description = records[0].description
    lines = [
        f"# A study of {description.model_name}, begun by `fmuid init`.",
        f"# Remove the # before each parameter to identify, below [parameters], and run: fmuid identify {output.name}",
        "",
        f"title = {text(description.model_name)}",
        "",
        "[model]",
        f"fmu = {text(relative(fmu, output))}  # paths are relative to this file",
        *numerics(description),
        "",
        "[model.values]  # parameters held at another value than the FMU's own: name = value",
        "",
    ]
    stems = [record.path.stem for record in records]
    for k, record in enumerate(records):
        again = stems[:k].count(stems[k])
        lines += [*_experiment(record, output, f"{stems[k]} {again + 1}" if again else "", first=k == 0), ""]
    lines += [*_parameters(description), "", *rest()]
    return Draft("\n".join(lines) + "\n", tuple(records))


def write_draft(made: Draft, output: Path) -> None:
    """Write the study file that `draft` made up.

    Raises
    ------
    InputError
        If a file of that name is there already, or it cannot be written.
    """
    if exists(output):
        raise InputError(f"{output} is there already: choose another name with --output, or remove it")
    try:
        with output.open("x", encoding="utf-8") as file:
            file.write(made.text)
    except OSError as error:
        raise InputError(f"{output} cannot be written: {error.strerror}") from None


def check_output(output: Path) -> None:
    """Check that a study file can be written, before it is made up.

    Raises
    ------
    InputError
        As `write_draft`.
    """
    write_draft(Draft("", ()), output)
    output.unlink()


def _experiment(record: Record, output: Path, name: str, *, first: bool) -> list[str]:
    """Return the table of one experiment, with a name where its own is another's too."""
    from fmuid.studies.model import ExperimentSettings

    asked = record.asked
    said = {"time_unit": asked.time_unit, "sample_rate": asked.sample_rate, "sheet": asked.sheet}
    return [
        "[[experiments]]" + ("  # repeat this table for further experiments" if first else ""),
        f"table = {text(relative(record.path, output))}",
        *([f"name = {text(name)}"] if name else []),
        f"time = {text(asked.time)}" + ("  # or what the table calls so: Time (ms), t, timestamp" if first else ""),
        *(f"{word} = {text(value)}" for word, value in said.items() if value is not None),
        *_role(record, "input"),
        *_role(record, "output"),
        *([f"# columns that are no input or output of the FMU: {listed(record.unused)}"] if record.unused else []),
        *(['# where a column has another name: outputs = { fmu_variable = "column" }'] if first else []),
        *(ExperimentSettings.example_line(word) for word in ("interpolation", "discard")),
    ]


def _role(record: Record, which: str) -> list[str]:
    """Return inputs or outputs, with what of them is a guess and what is missing."""
    lines = [role(f"{which}s", record.roles(which))]
    guessed = [link.variable for link in record.links if link.role == which and link.column and not link.sure]
    if guessed:
        lines[0] += f"  # guessed: {listed(guessed)}"
    lacking = record.lacking(which)
    if lacking:
        lines.append(f"# {which}s of the FMU that are no column: {listed(lacking)}")
    return lines


def _parameters(description: Description) -> list[str]:
    """Return the table of parameters, all of them commented out."""
    lines = [
        "# Start, min, max and unit are the FMU's. Further keys: nominal = 1.0 (size, needed where the start is 0),",
        '# prior = { mean = 1.0, std = 0.1 } or { result = "healthy/result.json", inflate = 10 },',
        "# per_experiment = true (one value for each experiment).",
        "[parameters]",
    ]
    found = free(description)
    lines += ["# " + parameter(variable) for variable in found if variable.causality == "parameter"]
    starts = [variable for variable in found if variable.causality != "parameter"]
    if starts:
        lines += ["# start values of variables:", *("# " + parameter(variable) for variable in starts)]
    return lines
