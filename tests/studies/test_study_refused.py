"""Studies that are refused, each by file, key and remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fmuid import InputError, Study
from fmuid.studies import schema_text
from fmuid.studies.renamed_keys import RENAMED_KEYS, RENAMED_VALUES
from tests.support.study_files import FULL, write

MODEL, METHOD, MORE = 'interface = "co-simulation"', '"levenberg-marquardt"', "[noise]"
JACOBIAN = 'jacobian = "finite-difference"'
REFUSED = [
    ('title = "Coil"', 'titel = "Coil"', "study.toml: unknown key 'titel' .*'title'"),
    ('inputs = ["u"]', 'input = ["u"]', r"experiments\[1\]|experiments\[0\]: unknown key 'input' .*'inputs'"),
    ("start = 95.0", "min = 95.0", 'parameters."drive.M": missing key \'start\''),
    ('data = "run2.csv"', "", r"experiments\[1\]: missing key 'data'"),
    ('outputs = ["i"]', "outputs = []", r"experiments\[1\]: no outputs"),
    ("run2.csv", "run3.csv", r"experiments\[1\].data: file .*run3.csv not found"),
    ("step_size = 1e-3", "step_size = 0", "model.step_size: must be a number above 0, not 0"),
    ('inputs = ["u"]', 'inputs = ["u", "u"]', "'u' is there twice"),
    ("n = 3", "n = 1979-05-27", "model.fixed.n: must be a number, true, false or a text, not 1979-05-27"),
    ("n = 3", "n = {}", "model.fixed.n: missing key 'result'"),
    ('u = "zoh"', 'u = "zho"', "\"zoh-next\" or \"pchip\" .*'zoh'.*, not \"zho\""),
    (METHOD, f"{METHOD}\nseed = 1", 'estimation.seed: needs method = "multi-start"'),
    (METHOD, '"differential-evolution"\nn_starts = 2', "estimation: .*starts.* 5"),
    (METHOD, '"multi-start"\nloss = "huber"', 'loss = "huber" and method = "multi-start" cannot be combined'),
    (JACOBIAN, 'loss = "huber"\n[uncertainty]\ncost_map = ["R", "drive.M"]', "and cost_map cannot be combined"),
    (MORE, '[uncertainty]\nprofile_likelihood = ["r"]\n[noise]', "profile_likelihood: unknown parameter 'r' .*'R'"),
    (MORE, '[uncertainty]\ncost_map = [["R", "dr[run1]"]]\n[noise]', "cost_map: unknown parameter .*'dR.run1.'"),
    (MORE, "[uncertainty]\nposterior = { burn_in = 500 }\n[noise]", "posterior.burn_in: must be .*from 0 to below 1"),
    ("start = 4.0, min = 0", "start = -4.0, min = 0", "parameters.R: start -4 .*outside"),
    ("start = 0.0, nominal = 1.0", "start = 0.0", "parameters.dR: start 0 .*nominal"),
    ('name = "second"', 'name = "run1"', r"experiments\[1\]: 'run1' is also the name of an earlier"),
    ("interface =", "components = []\ninterface =", "model.components: cannot be combined with fmu"),
    ('fmu = "sub/Coil.fmu"', "", "model: missing key 'fmu'"),
    ("warmup = 0.05", "warmup = 0.05\ntime = 0", r"experiments\[0\].time: must be a name, or a place from 1, not 0"),
    ('title = "Coil"', "title = Coil", "study.toml: not valid TOML: invalid value .at line 2, column 9.: title = Coil"),
    ('variance = "estimate"', "coloured = true", "noise: 'coloured' was dropped: .*Remove it"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "said"), REFUSED)
def test_refused(folder: Path, old: str, new: str, said: str) -> None:
    assert old in FULL
    with pytest.raises(InputError, match=said) as refusal:
        Study.read(write(folder, FULL.replace(old, new, 1)))
    assert str(refusal.value).startswith(str(folder / "study.toml"))


ENTRY = '[[model.components]]\nname = "a"\nfmu = "sub/Coil.fmu"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[model]\nfmu = "sub/Coil.fmu"', "no experiments"),
        ('[model]\nfmu = "sub/Coil.fmu"\n[experiments]\n', r"experiments: must be a list of sections \[\["),
        ("[model]\ncomponents = []", "model: no components"),
        (ENTRY + ENTRY, r"model.components\[1\].name: 'a' is also"),
        ("[" + "a." * 100_000 + "a]", "more than 100 parts"),  # which took minutes
        ("a = " + 5000 * "[", "nested too deeply"),
        ("a = " + 5000 * "1", "thousands of digits"),
    ],
)  # fmt: skip
def test_incomplete_or_unreadable(folder: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Study.read(write(folder, text))


def test_files_that_are_no_study(folder: Path) -> None:
    write(folder)
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name, said in (("studi.toml", "not found.*'study.toml'"), (".", "is a folder"), ("binary.toml", "not UTF-8")):
        with pytest.raises(InputError, match=said):
            Study.read(folder / name)


RENAMED = [
    ("", "estimator", "estimation"),
    ("model", "values", "fixed"),
    ("model.components", "samples", "discrete_time"),
    ("experiments", "discard", "warmup"),
    ("experiments.preprocess", "from", "start_time"),
    ("experiments.preprocess.park", "from", "source"),
    ("parameters.a", "values", "choices"),
    ("noise", "start", "initial_variance"),
    ("uncertainty", "level", "confidence_level"),
    ("uncertainty.posterior", "burn", "burn_in"),
    ("monitoring", "level", "false_alarm_rate"),
    ("diagnosis.causes.sensor_gain", "size", "change_std"),
    ("diagnosis.faults.a.angles.b", "size", "magnitude"),
    ("batch", "starts", "starting_points"),
    ("isolation", "recycle", "max_simulations_per_process"),
]


@pytest.mark.parametrize(("path", "old", "new"), RENAMED)
def test_renamed_key_is_refused_by_its_new_name(folder: Path, path: str, old: str, new: str) -> None:
    data: dict[str, Any] = {old: 1}
    for part in reversed(path.split(".") if path else ()):
        data = {part: [data] if part in ("components", "park") else data}
    if old != "discard" and "experiments" in data:
        data["experiments"] |= {"data": "run1.csv", "outputs": ["i"]}
    data |= {"experiments": [data["experiments"]]} if "experiments" in data else {}
    with pytest.raises(InputError, match=rf"study\.toml: .*'{old}' is now '{new}'\.$"):
        Study.of(data, folder / "study.toml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('u = "zoh"', 'u = "hold"', r'experiments\[0\].interpolation.u: "hold" is now "zoh"'),
        (METHOD, '"global"', 'method: "global" is now "multi-start" or "differential-evolution"'),
        (METHOD, f'{METHOD}\nsolver_check = "switch"', 'solver_check: "switch" is now "refine"'),
    ],
)
def test_renamed_value_is_refused_by_its_new_name(folder: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Study.read(write(folder, FULL.replace(old, new)))


def test_new_names_are_keys() -> None:
    known = schema_text()
    for table, marks in ((RENAMED_KEYS, '"{}": {{'), (RENAMED_VALUES, '"{}"')):
        assert [new for several in table.values() for new in several if marks.format(new) not in known] == []
