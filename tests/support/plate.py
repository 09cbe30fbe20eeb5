"""A machine that least squares solve exactly, with faults: what diagnosis, monitoring and design are tested on."""

import math
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

import fmuid
from tests.support.exported import export_text

# Gains g and h are the common mode; three faults act along fixed axes on u as the shorted turns of three phases do, one
# turns with an angle on v as broken bars do.
PLATE = """model Plate "static machine"
  parameter Real g = 1;
  parameter Real h = 1;
  parameter Real ea = 0;
  parameter Real eb = 0;
  parameter Real ec = 0;
  parameter Real size = 0;
  parameter Real angle = 0;
  input Real ux;
  input Real uy;
  input Real vx;
  input Real vy;
  output Real x;
  output Real y;
equation
  x = g*ux + h*vx + (ea + (eb + ec)/4)*ux + sqrt(3)/4*(ec - eb)*uy + size*(cos(2*angle)*vx + sin(2*angle)*vy);
  y = g*uy + h*vy + 3/4*(eb + ec)*uy + sqrt(3)/4*(ec - eb)*ux + size*(sin(2*angle)*vx - cos(2*angle)*vy);
  annotation(experiment(StopTime=1, Interval=1e-2));
end Plate;
"""


Look = Callable[..., fmuid.Diagnosis]
SAMPLES, STD, TRUTH = 100, 0.1, {"g": 1.0, "h": 2.0}


PHASES = ("ea", "eb", "ec")


INPUTS = np.random.default_rng(11).standard_normal((SAMPLES, 4))


def columns() -> np.ndarray:
    """Return what g, h, ea, eb, ec and the two components of the turned fault add to x and y, (2 SAMPLES, 7)."""
    u, v = INPUTS[:, :2], INPUTS[:, 2:]
    axes = [np.array([math.cos(a), math.sin(a)]) for a in (0.0, 2 * math.pi / 3, 4 * math.pi / 3)]
    phases = [u @ np.outer(axis, axis) for axis in axes]  # Q(a) u
    # (size cos 2a) and (size sin 2a) multiply these
    turned = [np.column_stack([v[:, 0], -v[:, 1]]), np.column_stack([v[:, 1], v[:, 0]])]
    return np.column_stack([block.ravel() for block in (u, v, *phases, *turned)])


COLUMNS = columns()


def record(rng: np.random.Generator | None, **faults: float) -> fmuid.Experiment:
    """Return a record with faults ``ea``, ``eb``, ``ec``, ``size`` and ``angle``, without noise if there is no rng."""
    size, angle = faults.get("size", 0.0), faults.get("angle", 0.0)
    theta = [faults.get("g", TRUTH["g"]), TRUTH["h"], *(faults.get(name, 0.0) for name in PHASES)]
    theta += [size * math.cos(2 * angle), size * math.sin(2 * angle)]
    outputs = (COLUMNS @ theta).reshape(SAMPLES, 2)
    if rng is not None:
        outputs = outputs + STD * rng.standard_normal(outputs.shape)
    frame = pd.DataFrame(np.column_stack([INPUTS, outputs]), columns=["ux", "uy", "vx", "vy", "x", "y"])
    frame["time"] = 0.01 * np.arange(SAMPLES)
    return fmuid.Experiment(frame, ["ux", "uy", "vx", "vy"], ["x", "y"])


@pytest.fixture(scope="session")
def plate(tmp_path_factory: pytest.TempPathFactory) -> fmuid.System:
    return fmuid.System.of(export_text(tmp_path_factory.mktemp("plate"), PLATE))


def identified(plate: fmuid.System, experiment: fmuid.Experiment) -> fmuid.Result:
    parameters = {name: fmuid.Parameter(1.5) for name in TRUTH}
    problem = fmuid.Problem(plate, experiment, parameters, noise=fmuid.Noise(STD**2))
    return fmuid.identify(problem)


Faults = dict[str, fmuid.Fault]


@pytest.fixture(scope="session")
def faults(plate: fmuid.System) -> Faults:
    ratio = fmuid.Parameter(0.0, min=0.0, nominal=0.01)
    return {
        "stator": fmuid.Fault(plate, dict.fromkeys(PHASES, ratio)),
        "rotor": fmuid.Fault(
            plate,
            {"size": ratio, "angle": fmuid.Parameter(0.0, nominal=1.0)},
            angles={"angle": fmuid.diagnosis.FaultAngle("size", math.pi)},
        ),
    }
