"""Models in Modelica, and the same equations in Python."""

from collections.abc import Iterable

FRICTION = """model Friction "Mass under a force, with Coulomb's friction"
  parameter Real m = 2;
  parameter Real Fc = 3;
  parameter Real v_start = 1;
  input Real F;
  output Real x(start=0, fixed=true);
  output Real v(start=v_start, fixed=true);
  output Real impulse(start=0, fixed=true);
equation
  der(x) = v;
  m*der(v) = F - (if v > 0 then Fc elseif v < 0 then -Fc else 0);
  der(impulse) = if v > 0 then Fc else -Fc;
  annotation(experiment(StopTime=1, Interval=0.01));
end Friction;
"""


def friction(t: float, force: float, m: float = 2.0, Fc: float = 3.0, v: float = 1.0) -> tuple[float, float, float]:
    """Return x, v and the friction's impulse after time t for a force below -Fc: (F ∓ Fc)/m before and after v = 0."""
    stop = v * m / (Fc - force)
    before, after = min(t, stop), max(t - stop, 0.0)
    x = v * before + (force - Fc) / m * before**2 / 2 + (force + Fc) / m * after**2 / 2
    speed = v + (force - Fc) / m * before if t < stop else (force + Fc) / m * after
    return x, speed, Fc * (before - after)


DRIVE = """model Drive "Nonlinear, with an algebraic output, a local state and starts that depend on parameters"
  parameter Real R(unit="Ohm") = 1.5 "resistance";
  parameter Real L(unit="H") = 0.2;
  parameter Real k(unit="V.s/rad", nominal=0.5) = 0.7;
  parameter Real J = 0.05;
  parameter Real i0(unit="A") = 0.4;
  input Real u(unit="V");
  output Real i(start=i0*(1 + k), fixed=true, unit="A", nominal=3) "current";
  Real w(start=0.3, fixed=true, unit="rad/s") "speed";
  output Real p(unit="W") "power";
equation
  L*der(i) = u - R*i - k*w;
  J*der(w) = k*i - 0.2*tanh(w/k) - max(0.01*w, 0.02*w);
  p = R*i*i + abs(k*w);
  annotation(experiment(StopTime=1, Interval=0.01));
end Drive;
"""


def model(equations: str, declarations: str = "", interval: str = "0.1") -> str:
    """Return a model that integrates y to x."""
    return (
        f"model Test input Real u; input Real w; parameter Real a = 1; {declarations}\n"
        f"output Real y; output Real x(start=0, fixed=true);\nequation der(x) = y;\n{equations}\n"
        f"annotation(experiment(StopTime=1, Interval={interval})); end Test;"
    )


def integrals(expressions: Iterable[str]) -> str:
    """Return a model that integrates each expression, y1, y2, …, to x1, x2, …"""
    numbered = list(enumerate(expressions, 1))
    declared = "".join(f"Real y{k}; output Real x{k}(start=0, fixed=true);\n" for k, _ in numbered)
    equations = "".join(f"der(x{k}) = y{k}; y{k} = {expression};\n" for k, expression in numbered)
    end = "annotation(experiment(StopTime=1, Interval=0.1)); end Integrals;"
    return f"model Integrals input Real u; input Real w; parameter Real a = 1;\n{declared}equation\n{equations}{end}"
