"""Columns matched with variables: `fmuid init` guesses what is unique, and leaves the rest to the user."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from fmuid import InputError, Study
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, WRONG_INPUT
from fmuid.models import read_description
from fmuid.reports.topics import init as console_draft
from fmuid.studies import InitOptions, MatchReason, match_data_files
from fmuid.studies.init.column_matching import guess
from tests.support.coil_study import COIL, coil_table, fmuid_
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
