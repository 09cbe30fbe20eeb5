"""The report: what it says, that it says it of the folder's files, and that nothing in it is taken for HTML."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import fmuid
from fmuid.apps.cli.options import DONE, WRONG_INPUT
from fmuid.files import file_name
from fmuid.reports import write_report
from fmuid.reports.page.identification import part
from fmuid.runs import IdentificationRun, read_identification
from tests.support.coil_study import STUDY, coil_table, fmuid_, result
from tests.support.running import run_study

EVIL = '</script><script>alert(1)</script><img src=x onerror=alert(2)> & "quoted" $$x$$'
# A report is no larger than this, bytes, of few samples and of a million.
SMALL, LARGE = 1_000_000, 2_000_000


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
    """The results of a study with a prior, two experiments and a profile, without a report."""
    folder = tmp_path_factory.mktemp("results")
    for name, seed in (("first", 1), ("second", 2)):
        coil_table(folder / f"{name}.csv", 0.0, seed=seed)
    second = '[[experiments]]\ndata = "second.csv"\ninputs = ["u"]\noutputs = ["i"]\ninterpolation = "zoh"\n'
    more = 'warmup = 0.02\n[uncertainty]\nprofile_likelihood = ["R"]\ncost_map = [["R", "L"]]\n'
    study = STUDY.replace("min = 0.0", "min = 0.0, prior = { mean = 4.0, std = 0.2 }") + second + more
    (folder / "study.toml").write_text(study.replace('"Coil"', '"Two coils"'))
    assert fmuid_("identify", folder / "study.toml", "--no-report", "--set", "parameters.R.start=5.5") == DONE
    assert not (folder / "results" / "report.html").exists()
    return folder / "results"


@pytest.fixture(scope="module")
def page(results: Path) -> Page:
    return Page(write_report(results))


def test_the_folder_is_read_back_as_it_was_written(results: Path) -> None:
    found = read_identification(results)
    assert [each.experiment for each in found.fits] == ["first", "second"]
    first, second = found.fits
    assert first.units == ("A",)
    assert first.counted.all()
    assert second.counted[:, 0].argmax() == 20  # what is discarded does not count
    measured, error = second.measured[20:], (second.measured - second.simulated)[20:]
    fit = 100.0 * (1.0 - np.linalg.norm(error) / np.linalg.norm(measured - measured.mean()))
    assert second.fit[0] == pytest.approx(fit)
    written_fits = json.loads((results / "result.json").read_text())["fit"]["experiments"]
    assert written_fits[1]["fit"][0] == pytest.approx(fit)
    assert written_fits[1]["rmse"][0] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert found.unit_of == {"R": "Ohm", "L": "H"}
    (chart,) = found.assessment.maps
    assert chart.names == ("R", "L")
    assert chart.shape == (41, 41)
    assert chart.logarithmic == (False, False)
    np.testing.assert_array_equal(chart.grid[2].ravel(), chart.table["criterion"])
    assert chart.criterion == chart.table["criterion"].min()
    content = json.loads((results / "result.json").read_text())
    (results / "result.json").write_text(json.dumps(content | {"criterion": 5.0}))  # of other noise variances
    again = read_identification(results).assessment.maps[0].criterion
    (results / "result.json").write_text(json.dumps(content))
    assert again == chart.criterion
    written = json.loads((results / "result.json").read_text())
    own = written["parameters"]["R"]
    reach = stats.t.ppf(0.975, own["degrees_of_freedom"]) * own["std"] / own["white_std"]
    assert written["assessment"]["profiles"][0]["threshold"] == pytest.approx(reach**2, rel=1e-6)


def test_it_says_the_verdict_first_and_links_to_what_proves_it(page: Page) -> None:
    words = page.words
    assert "Two coils" in words
    assert words.index("Converged.") < words.index("95 % interval") < words.index("Measured and simulated: first")
    assert re.search(r"2 parameters are known to between .* % \(.\) and .* % \(.\), one standard deviation", words)
    anchors, links = page.values("id"), [link for link in page.values("href") if link.startswith("#")]
    assert set(links) <= {f"#{anchor}" for anchor in anchors}
    assert {"#fit", "#residuals", "#belief", "#criterion", "#accuracy"} <= set(links)
    assert {"fit", "fit-2", "correlation", "profiles", "maps"} <= set(anchors)


def test_the_parabolas_of_prior_data_and_both_are_of_parameters_with_a_prior(results: Path, tmp_path: Path) -> None:
    drawn = {each.name: each.figures for each in part(results).sections}
    (figure,) = drawn["parabolas"]
    assert figure.xaxis.axis_label == "R (Ohm)"  # L has none
    for path in results.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    content = json.loads((results / "result.json").read_text())
    content["parameters"]["R"] |= {"prior_mean": None, "prior_std": None}
    (tmp_path / "result.json").write_text(json.dumps(content))
    assert "parabolas" not in {each.name for each in part(tmp_path).sections}


def test_the_table_has_value_interval_prior_and_shift(results: Path, page: Page) -> None:
    found = result(results)["parameters"]["R"]
    for text in ("4.00 ± 0.20", "solver's shift", "Ohm", f"± {found['std']:.2g}", "5.5"):
        assert text in page.words, text


def test_it_says_where_it_comes_from(results: Path, page: Page) -> None:
    given = (results.parent / "first.csv").read_bytes()
    assert hashlib.sha256(given).hexdigest() in page.words
    assert hashlib.sha256((results.parent / "study.toml").read_bytes()).hexdigest() in page.words
    assert result(results)["models"][""]["digest"] in page.words
    assert fmuid.__version__ in page.words
    assert result(results)["origin"]["date"] in page.words
    assert "values were replaced for this run" in page.words  # by --set
    assert 'title = "Two coils"' in page.words  # the study file itself


def test_a_browser_runs_its_scripts_and_nothing_else(results: Path, page: Page) -> None:
    """The policy names the scripts by their digests, so that none that comes in by a name would run; and no host."""
    digests = {base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in page.scripts}
    assert set(re.findall(r"'sha256-([^']+)'", page.policy)) == digests
    assert len(digests) == 2
    assert page.policy.startswith("default-src 'none'; script-src 'sha256-")
    assert not {tag for tag, _ in page.tags} & {"link", "img", "iframe", "object", "form"}
    assert not page.values("src")
    assert all(link.startswith("#") for link in page.values("href"))
    assert (results / "report.html").stat().st_size < SMALL


def test_names_and_texts_never_become_html(results: Path, tmp_path: Path) -> None:
    """A title, a unit, a column, an experiment and a parameter that are markup are shown as they are written."""
    folder = shutil.copytree(results, tmp_path / "evil")
    fit = pd.read_csv(folder / "fit.csv")
    columns = {f"{kind}.i": f"{kind}.{EVIL}" for kind in ("measured", "simulated")}
    fit.rename(columns=columns).replace({"experiment": {"first": EVIL}}).to_csv(folder / "fit.csv", index=False)
    for name in ("estimates", "trace", "profiles", "map-R-L"):
        table = pd.read_csv(folder / f"{name}.csv")
        table = table.rename(columns={"R": EVIL}).replace({"R": EVIL, "Ohm": EVIL, "i": EVIL, "first": EVIL})
        table.to_csv(folder / f"{name}.csv", index=False)
    (folder / "map-R-L.csv").rename(folder / f"map-{file_name(f'{EVIL}-L')}.csv")
    swap = {"R": EVIL, "i": EVIL, "first": EVIL, "Ohm": EVIL, "A": EVIL}

    def swapped(value: Any) -> Any:
        if isinstance(value, dict):
            return {swap.get(key, key): swapped(each) for key, each in value.items()}
        if isinstance(value, list):
            return [swapped(each) for each in value]
        return swap.get(value, value) if isinstance(value, str) else value

    content = swapped(json.loads((folder / "result.json").read_text()))
    origin = content["origin"]
    origin["title"] = origin["study"]["text"] = origin["study"]["file"] = EVIL
    content["models"][""]["name"] = EVIL
    (folder / "result.json").write_text(json.dumps(content))
    page = Page(write_report(folder))
    assert page.words.count(EVIL) > 8
    assert len([tag for tag, _ in page.tags if tag == "script"]) == 3
    assert not {tag for tag, _ in page.tags} & {"img", "b", "iframe"}
    assert not [name for _, attributes in page.tags for name in attributes if name.startswith("on")]


@pytest.mark.slow
def test_a_million_samples_make_a_page_that_can_be_mailed(results: Path, tmp_path: Path) -> None:
    """Figures are thinned; the rows are made up, so that nothing is simulated."""
    folder = shutil.copytree(results, tmp_path / "long")
    rng = np.random.default_rng(2)
    size = 1_000_000
    noise = rng.standard_normal((2, size)).astype(np.float32)
    content = json.loads((folder / "result.json").read_text())
    content["fit"]["experiments"] = content["fit"]["experiments"][:1]
    content["assessment"]["residuals"]["series"] = []
    (folder / "result.json").write_text(json.dumps(content))
    columns = {"time": np.arange(size), "measured.i": noise[0].round(2), "simulated.i": noise[1].round(2)}
    pd.DataFrame(columns).to_csv(folder / "fit.csv", index=False)
    assert write_report(folder).stat().st_size < LARGE


def test_the_command_writes_the_report_alone(
    results: Path, page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("fmuid.reports.page.document._document", lambda figures: ({}, [], [""] * len(figures)))
    folder = shutil.copytree(results, tmp_path / "alone")
    (folder / "report.html").unlink(missing_ok=True)
    assert fmuid_("report", folder) == DONE
    assert "report.html" in capsys.readouterr().out
    assert Page(folder / "report.html").words.split() == page.words.split()
    (folder / "fit.csv").write_text("time,measured.q\n0,1\n")
    assert fmuid_("report", folder) == WRONG_INPUT
    assert "do not go with its result.json" in capsys.readouterr().err
    (folder / "fit.csv").write_bytes(b"\xff\x00,\x80")
    assert fmuid_("report", folder) == WRONG_INPUT
    assert "fit.csv" in capsys.readouterr().err
    for spoilt in ("[]", "{}", "{"):
        (folder / "result.json").write_text(spoilt)
        assert fmuid_("report", folder) == WRONG_INPUT
        assert "result.json" in capsys.readouterr().err
    (folder / "result.json").unlink()
    assert fmuid_("report", folder) == WRONG_INPUT
    assert "has no result.json" in capsys.readouterr().err
    assert fmuid_("report", tmp_path / "nowhere") == WRONG_INPUT
    assert "is no folder of results" in capsys.readouterr().err


def test_what_a_page_shows_of_findings_is_what_they_are(results: Path) -> None:
    """Numbers read back from the files are those of the run."""
    found = run_study(results.parent / "study.toml")
    assert isinstance(found, IdentificationRun)
    read = read_identification(results)
    np.testing.assert_allclose(read.result.values, found.result.values, rtol=1e-3)
    assert [each.outputs for each in read.fits] == [each.outputs for each in found.fits]
    np.testing.assert_array_equal(read.fits[1].counted, found.fits[1].counted)


def test_a_folder_without_results_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(
        fmuid.InputError, match=r"has no result\.json, .* give the folder that a command has written into"
    ):
        write_report(tmp_path)
    with pytest.raises(fmuid.InputError, match="is no folder of results"):
        write_report(tmp_path / "nowhere")
