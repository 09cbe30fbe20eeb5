"""The records that come with the package: what they are made from is in them, and they are what their script makes."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fmuid
from fmuid import datasets
from fmuid.array_types import Floats
from tools.make_datasets import MACHINE_NOISE, MACHINE_SAMPLES, MACHINE_STEP, SPEED, TABLES

NAMES = sorted(TABLES)


@pytest.mark.parametrize("name", NAMES)
def test_a_table_is_what_its_script_makes(name: str) -> None:
    """To the rounding of the file alone, six digits: the script's closed forms have no step that adapts."""
    made = TABLES[name]()
    np.testing.assert_allclose(datasets.load(name).table.to_numpy(), made.to_numpy(), rtol=5.1e-6, atol=1e-12)


def test_the_machine_obeys_its_equations() -> None:
    """Integrated by scipy from sample to sample, where the voltages have no kinks; to the error of its steps."""
    known = datasets.induction_machine()
    table, p = known.table, known.truth
    times, inputs = table["time"].to_numpy(), table[["uds", "uqs"]].to_numpy()
    noise = MACHINE_NOISE * np.random.default_rng(3).standard_normal((2, MACHINE_SAMPLES))

    states = [np.zeros(4)]
    for begin, own in zip(times[:60], inputs[:60], strict=True):
        rise = (inputs[len(states)] - own) / MACHINE_STEP

        def rates(t: float, x: Floats, begin: float = begin, own: Floats = own, rise: Floats = rise) -> list[float]:
            d, q, fd, fq = x
            ud, uq = own + (t - begin) * rise
            return [
                (ud - (p["Rs"] + p["Rr"]) * d + SPEED * p["Lf"] * q + p["Rr"] / p["Lm"] * fd + SPEED * fq) / p["Lf"],
                (uq - (p["Rs"] + p["Rr"]) * q - SPEED * p["Lf"] * d + p["Rr"] / p["Lm"] * fq - SPEED * fd) / p["Lf"],
                p["Rr"] * d - p["Rr"] / p["Lm"] * fd,
                p["Rr"] * q - p["Rr"] / p["Lm"] * fq,
            ]

        found = solve_ivp(rates, (begin, begin + MACHINE_STEP), states[-1], rtol=1e-9, atol=1e-9)
        states.append(found.y[:, -1])
    expected = np.array(states)[:, :2] + noise.T[: len(states)]
    # the file keeps six digits of up to 12 A, 5e-5 A
    np.testing.assert_allclose(table[["ids", "iqs"]].to_numpy()[: len(states)], expected, atol=6e-5, rtol=0.0)


@pytest.mark.parametrize("name", NAMES)
def test_the_true_values_lie_where_the_result_says(name: str) -> None:
    known = datasets.load(name)
    assert known == getattr(datasets, name)()
    assert known.path.stat().st_size < 30_000
    result = fmuid.identify(known.problem())
    assert result.converged
    for parameter, value in known.truth.items():
        assert abs(result[parameter] - value) < 4 * result[parameter].std, parameter


def test_a_study_of_one() -> None:
    known = datasets.coil()
    study = fmuid.Study.of(known.study, "coil.toml")
    np.testing.assert_array_equal(study.identify().values, fmuid.identify(known.problem()).values)
    with pytest.raises(fmuid.InputError, match="did you mean 'coil'"):
        datasets.load("coils")
