"""The two studies, as their users run them."""

import math
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments.induction_machine import make_table
from tests.support.paths import FMUS, ROOT

EXPERIMENTS = ROOT / "experiments"
INDUCTION = EXPERIMENTS / "induction_machine" / "study.toml"
EMPS = EXPERIMENTS / "emps" / "study.toml"
# M, Fv, Fc, offset as published with the record (A. Janot, M. Gautier, M. Brunot, 2019)
PUBLISHED = np.array([95.1089, 203.5034, 20.3935, -3.1648])


FACTORS = (pytest.param(each, marks=pytest.mark.slow) for each in ((0.5, 1.5, 0.5, 1.5), (1.5,) * 4, (0.5,) * 4))


@pytest.mark.parametrize("factors", [(1.5, 0.5, 1.5, 0.5), *FACTORS])
def test_induction_machine_comes_back_from_starts_50_percent_away(factors: tuple[float, ...]) -> None:
    truth = make_table.TRUTH
    overrides = [f"parameters.{n}.start={f * truth[n]}" for n, f in zip(truth, factors, strict=True)]
    result = fmuid.Study.read(INDUCTION, overrides).identify()
    assert result.converged
    assert result.names == tuple(truth)
    assert (np.abs(result.values - list(truth.values())) < 3 * result.std).all()
    assert list(result.fit.noise_variance.values()) == pytest.approx([make_table.NOISE_VARIANCE] * 2, rel=0.06)


def test_phase_sensors_of_the_induction_machine_are_alike() -> None:
    result = fmuid.Study.read(INDUCTION.with_name("study_phases.toml")).identify()
    truth = [*make_table.TRUTH.values(), 1.0]
    assert result.names == (*make_table.TRUTH, "gain(ib)")
    assert (np.abs(result.values - truth) < 3 * result.std).all()
    page = INDUCTION.with_name("README.md").read_text(encoding="utf-8")
    gain = result["gain(ib)"]
    assert f"{gain.value:.4f} ± {gain.std:.4f}" in page


@pytest.mark.slow
def test_intervals_of_the_induction_machine_cover_as_often_as_they_say(clean: pd.DataFrame) -> None:
    """100 draws of noise on the noise-free simulation of the three-phase equations; 95 % of 100 is 95 ± 2.2."""
    truth = np.array(list(make_table.TRUTH.values()))
    system = fmuid.System(FMUS / "InductionMachine" / "InductionMachine.fmu")
    parameters = {name: fmuid.Parameter(1.1 * value, min=0) for name, value in make_table.TRUTH.items()}
    rng = np.random.default_rng(20260)
    covered = np.zeros(4)
    for _ in range(100):
        frame = make_table.add_noise(clean, make_table.NOISE_VARIANCE, rng)
        experiment = fmuid.Experiment(frame, ["uds", "uqs", "w"], ["ids", "iqs"])
        intervals = fmuid.identify(fmuid.Problem(system, experiment, parameters)).intervals(0.95).to_numpy()
        covered += (intervals[:, 0] < truth) & (truth < intervals[:, 1])
    assert (covered >= 89).all()
    assert (covered <= 99).all()


def drive_record(samples: int = 3000, substeps: int = 20) -> pd.DataFrame:
    """The drive under its sampled controller, integrated by Runge-Kutta 4 at 0.05 ms, without any FMU."""
    M, Fv, Fc, offset = PUBLISHED.tolist()
    gtau, kp, kv, eps = 35.15, 160.18, 243.45, 1e-3

    def slope(dq: float, v: float) -> tuple[float, float]:
        return dq, (gtau * v - Fv * dq - Fc * math.tanh(dq / eps) - offset) / M

    times = np.arange(samples) * 1e-3
    reference = 0.05 * (1 - np.cos(2 * times)) + 0.005 * (1 - np.cos(9 * times))  # from rest, without saturation
    q, dq, h, voltage = 0.0, 0.0, 1e-3 / substeps, []
    for k in range(samples):
        v = max(-10.0, min(10.0, kv * (kp * (reference[k] - q) - dq)))
        voltage.append(v)
        for _ in range(substeps):
            a = slope(dq, v)
            b = slope(dq + h / 2 * a[1], v)
            c = slope(dq + h / 2 * b[1], v)
            d = slope(dq + h * c[1], v)
            q += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
            dq += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
    return pd.DataFrame({"t": times, "qg": reference, "vir": voltage})


@pytest.mark.slow
def test_coupled_drive_and_controller_give_the_parameters_of_a_simulated_record(tmp_path: Path) -> None:
    drive_record().to_csv(tmp_path / "record.csv", index=False)
    overrides = [f"experiments.0.data={tmp_path / 'record.csv'}", 'model.fixed."drive.q_start"=0.0']
    result = fmuid.Study.read(EMPS, overrides).identify()
    assert result.converged
    assert result.values[:4] == pytest.approx(PUBLISHED, rel=1e-4)
    assert result["drive.dq_start"] == pytest.approx(0.0, abs=1e-6)


def emps_record() -> Path | None:
    """The user's copy of the record: named by FMUID_EMPS_DATA, or beside the study."""
    path = Path(os.environ.get("FMUID_EMPS_DATA", EMPS.parent / "DATA_EMPS.mat"))
    return path if path.is_file() else None


@pytest.mark.skipif(emps_record() is None, reason="the EMPS record is not here; set FMUID_EMPS_DATA to its path")
def test_recorded_drive() -> None:
    result = fmuid.Study.read(EMPS, [f"experiments.0.data={emps_record()}"]).identify()
    assert result.converged
    assert np.abs(result.solver_error).max() < 1e-3  # its controller acts as often in the check
    errors = np.abs(result.values[:4] / PUBLISHED - 1)
    assert errors[0] < 0.03
    assert (errors[1:] < 0.02).all()
    fit = result.fit.frames[0]
    measured, simulated = fit["measured.controller.v"], fit["simulated.controller.v"]
    assert np.linalg.norm(measured - simulated) / np.linalg.norm(measured) < 0.049
