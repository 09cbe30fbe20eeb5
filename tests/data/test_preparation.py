"""What is done with a table before it is an experiment: against closed forms, numpy and the transforms."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import butter, sosfiltfilt

import fmuid
from fmuid import Experiment, InputError
from fmuid.array_types import Floats
from fmuid.data import ParkTransform, Preprocessing, evaluate, preprocess

T: Floats = np.arange(2000.0) * 1e-3


def frame(**columns: Any) -> pd.DataFrame:
    return pd.DataFrame({"time": T, **columns})


def reduced(given: Any, **how: Any) -> Any:
    return preprocess(given, Preprocessing(**how))


def value(text: str) -> Floats:
    columns = {"a": np.array([1.0, 4.0]), "b": np.array([2.0, 0.0]), "motor speed": np.array([3.0, 5.0])}

    def column(name: str) -> Floats:
        if name not in columns:
            raise InputError(f"no {name}")
        return columns[name]

    return evaluate(text, column, 2)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a * 35.1 + b", [37.1, 140.4]),
        ("-a ** 2 / (b - 1)", [-1.0, 16.0]),
        ("'motor speed' % 2", [1.0, 1.0]),
        ("sqrt(a) + atan2(0, a) - abs(-b)", [-1.0, 2.0]),
        ("max(a, b) - min(a, 2)", [1.0, 2.0]),
        ("sin(pi / 2)", [1.0, 1.0]),
        ("a / b", [0.5, np.inf]),
        (" 2 ", [2.0, 2.0]),
        ("9 ** 9 ** 9 ** 9", [np.inf, np.inf]),  # and at once: numbers are floats
    ],
)
def test_expressions(text: str, expected: list[float]) -> None:
    np.testing.assert_allclose(value(text), expected)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "a.__class__", "a[0]", "(lambda: 1)()", "[a for a in b]", "a if b else 1",
        "a < b", "a @ b", "a; b", "a = 1", "", "a +", "(" * 900, "a and b", "True", "f'{a}'", "1j", "exp(a, b)",
        "exp(x=a)", "eval(a)", "sinn(a)", "exec('a')", "a" + "+a" * 600, "None", "*a", "x := a", "{a}", "b''",
    ],
)  # fmt: skip
def test_what_is_no_expression_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"expression|no "):
        value(text)


def test_columns_one_after_the_other() -> None:
    found = reduced(frame(y=2.0, d=1.0), computed_columns={"e": "d * 3", "y": "y + e * time", "bad": "1 / (d - 1)"})
    np.testing.assert_allclose(found["y"], 2.0 + 3.0 * T)
    assert found["bad"].isna().all()  # missing, not infinite


@pytest.mark.parametrize("frequency", [20.0, 5.0, 80.0])
def test_low_pass_halves_at_its_frequency_and_shifts_nothing(frequency: float) -> None:
    """|H|² = 1 / (1 + (Ω/Ω_c)⁴) of a Butterworth filter of order 2, once in each direction; Ω = tan(π f / f_s)."""
    gain = 1 / (1 + (np.tan(np.pi * frequency * 1e-3) / np.tan(np.pi * 20e-3)) ** 4)
    assert gain == pytest.approx(0.5) or frequency != 20.0
    x = np.sin(2 * np.pi * frequency * T)
    found = reduced(frame(x=x, again=x), lowpass_frequency=20.0)
    inner = slice(300, -300)
    np.testing.assert_allclose(found["x"][inner], gain * x[inner], atol=1e-6)
    np.testing.assert_array_equal(found["x"], found["again"])


def test_stretches_between_gaps_are_filtered_by_themselves() -> None:
    x = np.random.default_rng(0).standard_normal(T.size)
    sections = butter(2, 50.0, fs=1000.0, output="sos")
    holed = np.where((T > 0.4) & (T < 0.45), np.nan, x)
    found = reduced(frame(x=holed), lowpass_frequency=50.0)["x"].to_numpy()
    for part in (slice(0, 401), slice(450, None)):
        np.testing.assert_allclose(found[part], sosfiltfilt(sections, x[part]), atol=1e-12)
    assert np.isnan(found[401:450]).all()
    kept = (T < 0.4) | (T > 0.6)  # a gap in time
    found = reduced(frame(x=x)[kept], lowpass_frequency=50.0)["x"].to_numpy()
    np.testing.assert_allclose(found[:400], sosfiltfilt(sections, x[:400]), atol=1e-12)
    lonely = np.where((T[700] == T) | (T < 0.5), x, np.nan)
    assert np.isnan(reduced(frame(x=lonely), lowpass_frequency=50.0)["x"][700])


def test_resample() -> None:
    x = 3 * T + 1
    stairs = np.floor(10 * T + 1e-9)
    experiment = Experiment(frame(u=stairs, y=np.where(T == 0.1, np.nan, x)), ["u"], ["y"], interpolation="zoh")
    found = reduced(experiment, resample_interval=0.0125)
    np.testing.assert_allclose(found.times, np.arange(160) * 0.0125, atol=1e-12)
    np.testing.assert_array_equal(found.input_values[:, 0], np.floor(10 * np.arange(160) * 0.0125 + 1e-6))
    expected = 3 * found.times + 1
    expected[8] = np.nan  # at 0.1 s
    np.testing.assert_allclose(found.output_values[:, 0], expected, atol=1e-9)
    finer = reduced(frame(x=x), resample_interval=2.5e-4)
    np.testing.assert_allclose(finer["x"], 3 * finer["time"] + 1)
    gap = reduced(frame(x=x)[(T < 0.4) | (T > 0.6)], resample_interval=0.01)
    np.testing.assert_array_equal(np.flatnonzero(gap["x"].isna()), np.arange(40, 61))


def test_detrend() -> None:
    x = 3 * T + 1 + np.where(T == 0.5, np.nan, np.sin(2 * np.pi * 5 * T))
    there = np.isfinite(x)
    line = np.polynomial.Polynomial.fit(T[there], x[there], 1)
    found = reduced(frame(x=x, y=x), detrend={"x": "linear"})
    np.testing.assert_allclose(found["x"], x - line(T), atol=1e-9)
    np.testing.assert_array_equal(found["y"], x)
    assert reduced(frame(x=x), detrend="mean")["x"].mean() == pytest.approx(0.0, abs=1e-12)


def test_the_order_and_what_is_left_alone() -> None:
    """Computed, filtered, cut, resampled, then freed of the mean; an empty preparation changes nothing."""
    x = np.random.default_rng(1).standard_normal(T.size)
    found = reduced(
        frame(x=x),
        computed_columns={"z": "2 * x"},
        lowpass_frequency=50.0,
        start_time=0.5,
        end_time=1.5,
        resample_interval=0.01,
        detrend={"z": "mean"},
    )
    z = sosfiltfilt(butter(2, 50.0, fs=1000.0, output="sos"), 2 * x)[500:1501:10]
    np.testing.assert_allclose(found["z"], z - z.mean(), atol=1e-9)
    given = frame(x=x, word="run")
    given.attrs["units"] = {"x": "mV"}
    assert reduced(given).equals(given)
    assert reduced(given, resample_interval=0.01).attrs["units"] == {"x": "mV"}


def phases(angle: Floats) -> dict[str, Floats]:
    """Return a balanced set of peak 10 that turns with an angle, 0.3 rad before it."""
    return {name: 10 * np.cos(angle + 0.3 - k * 2 * np.pi / 3) for k, name in enumerate(("ia", "ib", "ic"))}


def test_axes_by_angle_and_by_speed_of_any_unit() -> None:
    speed = 100 + 20 * np.sin(3 * T)  # mechanical, rad/s
    angle = 0.7 + 2 * (100 * T + 20 / 3 * (1 - np.cos(3 * T)))
    table = frame(**phases(angle), theta=np.degrees(angle), n=speed * 30 / np.pi)
    table.attrs["units"] = {"theta": "deg", "n": "rpm", "ia": "mA", "ib": "mA", "ic": "mA"}
    length = 10 * np.sqrt(1.5)
    hows: list[dict[str, Any]] = [{"angle": "theta"}, {"speed": "n", "pole_pairs": 2.0, "initial_angle": 0.7}]
    for how in hows:
        axes = ParkTransform(("ia", "ib", "ic"), ("id", "iq"), **how)
        back = ParkTransform(("id", "iq"), ("a", "b", "c"), **how)
        found = reduced(table, park=(axes, back))
        np.testing.assert_allclose(found["id"], length * np.cos(0.3), rtol=1e-4)
        np.testing.assert_allclose(found["iq"], length * np.sin(0.3), rtol=1e-4)
        np.testing.assert_allclose(found[["a", "b", "c"]], table[["ia", "ib", "ic"]], atol=1e-9)
        assert found.attrs["units"]["id"] == found.attrs["units"]["c"] == "mA"


def gappy() -> pd.DataFrame:
    """Return a line 2 t with gaps of 2, 12 and 3 ms, the last at the end."""
    u = 2 * T
    for gap in (slice(100, 101), slice(500, 511), slice(1997, 2000)):
        u[gap] = np.nan
    return frame(u=u, i=np.sin(T))


def fill(**how: Any) -> Any:
    return reduced(gappy().assign(none=np.nan), **({"fill_missing": {"u": "linear"}} | how))


AXES = ParkTransform(("ia", "ib", "ic"), ("id", "iq"), speed="n")
TURNING = {**phases(T), "n": 1.0}


def units(table: pd.DataFrame, **said: str) -> pd.DataFrame:
    table.attrs["units"] = said
    return table


def held() -> Experiment:
    return Experiment(frame(u=1.0, y=1.0), ["u"], ["y"], interpolation="zoh")


WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: value("sinn(a)"), r"unknown function 'sinn' \(did you mean 'sin'"),
    (lambda: value("exp(a, b)"), "takes 1 argument, not 2"),
    (lambda: value("a + True"), r"'a \+ True': holds a truth value"),
    (lambda: value("a" + "+a" * 600), "1201 characters"),
    (
        lambda: reduced(frame(pulses=1.0), computed_columns={"x": "pulse"}),
        "column 'x': preprocessed column 'pulse' not",
    ),
    (lambda: reduced(frame(y=2.0), computed_columns={"time": "time * 2"}), "time 'time' cannot be computed"),
    (lambda: reduced(frame(x=1.0), lowpass_frequency=600.0), "600 Hz must be below half the sampling rate, 500 Hz"),
    (
        lambda: reduced(frame(x=1.0).assign(time=np.where(T[7] == T, T + 3e-4, T)), lowpass_frequency=50.0),
        "unequal sampling, 0.0013 s after row 7",
    ),
    (lambda: reduced(held(), lowpass_frequency=50.0), "'u' has interpolation"),
    (lambda: reduced(frame(x=T), start_time=2.5), "from 2.5 s leaves 0 samples; data are from 0 to 1.999 s"),
    (lambda: reduced(frame(x=T), start_time=0.1, end_time=0.1), r"from 0\.1 to 0\.1 s leaves 1 samples"),
    (lambda: reduced(frame(x=1.0), resample_interval=5.0), "resample_interval = 5 s is longer than the data"),
    (lambda: reduced(frame(x=1.0).iloc[[0, 1, 1, 2]], resample_interval=0.5), r"two samples at t = 0\.001 s"),
    (lambda: reduced(frame(x=T), detrend="cubic"), "detrend: unknown value 'cubic'"),
    (lambda: ParkTransform(("a", "b", "c"), ("d", "q")), "axes d, q need an angle or a speed"),
    (
        lambda: reduced(frame(**TURNING | {"n": np.where(T == 0.5, np.nan, 1.0)}), park=(AXES,)),
        "'n' has no value in row 501",
    ),
    (lambda: reduced(units(frame(**TURNING), ia="A"), park=(AXES,)), "units differ"),
    (lambda: reduced(units(frame(**TURNING), n="A"), park=(AXES,)), "'n' is in A, not convertible to rad/s"),
    (lambda: reduced(frame(**phases(T)), park=(AXES,)), "column 'n' not found"),
    (lambda: fill(max_gap=0.003), "at t = 0.5 s in a gap of 0.012 s; limit max_gap = 0.003 s"),
    (lambda: fill(), "the frame: column 'u': no value at t = 1.997 s and none after it"),
    (lambda: fill(fill_missing={"none": "linear"}), "column 'none': no value at t = 0 s and none before it"),
    (lambda: fill(fill_missing={"u": "pchip"}), "fill_missing: unknown value 'pchip'"),
    (lambda: fill(fill_missing={"v": "zoh"}), "preprocessed column 'v' not found"),
]


@pytest.mark.parametrize(("call", "said"), WRONG, ids=[said for _, said in WRONG])
def test_what_is_refused(call: Callable[[], object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        call()


def test_gaps_are_filled_on_lines_or_by_the_sample_before() -> None:
    straight = reduced(gappy(), fill_missing={"u": "linear"}, end_time=1.9)
    np.testing.assert_allclose(straight["u"], 2 * T[:1901], atol=1e-12)
    held = reduced(gappy(), fill_missing={"u": "zoh"})["u"].to_numpy()
    steps = np.arange(2000)
    steps[100], steps[500:511], steps[1997:] = 99, 499, 1996
    np.testing.assert_array_equal(held, 2 * T[steps])


def test_filling_comes_between_columns_and_axes() -> None:
    table = gappy().assign(ia=3.0, ib=-1.5, ic=-1.5)
    axes = ParkTransform(("ia", "ib", "ic"), ("id", "iq"), speed="w")
    found = reduced(table, computed_columns={"w": "5 * u"}, fill_missing={"w": "zoh"}, park=(axes,))
    assert np.isfinite(found[["w", "id"]]).all(axis=None)
    assert found["u"].isna().sum() == 15  # what is not named stays


def test_a_pause_is_not_bridged_unless_its_length_is_said() -> None:
    table = gappy()
    table.loc[600:620, "u"] = np.nan  # from 599 to 621: 22 steps of 1 ms
    with pytest.raises(InputError, match=r"at t = 0.6 s in a gap of 0.022 s; limit 20 intervals = 0.02 s"):
        reduced(table, fill_missing={"u": "linear"}, end_time=1.9)
    found = reduced(table, fill_missing={"u": "linear"}, max_gap=0.022, end_time=1.9)
    np.testing.assert_allclose(found["u"], 2 * T[:1901], atol=1e-12)


def lacking(*without: tuple[float, float]) -> pd.DataFrame:
    """Return a line 2 t without the rows between times."""
    kept = np.all([(a >= T) | (b <= T) for a, b in without], axis=0)
    return frame(u=2 * T, i=np.sin(T))[kept].reset_index(drop=True)


def test_missing_rows_of_what_drives_a_model_are_refused_as_missing_samples_are() -> None:
    table = lacking((0.5, 0.8))
    with pytest.raises(InputError) as caught:
        fmuid.Experiment(table, ["u"], ["i"], interpolation="zoh")
    said = r"rows missing from 0\.5 s \(row 501\) to 0\.8 s; usual interval 0\.001 s"
    assert re.search(said, str(caught.value))
    assert 'preprocess = { fill_missing = { "u" = "zoh" }, max_gap = 0.3 }' in str(caught.value)
    assert fmuid.Experiment(table, [], ["i"]).times.size == table.shape[0]  # nothing drives it
    assert fmuid.Experiment(table, ["u"], ["i"], measured=False).times.size == table.shape[0]  # a plan, not a record
    for word, expected in (("linear", 2 * T), ("zoh", np.where((T > 0.5) & (T < 0.7995), 1.0, 2 * T))):
        whole = reduced(table, fill_missing={"u": word}, max_gap=0.3)
        np.testing.assert_allclose(whole["time"], T, atol=1e-12)
        np.testing.assert_allclose(whole["u"], expected, atol=1e-12)
        made = fmuid.Experiment(whole, ["u"], ["i"])
        assert int(np.isnan(made.output_values).sum()) == 299  # nobody measured there
    for longest in (None, 0.29):
        with pytest.raises(InputError, match=r"no value at t = 0\.501 s in a gap of 0\.3 s"):
            reduced(table, fill_missing={"u": "linear"}, max_gap=longest)


@pytest.mark.parametrize(
    "times",
    [
        pytest.param(np.delete(T, slice(500, 518)), id="a short gap"),
        pytest.param(np.sort(np.concatenate([T[:300], 0.3 + 0.1 * np.arange(40)])), id="two rates"),
        pytest.param(np.append(T, 60.0), id="one sample at the end"),
        pytest.param(np.cumsum(np.tile([*[0.001] * 9, 0.1], 20)), id="bursts"),
        pytest.param(np.geomspace(1e-3, 1e3, 300), id="times by decades"),
        pytest.param(np.array([0.0, 1.0]), id="two samples"),
        pytest.param(np.repeat(T[:50], 2), id="each twice"),
    ],
)
def test_records_that_lack_no_rows(times: Floats) -> None:
    table = pd.DataFrame({"time": times, "u": 1.0, "i": times})
    assert fmuid.Experiment(table, ["u"], ["i"]).times.size == times.size
