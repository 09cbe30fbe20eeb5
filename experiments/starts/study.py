"""Searches from far starts: three machines, forty draws each (experiments/starts/draws.py), with and without remedies.

    python -m experiments.starts.study [CASE...]      # all of them; rewrites draws.csv and README.md

Needs ``pip install '.[export]'``: DC motor and synchronous machine are exported from the Modelica files beside it.
"""

from __future__ import annotations

import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

import fmuid
from experiments import pages
from experiments.starts.draws import MACHINES, Record, draw
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.identification import assess, judge

HERE = Path(__file__).parent
FMUS = HERE.parents[1] / "fmus"
DRAWS = 40
CASES = {
    "DC motor, 50 to 300 %": ("dc", 0.0, 0.0),
    "DC motor, 3 to 30 times": ("dc", 3.0, 30.0),
    "PMSM, 50 to 300 %": ("pmsm", 0.0, 0.0),
    "PMSM, 3 to 30 times": ("pmsm", 3.0, 30.0),
    "induction machine, 50 to 300 %": ("im", 0.0, 0.0),
    "induction machine, 3 to 100 times": ("im", 3.0, 100.0),
}
"""How far away the starts lie."""
# A fit has found the machine where no output's residual exceeds that of the truth by more.
FOUND = 1.02


@cache
def fmu(kind: str) -> Path:
    """Return the FMU of a machine; one that is not among the project's is exported."""
    name = MACHINES[kind].name
    known = FMUS / name / f"{name}.fmu"
    if known.is_file():
        return known
    from fmuid.export import export_fmu

    folder = Path(tempfile.mkdtemp(prefix="fmuid-starts-"))
    return export_fmu(HERE / f"{name}.mo", folder / f"{name}.fmu")


def problem(kind: str, record: Record) -> fmuid.Problem:
    """Return the identification of a machine and its initial states from a record and its start."""
    machine = MACHINES[kind]
    inputs = {f"in_{name}": values for name, values in zip(machine.inputs, record.inputs.T, strict=True)}
    outputs = {f"out_{name}": values for name, values in zip(machine.outputs, record.measured.T, strict=True)}
    experiment = fmuid.Experiment(
        pd.DataFrame({"time": record.times, **inputs, **outputs}),
        {name: f"in_{name}" for name in machine.inputs},
        {name: f"out_{name}" for name in machine.outputs},
        interpolation="zoh",
    )
    start = record.start.tolist()
    parameters = {name: fmuid.Parameter(value, min=0.0) for name, value in zip(machine.parameters, start, strict=True)}
    parameters |= {
        name: fmuid.Parameter(0.0, nominal=size) for name, size in zip(machine.states, machine.nominal, strict=True)
    }
    return fmuid.Problem(fmu(kind), experiment, parameters, noise=fmuid.Noise(delay_std=0.0))


def searched(kind: str, seed: int, least: float, most: float, *, remedies: bool) -> dict[str, object]:
    """Search from one draw's start; return what came of it."""
    record = draw(kind, seed, least, most)
    whole, began = problem(kind, record), time.process_time()
    evaluator = Evaluator[LeastSquares](whole)
    row: dict[str, object] = {"kind": kind, "seed": seed, "far": most, "remedies": remedies}
    try:
        result = fmuid.identify(evaluator, restart=remedies)
    except fmuid.FmuidError:
        ended: dict[str, object] = {"found": False, "outcome": "error", "simulations": evaluator.simulations}
        ended |= {"way": "", "verdict": ""}
        return row | ended | {"cpu_s": time.process_time() - began}
    spent = time.process_time() - began
    noise = np.sqrt(np.nanmean((record.measured - record.clean) ** 2, axis=0))
    (fit,) = result.fit.frames
    outputs = MACHINES[kind].outputs
    left = [np.sqrt(np.nanmean((fit[f"measured.{name}"] - fit[f"simulated.{name}"]) ** 2)) for name in outputs]
    way = next((each.remedy.value for each in result.history.restarts if each.kept), "given")
    ended = {"found": bool((np.array(left) < FOUND * noise).all()), "outcome": result.outcome.value, "way": way}
    verdict = judge(result, assess(whole, result)) if remedies else None
    ended |= {"verdict": "" if verdict is None else verdict.grade.value}
    return row | ended | {"simulations": result.history.simulations, "cpu_s": spent}


def table(found: pd.DataFrame) -> str:
    """Return what came of each case as Markdown, with remedies and without."""
    rows = []
    for case, (kind, _, most) in CASES.items():
        for remedies in (True, False):
            part = found[(found["kind"] == kind) & (found["far"] == most) & (found["remedies"] == remedies)]
            if not len(part):
                continue
            ways = part["way"].fillna("").replace("", "nothing").value_counts()
            told = ", ".join(f"{way} {count}".replace("_", " ") for way, count in ways.items()) if remedies else ""
            count = f"{int(part['found'].sum())} of {len(part)}"
            effort = f"{part['simulations'].median():.0f}, {part['simulations'].max()}"
            passed = f"{int((part['verdict'] == 'passed').sum())}" if remedies else ""
            rows.append((case if remedies else "", "yes" if remedies else "no", count, effort, told, passed))
    return pages.table(["", "remedies", "found", "simulations (median, most)", "by", "PASSED"], rows)


def main() -> None:
    """Run the cases of the command line, or all; rewrite draws.csv and the page."""
    path = HERE / "draws.csv"
    rows: list[dict[str, object]] = []
    for case in sys.argv[1:] or CASES:
        if case not in CASES:
            raise SystemExit(f"there is no case {case!r}: give some of {', '.join(map(repr, CASES))}")
        kind, least, most = CASES[case]
        # without remedies that is left out: it stays among stiff points
        for remedies in (True,) if most > 30.0 else (True, False):
            rows += [searched(kind, seed, least, most, remedies=remedies) for seed in range(DRAWS)]
            print(table(pd.DataFrame(rows)).splitlines()[-1], flush=True)
    found = pd.DataFrame(rows)
    if path.is_file():
        before = pd.read_csv(path)
        keys = ["kind", "seed", "far", "remedies"]
        found = pd.concat([before, found]).drop_duplicates(keys, keep="last")
    found = pages.write(found, path, "%.4g")
    pages.rewrite(HERE, {"draws": table(found)})


if __name__ == "__main__":
    main()
