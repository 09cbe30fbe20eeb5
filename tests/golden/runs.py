"""The runs whose numbers are kept: public functions only, data by closed forms and by integrators of others.

A run returns its numbers by name. The first part of a name says what may differ on another machine (`TOLERANCES`).
"""

import contextlib
import math
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd

import fmuid
from experiments.batches import campaign
from experiments.cascaded_tanks import study as tanks
from experiments.coil import study as coil
from experiments.induction_machine import chapter
from experiments.machine_faults import make_tables, models
from experiments.nist import study as nist
from experiments.starts import draws
from experiments.starts import study as starts
from fmuid.export import export_fmu
from tests.support.coil_records import warming
from tests.support.paths import FMUS, HERE, ROOT
from tests.support.shipped_models import REFERENCES

Numbers = dict[str, float | str]
Run = Callable[[], Numbers]

DATA = Path(os.environ.get("FMUID_RECORDED_DATA", ROOT / "recorded"))  # of others: emps/ and cascaded_tanks/
TOLERANCES = {
    "value": 0.02,  # of the standard deviation of the same run
    "std": 0.02,  # of itself
    "noise": 0.01,  # of itself
    "cost": 0.02,  # as it is: minus twice the logarithm of the likelihood
    "statistic": 0.05,  # of 1 + itself
    "probability": 0.02,  # of itself
    "time": 0.02,  # s
    "count": math.inf,  # simulations and iterations: the same on one machine only
}
"""How far a number may lie from the kept one on another machine, by the first part of its name."""


# --- identification


def of_result(result: fmuid.Result, prefix: str = "") -> Numbers:
    """Return the numbers of an identification."""
    found: Numbers = {f"text.{prefix}outcome": result.outcome.value}
    for name, value, std in zip(result.names, result.values, result.std, strict=True):
        found |= {f"value.{prefix}{name}": float(value), f"std.{prefix}{name}": float(std)}
    found |= {f"noise.{prefix}{name}": float(value) for name, value in result.fit.noise_variance.items()}
    counts = {"iterations": result.history.iterations, "simulations": result.history.simulations}
    return found | {f"cost.{prefix}total": result.fit.cost} | {f"count.{prefix}{each}": n for each, n in counts.items()}


FREE = {
    "Coil": ["R", "L"],
    "FaultyCoil": ["R", "dR", "L"],
    "CoilTurns": ["R", "lost"],
    "InductionMachine": ["Rs", "Rr", "Lm", "Lf"],
    "InductionMachineRotorFault": ["Rs", "Rr", "Lm", "Lf", "eta0"],
    "InductionMachineBrokenBars": ["Rs", "Rr", "Lm", "Lf"],
    "StatorShortCircuit": ["eta_a", "eta_b", "eta_c"],
    "StatorShortCircuitContact": ["eta_a", "contact"],
    "ThreePhaseInductionMachine": ["Rs", "Rr", "Lm", "Lf"],
    "SpeedController": ["K", "Ti", "Tr"],
    "CurrentController": ["Rs", "Lf", "T"],
    "CoilController": ["K", "Ti"],
    "CurrentSensor": ["gain"],
    "Inverter": ["T"],
    "MechanicalLoad": ["J", "f"],
    "PositionDrive": ["M", "Fv", "gtau"],
    "PositionController": ["kp", "kv"],
}
"""What is estimated of each shipped model; the rest is known."""


def shipped(model: str) -> Numbers:
    """Identify a shipped model from its equations, integrated by scipy, with 1 % of white noise."""
    reference, free = REFERENCES[model], FREE[model]
    times, inputs = reference.signals()
    outputs = reference.integrate(times, inputs, linear=True)
    noise = np.random.default_rng(3).standard_normal(outputs.shape)
    measured = outputs + 0.01 * np.std(outputs, axis=0) * noise
    columns = {f"in_{name}": values for name, values in zip(reference.inputs, inputs.T, strict=True)}
    columns |= {f"out_{name}": values for name, values in zip(reference.outputs, measured.T, strict=True)}
    experiment = fmuid.Experiment(
        pd.DataFrame({"time": times, **columns}),
        {name: f"in_{name}" for name in reference.inputs},
        {name: f"out_{name}" for name in reference.outputs},
    )
    known = {name: value for name, value in reference.parameters.items() if name not in free}
    parameters = {name: fmuid.Parameter(0.8 * reference.parameters[name], min=0.0) for name in free}
    problem = fmuid.Problem(
        FMUS / model / f"{model}.fmu", experiment, parameters, values=known, noise=fmuid.Noise(delay_std=0.0)
    )
    return of_result(fmuid.identify(problem))


def certified(name: str, start: int) -> Numbers:
    """Solve a NIST problem of higher difficulty."""
    return of_result(nist.solve(name, nist.read(HERE / "nist", name), start))


def chapter_pair() -> Numbers:
    """Identify the induction machine with the chapter's prior and without."""
    found = chapter.pair(chapter.experiment(fmuid.read_data(chapter.HERE / "table.csv")))
    return {key: value for name, each in found.items() for key, value in of_result(each, f"{name}.").items()}


def one_start(kind: str, seed: int, least: float, most: float) -> Numbers:
    """Identify a machine from a far start."""
    return of_result(fmuid.identify(starts.problem(kind, draws.draw(kind, seed, least, most))))


# --- recorded data of others


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """Give a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="fmuid-golden-") as folder:
        yield Path(folder)


def positioning_drive() -> Numbers:
    """Identify the recorded drive in closed loop, from one of its records."""
    with scratch() as folder:
        text = (ROOT / "experiments/emps/study.toml").read_text(encoding="utf-8").replace("../../fmus", FMUS.as_posix())
        text = text.replace("DATA_EMPS.mat", (DATA / "emps/DATA_EMPS.mat").as_posix())
        (folder / "study.toml").write_text(text, encoding="utf-8")
        return of_result(fmuid.Study.read(folder / "study.toml").identify())


def cascaded_tanks(model: str) -> Numbers:
    """Identify a model of the cascaded tanks."""
    with scratch() as folder:
        export_fmu(ROOT / "experiments/cascaded_tanks/CascadedTanks.mo", folder / "CascadedTanks.fmu")
        tanks.write_tables(DATA / "cascaded_tanks/dataBenchmark.csv", folder)
        (folder / "study.toml").write_text(tanks.MODELS[model], encoding="utf-8")
        return of_result(fmuid.Study.read(folder / "study.toml").identify())


# --- many cases


def batch() -> Numbers:
    """Identify a coil from twelve draws of noise, and summarise."""
    with scratch() as folder:
        frame = fmuid.Batch(campaign.write_study(folder, 12), folder / "out").run().frame
    found: Numbers = {}
    for row in frame.sort_values("case").to_dict("records"):
        for name in ("R", "L"):
            found |= {f"{kind}.{row['case']}.{name}": float(row[f"{kind}.{name}"]) for kind in ("value", "std")}
        found |= {f"text.{row['case']}": str(row["status"]), f"count.{row['case']}": int(row["simulations"])}
    return found


# --- diagnosis


def of_diagnosis(found: fmuid.Diagnosis) -> Numbers:
    """Return the numbers of a diagnosis: what is named, how surely, how large."""
    numbers: Numbers = {"text.kind": found.kind, "text.named": " or ".join(found.named)}
    for each in found.evidence.suspects:
        label = each.change.label
        numbers |= {f"statistic.{label}": each.statistic, f"probability.{label}": each.probability}
        numbers |= {f"value.{label}": found[label].value, f"std.{label}": found[label].std}
    return numbers


def coil_test(number: int) -> Numbers:
    """Diagnose a test of table 1.1."""
    healthy = fmuid.Result.from_json(coil.HERE / "healthy" / "result.json")
    return of_diagnosis(coil.diagnose(fmuid.read_data(coil.HERE / f"test{number}.csv"), healthy))


@cache
def healthy_machine() -> fmuid.Baseline:
    """Identify the healthy machine once for all cases."""
    clean = make_tables.simulate(make_tables.CASES["healthy"])
    return models.healthy(make_tables.add_noise(clean, np.random.default_rng([0, 1000])))


def machine_case(case: str) -> Numbers:
    """Diagnose a record of the machine in its windings."""
    return of_diagnosis(models.diagnose(make_tables.table(case), healthy_machine()))


def monitored(seconds: int, to: float, fails: float, size: float, grows: float) -> Numbers:
    """Monitor a coil that warms up and fails."""
    healthy = fmuid.Result.from_json(coil.HERE / "healthy" / "result.json")
    dr = {"dR": fmuid.Parameter(0.0, nominal=1.0)}
    fault = {"turns": fmuid.Fault(coil.models()[1], dr, values={"tau": 0.02497})}
    rule = fmuid.Rule(window=1.0, transient=0.2)
    monitor = fmuid.Monitor(fmuid.Baseline(healthy, coil.INFLATE), fault, coil.models()[0], rule)
    monitor.add(coil.experiment(warming(seconds, to, fails, size, seed=4, grows=grows)))
    found: Numbers = {"text.alarms": " ".join(each.fault for each in monitor.alarms)}
    for k, each in enumerate(monitor.alarms):
        found[f"time.{k}"] = each.time
        if each.onset is not None:
            found[f"time.{k}.onset"] = each.onset.likely.time
    for k, row in enumerate(monitor.table.to_dict("records")[::10]):
        for name in ("R", "turns.dR"):
            found |= {f"value.{k}.{name}": float(row[name]), f"std.{k}.{name}": float(row[f"{name}.std"])}
    return found


# --- all of them

MACHINES = ["healthy", "warm", "stator_a1", "stator_b5", "warm_stator_b10", "bars_1", "warm_bars_1"]
MONITORED = {
    "fault": (30, 5.0, 20.0, 0.5, 0.0),
    "warm only": (30, 4.8, math.inf, 0.5, 0.0),
    "growing fault": (30, 4.5, 10.0, 0.1, 0.05),
}
RUNS: dict[str, Run] = {
    **{f"shipped {model}": partial(shipped, model) for model in FREE},
    **{
        f"nist {path.stem} {start}": partial(certified, path.stem, start)
        for path in sorted((HERE / "nist").glob("*.dat"))
        for start in (0, 1)
    },
    "chapter": chapter_pair,
    **{
        f"start {kind} {seed} {most:g}": partial(one_start, kind, seed, least, most)
        for kind, far in (("dc", 30.0), ("pmsm", 30.0), ("im", 100.0))
        for least, most, count in ((0.0, 0.0, 7), (3.0, far, 7 if kind == "dc" else 6))
        for seed in range(count)
    },
    "positioning drive": positioning_drive,
    **{f"tanks {model}": partial(cascaded_tanks, model) for model in tanks.MODELS},
    "batch": batch,
    **{f"coil test {number}": partial(coil_test, number) for number in coil.TESTS},
    **{f"machine {case}": partial(machine_case, case) for case in MACHINES},
    **{f"monitored {name}": partial(monitored, *given) for name, given in MONITORED.items()},
}
"""Every run by its name."""
RECORDED = {"positioning drive", *(f"tanks {model}" for model in tanks.MODELS)}
"""Runs of data that the project does not have."""
