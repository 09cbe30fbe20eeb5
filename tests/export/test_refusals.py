"""Modelica that the exporter does not take, and what it says."""

import sys
from pathlib import Path

import pytest

from fmuid import InputError
from fmuid.errors import ModelicaError
from fmuid.export import export_fmu
from tests.support.exported import here_only
from tests.support.exporting import BASE
from tests.support.paths import FMUS

DECLARATIONS = [
    ("parameter Integer n = 2;", "'parameter Integer' is outside the exported subset: declare"),
    ("Real v[3];", "array is outside the exported subset: declare and write scalars"),
    ("extends Base;", "extends is outside the exported subset: write one flat model"),
    ("Real r if true;", "conditional declaration is outside"),
    ("parameter Real r(redeclare Real q) = 2;", "redeclare is outside"),
    ("record Rec Real a; end Rec;", "record inside the model"),
    ("Real 'r s';", "quoted name 'r s'"),
    ("Real r = 2*x;", "'r = 2*x' is outside the exported subset: write it as an equation"),
    ("parameter Real r(quantity=1) = 2;", "modifier 'quantity' of parameter variable 'r'"),
    ("parameter Real r(min=1, min=2) = 2;", "'min' is given twice"),
    ("parameter Real r(min(a=1)) = 2;", "write min=..."),
    ("parameter Real r(unit=1) = 2;", 'give a string, unit="..."'),
    ('parameter Real r(unit="Ohn") = 2;', "unit 'Ohn' of 'r' is outside the exported subset"),
    ("parameter Real r(nominal=0) = 2;", "'nominal' of 'r' must be positive"),
    ("parameter Real r(min=L) = 2;", "'min' of 'r' must be a number, or an expression of constants above it"),
    ("parameter Real r;", "parameter 'r' has no value"),
    ("parameter Real r = 2*L;", "'r' must be a number, or an expression of constants above it, not of 'L'"),
    ("parameter Real r = 1/0;", "'/' gives no finite number here"),
    ("Real x;", "'x' is already declared at line 4"),
    ("Real time;", "'time' is the simulation time: use it undeclared, or rename this variable"),
    ("Real y(start=0, fixed=true);", "'start' of 'y', which is no state: remove it"),
    ("Real y(fixed=false);", "states are fixed=true at their start"),
    ("algorithm y := 1;", "algorithm section is outside the exported subset: write equations"),
    ("Real y", "syntax error at column 1: "),
]
EQUATIONS = [
    ("if x > 0 then y = 1; else y = 2; end if;", "if-equation is outside the exported subset"),
    ("y = x > 0;", "relation is outside the exported subset: a relation stands in the condition of an if-expression"),
    ("y = if x == 0 then 1 else 2;", "relation '==' is outside the exported subset: < <= > >= are supported"),
    ("y = if x then 1 else 2;", "condition 'x' is outside the exported subset: write relations, joined with and, or"),
    ("y = if initial() then 1 else 2;", "initial() is outside the exported subset: start values are given by"),
    ("y = if (if x > 0 then u > 0 else x < 1) then 1 else 2;", "if-expression as a condition is outside"),
    ("y = if x > 0 then y*y else x;", "equation not linear in its unknown y is outside"),
    ("y = noEvent(x, u);", "noEvent takes one expression"),
    ("y = (-1)^0.5;", "'^' gives no finite number here"),
    ("y = x.^2;", "operator '.^' is outside"),
    ("y = not x;", "'not' is outside"),
    ("(y, x) = u;", "'(y, x)' is outside"),
    ("y = if true then 1 else 2;", "Boolean in an expression is outside"),
    ("y = {1, 2};", "array is outside"),
    ('y = "a";', "string in an expression is outside"),
    ("y = atan2(x, u);", "function atan2() is outside the exported subset: sin, cos"),
    ("y = max(x);", "max() with 1 argument is outside the exported subset: it takes 2"),
    ("y = sin(x=1);", "give expressions as arguments"),
    ("y = der(L*x);", "write products out as L*der(i)"),
    ("y = der(u);", "der(u) of input 'u'"),
    ("y = xx;", "unknown variable 'xx' (did you mean 'x'"),
    ("y = y + x;", "the unknown y of this equation drops out"),
    ("x = u;", "no equation has y"),
    ("y = = x;", "syntax error at column 7: "),
]


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
        ("equation\n", "equation\n  y = z; z = if y > 0 then u else y;\n", 7, "which is not linear in y, is outside"),
        ("equation\n", "equation\n  y = z - x;\n 2*z = u + 2*y;\n", 7,
         "loop between y, z has no unique solution, the equations of lines 7, 8 follow from each other or are in"),
        ("u - x;", "u - x + z; y = u; y = x;", 7, "this equation has no unknown left"),
        ("equation\n", "equation\n", 9, "1 equations for 3 unknowns (der(x), y, z); no equation has y, z"),
        ("equation\n", "equation\n y = u; z = u; y = x;\n", 10, "unbalanced model: 4 equations for 3 unknowns"),
        ("start=0, ", "", 4, "state 'x' needs both start=... and fixed=true"),
        ("start=0", "start=u", 4, "'start' of 'x' must be an expression of parameters and constants, not of 'u'"),
        ("model Base", "block Base", 1, "this 'block' is outside the exported subset"),
        ("end Base", "end Bose", 9, "'end Bose' closes 'model Base': make the names the same"),
        ("model Base", "within A; model Base", 1, "several classes or none is outside"),
        ("model Base", "Base", 1, "syntax error: expected 'model'"),
        ("Interval=1e-3", "Interval=0", 8, "experiment(Interval=0) is outside"),
        ("experiment(", "Icon(", 8, "annotation is outside the exported subset"),
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
    with here_only(), pytest.raises(InputError, match=r"cannot write .*no.Coil\.fmu: No such file or directory"):
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
