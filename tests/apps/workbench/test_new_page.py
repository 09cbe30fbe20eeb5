"""A study that is begun on a page: what it shows of tables, and that the command it runs writes what is shown."""

from pathlib import Path

import numpy as np
import pytest
from bokeh.document import Document

from fmuid import Study
from fmuid.apps.cli.options import DONE
from fmuid.apps.workbench.pages.new import NewPage
from tests.support.coil_study import COIL, coil_table
from tests.support.workbench import bench_of, finished


@pytest.fixture
def page(tmp_path: Path) -> NewPage:
    (tmp_path / "coil.fmu").write_bytes(COIL.read_bytes())
    coil_table(tmp_path / "bench.csv", 0.0, seed=1)
    text = (tmp_path / "bench.csv").read_text().replace("time,u,i", "time,U_soll,strom")
    (tmp_path / "bench.csv").write_text(text)
    return NewPage(Document(), bench_of(tmp_path))


def test_data_files_are_shown_as_read(page: NewPage) -> None:
    assert page.fmu.value == "coil.fmu"  # there is one
    assert page.run.buttons[0].disabled
    page.tables.value = ["bench.csv"]
    assert "600 samples" in page.said.text
    assert "only column of this quantity" in page.said.text
    assert "time,U_soll,strom" in page.said.text  # of the file
    assert set(page.maps) == {"u", "i"}
    assert not page.run.buttons[0].disabled
    page.unit.value = "ms"
    assert f"{0.599e-3:.6g} s" in page.said.text
    page.time.value = "zeit"
    assert "role=alert" in page.said.text
    assert page.run.buttons[0].disabled
    page.rate.value = "-3"
    assert "sample rate: -3 is not a number above 0" in page.said.text


def test_rows_without_a_time_are_shown(page: NewPage, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("u,i\n2,0.5\n4,1.01\n8,1.99\n", encoding="utf-8")
    page.tables.options = [*page.tables.options, "points.csv"]
    page.tables.value = ["points.csv"]
    assert "a kind for rows without times" in page.said.text
    page.kind.value = "steady"
    assert "3 rows" in page.said.text
    assert page.words()[-2:] == ["--kind", "steady"]


def test_chosen_columns_are_in_the_command(page: NewPage) -> None:
    page.tables.value = ["bench.csv"]
    page.maps["i"].value = "(none)"
    assert "no column for the output i" in page.said.text
    assert page.words() == ["init", "coil.fmu", "bench.csv", "--output", "study.toml", "--map", "i="]
    page.maps["i"].value = "strom"
    page.maps["u"].value = "U_soll"
    assert page.words()[-4:] == ["--map", "u=U_soll", "--map", "i=strom"]
    assert "given" in page.said.text


@pytest.mark.slow
def test_study_is_written_by_the_shown_command(page: NewPage, tmp_path: Path) -> None:
    page.tables.value = ["bench.csv"]
    page.maps["u"].value, page.maps["i"].value = "U_soll", "strom"
    page.prepare["end_time"].value = "0.5"
    page.output.value = "../evil.toml"
    page.write()
    assert "not a .toml file in this folder" in page.run.state.text
    page.output.value = "made.toml"
    assert "--output made.toml" in page.command.text
    page.write()
    assert finished(page.run).code == DONE, page.run.state.text
    assert "study?file=made.toml" in page.run.state.text
    study = Study.read(tmp_path / "made.toml")
    assert sorted(study.parameters) == ["L", "R"]
    assert study.tables[0].times[-1] == pytest.approx(0.5)
    shown = page.records[0].experiment
    assert shown is not None
    np.testing.assert_array_equal(shown.output_values, study.tables[0].output_values)
