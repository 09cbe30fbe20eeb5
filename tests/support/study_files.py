"""A study file that uses every word, and its folder."""

from pathlib import Path

FULL = """
title = "Coil"

[model]
fmu = "sub/Coil.fmu"
interface = "co-simulation"
step_size = 1e-3

[model.fixed]
L = 0.1
n = 3
on = true
word = "fast"

[[experiments]]
data = "run1.csv"
inputs = ["u"]
outputs = { i = "current" }
interpolation = { u = "zoh" }
warmup = 0.05
units = { i = "mA" }

[[experiments]]
name = "second"
data = "run2.csv"
time = "t"
outputs = ["i"]

[parameters]
R = { start = 4.0, min = 0, prior = { mean = 4.1, std = 0.2 } }
dR = { start = 0.0, nominal = 1.0, max = inf, per_experiment = true }
"drive.M" = { start = 95.0 }

[noise]
variance = "estimate"

[estimation]
method = "levenberg-marquardt"
jacobian = "finite-difference"
"""


def write(folder: Path, text: str = FULL) -> Path:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path
