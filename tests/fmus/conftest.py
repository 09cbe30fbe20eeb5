"""Instances of the shipped FMUs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy.fmi2
import pytest

from tests.support.shipped_instances import Instance, Opener


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture
def opened(unpacked: Path) -> Iterator[Opener]:
    instances: list[Instance] = []

    def open_instance(model: str, kind: type[Any] = fmpy.fmi2.FMU2Slave) -> Instance:
        instances.append(Instance(model, unpacked / model, kind))
        return instances[-1]

    yield open_instance
    for instance in instances:
        instance.fmu.fmi2FreeInstance(instance.fmu.component)
