"""Identify the physical parameters of models packaged as FMUs from tables of measurements."""

__version__ = "0.1.0"
