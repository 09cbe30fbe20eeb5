"""Sensitivity functions and promised accuracy against closed forms and against what identifications give."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, InputError, Normal, Parameter, Study, System, identify
from fmuid.identification import expected_accuracy, rank_excitations, sensitivity_functions
from fmuid.runs import ranked_excitations
from tests.support.paths import FMUS

COIL = System.of(FMUS / "Coil/Coil.fmu")
R, L, NOISE = 4.0, 0.1, 0.02
PARAMETERS = {"R": Parameter(R, min=0.0), "L": Parameter(L, min=1e-3)}
TIMES = 1e-3 * np.arange(300.0)


def excitation(voltage: float | np.ndarray, name: str = "step") -> Experiment:
    frame = pd.DataFrame({"time": TIMES, "u": voltage + 0.0 * TIMES})
    return Experiment(frame, ["u"], ["i"], interpolation="zoh", measured=False, name=name)


def test_a_step_against_its_closed_form() -> None:
    """i = (u/R)(1 − e), e = exp(−R t/L): R ∂i/∂R = −i + u t e/L, L ∂i/∂L = −u t e/L."""
    found = sensitivity_functions(COIL, excitation(2.0), PARAMETERS)
    decay = np.exp(-R / L * TIMES)
    moved = 2.0 * TIMES * decay / L
    expected = np.column_stack([-2.0 / R * (1.0 - decay) + moved, -moved])
    np.testing.assert_allclose(found.values[:, 0], expected, atol=2e-6)
    assert list(found.table.columns) == ["time", "i/R", "i/L"]
    assert found.sizes.loc["L", "i"] == pytest.approx(np.sqrt(np.mean(moved**2)), rel=1e-5)
    assert found.units == ("A",)
    bounds = {"R": Parameter(R, min=R), "L": Parameter(L, max=L)}  # where differences are one-sided
    beside = sensitivity_functions(COIL, excitation(2.0), bounds)
    np.testing.assert_allclose(beside.values, found.values, atol=1e-5)


def test_excitations_are_ranked() -> None:
    """A constant voltage tells R best and hardly L; a fast square wave tells L better; none tells nothing."""
    square = np.where(np.arange(300) // 25 % 2 == 0, 1.0, -1.0)
    candidates = [excitation(1.0, "constant"), excitation(square, "square"), excitation(0.0, "none")]
    found = [expected_accuracy(COIL, each, PARAMETERS, {"i": NOISE**2}) for each in candidates]
    constant, wave, none = found
    assert constant.std["R"] < wave.std["R"]
    assert wave.std["L"] < constant.std["L"]
    assert none.log_determinant == -math.inf
    assert set(none.std.values()) == {math.inf}
    by_worst = rank_excitations(found, by="worst")
    assert list(by_worst["excitation"]) == [each.excitation for each in sorted(found, key=lambda each: each.worst)]
    by_determinant = rank_excitations(found)
    order = sorted(found, key=lambda each: -each.log_determinant)
    assert list(by_determinant["excitation"]) == [each.excitation for each in order]
    assert by_determinant["L.std"].iloc[-1] == math.inf
    with pytest.raises(InputError, match=r"by: .*'size'"):
        rank_excitations(found, by="size")


def test_priors_count() -> None:
    known = {"R": Parameter(R, prior=Normal(R, 0.1)), "L": Parameter(L, prior=Normal(L, 0.01))}
    found = expected_accuracy(COIL, excitation(0.0), known, {"i": NOISE**2})
    assert found.std == pytest.approx({"R": 0.1, "L": 0.01})
    assert found.log_determinant == pytest.approx(2.0 * math.log(R / 0.1 * L / 0.01))
    with pytest.raises(InputError, match="noise level of 'i' is unknown"):
        expected_accuracy(COIL, excitation(1.0), PARAMETERS, {})


def test_expected_accuracy_includes_a_delay_of_half_a_sample() -> None:
    """Against least squares with late and early outputs as parameters, by closed form."""
    found = sensitivity_functions(COIL, excitation(2.0), PARAMETERS)
    current = 2.0 / R * (1.0 - np.exp(-R / L * TIMES))
    rises = 0.29 * np.diff(current)
    late, early = np.append(0.0, -rises), np.append(rises, 0.0)
    rows = np.column_stack([found.values[:, 0] / found.magnitudes, late, early]) / NOISE
    rows = np.vstack([rows, np.sqrt(2.0) * np.eye(4)[2:]])
    expected = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    own = expected_accuracy(COIL, excitation(2.0), PARAMETERS, {"i": NOISE**2})
    assert list(own.std.values()) == pytest.approx(expected[:2], rel=1e-3)
    plain = expected_accuracy(COIL, excitation(2.0), PARAMETERS, {"i": NOISE**2}, delay_std=0.0)
    assert plain.std["L"] < 0.9 * own.std["L"] and plain.log_determinant > own.log_determinant


def test_expected_accuracy_of_a_spectrum_is_that_of_its_fit(tmp_path: Path) -> None:
    """With noise in proportion to the magnitude: against σ of an identification."""
    rows = np.logspace(-1.0, 2.0, 31)
    impedance = R + 2j * np.pi * L * rows
    table = pd.DataFrame({"f": rows, "re": impedance.real, "im": impedance.imag})
    table.to_csv(tmp_path / "plan.csv", index=False)
    (tmp_path / "study.toml").write_text(
        f"""[model]
fmu = '{FMUS / "Coil/Coil.fmu"}'
[[experiments]]
kind = "frequency"
data = "plan.csv"
frequency = "f"
responses.Z = {{ of = "u / i", real = "re", imaginary = "im" }}
[parameters]
R = {{ start = {R} }}
L = {{ start = {L} }}
[noise]
reading_std = 0.003
""",
        encoding="utf-8",
    )
    study = Study.read(tmp_path / "study.toml")
    ranked = ranked_excitations(study, [tmp_path / "plan.csv"])
    assert np.isnan(ranked["duration"][0])
    found = identify(study.problem())
    expected = [ranked[f"{name}.std"][0] for name in found.names]
    np.testing.assert_allclose(expected, found.std, rtol=1e-3)
