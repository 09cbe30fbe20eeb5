"""Models linear in their parameters: least squares, filtered equations, instrumental variables (1.1–1.12)."""
