"""Spoiled studies, tables, FMUs, packages and results: each ends in one clear sentence or in a right result.

What is spoiled and how is drawn, the same every time. With ``FMUID_FUZZ=100`` a hundred times as many cases are drawn,
others each time.
"""

import os
from collections.abc import Iterator
from random import Random, SystemRandom

import pytest

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
    first = 0 if MORE == 1 else SystemRandom().randrange(2**32)
    for seed in range(first, first + EXAMPLES[name] * MORE):
        print(f"seed {seed}")  # shown where it fails
        with fuzz.prepared(result) as place:
            fuzz.CASES[name](Random(seed), place)
