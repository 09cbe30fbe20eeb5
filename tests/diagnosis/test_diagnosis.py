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
from fmuid.codec import as_json
from fmuid.diagnosis import MODEL_ERROR, CauseScore
from fmuid.diagnosis.faults import common_mode
from fmuid.models import System
from fmuid.reports.topics.diagnosis_phrases import deviation_notes, diagnosis_notes, verdict
from tests.support.diagnosis_studies import Look
from tests.support.plate import (
    COLUMNS,
    INPUTS,
    SAMPLES,
    STD,
    TRUTH,
    Faults,
    identified,
    record,
)


def least_squares(healthy: fmuid.Result, experiment: fmuid.Experiment, inflate: float, which: list[int]) -> np.ndarray:
    """Return J_C, then the estimates and the standard deviations of the columns named."""
    target = experiment.output_values.ravel()
    rows, wanted = [COLUMNS[:, which] / STD], [target / STD]
    for i, name in enumerate(TRUTH):
        std = inflate * healthy.normal(name).std
        rows.append(np.eye(len(which))[[i]] / std)
        wanted.append(np.array([healthy[name] / std]))
    matrix, right = np.vstack(rows), np.concatenate(wanted)
    found = np.linalg.lstsq(matrix, right, rcond=None)[0]
    return np.array(
        [np.sum((matrix @ found - right) ** 2), *found, *np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))]
    )


def suspects(found: fmuid.Diagnosis) -> dict[str, CauseScore]:
    return {each.change.label: each for each in found.evidence.suspects}


def test_estimates_and_statistics_are_those_of_least_squares(look: Look, healthy: fmuid.Result) -> None:
    experiment = record(np.random.default_rng(3), eb=0.08)
    found = look(experiment, noise_variance=STD**2)
    nothing = least_squares(healthy, experiment, 5.0, [0, 1])
    alone = suspects(found)
    for label, column in (("stator.ea", 2), ("stator.eb", 3), ("stator.ec", 4)):
        cost, _, _, value, _, _, std = least_squares(healthy, experiment, 5.0, [0, 1, column])
        if value < 0.3 * std:  # near or beyond the sign that it may not have
            assert alone[label].statistic < 1.0
            continue
        # the noise that this record shows is not quite white
        assert alone[label].statistic == pytest.approx(nothing[0] - cost, rel=0.1)
        assert alone[label].change.value == pytest.approx(value, abs=0.3 * std)
        assert alone[label].change.std == pytest.approx(std, rel=0.1)
    rotor = least_squares(healthy, experiment, 5.0, [0, 1, 5, 6])
    assert alone["rotor.size"].statistic == pytest.approx(nothing[0] - rotor[0], abs=1.0)
    assert alone["rotor.size"].change.value == pytest.approx(math.hypot(*rotor[3:5]), abs=0.3 * rotor[-1])
    assert alone["rotor.size"].probability == pytest.approx(stats.chi2.sf(alone["rotor.size"].statistic, 2))
    assert (found.kind, found.named) == ("fault", ("stator",))
    _, _, _, eb, _, _, _ = least_squares(healthy, experiment, 5.0, [0, 1, 3])
    assert found["stator.eb"].value == pytest.approx(eb, rel=1e-4)
    assert found.result is not None
    error = 0.25 * MODEL_ERROR * eb  # of the model, along its own signature
    assert found["stator.eb"].std == pytest.approx(math.hypot(found.result.std[-1], error), rel=1e-6)
    assert "stator, eb = 0.0" in verdict(found).text


def test_a_size_keeps_its_bound_and_its_interval(plate: fmuid.System, healthy: fmuid.Result) -> None:
    """Above what the fault may be, the fit stands on the bound; the interval does not cross it."""
    narrow = {"one": fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, min=0.0, max=0.06, nominal=0.01)})}
    found = fmuid.diagnose(record(np.random.default_rng(30), ea=0.06), healthy, narrow, plate)
    assert found.named == ("one",)
    low, high = found["one.ea"].interval()
    assert 0.0 < low < found["one.ea"].value <= high <= 0.06


@pytest.mark.parametrize("angle", [0.1, 1.6, 2.9])
def test_a_turned_fault_is_located(look: Look, angle: float) -> None:
    found = look(record(np.random.default_rng(4), size=0.08, angle=angle))
    size = found["rotor.size"]
    assert found.named == ("rotor",)
    assert abs(size.value - 0.08) < 3 * size.std
    off = (size.angle_value - angle + math.pi / 2) % math.pi - math.pi / 2
    assert abs(off) < 3 * size.angle_std
    assert size.angle_std == pytest.approx(size.std / (2 * size.value), rel=0.2)
    assert "at angle = " in verdict(found).text


def test_no_angle_is_told_of_a_fault_that_is_not_there(look: Look) -> None:
    found = look(record(np.random.default_rng(5)))
    assert found.kind == "healthy"
    assert "angle" not in verdict(found).text


def test_the_common_mode_takes_what_was_foreseen(look: Look, faults: Faults) -> None:
    warm = record(np.random.default_rng(6), g=1.06)
    found = look(warm, std_factor={"g": 20.0})
    assert found.kind == "healthy"
    assert abs(found.nominal["g"][0] - 1.06) < 4 * found.nominal["g"][1]
    assert found.deviation is None
    surprised = look(warm, std_factor=1.0, faults={"rotor": faults["rotor"]})
    assert not surprised.evidence.alarm
    assert surprised.deviation is not None
    assert surprised.deviation.name == "g"
    assert deviation_notes(surprised.deviation)[0].text.startswith("g is ")


@pytest.mark.slow
def test_the_false_alarm_level_is_met(plate: fmuid.System, faults: Faults) -> None:
    """Over healthy records and healthy machines: any alarm, of either fault, at a level of 10 %."""
    rng, level, count = np.random.default_rng(7), 0.1, 100
    alarms = 0
    for _ in range(count):
        known = identified(plate, record(rng))
        found = fmuid.diagnose(record(rng), known, faults, plate, fmuid.diagnosis.DiagnosisSettings(level))
        alarms += found.evidence.alarm
    assert alarms / count == pytest.approx(level, abs=3 * math.sqrt(0.1 * 0.9 / count))


def test_faults_that_act_alike_are_not_told_apart(look: Look, plate: fmuid.System) -> None:
    ratio = fmuid.Parameter(0.0, min=0.0, nominal=0.01)
    alike = {"one": fmuid.Fault(plate, {"ea": ratio}), "other": fmuid.Fault(plate, {"ea": ratio})}
    found = look(record(np.random.default_rng(8), ea=0.06), faults=alike)
    assert found.kind == "ambiguous"
    assert set(found.named) == {"one", "other"}
    assert "FAULT, indistinguishable: one, ea = " in verdict(found).text
    assert found.evidence.explanations[0].odds == 1.0
    assert found.evidence.explanations[1].odds == pytest.approx(1.0)


def test_something_else_is_said_to_be_something_else(look: Look) -> None:
    experiment = record(np.random.default_rng(9))
    frame = experiment.frame.assign(x=experiment.frame["x"] + 0.2 * np.sin(np.arange(SAMPLES)))
    found = look(fmuid.Experiment(frame, experiment.inputs, experiment.outputs))
    assert found.kind == "unexplained"
    assert verdict(found).text.startswith("UNEXPLAINED CHANGE")
    assert found.unexplained.ratio > 2


def test_without_any_prior_a_fault_like_the_common_mode_stays_open(look: Look, plate: fmuid.System) -> None:
    """A gain that is the fault's and the machine's."""
    twice = System.of(plate.components[""].fmu)
    same = fmuid.Fault(
        System(
            components={"a": twice.components[""].fmu, "b": twice.components[""].fmu},
            connectors={
                **{name: [(f"{part}.{name}", 1.0, 0.0) for part in ("a", "b")] for name in ("ux", "uy")},
                **{name: [(f"a.{name}", 1.0, 0.0)] for name in ("g", "h", "vx", "vy")},
            },
        ),
        {"b.g": fmuid.Parameter(0.0, nominal=0.01)},
        {name: f"a.{name} + b.{name}" for name in ("x", "y")},
        values={"b.h": 0.0},
        inputs={"b.vx": "vx"},
    )
    experiment = record(np.random.default_rng(10), g=1.02)
    found = look(experiment, faults={"gain": same}, std_factor=math.inf)
    assert (found.kind, found.undetermined) == ("undecided", ("gain.b.g",))
    assert not found["gain.b.g"].is_determined
    assert "UNDECIDED: gain.b.g" in verdict(found).text
    assert look(experiment, faults={"gain": same}, std_factor=1.0)["gain.b.g"].is_determined


def test_a_fault_model_may_have_other_names_inputs_and_components(look: Look, plate: fmuid.System) -> None:
    """Two plates whose outputs are summed: a healthy one, and one without gains that only has the fault."""
    model = plate.components[""].fmu
    both = fmuid.System(
        components={"machine": model, "fault": model},
        connectors={name: [(f"{part}.{name}", 1.0, 0.0) for part in ("machine", "fault")] for name in ("ux", "uy")},
    )
    names = {"g": "machine.g", "h": "machine.h", "vx": "machine.vx", "vy": "machine.vy"}
    names |= {name: f"machine.{name} + fault.{name}" for name in ("x", "y")}
    beside = fmuid.Fault(
        both,
        {"fault.ea": fmuid.Parameter(0.0, min=0.0, nominal=0.01)},
        names,
        values={"fault.g": 0.0, "fault.h": 0.0},
        inputs={"fault.vx": "vx"},
    )
    inside = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, min=0.0, nominal=0.01)})
    found = look(record(np.random.default_rng(12), ea=0.05), faults={"beside": beside, "inside": inside})
    alone = suspects(found)
    one, other = alone["beside.fault.ea"], alone["inside.ea"]
    assert one.change.value == pytest.approx(other.change.value, abs=1e-5)
    assert one.statistic == pytest.approx(other.statistic, rel=1e-5)
    assert not found.mismatched
    assert found.result is not None
    assert found.result[("fault.ea", "ea")[found.named.index("inside") == 0]] == pytest.approx(0.05, abs=0.02)


def test_a_model_that_is_not_the_healthy_one_at_zero_fault_is_noted(look: Look, plate: fmuid.System) -> None:
    wrong = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, nominal=0.01)}, values={"eb": 0.1})
    found = look(record(np.random.default_rng(13)), faults={"wrong": wrong})
    assert found.mismatched == ("wrong",)
    assert any(note.message.endswith("MISMATCHED") for note in diagnosis_notes(found))


def test_the_colour_of_the_residual_counts(look: Look, plate: fmuid.System) -> None:
    """A slow disturbance and slow inputs: to white noise the one would look like a fault."""
    rng = np.random.default_rng(14)
    experiment = record(None)
    slow = np.convolve(rng.standard_normal(SAMPLES + 24), np.ones(25) / 5, mode="valid") * STD
    frame = experiment.frame.copy()
    frame[["ux", "uy", "vx", "vy"]] = 1.0 + 0.1 * INPUTS
    frame["x"] = TRUTH["g"] * frame["ux"] + TRUTH["h"] * frame["vx"] + slow
    frame["y"] = TRUTH["g"] * frame["uy"] + TRUTH["h"] * frame["vy"] + STD * rng.standard_normal(SAMPLES)
    fault = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, nominal=0.01)})
    found = look(fmuid.Experiment(frame, experiment.inputs, experiment.outputs), faults={"one": fault})
    assert found.kind == "healthy"
    white = 2.0 * STD / math.sqrt(np.sum((0.1 * INPUTS[:, 0] + 1.0) ** 2))
    assert found["one.ea"].std > white  # a mean over 25 samples; 5 for the sum of the residual, less for what wiggles


def test_a_file_keeps_the_diagnosis(look: Look, tmp_path: Path) -> None:
    found = look(record(np.random.default_rng(15), size=0.08, angle=1.0))
    read = fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json"))
    assert as_json(read) == as_json(found)
    assert [each.text for each in diagnosis_notes(read)] == [each.text for each in diagnosis_notes(found)]
    assert read.evidence == found.evidence
    assert read.table.equals(found.table)
    with pytest.raises(fmuid.InputError, match=r"has no cause 'rotor.angle'; it has stator.ea, "):
        read["rotor.angle"]
    (tmp_path / "other.json").write_text("{}", encoding="utf-8")
    with pytest.raises(fmuid.InputError, match=r"other\.json is of no schema"):
        fmuid.Diagnosis.from_json(tmp_path / "other.json")
    for key in ("evidence", "unexplained", "nominal"):
        old = {**json.loads((tmp_path / "diagnosis.json").read_text()), key: ["of old"]}
        (tmp_path / "other.json").write_text(json.dumps(old), encoding="utf-8")
        with pytest.raises(fmuid.InputError, match=rf"{key}: the value should be .*; run fmuid diagnose again$"):
            fmuid.Diagnosis.from_json(tmp_path / "other.json")


# --- bad input --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"parameters": {}}, "the fault has no parameters"),
        ({"parameters": {"ea": 0.0}}, "'ea' must be a Parameter"),
        ({"parameters": {"ea": fmuid.Parameter(1.0, min=0.5)}}, "exclude 0"),
        ({"parameters": {"ea": fmuid.Parameter(1.0, prior=fmuid.Normal(0, 1))}}, "has a prior"),
        ({"parameters": {"ea": fmuid.Parameter(1.0)}, "angles": ["eb"]}, "did you mean 'ea'"),
        ({"parameters": {"a": fmuid.Parameter(1.0)}, "angles": ["a"]}, "may belong to no size"),
        (
            {"parameters": {"ea": fmuid.Parameter(1.0, per_experiment=True)}},
            "'ea' is one per experiment: diagnose each experiment by itself",
        ),
        (
            {
                "parameters": {name: fmuid.Parameter(0.0, nominal=1.0) for name in ("s", "a", "b")},
                "angles": {"a": fmuid.diagnosis.FaultAngle("s"), "b": fmuid.diagnosis.FaultAngle("s")},
            },
            "the size 's' has two angles: one locates it",
        ),
    ],
)
def test_what_is_no_fault_is_refused(words: dict[str, Any], said: str) -> None:
    with pytest.raises(fmuid.InputError, match=said):
        fmuid.Fault("model.fmu", **words)


def test_a_fault_parameter_needs_a_nominal() -> None:
    with pytest.raises(fmuid.InputError, match="give nominal"):
        fmuid.Parameter(0.0)


def test_what_does_not_fit_together_is_refused(look: Look, plate: fmuid.System) -> None:
    experiment = record(np.random.default_rng(16))
    parameter = fmuid.Parameter(0.0, nominal=0.01)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"faults": {}}, "there is no fault to look for"),
        ({"std_factor": {"gg": 2.0}}, "std_factor names 'gg'.*did you mean 'g'"),
        ({"std_factor": 0.0}, "inflate must be greater than 0"),
        ({"noise_variance": {"x": 0.01}}, "none of 'y'"),
        ({"level": 1.0}, "the level of a test"),
        ({"values": {"g": 1.0, "h": 1.0}}, "knows nothing of this machine"),
        ({"parameters": {"g": fmuid.Parameter(1.0, prior=fmuid.Normal(1, 1))}}, "keep one of the two"),
        ({"parameters": {"g": fmuid.Parameter(5.0, min=4.0)}}, "'g' of the healthy result: start"),
        ({"faults": {"f": fmuid.Fault(plate, {"e": parameter})}}, "'e'"),
        ({"faults": {"f": fmuid.Fault(plate, {"g": parameter})}}, "fault 'f': the parameter 'g' is the fault's and"),
        ({"faults": {"f": fmuid.Fault(plate, {"ea": parameter}, {"q": "r"})}}, "fault 'f': variable_map has 'q'"),
    ]
    for words, said in cases:
        with pytest.raises(fmuid.InputError, match=said):
            look(experiment, **words)
    with pytest.raises(fmuid.InputError, match=r"nowhere\.json cannot be read"):
        fmuid.diagnose(experiment, "nowhere.json", {"f": fmuid.Fault(plate, {"ea": parameter})}, plate)
    with pytest.raises(fmuid.InputError, match=r"sensitivity: unknown value 'forwards'.*'forward'"):
        fmuid.diagnosis.DiagnosisSettings(sensitivity="forwards")


def test_the_common_mode_leaves_out_what_belongs_to_single_records(plate: fmuid.System) -> None:
    experiment = record(np.random.default_rng(17))
    parameters = {"g": fmuid.Parameter(1.5), "h": fmuid.Parameter(1.5, per_experiment=True)}
    result = fmuid.identify(fmuid.Problem(plate, experiment, parameters))
    assert list(common_mode(result)) == ["g"]
    own = common_mode(result, parameters={"h": fmuid.Parameter(2.0)})
    assert own["h"].prior is None and own["g"].prior is not None
