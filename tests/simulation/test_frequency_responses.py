"""Frequency responses: IEEE 115's standstill test by its circuit, all forms of tables, operating points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.stats

import fmuid
from fmuid import FmuidError, InputError, Noise, System
from fmuid.data import FrequencyExperiment, Response
from fmuid.simulation import simulator_of
from tests.support.resting import SATURATED, SYNCHRONOUS, SYNCHRONOUS_VALUES, saturated_motor, standstill_responses

COIL = fmuid.datasets.coil().fmu
FREQUENCIES = np.logspace(-3, 3, 61)
STANDSTILL = {"Zd": ("ud / id", None), "Zq": ("uq / iq", None), "sG": ("if_ / id", "ud")}
TRUTH = np.array(list(SYNCHRONOUS_VALUES.values()))


def standstill(seed: int | None = None, level: float = 0.005) -> FrequencyExperiment:
    columns, responses = {"f": FREQUENCIES}, {}
    random = np.random.default_rng(seed)
    for name, values in standstill_responses(FREQUENCIES).items():
        noise = random.normal(size=(2, values.size)) * (0.0 if seed is None else level)
        noisy = values * (1.0 + noise[0] + 1j * noise[1])
        columns |= {f"Re {name}": noisy.real, f"Im {name}": noisy.imag}
        responses[name] = Response(*STANDSTILL[name], f"Re {name}", f"Im {name}")
    return FrequencyExperiment(pd.DataFrame(columns), frequency="f", responses=responses)


def test_the_linear_model_is_the_circuit(made: Callable[[str], Path]) -> None:
    experiment = standstill()
    found = simulator_of(System.of(made(SYNCHRONOUS)), experiment, list(SYNCHRONOUS_VALUES))(TRUTH)
    sizes = np.column_stack([experiment.readings(name) for name in experiment.output_names])
    np.testing.assert_allclose(found / sizes, experiment.output_values / sizes, atol=1e-11)


def fits(fmu: Path, seeds: range) -> tuple[int, np.ndarray]:
    """Return how many of some draws and starts converge to the truth, and how many intervals cover each value."""
    converged, covered = 0, []
    for seed in seeds:
        starts = TRUTH * 2.0 ** np.random.default_rng(1000 + seed).uniform(-1.0, 1.0, TRUTH.size)
        free = {
            name: fmuid.Parameter(start, min=1e-3 * value)
            for (name, value), start in zip(SYNCHRONOUS_VALUES.items(), starts, strict=True)
        }
        result = fmuid.identify(fmuid.Problem(fmu, standstill(seed), free))
        converged += result.converged and bool((np.abs(result.values - TRUTH) < 6.0 * result.std).all())
        bounds = result.intervals(0.95)
        covered.append((bounds["lower"] <= TRUTH) & (bounds["upper"] >= TRUTH))
    return converged, np.sum(covered, axis=0)


def test_ten_parameters_converge_from_half_or_double(made: Callable[[str], Path]) -> None:
    assert fits(made(SYNCHRONOUS), range(1))[0] == 1


@pytest.mark.slow
def test_forty_of_forty_starts_converge(made: Callable[[str], Path]) -> None:
    converged, covered = fits(made(SYNCHRONOUS), range(40))
    assert converged == 40
    assert 0.90 < covered.mean() / 40 < 0.99


@pytest.mark.campaign
def test_intervals_of_spectra_cover(made: Callable[[str], Path]) -> None:
    """95 % of 400 draws, each parameter by the exact binomial test."""
    converged, covered = fits(made(SYNCHRONOUS), range(100, 500))
    print(f"covered: {covered} of 400, {converged} converged")
    assert converged == 400
    assert min(scipy.stats.binomtest(int(each), 400, 0.95).pvalue for each in covered) > 0.05 / TRUTH.size, covered


S = 2j * np.pi * np.array([1.0, 10.0, 100.0])
IMPEDANCE = 4.0 + 0.1 * S
PARTS = {
    "re": IMPEDANCE.real,
    "im": IMPEDANCE.imag,
    "mag": np.abs(IMPEDANCE),
    "dB": 20.0 * np.log10(np.abs(IMPEDANCE)),
    "deg": np.degrees(np.angle(IMPEDANCE)),
    "turns": np.degrees(np.angle(IMPEDANCE)) + np.array([360.0, -720.0, 0.0]),
    "late": np.degrees(np.angle(IMPEDANCE)) - np.degrees(1e-3 * S.imag),
    "admittance": np.abs(1.0 / IMPEDANCE),
    "rad": np.angle(IMPEDANCE),
    "negative": -IMPEDANCE.real,
    "f": S.imag / (2.0 * np.pi),
    "w": S.imag,
}


@pytest.mark.parametrize(
    "response",
    [
        Response("u / i", real="re", imaginary="im"),
        Response("u/i", imaginary="im"),
        Response("u / i", magnitude="mag", phase="deg"),
        Response("u / i", decibel="dB", phase="turns"),
        Response("u / i", phase="late", delay=1e-3),
        Response("i / u", magnitude="admittance"),
        Response("i", "u", magnitude="admittance"),
        Response("-u / i", real="negative"),
        Response(" - u/i ", real="negative"),
    ],
)
@pytest.mark.parametrize(("frequency", "unit"), [("f", "Hz"), ("w", "rad/s")])
def test_all_forms_of_a_response(response: Response, frequency: str, unit: str) -> None:
    units = {"frequency": unit}
    given = FrequencyExperiment(pd.DataFrame(PARTS), frequency=frequency, responses={"Z": response}, units=units)
    found = simulator_of(System.of(COIL), given, ["R", "L"])([4.0, 0.1])
    np.testing.assert_allclose(found, given.output_values, rtol=1e-10)


def test_columns_have_units() -> None:
    table = pd.DataFrame({"f": PARTS["f"], "Z": 1e3 * PARTS["mag"]})
    response = {"Z": Response("u / i", magnitude="Z")}
    given = FrequencyExperiment(table, frequency="f", responses=response, units={"Z.magnitude": "mOhm"})
    np.testing.assert_allclose(simulator_of(System.of(COIL), given, ["R"])([4.0]), given.output_values, rtol=1e-10)


def test_nonlinear_models_are_linearized_at_the_operating_point(made: Callable[[str], Path]) -> None:
    theta = np.array([0.6, 1.1, 900.0, 2e-3])
    r, k, c, b = theta
    (current, speed), load, voltage = saturated_motor(theta, np.array([[24.0, 1.0]]))[0], 1.0, 24.0
    psi = float(np.real(np.roots([c, 0.0, 50.0, -current])[-1]))
    slope = 50.0 + 3.0 * c * psi**2  # di/dpsi
    a = np.array([[-r * slope - k * speed, -k * psi], [100.0 * k * (current + psi * slope), -100.0 * b]])
    s = 2j * np.pi * np.array([0.1, 1.0, 10.0])
    wanted = [slope * np.linalg.solve(each * np.eye(2) - a, [1.0, 0.0])[0] for each in s]
    table = pd.DataFrame({"f": [0.1, 1.0, 10.0], "re": np.real(wanted), "im": np.imag(wanted)})
    response, point = {"Y": Response("i / u", real="re", imaginary="im")}, {"u": voltage, "load": load}
    given = FrequencyExperiment(table, frequency="f", responses=response, point=point)
    found = simulator_of(System.of(made(SATURATED)), given, ["R", "k", "c", "b"])(theta)
    np.testing.assert_allclose(found, given.output_values, rtol=1e-6)


@pytest.mark.parametrize("by", ["units", "header", "name"])
def test_phases_in_radians_are_degrees(by: str) -> None:
    column = "phi_rad" if by == "name" else "rad"
    table = pd.DataFrame(PARTS).rename(columns={"rad": column})
    table.attrs["units"] = {"rad": "rad"} if by == "header" else {}
    units = {"Z.phase": "rad"} if by == "units" else {}
    response = {"Z": Response("u / i", magnitude="mag", phase=column)}
    given = FrequencyExperiment(table, frequency="f", responses=response, units=units)
    again = dataclasses.replace(given, outputs=(), name="again")
    for each in (given, again):
        np.testing.assert_allclose(each.output_values[:, 1], PARTS["deg"], rtol=1e-12)
    found = simulator_of(System.of(COIL), given, ["R", "L"])([4.0, 0.1])
    np.testing.assert_allclose(found, given.output_values, rtol=1e-9)


@pytest.mark.parametrize(
    ("response", "more", "message"),
    [
        (Response("u / i", phase="rad"), {"units": {"Z.phase": "V"}}, "phase 'rad' is in 'V'. Give it in deg or rad"),
        (Response("y / i", real="re"), {}, "no signal 'y'"),
        (Response("i", real="re"), {}, "no input in 'i'. Set excited"),
        (Response("i / i", "i", real="re"), {}, "'i' is no input"),
        (Response("u / i", real="re"), {"point": {"i": 1.0}}, "point: 'i' is no input"),
        (Response("u / i", real="re"), {"units": {"frequency": "s"}}, "frequency must be in Hz or rad/s"),
        (Response("u / i", real="re"), {"frequency": "zero"}, "frequency must be above 0 in every row"),
        (Response("u / i", real="re"), {"units": {"Z.real": "A"}}, "'A' does not convert from"),
        (Response("u / i", real="zero"), {}, "noise.reading_std: output 'Z.real' is 0 in row 1"),
        (Response("u / i", real="re"), {"warmup": 1.0}, "warmup needs a time"),
    ],
)
def test_wrong_responses_are_refused(response: Response, more: dict[str, Any], message: str) -> None:
    frame = pd.DataFrame(PARTS | {"zero": np.zeros(3)})
    with pytest.raises(FmuidError, match=message):
        given = FrequencyExperiment(frame, **{"frequency": "f", "responses": {"Z": response}} | more)
        fmuid.identify(fmuid.Problem(COIL, given, {"R": fmuid.Parameter(3.0)}))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"of": "u / i / u", "real": "re"}, "is no ratio"),
        ({"of": "u / i"}, "no column"),
        ({"of": "u / i", "real": "re", "phase": "deg"}, "real and phase cannot be combined"),
        ({"of": "u / i", "magnitude": "mag", "decibel": "dB"}, "magnitude and decibel cannot be combined"),
    ],
)
def test_a_response_has_one_form(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Response(**keys)


def test_a_few_frequencies_show_no_noise_level() -> None:
    given = FrequencyExperiment(pd.DataFrame(PARTS), frequency="f", responses={"Z": Response("u/i", magnitude="mag")})
    assert np.isnan(fmuid.Problem(COIL, given, {"R": fmuid.Parameter(3.0)}).shown_noise).all()


def test_noise_is_a_fraction_of_the_magnitude_of_both_parts() -> None:
    random, rows = np.random.default_rng(5), np.logspace(-1, 3, 81)
    exact = 4.0 + 0.2j * np.pi * rows
    noisy = exact * (1.0 + 0.02 * random.normal(size=81) + 0.02j * random.normal(size=81))
    table = pd.DataFrame({"f": rows, "re": noisy.real, "im": noisy.imag})
    given = FrequencyExperiment(table, frequency="f", responses={"Z": Response("u / i", real="re", imaginary="im")})
    free = {"R": fmuid.Parameter(1.0, min=0.1), "L": fmuid.Parameter(1.0, min=0.01)}
    problem = fmuid.Problem(COIL, given, free)
    result = fmuid.identify(problem)
    relative = np.sqrt(list(result.fit.noise_variance.values())) / np.sqrt(np.mean(np.abs(noisy) ** 2))
    assert relative[0] == relative[1] == pytest.approx(0.02, rel=0.15)
    assert problem.shown_noise / np.sqrt(np.mean(np.abs(noisy) ** 2)) == pytest.approx([0.02, 0.02], rel=0.35)
    known = fmuid.identify(fmuid.Problem(COIL, given, free, noise=Noise(reading_std={"Z": 0.02})))
    assert known.values == pytest.approx(result.values, rel=1e-6)
    assert set(known.fit.given_variance) == {"Z.real", "Z.imaginary"}


def test_bands_follow_the_magnitude_of_a_new_response() -> None:
    random = np.random.default_rng(7)

    def spectrum(rows: np.ndarray) -> FrequencyExperiment:
        exact = 4.0 + 0.2j * np.pi * rows
        noisy = exact * (1.0 + 0.02 * (random.normal(size=rows.size) + 1j * random.normal(size=rows.size)))
        table = pd.DataFrame({"f": rows, "re": noisy.real, "im": noisy.imag})
        responses = {"Z": Response("u / i", real="re", imaginary="im")}
        return FrequencyExperiment(table, frequency="f", responses=responses)

    free = {"R": fmuid.Parameter(1.0, min=0.1), "L": fmuid.Parameter(1.0, min=0.01)}
    problem = fmuid.Problem(COIL, spectrum(np.logspace(-1, 3, 201)), free)
    new = spectrum(np.logspace(-1, 0, 201))  # where the magnitude is a hundredth of the largest
    prediction = fmuid.predict(fmuid.identify(problem), new)
    np.testing.assert_allclose(prediction.half_width, 1.96 * 0.02 * 4.0, rtol=0.15)
    inside = np.abs(new.output_values - prediction.fit.simulated) < prediction.half_width
    assert inside.mean() == pytest.approx(0.95, abs=0.03)
