"""Directed tests of experiments without a time: errors are found, and nothing where there is none."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import System
from fmuid.data import FrequencyExperiment, Response, RotatingFrame, SteadyExperiment
from fmuid.identification import DefectKind, ErrorKind, find_data_defects, find_model_errors, refit
from fmuid.identification.outlying_rows import find_outlying_rows
from fmuid.identification.output_directions import row_columns
from fmuid.simulation import AnySimulator, simulator_of
from tests.support.paths import FMUS
from tests.support.quick import first
from tests.support.resting import BISTABLE, MACHINE, induction_machine

COIL = fmuid.datasets.coil()
FREE = {"R": fmuid.Parameter(3.0, min=0.1), "L": fmuid.Parameter(0.2, min=0.01)}


def found_in(problem: fmuid.Problem) -> list[set[tuple[ErrorKind, tuple[str, ...]]]]:
    result = fmuid.identify(problem)
    assert result.converged
    errors = find_model_errors(problem, result)
    assert errors is not None
    return [{each.test.direction.key, *(other.key for other in each.alternatives)} for each in errors.errors]


def load_points(seed: int, gain: float = 0.0, offset: float = 0.0, saturation: float = 0.0) -> fmuid.Problem:
    """Return 24 points of the induction machine; saturation lowers Lf by the square of the current."""
    random, rows = np.random.default_rng(seed), []
    points = [(u, s) for u in (120.0, 180.0, 230.0) for s in (0.001, 0.01, 0.02, 0.04, 0.06, 0.1, 0.3, 1.0)]
    most = induction_machine(230.0, 1.0)[0]
    for u, s in points:
        current = induction_machine(u, s)[0]
        values = MACHINE | {"Lf": MACHINE["Lf"] * (1.0 - saturation * (current / most) ** 2)}
        current, power, torque = induction_machine(u, s, values)
        noise = 1.0 + 0.002 * random.normal(size=3)
        rows.append((u, s, *(np.array([current, power.real * (1.0 + gain), torque]) * noise), 0.0))
    table = pd.DataFrame(rows, columns=["U", "s", "I", "P", "T", "none"])
    table["I"] += offset
    supply = RotatingFrame(50.0, "U", slip="s", pole_pairs=2)
    outputs = {"I_rms": "I", "P": "P", "torque": "T"}
    experiment = SteadyExperiment(table, outputs=outputs, supply=supply)
    noise_std = fmuid.Noise(reading_std=0.002)
    free = {name: fmuid.Parameter(1.2 * value, min=1e-3) for name, value in MACHINE.items()}
    return fmuid.Problem(FMUS / "InductionMachine/InductionMachine.fmu", experiment, free, noise=noise_std)


def spectrum(seed: int, gain: float = 0.0, offset: float = 0.0, late: float = 0.0) -> list[fmuid.Experiment]:
    """Return a spectrum with errors, and a table without one."""
    random, rows = np.random.default_rng(seed), np.logspace(-1, 2, 31)
    noise = 0.002 * (random.normal(size=31) + 1j * random.normal(size=31))
    values = (4.0 + 0.2j * np.pi * rows) * (1.0 + noise) * (1.0 + gain) * np.exp(-2j * np.pi * rows * late) + offset
    frame = pd.DataFrame({"f": rows, "re": values.real, "im": values.imag})
    response = {"Z": Response("u / i", real="re", imaginary="im")}
    voltages = np.linspace(2.0, 12.0, 9)
    table = pd.DataFrame({"u": voltages, "i": voltages / 4.0 + 0.002 * random.normal(size=9)})
    return [
        FrequencyExperiment(frame, frequency="f", responses=response, name="spectrum"),
        SteadyExperiment(table, ["u"], ["i"], name="table"),
    ]


@pytest.mark.parametrize(
    ("error", "kind", "subject"),
    [
        ({"gain": 0.02}, ErrorKind.GAIN, ("P",)),
        ({"offset": 0.03}, ErrorKind.OFFSET, ("I_rms",)),
        ({"saturation": 0.1}, ErrorKind.SATURATION, ("Lf", "I_rms")),
    ],
)
def test_an_error_of_load_points_is_named(error: dict[str, float], kind: ErrorKind, subject: tuple[str, ...]) -> None:
    first, *_ = found_in(load_points(1, **error))
    assert (kind, subject) in first


@pytest.mark.parametrize(
    ("error", "kind", "size"),
    [
        ({"gain": 0.02}, ErrorKind.GAIN, 0.02),
        ({"late": 1e-4}, ErrorKind.RESPONSE_DELAY, 1e-4),
        ({"late": -1e-4}, ErrorKind.RESPONSE_DELAY, -1e-4),
        ({"offset": 0.1}, ErrorKind.OFFSET, 0.1),
    ],
)
def test_an_error_of_a_response_is_named(error: dict[str, float], kind: ErrorKind, size: float) -> None:
    problem = fmuid.Problem(COIL.fmu, spectrum(1, **error), FREE)
    result = fmuid.identify(problem)
    found = find_model_errors(problem, result)
    assert found is not None
    test = next(each for each in found.tests if each.direction.key == (kind, ("Z",)))
    assert (kind, ("Z",)) in found_in(problem)[0]
    assert abs(test.size - size) < 4.0 * test.std + 0.02 * abs(size)


def test_a_delay_of_a_response_is_freed() -> None:
    problem = fmuid.Problem(COIL.fmu, spectrum(1, late=2e-4)[:1], FREE)
    result = fmuid.identify(problem)
    found = find_model_errors(problem, result)
    assert found is not None
    assert found.covers_dynamics
    again = refit(problem, result, found)
    assert again is not None
    assert again.found is not None
    assert [each.kinds for each in again.found.freed] == [{ErrorKind.RESPONSE_DELAY}]
    assert not again.found.errors
    assert (abs(again.result.values - [4.0, 0.1, 2e-4]) < 3.5 * again.result.std).all()


def test_spectra_without_errors_raise_no_alarm() -> None:
    assert not found_in(fmuid.Problem(COIL.fmu, spectrum(1), FREE))


@pytest.mark.parametrize(
    "columns",
    [
        {"real": "re", "imaginary": "im"},
        {"magnitude": "size", "phase": "angle"},
        {"decibel": "dB", "phase": "angle", "conjugate": True},
    ],
    ids=["complex", "polar", "decibel"],
)
def test_directions_of_a_response_are_its_changes(columns: dict[str, Any]) -> None:
    """Delay and gain by differences of the simulator's own ones; an offset by that of the parts."""
    rows = np.logspace(-1, 2, 7)
    table = pd.DataFrame({"f": rows} | dict.fromkeys(("re", "im", "size", "angle", "dB"), np.ones(7)))

    def simulated(late: float) -> tuple[AnySimulator, np.ndarray]:
        response = {"Z": Response("u / i", delay=late, **columns)}
        made = simulator_of(System.of(COIL.fmu), FrequencyExperiment(table, frequency="f", responses=response), ["R"])
        return made, made(np.array([3.0]))

    simulator, values = simulated(0.0)
    directions = row_columns(simulator, np.array([3.0]), values, np.zeros((1, 7, 2)), {})
    found = {each.kind: each.column for each in directions}
    late = (simulated(1e-6)[1] - simulated(-1e-6)[1]) / 2e-6
    np.testing.assert_allclose(found[ErrorKind.RESPONSE_DELAY], late, rtol=1e-6, atol=1e-6)
    assert (ErrorKind.OFFSET in found) == ("decibel" not in columns)
    more = (simulator(np.array([3.0 + 1e-4])) - simulator(np.array([3.0 - 1e-4]))) / 2e-4  # R adds to Z
    if "decibel" not in columns:
        np.testing.assert_allclose(found[ErrorKind.OFFSET], more, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("by", ["time", "frequency"])
def test_values_that_an_experiment_holds_are_tested_as_those_of_the_model(by: str) -> None:
    held = {"R": 4.0} if by == "frequency" else {"R": 4.0, "i_start": 0.01}
    given: fmuid.Experiment = COIL.experiment if by == "time" else spectrum(1)[0]
    sizes = []
    for own in (True, False):
        experiment = dataclasses.replace(given, values=held if own else {})
        problem = fmuid.Problem(COIL.fmu, experiment, {"L": FREE["L"]}, values={} if own else held)
        found = find_model_errors(problem, fmuid.identify(problem))
        assert found is not None
        fixed = [each for each in found.tests if each.direction.kind is ErrorKind.FIXED]
        sizes.append({each.direction.subject: (each.size, each.std) for each in fixed})
    assert sizes[0].keys() == {(name,) for name in held}
    for subject, expected in sizes[1].items():
        assert sizes[0][subject] == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_rows_without_errors_raise_no_alarm() -> None:
    """The level is 1 %: two of 40 draws are rare."""
    assert sum(bool(found_in(load_points(100 + seed))) for seed in range(40)) <= 2


@pytest.mark.parametrize("relative", first(1, [True, False]))
def test_noise_of_load_points_that_follows_its_signal_is_in_their_intervals(relative: bool) -> None:
    """σ of R against its closed form; the regression i = u/R needs no FMU."""
    voltages = np.linspace(0.5, 12.0, 80)
    current = voltages / 4.0
    std = 0.01 * (current if relative else np.full(80, np.sqrt(np.mean(current**2))))
    slope = current / 4.0
    expected = np.sqrt(np.sum((slope * std) ** 2)) / np.sum(slope**2)
    found, uneven = [], 0
    for seed in range(10):
        table = pd.DataFrame({"u": voltages, "i": current + std * np.random.default_rng(seed).standard_normal(80)})
        problem = fmuid.Problem(COIL.fmu, SteadyExperiment(table, ["u"], ["i"]), {"R": FREE["R"]})
        result = fmuid.identify(problem)
        found.append(result.std[0])
        uneven += any(each.kind is DefectKind.UNEVEN for each in find_data_defects(problem, result))
    assert np.mean(found) == pytest.approx(expected, rel=0.08)
    assert uneven >= 8 if relative else uneven <= 1


@pytest.mark.parametrize("relative", [True, False])
def test_few_load_points_allow_for_noise_of_either_form(relative: bool) -> None:
    """The variance of R by regression in closed form: 12 rows, 40 draws, no form stated; a stated one is kept."""
    voltages = np.linspace(0.5, 12.0, 12)
    current = voltages / 4.0
    std = 0.01 * (current if relative else np.full(12, np.sqrt(np.mean(current**2))))
    slope = current / 4.0
    expected = np.sum((slope * std) ** 2) / np.sum(slope**2) ** 2
    found, uneven = [], 0
    for seed in range(40):
        table = pd.DataFrame({"u": voltages, "i": current + std * np.random.default_rng(seed).standard_normal(12)})
        experiment = SteadyExperiment(table, ["u"], ["i"])
        problem = fmuid.Problem(COIL.fmu, experiment, {"R": FREE["R"]})
        result = fmuid.identify(problem)
        found.append(result.std[0] ** 2)
        uneven += any(each.kind is DefectKind.EITHER for each in find_data_defects(problem, result))
    assert np.mean(found) == pytest.approx(expected, rel=0.15)
    assert uneven >= 36 if relative else uneven <= 12
    stated = fmuid.identify(fmuid.Problem(COIL.fmu, experiment, {"R": FREE["R"]}, noise=fmuid.Noise(std=0.01)))
    assert stated.std[0] == pytest.approx(0.01 / np.sqrt(np.sum(slope**2)), rel=0.01)


def lower_states(u: np.ndarray) -> np.ndarray:
    """Return the lower stable roots of u + x - x³."""
    roots = [np.roots([1.0, 0.0, -1.0, -each]) for each in u]
    return np.array([min(each.real for each in found if abs(each.imag) < 1e-6) for found in roots])


@pytest.mark.parametrize(("start", "rows"), first(2, [(0.9, 2), (1.05, 0), (0.85, 3)]))
def test_rows_that_leave_their_branch_are_outlying(made: Callable[[str], Path], start: float, rows: int) -> None:
    """From low starts the lower state of the last rows does not exist, and the search stays there."""
    u = np.linspace(-1.0, 0.38, 20)
    table = pd.DataFrame({"u": u, "x": lower_states(u) + 0.01 * np.random.default_rng(0).standard_normal(20)})
    experiment = SteadyExperiment(table, ["u"], ["x"], guess={"x": -1.0})
    problem = fmuid.Problem(made(BISTABLE), experiment, {"a": fmuid.Parameter(start)})
    found = find_data_defects(problem, fmuid.identify(problem))
    assert [(each.kind, each.values["rows"]) for each in found] == ([(DefectKind.OUTLYING, rows)] if rows else [])


def test_steady_states_are_checked_at_the_estimates(made: Callable[[str], Path]) -> None:
    """The start has one state a row, the estimates two."""
    u = np.linspace(0.2, 3.0, 12)
    x = -lower_states(-u) + 0.001 * np.random.default_rng(0).standard_normal(12)
    experiment = SteadyExperiment(pd.DataFrame({"u": u, "x": x}), ["u"], ["x"])
    problem = fmuid.Problem(made(BISTABLE), experiment, {"a": fmuid.Parameter(-1.0)})
    result = fmuid.identify(problem)
    assert result.values == pytest.approx([1.0], abs=0.01)
    assert [each.kind for each in find_data_defects(problem, result)] == [DefectKind.SEVERAL]


def test_an_outlying_row_and_copied_rows_are_named() -> None:
    voltages = np.linspace(2.0, 12.0, 9)
    current = voltages / 4.0 + 0.002 * np.random.default_rng(3).standard_normal(9)
    clean = pd.DataFrame({"u": voltages, "i": current})
    typed = clean.assign(i=np.where(voltages == 7.0, 1.57, current))  # 1.75
    found = {}
    for name, table in (("clean", clean), ("typed", typed), ("copied", pd.concat([clean, clean[:3]]))):
        problem = fmuid.Problem(COIL.fmu, SteadyExperiment(table, ["u"], ["i"]), {"R": FREE["R"]})
        found[name] = find_data_defects(problem, fmuid.identify(problem))
    assert not found["clean"]
    (outlying,), (copied,) = found["typed"], found["copied"]
    assert (outlying.kind, outlying.values["row"], outlying.values["rows"]) == (DefectKind.OUTLYING, 5.0, 1.0)
    assert (copied.kind, copied.values) == (DefectKind.TWICE, {"share": 0.25})


@pytest.mark.slow
def test_clean_rows_are_not_outlying() -> None:
    """The level is 1 %: of 300 draws at most 10 by the binomial test at 0.1 %."""
    alarms = 0
    for seed in range(300):
        random, voltages = np.random.default_rng(seed), np.linspace(2.0, 12.0, (5, 9, 30)[seed % 3])
        table = pd.DataFrame({"u": voltages, "i": voltages / 4.0 + 0.01 * random.standard_normal(voltages.size)})
        problem = fmuid.Problem(COIL.fmu, SteadyExperiment(table, ["u"], ["i"]), {"R": FREE["R"]})
        alarms += bool(find_outlying_rows(problem, fmuid.identify(problem)))
    assert alarms <= 10
