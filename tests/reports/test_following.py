"""Monitoring in operation: what one run finds, whatever breaks it; alarms as lines, told to a command once each."""

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import fmuid
from experiments.coil import study as coil
from fmuid.apps.cli.app import run
from fmuid.data import read_arrays, write_arrays
from fmuid.diagnosis import SkippedWindow
from fmuid.diagnosis import monitor as monitoring
from fmuid.diagnosis.monitor_store import MonitorStore
from fmuid.diagnosis.windows import summed
from fmuid.files import locked
from fmuid.reports import write_report
from fmuid.reports.render.console import console
from fmuid.reports.render.following import state
from fmuid.reports.topics.monitoring import gap_remarks
from fmuid.runs import FollowStatus
from fmuid.runs import follow as following
from fmuid.runs import log_follower as follower
from tests.support.coil_records import warming
from tests.support.running import run_following, run_monitoring

GOOD, FAULTY = warming(3, to=4.0), warming(3, to=4.0, fails=0.0, size=1.0)
RULE = "[monitoring]\nwindow_length = 1.0\nwarmup = 0.2\nalarm_command = {}\n"
HORIZON = "false_alarm_horizon = 3600.0\n"
TELL = """
import json, os, sys
line = json.loads(sys.stdin.read())
assert os.environ["FMUID_FAULT"] == line["fault"]
with open("told.txt", "a") as file:
    file.write(f"{os.environ['FMUID_ID']} {os.environ['FMUID_EVENT']} {line['fault']}\\n")
"""


def equip(folder: Path, rule: str = RULE + HORIZON) -> Path:
    """Make a folder with a study of a coil, and records/ for a logger."""
    (folder / "records").mkdir(parents=True)
    (folder / "tell.py").write_text(TELL)
    shutil.copytree(coil.HERE / "healthy", folder / "healthy")
    GOOD.to_csv(folder / "test1.csv", index=False)
    text = (coil.HERE / "test.toml").read_text(encoding="utf-8").replace("../../fmus", coil.FMUS.as_posix())
    (folder / "study.toml").write_text(text + rule.format(json.dumps([sys.executable, "tell.py"])), encoding="utf-8")
    return folder


@pytest.fixture(autouse=True)
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follower, "SETTLED", 0.0)
    monkeypatch.setattr(following, "EVERY", 0.01)


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    equip(tmp_path / "plant")
    monkeypatch.chdir(tmp_path / "plant")
    return tmp_path / "plant"


def alarms(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "alarms.jsonl").read_text(encoding="utf-8").splitlines()]


def events(folder: Path) -> list[str]:
    return [each["event"] for each in alarms(folder / "out")]


def rows(folder: Path) -> pd.DataFrame:
    return pd.read_csv(folder / "out" / "monitoring.csv")


def dated(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(time=pd.Timestamp("2026-03-01 12:00") + pd.to_timedelta(table["time"], unit="s"))


def follow(folder: Path, study: Any = None, out: str = "out") -> list[FollowStatus]:
    """Follow the records of a folder until nothing is left, and once more; return what was seen."""
    seen: list[FollowStatus] = []
    until = iter(range(100))
    run_following(
        folder / "study.toml" if study is None else study,
        folder / "records",
        folder / out,
        show=seen.append,
        until=lambda at: at.idle and next(until) > 0,
    )
    return seen


def said(seen: list[FollowStatus]) -> list[str]:
    return [str(each) for at in seen for each in at.remarks]


@pytest.mark.slow
def test_growing_file_gives_what_one_run_gives(plant: Path) -> None:
    dated(warming(24, to=4.3, fails=15.4, seed=3)).to_csv(plant / "records" / "log.csv", index=False)
    text = (plant / "records" / "log.csv").read_text()
    follow(plant, out="whole")
    (whole,) = alarms(plant / "whole")
    for share in (0.1, 0.25, 0.27, 0.6, 0.61, 0.7, 0.9, 1.0):
        (plant / "records" / "log.csv").write_text(text[: int(share * len(text))])
        follow(plant)
    (raised,) = alarms(plant / "out")
    for each in (whole, raised):
        assert (each["id"], each["event"], each["fault"], each["record"], each["time"]) == (
            1,
            "raised",
            "turns",
            "log",
            16,
        )
        assert each["date"] == "2026-03-01T12:00:16"
        (change,) = each["explanations"][0]["changes"]
        low, high = change["interval"]
        assert low < 0.5 < high and change["unit"] == "Ohm" and change["name"] == "turns.dR"
        first, last = (each["onset"][end]["date"] for end in ("first", "last"))
        assert first <= "2026-03-01T12:00:15.4" <= last
        assert each["words"].startswith("ALARM turns since 15.")
    once, grown = pd.read_csv(plant / "whole" / "monitoring.csv"), rows(plant)
    assert once["window"].tolist() == grown["window"].tolist() == list(range(24))
    assert once["turns.dR"].to_numpy() == pytest.approx(grown["turns.dR"].to_numpy(), abs=0.01)
    assert once["end"].to_numpy() == pytest.approx(grown["end"].to_numpy())
    assert (plant / "told.txt").read_text() == "1 raised turns\n" * 2  # by either


def test_alarm_of_one_file_ends_with_the_next(plant: Path) -> None:
    for k in range(3):
        (FAULTY if k == 1 else GOOD).to_parquet(plant / "records" / f"r{k}.parquet")
    assert said(follow(plant)) == []
    first, *_ = alarms(plant / "out")
    assert (first["event"], first["record"], first["id"]) == ("raised", "r1", 1)
    kept = json.loads((plant / "out" / "monitoring.json").read_text())
    assert kept["windows"] == 9 and [each["fault"] for each in kept["alarms"]] == ["turns"]
    (plant / "records" / "s.csv").write_text("time,v,i\n0,1,1\n1,1,1\n2,1,1\n3,1,1\n")
    (remark,) = said(follow(plant))
    assert "s.csv: input column 'u' not found" in remark


def test_console_shows_onset_and_silence(plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    warming(4, to=4.0, fails=1.0, size=1.0).to_parquet(plant / "records" / "r.parquet")
    seen = follow(plant)
    console().print(state(seen[-1], 8.0), state(seen[-1], 1.0))
    late, soon = (" ".join(each.split()) for each in capsys.readouterr().out.split("evaluated")[1:])
    assert "no new window for 8 s" in late and "no new window" not in soon
    at = r"4 windows, up to r, 4 s now ALARM: turns onset (1|0\.9\d|1\.0\d) s of r current size turns, dR = "
    assert re.search(at, soon)
    assert re.search(r"last window turns\.dR \S+ ± \S+ Ohm R ", soon)


def test_command_is_called_again_after_an_interruption(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    FAULTY.to_csv(plant / "records" / "a.csv", index=False)

    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as breaking:
        breaking.setattr(following, "run_program", broken)
        follow(plant)
    assert not (plant / "told.txt").exists()
    follow(plant)
    assert (plant / "told.txt").read_text() == "1 raised turns\n"
    assert events(plant) == ["raised"]
    with monkeypatch.context() as breaking:
        breaking.setattr(following, "_told", broken)
        words = ["monitor", "study.toml", "records", "--follow", "-o", "new", "--no-report"]
        assert run(words) == 1
    assert [each["event"] for each in alarms(plant / "new")] == ["raised"]


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (["no-such-program"], "'no-such-program'"),
        ([sys.executable, "-c", "raise SystemExit('mail is down')"], "mail is down"),
        ([sys.executable, "-c", "import time; time.sleep(60)"], "0.3 s"),
    ],
)
def test_failing_command_is_a_remark(
    plant: Path, monkeypatch: pytest.MonkeyPatch, command: list[str], words: str
) -> None:
    monkeypatch.setattr(following, "COMMAND_SECONDS", 0.3 if "0.3" in words else 20.0)
    FAULTY.to_csv(plant / "records" / "a.csv", index=False)
    study = fmuid.Study.read(plant / "study.toml", [f"monitoring.alarm_command={json.dumps(command)}"])
    (remark,) = said(follow(plant, study))
    assert words in remark


@pytest.mark.slow
def test_memory_has_the_latest_windows_only(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "KEPT_ROWS", 5)
    for k in range(4):
        table = warming(5, to=4.0, seed=k)
        table.loc[table["time"].between(1.9, 3.1), "i"] = math.nan
        table.to_csv(plant / "records" / f"r{k}.csv", index=False)
        seen = follow(plant)
        gaps = [each for one in seen for each in one.remarks if isinstance(each, SkippedWindow)]
        assert "windows from 2 s skipped" in gap_remarks(gaps)[0].text
        assert seen[-1].monitor.gaps == ()
    table = seen[-1].monitor.table
    assert (len(table), table.index[-1], len(rows(plant))) == (5, 15, 16)


@pytest.mark.parametrize(
    ("words", "refusal"),
    [
        (["records", "records"], "excludes several folders"),
        (["records", "--resume"], "excludes --resume"),
        (["records", "--figures", "png"], "excludes --figures"),
        (["nowhere"], "nowhere: no such folder or file"),
        (["records", "--set", "monitoring.alarm_command=3"], "monitoring.alarm_command: must be a list of a program"),
        (["records", "--set", "diagnosis.faults.turns.fixed.tau=0.02"], "or its models have changed"),
        (["records", "--set", "diagnosis.false_alarm_rate=0.2"], "another rule, other faults or another healthy"),
    ],
)
def test_refusals(plant: Path, capsys: pytest.CaptureFixture[str], words: list[str], refusal: str) -> None:
    if words[-1].startswith("diagnosis."):  # refused by the state of an earlier run
        GOOD.to_csv(plant / "records" / "a.csv", index=False)
        follow(plant, out="results")
    assert run(["monitor", "study.toml", *words, "--follow"]) == 2
    error = capsys.readouterr().err
    assert refusal in error and error.count("\n") == 1


def test_folder_is_locked(plant: Path) -> None:
    refused = pytest.raises(fmuid.InputError, match="is written to by another monitoring")
    with locked(plant / "out", "monitoring"), refused:
        follow(plant)


@pytest.mark.slow
def test_killed_monitoring_loses_nothing(plant: Path) -> None:
    text = dated(warming(30, to=4.0, fails=20.0, size=1.0, seed=5)).to_csv(index=False)
    log = plant / "records" / "log.csv"
    words = [sys.executable, "-m", "fmuid", "monitor", "study.toml", "records", "--follow", "-o", "out", "--no-report"]
    for k in range(1, 5):
        log.write_text(text[: k * len(text) // 5])
        with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as killed:
            time.sleep(1.5 + 0.6 * k)
            os.kill(killed.pid, signal.SIGKILL)
    log.write_text(text)  # the last windows are those of the last process
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 600.0
        while time.monotonic() < deadline and not ((plant / "told.txt").exists() and len(rows(plant)) >= 30):
            time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        out = process.communicate()[0]
    assert process.returncode == 1
    assert rows(plant)["window"].tolist() == list(range(30))
    assert events(plant) == ["raised"]
    assert (plant / "told.txt").read_text().startswith("1 raised turns\n")
    assert "Written to" in out


# --- whatever the first record is, and whatever has become of the files

STARTS: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "sound": lambda table: table,
    "too short": lambda table: table.iloc[:300],
    "no rows": lambda table: table.iloc[:0],
    "no output": lambda table: table.assign(i=math.nan),
    "an FMU that fails": lambda table: table.assign(u=1e308),
}


def stocked(folder: Path, start: str, rule: str = RULE + HORIZON) -> Path:
    """Make a folder with records the first of which is changed; the second one is faulty."""
    equip(folder, rule.replace("alarm_command = {}\n", ""))
    STARTS[start](GOOD).to_parquet(folder / "records" / "a.parquet")
    FAULTY.to_parquet(folder / "records" / "b.parquet")
    return folder


def slow_but(quick: tuple[object, ...], given: Any) -> list[Any]:
    """Return parameters all of which are slow but some."""
    return [each if each in quick else pytest.param(each, marks=pytest.mark.slow) for each in given]


@pytest.mark.parametrize("start", slow_but(("an FMU that fails",), STARTS))
def test_bad_first_recording_is_told_once(tmp_path: Path, start: str) -> None:
    folder = stocked(tmp_path / "a", start)
    told = said(follow(folder))
    assert len(told) == (start != "sound")
    assert all("a.parquet" in each for each in told)
    found = rows(folder)
    assert said(follow(folder)) == []
    pd.testing.assert_frame_equal(rows(folder), found)
    assert events(folder) == ["raised"]
    if start != "sound":  # the next recordings are examined as without it
        alone = stocked(tmp_path / "b", "sound")
        (alone / "records" / "a.parquet").unlink()
        follow(alone)
        pd.testing.assert_frame_equal(rows(alone), found)


def test_growing_data_need_a_horizon(tmp_path: Path) -> None:
    folder = equip(tmp_path / "a", RULE.replace("alarm_command = {}\n", ""))
    FAULTY.to_csv(folder / "records" / "log.csv", index=False)
    (told,) = said(follow(folder))
    assert "false_alarm_horizon" in told
    assert not (folder / "out" / "monitoring.csv").exists()
    with (folder / "study.toml").open("a") as file:
        file.write(HORIZON)
    assert said(follow(folder)) == []
    assert len(rows(folder)) == 3


def test_append_after_following(tmp_path: Path) -> None:
    folder = stocked(tmp_path / "a", "too short")
    faulty = (folder / "records" / "b.parquet").rename(folder / "b.parquet")
    follow(folder)
    assert write_report(folder / "out").is_file()  # without windows
    run_monitoring(folder / "study.toml", [faulty], folder / "out", append=True)
    assert len(rows(folder)) == 3
    GOOD.to_parquet(folder / "records" / "c.parquet")
    assert len(said(follow(folder))) == 1  # the first record is wrong still
    assert rows(folder)["record"].unique().tolist() == ["b", "c"]
    assert events(folder).count("raised") == 1


def text_changed(change: Callable[[Any], None]) -> Callable[[Path], None]:
    """Return what changes the text of a state."""

    def damage(path: Path) -> None:
        arrays = read_arrays(path)
        text = json.loads(arrays.pop("text").tobytes())
        change(text)
        write_arrays(path, {"text": np.frombuffer(json.dumps(text).encode(), np.uint8), **arrays})

    return damage


DAMAGES: dict[tuple[str, str], Callable[[Path], Any]] = {
    ("monitoring.npz", "truncated"): lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    ("monitoring.csv", "empty"): lambda path: path.write_bytes(b""),
    ("monitoring.csv", "missing"): lambda path: path.unlink(),
    ("monitoring.npz", "of another version"): text_changed(
        lambda text: text.update(version="0.0.1") or text["same"]["rule"].pop("level")
    ),
    ("monitoring.npz", "of other coordinates"): lambda path: write_arrays(
        path, read_arrays(path) | {"total": np.zeros((0, 0))}
    ),
    ("monitoring.npz", "of too many windows"): text_changed(lambda text: text.update(windows=10**9)),
    ("monitoring.npz", "of other types"): text_changed(lambda text: text.update(records=[1])),
}


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a monitoring that was stopped, with a further recording."""
    folder = stocked(tmp_path_factory.mktemp("stopped") / "a", "too short")
    with pytest.MonkeyPatch.context() as hurried:
        hurried.setattr(follower, "SETTLED", 0.0)
        follow(folder)
    GOOD.to_parquet(folder / "records" / "c.parquet")
    return folder


@pytest.mark.parametrize("damage", slow_but((("monitoring.npz", "truncated"), ("monitoring.csv", "empty")), DAMAGES))
def test_damaged_files_are_put_aside_once(stopped: Path, tmp_path: Path, damage: tuple[str, str]) -> None:
    folder, (name, how) = shutil.copytree(stopped, tmp_path / "a"), damage
    before = rows(folder)
    DAMAGES[damage](folder / "out" / name)
    here = folder / "out" / ("monitoring.csv" if how == "of too many windows" else name)
    of_record, told = sorted(said(follow(folder)), key=lambda each: "resumable" in each)
    assert "a.parquet" in of_record
    assert told.startswith(f"{here}: earlier run not resumable (")
    assert str(folder / "out" / "earlier-1") in told
    assert said(follow(folder)) == []
    after = rows(folder)
    assert after["record"].unique().tolist() == [*before["record"].unique(), "c"]
    pd.testing.assert_frame_equal(after.iloc[: len(before)], before)
    assert events(folder)[0] == "raised" and events(folder).count("raised") == 1
    kept = {path.name for path in (folder / "out" / "earlier-1").iterdir()}
    assert kept | {name} == {"monitoring.npz", "monitoring.csv", "monitoring.json", "alarms.jsonl"}


def test_alarm_log_that_was_cut_has_no_hole(tmp_path: Path) -> None:
    journal = MonitorStore(tmp_path)
    journal._add("alarms.jsonl", "1\n2\n")
    (tmp_path / "alarms.jsonl").write_bytes(b"1\n")
    journal._add("alarms.jsonl", "3\n")
    assert (tmp_path / "alarms.jsonl").read_bytes() == b"1\n3\n"


def test_singular_recording_is_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, calls = stocked(tmp_path / "a", "sound"), list[int]()

    def singular(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise np.linalg.LinAlgError("Singular matrix")
        return summed(*arguments)

    monkeypatch.setattr(monitoring, "summed", singular)
    (told,) = said(follow(folder))
    assert told.endswith("a.parquet: Singular matrix")
    assert rows(folder)["record"].unique().tolist() == ["b"]
