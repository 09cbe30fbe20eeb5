"""The exporter: what it refuses and how, and what the FMUs are made of."""

from __future__ import annotations

import ctypes
import re
import shutil
import struct
import subprocess
import sys
import warnings
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import fmpy
import fmpy.fmi2
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from fmuid.errors import InputError, ModelicaError, ModelicaWarning
from fmuid.export import build, export_fmu
from fmuid.fmi.native.build import compiler_here
from tests.support.exported import here_only
from tests.support.paths import FMUS

MODELS = sorted(path.name for path in FMUS.iterdir() if path.is_dir())
models = pytest.mark.parametrize("model", MODELS)


def members(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def description(fmu: Path) -> ET.Element:
    return ET.fromstring(members(fmu)["modelDescription.xml"])


# ---- refusals: (what stands on line 5 or 8 of a model, what the message says)

DECLARATIONS = [
    ("parameter Integer n = 2;", "'parameter Integer' is outside the exported subset: declare"),
    ("Boolean b;", "'Boolean' is outside"),
    ("discrete Real d;", "'discrete Real'"),
    ("flow Real f;", "'flow Real'"),
    ("parameter input Real f;", "'parameter input Real'"),
    ("SI.Voltage v;", "'SI.Voltage'"),
    ("Real v[3];", "array is outside the exported subset: declare and write scalars"),
    ("Real[3] v;", "array is outside"),
    ("Pin p;", "'Pin'"),
    ("extends Base;", "extends is outside the exported subset: write one flat model"),
    ("import Modelica.Constants.pi;", "import is outside"),
    ("replaceable Real r;", "replaceable is outside"),
    ("inner Real r;", "'inner'"),
    ("final parameter Real r = 1;", "'final'"),
    ("protected Real r;", "'protected'"),
    ("record Rec Real a; end Rec;", "record inside the model"),
    ("function f input Real a; end f;", "function inside the model"),
    ("Real r if true;", "conditional declaration is outside"),
    ("Real r annotation(Evaluate=true);", "annotation is outside"),
    ("Real 'r s';", "quoted name 'r s'"),
    ("Real r = 2*x;", "'r = 2*x' is outside the exported subset: write it as an equation"),
    ("parameter Real r(quantity=1) = 2;", "modifier 'quantity' of parameter variable 'r'"),
    ("parameter Real r(mni=1) = 2;", "(did you mean 'min'"),
    ("parameter Real r(start=1);", "modifier 'start' of parameter variable 'r'"),
    ("parameter Real r(each min=1) = 2;", "'each'"),
    ("parameter Real r(min=1, min=2) = 2;", "'min' is given twice"),
    ("parameter Real r(min) = 2;", "'min' without a value"),
    ("parameter Real r(min(a=1)) = 2;", "write min=..."),
    ("parameter Real r(redeclare Real q) = 2;", "redeclare is outside"),
    ("parameter Real r(unit=1) = 2;", 'give a string, unit="..."'),
    ('parameter Real r(unit="Ohn") = 2;', "unit 'Ohn' of 'r' is outside the exported subset"),
    ('parameter Real r(unit="V/A/s") = 2;', "unit 'V/A/s' of 'r'"),
    ("parameter Real r(nominal=0) = 2;", "'nominal' of 'r' must be positive"),
    ("parameter Real r(min=L) = 2;", "'min' of 'r' must be a number, or an expression of constants above it"),
    ("parameter Real r;", "parameter 'r' has no value"),
    ("parameter Real r = 2*L;", "'r' must be a number, or an expression of constants above it, not of 'L'"),
    ("parameter Real r = 1/0;", "'/' gives no finite number here"),
    ("constant Real r = sqrt(-1);", "'sqrt' gives no finite number here"),
    ("parameter Real r = Q;", "unknown variable 'Q'"),
    ("Real x;", "'x' is already declared at line 4"),
    ("Real time;", "'time' is the simulation time: use it undeclared, or rename this variable"),
    ("parameter Real r = time;", "'r' must be a number, or an expression of constants above it, not of 'time'"),
    ("Real y(start=0, fixed=true);", "'start' of 'y', which is no state: remove it"),
    ("Real y(fixed=false);", "states are fixed=true at their start"),
    ("algorithm y := 1;", "algorithm section is outside the exported subset: write equations"),
    ("initial equation x = 0;", "initial equation is outside"),
    ("Real y", "syntax error at column 1: "),
    ("Real 3;", "syntax error"),
    ("Real y; $", "syntax error"),
]
EQUATIONS = [
    ("if x > 0 then y = 1; else y = 2; end if;", "if-equation is outside the exported subset"),
    ("when x > 0 then y = 1; end when;", "when-equation is outside"),
    ("for k in 1:3 loop y = 1; end for;", "for-equation is outside"),
    ("connect(a, b);", "connect() is outside"),
    ('assert(x > 0, "x");', "call as an equation is outside"),
    ("y = x > 0;", "relation is outside the exported subset: a relation stands in the condition of an if-expression"),
    ("y = if x == 0 then 1 else 2;", "relation '==' is outside the exported subset: < <= > >= are supported"),
    ("y = if x <> 0 then 1 else 2;", "relation '<>' is outside"),
    ("y = if x then 1 else 2;", "condition 'x' is outside the exported subset: write relations, joined with and, or"),
    ("y = if x > 0 then u > 0 else 2;", "relation is outside"),
    ("y = if (x > 0) > 0 then 1 else 2;", "relation is outside"),
    ("y = if true then 1 else 2;", "Boolean in an expression is outside"),
    ("y = if initial() then 1 else 2;", "initial() is outside the exported subset: start values are given by"),
    ("y = if (if x > 0 then u > 0 else x < 1) then 1 else 2;", "if-expression as a condition is outside"),
    ("y = if sample(0, 1) then 1 else 2;", "condition 'sample(0, 1)' is outside"),
    ("y = if x > 0 then 1;", "syntax error"),
    ("y = if y > 0 then u else x;", "equation not linear in its unknown y is outside"),
    ("y = noEvent(if y > 0 then u else x);", "equation not linear in its unknown y is outside"),
    ("y = u - sign(y);", "equation not linear in its unknown y is outside"),
    ("y = if x > 0 then y*y else x;", "equation not linear in its unknown y is outside"),
    ("y = noEvent(x, u);", "noEvent takes one expression"),
    ("y = der(time);", "unknown variable 'der(time)'"),
    ("y = smooth(1, x);", "function smooth() is outside the exported subset: sin, cos"),
    ("y = x.^2;", "operator '.^' is outside"),
    ("y = y^2;", "equation not linear in its unknown y is outside"),
    ("y = u^y;", "equation not linear in its unknown y is outside"),
    ("y = (-1)^0.5;", "'^' gives no finite number here"),
    ("y = x^2^2;", "syntax error"),
    ("y = not x;", "'not' is outside"),
    ("y = x and x;", "'and' is outside"),
    ("y = true;", "Boolean in an expression is outside"),
    ('y = "a";', "string in an expression is outside"),
    ("y = {1, 2};", "array is outside"),
    ("y = [1, 2];", "matrix is outside"),
    ("y = x[1];", "array is outside"),
    ("y = 1:3;", "range is outside"),
    ("y = x .* x;", "operator '.*' is outside"),
    ("y = a.b;", "'a.b' is outside"),
    ("(y, x) = u;", "'(y, x)' is outside"),
    ("y = initial();", "initial() is outside"),
    ("y = atan2(x, u);", "function atan2() is outside the exported subset: sin, cos"),
    ("y = tan(x);", "(did you mean 'tanh'"),
    ("y = max(x);", "max() with 1 argument is outside the exported subset: it takes 2"),
    ("y = sin(x=1);", "give expressions as arguments"),
    ("y = der(L*x);", "write products out as L*der(i)"),
    ("y = der(x, u);", "der takes one variable"),
    ("y = der(u);", "der(u) of input 'u'"),
    ("y = der(L);", "der(L) of parameter 'L'"),
    ("y = xx;", "unknown variable 'xx' (did you mean 'x'"),
    ("y = 1/0;", "'/' gives no finite number here"),
    ("y*y = x;", "equation not linear in its unknown y is outside"),
    ("y = y + x;", "the unknown y of this equation drops out"),
    ("x = u;", "no equation has y"),
    ("y = x annotation(a=1);", "annotation is outside"),
    ("y = = x;", "syntax error at column 7: "),
]
BASE = """model Base "line 1"
  parameter Real L = 0.1;
  input Real u;
  Real x(start=0, fixed=true);
  {declaration}
equation
  L*der(x) = u - x;
  {equation}
  annotation(experiment(StopTime=1, Interval=1e-3));
end Base;
"""


def refusal(directory: Path, text: str) -> ModelicaError:
    (directory / "Base.mo").write_text(text, encoding="utf-8")
    with pytest.raises(ModelicaError) as caught:
        export_fmu(directory / "Base.mo")
    error = caught.value
    assert str(error) == f"Base.mo:{error.line}: {error.construct}"
    assert "\n" not in str(error)
    assert not (directory / "Base.fmu").exists()
    return error


@pytest.mark.parametrize(("declaration", "text"), DECLARATIONS, ids=[d for d, _ in DECLARATIONS])
def test_refused_declarations(tmp_path: Path, declaration: str, text: str) -> None:
    found = refusal(tmp_path, BASE.format(declaration=declaration, equation=""))
    assert text in found.construct
    assert found.line == (6 if declaration == "Real y" else 5)  # a missing semicolon shows on the next line


@pytest.mark.parametrize(("equation", "text"), EQUATIONS, ids=[e for e, _ in EQUATIONS])
def test_refused_equations(tmp_path: Path, equation: str, text: str) -> None:
    found = refusal(tmp_path, BASE.format(declaration="Real y;", equation=equation))
    assert text in found.construct
    assert found.line == (10 if equation == "x = u;" else 8)  # what is missing is missing at the end


@pytest.mark.parametrize(
    ("old", "new", "line", "text"),
    [
        ("equation\n", "equation\n  y = z - x; z = u - y*y;\n", 7,
         "algebraic loop between y, z, which is not linear in y, is outside the exported subset: solve it by hand"),
        ("u - x;", "u - sin(y)*z; y = z - x;\n z = der(x)*y;", 7, "der(x), y, z, which is not linear in der(x), y, z,"),
        ("equation\n", "equation\n  y = z; z = if y > 0 then u else y;\n", 7, "which is not linear in y, is outside"),
        ("equation\n", "equation\n  y = z - x;\n 2*z = u + 2*y;\n", 7,
         "loop between y, z has no unique solution, the equations of lines 7, 8 follow from each other or are in"),
        ("equation\n", "equation\n  y*sin(x) = z*cos(u);\n y*sin(x)*L = z*cos(u)*L;\n", 7, "has no unique solution"),
        ("u - x;", "u - x + z; y = u; y = x;", 7, "this equation has no unknown left"),
        ("equation\n", "equation\n", 9, "1 equations for 3 unknowns (der(x), y, z); no equation has y, z"),
        ("equation\n", "equation\n y = u; z = u; y = x;\n", 10, "unbalanced model: 4 equations for 3 unknowns"),
        ("start=0, ", "", 4, "state 'x' needs both start=... and fixed=true"),
        ("fixed=true", "min=0", 4, "state 'x' needs both start=... and fixed=true"),
        ("start=0", "start=u", 4, "'start' of 'x' must be an expression of parameters and constants, not of 'u'"),
        ("start=0", "start=x", 4, "not of 'x'"),
        ("model Base", "block Base", 1, "this 'block' is outside the exported subset"),
        ("model Base", "partial model Base", 1, "this 'partial model' is outside"),
        ("end Base", "end Bose", 9, "'end Bose' closes 'model Base': make the names the same"),
        ("model Base", "within A; model Base", 1, "several classes or none is outside"),
        ("end Base;", "end Base; model B end B;", 1, "several classes or none is outside"),
        ("model Base", "Base", 1, "syntax error: expected 'model'"),
        ("Interval=1e-3", "Interval=0", 8, "experiment(Interval=0) is outside"),
        ("StopTime=1", "StopTime=-1", 8, "experiment(StopTime=-1) is outside"),
        ("StopTime=1", "Tolerance=1", 8, "experiment(Tolerance=1) is outside"),
        ("experiment(", "Icon(", 8, "annotation is outside the exported subset"),
        ("Interval=1e-3)", "Interval=1e-3), Icon(a=1)", 8, "annotation is outside the exported subset"),
    ],
)  # fmt: skip
def test_refused_models(tmp_path: Path, old: str, new: str, line: int, text: str) -> None:
    base = BASE.replace("  {equation}\n", "").format(declaration="Real y; Real z;")
    if "y" not in new and "3 unknowns" not in text:
        base = base.replace("equation\n", "equation y = u; z = u;\n")
    assert old in base
    found = refusal(tmp_path, base.replace(old, new))
    assert text in found.construct
    assert found.line == line


def test_equations_that_determine_too_little(tmp_path: Path) -> None:
    """y and z stand in one equation alone, the others have more than enough for v and w."""
    declarations, equations = "Real y, z, v, w;", "v = w + u; v = 2*w; v = 3*w - x; y + z = v;"
    found = refusal(tmp_path, BASE.format(declaration=declarations, equation=equations))
    assert found.construct.startswith("the equations left for y, z, v, w do not determine all of them: correct these")


def test_unreadable_source(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read .*None\.mo: No such file or directory; give a Modelica file"):
        export_fmu(tmp_path / "None.mo")
    (tmp_path / "Latin.mo").write_bytes(b"model \xe9")
    with pytest.raises(InputError, match="it is not UTF-8 text"):
        export_fmu(tmp_path / "Latin.mo")


def test_output_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write .*no.Coil\.fmu: No such file or directory; name another"):
        export_fmu(FMUS / "Coil" / "Coil.mo", tmp_path / "no" / "Coil.fmu")


@pytest.mark.parametrize("missing", ["casadi", "antlr4", "pymoca", "ziglang"])
def test_missing_extra_names_the_remedy(monkeypatch: pytest.MonkeyPatch, missing: str) -> None:
    for name in [each for each in sys.modules if each.startswith("fmuid.export.")]:
        monkeypatch.delitem(sys.modules, name)
    for name in [each for each in sys.modules if each.partition(".")[0] == missing]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(InputError, match=rf"exporting needs '{missing}.*': pip install 'fmuid\[export\]'"):
        export_fmu(FMUS / "Coil" / "Coil.mo")


# ---- the FMUs


@models
def test_sources_of_a_committed_fmu_are_what_its_model_gives(
    tmp_path: Path, model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but the binaries, byte for byte."""
    monkeypatch.setitem(build.PLATFORMS, "2.0", {})
    new = members(export_fmu(FMUS / model / f"{model}.mo", tmp_path / "out.fmu"))
    committed = members(FMUS / model / f"{model}.fmu")
    assert new == {name: data for name, data in committed.items() if not name.startswith("binaries/")}


@pytest.mark.parametrize(
    "model",
    [
        "Coil",
        *(pytest.param(m, marks=pytest.mark.slow) for m in MODELS if m != "Coil"),
    ],
)
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
def test_fmpy_finds_nothing_to_say(model: str) -> None:
    assert validate_fmu(str(FMUS / model / f"{model}.fmu")) == []


@models
def test_every_variable_has_a_unit_and_a_description(model: str) -> None:
    root = description(FMUS / model / f"{model}.fmu")
    assert root.get("description")
    units = {unit.get("name") for unit in root.iter("Unit")}
    variables = list(root.iter("ScalarVariable"))
    assert variables
    for variable in variables:
        assert variable.get("description"), variable.get("name")
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
    with simulated(fmu) as slave:
        x, y, rate = slave.getReal([0, 5, 4])
        assert (x, y, rate) == (16.0, -24.0, 40.0)


@pytest.mark.parametrize(
    ("annotation", "stop", "step"),
    [
        ("", None, "0.002"),
        ("annotation(experiment());", None, "0.002"),
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


def test_functions_and_their_derivatives(tmp_path: Path) -> None:
    text = BASE.format(
        declaration="output Real y;", equation="y = sin(x)*cos(u) + sqrt(x)/tanh(u) - max(x, min(u, L));"
    )
    (tmp_path / "Base.mo").write_text(text.replace("start=0", "start=2"), encoding="utf-8")
    with simulated(export_fmu(tmp_path / "Base.mo")) as slave:
        references = {v.name: v.valueReference for v in slave.description.modelVariables}
        x, u = 2.0, 0.7
        slave.setReal([references["u"]], [u])
        y = np.sin(x) * np.cos(u) + np.sqrt(x) / np.tanh(u) - x
        assert slave.getReal([references["y"]])[0] == pytest.approx(y, rel=1e-14)
        known = [references["x"], references["u"], references["L"]]
        found = [slave.getDirectionalDerivative([references["y"]], [k], [1.0])[0] for k in known]
        expected = [
            np.cos(x) * np.cos(u) + 0.5 / np.sqrt(x) / np.tanh(u) - 1,
            -np.sin(x) * np.sin(u) - np.sqrt(x) / np.sinh(u) ** 2,
            0.0,
        ]
        assert found == pytest.approx(expected, rel=1e-13)
        slave.setReal([references["L"], references["u"]], [3.0, 5.0])  # now min gives L, and max that
        assert slave.getDirectionalDerivative([references["y"]], [references["L"]], [1.0]) == [-1.0]


def test_directional_derivatives_are_of_the_present_point(tmp_path: Path) -> None:
    """What they share along all directions is found anew after whatever changes it."""
    text = BASE.format(declaration="", equation="").replace("L*der(x) = u - x;", "der(x) = L*x^2*u;")
    (tmp_path / "Base.mo").write_text(text.replace("start=0", "start=2"), encoding="utf-8")
    with here_only(), simulated(export_fmu(tmp_path / "Base.mo")) as slave:
        references = {v.name: v.valueReference for v in slave.description.modelVariables}
        number = {"x": 2.0, "u": 0.0, "L": slave.getReal([references["L"]])[0]}

        def check() -> None:
            x, u, inductance = number["x"], number["u"], number["L"]
            for known, expected in (("x", 2 * inductance * x * u), ("u", inductance * x**2), ("L", x**2 * u)):
                found = slave.getDirectionalDerivative([references["der(x)"]], [references[known]], [1.0])[0]
                assert found == pytest.approx(expected, rel=1e-14)

        check()
        for name, value in (("u", 0.5), ("L", 3.0), ("u", 0.25)):
            number[name] = value
            slave.setReal([references[name]], [value])
            check()
        slave.doStep(0.0, 0.1)
        number["x"] = slave.getReal([references["x"]])[0]
        assert number["x"] > 2.0
        check()


class simulated:  # noqa: N801
    """An initialised co-simulation instance of an FMU, freed at the end."""

    def __init__(self, fmu: Path) -> None:
        directory = fmpy.extract(str(fmu), unzipdir=str(fmu.with_suffix("")))
        found = fmpy.read_model_description(directory)
        self.slave = fmpy.fmi2.FMU2Slave(
            guid=found.guid,
            unzipDirectory=directory,
            modelIdentifier=found.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.slave.description = found

    def __enter__(self) -> fmpy.fmi2.FMU2Slave:
        self.slave.instantiate()
        self.slave.setupExperiment()
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        return self.slave

    def __exit__(self, *_: object) -> None:
        self.slave.fmi2FreeInstance(self.slave.component)


def test_integration_is_of_order_six(tmp_path: Path) -> None:
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
    (tmp_path / "Oscillator.mo").write_text(text, encoding="utf-8")
    rate = 0.2

    def rates(t: float, z: np.ndarray) -> list[float]:
        return [z[1], (1 - z[0] ** 2) * z[1] - np.sin(z[0]) + rate * t * z[0]]

    exact = solve_ivp(rates, (0, 8), [1.5, -0.5], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    with simulated(export_fmu(tmp_path / "Oscillator.mo")) as slave:
        for count in (160, 320):
            slave.reset()
            slave.setupExperiment()
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            slave.fmi2SetRealInputDerivatives(
                slave.component, (ctypes.c_uint * 1)(2), 1, (ctypes.c_int * 1)(1), (ctypes.c_double * 1)(rate)
            )
            for k in range(count):
                slave.doStep(k * 8 / count, 8 / count)
            errors.append(np.abs(np.array(slave.getReal([0, 1])) - exact).max())
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(orders > 5.7), orders
    assert np.all(orders < 6.6), orders


# ---- the binaries


@models
def test_binaries_of_every_platform(model: str) -> None:
    files = members(FMUS / model / f"{model}.fmu")
    functions = set(re.findall(rb"\bfmi2\w+(?=TYPE )", files["sources/fmi2Functions.h"]))
    assert len(functions) == 44
    elf = files[f"binaries/linux64/{model}.so"]
    assert elf[:5] == b"\x7fELF\x02"
    assert struct.unpack_from("<H", elf, 18) == (62,)  # x86-64
    versions = {tuple(map(int, v.split(b"."))) for v in re.findall(rb"GLIBC_([\d.]+)\0", elf)}
    assert versions
    assert max(versions) <= (2, 17)
    dll = files[f"binaries/win64/{model}.dll"]
    assert dll[:2] == b"MZ"
    (start,) = struct.unpack_from("<I", dll, 0x3C)
    assert struct.unpack_from("<4sH", dll, start) == (b"PE\0\0", 0x8664)
    mac = files[f"binaries/darwin64/{model}.dylib"]
    for data in (elf, dll, *slices(mac).values()):
        assert all(b"\0" + name + b"\0" in data or b"\0_" + name + b"\0" in data for name in functions)
        for path in (str(Path.home()), str(FMUS.parent), "/tmp", "sources/fmi2.c"):
            assert path.encode() not in data


def slices(data: bytes) -> dict[int, bytes]:
    """Return the parts of a universal Mach-O binary by their CPU type."""
    magic, count = struct.unpack_from(">2I", data)
    assert magic == 0xCAFEBABE
    parts = {}
    for k in range(count):
        cpu, subtype, offset, size, align = struct.unpack_from(">5I", data, 8 + 20 * k)
        assert align == 14
        assert offset % 2**align == 0
        parts[cpu] = data[offset : offset + size]
        assert struct.unpack_from("<3I", parts[cpu]) == (0xFEEDFACF, cpu, subtype)
    return parts


@models
def test_universal_binary_for_intel_and_apple_silicon(model: str) -> None:
    parts = slices(members(FMUS / model / f"{model}.fmu")[f"binaries/darwin64/{model}.dylib"])
    intel, arm = 0x01000007, 0x0100000C
    assert [*parts] == [intel, arm]
    for part in parts.values():
        filetype, count = struct.unpack_from("<2I", part, 12)
        assert filetype == 6  # dylib
        offset, commands = 32, set()
        for _ in range(count):
            command, size = struct.unpack_from("<2I", part, offset)
            commands.add(command)
            offset += size
        if part is parts[arm]:
            assert 0x1D in commands  # a code signature: Apple silicon loads nothing without


def test_sources_rebuild(tmp_path: Path) -> None:
    """The FMU's sources compile as its description says: the listed file, and nothing but the folder around it."""
    fmpy.extract(str(FMUS / "Coil" / "Coil.fmu"), unzipdir=str(tmp_path))
    listed = {file.get("name") for file in description(FMUS / "Coil" / "Coil.fmu").iter("File")}
    assert listed == {"fmi2.c"}
    command = [*compiler_here(), "-Wall", "-Wextra", "-shared", "-fPIC", "fmi2.c", "-o", "x.so"]
    done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
