"""Studies that are refused, each in one sentence that names file and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmuid.errors import InputError
from fmuid.studies.study import Study
from tests.support.study_files import FULL, write

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
    "retired key": (
        "[noise]",
        "[noise]\ncoloured = true",
        "[noise] has no key 'coloured' any more: leave it out, confidence intervals allow for colored noise without it",
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
    "place of a column": (
        "discard = 0.05",
        "discard = 0.05\ntime = 0",
        "[experiments][0] time must be a name, or a place from 1, not 0",
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
