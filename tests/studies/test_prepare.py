"""``[experiments.preprocess]``: a study does with its data what would otherwise be done by hand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid.apps.cli.options import DONE, WRONG_INPUT
from fmuid.errors import InputError
from fmuid.studies import Study
from tests.support.coil_study import COIL, coil_table, fmuid_

STUDY = """
[model]
fmu = "{fmu}"
[[experiments]]
data = "{table}"
inputs = ["u"]
outputs = {{ i = "current" }}
interpolation = "{interpolation}"
[experiments.preprocess]
{prepare}
[parameters]
R = {{ start = 4.0, min = 0.0 }}
L = {{ start = 0.1, min = 1e-4 }}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    coil_table(tmp_path / "run.csv", 0.0, seed=1)
    frame = pd.read_csv(tmp_path / "run.csv")
    frame = frame.assign(current=frame["i"], shunt=frame["i"] * 50.0 - 3.0, t=20.0)
    frame.to_csv(tmp_path / "run.csv", index=False)
    return tmp_path


def study(folder: Path, prepare: str, table: str = "run.csv", interpolation: str = "zoh") -> Study:
    text = STUDY.format(fmu=COIL.as_posix(), table=table, prepare=prepare, interpolation=interpolation)
    (folder / "study.toml").write_text(text)
    return Study.read(folder / "study.toml")


def test_the_same_as_by_hand(folder: Path) -> None:
    by_hand = pd.read_csv(folder / "run.csv")
    by_hand = by_hand[(by_hand["time"] > 0.0995) & (by_hand["time"] < 0.4005)]
    by_hand.to_csv(folder / "cut.csv", index=False)
    (expected,) = study(folder, "", "cut.csv").tables
    keys = 'computed_columns = { current = "(shunt + 3) / 50" }\nstart_time = 0.1\nend_time = 0.4'
    (found,) = study(folder, keys).tables
    np.testing.assert_array_equal(found.times, expected.times)
    np.testing.assert_allclose(found.output_values, expected.output_values, rtol=1e-12, atol=1e-12)


def test_segments_are_experiments_of_their_own(folder: Path) -> None:
    read = study(folder, "segments = [[0.0, 0.2], [0.3, 0.5]]")
    assert [each.name for each in read.experiments] == [each.name for each in read.tables] == ["run 1", "run 2"]
    ends = [float(table.times[k]) for table in read.tables for k in (0, -1)]
    assert ends == pytest.approx([0.0, 0.2, 0.3, 0.5])


def test_filtered_and_resampled(folder: Path) -> None:
    """Inputs and outputs go through the same filter, so that the estimates of a linear model stay where they are."""
    plain = study(folder, "").identify()
    read = study(folder, "lowpass_frequency = 60.0\nresample_interval = 0.004", interpolation="linear")
    assert np.diff(read.tables[0].times) == pytest.approx(0.004)
    np.testing.assert_allclose(read.identify().values, plain.values, rtol=0.03)


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        ('computed_columns = { current = "shunt +" }', r"'current': .*'shunt \+'"),
        ('computed_columns = { current = "shnt / 50" }', "'shnt' .*'shunt'"),
        ("lowpass_frequency = 60.0", "'u' has interpolation"),
        ("start_time = 3.0\nend_time = 1.0", r"experiments\[0\].preprocess: start_time = 3 is after end_time = 1"),
        ("start_time = 300.0", "300 s .*0 samples"),
        ("segments = [[0.0, 0.2], [0.5, 0.3]]", "segments: must be a list of pairs of times.*earlier time first"),
        ("segments = [[0.0, 0.2, 0.3]]", "segments: must be a list of pairs of times"),
        ("segments = [[0.0, 0.2]]\nend_time = 3.0", "segments and end_time cannot be combined"),
        ("resample_interval = 0", "resample_interval: must be a number above 0, not 0"),
        ('fill_missing = { u = "pchip" }', 'fill_missing.u: must be "linear" or "zoh", not "pchip"'),
        ('fill_missing = { current = "zoh" }', "preprocess.fill_missing: 'current' is the output 'i'. Remove it"),
        ("max_gap = 0.1", "preprocess: max_gap"),
        ('park = [{ source = ["u", "i"], target = ["a", "b"], angle = "t" }]', "source and target"),
        ('park = [{ source = ["u", "i"], target = ["a", "b", "c"] }]', "a, b, c need an angle or a speed"),
    ],
)
def test_wrong_preprocessing_is_refused(folder: Path, prepare: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        _ = study(folder, prepare).tables


def test_an_input_with_a_gap_names_the_remedy_that_fills_it(folder: Path) -> None:
    (whole,) = study(folder, "").tables
    table = pd.read_csv(folder / "run.csv")
    row = int(np.flatnonzero(np.diff(table["u"]) == 0)[20]) + 1  # where holding changes nothing
    table.loc[row, "u"] = np.nan
    table.to_csv(folder / "run.csv", index=False)
    with pytest.raises(InputError, match="fill_missing") as caught:
        _ = study(folder, "").tables
    remedy = re.search(r"fill_missing = {.*?}", str(caught.value))
    assert remedy is not None
    assert np.isfinite(study(folder, remedy[0]).tables[0].input_values).all()
    (filled,) = study(folder, 'fill_missing = { u = "zoh" }\nmax_gap = 0.01').tables
    np.testing.assert_array_equal(filled.input_values, whole.input_values)


def test_missing_rows_are_said_and_filled_like_missing_samples(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pd.read_csv(folder / "run.csv")
    begin, end, whole = 100, 150, table["time"].to_numpy()
    table.drop(index=range(begin, end)).to_csv(folder / "run.csv", index=False)
    assert fmuid_("init", COIL, folder / "run.csv", "-o", folder / "begun.toml") != DONE
    assert f"(row {begin})" in capsys.readouterr().out
    with pytest.raises(InputError, match=rf"\(row {begin}\)") as caught:
        _ = study(folder, "").tables
    words = re.search(r"preprocess = { (fill_missing = {.*}), (max_gap = .*) }", str(caught.value))
    assert words is not None
    (filled,) = study(folder, "\n".join(words.groups())).tables
    np.testing.assert_allclose(filled.times, whole, atol=1e-9)
    assert np.isnan(filled.output_values).sum() == end - begin
    assert fmuid_("simulate", folder / "study.toml", "--set", "experiments.0.preprocess.max_gap=0") == WRONG_INPUT
