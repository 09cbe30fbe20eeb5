"""Figures of spectra: Bode and Nyquist against the numbers that are drawn."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import Noise
from fmuid.data import FrequencyExperiment, Response
from fmuid.identification import Contributions, find_contributions
from fmuid.identification.contributions import Contribution
from fmuid.reports.chart import Chart
from fmuid.reports.topics.row_charts import bands, contribution_sections, row_charts
from fmuid.simulation import OutputFit, fit_of

FREQUENCIES = np.logspace(-1.0, 2.0, 20)
SPECTRUM = 4.0 + 0.2j * np.pi * FREQUENCIES
COIL = fmuid.datasets.coil().fmu


def spectrum(of: str, values: np.ndarray, real: str, imaginary: str) -> FrequencyExperiment:
    table = {"f": FREQUENCIES[::-1], "re": values.real[::-1], "im": values.imag[::-1], "-im": -values.imag[::-1]}
    responses = {"Z": Response(of, real=real, imaginary=imaginary, conjugate=imaginary == "-im")}
    return FrequencyExperiment(pd.DataFrame(table), frequency="f", responses=responses)


def charts(fit: OutputFit, half: np.ndarray | None = None) -> list[Chart]:
    return [chart for row in row_charts(fit, half).rows for chart in row if chart is not None]


@pytest.mark.parametrize(
    ("of", "values", "imaginary", "label", "drawn"),
    [
        ("u / i", SPECTRUM, "im", "Im Z (Ohm)", SPECTRUM.imag),
        ("u / i", np.conj(SPECTRUM), "im", "−Im Z (Ohm)", SPECTRUM.imag),
        ("u / i", np.conj(SPECTRUM), "-im", "−Im Z (Ohm)", SPECTRUM.imag),
        ("u / i", SPECTRUM, "-im", "−Im Z (Ohm)", -SPECTRUM.imag),
        ("i / u", 1.0 / SPECTRUM, "im", "Im Z (A/V)", (1.0 / SPECTRUM).imag),
    ],
    ids=["inductive", "capacitive", "as of batteries", "both", "admittance"],
)
def test_nyquist_of_capacitive_impedances_has_its_arcs_upwards(
    of: str, values: np.ndarray, imaginary: str, label: str, drawn: np.ndarray
) -> None:
    unit = label[label.index("(") + 1 : -1]
    experiment = spectrum(of, values, "re", imaginary)
    experiment = FrequencyExperiment(
        experiment.frame,
        frequency="f",
        responses=experiment.responses,
        units={"Z.real": unit, "Z.imaginary": unit},
    )
    *bode, nyquist = charts(fit_of(fmuid.System.of(COIL), experiment, experiment.output_values))
    assert nyquist.y.label == label
    np.testing.assert_allclose(np.asarray(nyquist.layers[0].data["y"]), drawn, rtol=1e-5)
    assert bode[2].y.label == ("−" if imaginary == "-im" else "") + f"Z.imaginary ({unit})"


def test_what_experiments_bring_stands_below_its_parameters() -> None:
    """Sizes of freed errors have factors of their own, which are no column."""
    none = (np.full((1, 1), np.nan),)
    found = Contributions((Contribution("first", (2.0, np.inf, 7.0), 1, 0.25),), none, none, none)
    (section,) = contribution_sections(found, ("R", "L"), [])
    assert [each.head for each in section.table] == ["without", "R", "L", "agreement"]
    assert [each.cells[0] for each in section.table] == ["first", "× 2", "only here", "p = 0.25"]


@pytest.mark.parametrize("relative", [True, False])
def test_bands_of_bode_charts_are_the_noise(relative: bool) -> None:
    """Absolute noise is a smaller part of a larger response; estimates are all but exact."""
    noise = Noise(reading_std={"Z": 0.01}) if relative else Noise(std={"Z.real": 0.05, "Z.imaginary": 0.05})
    experiment = spectrum("u / i", SPECTRUM, "re", "im")
    free = {"R": fmuid.Parameter(3.0, min=0.1), "L": fmuid.Parameter(0.2, min=0.01)}
    problem = fmuid.Problem(COIL, experiment, free, noise=noise)
    result = fmuid.identify(problem)
    found = find_contributions(problem, result)
    assert found is not None
    fits = [fit_of(problem.system, experiment, result.fit.simulated[0])]
    (half,) = bands(found, fits, 1.0).values()
    _, error, *_ = charts(fits[0], half)
    level = np.full(20, 1.0) if relative else 5.0 / np.abs(SPECTRUM)
    expected = np.hypot(level, 100.0 * found.std[0][::-1, 0] / np.abs(SPECTRUM))
    np.testing.assert_allclose(np.asarray(error.layers[0].data["y1"]), expected, rtol=1e-4)
    np.testing.assert_allclose(np.asarray(error.layers[0].data["y0"]), -expected, rtol=1e-4)
