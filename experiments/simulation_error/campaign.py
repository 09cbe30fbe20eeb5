"""Whether the error of a simulation ever comes through unsaid, on simulations that are right and wrong by design.

    python -m experiments.simulation_error.campaign

Run from the project's folder; it rewrites the table of README.md beside it. The measurements come from closed forms and
matrix exponentials; the FMUs whose co-simulation is explicit Euler are written in C and compiled here. Set
FMUID_EMPS_DATA to the path of the EMPS record to have that machine among them.
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import expm

import fmuid
from experiments import pages
from fmuid.array_types import Floats
from fmuid.estimation import AccuracyOutcome, Method
from fmuid.simulation import close
from tests.support.stepping import LAG, MOTOR, stepping_fmu

HERE = Path(__file__).parent
EXPERIMENTS = HERE.parent
STARTS, DRAWS = 200, 5
# An estimate is right within so many standard deviations; one of a thousand is not, by chance.
FAR = 4.0
STEP, LAG_TRUTH, LAG_NOISE = 0.05, 2.0, 0.004
MOTOR_STEP, MOTOR_TRUTH = 1e-3, {"R": 1.0, "L": 1.0 / 3e3, "K": 0.05, "J": 1e-4}
FRICTION, MOTOR_NOISE = 1e-5, (0.02, 0.05)
METHODS: dict[str, Method] = {
    "one start": fmuid.Marquardt(),
    "multi-start": fmuid.GlobalSearch(starts=10),
    "differential-evolution": fmuid.GlobalSearch(method="differential-evolution"),
}


class Case(NamedTuple):
    """An identification: its group in the table, the problem, how it is searched, the truth where that is known."""

    group: str
    problem: fmuid.Problem
    method: Method
    truth: Floats | None


def held(rng: np.random.Generator, count: int, repeat: int, size: float) -> Floats:
    """Return a command that is held, of random sign."""
    return np.repeat(rng.choice([-size, size], count), repeat)


def responded(rates: Floats, u: Floats, step: float) -> Floats:
    """Return the states (n, k) of x' = A x + b u for a held u, [A b] (k, k+1), by the matrix exponential."""
    states = len(rates)
    exact = expm(step * np.vstack([rates, np.zeros(states + 1)]))[:states]
    x = np.zeros((u.size, states))
    for i in range(u.size - 1):
        x[i + 1] = exact[:, :states] @ x[i] + exact[:, states] * u[i]
    return x


def lags(folder: Path) -> Iterator[Case]:
    """Yield x' = u − k x with Euler inside: with model exchange and without, with steps of its own and without."""
    for internal, exchange in [(0.0, True), (0.0, False), (STEP, True), (STEP, False)]:
        fmu = stepping_fmu(folder, LAG, internal=internal, exchange=exchange)
        steps = "steps of its own" if internal else "one step a sample"
        name = f"lag, Euler, {steps}, {'model exchange too' if exchange else 'co-simulation alone'}"
        for seed in range(DRAWS):
            rng = np.random.default_rng(seed)
            u = held(rng, 40, 10, 1.0)
            x = responded(np.array([[-LAG_TRUTH, 1.0]]), u, STEP)[:, 0] + LAG_NOISE * rng.standard_normal(u.size)
            frame = pd.DataFrame({"time": STEP * np.arange(u.size), "u": u, "x": x})
            table = fmuid.Experiment(frame, ["u"], ["x"], interpolation="zoh")
            for method in METHODS.values():
                start = {"k": fmuid.Parameter(float(rng.uniform(0.3, 6.0)), min=0.01, max=15.0)}
                yield Case(
                    name,
                    fmuid.Problem(fmu, table, start, noise=fmuid.Noise(delay_std=0.0)),
                    method,
                    np.array([LAG_TRUTH]),
                )


def motors(folder: Path) -> Iterator[Case]:
    """Yield a DC motor whose L/R is a third of the step, by Euler and by Runge–Kutta inside."""
    r, inductance, k, j = MOTOR_TRUTH.values()
    rates = np.array([[-r / inductance, -k / inductance, 1.0 / inductance], [k / j, -FRICTION / j, 0.0]])
    for order in (1, 4):
        for exchange in (True, False):
            fmu = stepping_fmu(folder, MOTOR, order=order, exchange=exchange)
            inside = {1: "Euler", 4: "Runge–Kutta"}[order]
            name = f"motor, {inside}, {'model exchange too' if exchange else 'co-simulation alone'}"
            for seed in range(DRAWS):
                rng = np.random.default_rng(seed)
                u = held(rng, 100, 15, 5.0)
                x = responded(rates, u, MOTOR_STEP) + rng.standard_normal((u.size, 2)) * MOTOR_NOISE
                frame = pd.DataFrame({"time": MOTOR_STEP * np.arange(u.size), "u": u, "i": x[:, 0], "w": x[:, 1]})
                table = fmuid.Experiment(frame, ["u"], ["i", "w"], interpolation="zoh")
                start = {
                    name: fmuid.Parameter(value * float(np.exp(rng.uniform(-0.7, 0.7))), min=1e-7)
                    for name, value in MOTOR_TRUTH.items()
                }
                problem = fmuid.Problem(fmu, table, start, values={"F": FRICTION}, noise=fmuid.Noise(delay_std=0.0))
                yield Case(name, problem, METHODS["one start"], np.array(list(MOTOR_TRUTH.values())))


def coils() -> Iterator[Case]:
    """Yield the coil from random starts, and its box; steps of 1 ms alias e^−0.04 at L = 1.42 mH."""
    study, truth = EXPERIMENTS / "coil" / "healthy.toml", np.array([4.0, 0.1])
    rng = np.random.default_rng(0)
    for r, inductance in np.exp(rng.uniform(np.log([0.1, 1e-3]), np.log([100.0, 1.0]), (STARTS, 2))).tolist():
        words = [f"parameters.R.start={r!r}", f"parameters.L.start={inductance!r}"]
        yield Case("coil, random starts", fmuid.Study.read(study, words).problem(), METHODS["one start"], truth)
    box = [f"parameters.{bound}" for bound in ("R.min=0.1", "R.max=100.0", "L.min=1e-3", "L.max=1.0")]
    for name in ("multi-start", "differential-evolution"):
        yield Case(f"coil, {name}", fmuid.Study.read(study, box).problem(), METHODS[name], truth)


def machines() -> Iterator[Case]:
    """Yield the induction machine and, where its record is here, the positioning drive under its control."""
    machine = fmuid.Study.read(EXPERIMENTS / "induction_machine" / "study.toml")
    yield Case("induction machine", machine.problem(), machine.estimator, None)
    record = os.environ.get("FMUID_EMPS_DATA")
    if record:
        drive = fmuid.Study.read(EXPERIMENTS / "emps" / "study.toml", [f"experiments.0.data={record}"])
        yield Case("EMPS", drive.problem(), drive.estimator, None)


def verdict(case: Case, result: fmuid.Result) -> str:
    """Return ``right``, ``said`` (that it is not, or may not be) or ``wrong``."""
    found = result.accuracy
    assert found is not None
    if not result.converged or found.outcome is not AccuracyOutcome.PASSED:
        return "said"
    if case.truth is None:
        return "right"
    return "right" if (np.abs(result.values - case.truth) < FAR * result.std).all() else "wrong"


def outcome(case: Case) -> tuple[str, bool, int]:
    """Return the verdict, whether a finer simulation took over, and what all of that took."""
    try:
        result = fmuid.identify(case.problem, case.method)
    except fmuid.FmuidError as error:  # the start cannot be simulated, which the sentence names
        print(case.group, error, sep=": ")
        return "said", False, 0
    found, said = result.accuracy, verdict(case, result)
    assert found is not None
    if said == "wrong":
        print(case.group, result.values, result.std, fmuid.Document.of(result), sep="\n")
    return said, bool(found.switches), found.simulations


def main() -> None:
    """Run all and write the table."""
    rows: dict[str, list[tuple[str, bool, int]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for cases in (lags(Path(folder)), motors(Path(folder)), coils(), machines()):
            for case in cases:
                rows.setdefault(case.group, []).append(outcome(case))
                close(case.problem.system)
            print(*rows, sep="; ", flush=True)
    shown: list[tuple[object, ...]] = []
    for group, found in rows.items():
        counts = Counter(said for said, _, _ in found)
        spent = [simulations for said, switched, simulations in found if said == "right" and not switched]
        cells = (counts[said] for said in ("right", "said", "wrong"))
        shown.append((group, len(found), *cells, sum(each[1] for each in found), max(spent) if spent else ""))
    heads = ["", "runs", "right", "said", "wrong", "finer simulation", "more simulations if none was needed, at most"]
    pages.rewrite(HERE, {"campaign": pages.table(heads, shown)})


if __name__ == "__main__":
    main()
