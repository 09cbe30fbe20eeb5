"""The smallest detectable fault and the best excitation: against closed forms and against draws."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.signal import lfilter

import fmuid
from experiments.coil import study as coil
from fmuid import Baseline, Design, Monitor, Rule
from fmuid.data.signals import prbs, step_sequence
from fmuid.diagnosis import planned_experiment
from fmuid.runs.faults import design_of
from tests.support import operated_coil
from tests.support.plate import COLUMNS, PHASES, STD, TRUTH, Faults
from tests.support.plate import record as plate_record
from tests.support.results import changed

FALSE_ALARM, MISS = 0.02, 0.1
VARIANCE = {"i": coil.NOISE_VARIANCE}


@pytest.fixture(scope="module")
def healthy(healthy_coil: fmuid.Result) -> fmuid.Result:
    """Return a healthy result whose estimates are the true values, with the standard deviations of a record."""
    return changed(healthy_coil, values=np.array([coil.R, coil.L]))


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


def test_detectable_size_of_the_coil(healthy: fmuid.Result) -> None:
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
    }
    expected = {name: coil_deviation(healthy, frame["u"].to_numpy()) for name, frame in frames.items()}
    found = design(healthy)
    table = found.rank({name: on_coil(frame) for name, frame in frames.items()})
    order = sorted(expected, key=lambda name: expected[name])
    assert list(table["excitation"]) == order
    assert list(table["dR.std"]) == pytest.approx([expected[name] for name in order], rel=1e-3)
    assert list(table["worst"]) == list(table["dR"])  # the magnitude is 1 Ω
    assert table["excitation"][0] == "strong" and table["duration"].to_numpy() == pytest.approx(1.199)
    # a longer test does not lower what the healthy record's errors make
    (weak,), (strong,) = (found.detectable(on_coil(frames[name])) for name in ("weak", "strong"))
    assert 0 < weak.share < strong.share < 1
    still = found.rank({"still": on_coil(step_sequence(1.0, coil.STEP, [0.0])), "weak": on_coil(frames["weak"])})
    assert list(still["excitation"]) == ["weak", "still"]
    assert math.isinf(still["dR"][1]) and math.isfinite(still["dR"][0])


def test_a_design_promises_what_a_diagnosis_does() -> None:
    """Of ten imperfect coils at operating points of their own: the scatter of few records counts in both."""
    always = {"saturation": 0.15, "gain": 0.02, "dead": 0.03}
    rng = np.random.default_rng(71)
    known = operated_coil.baseline([operated_coil.operated(rng, **always) for _ in range(10)])
    new = operated_coil.operated(rng, **always)
    (planned,) = Design(operated_coil.FAULTS, known, coil.models()[0]).detectable(new)
    promised = fmuid.diagnose(new, known, operated_coil.FAULTS, coil.models()[0]).detectable["turns.dR"]
    assert planned.value == pytest.approx(promised, rel=0.05)


@pytest.mark.parametrize(
    "draws", [pytest.param(50, marks=pytest.mark.slow), pytest.param(300, marks=pytest.mark.campaign)]
)
def test_rates_over_draws(healthy: fmuid.Result, draws: int) -> None:
    """Draws of record and healthy result; R with the errors of its estimate, so not widened."""
    rng, settings = np.random.default_rng(6), fmuid.diagnosis.DiagnosisSettings(0.1)
    baseline = Baseline(healthy, noise_variance=VARIANCE)
    asked = Design({"turns": turns()}, baseline, coil.models()[0], settings, miss=0.2)
    (smallest,) = asked.detectable(coil.experiment(coil.record(coil.R, 0.0, rng)))
    for fault, expected in ((0.0, 0.1), (smallest.value, 0.8)):
        hits = 0
        for _ in range(draws):
            known = changed(healthy, values=healthy.values + healthy.std * rng.standard_normal(2))
            watch = Monitor(
                Baseline(known, noise_variance=VARIANCE), {"turns": turns()}, coil.models()[0], Rule(level=0.1)
            )
            watch.add(coil.experiment(coil.record(coil.R, fault, rng)))
            hits += watch.table["significant"][0] == "turns"
        assert hits / draws == pytest.approx(expected, abs=3 * math.sqrt(expected * (1 - expected) / draws))


# --- several parameters -----------------------------------------------------------------


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


NOISE = {"x": STD**2, "y": STD**2}


@pytest.mark.parametrize(("least", "tails"), [(-math.inf, 2.0), (0.0, 1.0)])
def test_each_size_is_a_cause_of_its_own(plate: fmuid.System, known: fmuid.Result, least: float, tails: float) -> None:
    """Without the others; the threshold is that of the smallest of three probabilities, a little below Bonferroni's."""
    fault = fmuid.Fault(plate, dict.fromkeys(PHASES, fmuid.Parameter(0.0, min=least, nominal=0.01)))
    found = Design({"stator": fault}, Baseline(known, noise_variance=NOISE), plate).detectable(plate_record(None))
    for each, column in zip(found, (2, 3, 4), strict=True):
        assert each.std == pytest.approx(plate_precision(known, [column])[0, 0] ** -0.5, rel=1e-4)
        high, low = (stats.norm.isf(0.01 / tails / count) + stats.norm.isf(0.05) for count in (3, 1))
        assert low * each.std < each.value < 1.01 * high * each.std
    if least < 0:
        information = plate_precision(known, [2, 3, 4])
        cosines = np.abs(information / np.sqrt(np.outer(np.diag(information), np.diag(information))))
        near = 1 + int(np.argmax(cosines[0, 1:]))
        assert found[0].rival == f"stator.{PHASES[near]}"
        assert math.cos(found[0].rival_angle) == pytest.approx(cosines[0, near], rel=1e-4)
        assert math.degrees(found[0].rival_angle) > 80.0
        assert found[0].apart == found[0].value  # named as soon as it is found


def test_cost_of_a_healthy_record(healthy: fmuid.Result) -> None:
    """An equally long one costs a factor of at most √2; one ten times as long 5 %."""
    record = on_coil(prbs(1.2, coil.STEP, 1.0, 15, seed=3))
    cost = design(healthy).cost(record)
    times = dict(zip(cost["healthy"], cost["turns.dR.times"], strict=True))
    assert times[1.0] > times[3.0] > times[10.0] > times[100.0] >= 1.0 - 1e-6
    assert times[1.0] <= math.sqrt(2.0) * 1.001
    assert times[10.0] <= 1.1
    (found,) = design(healthy).detectable(record, healthy=1.0)
    assert math.degrees(found.rival_angle) < 10.0  # a coil's turns, inductance and sensor look alike
    assert found.value < found.apart


def test_worst_angle_of_a_turned_fault(plate: fmuid.System, known: fmuid.Result, faults: Faults) -> None:
    baseline = Baseline(known, noise_variance=NOISE)
    (found,) = Design({"rotor": faults["rotor"]}, baseline, plate).detectable(plate_record(None))
    worst = float(np.linalg.eigvalsh(plate_precision(known, [5, 6]))[0])
    assert found.std == pytest.approx(worst**-0.5, rel=1e-4)
    assert stats.ncx2.sf(stats.chi2.isf(0.01, 2), 2, found.value**2 * worst) == pytest.approx(0.95, abs=1e-4)


# --- words ------------------------------------------------------------------------------


def test_wrong_words(healthy: fmuid.Result) -> None:
    model, settings, still = coil.models()[0], fmuid.diagnosis.DiagnosisSettings, prbs(1.0, coil.STEP, 1.0, 15)
    unknown = Design({"turns": turns()}, Baseline(healthy, noise_variance={"j": 1.0}), model)
    clash = design(healthy, fmuid.Fault(coil.models()[1], {"R": fmuid.Parameter(0.0, nominal=1.0)}))
    other = planned_experiment(prbs(1.0, coil.STEP, 1.0, 15, column="v"), ["v"], ["i"])
    cases: list[tuple[Callable[[], object], str]] = [
        (lambda: Design({"turns": turns()}, healthy, model, miss=0.7), r"between 0 and 0\.5, not 0\.7"),
        (lambda: Design({"turns": turns()}, healthy, model, settings(0.0)), "level"),
        (lambda: design(healthy).rank({}), "no excitation"),
        (lambda: design(healthy).detectable(other), "'v'"),
        (lambda: unknown.detectable(on_coil(still)), "'j'"),
        (lambda: clash.detectable(on_coil(still)), "belongs to the fault and the healthy machine"),
    ]
    for call, said in cases:
        with pytest.raises(fmuid.InputError, match=said):
            call()
    with pytest.raises(fmuid.InputError, match=r"unknown fault 'bars'\. Choose turns"):
        design_of(fmuid.Study.read(coil.HERE / "test.toml"), "bars")
