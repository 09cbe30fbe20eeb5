"""Estimates for other tools: SSV files and FMUs with new start values."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fmuid.data import is_quantity
from fmuid.errors import InputError
from fmuid.estimation import Grade, Result
from fmuid.files import exists, is_folder, replacing
from fmuid.formatting import nearest
from fmuid.identification import judge
from fmuid.models import (
    DESCRIPTION_FILE,
    FMU,
    CheckedArchive,
    Description,
    Quantity,
    System,
    Unit,
    Value,
    Variable,
    read_ssv,
    unit_conversion,
    with_starts,
    write_ssv,
)
from fmuid.runs.folder import read_model_errors

ESTIMATES_FILE = "parameters.ssv"


@dataclass(frozen=True)
class AppliedValue:
    """A replaced start value, in the unit of the variable.

    `old` is None where there was none, `std` NaN where unknown.
    """

    variable: str
    old: float | int | bool | str | None
    new: float | int | bool
    std: float
    unit: str | None


@dataclass(frozen=True)
class _Estimate:
    """A value to apply: σ from a result, unit from an SSV file."""

    value: Value
    std: float = math.nan
    unit: str | None = None


def write_estimates(folder: Path, system: System, result: Result, corrected: Mapping[str, float]) -> list[Path]:
    """Write ``parameters.ssv`` (SSP 1.0), without undetermined values; return its path in a list."""
    units, values = _units(system), {}
    for name, value, std in zip(result.names, result.values.tolist(), result.std.tolist(), strict=True):
        if name in system.variables and math.isfinite(std) and math.isfinite(value):
            unit = system.variables[name].unit
            said = " ".join(filter(None, (f"standard deviation {std:.3g}", unit)))
            values[name] = Quantity(value, unit, said)
    values |= {name: Quantity(value) for name, value in (*corrected.items(), *result.chosen.items()) if values}
    path = folder / ESTIMATES_FILE
    if not values or not result.converged:
        path.unlink(missing_ok=True)
        return []
    with replacing(path) as draft:
        write_ssv(draft, "estimates", values, units)
    return [path]


def _units(system: System) -> dict[str, Unit]:
    """Return the units with one definition in all FMUs."""
    found: dict[str, Unit] = {}
    clashing = set()
    for component in system.components.values():
        for name, unit in component.fmu.description.units.items():
            known = found.setdefault(name, unit)
            if (known.exponents, known.factor, known.offset) != (unit.exponents, unit.factor, unit.offset):
                clashing.add(name)
    return {name: unit for name, unit in found.items() if name not in clashing}


def apply_result(
    result: Path, fmu: Path, output: Path, component: str | None = None, *, force: bool = False
) -> tuple[AppliedValue, ...]:
    """Write a copy of an FMU with the estimates as start values.

    Only start values and their annotation in the modelDescription.xml differ (`fmuid.models.start_values`): simulators
    must set the start values of the XML. `component` is the FMU's name in a system; `result` may be an ``.ssv`` file.
    `force` applies a result that is not usable.
    """
    model = FMU(fmu)
    estimates, units = _read(result, model.description.model_name, component, force)
    if exists(output) and output.samefile(fmu):
        raise InputError(f"{output}: this is the FMU itself. Choose another name with --output.")
    description = model.description
    applied = []
    for name, estimate in estimates.items():
        variable = _startable(description, name, fmu)
        factor, offset = _conversion(description, variable, estimate.unit, units, result)
        new = _checked(variable, estimate.value, factor, offset, fmu)
        applied.append(AppliedValue(name, variable.start, new, estimate.std, variable.unit))
    _copy(fmu, output, {each.variable: each.new for each in applied})
    return tuple(applied)


def _read(
    path: Path, model: str, component: str | None, force: bool
) -> tuple[dict[str, _Estimate], Mapping[str, Unit]]:
    """Return values by FMU names, and the units of the file."""
    if is_folder(path):
        path = path / "result.json"
    if path.suffix.lower() == ".ssv":
        given = read_ssv(path)
        found = {name: _Estimate(q.value, unit=q.unit) for name, q in given.values.items()}
        return _of_component(path, found, component), given.units
    result = Result.from_json(path)
    every = zip(result.names, map(_Estimate, result.values.tolist(), result.std.tolist()), strict=True)
    estimates = {name: each for name, each in every if not is_quantity(name)}  # sensors are no part of the FMU
    corrected = read_model_errors(path).corrected
    estimates |= {name: _Estimate(value) for name, value in corrected.items() if name not in estimates}
    found = _of_component(path, estimates, component, tuple(result.setup.models))
    used = result.setup.models.get(component or "")
    identified = model if used is None else used["name"]
    if identified != model:
        raise InputError(f"{path}: result of the model {identified}, not {model}. Give the FMU of the result.")
    verdict = result.verdict or judge(result)
    if verdict.grade is Grade.NOT_USABLE and not force:
        why = "; ".join(": ".join((each.reason.value, *each.subject)) for each in verdict.doubts if each.is_fatal)
        raise InputError(f"{path}: the verdict is NOT USABLE ({why}). Identify again, or add --force.")
    return found, {}


def _of_component(
    path: Path, found: Mapping[str, _Estimate], component: str | None, components: tuple[str, ...] = ()
) -> dict[str, _Estimate]:
    """Return the values of one component under their names in it."""
    if component is None:
        if any(components):
            named = ", ".join(components)
            raise InputError(f"{path}: result of the system of {named}. Name the FMU's component with --component.")
        chosen = dict(found)
    else:
        prefix = f"{component}."
        chosen = {name.removeprefix(prefix): value for name, value in found.items() if name.startswith(prefix)}
    if not chosen:
        known = sorted({name.rpartition(".")[0] for name in found} | set(components)) if component else []
        whose = f" of the component {component!r}{nearest(component, known)}" if component else ""
        raise InputError(f"{path}: no parameters{whose}")
    return chosen


def _startable(description: Description, name: str, fmu: Path) -> Variable:
    """Return a variable whose start value may be set."""
    variables = description.variables
    base = name.rpartition("[")[0]
    if name not in variables and base in variables:
        why = f"{name}: estimated for one experiment only, or no element of {base!r}"
        raise InputError(f"{why}. Identify it for all experiments.")
    if name not in variables:
        raise InputError(f"{fmu}: unknown variable {name!r}{nearest(name, variables)}")
    variable = variables[name]
    if not variable.settable or variable.causality == "structuralParameter":  # which the sizes of arrays hang on
        kind = f"causality {variable.causality}, variability {variable.variability}"
        initial = variable.initial or "not given"
        raise InputError(f"{fmu}: {name}: start value is not settable ({kind}, initial {initial}).")
    return variable


def _conversion(
    description: Description, variable: Variable, unit: str | None, units: Mapping[str, Unit], result: Path
) -> tuple[float, float]:
    """Return factor and offset to the unit of a variable."""
    if unit is None or variable.unit is None or unit == variable.unit:
        return 1.0, 0.0
    found = unit_conversion({**description.units, **units}.get(unit), description.units.get(variable.unit))
    if found is None:
        raise InputError(f"{result}: {variable.name}: unit {unit!r} does not convert to {variable.unit!r}.")
    return found


def _checked(variable: Variable, value: Value, factor: float, offset: float, fmu: Path) -> float | int | bool:
    """Return a value in its variable's unit, within the FMU's limits."""
    if isinstance(value, str):
        raise InputError(f"{variable.name}: text {value!r}. Only numbers and booleans can be applied.")
    new: float | int | bool = value
    if not isinstance(value, bool) and (variable.type == "Real" or (factor, offset) != (1.0, 0.0)):
        new = factor * value + offset
    for word, limit, sign in (("min", variable.min, 1.0), ("max", variable.max, -1.0)):
        if limit is not None and sign * new < sign * limit:
            beyond = f"{fmu}: {variable.name}: {new:.6g} is beyond {word} = {limit:.6g} of the FMU"
            raise InputError(f"{beyond}. Add this bound to the study.")
    return new


def _copy(fmu: Path, output: Path, values: Mapping[str, float | int | bool]) -> None:
    """Write a copy of an FMU; other entries keep content, order and attributes."""
    with CheckedArchive(fmu) as old:
        try:
            text = with_starts(old.read(DESCRIPTION_FILE), values)
        except InputError as error:
            raise InputError(f"{fmu}: {error}") from None
        with replacing(output) as draft, zipfile.ZipFile(draft, "w") as new:
            new.comment = old.comment
            for entry in old.entries:
                new.writestr(entry, text if entry.filename == DESCRIPTION_FILE else b"".join(old.chunks(entry)))
