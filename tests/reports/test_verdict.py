"""The line of a verdict, whatever its parameters are called; rows of assumptions and their effects."""

from dataclasses import replace

import pytest

from fmuid import Study
from fmuid.estimation import AccuracyOutcome, Doubt, Reason, Verdict
from fmuid.identification import DefectKind, ErrorKind
from fmuid.reports.topics.assumption_rows import assumption_rows, guessed_keys
from fmuid.reports.topics.verdict import STATES, VerdictMessage, reason_words, remedy_words
from fmuid.runs import identified
from tests.support.coil_study import STUDY, coil_table

DEFECTS = {"frequency": 50.0, "ratio": 2.4, "limit": 5.0, "samples": 9.0, "share": 0.31, "factor": 2.2}
DEFECTS |= {"row": 7.0, "rows": 2.0, "size": 12.0, "fit": 99.6}
BOUNDED = (AccuracyOutcome.FAILED.value, AccuracyOutcome.COUPLED.value)
VALUES = {"fit": 12.4, "ratio": 5.42, "shift": 0.81, "probability": 3e-4, "widening": 1.9}


def test_reasons_and_messages_are_the_same_in_one_order() -> None:
    assert [each.name for each in VerdictMessage] == [each.name for each in Reason]


ERROR = {"size": 0.021, "std": 0.004, "shift": 3.2}
OPEN = [each.value for each in AccuracyOutcome if each.name not in ("PASSED", "SHIFTED")]
NAMED = (Reason.MODEL_ERROR, Reason.DATA_DEFECT, Reason.CONVENTION, Reason.SOLVER_UNCHECKED)  # by their kinds
DOUBTS = [Doubt(Reason.MODEL_ERROR, (kind.value, "R", "V", "u", "i"), ERROR) for kind in ErrorKind]
DOUBTS += [Doubt(Reason.DATA_DEFECT, (kind.value, "i", "run"), DEFECTS) for kind in DefectKind]
DOUBTS += [Doubt(Reason.SOLVER_UNCHECKED, (each,), values) for each in OPEN for values in ({}, {"bound": 13.0})]
DOUBTS += [Doubt(each, names, VALUES) for each in Reason if each not in NAMED for names in (("y", "run", "u"), ())]


@pytest.mark.parametrize("doubt", DOUBTS, ids=lambda each: " ".join((each.reason.value, *each.subject[:1])))
def test_each_reason_is_said(doubt: Doubt) -> None:
    others = [replace(doubt, subject=("x", "run", "v"))] if doubt.values == VALUES and doubt.subject else []
    words = reason_words(Verdict((doubt, *others)))
    assert words and "{" not in words
    if doubt.reason is Reason.MODEL_ERROR:
        words, remedy = (said(Verdict((doubt,))) for said in (reason_words, remedy_words))
        assert remedy and "{" not in remedy
        assert reason_words(Verdict((), (doubt,))) == f"freed: {words}"
    if doubt.reason is Reason.SOLVER_UNCHECKED:
        assert words.startswith("solver error unknown: ")
        assert "13 σ" in words or not doubt.values or doubt.subject[0] not in BOUNDED


def test_a_line_has_two_reasons_and_counts_the_others() -> None:
    verdict = Verdict.of(
        [
            Doubt(Reason.SECOND_OPTIMUM, (), {"inputs": 1.0, "first": 2.0, "subjects": 3.0}),  # names of parameters
            Doubt(Reason.AT_BOUND, ("R",)),
            Doubt(Reason.AT_BOUND, ("L",)),
            Doubt(Reason.INPUT_CORRELATION, ("y", "run", "u")),
        ]
    )
    assert STATES[verdict.grade] == ("DOUBTFUL", "doubt")
    assert reason_words(verdict) == "model misses effects of u; R and L at a bound; 1 more"
    assert reason_words(Verdict()) == ""


GUESSED = STUDY.replace('= "zoh"', '= "zoh"  # guessed from constant stretches')


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, str]]:
    folder = tmp_path_factory.mktemp("assumed")
    coil_table(folder / "first.csv", 0.0, seed=1)
    path = folder / "study.toml"
    path.write_text(GUESSED.replace("[parameters]", "warmup = 0.01\nfixed = { i_start = 0.0 }\n[parameters]"))
    (found,) = identified(Study.read(path, isolated=False), folder / "results")
    return {name: (value, effect) for name, value, effect in assumption_rows(found)}


def test_assumptions_are_listed(rows: dict[str, tuple[str, str]]) -> None:
    assert rows["u between samples"][0] == "held, guessed"
    assert "the other moves" in rows["u between samples"][1]
    assert rows["warm-up"] == ("0.01 s", "simulated, not scored")
    assert rows["i_start"] == ("0.0", "fixed in this experiment")
    assert rows["time unit"][0] == "that of the data file, else s"
    assert rows["noise of i"][0].endswith("variance estimated")
    assert rows["solver"][0].startswith("FMI 2.0 Co-Simulation")
    assert rows["solver"][1].endswith("σ at most")
    assert "A of i moves" in rows["initial state"][1]
    assert "±½ sample" in rows["delay of outputs"][0]


def test_guesses_are_those_of_init() -> None:
    assert guessed_keys(GUESSED) == {"interpolation"}
    assert guessed_keys('a = 1  # free\ninputs = ["u"]  # guessed: u\n# guessed nothing = 2') == {"inputs"}
