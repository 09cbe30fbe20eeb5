"""Instances of the shipped FMUs."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.paths import FMUS
from tests.support.shipped_instances import Instance, Opener


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture
def opened(unpacked: Path) -> Iterator[Opener]:
    instances: list[Instance] = []

    def open_instance(model: str, model_exchange: bool = False) -> Instance:
        instances.append(Instance(FMUS / model / f"{model}.fmu", model_exchange, unpacked / model))
        return instances[-1]

    yield open_instance
    for instance in instances:
        instance.free()
