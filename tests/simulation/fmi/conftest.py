"""Probes of the integrators, and a cache of unpacked FMUs that is empty."""

import ctypes
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.compiled import compiled
from tests.support.integrating import Libraries, Maker, Trial
from tests.support.paths import HERE


@pytest.fixture(scope="session")
def libraries() -> Libraries:
    found = {}
    for version in (2, 3):
        found[version] = ctypes.CDLL(str(compiled(HERE / "probe" / "hybrid.c", f"-DFMI={version}")))
        found[version].make.restype = ctypes.c_void_p
        found[version].make.argtypes = [ctypes.c_double]
    return found


@pytest.fixture(params=[2, 3], ids=["fmi2", "fmi3"])
def make(request: pytest.FixtureRequest, libraries: Libraries) -> Iterator[Maker]:
    made: list[Trial] = []

    def maker(*arguments: Any, **settings: Any) -> Trial:
        made.append(Trial(libraries[request.param], request.param, *arguments, **settings))
        return made[-1]

    yield maker
    for trial in made:
        libraries[request.param].drop(trial.handle)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda name: str(folder / name))
    return folder
