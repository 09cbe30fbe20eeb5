"""The smallest detectable fault and the best excitation: against closed forms and against draws."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.signal import lfilter

import fmuid
from experiments.coil import study as coil
from fmuid.data.signals import multisine, prbs, step_sequence
from fmuid.diagnosis.alarms import Rule
from fmuid.diagnosis.baseline import Baseline
from fmuid.diagnosis.design import Design, planned_experiment
from fmuid.diagnosis.monitor import Monitor
from fmuid.runs.faults import design_of
from tests.support.exported import export_text
from tests.support.plate import COLUMNS, PHASES, PLATE, STD, TRUTH
from tests.support.plate import record as plate_record
from tests.support.results import changed

FALSE_ALARM, MISS = 0.02, 0.1
VARIANCE = {"i": coil.NOISE_VARIANCE}


@pytest.fixture(scope="module")
def healthy() -> fmuid.Result:
    """Return a healthy result whose estimates are the truth, with the standard deviations of a record."""
    found = fmuid.Result.from_json(coil.HERE / "healthy" / "result.json")
    return changed(found, values=np.array([coil.R, coil.L]))


def turns(largest: float = math.inf) -> fmuid.Fault:
    parameter = fmuid.Parameter(0.0, max=largest, nominal=1.0)
    return fmuid.Fault(coil.models()[1], {"dR": parameter}, values={"tau": coil.TAU})


def design(healthy: fmuid.Result, fault: fmuid.Fault | None = None) -> Design:
    baseline = Baseline(healthy, coil.INFLATE, VARIANCE)
    how = fmuid.diagnosis.DiagnosisSettings(FALSE_ALARM)
    return Design({"turns": fault or turns()}, baseline, coil.models()[0], how, miss=MISS)


def coil_deviation(healthy: fmuid.Result, voltage: np.ndarray) -> float:
    """Return the standard deviation of ΔR in closed form.

    The sensitivities are differences of the closed form of the current under a held voltage.
    """

    def current(resistance: float, inductance: float) -> np.ndarray:
        decay = math.exp(-resistance / inductance * coil.STEP)
        return np.asarray(lfilter([0.0, (1.0 - decay) / resistance], [1.0, -decay], voltage))

    by_r = (current(coil.R + 1e-4, coil.L) - current(coil.R - 1e-4, coil.L)) / 2e-4
    by_l = (current(coil.R, coil.L + 1e-6) - current(coil.R, coil.L - 1e-6)) / 2e-6
    columns = np.column_stack([by_r, by_l, by_r + 2 * coil.TAU * by_l])
    known = np.array([healthy.normal("R", inflate=10.0).std, healthy.normal("L").std])
    prior = np.diag([*known**-2.0, 0.0])
    return math.sqrt(np.linalg.inv(prior + columns.T @ columns / coil.NOISE_VARIANCE)[2, 2])


def on_coil(frame: pd.DataFrame) -> fmuid.Experiment:
    return planned_experiment(frame, ["u"], ["i"])


def test_the_smallest_fault_of_the_coil(healthy: fmuid.Result) -> None:
    frame = prbs(1.2, coil.STEP, 1.0, 15, seed=3)
    std = coil_deviation(healthy, frame["u"].to_numpy())
    (found,) = design(healthy).detectable(on_coil(frame))
    assert (found.name, found.unit) == ("dR", "Ohm")
    assert found.std == pytest.approx(std, rel=1e-3)
    z = stats.norm.isf
    assert found.value == pytest.approx((z(FALSE_ALARM / 2) + z(MISS)) * std, rel=1e-3)
    (one_sided,) = design(healthy, turns(largest=0.0)).detectable(on_coil(frame))
    assert one_sided.value == pytest.approx((z(FALSE_ALARM) + z(MISS)) * std, rel=1e-3)


def test_excitations_are_ranked(healthy: fmuid.Result) -> None:
    frames = {
        "weak": prbs(1.2, coil.STEP, 0.5, 15),
        "strong": prbs(1.2, coil.STEP, 2.0, 15),
        "slow": prbs(1.2, coil.STEP, 1.0, 150),
        "steps": step_sequence(1.2, coil.STEP, [1.0, -1.0]),
        "multisine": multisine(1.2, coil.STEP, 1.0, 1.0, 30.0),
    }
    expected = {name: coil_deviation(healthy, frame["u"].to_numpy()) for name, frame in frames.items()}
    found = design(healthy)
    table = found.rank({name: on_coil(frame) for name, frame in frames.items() if name != "multisine"})
    order = [name for name in sorted(expected, key=lambda name: expected[name]) if name != "multisine"]
    assert list(table["excitation"]) == order
    assert list(table["dR.std"]) == pytest.approx([expected[name] for name in order], rel=1e-3)
    assert list(table["worst"]) == list(table["dR"])  # the magnitude is 1 Ω
    assert table["excitation"][0] == "strong" and table["duration"].to_numpy() == pytest.approx(1.199)
    # a longer test does not lower what the healthy record's errors make
    (weak,), (strong,) = (found.detectable(on_coil(frames[name])) for name in ("weak", "strong"))
    assert 0 < weak.share < strong.share < 1


def test_nothing_is_detectable_without_excitation(healthy: fmuid.Result) -> None:
    still, moved = step_sequence(1.0, coil.STEP, [0.0]), prbs(1.0, coil.STEP, 1.0, 15)
    table = design(healthy).rank({"still": on_coil(still), "moved": on_coil(moved)})
    assert list(table["excitation"]) == ["moved", "still"]
    assert math.isinf(table["dR"][1]) and math.isfinite(table["dR"][0])


@pytest.mark.slow
def test_the_rates_are_those_of_draws(healthy: fmuid.Result) -> None:
    """Draws of record and healthy result; R with the errors of its estimate, so not inflated."""
    rng, count = np.random.default_rng(6), 300
    experiment = coil.experiment(coil.record(coil.R, 0.0, rng))
    baseline = Baseline(healthy, noise_variance=VARIANCE)
    asked = Design({"turns": turns()}, baseline, coil.models()[0], fmuid.diagnosis.DiagnosisSettings(0.1), miss=0.2)
    (smallest,) = asked.detectable(experiment)
    root = np.linalg.cholesky(np.diag(healthy.std**2))
    rates = []
    for fault in (0.0, smallest.value):
        hits = 0
        for _ in range(count):
            known = changed(healthy, values=healthy.values + root @ rng.standard_normal(2))
            baseline = Baseline(known, noise_variance=VARIANCE)
            watch = Monitor(baseline, {"turns": turns()}, coil.models()[0], Rule(level=0.1))
            watch.add(coil.experiment(coil.record(coil.R, fault, rng)))
            hits += watch.table["significant"][0] == "turns"
        rates.append(hits / count)
    assert rates[0] == pytest.approx(0.1, abs=3 * math.sqrt(0.1 * 0.9 / count))
    assert rates[1] == pytest.approx(0.8, abs=3 * math.sqrt(0.8 * 0.2 / count))


# --- several parameters -----------------------------------------------------------------


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> fmuid.System:
    return fmuid.System.of(export_text(tmp_path_factory.mktemp("plate"), PLATE))


@pytest.fixture(scope="module")
def known(plate: fmuid.System) -> fmuid.Result:
    problem = fmuid.Problem(
        plate, plate_record(None), {n: fmuid.Parameter(1.5) for n in TRUTH}, noise=fmuid.Noise(1e-2)
    )
    return fmuid.identify(problem)


def plate_precision(known: fmuid.Result, which: list[int]) -> np.ndarray:
    """Return the inverse covariance of columns of the plate beside g and h."""
    own = COLUMNS[:, [0, 1, *which]] / STD
    prior = np.diag([*known.std**-2.0, *np.zeros(len(which))])
    return np.asarray(np.linalg.inv(np.linalg.inv(prior + own.T @ own)[2:, 2:]))


def test_each_size_is_a_cause_of_its_own(plate: fmuid.System, known: fmuid.Result) -> None:
    """Without the others; the threshold is that of the smallest of three probabilities, a little below Bonferroni's."""
    baseline = Baseline(known, noise_variance={"x": STD**2, "y": STD**2})
    stds = [plate_precision(known, [k])[0, 0] ** 0.5 for k in (2, 3, 4)]
    z = stats.norm.isf
    for least, tails in ((-math.inf, 2.0), (0.0, 1.0)):
        fault = fmuid.Fault(plate, dict.fromkeys(PHASES, fmuid.Parameter(0.0, min=least, nominal=0.01)))
        found = Design({"stator": fault}, baseline, plate).detectable(plate_record(None))
        for each, std in zip(found, stds, strict=True):
            assert each.std == pytest.approx(1.0 / std, rel=1e-4)
            high, low = (z(0.01 / tails / count) + z(0.05) for count in (3, 1))
            assert low * each.std < each.value < 1.01 * high * each.std


def test_angles_and_sizes_that_are_told_apart(plate: fmuid.System, known: fmuid.Result) -> None:
    baseline = Baseline(known, noise_variance={"x": STD**2, "y": STD**2})
    fault = fmuid.Fault(plate, dict.fromkeys(PHASES, fmuid.Parameter(0.0, nominal=0.01)))
    (first, *_) = Design({"stator": fault}, baseline, plate).detectable(plate_record(None))
    own = COLUMNS / STD
    prior = np.diag(known.std**-2.0)
    covariance = np.linalg.inv(prior + own[:, :2].T @ own[:, :2])
    beside = own[:, 2:5] - own[:, :2] @ covariance @ own[:, :2].T @ own[:, 2:5]
    information = own[:, 2:5].T @ beside
    cosines = np.abs(information / np.sqrt(np.outer(np.diag(information), np.diag(information))))
    near = 1 + int(np.argmax(cosines[0, 1:]))
    assert first.rival == f"stator.{PHASES[near]}"
    assert math.cos(first.rival_angle) == pytest.approx(cosines[0, near], rel=1e-4)
    assert math.degrees(first.rival_angle) > 80.0
    assert first.apart == first.value  # named as soon as it is called


def test_what_a_healthy_record_costs(healthy: fmuid.Result) -> None:
    """An equally long one a factor √2 where nothing else tells; one ten times as long 5 %."""
    cost = design(healthy).cost(on_coil(prbs(1.2, coil.STEP, 1.0, 15, seed=3)))
    times = dict(zip(cost["healthy"], cost["turns.dR.times"], strict=True))
    assert times[1.0] > times[3.0] > times[10.0] > times[100.0] >= 1.0 - 1e-6
    assert times[1.0] <= math.sqrt(2.0) * 1.001
    assert times[10.0] <= 1.1
    (found,) = design(healthy).detectable(on_coil(prbs(1.2, coil.STEP, 1.0, 15, seed=3)), healthy=1.0)
    assert math.degrees(found.rival_angle) < 10.0  # a coil's turns, inductance and sensor look alike
    assert found.value < found.apart


def test_of_a_turned_fault_the_worst_angle_counts(plate: fmuid.System, known: fmuid.Result) -> None:
    parameters = {"size": fmuid.Parameter(0.0, min=0.0, nominal=0.01), "angle": fmuid.Parameter(0.0, nominal=1.0)}
    fault = fmuid.Fault(plate, parameters, angles={"angle": fmuid.diagnosis.FaultAngle("size", math.pi)})
    baseline = Baseline(known, noise_variance={"x": STD**2, "y": STD**2})
    (found,) = Design({"rotor": fault}, baseline, plate).detectable(plate_record(None))
    precision = plate_precision(known, [5, 6])
    angles = np.linspace(0.0, math.pi, 1001)
    worst = min(d @ precision @ d for d in np.column_stack([np.cos(2 * angles), np.sin(2 * angles)]))
    assert found.std == pytest.approx(worst**-0.5, rel=1e-4)
    assert stats.ncx2.sf(stats.chi2.isf(0.01, 2), 2, found.value**2 * worst) == pytest.approx(0.95, abs=1e-4)


# --- words ------------------------------------------------------------------------------


def test_a_design_of_a_study() -> None:
    study = fmuid.Study.read(coil.HERE / "test.toml")
    (found,) = design_of(study, "turns", false_alarm=0.01, miss=0.05).detectable(study.tables[0])
    known = study.diagnose()["turns.dR"]
    assert found.std == pytest.approx(known.std, rel=0.5)  # there with another ΔR and R
    assert found.value == pytest.approx((2.576 + 1.645) * found.std, rel=0.01)


def test_wrong_words_are_one_sentence(healthy: fmuid.Result) -> None:
    with pytest.raises(fmuid.InputError, match=r"misses must be above 0 and below 0\.5, not 0\.7"):
        Design({"turns": turns()}, healthy, coil.models()[0], miss=0.7)
    with pytest.raises(fmuid.InputError, match="level"):
        Design({"turns": turns()}, healthy, coil.models()[0], fmuid.diagnosis.DiagnosisSettings(0.0))
    with pytest.raises(fmuid.InputError, match="no excitation to compare"):
        design(healthy).rank({})
    with pytest.raises(fmuid.InputError, match="'v'"):
        design(healthy).detectable(planned_experiment(prbs(1.0, coil.STEP, 1.0, 15, column="v"), ["v"], ["i"]))
    with pytest.raises(fmuid.InputError, match="'j' is no measured output"):
        unknown = Design({"turns": turns()}, Baseline(healthy, noise_variance={"j": 1.0}), coil.models()[0])
        unknown.detectable(on_coil(prbs(1.0, coil.STEP, 1.0, 15)))
    clash = design(healthy, fmuid.Fault(coil.models()[1], {"R": fmuid.Parameter(0.0, nominal=1.0)}))
    with pytest.raises(fmuid.InputError, match="it can be only one"):
        clash.detectable(on_coil(prbs(1.0, coil.STEP, 1.0, 15)))
