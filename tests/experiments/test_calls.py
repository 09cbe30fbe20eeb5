"""Campaigns of calls: what is shared between records is what each would give by itself, and pages show the counts."""

import re
from decimal import Context, Decimal
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest
from scipy import stats

from experiments import calls, pages
from experiments.coil import calls as coil
from experiments.machine_faults import calls as machine
from experiments.machine_faults import detectable, neighbours


def test_rates_have_their_exact_intervals() -> None:
    low, high = calls.interval(4, 400)
    assert stats.binom.sf(3, 400, low / 100) == pytest.approx(0.025, rel=1e-6)
    assert stats.binom.cdf(4, 400, high / 100) == pytest.approx(0.025, rel=1e-6)
    assert calls.interval(0, 10)[0] == 0.0
    assert calls.interval(10, 10)[1] == 100.0
    assert [calls.rate(each) for each in ([True, False], [True], [])] == ["50.0 (1.3–98.7)", "100", ""]


@pytest.mark.slow
@pytest.mark.parametrize("module", [detectable, neighbours])
def test_the_page_shows_how_few_turns_are_called_and_which_bars(module: ModuleType) -> None:
    page = (module.HERE / "README.md").read_text(encoding="utf-8")
    now = pages.insert(page, {module.__name__.rsplit(".")[-1]: module.shown()})
    number = r"\d+\.\d+(?:e[-+]\d+)?"
    assert re.sub(number, "", now) == re.sub(number, "", page)
    for shown, kept in zip(re.findall(number, now), re.findall(number, page), strict=True):
        digits = len(Decimal(kept).as_tuple().digits)  # the last one is the processor's
        step = Decimal(kept).next_plus(Context(prec=digits)) - Decimal(kept)
        assert abs(Decimal(shown) - Decimal(kept)) <= step, (shown, kept)


@pytest.mark.slow
@pytest.mark.parametrize(("module", "case"), [(coil, "sensor's delay, 1 ms"), (machine, "sensor a, gain + 3 %")])
def test_the_committed_records_are_these(module: ModuleType, case: str, tmp_path: Path) -> None:
    found = pd.read_csv(module.HERE / "calls.csv", keep_default_na=False)
    there = found[(found["case"] == case) & (found["record"] == 0)].iloc[0]
    again = calls.Campaign(module.setting(), tmp_path / "none.csv").row(case, module.KEYS[case], 0)
    assert again["named"] == there["named"]
    assert again["D"] == pytest.approx(float(there["D"]), rel=1e-3)
