"""Shipped models against their equations, integrated by scipy, and what their FMUs answer to the calls of FMI.

`Reference` has plain formulas of docs/method/induction-machine.md and of the models' README files. The
FMUs run through FMPy's low-level calls (its `simulate_fmu` does not apply inputs inside an integrator).
"""

from collections.abc import Callable
from typing import Any

import fmpy.fmi1
import fmpy.fmi2
import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

from fmuid.data.signals import park_transform
from tests.support.shipped_instances import Instance, Opener, points, relative_error
from tests.support.shipped_models import FLUXES, MACHINE, PHASES, REFERENCES, TOLERANCE, models, park_machine


@pytest.mark.parametrize("linear", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["linear", "held"])
@models
def test_co_simulation_follows_the_equations(opened: Opener, model: str, linear: bool) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals()
    instance = opened(model)
    instance.initialize(reference.parameters)
    found = instance.follow(reference, times, inputs, linear)
    expected = reference.integrate(times, inputs, linear)
    assert relative_error(found, expected) < TOLERANCE
    assert np.all(np.ptp(found, axis=0) > 0)


def test_induction_machine_at_constant_speed_against_its_matrix_exponential(opened: Opener) -> None:
    """One substep a sample of 0.7 ms, the method's own, over 3 s."""
    p, w, h, count = REFERENCES["InductionMachine"].parameters, 157.0, 7e-4, 4300
    u = np.array([200.0, -100.0, w])
    A = np.array([park_machine(x, [0, 0, w], p) for x in np.eye(4)]).T
    steady = np.linalg.solve(A, -park_machine(np.zeros(4), u, p))
    x, step = np.array([p[f"{name}_start"] for name in ("ids", "iqs", "phidr", "phiqr")]), expm(A * h)
    rows = [x]
    for _ in range(count - 1):
        x = steady + step @ (x - steady)
        rows.append(x)
    instance = opened("InductionMachine")
    instance.initialize(p)
    found = instance.follow(REFERENCES["InductionMachine"], h * np.arange(count), np.tile(u, (count, 1)), linear=False)
    assert relative_error(found, np.array(rows)) < TOLERANCE


def test_controller_is_limited(opened: Opener) -> None:
    instance = opened("PositionController")
    instance.initialize()
    for reference_position, expected in ((0.0, 0.0), (1e-4, 160.18 * 243.45 * 1e-4), (1.0, 10.0), (-1.0, -10.0)):
        instance.set({"qg": reference_position})
        assert instance.get("v") == pytest.approx([expected], rel=1e-14)


@pytest.mark.parametrize(
    ("model", "free", "limits"),
    [
        ("SpeedController", {}, {"torque_max": 0.2}),
        ("CurrentController", {}, {"u_max": 10.0}),
        ("CurrentController", {"flux_reference": 6.0}, {"i_max": 1.0}),  # flux is missing, and less than half is there
    ],
)
def test_limits_of_the_controllers(
    opened: Opener, model: str, free: dict[str, float], limits: dict[str, float]
) -> None:
    """What the limits leave, and how the integral parts follow; each limit makes a difference at every point."""
    reference = REFERENCES[model]
    both = [reference.parameters | free | each for each in ({}, limits)]
    instance = opened(model, model_exchange=True)
    instance.start_model_exchange(both[1])
    for x, u in points(reference):
        x[:2] += np.sign(x[:2])
        instance.set(dict(zip(reference.inputs, u, strict=True)))
        found = np.concatenate([instance.rates(x), instance.get(*reference.outputs)])
        unlimited, expected = (np.concatenate([reference.rates(x, u, p), reference.evaluate(x, u, p)]) for p in both)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)
        assert np.abs(unlimited / expected - 1).max() > 0.01


def test_inputs_move_on_along_their_slopes(opened: Opener) -> None:
    """The value of an input is that at the present time, also after a step; a slope holds until it is changed."""
    instance = opened("PositionController")
    instance.initialize()
    instance.set({"qg": 1e-5})
    instance.ramps(["qg"], np.array([1e-2]))
    for k in (1, 2, 3):
        instance.fmu.doStep((k - 1) * 1e-3, 1e-3)
        assert instance.get("qg", "v") == pytest.approx([1e-5 * (1 + k), 160.18 * 243.45 * 1e-5 * (1 + k)], rel=1e-12)


@models
def test_long_steps_are_divided(opened: Opener, model: str) -> None:
    """Substeps of at most the model's Interval: a step of three is three steps of one."""
    reference = REFERENCES[model]
    interval = float(opened(model).description.defaultExperiment.stepSize)
    results = []
    for parts in (1, 3):
        instance = opened(model)
        instance.initialize(reference.parameters)
        instance.set(dict(zip(reference.inputs, np.array(reference.amplitudes) / 3, strict=True)))
        for k in range(parts):
            instance.fmu.doStep(k * 3 * interval / parts, 3 * interval / parts)
        results.append(instance.get(*reference.outputs))
    np.testing.assert_allclose(results[0], results[1], rtol=1e-12)


@pytest.mark.parametrize(("speed", "step", "tolerance"), [(0.0, 7e-4, 1e-8), (157.0, 1e-5, 2e-6)])
def test_three_phase_machine_is_the_park_machine(opened: Opener, speed: float, step: float, tolerance: float) -> None:
    """Seen through the transforms. Between samples, voltages are linear in one of two turning frames only: (wT)²/8."""
    count = 1000
    t = step * np.arange(count)
    frame = pd.DataFrame({"time": t, "w": np.full(count, speed), "theta": 0.7 + speed * t})
    for phase, name in enumerate(("ua", "ub", "uc")):
        frame[name] = 310 * np.cos(314 * t - phase * 2 * np.pi / 3) + 20  # the 20 V: a zero sequence
    three = REFERENCES["ThreePhaseInductionMachine"]
    machine = opened("ThreePhaseInductionMachine")
    machine.initialize(MACHINE | FLUXES | PHASES)
    phases = machine.follow(three, t, frame[list(three.inputs)].to_numpy(), linear=True)
    frame[list(three.outputs)] = phases
    np.testing.assert_allclose(frame["theta"], 0.7 + speed * t, rtol=1e-12)
    frame = park_transform(frame, ["ua", "ub", "uc"], ["uds", "uqs"])
    frame = park_transform(frame, ["ia", "ib", "ic"], ["ids", "iqs"])
    two = REFERENCES["InductionMachine"]
    machine = opened("InductionMachine")
    starts = {f"{name}_start": float(frame[name].iloc[0]) for name in ("ids", "iqs")}
    machine.initialize(MACHINE | FLUXES | starts)
    found = machine.follow(two, t, frame[list(two.inputs)].to_numpy(), linear=True)
    assert relative_error(found, frame[list(two.outputs)].to_numpy()) < tolerance


def test_zero_sequence_current_sees_resistance_and_leakage_only(opened: Opener) -> None:
    """Lf di0/dt = u0 - Rs i0, whatever the rotor does."""
    reference = REFERENCES["ThreePhaseInductionMachine"]
    t = 7e-4 * np.arange(100)
    inputs = np.tile([50.0, 50.0, 50.0, 150.0], (100, 1))
    machine = opened("ThreePhaseInductionMachine")
    machine.initialize(reference.parameters)
    found = machine.follow(reference, t, inputs, linear=False)[:, :3].mean(1)
    final, start = 50 / MACHINE["Rs"], (1.1 + 0.3 - 0.8) / 3
    expected = final + (start - final) * np.exp(-MACHINE["Rs"] / MACHINE["Lf"] * t)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@models
def test_parameters_give_the_start_values(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    instance = opened(model)
    instance.fmu.setupExperiment()
    instance.set(reference.parameters)
    expected = [reference.parameters[f"{name}_start"] for name in reference.states]
    assert instance.get(*reference.states) == expected
    instance.fmu.enterInitializationMode()
    instance.set({f"{name}_start": k + 0.5 for k, name in enumerate(reference.states)})
    assert instance.get(*reference.states) == [k + 0.5 for k in range(len(expected))]
    instance.set(reference.parameters)
    instance.fmu.exitInitializationMode()
    assert instance.get(*reference.states) == expected
    instance.set({f"{name}_start": 9.0 for name in reference.states})  # too late to act
    assert instance.get(*reference.states) == expected


@models
def test_tuning_a_parameter_between_steps(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals(10)
    tuned, fresh = opened(model), opened(model)
    tuned.initialize()
    tuned.follow(reference, times, inputs, True)
    tuned.set(reference.parameters)
    fresh.initialize(reference.parameters | {f"{n}_start": float(tuned.get(n)[0]) for n in reference.states})
    assert np.array_equal(tuned.follow(reference, times, inputs, True), fresh.follow(reference, times, inputs, True))


@models
def test_reset_and_other_instances_change_no_bit(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals(40)
    instance, other = opened(model), opened(model)
    other.initialize()
    runs = []
    for values in ({}, reference.parameters, {}, reference.parameters):
        instance.initialize(values)
        other.follow(reference, times[:5], -inputs, True)
        runs.append(instance.follow(reference, times, inputs, True))
        instance.fmu.reset()
    assert np.array_equal(runs[0], runs[2])
    assert np.array_equal(runs[1], runs[3])
    assert not np.array_equal(runs[0], runs[1])


@models
def test_state_is_saved_restored_and_serialised(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    times, inputs = reference.signals(40)
    instance, second = opened(model), opened(model)
    instance.initialize(reference.parameters)
    second.initialize()
    instance.follow(reference, times[:20], inputs[:20], True)
    state = instance.fmu.getFMUstate()
    data = instance.fmu.serializeFMUstate(state)
    expected = instance.follow(reference, times[20:], inputs[20:], True)
    instance.fmu.setFMUstate(state)
    assert np.array_equal(instance.follow(reference, times[20:], inputs[20:], True), expected)
    copy = second.fmu.deSerializeFMUstate(data)
    second.fmu.setFMUstate(copy)
    assert np.array_equal(second.follow(reference, times[20:], inputs[20:], True), expected)
    assert second.fmu.serializeFMUstate(copy) == data
    for owner, each in ((instance, state), (second, copy)):
        owner.fmu.freeFMUstate(each)


def test_state_of_another_model_is_refused(opened: Opener) -> None:
    coil_, drive_ = opened("Coil"), opened("PositionDrive")
    data = coil_.fmu.serializeFMUstate(coil_.fmu.getFMUstate())
    with pytest.raises(fmpy.fmi1.FMICallException):
        drive_.fmu.deSerializeFMUstate(data)
    assert "not a state of this FMU" in drive_.messages[0]


@models
def test_derivatives_are_the_equations(opened: Opener, model: str) -> None:
    reference = REFERENCES[model]
    instance = opened(model, model_exchange=True)
    instance.start_model_exchange(reference.parameters)
    for x, u in points(reference):
        instance.set(dict(zip(reference.inputs, u, strict=True)))
        expected = reference.rates(x, u, reference.parameters)
        np.testing.assert_allclose(instance.rates(x), expected, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(
            instance.get(*reference.outputs), reference.evaluate(x, u, reference.parameters), rtol=1e-13
        )


@models
def test_directional_derivatives(opened: Opener, model: str) -> None:
    """Exact: against the complex-step derivatives of the reference."""
    reference = REFERENCES[model]
    instance = opened(model, model_exchange=True)
    instance.start_model_exchange(reference.parameters)
    unknowns = [*(f"der({name})" for name in reference.states), *reference.outputs]
    counts = ("bars", "p") if "bars" in reference.parameters else ()
    active = [name for name in reference.parameters if not name.endswith("_start") and name not in counts]
    for x, u in points(reference):
        instance.set(dict(zip(reference.inputs, u, strict=True)))
        instance.rates(x)
        columns = {name: ("x", k) for k, name in enumerate(reference.states)}
        columns |= {name: ("u", k) for k, name in enumerate(reference.inputs)}
        columns |= {name: ("p", k) for k, name in enumerate(active)}
        for name, (kind, k) in columns.items():
            point = {"x": x.astype(complex), "u": u.astype(complex), "p": dict(reference.parameters)}
            if kind == "p":
                point["p"][name] += 1e-30j  # type: ignore[index]
            else:
                point[kind][k] += 1e-30j  # type: ignore[index]
            arguments = (point["x"], point["u"], point["p"])
            both = np.concatenate([reference.rates(*arguments), reference.evaluate(*arguments)])
            expected = both.imag / 1e-30
            scale = 1e-12 * max(1.0, np.abs(expected).max())
            np.testing.assert_allclose(instance.slopes(unknowns, name), expected, rtol=1e-9, atol=scale)


def test_directional_derivatives_in_initialization_mode(opened: Opener) -> None:
    """There the states are functions of the start parameters."""
    instance = opened("Coil")
    instance.fmu.setupExperiment()
    instance.fmu.enterInitializationMode()
    instance.set({"R": 3.0, "L": 0.5})
    assert instance.slopes(["i", "der(i)"], "i_start") == [1.0, -6.0]
    assert instance.slopes(["i", "der(i)"], "u") == [0.0, 2.0]


def refused(instance: Instance, call: Callable[[], Any]) -> str:
    with pytest.raises(fmpy.fmi1.FMICallException):
        call()
    assert len(instance.messages) == 1
    with pytest.raises(fmpy.fmi1.FMICallException):  # after an error only reset (or a saved state) helps
        instance.get("i")
    assert "after an error (reset the instance or restore a state)" in instance.messages[1]
    instance.fmu.reset()
    instance.initialize()
    assert instance.get("i") == [0.0]
    return instance.messages[0]


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda c: c.set({"R": float("nan")}), "fmi2SetReal: the value given for R at t = 0 is not finite"),
        (lambda c: c.set({"u": float("inf")}), "the value given for u at t = 0 is not finite"),
        (lambda c: c.set({"i": 1.0}), "i is computed by the model: only inputs and parameters can be set"),
        (lambda c: c.fmu.setReal([99], [1.0]), "there is no variable of value reference 99"),
        (lambda c: c.fmu.getReal([99]), "there is no variable of value reference 99"),
        (lambda c: c.fmu.getInteger([0]), "fmi2GetInteger: all variables of the model are Real"),
        (lambda c: c.fmu.setString([0], ["a"]), "fmi2SetString: all variables of the model are Real"),
        (lambda c: c.ramps(["R"], np.array([1.0])), "is no input"),
        (lambda c: c.ramps(["u"], np.array([1.0]), order=2), "order 2 of u: only order 1 is supported"),
        (lambda c: c.ramps(["u"], np.array([np.nan])), "the value given for u at t = 0 is not finite"),
        (lambda c: c.fmu.doStep(0.0, -1e-3), "fmi2DoStep: from t = 0 by -0.001 is no step"),
        (lambda c: c.fmu.enterInitializationMode(), "fmi2EnterInitializationMode cannot be called between steps"),
        (lambda c: c.fmu.getDirectionalDerivative([0], [5], [1.0]), "value reference 5 is no state, input or param"),
        (lambda c: (c.set({"L": 0.0}), c.get("der(i)")), "der(i) is not finite at t = 0: parameters, inputs or"),
        (
            lambda c: (c.set({"L": 1e-9, "u": 1.0}), [c.fmu.doStep(k * 1e-3, 1e-3) for k in range(60)]),
            "state i is not finite at t = 0.0",
        ),
    ],
)
def test_refusals(opened: Opener, call: Callable[[Instance], Any], text: str) -> None:
    instance = opened("Coil")
    instance.initialize()
    assert text in refused(instance, lambda: call(instance))


def test_refusals_before_and_after(opened: Opener) -> None:
    instance = opened("Coil")
    assert "fmi2DoStep cannot be called before initialization mode" in refused(
        instance, lambda: instance.fmu.doStep(0.0, 1e-3)
    )
    instance.fmu.terminate()
    instance.messages.clear()
    assert "fmi2SetReal cannot be called after termination" in refused(instance, lambda: instance.set({"u": 1.0}))


def test_parameters_are_fixed_in_continuous_time_mode(opened: Opener) -> None:
    instance = opened("Coil", model_exchange=True)
    instance.start_model_exchange({})
    instance.fmu.enterEventMode()
    instance.set({"R": 2.0})
    instance.fmu.enterContinuousTimeMode()
    with pytest.raises(fmpy.fmi1.FMICallException):
        instance.set({"R": 3.0})
    assert "parameter R cannot be set in continuous-time mode" in instance.messages[0]


def test_wrong_guid_is_refused(opened: Opener) -> None:
    instance = opened("Coil")
    instance.fmu.guid = "{another}"
    component = instance.fmu.component
    with pytest.raises(Exception, match="Failed to instantiate"):
        instance.fmu.instantiate(callbacks=instance.callbacks)
    assert "modelDescription.xml and binary are not of the same export" in instance.messages[0]
    instance.fmu.component = component
