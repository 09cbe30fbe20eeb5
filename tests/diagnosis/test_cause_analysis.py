"""Causes beside the faults: columns against closed forms, names over draws, and what study and words say of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import signal

import fmuid
from fmuid.apps.cli.app import run
from fmuid.diagnosis import MODEL_ERROR, CauseKind, Causes, CauseScale, ChangeEvidence
from fmuid.diagnosis.causes import ChangeParameterSet, coordinates_of
from fmuid.diagnosis.information_matrix import Whitening
from fmuid.diagnosis.linearized_machine import LinearizedMachine
from fmuid.errors import InputError
from fmuid.reports.topics.diagnosis_phrases import verdict
from tests.support.closed_forms import coil_response
from tests.support.paths import FMUS

EXPERIMENT = Path(__file__).parents[2] / "experiments" / "coil"
SAMPLES, STEP, NOISE = 1200, 1e-3, 0.035
TRUTH = {"R": 4.0, "L": 0.1}
TAU = 0.025
NOMINAL = {name: fmuid.Parameter(value, nominal=value) for name, value in TRUTH.items()}
VOLTAGE = np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], SAMPLES // 15), 15)


def current(turns: float = 0.0, **off: float) -> np.ndarray:
    """Return the closed form of a coil with R, L and turns off, seen by a sensor with a gain, an offset and a delay."""
    times = np.asarray(STEP * np.arange(SAMPLES), dtype=np.float64)
    R, L = TRUTH["R"] + off.get("R", 0.0) + turns, TRUTH["L"] + off.get("L", 0.0) + 2 * TAU * turns
    u = np.asarray(VOLTAGE * (1.0 + off.get("input_gain", 0.0)), dtype=np.float64)
    i = coil_response(times, u, R, L, linear=False)
    # samples lie on the steps of the voltage, where the current has two rates: central differences, as fmuid's
    late = i - off.get("delay", 0.0) * np.gradient(i, times)
    return (1.0 + off.get("gain", 0.0)) * late + off.get("offset", 0.0)


def experiment(values: np.ndarray) -> fmuid.Experiment:
    frame = pd.DataFrame({"time": STEP * np.arange(SAMPLES), "u": VOLTAGE, "i": values})
    return fmuid.Experiment(frame, ["u"], ["i"], interpolation="zoh")


def noisy(rng: np.random.Generator, colour: float = 0.0, **off: float) -> fmuid.Experiment:
    white = NOISE * np.sqrt(1 - colour**2) * rng.standard_normal(SAMPLES + 50)
    return experiment(current(**off) + signal.lfilter([1.0], [1.0, -colour], white)[50:])


@pytest.fixture(scope="module")
def coil() -> fmuid.System:
    return fmuid.System.of(FMUS / "Coil/Coil.fmu")


@pytest.fixture(scope="module")
def faults() -> dict[str, fmuid.Fault]:
    model = FMUS / "FaultyCoil/FaultyCoil.fmu"
    return {"turns": fmuid.Fault(model, {"dR": fmuid.Parameter(0.0, nominal=0.5)}, values={"tau": TAU})}


@pytest.fixture(scope="module")
def coordinates(coil: fmuid.System, faults: dict[str, fmuid.Fault]) -> ChangeParameterSet:
    return coordinates_of(coil, NOMINAL, faults, experiment(current()), {"i": NOISE}, Causes())


ORDER = ("R", "L", "turns", "gain", "offset", "delay", "input_gain")


@pytest.mark.parametrize("at", [{}, {"turns": 1.0, "gain": 0.1, "R": 0.5}, {"input_gain": 0.2, "turns": -0.5}])
def test_outputs_and_columns_are_those_of_the_closed_form(
    coil: fmuid.System, coordinates: ChangeParameterSet, at: dict[str, float]
) -> None:
    machine = LinearizedMachine(coil, {}, coordinates, experiment(current()))
    point = coordinates.healthy + np.array([at.get(name, 0.0) for name in ORDER])
    outputs, columns = machine.linearize(point)
    assert outputs[:, 0] == pytest.approx(current(**at), abs=1e-6)
    assert machine.outputs(point) == pytest.approx(outputs)
    for k, name in enumerate(ORDER):
        step = 1e-4 * (coordinates.each[k].normal if name not in TRUTH else TRUTH[name])
        beside = [current(**(at | {name: at.get(name, 0.0) + sign * step})) for sign in (-1, 1)]
        exact = (beside[1] - beside[0]) / (2 * step)
        assert columns[:, 0, k] == pytest.approx(exact, abs=2e-4 * np.abs(exact).max()), name


def test_a_column_that_two_inputs_share_is_scaled_for_one(coil: fmuid.System) -> None:
    """A causes' gain scales a copy: another variable may read the same column."""
    frame = experiment(current()).frame
    shared = fmuid.Experiment(frame, {"u": "u"}, {"i": "i"}, interpolation="zoh")
    made = coordinates_of(coil, NOMINAL, {}, shared, {"i": NOISE}, Causes())
    LinearizedMachine(coil, {}, made, shared).linearize(made.healthy)
    assert shared.frame["u"].to_numpy() == pytest.approx(VOLTAGE)
    assert [each.variable for each in made.each if each.kind is CauseKind.INPUT_GAIN] == ["u"]


def test_whitening() -> None:
    """Innovations of coloured noise are white, of unit variance; the first samples have the process's variance."""
    rng = np.random.default_rng(5)
    record = noisy(rng, 0.8)
    rest = record.output_values - current()[:, None]
    whitening = Whitening.of([(record, rest)])
    other = noisy(rng, 0.8)
    white = whitening(other, (other.output_values - current()[:, None])[:, :, None])[:, 0]
    assert np.std(white) == pytest.approx(1.0, abs=0.08)
    assert np.corrcoef(white[1:], white[:-1])[0, 1] == pytest.approx(0.0, abs=0.08)
    gaps = other.output_values.copy()
    gaps[100:110] = np.nan
    holed = other.with_outputs(gaps)
    filled = np.where(np.isnan(gaps), 0.0, gaps - current()[:, None])
    assert whitening(holed, filled[:, :, None])[:100, 0] == pytest.approx(white[:100])
    assert len(whitening(holed, filled[:, :, None])) == SAMPLES - 10
    given = Whitening.of([(record, rest)], {"i": 4 * NOISE**2})
    assert np.std(given(other, (other.output_values - current()[:, None])[:, :, None])) == pytest.approx(0.5, abs=0.05)


Look = Callable[..., fmuid.Diagnosis]


@pytest.fixture(scope="module")
def look(coil: fmuid.System, faults: dict[str, fmuid.Fault]) -> Look:
    def diagnosis(
        seed: int, base: dict[str, float] | None = None, colour: float = 0.0, causes: Causes | None = None, **off: float
    ) -> fmuid.Diagnosis:
        rng = np.random.default_rng(seed)
        healthy = noisy(rng, colour, **(base or {}))
        known = fmuid.identify(fmuid.Problem(coil, healthy, NOMINAL))
        baseline = fmuid.Baseline(known, {"R": 10.0}, records=[healthy])
        record = noisy(rng, colour, **{name: (base or {}).get(name, 0.0) + off.get(name, 0.0) for name in ORDER})
        settings = fmuid.diagnosis.DiagnosisSettings(0.01, causes=causes or Causes())
        return fmuid.diagnose(record, baseline, faults, coil, settings)

    return diagnosis


def names(found: fmuid.Diagnosis) -> list[list[tuple[CauseKind, str]]]:
    return [[(each.kind, each.variable) for each in one.changes] for one in found.evidence.explanations]


TURNS = [(CauseKind.FAULT, "dR")]


@pytest.mark.parametrize(
    ("off", "first"),
    [
        ({"turns": 1.0}, TURNS),
        ({"turns": 1.0, "R": 1.0}, TURNS),
        ({"offset": NOISE / 2}, [(CauseKind.OFFSET, "i")]),
        ({"delay": 1e-3}, [(CauseKind.DELAY, "i")]),
    ],
    ids=["turns", "turns, warm", "offset", "delay"],
)
def test_what_has_changed_is_named(look: Look, off: dict[str, float], first: list[tuple[CauseKind, str]]) -> None:
    """An offset of half a standard deviation of the noise is not silent, a late sensor no loss of turns."""
    found = look(1, **off)
    assert names(found) == [first]
    assert found.kind == ("fault" if "turns" in off else "other")
    assert found.evidence.steady
    change = found.evidence.explanations[0].changes[0]
    assert abs(change.value - off[next(iter(off))]) < 3 * change.std
    low, high = change.interval()
    assert low < change.value < high
    assert ("FAULT: turns" if "turns" in off else "CHANGE without fault") in verdict(found).text


def test_what_looks_alike_is_named_together(look: Look) -> None:
    """A larger inductance: no loss of turns alone; both, with the angle between them."""
    found = look(2, L=0.012)
    assert found.kind == "ambiguous"
    named = [one[0] for one in names(found)]
    assert (CauseKind.PARAMETER, "L") in named
    assert (CauseKind.FAULT, "dR") in named
    suspect = next(each for each in found.evidence.suspects if each.change.fault)
    assert np.degrees(suspect.rival_angle) < 10
    assert "CHANGE, indistinguishable: " in verdict(found).text


def test_what_was_always_so_is_no_news(look: Look) -> None:
    """Sensors that were off when the machine was healthy; coloured noise; a warm winding: nothing new."""
    always = {"gain": 0.02, "offset": 0.008, "delay": 2e-4}
    for found in (look(3, base=always), look(4, colour=0.8), look(5, R=0.8)):
        assert found.kind == "healthy", verdict(found).text
        assert "NO FAULT at 1 % false-alarm rate" in verdict(found).text


@pytest.mark.slow
def test_trials_show_what_a_fault_model_leaves(coil: fmuid.System, faults: dict[str, fmuid.Fault]) -> None:
    """As much as an offset that a trial has beside its turns explains; chance alone leaves next to nothing."""
    random = np.random.default_rng(8)
    healthy = noisy(random)
    known = fmuid.identify(fmuid.Problem(coil, healthy, NOMINAL))

    def found(record: fmuid.Experiment, **trials: list[fmuid.Experiment]) -> ChangeEvidence:
        named = {name.replace("_", "."): each for name, each in trials.items()}
        baseline = fmuid.Baseline(known, {"R": 10.0}, records=[healthy], trials=named)
        return fmuid.diagnose(record, baseline, faults, coil).evidence

    plain, off = noisy(random, turns=2.0), noisy(random, turns=2.0, offset=0.02)
    own = next(each.statistic for each in found(plain).suspects if each.change.label == "turns.dR")
    left = 0.02**2 * SAMPLES / NOISE**2 / 2.0  # half of the information on an offset is the healthy record's
    assert found(healthy).model_error == MODEL_ERROR
    assert found(healthy, turns_dR=[off]).model_error == pytest.approx(math.sqrt(left / own) / 3.0, rel=0.25)
    assert found(healthy, turns_dR=[plain]).model_error < 0.3 * math.sqrt(left / own) / 3.0
    assert found(healthy, turns_dR=[plain, off]).model_error == found(healthy, turns_dR=[off]).model_error
    for given, message in (
        ({"turns": [off]}, "trials have 'turns', which is no cause"),
        ({"turns_dR": [healthy]}, "shows nothing of turns.dR: take a larger one"),
    ):
        with pytest.raises(InputError, match=message):
            found(healthy, **given)
    with pytest.raises(InputError, match="trials are compared with healthy records"):
        fmuid.Baseline(known, trials={"turns.dR": [off]})


def test_causes_may_be_left_out(look: Look) -> None:
    none = Causes(None, None, None, None, None)
    found = look(2, L=0.012, causes=none)
    assert [each.change.kind for each in found.evidence.suspects] == [CauseKind.FAULT]
    assert names(found) == [TURNS]
    with pytest.raises(InputError, match="must be positive, not 0"):
        CauseScale(0.0, 1.0)


def test_what_no_cause_explains_is_something_else(look: Look, tmp_path: Path) -> None:
    """An offset of half a standard deviation of the noise, where sensors are not looked at."""
    none = Causes(None, None, None, None, None)
    found = look(500, causes=none, offset=NOISE / 2)
    assert found.kind == "unexplained"
    assert found.evidence.remainder.probability < 1e-10
    assert found.unexplained.ratio < 1.5
    assert verdict(found).text.startswith("UNEXPLAINED CHANGE: residual–input correlation")
    assert fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json")).kind == "unexplained"
    for known in (
        look(501, causes=none),
        look(501, causes=none, base={"offset": NOISE / 2}),
        look(1, offset=NOISE / 2),
    ):
        assert known.evidence.remainder.probability > 0.01
        assert known.kind in ("healthy", "other")
    turns = look(502, causes=none, turns=1.0)
    assert turns.kind == "fault"
    assert turns.evidence.explained > 0.95


@pytest.mark.slow
def test_level_and_names_over_draws(look: Look) -> None:
    """100 healthy records, white and coloured: 1 % of alarms; 40 with a fault of the sensor: never a fault alone."""
    alarms = [look(100 + k, colour=colour).evidence for k in range(50) for colour in (0.0, 0.8)]
    assert sum(each.alarm for each in alarms) <= 5
    for k in range(40):
        found = look(300 + k, delay=1e-3)
        assert found.kind != "fault"
        assert [(CauseKind.DELAY, "i")] in names(found)


def test_files_and_words(look: Look, tmp_path: Path) -> None:
    found = look(6, turns=1.0)
    again = fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json"))
    assert again.evidence == found.evidence
    assert verdict(again).text == verdict(found).text


def coil_study(*words: str, table: str = "test1.csv") -> list[str]:
    set_ = [f"experiments.0.data={table}", *words]
    return ["diagnose", str(EXPERIMENT / "test.toml"), *(part for word in set_ for part in ("--set", word))]


def test_a_study_with_healthy_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*coil_study('diagnosis.healthy_data=["healthy.csv"]'), "-o", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "Causes" in said
    assert "gain of sensor i" in said
    assert fmuid.Diagnosis.from_json(tmp_path / "diagnosis.json").named == ("turns",)
    few = coil_study(
        'diagnosis.healthy_data=["healthy.csv"]',
        "diagnosis.causes.sensor_gain=false",
        "diagnosis.causes.sensor_delay=false",
    )
    assert run([*few, "-o", str(tmp_path)]) == 1
    assert "gain of sensor i" not in capsys.readouterr().out
    trials = coil_study(
        'diagnosis.healthy_data=["healthy.csv"]', 'diagnosis.known_fault_data={"turns.dR" = ["test4.csv"]}'
    )
    assert run([*trials, "-o", str(tmp_path)]) == 1
    evidence = fmuid.Diagnosis.from_json(tmp_path / "diagnosis.json").evidence
    assert 0.0 < evidence.model_error < MODEL_ERROR
    said = f"other signatures: {100 * evidence.model_error:.2g} % of their effect"
    assert "Fault-model error: 3 % along" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ('diagnosis.healthy_data=["nothing.csv"]', "not found"),
        ('diagnosis.healthy_data="healthy.csv"', "healthy_data: must be a list of files"),
        ("diagnosis.causes.sensor_gain=0.3", "sensor_gain: must be a section, not 0.3"),
        ("diagnosis.fault_model_error=-1", "fault_model_error: must be a number, 0 or above"),
    ],
)
def test_wrong_words(words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*coil_study(words), "-o", str(tmp_path)]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_records_that_do_not_fit(coil: fmuid.System, faults: dict[str, fmuid.Fault]) -> None:
    healthy = noisy(np.random.default_rng(8))
    known = fmuid.identify(fmuid.Problem(coil, healthy, NOMINAL))
    silent = fmuid.Experiment(healthy.frame, [], ["i"], source="silent.csv")
    with pytest.raises(InputError, match=r"has the inputs u, and the healthy record silent.csv none"):
        fmuid.diagnose(healthy, fmuid.Baseline(known, records=[silent]), faults, coil)
    planned = fmuid.diagnosis.planned_experiment(healthy.frame[["time", "u"]], ["u"], ["i"], name="plan")
    with pytest.raises(InputError, match=r"plan has no sample of 'i'\. Leave it out of the healthy data\."):
        fmuid.diagnose(healthy, fmuid.Baseline(known, records=[healthy, planned]), faults, coil)
    with pytest.raises(InputError, match="model_error is a share"):
        fmuid.diagnosis.DiagnosisSettings(model_error=-1.0)
