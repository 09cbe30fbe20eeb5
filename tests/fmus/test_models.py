"""The exported machine models against their equations, written here anew and integrated by scipy.

`Reference` has plain formulas of docs/method/induction-machine.md and of the models' README files. The
FMUs run through FMPy's low-level calls (its `simulate_fmu` does not apply inputs inside an integrator).
"""

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

from fmuid.data.signals import park_transform
from tests.support.shipped_instances import Opener, points, relative_error
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
