"""The machine in its windings that makes the tables of machine faults, and what is found in some of them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

import fmuid
from experiments.machine_faults import machine, make_tables, models, study
from experiments.machine_faults.machine import BARS, COILS, TRUTH, TURNS, Condition
from fmuid.data.signals import T23

Array = npt.NDArray[np.floating]


@pytest.fixture(scope="module")
def known() -> fmuid.Baseline:
    return study.baseline(0)


@pytest.fixture(scope="module")
def committed() -> pd.DataFrame:
    return pd.read_csv(study.HERE / "draws.csv")


# ---- the machine


def steady_currents(condition: Condition, frequency: float, voltage: Array, angle: float) -> Array:
    """Phasors of ids, iqs at standstill, from the rates of the states."""
    matrices, count = machine.windings(condition), machine.FLUXES

    def rates(fluxes: Array, u: Array) -> tuple[Array, Array]:
        x = np.zeros(machine.STATES)
        x[:count] = fluxes
        x[count], x[count + 5], x[count + 10 :] = angle, 0.01, u
        found, currents = machine.slope(x, 0.0, matrices)
        return found[:count], currents

    nothing, still = np.zeros(count), np.zeros(2)
    dynamics, currents = (np.array(each).T for each in zip(*(rates(x, still) for x in np.eye(count)), strict=True))
    drive = np.array([rates(nothing, u)[0] for u in np.eye(2)]).T @ voltage
    fluxes = np.linalg.solve(2j * np.pi * frequency * np.eye(count) - dynamics, drive)
    return np.asarray(currents @ fluxes)


def circuit_currents(turns: int, phase: int, frequency: float, voltage: Array, angle: float) -> Array:
    """The same from Kirchhoff's laws: three phases, the contact, and a star point at whatever potential."""
    jw = 2j * np.pi * frequency
    slots, common = machine.SLOTS * machine.STATOR_LEAKAGE, (1 - machine.SLOTS) * machine.STATOR_LEAKAGE
    in_coil = TURNS // COILS
    rotor = jw * TRUTH["Lm"] * TRUTH["Rr"] / (TRUTH["Rr"] + jw * TRUTH["Lm"])
    gap = jw * (TRUTH["Lf"] - machine.STATOR_LEAKAGE) + rotor
    axes = np.sqrt(2 / 3) * np.exp(2j * np.pi / 3 * np.arange(3))
    loop = np.array([turns / TURNS if k == phase else 0.0 for k in range(3)])
    # voltage of a turn over each current (a, b, c, contact): by the air gap, by slots of its coil, by what all share
    ampere = np.column_stack([np.eye(3), -loop])  # of each phase, in shares of its turns
    through_gap = gap * np.real(np.outer(axes.conj(), axes)) @ ampere
    in_slot = jw * slots / COILS * np.array([1.0, 1.0, 1.0, -turns / in_coil])  # of a whole coil, the faulty one
    whole = jw * common * ampere + through_gap
    a, b, c, contact, star = np.eye(5)
    rows = []
    for k, current in enumerate((a, b, c)):
        row = TRUTH["Rs"] * (current - loop[k] * contact) + star
        row = row + np.append(whole[k], 0) + (COILS - 1) * jw * slots / COILS * current
        rows.append(row + (in_slot[k] * current + in_slot[3] * contact if k == phase else jw * slots / COILS * current))
    share, faulty = turns / TURNS, (a, b, c)[phase]
    closed = TRUTH["Rs"] * share * (faulty - contact) - machine.CONTACT * contact + share * np.append(whole[phase], 0)
    rows.append(closed + turns / in_coil * (in_slot[phase] * faulty + in_slot[3] * contact))
    rows.append(a + b + c)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    found = np.linalg.solve(np.array(rows), np.array([*(T23.T @ turn @ voltage), 0.0, 0.0]))
    return np.asarray(turn.T @ T23 @ found[:3])


@pytest.mark.parametrize("phase", range(3))
@pytest.mark.parametrize("turns", [1, 20])
def test_shorted_turns_obey_kirchhoff(turns: int, phase: int) -> None:
    voltage = np.array([100.0, 40.0 - 70.0j])
    found = steady_currents(Condition(turns=turns, phase=phase), 50.0, voltage, 0.4)
    np.testing.assert_allclose(found, circuit_currents(turns, phase, 50.0, voltage, 0.4), rtol=1e-9)
    healthy = steady_currents(Condition(), 50.0, voltage, 0.4)
    assert np.abs(found - healthy).max() > 1e-3 * turns


@pytest.mark.parametrize("bars", [1, 3])
def test_broken_bars_in_a_slow_field(bars: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rings without resistance: each bar left carries what the field drives through it, all of them together nothing.

    So the conductance is G Σ (c - m)(c - m)ᵀ over the bars left, c their directions and m the mean of these. For one
    bar that is R_eq of the fault model but for m.
    """
    monkeypatch.setattr(machine, "RINGS", 1e-9)
    cage = machine.windings(Condition(bars=bars))
    coupling, decay = cage.coupling[:, : BARS - bars], cage.decay[: BARS - bars]
    conductance = coupling / decay @ coupling.T / TRUTH["Lm"] ** 2
    places = 2 * np.pi * machine.POLE_PAIRS / BARS * (np.arange(BARS) + 0.5) + np.pi / 2
    left = np.array([np.cos(places), np.sin(places)])[:, bars:]
    centred = left - left.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(conductance, 2 / BARS / TRUTH["Rr"] * centred @ centred.T, rtol=1e-6, atol=1e-9)
    weakest = np.linalg.eigh(conductance)[1][:, 0]
    assert np.arctan2(weakest[1], weakest[0]) % np.pi == pytest.approx(machine.bar_angle(bars), abs=1e-6)


@pytest.mark.parametrize("condition", [Condition(turns=1, phase=2), Condition(turns=20), Condition(bars=3)])
def test_the_integration_is_precise(condition: Condition) -> None:
    """Half the substeps: the method is of order 4, and changes by what is left 16-fold."""
    references = np.where(np.arange(250) > 145, machine.SPEED + machine.SPEED_STEP, machine.SPEED)
    fine, coarse = (
        machine.run(condition, references, make_tables.SAMPLE_TIME, substeps)
        for substeps in (2 * make_tables.SUBSTEPS, make_tables.SUBSTEPS)
    )
    np.testing.assert_allclose(coarse[:, 4:], fine[:, 4:], rtol=0, atol=1e-5)
    assert np.abs(fine[:, 4:]).max() > 5.0


# ---- what is found


@pytest.fixture(scope="module")
def drawn(known: fmuid.Baseline, committed: pd.DataFrame) -> Callable[[str], dict[str, Any]]:
    """The first draw of a case, made anew; it is that of the page."""

    def again(case: str) -> dict[str, Any]:
        row = study.row(models.diagnose(make_tables.table(case), known))
        page = committed[(committed["case"] == case) & (committed["seed"] == 0)].iloc[0].to_dict()
        assert row["verdict"] == page["verdict"]
        for name in set(row) - {"verdict"}:
            # statistics are in units of a difference that chance makes: a tenth decides nothing
            assert row[name] == pytest.approx(page[name], rel=1e-2, abs=0.1 if name.endswith("_D") else 1e-3), name
        return row

    return again


@pytest.mark.slow
@pytest.mark.parametrize(("case", "verdict"), [("warm", "none"), ("stator_a20", "stator a"), ("bars_1", "rotor")])
def test_the_fault_is_found(drawn: Callable[[str], dict[str, Any]], case: str, verdict: str) -> None:
    row, condition = drawn(case), make_tables.CASES[case]
    assert row["verdict"] == verdict
    if not condition.bars:
        assert row["turns_a"] == pytest.approx(condition.turns, abs=3.0 if condition.turns else 4 * row["std_a"])
    assert row["eta0"] == pytest.approx(3 * condition.bars / BARS, rel=0.2, abs=0.015 if verdict == "none" else 0.02)
    if condition.bars:
        assert row["theta0"] == pytest.approx(machine.bar_angle(condition.bars), abs=0.3)
    resistances = [condition.warmth * TRUTH[name] for name in ("Rs", "Rr")]
    assert [row["Rs"], row["Rr"]] == pytest.approx(resistances, rel=0.03)


def test_a_short_circuit_comes_without_a_jump() -> None:
    """Until then it is the healthy drive; then its currents go on, and become those of one that has always had it."""
    references, step = np.full(1500, machine.SPEED), make_tables.SAMPLE_TIME
    shorted = Condition(turns=10, phase=1)
    sound, always = (machine.run(each, references, step, 20) for each in (Condition(), shorted))
    found = machine.run(Condition(phase=1), references, step, 20, (500, shorted))
    np.testing.assert_allclose(found[:501], sound[:501], atol=1e-9)
    assert np.abs(found[501:510, 4:] - sound[501:510, 4:]).max() > 0.1
    late = slice(1200, None)  # the angle is another one by then: sizes of currents and voltages
    for columns in ([0, 1], [4, 5]):
        one, other = (np.linalg.norm(each[late][:, columns], axis=1) for each in (found, always))
        assert one.mean() == pytest.approx(other.mean(), rel=2e-3)
