"""A first study file for an FMU and tables, with everything in it that they say of themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from fmuid.errors import InputError
from fmuid.files import exists
from fmuid.formatting import two_digits
from fmuid.studies.init.data_file import InitOptions, MatchedDataFile
from fmuid.studies.init.lines import (
    example,
    free,
    inline,
    listed,
    numerics,
    parameter,
    parameter_line,
    relative,
    rest,
    role,
    text,
)
from fmuid.studies.init.parameter_survey import (
    FREE,
    SHOWN_CHANGE,
    Candidate,
    ParameterProposal,
    Survey,
    bounds,
    is_solver_setting,
    proposal,
    survey,
)

if TYPE_CHECKING:
    from fmuid.models import Description


@dataclass(frozen=True)
class Draft:
    """A study file to begin with, and what could not be matched.

    Attributes
    ----------
    text : str
        The file.
    records : tuple of MatchedDataFile
        The tables, and what their columns are taken for.
    survey : Survey
        What the parameters change; empty where the tables cannot be simulated and compared yet.
    """

    text: str
    records: tuple[MatchedDataFile, ...]
    survey: Survey = field(default_factory=Survey)

    @property
    def runs(self) -> bool:
        """Whether the study can be identified as it is."""
        return bool(self.survey.freed)


def match_data_files(
    fmu: Path, tables: Sequence[Path], asked: InitOptions | None = None
) -> tuple[MatchedDataFile, ...]:
    """Read an FMU's description and tables, and guess which columns are which variables.

    Raises
    ------
    InputError
        If a file cannot be read, or something asked for is not there.
    """
    from fmuid.models import read_description

    description = read_description(fmu)
    records = tuple(MatchedDataFile.read(table, description, asked or InitOptions()) for table in tables)
    for record in records:
        _ = record.links, record.settings  # checks what is given
    return records


def draft(fmu: Path, records: Sequence[MatchedDataFile], output: Path) -> Draft:
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
        f"# Look at what is free below [parameters] (without # before it), and run: fmuid identify {output.name}",
        "",
        f"title = {text(description.model_name)}",
        "",
        "[model]",
        f"fmu = {text(relative(fmu, output))}  # paths are relative to this file",
        *numerics(description),
        "",
        "[model.fixed]  # parameters held at another value than the FMU's own: name = value",
        "",
    ]
    stems = [record.path.stem for record in records]
    for k, record in enumerate(records):
        again = stems[:k].count(stems[k])
        lines += [*_experiment(record, output, f"{stems[k]} {again + 1}" if again else "", first=k == 0), ""]
    found = (
        survey(fmu, [each for record in records if (each := record.experiment) is not None])
        if _ready(records)
        else Survey()
    )
    lines += [*_parameters(description, found, len(records)), "", *rest()]
    return Draft("\n".join(lines) + "\n", tuple(records), found)


def _ready(records: Sequence[MatchedDataFile]) -> bool:
    return all(record.experiment is not None and not record.lacking("input") for record in records)


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


def _experiment(record: MatchedDataFile, output: Path, name: str, *, first: bool) -> list[str]:
    """Return the table of one experiment, with a name where its own is another's too."""
    from fmuid.studies.model import ExperimentSettings

    asked = record.asked
    said = {"time_unit": asked.time_unit, "sample_rate": asked.sample_rate, "sheet": asked.sheet}
    return [
        "[[experiments]]" + ("  # repeat this table for further experiments" if first else ""),
        f"data = {text(relative(record.path, output))}",
        *([f"name = {text(name)}"] if name else []),
        f"time = {text(asked.time)}" + ("  # or what the table calls so: Time (ms), t, timestamp" if first else ""),
        *(f"{word} = {text(value)}" for word, value in said.items() if value is not None),
        *_role(record, "input"),
        *_role(record, "output"),
        *([f"# columns that are no input or output of the FMU: {listed(record.unused)}"] if record.unused else []),
        *([f"units = {inline(asked.units)}"] if asked.units else []),
        *([f"preprocess = {inline(asked.prepare)}"] if asked.prepare else []),
        *(['# where a column has another name: outputs = { fmu_variable = "column" }'] if first else []),
        _interpolation(record),
        example(ExperimentSettings, "experiments", "warmup"),
    ]


def _interpolation(record: MatchedDataFile) -> str:
    """Return the line on how inputs go between samples."""
    from fmuid.studies.model import ExperimentSettings

    found = record.interpolation
    if found == "linear":
        return example(ExperimentSettings, "experiments", "interpolation")
    said = text(found) if isinstance(found, str) else role("", found).removeprefix(" = ")
    return f'interpolation = {said}  # guessed: over most samples it stays what it was; "linear" for what is measured'


def _role(record: MatchedDataFile, which: str) -> list[str]:
    """Return inputs or outputs, with what of them is a guess and what is missing."""
    lines = [role(f"{which}s", record.roles(which))]
    guessed = [link.variable for link in record.links if link.role == which and link.column and not link.sure]
    if guessed:
        lines[0] += f"  # guessed: {listed(guessed)}"
    lacking = record.lacking(which)
    if lacking:
        lines.append(f"# {which}s of the FMU that are no column: {listed(lacking)}")
    return lines


def _parameters(description: Description, found: Survey, experiments: int) -> list[str]:
    """Return the table of parameters: those that are proposed, and all others commented out."""
    lines = [
        "# Start, min, max and unit are the FMU's. Further keys: nominal = 1.0 (size, needed where the start is 0),",
        '# prior = { mean = 1.0, std = 0.1 } or { result = "healthy/result.json", std_factor = 10 },',
        "# per_experiment = true (one value for each experiment).",
    ]
    if found.candidates:
        lines += [
            f"# The percentage is what {100 * SHOWN_CHANGE:g} % of a parameter change of the outputs, in terms of",
            "# their spread, at the FMU's values; of its nominal where it is 0. A min of 0 that is not the FMU's is",
            "# the sign of its value.",
        ]
    lines.append("[parameters]")
    lines += [_candidate(each, experiments) for each in found.candidates]
    if found.candidates:
        states = {name for name in description.states if name not in found.names}
        others = [v for v in free(description) if v.name not in found.names | states and not is_solver_setting(v)]
        others = [v for v in others if v.causality == "parameter"]
        return lines + (["# not looked at:"] if others else []) + ["# " + parameter(v) for v in others]
    others = [v for v in free(description) if not is_solver_setting(v)]
    lines += ["# " + parameter(variable) for variable in others if variable.causality == "parameter"]
    starts = [variable for variable in others if variable.causality != "parameter"]
    if starts:
        lines += ["# start values of variables:", *("# " + parameter(variable) for variable in starts)]
    return lines


def _candidate(given: Candidate, experiments: int) -> str:
    """Return the line of a parameter that was looked at."""
    said = [f"{two_digits(100 * given.effect)} %"] if given.effect else []
    said += [proposal(given)] if given.use is not ParameterProposal.FREED else []
    more = (
        "per_experiment = true"
        if given.use in (ParameterProposal.START_FREED, ParameterProposal.START_OPEN) and experiments > 1
        else ""
    )
    line = parameter_line(given.variable, given.start, bounds(given), more, "; ".join(said))
    return line if given.use in FREE else "# " + line
