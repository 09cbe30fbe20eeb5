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
from numpy.typing import NDArray
from scipy.optimize import least_squares

import fmuid
from fmuid.fmi.instance import Instance

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


def alternating(rounds: int, *tasks: Callable[[], object]) -> list[float]:
    """Return the best time of each task, s, run in turn."""
    best = [np.inf] * len(tasks)
    for _ in range(rounds):
        for i, task in enumerate(tasks):
            began = time.perf_counter()
            task()
            best[i] = min(best[i], time.perf_counter() - began)
    return best


def fmpy_simulation(experiment: fmuid.Experiment) -> Callable[[Array], Array]:
    """Return theta -> outputs by ``fmpy.simulate_fmu`` with one instance, kept and reset."""
    folder = fmpy.extract(str(FMU_FILE))
    description = fmpy.read_model_description(folder, validate=False)
    instance = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
    times = experiment.times
    signals = np.rec.fromarrays([times, *experiment.input_values.T], names=["time", *INPUTS])
    interval = float(times[1] - times[0])

    def simulate(theta: Array) -> Array:
        instance.reset()
        result = fmpy.simulate_fmu(
            folder,
            validate=False,
            start_time=float(times[0]),
            stop_time=float(times[-1]),
            output_interval=interval,
            start_values=dict(zip(PARAMETERS, theta, strict=True)),
            input=signals,
            output=OUTPUTS,
            model_description=description,
            fmu_instance=instance,
            set_input_derivatives=True,
            terminate=False,
        )
        return np.column_stack([result[name] for name in OUTPUTS])

    return simulate


def c_simulation(experiment: fmuid.Experiment, folder: Path) -> Callable[[Array], Array]:
    """Return theta -> outputs by the same loop written in C for this one case."""
    source, library = folder / "loop.c", folder / ("loop" + fmpy.sharedLibraryExtension)
    source.write_text(LOOP_IN_C)
    headers = Path(fmpy.__file__).parent / "c-code"
    compiler = [sys.executable, "-m", "ziglang", "cc", "-O2", "-shared", "-fPIC", f"-I{headers}"]
    subprocess.run([*compiler, str(source), "-o", str(library)], check=True)
    loop = ctypes.CDLL(str(library)).loop
    fmu = fmuid.FMU(FMU_FILE)
    instance = Instance(fmu, "c")
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


def compare_simulations(experiment: fmuid.Experiment, by_fmpy: Callable[[Array], Array]) -> None:
    """Print how long one simulation of 4500 samples takes."""
    theta = np.array([9.8, 3.8, 0.436, 0.0762])
    simulator = fmuid.Simulator(FMU_FILE, experiment, PARAMETERS)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        by_c = c_simulation(experiment, Path(folder))
        expected = simulator(theta)
        for name, other in (("fmpy.simulate_fmu", by_fmpy), ("C", by_c)):
            difference = np.abs(other(theta) - expected).max() / np.abs(expected).max()
            print(f"largest relative difference to {name}: {difference:.1e}")
        ours, fmpys = alternating(5, lambda: simulator(theta), lambda: by_fmpy(theta))
        print(
            f"simulation: fmuid {1e3 * ours:.3f} ms, fmpy.simulate_fmu {1e3 * fmpys:.1f} ms: {fmpys / ours:.0f} times"
        )
        ours, c = alternating(200, lambda: simulator(theta), lambda: by_c(theta))
        print(f"simulation: fmuid {1e3 * ours:.3f} ms, the same loop in C {1e3 * c:.3f} ms: {ours / c:.2f} of it")


def compare_fits(study: fmuid.Study, experiment: fmuid.Experiment, by_fmpy: Callable[[Array], Array]) -> None:
    """Print how long a whole identification takes from the study's starts."""
    problem = study.problem()
    start = np.array(problem.parameters.start)
    measured = experiment.output_values

    def fit_with_scipy() -> Any:
        return least_squares(lambda theta: (by_fmpy(theta) - measured).ravel(), start, method="lm", x_scale=start)

    results: dict[str, Any] = {}
    ours, scipys = alternating(
        3,
        lambda: results.update(fmuid=study.identify()),
        lambda: results.update(scipy=fit_with_scipy()),
    )
    kept, _ = alternating(10, lambda: fmuid.identify(problem), lambda: None)
    result, reference = results["fmuid"], results["scipy"]
    difference = np.abs(result.values / reference.x - 1).max()
    print(f"optimum: relative difference to scipy's {difference:.1e}")
    print(f"fit: fmuid {1e3 * ours:.1f} ms with reading the study, {1e3 * kept:.1f} ms without ", end="")
    print(f"({result.simulations} simulations)")
    print(f"fit: scipy least_squares(method='lm') over FMPy {scipys:.2f} s: {scipys / kept:.0f} times ", end="")
    print(f"({scipys / ours:.0f} with reading the study)")


def compare_starts() -> None:
    """Print how long the commands take in a process of their own."""
    command = [sys.executable, "-m", "fmuid"]
    (helped,) = alternating(5, lambda: subprocess.run([*command, "--help"], check=True, capture_output=True))
    print(f"fmuid --help: {helped:.2f} s")
    for label, rounds in (("first run ever, compiling", 1), ("cold", 3)):
        with tempfile.TemporaryDirectory() as folder:
            environment = os.environ | ({"NUMBA_CACHE_DIR": folder} if rounds == 1 else {})
            job = [*command, "identify", str(STUDY_FILE), "--output", folder]
            run = partial(subprocess.run, job, check=True, capture_output=True, env=environment)
            (took,) = alternating(rounds, run)
        print(f"fmuid identify of the induction machine ({label}): {took:.2f} s")


def main() -> None:
    """Run all comparisons."""
    study = fmuid.Study.read(STUDY_FILE)
    experiment = study.problem().experiments[0]
    by_fmpy = fmpy_simulation(experiment)
    compare_simulations(experiment, by_fmpy)
    compare_fits(study, experiment, by_fmpy)
    compare_starts()


if __name__ == "__main__":
    main()
