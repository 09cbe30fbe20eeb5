"""Concordia and Park against explicit matrices, and there and back."""

import numpy as np
import pandas as pd
import pytest

from fmuid import InputError
from fmuid.data.signals import concordia_transform, inverse_concordia, inverse_park, park_transform

PHASES = ("a", "b", "c")


def random_phases() -> pd.DataFrame:
    rng = np.random.default_rng(7)
    return pd.DataFrame(rng.normal(size=(50, 3)), columns=list(PHASES)).assign(theta=rng.uniform(-9, 9, 50))


def test_concordia_of_single_phases_gives_the_published_columns() -> None:
    unit = pd.DataFrame(np.eye(3), columns=list(PHASES))
    axes = concordia_transform(unit, PHASES, ("alpha", "beta"))
    assert list(axes.columns) == [*PHASES, "alpha", "beta"]
    np.testing.assert_allclose(axes["alpha"], [0.816496580928, -0.408248290464, -0.408248290464], rtol=1e-11)
    np.testing.assert_allclose(axes["beta"], [0.0, 0.707106781187, -0.707106781187], rtol=1e-11)


def test_park_of_every_row_against_the_explicit_matrices() -> None:
    frame = random_phases()
    axes = park_transform(frame, PHASES, ("d", "q"))
    for _, row in axes.iterrows():
        angle = -row["theta"]
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        matrix = np.sqrt(2 / 3) * np.array([[1, -0.5, -0.5], [0, np.sqrt(0.75), -np.sqrt(0.75)]])
        expected = rotation @ matrix @ row[list(PHASES)].to_numpy(dtype=float)
        np.testing.assert_allclose(row[["d", "q"]].to_numpy(dtype=float), expected, rtol=1e-12, atol=1e-14)


def test_round_trips_lose_the_zero_sequence() -> None:
    frame = random_phases()
    back, names = tuple(f"{name} back" for name in PHASES), list(PHASES)
    for there_and_back in (
        inverse_concordia(concordia_transform(frame, PHASES, ("x", "y")), ("x", "y"), back),
        inverse_park(park_transform(frame, PHASES, ("x", "y")), ("x", "y"), back),
    ):
        expected = frame[names].sub(frame[names].mean(axis=1), axis=0)
        np.testing.assert_allclose(there_and_back[list(back)], expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("columns", "names", "theta", "said"),
    [
        (("voltage", "b", "c"), "xy", "theta", r"'voltage' not found \(columns: a, b, c, theta, w\)"),
        (PHASES, "xy", "thet", r"'thet' not found \(did you mean 'theta'\?\)"),
        (("a", "b"), "xy", "theta", "columns = .*Give 3 different names"),
        (PHASES, ("dq",), "theta", "names = .*Give 2 different names"),
        (PHASES, ("a", "y"), "theta", "column 'a' exists already"),
        (("w", "b", "c"), "xy", "theta", "column 'w': 'x' in row 1"),
    ],
)
def test_wrong_columns_are_named(columns: tuple[str, ...], names: tuple[str, ...], theta: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        park_transform(random_phases().assign(w="x"), columns, tuple(names), theta=theta)
