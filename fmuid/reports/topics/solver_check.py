"""Solver error: configuration, effect on the estimates, refinement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.array_types import Flags
from fmuid.estimation import (
    SHIFT_LIMIT,
    AccuracyOutcome,
    RefinementRefusal,
    RefinementStep,
    RunFields,
    SensitivityMethod,
    SolverCheck,
    SwitchCause,
)
from fmuid.models import SolverConfiguration
from fmuid.reports.chart import LIMITS, Axis, Color, Data, Layer, picked, rows_of
from fmuid.reports.document import Section

# Attributes of <CoSimulation>, <ModelExchange> and <ScheduledExecution> in words (FMI 2.0.4, sections 3.3.1 and 4.3.1;
# FMI 3.0.2, section 2.4.8). The versions of the standard spell some names differently.
_CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": "variable communication steps",
    "canInterpolateInputs": "interpolates inputs",
    "hasEventMode": "event mode",
    "canReturnEarlyAfterIntermediateUpdate": "early return on demand",
    "mightReturnEarlyFromDoStep": "may return early from a step",
    "providesIntermediateUpdate": "intermediate update",
    "needsCompletedIntegratorStep": "is told completed steps",
    "canGetAndSetFMUstate": "gets and sets its state",
    "canGetAndSetFMUState": "gets and sets its state",
    "canSerializeFMUstate": "serialises its state",
    "canSerializeFMUState": "serialises its state",
    "providesDirectionalDerivative": "directional derivatives",
    "providesDirectionalDerivatives": "directional derivatives",
    "providesAdjointDerivatives": "adjoint derivatives",
    "canBeInstantiatedOnlyOncePerProcess": "once per process",
    "needsExecutionTool": "needs its tool",
}


def capability_words(interface: str, declared: Mapping[str, str]) -> list[str]:
    """Return the optional capabilities of an FMU interface."""
    given = {name for name, value in declared.items() if value.strip() in ("true", "1")}
    words = [word for name, word in _CAPABILITIES.items() if name in given]
    if interface == "co-simulation":
        if "canHandleVariableCommunicationStepSize" not in given:
            words.insert(0, "communication steps of one length")
        if declared.get("fixedInternalStepSize"):
            words.append(f"internal steps of {declared['fixedInternalStepSize']} s")
        if declared.get("maxOutputDerivativeOrder", "0") != "0":
            words.append(f"derivatives of outputs to order {declared['maxOutputDerivativeOrder']}")
    return list(dict.fromkeys(words))


def run_words(run: SolverConfiguration) -> str:
    """Return interface, solver, tolerance and step of an FMU."""
    words = f"FMI {run.fmi_version} {run.interface}"
    if run.integrator is not None:
        words += f", integrator {run.integrator}" + (" (rk45 found the model stiff)" if run.stiff else "")
    if run.tolerance is not None:
        words += f", tolerance {run.tolerance:g}"
    if run.step_size is not None:
        words += f", steps of at most {run.step_size:g} s"
    if run.divisor > 1:
        words += f", each step divided by {run.divisor}"
    return words + (", in a new process for each simulation" if run.new_processes else "")


def runs_words(runs: Mapping[str, RunFields]) -> str:
    """Return the configuration of each component."""
    told = {name: run_words(SolverConfiguration(**run)) for name, run in runs.items()}
    return "; ".join(f"{name}: {words}" if name else words for name, words in told.items())


def sensitivity_words(used: SensitivityMethod) -> str:
    """Return the method of the sensitivities."""
    if used.refusal:
        return f"finite differences ({used.method} sensitivities are refused: {used.refusal})"
    return {
        "finite-difference": "finite differences of whole simulations",
        "forward": "the sensitivity system, integrated with the model: "
        + ("differences of its right-hand side" if used.by_differences else "directional derivatives"),
        "fmu": "outputs of the FMU",
    }[used.method]


KEPT = {
    RefinementRefusal.ASKED: (
        "it is simulated as it was asked for: leave interface, tolerance and accuracy open for a finer search"
    ),
    RefinementRefusal.FITS_BETTER: (
        "the finer simulation fits clearly worse, as if the table came from this very solver"
    ),
    RefinementRefusal.NO_SEARCH: "a search by the finer simulation does not end",
    RefinementRefusal.FINEST: "there is no finer simulation to go on by",
}
"""Why a simulation that shifts the estimates serves all the same."""
LEAST_SHOWN = 0.005
"""Standard deviations: a smaller shift is none to a reader."""


def accuracy_words(names: Sequence[str], found: SolverCheck | None) -> tuple[str, ...]:
    """Return the remarks on solver refinement and solver error."""
    if found is None:
        return ()
    finer = runs_words(found.finer)
    others = "another optimum" if found.refused == 1 else f"{found.refused} other optima"
    refused = (
        f"{others} fitted as well, and the finer simulation ({finer}) moves away from "
        f"{'it' if found.refused == 1 else 'them'}: refused"
    )
    words = [*map(_switch, found.switches), *([refused] if found.refused else []), _outcome(names, found)]
    return tuple(filter(None, words))


def passed_words(found: SolverCheck) -> str:
    """Return the remark on a passed solver check, else ""."""
    if found.outcome is not AccuracyOutcome.PASSED or not found.finer:
        return ""
    checked = f"simulation checked by {runs_words(found.finer)}"
    if math.isnan(found.largest):  # no estimate has a standard deviation
        return f"{checked}: it changes the outputs by {found.change:.1g} standard deviations in all"
    return f"{checked}: it moves the estimates by {max(found.largest, LEAST_SHOWN):.1g} std at most"


def _switch(switch: RefinementStep) -> str:
    before, after = runs_words(switch.before), runs_words(switch.after)
    if switch.cause is SwitchCause.START_FAILED:
        return f"simulated by {before} the start fails: the search went by {after}"
    if switch.cause is SwitchCause.START_DIFFERED:
        return (
            f"at the start {before} is off by {100 * switch.size:.2g} % of an output's spread: the search went "
            f"by {after}"
        )
    moved = (
        f"moves an estimate by {switch.size:.2g} standard deviations"
        if switch.size > SHIFT_LIMIT
        else "may move an estimate whose standard deviation is not known"
    )
    return f"the error of {before} {moved}: the search went on by {after}, in {switch.simulations} simulations"


def _outcome(names: Sequence[str], found: SolverCheck) -> str:
    used, finer = runs_words(found.used), runs_words(found.finer)
    match found.outcome:
        case AccuracyOutcome.PASSED:
            return ""
        case AccuracyOutcome.SHIFTED:
            why = KEPT.get(found.kept, "") if found.kept else ""
            return (
                "the error of the simulation moves estimates, in the standard deviations of noise: "
                f"{_shifts(names, found)} ({finer} against {used}); that is added to the standard deviations; {why}"
            )
        case AccuracyOutcome.UNKNOWN:
            return (
                "what the error of the simulation moves the estimates by is not known, as not all have a standard "
                f"deviation; {finer} changes the outputs by {found.change:.2g} standard deviations in all"
            )
        case AccuracyOutcome.UNCHECKABLE:
            why = (
                "in shorter steps the FMU gives the same outputs to the last bit, as it steps inside at its own length"
                if found.finer
                else "nothing finer is offered"
            )
            return f"the error of the simulation cannot be checked: {why}"
        case AccuracyOutcome.COUPLED:
            return (
                "the error of the simulation is not known: a quarter of the communication step would move "
                f"{_shifts(names, found)} (standard deviations), and the FMUs do not tell whether for less error or "
                "because a sampled controller would act more often; give samples = true for the components that act "
                "once a step, or samples = false where none does"
            )
        case AccuracyOutcome.FAILED:
            return f"the error of the simulation is not known: {finer} fails at the estimates"
        case AccuracyOutcome.INTERRUPTED:
            return "the error of the simulation was not checked: interrupted"


def _shifts(names: Sequence[str], found: SolverCheck) -> str:
    pairs = zip(names, found.shift.tolist(), strict=True)
    moved = ", ".join(f"{name} by {shift:+.2g}" for name, shift in pairs if abs(shift) > SHIFT_LIMIT)
    return moved or f"the outputs by {found.change:.2g} in all"


def shift_text(shift: float) -> str:
    """Return a shift in σ for a table, "?" if unknown."""
    if math.isnan(shift):
        return "?"
    return f"{shift:+.2f}" if abs(shift) >= LEAST_SHOWN else "0"


CAPTION = (
    "Each estimate's shift if the finer simulation took the place of the one used, in its standard "
    "deviations. In the band it spoils no interval."
)


def solver_section(estimates: pd.DataFrame) -> list[Section]:
    """Return the solver error of each estimate in σ, if known."""
    shift = estimates["solver_error"].astype(float)
    known = estimates[np.isfinite(shift)].iloc[: LIMITS.parameters]
    if not len(known):
        return []
    names, shifts = tuple(map(str, known["parameter"])), known["solver_error"].to_numpy(np.float64)
    most = max(1.5 * SHIFT_LIMIT, 1.15 * float(np.abs(shifts).max(initial=0.0)))
    layers = [Layer("zone", {"left": -SHIFT_LIMIT, "right": SHIFT_LIMIT}, alpha=0.14), Layer("rule", {"x": 0.0}, "ink")]
    large, hover = np.abs(shifts) > SHIFT_LIMIT, (("parameter", "@y"), ("shift", "@x{0.000000} std"))
    kinds: tuple[tuple[Flags, Color, str], ...] = ((~large, "blue", "harmless"), (large, "red", "larger than a tenth"))
    for mine, color, text in kinds:
        if mine.any():
            some = picked({"x": shifts, "y": names}, mine)
            lines: Data = {"x0": 0.0, "y0": some["y"], "x1": some["x"], "y1": some["y"]}
            layers.append(Layer("segments", lines, color, width=2))
            layers.append(Layer("points", some, color, size=8, label=text, hover=hover))
    axis = Axis("shift under the finer simulation (std of the estimate)", reach=(-most, most))
    return [
        Section("accuracy", "Error of the simulation", CAPTION, charts=(rows_of(names, axis, layers, 90),), beside=1)
    ]
