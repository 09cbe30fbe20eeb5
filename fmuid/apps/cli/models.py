"""The commands about models: parse, call, print."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, FmuFile

if TYPE_CHECKING:
    from fmuid.reports import AppliedValue


def info(fmu: FmuFile) -> int:
    """Show what an FMU declares: capabilities, parameters, inputs, outputs, units; with a study to begin with."""
    from fmuid.models import FMU, facts, uncollected
    from fmuid.reports.console.fmu import show_facts

    with uncollected():
        show_facts(facts(FMU(fmu)))
    return DONE


def validate(fmu: FmuFile) -> int:
    """Check an FMU: its description by FMPy, its binaries, and a short simulation of each interface."""
    from fmuid.models import FMU
    from fmuid.reports.console.fmu import show_binaries, show_validation
    from fmuid.simulation import check_binaries, validate

    model = FMU(fmu)
    show_binaries(list(check_binaries(model).values()))  # at once: FMPy takes its time for a large description
    found = validate(model)
    show_validation(found)
    return DONE if found.passed else NOT_SUCCEEDED


def init(
    fmu: FmuFile,
    tables: Annotated[
        list[Path], typer.Argument(metavar="TABLE", help="The tables, one an experiment.", show_default=False)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The study file to write.")] = Path(
        "study.toml"
    ),
    map_: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="VARIABLE=COLUMN", help="Which column a variable of the FMU is; repeatable."),
    ] = None,
    time: Annotated[str, typer.Option(metavar="COLUMN", help="The column of time, or its place from 1.")] = "time",
    time_unit: Annotated[
        str | None, typer.Option(metavar="UNIT", help="s, ms, us, ns, min, h or d; default: what the table says.")
    ] = None,
    sample_rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Samples per second, of a table without times.")
    ] = None,
    sheet: Annotated[str | None, typer.Option(metavar="SHEET", help="Of a spreadsheet, or its place from 1.")] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(metavar="VARIABLE=UNIT", help="The unit of a variable's column, 1 for the FMU's; repeatable."),
    ] = None,
    prepare: Annotated[
        list[str] | None,
        typer.Option(metavar="WORD=VALUE", help="Done with the tables first, such as low_pass=100; repeatable."),
    ] = None,
) -> int:
    """Write a commented study file for an FMU and tables, to start from; in a terminal it asks what is in doubt."""
    from fmuid.reports.console.draft import asked_about, show_draft
    from fmuid.studies import Asked, begin, check_output, draft, placed, value_of, write_draft

    check_output(output)
    columns = _pairs(map_ or (), "--map", "variable=column", "ids=Id_meas")
    words = _pairs(prepare or (), "--prepare", "word=value", "low_pass=100")
    asked = Asked(
        placed(time),
        time_unit,
        sample_rate,
        None if sheet is None else placed(sheet),
        columns,
        {word: value_of(text) for word, text in words.items()},
        _pairs(unit or (), "--unit", "variable=unit", "w=rpm"),
    )
    records = [asked_about(record) for record in begin(fmu, tables, asked)]
    made = draft(fmu, records, output)
    write_draft(made, output)
    show_draft(made, output)
    return DONE if made.runs else NOT_SUCCEEDED


def _pairs(given: Sequence[str], option: str, form: str, example: str) -> dict[str, str]:
    """Return what an option that may be repeated gives."""
    from fmuid.errors import InputError

    found = {}
    for each in given:
        name, equals, text = (part.strip() for part in each.partition("="))
        if not equals or not name:
            raise InputError(f"{option} {each}: write {option} {form}, such as {option} {example}")
        found[name] = text
    return found


def schema() -> int:
    """Print the JSON schema of study files, with which editors complete and check them."""
    from fmuid.studies import schema_text

    print(schema_text())
    return DONE


def apply(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT", help="A result.json, the folder that has it, or an .ssv file.", show_default=False
        ),
    ],
    fmu: FmuFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="NEW.fmu", help="The FMU to write.")],
    component: Annotated[
        str | None, typer.Option("--component", metavar="NAME", help="Which component of a system the FMU is.")
    ] = None,
) -> int:
    """Write identified values as the start values of a copy of an FMU."""
    from fmuid.reports import apply_result
    from fmuid.reports.console import layout as console

    _show_applied(apply_result(result, fmu, output, component))
    console.show_files([output])
    return DONE


def _show_applied(applied: Sequence[AppliedValue]) -> None:
    from fmuid.formatting import rounded, unit_text
    from fmuid.reports.console import layout as console

    numbers = ("old start", "new start", "std")
    rows = []
    for each in applied:
        old, known = each.old, math.isfinite(each.std)
        new = rounded(each.new, each.std) if isinstance(each.new, float) else str(each.new)
        cells = ["" if old is None else f"{old:.6g}" if isinstance(old, float) else str(old), new]
        cells += [rounded(each.std, each.std) if known else "", unit_text(each.unit)]
        rows.append((each.variable, *cells))
    heads = ("variable", *numbers, "unit")
    console.console().print(console.table_of_rows("Start values", heads, rows, right=numbers))


def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL.mo", help="The Modelica file.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="The FMU to write; default: beside the model.")
    ] = None,
    fmi: Annotated[str, typer.Option("--fmi", metavar="VERSION", help="The version of FMI, 2.0 or 3.0.")] = "2.0",
    sensitivities: Annotated[
        str,
        typer.Option(
            "--sensitivities", metavar="P,...", help="Also output the derivatives to these parameters, or to 'all'."
        ),
    ] = "",
) -> int:
    """Export a Modelica model as an FMU (needs the extra 'export' of the package)."""
    from fmuid.errors import ModelicaWarning
    from fmuid.export import export_fmu
    from fmuid.reports.console import layout as console

    names = [name.strip() for name in sensitivities.split(",")] if sensitivities else []
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always", ModelicaWarning)
        fmu = export_fmu(model, output, fmi=fmi, sensitivities="all" if names == ["all"] else names)
    console.show_remarks(str(each.message) for each in remarks)
    console.show_files([fmu])
    return DONE
