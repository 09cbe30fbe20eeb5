"""An order to a process that runs FMUs which fails as code does whose memory an FMU has spoilt."""

from typing import Any

from fmuid.processes import shared_memory
from fmuid.simulation.isolation import server

RUN = server.run
MOST_GAIN = 2.9


def run(*arguments: Any) -> Any:
    """Simulate as ordered; fail where a gain is too large."""
    _, shape, size, _ = arguments
    _, gains, _ = server.arrays(shared_memory(size), shape)
    if (gains[:, 0] > MOST_GAIN).any():
        raise TypeError("'NoneType' object is not callable")
    return RUN(*arguments)
