"""The records that come with the package: what they are made from is in them, and they are what their script makes."""

import numpy as np
import pytest

import fmuid
from fmuid import datasets
from tools.make_datasets import TABLES

NAMES = sorted(TABLES)


@pytest.mark.parametrize("name", NAMES)
def test_a_table_is_what_its_script_makes(name: str) -> None:
    """To the rounding of the file alone, six digits: the script's closed forms have no step that adapts."""
    made = TABLES[name]()
    np.testing.assert_allclose(datasets.load(name).table.to_numpy(), made.to_numpy(), rtol=5.1e-6, atol=1e-12)


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
