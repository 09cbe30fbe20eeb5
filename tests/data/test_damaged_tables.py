"""Damaged binary files: each is a table or one sentence, whatever the library that reads it does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from scipy.io import savemat

from fmuid import Experiment, InputError, read_data
from tests.support import table_variants as variants
from tests.support.fuzz_spoil import mutated

SHORT = 12
"""Rows of a table: headers and structure are most of its file."""
FRAME = variants.FRAME[:SHORT]
WRITERS: dict[str, Callable[[Path], object]] = {
    **{name: variants.FILES[name] for name in ("a.h5", "compound.h5", "v73.mat", "a.tdms", "a.mf4", "a.mdf", "a.ods")},
    "dates.xlsx": variants.FILES["dates.xlsx"],
    "fixed.h5": lambda path: FRAME.to_hdf(path, key="run"),
    "table.h5": lambda path: FRAME.assign(state="on").to_hdf(path, key="run", format="table", index=False),
    "packed.mat": lambda path: savemat(path, {"run": {"rig": "4", **FRAME}, "names": [*FRAME]}, do_compression=True),
    "v5.mat": lambda path: savemat(path, {"run": {"rig": "4"}, "n": FRAME["u"].astype("i2").to_numpy(), **FRAME}),
    "v4.mat": lambda path: savemat(path, {str(name): values.to_numpy() for name, values in FRAME.items()}, format="4"),
    "result.mat": variants.FILES["Motor_res.mat"],
    "a.parquet": lambda path: FRAME.assign(state="on").set_index("time").to_parquet(path),
    "a.feather": lambda path: FRAME.assign(state="on").to_feather(path),
}


COUNTS = [pytest.param(50, marks=pytest.mark.slow), pytest.param(500, marks=pytest.mark.campaign)]


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", WRITERS)
def test_damaged_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, count: int) -> None:
    """Mutations, of which none ends this process."""
    for each in ("FRAME", "MS", "IN_RPM", "IN_MA", "DATES"):
        monkeypatch.setattr(variants, each, getattr(variants, each)[:SHORT])
    monkeypatch.setattr("fmuid.data.readers.base.READING_SECONDS", 3.0)  # some damage lets HDF5 run in circles
    path = tmp_path / name
    WRITERS[name](path)
    sound, rng = path.read_bytes(), Random(name)
    refused = 0
    for _ in range(count):
        path.write_bytes(mutated(rng, sound))
        try:
            frame = read_data(path)
            Experiment(frame, ["u"], ["i", "w"])
        except InputError as error:
            assert "\n" not in str(error)
            refused += 1
    assert refused > count / 10
