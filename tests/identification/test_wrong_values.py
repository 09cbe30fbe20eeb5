"""Values of a wrong kind given to functions: one sentence each, that says what is wanted."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import Parameter
from fmuid.estimation import LeastSquares, Term, equation_error, instrumental_variables, linear_least_squares

COIL = fmuid.datasets.coil()
EXPERIMENT, TIMES = COIL.experiment, np.linspace(0.0, 1.0, 20)
FALLING = Term(np.exp(-TIMES))
FRAME: Any = pd.DataFrame({"time": [0.0, 1.0], "u": [0.0, 1.0], "i": [0.0, 0.1]})
TEXT: Any = "abc"


@cache
def result() -> fmuid.Result:
    return fmuid.identify(COIL.problem())


def equation(target: Any = FALLING, terms: Any = None, cutoff: Any = 1.0, **more: Any) -> object:
    known = {"a": FALLING} if terms is None else terms
    return equation_error(TIMES, target, known, cutoff=cutoff, **more)


def instruments(simulated: Any, **more: Any) -> object:
    return instrumental_variables(TIMES, Term(FALLING.values, 1), {"a": FALLING}, simulated, cutoff=1.0, **more)


WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "record": (lambda: fmuid.predict(result(), FRAME), "must be a fmuid.Experiment.*, not a DataFrame"),
    "result": (lambda: fmuid.predict(TEXT, EXPERIMENT), "must be a fmuid.Result, not a str"),
    "model": (lambda: fmuid.predict(result(), EXPERIMENT, FRAME), "the path of one, not a DataFrame"),
    "level": (lambda: fmuid.predict(result(), EXPERIMENT, level=TEXT), "level of a band must lie between"),
    "free": (lambda: fmuid.predict(result(), EXPERIMENT, free=["Q"]), "no parameter 'Q'"),
    "free value": (lambda: fmuid.predict(result(), EXPERIMENT, free={"L": 1.0}), "'L' is free and must be"),  # type: ignore[dict-item]
    "values": (lambda: fmuid.predict(result(), EXPERIMENT, values=["L"]), "values must be a mapping"),  # type: ignore[arg-type]
    "step": (
        lambda: fmuid.Problem(COIL.fmu, EXPERIMENT, COIL.parameters, step_size=TEXT),
        "step_size must be a positive",
    ),
    "table": (lambda: fmuid.Problem(COIL.fmu, FRAME, COIL.parameters), "an experiment must be a fmuid.Experiment"),
    "parameters": (lambda: fmuid.Problem(COIL.fmu, EXPERIMENT, ["R"]), "parameters must be a mapping of names"),  # type: ignore[arg-type]
    "noise": (lambda: fmuid.Problem(COIL.fmu, EXPERIMENT, COIL.parameters, noise=TEXT), "noise must be a fmuid.Noise"),
    "joint prior": (
        lambda: fmuid.Problem(COIL.fmu, EXPERIMENT, COIL.parameters, joint_prior=TEXT),
        "joint_prior must be a fmuid.JointPrior, not a str",
    ),
    "simulated": (lambda: fmuid.Simulator(COIL.fmu, FRAME), "an experiment must be a fmuid.Experiment"),
    "identified": (lambda: fmuid.identify(FRAME), "must be a fmuid.Problem, not a DataFrame"),
    "start": (lambda: fmuid.identify(COIL.problem(), start=TEXT), "start must be numbers .*, not 'abc'"),
    "settings": (lambda: fmuid.identify(COIL.problem(), TEXT), "optimizer must be fmuid.Marquardt"),
    "compared": (
        lambda: fmuid.compare_models([result(), result()]),  # type: ignore[list-item]
        "must be fmuid.identification.ModelCandidate.*, not a Result",
    ),
    "function": (
        lambda: LeastSquares.from_function(abs, TEXT, {"a": Parameter(1.0)}),
        "measured must be numbers",
    ),
    "regressors": (
        lambda: linear_least_squares(TEXT, [1.0]),
        "regressors must be numbers .*, not 'abc'",
    ),
    "ragged": (lambda: linear_least_squares([[1.0], [1.0, 2.0]], [1.0, 2.0]), "rows of one length"),
    "measured": (lambda: linear_least_squares([[1.0], [2.0]], TEXT), "measured must be numbers"),
    "names": (lambda: linear_least_squares([[1.0], [2.0]], [1.0, 2.0], TEXT), "names must be a list"),
    "interval": (
        lambda: linear_least_squares(np.eye(3)[:, :1] + 1, [1.0, 2.0, 3.0]).intervals(TEXT),
        "level",
    ),
    "cutoff": (lambda: equation(cutoff=TEXT), "cutoff must be a positive number of rad/s, not 'abc'"),
    "no terms": (lambda: equation(terms={}), "terms are missing: name each parameter with the term"),
    "order": (lambda: equation(order=1.5), "order must be 1, 2"),
    "target": (lambda: equation(TIMES), "target must be a fmuid.estimation.Term"),
    "terms": (lambda: equation(terms=[FALLING]), "terms must be a mapping of parameters"),
    "term": (lambda: equation(terms={"a": TIMES}), "the term of 'a' must be a fmuid.estimation.Term"),
    "term values": (lambda: equation(Term(TEXT)), "the values of a term must be numbers"),
    "derivative": (lambda: Term(TIMES, derivative=TEXT), "derivative must be 0, 1"),
    "no function": (lambda: instruments(3), "simulated must be a function of theta"),
    "no mapping": (lambda: instruments(lambda _: [FALLING]), "what simulated returns must be a mapping"),
    "no term": (lambda: instruments(lambda _: {"a": TIMES}), "the term of 'a' must be a fmuid.estimation.Term"),
    "theta": (lambda: instruments(abs, start=TEXT), "start must be numbers"),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_sentence_says_what_is_wanted(case: str) -> None:
    call, words = WRONG[case]
    with pytest.raises(fmuid.InputError, match=words):
        call()
