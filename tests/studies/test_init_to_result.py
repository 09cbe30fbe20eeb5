"""From an FMU and a table of somebody's bench to the right values, with no edit between `fmuid init` and `identify`."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

from fmuid import Experiment, InputError, Study, System
from fmuid.apps.cli.options import DONE, NOT_SUCCEEDED
from fmuid.array_types import Floats
from fmuid.models import read_description
from fmuid.studies import draft, match_data_files
from fmuid.studies.init.parameter_survey import ParameterProposal as Use
from fmuid.studies.init.parameter_survey import Survey, _select, is_solver_setting, survey
from fmuid.studies.init.start_parameters import is_start
from tests.support.coil_study import COIL, fmuid_, result
from tests.support.exported import export_text
from tests.support.fmu_texts import FMI2, write_fmu
from tests.support.paths import FMUS

pytestmark = pytest.mark.usefixtures("blank_figures")

REACTOR = """
model BatchReactor "growth on one substrate, after Monod"
  parameter Real mu_max = 0.4 "largest growth rate";
  parameter Real Y_XS = 0.6 "yield";
  parameter Real K_S = 0.02 "half-saturation";
  parameter Real X0 = 0.1 "biomass at the beginning";
  parameter Real S0 = 20.0 "substrate at the beginning";
  output Real X(start=X0, fixed=true) "biomass";
  output Real S(start=S0, fixed=true) "substrate";
  Real mu;
equation
  mu = mu_max*S/(K_S + S);
  der(X) = mu*X;
  der(S) = -mu*X/Y_XS;
end BatchReactor;
"""


def integrated(rates: Callable[[float, Floats], list[float]], start: list[float], t: Floats) -> Floats:
    """Return the states (n, K) at the times, tightly."""
    found = solve_ivp(rates, (0.0, float(t[-1])), start, "LSODA", t_eval=t, rtol=1e-8, atol=1e-9)
    return np.asarray(found.y, dtype=np.float64)


def noisy(values: Floats, share: float, seed: int) -> Floats:
    return np.asarray(values + share * np.std(values) * np.random.default_rng(seed).standard_normal(values.shape))


def current(t: Floats, u: Floats, i0: float, R: float, L: float = 0.1) -> Floats:
    """Return the current of a coil under a voltage that is held from sample to sample, in closed form."""
    i, decay = np.full(t.size, i0), np.exp(-R / L * t[1])
    for k in range(1, t.size):
        i[k] = u[k - 1] / R + (i[k - 1] - u[k - 1] / R) * decay
    return i


def coil(folder: Path) -> tuple[Path, dict[str, float]]:
    """A coil under steps of a commanded voltage: exact from sample to sample."""
    truth, t = {"R": 6.0, "L": 0.045, "i_start": 0.8}, np.arange(400.0) * 1e-3
    u = np.repeat(np.random.default_rng(3).choice([0.0, 10.0], 20), 20)
    i = current(t, u, truth["i_start"], truth["R"], truth["L"])
    pd.DataFrame({"Zeit [ms]": 1e3 * t, "U_soll [V]": u, "I_mess [mA]": 1e3 * noisy(i, 0.005, 1)}).to_csv(
        folder / "bench.csv", sep=";", decimal=",", index=False
    )
    return COIL, truth


def reactor(folder: Path) -> tuple[Path, dict[str, float]]:
    truth = {"mu_max": 0.52, "Y_XS": 0.48, "X0": 0.17, "S0": 16.0}
    mu, y, x0, s0 = truth.values()
    t = np.linspace(0.0, 12.0, 90)

    def rates(_: float, x: Floats) -> list[float]:
        growth = mu * max(x[1], 0.0) / (0.02 + max(x[1], 0.0)) * x[0]
        return [growth, -growth / y]

    x = integrated(rates, [x0, s0], t)
    pd.DataFrame({"time": t, "X": noisy(x[0], 0.003, 1), "S": noisy(x[1], 0.003, 2)}).to_csv(
        folder / "bench.csv", index=False
    )
    return export_text(folder, REACTOR), truth


@pytest.mark.parametrize("case", [coil, pytest.param(reactor, marks=pytest.mark.slow)])
def test_no_edit_between(
    case: Callable[[Path], tuple[Path, dict[str, float]]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fmu, truth = case(tmp_path)
    study = tmp_path / "study.toml"
    assert fmuid_("init", fmu, tmp_path / "bench.csv", "--output", study) == DONE
    assert "Next: fmuid identify " in capsys.readouterr().out
    assert fmuid_("identify", study, "--output", tmp_path / "results") == DONE
    found = result(tmp_path / "results")["parameters"]
    assert not {"_nle_tolerance", "i", "w", "X", "S"} & set(found)
    for name, value in truth.items():
        assert abs(found[name]["value"] - value) < 4.5 * found[name]["std"], name
        assert found[name]["std"] < 0.05 * abs(value), name


# --- what is proposed ---------------------------------------------------------------------


def test_settings_of_solvers_and_start_values() -> None:
    description = read_description(FMUS / "InductionMachine/InductionMachine.fmu")
    rs = description.variables["Rs"]
    for name in ("_nle_tol", "solver.eps", "tolerance", "sim.maxIterations", "LogLevel"):
        assert is_solver_setting(rs._replace(name=name)), name
    for name in ("Rs", "stolen", "epsilon_r", "motor.L", "tol_gap", "nleak"):
        assert is_solver_setting(rs._replace(name=name)) == (name == "tol_gap"), name
    for name in ("ids_start", "ids0", "motor.wInit", "x.start", "init_temp"):
        assert is_start(rs._replace(name=name), description), name
    for name in ("Rs", "R0", "L0", "startup"):  # there is no variable R or L that they could be the start of
        assert not is_start(rs._replace(name=name), description), name
    assert is_start(rs._replace(name="p", description="initial pressure"), description)


def test_what_the_noise_hides_is_left_out() -> None:
    """The second column is as strong as the noise lets it be seen by one standard deviation."""
    a, b = np.random.default_rng(5).standard_normal((2, 50))
    b -= (a @ b) / (a @ a) * a
    for share, use in ((0.9, Use.NOISE), (1.1, Use.FREED)):
        columns = np.column_stack([a, a + share * 0.1 * b / np.linalg.norm(b)])
        uses: list[Use | None] = [None, None]
        _select(columns, np.linalg.norm(columns, axis=0), uses, [], columns / 0.1)
        assert sorted(each.value for each in uses if each) == sorted([Use.FREED.value, use.value])


BIASED = """
model Biased "a lag with feedthrough, and a drift that the machine does not have"
  parameter Real a(unit="1/s") = 2.0 "rate";
  parameter Real b = 1.5 "gain";
  parameter Real c = 0.3 "feedthrough";
  parameter Real drift(unit="1/s") = 0 "huge where it is there";
  parameter Real x_start = 0 "state at the beginning";
  input Real u;
  Real x(start=x_start, fixed=true);
  output Real y;
equation
  der(x) = -a*x + b*u + 1e4*drift;
  y = x + c*u;
end Biased;
"""


def test_survey_judges_effects_against_noise_and_inputs_against_offsets(tmp_path: Path) -> None:
    """One effect of 8e4 % hides no other; an input recorded with an offset moves the first sample, not the start."""
    a, b, c = 2.3, 1.2, 0.35
    t = np.arange(400.0) * 0.01
    u = np.where(np.sin(3.0 * t) >= 0.0, 1.2, -0.8)
    y = c * u + current(t, b * u, 0.0, a, 1.0) + 0.01 * np.random.default_rng(1).standard_normal(t.size)
    fmu, uses = export_text(tmp_path, BIASED), {}
    for offset, start in ((0.0, 0.0), (0.4, 0.0), (0.0, 3.0)):
        frame = pd.DataFrame({"time": t, "u": u + offset, "y": y + start * np.exp(-a * t)})
        found = survey(fmu, [Experiment(frame, ["u"], ["y"], interpolation="zoh")])
        uses[offset, start] = {each.variable.name: each.use for each in found.candidates}
        assert [uses[offset, start][name] for name in ("a", "b", "c", "drift")] == [*[Use.FREED] * 3, Use.ZERO]
    assert [each["x_start"] for each in uses.values()] == [Use.START, Use.START, Use.START_FREED]


SPRING = """
model Pendulum "a mass on a spring"
  parameter Real c(unit="N/m") = 10.0 "stiffness";
  parameter Real m(unit="kg", min=0) = 1.0 "mass";
  parameter Real s_rel0(unit="m") = 1.0 "length at rest";
  parameter Real s0(unit="m") = 0.5 "position at the beginning";
  parameter Real fixed(unit="m") = 0.1 "position of the wall";
  Real s_rel(unit="m");
  output Real s(unit="m", start=s0, fixed=true);
  Real v(unit="m/s", start=0, fixed=true);
equation
  s_rel = s - fixed;
  der(s) = v;
  m*der(v) = -c*(s_rel - s_rel0);
end Pendulum;
"""


def test_a_length_at_rest_is_no_start_value(tmp_path: Path) -> None:
    """What nothing begins at is none, whatever its name; all begins with the start values, as there is no input."""
    t = np.linspace(0.0, 8.0, 200)
    s = 1.0 - 0.5 * np.cos(np.sqrt(10.9) * t) + 0.002 * np.random.default_rng(1).standard_normal(t.size)
    record = Experiment(pd.DataFrame({"time": t, "s": s}), [], ["s"])
    found = {each.variable.name: each for each in survey(export_text(tmp_path, SPRING), [record]).candidates}
    uses = {name: each.use for name, each in found.items()}
    for pair in (("c", "m"), ("s_rel0", "fixed")):
        assert {uses[name] for name in pair} == {Use.FREED, Use.ALIKE}
    assert uses["s0"] is Use.START_OPEN


SWINGING = """
model Swinging "force, mass, spring and a weak damper: all four have one scale"
  parameter Real k(unit="N/V") = 3;
  parameter Real m(unit="kg") = 0.5;
  parameter Real c(unit="N/m") = 200;
  parameter Real d(unit="N.s/m") = 0.3;
  input Real u(unit="V");
  output Real x(unit="m", start=0, fixed=true, nominal=0.01);
  Real v(unit="m/s", start=0, fixed=true);
equation
  der(x) = v;
  m*der(v) = k*u - c*x - d*v;
end Swinging;
"""


@pytest.mark.slow
def test_a_weak_parameter_that_acts_like_strong_ones_stays_fixed(tmp_path: Path) -> None:
    """Its effect is less than the curvature of theirs."""
    t = np.arange(1500.0) * 0.01
    u: Floats = np.where(np.sin(0.9 * t) >= 0.0, 1.0, -1.0)
    moved = solve_ivp(
        lambda s, z: [z[1], (3.0 * u[min(int(s / 0.01 + 1e-9), 1499)] - 200.0 * z[0] - 0.3 * z[1]) / 0.5],
        (0.0, t[-1]), [0.0, 0.0], t_eval=t, max_step=0.005,
    )  # fmt: skip
    frame = pd.DataFrame({"time": t, "u": u, "x": moved.y[0] + 1e-4 * np.random.default_rng(4).standard_normal(t.size)})
    found = survey(export_text(tmp_path, SWINGING), [Experiment(frame, ["u"], ["x"], interpolation="zoh")])
    uses = {each.variable.name: each.use for each in found.candidates}
    assert sorted(uses[name].name for name in "kmcd") == ["ALIKE", "FREED", "FREED", "FREED"], uses


WALL = """
model Wall "a room behind a wall; for Co-Simulation, in steps of 2 ms"
  parameter Real tau(unit="s", min=1) = 2e6;
  parameter Real share(unit="1") = 0.3;
  parameter Real T0(unit="degC") = 20;
  parameter Real Tw0(unit="degC") = 12;
  input Real Ta(unit="degC");
  output Real T(unit="degC", start=T0, fixed=true);
  Real Tw(unit="degC", start=Tw0, fixed=true);
equation
  tau*der(T) = Tw - T;
  tau*der(Tw) = share*(T - Tw) + Ta - Tw;
end Wall;
"""


@pytest.mark.slow
def test_slow_models_run_by_model_exchange_and_hidden_states_start_unseen(tmp_path: Path) -> None:
    """A record of three years has 5e10 steps of 2 ms."""
    t = np.linspace(0.0, 1e8, 400)
    table = pd.DataFrame({"time": t, "Ta": 10.0 * np.sin(2e-7 * t), "T": 20.0 * np.exp(-t / 3e6)})
    fmu = export_text(tmp_path, WALL)
    table.to_csv(tmp_path / "record.csv", index=False)
    made = draft(fmu, match_data_files(fmu, [tmp_path / "record.csv"]), tmp_path / "study.toml")
    assert tomllib.loads(made.text)["model"]["interface"] == "model-exchange"
    uses = {each.variable.name: each.use for each in made.survey.candidates}
    assert uses["Tw0"] is Use.START_HIDDEN


def experiment(table: pd.DataFrame) -> Experiment:
    return Experiment(table, ["u"], ["i"], interpolation="zoh")


def test_start_values_are_freed_where_records_begin_elsewhere() -> None:
    t = np.arange(200.0) * 1e-3
    u: Floats = np.where(np.arange(200) % 40 < 20, 10.0, 0.0)
    for i0, use in ((0.0, Use.START), (0.7, Use.START_FREED)):
        i = current(t, u, i0, 4.0)
        found = survey(COIL, [experiment(pd.DataFrame({"time": t, "u": u, "i": i}))])
        assert not found.lags
        candidates = {each.variable.name: each for each in found.candidates}
        assert candidates.keys() == {"R", "L", "i_start"}  # the current itself starts at i_start
        assert [candidates[name].use for name in ("R", "L", "i_start")] == [Use.FREED, Use.FREED, use]
        assert candidates["i_start"].start == pytest.approx(i0, abs=1e-4)
    # what 10 % of R change of the current, from the closed form moved by a thousandth
    difference = current(t, u, 0.7, 4.004) - current(t, u, 0.7, 4.0)
    expected = 100 * np.sqrt(np.mean(difference**2)) / np.std(i)
    assert candidates["R"].effect == pytest.approx(expected, rel=1e-3)


def test_effect_below_the_noise_stays_fixed_and_nothing_is_no_study() -> None:
    """Sampled slower than its time constant, a coil shows its resistance alone; without input and effect, nothing."""
    t, noise = np.arange(60.0), np.random.default_rng(2).standard_normal(60)
    u: Floats = np.where(np.arange(60) % 7 < 3, 10.0, 5.0)
    for voltage, i, expected in (
        (u, np.roll(u, 1) / 4 + 0.05 * noise, {"R": Use.FREED, "L": Use.NOISE, "i_start": Use.START}),
        (0 * u, noise, {"R": Use.NO_EFFECT, "L": Use.NO_EFFECT, "i_start": Use.NOISE}),
    ):
        found = survey(COIL, [experiment(pd.DataFrame({"time": t, "u": voltage, "i": i}))])
        uses = {each.variable.name: each.use for each in found.candidates}
        assert uses == expected, uses


def test_co_simulation_is_surveyed_where_model_exchange_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def surveyed(system: System, *_: object) -> Survey:
        tried.append(system.numerics.interface)
        if tried[-1] == "model-exchange":
            raise InputError("does not run so")
        return Survey()

    monkeypatch.setattr("fmuid.studies.init.parameter_survey._surveyed", surveyed)
    record = experiment(pd.DataFrame({"time": [0.0, 1.0], "u": 1.0, "i": 0.0}))
    assert survey(COIL, [record]) == Survey()
    assert tried == ["model-exchange", "co-simulation"]


def test_simulations_that_fail_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An FMU without binaries is described all the same; nothing is proposed, and the study is to be looked at."""
    fmu = write_fmu(tmp_path / "Motor.fmu", FMI2)
    pd.DataFrame({"time": [0.0, 1.0], "u": 1.0, "on": 1, "w": [0.0, 1.0]}).to_csv(tmp_path / "run.csv", index=False)
    study = tmp_path / "study.toml"
    assert fmuid_("init", fmu, tmp_path / "run.csv", "--output", study) == NOT_SUCCEEDED
    assert "parameters" in capsys.readouterr().out
    assert "# R = { start = 2.0, min = 0.0 }" in study.read_text()


def test_bounds_and_starts_in_the_file(tmp_path: Path) -> None:
    """The sign of a value without a minimum is kept; several records have start values of their own."""
    t = np.arange(100.0) * 1e-3
    for name, i0 in (("a", 1.0), ("b", 2.0)):
        i = i0 * np.exp(-40 * t)
        pd.DataFrame({"time": t, "u": 0.0 * t, "i": i}).to_csv(tmp_path / f"{name}.csv", index=False)
    assert fmuid_("init", COIL, tmp_path / "a.csv", tmp_path / "b.csv", "-o", tmp_path / "study.toml") == DONE
    parameters = Study.read(tmp_path / "study.toml").parameters
    assert parameters.keys() >= {"i_start", "R"} or parameters.keys() >= {"i_start", "L"}  # of a decay only R/L shows
    assert parameters["i_start"].per_experiment
    assert np.isneginf(parameters["i_start"].min)
