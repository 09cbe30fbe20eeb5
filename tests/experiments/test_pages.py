"""Pages of the experiments show what their committed tables say."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd
import pytest

from experiments import pages
from experiments.closed_loop_bias import study as closed_loop
from experiments.coil import calls as coil_calls
from experiments.coil import onsets as coil_onsets
from experiments.coil import squared
from experiments.coil import study as coil
from experiments.equation_error import study as equation_error
from experiments.induction_machine import chapter
from experiments.machine_faults import calls as machine_calls
from experiments.machine_faults import onsets as machine_onsets
from experiments.machine_faults import study as machine
from experiments.starts import study as starts

Tables = Callable[[pd.DataFrame], Mapping[str, str]]


def one(name: str, table: Callable[[pd.DataFrame], str]) -> Tables:
    return lambda found: {name: table(found)}


@pytest.mark.parametrize(
    ("file", "tables"),
    [
        (coil.HERE / "draws.csv", one("draws", coil.draws_table)),
        (coil.HERE / "alarms.csv", one("alarms", coil.alarms_table)),
        (coil.HERE / "calls.csv", coil_calls.tables),
        (coil.HERE / "unlisted.csv", coil_calls.unlisted),
        (coil.HERE / "squared.csv", one("squared", squared.squared_table)),
        (coil_onsets.FILE, one("onsets", coil_onsets.table)),
        (machine.HERE / "draws.csv", machine.tables),
        (machine.HERE / "calls.csv", machine_calls.tables),
        (machine_onsets.FILE, one("onsets", machine_onsets.table)),
        (closed_loop.HERE / "bias.csv", one("bias", closed_loop.table)),
        (equation_error.HERE / "bias.csv", one("bias", equation_error.table)),
        (chapter.HERE / "iterations.csv", one("iterations", chapter.iterations_table)),
        (starts.HERE / "draws.csv", one("draws", starts.table)),
    ],
)
def test_page_shows_the_committed_table(file: Path, tables: Tables) -> None:
    page = (file.parent / "README.md").read_text(encoding="utf-8")
    found = pd.read_csv(file, keep_default_na=file.name not in ("calls.csv", "unlisted.csv"))
    assert pages.insert(page, tables(found)) == page, "run python -m experiments.regenerate"


def test_page_without_place_for_a_table_is_refused() -> None:
    with pytest.raises(ValueError, match="the table other"):
        pages.insert("a page", {"other": "| a |"})
