"""Spoiled studies, tables, FMUs, packages and results: each ends in one clear sentence or in a right result.

Hypothesis draws what is spoiled and how, the same every time. With ``FMUID_FUZZ=100`` it draws a hundred times as many
cases, others each time.
"""

import os
from collections.abc import Iterator
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support import fuzz_cases as fuzz

MORE = int(os.environ.get("FMUID_FUZZ", "1"))
EXAMPLES = {"study": 35, "override": 25, "nested": 5, "table": 35, "fmu": 30, "result": 30, "package": 25, "batch": 35}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The result of a good study, in surroundings of its own: a cache, and no figures written."""
    with pytest.MonkeyPatch.context() as patched:
        cache = tmp_path_factory.mktemp("cache")
        patched.setattr("platformdirs.user_cache_dir", lambda name: str(cache / name))
        fuzz.fast(patched)
        yield fuzz.first_result(tmp_path_factory.mktemp("result"))


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.CASES)
def test_fuzz(result: str, name: str) -> None:
    @settings(
        max_examples=EXAMPLES[name] * MORE,
        derandomize=MORE == 1,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(rng=st.randoms(use_true_random=False))
    def every(rng: Random) -> None:
        with fuzz.prepared(result) as place:
            fuzz.CASES[name](rng, place)

    every()
