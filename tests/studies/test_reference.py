"""Every section of the study file: reference page, JSON schema, and odd values, which are refused in words."""

from __future__ import annotations

import copy
import datetime
import json
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from fmuid import InputError, Rule
from fmuid.apps.cli.app import run
from fmuid.diagnosis import FALSE_ALARM_LEVEL
from fmuid.studies.schema import reference, schema
from fmuid.studies.section import SectionLocation
from fmuid.studies.study_file import StudyFile
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
        '- `interpolation` ("linear", "zoh", "zoh-next", "pchip", { input = interpolation }, default ',
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


TEXT = """
title = "Coil"
[model]
step_size = 1e-3
shared_variables = { R = ["a.R", "b.R"] }
fixed = { "a.L" = 0.1 }
components = [{ name = "a", fmu = "file" }]
connections = [{ from = "a.i", to = "b.u", factor = 2 }]
[[experiments]]
data = "file"
inputs = { u = "voltage" }
outputs = ["i"]
interpolation = { u = "zoh" }
units = { i = "mA" }
[parameters]
R = { start = 4, per_experiment = true, prior = { result = "file", std_factor = 10 } }
[prior]
names = ["R", "L"]
mean = [1, 2.0]
covariance = [[1, 0], [0, 1]]
[noise]
variance = { i = 0.04 }
initial_variance = 1
[estimation]
method = "multi-start"
n_starts = 20
[uncertainty]
profile_likelihood = ["R"]
posterior = { max_steps = 2000 }
cost_map = [["R", "L"]]
[diagnosis]
baseline = "file"
std_factor = { R = inf }
[diagnosis.faults.turns]
parameters = { dR = { nominal = 1 } }
angles = { phi = { magnitude = "dR" } }
variable_map = { R = "a.R" }
[monitoring]
window_length = 1
[batch]
data = ["*.csv"]
starting_points = [{ R = 3.0 }]
free_parameters = [["R"]]
sweep = { L = { from = 0.1, to = 0.2, count = 3 }, on = [true, false] }
space_filling = { points = 4, ranges = { L = [1, 2] } }
monte_carlo = { realizations = 10, std = { i = 0.1 }, true_values = { R = 4 } }
[isolation]
memory_limit_mb = 100.0
"""
VALID = [
    ('{ u = "zoh" }', '"zoh"'),
    ("{ i = 0.04 }", '"estimate"'),
    ("{ max_steps = 2000 }", "true"),
    ('[["R", "L"]]', '["R", "L"]'),
    ('{ phi = { magnitude = "dR" } }', '["phi"]'),
    ('{ "a.L" = 0.1 }', '{ A = [[1.0, 2.0]], b = { result = "file" } }'),
    ("start = 4,", "start = [4, 5], nominal = [1, 2], min = 0, max = [8, 9],"),
    ("R = { start = 4,", 'k = { choices = "all" }\nR = { start = 4,'),
    ("title", "title"),
]
INVALID = [
    ("title", "titel"),
    ("std_factor = 10", "std_factor = -10"),
    ('"zoh"', '"zohh"'),
    ("0.04", "0"),
    ('data = "file"', ""),
    ('[["R", "L"]]', '["R"]'),
    ("nominal = 1", "nominal = true"),
    ('magnitude = "dR"', "period = 1"),
    ("realizations = 10", "realizations = 0.5"),
    ("R = 3.0", 'R = "x"'),
    (", count = 3", ""),
    ("R = { start = 4,", 'k = { choices = "some" }\nR = { start = 4,'),
]


@pytest.mark.parametrize(("old", "new"), [*VALID, *INVALID])
def test_schema_accepts_what_fmuid_accepts(checker: jsonschema.Draft202012Validator, old: str, new: str) -> None:
    assert old in TEXT
    content: dict[str, Any] = tomllib.loads(TEXT.replace(old, new, 1))
    assert (not list(checker.iter_errors(content))) == ((old, new) in VALID)


ODD: list[Any] = [
    *(None, True, 0, -1, 3, 10**400, 0.5, math.nan, math.inf, "", "x", "file"),
    *([], ["x"], ["x", "x"], [[]], [{}], {}, {"x": 1}, {"x": {}}, {"x": {"x": []}}),
    *(datetime.date(1979, 5, 27), [[math.nan]], [{"x": "x"}]),
]


def places(data: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the way to each value of a tree."""
    for key, item in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield (*above, key)
        yield from places(item, (*above, key))


@pytest.mark.parametrize("section", tomllib.loads(TEXT))
def test_odd_values_are_refused_in_words(section: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    good = {section: tomllib.loads(TEXT)[section]}
    StudyFile.read(copy.deepcopy(good), SectionLocation("study.toml", tmp_path))
    refused = 0
    for way in places(good):
        for value in ODD:
            data: Any = copy.deepcopy(good)
            node = data
            for key in way[:-1]:
                node = node[key]
            node[way[-1]] = value
            try:
                StudyFile.read(data, SectionLocation("study.toml", tmp_path))
            except InputError as error:
                refused, said = refused + 1, str(error)
                assert re.match(rf"study\.toml: {section}\b", said), (way, value, said)
                assert re.search("must be|unknown key|missing key|not found|no prior", said), (way, value, said)
                assert not re.search("Input |should be|<value>|<table>", said), (way, value, said)
    assert refused > 5
