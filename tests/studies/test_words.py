"""Every key of the study file with every odd value: taken, or refused in fmuid's own words that name its place."""

from __future__ import annotations

import copy
import datetime
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fmuid.errors import InputError
from fmuid.studies.section import SectionLocation
from fmuid.studies.study_file import StudyFile

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
ODD: list[Any] = [
    None,
    True,
    0,
    -1,
    3,
    10**400,
    0.5,
    math.nan,
    math.inf,
    "",
    "x",
    [],
    ["x"],
    ["x", "x"],
    [[]],
    [{}],
    {},
]
ODD += [{"x": 1}, {"x": {}}, {"x": {"x": []}}, datetime.date(1979, 5, 27), [[math.nan]], [{"x": "x"}], "file"]


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
