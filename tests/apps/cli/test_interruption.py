"""Ctrl-C and SIGTERM keep what there is, the first is answered, and nothing is lost to a full disk."""

import errno
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, WRONG_INPUT
from fmuid.apps.cli.signals import answering, handled, stopping
from fmuid.estimation import Evaluator, LeastSquares
from fmuid.identification import conditional_optimum
from fmuid.reports.render import progress
from tests.support.coil_study import STUDY, fmuid_, result
from tests.support.interrupting import SIGNALS, command, killing

pytestmark = pytest.mark.usefixtures("blank_figures")

GLOBAL = '[estimation]\nmethod = "differential-evolution"\n'
ANSWER = "interrupted: saving the results so far (Ctrl-C again: stop without)"


# --- signals -----------------------------------------------------------------------------


@pytest.mark.parametrize("number", SIGNALS)
def test_a_search(folder: Path, number: int, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """With what does not count not simulated any more: who interrupts a slow search waits for nothing."""
    shown, simulations, after = progress.Display.__call__, list[bool](), [False]

    def when(_: object, step: Any) -> bool:
        after[0] = after[0] or getattr(step, "number", 0) == 2
        return after[0]

    def simulated(self: Evaluator[LeastSquares], *arguments: Any) -> Any:
        simulations.append(after[0])
        return original(self, *arguments)

    original = Evaluator._simulated
    monkeypatch.setattr(progress.Display, "__call__", killing(number, when, shown))
    monkeypatch.setattr(Evaluator, "_simulated", simulated)
    (folder / "study.toml").write_text(STUDY.replace("[parameters]", "warmup = 0.01\n[parameters]"))
    assert command("identify", folder / "study.toml") == NOT_SUCCEEDED
    assert capsys.readouterr().err == ANSWER + "\n"
    found = result(folder / "results")
    assert (found["outcome"], found["converged"]) == ("interrupted", False)
    assert found["parameters"]["R"]["value"] != 6.0
    assert (folder / "results/report.html").is_file()
    assert simulations
    assert not any(simulations)


def test_a_global_search(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """Before there was any fit: the best of the points tried, from which --resume searches on."""
    text = STUDY.replace("min = 0.0", "min = 0.0, max = 20.0").replace("1e-3", "1e-3, max = 1.0")
    (folder / "study.toml").write_text(text)
    assert fmuid_("identify", folder / "study.toml") == DONE
    (folder / "results/mine.csv").write_text("")
    shown = progress.Display.__call__

    def when(_: object, step: Any) -> bool:
        return bool(step.done == 2)

    capsys.readouterr()
    (folder / "study.toml").write_text(text + GLOBAL)
    with monkeypatch.context() as disturbed:
        disturbed.setattr(progress.Display, "__call__", killing(signal.SIGINT, when, shown))
        assert command("identify", folder / "study.toml") == NOT_SUCCEEDED
    out, error = capsys.readouterr()
    assert error == ANSWER + "\n"
    assert "Interrupted after 0 fits of a global search: best values so far." in out
    found = result(folder / "results")
    assert (found["outcome"], found["converged"]) == ("interrupted", False)
    assert found["parameters"]["R"]["std"] == "inf"
    left = {path.name for path in (folder / "results").rglob("*") if path.is_file()}
    assert left == {"result.json", "estimates.csv", "document.json", "mine.csv"}
    assert fmuid_("identify", folder / "study.toml", "--resume") == DONE
    assert result(folder / "results")["parameters"]["R"]["start"] == found["parameters"]["R"]["value"]


def test_before_the_search(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """What an earlier run has found stays."""
    assert fmuid_("identify", folder / "study.toml") == DONE
    before = (folder / "results/result.json").read_bytes()
    capsys.readouterr()
    monkeypatch.setattr(Evaluator, "_rows", killing(signal.SIGTERM, lambda *_: True, Evaluator._rows))
    assert command("identify", folder / "study.toml") == NOT_SUCCEEDED
    said = "error: interrupted before any improvement: nothing is written"
    assert capsys.readouterr().err.splitlines() == [ANSWER, said]
    assert (folder / "results/result.json").read_bytes() == before


@pytest.mark.parametrize("number", SIGNALS)
def test_what_follows(folder: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C leaves out the search of the data alone; SIGTERM the uncertainty that the study asks for too."""
    text = STUDY.replace("min = 0.0", "min = 0.0, prior = { mean = 4.0, std = 1.0 }")
    (folder / "study.toml").write_text(text + '[uncertainty]\nprofile_likelihood = ["L"]\n')
    monkeypatch.setattr(
        "fmuid.identification.prior_and_data.cost_at", killing(number, lambda *_: True, conditional_optimum.cost_at)
    )
    assert command("identify", folder / "study.toml") == (DONE if number == signal.SIGINT else NOT_SUCCEEDED)
    found = result(folder / "results")
    assert found["outcome"] == "converged"
    assert bool(found["assessment"]["profiles"]) == (number == signal.SIGINT)


def test_handling(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """Several signals are one request where they come together; only Ctrl-C ends what is being saved."""
    now = [100.0]
    monkeypatch.setattr("fmuid.apps.cli.signals.time.monotonic", lambda: now[0])
    with handled(), answering("saving"):
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
        assert stopping()
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
        now[0] += 5.0
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert capsys.readouterr().err == "interrupted: saving\n"
    with handled():
        assert not stopping()


def test_what_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        with handled():
            os.kill(os.getpid(), signal.SIGTERM)
            assert signal.getsignal(signal.SIGINT) != before
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, before)


# --- a full disk -------------------------------------------------------------------------


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_no_room_for_figures(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """One sentence, what was saved before is told, and no half file is left."""
    written: Any = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda self, to, **rest: full() if "residuals" in str(to) else written(self, to, **rest)
    )
    assert fmuid_("identify", folder / "study.toml", "--figures", "png") == WRONG_INPUT
    out, error = capsys.readouterr()
    figure = folder / "results/figures/residuals.png"
    remedy = "make room, or choose another folder with --output"
    assert error == f"error: {figure} cannot be written: No space left on device; {remedy}\n"
    assert f"Written to {folder}/results/: result.json, estimates.csv, trace.csv" in out
    assert f"Written to {folder}/results/figures/: forest.png, hiding.png, fit.png" in out
    assert {path.name for path in figure.parent.iterdir()} == {"forest.png", "hiding.png", "fit.png"}
