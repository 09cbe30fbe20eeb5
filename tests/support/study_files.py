"""A study file that uses every word, and its folder."""

from __future__ import annotations

from pathlib import Path

FULL = """
title = "Coil"

[model]
fmu = "sub/Coil.fmu"
interface = "co-simulation"
step_size = 1e-3

[model.values]
L = 0.1
n = 3
on = true
word = "fast"

[[experiments]]
table = "run1.csv"
inputs = ["u"]
outputs = { i = "current" }
interpolation = { u = "hold" }
discard = 0.05
units = { i = "mA" }

[[experiments]]
name = "second"
table = "run2.csv"
time = "t"
outputs = ["i"]

[parameters]
R = { start = 4.0, min = 0, prior = { mean = 4.1, std = 0.2 } }
dR = { start = 0.0, nominal = 1.0, max = inf, per_experiment = true }
"drive.M" = { start = 95.0 }

[noise]
variance = "estimate"

[estimator]
method = "marquardt"
sensitivity = "finite-difference"
"""


def write(folder: Path, text: str = FULL) -> Path:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path
