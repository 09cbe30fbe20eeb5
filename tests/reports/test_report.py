"""The report: what it says of an identification, and that a browser runs nothing but its own scripts."""

import base64
import gzip
import hashlib
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import pytest

import fmuid
from fmuid.apps.cli.options import DONE, WRONG_INPUT
from fmuid.reports.render.document_json import DOCUMENT_FILE
from tests.support.coil_study import STUDY, coil_table, fmuid_, result

# A report is no larger than this, bytes.
SMALL = 700_000


class Page(HTMLParser):
    """What a browser sees of a page: tags, attributes, anchors, text, scripts."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.words = ""
        self._open = ""
        self.feed(path.read_text(encoding="utf-8"))
        library, _, own = self.scripts
        self.scripts = [gzip.decompress(base64.b64decode(library)).decode(), own]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, _: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open == "script":
            self.scripts[-1] += data
        elif self._open != "style":
            self.words += data

    def values(self, name: str) -> list[str]:
        return [value for _, attributes in self.tags if (value := attributes.get(name))]

    @property
    def policy(self) -> str:
        return next(value for value in self.values("content") if "default-src" in value)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a study with a prior, two experiments, a profile and a map."""
    folder = tmp_path_factory.mktemp("results")
    for name, seed in (("first", 1), ("second", 2)):
        coil_table(folder / f"{name}.csv", 0.0, seed=seed)
    second = '[[experiments]]\ndata = "second.csv"\ninputs = ["u"]\noutputs = ["i"]\ninterpolation = "zoh"\n'
    more = 'warmup = 0.02\n[uncertainty]\nprofile_likelihood = ["R"]\ncost_map = [["R", "L"]]\n'
    study = STUDY.replace("min = 0.0", "min = 0.0, prior = { mean = 4.0, std = 0.2 }") + second + more
    (folder / "study.toml").write_text(study.replace('"Coil"', '"Two coils"'))
    start = next(key for key in ("start", "initial_guess") if f"{key} =" in STUDY)
    assert fmuid_("identify", folder / "study.toml", "--set", f"parameters.R.{start}=5.5") == DONE
    return folder / "results"


@pytest.fixture(scope="module")
def page(results: Path) -> Page:
    return Page(results / "report.html")


def test_verdict_comes_first_with_links_and_table(results: Path, page: Page) -> None:
    words, found = page.words, result(results)["parameters"]["R"]
    assert words.index("converged") < words.index("95 % interval") < words.index("Measured and simulated: first")
    for text in ("Two coils", "4.00 ± 0.20", "solver error", "Ohm", f"± {found['std']:.2g}", "5.5"):
        assert text in words, text
    anchors, links = page.values("id"), [link for link in page.values("href") if link.startswith("#")]
    assert set(links) <= {f"#{anchor}" for anchor in anchors}
    assert {"#fit", "#residuals"} <= set(links)
    assert {"fit", "fit-2", "correlation", "profiles", "maps"} <= set(anchors)


def test_report_has_its_provenance(results: Path, page: Page) -> None:
    given = (results.parent / "first.csv").read_bytes()
    assert hashlib.sha256(given).hexdigest() in page.words
    assert hashlib.sha256((results.parent / "study.toml").read_bytes()).hexdigest() in page.words
    assert fmuid.__version__ in page.words
    assert "values were replaced for this run" in page.words  # by --set
    assert 'title = "Two coils"' in page.words  # the study file itself


def test_report_allows_its_own_scripts_only(results: Path, page: Page) -> None:
    digests = {base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in page.scripts}
    assert set(re.findall(r"'sha256-([^']+)'", page.policy)) == digests
    assert len(digests) == 2
    assert page.policy.startswith("default-src 'none'; script-src 'sha256-")
    assert not {tag for tag, _ in page.tags} & {"link", "img", "iframe", "object", "form"}
    assert not page.values("src")
    assert all(link.startswith("#") for link in page.values("href"))
    assert (results / "report.html").stat().st_size < SMALL


def test_report_command_writes_the_same_report(
    results: Path, page: Page, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(results, tmp_path / "alone")
    (folder / "report.html").unlink()
    assert fmuid_("report", folder) == DONE
    assert "report.html" in capsys.readouterr().out
    assert Page(folder / "report.html").words.split() == page.words.split()
    of_document = '{"schema": "fmuid/document/1", '
    for spoilt, said in (
        ("[]", "has no JSON object"),
        ("{}", "is of no schema"),
        ("{", "is not JSON"),
        (of_document + '"documents": {}}', "cannot be right: KeyError: 'arrays'"),
        (of_document + '"documents": {"a": 1}, "arrays": []}', "cannot be right: a: the value should be an object"),
    ):
        (folder / DOCUMENT_FILE).write_text(spoilt)
        assert fmuid_("report", folder) == WRONG_INPUT
        error = capsys.readouterr().err
        assert f"document.json {said}" in error and "run the command again that has written it" in error
    assert fmuid_("report", tmp_path / "nowhere") == WRONG_INPUT
    assert "is no folder of results" in capsys.readouterr().err
