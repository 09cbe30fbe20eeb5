"""Campaign: names of errors, intervals without a doubt, and what exposures tell, in many records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import binom

from fmuid.array_types import Floats
from fmuid.estimation import Grade
from tests.support.machine_scenes import machines
from tests.support.verdict_scenes import coils
from tests.support.verdicts import Flaw, Found, Plant

PLANTS = {"coil, 200": coils(200), "coil, 1000": coils(1000), "machine, 3000": machines()}


def least(draws: int, rate: float) -> float:
    """Return the smallest count that a rate allows, by the exact binomial test at 0.1 %."""
    return float(binom.ppf(1e-3, draws, rate))


@pytest.mark.campaign
@pytest.mark.parametrize("color", [0.0, 0.6])
@pytest.mark.parametrize(("plant", "name"), [(plant, name) for plant, own in PLANTS.items() for name in own.flaws])
def test_verdicts_in_many_records(plant: str, name: str, color: float) -> None:
    made = PLANTS[plant]
    error, found, draws = made.flaws[name], made.found(name, color), made.draws
    kinds = set(error.kinds)
    alone = sum(len(each.names) == 1 and not kinds & each.names[0] for each in found)
    assert draws - alone >= least(draws, 0.95 if kinds else 0.99)
    passed = [each for each in found if each.verdict.grade is Grade.PASSED]
    right = [bool(each.names) and len(each.names[0]) <= 2 and bool(kinds & each.names[0]) for each in found]
    told = [told_of(error, each) for each in found]
    is_shown = bool(np.median([detectable for detectable, _ in told]) <= abs(error.size))
    if not kinds:
        assert len(passed) >= least(draws, 0.97)
    elif is_shown:
        assert sum(right) >= least(draws, 0.95)
    elif error.has_truth and np.isfinite(error.size):
        check_told(made, color, found, np.array([shift for _, shift in told]))
    sure = [each for each in passed if not kinds or (each.names and kinds & each.names[0])]
    if sure and error.has_truth and (is_shown or not kinds):
        truth = np.array([made.truth[each] for each in sure[0].parameters])
        covered = np.sum([np.abs(each.values - truth) < 1.96 * each.std for each in sure], axis=0)
        assert (covered >= least(len(sure), 0.95)).all(), (covered, len(sure))


def told_of(error: Flaw, found: Found) -> tuple[float, Floats]:
    """Return the detectable size of an error, and the shift (N,) that its size makes, σ."""
    tests = [] if found.errors is None else found.errors.tests
    own = [each for each in tests if error.kinds and each.direction.kind is error.kinds[0]]
    if not own:
        return np.inf, np.zeros(len(found.before))
    strongest = max(own, key=lambda each: abs(each.score))
    return strongest.detectable, strongest.shift * error.size


def check_told(plant: Plant, color: float, found: Sequence[Found], told: Floats) -> None:
    """Compare shifts with those against the sound record with the same noise; an error may fix a parameter."""
    sounds = plant.found("honest", color)
    own = [sounds[0].parameters.index(name) for name in found[0].parameters]
    real = [(each.before - sound.before[own]) / each.std_before for each, sound in zip(found, sounds, strict=True)]
    np.testing.assert_allclose(np.mean(told, axis=0), np.mean(real, axis=0), rtol=0.2, atol=0.3)
