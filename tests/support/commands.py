"""Studies for the commands."""

from __future__ import annotations

SECOND = """
i_start = { start = 0.0, nominal = 0.1, per_experiment = true }
[[experiments]]
table = "second.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "hold"
"""
# Nothing but a search that is given no time.
HASTY = ["--set", "estimator.max_iterations=1", "--set", "estimator.remedies=false"]
