"""Exported FMUs and their members."""

import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest

from tests.support.paths import FMUS

MODELS = sorted(path.name for path in FMUS.iterdir() if path.is_dir())
models = pytest.mark.parametrize("model", MODELS)


def members(fmu: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def description(fmu: Path) -> ET.Element:
    return ET.fromstring(members(fmu)["modelDescription.xml"])


BASE = """model Base "line 1"
  parameter Real L = 0.1;
  input Real u;
  Real x(start=0, fixed=true);
  {declaration}
equation
  L*der(x) = u - x;
  {equation}
  annotation(experiment(StopTime=1, Interval=1e-3));
end Base;
"""
