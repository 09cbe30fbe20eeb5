"""``[experiments.preprocess]``: a study does with its table what would otherwise be done by hand."""

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
    expected = study(folder, "", "cut.csv")
    found = study(folder, 'computed_columns = { current = "(shunt + 3) / 50" }\nstart_time = 0.1\nend_time = 0.4')
    np.testing.assert_array_equal(found.tables[0].times, expected.tables[0].times)
    np.testing.assert_allclose(found.identify().values, expected.identify().values, rtol=1e-6)


def test_pieces_are_experiments_of_their_own(folder: Path) -> None:
    read = study(folder, "segments = [[0.0, 0.2], [0.3, 0.5]]")
    assert [each.name for each in read.experiments] == ["run 1", "run 2"]
    assert [float(table.times[-1]) for table in read.tables] == pytest.approx([0.2, 0.5])
    assert float(read.tables[1].times[0]) == pytest.approx(0.3)
    assert [table.name for table in read.tables] == ["run 1", "run 2"]


def test_filtered_and_resampled(folder: Path) -> None:
    """Inputs and outputs go through the same filter, so that the estimates of a linear model stay where they are."""
    plain = study(folder, "").identify()
    read = study(folder, "lowpass_frequency = 60.0\nresample_interval = 0.004", interpolation="linear")
    (table,) = read.tables
    assert np.diff(table.times) == pytest.approx(0.004)
    found = read.identify()
    np.testing.assert_allclose(found.values, plain.values, rtol=0.03)


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (
            'computed_columns = { current = "shunt +" }',
            r"column 'current': the expression 'shunt \+' cannot be computed",
        ),
        ('computed_columns = { current = "shnt / 50" }', r"'shnt' is missing \(did you mean 'shunt'"),
        ("lowpass_frequency = 60.0", r"'u' holds between samples \(interpolation = \"zoh\"\)"),
        (
            "start_time = 3.0\nend_time = 1.0",
            r"\[experiments.preprocess\]\S* is refused: start_time = 3 and end_time = 1: give the earlier time first",
        ),
        ("start_time = 300.0", r"from 300 s leaves 0 samples: the record goes from 0 to"),
        ("segments = [[0.0, 0.2], [0.5, 0.3]]", "segments must be a list of pairs of times"),
        ("segments = [[0.0, 0.2, 0.3]]", "segments must be a list of pairs of times"),
        ("segments = [[0.0, 0.2]]\nend_time = 3.0", "has both segments and end_time: keep one of the two"),
        ("resample_interval = 0", "resample_interval must be a number above 0, not 0"),
        ('fill_missing = { u = "pchip" }', r'preprocess.fill_missing\] u must be "linear" or "zoh", not "pchip"'),
        (
            'fill_missing = { current = "zoh" }',
            "fills 'current', what was measured of the output 'i': leave it out of fill_missing",
        ),
        ("max_gap = 0.1", "is refused: max_gap without anything to fill: name the columns"),
        ('max_gap = 0\nfill_missing = { u = "zoh" }', "max_gap must be a number above 0, not 0"),
        ('detrend = "pchip"', 'detrend must be "mean" or "linear"'),
        ("lowpass = 3.0", r"has no key 'lowpass' \(did you mean 'lowpass_frequency'"),
        (
            'park = [{ source = ["u", "i"], target = ["a", "b"], angle = "t" }]',
            "source and target are of other lengths",
        ),
        (
            'park = [{ source = ["u", "i"], target = ["a", "b", "c"] }]',
            "the axes a, b, c need an angle or a speed, one of the two",
        ),
    ],
)
def test_what_is_wrong_is_said(folder: Path, prepare: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=said):
        _ = study(folder, prepare).tables
    assert fmuid_("simulate", folder / "study.toml") == WRONG_INPUT
    assert capsys.readouterr().err.count("\n") == 1


def test_an_input_with_a_gap_names_the_remedy_which_fills_it(folder: Path) -> None:
    whole = study(folder, "").identify()
    table = pd.read_csv(folder / "run.csv")
    row = int(np.flatnonzero(np.diff(table["u"]) == 0)[20]) + 1  # where holding changes nothing
    table.loc[row, "u"] = np.nan
    table.to_csv(folder / "run.csv", index=False)
    with pytest.raises(InputError) as caught:
        _ = study(folder, "").tables
    remedy = 'fill_missing = { "u" = "linear" }'
    assert f"fill the gap, preprocess = {{ {remedy} }}, or cut the table there" in str(caught.value)
    assert np.isfinite(study(folder, remedy).tables[0].input_values).all()
    filled = study(folder, 'fill_missing = { u = "zoh" }\nmax_gap = 0.01').identify()
    np.testing.assert_array_equal(filled.values, whole.values)


def test_missing_rows_are_said_and_filled_like_missing_samples(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pd.read_csv(folder / "run.csv")
    begin, end, whole = 100, 150, table["time"].to_numpy()
    gap = f"between t = {table['time'][begin - 1]:.9g} s (row {begin}) and {table['time'][end]:.9g} s"
    table.drop(index=range(begin, end)).to_csv(folder / "run.csv", index=False)
    assert fmuid_("init", COIL, folder / "run.csv", "-o", folder / "begun.toml") != DONE
    assert gap in capsys.readouterr().out
    with pytest.raises(InputError) as caught:
        _ = study(folder, "").tables
    assert gap in str(caught.value)
    words = re.search(r"preprocess = { (fill_missing = {.*}), (max_gap = .*) }", str(caught.value))
    assert words is not None
    (record,) = study(folder, "\n".join(words.groups())).tables
    np.testing.assert_allclose(record.times, whole, atol=1e-9)
    assert np.isnan(record.output_values).sum() == end - begin
