"""Studies for the commands."""

from __future__ import annotations

SECOND = """
i_start = { start = 0.0, nominal = 0.1, per_experiment = true }
[[experiments]]
data = "second.csv"
inputs = ["u"]
outputs = ["i"]
interpolation = "zoh"
"""
# Nothing but a search that is given no time.
HASTY = ["--set", "estimation.max_iterations=1", "--set", "estimation.restarts=false"]
