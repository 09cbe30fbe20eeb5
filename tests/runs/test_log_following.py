"""Following what a logger writes: every row once, whatever happens to its files."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from fmuid.runs import LogFollower, RecordUpdate
from fmuid.runs import log_follower as module
from fmuid.studies import ExperimentSettings

STEP = 0.01


def words(**more: object) -> ExperimentSettings:
    study = {
        "model": {"fmu": str(fmuid.datasets.coil().fmu)},
        "experiments": [{"data": str(fmuid.datasets.coil().path), "inputs": ["u"], "outputs": ["i"], **more}],
        "parameters": {"R": {"start": 1.0}},
    }
    return fmuid.Study.of(study, "study.toml").experiments[0]


def lines(first: int, last: int) -> str:
    """Return rows of samples, each of which has its number as u."""
    return "".join(f"{STEP * k:.2f},{k},{0.5 * k}\n" for k in range(first, last))


HEAD = "time,u,i\n"


@pytest.fixture(autouse=True)
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are whole when they have not changed between two looks."""
    monkeypatch.setattr(module, "SETTLED", 0.0)


class Reader:
    """Takes pieces as a monitoring does: windows of 0.1 s, a transient of 0.05 s; restarted before each look."""

    def __init__(self, place: Path, given: ExperimentSettings, window: float | None = 0.1) -> None:
        self.place, self.given, self.window = place, given, window
        self.state: dict[str, Any] | None = None
        self.rows: dict[str, list[float]] = {}
        self.remarks: list[str] = []

    def look(self) -> list[str]:
        """Look once and return the remarks."""
        follower = LogFollower(self.given, self.place, self.window, 0.05, self.state)
        said: list[str] = []
        for each in follower.look():
            if not isinstance(each, RecordUpdate):
                said.append(each)
                continue
            times = each.record.times
            self.rows.setdefault(each.record.name, []).extend(each.record.input_values[:, 0].tolist())
            needed = times[-1] - 0.15 if each.grows else times[-1]
            follower.taken(each, float(needed))
        self.state = follower.state
        return said

    def seen(self, name: str) -> list[float]:
        """Return which rows of a record were seen, each once."""
        return sorted(set(self.rows[name]))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "log.csv"


@pytest.fixture
def reader(tmp_path: Path) -> Reader:
    return Reader(tmp_path, words())


def test_a_file_that_grows(log: Path, reader: Reader) -> None:
    """Half lines are waited for; little more than needed is read again."""
    text = HEAD + lines(0, 400)
    for at in [*np.random.default_rng(1).integers(10, 700, 16).cumsum().tolist(), len(text)]:
        log.write_text(text[:at])
        assert reader.look() == []
    assert reader.seen("log") == list(range(400))
    assert len(reader.rows["log"]) < 400 + 20 * 20


def test_dates_and_sample_rates_go_on(tmp_path: Path) -> None:
    begin = pd.Timestamp("2026-01-02 03:04:05")
    for given, head, rows in (
        (words(), "time,u,i", [f"{(begin + pd.Timedelta(seconds=STEP * k)).isoformat()},{k},0" for k in range(300)]),
        (words(sample_rate=100.0), "u,i", [f"{k},0" for k in range(300)]),
    ):
        folder = tmp_path / str(len(head))
        folder.mkdir()
        state: dict[str, Any] | None = None
        for stop in (100, 200, 300):
            (folder / "log.csv").write_text("\n".join([head, *rows[:stop]]) + "\n")
            follower = LogFollower(given, folder, 0.1, 0.05, state)
            (piece,) = follower.look()
            assert isinstance(piece, RecordUpdate)
            record = piece.record
            assert record.times == pytest.approx(STEP * record.input_values[:, 0])
            assert record.times[-1] == pytest.approx(STEP * (stop - 1))
            if "time" in head:
                assert record.frame.attrs["begin"] == begin
            follower.taken(piece, float(record.times[-1] - 0.15))
            state = follower.state


@pytest.mark.parametrize("copied", [False, True])
def test_a_rotated_file(log: Path, reader: Reader, copied: bool) -> None:
    """What was written before it was renamed, or copied and truncated, is read under its new name."""
    log.write_text(HEAD + lines(0, 100))
    reader.look()
    old = log.with_name("log.1.csv")
    old.write_text(HEAD + lines(0, 150))
    if not copied:
        old.replace(log).rename(old)
    log.write_text(HEAD + lines(500, 600))
    said = reader.look() + reader.look()
    assert reader.seen("log") == list(range(150))
    assert reader.seen("log (2)") == list(range(500, 600))
    assert all("replaced by another file" in each for each in said)
    assert reader.look() == []


def test_records_of_a_file(log: Path, reader: Reader) -> None:
    """Truncated; a logger that paused; one that began at 0 again and wrote its head once more."""
    log.write_text(HEAD + lines(0, 100))
    reader.look()
    log.write_text(HEAD + lines(300, 340) + lines(900, 1000) + HEAD + lines(0, 50))
    truncated, invalid = reader.look()
    assert truncated.endswith("log.csv: replaced by another file; its record is 'log (2)'.")
    assert invalid.endswith("log.csv: invalid line ignored; following rows are record 'log (4)'.")
    for number, first, last in (("", 0, 100), (" (2)", 300, 340), (" (3)", 900, 1000), (" (4)", 0, 50)):
        assert reader.seen(f"log{number}") == list(range(first, last))


def test_files_of_a_folder_in_their_order(tmp_path: Path, reader: Reader) -> None:
    for k in (2, 0, 1):
        (tmp_path / f"day{k}.csv").write_text(HEAD + lines(100 * k, 100 * k + 100))
    reader.look()
    assert list(reader.rows) == ["day0", "day1", "day2"]
    with (tmp_path / "day0.csv").open("a") as file:
        file.write(lines(300, 400))
    assert "new rows are record 'day0 (2)'" in reader.look()[0]
    reader.look()
    assert reader.seen("day0 (2)") == list(range(300, 400))


def test_parquet_files_are_read_when_whole(tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = tmp_path / "a.parquet", tmp_path / "b.parquet"
    pd.DataFrame({"time": STEP * np.arange(50), "u": np.arange(50.0), "i": 0.0}).to_parquet(one)
    content = one.read_bytes()
    with monkeypatch.context() as slow:
        slow.setattr(module, "SETTLED", 60.0)
        for written in (content[:-10], content):
            one.write_bytes(written)
            assert reader.look() == []
    assert reader.seen("a") == list(range(50))
    other.write_bytes(content[:-10])
    assert "b.parquet: not a readable Parquet table" in reader.look()[0]
    assert reader.look() == []
    other.write_bytes(content)
    reader.look()
    assert reader.seen("b (2)") == list(range(50))


@pytest.mark.parametrize("more", [{"preprocess": {"lowpass_frequency": 5.0}}, {}])
def test_what_is_prepared_as_a_whole_waits_until_it_is(
    log: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, object]
) -> None:
    reader = Reader(log.parent, words(**more), window=0.1 if more else None)
    log.write_text(HEAD + lines(0, 100))
    with monkeypatch.context() as slow:
        slow.setattr(module, "SETTLED", 60.0)
        assert reader.look() == [] and not reader.rows
    reader.look()
    assert len(reader.rows["log"]) == 100


def test_bad_tables_are_reported_once(log: Path, reader: Reader) -> None:
    log.write_text("time,v,i\n" + lines(0, 100))
    (said,) = reader.look()
    assert "log.csv" in said and "'u'" in said
    assert reader.look() == []
    log.write_text(HEAD + lines(0, 100))
    reader.look()
    assert reader.seen("log") == list(range(100))


def test_one_growing_file(log: Path) -> None:
    reader = Reader(log, words())
    for name in ("log.csv", "other.csv"):
        log.with_name(name).write_text(HEAD + lines(0, 100))
    reader.look()
    assert list(reader.rows) == ["log"]
    with pytest.raises(fmuid.InputError, match="no such folder or file"):
        Reader(log.with_name("none"), words()).look()


def test_files_that_are_gone_are_forgotten_in_the_end(
    tmp_path: Path, reader: Reader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "GONE", 2)
    for k in range(5):
        path = tmp_path / f"r{k}.csv"
        path.write_text(HEAD + lines(k, 100))
        path.with_name("s.csv").write_text(HEAD + lines(0, 10))
        reader.look()
        path.unlink()
    reader.look()
    assert reader.state is not None
    assert {"r3.csv", "r4.csv"} <= {each["file"] for each in reader.state["files"]}
    assert len(reader.state["files"]) <= 3
