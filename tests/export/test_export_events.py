"""State events and jumps of exported FMUs: against closed forms and scipy, frozen relations, refusals."""

import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmuid.errors import ModelicaError
from fmuid.export import export_fmu
from tests.export.conftest import Exporter
from tests.support.exported import both_versions, running
from tests.support.modelica import FRICTION, friction, integrals, model


@both_versions
@pytest.mark.parametrize("step", [pytest.param(0.0037, marks=pytest.mark.slow), 0.35])
def test_coulomb_friction_against_its_closed_form(exported: Exporter, fmi: str, step: float) -> None:
    """The impulse has the time of the reversal, wherever it falls in the internal steps."""
    with running(exported(FRICTION, fmi=fmi)) as drive:
        for force in (-4.0, -7.3, -31.0):
            drive.initialize({"F": force})
            t = 0.0
            while t < 0.99:
                t = drive.run(step, start=t)
                np.testing.assert_allclose(drive.get("x", "v", "impulse"), friction(t, force), rtol=0, atol=1e-11)
            drive.fmu.reset()


def test_results_are_smooth_functions_of_the_parameters(exported: Exporter) -> None:
    """Central differences across the event give the derivative of the closed form, to their own rounding."""
    with running(exported(FRICTION, fmi="2.0")) as drive:

        def final(m: float, Fc: float) -> np.ndarray:
            drive.initialize({"F": -7.3, "m": m, "Fc": Fc})
            drive.run(*[0.05] * 20)
            found = np.array(drive.get("x", "v"))
            drive.fmu.reset()
            return found

        h = 1e-5
        for direction in ((h, 0.0), (0.0, h)):
            ahead = [np.add((2.0, 3.0), sign * np.array(direction)) for sign in (1, -1)]
            difference = (final(*ahead[0]) - final(*ahead[1])) / (2 * h)
            exact = [np.array(friction(1.0, -7.3, *each)[:2]) for each in ahead]
            np.testing.assert_allclose(difference, (exact[0] - exact[1]) / (2 * h), rtol=1e-9, atol=1e-9)
            assert np.all(np.abs(difference) > 1e-2)


LOCATED = {
    "if u > 0.25 then 1 else 0": 0.75,
    "if 0.25 < u then 1 else 0": 0.75,
    "if u <= 0.25 then 0 else 1": 0.75,
    "if not 0.25 >= u then 1 else 0": 0.75,
    "if u > 0.21 and w > 0.77 then 1 else 0": 0.02,  # both within one internal step
    "if u < 0.33 or (not w > 0.25) then 1 else 0": 0.58,
    "if u < 0.25 then 1 elseif u < 0.5 then 2 elseif u < 0.875 then 3 else 4": 0.25 + 0.5 + 1.125 + 0.5,
    "if u > 0.25 then (if u > 0.75 then 3 else 2) else if w > 0.9 then 1 else 0": 0.1 + 1.0 + 0.75,
    "2*(if time < 0.3 then a else -a) + time": 2 * (0.3 - 0.7) + 0.5,
    "(1 + (if u < 0.25 then y10 else -y10))*2": -2 * 0.25 + 0.75 * 2 / 3,
    "if x11 > 0.2 then 2 else 1": 0.2 + 2 * 0.8,
    "if (if u > 0.25 then w else u) > 0.5 then 1 else 0": 0.25,
    "noEvent(if u > 0.25 then sqrt(u - 0.25) else -sqrt(0.25 - u))": 2 / 3 * (0.75**1.5 - 0.25**1.5),
}
"""Expressions, and their integrals over one second with u = t and w = 1 - t."""


@both_versions
def test_relations_are_frozen_in_continuous_time_mode(exported: Exporter, fmi: str) -> None:
    text = model("y = if x > a and not w >= 2 then 10 else -10*x;")
    with running(exported(text, fmi=fmi), model_exchange=True) as test:
        test.initialize({"a": 0.5})
        test.update()

        def check(indicators: list[float], rate: float) -> None:
            assert test.indicators() == indicators  # x - a; w >= 2 is not 2 - w > 0
            assert test.derivatives() == [rate]

        test.at(0.0, 0.25)
        check([-0.25, 2.0], -2.5)
        test.at(0.1, 0.75)  # beyond the event: the indicator says so, the branch stays
        check([0.25, 2.0], -7.5)
        test.fmu.enterEventMode()
        assert test.get("y") == [10.0]
        test.update()
        check([0.25, 2.0], 10.0)
        test.at(0.2, 0.5)  # not above a any more, in continuous-time mode still so
        check([0.0, 2.0], 10.0)
        test.set({"w": 3.0})
        check([0.0, -1.0], 10.0)
        test.fmu.enterEventMode()
        test.update()
        check([0.0, -1.0], -5.0)


def test_no_event_and_parameters_alone_make_no_events(exported: Exporter) -> None:
    text = model(
        "y = noEvent(if x > 0.5 then 1 else -1) + (if noEvent(x > 0.5) then 10 else 0) + (if a > 0 then 100 else 0);",
        "parameter Real b = if 2 > 1 then 7 else 8; Real q(start=if a > 2 then a else b, fixed=true);",
    )
    with running(exported(text.replace("\nequation", "\nequation der(q) = 0;")), model_exchange=True) as test:
        assert test.description.numberOfEventIndicators == 0
        test.initialize({"a": 3.0})
        assert test.get("q", "b") == [3.0, 7.0]
        test.update()
        for x, y in ((0.5, 99.0), (0.51, 111.0)):
            test.at(0.0, 0.0, x)
            assert test.get("y") == [y]
        test.fmu.enterEventMode()
        test.set({"a": -1.0})
        assert test.get("y") == [11.0]
        test.fmu.reset()
        test.initialize()
        assert test.get("q") == [7.0]


@both_versions
def test_chattering_is_an_error_that_names_the_relation_and_the_time(exported: Exporter, fmi: str) -> None:
    """Friction that holds has no solution in this form: the speed would change its sign without end."""
    with running(exported(FRICTION, fmi=fmi)) as drive:
        drive.initialize({"F": -1.0})  # v = 0 after 0.5 s, then friction holds
        assert "relation v > 0 (line 11) chatters at t = 0.5: " in drive.refused(lambda: drive.run(*[0.1] * 10))
        drive.fmu.reset()
        drive.initialize({"F": -7.3})
        drive.run(0.5)
        np.testing.assert_allclose(drive.get("x", "v", "impulse"), friction(0.5, -7.3), atol=1e-11)


def test_relation_that_is_not_finite(exported: Exporter) -> None:
    with running(exported(model("y = if sqrt(0.25 - u) > 2 then 1 else 0;"))) as test:
        test.initialize()
        test.slope("u", 1.0)
        text = test.refused(lambda: test.run(1.0))
        assert "relation sqrt(0.25 - u) > 2 (line 4) is not finite at t = 0.25" in text


@both_versions
def test_saved_state_has_relations_and_whole_numbers(exported: Exporter, fmi: str) -> None:
    text = model("y = (if x > 0.5 then 1 else 0.25) + z - z; z = floor(4*x);", "output Real z;")
    with running(exported(text, fmi=fmi)) as test:
        test.initialize()
        test.run(1.9)
        with test.saved_state() as restore:
            for _ in range(2):
                assert test.get("x", "y", "z") == pytest.approx([0.475, 0.25, 1.0], abs=1e-12)
                test.run(1.0, start=1.9)
                assert test.get("x", "y", "z") == pytest.approx([0.5 + 0.9, 1.0, 5.0], abs=1e-12)
                restore()


@pytest.mark.parametrize("jump", ["if x > 0 then 1 else 0", "noEvent(if x > 0 then 1 else 0)", "sign(u)", "mod(u, 2)"])
def test_jumps_have_no_sensitivities(tmp_path: Path, jump: str) -> None:
    (tmp_path / "Test.mo").write_text(model(f"y = {jump};"))
    with pytest.raises(ModelicaError, match="sensitivities jump where") as caught:
        export_fmu(tmp_path / "Test.mo", sensitivities=["a"])
    assert caught.value.line == 4


def test_branches_of_parameters_have_sensitivities(exported: Exporter) -> None:
    with running(exported(model("y = if a > 0 then a*u else abs(u);"), sensitivities="all")) as test:
        test.initialize({"u": 3.0})
        assert test.get("sens.a.y") == [3.0]


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_values_at_and_between_whole_numbers(exported: Exporter, fmi: str) -> None:
    text = """model Values input Real u, w; parameter Real a = 2; output Real y1, y2, y3, y4, y5;
equation y1 = floor(u); y2 = ceil(u); y3 = mod(u, w); y4 = mod(floor(a), 3)*u; y5 = noEvent(floor(u) + mod(u, a));
end Values;
"""
    fmu = exported(text, fmi=fmi)
    assert validate_fmu(str(fmu)) == []
    rng = np.random.default_rng(3)
    values = [0.0, 1.0, -1.0, 3.0, -3.5, 0.3, 2.0**-40, -(2.0**-40), 1e6, -1e6 - 0.5, 1e17, math.nextafter(3.0, 0.0)]
    with running(fmu) as test:
        test.initialize({"w": 1.0, "a": 5.5})
        for u in [*values, *rng.uniform(-50, 50, 20)]:  # from each to the next, however far it is
            for w in (1.0, -2.5, 0.75):
                test.set({"u": u, "w": w})
                expected = [math.floor(u), math.ceil(u), u - w * math.floor(u / w), 2.0 * u, math.floor(u) + u % 5.5]
                assert test.get("y1", "y2", "y3", "y4", "y5") == pytest.approx(expected, rel=1e-15, abs=1e-15)


def parabola() -> float:
    """Return the integral of floor(5 t - 10 t² + 1), which rises from 1 to 1.625 and falls to -4."""
    roots = [(5 + math.sqrt(25 - 40 * (level - 1))) / 20 for level in (1, 0, -1, -2, -3)]
    return float(np.diff([0.0, *roots, 1.0]) @ [1, 0, -1, -2, -3, -4])


JUMPS = {
    "floor(10*u)": 4.5,
    "ceil(10*u)": 5.5,
    "mod(u, 0.3)": 0.15 * 0.9 + 0.1 * 0.05,
    "mod(-u, 0.3)": 0.15 * 0.9 + 0.1 * 0.25,
    "floor(-10*u) + floor(10*u)": -1.0,
    "(if floor(4*u) >= 2 then 1 else 0) + floor(3*x6)": 1 / 3 + 2 * (0.5 - 1 / 3),  # rests until 0.5
    "floor(5*u - 10*u*u + a)": parabola(),
    "if mod(u, 0.25) > 0.1 then 1 else 0": 0.6,
    "floor(2*u + floor(4*u))": (0 + 1 + 3 + 4) / 4,
    "noEvent(floor(10*u))*0 + floor(40*u)/40": 39 / 80,
}
"""Expressions, and their integrals over one second with u = t."""


@pytest.mark.parametrize("expected", [LOCATED, JUMPS], ids=["events", "jumps"])
def test_events_are_located(exported: Exporter, expected: dict[str, float]) -> None:
    """Some steps hold more than one jump."""
    with running(exported(integrals(expected))) as test:
        for steps in ([1.0], [0.125] * 8, [0.3, 0.5, 0.2]):
            test.initialize({"u": 0.0, "w": 1.0})
            test.slope("u", 1.0)
            test.slope("w", -1.0)
            test.run(*steps)
            for k, (expression, value) in enumerate(expected.items(), 1):
                accuracy = 1e-3 if "sqrt" in expression else 1e-11  # a root's slope is infinite where it begins
                assert test.get(f"x{k}")[0] == pytest.approx(value, abs=accuracy), expression
            test.fmu.reset()


@both_versions
def test_whole_numbers_are_frozen_in_continuous_time_mode(exported: Exporter, fmi: str) -> None:
    with running(exported(model("y = floor(x) - 10*mod(u, 2);"), fmi=fmi), model_exchange=True) as test:
        test.initialize()
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
def test_chattering_and_not_finite_name_function_and_time(exported: Exporter, fmi: str) -> None:
    with running(exported(model("y = floor(1000*time) + 0*ceil(sqrt(a - time));"), fmi=fmi)) as test:
        test.initialize()
        text = test.refused(lambda: test.run(1.0))
        assert "jump of floor(1000*time) (line 4) chatters at t = 0.1" in text
        assert text.endswith("or give a shorter Interval")
        test.fmu.reset()
        test.initialize()
        test.run(*[0.05] * 4)
        assert test.get("x")[0] == pytest.approx(sum(range(200)) / 1000, abs=1e-11)
        test.fmu.reset()
        test.initialize({"a": 0.05})
        text = test.refused(lambda: test.run(*[0.04] * 2))
        assert "jump of ceil(sqrt(a - time)) (line 4) is not finite at t = 0.05" in text


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
