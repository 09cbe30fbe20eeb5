"""Solver error: configuration, effect on the estimates, refinement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fmuid.estimation import (
    SHIFT_LIMIT,
    AccuracyOutcome,
    Doubt,
    Reason,
    RefinementRefusal,
    RefinementStep,
    RunFields,
    SensitivityMethod,
    SolverCheck,
    SwitchCause,
)
from fmuid.formatting import listed
from fmuid.models import SolverConfiguration
from fmuid.reports.chart import LIMITS, Axis, Data, Layer, kinds, rows_of
from fmuid.reports.document import Message, Remark, Section, Tone, doubt, plain

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
    "canSerializeFMUstate": "serializes its state",
    "canSerializeFMUState": "serializes its state",
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


class SolverMessage(Message, section="accuracy"):
    """Solver error of the estimates, and solver refinement."""

    PASSED = plain("Solver error is below {shift} σ.")
    PASSED_OUTPUTS = plain("Solver error changes all outputs by {change} σ of the noise.")
    CHECKED = plain("Solver check: {finer}.")
    REFINED = plain("Solver refined to {after}: {reason}.")
    REFUSED = plain("{count} other optima exist only with the inaccurate solver.")
    SHIFTED = plain("Solver error moves {shifts}; σ includes it.")
    ASKED = plain(
        "The solver was kept as the study sets it.", remedy="Leave `interface`, `tolerance` and `solver_check` unset."
    )
    FITS_BETTER = plain(
        "The solver was kept: a more accurate one fits clearly worse.", "the data may come from this very solver"
    )
    NO_SEARCH = plain("The solver was kept: the fit with a more accurate one did not terminate.")
    FINEST = plain("The solver was kept: no more accurate one exists.", remedy="Reduce `step_size`.")
    UNKNOWN = doubt(
        "Solver error is unknown; it changes all outputs by {change} σ of the noise.",
        remedy="First make all parameters identifiable.",
    )
    UNCHECKABLE = doubt(
        "Solver error is unknown: no more accurate solver exists.",
        "a Co-Simulation FMU without settings",
        "Export the FMU for Model Exchange.",
    )
    FIXED_STEP = doubt(
        "Solver error is unknown: the FMU ignores shorter communication steps.",
        "its internal step is fixed",
        "Export the FMU for Model Exchange.",
    )
    COUPLED = plain(
        "Solver error is unknown: communication steps of a quarter move {shifts}.",
        "an error, or a sampled controller that acts more often",
        "Set `discrete_time` to true or false for each component.",
    )
    FAILED = doubt(
        "Solver error is unknown: {finer} fails at the estimates.", remedy="Export the FMU for Model Exchange."
    )
    SUGGESTED = doubt(
        "Solver error is unknown; half the communication step suggests {shifts}.",
        "twice its shift, by Richardson at order 1; shorter steps fail",
        "Export the FMU for Model Exchange.",
    )
    INTERRUPTED = doubt("Solver error was not checked: interrupted.")
    RUN = plain("{model}: {run}.")
    SENSITIVITIES = plain("Jacobian: {how}.")


class UncheckedMessage(Message, section="accuracy"):
    """Reasons of an unknown solver error, by `AccuracyOutcome`."""

    UNKNOWN = "an estimate has no σ"
    UNCHECKABLE = "shorter communication steps change nothing"
    COUPLED = "shorter communication steps suggest {bound}"
    FAILED = "shorter communication steps fail"
    SUGGESTED = "half the communication step suggests {bound}"
    INTERRUPTED = "its check was interrupted"


def solver_remedy(found: Doubt) -> str:
    """Return the remedy of a solver error: of its check, or of the reason that kept the solver."""
    if found.reason is Reason.SOLVER_UNCHECKED:
        return SolverMessage[AccuracyOutcome(found.subject[0]).name].remedy
    return SolverMessage[RefinementRefusal(found.subject[1]).name].remedy if len(found.subject) > 1 else ""


def unchecked_words(found: Doubt) -> str:
    """Return the reason of an unknown solver error, or its bound."""
    outcome, bound = AccuracyOutcome(found.subject[0]), found.values.get("bound")
    message = UncheckedMessage[outcome.name]
    if bound is None:
        return message.text.format(bound="an unknown error")
    message = UncheckedMessage.SUGGESTED if outcome is AccuracyOutcome.FAILED else message
    return message.text.format(bound=f"{max(bound, LEAST_SHOWN):.2g} σ")


def run_words(run: SolverConfiguration) -> str:
    """Return interface, solver, tolerance and step of an FMU."""
    interface = {"co-simulation": "Co-Simulation", "model-exchange": "Model Exchange"}.get(run.interface, run.interface)
    words = f"FMI {run.fmi_version} {interface}"
    if run.integrator is not None:
        words += f", {run.integrator}" + (" (rk45 found the model stiff)" if run.stiff else "")
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
        return f"finite differences ({used.method} refused: {used.refusal})"
    return {
        "finite-difference": "finite differences of whole simulations",
        "forward": "sensitivity equations, with "
        + ("differences of the right-hand side" if used.by_differences else "directional derivatives"),
        "fmu": "outputs of the FMU",
    }[used.method]


LEAST_SHOWN = 0.005  # smallest shift that is shown, σ


def solver_remarks(names: Sequence[str], found: SolverCheck | None) -> list[Remark]:
    """Return the remarks on solver refinement and solver error."""
    if found is None:
        return []
    said = list(map(_refinement, found.switches))
    said += [SolverMessage.REFUSED.said(count=found.refused)] if found.refused else []
    return [*said, *_outcome(names, found, runs_words(found.finer))]


def _refinement(switch: RefinementStep) -> Remark:
    before = runs_words(switch.before)
    match switch.cause:
        case SwitchCause.START_FAILED:
            reason = f"{before} fails at the initial guess"
        case SwitchCause.START_DIFFERED:
            reason = f"{before} is off by {100 * switch.size:.2g} % of the signal"
        case _:
            reason = f"error was {switch.size:.2g} σ" if switch.size > SHIFT_LIMIT else "its error may exceed σ"
    return SolverMessage.REFINED.said(after=runs_words(switch.after), reason=reason)


def _outcome(names: Sequence[str], found: SolverCheck, finer: str) -> list[Remark]:
    values = {"finer": finer, "change": f"{found.change:.1g}", "shifts": _shifts(names, found)}
    match found.outcome:
        case AccuracyOutcome.PASSED if not finer:
            return []
        case AccuracyOutcome.PASSED:
            known = not math.isnan(found.largest)
            values["shift"] = f"{max(found.largest, LEAST_SHOWN):.1g}"
            message = SolverMessage.PASSED if known else SolverMessage.PASSED_OUTPUTS
            return [message.said(**values), SolverMessage.CHECKED.said(finer=finer)]
        case AccuracyOutcome.SHIFTED:
            tone: Tone = "doubt" if found.doubtful else "plain"
            messages = [SolverMessage.SHIFTED, *([SolverMessage[found.kept.name]] if found.kept else [])]
            return [each.said(None, tone, **values) for each in messages]
        case AccuracyOutcome.FAILED if math.isfinite(found.change):
            return [SolverMessage.SUGGESTED.said(**values)]
        case AccuracyOutcome.UNCHECKABLE if finer:
            return [SolverMessage.FIXED_STEP.said()]
    return [SolverMessage[found.outcome.name].said(**values)]


def _shifts(names: Sequence[str], found: SolverCheck) -> str:
    pairs = zip(names, found.shift.tolist(), strict=True)
    moved = [f"{name} by {shift:+.2g} σ" for name, shift in pairs if abs(shift) > SHIFT_LIMIT]
    return listed(moved) if moved else f"all outputs by {found.change:.2g} σ of the noise"


def shift_text(shift: float) -> str:
    """Return a shift in σ for a table, "?" if unknown."""
    if math.isnan(shift):
        return "?"
    return f"{shift:+.2f} σ" if abs(shift) >= LEAST_SHOWN else "0.0 σ"


CAPTION = (
    "Shift of each estimate by a more accurate simulation, in its standard deviations. In the band it affects no "
    "interval."
)


def solver_section(estimates: pd.DataFrame) -> list[Section]:
    """Return the solver error of each estimate in σ, if known."""
    known = estimates[np.isfinite(estimates["solver_error"].astype(float))].iloc[: LIMITS.parameters]
    if not len(known):
        return []
    names, shifts = tuple(map(str, known["parameter"])), known["solver_error"].to_numpy(np.float64)
    most = max(1.5 * SHIFT_LIMIT, 1.15 * float(np.abs(shifts).max(initial=0.0)))
    large, hover = np.abs(shifts) > SHIFT_LIMIT, (("parameter", "@y"), ("shift", "@x{0.000000} σ"))
    lines: Data = {"x0": 0.0, "y0": names, "x1": shifts, "y1": names}
    dots: Data = {"x": shifts, "y": names}
    layers = [
        Layer("zone", {"left": -SHIFT_LIMIT, "right": SHIFT_LIMIT}, alpha=0.14),
        Layer("rule", {"x": 0.0}, "ink"),
        *kinds("segments", lines, [("", "blue", ~large), ("", "red", large)], width=2),
        *kinds("points", dots, [("harmless", "blue", ~large), ("above 0.1 σ", "red", large)], size=8, hover=hover),
    ]
    axis = Axis("shift by a more accurate simulation (σ of the estimate)", reach=(-most, most))
    return [Section("accuracy", "Solver error", CAPTION, charts=(rows_of(names, axis, layers, 90),), beside=1)]
