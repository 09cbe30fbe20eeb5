"""Values of a wrong kind given to functions: one sentence each, that says what is wanted."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import Parameter
from fmuid.estimation import LeastSquares, Term, equation_error

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


WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "record": (lambda: fmuid.predict(result(), FRAME), "must be a fmuid.Experiment.*, not a DataFrame"),
    "result": (lambda: fmuid.predict(TEXT, EXPERIMENT), "must be a fmuid.Result, not a str"),
    "model": (lambda: fmuid.predict(result(), EXPERIMENT, FRAME), "the path of one, not a DataFrame"),
    "values": (lambda: fmuid.predict(result(), EXPERIMENT, values=["L"]), "values must be a mapping"),  # type: ignore[arg-type]
    "table": (lambda: fmuid.Problem(COIL.fmu, FRAME, COIL.parameters), "an experiment must be a fmuid.Experiment"),
    "parameters": (lambda: fmuid.Problem(COIL.fmu, EXPERIMENT, ["R"]), "parameters must be a mapping of names"),  # type: ignore[arg-type]
    "noise": (lambda: fmuid.Problem(COIL.fmu, EXPERIMENT, COIL.parameters, noise=TEXT), "noise must be a fmuid.Noise"),
    "identified": (lambda: fmuid.identify(FRAME), "must be a fmuid.Problem, not a DataFrame"),
    "start": (lambda: fmuid.identify(COIL.problem(), start=TEXT), "start must be numbers .*, not 'abc'"),
    "compared": (
        lambda: fmuid.compare_models([result(), result()]),  # type: ignore[list-item]
        "must be fmuid.identification.ModelCandidate.*, not a Result",
    ),
    "function": (lambda: LeastSquares.from_function(abs, TEXT, {"a": Parameter(1.0)}), "measured must be numbers"),
    "cutoff": (lambda: equation(cutoff=TEXT), "cutoff must be a positive number of rad/s, not 'abc'"),
    "term": (lambda: equation(terms={"a": TIMES}), "the term of 'a' must be a fmuid.estimation.Term"),
    "derivative": (lambda: Term(TIMES, derivative=TEXT), "derivative must be 0, 1"),
}


@pytest.mark.parametrize(("call", "words"), WRONG.values(), ids=WRONG)
def test_one_sentence_says_what_is_wanted(call: Callable[[], object], words: str) -> None:
    with pytest.raises(fmuid.InputError, match=words):
        call()
