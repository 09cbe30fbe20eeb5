"""Documents: written and read back alike, shown by every renderer, damaged ones refused in one sentence."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmuid import Document, InputError
from fmuid.reports import write_report
from fmuid.reports.chart import ChartGrid
from fmuid.reports.document import Message, Remark, Section, table_of
from fmuid.reports.publish import publish
from fmuid.reports.render.document_json import DOCUMENT_FILE, read_documents
from tests.support.charts import EVIL, every_mark


class Said(Message):
    KNOWN = ("{name} is known to {share:.2g} %", "its standard deviation is small", "nothing")


def document(**more: Any) -> Document:
    rows = table_of({"parameter": ["R", EVIL], "value": ["4.00 ± 0.20", "1"], "note": ["", ""]}, ["note"], ["value"])
    said = (Said.KNOWN.said("fit", name="R", share=5.0), Remark(EVIL, "doubt"))
    sections = (Section("estimates", "Estimates", table=rows), Section("fit", EVIL, EVIL, charts=(every_mark(),)))
    made = Document("identification", "Identification", "converged", "good", said, sections, rows, EVIL, EVIL)
    return replace(made, **more)


def test_documents_are_read_back(tmp_path: Path) -> None:
    given = document()
    publish(tmp_path, given, report=False)
    publish(tmp_path, document(kind="prediction"), report=False)
    assert list(read_documents(tmp_path)) == ["identification", "prediction"]
    found = read_documents(tmp_path)["identification"]
    assert found.remarks[0].text == "R is known to 5 %"
    assert found.remarks[0].values == {"name": "R", "share": 5.0}
    assert found.section("estimates").table == given.section("estimates").table
    (grid,), (drawn,) = given.section("fit").charts, found.section("fit").charts
    assert isinstance(grid, ChartGrid)
    assert isinstance(drawn, ChartGrid)
    for chart, other in zip(grid.charts, drawn.charts, strict=True):
        assert chart.x == other.x
        for layer, read in zip(chart.layers, other.layers, strict=True):
            assert layer.data.keys() == read.data.keys()
            for key, values in layer.data.items():
                np.testing.assert_array_equal(np.asarray(read.data[key]), np.asarray(values))
    first, second = drawn.charts[0].layers[:2]
    assert first.data["x"] is second.data["x"]  # one array, one source of columns


def test_names_never_become_html(tmp_path: Path) -> None:
    paths = publish(tmp_path, document(), report=True, figures="png")
    assert [path.name for path in paths] == [DOCUMENT_FILE, "fit.png", "report.html"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    body = page.partition("</style>")[2]
    assert body.count("<script") == 3
    assert "<img" not in body
    assert body.count("&lt;img") > 4
    assert paths[-1].stat().st_size < 700_000


def test_folder_without_documents_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no document\.json: give the folder"):
        write_report(tmp_path)
    with pytest.raises(InputError, match="is no folder of results"):
        write_report(tmp_path / "nowhere")
