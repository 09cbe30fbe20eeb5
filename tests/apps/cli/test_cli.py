"""The command line from end to end, on coil and machine FMUs with tables of known truth."""

import re
import subprocess
import sys
import warnings
from pathlib import Path

import pandas as pd
import pytest

import fmuid
from fmuid import Study
from fmuid.apps.cli import app as cli
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED, WRONG_INPUT
from fmuid.errors import ModelicaWarning
from fmuid.studies import draft, match_data_files
from tests.support.coil_study import COIL, SECOND, STUDY, fmuid_

pytestmark = pytest.mark.usefixtures("blank_figures")


# --- simulate ----------------------------------------------------------------------------


def test_simulate_several_experiments_and_api(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = folder / "study.toml"
    study.write_text(STUDY + SECOND)
    assert fmuid_("simulate", study, "-o", folder / "out") == DONE
    written = pd.read_csv(folder / "out/simulated.csv")
    frames = Study.read(study).simulate()
    assert len(frames) == 2
    for name, frame in zip(("first", "second"), frames, strict=True):
        part = written[written["experiment"] == name].drop(columns="experiment").reset_index(drop=True)
        pd.testing.assert_frame_equal(part, frame)
    assert fmuid_("simulate", study, "--set", "experiments.0.inputs=[]") == DONE
    assert "no column for u; start value used" in capsys.readouterr().err


# --- info, init, export, help ------------------------------------------------------------


def test_preview_shows_columns_clocks_and_rows_and_writes_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = pd.read_csv(folder / "first.csv")
    frame.insert(2, "t_i", frame["time"] + 1e-5)
    frame.assign(state="on").to_csv(folder / "first.csv", index=False)
    before = sorted(folder.iterdir())
    assert fmuid_("init", COIL, folder / "first.csv", "--output", folder / "new.toml", "--preview") == DONE
    assert sorted(folder.iterdir()) == before
    said = " ".join("".join(capsys.readouterr()).split())
    for words in ("Columns without role: state.", "Several time columns: u at time 1, i at t_i", "First rows as read"):
        assert words in said
    assert re.search(rf"0 0 nan {frame['u'][0]:.6g} nan on", said)
    (folder / "first.csv").write_text((folder / "first.csv").read_text().replace(",i,", ",i [Aeff],", 1))
    assert fmuid_("init", COIL, folder / "first.csv", "--preview") == NOT_SUCCEEDED


def test_every_word_that_init_comments_on_is_one(folder: Path) -> None:
    """With all its comments uncommented, what `fmuid init` writes is a study still."""
    assert fmuid_("identify", folder / "study.toml", "--output", folder / "healthy") == DONE
    made = draft(COIL, match_data_files(COIL, [folder / "first.csv"]), folder / "study.toml")
    text = (
        made.text.replace('"a", "b"', '"R", "L"')
        .replace('"levenberg-marquardt"', '"multi-start"')
        .replace('"soft_l1"', '"linear"')
    )
    words = re.compile(r"^# (?=\[?(?!prior |per_experiment )[a-zA-Z_]+\]?( = |  #))")
    (folder / "study.toml").write_text("\n".join(words.sub("", line) for line in text.splitlines()))
    read = Study.read(folder / "study.toml")
    assert read.joint_prior is not None
    assert read.noise.initial_variance == 0.01
    assert read.uncertainty_settings.maps == (("R", "L"),)


def test_export(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The command passes paths and options on and says where the FMU is; the export has its own tests."""
    import fmuid.export

    calls = []

    def fake(source: Path, output: Path | None = None, **options: object) -> Path:
        calls.append((source, output, options))
        warnings.warn(ModelicaWarning("Coil.mo", 7, "parameter 'a' is used nowhere"), stacklevel=2)
        return folder / "Coil.fmu"

    monkeypatch.setattr(fmuid.export, "export_fmu", fake)
    assert fmuid_("export", "Coil.mo") == DONE
    assert fmuid_("export", "Coil.mo", "--output", "x/Y.fmu") == DONE
    assert fmuid_("export", "Coil.mo", "--fmi", "3.0", "--sensitivities", "R, L") == DONE
    assert fmuid_("export", "Coil.mo", "--sensitivities", "all") == DONE
    assert calls == [
        (Path("Coil.mo"), None, {"fmi": "2.0", "sensitivities": []}),
        (Path("Coil.mo"), Path("x/Y.fmu"), {"fmi": "2.0", "sensitivities": []}),
        (Path("Coil.mo"), None, {"fmi": "3.0", "sensitivities": ["R", "L"]}),
        (Path("Coil.mo"), None, {"fmi": "2.0", "sensitivities": "all"}),
    ]
    out = capsys.readouterr().out
    assert "Coil.fmu" in out
    assert out.count("note: Coil.mo:7: parameter 'a' is used nowhere\n") == 4


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert fmuid_("--version") == DONE
    assert capsys.readouterr().out == f"fmuid {fmuid.__version__}\n"
    assert fmuid_("--help") == DONE
    out = capsys.readouterr().out
    assert all(command in out for command in ("info", "init", "simulate", "identify", "export"))
    assert fmuid_() == DONE
    assert capsys.readouterr().out == out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("open",), "open is now workbench"),
        (("workbench", "--listen", "me"), "--listen was removed: the workbench serves this machine only"),
        (("predict", "results", "--like=a"), "--like is now --experiment"),
    ],
)
def test_an_old_name_is_refused_with_its_new_one(
    words: tuple[str, ...], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fmuid_(*words) == WRONG_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: fmuid")
    assert sentence in line


def test_exit_code_of_the_process() -> None:
    """The installed entry point is `main`; ``python -m fmuid`` is the same."""
    run_ = subprocess.run([sys.executable, "-m", "fmuid", "info"], capture_output=True, text=True, check=False)
    assert run_.returncode == WRONG_INPUT
    assert run_.stderr.startswith("error: ")
    with pytest.raises(SystemExit) as end:
        cli.main(["--version"])
    assert end.value.code == DONE
