"""Instances of the shipped FMUs, driven call by call beside their equations."""

import ctypes
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tests.support.exported import Running
from tests.support.shipped_models import Array, Reference, drive


class Instance(Running):
    """One instance of a shipped FMU beside its reference."""

    def start_model_exchange(self, values: dict[str, float]) -> None:
        self.initialize(values)
        self.update()

    def ramps(self, names: Sequence[str], values: Array, order: int = 1) -> None:
        """Let inputs move on along their slopes."""
        n = len(names)
        orders, rates = (ctypes.c_int * n)(*[order] * n), (ctypes.c_double * n)(*values)
        references = (ctypes.c_uint * n)(*(self.references[name] for name in names))
        self.fmu.fmi2SetRealInputDerivatives(self.fmu.component, references, n, orders, rates)

    def rates(self, x: Array) -> Array:
        """Return the derivatives at states."""
        self.fmu.setContinuousStates((ctypes.c_double * len(x))(*x), len(x))
        return np.array(self.derivatives())

    def follow(self, reference: Reference, times: Array, inputs: Array, linear: bool) -> Array:
        """Co-simulate from the initialized state; outputs at the times."""
        names, rows = reference.inputs, []
        for k in range(len(times)):
            self.set(dict(zip(names, inputs[k], strict=True)))
            rows.append(self.get(*reference.outputs))
            if k + 1 < len(times):
                h = times[k + 1] - times[k]
                self.ramps(names, (inputs[k + 1] - inputs[k]) / h * linear)
                self.fmu.doStep(times[k], h)
        return np.array(rows)


Opener = Callable[..., Instance]


def relative_error(found: Array, expected: Array) -> float:
    return float(np.max(np.abs(found - expected).max(0) / np.abs(expected).max(0)))


def points(reference: Reference) -> Iterator[tuple[Array, Array]]:
    rng = np.random.default_rng(5)
    for _ in range(5):
        x = rng.uniform(-1, 1, len(reference.states))
        if reference.rates is drive:
            x[1] *= 2e-3  # where friction changes sign
        yield x, rng.uniform(-1, 1, len(reference.inputs)) * np.array(reference.amplitudes)
