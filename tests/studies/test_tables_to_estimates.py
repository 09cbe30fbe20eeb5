"""From one record in many forms to the same estimates by `fmuid init` and `fmuid identify`, or to a sentence."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmuid.apps.cli.options import DONE
from tests.support.coil_study import fmuid_, result
from tests.support.exported import export_text
from tests.support.paths import ROOT
from tests.support.table_variants import MODEL, SAID, TRUTH, writers

WRITERS = writers()

ROUGH = dict.fromkeys(("steps as two samples", "rates.tdms", "rates.h5"), 0.05)
"""Variants with other samples, and how far their estimates are from those of the plain table, relative."""


def test_the_page_counts_all_forms() -> None:
    page = (ROOT / "docs/tables.md").read_text(encoding="utf-8")
    assert SAID.keys() <= WRITERS.keys()
    assert f"one recording in {len(WRITERS)} forms. From {len(WRITERS) - len(SAID)} of them" in page


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_text(tmp_path_factory.mktemp("motor"), MODEL)


def estimates(motor: Path, folder: Path, variant: str) -> dict[str, dict[str, float]]:
    """Write a variant, begin a study of it and identify; nothing is edited in between."""
    name, write = WRITERS[variant]
    folder.mkdir(exist_ok=True)
    write(folder / name)
    assert fmuid_("init", motor, folder / name, "--output", folder / "study.toml") == DONE
    results = folder / "results"
    assert fmuid_("identify", folder / "study.toml", "--output", results, "--no-isolation", "--no-report") == DONE
    found: dict[str, dict[str, float]] = result(results)["parameters"]
    return found


@pytest.fixture(scope="module")
def expected(motor: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, dict[str, dict[str, float]]]:
    """The estimates of the plain table, and of the one in which three samples are missing (True)."""
    folder = tmp_path_factory.mktemp("plain")
    return {gaps: estimates(motor, folder / str(gaps), ("plain", "missing: empty")[gaps]) for gaps in (False, True)}


@pytest.mark.parametrize(
    "variant",
    [
        pytest.param(name, marks=pytest.mark.campaign if k % 8 else pytest.mark.slow)
        for k, name in enumerate(name for name in WRITERS if name not in SAID)
    ],
)
def test_the_same_estimates(
    motor: Path, expected: dict[bool, dict[str, dict[str, float]]], tmp_path: Path, variant: str
) -> None:
    reference = expected[variant.startswith("missing")]
    found = estimates(motor, tmp_path, variant)
    assert found.keys() == reference.keys() == TRUTH.keys()
    close = ROUGH.get(variant, 1e-6)
    for name, each in found.items():
        assert each["value"] == pytest.approx(reference[name]["value"], rel=close)
        assert each["std"] == pytest.approx(reference[name]["std"], rel=1.0 if variant in ROUGH else 1e-3)
        assert abs(each["value"] - TRUTH[name]) < 4 * each["std"]


@pytest.mark.parametrize("variant", SAID)
def test_a_sentence(motor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], variant: str) -> None:
    name, write = WRITERS[variant]
    write(tmp_path / name)
    fmuid_("init", motor, tmp_path / name, "--output", tmp_path / "study.toml")
    said = "".join(capsys.readouterr())
    assert f"{name}: " in said
    assert SAID[variant] in said
