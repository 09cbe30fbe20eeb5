"""A study file: sections to objects, overrides by --set."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

import fmuid
from fmuid import GlobalSearch, InputError, Marquardt, Noise, Normal, Numerics, Parameter, Study
from fmuid.estimation import Method
from fmuid.identification import AssessmentSettings, SamplerSettings
from fmuid.studies import override
from tests.support.study_files import FULL, write

METHOD = 'method = "levenberg-marquardt"'


def test_every_key(folder: Path) -> None:
    study = Study.read(write(folder))
    assert study.title == "Coil"
    assert study.model.section.numerics == Numerics("co-simulation", step_size=1e-3)
    assert study.model.components == {"": (folder / "sub/Coil.fmu", study.model.section.numerics)}
    assert study.model.values == {"L": 0.1, "n": 3, "on": True, "word": "fast"}
    first, second = study.experiments
    assert (first.data, first.name, first.time) == (folder / "run1.csv", "run1", "time")
    assert (first.inputs, first.outputs) == ({"u": "u"}, {"i": "current"})
    assert (first.interpolation, first.warmup, first.units) == ({"u": "zoh"}, 0.05, {"i": "mA"})
    assert (second.name, second.time, second.inputs, second.outputs) == ("second", "t", {}, {"i": "i"})
    assert (second.interpolation, second.warmup) == ("linear", 0.0)
    assert study.parameters == {
        "R": Parameter(4.0, min=0.0, prior=Normal(4.1, 0.2)),
        "dR": Parameter(0.0, max=math.inf, nominal=1.0, per_experiment=True),
        "drive.M": Parameter(95.0),
    }
    assert repr(study) == "Study('Coil': run1, second; R, dR, drive.M)"
    assert study.files() == tuple(folder / name for name in ("sub/Coil.fmu", "run1.csv", "run2.csv"))
    assert not study.uncertainty_settings.explores


EVOLUTION = 'method = "differential-evolution"'


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("max_iterations = 7", Marquardt(max_iterations=7)),
        (EVOLUTION, GlobalSearch("differential-evolution")),
        ("n_starts = 20\nseed = 4", GlobalSearch("multi-start", 20, 4)),
        ('method = "multi-start"', GlobalSearch("multi-start")),
        (
            f"{EVOLUTION}\nn_starts = 20\nrelative_step_tolerance = 1e-4",
            GlobalSearch("differential-evolution", 20, marquardt=Marquardt(tolerance=1e-4)),
        ),
    ],
)
def test_estimators(folder: Path, keys: str, expected: Method) -> None:
    assert Study.read(write(folder, FULL.replace(METHOD, keys))).estimator == expected


@pytest.mark.parametrize(
    ("keys", "noise"),
    [
        ("variance = { i = 0.04 }\ninitial_variance = { i = 1.0 }", Noise({"i": 0.04}, {"i": 1.0})),
        ('shared_variance = ["i"]', Noise(shared_variance=["i"])),
        ('std = { i = "sd" }', Noise(std={"i": "sd"})),
        ('weights = "w"', Noise(weights="w")),
    ],
)
def test_noise(folder: Path, keys: str, noise: Noise) -> None:
    assert Study.read(write(folder, FULL.replace('variance = "estimate"', keys))).noise == noise


def test_noise_of_an_experiment_and_keys_of_the_estimation(folder: Path) -> None:
    text = FULL.replace('outputs = ["i"]', 'outputs = ["i"]\nnoise = { weights = { i = "w" } }')
    text = text.replace(METHOD, f'{METHOD}\nloss = "cauchy"').replace("finite-difference", "forward")
    study = Study.read(write(folder, text))
    assert study.noise == Noise(experiments={"second": Noise(weights={"i": "w"})})
    assert (study.estimation.loss, study.estimation.jacobian) == ("cauchy", "forward")


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("profile_likelihood = true", AssessmentSettings(profile=("R", "dR[run1]", "dR[second]", "drive.M"))),
        ('profile_likelihood = ["dR[run1]", "R", "R"]', AssessmentSettings(profile=("dR[run1]", "R"))),
        (
            'confidence_level = 0.9\ncost_map = [["R", "drive.M"], ["R", "dR[run1]"]]',
            AssessmentSettings(0.9, maps=(("R", "drive.M"), ("R", "dR[run1]"))),
        ),
        ('cost_map = ["R", "drive.M"]', AssessmentSettings(maps=(("R", "drive.M"),))),
        ("posterior = true", AssessmentSettings(posterior=SamplerSettings())),
        (
            "posterior = { walkers = 32, max_steps = 2000, burn_in = 0.5, seed = 3 }",
            AssessmentSettings(posterior=SamplerSettings(32, 2000, burn_in=0.5, seed=3)),
        ),
    ],
)
def test_uncertainty(folder: Path, keys: str, expected: AssessmentSettings) -> None:
    assert Study.read(write(folder, FULL + f"[uncertainty]\n{keys}")).uncertainty_settings == expected


def test_components(folder: Path) -> None:
    text = """
[model]
step_size = 1e-3
[[model.components]]
name = "drive"
fmu = "sub/Coil.fmu"
[[model.components]]
name = "controller"
fmu = "sub/Coil.fmu"
interface = "model-exchange"
solver = "rk4"
step_size = 1e-2
[model.shared_variables]
R = ["drive.R", "controller.R"]
u = "drive.u"
[[model.connections]]
from = "drive.q"
to = "controller.q"
[[model.connections]]
from = "controller.u"
to = "drive.u"
factor = 60
[[experiments]]
data = "run1.csv"
outputs = ["drive.q"]
"""
    model = Study.read(write(folder, text)).model
    assert {name: numerics for name, (_, numerics) in model.components.items()} == {
        "drive": Numerics(),
        "controller": Numerics("model-exchange", "rk4", step_size=1e-2),
    }
    assert model.section.numerics == Numerics(step_size=1e-3)
    assert model.section.shared_variables == {"R": ["drive.R", "controller.R"], "u": ["drive.u"]}
    connections = [each.connection for each in model.section.connections]
    assert connections == [("drive.q", "controller.q"), ("controller.u", "drive.u", 60.0, 0.0)]


def test_uncertainty_of_a_result(tmp_path: Path) -> None:
    """A coil is nearly linear in R: the profile ends where the local interval does; another study refuses it."""
    coil = fmuid.datasets.coil()
    asked = coil.study | {"uncertainty": {"profile_likelihood": ["R"]}}
    study = Study.of(asked, tmp_path / "coil.toml")
    result = study.identify()
    (profile,) = study.assess(result).profiles
    local = result.intervals(0.95).loc["R"].to_numpy(float)
    assert [profile.lower, profile.upper] == pytest.approx(local, abs=0.005 * (local[1] - local[0]))
    other = Study.of(asked | {"parameters": {"R": {"start": 3.0}}}, tmp_path / "other.toml")
    with pytest.raises(InputError, match="parameters are R, L, not R"):
        other.assess(result)


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
