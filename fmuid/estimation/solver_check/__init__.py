"""The error of the simulation, and what it does to the estimates (docs/method.md section 5)."""
