"""Optimization: one loop, and Levenberg–Marquardt (1.16) as its steps."""
