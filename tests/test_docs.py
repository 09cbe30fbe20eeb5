"""The pages in docs: what they show can be read, what they point at is there, and what points at them is right."""

import ast
import math
import re
import shutil
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

from fmuid import Study
from fmuid.diagnosis.cause_ranking import SETTINGS as CAUSE_RANKING
from fmuid.diagnosis.unexplained_residual import SETTINGS as UNEXPLAINED_RESIDUAL
from fmuid.estimation.covariance import LIMITS
from fmuid.estimation.local_search import ROUNDS
from fmuid.estimation.noise.whiteness_tests import WhitenessSettings
from fmuid.estimation.search.state import STOPPING
from fmuid.estimation.simulation_noise import NOISE
from fmuid.identification import SAME_VARIANCE_RATIO
from fmuid.models import DEFAULT_TOLERANCE
from fmuid.reports.publish import KINDS
from fmuid.runs import CaseList
from fmuid.simulation import TIME_LIMITS
from fmuid.simulation.plan_builder import LINEAR_SUBSTEPS
from tests.support.docs_rows import blocks, rows
from tests.support.paths import ROOT

FOLDERS = ("docs", "experiments", "fmuid", "fmus", "tests")
PAGES = [ROOT / "README.md", *sorted(page for folder in FOLDERS for page in (ROOT / folder).rglob("*.md"))]
SOURCES = sorted(source for folder in FOLDERS for source in (ROOT / folder).rglob("*.py"))
METHOD = "\n".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs" / "method").glob("*.md")))
MACHINE = ROOT / "experiments" / "induction_machine"


def study_of(more: str, folder: Path) -> Study:
    """Return the study of the induction machine, its table among others in a folder, with what a page adds."""
    (folder / "records").mkdir(exist_ok=True)
    for name in ("a.csv", "b.csv"):
        shutil.copy(MACHINE / "table.csv", folder / "records" / name)
    data = tomllib.loads((MACHINE / "study.toml").read_text(encoding="utf-8"))
    data["model"]["fmu"] = str((MACHINE / data["model"]["fmu"]).resolve())
    data["experiments"][0]["data"] = str(MACHINE / "table.csv")
    return Study.of(data | tomllib.loads(more), folder / "study.toml")


def test_the_batches_that_are_shown(tmp_path: Path) -> None:
    whole, sample = (CaseList.of(study_of(text, tmp_path)) for text in blocks("batches.md", "toml"))
    assert len(whole) == 2 * 3 * 5 * 2 * 20 * 100  # data, Lm, Lf, free parameters, starting points, realizations
    assert whole[0].settings["table"] == "a"
    assert len(sample) == 64


def test_the_isolation_that_is_shown(tmp_path: Path) -> None:
    (text,) = blocks("isolation-limits.md", "toml")
    study_of(text, tmp_path)
    limits = TIME_LIMITS
    assert f"{limits.slower:g} times the longest so far, at least {limits.least:g} s; {limits.first:g} s before" in text


def test_scripts_are_python() -> None:
    for page in ("batches.md", "clusters.md", "report.md", "study-file.md", "validation.md"):
        for code in blocks(page, "python"):
            compile(code, page, "exec")


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        for target in re.findall(r"\]\((?!https://)([^)]+)\)", text):
            path, _, anchor = target.partition("#")
            there = page.parent / path if path else page
            assert there.exists(), (page, target)
            assert not anchor or anchor in anchors(there), (page, target)


def test_the_numbers_of_the_method() -> None:
    text = " ".join(METHOD.split())
    for words in (
        f"still gain is less than $10^{{{math.log10(STOPPING.offset):.0f}}}$ of the parameters' standard deviations",
        f"a table of differences at {('six', 'seven', 'eight')[NOISE.points - 6]} neighboring points",
        f"Beyond {LIMITS.weak_std:.0%} the direction is weakly identifiable".replace("%", " %"),
        f"Beyond {LIMITS.lost_std:.0%} it is practically non-identifiable".replace("%", " %"),
        f"relative tolerance $10^{{{math.log10(DEFAULT_TOLERANCE):.0f}}}$",
        f"until none moves by more than {ROUNDS.variance_change:.0%}".replace("%", " %"),
        f"a difference of less than {SAME_VARIANCE_RATIO - 1.0:.0%} is ignored".replace("%", " %"),
        f"all within {CAUSE_RANKING.odds:g} : 1 are named",
        f"over up to {WhitenessSettings().tested_lags} lags",
        "divided in ten" if LINEAR_SUBSTEPS == 10 else "",
        "tested at a tenth of the level" if UNEXPLAINED_RESIDUAL.level_share == 0.1 else "",
    ):
        assert words
        assert words in text


def test_formulas_can_be_shown() -> None:
    """GitHub reads Markdown in formulas between dollars first: escapes, emphasis, words right after the last dollar."""
    outside = re.sub(r"^ *```.*?^ *```", "", METHOD, flags=re.DOTALL | re.MULTILINE)
    assert not re.search(r"\$\$|\\operatorname", METHOD)
    for line in re.sub(r"`[^`]*`", "", outside).splitlines():
        assert line.count("$") % 2 == 0, line
        for formula, after in re.findall(r"\$([^$]*)\$(.?)", line):
            assert not re.search(r"\\[^A-Za-z]|\}_|\*|^ | $", formula), formula
            assert not re.match(r"\w", after), line


# --- what is cited -----------------------------------------------------------------------

NUMBER = r"1\.\d{1,2}(?!\d)"
CITATION = re.compile(rf"\(({NUMBER}(?:(?:–|, ){NUMBER})*)\)")
# What a number in parentheses after these words has to be, of the chapter's.
NAMED = {
    r"prior rows W\(θ₀ − θ\) of": {"1.37"},
    r"Marquardt's (?:search for the least sum of squares|steps)": {"1.16"},
    r"natural equations": {"1.58"},
}


def prose(source: Path) -> Iterator[str]:
    """Yield the docstrings and comments of a file, each in one line; to parse all files would take seconds."""
    text = source.read_text(encoding="utf-8")
    for found in re.finditer(r'(^ *)?"""(.*?)"""', text, re.DOTALL | re.MULTILINE):
        if found[1] is not None:  # no text that is assigned
            yield " ".join(found[2].split())
    yield from re.findall("#.*", text)


@cache
def cited() -> tuple[tuple[Path, str], ...]:
    """Return the texts that may cite, each with its file."""
    found = [(source, text) for source in SOURCES for text in prose(source)]
    return *found, *((page, " ".join(page.read_text(encoding="utf-8").split())) for page in PAGES)


def expanded(citation: str) -> set[str]:
    """Return the numbers of ``1.26, 1.27`` or ``1.63–1.65``."""
    found = set()
    for part in re.split("[,;]", citation):
        first, _, last = part.strip().partition("–")
        found |= {f"1.{k}" for k in range(int(first[2:]), int((last or first)[2:]) + 1)}
    return found


def test_equations_that_are_cited_are_explained() -> None:
    index = (ROOT / "docs" / "method" / "equations.md").read_text(encoding="utf-8")
    known = {number for row in re.findall(rf"{NUMBER}(?:–{NUMBER})?", index) for number in expanded(row)}
    assert known == {f"1.{k}" for k in range(1, 81)}
    body = {number for each in CITATION.findall(METHOD) for number in expanded(each)}
    body |= set(re.findall(rf"\\tag{{({NUMBER})}}", METHOD))
    assert known - body == set()
    numbers = {(file, number) for file, text in cited() for each in CITATION.findall(text) for number in expanded(each)}
    assert len(numbers) > 50
    assert sorted((file, number) for file, number in numbers if number not in known) == []


def test_equations_are_what_they_are_cited_for() -> None:
    for words, numbers in NAMED.items():
        found = [(file, each) for file, text in cited() for each in re.findall(rf"{words} {CITATION.pattern}", text)]
        assert found
        assert [(file, each) for file, each in found if not expanded(each) <= numbers] == []


def test_pages_that_are_cited_are_there() -> None:
    for file, text in cited():
        for page in re.findall(r"[\w./-]+\.md\b", text):
            assert any((folder / page).exists() for folder in (ROOT, file.parent)), (file, page)


def test_what_is_named_in_python_is_there() -> None:
    for page in PAGES:
        for name in set(re.findall(r"`(fmuid(?:\.\w+)+)[`(]", page.read_text(encoding="utf-8"))):
            resolve_name(name)  # raises ImportError or AttributeError


def test_each_figure_says_how_it_is_read() -> None:
    """The names on the page are those that a report can draw, each of them and no other; a new run clears them all."""
    cells = [names for page in ("figures.md", "figures-diagnosis.md") for names, *_ in rows(page, 4)]
    said = {name for names in cells for name in re.findall(r"`(\w+)`", names)}
    assert said == set(KINDS)
    for module in (ROOT / "fmuid" / "reports" / "topics").glob("*.py"):
        calls = [node for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        made = [node for node in calls if isinstance(node.func, ast.Name) and node.func.id == "Section"]
        drawn = [node for node in made if len(node.args) > 4 or any(each.arg == "charts" for each in node.keywords)]
        assert {str(node.args[0].value) for node in drawn if isinstance(node.args[0], ast.Constant)} <= said
