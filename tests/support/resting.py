"""Models with steady states, and their equations a second time."""

from __future__ import annotations

import numpy as np
import pandas as pd
import scipy

SATURATED = """model SaturatedMotor "series motor with a saturated field"
  parameter Real R(unit="Ohm") = 0.6;
  parameter Real k(unit="1") = 1.1;
  parameter Real c(unit="A/Wb3") = 900 "saturation";
  parameter Real b(unit="N.m.s/rad") = 2e-3;
  input Real u(unit="V");
  input Real load(unit="N.m");
  output Real i(unit="A");
  output Real w(unit="rad/s", nominal=100, start=50, fixed=true);
  Real psi(unit="Wb", nominal=0.1, start=0.05, fixed=true);
equation
  i = psi/0.02 + c*psi^3;
  der(psi) = u - R*i - k*w*psi;
  0.01*der(w) = k*psi*i - b*w - load;
end SaturatedMotor;
"""
BISTABLE = """model Switch "two stable states, none beyond a limit; unstable about zero"
  parameter Real a = 1;
  parameter Real x0 = 0.5;
  input Real u;
  output Real x(start=x0, fixed=true);
equation
  der(x) = u + a*x - x^3;
end Switch;
"""
KINKED = """model Kinked "two slopes, which meet at rest"
  parameter Real a = 1;
  input Real u;
  output Real x(start=3, fixed=true);
equation
  der(x) = if x > 1 then -2*(x - 1) + u else -a*(x - 1) + u;
end Kinked;
"""
ADDING = """model Adding "an integrator: it rests for no input"
  parameter Real a = 1;
  input Real u;
  output Real x(start=2, fixed=true);
equation
  der(x) = a*u;
end Adding;
"""


def saturated_motor(theta: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return i and w (K, 2) of (R, k, c, b) at voltages and loads (K, 2), by scipy's fsolve."""
    r, k, c, b = theta

    def current(psi: float) -> float:
        return float(psi / 0.02 + c * psi**3)

    found = []
    for u, load in points:

        def rates(x: np.ndarray, u: float = u, load: float = load) -> list[float]:
            psi, w = 0.1 * x[0], 100.0 * x[1]
            return [u - r * current(psi) - k * w * psi, 10.0 * (k * psi * current(psi) - b * w - load)]

        x = scipy.optimize.fsolve(rates, [0.5, 0.5], xtol=1e-12)
        found.append((current(0.1 * x[0]), 100.0 * x[1]))
    return np.array(found)


MACHINE = {"Rs": 9.8, "Rr": 3.8, "Lm": 0.436, "Lf": 0.0762}
"""Parameters of the induction machine of the book, rounded."""
OMEGA = 2.0 * np.pi * 50.0


def induction_machine(voltage: float, slip: float, theta: dict[str, float] = MACHINE) -> tuple[float, complex, float]:
    """Return current (A rms), complex power (VA) and torque (N.m) by IEEE 112's circuit, leakage at the stator."""
    magnetizing, rotor = 1j * OMEGA * theta["Lm"], theta["Rr"] / slip
    gap = magnetizing * rotor / (magnetizing + rotor)
    current = voltage / (theta["Rs"] + 1j * OMEGA * theta["Lf"] + gap)
    in_rotor = gap * current / rotor
    torque = 3.0 * abs(in_rotor) ** 2 * rotor * 2 / OMEGA
    return abs(current), 3.0 * voltage * current.conjugate(), torque


def three_tests() -> pd.DataFrame:
    """Return no-load, locked-rotor and load points, without noise."""
    rows = [(230, 0.001), (200, 0.001), (160, 0.001), (60, 1.0), (90, 1.0)]
    rows += [(230, 0.012), (230, 0.026), (230, 0.041), (230, 0.058)]
    found = []
    for voltage, slip in rows:
        current, power, torque = induction_machine(voltage, slip)
        speed = (1.0 - slip) * OMEGA / 2.0 * 30.0 / np.pi
        found.append((voltage, voltage * np.sqrt(3.0), slip, speed, 50.0, current, power.real, power.imag, torque))
    table = pd.DataFrame(found, columns=["U", "UL", "s", "n", "f", "I", "P", "Q", "T"])
    return table.assign(cos=table["P"] / np.hypot(table["P"], table["Q"]))


SYNCHRONOUS = """model SynchronousMachine "wound field, one damper an axis, axes of its rotor, referred to the stator"
  parameter Real Ra(unit="Ohm", min=0) = 0.003;
  parameter Real Ll(unit="H", min=1e-9) = 5e-4;
  parameter Real Lmd(unit="H", min=1e-9) = 4.4e-3;
  parameter Real Lmq(unit="H", min=1e-9) = 4.2e-3;
  parameter Real Rf(unit="Ohm", min=0) = 9e-4;
  parameter Real Lf(unit="H", min=1e-9) = 4.5e-4;
  parameter Real RD(unit="Ohm", min=0) = 0.03;
  parameter Real LD(unit="H", min=1e-9) = 4.0e-4;
  parameter Real RQ(unit="Ohm", min=0) = 0.02;
  parameter Real LQ(unit="H", min=1e-9) = 8e-4;
  input Real ud(unit="V"); input Real uq(unit="V"); input Real uf(unit="V"); input Real w(unit="rad/s");
  output Real id(unit="A"); output Real iq(unit="A"); output Real if_(unit="A");
  Real psid(unit="Wb", start=0, fixed=true); Real psiq(unit="Wb", start=0, fixed=true);
  Real psif(unit="Wb", start=0, fixed=true); Real psiD(unit="Wb", start=0, fixed=true);
  Real psiQ(unit="Wb", start=0, fixed=true);
  Real iD(unit="A"); Real iQ(unit="A");
equation
  psid = (Ll+Lmd)*id + Lmd*(if_ + iD);
  psif = Lmd*(id + iD) + (Lmd+Lf)*if_;
  psiD = Lmd*(id + if_) + (Lmd+LD)*iD;
  psiq = (Ll+Lmq)*iq + Lmq*iQ;
  psiQ = Lmq*iq + (Lmq+LQ)*iQ;
  der(psid) = ud - Ra*id + w*psiq;
  der(psiq) = uq - Ra*iq - w*psid;
  der(psif) = uf - Rf*if_;
  der(psiD) = -RD*iD;
  der(psiQ) = -RQ*iQ;
end SynchronousMachine;
"""
SYNCHRONOUS_VALUES = dict(
    zip(
        ("Ra", "Ll", "Lmd", "Lmq", "Rf", "Lf", "RD", "LD", "RQ", "LQ"),
        (3e-3, 5e-4, 4.4e-3, 4.2e-3, 9e-4, 4.5e-4, 0.03, 4e-4, 0.02, 8e-4),
        strict=True,
    )
)


def standstill_responses(frequencies: np.ndarray) -> dict[str, np.ndarray]:
    """Return Zd, Zq and sG of IEEE 115's standstill test by the circuit of the machine."""
    at, s = SYNCHRONOUS_VALUES, 2j * np.pi * frequencies
    field, damper, magnetizing = at["Rf"] + s * at["Lf"], at["RD"] + s * at["LD"], s * at["Lmd"]
    inner = 1.0 / (1.0 / magnetizing + 1.0 / field + 1.0 / damper)
    other = 1.0 / (1.0 / (s * at["Lmq"]) + 1.0 / (at["RQ"] + s * at["LQ"]))
    stator = at["Ra"] + s * at["Ll"]
    return {"Zd": stator + inner, "Zq": stator + other, "sG": -inner / field}
