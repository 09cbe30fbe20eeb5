"""What a notebook shows: tables as HTML, figures that carry their library once, short texts elsewhere."""

import json
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmuid
from fmuid.estimation import Identifiability, IdentifiabilityLevel, WeakDirection
from fmuid.reports.render.notebook import NotebookFigures, plots
from fmuid.runs.batch.dataset import Dataset
from tests.support.coil_study import COIL, STUDY, coil_table
from tests.support.results import made_up
from tests.support.running import run_study

# A notebook with five figures is no larger than this, bytes.
LARGEST = 3_000_000


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> fmuid.runs.IdentificationRun:
    folder = tmp_path_factory.mktemp("notebook")
    coil_table(folder / "first.csv", 0.0, seed=1)
    study = folder / "study.toml"
    study.write_text(STUDY.replace("min = 0.0", "min = 0.0, prior = { mean = 4.0, std = 0.2 }"))
    return run_study(study)


@pytest.fixture(autouse=True)
def new_notebook() -> Iterator[None]:
    NotebookFigures._library_in.clear()
    yield
    NotebookFigures._library_in.clear()


def html(shown: Any) -> str:
    return str(shown._repr_html_())


def test_library_is_in_the_first_figure_only(found: fmuid.runs.IdentificationRun) -> None:
    plots = (found.plot.fit, found.plot.residuals, found.plot.cost, found.plot.correlation, found.plot.belief)
    shown = [html(plot()) for plot in plots]
    assert len(shown[0]) > 1_000_000
    assert max(map(len, shown[1:])) < 400_000
    assert sum(map(len, shown)) < LARGEST
    assert all("cdn." not in text for text in shown[1:])


def test_result_has_figures_of_its_own(found: fmuid.runs.IdentificationRun) -> None:
    assert [len(found.result.plot.residuals().charts), len(found.plot.residuals().charts)] == [1, 3]
    assert len(found.result.plot.fit().charts) == len(found.result.plot.accuracy().charts) == 1
    assert dir(found.result.plot) == ["accuracy", "correlation", "cost", "fit", "forest", "parameters", "residuals"]
    with pytest.raises(fmuid.InputError, match=r"fmuid\.run"):
        found.result.plot.parabolas("R")
    with pytest.raises(AttributeError, match="nothing to draw as 'optima': there is accuracy, correlation, cost"):
        found.result.plot.optima()
    assert len(found.plot.parabolas("L").charts) == 1
    with pytest.raises(fmuid.InputError, match="a FMU has no figures"):
        plots(fmuid.FMU(COIL))


def test_tables(found: fmuid.runs.IdentificationRun, tmp_path: Path) -> None:
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


def test_parameter_of_a_result_is_a_number_with_attributes(found: fmuid.runs.IdentificationRun) -> None:
    result, own = found.result, found.result["R"]
    assert own == own.value == result.values[0]
    assert own + 1.0 == result.values[0] + 1.0
    assert json.loads(json.dumps({"R": own})) == {"R": result.values[0]}
    assert str(own) == f"{own}" == str(own.value)
    assert (own.std, own.start, own.unit) == (result.std[0], result.estimates.start[0], "Ohm")
    assert own.interval == tuple(result.intervals().loc["R"])
    assert own.prior == fmuid.Normal(4.0, 0.2)
    assert result["L"].prior is None
    assert repr(own).startswith("R = ")
    assert repr(own).endswith(" Ohm")
    again = pickle.loads(pickle.dumps(own))
    assert (again, again.std, again.prior) == (own, own.std, own.prior)
    with pytest.raises(fmuid.InputError, match="it has R, L"):
        result["Rs"]


def many(count: int, directions: int) -> fmuid.Result:
    """Return a result of many parameters, of which as much is to be said as there are directions."""
    names = tuple(f"a_parameter_whose_name_takes_room_{i}" for i in range(count))
    weak = tuple(
        WeakDirection(IdentifiabilityLevel.HARDLY, names[i % count : i % count + 1], (1.0,), 2.0, (1.0,), (1.0,))
        for i in range(directions)
    )
    return made_up(
        names, np.ones(count), np.ones(count), np.eye(count), identifiability=Identifiability(weakly_identifiable=weak)
    )


@pytest.mark.parametrize(("count", "directions", "rows"), [(20, 0, 20), (23, 0, 20), (100, 60, 11), (3, 60, 3)])
def test_printed_result_has_at_most_25_lines(count: int, directions: int, rows: int) -> None:
    text = str(many(count, directions))
    lines = text.splitlines()
    assert len(lines) <= 25 and lines[2].startswith("a_parameter_whose_name_takes_room_0 ")
    assert sum(line.startswith("a_parameter") and "±" in line for line in lines[2:]) == rows
    assert (f"… {count - rows} more" in lines) == (rows < count)
    assert ("fmuid.Document.of" in text) == (directions == 60)


def test_texts_are_short(found: fmuid.runs.IdentificationRun, tmp_path: Path) -> None:
    assert repr(found.result).startswith("Result(converged: R = ")
    coil_table(tmp_path / "first.csv", 0.0, seed=1)
    (tmp_path / "study.toml").write_text(STUDY)
    study = fmuid.Study.read(tmp_path / "study.toml")
    assert repr(study) == "Study('Coil': first; R, L)"
    batch = fmuid.runs.BatchResult(Dataset(tmp_path, {}, 4), 3, 4, {}, {}, Path("batch"), given_noise=False)
    assert repr(batch) == "BatchResult(3 of 4 cases, 'batch')"
    for shown in (found, found.result, study, study.tables[0], study.system, fmuid.FMU(COIL)):
        assert len(repr(shown)) < 200
        assert "\n" not in repr(shown)
