"""What the models of the study file give besides its checks: reference page, JSON schema."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from fmuid.apps.cli.app import run
from fmuid.diagnosis import FALSE_ALARM_LEVEL, Rule
from fmuid.studies.schema import reference, schema
from tests.support.paths import ROOT

STUDIES = sorted((ROOT / "experiments").rglob("*.toml"))
SCHEMA = jsonschema.Draft202012Validator(schema())


def test_the_page_is_what_the_models_say() -> None:
    """Written anew by: python -m fmuid.studies.schema > docs/study-reference.md."""
    assert (ROOT / "docs" / "study-reference.md").read_text(encoding="utf-8") == reference()


def test_the_page_has_what_a_word_takes() -> None:
    lines = reference().splitlines()
    for line in (
        '| `interpolation` | "linear" or "zoh" or "zoh-next" or "pchip" or a table { input = interpolation } | '
        '`"linear"` | between samples; "zoh" for commands of a digital controller |',
        "## `[diagnosis.faults.<name>.parameters.<name>]`",
        "| `from` | a text in quotes | must be given | an output |",
        "| `size_limits` | a table { fault.size = number } |  | "
        'sizes that must not be reached, as in { "turns.dR" = 0.5 } |',
    ):
        assert line in lines


def test_defaults_are_those_of_the_program() -> None:
    """The words take the level of a test from a rule, which loads faster."""
    assert Rule().level == FALSE_ALARM_LEVEL


def test_the_command_prints_the_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["schema"]) == 0
    printed = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert printed == schema()
    SCHEMA.check_schema(printed)


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_studies_are_valid(path: Path) -> None:
    assert list(SCHEMA.iter_errors(tomllib.loads(path.read_text(encoding="utf-8")))) == []


GOOD = """
title = "Coil"
[model]
fmu = "Coil.fmu"
[[experiments]]
data = "run.csv"
inputs = { u = "voltage" }
outputs = ["i"]
interpolation = { u = "zoh" }
[parameters]
R = { start = 4, prior = { mean = 4.1, std = 0.2 } }
[noise]
variance = { i = 0.04 }
[uncertainty]
profile_likelihood = ["R"]
posterior = { max_steps = 2000 }
cost_map = ["R", "L"]
[diagnosis]
baseline = "result.json"
std_factor = { R = inf }
[diagnosis.faults.turns]
parameters = { dR = { nominal = 1 } }
angles = { phi = { magnitude = "dR" } }
[monitoring]
window_length = 1
[batch]
data = "*.csv"
starting_points = [{ R = 3.0 }]
sweep = { L = { from = 0.1, to = 0.2, count = 3 }, on = [true, false] }
monte_carlo = { realizations = 10, std = 0.1 }
"""


def errors(text: str) -> list[Any]:
    return list(SCHEMA.iter_errors(tomllib.loads(text)))


def test_every_shape_of_a_word_is_valid() -> None:
    assert errors(GOOD) == []
    other = (
        GOOD.replace('{ u = "zoh" }', '"zoh"')
        .replace("{ i = 0.04 }", '"estimate"')
        .replace("{ max_steps = 2000 }", "true")
    )
    assert (
        errors(other.replace('["R", "L"]', '[["R", "L"]]').replace('{ phi = { magnitude = "dR" } }', '["phi"]')) == []
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("title", "titel"),
        ("start = 4", "strat = 4"),
        ("std = 0.2", "std = -0.2"),
        ('"zoh"', '"zohh"'),
        ("0.04", "0"),
        ('data = "run.csv"', ""),
        ("max_steps = 2000", "step = 2000"),
        ('["R", "L"]', '["R"]'),
        ("nominal = 1", "nominal = true"),
        ('magnitude = "dR"', "period = 1"),
        ("window_length = 1", 'window_length = "1"'),
        ("realizations = 10", "realizations = 0.5"),
        ("R = 3.0", 'R = "x"'),
        ("count = 3", ""),
    ],
)  # fmt: skip
def test_what_is_wrong_is_not_valid(old: str, new: str) -> None:
    assert old in GOOD
    assert errors(GOOD.replace(old, new, 1).replace(", ,", ",").replace(",  }", " }"))
