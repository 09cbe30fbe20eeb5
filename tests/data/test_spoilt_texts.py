"""Spoilt texts of instruments: each is read right, or refused in one sentence with a remedy."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from random import Random

import numpy as np
import pytest

from fmuid import Experiment, InputError, read_data
from tests.support import historian_texts, instrument_texts, simulator_texts, spoilt_texts
from tests.support.table_variants import DATES, FRAME, ROWS

LOGGERS = ("HOBO", "EasyLog", "Grafana", "Digatron", "VCDS", "Tinytag")
TEXTS = instrument_texts.texts(FRAME, DATES)
TEXTS |= {name: each for name, each in historian_texts.texts(FRAME, DATES).items() if name in LOGGERS}
TEXTS |= simulator_texts.texts(FRAME, DATES)
WITHOUT_TIMES = {"LabVIEW without times", "Yokogawa"}
"""Texts in which nothing shows a row that is gone."""
FACTORS = {"rpm": np.pi / 30, "mA": 1e-3}
LONG = {
    *("ANSYS", "catman", "DEWESoft", "Graphtec", "Hioki", "INCA", "Keysight 34970A", "Rohde & Schwarz", "Yokogawa WT"),
    *("days of spreadsheets", "one block below another", "percent in cells", "rows are columns"),
    *LOGGERS,
}
COUNTS = [2, pytest.param(20, marks=pytest.mark.slow)]


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in TEXTS])
def test_spoilt_texts(tmp_path: Path, name: str, count: int) -> None:
    file, text = TEXTS[name]
    path, ended = tmp_path / file, {"read": 0, "refused": 0}
    for way, spoil in spoilt_texts.WAYS.items():
        for k in range(count):
            spoilt = spoil(Random(f"{name} {way} {k}"), text)
            path.write_bytes(spoilt if isinstance(spoilt, bytes) else spoilt.encode())
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    found = Experiment(read_data(path, source="F"), ["u"], ["i", "w"])
            except InputError as error:
                check_sentence(str(error))
                ended["refused"] += 1
                continue
            ended["read"] += 1
            same = isinstance(spoilt, str) and spoilt.startswith(text.rsplit("\n", ROWS + 1)[0])
            if same and (way != "lines" or name not in WITHOUT_TIMES):
                check(found, way)
    assert ended["refused"] > count


def check_sentence(text: str) -> None:
    """Check words and remedy of a refusal."""
    assert "\n" not in text
    assert not re.search(r"Error|Exception|Traceback|tokeniz|fields", text), text
    assert re.search(r"[.)] [A-Z][^.]* |: [A-Z]", text), text


def check(found: Experiment, way: str) -> None:
    """Compare with the samples at the same times; the last cell of a text may be cut."""
    rows = np.round(100 * (found.times - found.times[0])).astype(int)
    np.testing.assert_allclose(found.times - found.times[0], rows / 100, atol=1e-9)
    scales = [FACTORS.get(found.units.get(name, ""), 1.0) for name in found.columns]
    values = np.column_stack([found.input_values, found.output_values]) * scales
    rows += int(np.argmin(np.nan_to_num(np.abs(FRAME["i"][:3] - values[0, 1]))))  # first rows may be gone
    expected = FRAME[["u", "i", "w"]].to_numpy()[rows]
    same = np.isnan(values) | np.isclose(values, expected, rtol=1e-9, atol=1e-12)
    if way == "cut":
        same[-1] = True
    assert same.all(), np.argwhere(~same)
