"""Parameters of a machine from its nameplate; σ from the printed digits.

Rated point, locked rotor and breakdown are phasors of the model. The slip is a parameter beside those of the machine,
so that the rounding of the speed counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from fmuid.array_types import Floats
from fmuid.data import (
    JointPrior,
    Nameplate,
    Noise,
    Normal,
    Parameter,
    PrintedNumber,
    RotatingFrame,
    SteadyExperiment,
    evaluate,
)
from fmuid.errors import InputError
from fmuid.estimation import LeastSquares
from fmuid.identification.identify import identify
from fmuid.models import System, machine_of
from fmuid.simulation import Value, simulator_of


@dataclass(frozen=True)
class NameplateSettings:
    """Numbers of the fit to a nameplate."""

    slips: int = 25  # of the torque curve ...
    least_slip: float = 0.02  # ... from here ...
    most_slip: float = 0.95  # ... to here, in equal ratios
    reach: float = 3.0  # half steps of the speed's last digit that the slip may be away
    spread: float = 1.0  # σ of first values, relative: they decide only what the nameplate does not
    least: float = 0.01  # lower bound, relative to the first value


SETTINGS = NameplateSettings()
OUTPUTS = ("I_rms", "cos_phi", "torque")


class _Plate:
    """Quantities of a nameplate as functions of parameters and slip."""

    def __init__(self, system: System, plate: Nameplate, names: Sequence[str], values: Mapping[str, Value]) -> None:
        printed, slip = plate.printed, plate.slip
        self.printed, self.count = printed, len(names)
        width = max(SETTINGS.reach * slip.half, 1e-6 * slip.value)
        self.rated = slip.value + width * np.array([-1.0, 0.0, 1.0])
        if self.rated[0] <= 0.0:
            raise InputError(f"nameplate: n = {plate.n} is too near the synchronous speed. Print more digits.")
        self.curve = np.geomspace(SETTINGS.least_slip, SETTINGS.most_slip, SETTINGS.slips)
        slips = np.concatenate([self.rated, [1.0], self.curve])
        frame = pd.DataFrame({"slip": slips, **dict.fromkeys(OUTPUTS, np.ones(slips.size))})
        supply = RotatingFrame(printed["f"].value, None, printed["U"].value, "slip", None, plate.pole_pairs)
        experiment = SteadyExperiment(frame, outputs=list(OUTPUTS), supply=supply, source="nameplate")
        self.simulator = simulator_of(system, experiment, tuple(names), values)
        self.synchronous = 2.0 * np.pi * printed["f"].value / plate.pole_pairs

    def quantities(self, theta: Floats) -> dict[str, float]:
        """Return the printed quantities of parameters and slip (N + 1,)."""
        slip, found = theta[-1], self.simulator(theta[:-1])
        current, cosine, torque = _through(self.rated, found[:3], slip)
        locked, curve = found[3], found[4:, 2]
        speed = self.synchronous * (1.0 - slip)
        made = {"I": current, "cos_phi": cosine, "P": torque * speed, "n": speed * 30.0 / np.pi}
        made |= {"Is_In": locked[0] / current, "Ts_Tn": locked[2] / torque}
        return made | {"Tb_Tn": _peak(np.log(self.curve), curve) / torque}

    def residual(self, theta: Floats) -> Floats:
        """Return the errors of the printed quantities, in their rounding's σ."""
        found = self.quantities(theta)
        return np.array([(found[name] - each.value) / each.std for name, each in self.compared.items()])

    @property
    def compared(self) -> dict[str, PrintedNumber]:
        """Printed numbers that depend on the parameters."""
        return {name: each for name, each in self.printed.items() if name not in ("U", "f")}


def _through(x: Floats, y: Floats, at: float) -> Floats:
    """Return the parabola through three points (3,), (3, n)."""
    a, b, c = x
    weights = [(at - b) * (at - c) / ((a - b) * (a - c)), (at - a) * (at - c) / ((b - a) * (b - c))]
    return np.asarray(np.array([*weights, 1.0 - sum(weights)]) @ y)


def _peak(x: Floats, y: Floats) -> float:
    """Return the largest value of a curve, by a parabola."""
    k = min(max(int(np.argmax(y)), 1), y.size - 2)
    curve = np.polyfit(x[k - 1 : k + 2] - x[k], y[k - 1 : k + 2], 2)
    top = float(curve[2] - curve[1] ** 2 / (4.0 * curve[0])) if curve[0] < 0.0 else float(y[k])
    return max(top, float(y[k]))


def nameplate_prior(
    system: System, plate: Nameplate, names: Sequence[str] = (), values: Mapping[str, Value] | None = None
) -> JointPrior:
    """Return the parameters that a nameplate gives, as a prior.

    The system is one FMU with a declaration beside it, ``<Model>.nameplate.toml``. Free parameters are by default all
    of the declaration's starts. `InputError`: there is no declaration, or no machine with such a nameplate.
    """
    declared = machine_of(system)
    if declared is None or not declared.starts:
        place = f"{system.label.removesuffix('.fmu')}.nameplate.toml"
        raise InputError(f"no starts by a nameplate. Declare them in {place} beside the FMU.")
    free = [name for name in declared.starts if not names or name in names]
    if not free:
        raise InputError(f"none of {', '.join(declared.starts)} is a free parameter. Add one to [parameters].")
    printed = plate.printed
    known = {name: np.array([each.value]) for name, each in printed.items()}
    known |= {"Z": known["U"] / 3.0**0.5 / known["I"], "w": 2.0 * np.pi * known["f"]}

    def column(name: str) -> Floats:
        if name not in known:
            raise InputError(f"{declared.path}: starts: unknown quantity {name!r}. Use {', '.join(known)}.")
        return known[name]

    starts = {name: float(evaluate(declared.starts[name], column, 1)[0]) for name in free}
    made = _Plate(system, plate, free, values or {})
    parameters = {
        name: Parameter(start, min=SETTINGS.least * start, prior=Normal(start, SETTINGS.spread * start))
        for name, start in starts.items()
    }
    parameters["slip"] = Parameter(plate.slip.value, min=float(made.rated[0]), max=float(made.rated[-1]))
    zeros = np.zeros(len(made.compared))
    result = identify(LeastSquares.from_function(made.residual, zeros, parameters, noise=Noise(variance=1.0)))
    if not result.converged:
        raise InputError(f"no machine has this nameplate: {result.outcome.value}. Check its numbers.")
    worst = int(np.argmax(np.abs(made.residual(result.values))))
    rest = np.abs(made.residual(result.values))
    if rest[worst] > 5.0:
        name = list(made.compared)[worst]
        raise InputError(f"no machine has this nameplate: {name} differs by {rest[worst]:.0f} σ. Check its numbers.")
    count = len(free)
    covariance = result.covariance[:count, :count] * plate.std_factor**2
    return JointPrior(free, result.values[:count], covariance)
