"""FMUs in a process of their own."""

from __future__ import annotations

from fmuid.processes import SERVER

CODE = "fmuid.simulation.executor"  # what processes that run FMUs need to have loaded


def start_server() -> None:
    """Start the server of isolated processes, which loads its code meanwhile."""
    SERVER.start(CODE)
