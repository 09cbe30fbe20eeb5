"""What the classes of the study file give besides its checks: reference page, JSON schema."""

from __future__ import annotations

import json
import tomllib
from typing import Any

import jsonschema
import pytest

from fmuid.apps.cli.app import run
from fmuid.diagnosis import FALSE_ALARM_LEVEL, Rule
from fmuid.studies.schema import reference, schema
from tests.support.paths import ROOT

STUDIES = sorted((ROOT / "experiments").rglob("*.toml"))


@pytest.fixture(scope="module")
def checker() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema())


def test_the_page_is_generated() -> None:
    """Written anew by: python -m fmuid.studies.schema > docs/study-reference.md."""
    page = (ROOT / "docs" / "study-reference.md").read_text(encoding="utf-8")
    assert page == reference()
    for line in (
        '- `interpolation` ("linear" or "zoh" or "zoh-next" or "pchip" or { input = interpolation }, default ',
        "## `[diagnosis.faults.<name>.parameters.<name>]`",
        "- `from` (text, required): output",
        "Also `[[diagnosis.faults.<name>.components]]`.",
        "Also `min`, `max` as in `[parameters.<name>]`.",
    ):
        assert f"\n{line}" in page


def test_defaults_are_those_of_the_program() -> None:
    """The section takes the level of a test from a rule, which loads faster."""
    assert Rule().level == FALSE_ALARM_LEVEL


def test_the_command_prints_the_schema(
    capsys: pytest.CaptureFixture[str], checker: jsonschema.Draft202012Validator
) -> None:
    assert run(["schema"]) == 0
    printed = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert printed == checker.schema
    checker.check_schema(printed)


def test_studies_are_valid(checker: jsonschema.Draft202012Validator) -> None:
    assert len(STUDIES) > 5
    for path in STUDIES:
        assert list(checker.iter_errors(tomllib.loads(path.read_text(encoding="utf-8")))) == [], path


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
VALID = [
    ('{ u = "zoh" }', '"zoh"'),
    ("{ i = 0.04 }", '"estimate"'),
    ("{ max_steps = 2000 }", "true"),
    ('["R", "L"]', '[["R", "L"]]'),
    ('{ phi = { magnitude = "dR" } }', '["phi"]'),
    ('fmu = "Coil.fmu"', 'fmu = "Coil.fmu"\nfixed = { A = [[1.0, 2.0]], b = { result = "result.json" } }'),
    ("start = 4", "start = [4, 5], nominal = [1, 2], min = 0, max = [8, 9]"),
    ("start = 4, prior = { mean = 4.1, std = 0.2 }", 'choices = "all"'),
    ("title", "title"),
]
INVALID = [
    ("title", "titel"),
    ("std = 0.2", "std = -0.2"),
    ('"zoh"', '"zohh"'),
    ("0.04", "0"),
    ('data = "run.csv"', ""),
    ('["R", "L"]', '["R"]'),
    ("nominal = 1", "nominal = true"),
    ('magnitude = "dR"', "period = 1"),
    ("realizations = 10", "realizations = 0.5"),
    ("R = 3.0", 'R = "x"'),
    ("start = 4, prior = { mean = 4.1, std = 0.2 }", 'choices = "some"'),
    (", count = 3", ""),
]


@pytest.mark.parametrize(("old", "new"), [*VALID, *INVALID])
def test_schema_accepts_what_fmuid_accepts(checker: jsonschema.Draft202012Validator, old: str, new: str) -> None:
    assert old in GOOD
    content: dict[str, Any] = tomllib.loads(GOOD.replace(old, new, 1))
    assert (not list(checker.iter_errors(content))) == ((old, new) in VALID)
