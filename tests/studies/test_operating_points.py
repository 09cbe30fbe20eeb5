"""Studies with experiments that have no time."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid import InputError
from fmuid.apps.cli.app import main
from fmuid.codec import from_json
from fmuid.identification import Contributions
from fmuid.models import PHASOR_FORMULAS
from fmuid.reports.topics.study_notes import input_notes
from fmuid.runs import read_fits
from fmuid.runs.batch.case import CaseRunner
from fmuid.studies import InitOptions, draft, match_data_files, write_draft
from tests.support.paths import FMUS, ROOT
from tests.support.resting import MACHINE, three_tests

SIDES = ("measured", "simulated")
STEADY = """
[model]
fmu = "InductionMachine.fmu"
[[experiments]]
kind = "steady"
data = "tests.csv"
outputs = { I_rms = "I", P = "P" }
frame = { frequency = 50.0, voltage = "U", slip = "s" }
[parameters]
Rs = { start = 15.0, min = 0.1 }
Rr = { start = 2.0, min = 0.1 }
Lm = { start = 0.3, min = 0.01 }
Lf = { start = 0.1, min = 0.001 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for suffix in (".fmu", ".nameplate.toml"):
        shutil.copy(FMUS / f"InductionMachine/InductionMachine{suffix}", tmp_path)
    three_tests().rename(columns={"P": "P (W)"}).to_csv(tmp_path / "tests.csv", index=False)
    shutil.copy(fmuid.datasets.coil().fmu, tmp_path / "Coil.fmu")
    frequencies = np.logspace(-1, 3, 41)
    impedance = 4.0 + 0.2j * np.pi * frequencies
    spectrum = {"f (Hz)": frequencies, "|Z| (Ohm)": np.abs(impedance), "phi (deg)": np.degrees(np.angle(impedance))}
    pd.DataFrame(spectrum).to_csv(tmp_path / "spectrum.csv", index=False)
    return tmp_path


SPECTRUM = """
[model]
fmu = "Coil.fmu"
[[experiments]]
kind = "frequency"
data = "spectrum.csv"
frequency = "f"
responses.Z = { of = "u / i", magnitude = "|Z|", phase = "phi" }
[parameters]
R = { start = 1.0, min = 0.01 }
L = { start = 1.0, min = 0.001 }
"""


def study_of(folder: Path, text: str = STEADY) -> fmuid.Study:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return fmuid.Study.read(path)


def test_a_table_of_tests_gives_the_machine(folder: Path) -> None:
    found = fmuid.run(study_of(folder), folder / "out")
    assert found.succeeded
    assert found.result.values == pytest.approx(list(MACHINE.values()), rel=1e-6)
    assert (folder / "out/report.html").is_file()


def test_a_spectrum_gives_the_winding(folder: Path) -> None:
    found = fmuid.run(study_of(folder, SPECTRUM), folder / "out")
    assert found.succeeded
    assert found.result.values == pytest.approx([4.0, 0.1], rel=1e-6)
    fit = pd.read_csv(folder / "out/fit.csv")
    assert list(fit.columns) == ["frequency", *(f"{a}.Z.{b}" for b in ("magnitude", "phase") for a in SIDES)]


def test_a_monte_carlo_study_of_a_spectrum_has_relative_noise(folder: Path) -> None:
    """The mean relative noise variance is that of 15 realizations; both parts of a response fit alike."""
    drawn = "[batch.monte_carlo]\nrealizations = 15\nreading_std = { Z = 0.01 }\ntrue_values = { R = 4.0, L = 0.1 }\n"
    run = CaseRunner(study_of(folder, SPECTRUM + drawn))
    table = pd.DataFrame([run(k).row for k in range(15)])
    magnitude = pd.read_csv(folder / "spectrum.csv")["|Z| (Ohm)"]
    relative = table["noise.Z.magnitude"] / np.mean(magnitude**2)
    assert relative.mean() == pytest.approx(1e-4, rel=4.0 * np.sqrt(2.0 / (15 * 80)))
    assert (table["fit.Z.magnitude"] == table["fit.Z.phase"]).all()
    assert table["fit.Z.phase"].mean() == pytest.approx(100.0 * (1.0 - 0.01 * np.sqrt(2.0)), abs=0.1)


def test_an_unknown_response_of_a_monte_carlo_study_is_refused(folder: Path) -> None:
    text = SPECTRUM + "[batch.monte_carlo]\nrealizations = 2\n"
    with pytest.raises(InputError, match=r"unknown noise level of 'Z.magnitude'. Set std or reading_std of it"):
        study_of(folder, text)
    with pytest.raises(InputError, match="reading_std: unknown output 'Y'"):
        study_of(folder, text + "reading_std = { Y = 0.01 }\n")


@pytest.mark.parametrize(
    ("text", "first"), [(STEADY, ["row", "frequency", "voltage", "slip"]), (SPECTRUM, ["frequency"])]
)
def test_a_prediction_has_the_axis_of_its_rows(folder: Path, text: str, first: list[str]) -> None:
    problem = study_of(folder, text).problem()
    result = fmuid.identify(problem)
    table = fmuid.predict(result, problem.experiments[0]).table
    assert [name for name in table.columns.tolist() if "." not in name] == first


@pytest.mark.parametrize(
    ("kind", "fmu", "table", "expected"),
    [
        ("steady", "InductionMachine.fmu", "tests.csv", MACHINE),
        ("frequency", "Coil.fmu", "spectrum.csv", {"R": 4.0, "L": 0.1}),
    ],
)
def test_a_drafted_study_identifies_as_it_is(
    folder: Path, kind: str, fmu: str, table: str, expected: dict[str, float]
) -> None:
    """The FMU's own values are those of the tables; the study starts away from them."""
    records = match_data_files(folder / fmu, [folder / table], InitOptions(kind=kind))
    write_draft(draft(folder / fmu, records, folder / "new.toml"), folder / "new.toml")
    text = (folder / "new.toml").read_text(encoding="utf-8")
    moved = re.sub(r"start = ([\d.]+)", lambda found: f"start = {1.2 * float(found[1])}", text)
    found = fmuid.run(study_of(folder, moved), folder / "out")
    assert found.result.values == pytest.approx([expected[name] for name in found.result.names], rel=1e-5)
    assert set(found.result.names) == set(expected)


@pytest.mark.parametrize(
    ("kind", "head", "expected"),
    [
        ("steady", "U_LL [V],n [1/min],I1,P1,cosphi", {"line_voltage": "U_LL", "speed": "n", "cos_phi": "cosphi"}),
        ("steady", "Drehzahl,Spannung,Drehmoment,f", {"speed": "Drehzahl", "frequency": "f", "torque": "Drehmoment"}),
        ("frequency", "freq,Zd_re,Zd_im", {"frequency": "freq", "Zd.real": "Zd_re", "Zd.imaginary": "Zd_im"}),
        ("frequency", "w (rad/s),gain (dB),arg (deg)", {"gain.decibel": "gain (dB)", "gain.phase": "arg"}),
        ("frequency", "omega,Re,Im", {"frequency": "omega", "Z.real": "Re"}),
        ("frequency", "f,Re,Im", {"Z.real": "Re", "Z.imaginary": "Im"}),
        ("frequency", "freq/Hz,Re(Z)/Ohm,-Im(Z)/Ohm,|Z|/Ohm", {"Z.real": "Re(Z)", "Z.imaginary": "-Im(Z)"}),
        ("frequency", "Freq,Zreal,Zimag,Zmod,Zphz", {"Z.real": "Zreal", "Z.imaginary": "Zimag"}),
        ("frequency", "Frequency (Hz),Z' (Ohm),-Z'' (Ohm)", {"Z.real": "Z'", "Z.imaginary": "-Z''"}),
        ("frequency", "f,temperature,|G| (dB),Phase/°", {"G.decibel": "|G| (dB)", "G.phase": "Phase"}),
    ],
)
def test_columns_without_a_time_are_matched(folder: Path, kind: str, head: str, expected: dict[str, str]) -> None:
    count = head.count(",") + 1
    (folder / "table.csv").write_text(f"{head}\n" + f"{','.join(['1400'] * count)}\n" * 3, encoding="utf-8")
    fmu = folder / ("InductionMachine.fmu" if kind == "steady" else "Coil.fmu")
    (record,) = match_data_files(fmu, [folder / "table.csv"], InitOptions(kind=kind))
    found = {link.variable: link.column for link in record.links}
    assert expected.items() <= found.items()
    assert record.settings.kind == kind
    assert record.units == ({"frequency": "rad/s"} if head.startswith("omega") else {})
    if "speed" in expected:
        assert record.settings.frame is not None and record.settings.frame.pole_pairs == (
            60 if "frequency" in found else 2
        )


@pytest.mark.parametrize(("fmu", "count"), [("InductionMachine.fmu", 7), ("Coil.fmu", 0)])
def test_info_lists_the_formulas_of_declared_terminals(
    folder: Path, fmu: str, count: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        main(["info", str(folder / fmu)])
    printed = capsys.readouterr().out
    assert sum(each.equation in printed for each in PHASOR_FORMULAS.values()) == count
    assert ("Outputs of operating points" in printed) is bool(count)


def test_a_spectrum_with_reversed_sign_is_one(folder: Path) -> None:
    """Batteries' spectra have −Im: the same estimates."""
    table = pd.read_csv(folder / "spectrum.csv")
    impedance = table["|Z| (Ohm)"] * np.exp(1j * np.radians(table["phi (deg)"]))
    parts = {
        "freq/Hz": table["f (Hz)"],
        "Re(Z)/Ohm": impedance.to_numpy().real,
        "-Im(Z)/Ohm": -impedance.to_numpy().imag,
    }
    pd.DataFrame(parts).to_csv(folder / "spectrum.csv", index=False)
    records = match_data_files(folder / "Coil.fmu", [folder / "spectrum.csv"], InitOptions(kind="frequency"))
    text = draft(folder / "Coil.fmu", records, folder / "new.toml").text
    assert "conjugate = true" in text
    found = fmuid.run(study_of(folder, text.replace("start = 4.0", "start = 6.0")), folder / "out")
    assert dict(zip(found.result.names, found.result.values, strict=True)) == pytest.approx(
        {"L": 0.1, "R": 4.0}, rel=1e-6
    )


@pytest.mark.parametrize("text", [STEADY, SPECTRUM])
def test_a_results_folder_keeps_what_its_charts_need(folder: Path, text: str) -> None:
    found = fmuid.run(study_of(folder, text), folder / "out")
    (fit,), (again,) = found.fits, read_fits(folder / "out")
    assert again.kind == fit.kind
    np.testing.assert_equal(again.readings, fit.readings)
    assert list(again.axis) == list(fit.axis)
    contributions = json.loads((folder / "out/result.json").read_text())["assessment"]["contributions"]
    kept, own = from_json(Contributions, contributions), found.assessment.contributions
    assert own is not None
    for part in ("leverage", "std", "noise"):
        np.testing.assert_allclose(getattr(kept, part)[0], getattr(own, part)[0])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'frequency = "f"',
            'frequency = "w"',
            r"frequency column 'w' not found \(columns: f, \|Z\|, phi\). Set frequency",
        ),
        ('frequency = "f"', 'frequency = "f"\noutputs = ["i"]', "has responses. Remove outputs"),
        ('frequency = "f"', 'frequency = "f"\nframe = { frequency = 50.0 }', "frame: give either voltage"),
        ('frequency = "f"', 'frequency = "f"\nguess = { i = 1.0 }', 'guess: needs kind = "steady"'),
        ('of = "u / i"', 'of = "u i i"', "no signal 'u i i'. `fmuid info` lists all"),
        ('phase = "phi"', 'phase = "|Z|"', "responses.Z: magnitude and phase have the same column. Name one for each"),
        ('phase = "phi"', 'phase = "phi", delay = "x"', "responses.Z.delay: must be a number, not"),
        ('phase = "phi"', 'real = "phi"', "responses.Z: magnitude and real cannot be combined|real and magnitude"),
        ("responses.Z = ", "outputs = ", "outputs"),
        (
            'responses.Z = { of = "u / i", magnitude = "|Z|", phase = "phi" }',
            "",
            "no outputs. Name the measured ones, resp",
        ),
    ],
)
def test_wrong_responses_are_refused(folder: Path, old: str, new: str, message: str) -> None:
    assert SPECTRUM.count(old) == 1
    with pytest.raises(InputError, match=message):
        study_of(folder, SPECTRUM.replace(old, new)).problem()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "steady"', "", r'experiments\[0\].frame: needs kind = "steady"'),
        ('data = "tests.csv"', 'data = "tests.csv"\ntime = "t"', 'time: kind = "steady" has no time. Remove time.'),
        ('data = "tests.csv"', 'data = "tests.csv"\nwarmup = 1.0', "Remove warmup"),
        ('data = "tests.csv"', 'data = "tests.csv"\npreprocess = { detrend = "mean" }', "only computed_columns"),
        ('slip = "s"', 'slip = "s", speed = "n"', "frame: give either slip or speed"),
        ('slip = "s"', 'speed = "n"', "speed needs pole_pairs"),
        ('slip = "s"', 'slip = "slip"', "slip column 'slip' not found.* Set slip to its column"),
        ("frequency = 50.0", "frequency = 0.0", "frequency must be above 0 Hz"),
        ('voltage = "U"', "voltage = -230.0", "frame: voltage must be above 0 V in every row, not as in row 1"),
        ('slip = "s"', 'slip = "n"', "frame: slip 1.5e[+]03 in row 1 is no fraction. Check units and pole_pairs"),
        ('slip = "s"', 'speed = "n", pole_pairs = 2.5', "frame.pole_pairs: must be a whole number above 0"),
        ('data = "tests.csv"', 'data = "tests.csv"\nguess = { x = 1.0 }', "guess has no effect with frame. Remove it"),
        ('data = "tests.csv"', 'data = "tests.csv"\ninputs = { uds = "U" }', "frame gives the input 'uds'. Remove it"),
        ('P = "P"', 'torque = "T"', "'torque' needs pole_pairs. Set it in frame"),
        ('P = "P"', 'ids = "P"', "with frame, outputs are I_rms, P, Q, S"),
        ('kind = "steady"', 'kind = "static"', 'must be "time" or "steady" or "frequency"'),
    ],
)
def test_wrong_keys_are_refused_in_one_sentence(folder: Path, old: str, new: str, message: str) -> None:
    assert STEADY.count(old) == 1
    with pytest.raises(InputError, match=message):
        study_of(folder, STEADY.replace(old, new)).problem()


@pytest.mark.parametrize(("value", "what"), [(np.nan, "empty"), (np.inf, "infinite")])
def test_a_row_without_an_input_is_refused(folder: Path, value: float, what: str) -> None:
    table = three_tests()
    table.loc[2, "s"] = value
    table.to_csv(folder / "tests.csv", index=False)
    with pytest.raises(InputError, match=rf"tests.csv: input column 's' is {what} in row 3. Remove the row"):
        study_of(folder).problem()


def test_a_negative_magnitude_is_refused_and_an_empty_one_is_noted(folder: Path) -> None:
    rows = {"f": [1.0, 10.0, 30.0], "|Z|": [4.0, 7.4, 19.2], "phi": [9.0, 57.5, np.nan]}
    pd.DataFrame(rows).to_csv(folder / "spectrum.csv", index=False)
    (note,) = input_notes(study_of(folder, SPECTRUM).simulators())
    assert str(note).endswith("spectrum.csv: 1 of 3 samples of 'phi' are missing.")
    pd.DataFrame({**rows, "|Z|": [4.0, -7.4, 19.2]}).to_csv(folder / "spectrum.csv", index=False)
    with pytest.raises(InputError, match=r"magnitude '\|Z\|' is negative in row 2. Use decibel"):
        study_of(folder, SPECTRUM).problem()


def test_half_a_response_is_refused(folder: Path) -> None:
    table = pd.DataFrame({"f": [1.0, 10.0], "|Z|": [4.0, np.nan], "phi": [1.0, 2.0]})
    table.to_csv(folder / "spectrum.csv", index=False)
    text = SPECTRUM.replace("magnitude =", "real =").replace("phase =", "imaginary =")
    with pytest.raises(InputError, match=r"spectrum.csv: one of '\|Z\|' and 'phi' is empty in row 2. Empty both."):
        study_of(folder, text).problem()


def test_a_table_without_times_names_the_kind(folder: Path) -> None:
    three_tests().drop(columns="T").to_csv(folder / "tests.csv", index=False)  # which might be a time
    text = STEADY.replace('kind = "steady"', "").replace("frame = {", "# ")
    with pytest.raises(InputError, match=r"or a kind for rows without times"):
        study_of(folder, text).problem()


PLATE = """
[nameplate]
P = "1.19 kW"
U = "400 V"
I = 2.73
cos_phi = 0.78
n = 1420
f = 50
Is_In = 3.1
Ts_Tn = 0.6
Tb_Tn = 1.6
"""


def test_a_nameplate_is_a_prior(folder: Path) -> None:
    alone = fmuid.run(study_of(folder)).result
    found = fmuid.run(study_of(folder, 'prior = "nameplate"\n' + STEADY + PLATE))
    assert found.succeeded and found.has_prior
    assert found.result.estimates.prior_mean == pytest.approx(list(MACHINE.values()), rel=0.05)
    assert (found.result.std <= 1.001 * alone.std).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (STEADY + PLATE, 'nameplate: has no effect. Set prior = "nameplate"'),
        ('prior = "nameplate"\n' + STEADY, r"prior: needs the section \[nameplate\]"),
        ('prior = "plate"\n' + STEADY + PLATE, 'prior: must be "nameplate"'),
        ('prior = "nameplate"\n' + STEADY + PLATE.replace("n = 1420", ""), "nameplate: missing key 'n'"),
        ('prior = "nameplate"\n' + STEADY + PLATE.replace("3.1", "9.1"), "nameplate: no machine has this nameplate"),
    ],
)
def test_wrong_nameplates_are_refused(folder: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        study_of(folder, text)


def test_init_takes_a_nameplate(folder: Path) -> None:
    shutil.copy(ROOT / "experiments/induction_machine/table.csv", folder)
    given = [f"--nameplate={each}" for each in ("P=1.19 kW", "U=400 V", "I=2.73", "n=1420", "f=50", "cos_phi=0.78")]
    files = [str(folder / name) for name in ("InductionMachine.fmu", "table.csv", "new.toml")]
    with pytest.raises(SystemExit, match="0"):
        main(["init", *files[:2], "-o", files[2], *given])
    study = fmuid.Study.read(folder / "new.toml")
    assert study.joint_prior is not None
    assert set(study.joint_prior.names) == set(MACHINE) <= set(study.parameters)
    assert study.parameters["Rs"].start == pytest.approx(study.joint_prior.mean[0], rel=1e-3)
