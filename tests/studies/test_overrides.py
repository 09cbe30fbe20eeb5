"""Values of a study that are set from the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fmuid import InputError, Normal, Parameter, Study
from fmuid.studies import override
from tests.support.study_files import write


def test_overrides(folder: Path) -> None:
    settings = """parameters.R.start=9
        parameters."drive.M".start=90
        parameters.drive.M.max=100
        parameters.dR.prior={mean = 0.5, std = 1}
        parameters.R.prior.std=0.5
        parameters.L={start = 0.2}
        experiments.0.data=run2.csv
        experiments.0.name=other
        experiments.1.units.i=kA
        experiments.1.inputs=["u"]
        model.fixed.drive.k=2
        title=A b"""
    study = Study.read(write(folder), [each.strip() for each in settings.splitlines()])
    assert study.parameters == {
        "R": Parameter(9.0, min=0.0, prior=Normal(4.1, 0.5)),
        "dR": Parameter(0.0, nominal=1.0, prior=Normal(0.5, 1.0), per_experiment=True),
        "drive.M": Parameter(90.0, max=100.0),
        "L": Parameter(0.2),
    }
    assert study.experiments[0].data == folder / "run2.csv"
    assert (study.experiments[1].units, study.experiments[1].inputs) == ({"i": "kA"}, {"u": "u"})
    assert (study.model.values["drive.k"], study.title) == (2, "A b")
    fixed = Study.read(write(folder), ["parameters.drive.M=9.5"])
    assert ("drive.M" in fixed.parameters, fixed.model.values["drive.M"]) == (False, 9.5)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("parameters.Q.start=9", "study.toml: parameters: unknown key 'Q'"),
        ("parameters.drive.N.start=9", "unknown key 'drive.N' (did you mean 'drive.M'?)"),
        ("parameters.R.strat=9", "with --set: parameters.R: unknown key 'strat'"),
        ("parameters.R.start=nine", 'with --set: parameters.R.start: must be a number, not "nine"'),
        ("experiments.2.warmup=1", "experiments.2 not found"),
        ("modle.step_size=1", "unknown key 'modle'"),
        ("title.x=1", "title is \"Coil\" and has no key 'x'"),
        ("noise.coloured=true", "noise: 'coloured' was dropped"),
        *((wrong, "no path=value") for wrong in ("parameters.R.start", "=3", "a..b=3", "a.=3")),
    ],
)
def test_override_refused(folder: Path, setting: str, said: str) -> None:
    with pytest.raises(InputError, match="--set") as refusal:
        Study.read(write(folder), [setting])
    assert said in str(refusal.value)


def test_override_asks_for_quotes_where_two_keys_fit_and_begins_sections() -> None:
    data: dict[str, Any] = {"parameters": {"a": {"b": 1}, "a.b": {"start": 2}}}
    with pytest.raises(InputError, match=r'Quote one of them, "a" or "a\.b"'):
        override(data, "parameters.a.b=3", "study.toml")
    override(data, 'parameters."a.b".start=3', "study.toml")
    override(data, "estimation.max_iterations=5", "study.toml")
    override(data, "model.fixed.L=0.1", "study.toml")
    assert data.pop("parameters") == {"a": {"b": 1}, "a.b": {"start": 3}}
    assert data == {"estimation": {"max_iterations": 5}, "model": {"fixed": {"L": 0.1}}}
