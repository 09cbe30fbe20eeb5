"""floor, ceil and mod in exported models: whole numbers that only events change."""

import math
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmuid.errors import ModelicaError
from fmuid.export import export_fmu
from tests.export.conftest import Exporter
from tests.support.exported import both_versions, running
from tests.support.modelica import integrals, model


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


def test_jumps_are_located(exported: Exporter) -> None:
    """Some steps hold more than one jump."""
    with running(exported(integrals(JUMPS))) as test:
        for steps in ([1.0], [0.125] * 8, [0.3, 0.5, 0.2]):
            test.initialize()
            test.slope("u", 1.0)
            test.run(*steps)
            for k, (expression, expected) in enumerate(JUMPS.items(), 1):
                assert test.get(f"x{k}")[0] == pytest.approx(expected, abs=1e-11), expression
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
