"""A DC motor as two coupled FMUs: its winding and its rotor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmuid

WINDING = """model Winding
  parameter Real R(unit = "Ohm") = 1.0;
  parameter Real L(unit = "H") = 0.01;
  parameter Real k(unit = "N.m/A") = 0.1;
  input Real u(unit = "V");
  input Real w(unit = "rad/s");
  output Real i(unit = "A", start = 0.0, fixed = true);
  output Real tau(unit = "N.m");
equation
  L*der(i) = u - R*i - k*w;
  tau = k*i;
end Winding;
"""
ROTOR = """model Rotor
  parameter Real J(unit = "kg.m2") = 0.001;
  parameter Real b(unit = "N.m.s/rad") = 0.0002;
  input Real tau(unit = "N.m");
  output Real w(unit = "rad/s", start = 0.0, fixed = true);
equation
  J*der(w) = tau - b*w;
end Rotor;
"""
MOTOR = {"winding.R": 1.3, "winding.L": 0.012, "winding.k": 0.11, "rotor.J": 0.0012, "rotor.b": 0.0003}


def coupled_motor(made: Callable[[str], Path], step: float | None = None) -> fmuid.System:
    """Return the motor; a communication step exchanges torque and speed."""
    numerics = fmuid.Numerics(step_size=step, samples=False)
    parts = {name: fmuid.Component(made(text), numerics) for name, text in (("winding", WINDING), ("rotor", ROTOR))}
    return fmuid.System(components=parts, connections=[("winding.tau", "rotor.tau"), ("rotor.w", "winding.w")])
