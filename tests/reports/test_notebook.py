"""What a notebook shows: tables as HTML, figures that carry their library once, short texts elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import fmuid
from fmuid.displays import shown_by
from fmuid.reports.notebook import Drawing
from tests.support.coil_study import COIL, STUDY, coil_table

# A notebook with five figures is no larger than this, bytes.
LARGEST = 3_000_000


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> fmuid.Findings:
    folder = tmp_path_factory.mktemp("notebook")
    coil_table(folder / "first.csv", 0.0, seed=1)
    study = folder / "study.toml"
    study.write_text(STUDY.replace("min = 0.0", "min = 0.0, prior = { mean = 4.0, std = 0.2 }"))
    return fmuid.run_study(study)


@pytest.fixture(autouse=True)
def new_notebook() -> Iterator[None]:
    Drawing._library_in.clear()
    yield
    Drawing._library_in.clear()


def html(shown: Any) -> str:
    text = shown._repr_html_()
    assert isinstance(text, str)
    return text


def test_a_notebook_with_five_figures_can_be_kept(found: fmuid.Findings) -> None:
    """The library, 1.3 MB, is in the first of them only."""
    plots = (found.plot.fit, found.plot.residuals, found.plot.search, found.plot.correlation, found.plot.belief)
    shown = [html(plot()) for plot in plots]
    assert len(shown[0]) > 1_000_000
    assert max(map(len, shown[1:])) < 400_000
    assert sum(map(len, shown)) < LARGEST
    assert all("cdn." not in text for text in shown[1:])


def test_a_result_draws_itself_without_its_findings(found: fmuid.Findings) -> None:
    assert [len(found.result.plot.residuals().models), len(found.plot.residuals().models)] == [1, 3]
    assert len(found.result.plot.fit().models) == len(found.result.plot.accuracy().models) == 1
    with pytest.raises(fmuid.InputError, match="run_study"):
        found.result.plot.belief()
    with pytest.raises(fmuid.InputError, match="nothing of it"):
        found.result.plot.optima()


def test_tables(found: fmuid.Findings, tmp_path: Path) -> None:
    """Each shows what it is, and names never become markup."""
    for shown in (found, found.result):
        assert "<th scope=row>R</th>" in html(shown)
        assert "Converged" in html(shown)
    assert "Ohm" in html(found)
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    (tmp_path / "study.toml").write_text(STUDY.replace('"Coil"', '"<script>x</script>"'))
    study = fmuid.Study.read(tmp_path / "study.toml")
    assert "&lt;script&gt;x&lt;/script&gt;" in html(study)
    assert "<script>" not in html(study)
    assert "<th scope=row>L</th>" in html(study)
    coil = html(fmuid.FMU(COIL))
    assert all(f"<th scope=row>{name}</th>" in coil for name in ("R", "L", "u", "i"))


def test_texts_are_short(found: fmuid.Findings) -> None:
    """What a notebook keeps beside the HTML is a line; of many parameters the first ones."""
    assert repr(found.result).startswith("Result(converged: R = ")
    for shown in (found, found.result):
        assert len(repr(shown)) < 200
        assert "\n" not in repr(shown)


def test_without_anybody_who_shows_there_is_the_text(found: fmuid.Findings) -> None:
    shown_by("fmuid.reports.notebook")
    from fmuid import displays

    displays._by.clear()
    try:
        assert found.result._repr_html_() is None
    finally:
        shown_by("fmuid.reports.notebook")
