"""Experiment: roles and masks from small tables, and one sentence for everything that can be wrong with them."""

from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, GlobalSearch, InputError, Marquardt, Parameter
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.estimation.predictors import FunctionPredictor

NAN = float("nan")
TIMES = [1.0, 1.1, 1.2, 1.2, 1.3]


def table(**columns: Any) -> pd.DataFrame:
    plain = {"time": TIMES, "u": [0.0, 1.0, 2.0, 5.0, 6.0], "w": [9.0, 8.0, 7.0, 7.0, 6.0]}
    return pd.DataFrame(plain | {"y": [0.5, NAN, 0.7, 0.8, 0.9]} | columns)


def test_roles_arrays_and_masks() -> None:
    outputs = {"position": "y", "speed": "w"}
    more: dict[str, Any] = {"interpolation": {"u": "zoh"}, "warmup": 0.2, "units": {"position": "mm"}, "name": "run1"}
    run = Experiment(table(), ["w", "u"], outputs, **more)
    assert (run.input_names, run.output_names) == (("w", "u"), ("position", "speed"))
    assert run.columns == {"w": "w", "u": "u", **outputs}
    np.testing.assert_array_equal(run.times, TIMES)
    np.testing.assert_array_equal(run.input_values[:, 1], [0, 1, 2, 5, 6])
    np.testing.assert_array_equal(run.output_values[:, 0], [0.5, NAN, 0.7, 0.8, 0.9])
    np.testing.assert_array_equal(run.held, [False, True])
    # 1.0 + 0.2 is a hair more than 1.2 in floating point: the sample at the end of warmup counts all the same.
    np.testing.assert_array_equal(run.counted[:, 0], [False, False, True, True, True])
    assert (run.units, run.name) == ({"position": "mm"}, "run1")


def test_defaults() -> None:
    """Missing samples do not count; one word of interpolation is for all inputs; outputs are optional."""
    np.testing.assert_array_equal(Experiment(table(), outputs=["y", "w"]).counted, [[1, 1], [0, 1], *[[1, 1]] * 3])
    np.testing.assert_array_equal(Experiment(table(), ["u", "w"], interpolation="zoh").held, [True, True])
    np.testing.assert_array_equal(Experiment(table(), ["u", "w"]).held, [False, False])
    run = Experiment(table().set_index("time"), inputs=["u"])
    np.testing.assert_array_equal(run.times, TIMES)
    assert run.output_values.shape == run.counted.shape == (5, 0)
    assert Experiment(table()).input_values.shape == (5, 0)


def test_outputs_that_are_not_measured_are_names() -> None:
    run = Experiment(table(), ["u"], ["y", "z"], warmup=0.15, measured=False)
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
        with pytest.raises(InputError, match="output 'z' has not been measured"):
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


@pytest.mark.parametrize("dtype", ["int16", "bool", "Int64", "int64[pyarrow]", "bool[pyarrow]", "Float64", "object"])
def test_numbers_and_missing_samples_of_any_type(dtype: Any) -> None:
    missing = pd.Series([1, None, 1, 0, 1], dtype="float" if dtype in ("int16", "bool") else dtype)
    run = Experiment(table(u=pd.Series([0, 1, 1, 0, 1]).astype(dtype), y=missing), ["u"], ["y"])
    assert run.input_values.dtype == np.float64
    np.testing.assert_array_equal(run.input_values[:, 0], [0, 1, 1, 0, 1])
    np.testing.assert_array_equal(run.counted[:, 0], [True, False, True, True, True])


WRONG: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    # the time
    ({"time": [0, 1, 2, 1.5, 3]}, {}, r"'time': row 4 goes back from 2 s to 1\.5 s\. Sort the rows"),
    ({"time": [0, 1, NAN, 2, 3]}, {}, "'time': nan in row 3"),
    ({"time": [0, 1, 1, 1, 2]}, {}, "'time': 1 s more than twice from row 2"),
    ({"time": ["0", "1", "x", "3", "4"]}, {}, "'time': 'x' in row 3 is no real number"),
    ({"time": pd.date_range("2026-01-01", periods=5)}, {}, "'time' holds dates or durations"),
    ({}, {"time": "t"}, r"time column 't' not found \(did you mean 'time'\?\)|columns: time"),
    # inputs and outputs
    ({"u": [0, 1, NAN, 2, NAN]}, {}, r"input column 'u' has no value in row 3 \(t = 1\.2 s\)\. Fill the gap"),
    ({"u": [0, 1, 2, -np.inf, 3]}, {}, r"input column 'u' is -inf in row 4 \(t = 1\.2 s\)"),
    ({"u": ["a", "b", "c", "d", "e"]}, {}, r"'u': 'a' in row 1 is no real number\. Give numbers"),
    ({"u": ["0,5", "1", "2", "3", "4"]}, {}, r"'u': '0,5' in row 1 .*\. Write decimal points"),
    ({"u": [1j, 0, 0, 0, 0]}, {}, "'u': '1j' in row 1"),
    ({}, {"inputs": {"voltage": "U"}}, r"input column 'U' not found \(did you mean 'u'\?\)"),
    ({}, {"inputs": "u"}, "inputs = 'u' is no list"),
    ({}, {"inputs": ["u", 3]}, "inputs: 3 = 3 is no name"),
    ({}, {"inputs": ["u", "w", "u"]}, "inputs: 'u' is given twice"),
    ({"y": [0, 1, np.inf, 2, 3]}, {}, r"output column 'y' is inf in row 3 .*\. Leave missing cells empty"),
    ({"y": [NAN] * 5}, {}, "output column 'y' has no sample"),
    ({}, {"outputs": ["u"]}, "'u' is both input and output"),
    # the words
    ({}, {"interpolation": "lin"}, r"interpolation: unknown value 'lin' \(did you mean 'linear'\?\)"),
    ({}, {"interpolation": {"U": "zoh"}}, r"interpolation: 'U' is no input \(did you mean 'u'\?\)"),
    *(({}, {"warmup": each}, "warmup = .* is no duration") for each in (-0.1, NAN, "1", True)),
    ({}, {"warmup": 0.5}, r"warmup = 0\.5 s leaves no sample of 'y'; its last is at 1\.3 s"),
    ({}, {"units": {"speed": "rad/s"}}, "units: 'speed' is no input or output"),
    ({}, {"units": {"u": 1}}, "units: u = 1 is no text"),
    ({"z": 1.0, "u": [[1.0]] * 5}, {}, "'u': .* in row 1 is no real number"),
]


@pytest.mark.parametrize(("columns", "words", "sentence"), WRONG, ids=[sentence[:40] for _, _, sentence in WRONG])
def test_what_is_wrong_is_said_in_one_sentence(columns: Any, words: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        Experiment(table(**columns), **({"inputs": ["u"], "outputs": ["y"], "source": "run.csv"} | words))
    assert str(caught.value).startswith("run.csv: ")
    assert "\n" not in str(caught.value)


def test_wrong_frames() -> None:
    for frame, sentence in (
        (pd.concat([table(), table()[["u"]]], axis=1), "column 'u' occurs twice"),
        ({"time": [0, 1]}, "type dict. Give a pandas DataFrame"),
        *((table().iloc[rows], "fewer than two different times") for rows in (slice(0), slice(1), slice(2, 4))),
    ):
        with pytest.raises(InputError, match=sentence):
            Experiment(frame, ["u"])  # type: ignore[arg-type]
