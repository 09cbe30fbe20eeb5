"""Tables with several clocks, coarse time stamps and marks of missing samples: read right, or refused."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fmuid import Experiment, InputError, Study, datasets, read_data

COUNT = 60
TIMES = 0.7e-3 * np.arange(COUNT)


def signal(times: np.ndarray) -> np.ndarray:
    return np.sin(40.0 * times) + 0.3 * np.cos(170.0 * times)


def written(folder: Path, **columns: object) -> Path:
    path = folder / "table.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("names", [("t_u", "u", "t_i", "i"), ("time", "u", "time.1", "i")], ids=str)
def test_each_column_has_its_own_clock(tmp_path: Path, names: tuple[str, str, str, str]) -> None:
    """The output 2.1 ms later, on a clock of its own: the input is interpolated, the output stays."""
    later = TIMES + 2.1e-3
    columns = dict(zip(names, (TIMES, signal(TIMES), later, 2.0 * signal(later)), strict=True))
    frame = read_data(written(tmp_path, **columns), "time")
    experiment = Experiment(frame, [names[1]], [names[3]])
    measured = experiment.counted[:, 0]
    assert measured.sum() > COUNT - 5
    times = experiment.times[measured]
    assert experiment.output_values[measured, 0] == pytest.approx(2.0 * signal(times), abs=1e-9)
    assert experiment.input_values[:, 0] == pytest.approx(signal(experiment.times), abs=2e-3)


def test_equal_clocks_are_one(tmp_path: Path) -> None:
    frame = read_data(written(tmp_path, time=TIMES, u=signal(TIMES), t_i=TIMES, i=signal(TIMES)))
    assert len(frame) == COUNT


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"i": TIMES, "t": TIMES, "t 2": TIMES + 1e-4, "u": TIMES}, "several time columns"),
        ({"t_u": TIMES, "u": TIMES, "t_i": 1.5 * TIMES + 9.0, "i": TIMES}, "no time in common"),
    ],
    ids=["which", "apart"],
)
def test_unclear_clocks_are_refused(tmp_path: Path, columns: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_data(written(tmp_path, **columns))


def test_coarse_stamps_are_rebuilt_or_refused(tmp_path: Path) -> None:
    """A clock of 1 ms under samples of 0.7 ms: by the rate, by the count of a long record, or refused."""
    long = 0.7e-3 * np.arange(4000)
    stamps = np.floor(long / 1e-3 + 1e-9) * 1e-3
    path = written(tmp_path, time=stamps, u=signal(long))
    assert read_data(path)["time"].to_numpy() == pytest.approx(long, rel=2e-3, abs=1e-3)
    given = read_data(path, sample_rate=1.0 / 0.7e-3)
    assert given["time"].to_numpy() == pytest.approx(long, abs=1e-9)
    with pytest.raises(InputError, match="contradicts"):
        read_data(path, sample_rate=2000.0)
    short = written(tmp_path, time=stamps[:40], u=signal(long[:40]))
    with pytest.raises(InputError, match="Set sample_rate"):
        read_data(short)


@pytest.mark.parametrize("mark", ["-9999", "9.9E+37", "1e6"])
def test_far_values_are_never_fitted_in_silence(tmp_path: Path, mark: str) -> None:
    cells = [f"{each:.6g}" for each in signal(TIMES)]
    cells[7] = cells[20] = mark
    path = written(tmp_path, time=TIMES, u=signal(TIMES), i=cells)
    if mark == "9.9E+37":  # SCPI's infinity
        assert Experiment(read_data(path), ["u"], ["i"]).counted.sum() == COUNT - 2
        return
    with pytest.raises(InputError, match=r"far beyond all others\. Set missing"):
        Experiment(read_data(path), ["u"], ["i"])
    assert Experiment(read_data(path, missing=[float(mark)]), ["u"], ["i"]).counted.sum() == COUNT - 2
    assert Experiment(read_data(path, missing=[]), ["u"], ["i"]).counted.sum() == COUNT


@pytest.mark.parametrize("encoding", ["cp932", "gbk", "utf-16-le", "utf-8", "cp1252"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    name = {"cp932": "電流", "gbk": "电流"}.get(encoding, "Strom Ä")
    text = f"time,{name}\r\n" + "".join(f"{t:.4f},{x:.6f}\r\n" for t, x in zip(TIMES, signal(TIMES), strict=True))
    (tmp_path / "table.csv").write_bytes(text.encode(encoding))
    assert list(read_data(tmp_path / "table.csv").columns) == ["time", name]


def test_headers_of_several_lines_and_bare_returns(tmp_path: Path) -> None:
    head = '"time\n[s]","voltage\nof phase a [V]",i\n'
    rows = "".join(f"{t:.4f},{x:.6f},1.5\n" for t, x in zip(TIMES, signal(TIMES), strict=True))
    (tmp_path / "table.csv").write_text(head + rows)
    frame = read_data(tmp_path / "table.csv")
    assert list(frame.columns) == ["time", "voltage of phase a", "i"] and len(frame) == COUNT
    (tmp_path / "mac.csv").write_bytes(("time,u\n" + "0,1\n1,2\n2,5\n").replace("\n", "\r").encode())
    assert read_data(tmp_path / "mac.csv")["u"].tolist() == [1.0, 2.0, 5.0]


def test_dates_with_dots_begin_with_the_day(tmp_path: Path) -> None:
    rows = "".join(f"01.03.2026 10:00:0{k};{k}\n" for k in range(5))
    (tmp_path / "table.csv").write_text("time;u\n" + rows)
    assert read_data(tmp_path / "table.csv").attrs["begin"].month == 3


def test_a_slower_input_on_the_same_times(tmp_path: Path) -> None:
    """Empty cells between even samples are a slower rate; other gaps name keys that fill them."""
    times = 0.01 * np.arange(300)
    rows = np.arange(300)
    slow = np.where(rows % 50 == 10, times, np.nan)
    experiment = Experiment(read_data(written(tmp_path, time=times, u=slow, i=1.0)), ["u"], ["i"])
    np.testing.assert_allclose(experiment.times, times[10:261])
    np.testing.assert_allclose(experiment.input_values[:, 0], times[10:261])
    pauses = read_data(written(tmp_path, time=times, u=np.where((rows // 30) % 3 == 1, times, np.nan), i=1.0))
    with pytest.raises(InputError, match="has no value in row 1") as caught:
        Experiment(pauses, ["u"], ["i"])
    keys = tomllib.loads(str(caught.value).partition("Fill the gap, ")[2].partition(", or")[0])["preprocess"]
    assert keys == {"fill_missing": {"u": "linear"}, "max_gap": 0.61, "start_time": 0.3, "end_time": 2.39}
    roles = {"data": "table.csv", "inputs": ["u"], "outputs": ["i"], "preprocess": keys}
    study = Study.of({**datasets.coil().study, "experiments": [roles]}, tmp_path / "study.toml")
    np.testing.assert_allclose(study.problem().experiments[0].input_values[:, 0], times[30:240])
