"""The exporter: what it refuses and how, and what the FMUs are made of."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from fmuid.export import build, export_fmu
from tests.export.conftest import Exporter
from tests.support.exported import running
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


SI = {  # SI Brochure, 9th edition, tables 4 to 6
    **{"N": "kg1 m1 s-2", "J": "kg1 m2 s-2", "W": "kg1 m2 s-3", "V": "kg1 m2 s-3 A-1", "Ohm": "kg1 m2 s-3 A-2"},
    **{"H": "kg1 m2 s-2 A-2", "Wb": "kg1 m2 s-2 A-1", "T": "kg1 s-2 A-1", "C": "s1 A1", "F": "kg-1 m-2 s4 A2"},
    **{"S": "kg-1 m-2 s3 A2", "Hz": "s-1", "Pa": "kg1 m-1 s-2", "degC": "K1 offset273.15", "F.V/s": "A1"},
    **{"C/F": "kg1 m2 s-3 A-1", "W/(m2.K)": "kg1 s-3 K-1", "J/(mol.K)": "kg1 m2 s-2 K-1 mol-1", "cd/m2": "m-2 cd1"},
    **{"rad/s": "s-1 rad1", "mm": "m1 factor0.001"},
}


@pytest.mark.slow
def test_units_are_products_of_base_units(exported: Exporter) -> None:
    lines = [f'parameter Real p{k}(unit="{unit}") = 1;' for k, unit in enumerate(SI)]
    total = " + ".join(f"p{k}" for k in range(len(SI)))
    found = description(
        exported(f"model Units {' '.join(lines)} Real x(start=0, fixed=true); equation der(x) = {total}; end Units;")
    )
    units = {
        unit.get("name"): " ".join(f"{key}{power}" for key, power in unit[0].items()) for unit in found.iter("Unit")
    }
    assert units == SI


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
