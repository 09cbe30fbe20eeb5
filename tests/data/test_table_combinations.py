"""Drawn combinations of encoding, separator, header, units, clock and gaps: read within the digits, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmuid import Experiment, InputError, read_data
from fmuid.units import parse_unit
from tests.support.table_combinations import Written, drawn

COHERENT = {"u": "V", "i": "A", "w": "rad/s"}
PARTS = [
    (40, 60),
    *(pytest.param((first, first + 115), marks=pytest.mark.slow) for first in (0, *range(60, 500, 110))),
]


@pytest.mark.parametrize("part", PARTS, ids=str)
def test_combinations(tmp_path: Path, part: tuple[int, int]) -> None:
    path, read = tmp_path / "a.csv", 0
    for seed in range(*part):
        written = drawn(seed)
        path.write_bytes(written.content)
        try:
            found = Experiment(read_data(path), ["u"], ["i", "w"])
        except InputError as error:
            assert "\n" not in str(error)
            continue
        read += 1
        check(found, written)
    assert read >= 0.75 * len(range(*part))


def check(found: Experiment, written: Written) -> None:
    """Compare samples in SI at their own times; an unknown unit stays, and refuses its column where it is used."""
    samples = dict(zip("uiw", np.column_stack([found.input_values, found.output_values]).T, strict=True))
    zero = written.times["u"][0] - (0.0 if written.choices["clock"] == "second" else found.times[0])
    for name, values in samples.items():
        said, unit = written.choices["unit"][name], found.units.get(name, "")
        if name in written.unknown:
            assert (unit, parse_unit(unit)) == (written.unknown[name], None), written.choices
            continue
        times, expected = written.times[name] - zero, written.values[name]
        inside = (times > found.times[0] - 1e-9) & (times < found.times[-1] + 1e-9)
        places = np.abs(found.times[:, None] - times[inside]).argmin(axis=0)
        reached = 2e-3 * times[-1] if written.choices["clock"] == "rounded" else 1e-7  # the interval was rebuilt
        np.testing.assert_allclose(found.times[places], times[inside], atol=reached, err_msg=str(written.choices))
        assert inside.sum() >= len(times) - 1
        if written.choices["clock"] != "second":
            assert len(found.times) == len(times), written.choices
        factor = parse_unit(unit).factor / parse_unit(COHERENT[name]).factor if said else 1.0  # type: ignore[union-attr]
        np.testing.assert_allclose(
            factor * values[places], expected[inside], rtol=1e-9, atol=1e-12, err_msg=str(written.choices)
        )
        if written.choices["clock"] == "second" and name != "u":
            assert np.isfinite(values).sum() == np.isfinite(expected[inside]).sum()
