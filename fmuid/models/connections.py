"""Connections of a system, and their order of exchange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import NamedTuple

from fmuid.errors import InputError
from fmuid.models.description import Description


class Connection(NamedTuple):
    """An output and its target input, each as (component, inner name).

    The input is factor times the output plus offset.
    """

    source: tuple[str, str]
    target: tuple[str, str]
    factor: float = 1.0
    offset: float = 0.0


def exchange_order(
    connections: Sequence[Connection], descriptions: Mapping[str, Description]
) -> tuple[tuple[tuple[Connection, ...], bool], ...]:
    """Return the connections in groups, each after those it depends on directly; a flag marks algebraic loops."""
    feeding = {connection.target: i for i, connection in enumerate(connections)}
    needs: list[set[int]] = []
    for component, output in (connection.source for connection in connections):
        declared = descriptions[component].dependencies.get(output)
        direct = descriptions[component].inputs if declared is None else declared
        needs.append({feeding[component, name] for name in direct if (component, name) in feeding})
    members: dict[int, list[int]] = {}
    for i, label in enumerate(_loops(needs)):
        members.setdefault(label, []).append(i)
    groups: list[tuple[tuple[Connection, ...], bool]] = []
    waiting, done = dict(members), set[int]()
    while waiting:
        ready = [label for label, some in waiting.items() if all(needs[i] <= done | {*some} for i in some)]
        plain = [i for label in ready for i in waiting[label] if not needs[i] & {*waiting[label]}]
        if plain:
            groups.append((tuple(sorted(connections[i] for i in plain)), False))
        for label in ready:
            some = waiting.pop(label)
            done |= {*some}
            if some[0] not in plain:
                groups.append((_loop([connections[i] for i in some], descriptions), True))
    return tuple(groups)


def _loops(needs: Sequence[set[int]]) -> list[int]:
    """Return each connection's loop number; a connection outside loops has its own."""
    try:
        TopologicalSorter(dict(enumerate(needs))).prepare()
        return list(range(len(needs)))
    except CycleError:
        from scipy.sparse import coo_array  # slow to import
        from scipy.sparse.csgraph import connected_components
    edges = [(i, j) for i, needed in enumerate(needs) for j in needed]
    rows, columns = ([edge[side] for edge in edges] for side in (0, 1))
    graph = coo_array(([1] * len(edges), (rows, columns)), (len(needs), len(needs)))
    labels: list[int] = connected_components(graph, connection="strong")[1].tolist()
    return labels


def _loop(loop: Sequence[Connection], descriptions: Mapping[str, Description]) -> tuple[Connection, ...]:
    for component, output in (connection.source for connection in loop):
        kind = descriptions[component].variables[output].type
        if kind != "Real":
            through = " -> ".join(".".join(filter(None, each.source)) for each in loop)
            source = ".".join(filter(None, (component, output)))
            raise InputError(
                f"algebraic loop {through}: {source!r} is of type {kind}, not Real. "
                "Break it with a component without direct feedthrough."
            )
    return tuple(loop)
