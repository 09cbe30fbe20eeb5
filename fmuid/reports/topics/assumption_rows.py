"""What an identification assumes beside fixed parameters: rows of assumption, value and effect."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fmuid.data import Experiment
from fmuid.estimation import AccuracyOutcome, Result
from fmuid.formatting import listed, two_digits, with_std
from fmuid.identification import ErrorKind, ModelErrors
from fmuid.models import SolverConfiguration
from fmuid.reports.topics.assumptions import size_text
from fmuid.reports.topics.solver_check import LEAST_SHOWN, run_words
from fmuid.runs import IdentificationRun, Provenance

Row = tuple[str, str, str]
ROLES = {"inputs", "outputs"}
MARK = "# guessed"  # comment of ``fmuid init`` at the end of a line


def assumption_rows(found: IdentificationRun) -> list[Row]:
    """Return what was assumed, its value, and its effect."""
    result, errors = found.result, found.assessment.model_errors
    text = "" if found.origin is None or found.origin.study is None else found.origin.study.text
    experiments = result.fit.experiments
    rows = list(_initial_states(experiments, errors))
    rows += _interpolations(experiments, errors, guessed_keys(text))
    if has_open_time_unit(found.origin):
        rows.append(("time unit", "that of the data file, else s", ""))
    rows += [("roles of columns", f"{key} guessed by `fmuid init`", "") for key in guessed_keys(text) & ROLES]
    in_time = any(each.kind == "time" for each in experiments)  # steady states have no solver
    rows += [*_delay(result), *_noise(result), *(_solver(result) if in_time else ())]
    return list(dict.fromkeys(rows))


def has_open_time_unit(origin: Provenance | None) -> bool:
    """Return True if a study gives an experiment no time unit."""
    content = None if origin is None or origin.study is None else origin.study.content
    given = (content or {}).get("experiments", [])
    return any(not {"time_unit", "sample_rate", "kind"} & set(each) for each in given)


def guessed_keys(text: str) -> set[str]:
    """Return the keys of a study file with a guessed value."""
    lines = (line for line in text.splitlines() if MARK in line)
    return {line.partition("=")[0].strip() for line in lines if "=" in line.partition(MARK)[0]}


def _initial_states(experiments: Sequence[Experiment], errors: ModelErrors | None) -> Iterator[Row]:
    if any(each.kind == "time" for each in experiments):
        yield "initial state", "start values of the FMU and the study", _largest(errors, ErrorKind.INITIAL_STATE)
    for each in experiments:
        for name, value in each.values.items():
            where = f" in {each.name}" if len(experiments) > 1 else ""
            yield f"{name}{where}", f"{value}", "fixed in this experiment"
    warmups = sorted({each.warmup for each in experiments if each.warmup > 0.0})
    if warmups:
        yield "warm-up", f"{', '.join(f'{each:g}' for each in warmups)} s", "simulated, not scored"


def _interpolations(experiments: Sequence[Experiment], errors: ModelErrors | None, guessed: set[str]) -> Iterator[Row]:
    words: dict[str, list[str]] = {}
    for each in (one for one in experiments if one.kind == "time"):
        for name, held in zip(each.input_names, each.held.tolist(), strict=True):
            where = f" in {each.name}" if len(experiments) > 1 else ""
            words.setdefault("held" if held else "interpolated", []).append(f"{name}{where}")
    effect = _largest(errors, ErrorKind.INTERPOLATION, "the other")
    for word, names in words.items():
        shown = listed(names) if len(names) <= 6 else f"{len(names)} inputs"
        yield f"{shown} between samples", word + (", guessed" if "interpolation" in guessed else ""), effect


def _largest(errors: ModelErrors | None, kind: ErrorKind, size: str = "") -> str:
    """Return the largest effect of errors of one kind and usual size."""
    tests = () if errors is None else (each for each in errors.exposures if each.direction.kind is kind)
    for each in tests:
        i, shift = each.most
        assert errors is not None, "it has tests"
        usual = size or f"{size_text(each.direction, each.direction.usual)} of {each.direction.subject[0]}"
        return f"{usual} moves {errors.names[i]} by {two_digits(shift * each.direction.usual)} σ"
    return ""


def _delay(result: Result) -> Iterator[Row]:
    delay = result.fit.delay
    if delay is not None:
        i = int(np.argmax(delay.widening))
        effect = f"found {with_std(delay.samples, delay.std)} samples; σ of {result.names[i]} × {delay.widening[i]:.2f}"
        yield "delay of outputs", "within ±½ sample (noise.delay_std)", effect


def _noise(result: Result) -> Iterator[Row]:
    orders: dict[int, list[str]] = {}
    for model in () if result.fit.noise is None else result.fit.noise.models:
        orders.setdefault(model.process.coefficients.size, []).append(model.series.output)
    given = result.fit.given_variance
    for order, outputs in orders.items():
        names = list(dict.fromkeys(outputs))
        shown = listed(names) if len(names) <= 6 else f"{len(names)} outputs"
        word = "given" if all(name in given for name in names) else "estimated"
        color = f"autoregression of order {order}" if order else "white"
        yield f"noise of {shown}", f"{color}, variance {word}", ""


def _solver(result: Result) -> Iterator[Row]:
    check = result.accuracy
    effect = "not checked"
    if check is not None:
        known = check.outcome in (AccuracyOutcome.PASSED, AccuracyOutcome.SHIFTED) and check.largest == check.largest
        effect = f"error {two_digits(max(check.largest, LEAST_SHOWN))} σ at most" if known else "error unknown"
    for name, model in result.setup.models.items():
        if "run" in model:
            run = SolverConfiguration(**model["run"])
            yield f"solver{f' of {name}' if name else ''}", run_words(run), effect
            if run.new_processes:
                memory = f"memory of {name or model['name']}"
                yield memory, "a new process for each simulation", "it cannot be run twice in one process"
