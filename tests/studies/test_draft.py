"""`fmuid init` for FMUs of all kinds: solver keys, arrays, local variables, missing bounds."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import fmuid
from fmuid import InputError
from fmuid.models import DEFAULT_INTEGRATOR, DEFAULT_TOLERANCE, INTEGRATORS, read_description
from fmuid.reports.topics.init import remarks
from fmuid.studies import Candidate, Draft, check_output, draft, match_data_files, skeleton, write_draft
from fmuid.studies.init.lines import LINE_LENGTH
from fmuid.studies.init.parameter_survey import ParameterProposal, bounds
from fmuid.studies.model import NumericsSection
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.paths import FMUS


def drafted(fmu: Path, *columns: str) -> str:
    table = fmu.parent / "table.csv"
    pd.DataFrame({"time": [0.0, 1.0], **dict.fromkeys(columns, 0.0)}).to_csv(table, index=False)
    return draft(fmu, match_data_files(fmu, [table]), fmu.parent / "study.toml").text


def freed(text: str) -> str:
    """Return a study with all its parameters taken out of their comments."""
    return "\n".join(line[2:] if re.match(r"# \S+ = { start", line) else line for line in text.splitlines())


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("exchange", {"solver", "tolerance", "step_size"}),
        ("both", {"interface", "solver", "tolerance", "step_size"}),
        ("co-simulation", {"tolerance", "step_size"}),
    ],
)
def test_solver_keys(kind: str, expected: set[str], tmp_path: Path) -> None:
    """The keys are those that apply, and the values in their comments are ones that fmuid takes."""
    text = FMI2 if kind == "exchange" else FMI3
    if kind == "co-simulation":
        text = re.sub("<ModelExchange.*/>\n", "", text)
    fmu = write_fmu(tmp_path / "Model.fmu", text)
    said = drafted(fmu, *(["i"] if kind == "exchange" else ["y[1]"]))
    section = said[said.index("[model]") : said.index("[model.fixed]")]
    found = tomllib.loads(re.sub(r"^# (?=\w+ = )", "", section, flags=re.MULTILINE))["model"]
    assert found.pop("fmu") == "Model.fmu"
    assert found.keys() == expected
    fmuid.Component(fmu, NumericsSection(**found).numerics)
    if "solver" in expected:
        assert [name for name in INTEGRATORS if f'"{name}"' not in said] == []
        assert f'default: "{DEFAULT_INTEGRATOR}"' in said
        assert found["tolerance"] == DEFAULT_TOLERANCE


def test_arrays(tmp_path: Path) -> None:
    text = drafted(write_fmu(tmp_path / "Linear.fmu", FMI3), "u[2]", "y[1]", "y[5]")
    content = tomllib.loads(freed(text))
    (experiment,) = content["experiments"]
    assert (experiment["inputs"], experiment["outputs"]) == (["u[2]"], ["y[1]", "y[5]"])
    assert "# inputs without column: u[1]\n# outputs" in re.sub("outputs = .*\n", "", text)
    assert "# outputs without column: y[2], y[3], y[4]\n" in text
    assert {name: keys["start"] for name, keys in content["parameters"].items()} == {
        **{f"A[{i},{j}]": 3.0 * (i - 1) + j for i in (1, 2) for j in (1, 2, 3)},
        "b[1]": 7.0,
        "b[2]": 8.0,
    }


@pytest.mark.parametrize(("both", "held"), [(True, ("u[1]", "u[2]")), (False, ())])
def test_elements_of_one_array_hold_together(tmp_path: Path, both: bool, held: tuple[str, ...]) -> None:
    """Model Exchange takes them in no other way."""
    fmu = write_fmu(tmp_path / "Linear.fmu", FMI3)
    steps, slope = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    columns = {"time": slope, "u[1]": steps, "u[2]": steps if both else slope, "y[1]": slope}
    pd.DataFrame(columns).to_csv(tmp_path / "table.csv", index=False)
    (record,) = match_data_files(fmu, [tmp_path / "table.csv"])
    assert record.held == held
    assert any("u[1], u[2]" in str(each) and '"linear"' in str(each) for each in remarks(record)) == both


def test_elements_of_a_matrix_keep_no_sign(tmp_path: Path) -> None:
    variables = read_description(write_fmu(tmp_path / "Linear.fmu", FMI3)).variables
    for name, start, expected in (("A[1,2]", 2.0, {}), ("b[1]", 7.0, {"min": 0.0}), ("b[1]", -7.0, {"max": 0.0})):
        assert bounds(Candidate(variables[name], ParameterProposal.FREED, start)) == expected


def test_data_of_one_row(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("time,u,w\n0,1,2\n")
    (record,) = match_data_files(write_fmu(tmp_path / "Motor.fmu", FMI2), [table])
    assert record.roles("input") and record.interpolation == "linear"
    assert "two different times" in record.refusal


def test_local_outputs_and_valid_bounds(tmp_path: Path) -> None:
    """Bounds that are missing, empty, or broken by the start are left out; what never changes is no output."""
    text = drafted(write_fmu(tmp_path / "Motor.fmu", FMI2), "w", "heat", "half", "word")
    (experiment,) = tomllib.loads(text)["experiments"]
    assert experiment["outputs"] == ["w", "heat"]
    assert "# unused columns: half, word\n" in text
    parameters: dict[str, Any] = tomllib.loads(freed(text))["parameters"]
    assert parameters == {
        "R": {"start": 2.0, "min": 0.0},
        "L": {"start": 0.1},
        "J": {"start": 0.0, "max": 2.0, "nominal": 1.0},
        "i": {"start": 0.0, "nominal": 1.0},
        "angle": {"start": 0.5},
        "guess": {"start": 1.0},
    }
    for keys in parameters.values():
        fmuid.Parameter(**keys)


def test_long_lists_and_remarks(tmp_path: Path) -> None:
    many = "".join(
        f'<ScalarVariable name="a long, [odd] name {i}" valueReference="{100 + i}" causality="input" '
        f'variability="continuous" description="{"very " * 50}long"><Real start="0"/></ScalarVariable>'
        for i in range(60)
    )
    fmu = write_fmu(tmp_path / "Motor.fmu", FMI2.replace("</ModelVariables>", many + "</ModelVariables>"))
    inputs = [f"a long, [odd] name {i}" for i in range(60)]
    text = drafted(fmu, *inputs, "i")
    assert tomllib.loads(text)["experiments"][0]["inputs"] == inputs
    start = text.index("inputs = [")
    assert max(map(len, text[start : text.index("]\n", start + 40 * 60)].splitlines())) <= LINE_LENGTH
    assert "a long, [odd] name 17 and 42 more\n" in drafted(fmu, "i")  # after u and on


@pytest.mark.parametrize("path", sorted(FMUS.glob("*/*.fmu"))[::8], ids=lambda path: path.stem)
def test_a_study_of_every_kind_is_read(path: Path, tmp_path: Path) -> None:
    """What is written for the FMUs of the house, by init and by info, can be read with all its parameters freed."""
    fmu = tmp_path / path.name
    fmu.write_bytes(path.read_bytes())
    outputs = [variable.name for variable in fmuid.FMU(fmu).description.with_causality("output")]
    text = freed(drafted(fmu, *outputs[:1]))
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    assert list(fmuid.Study.read(tmp_path / "study.toml").parameters) == list(tomllib.loads(text)["parameters"])
    short = tomllib.loads(skeleton(fmuid.FMU(fmu)))
    assert (short["model"]["fmu"], short["experiments"][0]["outputs"]) == (path.name, outputs)


def test_a_new_file_is_never_written_over_another(tmp_path: Path) -> None:
    edited = tmp_path / "edited.toml"
    write_draft(Draft("# head\n[model]\n", ()), edited)
    write_draft(Draft("# head\n[model]\nnew = 1\n", ()), edited)  # as `init` left it
    edited.write_text(edited.read_text().replace("new", "mine"))
    write_draft(Draft("# head\n", ()), tmp_path / "study.toml")
    for path, said in (
        (tmp_path, "file exists"),
        (edited, "file exists"),
        (tmp_path / "none" / "study.toml", "its folder does not exist. Create it"),
    ):
        with pytest.raises(InputError, match=said):
            check_output(path)
    write_draft(Draft("# head\n[model]\n", ()), edited, force=True)
    assert "mine" not in edited.read_text()
