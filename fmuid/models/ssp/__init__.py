"""System Structure and Parameterization (SSP 1.0, 2.0): packages, structures, parameter values."""
