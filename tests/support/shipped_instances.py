"""Instances of the shipped FMUs, driven call by call beside their equations."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2
import numpy as np

from tests.support.paths import FMUS
from tests.support.shipped_models import Array, Reference, drive


class Instance:
    """One instance of an FMU, variables by name."""

    def __init__(self, model: str, directory: Path, kind: type[Any] = fmpy.fmi2.FMU2Slave) -> None:
        if not (directory / "modelDescription.xml").exists():
            fmpy.extract(str(FMUS / model / f"{model}.fmu"), unzipdir=str(directory))
        self.description: Any = fmpy.read_model_description(str(directory))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages: list[str] = []
        self.callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(self.log)
        self.fmu: Any = kind(
            guid=self.description.guid, unzipDirectory=str(directory), modelIdentifier=model, instanceName="one"
        )
        self.fmu.instantiate(callbacks=self.callbacks)

    def log(self, _: Any, name: bytes, status: int, category: bytes, text: bytes) -> None:
        assert (name, status, category) == (b"one", fmpy.fmi2.fmi2Error, b"logStatusError")
        self.messages.append(text.decode())

    def initialize(self, values: dict[str, float] | None = None) -> None:
        self.fmu.setupExperiment()
        self.set(values or {})
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def start_model_exchange(self, values: dict[str, float]) -> None:
        self.initialize(values)
        assert self.fmu.newDiscreteStates() == (False, False, False, False, False, 0.0)
        self.fmu.enterContinuousTimeMode()

    def numbers(self, names: Sequence[str]) -> list[int]:
        return [self.references[name] for name in names]

    def set(self, values: dict[str, float]) -> None:
        self.fmu.setReal(self.numbers([*values]), [*values.values()])

    def get(self, *names: str) -> Array:
        return np.array(self.fmu.getReal(self.numbers(names)))

    def slopes(self, names: Sequence[str], values: Array, order: int = 1) -> None:
        n = len(names)
        self.fmu.fmi2SetRealInputDerivatives(
            self.fmu.component,
            (ctypes.c_uint * n)(*self.numbers(names)),
            n,
            (ctypes.c_int * n)(*[order] * n),
            (ctypes.c_double * n)(*values),
        )

    def derivatives(self, x: Array) -> Array:
        n = len(x)
        self.fmu.setContinuousStates((ctypes.c_double * n)(*x), n)
        rates = (ctypes.c_double * n)()
        self.fmu.getDerivatives(rates, n)
        return np.array(rates)

    def directional(self, unknowns: Sequence[str], known: str) -> Array:
        return np.array(self.fmu.getDirectionalDerivative(self.numbers(unknowns), self.numbers([known]), [1.0]))

    def run(self, reference: Reference, times: Array, inputs: Array, linear: bool) -> Array:
        """Co-simulate from the initialized state; outputs at the times."""
        names, rows = reference.inputs, []
        for k in range(len(times)):
            self.set(dict(zip(names, inputs[k], strict=True)))
            rows.append(self.get(*reference.outputs))
            if k + 1 < len(times):
                h = times[k + 1] - times[k]
                self.slopes(names, (inputs[k + 1] - inputs[k]) / h * linear)
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
