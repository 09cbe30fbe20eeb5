"""Powers and linear algebraic loops in exported models, against closed forms, linear algebra and scipy."""

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
import scipy.linalg

from fmuid.export.algebraic_loops import solve_linear
from tests.export.conftest import Exporter
from tests.support.exported import both_versions, running

DECAY = """model Decay "dx/dt = -x^a"
  parameter Real a = 2.5, x_start = 2;
  output Real x(start=x_start, fixed=true);
equation
  der(x) = -x^a;
  annotation(experiment(StopTime=1, Interval=0.01));
end Decay;
"""


def decay(t: float, a: complex, start: complex) -> complex:
    return (start ** (1 - a) + (a - 1) * t) ** (1 / (1 - a))


@both_versions
def test_powers_against_the_closed_form(exported: Exporter, fmi: str) -> None:
    """Its derivatives are those of the closed form along imaginary steps, which have no error of their own."""
    fmu = exported(DECAY, fmi=fmi, sensitivities="all")
    with running(fmu) as model:
        model.initialize({"a": 1.7})
        model.run(*[0.1] * 10)
        expected = [decay(1.0, 1.7, 2.0), decay(1.0, 1.7 + 1e-20j, 2.0), decay(1.0, 1.7, 2.0 + 1e-20j)]
        found = model.get("x", "sens.a.x", "sens.x_start.x")
        assert found == pytest.approx([expected[0].real, *(each.imag / 1e-20 for each in expected[1:])], rel=1e-10)
    with running(fmu, model_exchange=True) as model:
        model.initialize({"a": 1.7})
        model.update()
        model.at(0.0, 3.0, 0.0, 1.0)
        assert model.derivatives() == pytest.approx([-(3.0**1.7), -np.log(3.0) * 3.0**1.7, -1.7 * 3.0**0.7], rel=1e-15)


def test_values_and_derivatives_of_powers(exported: Exporter) -> None:
    """Whole exponents serve negative numbers; a power with a parameter as exponent has derivatives at 0, too."""
    text = """model Powers parameter Real a = 3; parameter Real b = 1.5; constant Real c = 2^3; input Real u;
  output Real y1, y2, y3, y4, y5, y6, y7;
equation
  y1 = -u^2; y2 = (u - 1)^3 + 2*u^0; y3 = (u + 5)^(-2); y4 = u^a; y5 = abs(u)^b; y6 = c^u; y7 = 4^0.5*u^1;
end Powers;
"""
    with running(exported(text)) as model:
        model.initialize()
        names = [f"y{k}" for k in range(1, 8)]
        for u in (-2.0, 0.0, 0.5):
            model.set({"u": u})
            expected = [-(u**2), (u - 1) ** 3 + 2, (u + 5) ** -2, u**3, abs(u) ** 1.5, 8**u, 2 * u]
            assert model.get(*names) == pytest.approx(expected, rel=1e-15)
            slopes = [-2 * u, 3 * (u - 1) ** 2, -2 * (u + 5) ** -3, 3 * u**2]
            slopes += [1.5 * abs(u) ** 0.5 * np.sign(u), np.log(8) * 8**u, 2]
            assert model.slopes(names, "u") == pytest.approx(slopes, rel=1e-14)
            assert model.slopes(["y5"], "b") == pytest.approx([np.log(abs(u)) * abs(u) ** 1.5 if u else 0.0], rel=1e-14)


def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return what the expressions of the solution give for these numbers."""
    count = len(right)
    a, b = ca.SX.sym("a", count, count), ca.SX.sym("b", count)
    return np.array(ca.Function("solution", [a, b], [ca.vertcat(*solve_linear(a, b))])(matrix, right)).ravel()


def exact(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solution in rational numbers, rounded once at the end."""
    rows = [[Fraction(x) for x in (*row, value)] for row, value in zip(matrix.tolist(), right.tolist(), strict=True)]
    count = len(rows)
    for k in range(count):
        pivot = next(i for i in range(k, count) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(count):
            if i != k:
                rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return np.array([float(row[-1]) for row in rows])


def inductances(leakage: float) -> np.ndarray:
    """Two times three windings of a machine, turned against each other by 0.3 rad."""
    angles = np.array([0, 2, 4, 0.3 * 3 / np.pi, 2 + 0.3 * 3 / np.pi, 4 + 0.3 * 3 / np.pi]) * np.pi / 3
    matrix = np.cos(angles[:, None] - angles)
    matrix[:3, :3] += 0.2
    return np.asarray(0.4 * matrix + leakage * np.diag([1.0, 1.1, 0.9, 1.2, 1.0, 0.8]))


def test_tightly_coupled_windings_are_solved_as_well_as_their_condition_allows() -> None:
    rng = np.random.default_rng(1)
    matrix = inductances(2e-7)
    assert 1e6 < np.linalg.cond(matrix) < 1e7
    for _ in range(5):
        flux = matrix @ rng.uniform(-5, 5, 6)
        expected = exact(matrix, flux)
        size = np.abs(expected).max()
        assert np.abs(solved(matrix, flux) - expected).max() / size < 1e-9  # condition x rounding; squared: 1e-3
        scales = 10.0 ** rng.integers(-12, 12, 6)  # equations in other units
        order = rng.permutation(6)
        found = solved((matrix * scales[:, None])[order], (flux * scales)[order])
        assert np.abs(found - expected).max() / size < 1e-9


COILS = """model Coils "Two coupled coils, fluxes as states"
  parameter Real L1(unit="H") = 0.3, L2(unit="H") = 0.5, M(unit="H") = 0.35;
  parameter Real R1(unit="Ohm") = 2, R2(unit="Ohm") = 3;
  input Real u;
  output Real i1(unit="A"), i2(unit="A");
  Real psi1(start=0.1, fixed=true), psi2(start=0, fixed=true);
equation
  der(psi1) = u - R1*i1;
  der(psi2) = -R2*i2;
  psi1 = L1*i1 + M*i2;
  psi2 = M*i1 + L2*i2;
  annotation(experiment(StopTime=1, Interval=0.002));
end Coils;
"""
COIL_VALUES = {"L1": 0.3, "L2": 0.5, "M": 0.35, "R1": 2.0, "R2": 3.0}


def coil_currents(t: float, u: float, values: dict[str, float]) -> np.ndarray:
    """Return the currents at time t by the matrix exponential, u being constant."""
    L = np.array([[values["L1"], values["M"]], [values["M"], values["L2"]]])
    R = np.diag([values["R1"], values["R2"]])
    end = np.linalg.solve(R, [u, 0.0])
    return np.asarray(end + scipy.linalg.expm(-np.linalg.solve(L, R) * t) @ (np.linalg.solve(L, [0.1, 0.0]) - end))


@both_versions
def test_coupled_coils_and_their_sensitivities(exported: Exporter, fmi: str) -> None:
    with running(exported(COILS, fmi=fmi, sensitivities="all")) as coils:
        coils.initialize({"u": 4.0})
        coils.run(*[0.02] * 15)
        assert coils.get("i1", "i2") == pytest.approx(coil_currents(0.3, 4.0, COIL_VALUES), rel=1e-10)
        for name, value in COIL_VALUES.items():
            h = 1e-4 * value
            ends = [coil_currents(0.3, 4.0, COIL_VALUES | {name: value + k * h}) for k in (-2, -1, 1, 2)]
            slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
            assert coils.get(f"sens.{name}.i1", f"sens.{name}.i2") == pytest.approx(slope, rel=1e-8)


def test_matrix_that_becomes_singular(exported: Exporter) -> None:
    with running(exported(COILS)) as coils:
        coils.initialize({"L1": 1.0, "L2": 1.0, "M": 1.0, "u": 1.0})
        assert "i1 is not finite at t = 0" in coils.refused(lambda: coils.get("i1"))


def test_loops_one_after_the_other_with_branches_and_derivatives(exported: Exporter) -> None:
    """Mutual inductances in front of derivatives; then a loop that needs their result and has an event."""
    text = """model Two
  parameter Real L = 2, M = 1; input Real u;
  output Real i(start=0, fixed=true), j(start=0.5, fixed=true), a, b;
equation
  a + (if time > 0.5 then 2 else 1)*b = der(i);
  L*der(i) + M*der(j) = u - i;
  a - b = 3*i + der(j);
  M*der(i) + L*der(j) = -j;
  annotation(experiment(StopTime=1, Interval=0.01));
end Two;
"""
    with running(exported(text)) as two:
        two.initialize({"u": 1.0})
        for time, factor in ((0.0, 1.0), (1.0, 2.0)):
            i, j = two.get("i", "j")
            rates = np.linalg.solve([[2, 1], [1, 2]], [1 - i, -j])
            expected = np.linalg.solve(np.array([[1, factor], [1, -1]]), [rates[0], 3 * i + rates[1]])
            assert two.get("der(i)", "der(j)", "a", "b") == pytest.approx([*rates, *expected], rel=1e-13)
            if not time:
                two.run(0.3, 0.3, 0.4)
        A = -np.linalg.inv([[2, 1], [1, 2]])
        end = np.array([1.0, 0.0])
        assert two.get("i", "j") == pytest.approx(end + scipy.linalg.expm(A) @ (np.array([0, 0.5]) - end), rel=1e-11)
