"""Diagnosis by fault models: size, place, significance and level on a machine that least squares solve exactly."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import optimize, stats

import fmuid
from fmuid.diagnosis.faults import common_mode
from fmuid.reports.topics.diagnosis_phrases import hypothesis_notes, strain_words, verdict
from tests.support.diagnosis_studies import Look
from tests.support.plate import (
    COLUMNS,
    INPUTS,
    PHASES,
    SAMPLES,
    STD,
    TRUTH,
    Faults,
    identified,
    record,
)


def least_squares(healthy: fmuid.Result, experiment: fmuid.Experiment, inflate: float, which: list[int]) -> np.ndarray:
    """Return J_C and the estimates of the columns named, those of the phases (2 to 4) not being negative."""
    target = experiment.output_values.ravel()
    rows, wanted = [COLUMNS[:, which] / STD], [target / STD]
    for i, name in enumerate(TRUTH):
        std = inflate * healthy.normal(name).std
        rows.append(np.eye(len(which))[[i]] / std)
        wanted.append(np.array([healthy[name] / std]))
    matrix, right = np.vstack(rows), np.concatenate(wanted)
    lower = [0.0 if 2 <= i <= 4 else -np.inf for i in which]
    found = optimize.lsq_linear(matrix, right, (lower, np.inf), method="bvls")
    return np.array([2.0 * found.cost, *found.x])


def test_estimates_and_statistics_are_those_of_least_squares(look: Look, healthy: fmuid.Result) -> None:
    experiment = record(np.random.default_rng(3), eb=0.05)
    found = look(experiment)
    nothing = least_squares(healthy, experiment, 5.0, [0, 1])
    stator = least_squares(healthy, experiment, 5.0, [0, 1, 2, 3, 4])
    rotor = least_squares(healthy, experiment, 5.0, [0, 1, 5, 6])
    falls = {each.name: each.statistic * each.colour**2 for each in found.hypotheses}
    assert falls["stator"] == pytest.approx(nothing[0] - stator[0], rel=1e-4)
    assert [size.value for size in found["stator"].sizes] == pytest.approx(stator[3:], abs=1e-5)
    assert falls["rotor"] == pytest.approx(nothing[0] - rotor[0], rel=1e-4)
    assert found["rotor"]["size"].value == pytest.approx(math.hypot(*rotor[3:]), rel=1e-3)
    half, freedom = 0.5 * found["rotor"].statistic, found["rotor"].reference.freedom
    assert found["rotor"].probability == pytest.approx(stats.f.sf(half, 2, freedom), rel=1e-3)
    assert all(0.8 < each.colour < 1.5 for each in found.hypotheses if each.name != "wrong")
    assert (found.kind, found.named) == ("fault", ("stator",))
    assert found["stator"].significant(0.01)[0].name == "eb"
    assert "stator, eb = 0.0" in verdict(found)


@pytest.mark.parametrize("angle", [0.1, 1.6, 2.9])
def test_a_turned_fault_is_located(look: Look, angle: float) -> None:
    found = look(record(np.random.default_rng(4), size=0.08, angle=angle))
    size = found["rotor"]["size"]
    assert found.named == ("rotor",)
    assert abs(size.value - 0.08) < 3 * size.std
    off = (size.angle_value - angle + math.pi / 2) % math.pi - math.pi / 2
    assert abs(off) < 3 * size.angle_std
    assert size.angle_std == pytest.approx(size.std / (2 * size.value), rel=0.2)
    assert "at angle = " in verdict(found)


def test_no_angle_is_told_of_a_fault_that_is_not_there(look: Look) -> None:
    found = look(record(np.random.default_rng(5)))
    assert found.kind == "healthy"
    assert "angle" not in verdict(found)
    rotor = found.table[found.table["fault"] == "rotor"]
    assert rotor["angle_value"].isna().all()
    assert found.to_json_dict()["faults"]["rotor"]["sizes"]["size"]["angle_value"] is None


def test_the_common_mode_takes_what_was_foreseen(look: Look, faults: Faults) -> None:
    warm = record(np.random.default_rng(6), g=1.06)
    found = look(warm, inflate={"g": 20.0})
    assert found.kind == "healthy"
    assert abs(found.nominal["g"][0] - 1.06) < 4 * found.nominal["g"][1]
    surprised = look(warm, inflate=1.0, faults={"rotor": faults["rotor"]})
    assert not surprised.called
    assert surprised.strain is not None
    assert surprised.strain.name == "g"
    assert strain_words(surprised.strain)[0].startswith("g lies ")


@pytest.mark.slow
def test_the_false_alarm_level_is_met(plate: fmuid.System, faults: Faults) -> None:
    """Over healthy records and healthy machines: any alarm, of either fault, at a level of 10 %."""
    rng, level, count = np.random.default_rng(7), 0.1, 100
    alarms = 0
    for _ in range(count):
        known = identified(plate, record(rng))
        found = fmuid.diagnose(record(rng), known, faults, plate, fmuid.DiagnosisSettings(level))
        alarms += bool(found.called)
    # Bonferroni over two nearly independent faults: 1 - 0.95² = 9.75 %
    assert alarms / count == pytest.approx(0.0975, abs=3 * math.sqrt(0.1 * 0.9 / count))


def test_faults_that_act_alike_are_not_told_apart(look: Look, plate: fmuid.System) -> None:
    ratio = fmuid.Parameter(0.0, min=0.0, nominal=0.01)
    alike = {"one": fmuid.Fault(plate, {"ea": ratio}), "other": fmuid.Fault(plate, {"ea": ratio})}
    found = look(record(np.random.default_rng(8), ea=0.06), faults=alike)
    assert found.kind == "ambiguous"
    assert set(found.named) == {"one", "other"}
    assert "cannot tell one and other apart" in verdict(found)


def test_something_else_is_said_to_be_something_else(look: Look) -> None:
    experiment = record(np.random.default_rng(9))
    frame = experiment.frame.assign(x=experiment.frame["x"] + 0.2 * np.sin(np.arange(SAMPLES)))
    found = look(fmuid.Experiment(frame, experiment.inputs, experiment.outputs))
    assert found.kind == "unexplained"
    assert verdict(found).startswith("Something else is wrong")
    assert found.unexplained.ratio > 2


def test_without_any_prior_a_fault_like_the_common_mode_stays_open(look: Look, plate: fmuid.System) -> None:
    """The three phases together are a gain."""
    phases = fmuid.Fault(plate, dict.fromkeys(PHASES, fmuid.Parameter(0.0, nominal=0.01)))
    experiment = record(np.random.default_rng(10), ea=0.02, eb=0.02, ec=0.02)
    found = look(experiment, faults={"phases": phases}, inflate=math.inf)
    assert found.kind == "undecided"
    assert "cannot be told apart" in verdict(found)
    held = look(experiment, faults={"phases": phases}, inflate=1.0)
    assert held["phases"].determined
    assert any(
        note.startswith("without the healthy record, ") and "cannot be told apart" in note
        for note in hypothesis_notes(held["phases"])
    )


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
    one, other = found["beside"]["fault.ea"], found["inside"]["ea"]
    assert one.value == pytest.approx(other.value, abs=1e-5)
    assert found["beside"].statistic == pytest.approx(found["inside"].statistic, rel=1e-5)
    assert found["beside"].healthy_at_zero
    assert not hypothesis_notes(found["beside"])


def test_a_model_that_is_not_the_healthy_one_at_zero_fault_is_noted(look: Look, plate: fmuid.System) -> None:
    wrong = fmuid.Fault(plate, {"ea": fmuid.Parameter(0.0, nominal=0.01)}, values={"eb": 0.1})
    found = look(record(np.random.default_rng(13)), faults={"wrong": wrong})
    assert not found["wrong"].healthy_at_zero
    assert any(
        "without its fault this model is not the healthy machine" in note for note in hypothesis_notes(found["wrong"])
    )


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
    found = look(fmuid.Experiment(frame, experiment.inputs, experiment.outputs), faults={"one": fault})["one"]
    assert found.result is not None
    assert found.colour > 2.0  # a mean over 25 samples; 5 for the sum of the residual, less for what wiggles
    assert found["ea"].std == found.result.std[-1]
    assert found.colour == pytest.approx(found.result.widening[-1])
    assert any("D is divided by" in note for note in hypothesis_notes(found))


def test_a_file_keeps_the_diagnosis(look: Look, tmp_path: Path) -> None:
    found = look(record(np.random.default_rng(15), size=0.08, angle=1.0))
    read = fmuid.Diagnosis.from_json(found.to_json(tmp_path / "diagnosis.json"))
    assert read.to_json_dict() == found.to_json_dict()
    assert verdict(read) == verdict(found)
    assert read["rotor"].reference == found["rotor"].reference
    with pytest.raises(fmuid.InputError, match=r"fault 'rotor' has no size 'angle'; it has \w+"):
        read["rotor"]["angle"]
    (tmp_path / "other.json").write_text("{}", encoding="utf-8")
    with pytest.raises(fmuid.InputError, match=r"other\.json does not say which fmuid .*give the diagnosis\.json of a"):
        fmuid.Diagnosis.from_json(tmp_path / "other.json")
    for key in ("faults", "unexplained", "nominal"):
        old = {**found.to_json_dict(), key: ["of old"]}
        (tmp_path / "other.json").write_text(json.dumps(old), encoding="utf-8")
        with pytest.raises(fmuid.InputError, match=rf"has something in '{key}' that .*: run fmuid diagnose again$"):
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
                "angles": {"a": fmuid.FaultAngle("s"), "b": fmuid.FaultAngle("s")},
            },
            "the size 's' has two angles: one locates it",
        ),
    ],
)
def test_what_is_no_fault_is_refused(words: dict[str, Any], said: str) -> None:
    with pytest.raises(fmuid.InputError, match=said):
        fmuid.Fault("model.fmu", **words)


def test_a_located_fault_is_searched_off_zero_and_within_its_bounds() -> None:
    turned = {"a": fmuid.Parameter(0.0, nominal=1.0)}
    sizes = {
        0.1: fmuid.Parameter(0.0, min=0.0, nominal=0.1),
        0.02: fmuid.Parameter(0.0, min=0.0, max=0.04, nominal=0.1),
        -0.1: fmuid.Parameter(0.0, max=0.0, nominal=0.1),
        0.03: fmuid.Parameter(0.03),
    }
    for expected, size in sizes.items():
        starts = fmuid.Fault("model.fmu", {"s": size} | turned, angles=["a"]).starts()
        assert {start["s"] for start in starts} == {expected}
        assert [start["a"] for start in starts] == pytest.approx([0.0, math.pi / 2, math.pi, 3 * math.pi / 2])


def test_a_fault_parameter_needs_a_nominal() -> None:
    with pytest.raises(fmuid.InputError, match="give nominal"):
        fmuid.Parameter(0.0)


def test_what_does_not_fit_together_is_refused(look: Look, plate: fmuid.System) -> None:
    experiment = record(np.random.default_rng(16))
    parameter = fmuid.Parameter(0.0, nominal=0.01)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"faults": {}}, "there is no fault to look for"),
        ({"inflate": {"gg": 2.0}}, "inflate names 'gg'.*did you mean 'g'"),
        ({"inflate": 0.0}, "inflate must be greater than 0"),
        ({"noise_variance": {"x": 0.01}}, "none of 'y'"),
        ({"level": 1.0}, "the level of a test"),
        ({"values": {"g": 1.0, "h": 1.0}}, "knows nothing of this machine"),
        ({"parameters": {"g": fmuid.Parameter(1.0, prior=fmuid.Normal(1, 1))}}, "keep one of the two"),
        ({"parameters": {"g": fmuid.Parameter(5.0, min=4.0)}}, "'g' of the healthy result: start"),
        ({"faults": {"f": fmuid.Fault(plate, {"e": parameter})}}, "fault 'f': .*'e'"),
        ({"faults": {"f": fmuid.Fault(plate, {"g": parameter})}}, "fault 'f': the parameter 'g' is the fault's and"),
        ({"faults": {"f": fmuid.Fault(plate, {"ea": parameter}, {"q": "r"})}}, "fault 'f': names has 'q'"),
    ]
    for words, said in cases:
        with pytest.raises(fmuid.InputError, match=said):
            look(experiment, **words)
    with pytest.raises(fmuid.InputError, match=r"nowhere\.json cannot be read"):
        fmuid.diagnose(experiment, "nowhere.json", {"f": fmuid.Fault(plate, {"ea": parameter})}, plate)
    with pytest.raises(fmuid.InputError, match=r"sensitivity 'forwards' is not known.*'forward'"):
        fmuid.DiagnosisSettings(sensitivity="forwards")


def test_the_common_mode_leaves_out_what_belongs_to_single_records(plate: fmuid.System) -> None:
    experiment = record(np.random.default_rng(17))
    parameters = {"g": fmuid.Parameter(1.5), "h": fmuid.Parameter(1.5, per_experiment=True)}
    result = fmuid.identify(fmuid.Problem(plate, experiment, parameters))
    assert list(common_mode(result)) == ["g"]
    own = common_mode(result, parameters={"h": fmuid.Parameter(2.0)})
    assert own["h"].prior is None and own["g"].prior is not None
