"""Results in whose files a value has another type: a line says so on each page, and other results are shown."""

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random

import pandas as pd
import pytest

from fmuid import FmuidError
from fmuid.apps.workbench import Folder
from fmuid.apps.workbench.home import _results, _studies
from fmuid.apps.workbench.pages import results as results_page
from fmuid.apps.workbench.pages.batch import BatchPage
from fmuid.apps.workbench.pages.study import StudyPage
from tests.support.begun_batch import batch, write_part
from tests.support.coil_study import STUDY
from tests.support.fuzz_spoil import with_changed_type
from tests.support.results import result
from tests.support.running import run_study
from tests.support.workbench import asked_for, bench_of, coil_study

SEEDS = 8


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("identified")
    study = coil_study(folder, STUDY.replace("R = {", "R = { prior = { mean = 4.5, std = 1.0 },"))
    run_study(study, folder / "results")
    (folder / "sound").mkdir()
    result(folder / "sound", {"R": (4.25, 0.1)})
    batch(folder / "out", 4)
    return folder


def first_page(folder: Path) -> str:
    studies, results = Folder(folder).look()
    return _studies(Folder(folder), studies, results, set()) + _results(Folder(folder), results)


def page_of_results(folder: Path, *names: str) -> str:
    doc = asked_for(*names)
    results_page.build(doc, bench_of(folder))
    return "".join(text for text, _ in doc.template_variables["pieces"])


def page_of_the_study(folder: Path) -> str:
    page = StudyPage(asked_for("study.toml"), bench_of(folder), isolated=False)
    page._newest.close()
    return str(page.identifying.text.text)


def page_of_the_batch(folder: Path) -> str:
    page = BatchPage(asked_for("out"), bench_of(folder))
    page.number.value = "3"
    return str(page.state.text)


PAGES: Mapping[str, Callable[[Path], str]] = {
    "first": first_page,
    "result": lambda folder: page_of_results(folder, "results"),
    "side by side": lambda folder: page_of_results(folder, "sound", "results"),
    "study": page_of_the_study,
    "batch": page_of_the_batch,
}
READ = {"results/result.json": PAGES.keys() - {"batch"}, "out/batch.json": {"first", "batch"}}


@pytest.mark.slow
@pytest.mark.parametrize("file", READ)
def test_pages_survive_changed_types(identified: Path, tmp_path: Path, file: str) -> None:
    folder = shutil.copytree(identified, tmp_path / "work")
    whole = json.loads((folder / file).read_text())
    for seed in range(SEEDS):
        content, what = with_changed_type(whole, Random(seed))
        (folder / file).write_text(json.dumps(content))
        for name in READ[file]:
            try:
                text = PAGES[name](folder)
            except FmuidError as error:
                assert file.split("/")[-1] in str(error), (name, what)
                assert name in ("result", "batch"), (name, what)  # other results stay visible
            else:
                assert "4.25 ± 0.10" in text or name != "side by side", what


def test_pages_name_the_value(identified: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(identified, tmp_path / "work")
    path = folder / "results/result.json"
    sound = json.loads(path.read_text())
    for key, value in (("parameters", [1]), ("assessment", "good")):
        path.write_text(json.dumps(sound | {key: value}))
        shown = first_page(folder)
        assert f"result.json: {key}" in shown
        assert "sound" in shown
        assert "PASSED" in page_of_results(folder, "results")
        assert "4.25 ± 0.10" in page_of_results(folder, "sound", "results")
        said = page_of_the_study(folder)
        damaged = key == "parameters"  # of the result itself
        assert ("class=error" in said, "PASSED" in said) == (damaged, not damaged)  # as the run has left it


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("case", "one", "case: not numeric"),
        ("value.R", "many", "value.R: not numeric"),
        ("status", None, "has no column status"),
    ],
)
def test_batch_page_shows_the_sound_rows(tmp_path: Path, column: str, value: str | None, said: str) -> None:
    batch(tmp_path / "out", 2)
    (sound,) = (tmp_path / "out/cases").iterdir()
    frame = pd.read_parquet(sound).assign(case=[2, 3])
    changed = frame.drop(columns=column) if value is None else frame.assign(**{column: value})
    write_part(tmp_path / "out", 3, changed)
    manifest = tmp_path / "out/batch.json"
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"truth": {"R": None}}))
    damaged = sound.with_name("part-000000009-0123456789ab.parquet")
    damaged.write_bytes(b"PAR1 no more")
    page = BatchPage(asked_for("out"), bench_of(tmp_path))
    assert list(page.frame["case"]) == [0, 1]
    assert page.drawn.children[0].name != "none"
    assert said in page.state.text
    assert f"{damaged.name}: damaged" in page.state.text
