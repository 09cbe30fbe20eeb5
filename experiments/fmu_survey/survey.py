"""Simulate every FMU of some folders with fmuid and compare: a CSV table.

    python -m experiments.fmu_survey.survey FOLDER... [--json FILE]

Every FMU, interface and integrator runs in a process of its own (`experiments.fmu_survey.case`), so that an FMU that
crashes or hangs is one row of the table. See the README for where to get FMUs.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fmuid
from experiments.fmu_survey.case import TIGHT, TOLERANCE

CASES = (("co-simulation", "own"), ("model-exchange", "rk45"), ("model-exchange", "cvode"))
SHORT = {"co-simulation": "CS", "model-exchange": "ME"}
PATIENCE = 180.0  # s, for one case

LIMITS = {"plain loop": 1e-12, "table": 2e-5, "equations": 1e-6, "scipy on the FMU": 1e-6}
"""Largest deviation relative to the variable's range that counts as agreement: the same calls must give the same
numbers; tables have their digits; integrators get a hundred times the tolerance asked (1e-8)."""
BDF_SHARE = 10.0  # times as much for cvode: the errors of its small steps add up
SHRINKS = 0.01  # where a thousandth of the tolerance brings an error down to this share, it is the tolerance's


def limit(against: str, integrator: str) -> float:
    """Return the largest deviation that counts as agreement."""
    return LIMITS[against] * (BDF_SHARE if integrator == "cvode" else 1.0)


def tool_of(fmu: fmuid.FMU) -> str:
    """Return the exporting tool with its version, short."""
    text = re.split(r",| \(|[-~]dev", fmu.description.generation_tool)[0]
    return re.sub(r"Compiler (OMCompiler|OpenModelica) v?|Version ", "", text) or "not said"


@dataclass
class Row:
    """One FMU and interface against one reference."""

    fmu: fmuid.FMU
    kind: str
    against: str
    errors: dict[str, float] = field(default_factory=dict)
    tight: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    events: int = 0

    def verdict(self) -> str:
        """Say whether fmuid and the reference agree."""
        if self.notes:
            return "; ".join(dict.fromkeys(self.notes))
        if all(error <= limit(self.against, label) for label, error in self.errors.items()):
            return "ok"
        if self.kind == "co-simulation" and self.against != "plain loop":
            return "the FMU's own solver"
        finer = {label: self.tight.get(label, error) for label, error in self.errors.items()}
        if all(e <= max(limit(self.against, label), SHRINKS * self.errors[label]) for label, e in finer.items()):
            shown = ", ".join(f"{label} {error:.0e}" for label, error in self.tight.items())
            return f"follows the tolerance: at {TIGHT:.0e} {shown}"
        return "deviates"

    def cells(self) -> list[str]:
        """Return the cells of the row."""
        shown = ", ".join(f"{name} {error:.0e}".strip() for name, error in self.errors.items()) or "-"
        fmu, version = self.fmu.path.stem, self.fmu.description.fmi_version
        events = str(self.events or "")
        return [fmu, tool_of(self.fmu), version, SHORT[self.kind], self.against, events, shown, self.verdict()]


def run_case(path: Path, kind: str, integrator: str, tolerance: float = TOLERANCE) -> list[dict[str, Any]]:
    """Run one case in its own process; a crash or a hang becomes a line like the others."""
    command = [sys.executable, "-m", "experiments.fmu_survey.case", str(path), kind]
    command += [integrator, str(tolerance)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        out, err = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        err = f"no end within {PATIENCE:.0f} s"
    lines = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    if process.returncode:
        stage = [line["stage"] for line in lines if "stage" in line][-1:] or ["fmuid"]
        last = (err.strip().splitlines() or [""])[-1]
        lines.append({"failed": stage[0], "why": f"ended with {process.returncode}: {last}"})
        if stage[0] == "fmuid" and integrator != "none":  # does the FMU crash or hang in other hands too?
            lines += run_case(path, kind, "none")
    return [line for line in lines if "stage" not in line]


def run_cases(path: Path) -> dict[str, Any]:
    """Run all cases of an FMU; return the lines of each by (interface, integrator[, tighter tolerance])."""
    fmu = fmuid.FMU(path)
    found: dict[str, Any] = {}
    for kind, integrator in CASES:
        if kind not in fmu.description.interfaces:
            continue
        label = f"{SHORT[kind]} {integrator}"
        found[label] = lines = run_case(path, kind, integrator)
        compared = [line for line in lines if "error" in line]
        if kind == "model-exchange" and any(line["error"] > limit(line["against"], integrator) for line in compared):
            found[f"{label} {TIGHT}"] = run_case(path, kind, integrator, TIGHT)
    return found


def rows_of(fmu: fmuid.FMU, found: dict[str, Any]) -> list[Row]:
    """Return the rows of the table for an FMU and its lines."""
    rows: dict[tuple[str, str], Row] = {}
    for kind, integrator in CASES:
        label = f"{SHORT[kind]} {integrator}"
        name = integrator if kind == "model-exchange" else ""
        for line in found.get(label, []):
            against = line.get("against", "plain loop" if kind == "co-simulation" else "scipy on the FMU")
            row = rows.setdefault((kind, against), Row(fmu, kind, against))
            if "error" in line:
                row.errors[name] = line["error"]
                row.events = max(row.events, line["events"])
            elif "failed" in line:
                said = re.sub(r"/\S*/", "", line["why"]).replace("|", "/")
                row.notes.append(f"{name} {line['failed']} fails: {said[:200]}".strip())
        for line in found.get(f"{label} {TIGHT}", []):
            if "error" in line and (kind, line["against"]) in rows:
                rows[kind, line["against"]].tight[name] = line["error"]
    return list(rows.values())


def main() -> None:
    """Parse the command line, run, print the table as it grows."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--json", type=Path, help="write all comparisons here")
    arguments = parser.parse_args()
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["FMU", "tool", "FMI", "kind", "checked against", "events", "error", "verdict"])
    everything: dict[str, Any] = {}
    for path in sorted(p for folder in arguments.folders for p in folder.rglob("*.fmu")):
        try:
            everything[str(path)] = run_cases(path)
            for row in rows_of(fmuid.FMU(path), everything[str(path)]):
                table.writerow(row.cells())
        except fmuid.FmuidError as error:
            said = str(error).replace(str(path), path.name)
            table.writerow([path.stem, *[""] * 5, "-", f"not simulated: {said}"])
        sys.stdout.flush()
        if arguments.json:
            arguments.json.write_text(json.dumps(everything, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
