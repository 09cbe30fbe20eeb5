"""Words of a study that are set from the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fmuid.data import Normal, Parameter
from fmuid.errors import InputError
from fmuid.studies.overrides import override
from fmuid.studies.study import Study
from tests.support.study_files import write

# --- overrides --------------------------------------------------------------------------


def test_overrides(folder: Path) -> None:
    study = Study.read(
        write(folder),
        [
            "parameters.R.start=9",
            'parameters."drive.M".start=90',
            "parameters.drive.M.max=100",
            "parameters.dR.prior={mean = 0.5, std = 1}",
            "parameters.R.prior.std=0.5",
            "parameters.L={start = 0.2}",
            f"experiments.0.data={folder / 'run2.csv'}",
            "experiments.1.units.i=kA",
            "experiments.1.inputs=[\"u\"]",
            "model.fixed.drive.k=2",
            "title=A b",
        ],
    )  # fmt: skip
    assert study.parameters == {
        "R": Parameter(9.0, min=0.0, prior=Normal(4.1, 0.5)),
        "dR": Parameter(0.0, nominal=1.0, prior=Normal(0.5, 1.0), per_experiment=True),
        "drive.M": Parameter(90.0, max=100.0),
        "L": Parameter(0.2),
    }
    assert study.experiments[0].data == folder / "run2.csv"
    assert study.experiments[1].units == {"i": "kA"}
    assert study.experiments[1].inputs == {"u": "u"}
    assert study.model.values["drive.k"] == 2
    assert study.title == "A b"


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ("parameters.Q.start=9", "study.toml: [parameters] has no 'Q'"),
        ("parameters.drive.N.start=9", "[parameters] has no 'drive.N' (did you mean 'drive.M'?)"),
        ("parameters.Q=9", "[parameters] has no 'Q'"),
        ("parameters.R.strat=9", "with --set: [parameters.R] has no key 'strat' (did you mean 'start'?)"),
        ("parameters.R.start=nine", 'with --set: [parameters.R] start must be a number, not "nine"'),
        ("parameters.R.start=", 'with --set: [parameters.R] start must be a number, not ""'),
        ("experiments.2.warmup=1", "has no experiments.2: the entries of experiments are numbered 0 to 1"),
        ("experiments.first.discard=1", "has no experiments.first: the entries"),
        ("modle.step_size=1", "the file has no 'modle' (did you mean 'model'?)"),
        ("title.x=1", "has \"Coil\" for title, which has no key 'x'"),
        ("parameters.R.start", "expected path=value"),
        ("=3", "expected path=value"),
        ("a..b=3", "expected path=value"),
        ("a.=3", "expected path=value"),
    ],
)  # fmt: skip
def test_override_refused(folder: Path, setting: str, sentence: str) -> None:
    with pytest.raises(InputError) as refusal:
        Study.read(write(folder), [setting])
    assert sentence in str(refusal.value)
    assert "--set" in str(refusal.value)


def test_override_asks_for_quotes_where_two_keys_fit() -> None:
    data: dict[str, Any] = {"parameters": {"a": {"b": 1}, "a.b": {"start": 2}}}
    with pytest.raises(InputError, match=r'quote the one meant, "a" or "a\.b"'):
        override(data, "parameters.a.b=3", "study.toml")
    override(data, 'parameters."a.b".start=3', "study.toml")
    assert data["parameters"] == {"a": {"b": 1}, "a.b": {"start": 3}}


def test_override_begins_tables() -> None:
    data: dict[str, Any] = {}
    override(data, "estimation.max_iterations=5", "study.toml")
    override(data, "model.fixed.L=0.1", "study.toml")
    assert data == {"estimation": {"max_iterations": 5}, "model": {"fixed": {"L": 0.1}}}
