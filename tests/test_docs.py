"""The pages in docs: what they show can be read, and what they point at is there."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import pytest

from fmuid.cases import Cases
from fmuid.isolation import FIRST_LIMIT, LEAST_LIMIT, SLOWER
from fmuid.study import Study

ROOT = Path(__file__).parents[1]
PAGES = [*sorted((ROOT / "docs").glob("*.md")), ROOT / "experiments" / "batches" / "README.md"]
MACHINE = ROOT / "experiments" / "induction_machine"


def blocks(page: str, kind: str) -> list[str]:
    """Return what stands in a page's blocks of a language."""
    return re.findall(rf"```{kind}\n(.*?)```", (ROOT / "docs" / page).read_text(encoding="utf-8"), re.DOTALL)


def study_of(more: str, folder: Path) -> Study:
    """Return the study of the induction machine, its table among others in a folder, with what a page adds."""
    (folder / "records").mkdir()
    for name in ("a.csv", "b.csv"):
        shutil.copy(MACHINE / "table.csv", folder / "records" / name)
    data = tomllib.loads((MACHINE / "study.toml").read_text(encoding="utf-8"))
    data["model"]["fmu"] = str((MACHINE / data["model"]["fmu"]).resolve())
    data["experiments"][0]["table"] = str(MACHINE / "table.csv")
    return Study.of(data | tomllib.loads(more), folder / "study.toml")


def test_the_batch_that_is_shown(tmp_path: Path) -> None:
    whole, _ = blocks("batches.md", "toml")
    cases = Cases.of(study_of(whole, tmp_path))
    # tables, Lm, Lf, subsets, starts, draws
    assert len(cases) == 2 * 3 * 5 * 2 * 20 * 100
    assert cases[0].settings["table"] == "a"


def test_the_sample_that_is_shown(tmp_path: Path) -> None:
    _, sample = blocks("batches.md", "toml")
    assert len(Cases.of(study_of(sample, tmp_path))) == 64


def test_the_isolation_that_is_shown(tmp_path: Path) -> None:
    (words,) = blocks("isolation.md", "toml")
    study_of(words, tmp_path)
    assert f"{SLOWER:g} times the longest so far, at least {LEAST_LIMIT:g} s; {FIRST_LIMIT:g} s before" in words


@pytest.mark.parametrize("code", [*blocks("clusters.md", "python"), *blocks("batches.md", "python")])
def test_scripts_are_python(code: str) -> None:
    compile(code, "page", "exec")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    assert targets
    inside = [target for target in targets if not target.startswith("https://")]
    assert not [target for target in inside if not (page.parent / target.partition("#")[0]).exists()]
