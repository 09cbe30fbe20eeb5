"""Lines of a study file from an FMU, mostly commented out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized
from textwrap import shorten

from fmuid.models import FMU, Description, Variable
from fmuid.studies.init.column_matching import of_tables
from fmuid.studies.model import SolverSection
from fmuid.studies.section import keys_of, own_first, summary, table_of
from fmuid.studies.study_file import StudyFile
from fmuid.studies.toml import quoted_key, show, toml_text

OBSERVED = ("output", "local")  # causalities of outputs of an experiment
NAMES_LISTED = 20  # names in a comment
PARAMETERS_LISTED = 12  # parameters in a skeleton
LINE_LENGTH, REMARK_LENGTH = 110, 80
NOISE_EXAMPLES: Mapping[str, object] = {"variance": "estimate", "excitation_period": 4.0, "initial_variance": 0.01}
"""Examples of a settings class; sections of `fmuid.studies` have their own."""


def skeleton(fmu: FMU) -> str:
    """Return a short study of an FMU without data, for `fmuid info`."""
    description = fmu.description
    outputs, remark = of_tables(description, "output"), ""
    if not outputs:
        outputs = [name for name in description.states if description.variables[name].causality in OBSERVED]
        remark = "  # the FMU declares no outputs: name measured states or local variables"
    lines = [
        "[model]",
        f"fmu = {toml_text(fmu.path.name)}  # relative to the study file",
        *numerics(description),
        "",
        "[[experiments]]",
        'data = "data.csv"  # first column: time, s',
        role("inputs", {name: name for name in of_tables(description, "input")}),
        role("outputs", {name: name for name in outputs}) + remark,
        "",
    ]
    freed = free(description)
    lines.append("[parameters]  # " + ("remove the # before free parameters" if freed else "none can be set"))
    lines += ["# " + parameter(variable) for variable in freed[:PARAMETERS_LISTED]]
    if len(freed) > PARAMETERS_LISTED:
        lines.append(f"# and {len(freed) - PARAMETERS_LISTED} more; `fmuid init` writes all")
    return "\n".join(lines) + "\n"


def numerics(description: Description, *, lags: bool = False) -> list[str]:
    """Return the solver keys, commented out unless Co-Simulation `lags`."""
    both, exchanges = len(description.interfaces) > 1, "model-exchange" in description.interfaces
    chosen = 'interface = "model-exchange"  # co-simulation fails or takes over ten times as long'
    lines = ([chosen] if lags else [example(SolverSection, "interface")]) if both else []
    return lines + [example(SolverSection, word) for word in (*["solver"] * exchanges, "tolerance", "step_size")]


def rest(known: Sized = ()) -> list[str]:
    """Return the sections without keys from FMU or data."""
    lines: list[str] = []
    prior = () if known else (("prior", False),)
    for name, asked in (*prior, ("noise", True), ("estimation", True), ("uncertainty", False)):
        table = table_of(keys_of(StudyFile)[name].annotation)
        assert table is not None
        keys = NOISE_EXAMPLES if name == "noise" else [key for key, each in own_first(table) if each.examples]
        some, about = [example(table, key) for key in keys], summary(table).rstrip(".")
        if not asked:
            some = [f"# {line.removeprefix('# ')}" for line in some]
        said = f"[{name}]" if asked else f"# [{name}]  # {about[0].lower()}{about[1:]}"
        lines += [said, *some, ""]
    return lines[:-1]


def example(table: type, key: str) -> str:
    """Return an example of a key, commented out unless default."""
    known = keys_of(table)[key]
    value = known.examples[0] if known.examples else NOISE_EXAMPLES[key]
    return f"{'' if value == known.default else '# '}{key} = {show(value)}  # {known.description}"


def role(word: str, columns: Mapping[str, str]) -> str:
    """Return inputs or outputs as a list or ``{ name = column }``."""
    if any(variable != column for variable, column in columns.items()):
        return f"{word} = {toml_text(columns)}"
    lines = [f"{word} = ["]
    for name in columns:
        item = toml_text(name) + ", "
        if len(lines[-1] + item) > LINE_LENGTH:
            lines.append("    ")
        lines[-1] += item
    if len(lines) == 1:
        return lines[0].removesuffix(", ") + "]"
    return "\n".join([*(line.rstrip() for line in lines), "]"])


def listed(names: Sequence[str]) -> str:
    """Return the first names and the number of others."""
    more = len(names) - NAMES_LISTED
    return ", ".join(names[:NAMES_LISTED]) + (f" and {more} more" if more > 0 else "")


def free(description: Description) -> list[Variable]:
    """Return parameters, then other variables with settable start values."""
    settable = [
        variable
        for variable in description.variables.values()
        if variable.type == "Real" and variable.settable and variable.causality not in ("input", "structuralParameter")
    ]
    return sorted(settable, key=lambda variable: variable.causality != "parameter")


def parameter(variable: Variable) -> str:
    """Return the line of a parameter as in the FMU."""
    start = float(variable.start) if isinstance(variable.start, int | float) else 0.0
    return parameter_line(variable, start, declared_bounds(variable, start))


def parameter_line(
    variable: Variable, start: float, bounds: Mapping[str, float], more: str = "", said: str = ""
) -> str:
    """Return the line of a parameter."""
    keys = {"start": start, **bounds}
    if start == 0:
        keys["nominal"] = abs(variable.nominal or 1.0)
    given = ", ".join([*(f"{word} = {value!r}" for word, value in keys.items()), *([more] if more else [])])
    unit = variable.unit if variable.unit not in (None, "1") else ""
    remark = shorten(": ".join(part for part in (unit, variable.description) if part), REMARK_LENGTH, placeholder="…")
    remark = "; ".join(part for part in (remark, said) if part)
    return f"{quoted_key(variable.name)} = {{ {given} }}" + (f"  # {remark}" if remark else "")


def declared_bounds(variable: Variable, start: float) -> dict[str, float]:
    """Return the FMU's bounds around its start; Modelica tools write some 1e60 for none."""
    found = {}
    for word in ("min", "max"):
        bound = getattr(variable, word)
        if bound is not None and abs(bound) < 1e60 and (start >= bound if word == "min" else start <= bound):
            found[word] = bound
    return {} if "min" in found and found["min"] == found.get("max") else found
