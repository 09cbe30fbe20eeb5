"""The exporter: what it refuses and how, and what the FMUs are made of."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from fmuid.errors import ModelicaWarning
from fmuid.export import build, export_fmu
from tests.export.conftest import Exporter
from tests.support.exported import here_only, running
from tests.support.exporting import BASE, description, members, models
from tests.support.paths import FMUS


@models
def test_sources_of_a_committed_fmu_are_what_its_model_gives(
    tmp_path: Path, model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but the binaries, byte for byte."""
    monkeypatch.setitem(build.PLATFORMS, "2.0", {})
    new = members(export_fmu(FMUS / model / f"{model}.mo", tmp_path / "out.fmu"))
    committed = members(FMUS / model / f"{model}.fmu")
    assert new == {name: data for name, data in committed.items() if not name.startswith("binaries/")}


@pytest.mark.slow
@models
def test_committed_fmu_is_what_its_source_gives(tmp_path: Path, model: str) -> None:
    """Byte for byte, in another directory and under another name."""
    elsewhere = tmp_path / "a directory" / "Source.mo"
    elsewhere.parent.mkdir()
    shutil.copy(FMUS / model / f"{model}.mo", elsewhere)
    built = export_fmu(elsewhere, tmp_path / "out.fmu")
    assert built == tmp_path / "out.fmu"
    new, committed = members(built), members(FMUS / model / f"{model}.fmu")
    assert [*new] == [*committed]
    assert not [name for name, data in new.items() if data != committed[name]]
    assert built.read_bytes() == (FMUS / model / f"{model}.fmu").read_bytes()


@models
def test_committed_fmu_is_valid_and_documented(model: str) -> None:
    """FMPy finds nothing; every variable has a unit and a description."""
    assert validate_fmu(str(FMUS / model / f"{model}.fmu")) == []
    root = description(FMUS / model / f"{model}.fmu")
    units = {unit.get("name") for unit in root.iter("Unit")}
    variables = list(root.iter("ScalarVariable"))
    assert variables
    for variable in [root, *variables]:
        assert variable.get("description"), variable.get("name")
    for variable in variables:
        assert variable[0].get("unit") in units, variable.get("name")


def test_units_in_base_units() -> None:
    root = description(FMUS / "PositionController" / "PositionController.fmu")
    units = {unit.get("name"): dict(unit[0].attrib) for unit in root.iter("Unit")}
    assert units == {
        "1/s": {"s": "-1"},
        "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
        "V.s/m": {"kg": "1", "m": "1", "s": "-2", "A": "-1"},
        "m": {"m": "1"},
        "m/s": {"m": "1", "s": "-1"},
    }
    machine = description(FMUS / "InductionMachine" / "InductionMachine.fmu")
    (rpm,) = (each for each in machine.iter("DisplayUnit") if each.get("name") == "rpm")
    assert 750 / float(rpm.get("factor", "")) == pytest.approx(750 * 2 * np.pi / 60)  # rad/s


def dependencies(model: str) -> dict[str, dict[str, set[str]]]:
    root = description(FMUS / model / f"{model}.fmu")
    names = [str(variable.get("name")) for variable in root.iter("ScalarVariable")]
    return {
        element: {
            names[int(unknown.get("index", "")) - 1]: {
                names[int(k) - 1] for k in unknown.get("dependencies", "missing").split()
            }
            for unknown in root.findall(f"ModelStructure/{element}/Unknown")
        }
        for element in ("Outputs", "Derivatives", "InitialUnknowns")
    }


def test_dependencies_are_exact() -> None:
    assert dependencies("Coil") == {
        "Outputs": {"i": {"i"}},
        "Derivatives": {"der(i)": {"i", "u"}},
        "InitialUnknowns": {"i": {"i_start"}, "der(i)": {"i_start", "u", "R", "L"}},
    }
    machine = dependencies("InductionMachine")["Derivatives"]
    assert machine["der(phidr)"] == {"ids", "phidr"}
    assert machine["der(ids)"] == {"ids", "iqs", "phidr", "phiqr", "uds", "w"}
    phases = dependencies("ThreePhaseInductionMachine")["Derivatives"]
    assert phases["der(theta)"] == {"w"}
    assert phases["der(phidr)"] == {"ia", "ib", "ic", "theta", "phidr"}
    assert phases["der(ia)"] == {"ia", "ib", "ic", "theta", "phidr", "phiqr", "ua", "w"}
    assert dependencies("PositionController") == {
        "Outputs": {"v": {"qg", "q", "dq"}},
        "Derivatives": {},
        "InitialUnknowns": {"v": {"qg", "q", "dq", "kp", "kv", "v_max"}},
    }


def test_attributes_of_variables(tmp_path: Path) -> None:
    """Constants are folded, escapes and signs read, limits and nominals passed on."""
    (tmp_path / "Some.mo").write_text(
        'model Some "a \\"quoted\\" & <marked> " + "text"\n'
        "  constant Real two = 4/2; // not a variable of the FMU\n"
        "  parameter Real a(min=-two, max=2*two, nominal=0.5) = -two + 1e1;\n"
        "  input Real u(start=-3), w;\n"
        '  output Real y "the output";\n'
        '  Real x(start=a*two, fixed=true, nominal=7, unit="N.m/(V.s)");\n'
        "equation\n"
        "  0 = y - (a*u + two*w);\n"
        '  -der(x) = -(+(x - y)) /* a comment */ "and a string";\n'
        "  annotation(experiment(StopTime=2, Interval=0.25));\n"
        "end Some;",
        encoding="utf-8",
    )
    with here_only():
        fmu = export_fmu(tmp_path / "Some.mo")
    assert fmu == tmp_path / "Some.fmu"
    assert validate_fmu(str(fmu)) == []
    root = description(fmu)
    assert root.get("description") == 'a "quoted" & <marked> text'
    found = {v.get("name"): dict(v[0].attrib) for v in root.iter("ScalarVariable")}
    assert found == {
        "a": {"min": "-2.0", "max": "4.0", "nominal": "0.5", "start": "8.0"},
        "u": {"start": "-3.0"},
        "w": {"start": "0.0"},
        "y": {},
        "x": {"unit": "N.m/(V.s)", "nominal": "7.0"},
        "der(x)": {"unit": "N.m/(V.s.s)", "derivative": "5"},
    }
    assert {unit.get("name"): unit[0].attrib for unit in root.iter("Unit")} == {
        "N.m/(V.s)": {"A": "1"},
        "N.m/(V.s.s)": {"s": "-1", "A": "1"},
    }
    with running(fmu) as some:
        some.initialize()
        assert some.get("x", "y", "der(x)") == [16.0, -24.0, 40.0]


@pytest.mark.parametrize(
    ("annotation", "stop", "step"),
    [
        ("", None, "0.002"),
        ("annotation(experiment(StopTime=10));", "10.0", "0.02"),
        ("annotation(experiment(Interval=0.5));", None, "0.5"),
        ("annotation(experiment(StopTime=10, Interval=0.5));", "10.0", "0.5"),
    ],
)
def test_experiment_is_optional(tmp_path: Path, annotation: str, stop: str | None, step: str) -> None:
    """Without an Interval the steps are a 500th of the experiment, as in Modelica tools, and a warning says so."""
    text = BASE.format(declaration="output Real y;", equation="y = x;").replace(
        "annotation(experiment(StopTime=1, Interval=1e-3));", annotation
    )
    (tmp_path / "Base.mo").write_text(text, encoding="utf-8")
    with here_only(), warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        fmu = export_fmu(tmp_path / "Base.mo")
    (experiment,) = description(fmu).iter("DefaultExperiment")
    assert (experiment.get("stopTime"), experiment.get("stepSize")) == (stop, step)
    assert validate_fmu(str(fmu)) == []
    assert f"MODEL_STEP {step} /*" in members(fmu)["sources/model.h"].decode()
    text = f"Base.mo:10: experiment without Interval: co-simulation takes steps of {step} s, without error control"
    assert [str(each.message).partition(";")[0] for each in found] == [text] * ("Interval" not in annotation)


def test_parameters_without_a_use_are_named(tmp_path: Path) -> None:
    """Used is what the equations or a start depend on, not what they mention."""
    declaration = (
        "parameter Real a = 1, b = 2;\n parameter Real c = 3, d = 4, e = 5; Real y(start=d, fixed=true); Real z;"
    )
    text = BASE.format(declaration=declaration, equation="der(y) = u*(c - c + e^2); z = if b > 1 then x else u;")
    (tmp_path / "Base.mo").write_text(text, encoding="utf-8")
    with here_only(), warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        export_fmu(tmp_path / "Base.mo", sensitivities=["a", "L"])
    assert [str(each.message) for each in found] == [
        "Base.mo:5: parameter 'a' is used nowhere: use or remove it",
        "Base.mo:6: parameter 'c' is used nowhere: use or remove it",
    ]
    assert all(each.category is ModelicaWarning and each.filename == __file__ for each in found)


def test_functions_and_their_derivatives(exported: Exporter) -> None:
    equation = "y = sin(x)*cos(u) + sqrt(x)/tanh(u) - max(x, min(u, L));"
    text = BASE.format(declaration="output Real y;", equation=equation).replace("start=0", "start=2")
    with running(exported(text)) as base:
        base.initialize()
        x, u = 2.0, 0.7
        base.set({"u": u})
        assert base.get("y") == pytest.approx([np.sin(x) * np.cos(u) + np.sqrt(x) / np.tanh(u) - x], rel=1e-14)
        expected = {
            "x": np.cos(x) * np.cos(u) + 0.5 / np.sqrt(x) / np.tanh(u) - 1,
            "u": -np.sin(x) * np.sin(u) - np.sqrt(x) / np.sinh(u) ** 2,
            "L": 0.0,
        }
        for name, slope in expected.items():
            assert base.slopes(["y"], name) == pytest.approx([slope], rel=1e-13)
        base.set({"L": 3.0, "u": 5.0})  # now min gives L, and max that
        assert base.slopes(["y"], "L") == [-1.0]


def test_directional_derivatives_are_of_the_present_point(exported: Exporter) -> None:
    """What they share along all directions is found anew after whatever changes it."""
    text = BASE.format(declaration="", equation="").replace("L*der(x) = u - x;", "der(x) = L*x^2*u;")
    with running(exported(text.replace("start=0", "start=2"))) as base:

        def check() -> None:
            x, u, inductance = base.get("x", "u", "L")
            for known, expected in (("x", 2 * inductance * x * u), ("u", inductance * x**2), ("L", x**2 * u)):
                assert base.slopes(["der(x)"], known) == pytest.approx([expected], rel=1e-14)

        base.initialize({"u": 0.0})
        check()
        for name, value in (("u", 0.5), ("L", 3.0), ("u", 0.25)):
            base.set({name: value})
            check()
        base.run(0.1)
        assert base.get("x")[0] > 2.0
        check()


def test_integration_is_of_order_six(exported: Exporter) -> None:
    """On a nonlinear oscillator with an input that is linear in time: halving the step divides the error by 64."""
    text = """model Oscillator
  input Real u;
  output Real x(start=1.5, fixed=true), y(start=-0.5, fixed=true);
equation
  der(x) = y;
  der(y) = (1 - x*x)*y - sin(x) + u*x;
  annotation(experiment(StopTime=1, Interval=1));
end Oscillator;
"""
    rate = 0.2

    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], (1 - z[0] ** 2) * z[1] - np.sin(z[0]) + rate * t * z[0]]

    exact = solve_ivp(rates, (0, 8), [1.5, -0.5], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    with running(exported(text)) as oscillator:
        for count in (160, 320):
            oscillator.initialize()
            oscillator.slope("u", rate)
            oscillator.run(*[8 / count] * count)
            errors.append(np.abs(np.array(oscillator.get("x", "y")) - exact).max())
            oscillator.fmu.reset()
    assert 5.7 < np.log2(errors[0] / errors[1]) < 6.6
