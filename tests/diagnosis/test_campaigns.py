"""Campaigns: false alarms and lasting alarms of a monitored coil of its own equations, under noise of four kinds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fmuid
from experiments.coil import study as coil
from fmuid.diagnosis import compute_stored_baseline
from tests.support.operated_coil import FAULTS, KINDS, SAMPLES, STEP, WINDOW, baseline, monitor, operated, record


# 12 of 400 at a level of 1 %: chance exceeds that in 0.06 %
@pytest.mark.parametrize("with_records", [False, True])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("draws", "most"),
    [pytest.param(4, 1, marks=pytest.mark.slow), pytest.param(400, 12, marks=pytest.mark.campaign)],
    ids=["few", "all"],
)
def test_false_alarms_under_each_noise(kind: str, with_records: bool, draws: int, most: int) -> None:
    alarms = 0
    for draw in range(draws):
        rng = np.random.default_rng([41, draw, KINDS.index(kind)])
        found = monitor(rng, kind, with_records=with_records)
        found.add(record(rng, kind, SAMPLES))
        alarms += bool(found.alarms)
    print(f"{kind}, {'healthy data' if with_records else 'result alone'}: {alarms} of {draws} healthy records alarm")
    assert alarms <= most


@pytest.mark.parametrize("kind", ["white", "mixture"])
@pytest.mark.parametrize(
    ("draws", "least"),
    [pytest.param(3, 3, marks=pytest.mark.slow), pytest.param(200, 190, marks=pytest.mark.campaign)],
    ids=["few", "all"],
)
def test_an_alarm_begins_and_ends_with_the_fault(kind: str, draws: int, least: int) -> None:
    begun = ended = named = 0
    for draw in range(draws):
        rng = np.random.default_rng([42, draw, KINDS.index(kind)])
        found = monitor(rng, kind, with_records=bool(draw % 2))
        first, last = int(rng.uniform(0.25, 0.4) * SAMPLES), int(rng.uniform(0.6, 0.8) * SAMPLES)
        there = np.arange(SAMPLES)
        found.add(record(rng, kind, SAMPLES, 0.7 * ((there >= first) & (there < last))))
        if len(found.alarms) != 1:
            continue
        (alarm,) = found.alarms
        if alarm.onset is None or alarm.ended is None:
            continue
        named += "turns" in alarm.fault
        begun += abs(alarm.onset.likely.time - STEP * first) < 2 * WINDOW
        late = found.table["end"][alarm.last] - STEP * last
        ended += abs(alarm.ended.time - STEP * last) < 2 * WINDOW and late < 2 * WINDOW
    print(f"{kind}: onset {begun}, end {ended}, named {named} of {draws}")
    assert min(begun, ended, named) >= least


# --- diagnosis, every record at an operating point and temperature of its own


ALWAYS = {"saturation": 0.15, "gain": 0.02, "dead": 0.03}
CHANGES = {
    "healthy": {},
    "turns 1 Ohm": {"turns": 1.0},
    "gain -20 %": {"gain": -0.2},
    "offset": {"offset": 0.01},
    "delay 1 ms": {"delay": 1e-3},
}


@pytest.mark.campaign
@pytest.mark.parametrize("always", [{}, ALWAYS], ids=["nothing off", "imperfect"])
@pytest.mark.parametrize("count", [10, 20])
def test_diagnosis_at_operating_points(count: int, always: dict[str, float]) -> None:
    """Four sets of healthy records, 200 new records a change."""
    coil_model, draws = coil.models()[0], 200
    sets = []
    for number in range(4):
        rng = np.random.default_rng([43, number])
        records = [operated(rng, **always) for _ in range(count)]
        given = baseline(records)
        shown = compute_stored_baseline(given, FAULTS, fmuid.System.of(coil_model), fmuid.diagnosis.Causes())
        sets.append(replace(given, records=(), shown=shown))
    first, alone, changed = (dict.fromkeys(CHANGES, 0) for _ in range(3))
    for name, change in CHANGES.items():
        for draw in range(draws):
            rng = np.random.default_rng([44, draw, list(CHANGES).index(name)])
            off = {key: always.get(key, 0.0) + change.get(key, 0.0) for key in {*always, *change}}
            found = fmuid.diagnose(operated(rng, **off), sets[draw % 4], FAULTS, coil_model)
            changed[name] += found.kind != "healthy"
            alone[name] += found.kind == "fault"
            wanted = {"turns": "turns.dR", "gain": "gain(i)", "offset": "offset(i)", "delay": "delay(i)"}
            label = wanted.get(next(iter(change), ""), "")
            best = found.evidence.explanations[:1]
            first[name] += found.kind != "unexplained" and [c.label for one in best for c in one.changes] == [label]
    print(f"{count} records, {always}: changed {changed}, named first {first}, a fault alone {alone}")
    assert changed["healthy"] <= (8 if always else 6)
    assert max(alone["gain -20 %"], alone["offset"], alone["delay 1 ms"]) <= 2
    assert min(first["turns 1 Ohm"], first["offset"], first["delay 1 ms"]) >= 190


@pytest.mark.parametrize(
    ("draws", "least"),
    [pytest.param(4, 3, marks=pytest.mark.slow), pytest.param(200, 180, marks=pytest.mark.campaign)],
    ids=["few", "all"],
)
def test_a_fault_shows_from_the_size_that_a_healthy_record_promises(draws: int, least: int) -> None:
    """95 % of records beside ten healthy ones; fewer than 180 of 200 come by chance in one of a thousand campaigns."""
    rng = np.random.default_rng([61, 0])
    healthy, shown = baseline([operated(rng) for _ in range(10)]), 0
    for draw in range(draws):
        sound = fmuid.diagnose(operated(np.random.default_rng([62, draw])), healthy, FAULTS, coil.models()[0])
        faulty = operated(np.random.default_rng([62, draw]), turns=sound.detectable["turns.dR"])
        shown += fmuid.diagnose(faulty, healthy, FAULTS, coil.models()[0]).kind != "healthy"
    print(f"{shown} of {draws} faults of the promised size show")
    assert shown >= least
