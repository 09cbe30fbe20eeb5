"""Experiment: roles and masks from small tables, and one sentence for everything that can be wrong with them."""

from dataclasses import FrozenInstanceError
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid.data import Parameter
from fmuid.data.data_file import read_data
from fmuid.data.experiment import Experiment
from fmuid.errors import InputError
from fmuid.estimation.estimate import Marquardt
from fmuid.estimation.evaluator import Evaluator
from fmuid.estimation.global_search import GlobalSearch
from fmuid.estimation.predictors import FunctionPredictor
from fmuid.estimation.problem import LeastSquares

NAN = float("nan")


def table(**columns: Any) -> pd.DataFrame:
    plain = {
        "time": [1.0, 1.1, 1.2, 1.2, 1.3],
        "u": [0.0, 1.0, 2.0, 5.0, 6.0],
        "w": [9.0, 8.0, 7.0, 7.0, 6.0],
        "y": [0.5, NAN, 0.7, 0.8, 0.9],
    }
    return pd.DataFrame(plain | columns)


def test_roles_arrays_and_masks() -> None:
    run = Experiment(
        table(),
        inputs=["w", "u"],
        outputs={"position": "y", "speed": "w"},
        interpolation={"u": "zoh"},
        warmup=0.2,
        units={"position": "mm"},
        name="run1",
    )
    assert run.input_names == ("w", "u")
    assert run.output_names == ("position", "speed")
    assert run.inputs == {"w": "w", "u": "u"}
    assert run.columns == {"w": "w", "u": "u", "position": "y", "speed": "w"}
    np.testing.assert_array_equal(run.times, [1.0, 1.1, 1.2, 1.2, 1.3])
    np.testing.assert_array_equal(run.input_values[:, 1], [0, 1, 2, 5, 6])
    np.testing.assert_array_equal(run.output_values[:, 0], [0.5, NAN, 0.7, 0.8, 0.9])
    np.testing.assert_array_equal(run.held, [False, True])
    # 1.0 + 0.2 is a hair more than 1.2 in floating point: the sample at the end of warmup counts all the same.
    np.testing.assert_array_equal(run.counted[:, 0], [False, False, True, True, True])
    assert run.units == {"position": "mm"}
    assert run.name == "run1"


def test_missing_samples_do_not_count() -> None:
    run = Experiment(table(), outputs=["y", "w"])
    np.testing.assert_array_equal(run.counted, [[1, 1], [0, 1], [1, 1], [1, 1], [1, 1]])


def test_one_word_of_interpolation_for_all_inputs() -> None:
    np.testing.assert_array_equal(Experiment(table(), ["u", "w"], interpolation="zoh").held, [True, True])
    np.testing.assert_array_equal(Experiment(table(), ["u", "w"]).held, [False, False])


def test_without_outputs_it_can_be_simulated() -> None:
    run = Experiment(table(), inputs=["u"])
    assert run.output_values.shape == run.counted.shape == (5, 0)
    assert Experiment(table()).input_values.shape == (5, 0)


def test_outputs_that_are_not_measured_are_names() -> None:
    run = Experiment(table(), ["u"], ["y", "z"], warmup=0.15, measured=False)
    assert run.output_names == ("y", "z")
    np.testing.assert_array_equal(run.output_values[:, 0], table()["y"])  # what is there is taken
    assert np.isnan(run.output_values[:, 1]).all()
    late = [False, False, True, True, True]
    np.testing.assert_array_equal(run.counted, np.column_stack([late, late]))
    with pytest.raises(InputError, match="'z'"):
        Experiment(table(), ["u"], ["y", "z"])
    with pytest.raises(InputError, match="'v'"):
        Experiment(table(), ["v"], ["z"], measured=False)
    problem = LeastSquares([FunctionPredictor(lambda theta: theta, (5, 2))], [run], {"a": Parameter(1.0, 0.0, 2.0)})
    for search in (Marquardt().search, GlobalSearch().search):
        with pytest.raises(InputError, match="output 'z' has not been measured: there is nothing to identify"):
            search(Evaluator(problem))
    found = run.with_outputs(np.column_stack([run.times, run.times]))
    assert found.measured
    np.testing.assert_array_equal(found.frame["z"], run.times)
    with pytest.raises(InputError, match="'z' has no sample"):
        run.with_outputs(np.column_stack([run.times, np.full(5, NAN)]))


def test_it_does_not_change_any_more() -> None:
    frame = table()
    run = Experiment(frame, ["u"], ["y"])
    frame.loc[0, "u"] = 77.0
    assert run.input_values[0, 0] == run.frame["u"][0] == 0.0
    for array in (run.times, run.input_values, run.output_values, run.counted, run.held):
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(FrozenInstanceError):
        run.warmup = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(
    "dtype",
    ["int16", "float32", "bool", "Int64", "Float64", "boolean", "int64[pyarrow]", "double[pyarrow]", "bool[pyarrow]"],
)
def test_numbers_of_any_type(dtype: Any) -> None:
    frame = table(u=pd.Series([0, 1, 1, 0, 1]).astype(dtype))
    run = Experiment(frame, ["u"])
    assert run.input_values.dtype == np.float64
    np.testing.assert_array_equal(run.input_values[:, 0], [0, 1, 1, 0, 1])


@pytest.mark.parametrize("dtype", ["Float64", "double[pyarrow]", "object"])
def test_missing_samples_of_any_type(dtype: str) -> None:
    run = Experiment(table(y=pd.Series([1.5, None, 2.5, 3.5, 4.5], dtype=dtype)), outputs=["y"])
    np.testing.assert_array_equal(run.counted[:, 0], [True, False, True, True, True])


def test_the_index_may_be_the_time() -> None:
    run = Experiment(table().set_index("time"), ["u"])
    np.testing.assert_array_equal(run.times, [1.0, 1.1, 1.2, 1.2, 1.3])


def test_messages_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run7.csv"
    table().rename(columns={"time": "t"}).to_csv(path, index=False)
    run = Experiment(read_data(path, "t"), ["u"], {"position": "y"}, time="t", interpolation="zoh", warmup=0.1)
    assert run.source == str(path)
    assert run.held.tolist() == [True]
    np.testing.assert_array_equal(run.counted[:, 0], [False, False, True, True, True])
    with pytest.raises(InputError, match=r"run7\.csv: the input column 'v' is missing"):
        Experiment(read_data(path, "t"), ["v"], time="t")


WRONG: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    # the time
    ({"time": [0, 1, 2, 1.5, 3]}, {}, r"'time' decreases in row 4, where 1\.5 s follows 2 s: sort the rows"),
    ({"time": [0, 1, NAN, 2, 3]}, {}, "'time' has nan in row 3: give every row a time"),
    ({"time": [0, 1, 2, 3, np.inf]}, {}, "'time' has inf in row 5"),
    ({"time": [0, 1, 1, 1, 2]}, {}, "'time' has 1 s more than twice, from row 2 on: keep two rows"),
    ({"time": ["0", "1", "x", "3", "4"]}, {}, "column 'time' holds 'x' in row 3, which is no real number"),
    ({"time": pd.date_range("2026-01-01", periods=5)}, {}, "column 'time' holds dates or durations"),
    ({}, {"time": "t"}, r"the time column 't' is missing \(did you mean 'time'\?\)|there is time"),
    # the inputs
    ({"u": [0, 1, NAN, 2, NAN]}, {}, r"the input column 'u' has no value in row 3 \(t = 1\.2 s\): fill the gap"),
    ({"u": [0, 1, 2, -np.inf, 3]}, {}, r"the input column 'u' is -inf in row 4 \(t = 1\.2 s\)"),
    ({"u": ["a", "b", "c", "d", "e"]}, {}, "column 'u' holds 'a' in row 1, .*: give numbers only"),
    ({"u": ["0,5", "1", "2", "3", "4"]}, {}, "column 'u' holds '0,5' in row 1, .*: write numbers with decimal points"),
    ({"u": ["0.5", "1", "2", "3", "4"]}, {}, "column 'u' holds '0.5' in row 1"),
    ({"u": [1j, 0, 0, 0, 0]}, {}, r"column 'u' holds '1j' in row 1, which is no real number"),
    ({}, {"inputs": ["uu"]}, r"the input column 'uu' is missing \(did you mean 'u'\?\)"),
    ({}, {"inputs": {"voltage": "U"}}, r"the input column 'U' is missing \(did you mean 'u'\?\)"),
    ({}, {"inputs": "u"}, r'inputs is \'u\': give a list of names, such as \["u", "w"\]'),
    ({}, {"inputs": 3}, "inputs is 3: give a list of names"),
    ({}, {"inputs": ["u", 3]}, "inputs holds 3 = 3: give names"),
    ({}, {"inputs": ["u", "w", "u"]}, "inputs names 'u' twice"),
    # the outputs
    ({"y": [0, 1, np.inf, 2, 3]}, {}, r"the output column 'y' is inf in row 3 .*: leave cells without a sample empty"),
    ({"y": [NAN] * 5}, {}, "the output column 'y' has no sample: remove it"),
    ({}, {"outputs": {"speed": "x1"}}, "the output column 'x1' is missing"),
    ({}, {"outputs": ["u"]}, "'u' is both an input and an output: give it one role"),
    # the words
    ({}, {"interpolation": "lin"}, r"interpolation 'lin' is not known \(did you mean 'linear'\?\)"),
    ({}, {"interpolation": {"u": 1}}, 'interpolation 1 is not known: write "linear", "zoh", "zoh-next" or'),
    ({}, {"interpolation": {"U": "zoh"}}, r"interpolation names 'U', which is no input \(did you mean 'u'\?\)"),
    ({}, {"warmup": -0.1}, r"warmup is -0\.1: give a duration in seconds, zero or more"),
    ({}, {"warmup": NAN}, "warmup is nan"),
    ({}, {"warmup": "1"}, "warmup is '1'"),
    ({}, {"warmup": True}, "warmup is True"),
    ({}, {"warmup": 0.5}, r"warmup = 0\.5 s leaves no sample of the output column 'y', whose last is at t = 1\.3 s"),
    ({}, {"units": {"speed": "rad/s"}}, "units names 'speed', which is no input or output"),
    ({}, {"units": {"u": 1}}, "the unit of 'u' is 1: write it as a text, such as \"rad/s\""),
]


@pytest.mark.parametrize(("columns", "words", "sentence"), WRONG, ids=[sentence[:40] for _, _, sentence in WRONG])
def test_what_is_wrong_is_said_in_one_sentence(columns: Any, words: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        Experiment(table(**columns), **({"inputs": ["u"], "outputs": ["y"], "source": "run.csv"} | words))
    assert str(caught.value).startswith("run.csv: ")
    assert "\n" not in str(caught.value)


def test_wrong_frames() -> None:
    with pytest.raises(InputError, match="the column 'u' is there twice"):
        Experiment(pd.concat([table(), table()[["u"]]], axis=1), ["u"])
    with pytest.raises(InputError, match="the table is of type dict: give a pandas DataFrame"):
        Experiment({"time": [0, 1]})  # type: ignore[arg-type]
    for rows in (0, 1):
        with pytest.raises(InputError, match="fewer than two different times: give a longer record"):
            Experiment(table().iloc[:rows], ["u"])
    with pytest.raises(InputError, match="fewer than two different times"):
        Experiment(table().iloc[2:4], ["u"])
