"""Studies that are refused, each in one sentence that names file and key."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fmuid.errors import InputError
from fmuid.studies.renamed_keys import RENAMED_KEYS, RENAMED_VALUES
from fmuid.studies.schema import reference
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
    "no table": ('data = "run2.csv"', "", "[experiments][1] needs the key 'data'"),
    "no outputs": ('outputs = ["i"]', "outputs = []", "[experiments][1] has no outputs"),
    "missing table": ("run2.csv", "run3.csv", 'data = "run3.csv": there is no file'),
    "missing fmu": ("sub/Coil.fmu", "Coil.fmu", 'fmu = "Coil.fmu": there is no file'),
    "text for a number": (
        "step_size = 1e-3",
        'step_size = "1e-3"',
        '[model] step_size must be a number above 0, not "1e-3"',
    ),
    "zero step": ("step_size = 1e-3", "step_size = 0", "[model] step_size must be a number above 0, not 0"),
    "bool for a number": (
        "warmup = 0.05",
        "warmup = true",
        "[experiments][0] warmup must be a number, 0 or above, not true",
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
        "[model.fixed] n must be a number, true, false or a text, not 1979-05-27",
    ),
    "empty value": ("n = 3", "n = {}", "[model.fixed.n] needs the key 'result': the result.json of an earlier"),
    "interpolation": (
        'u = "zoh"',
        'u = "zho"',
        '"zoh-next" or "pchip" (did you mean \'zoh\'?), not "zho"',
    ),
    "interface": (
        'interface = "co-simulation"',
        'interface = "modelexchange"',
        '[model] interface must be "co-simulation" or "model-exchange" (did you mean',
    ),
    "solver": (
        'interface = "co-simulation"',
        'solver = "rk5"',
        '[model] solver must be "rk4" or "rk45" or "cvode" (did you mean',
    ),
    "tolerance": (
        'interface = "co-simulation"',
        "tolerance = 2",
        "[model] tolerance must be a number between 0 and 1, not 2",
    ),
    "coupling": (
        'interface = "co-simulation"',
        'coupling = "gauss"',
        '[model] coupling must be "jacobi" or "gauss-seidel" (did you mean',
    ),
    "method": (
        '"levenberg-marquardt"',
        '"markwart"',
        '[estimation] method must be "levenberg-marquardt" or "multi-start" or "differential-evolution", not',
    ),
    "keys of a global search": (
        '"levenberg-marquardt"',
        '"levenberg-marquardt"\nseed = 1',
        '[estimation] has seed, which goes with method = "multi-start": choose that, or remove seed',
    ),
    "n_starts": (
        '"levenberg-marquardt"',
        '"multi-start"\nn_starts = 0',
        "[estimation] n_starts must be a whole number above 0, not 0",
    ),
    "few starts of an evolution": (
        '"levenberg-marquardt"',
        '"differential-evolution"\nn_starts = 2',
        "[estimation] is refused: starts of a global search must be a whole number from 5 on, not 2",
    ),
    "seed": (
        '"levenberg-marquardt"',
        '"multi-start"\nseed = -1',
        "[estimation] seed must be a whole number, 0 or above, not -1",
    ),
    "loss": (
        '"levenberg-marquardt"',
        '"levenberg-marquardt"\nloss = "hubr"',
        '"cauchy" (did you mean \'huber\'?), not "hubr"',
    ),
    "loss of a global search": (
        '"levenberg-marquardt"',
        '"multi-start"\nloss = "huber"',
        'has both loss = "huber" and method = "multi-start", which compares plain sums of squares in this version',
    ),
    "loss on a map": (
        'jacobian = "finite-difference"',
        'loss = "huber"\n[uncertainty]\ncost_map = ["R", "drive.M"]',
        'has both loss = "huber" and cost_map, which compares plain sums of squares in this version',
    ),
    "noise start": (
        '"estimate"',
        '"estimate"\ninitial_variance = 0',
        "[noise] initial_variance must be a number above 0, not 0",
    ),
    "level": (
        "[noise]",
        "[uncertainty]\nconfidence_level = 95\n[noise]",
        "confidence_level must be a number between 0 and 1, not 95",
    ),
    "profile": (
        "[noise]",
        '[uncertainty]\nprofile_likelihood = "R"\n[noise]',
        "profile_likelihood must be true (all parameters), false or a",
    ),
    "profile of what": (
        "[noise]",
        '[uncertainty]\nprofile_likelihood = ["r"]\n[noise]',
        "[uncertainty] profile_likelihood names 'r', which is no parameter of this study (did you mean",
    ),
    "map": ("[noise]", '[uncertainty]\ncost_map = ["R"]\n[noise]', "cost_map must be a list of pairs of parameters"),
    "map of what": (
        "[noise]",
        '[uncertainty]\ncost_map = [["R", "dr[second]"]]\n[noise]',
        "[uncertainty] cost_map names 'dr[second]', which is no parameter of this study (did you mean 'dR[second]'",
    ),
    "map of one": ("[noise]", '[uncertainty]\ncost_map = ["R", "R"]\n[noise]', "('R' is there with itself)"),
    "posterior": (
        "[noise]",
        "[uncertainty]\nposterior = 5\n[noise]",
        "[uncertainty.posterior] must be a table, not 5",
    ),
    "posterior key": (
        "[noise]",
        "[uncertainty]\nposterior = { step = 5 }\n[noise]",
        "[uncertainty.posterior] has no key 'step' (did you mean 'max_steps' or",
    ),
    "posterior burn": (
        "[noise]",
        "[uncertainty]\nposterior = { burn_in = 500 }\n[noise]",
        "[uncertainty.posterior] burn_in must be a number from 0 to below 1, not 500",
    ),
    "uncertainty key": (
        "[noise]",
        "[uncertainty]\nprofiles = true\n[noise]",
        "[uncertainty] has no key 'profiles' (did you mean 'profile_likelihood'?)",
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
        "warmup = 0.05",
        "warmup = 0.05\ntime = 0",
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


def renamed() -> Iterator[tuple[str, Any, str]]:
    """Yield each old key or value, the content of a study that has it, and what is said of it."""

    def content(path: str, inner: dict[str, Any]) -> dict[str, Any]:
        for part in reversed(path.split(".") if path else ()):
            inner = {"a" if part == "*" else part: [inner] if part in ("experiments", "components", "park") else inner}
        return inner

    for path, keys in RENAMED_KEYS.items():
        for old, new in keys.items():
            yield f"{path}.{old}", content(path, {old: 1}), f"{old} is now {new}"
    for path, keys in RENAMED_VALUES.items():
        section, _, key = path.rpartition(".")
        for old, new in keys.items():
            yield f"{path} {old}", content(section, {"a" if key == "*" else key: old}), f'= "{old}" is now "{new}"'


@pytest.mark.parametrize(("data", "said"), [pytest.param(*each[1:], id=each[0]) for each in renamed()])
def test_renamed_is_refused_by_its_new_name(data: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as refusal:
        Study.of(data, "study.toml")
    assert str(refusal.value).startswith("study.toml: ")
    assert str(refusal.value).endswith(said)


def test_new_names_are_keys() -> None:
    """What a refusal names is a key of that section, or a value that its key takes."""
    page = reference()
    for path, keys in RENAMED_KEYS.items():
        name = path.replace("causes.*", "causes.sensor_gain").replace("*", "<name>")
        head = re.search(rf"^## `\[+{re.escape(name)}\]+`$" if path else "^## The file$", page, re.MULTILINE)
        assert head, path
        section = page[head.end() :].split("\n## ")[0]
        assert [new for new in keys.values() if f"| `{new}` |" not in section and " " not in new] == []


def test_dropped_is_refused(folder: Path) -> None:
    text = FULL.replace('variance = "estimate"', "coloured = true")
    with pytest.raises(InputError, match=r"\[noise\] coloured has been dropped, remove it: confidence intervals"):
        Study.read(write(folder, text))
    with pytest.raises(InputError, match=r"with --set: \[noise\] coloured has been dropped"):
        Study.read(write(folder), ["noise.coloured=true"])
