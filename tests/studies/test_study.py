"""Study files: every key, every refusal in one sentence, overrides."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from fmuid.assessment.sampling.posterior import Sampling
from fmuid.assessment.uncertainty import UncertaintySettings
from fmuid.data.noise import Noise
from fmuid.data.parameters import Normal, Parameter
from fmuid.errors import InputError
from fmuid.estimation import GlobalSearch
from fmuid.estimation.method import Marquardt, Method
from fmuid.models.component import Numerics
from fmuid.studies.overrides import override
from fmuid.studies.study import Study
from fmuid.studies.toml import show

FULL = """
title = "Coil"

[model]
fmu = "sub/Coil.fmu"
interface = "co-simulation"
step_size = 1e-3

[model.values]
L = 0.1
n = 3
on = true
word = "fast"

[[experiments]]
table = "run1.csv"
inputs = ["u"]
outputs = { i = "current" }
interpolation = { u = "hold" }
discard = 0.05
units = { i = "mA" }

[[experiments]]
name = "second"
table = "run2.csv"
time = "t"
outputs = ["i"]

[parameters]
R = { start = 4.0, min = 0, prior = { mean = 4.1, std = 0.2 } }
dR = { start = 0.0, nominal = 1.0, max = inf, per_experiment = true }
"drive.M" = { start = 95.0 }

[noise]
variance = "estimate"

[estimator]
method = "marquardt"
sensitivity = "finite-difference"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the files that `FULL` names; their content is not read with the study."""
    (tmp_path / "sub").mkdir()
    for name in ("sub/Coil.fmu", "run1.csv", "run2.csv"):
        (tmp_path / name).write_text("")
    return tmp_path


def write(folder: Path, text: str = FULL) -> Path:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_key(folder: Path) -> None:
    study = Study.read(write(folder))
    assert study.title == "Coil"
    assert study.model.numerics == Numerics("co-simulation", step_size=1e-3)
    assert study.model.components == {"": (folder / "sub/Coil.fmu", study.model.numerics)}
    assert study.model.values == {"L": 0.1, "n": 3, "on": True, "word": "fast"}
    first, second = study.experiments
    assert (first.table, first.name, first.time) == (folder / "run1.csv", "run1", "time")
    assert (first.inputs, first.outputs) == ({"u": "u"}, {"i": "current"})
    assert (first.interpolation, first.discard, first.units) == ({"u": "hold"}, 0.05, {"i": "mA"})
    assert (second.name, second.time, second.inputs, second.outputs) == ("second", "t", {}, {"i": "i"})
    assert (second.interpolation, second.discard) == ("linear", 0.0)
    assert study.parameters == {
        "R": Parameter(4.0, min=0.0, prior=Normal(4.1, 0.2)),
        "dR": Parameter(0.0, max=math.inf, nominal=1.0, per_experiment=True),
        "drive.M": Parameter(95.0),
    }


def test_estimators(folder: Path) -> None:
    def estimator(words: str) -> Method:
        return Study.read(write(folder, FULL.replace('method = "marquardt"', words))).estimator

    assert estimator("max_iterations = 7") == Marquardt(max_iterations=7)
    assert estimator('method = "global"') == GlobalSearch("evolution")
    assert estimator("starts = 20\nseed = 4") == GlobalSearch("multistart", 20, 4)
    assert estimator('search = "multistart"') == GlobalSearch("multistart")
    assert estimator('search = "evolution"\nstarts = 20\ntolerance = 1e-4') == GlobalSearch(
        "evolution", 20, marquardt=Marquardt(tolerance=1e-4)
    )
    study = Study.read(write(folder, FULL.replace('"marquardt"', '"marquardt"\nloss = "cauchy"')))
    assert (study.loss, study.estimator.marquardt) == ("cauchy", Marquardt())


def test_noise(folder: Path) -> None:
    text = FULL.replace('variance = "estimate"', "variance = { i = 0.04 }\nstart = { i = 1.0 }")
    assert Study.read(write(folder, text)).noise == Noise({"i": 0.04}, {"i": 1.0})
    text = FULL.replace('variance = "estimate"', "start = 2")
    assert Study.read(write(folder, text)).noise == Noise("estimate", 2.0)
    own = 'outputs = ["i"]\nnoise = { weights = { i = "w" } }'
    text = FULL.replace('variance = "estimate"', 'common = ["i"]').replace('outputs = ["i"]', own)
    assert Study.read(write(folder, text)).noise == Noise(
        common=["i"], experiments={"second": Noise(weights={"i": "w"})}
    )
    for words, noise in (
        ('std = { i = "sd" }', Noise(std={"i": "sd"})),
        ("std = 0.2", Noise(std=0.2)),
        ("relative = 0.01", Noise(relative=0.01)),
        ('weights = "w"', Noise(weights="w")),
    ):
        assert Study.read(write(folder, FULL.replace('variance = "estimate"', words))).noise == noise


def test_uncertainty_words(folder: Path) -> None:
    def asked(words: str) -> UncertaintySettings:
        return Study.read(write(folder, FULL + f"[uncertainty]\n{words}")).uncertainty_settings

    assert not Study.read(write(folder)).uncertainty_settings.any
    assert not asked("profile = false\nposterior = false\nmap = []").any
    assert asked("profile = true").profile == ("R", "dR[run1]", "dR[second]", "drive.M")
    assert asked('profile = ["dR[run1]", "R", "R"]').profile == ("dR[run1]", "R")
    assert asked('level = 0.9\nmap = [["R", "drive.M"], ["R", "dR[run1]"]]') == UncertaintySettings(
        0.9, maps=(("R", "drive.M"), ("R", "dR[run1]"))
    )
    assert asked('map = ["R", "drive.M"]').maps == (("R", "drive.M"),)
    assert asked("posterior = true").posterior == Sampling()
    assert asked("posterior = { walkers = 32, steps = 2000, burn = 0.5, seed = 3 }").posterior == Sampling(
        32, 2000, burn=0.5, seed=3
    )


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
integrator = "rk4"
step_size = 1e-2
[model.connectors]
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
table = "run1.csv"
outputs = ["drive.q"]
"""
    model = Study.read(write(folder, text)).model
    assert {name: numerics for name, (_, numerics) in model.components.items()} == {
        "drive": Numerics(),
        "controller": Numerics("model-exchange", "rk4", step_size=1e-2),
    }
    assert model.numerics == Numerics(step_size=1e-3)
    assert model.connectors == {"R": ("drive.R", "controller.R"), "u": ("drive.u",)}
    assert model.connections == (("drive.q", "controller.q"), ("controller.u", "drive.u", 60.0, 0.0))


REFUSED = {
    "key at the top": (
        'title = "Coil"',
        'titel = "Coil"',
        "study.toml: the file has no key 'titel' (did you mean 'title'?)",
    ),
    "key in a list": (
        'inputs = ["u"]',
        'input = ["u"]',
        "[experiments][0] has no key 'input' (did you mean 'inputs' or",
    ),
    "key of a parameter": ("start = 4.0", "strat = 4.0", "[parameters.R] has no key 'strat' (did you mean 'start'?)"),
    "key of a quoted parameter": ("start = 95.0", "begin = 95.0", "[parameters.\"drive.M\"] has no key 'begin'"),
    "key of a prior": ("std = 0.2", "sdt = 0.2", "[parameters.R.prior] has no key 'sdt' (did you mean 'std'?)"),
    "no start": ("start = 95.0", "min = 95.0", "[parameters.\"drive.M\"] needs the key 'start'"),
    "no table": ('table = "run2.csv"', "", "[experiments][1] needs the key 'table'"),
    "no outputs": ('outputs = ["i"]', "outputs = []", "[experiments][1] has no outputs"),
    "missing table": ("run2.csv", "run3.csv", 'table = "run3.csv": there is no file'),
    "missing fmu": ("sub/Coil.fmu", "Coil.fmu", 'fmu = "Coil.fmu": there is no file'),
    "text for a number": (
        "step_size = 1e-3",
        'step_size = "1e-3"',
        '[model] step_size must be a number above 0, not "1e-3"',
    ),
    "zero step": ("step_size = 1e-3", "step_size = 0", "[model] step_size must be a number above 0, not 0"),
    "bool for a number": (
        "discard = 0.05",
        "discard = true",
        "[experiments][0] discard must be a number, 0 or above, not true",
    ),
    "nan": ("start = 95.0", "start = nan", "start must be a number, not nan"),
    "number for a text": ('title = "Coil"', "title = 5", "study.toml: title must be a text in quotes, not 5"),
    "number for a flag": ("per_experiment = true", "per_experiment = 1", "per_experiment must be true or false, not 1"),
    "number for a parameter": ('"drive.M" = { start = 95.0 }', "x = 95.0", "[parameters.x] must be a table, not 95.0"),
    "text for names": ('inputs = ["u"]', 'inputs = "u"', 'inputs must be a list of names, ["u", "w"], or a table'),
    "name twice": ('inputs = ["u"]', 'inputs = ["u", "u"]', "names each variable once ('u' is there twice)"),
    "date in values": (
        "n = 3",
        "n = 1979-05-27",
        "[model.values] n must be a number, true, false or a text, not 1979-05-27",
    ),
    "empty value": ("n = 3", "n = {}", "[model.values.n] needs the key 'result': the result.json of an earlier"),
    "interpolation": (
        'u = "hold"',
        'u = "holds"',
        '"hold-previous" or "cubic" (did you mean \'hold\' or \'hold-previous\'?), not "holds"',
    ),
    "interface": (
        'interface = "co-simulation"',
        'interface = "modelexchange"',
        '[model] interface must be "co-simulation" or "model-exchange" (did you mean',
    ),
    "integrator": (
        'interface = "co-simulation"',
        'integrator = "rk5"',
        '[model] integrator must be "rk4" or "rk45" or "cvode" (did you mean',
    ),
    "tolerance": (
        'interface = "co-simulation"',
        "tolerance = 2",
        "[model] tolerance must be a number between 0 and 1, not 2",
    ),
    "master": (
        'interface = "co-simulation"',
        'master = "gauss"',
        '[model] master must be "jacobi" or "gauss-seidel" (did you mean',
    ),
    "method later": (
        '"marquardt"',
        '"linear"',
        '[estimator] method must be "marquardt" or "global" in this version, not "linear"',
    ),
    "method": (
        '"marquardt"',
        '"markwart"',
        '[estimator] method must be "marquardt" or "global" (did you mean \'marquardt\'?)',
    ),
    "words of a global search": (
        '"marquardt"',
        '"marquardt"\nseed = 1',
        '[estimator] has seed, which goes with method = "global": choose that, or remove seed',
    ),
    "search": (
        '"marquardt"',
        '"global"\nsearch = "evolve"',
        '[estimator] search must be "multistart" or "evolution" (did you mean \'evolution\'?)',
    ),
    "starts": ('"marquardt"', '"global"\nstarts = 0', "[estimator] starts must be a whole number above 0, not 0"),
    "few starts of an evolution": (
        '"marquardt"',
        '"global"\nstarts = 2\nsearch = "evolution"',
        "[estimator] is refused: starts of a global search must be a whole number from 5 on, not 2",
    ),
    "seed": ('"marquardt"', '"global"\nseed = -1', "[estimator] seed must be a whole number, 0 or above, not -1"),
    "loss": (
        '"marquardt"',
        '"marquardt"\nloss = "hubr"',
        '"cauchy" (did you mean \'huber\'?), not "hubr"',
    ),
    "loss of a global search": (
        '"marquardt"',
        '"global"\nloss = "huber"',
        'has both loss = "huber" and method = "global", which compares plain sums of squares in this version',
    ),
    "loss on a map": (
        'sensitivity = "finite-difference"',
        'loss = "huber"\n[uncertainty]\nmap = ["R", "drive.M"]',
        'has both loss = "huber" and map, which compares plain sums of squares in this version',
    ),
    "noise start": ('"estimate"', '"estimate"\nstart = 0', "[noise] start must be a number above 0, not 0"),
    "level": ("[noise]", "[uncertainty]\nlevel = 95\n[noise]", "level must be a number between 0 and 1, not 95"),
    "profile": (
        "[noise]",
        '[uncertainty]\nprofile = "R"\n[noise]',
        "profile must be true (all parameters), false or a",
    ),
    "profile of what": (
        "[noise]",
        '[uncertainty]\nprofile = ["r"]\n[noise]',
        "[uncertainty] profile names 'r', which is no parameter of this study (did you mean",
    ),
    "map": ("[noise]", '[uncertainty]\nmap = ["R"]\n[noise]', "map must be a list of pairs of parameters"),
    "map of what": (
        "[noise]",
        '[uncertainty]\nmap = [["R", "dr[second]"]]\n[noise]',
        "[uncertainty] map names 'dr[second]', which is no parameter of this study (did you mean 'dR[second]'",
    ),
    "map of one": ("[noise]", '[uncertainty]\nmap = ["R", "R"]\n[noise]', "('R' is there with itself)"),
    "posterior": (
        "[noise]",
        "[uncertainty]\nposterior = 5\n[noise]",
        "[uncertainty.posterior] must be a table, not 5",
    ),
    "posterior key": (
        "[noise]",
        "[uncertainty]\nposterior = { step = 5 }\n[noise]",
        "[uncertainty.posterior] has no key 'step' (did you mean 'steps' or",
    ),
    "posterior burn": (
        "[noise]",
        "[uncertainty]\nposterior = { burn = 500 }\n[noise]",
        "[uncertainty.posterior] is refused: the setting burn of the sampler must be a share",
    ),
    "uncertainty key": (
        "[noise]",
        "[uncertainty]\nprofiles = true\n[noise]",
        "[uncertainty] has no key 'profiles' (did you mean 'profile'?)",
    ),
    "outside bounds": (
        "start = 4.0, min = 0",
        "start = -4.0, min = 0",
        "[parameters.R]: start -4 lies outside its bounds",
    ),
    "zero start": (
        "start = 0.0, nominal = 1.0",
        "start = 0.0",
        "[parameters.dR]: start 0 has no magnitude; give nominal",
    ),
    "same name": ('name = "second"', 'name = "run1"', "[experiments][1] is called 'run1' like an earlier one"),
    "both": (
        "interface =",
        "components = []\ninterface =",
        "[model] has both 'fmu' (one FMU) and components (of several)",
    ),
    "no model": (
        'fmu = "sub/Coil.fmu"',
        "",
        "[model] needs the key 'fmu', the path of the FMU, or [[model.components]]",
    ),
    "syntax": ('title = "Coil"', "title = Coil", "study.toml is not valid TOML: invalid value (at line 2, column 9)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(folder: Path, case: str) -> None:
    old, new, sentence = REFUSED[case]
    assert old in FULL
    with pytest.raises(InputError) as refusal:
        Study.read(write(folder, FULL.replace(old, new, 1)))
    assert sentence in str(refusal.value)
    assert str(refusal.value).startswith(str(folder / "study.toml"))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "[model] needs the key 'fmu'"),
        ('[model]\nfmu = "sub/Coil.fmu"', "has no experiments"),
        ('[model]\nfmu = "sub/Coil.fmu"\n[experiments]\n', "must be a list of tables, each begun with [[experiments]]"),
        ('model = "sub/Coil.fmu"', "[model] must be a table, not \"sub/Coil.fmu\""),
        ("[model]\ncomponents = []", "[model] has no components"),
    ],
)  # fmt: skip
def test_incomplete(folder: Path, text: str, sentence: str) -> None:
    with pytest.raises(InputError) as refusal:
        Study.read(write(folder, text))
    assert sentence in str(refusal.value)


def test_component_named_twice(folder: Path) -> None:
    entry = '[[model.components]]\nname = "a"\nfmu = "sub/Coil.fmu"\n'
    with pytest.raises(InputError, match=r"\[model.components\]\[1\] has the name 'a' of an earlier component"):
        Study.read(write(folder, entry + entry))


def test_files_that_are_no_study(folder: Path) -> None:
    write(folder)
    with pytest.raises(InputError, match=r"studi\.toml: there is no such study file \(did you mean 'study\.toml'\?\)"):
        Study.read(folder / "studi.toml")
    with pytest.raises(InputError, match="is a folder, not a study file"):
        Study.read(folder)
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8 text"):
        Study.read(folder / "binary.toml")


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
            f"experiments.0.table={folder / 'run2.csv'}",
            "experiments.1.units.i=kA",
            "experiments.1.inputs=[\"u\"]",
            "model.values.drive.k=2",
            "title=A b",
        ],
    )  # fmt: skip
    assert study.parameters == {
        "R": Parameter(9.0, min=0.0, prior=Normal(4.1, 0.5)),
        "dR": Parameter(0.0, nominal=1.0, prior=Normal(0.5, 1.0), per_experiment=True),
        "drive.M": Parameter(90.0, max=100.0),
        "L": Parameter(0.2),
    }
    assert study.experiments[0].table == folder / "run2.csv"
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
        ("experiments.2.discard=1", "has no experiments.2: the entries of experiments are numbered 0 to 1"),
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
    override(data, "estimator.max_iterations=5", "study.toml")
    override(data, "model.values.L=0.1", "study.toml")
    assert data == {"estimator": {"max_iterations": 5}, "model": {"values": {"L": 0.1}}}


def test_show() -> None:
    values: list[object] = ["ü", True, 1.5, [1, "a"], [1] * 9, {}]
    assert [show(value) for value in values] == ['"ü"', "true", "1.5", '[1, "a"]', "a list", "a table"]


def test_forward_sensitivities_of_a_study(folder: Path) -> None:
    """Model exchange and forward sensitivities are words of the file."""
    text = FULL.replace('interface = "co-simulation"', 'interface = "model-exchange"')
    for word in ("finite-difference", "forward"):
        study = Study.read(write(folder, text.replace('sensitivity = "finite-difference"', f'sensitivity = "{word}"')))
        assert study.sensitivity == word
        assert study.model.numerics.interface == "model-exchange"
