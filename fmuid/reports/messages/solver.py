"""What FMUs can do, how they are run, and how their derivatives are found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fmuid.models import SolverConfiguration

if TYPE_CHECKING:
    from fmuid.estimation import SensitivityMethod

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
    """Return what an interface can do beyond the obligatory, from what it declares (`FmuSummary.capabilities`)."""
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
    """Return with which interface, integrator, tolerance and step an FMU is run."""
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


def runs_words(runs: Mapping[str, Mapping[str, Any]]) -> str:
    """Return how each component of a model is run, from the fields of its `SolverConfiguration`."""
    told = {name: run_words(SolverConfiguration(**run)) for name, run in runs.items()}
    return "; ".join(f"{name}: {words}" if name else words for name, words in told.items())


def sensitivity_words(used: SensitivityMethod) -> str:
    """Return how the derivatives by the parameters were found."""
    if used.refusal:
        return f"finite differences ({used.method} sensitivities are refused: {used.refusal})"
    return {
        "finite-difference": "finite differences of whole simulations",
        "forward": "the sensitivity system, integrated with the model: "
        + ("differences of its right-hand side" if used.by_differences else "directional derivatives"),
        "fmu": "outputs of the FMU",
    }[used.method]
