"""Diagnosis by fault models: size, place, significance and level on a machine that least squares solve exactly."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import fmuid
from fmuid import System
from fmuid.codec import as_json
from fmuid.diagnosis import MODEL_ERROR
from fmuid.diagnosis.faults import common_mode
from fmuid.reports.topics.diagnosis import deviation_notes, diagnosis_notes, verdict
from tests.support.plate import COLUMNS, STD, TRUTH, Faults, Look, identified, record

RATIO = fmuid.Parameter(0.0, min=0.0, nominal=0.01)
FREE = fmuid.Parameter(0.0, nominal=0.01)


def drawn(seed: int, **faults: float) -> fmuid.Experiment:
    return record(np.random.default_rng(seed), **faults)


def least_squares(healthy: fmuid.Result, experiment: fmuid.Experiment, which: list[int]) -> np.ndarray:
    """Return J_C, then the estimates and the standard deviations of the columns named."""
    stds = 5.0 * np.array([healthy.normal(name).std for name in TRUTH])
    springs = np.eye(len(which))[:2] / stds[:, None]
    matrix = np.vstack([COLUMNS[:, which] / STD, springs])
    right = np.concatenate([experiment.output_values.ravel() / STD, [healthy[name] for name in TRUTH] / stds])
    found = np.linalg.lstsq(matrix, right, rcond=None)[0]
    std = np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    return np.array([np.sum((matrix @ found - right) ** 2), *found, *std])


def test_estimates_and_statistics_are_those_of_least_squares(look: Look, sound: fmuid.Result) -> None:
    experiment = drawn(3, eb=0.08)
    found = look(experiment, noise_variance=STD**2)
    nothing = least_squares(sound, experiment, [0, 1])[0]
    alone = {each.change.label: each for each in found.evidence.suspects}
    for label, column in (("stator.ea", 2), ("stator.eb", 3), ("stator.ec", 4)):
        cost, _, _, value, _, _, std = least_squares(sound, experiment, [0, 1, column])
        if value < 0.3 * std:  # near or beyond the sign that it may not have
            assert alone[label].statistic < 1.0
            continue
        # the noise of this record is not quite white
        assert alone[label].statistic == pytest.approx(nothing - cost, rel=0.1)
        assert alone[label].change.value == pytest.approx(value, abs=0.3 * std)
        assert alone[label].change.std == pytest.approx(std, rel=0.1)
    cost, _, _, x, y, *_, std = least_squares(sound, experiment, [0, 1, 5, 6])
    rotor = alone["rotor.size"]
    assert rotor.statistic == pytest.approx(nothing - cost, abs=1.0)
    assert rotor.change.value == pytest.approx(math.hypot(x, y), abs=0.3 * std)
    assert rotor.probability == pytest.approx(stats.chi2.sf(rotor.statistic, 2))
    assert (found.kind, found.named) == ("fault", ("stator",))
    eb = least_squares(sound, experiment, [0, 1, 3])[3]
    assert found["stator.eb"].value == pytest.approx(eb, rel=1e-4)
    assert found.result is not None
    error = 0.25 * MODEL_ERROR * eb  # of the model, along its own signature
    assert found["stator.eb"].std == pytest.approx(math.hypot(found.result.std[-1], error), rel=1e-6)
    assert "stator, eb = 0.0" in verdict(found).text


def test_a_size_keeps_its_bound_and_its_interval(plate: fmuid.System, sound: fmuid.Result) -> None:
    narrow = {"one": fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, min=0.0, max=0.06, nominal=0.01)})}
    found = fmuid.diagnose(drawn(30, ea=0.06), sound, narrow, plate)
    assert found.named == ("one",)
    low, high = found["one.ea"].interval()
    assert 0.0 < low < found["one.ea"].value <= high <= 0.06


@pytest.mark.parametrize("angle", [0.1, 1.6])
def test_a_turned_fault_is_located(look: Look, angle: float) -> None:
    found = look(drawn(4, size=0.08, angle=angle))
    size = found["rotor.size"]
    assert found.named == ("rotor",)
    assert abs(size.value - 0.08) < 3 * size.std
    off = (size.angle_value - angle + math.pi / 2) % math.pi - math.pi / 2
    assert abs(off) < 3 * size.angle_std
    assert size.angle_std == pytest.approx(size.std / (2 * size.value), rel=0.2)
    assert "at angle = " in verdict(found).text


def test_sound_machines(look: Look, faults: Faults) -> None:
    """No fault and no angle; allowed changes of g are none; beyond them g is named."""
    found = look(drawn(5))
    assert found.kind == "healthy"
    assert "angle" not in verdict(found).text
    warm = drawn(6, g=1.06)
    found = look(warm, std_factor={"g": 20.0})
    assert (found.kind, found.deviation) == ("healthy", None)
    assert abs(found.nominal["g"][0] - 1.06) < 4 * found.nominal["g"][1]
    surprised = look(warm, std_factor=1.0, faults={"rotor": faults["rotor"]})
    assert not surprised.evidence.alarm
    assert surprised.deviation is not None and surprised.deviation.name == "g"
    assert deviation_notes(surprised.deviation)[0].text.startswith("g is ")


@pytest.mark.campaign
def test_false_alarm_rate_over_draws(plate: fmuid.System, faults: Faults) -> None:
    """Over healthy records and healthy machines: any alarm, of either fault, at a level of 10 %."""
    rng, settings, count, alarms = np.random.default_rng(7), fmuid.diagnosis.DiagnosisSettings(0.1), 200, 0
    for _ in range(count):
        known = identified(plate, record(rng))
        alarms += fmuid.diagnose(record(rng), known, faults, plate, settings).evidence.alarm
    assert alarms / count == pytest.approx(0.1, abs=3 * math.sqrt(0.09 / count))


def test_indistinguishable_faults(look: Look, plate: fmuid.System) -> None:
    alike = {name: fmuid.Fault(plate, {"ea": RATIO}) for name in ("one", "other")}
    found = look(drawn(8, ea=0.06), faults=alike)
    assert (found.kind, set(found.named)) == ("ambiguous", {"one", "other"})
    text = verdict(found).text  # in either order: their odds are equal
    assert text.startswith("FAULT, indistinguishable: ")
    assert text.count("one, ea = ") == text.count("other, ea = ") == 1
    assert [each.odds for each in found.evidence.explanations] == pytest.approx([1.0, 1.0])


@pytest.fixture(scope="module")
def two(plate: fmuid.System) -> fmuid.System:
    """Return two plates with the same u, whose other inputs are their own."""
    connectors = {name: [(f"{part}.{name}", 1.0, 0.0) for part in "ab"] for name in ("ux", "uy")}
    return System(components=dict.fromkeys("ab", plate.components[""].fmu), connectors=connectors)


NAMES = {name: f"a.{name}" for name in ("g", "h", "vx", "vy")} | {name: f"a.{name} + b.{name}" for name in ("x", "y")}


def test_a_fault_like_the_machine_needs_a_prior(look: Look, two: fmuid.System) -> None:
    """A gain that is the fault's and the machine's."""
    same = {"gain": fmuid.Fault(two, {"b.g": FREE}, NAMES, values={"b.h": 0.0}, inputs={"b.vx": "vx"})}
    found = look(drawn(10, g=1.02), faults=same, std_factor=math.inf)
    assert (found.kind, found.undetermined) == ("undecided", ("gain.b.g",))
    assert not found["gain.b.g"].is_determined
    assert "UNDECIDED: gain.b.g" in verdict(found).text
    assert look(drawn(10, g=1.02), faults=same, std_factor=1.0)["gain.b.g"].is_determined


def test_a_fault_model_with_other_names_inputs_and_components(
    look: Look, plate: fmuid.System, two: fmuid.System
) -> None:
    """Outputs are sums of a healthy plate, and one without gains that only has the fault."""
    beside = fmuid.Fault(two, {"b.ea": RATIO}, NAMES, values={"b.g": 0.0, "b.h": 0.0}, inputs={"b.vx": "vx"})
    found = look(drawn(12, ea=0.05), faults={"beside": beside, "inside": fmuid.Fault(plate, {"ea": RATIO})})
    one, other = found.evidence.suspects
    assert (one.change.label, other.change.label) == ("beside.b.ea", "inside.ea")
    assert one.change.value == pytest.approx(other.change.value, abs=1e-5)
    assert one.statistic == pytest.approx(other.statistic, rel=1e-5)
    assert not found.mismatched
    assert found.result is not None
    assert found.result[("b.ea", "ea")[found.named.index("inside") == 0]] == pytest.approx(0.05, abs=0.02)


def test_a_fault_model_that_differs_at_zero_is_noted(look: Look, plate: fmuid.System) -> None:
    found = look(drawn(13), faults={"wrong": fmuid.Fault(plate, {"ea": FREE}, values={"eb": 0.1})})
    assert found.mismatched == ("wrong",)
    assert any(note.message.endswith("MISMATCHED") for note in diagnosis_notes(found))


def test_a_file_keeps_the_diagnosis(look: Look, tmp_path: Path) -> None:
    found = look(drawn(15, size=0.08, angle=1.0))
    read = fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json"))
    assert as_json(read) == as_json(found)
    assert [each.text for each in diagnosis_notes(read)] == [each.text for each in diagnosis_notes(found)]
    assert read.evidence == found.evidence
    assert read.table.equals(found.table)
    with pytest.raises(fmuid.InputError, match=r"unknown cause 'rotor.angle'.*stator.ea, "):
        read["rotor.angle"]
    content, other = json.loads((tmp_path / "diagnosis.json").read_text()), tmp_path / "other.json"
    damaged: dict[str, Any] = {r"other\.json is of no schema": {}}
    damaged |= {
        f"{key}: .*{'run fmuid diagnose again'}": content | {key: ["of old"]} for key in ("evidence", "nominal")
    }
    for message, written in damaged.items():
        other.write_text(json.dumps(written), encoding="utf-8")
        with pytest.raises(fmuid.InputError, match=message):
            fmuid.Diagnosis.from_json(other)


# --- bad input --------------------------------------------------------------------------

ANGLE = fmuid.diagnosis.FaultAngle


@pytest.mark.parametrize(
    ("parameters", "angles", "said"),
    [
        ({}, (), "no parameters"),
        ({"ea": 0.0}, (), "'ea' must be a Parameter"),
        ({"ea": fmuid.Parameter(1.0, min=0.5)}, (), "exclude 0"),
        ({"ea": fmuid.Parameter(1.0, prior=fmuid.Normal(0, 1))}, (), "has a prior"),
        ({"ea": fmuid.Parameter(1.0, per_experiment=True)}, (), "one per experiment"),
        ({"ea": FREE}, ["eb"], "unknown angle 'eb'.*'ea'"),
        ({"a": FREE}, ["a"], "no clear size"),
        ({"s": FREE, "a": FREE}, {"a": ANGLE("t")}, "unknown size 't'"),
        ({"s": FREE, "a": FREE, "b": FREE}, {"a": ANGLE("s"), "b": ANGLE("s")}, "two angles"),
    ],
)
def test_wrong_faults(parameters: dict[str, Any], angles: Any, said: str) -> None:
    with pytest.raises(fmuid.InputError, match=said):
        fmuid.Fault("model.fmu", parameters, angles=angles)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"faults": {}}, "no fault given"),
        ({"std_factor": {"gg": 2.0}}, "std_factor: unknown parameter 'gg'.*'g'"),
        ({"std_factor": 0.0}, "inflate must be greater than 0"),
        ({"noise_variance": {"x": 0.01}}, "lacks the output 'y'"),
        ({"level": 1.0}, "the level of a test"),
        ({"values": {"g": 1.0, "h": 1.0}}, "no free parameter of this machine"),
        ({"parameters": {"g": fmuid.Parameter(1.0, prior=fmuid.Normal(1, 1))}}, "two priors"),
        ({"parameters": {"g": fmuid.Parameter(5.0, min=4.0)}}, "'g' of the healthy result: start"),
        ({"faults": {"f": {"e": FREE}}}, "'e'"),
        ({"faults": {"f": {"g": FREE}}}, "fault 'f': the parameter 'g' belongs to"),
        ({"faults": {"f": {"q": "r"}}}, "fault 'f': variable_map: unknown variable 'q'"),
    ],
)
def test_what_does_not_fit_together(look: Look, plate: fmuid.System, words: dict[str, Any], said: str) -> None:
    def fault(given: Any) -> fmuid.Fault:
        return fmuid.Fault(plate, {"ea": FREE}, given) if "q" in given else fmuid.Fault(plate, given)

    if "faults" in words:
        words = {"faults": {name: fault(given) for name, given in words["faults"].items()}}
    with pytest.raises(fmuid.InputError, match=said):
        look(drawn(16), **words)


@pytest.mark.parametrize(
    ("words", "said"), [({"sensitivity": "forwards"}, "'forwards'.*'forward'"), ({"model_error": -1.0}, "model_error")]
)
def test_wrong_settings(words: dict[str, Any], said: str) -> None:
    with pytest.raises(fmuid.InputError, match=said):
        fmuid.diagnosis.DiagnosisSettings(**words)


def test_common_mode_excludes_parameters_of_single_records(plate: fmuid.System) -> None:
    parameters = {"g": fmuid.Parameter(1.5), "h": fmuid.Parameter(1.5, per_experiment=True)}
    result = fmuid.identify(fmuid.Problem(plate, drawn(17), parameters))
    assert list(common_mode(result)) == ["g"]
    own = common_mode(result, parameters={"h": fmuid.Parameter(2.0)})
    assert own["h"].prior is None and own["g"].prior is not None


@pytest.mark.parametrize("grid", [{"tau": [0.01, 0.025, 0.05]}, {"taw": [0.01, 0.02]}])
def test_a_detail_alone_has_no_pairs_and_a_known_name(grid: dict[str, list[float]]) -> None:
    coil, faulty = fmuid.datasets.coil(), fmuid.datasets.faulty_coil()
    fault = fmuid.Fault(faulty.fmu, {"dR": faulty.parameters["dR"]}, nuisance=grid)
    healthy = fmuid.identify(coil.problem())
    if "taw" in grid:
        with pytest.raises(fmuid.InputError, match=r"fault 'turns': .*no nuisance variable 'taw' .*'tau'"):
            fmuid.diagnose(faulty.experiment, healthy, {"turns": fault}, coil.fmu)
        return
    size = fmuid.diagnose(faulty.experiment, healthy, {"turns": fault}, coil.fmu)["turns.dR"]
    assert abs(size.value - faulty.truth["dR"]) < 4 * size.std
