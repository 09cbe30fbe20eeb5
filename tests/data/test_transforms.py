"""Concordia and Park against explicit matrices, closed forms and the invariance of power."""

import numpy as np
import pandas as pd
import pytest

from fmuid.data.signals import concordia_transform, inverse_concordia, inverse_park, park_transform
from fmuid.errors import InputError

PHASES = ("a", "b", "c")


def balanced(peak: float = 3.0, omega: float = 314.0, delay: float = 0.4) -> pd.DataFrame:
    t = np.linspace(0.0, 0.05, 101)
    turns = {name: peak * np.cos(omega * t - delay - k * 2 * np.pi / 3) for k, name in enumerate(PHASES)}
    return pd.DataFrame({"time": t, **turns, "theta": omega * t})


def random_phases(zero_sum: bool) -> pd.DataFrame:
    rng = np.random.default_rng(7)
    values = rng.normal(size=(50, 3))
    if zero_sum:
        values -= values.mean(axis=1, keepdims=True)
    return pd.DataFrame(values, columns=list(PHASES)).assign(theta=rng.uniform(-9, 9, 50))


def test_concordia_of_single_phases_gives_the_published_columns() -> None:
    unit = pd.DataFrame(np.eye(3), columns=list(PHASES))
    axes = concordia_transform(unit, PHASES, ("alpha", "beta"))
    assert list(axes.columns) == [*PHASES, "alpha", "beta"]
    np.testing.assert_allclose(axes["alpha"], [0.816496580928, -0.408248290464, -0.408248290464], rtol=1e-11)
    np.testing.assert_allclose(axes["beta"], [0.0, 0.707106781187, -0.707106781187], rtol=1e-11)


def test_park_of_every_row_against_the_explicit_matrices() -> None:
    frame = random_phases(zero_sum=False)
    axes = park_transform(frame, PHASES, ("d", "q"))
    for _, row in axes.iterrows():
        angle = -row["theta"]
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        matrix = np.sqrt(2 / 3) * np.array([[1, -0.5, -0.5], [0, np.sqrt(0.75), -np.sqrt(0.75)]])
        expected = rotation @ matrix @ row[list(PHASES)].to_numpy(dtype=float)
        np.testing.assert_allclose(row[["d", "q"]].to_numpy(dtype=float), expected, rtol=1e-12, atol=1e-14)


def test_power_is_the_same_in_both() -> None:
    u, i = random_phases(zero_sum=False), random_phases(zero_sum=True)
    u["theta"] = i["theta"]
    udq, idq = (park_transform(frame, PHASES, ("d", "q"))[["d", "q"]].to_numpy() for frame in (u, i))
    power = (u[list(PHASES)].to_numpy() * i[list(PHASES)].to_numpy()).sum(axis=1)
    np.testing.assert_allclose((udq * idq).sum(axis=1), power, rtol=1e-12, atol=1e-13)


def test_round_trips_without_zero_sequence() -> None:
    frame = random_phases(zero_sum=True)
    back = tuple(f"{name} back" for name in PHASES)
    for there_and_back in (
        inverse_concordia(concordia_transform(frame, PHASES, ("x", "y")), ("x", "y"), back),
        inverse_park(park_transform(frame, PHASES, ("x", "y")), ("x", "y"), back),
    ):
        np.testing.assert_allclose(there_and_back[list(back)], frame[list(PHASES)], rtol=0, atol=1e-13)


def test_the_zero_sequence_is_lost() -> None:
    frame = random_phases(zero_sum=False)
    back = inverse_concordia(concordia_transform(frame, PHASES, ("x", "y")), ("x", "y"), ("a back", "b back", "c back"))
    zero = frame[list(PHASES)].mean(axis=1)
    np.testing.assert_allclose(back["a back"], frame["a"] - zero, atol=1e-13)


def test_wrong_columns_are_named() -> None:
    frame = balanced()
    with pytest.raises(InputError, match=r"'voltage' not found \(columns: time, a, b, c, theta\)"):
        concordia_transform(frame, ("voltage", "b", "c"), ("x", "y"))
    with pytest.raises(InputError, match=r"'thet' not found \(did you mean 'theta' or 'time'\?\)"):
        park_transform(frame, PHASES, ("x", "y"), theta="thet")
    with pytest.raises(InputError, match=r"columns = .*Give 3 different names"):
        concordia_transform(frame, ("a", "b"), ("x", "y"))
    with pytest.raises(InputError, match="names = 'dq'"):
        park_transform(frame, PHASES, "dq")
    with pytest.raises(InputError, match="column 'time' exists already"):
        park_transform(frame, PHASES, ("time", "y"))
    with pytest.raises(InputError, match="column 'a': 'x' in row 2"):
        concordia_transform(frame.astype({"a": object}).replace({"a": {frame["a"][1]: "x"}}), PHASES, ("x", "y"))
