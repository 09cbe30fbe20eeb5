"""The lines of a study file that an FMU can say of itself, most of them commented out."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

from fmuid.studies.init.column_matching import of_tables
from fmuid.studies.section import keys_of, meaning, summary, table_of
from fmuid.studies.toml import show

if TYPE_CHECKING:
    from fmuid.models import FMU, Description, Variable

# What an output of an experiment can be.
OBSERVED = ("output", "local")
# How many names a comment lists, and how many parameters a skeleton: what can be read at a glance.
NAMES_LISTED, PARAMETERS_LISTED = 20, 12
LINE_LENGTH, REMARK_LENGTH = 110, 80
_BARE = re.compile(r"[A-Za-z0-9_-]+")
EXAMPLES: Mapping[str, Mapping[str, object]] = {
    "model": {"interface": "model-exchange", "solver": "cvode", "tolerance": 1e-7, "step_size": 1e-3},
    "experiments": {"interpolation": "linear", "warmup": 0.0},
    "prior": {"names": ["a", "b"], "result": "healthy/result.json", "std_factor": 10},
    "noise": {"variance": "estimate", "excitation_period": 4.0, "initial_variance": 0.01},
    "estimation": {
        "method": "levenberg-marquardt",
        "n_starts": 50,
        "loss": "soft_l1",
        "jacobian": "finite-difference",
        "solver_check": "refine",
        "observer_memory": 3.0,
    },
    "uncertainty": {
        "confidence_level": 0.95,
        "profile_likelihood": True,
        "posterior": True,
        "cost_map": [["a", "b"]],
    },
}
"""The keys that a first study file shows, with an example."""
# Modelica tools write their largest numbers for bounds that are none.
NO_BOUND = 1e60


def skeleton(fmu: FMU) -> str:
    """Return a short study of an FMU and a table that is still to come: what `fmuid info` shows to be pasted.

    An FMU without outputs is observed by its states, which may be measured like any local variable.
    """
    description = fmu.description
    outputs, remark = of_tables(description, "output"), ""
    if not outputs:
        outputs = [name for name in description.states if description.variables[name].causality in OBSERVED]
        remark = "  # the FMU declares no outputs: states or other local variables that are measured"
    lines = [
        "[model]",
        f"fmu = {text(fmu.path.name)}  # relative to the study file",
        *numerics(description),
        "",
        "[[experiments]]",
        'data = "table.csv"  # its first column is time, s',
        role("inputs", {name: name for name in of_tables(description, "input")}),
        role("outputs", {name: name for name in outputs}) + remark,
        "",
    ]
    freed = free(description)
    lines.append("[parameters]  # " + ("remove the # before those to identify" if freed else "none can be set"))
    lines += ["# " + parameter(variable) for variable in freed[:PARAMETERS_LISTED]]
    if len(freed) > PARAMETERS_LISTED:
        lines.append(f"# and {len(freed) - PARAMETERS_LISTED} more, all of which `fmuid init` writes")
    return "\n".join(lines) + "\n"


def inline(value: object) -> str:
    """Return a value as it stands in a line of a study file."""
    if isinstance(value, Mapping):
        pairs = (f"{key if _BARE.fullmatch(key) else text(key)} = {inline(each)}" for key, each in value.items())
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(inline, value))}]"
    return text(value) if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)


def numerics(description: Description) -> list[str]:
    """Return the keys on how the FMU is run, commented out, as far as its interfaces have use for them."""
    from fmuid.studies.model import NumericsSection

    words = ["interface"] if len(description.interfaces) > 1 else []
    words += ["solver"] if "model-exchange" in description.interfaces else []
    return [example(NumericsSection, "model", word) for word in (*words, "tolerance", "step_size")]


def rest() -> list[str]:
    """Return what does not depend on FMU and table; the sections that few studies need are commented out."""
    from fmuid.studies.study_file import StudyFile

    lines: list[str] = []
    for name, asked in (("prior", False), ("noise", True), ("estimation", True), ("uncertainty", False)):
        table = table_of(keys_of(StudyFile)[name].annotation)
        assert table is not None
        some, about = [example(table, name, key) for key in EXAMPLES[name]], summary(table).rstrip(".")
        if not asked:
            some = [f"# {line.removeprefix('# ')}" for line in some]
        said = f"[{name}]" if asked else f"# [{name}]  # {about[0].lower()}{about[1:]}"
        lines += [said, *some, ""]
    return lines[:-1]


def example(table: type, section: str, key: str) -> str:
    """Return a line with an example of a key and its meaning, commented out where that is not the default."""
    value = EXAMPLES[section][key]
    return f"{'' if value == keys_of(table)[key].default else '# '}{key} = {show(value)}  # {meaning(table, key)}"


def role(word: str, columns: Mapping[str, str]) -> str:
    """Return inputs or outputs: a list of names, on several lines where it is long, or a table where columns differ."""
    if any(variable != column for variable, column in columns.items()):
        return f"{word} = {{ " + ", ".join(f"{key(name)} = {text(column)}" for name, column in columns.items()) + " }"
    lines = [f"{word} = ["]
    for name in columns:
        item = text(name) + ", "
        if len(lines[-1] + item) > LINE_LENGTH:
            lines.append("    ")
        lines[-1] += item
    if len(lines) == 1:
        return lines[0].removesuffix(", ") + "]"
    return "\n".join([*(line.rstrip() for line in lines), "]"])


def listed(names: Sequence[str]) -> str:
    """Return the first names and how many more there are."""
    more = len(names) - NAMES_LISTED
    return ", ".join(names[:NAMES_LISTED]) + (f" and {more} more" if more > 0 else "")


def free(description: Description) -> list[Variable]:
    """Return all that can be identified: Real parameters, then other variables whose start values can be set."""
    settable = [
        variable
        for variable in description.variables.values()
        if variable.type == "Real" and variable.settable and variable.causality not in ("input", "structuralParameter")
    ]
    return sorted(settable, key=lambda variable: variable.causality != "parameter")


def parameter(variable: Variable) -> str:
    """Return the line of one parameter as the FMU has it."""
    start = float(variable.start) if isinstance(variable.start, int | float) else 0.0
    return parameter_line(variable, start, declared_bounds(variable, start))


def parameter_line(
    variable: Variable, start: float, bounds: Mapping[str, float], more: str = "", said: str = ""
) -> str:
    """Return the line of a parameter with a start, bounds, further words, and what is said of it first."""
    keys = {"start": start, **bounds}
    if start == 0:
        keys["nominal"] = abs(variable.nominal or 1.0)
    given = ", ".join([*(f"{word} = {value!r}" for word, value in keys.items()), *([more] if more else [])])
    unit = variable.unit if variable.unit not in (None, "1") else ""
    remark = shorten(": ".join(part for part in (unit, variable.description) if part), REMARK_LENGTH, placeholder="…")
    remark = "; ".join(part for part in (remark, said) if part)
    return f"{key(variable.name)} = {{ {given} }}" + (f"  # {remark}" if remark else "")


def declared_bounds(variable: Variable, start: float) -> dict[str, float]:
    """Return the FMU's min and max as far as they are bounds: those that its own start breaks would only be refused."""
    found = {}
    for word in ("min", "max"):
        bound = getattr(variable, word)
        if bound is not None and abs(bound) < NO_BOUND and (start >= bound if word == "min" else start <= bound):
            found[word] = bound
    return {} if "min" in found and found["min"] == found.get("max") else found


def relative(path: Path, output: Path) -> str:
    """Return a path as a study file at `output` names it."""
    try:
        return Path(os.path.relpath(path.resolve(), output.resolve().parent)).as_posix()
    except ValueError:  # another drive
        return path.resolve().as_posix()


def text(given: str | float) -> str:
    """Return a text or a number as TOML has it."""
    return json.dumps(given, ensure_ascii=False)


def key(name: str) -> str:
    """Return a name as the key of a TOML table."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else text(name)
