"""Studies that are begun: columns and times of data files, and what is written."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import fmuid
from fmuid import InputError, Study
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, WRONG_INPUT
from fmuid.models import DEFAULT_INTEGRATOR, DEFAULT_TOLERANCE, INTEGRATORS, read_description
from fmuid.reports.topics import init as console_draft
from fmuid.reports.topics.init import remarks
from fmuid.studies import (
    Candidate,
    Draft,
    InitOptions,
    MatchReason,
    check_output,
    draft,
    match_data_files,
    skeleton,
    write_draft,
)
from fmuid.studies.init.column_matching import guess
from fmuid.studies.init.lines import LINE_LENGTH
from fmuid.studies.init.parameter_survey import ParameterProposal, bounds
from fmuid.studies.model import SolverSection
from tests.support.coil_study import COIL, coil_table, fmuid_
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.paths import FMUS

MACHINE = read_description(FMUS / "InductionMachine/InductionMachine.fmu")


def guessed(columns: dict[str, str], given: dict[str, str] | None = None) -> dict[str, tuple[str, MatchReason]]:
    """Return what is guessed of columns with units for the machine."""
    links = guess(MACHINE, list(columns), {name: unit for name, unit in columns.items() if unit}, given or {})
    return {link.variable: (link.column, link.reason) for link in links if link.column and link.reason}


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"w": "", "ids": "A"}, {"w": ("w", MatchReason.NAME), "ids": ("ids", MatchReason.NAME)}),
        ({"IDS": "", "i_qs": "A"}, {"ids": ("IDS", MatchReason.SPELLING), "iqs": ("i_qs", MatchReason.SPELLING)}),
        ({"Ids_meas": "", "qIst": ""}, {"ids": ("Ids_meas", MatchReason.ADDITION)}),
        ({"uds_ref": "V", "ids_ref": "A"}, {"uds": ("uds_ref", MatchReason.ADDITION)}),  # no output is a reference
        (
            {"Id": "mA", "Iq_meas": "mA"},
            {"ids": ("Id", MatchReason.BEGINNING), "iqs": ("Iq_meas", MatchReason.BEGINNING)},
        ),
        ({"Id": "", "Iq": ""}, {}),  # of which nobody knows the quantity
        ({"Drehzahl": "n/min"}, {"w": ("Drehzahl", MatchReason.QUANTITY)}),
        ({"n1": "rpm", "n2": "rpm"}, {}),
        ({"Strom": ""}, {}),  # ids or iqs
        ({"ids": "", "IDS": ""}, {"ids": ("ids", MatchReason.NAME)}),
        ({"phidr": "Wb", "Phi_qr": "Wb"}, {"phidr": ("phidr", MatchReason.NAME)}),  # local variables are not guessed
    ],
)  # fmt: skip
def test_guesses(columns: dict[str, str], expected: dict[str, tuple[str, MatchReason]]) -> None:
    assert guessed(columns) == expected


@pytest.mark.parametrize(
    ("columns", "found", "units"),
    [
        (("PUMP_V", "SENSE_MA"), ["PUMP_V", "SENSE_MA"], {"i": "mA"}),
        (("drive_V", "sense_uA"), ["drive_V", "sense_uA"], {}),  # which experiments read, too
        (("u", "i_kiloampere"), ["u", "i_kiloampere"], {"i": "kiloampere"}),
        (("u", "i_s"), ["u", None], {}),  # seconds are no current
        (("u_A", "i"), [None, "i"], {}),
    ],
)
def test_ends_of_names_are_units_that_convert(
    columns: tuple[str, str], found: list[str | None], units: dict[str, str], tmp_path: Path
) -> None:
    coil_table(path := tmp_path / "a.csv", 0.0, 1)
    pd.read_csv(path).set_axis(["time", *columns], axis=1).to_csv(path, index=False)
    (record,) = match_data_files(COIL, [path])
    assert record.units == units
    assert [link.column for link in record.links] == found


def test_undecided_columns_are_choices() -> None:
    links = guess(MACHINE, ["n1", "n2"], {"n1": "rpm", "n2": "rpm"}, {})
    assert [(link.column, link.choices) for link in links if link.variable == "w"] == [(None, ("n1", "n2"))]


def test_given_columns_go_first() -> None:
    found = guessed({"w": "rad/s", "speed": "rpm", "phi": "Wb"}, {"w": "speed", "phidr": "phi"})
    assert found == {"w": ("speed", MatchReason.GIVEN), "phidr": ("phi", MatchReason.GIVEN)}
    assert guessed({"w": "rad/s", "speed": "rpm"}, {"w": ""}) == {}
    for given, said in (
        ({"idss": "ids"}, "no input or output 'idss' .*'ids'"),
        ({"ids": "Ids"}, "'Ids' not found.*'ids'"),
    ):
        with pytest.raises(InputError, match=said):
            guessed({"ids": "A"}, given)


# --- on the command line ------------------------------------------------------------------


def bench(folder: Path) -> pd.DataFrame:
    """Return the record of a coil as a test bench has it."""
    coil_table(folder / "run.csv", 0.0, seed=1)
    frame = pd.read_csv(folder / "run.csv").iloc[:60]
    return pd.DataFrame(
        {
            "Zeit [ms]": 1000 * frame["time"],
            "Spannung_soll": frame["u"],
            "I_mess [mA]": 1000 * frame["i"],
            "T [°C]": 20.0,
        }
    )


def write(frame: pd.DataFrame, path: Path) -> Path:
    frame.to_csv(path, sep=";", decimal=",", index=False, na_rep="-")
    return path


def without(frame: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return the record without one sample."""
    return frame.assign(**{column: frame[column].where(frame.index != 3)})


@pytest.mark.parametrize(
    ("spoil", "code", "said"),
    [
        (lambda f: without(f, "I_mess [mA]"), DONE, "1 of 60 samples of 'I_mess'"),
        (lambda f: without(f, "Spannung_soll"), NOT_SUCCEEDED, "has no value in row 4"),
        (lambda f: f.iloc[::-1], NOT_SUCCEEDED, "row 2 goes back"),
        (lambda f: f.rename(columns={"Spannung_soll": "X"}), NOT_SUCCEEDED, "--map u=COLUMN"),
        (lambda f: f.rename(columns={"I_mess [mA]": "X"}), NOT_SUCCEEDED, "--map i=COLUMN"),
    ],
)  # fmt: skip
def test_init_says_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], spoil: object, code: int, said: str
) -> None:
    assert callable(spoil)
    table, study = write(spoil(bench(tmp_path)), tmp_path / "bench.csv"), tmp_path / "study.toml"
    assert fmuid_("init", COIL, table, "--output", study) == code
    assert said in capsys.readouterr().out.replace("\n", " ")
    assert study.exists()


def test_guessed_and_given_columns_and_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, study = write(bench(tmp_path), tmp_path / "run.csv"), tmp_path / "guessed.toml"
    assert fmuid_("init", COIL, table, "--output", study) == DONE
    assert "Spannung_soll" in capsys.readouterr().out
    (experiment,) = Study.read(study).tables
    assert (experiment.columns, experiment.units) == ({"u": "Spannung_soll", "i": "I_mess"}, {"i": "mA"})
    assert experiment.times[1] < 0.01
    frame = bench(tmp_path).set_axis(["tick", "a", "b", "c"], axis="columns")
    table, study = write(frame, tmp_path / "bench.csv"), tmp_path / "study.toml"
    given = ("--map", "u=a", "--map", "i=b", "--time", "1", "--time-unit", "ms", "--unit", "i=mA", "--output", study)
    assert fmuid_("init", COIL, table, table, *given) == DONE
    text = study.read_text()
    assert text.count('inputs = { u = "a" }\noutputs = { i = "b" }\n') == 2
    read = Study.read(study)
    assert [each.name for each in read.experiments] == ["bench", "bench 2"]
    assert read.tables[1].times[-1] < 1.0
    assert read.tables[1].units == {"i": "mA"}


@pytest.mark.parametrize("given", [("--map", "u"), ("--map", "u=nothing"), ("--sheet", "run")])
def test_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str], given: tuple[str, str]) -> None:
    table, study = write(bench(tmp_path), tmp_path / "bench.csv"), tmp_path / "study.toml"
    assert fmuid_("init", COIL, table, "--output", study, *given) == WRONG_INPUT
    assert capsys.readouterr().err.count("\n") == 1
    assert not study.exists()


class Terminal:
    """Stands for a terminal whose user gives answers."""

    def __init__(self, answers: list[str]) -> None:
        self.answers, self.asked = answers, 0

    def ask(self, *_: object, **__: object) -> str:
        self.asked += 1
        return self.answers.pop(0)


def test_a_guess_is_asked_about_in_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = bench(tmp_path).assign(other=1.0)
    (record,) = match_data_files(COIL, [write(frame, tmp_path / "bench.csv")], InitOptions())
    terminal = Terminal(["u=othr", "nonsense", "u = other", ""])
    monkeypatch.setattr(console_draft, "Prompt", terminal)
    assert console_draft.asked_about(record) is record  # no terminal
    assert terminal.asked == 0
    monkeypatch.setattr(console_draft, "on_terminal", lambda: True)
    found = console_draft.asked_about(record)
    assert terminal.asked == 4
    assert found.roles("input") == {"u": "other"}
    (sure,) = match_data_files(COIL, [tmp_path / "run.csv"])
    assert console_draft.asked_about(sure) is sure
    assert terminal.asked == 4


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
    fmuid.Component(fmu, SolverSection(**found).numerics)
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
