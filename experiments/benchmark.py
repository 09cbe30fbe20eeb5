"""How fast fmuid is, as ratios of things run alternately in one process: ``python experiments/benchmark.py``.

Needs ``fmuid[export]`` (for the C compiler of the comparison with C). Every figure is the best of several.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

import fmuid
from fmuid.simulation.instance import Instance
from fmuid.simulation.native.build import compiler_here

Array = NDArray[np.float64]
HERE = Path(__file__).parent
FMU_FILE = HERE.parent / "fmus" / "InductionMachine" / "InductionMachine.fmu"
STUDY_FILE = HERE / "induction_machine" / "study.toml"
PARAMETERS = ["Rs", "Rr", "Lm", "Lf"]
INPUTS, OUTPUTS = ["uds", "uqs", "w"], ["ids", "iqs"]

LOOP_IN_C = """
#include <stddef.h>
#include "fmi2FunctionTypes.h"
int loop(fmi2ResetTYPE *reset, fmi2SetupExperimentTYPE *setup, fmi2EnterInitializationModeTYPE *enter,
         fmi2ExitInitializationModeTYPE *leave, fmi2SetRealTYPE *set, fmi2GetRealTYPE *get,
         fmi2SetRealInputDerivativesTYPE *slope, fmi2DoStepTYPE *step, void *c, const unsigned *vp, const double *p,
         size_t np, const unsigned *vu, size_t nu, const unsigned *vy, size_t ny, const double *t, const double *u,
         double *y, size_t n) {
  int ones[3] = {1, 1, 1};
  double slopes[3];
  if (reset(c) > 1 || setup(c, 0, 0, t[0], 0, 0) > 1 || set(c, vp, np, p) > 1 || enter(c) > 1) return 1;
  if (set(c, vu, nu, u) > 1 || leave(c) > 1) return 1;
  for (size_t k = 0; k < n; k++) {
    if (set(c, vu, nu, u + k * nu) > 1 || get(c, vy, ny, y + k * ny) > 1) return 1;
    if (k + 1 == n) break;
    double h = t[k + 1] - t[k];
    for (size_t j = 0; j < nu; j++) slopes[j] = (u[(k + 1) * nu + j] - u[k * nu + j]) / h;
    if (slope(c, vu, nu, ones, slopes) > 1 || step(c, t[k], h, 1) > 1) return 1;
  }
  return 0;
}
"""
CALLED_IN_C = [
    "fmi2Reset",
    "fmi2SetupExperiment",
    "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode",
    "fmi2SetReal",
    "fmi2GetReal",
    "fmi2SetRealInputDerivatives",
    "fmi2DoStep",
]


def alternating(rounds: int, *tasks: Callable[[], object], repeat: int = 1) -> list[float]:
    """Return the best time of each task, s: the tasks in turn, the first one `repeat` times in each round."""
    best = [np.inf] * len(tasks)
    for _ in range(rounds):
        for i, task in enumerate(tasks):
            for _ in range(repeat if i == 0 else 1):
                began = time.perf_counter()
                task()
                best[i] = min(best[i], time.perf_counter() - began)
    return best


def fmpy_simulation(experiment: fmuid.Experiment, model_exchange: bool = False) -> Callable[[Array], Array]:
    """Return theta -> outputs by ``fmpy.simulate_fmu``: one instance, kept and reset, with held inputs; or CVode.

    (FMPy 0.3.32 can set input derivatives for FMUs with exactly nine inputs only, and applies no inputs inside CVode's
    right-hand side: that is compared in time only.)
    """
    folder = fmpy.extract(str(FMU_FILE))
    description = fmpy.read_model_description(folder, validate=False)
    times, signals = experiment.times, experiment.frame[["time", *INPUTS]].to_records(index=False)
    words: dict[str, Any] = {"fmi_type": "ModelExchange", "solver": "CVode", "relative_tolerance": 1e-7}
    words |= {"record_events": False}
    instance = None
    if not model_exchange:
        instance = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
        words = {"fmu_instance": instance, "terminate": False}

    def simulate(theta: Array) -> Array:
        if instance is not None:
            instance.reset()
        result = fmpy.simulate_fmu(
            folder,
            validate=False,
            start_time=float(times[0]),
            stop_time=float(times[-1]),
            output_interval=float(times[1] - times[0]),
            start_values=dict(zip(PARAMETERS, theta, strict=True)),
            input=signals,
            output=OUTPUTS,
            model_description=description,
            **words,
        )
        return np.column_stack([result[name] for name in OUTPUTS])

    return simulate


def c_simulation(experiment: fmuid.Experiment, folder: Path) -> Callable[[Array], Array]:
    """Return theta -> outputs by the same loop written in C for this one case."""
    source, library = folder / "loop.c", folder / ("loop" + fmpy.sharedLibraryExtension)
    source.write_text(LOOP_IN_C)
    headers = Path(fmpy.__file__).parent / "c-code"
    compiler = [*compiler_here(), "-O2", "-shared", "-fPIC", f"-I{headers}"]
    subprocess.run([*compiler, str(source), "-o", str(library)], check=True)
    loop = ctypes.CDLL(str(library)).loop
    fmu = fmuid.FMU(FMU_FILE)
    instance = Instance(fmu, "co-simulation", "c")
    dll: Any = instance.library
    functions = [ctypes.cast(getattr(dll, name), ctypes.c_void_p) for name in CALLED_IN_C]
    references = [
        np.array([fmu.description.variables[name].reference for name in names], np.uint32)
        for names in (PARAMETERS, INPUTS, OUTPUTS)
    ]
    times, inputs = np.array(experiment.times), np.array(experiment.input_values)
    outputs = np.empty((len(times), len(OUTPUTS)))

    def at(array: NDArray[Any]) -> ctypes.c_void_p:
        return ctypes.c_void_p(array.ctypes.data)

    def size(array: NDArray[Any]) -> ctypes.c_size_t:
        return ctypes.c_size_t(len(array))

    def simulate(theta: Array) -> Array:
        p, u, y = references
        handle = ctypes.c_void_p(instance.handle)
        values = np.array(theta)
        signals = (at(times), at(inputs), at(outputs), size(times))
        status = loop(*functions, handle, at(p), at(values), size(p), at(u), size(u), at(y), size(y), *signals)
        if status:
            raise RuntimeError("the loop in C failed")
        return outputs

    return simulate


def difference(got: Array, expected: Array) -> float:
    """Return the largest difference relative to the largest value."""
    return float(np.abs(got - expected).max() / np.abs(expected).max())


def compare_simulations(linear: fmuid.Experiment, held: fmuid.Experiment, by_fmpy: Callable[[Array], Array]) -> None:
    """Print how long one simulation of 4500 samples takes."""
    theta = np.array([9.8, 3.8, 0.436, 0.0762])
    simulator = fmuid.Simulator(FMU_FILE, held, PARAMETERS)
    ours, other = alternating(7, partial(simulator, theta), partial(by_fmpy, theta), repeat=30)
    apart = difference(simulator(theta), by_fmpy(theta))
    print(f"simulation: fmuid {1e3 * ours:.3f} ms, fmpy.simulate_fmu {1e3 * other:.1f} ms: ", end="")
    print(f"{other / ours:.0f} times as fast (outputs differ by {apart:.0e})")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        simulator, by_c = fmuid.Simulator(FMU_FILE, linear, PARAMETERS), c_simulation(linear, Path(folder))
        ours, other = alternating(300, partial(simulator, theta), partial(by_c, theta))
        apart = difference(simulator(theta), by_c(theta))
    print(f"simulation: fmuid {1e3 * ours:.3f} ms, the same loop in C {1e3 * other:.3f} ms: ", end="")
    print(f"{ours / other:.2f} times as long (outputs differ by {apart:.0e})")


def compare_fits(study: fmuid.Study, experiment: fmuid.Experiment, by_fmpy: Callable[[Array], Array]) -> None:
    """Print how long a whole identification takes from the study's starts, both with the same weights."""
    problem = study.problem()
    start = np.array(problem.parameters.start)
    measured = experiment.output_values

    def residual(theta: Array) -> Array:
        return (by_fmpy(theta) - measured).ravel()

    def fit_with_scipy() -> Any:
        return least_squares(residual, start, method="lm", x_scale=start)

    reference = fit_with_scipy()
    result = fmuid.identify(problem)
    ours, other = alternating(4, partial(fmuid.identify, problem), fit_with_scipy, repeat=10)
    print(f"fit: fmuid {1e3 * ours:.1f} ms ({result.history.simulations} simulations), ", end="")
    print(f"scipy least_squares(method='lm') over FMPy {other:.2f} s: {other / ours:.0f} times as fast")
    apart = np.abs((result.values - reference.x) / result.std).max()
    print(f"     the two optima are {apart:.0e} standard deviations apart")


def compare_model_exchange(linear: fmuid.Experiment) -> None:
    """Print how long one simulation of 4500 samples takes by model exchange, with each integrator."""
    theta = np.array([9.8, 3.8, 0.436, 0.0762])
    by_fmpy = fmpy_simulation(linear, model_exchange=True)
    exact = fmuid.Simulator(FMU_FILE, linear, PARAMETERS)(theta)
    for integrator in ("rk4", "rk45", "cvode"):
        numerics = fmuid.Numerics("model-exchange", integrator)
        simulator = fmuid.Simulator(fmuid.System(FMU_FILE, numerics=numerics), linear, PARAMETERS)
        ours, other = alternating(3, partial(simulator, theta), partial(by_fmpy, theta), repeat=10)
        print(f"model exchange: fmuid {integrator} {1e3 * ours:.2f} ms, FMPy's CVode {1e3 * other:.0f} ms: ", end="")
        print(f"{other / ours:.0f} times as fast (error {difference(simulator(theta), exact):.0e})")


def fmpy_system(
    parts: dict[str, str], connections: list[tuple[str, str]], fed: str, shown: str, times: Array, reference: Array
) -> Callable[[], Array]:
    """Return a loop in Python over FMPy's instances that passes outputs on at every sample."""
    instances: dict[str, Any] = {}
    references: dict[str, int] = {}
    for name, model in parts.items():
        folder = fmpy.extract(str(HERE.parent / "fmus" / model / f"{model}.fmu"))
        description = fmpy.read_model_description(folder, validate=False)
        instances[name] = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
        references |= {f"{name}.{v.name}": v.valueReference for v in description.modelVariables}

    def at(variable: str) -> tuple[Any, list[int]]:
        return instances[variable.partition(".")[0]], [references[variable]]

    links = [(*at(source), *at(target)) for source, target in connections]
    (driven, input_reference), (watched, output_reference) = at(fed), at(shown)

    def simulate() -> Array:
        for instance in instances.values():
            instance.reset()
            instance.setupExperiment(startTime=float(times[0]))
            instance.enterInitializationMode()
            instance.exitInitializationMode()
        found = []
        for k, time_ in enumerate(times.tolist()):
            driven.setReal(input_reference, [reference[k]])
            for source, output, target, input_ in links:
                target.setReal(input_, source.getReal(output))
            found.append(watched.getReal(output_reference)[0])
            if k + 1 < len(times):
                for instance in instances.values():
                    instance.doStep(time_, times[k + 1] - time_)
        return np.array(found)

    return simulate


SYSTEMS: dict[str, tuple[dict[str, str], list[tuple[str, str]], str, str]] = {
    "two coils": ({"one": "Coil", "other": "Coil"}, [("one.i", "other.u")], "one.u", "other.i"),
    "a drive under its controller": (
        {"drive": "PositionDrive", "controller": "PositionController"},
        [("drive.q", "controller.q"), ("drive.dq", "controller.dq"), ("controller.v", "drive.v")],
        "controller.qg",
        "controller.v",
    ),
}
"""Components, connections, the input that the table feeds and the output that is looked at."""


def compare_systems() -> None:
    """Print how long two coupled FMUs take, 5000 communication steps."""
    times: Array = np.linspace(0.0, 4.999, 5000)
    reference: Array = 0.1 * np.sin(3.0 * times)
    frame = pd.DataFrame({"time": times, "r": reference, "y": 0.0})
    for label, (parts, connections, fed, shown) in SYSTEMS.items():
        by_fmpy = fmpy_system(parts, connections, fed, shown, times, reference)
        system = fmuid.System(
            components={name: HERE.parent / "fmus" / model / f"{model}.fmu" for name, model in parts.items()},
            connections=[(source, target, 1.0, 0.0) for source, target in connections],
        )
        experiment = fmuid.Experiment(frame, {fed: "r"}, {shown: "y"}, interpolation="zoh")
        simulator = fmuid.Simulator(system, experiment)
        ours, other = alternating(5, partial(simulator, []), by_fmpy, repeat=20)
        apart = difference(simulator([])[:, 0], by_fmpy())
        print(f"{label}: fmuid {1e3 * ours:.2f} ms, a loop in Python over FMPy {1e3 * other:.0f} ms: ", end="")
        print(f"{other / ours:.0f} times as fast (outputs differ by {apart:.0e})")


def compare_isolation() -> None:
    """Print what a process of its own for the FMU costs: a simulation, and a whole identification."""
    study, isolated = (fmuid.Study.read(STUDY_FILE, isolated=away) for away in (False, True))
    theta = [parameter.start for parameter in study.parameters.values()]
    simulators = [each.simulators()[0] for each in (study, isolated)]
    here, there = alternating(10, *(partial(_often, partial(each, theta), 20) for each in simulators))
    print(f"FMU in a process of its own: simulation {1e3 * there / 20:.3f} ms, here {1e3 * here / 20:.3f} ms, ", end="")
    apart = difference(simulators[0](theta), simulators[1](theta))
    print(f"{there / here:.2f} times as long (outputs differ by {apart:.0e})")
    here, there = alternating(20, *(partial(fmuid.identify, each.problem()) for each in (study, isolated)))
    print(f"     identification {1e3 * there:.1f} ms, here {1e3 * here:.1f} ms: {there / here:.2f} times as long")


def _often(task: Callable[[], object], times: int) -> None:
    for _ in range(times):
        task()


FIRST_SIMULATION = f"""
import fmuid, pandas
table = pandas.DataFrame({{"time": [0.0, 0.1, 0.2], "u": [0.0, 1.0, 1.0], "i": [0.0, 0.0, 0.0]}})
model = {str(FMU_FILE.parents[1] / "Coil" / "Coil.fmu")!r}
fmuid.Simulator(model, fmuid.Experiment(table, ["u"], ["i"]), ["R"])([4.0])
"""


def compare_starts() -> None:
    """Print how long the commands take in a process of their own, their code compiled as an installation has it."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    run = partial(subprocess.run, check=True, capture_output=True)
    programs = (FIRST_SIMULATION, "import numpy, pandas")
    first, packages = alternating(7, *(partial(run, [sys.executable, "-c", each]) for each in programs))
    print(f"import fmuid and a first simulation: {first:.2f} s, of which numpy and pandas {packages:.2f} s")
    command = [sys.executable, "-m", "fmuid"]
    (helped,) = alternating(5, partial(subprocess.run, [*command, "--help"], check=True, capture_output=True))
    print(f"fmuid --help: {helped:.2f} s")
    with tempfile.TemporaryDirectory() as folder:
        job = [*command, "identify", str(STUDY_FILE), "--output", folder]
        (took,) = alternating(3, partial(subprocess.run, job, check=True, capture_output=True))
    print(f"fmuid identify of the induction machine: {took:.2f} s")


def main() -> None:
    """Run all comparisons."""
    (linear,) = fmuid.Study.read(STUDY_FILE).tables
    study = fmuid.Study.read(STUDY_FILE, ['experiments.0.interpolation="zoh"', "noise.variance=0.0462"])
    (held,) = study.tables
    by_fmpy = fmpy_simulation(held)
    compare_simulations(linear, held, by_fmpy)
    compare_model_exchange(linear)
    compare_systems()
    compare_fits(study, held, by_fmpy)
    compare_isolation()
    compare_starts()


if __name__ == "__main__":
    main()
