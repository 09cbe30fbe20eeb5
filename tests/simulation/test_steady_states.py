"""Steady states: against scipy's fsolve, circuit formulas of IEEE 112, and rows that have none."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.stats

import fmuid
from fmuid import FmuidError, System
from fmuid.data import RotatingFrame, SteadyExperiment
from fmuid.simulation import AnySimulator, simulator_of
from fmuid.simulation.right_hand_side import RightHandSide
from tests.support.packing import pack
from tests.support.paths import FMUS
from tests.support.resting import ADDING, BISTABLE, KINKED, MACHINE, SATURATED, saturated_motor, three_tests

INDUCTION = FMUS / "InductionMachine/InductionMachine.fmu"


def steady(
    fmu: Path, columns: Mapping[str, object], parameters: list[str], outputs: list[str], **more: Any
) -> AnySimulator:
    inputs = [name for name in columns if name not in outputs]
    frame = pd.DataFrame(dict(columns) | {name: 1.0 for name in outputs if name not in columns})
    return simulator_of(System.of(fmu), SteadyExperiment(frame, inputs, outputs, **more), parameters)


def test_a_saturated_model_is_at_rest_as_by_fsolve(made: Callable[[str], Path]) -> None:
    points = np.array([(u, load) for u in (12.0, 24.0, 48.0, 96.0) for load in (0.2, 1.0, 3.0)])
    thetas = np.array([[0.6, 1.1, 900.0, 2e-3], [0.4, 0.9, 300.0, 4e-3]])
    columns = {"u": points[:, 0], "load": points[:, 1]}
    found = steady(made(SATURATED), columns, ["R", "k", "c", "b"], ["i", "w"])(thetas)
    for own, theta in zip(found, thetas, strict=True):
        np.testing.assert_allclose(own, saturated_motor(theta, points), rtol=1e-9)


def test_phasors_are_those_of_the_circuit() -> None:
    table = three_tests()
    columns = {"I_rms": "I", "P": "P", "Q": "Q", "torque": "T", "cos_phi": "cos"}
    given = {
        "slip": RotatingFrame(50.0, "U", slip="s", pole_pairs=2),
        "speed": RotatingFrame("f", None, "UL", None, "n", 2),
    }
    for supply in given.values():
        experiment = SteadyExperiment(table, outputs=columns, supply=supply)
        simulator = simulator_of(System.of(INDUCTION), experiment, list(MACHINE))
        np.testing.assert_allclose(simulator(list(MACHINE.values())), table[list(columns.values())], rtol=1e-12)


def test_phasors_and_their_check_take_one_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points with exact derivatives, and their check by differences."""
    made, plans = list[RightHandSide](), RightHandSide.__init__

    def counted(self: RightHandSide, *given: Any, **more: Any) -> None:
        made.append(self)
        plans(self, *given, **more)

    monkeypatch.setattr(RightHandSide, "__init__", counted)
    experiment = SteadyExperiment(three_tests(), outputs={"I_rms": "I"}, supply=RotatingFrame(50.0, "U", slip="s"))
    simulator_of(System.of(INDUCTION), experiment, list(MACHINE))(list(MACHINE.values()))
    assert len(made) == 2


def test_phasors_at_synchronous_speed_are_those_of_the_open_circuit() -> None:
    table = pd.DataFrame({"U": [230.0], "I": [1.0]})
    experiment = SteadyExperiment(table, outputs={"I_rms": "I"}, supply=RotatingFrame(50.0, "U", slip=0.0))
    found = simulator_of(System.of(INDUCTION), experiment, list(MACHINE))(list(MACHINE.values()))
    impedance = complex(MACHINE["Rs"], 100.0 * np.pi * (MACHINE["Lm"] + MACHINE["Lf"]))
    np.testing.assert_allclose(found, 230.0 / abs(impedance), rtol=1e-12)


def test_units_of_headers_count() -> None:
    table = three_tests().assign(P=lambda found: found["P"] / 1e3)
    supply = RotatingFrame(50.0, "U", slip="s")
    experiment = SteadyExperiment(table, outputs=["P"], supply=supply, units={"P": "kW"})
    simulator = simulator_of(System.of(INDUCTION), experiment, list(MACHINE))
    np.testing.assert_allclose(simulator(list(MACHINE.values())), table[["P"]], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "u", "more", "expected"),
    [
        (BISTABLE, 0.0, {}, "row 1: several steady states. Set guess"),
        (BISTABLE, 0.0, {"guess": {"x": -0.7}}, -1.0),
        (BISTABLE, 0.0, {"guess": {"x": 0.01}}, "row 1: the steady state is unstable"),
        (BISTABLE, 0.0, {"guess": {"y": 0.01}}, "guess: 'y' is no state"),
        (BISTABLE, 6.0, {}, 2.0),
        (KINKED, 0.0, {}, "row 1: an event at the steady state"),
        (KINKED, -1.0, {}, 0.0),
        (ADDING, 1.0, {}, "row 1: no steady state"),
        (ADDING, 0.0, {}, 2.0),
    ],
)
def test_rows_without_a_usable_steady_state_say_why(
    made: Callable[[str], Path], text: str, u: float, more: dict[str, Any], expected: str | float
) -> None:
    simulator = steady(made(text), {"u": [u]}, ["a"], ["x"], **more)
    if isinstance(expected, float):
        assert simulator([1.0]) == pytest.approx(expected, abs=1e-9)
        return
    with pytest.raises(FmuidError, match=expected):
        simulator([1.0])


def test_coupled_fmus_at_rest() -> None:
    coil = fmuid.datasets.coil().fmu
    pair = System(components={"a": coil, "b": coil}, connections=[("a.i", "b.u", 4.0, 0.0)])
    frame = pd.DataFrame({"a.u": [2.0, 8.0], "b.i": [1.0, 1.0]})
    experiment = SteadyExperiment(frame, ["a.u"], ["b.i"])
    simulator = simulator_of(pair, experiment, ["a.R", "b.R"])
    np.testing.assert_allclose(simulator([4.0, 2.0])[:, 0], [1.0, 4.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("resistance", "expected"),
    [(4.0, [0.5, 2.0]), pytest.param(0.0, "row 1: outputs do not come to rest", marks=pytest.mark.slow)],
)
def test_co_simulation_alone_is_simulated_until_still(
    tmp_path: Path, resistance: float, expected: list[float] | str
) -> None:
    with zipfile.ZipFile(FMUS / "Coil/Coil.fmu") as archive:
        texts = {name: archive.read(name) for name in archive.namelist()}
    description = texts["modelDescription.xml"]
    alone = re.sub(rb"<ModelExchange .*?</ModelExchange>", b"", description, flags=re.DOTALL)
    assert alone != description
    fmu = pack(tmp_path / "Alone.fmu", *{**texts, "modelDescription.xml": alone}.items())
    simulator = steady(fmu, {"u": [2.0, 8.0]}, ["R"], ["i"])
    if isinstance(expected, list):
        np.testing.assert_allclose(simulator([resistance])[:, 0], expected, rtol=1e-6)
        return
    with pytest.raises(FmuidError, match=expected):
        simulator([resistance])


@pytest.mark.slow
def test_coupled_fmus_that_never_rest(made: Callable[[str], Path]) -> None:
    fmu = made(ADDING)
    pair = System(components={"a": fmu, "b": fmu}, connections=[("a.x", "b.u", 0.0, 1.0)])
    experiment = SteadyExperiment(pd.DataFrame({"a.u": [0.0, 1.0], "b.x": [1.0, 1.0]}), ["a.u"], ["b.x"])
    with pytest.raises(FmuidError, match=r"row 1: no steady state. Change the inputs or set guess"):
        simulator_of(pair, experiment, ["b.a"])([1.0])


@pytest.mark.campaign
@pytest.mark.parametrize(("copies", "known"), [(1, True), (7, False)])
def test_intervals_of_load_points_cover(copies: int, known: bool) -> None:
    """95 % of 400 draws with known or estimated noise, each parameter by the exact binomial test."""
    table = pd.concat([three_tests()] * copies, ignore_index=True)
    truth, covered, level = np.array(list(MACHINE.values())), [], {"I": 0.002, "P": 0.005}
    free = {name: fmuid.Parameter(1.3 * value, min=1e-3) for name, value in MACHINE.items()}
    noise = fmuid.Noise(std={"I_rms": tuple(level["I"] * table["I"]), "P": tuple(level["P"] * table["P"])})
    noise = noise if known else fmuid.Noise(reading_std="estimate")
    for seed in range(400):
        random = np.random.default_rng(seed)
        noisy = {name: table[name] * (1.0 + size * random.normal(size=len(table))) for name, size in level.items()}
        supply = RotatingFrame(50.0, "U", slip="s")
        experiment = SteadyExperiment(table.assign(**noisy), outputs={"I_rms": "I", "P": "P"}, supply=supply)
        bounds = fmuid.identify(fmuid.Problem(INDUCTION, experiment, free, noise=noise)).intervals(0.95)
        covered.append((bounds["lower"] <= truth) & (bounds["upper"] >= truth))
    counts = np.sum(covered, axis=0)
    print(f"covered by {len(table)} rows: {counts} of 400")
    assert min(scipy.stats.binomtest(int(each), 400, 0.95).pvalue for each in counts) > 0.05 / truth.size, counts


def test_a_transient_and_a_table_share_the_parameters() -> None:
    coil = fmuid.datasets.coil()
    table = SteadyExperiment(
        pd.DataFrame({"u": [4.0, 8.0, 12.0], "i": [1.001, 1.999, 3.0]}), ["u"], ["i"], name="table"
    )
    both = fmuid.Problem(coil.fmu, [coil.experiment, table], coil.parameters)
    alone = fmuid.identify(fmuid.Problem(coil.fmu, coil.experiment, coil.parameters))
    result = fmuid.identify(both)
    assert result.converged
    assert result["R"] == pytest.approx(4.0, abs=3.0 * result.std[0])
    assert result.std[0] < alone.std[0]
    assert fmuid.assess(both, result).succeeded


def test_nonlinear_models_take_no_phasors(made: Callable[[str], Path]) -> None:
    fmu = made(SATURATED)
    declared = fmu.with_suffix(".nameplate.toml")
    declared.write_text('[terminals]\nvoltages = ["u", "load"]\ncurrents = ["i", "w"]\naxes = "stator"\n')
    frame = pd.DataFrame({"U": [3.0], "I": [1.0]})
    experiment = SteadyExperiment(frame, outputs={"I_rms": "I"}, supply=RotatingFrame(50.0, "U", slip=0.0))
    with pytest.raises(FmuidError, match="row 1: nonlinear at this amplitude"):
        simulator_of(System.of(fmu), experiment, ["R"])([0.6])


def test_models_without_declared_terminals_take_no_formulas() -> None:
    frame = pd.DataFrame({"u": [3.0], "I": [1.0]})
    with pytest.raises(FmuidError, match=r"'I_rms' needs terminals. Declare them in Coil.nameplate.toml"):
        simulator_of(System.of(fmuid.datasets.coil().fmu), SteadyExperiment(frame, ["u"], {"I_rms": "I"}), ["R"])
