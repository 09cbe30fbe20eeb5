"""Whole runs give the numbers that they gave, within what another machine may make of them."""

import pytest

from tests.golden.numbers import differences, load
from tests.golden.runs import DATA, RECORDED, RUNS
from tests.support.paths import HERE

KEPT = load(HERE.parent / "golden" / "numbers.json")


LONG = "start im 4 100"
"""As long as all others together."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.campaign if name == LONG else pytest.mark.slow) for name in RUNS]
)
def test_a_run_gives_its_numbers(name: str) -> None:
    if name in RECORDED and not DATA.is_dir():
        pytest.skip("recorded data of others, which the project does not have")
    assert differences(RUNS[name](), KEPT[name]) == []


def test_differences_are_seen() -> None:
    kept: dict[str, float | str] = {"value.R": 4.0, "std.R": 0.1, "text.outcome": "converged", "count.iterations": 7}
    assert differences(dict(kept), kept, exact=True) == []
    moved = kept | {"value.R": 4.001, "count.iterations": 8}
    assert differences(moved, kept) == []
    assert len(differences(moved, kept, exact=True)) == 2
    assert differences(kept | {"value.R": 4.01}, kept) == ["value.R: 4.01, kept 4.0"]
    assert differences(kept | {"text.outcome": "stalled"}, kept) == ["text.outcome: 'stalled', kept 'converged'"]
    assert differences({"value.R": 4.0}, kept) == ["other names: ['count.iterations', 'std.R', 'text.outcome']"]
