"""The version of fmuid."""

__version__ = "0.1.0"
