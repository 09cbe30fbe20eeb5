"""Problems without an FMU: fakes, a coil in closed form, noise."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from fmuid import Parameter, SimulationError
from fmuid.array_types import Floats, Simulations
from fmuid.estimation import LeastSquares

TIMES, CLOCK = np.linspace(0.0, 2.0, 50), np.linspace(0.0, 3.0, 100)


@dataclass
class Fake:
    """Stands in for a simulator: two outputs of very different scale, failing where the first parameter is negative."""

    taken: list[Floats] = field(default_factory=list)

    def many(self, thetas: ArrayLike) -> Simulations:
        given = np.array(thetas, dtype=np.float64)
        self.taken.append(given)
        outputs = np.array([simulate(*theta) for theta in given])
        failed = given[:, 0] < 0
        outputs[failed] = np.nan
        error = SimulationError("Fake.fmu", 0.5, {"k": -1.0}, "fmi2DoStep returned fmi2Error")
        return Simulations(outputs, tuple(error if f else None for f in failed))


def simulate(k: float, gain: float, times: Floats = TIMES) -> Floats:
    return np.column_stack([1e3 * gain * np.exp(-k * times), 1e-3 * gain * np.sin(k * times)])


def two_outputs(theta: Floats) -> Floats:
    k, gain = theta.tolist()
    return simulate(k, gain, CLOCK)


def two_output_problem(seed: int = 1, **words: Any) -> LeastSquares:
    """Return a problem with two outputs of known noise."""
    noise = np.random.default_rng(seed).standard_normal((100, 2)) * [20.0, 1e-4]
    parameters = {"k": Parameter(0.8, min=0.0), "gain": Parameter(3.0)} | words.pop("parameters", {})
    measured = two_outputs(np.array([1.5, 2.0])) + noise
    return LeastSquares.from_function(two_outputs, measured, parameters, outputs=("u", "i"), times=CLOCK, **words)


def coil(theta: Floats, voltage: Floats) -> Floats:
    """The coil with its fault (1.69–1.80), exact for a held voltage: ΔL = 2τ ΔR."""
    step, tau = 1e-3, 0.0247
    resistance, inductance = theta[0] + theta[2], theta[1] + 2.0 * tau * theta[2]
    decay = math.exp(-resistance * step / inductance)
    return np.asarray(lfilter([0.0, (1.0 - decay) / resistance], [1.0, -decay], voltage))


def ar1(rng: np.random.Generator, share: float, count: int) -> Floats:
    """Return noise of variance 1 whose autocorrelation is share^lag, from a start in its own distribution."""
    steps = rng.standard_normal(count) * math.sqrt(1.0 - share**2)
    steps[0] /= math.sqrt(1.0 - share**2)
    return np.asarray(lfilter([1.0], [1.0, -share], steps))
