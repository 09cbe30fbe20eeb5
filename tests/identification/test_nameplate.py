"""Machines from their nameplates: random machines, digits and units as printed, wrong plates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmuid
from fmuid import InputError, System
from fmuid.data import JointPrior, Nameplate, RotatingFrame, SteadyExperiment
from fmuid.identification import find_contributions, nameplate_prior
from tests.support.paths import FMUS
from tests.support.resting import MACHINE, OMEGA, induction_machine, three_tests

MODEL = FMUS / "InductionMachine/InductionMachine.fmu"
PHASE = 400.0 / np.sqrt(3.0)


def plate_of(theta: dict[str, float], slip: float) -> dict[str, Any]:
    """Return what is printed of a machine, by the circuit's own formulas."""
    current, power, torque = induction_machine(PHASE, slip, theta)
    locked, _, start = induction_machine(PHASE, 1.0, theta)
    most = max(induction_machine(PHASE, each, theta)[2] for each in np.geomspace(0.02, 0.95, 2000))
    speed = OMEGA / 2.0 * (1.0 - slip)
    return {
        "P": f"{torque * speed / 1e3:.2f} kW",
        "U": "400 V",
        "I": f"{current:.2f}",
        "n": f"{speed * 30.0 / np.pi:.0f} 1/min",
        "f": "50 Hz",
        "cos_phi": f"{power.real / abs(power):.2f}",
        "Is_In": f"{locked / current:.1f}",
        "Ts_Tn": f"{start / torque:.1f}",
        "Tb_Tn": f"{most / torque:.1f}",
    }


def table_of(seed: int) -> SteadyExperiment:
    """Return no-load and locked-rotor points with relative noise."""
    table = three_tests()[:5]
    table[["I", "P"]] *= 1.0 + np.array([0.002, 0.005]) * np.random.default_rng(seed).normal(size=(5, 2))
    outputs, supply = {"I_rms": "I", "P": "P"}, RotatingFrame(50.0, "U", slip="s")
    return SteadyExperiment(table, outputs=outputs, supply=supply, name="tests")


def free() -> dict[str, fmuid.Parameter]:
    return {name: fmuid.Parameter(1.2 * value, min=1e-3) for name, value in MACHINE.items()}


def errors(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return relative errors and errors in σ (count, 4) of random machines."""
    random, found = np.random.default_rng(0), []
    for _ in range(count):
        values = np.array(list(MACHINE.values())) * np.exp(0.25 * random.normal(size=4))
        slip = 0.05 * np.exp(0.2 * random.normal())
        prior = nameplate_prior(System.of(MODEL), Nameplate(**plate_of(dict(zip(MACHINE, values, strict=True)), slip)))
        found.append((prior.mean / values - 1.0, (prior.mean - values) / prior.std))
    relative, scores = np.moveaxis(np.array(found), 1, 0)
    return relative, scores


@pytest.mark.slow
def test_random_machines_are_near_their_nameplates() -> None:
    relative, scores = errors(4)
    assert np.median(np.abs(relative), axis=0).max() < 0.05
    assert np.abs(scores).max() < 4.0


@pytest.mark.slow
def test_forty_random_machines_have_honest_starts() -> None:
    relative, scores = errors(40)
    assert np.median(np.abs(relative), axis=0).max() <= 0.025
    assert 0.9 < np.sqrt(np.mean(scores**2)) < 1.1
    assert np.sqrt(np.mean(scores**2, axis=0)) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("seed", [15, 24])
def test_noise_of_five_points_settles_beside_a_nameplate(seed: int) -> None:
    """Its variances need 12 repetitions and more; at the end they repeat themselves."""
    prior = nameplate_prior(System.of(MODEL), Nameplate(**plate_of(MACHINE, 0.05)))
    result = fmuid.identify(fmuid.Problem(MODEL, table_of(seed), free(), joint_prior=prior))
    assert result.converged
    last = result.history.rounds[-1]
    for name in ("I_rms", "P"):
        assert last[f"estimated.{name}"] == pytest.approx(last[f"used.{name}"], rel=0.02)


@pytest.mark.parametrize(("factor", "contradicts"), [(1.0, False), (1.1, True)])
def test_a_transient_tests_and_a_nameplate_narrow_every_interval(factor: float, contradicts: bool) -> None:
    """A rotor that is 10 % warmer on the nameplate contradicts both others."""
    data = fmuid.datasets.induction_machine()
    levels = {"ids": 0.02, "iqs": 0.02, "I_rms": 0.004, "P": 2.0}
    table = data.table[:60]
    transient = fmuid.Experiment(table, data.inputs, data.outputs, name="transient", interpolation="linear")
    plate = Nameplate(**plate_of(MACHINE | {"Rr": factor * MACHINE["Rr"]}, 0.05))
    prior = nameplate_prior(System.of(MODEL), plate)

    def fitted(experiments: list[fmuid.Experiment], prior: JointPrior | None) -> tuple[fmuid.Problem, fmuid.Result]:
        names = [name for each in experiments for name in each.output_names]
        noise = fmuid.Noise(std={name: levels[name] for name in names})
        problem = fmuid.Problem(MODEL, experiments, free(), noise=noise, joint_prior=prior)
        return problem, fmuid.identify(problem)

    problem, result = fitted([transient, table_of(1)], prior)
    assert result.converged
    found = find_contributions(problem, result)
    assert found is not None
    if not contradicts:
        both: list[fmuid.Experiment] = [transient, table_of(1)]
        pairs = [(both, None), (both[:1], prior), (both[1:], prior)]
        brought = {each.experiment: each.widening for each in found.parts}
        for name, pair in zip(("prior", "tests", "transient"), pairs, strict=True):
            without = fitted(*pair)[1].std
            assert (result.std < without).all()
            np.testing.assert_allclose(brought[name], without / result.std, rtol=0.2)  # linear about other estimates
    assert ("prior" in [each.experiment for each in found.contradictions]) is contradicts


@pytest.mark.parametrize(
    ("given", "value", "half"),
    [
        ("1.1 kW", 1100.0, 50.0),
        ("1100 W", 1100.0, 0.5),
        (1100, 1100.0, 0.5),
        (0.5, 0.5, 0.05),
        ("2.50", 2.5, 0.005),
        ("1,10 kW", 1100.0, 5.0),
    ],
)
def test_digits_are_those_printed(given: str | float, value: float, half: float) -> None:
    printed = Nameplate(P=given, U=400, I=2.6, n=1420, f=50).printed["P"]
    assert (printed.value, printed.half) == pytest.approx((value, half))


@pytest.mark.parametrize(("n", "f", "pairs"), [(2880, 50, 1), (1420, 50, 2), (1750, 60, 2), (960, 50, 3), (725, 50, 4)])
def test_pole_pairs_follow_from_the_speed(n: float, f: float, pairs: int) -> None:
    assert Nameplate(P=1.0, U=400, I=2.6, n=n, f=f).pole_pairs == pairs


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"P": "much"}, "P = 'much' is no printed number"),
        ({"U": "230/400 V"}, "U = '230/400 V' has two values. Give the one of the connection in use"),
        ({"I": "4,7 / 2,73 A"}, "I = '4,7 / 2,73 A' has two values"),
        ({"P": "1.1 kV"}, "P: unit 'kV' does not convert to 'W'"),
        ({"I": 0}, "I must be above 0"),
        ({"P": "1.1 kVA"}, "P: 'kVA' is apparent power. Give the mechanical power in W"),
        ({"U": "400 VA"}, "U: unit 'VA' does not convert to 'V'"),
        ({"n": 0.02}, "n = 0.02 rpm is no rated speed|too near"),
        ({"n": 1530}, "n = 1530 rpm is no rated speed at 50 Hz"),
        ({"f": "60 Hz"}, "is no rated speed at 60 Hz"),
        ({"U": "230 V"}, "P exceeds the electrical power of U, I and cos_phi. Give U between lines"),
        ({"n": 1500}, "n = 1500 rpm is no rated speed|too near the synchronous speed"),
        ({"Is_In": "9.5"}, "no machine has this nameplate: .* σ. Check its numbers"),
    ],
)
def test_wrong_nameplates_are_refused(changed: dict[str, str | float], message: str) -> None:
    given = plate_of(MACHINE, 0.05) | changed
    with pytest.raises(InputError, match=message):
        nameplate_prior(System.of(MODEL), Nameplate(**given))


def test_only_free_parameters_are_estimated() -> None:
    plate = Nameplate(**plate_of(MACHINE, 0.05))
    prior = nameplate_prior(System.of(MODEL), plate, ["Rr", "Lf"], {"Rs": 9.8, "Lm": 0.436})
    assert prior.names == ("Rr", "Lf")
    assert np.abs(prior.mean - [3.8, 0.0762]).max() < 0.05 * 3.8
    wider = nameplate_prior(System.of(MODEL), Nameplate(**plate_of(MACHINE, 0.05), std_factor=3.0), ["Rr", "Lf"])
    assert (np.array(wider.std) > 2.9 * np.array(prior.std)).all()
    with pytest.raises(InputError, match="none of Rs, Rr, Lm, Lf is a free parameter"):
        nameplate_prior(System.of(MODEL), plate, ["J"])


def test_a_model_without_declaration_has_no_starts(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no starts by a nameplate. Declare them in Coil.nameplate.toml"):
        nameplate_prior(System.of(fmuid.datasets.coil().fmu), Nameplate(**plate_of(MACHINE, 0.05)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[terminal]", "unknown section 'terminal'"),
        ("[terminals]\nvoltage = 1", "unknown key 'voltage' .*'voltages'"),
        ('[terminals]\nvoltages = ["u"]', "voltages: the value should be a list of 2"),
        (
            '[terminals]\nvoltages = ["a", "b"]\ncurrents = ["c", "d"]\naxes = "x"',
            "axes: the value should be one of rotor, stator",
        ),
        ("[terminals", "not readable as TOML"),
        ("[starts]\nRs = 1", "starts must be formulas"),
        ('[terminals]\nvoltages = ["uds", "uqs"]\ncurrents = ["ids", "iqs"]\n[starts]\nRs = "0.1 * X"', "quantity 'X'"),
    ],
)
def test_wrong_declarations_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / MODEL.name).write_bytes(MODEL.read_bytes())
    (tmp_path / "InductionMachine.nameplate.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        nameplate_prior(System.of(tmp_path / MODEL.name), Nameplate(**plate_of(MACHINE, 0.05)))
