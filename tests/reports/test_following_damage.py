"""A monitoring in operation goes on: whatever the first record is, and whatever has become of its files."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.coil import study as coil
from fmuid.data.npz import read_arrays, write_arrays
from fmuid.diagnosis import monitor as monitoring
from fmuid.diagnosis.monitor_store import MonitorStore
from fmuid.diagnosis.windows import summed
from fmuid.reports import write_report
from fmuid.runs import follow as following
from fmuid.runs import log_follower as follower
from tests.support.coil_records import warming
from tests.support.running import run_following, run_monitoring

GOOD, FAULTY = warming(3, to=4.0), warming(3, to=4.0, fails=0.0, size=1.0)
RULE = "[monitoring]\nwindow_length = 1.0\nwarmup = 0.2\n"
HORIZON = "false_alarm_horizon = 3600.0\n"

STARTS: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "sound": lambda table: table,
    "another column": lambda table: table.rename(columns={"u": "v"}),
    "too short": lambda table: table.iloc[:300],
    "two rows": lambda table: table.iloc[:2],
    "no rows": lambda table: table.iloc[:0],
    "no output": lambda table: table.assign(i=math.nan),
    "no input": lambda table: table.assign(u=math.nan),
    "an FMU that fails": lambda table: table.assign(u=1e308),
}


def text_changed(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Return what changes the text of a state."""

    def damage(path: Path) -> None:
        arrays = read_arrays(path)
        text = json.loads(arrays.pop("text").tobytes())
        change(text)
        write_arrays(path, {"text": np.frombuffer(json.dumps(text).encode(), np.uint8), **arrays})

    return damage


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 0x10
    path.write_bytes(content)


SPOIL: dict[str, Callable[[Path], Any]] = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "empty": lambda path: path.write_bytes(b""),
    "garbage": lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
    "flipped": flipped,
    "missing": lambda path: path.unlink(),
}
STATE: dict[str, Callable[[Path], Any]] = {
    "of another version": text_changed(lambda text: text.update(version="0.0.1") or text["same"]["rule"].pop("level")),
    "read otherwise": text_changed(lambda text: text["beside"]["followed"]["files"][0].update(new=1)),
    "of other coordinates": lambda path: write_arrays(path, read_arrays(path) | {"total": np.zeros((0, 0))}),
    "of too many windows": text_changed(lambda text: text.update(windows=10**9)),
    "of other types": text_changed(lambda text: text.update(records=[1])),
}
DAMAGES = [(name, how) for name in ("monitoring.npz", "monitoring.csv") for how in SPOIL]
DAMAGES += [("monitoring.npz", how) for how in STATE]


def plant(folder: Path, change: Callable[[pd.DataFrame], pd.DataFrame], rule: str = RULE + HORIZON) -> Path:
    """Return a folder with a study, and records the first of which is changed; the second one is faulty."""
    (folder / "records").mkdir(parents=True)
    shutil.copytree(coil.HERE / "healthy", folder / "healthy")
    change(GOOD).to_parquet(folder / "records" / "a.parquet")
    FAULTY.to_parquet(folder / "records" / "b.parquet")
    GOOD.to_csv(folder / "test1.csv", index=False)
    text = (coil.HERE / "test.toml").read_text(encoding="utf-8").replace("../../fmus", coil.FMUS.as_posix())
    (folder / "study.toml").write_text(text + rule, encoding="utf-8")
    return folder


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follower, "SETTLED", 0.0)
    monkeypatch.setattr(following, "EVERY", 0.01)


def follow(folder: Path, rounds: int = 2) -> list[str]:
    """Follow the records of a folder for some rounds; return what is said."""
    said: list[str] = []
    idle: list[bool] = []

    def until(watching: following.FollowStatus) -> bool:
        idle.append(watching.idle)
        return len(idle) >= rounds

    run_following(
        folder / "study.toml",
        folder / "records",
        folder / "out",
        show=lambda at: said.extend(map(str, at.remarks)),
        until=until,
    )
    return said


def events(folder: Path) -> list[str]:
    return [json.loads(line)["event"] for line in (folder / "out" / "alarms.jsonl").read_text().splitlines()]


def rows(folder: Path) -> pd.DataFrame:
    return pd.read_csv(folder / "out" / "monitoring.csv")


def slow_but(quick: tuple[object, ...], given: Any) -> list[Any]:
    """Return parameters all of which are slow but some."""
    return [each if each in quick else pytest.param(each, marks=pytest.mark.slow) for each in given]


@pytest.mark.parametrize("start", slow_but(("too short", "an FMU that fails"), STARTS))
def test_bad_first_recording_is_told_once(tmp_path: Path, start: str) -> None:
    folder = plant(tmp_path / "a", STARTS[start])
    said = follow(folder)
    assert len(said) == (start != "sound")
    assert all("a.parquet" in each for each in said)
    found = rows(folder)
    assert follow(folder) == []
    pd.testing.assert_frame_equal(rows(folder), found)
    assert events(folder) == ["raised"]
    if start != "sound":  # the next recordings are examined as without it
        alone = plant(tmp_path / "b", STARTS["sound"])
        (alone / "records" / "a.parquet").unlink()
        follow(alone)
        pd.testing.assert_frame_equal(rows(alone), found)


def test_growing_data_need_a_horizon(tmp_path: Path) -> None:
    folder = plant(tmp_path / "a", STARTS["sound"], RULE)
    for path in (folder / "records").iterdir():
        path.unlink()
    FAULTY.to_csv(folder / "records" / "log.csv", index=False)
    for _ in range(2):
        (said,) = follow(folder)
        assert "false_alarm_horizon" in said
    assert not (folder / "out" / "monitoring.csv").exists()
    with (folder / "study.toml").open("a") as file:
        file.write(HORIZON)
    assert follow(folder) == []
    assert len(rows(folder)) == 3


def test_report_without_windows(tmp_path: Path) -> None:
    folder = plant(tmp_path / "a", STARTS["too short"])
    (folder / "records" / "b.parquet").unlink()
    run_following(folder / "study.toml", folder / "records", folder / "out", until=lambda watching: watching.idle)
    assert write_report(folder / "out").is_file()


def test_append_after_following(tmp_path: Path) -> None:
    folder = plant(tmp_path / "a", STARTS["too short"])
    faulty = (folder / "records" / "b.parquet").rename(folder / "b.parquet")
    follow(folder)
    run_monitoring(folder / "study.toml", [faulty], folder / "out", append=True)
    assert len(rows(folder)) == 3
    GOOD.to_parquet(folder / "records" / "c.parquet")
    assert len(follow(folder)) == 1  # the first record is wrong still
    assert rows(folder)["record"].unique().tolist() == ["b", "c"]
    assert events(folder).count("raised") == 1
    GOOD.to_parquet(folder / "d.parquet")
    run_monitoring(folder / "study.toml", [folder / "d.parquet"], folder / "out", append=True)
    assert follow(folder) == []
    assert events(folder).count("raised") == 1


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a monitoring that was stopped, with a further recording."""
    folder = plant(tmp_path_factory.mktemp("stopped") / "a", STARTS["too short"])
    follow(folder)
    GOOD.to_parquet(folder / "records" / "c.parquet")
    return folder


QUICK = (("monitoring.npz", "truncated"), ("monitoring.csv", "empty"))


@pytest.mark.parametrize("damage", slow_but(QUICK, DAMAGES))
def test_damaged_files_are_put_aside_once(stopped: Path, tmp_path: Path, damage: tuple[str, str]) -> None:
    folder, (name, how) = shutil.copytree(stopped, tmp_path / "a"), damage
    before = rows(folder)
    (SPOIL | STATE)[how](folder / "out" / name)
    here = folder / "out" / ("monitoring.csv" if how == "of too many windows" else name)
    of_record, said = sorted(follow(folder), key=lambda each: "resumable" in each)
    assert "a.parquet" in of_record
    assert said.startswith(f"{here}: earlier run not resumable (")
    assert str(folder / "out" / "earlier-1") in said
    assert follow(folder) == []
    after = rows(folder)
    assert after["record"].unique().tolist() == [*before["record"].unique(), "c"]
    pd.testing.assert_frame_equal(after.iloc[: len(before)], before)
    assert events(folder)[0] == "raised" and events(folder).count("raised") == 1
    kept = {path.name for path in (folder / "out" / "earlier-1").iterdir()}
    assert kept | {name} == {"monitoring.npz", "monitoring.csv", "monitoring.json", "alarms.jsonl"}


@pytest.mark.parametrize("kept", [b"", b"1\n", b"1\n2\n"])
def test_alarm_log_that_was_cut_has_no_hole(tmp_path: Path, kept: bytes) -> None:
    journal = MonitorStore(tmp_path)
    journal._add("alarms.jsonl", "1\n2\n")
    (tmp_path / "alarms.jsonl").write_bytes(kept)
    journal._add("alarms.jsonl", "3\n")
    journal._add("alarms.jsonl", "4\n")
    assert (tmp_path / "alarms.jsonl").read_bytes() == kept + b"3\n4\n"


def test_singular_recording_is_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, calls = plant(tmp_path / "a", STARTS["sound"]), list[int]()

    def singular(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise np.linalg.LinAlgError("Singular matrix")
        return summed(*arguments)

    monkeypatch.setattr(monitoring, "summed", singular)
    (said,) = follow(folder)
    assert said.endswith("a.parquet: Singular matrix")
    assert rows(folder)["record"].unique().tolist() == ["b"]
