"""The commands about models."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from fmuid import errors, models, runs, simulation, studies
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, FmuFile, showing_findings
from fmuid.reports import render, topics


@showing_findings
def info(fmu: FmuFile) -> int:
    """Show variables and units of an FMU, with a first study."""
    with models.uncollected():
        width = render.console.console().width if render.console.console().is_terminal else None
        more = "[bold]A first study[/] [dim](fmuid init FMU DATA writes a longer one)[/]"
        render.show_listing(topics.facts_document(models.facts(models.FMU(fmu)), width), more)
    return DONE


@showing_findings
def validate(fmu: FmuFile) -> int:
    """Check an FMU: description, binaries, and a short simulation of each interface."""
    model = models.FMU(fmu)
    notes = topics.binary_notes(list(simulation.check_binaries(model).values()))
    render.show_notes(notes)  # before FMPy checks a large description
    found = simulation.validate(model)
    render.show(topics.validation_document(found, terminal=render.console.console().is_terminal))
    return DONE if found.passed else NOT_SUCCEEDED


def init(
    fmu: FmuFile,
    data: Annotated[list[Path], Argument(metavar="DATA", help="Data files, one per experiment.", show_default=False)],
    output: Annotated[Path, Option("--output", "-o", metavar="FILE", help="Study file to write.")] = Path("study.toml"),
    map_: Annotated[
        list[str] | None,
        Option("--map", metavar="VARIABLE=COLUMN", help="Column of a variable of the FMU; repeatable."),
    ] = None,
    time: Annotated[str, Option(metavar="COLUMN", help="Time column, by name or place from 1.")] = "time",
    time_unit: Annotated[
        str | None, Option(metavar="UNIT", help="s, ms, us, ns, min, h or d (default: as the file says).")
    ] = None,
    model_time_unit: Annotated[str, Option(metavar="UNIT", help="Unit in which the FMU counts time.")] = "s",
    sample_rate: Annotated[
        float | None, Option(metavar="HZ", help="Samples per second, for data without times.")
    ] = None,
    sheet: Annotated[
        str | None, Option(metavar="SHEET", help="Sheet, or frame of an HDF5 file; name or place from 1.")
    ] = None,
    unit: Annotated[
        list[str] | None,
        Option(metavar="VARIABLE=UNIT", help="Unit of a variable's column, 1 for the FMU's; repeatable."),
    ] = None,
    preprocess: Annotated[
        list[str] | None,
        Option(metavar="KEY=VALUE", help="Preprocessing of the data, e.g. lowpass_frequency=100; repeatable."),
    ] = None,
    nameplate: Annotated[
        list[str] | None, Option(metavar="KEY=VALUE", help="Number of the nameplate, e.g. 'P=1.1 kW'; repeatable.")
    ] = None,
    kind: Annotated[
        str, Option(metavar="KIND", help="time; or steady or frequency, for rows without a time.")
    ] = "time",
    force: Annotated[bool, Option("--force", help="Replace a study file that was edited.")] = False,
    preview: Annotated[bool, Option("--preview", help="Show how the data are read, and write nothing.")] = False,
) -> int:
    """Write a first study file for an FMU and data; a terminal is asked in doubt."""
    if not preview:
        studies.check_output(output, force=force)
    columns = _pairs(map_ or (), "--map", "variable=column", "ids=Id_meas")
    words = _pairs(preprocess or (), "--preprocess", "key=value", "lowpass_frequency=100")
    asked = studies.InitOptions(
        studies.parse_column(time),
        time_unit,
        sample_rate,
        None if sheet is None else studies.parse_column(sheet),
        columns,
        {word: studies.value_of(text) for word, text in words.items()},
        _pairs(unit or (), "--unit", "variable=unit", "w=rpm"),
        kind=kind,
        model_time_unit=model_time_unit,
    )
    found = studies.match_data_files(fmu, data, asked)
    if preview:
        for record in found:
            render.show_section(topics.record_section(record))
            render.show_section(topics.rows_section(record))
        return DONE if all(record.is_ready for record in found) else NOT_SUCCEEDED
    records = [topics.asked_about(record) for record in found]
    made = studies.draft(fmu, records, output, _pairs(nameplate or (), "--nameplate", "key=value", "'P=1.1 kW'"))
    studies.write_draft(made, output, force=force)
    render.show(topics.draft_document(made, output))
    return DONE if made.runs else NOT_SUCCEEDED


def _pairs(given: Sequence[str], option: str, form: str, example: str) -> dict[str, str]:
    """Return the names and values of a repeatable option."""
    found = {}
    for each in given:
        name, equals, text = (part.strip() for part in each.partition("="))
        if not equals or not name:
            raise errors.InputError(
                f"{option} {each}: no value. Write {option} {form}, for example {option} {example}."
            )
        found[name] = text
    return found


def schema(
    of: Annotated[
        str, Argument(metavar="[FILE]", help="'study', or 'result': result.json.", show_default=False)
    ] = "study",
) -> int:
    """Print the JSON schema of study files or of result.json."""
    if of == "result":
        print(runs.result_schema_text())
        return DONE
    if of != "study":
        raise errors.InputError(f"{of}: no such schema. Choose study or result.")
    print(studies.schema_text())
    return DONE


def export(
    model: Annotated[Path, Argument(metavar="MODEL.mo", help="Modelica file.", show_default=False)],
    output: Annotated[
        Path | None, Option("--output", "-o", metavar="FILE", help="FMU to write (default: beside the model).")
    ] = None,
    fmi: Annotated[str, Option(metavar="VERSION", help="FMI version, 2.0 or 3.0.")] = "2.0",
    sensitivities: Annotated[
        str, Option(metavar="P,...", help="Also output derivatives to these parameters, or to 'all'.")
    ] = "",
) -> int:
    """Export a Modelica model as an FMU (needs the extra 'export')."""
    from fmuid import export as exporting
    from fmuid.reports.document import Remark

    names = [name.strip() for name in sensitivities.split(",")] if sensitivities else []
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always", errors.ModelicaWarning)
        fmu = exporting.export_fmu(model, output, fmi=fmi, sensitivities="all" if names == ["all"] else names)
    render.show_remarks(Remark(str(each.message), "doubt") for each in remarks)
    render.show_files([fmu])
    return DONE
