"""How a process that runs FMUs came to an end, in words."""

from __future__ import annotations

import os

from fmuid.processes import EXITED, FAILED, GARBLED, GREW, HUNG, KILLED, REFUSED, STOPPED, HostExitError


def end_words(end: HostExitError) -> str:
    """Return an end as a sentence goes on after the simulation.

    Of the limits, only those are named that were given (`HostExitError.number` is 0 otherwise): the others depend on
    the machine and on what ran before, and the same failure is to read the same.
    """
    if end.kind == EXITED:
        return f"it ended its process with exit code {end.number}"
    if end.kind == REFUSED:
        why = f" ({os.strerror(end.number)})" if end.number else ""
        return f"the system refused its process what it needs to go on{why}"
    if end.kind == GARBLED:
        return "it wrote into the connection of its process with fmuid"
    if end.kind == FAILED:
        return "code of fmuid failed in its process"
    if end.kind == STOPPED:
        return "its process was stopped (SIGSTOP) and did not go on"
    if end.kind == HUNG:
        limit = f"{end.number / 1e3:.4g} s" if end.number else "the default time limit (isolation.time_limit)"
        return f"it did not end within {limit} and was stopped"
    if end.kind == GREW:
        limit = f"{end.number} MB" if end.number else "the default share of the memory (isolation.memory)"
        return f"its process took more than {limit} and was stopped"
    if end.kind == KILLED:
        return f"its process was killed again and again with {end.signal_name}, from outside or for want of memory"
    return f"its process crashed with {end.signal_name}"
