"""The server of isolated processes started ahead of the first FMU, so that it loads its code meanwhile."""

from __future__ import annotations

from fmuid.processes import SERVER

CODE = "fmuid.simulation.in_process"
"""What processes that run FMUs need to have loaded."""


def start_server() -> None:
    """Start the server; it loads its code while this process loads its own."""
    SERVER.start(CODE)
