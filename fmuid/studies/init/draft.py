"""First study file, drafted from an FMU and data files."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from fmuid.errors import InputError
from fmuid.files import exists, is_file, relative
from fmuid.formatting import two_digits
from fmuid.identification import nameplate_prior
from fmuid.models import Description, System, read_description
from fmuid.studies.init.data_file import InitOptions, MatchedDataFile
from fmuid.studies.init.lines import (
    declared_bounds,
    example,
    free,
    listed,
    numerics,
    parameter,
    parameter_line,
    rest,
    role,
)  # fmt: skip
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
)  # fmt: skip
from fmuid.studies.model import ExperimentSettings
from fmuid.studies.nameplate import nameplate_of, nameplate_offer
from fmuid.studies.toml import toml_text


@dataclass(frozen=True)
class Draft:
    """Study file with its data files and the parameter survey."""

    text: str
    records: tuple[MatchedDataFile, ...]
    survey: Survey = field(default_factory=Survey)

    @property
    def runs(self) -> bool:
        """Whether the study has free parameters."""
        return bool(self.survey.freed)


def match_data_files(
    fmu: Path, tables: Sequence[Path], asked: InitOptions | None = None
) -> tuple[MatchedDataFile, ...]:
    """Read data files, and match their columns with FMU variables."""
    description = read_description(fmu)
    terminals, given = is_file(fmu.with_suffix(".nameplate.toml")), asked or InitOptions()
    records = tuple(MatchedDataFile.read(table, description, given, terminals=terminals) for table in tables)
    for record in records:
        _ = record.links, record.settings  # checks what is given
    return records


def draft(fmu: Path, records: Sequence[MatchedDataFile], output: Path, plate: Mapping[str, str] | None = None) -> Draft:
    """Return a study for an FMU and data files; paths are relative to `output`.

    With numbers of a nameplate, the parameters that it gives start there.
    """
    known = None if not plate else nameplate_prior(System.of(fmu), nameplate_of(plate))
    description = records[0].description
    ready = [each.experiment for each in records if each.is_ready and each.experiment is not None]
    found = survey(fmu, ready) if len(ready) == len(records) else Survey()
    lines = [
        f"# Study of {description.model_name}, written by `fmuid init`.",
        f"# Check the free parameters below [parameters], then run: fmuid identify {output.name}",
        "",
        f"title = {toml_text(description.model_name)}",
        *(['prior = "nameplate"'] if known is not None else nameplate_offer(fmu)),
        "",
        "[model]",
        f"fmu = {toml_text(relative(fmu, output.parent))}  # paths are relative to this file",
        *numerics(description, lags=found.lags),
        "",
        "[model.fixed]  # fixed parameters that differ from the FMU: name = value",
        "",
    ]
    stems = [record.path.stem for record in records]
    for k, record in enumerate(records):
        again = stems[:k].count(stems[k])
        lines += [*_experiment(record, output, f"{stems[k]} {again + 1}" if again else "", first=k == 0), ""]
    starts: dict[str, tuple[float, float]] = {}
    if known is not None:
        starts = dict(zip(known.names, zip(known.mean.tolist(), known.std, strict=True), strict=True))
    lines += [*_parameters(description, found, len(records), starts), "", *rest(starts)]
    if plate:
        lines += ["", "[nameplate]", *(f"{key} = {toml_text(text)}" for key, text in plate.items())]
    return Draft("\n".join(lines) + "\n", tuple(records), found)


def write_draft(made: Draft, output: Path, *, force: bool = False) -> None:
    """Write the study file; it replaces one that `init` wrote and nobody changed, others with `force`."""
    check_output(output, force=force)
    head, _, body = made.text.partition("\n")
    try:
        output.write_text(f"{head} [{_digest(body)}]\n{body}", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{output}: cannot be written: {error.strerror}.") from None


def check_output(output: Path, *, force: bool = False) -> None:
    """Check that a study file can be written."""
    if not output.parent.is_dir():
        raise InputError(f"{output}: its folder does not exist. Create it, or choose another with --output.")
    if exists(output) and not force and not _is_untouched(output):
        raise InputError(f"{output}: file exists. Choose another name with --output, or replace it with --force.")
    try:
        with output.open("a", encoding="utf-8") as file:
            is_new = file.tell() == 0
    except OSError as error:
        raise InputError(f"{output}: cannot be written: {error.strerror}.") from None
    if is_new:
        output.unlink()


def _digest(body: str) -> str:
    return f"{zlib.crc32(body.encode()):08x}"


def _is_untouched(path: Path) -> bool:
    """Return True if a file is as `write_draft` left it."""
    with suppress(OSError, UnicodeDecodeError):
        head, _, body = path.read_text(encoding="utf-8").partition("\n")
        return head.endswith(f" [{_digest(body)}]")
    return False


def _experiment(record: MatchedDataFile, output: Path, name: str, *, first: bool) -> list[str]:
    asked = record.asked
    clock = "  # or the name of the time column: Time (ms), t, timestamp" if first else ""
    guessed = "" if record.units == asked.units else "  # guessed from names of columns"
    said = {"time_unit": asked.time_unit, "sample_rate": asked.sample_rate, "sheet": asked.sheet}
    said |= {"model_time_unit": None if asked.model_time_unit == "s" else asked.model_time_unit}
    return [
        "[[experiments]]" + ("  # repeat this section for each experiment" if first else ""),
        f"data = {toml_text(relative(record.path, output.parent))}",
        *([f"name = {toml_text(name)}"] if name else []),
        f"time = {toml_text(asked.time)}{clock}" if record.in_time else f"kind = {toml_text(asked.kind)}",
        *(f"{word} = {toml_text(value)}" for word, value in said.items() if value is not None),
        *(_role(record, "input") if not record.of_rows else []),
        *(_role(record, "output") if asked.kind != "frequency" else []),
        *(f"{word} = {toml_text(value)}  # guessed: check" for word, value in record.of_rows.items()),
        *([f"# unused columns: {listed(record.unused)}"] if record.unused else []),
        *([f"missing = {toml_text([*asked.missing])}  # taken for marks of missing samples"] if asked.missing else []),
        *([f"units = {toml_text(record.units)}{guessed}"] if record.units else []),
        *([f"preprocess = {toml_text(asked.prepare)}"] if asked.prepare else []),
        *(['# for other column names: outputs = { fmu_variable = "column" }'] if first and record.in_time else []),
        *([_interpolation(record), example(ExperimentSettings, "warmup")] if record.in_time else []),
    ]


def _interpolation(record: MatchedDataFile) -> str:
    found = record.interpolation
    if found == "linear":
        return example(ExperimentSettings, "interpolation")
    said = toml_text(found) if isinstance(found, str) else role("", found).removeprefix(" = ")
    return f'interpolation = {said}  # guessed from constant stretches; "linear" for measured inputs'


def _role(record: MatchedDataFile, which: str) -> list[str]:
    lines = [role(f"{which}s", record.roles(which))]
    guessed = [link.variable for link in record.links if link.role == which and link.column and not link.sure]
    if guessed:
        lines[0] += f"  # guessed: {listed(guessed)}"
    lacking = record.lacking(which)
    if lacking:
        lines.append(f"# {which}s without column: {listed(lacking)}")
    return lines


def _parameters(
    description: Description, found: Survey, experiments: int, starts: Mapping[str, tuple[float, float]]
) -> list[str]:
    lines = [
        "# start, min, max and unit come from the FMU. Further keys: nominal = 1.0 (scale, required if start is 0),",
        '# prior = { mean = 1.0, std = 0.1 } or { result = "healthy/result.json", std_factor = 10 },',
        "# per_experiment = true (one value per experiment).",
    ]
    if found.candidates:
        lines += [
            f"# Percentages: change of the outputs, relative to their spread, for {100 * SHOWN_CHANGE:g} % more of a",
            "# parameter (of nominal if start is 0). A min or max of 0 keeps the sign of start.",
        ]
    lines += ["[parameters]"]
    for name, (mean, std) in starts.items():
        variable, start = description.variables[name], float(f"{mean:.4g}")
        said = f"nameplate: {mean:.4g} ± {std:.2g}"
        lines.append(parameter_line(variable, start, declared_bounds(variable, start), said=said))
    candidates = [each for each in found.candidates if each.variable.name not in starts]
    lines += [_candidate(each, experiments) for each in candidates]
    looked_at = {each.variable.name for each in found.candidates} | set(starts)
    others = [v for v in free(description) if v.name not in looked_at and not is_solver_setting(v)]
    fixed = ["# " + parameter(v) for v in others if v.causality == "parameter"]
    if found.candidates:
        return lines + (["# not examined:"] if fixed else []) + fixed
    initial = ["# " + parameter(v) for v in others if v.causality != "parameter"]
    return [*lines, *fixed, *(["# start values of variables:"] if initial else []), *initial]


def _candidate(given: Candidate, experiments: int) -> str:
    said = [f"{two_digits(100 * given.effect)} %"] if given.effect else []
    said += [proposal(given)] if given.use is not ParameterProposal.FREED else []
    begins = given.use in (ParameterProposal.START_FREED, ParameterProposal.START_OPEN)
    more = "per_experiment = true" if begins and experiments > 1 else ""
    line = parameter_line(given.variable, given.start, bounds(given), more, "; ".join(said))
    return line if given.use in FREE else "# " + line
