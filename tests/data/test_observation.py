"""Phase signals as a map between a table and a machine in rotating axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, InputError, Normal, Parameter, read_data
from fmuid.data import Angle, Observation, Sensor, SensorMap

AXES = {"ids": ("ia", "ib"), "iqs": ("ia", "ib")}
VOLTAGES = {"uds": ("ua", "ub", "uc"), "uqs": ("ua", "ub", "uc")}
STAR = Observation(Angle(speed="w"), AXES, VOLTAGES)
THREE = dict.fromkeys(AXES, ("ia", "ib", "ic"))
DELTA = replace(STAR, currents=THREE, phases="delta")


def table(count: int = 200) -> pd.DataFrame:
    """Return currents and voltages of the axes with a speed, without any symmetry."""
    rng = np.random.default_rng(3)
    time = 1e-3 * np.arange(count)
    frame = pd.DataFrame({"time": time, "w": 150.0 + 5.0 * np.sin(9.0 * time)})
    frame["theta"] = np.concatenate([[0.0], np.cumsum(5e-4 * (frame.w.to_numpy()[1:] + frame.w.to_numpy()[:-1]))])
    for name in ("ids", "iqs", "uds", "uqs"):
        frame[name] = rng.standard_normal(count)
    return frame


def phases(frame: pd.DataFrame, observation: Observation) -> pd.DataFrame:
    """Return the phase signals of `frame`, written out line by line."""
    found = pd.DataFrame({"time": frame.time, "w": frame.w, "theta": frame.theta})
    root, sines = np.sqrt(2.0 / 3.0), (0.0, -2.0 * np.pi / 3.0, 2.0 * np.pi / 3.0)
    for d, q, letter in (("ids", "iqs", "i"), ("uds", "uqs", "u")):
        for name, shift in zip("abc", sines, strict=True):
            angle = frame.theta + shift
            found[letter + name] = root * (np.cos(angle) * frame[d] - np.sin(angle) * frame[q])
    if observation.phases == "delta":  # windings ab, bc, ca carry what the axes say
        a, b, c = (found[f"i{name}"].copy() for name in "abc")
        found["ia"], found["ib"], found["ic"] = a - c, b - a, c - b
        ab, _, ca = (found[f"u{name}"].copy() for name in "abc")
        found["ua"], found["ub"], found["uc"] = 0.0 * ab, -ab, ca
    return found


@pytest.mark.parametrize("observation", [STAR, DELTA, replace(STAR, angle=Angle(column="theta"))])
def test_phases_and_axes_are_one(observation: Observation) -> None:
    frame = table()
    experiment = Experiment(phases(frame, observation), ["w"], observation=observation)
    own = experiment.of_model
    assert own.output_names == ("ids", "iqs") and own.input_names == ("w", "uds", "uqs")
    np.testing.assert_allclose(own.output_values, frame[["ids", "iqs"]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(own.input_values[:, 1:], frame[["uds", "uqs"]], rtol=0, atol=1e-12)


def test_a_table_of_axes_is_mapped_back_exactly() -> None:
    frame, observation = table(), replace(STAR, source="dq")
    experiment = Experiment(frame, ["w"], observation=observation)
    there = phases(frame, STAR)
    assert experiment.output_names == ("ia", "ib")
    np.testing.assert_allclose(experiment.output_values, there[["ia", "ib"]], rtol=0, atol=1e-12)
    made = experiment.sensor_map
    assert made is not None
    back = made.axes(made.lines(np.array(observation.values)))
    np.testing.assert_allclose(back, frame[["uds", "uqs"]], rtol=0, atol=1e-12)
    again = replace(experiment, warmup=0.01)
    np.testing.assert_array_equal(again.output_values, experiment.output_values)


def test_held_voltages_enter_with_their_mean() -> None:
    frame = phases(table(40), STAR)
    held = Experiment(frame, ["w"], interpolation="zoh", observation=STAR).sensor_map
    assert held is not None and held.held
    lines = held.lines(np.array(STAR.values))
    found = held.axes(lines)
    at_rest = lines @ held.windings.T
    for k in (3, 17):  # by quadrature of the turning vector
        angles = held.angle[k] + (held.angle[k + 1] - held.angle[k]) * (np.arange(4000) + 0.5) / 4000
        turning = np.array([np.cos(angles), np.sin(angles)]), np.array([-np.sin(angles), np.cos(angles)])
        mean = [np.mean(at_rest[k] @ each) for each in turning]
        np.testing.assert_allclose(found[k], mean, rtol=1e-6)


def sensor_map(observation: Observation) -> SensorMap:
    made = Experiment(phases(table(), observation), ["w"], observation=observation).sensor_map
    assert made is not None
    return made


@pytest.mark.parametrize("delay", [0.0, 2.3e-4, -4e-4])
def test_readings_have_exact_derivatives(delay: float) -> None:
    made, frame = sensor_map(DELTA), table()
    smooth = np.column_stack([np.sin(30.0 * frame.time), np.cos(17.0 * frame.time)])
    values = np.array(DELTA.values)
    changed = {"gain(ia)": 1.02, "offset(ib)": 0.1, "delay(ia)": delay, "delay(ic)": -delay}
    for name, value in changed.items():
        values[DELTA.names.index(name)] = value
    found = made.derivatives(smooth, values)
    for k, name in enumerate(DELTA.names):
        step = 1e-7 if name.startswith("delay") else 1e-4
        moved = np.eye(values.size)[k] * step
        by_differences = (made.outputs(smooth, values + moved) - made.outputs(smooth, values - moved)) / (2.0 * step)
        inner = slice(2, -2)  # beyond the ends a current is constant
        np.testing.assert_allclose(
            found[k][inner], by_differences[inner], rtol=0, atol=2e-5 * max(1.0, abs(found[k]).max())
        )


def test_a_delay_reads_the_current_before() -> None:
    frame = table()
    values = np.array(replace(STAR, sensors={"ib": Sensor(delay=2e-4)}).values)
    made = sensor_map(STAR)
    slow = np.column_stack([np.sin(20.0 * frame.time), np.cos(20.0 * frame.time)])
    late = frame.time.to_numpy() - 2e-4
    speed = np.interp(late, frame.time, frame.w)
    angle = np.interp(late, frame.time, frame.theta) - 0.0 * speed
    expected = np.sqrt(2.0 / 3.0) * (
        np.cos(angle - 2.0 * np.pi / 3.0) * np.sin(20.0 * late)
        - np.sin(angle - 2.0 * np.pi / 3.0) * np.cos(20.0 * late)
    )
    np.testing.assert_allclose(made.outputs(slow, values)[2:, 1], expected[2:], rtol=0, atol=2e-5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Observation(Angle(), AXES), "phases of sensors are indistinguishable"),
        (lambda: replace(STAR, voltages={"uds": ("ia", "ub", "uc"), "uqs": ("ia", "ub", "uc")}), "'ia' has two roles"),
        (lambda: replace(STAR, currents={"ids": ("ia", "ia"), "iqs": ("ia", "ia")}), "'ia' has two roles"),
        (lambda: replace(STAR, phases="delta"), "sensors of three lines"),
        (lambda: replace(STAR, phases="star"), "unknown value 'star'"),  # type: ignore[arg-type]
        (lambda: replace(STAR, isolated=False), "no zero-sequence"),
        (lambda: replace(STAR, sensors={"ix": Sensor()}), "unknown column 'ix'"),
        (lambda: replace(STAR, voltages={"uds": ("ua", "ub"), "uqs": ("ua", "ub")}), "three columns"),
        (lambda: replace(STAR, currents={"ids": ("ia", "ib"), "iqs": ("ib", "ia")}), "the same columns"),
        (lambda: replace(STAR, currents={"ids": ("ia",)}), "1 variables"),
        (lambda: replace(STAR, currents=THREE, source="dq"), "gives two sensors"),
        (lambda: replace(STAR, phase_resistance={"d": 1.0}), "unknown phase 'd'"),
        (lambda: replace(STAR, voltages={}, dead_time_voltage=1.0), "need voltages"),
        (lambda: Sensor(gain=0.0), "gain = 0 shows nothing"),
        (lambda: Angle(speed="w", pole_pairs=0), "turns nothing"),
        (lambda: Experiment(table(), ["w", "uds"], observation=STAR), "'uds' has a column"),
        (lambda: Experiment(table().drop(columns="w"), [], observation=STAR), "speed"),
        (lambda: Experiment(phases(table(), STAR).drop(columns="uc"), ["w"], observation=STAR), "'uc'"),
        (lambda: Experiment(phases(table(), STAR).drop(columns="ib"), ["w"], observation=STAR), "'ib'"),
    ],
)
def test_bad_maps_get_one_sentence(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(")) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_units_of_columns_are_converted(tmp_path: Any) -> None:
    frame = phases(table(), STAR)
    frame = frame.assign(ua=1e-3 * frame.ua, w=frame.w * 30.0 / np.pi)
    frame.rename(columns={"ua": "ua [kV]", "w": "w [rpm]"}).to_csv(tmp_path / "a.csv", index=False)
    read = read_data(tmp_path / "a.csv")
    found = Experiment(read, ["w"], observation=STAR)
    own = Experiment(phases(table(), STAR), ["w"], observation=STAR)
    np.testing.assert_allclose(found.input_values[:, 1:], own.input_values[:, 1:], rtol=0, atol=1e-9)
    with pytest.raises(InputError, match="'ia' is in mA"):
        frame.rename(columns={"ia": "ia [mA]"}).to_csv(tmp_path / "b.csv", index=False)
        Experiment(read_data(tmp_path / "b.csv"), ["w"], observation=STAR)


def test_quantities_are_parameters() -> None:
    gain = Parameter(1.0, prior=Normal(1.0, 0.02))
    given = replace(STAR, sensors={"ib": Sensor(gain=gain)}, dead_time_voltage=Parameter(1.0))
    assert set(given.parameters) == {"gain(ib)", "dead_time_voltage"}
    assert given.parameters["gain(ib)"].min > 0.0
    assert given.unit("delay(ia)", {}) == "s" and given.unit("offset(ua)", {}) == "V"
