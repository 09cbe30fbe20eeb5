"""floor, ceil and mod in exported models: whole numbers that only events change."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.integrate
from fmpy.validation import validate_fmu

from fmuid.errors import ModelicaError
from fmuid.export import export_fmu
from tests.support.exported import Running, both_versions, export_text, running
from tests.support.modelica import model

solve_ivp: Any = scipy.integrate.solve_ivp  # its types do not allow for what events take
ACCURATE = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}


@both_versions
def test_values_at_and_between_whole_numbers(tmp_path: Path, fmi: str) -> None:
    text = """model Values input Real u, w; parameter Real a = 2; output Real y1, y2, y3, y4, y5;
equation y1 = floor(u); y2 = ceil(u); y3 = mod(u, w); y4 = mod(floor(a), 3)*u; y5 = noEvent(floor(u) + mod(u, a));
end Values;
"""
    fmu = export_text(tmp_path, text, fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    rng = np.random.default_rng(3)
    values = [0.0, 1.0, -1.0, 3.0, -3.5, 0.3, 2.0**-40, -(2.0**-40), 1e6, -1e6 - 0.5, 1e17, math.nextafter(3.0, 0.0)]
    with running(fmu) as test:
        test.initialise({"w": 1.0, "a": 5.5})
        for u in [*values, *rng.uniform(-50, 50, 50)]:  # from each to the next, however far it is
            for w in (1.0, -2.5, 0.75):
                test.set({"u": u, "w": w})
                expected = [math.floor(u), math.ceil(u), u - w * math.floor(u / w), 2.0 * u, math.floor(u) + u % 5.5]
                assert test.get("y1", "y2", "y3", "y4", "y5") == pytest.approx(expected, rel=1e-15, abs=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("equation", "expected"),
    [
        ("y = floor(10*u);", 4.5),
        ("y = ceil(10*u);", 5.5),
        ("y = mod(u, 0.3);", 0.15 * 0.9 + 0.1 * 0.05),
        ("y = mod(-u, 0.3);", 0.15 * 0.9 + 0.1 * 0.25),
        ("y = floor(-10*u) + floor(10*u);", -1.0),
        ("y = (if floor(4*u) >= 2 then 1 else 0) + floor(3*x);", None),
        ("y = floor(5*u - 10*u*u + a);", None),
        ("y = if mod(u, 0.25) > 0.1 then 1 else 0;", 0.6),
        ("y = floor(2*u + floor(4*u));", (0 + 1 + 3 + 4) / 4),
        ("y = noEvent(floor(10*u))*0 + floor(40*u)/40;", 39 / 80),
    ],
)
def test_jumps_are_located(tmp_path: Path, equation: str, expected: float | None) -> None:
    """With u = t: the integral of y over one second has the times of all jumps; some steps hold more than one."""
    if "3*x" in equation:  # rests until 0.5, then x grows at a rate of 1, from 1/3 on at one of 2
        expected = 1 / 3 + 2 * (0.5 - 1 / 3)
    if "10*u*u" in equation:  # a parabola that rises from 1 to 1.625 and falls to -4
        roots = [(5 + math.sqrt(25 - 40 * (level - 1))) / 20 for level in (1, 0, -1, -2, -3)]
        widths = np.diff([0.0, *roots, 1.0])
        expected = float(widths @ [1, 0, -1, -2, -3, -4])
    with running(export_text(tmp_path, model(equation))) as test:
        for steps in ([1.0], [0.125] * 8, [0.3, 0.5, 0.2]):
            test.initialise()
            test.slope("u", 1.0)
            test.run(*steps)
            assert test.get("x")[0] == pytest.approx(expected, abs=1e-11)
            test.fmu.reset()


def test_bouncing_between_whole_numbers_against_scipy(tmp_path: Path) -> None:
    """An oscillator whose spring is a staircase: floor changes in both directions, many times."""
    text = """model Stairs
  output Real x(start=0.3, fixed=true), v(start=2, fixed=true);
equation
  der(x) = v; der(v) = -floor(2*x) - 0.5 + 0.3*sin(time);
  annotation(experiment(StopTime=10, Interval=0.02));
end Stairs;
"""

    def rates(t: float, z: np.ndarray, step: int) -> list[float]:
        return [z[1], -step - 0.5 + 0.3 * np.sin(t)]

    def upper(_: float, z: np.ndarray, step: int) -> float:
        return float(2 * z[0] - step - 1)

    def lower(_: float, z: np.ndarray, step: int) -> float:
        return float(2 * z[0] - step)

    upper.terminal = lower.terminal = True  # type: ignore[attr-defined]
    upper.direction, lower.direction = 1.0, -1.0  # type: ignore[attr-defined]
    t, z, step, events = 0.0, np.array([0.3, 2.0]), 0, 0
    while t < 10:
        done = solve_ivp(rates, (t, 10), z, args=(step,), events=[upper, lower], max_step=0.05, **ACCURATE)
        t, z = done.t[-1], done.y[:, -1]
        if done.status == 1:
            events += 1
            step += 1 if len(done.t_events[0]) else -1
    assert events == 22
    with running(export_text(tmp_path, text)) as stairs:
        stairs.initialise()
        stairs.run(*[0.25] * 40)
        np.testing.assert_allclose(stairs.get("x", "v"), z, atol=1e-9)


@both_versions
def test_whole_numbers_are_held_in_continuous_time_mode(tmp_path: Path, fmi: str) -> None:
    fmu = export_text(tmp_path, model("y = floor(x) - 10*mod(u, 2);"), fmi=fmi)
    with running(fmu, model_exchange=True) as test:
        test.initialise()
        test.update()
        test.at(0.0, 0.75)
        assert test.indicators() == [0.25, -0.75, 1.0, 0.0]
        test.at(0.1, 2.25)  # beyond the events: the indicator says so, the whole number stays
        test.set({"u": -0.5})
        assert test.indicators() == [-1.25, -2.25, 1.25, 0.25]
        assert test.derivatives() == [5.0]
        test.fmu.enterEventMode()
        assert test.get("y") == [2.0 - 15.0]
        test.update()
        assert test.indicators() == [0.75, -0.25, 0.25, -0.75]
        assert test.derivatives() == [-13.0]
        test.at(0.2, 2.0)  # on the whole number: still above it
        assert test.indicators()[:2] == [1.0, 0.0]
        test.fmu.enterEventMode()
        test.update()
        assert test.derivatives() == [-13.0]


@both_versions
def test_model_exchange_and_co_simulation_agree(tmp_path: Path, fmi: str) -> None:
    """An importer that stops where an indicator changes sign gets what the co-simulation gets."""
    text = model("y = 4 - mod(x, 0.3) - floor(a*x);", interval="0.01")
    fmu = export_text(tmp_path, text, fmi=fmi)
    with running(fmu) as test:
        test.initialise({"a": 2.2})
        test.run(0.8)
        expected = test.get("x")[0]
    with running(fmu, model_exchange=True) as test:
        test.initialise({"a": 2.2})
        test.update()
        t, x, events = 0.0, 0.0, 0
        while t < 0.8:
            events_of = [crossing(test, k) for k in range(4)]
            last = solve_ivp(
                lambda t, z: at(test, t, z).derivatives(), (t, 0.8), [x], events=events_of, max_step=0.01, **ACCURATE
            )
            t, x = last.t[-1], last.y[0, -1]
            if last.status == 1:
                events += 1
                at(test, t, np.array([x + 1e-13]))
                test.fmu.enterEventMode()
                test.update()
        assert events == 8
        assert x == pytest.approx(expected, abs=1e-11)


def at(test: Running, t: float, states: np.ndarray) -> Running:
    test.at(t, *states)
    return test


def crossing(test: Running, k: int) -> Any:
    def indicator(t: float, z: np.ndarray) -> float:
        return at(test, t, z).indicators()[k]

    indicator.terminal, indicator.direction = True, -1.0 if k % 2 == 0 else 1.0  # type: ignore[attr-defined]
    return indicator


def test_directional_derivatives_are_of_the_piece_in_force(tmp_path: Path) -> None:
    with running(export_text(tmp_path, model("y = mod(u, a) + 7*floor(x + a) + 3*ceil(u);"))) as test:
        test.initialise({"a": 0.4, "u": 1.0})
        references = [test.references[name] for name in ("u", "a", "x")]
        unknown = [test.references["y"]]
        found = [test.fmu.getDirectionalDerivative(unknown, [each], [1.0])[0] for each in references]
        assert found == [1.0, -2.0, 0.0]


def test_where_there_are_no_events(tmp_path: Path) -> None:
    text = model("y = noEvent(floor(x)) + noEvent(mod(u, 2)) + ceil(a) + b;", "parameter Real b = mod(-7, 3);")
    with running(export_text(tmp_path, text), model_exchange=True) as test:
        assert test.description.numberOfEventIndicators == 0
        test.initialise({"a": 1.5, "u": 3.5})
        assert test.get("b") == [2.0]
        test.update()
        test.at(0.0, 4.5)
        assert test.get("y") == [4.0 + 1.5 + 2.0 + 2.0]


def test_equal_arguments_share_a_whole_number(tmp_path: Path) -> None:
    fmu = export_text(tmp_path, model("y = mod(u, a) + floor(u/a);"), fmi="3.0")
    with running(fmu) as test:
        found = [v for v in test.description.modelVariables if v.name.startswith("integer")]
        assert [v.name for v in found] == ["integer[1].up", "integer[1].down"]
        assert found[0].description == "event indicator: not positive where mod(u, a) jumps up"
        test.initialise({"u": 5.0, "a": 2.0})
        assert test.get("y") == [3.0]


@both_versions
def test_failures_name_the_function_and_the_time(tmp_path: Path, fmi: str) -> None:
    with running(export_text(tmp_path, model("y = floor(1000*time);"), fmi=fmi)) as test:
        test.initialise()
        text = test.refused(lambda: test.run(1.0))
        assert "jump of floor(1000*time) (line 4) chatters at t = 0.1" in text
        assert text.endswith("or give a shorter Interval")
        test.fmu.reset()
        test.initialise()
        test.run(*[0.05] * 4)
        assert test.get("x")[0] == pytest.approx(sum(range(200)) / 1000, abs=1e-11)
    (tmp_path / "root").mkdir()
    with running(
        export_text(tmp_path / "root", model("y = ceil(sqrt(0.25 - time)*a);", interval="0.2"), fmi="2.0")
    ) as test:
        test.initialise()
        assert "jump of ceil(sqrt(0.25 - time)*a) (line 4) is not finite at t = 0.25" in test.refused(
            lambda: test.run(1.0)
        )


@both_versions
def test_saved_state_has_the_whole_numbers(tmp_path: Path, fmi: str) -> None:
    with running(export_text(tmp_path, model("y = 1 + floor(x);"), fmi=fmi), model_exchange=True) as test:
        get, put = (getattr(test.fmu, f"{what}FMU{'S' if test.fmi3 else 's'}tate") for what in ("get", "set"))
        test.initialise()
        test.update()
        state = get()
        test.at(0.0, 3.5)
        test.fmu.enterEventMode()
        test.update()
        assert test.derivatives() == [4.0]
        put(state)
        test.at(0.0, 3.5)
        assert test.derivatives() == [1.0]
        (test.fmu.freeFMUState if test.fmi3 else test.fmu.freeFMUstate)(state)


@pytest.mark.parametrize(
    ("equation", "text"),
    [
        ("y = u + floor(y);", "equation not linear in its unknown y is outside"),
        ("y = noEvent(mod(y, 2));", "equation not linear in its unknown y is outside"),
        ("y = floor(u, 2);", "floor() with 2 arguments is outside the exported subset: it takes 1"),
        ("y = flor(u);", "(did you mean 'floor'"),
    ],
)
def test_refused(tmp_path: Path, equation: str, text: str) -> None:
    (tmp_path / "Test.mo").write_text(model(equation))
    with pytest.raises(ModelicaError) as caught:
        export_fmu(tmp_path / "Test.mo")
    assert text in str(caught.value)
    assert caught.value.line == 4
