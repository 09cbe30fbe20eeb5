"""Models exported for this machine alone, which is quicker, and FMPy's low-level calls to their FMUs."""

import ctypes
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2
import fmpy.fmi3
import pytest

from fmuid.errors import ModelicaWarning
from fmuid.export import build, export_fmu
from tests.support.quick import first

both_versions = pytest.mark.parametrize("fmi", first(1, ["2.0", "3.0"]))
HERE = {"2.0": fmpy.platform, "3.0": fmpy.platform_tuple}


def export_text(folder: Path, text: str, **options: Any) -> Path:
    """Export the model in a text for this machine's platform."""
    name = text.split()[1]
    (folder / f"{name}.mo").write_text(text, encoding="utf-8")
    with here_only(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelicaWarning)  # models of tests may have parameters without a use
        return export_fmu(folder / f"{name}.mo", **options)


@contextmanager
def here_only() -> Iterator[None]:
    """Let exports compile for this machine's platform alone, and without the optimizer: results are the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "_FLAGS", tuple("-O0" if flag == "-O2" else flag for flag in build._FLAGS))
        only = {fmi: {name: build.PLATFORMS[fmi][name]} for fmi, name in HERE.items()}
        patch.setattr(build, "PLATFORMS", only)
        yield


class Running:
    """One instance of an exported FMU of either version and interface, its variables by name."""

    def __init__(self, fmu: Path, model_exchange: bool = False, folder: Path | None = None) -> None:
        folder = folder or fmu.with_name(fmu.stem + " unpacked")
        if not folder.exists():
            fmpy.extract(str(fmu), unzipdir=str(folder))
        self.description: Any = fmpy.read_model_description(str(folder))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.fmi3 = self.description.fmiVersion == "3.0"
        self.messages: list[str] = []
        slaves = (fmpy.fmi3.FMU3Slave, fmpy.fmi3.FMU3Model) if self.fmi3 else (fmpy.fmi2.FMU2Slave, fmpy.fmi2.FMU2Model)
        interface = self.description.modelExchange if model_exchange else self.description.coSimulation
        self.fmu: Any = slaves[model_exchange](
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=interface.modelIdentifier,
            instanceName="one",
        )
        self.instantiate()

    def instantiate(self) -> None:
        if self.fmi3:
            self.callback = fmpy.fmi3.fmi3LogMessageCallback(
                lambda _, __, ___, text: self.messages.append(text.decode())
            )
            self.fmu.instantiate(logMessage=self.callback)
            return
        self.callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(self.log)
        self.fmu.instantiate(callbacks=self.callbacks)

    def log(self, _: Any, name: bytes, status: int, category: bytes, text: bytes) -> None:
        assert (name, status, category) == (b"one", fmpy.fmi2.fmi2Error, b"logStatusError")
        self.messages.append(text.decode())

    def initialize(self, values: Mapping[str, float] | None = None, start: float = 0.0) -> None:
        if not self.fmi3:
            self.fmu.setupExperiment(startTime=start)
        self.set(values or {})
        self.fmu.enterInitializationMode(**({"startTime": start} if self.fmi3 else {}))
        self.fmu.exitInitializationMode()

    def set(self, values: Mapping[str, float]) -> None:
        call = self.fmu.setFloat64 if self.fmi3 else self.fmu.setReal
        call([self.references[name] for name in values], list(values.values()))

    def get(self, *names: str) -> list[float]:
        call = self.fmu.getFloat64 if self.fmi3 else self.fmu.getReal
        return list(call([self.references[name] for name in names]))

    def slopes(self, unknowns: Sequence[str], known: str) -> list[float]:
        """Return the directional derivatives of variables along another one."""
        unknown, size = [self.references[name] for name in unknowns], (len(unknowns),) if self.fmi3 else ()
        return list(self.fmu.getDirectionalDerivative(unknown, [self.references[known]], [1.0], *size))

    def slope(self, name: str, value: float) -> None:
        """Let an input move on along a slope (FMI 2.0 only)."""
        reference, order = (ctypes.c_uint * 1)(self.references[name]), (ctypes.c_int * 1)(1)
        self.fmu.fmi2SetRealInputDerivatives(self.fmu.component, reference, 1, order, (ctypes.c_double * 1)(value))

    def run(self, *steps: float, start: float = 0.0) -> float:
        """Co-simulate over steps of these lengths; return the time reached."""
        for h in steps:
            self.fmu.doStep(start, h)
            start += h
        return start

    # ---- model exchange

    def update(self) -> None:
        """Handle an event and go (back) to continuous-time mode."""
        if self.fmi3:
            assert not any(self.fmu.updateDiscreteStates())
        else:
            assert not any(self.fmu.newDiscreteStates())
        self.fmu.enterContinuousTimeMode()

    def at(self, time: float, *states: float) -> None:
        self.fmu.setTime(time)
        self.fmu.setContinuousStates((ctypes.c_double * len(states))(*states), len(states))

    def derivatives(self) -> list[float]:
        count = sum(v.derivative is not None for v in self.description.modelVariables)
        values = (ctypes.c_double * count)()
        call = self.fmu.getContinuousStateDerivatives if self.fmi3 else self.fmu.getDerivatives
        call(values, count)
        return list(values)

    def indicators(self) -> list[float]:
        count = self.fmu.getNumberOfEventIndicators() if self.fmi3 else self.description.numberOfEventIndicators
        values = (ctypes.c_double * count)()
        self.fmu.getEventIndicators(values, count)
        return list(values)

    @contextmanager
    def saved_state(self) -> Iterator[Callable[[], Any]]:
        """Save the state; give a function that restores it, and free it at the end."""
        kind = "FMUState" if self.fmi3 else "FMUstate"
        state = getattr(self.fmu, f"get{kind}")()
        yield lambda: getattr(self.fmu, f"set{kind}")(state)
        getattr(self.fmu, f"free{kind}")(state)

    def refused(self, call: Callable[[], Any]) -> str:
        """Return what the FMU says when a call fails."""
        self.messages.clear()
        with pytest.raises(fmpy.fmi1.FMICallException):
            call()
        assert len(self.messages) == 1
        return self.messages[0]

    def free(self) -> None:
        if self.fmi3:
            self.fmu.fmi3FreeInstance(self.fmu.component)
        else:
            self.fmu.fmi2FreeInstance(self.fmu.component)


@contextmanager
def running(fmu: Path, model_exchange: bool = False) -> Iterator[Running]:
    """Instantiate an FMU, for co-simulation unless said otherwise; free it at the end."""
    instance = Running(fmu, model_exchange)
    try:
        yield instance
    finally:
        instance.free()
