"""Monitoring in operation: what one run finds, whatever breaks it; alarms as lines, told to a command once each."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import fmuid
from experiments.coil import study as coil
from fmuid.apps.cli.app import run
from fmuid.diagnosis import SkippedWindow
from fmuid.files import locked
from fmuid.reports.render.console import console
from fmuid.reports.render.following import state
from fmuid.reports.topics.monitoring import gap_remarks
from fmuid.runs import follow as following
from fmuid.runs import log_follower as follower
from fmuid.runs.follow import FollowStatus
from tests.support.coil_records import warming
from tests.support.running import run_following

TELL = """
import json, os, sys
line = json.loads(sys.stdin.read())
assert os.environ["FMUID_FAULT"] == line["fault"]
with open("told.txt", "a") as file:
    file.write(f"{os.environ['FMUID_ID']} {os.environ['FMUID_EVENT']} {line['fault']}\\n")
"""


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a study of a coil, and records/ for a logger."""
    monkeypatch.setattr(follower, "SETTLED", 0.0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "records").mkdir()
    (tmp_path / "tell.py").write_text(TELL)
    shutil.copytree(coil.HERE / "healthy", tmp_path / "healthy")
    warming(1, to=4.0).to_csv(tmp_path / "test1.csv", index=False)
    text = (coil.HERE / "test.toml").read_text(encoding="utf-8").replace("../../fmus", coil.FMUS.as_posix())
    command = json.dumps([sys.executable, "tell.py"])
    rule = f"[monitoring]\nwindow_length = 1.0\nwarmup = 0.2\nfalse_alarm_horizon = 3600.0\nalarm_command = {command}\n"
    (tmp_path / "study.toml").write_text(text + rule, encoding="utf-8")
    return tmp_path


def idle(watching: FollowStatus) -> bool:
    return watching.idle


def alarms(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "alarms.jsonl").read_text(encoding="utf-8").splitlines()]


def dated(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(time=pd.Timestamp("2026-03-01 12:00") + pd.to_timedelta(table["time"], unit="s"))


@pytest.mark.slow
def test_growing_file_gives_what_one_run_gives(plant: Path) -> None:
    table = dated(warming(24, to=4.3, fails=15.4, seed=3))
    table.to_csv(plant / "records" / "log.csv", index=False)
    text = (plant / "records" / "log.csv").read_text()
    found = run_following("study.toml", "records", "whole", until=idle)
    assert not found.healthy
    (whole,) = alarms(plant / "whole")
    for share in (0.1, 0.25, 0.27, 0.6, 0.61, 0.7, 0.9, 1.0):
        (plant / "records" / "log.csv").write_text(text[: int(share * len(text))])
        run_following("study.toml", "records", "grown", until=idle)
    (raised, *_) = grown = alarms(plant / "grown")
    assert [each["event"] for each in grown] == ["raised"]
    for each in (whole, raised):
        assert (each["id"], each["fault"], each["record"], each["time"]) == (1, "turns", "log", 16.0)
        assert each["date"] == "2026-03-01T12:00:16"
        (change,) = each["explanations"][0]["changes"]
        low, high = change["interval"]
        assert low < 0.5 < high and change["unit"] == "Ohm" and change["name"] == "turns.dR"
        first, last = (each["onset"][end]["date"] for end in ("first", "last"))
        assert first <= "2026-03-01T12:00:15.4" <= last
        assert each["words"].startswith("ALARM turns since 15.")
    rows = [pd.read_csv(plant / name / "monitoring.csv") for name in ("whole", "grown")]
    assert rows[0]["window"].tolist() == rows[1]["window"].tolist() == list(range(24))
    assert rows[0]["turns.dR"].to_numpy() == pytest.approx(rows[1]["turns.dR"].to_numpy(), abs=0.01)
    assert rows[0]["end"].to_numpy() == pytest.approx(rows[1]["end"].to_numpy())
    assert (plant / "told.txt").read_text() == "1 raised turns\n" * 2  # by either


def follow(study: Any = "study.toml", **more: Any) -> list[str]:
    """Follow the recordings until nothing is left; return the remarks."""
    remarks: list[str] = []
    run_following(study, "records", "out", show=lambda at: remarks.extend(map(str, at.remarks)), until=idle, **more)
    return remarks


def test_alarm_of_one_file_ends_with_the_next(plant: Path) -> None:
    for k in range(3):
        table = warming(3, to=4.0, fails=0.0 if k == 1 else math.inf, size=1.0, seed=k)
        table.to_parquet(plant / "records" / f"r{k}.parquet")
    assert follow() == []
    first, *_ = alarms(plant / "out")
    assert (first["event"], first["record"], first["id"]) == ("raised", "r1", 1)
    state = json.loads((plant / "out" / "monitoring.json").read_text())
    assert state["windows"] == 9 and [each["fault"] for each in state["alarms"]] == ["turns"]
    (plant / "records" / "s.csv").write_text("time,v,i\n0,1,1\n1,1,1\n2,1,1\n3,1,1\n")
    (remark,) = follow()
    assert "s.csv: input column 'u' not found" in remark


def test_console_shows_onset_and_silence(plant: Path, capsys: pytest.CaptureFixture[str]) -> None:
    warming(4, to=4.0, fails=1.0, size=1.0).to_parquet(plant / "records" / "r.parquet")
    seen: list[FollowStatus] = []
    run_following("study.toml", "records", "out", show=seen.append, until=idle)
    console().print(state(seen[-1], 8.0), state(seen[-1], 1.0))
    late, soon = (" ".join(each.split()) for each in capsys.readouterr().out.split("evaluated")[1:])
    assert "no new window for 8 s" in late and "no new window" not in soon
    at = r"4 windows, up to r, 4 s now ALARM: turns onset (1|0\.9\d|1\.0\d) s of r current size turns, dR = "
    assert re.search(at, soon)
    assert re.search(r"last window turns\.dR \S+ ± \S+ Ohm R ", soon)


def test_command_is_called_again_after_an_interruption(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    warming(6, to=4.0, fails=0.0, size=1.0).to_csv(plant / "records" / "a.csv", index=False)

    def broken(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as breaking:
        breaking.setattr(following, "run_program", broken)
        follow()
    assert not (plant / "told.txt").exists()
    follow()
    assert (plant / "told.txt").read_text() == "1 raised turns\n"
    assert len(alarms(plant / "out")) == 1


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["no-such-program"], "'no-such-program'"),
        ([sys.executable, "-c", "raise SystemExit('mail is down')"], "mail is down"),
        ([sys.executable, "-c", "import time; time.sleep(60)"], "0.3 s"),
    ],
)
def test_failing_command_is_a_remark(
    plant: Path, monkeypatch: pytest.MonkeyPatch, command: list[str], said: str
) -> None:
    monkeypatch.setattr(following, "COMMAND_SECONDS", 0.3 if "0.3" in said else 20.0)
    warming(3, to=4.0, fails=0.0, size=1.0).to_csv(plant / "records" / "a.csv", index=False)
    (remark,) = follow(fmuid.Study.read("study.toml", [f"monitoring.alarm_command={json.dumps(command)}"]))
    assert said in remark


@pytest.mark.slow
def test_memory_has_the_latest_windows_only(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "KEPT_ROWS", 5)
    for k in range(4):
        table = warming(5, to=4.0, seed=k)
        table.loc[table["time"].between(1.9, 3.1), "i"] = math.nan
        table.to_csv(plant / "records" / f"r{k}.csv", index=False)
        seen: list[FollowStatus] = []
        run_following("study.toml", "records", "out", show=seen.append, until=idle)
        monitor = seen[-1].monitor
        assert monitor.gaps == ()
        assert (
            "windows from 2 s skipped"
            in gap_remarks([each for one in seen for each in one.remarks if isinstance(each, SkippedWindow)])[0].text
        )
    assert len(monitor.table) == 5
    assert monitor.table.index[-1] == 15
    assert len(pd.read_csv(plant / "out" / "monitoring.csv")) == 16


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["records", "records"], "excludes several folders"),
        (["records", "--resume"], "excludes --resume"),
        (["records", "--figures", "png"], "excludes --figures"),
        (["nowhere"], "nowhere: no such folder or file"),
        (["records", "--set", "monitoring.alarm_command=3"], "monitoring.alarm_command: must be a list of a program"),
        (["records", "--set", "diagnosis.faults.turns.fixed.tau=0.02"], "or its models have changed"),
        (
            ["records", "--set", "diagnosis.false_alarm_rate=0.2"],
            "another rule, other faults or another healthy machine",
        ),
    ],
)
def test_refusals(plant: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    if words[-1].startswith("diagnosis."):  # refused by the state of an earlier run
        warming(3, to=4.0).to_csv(plant / "records" / "a.csv", index=False)
        run_following("study.toml", "records", "results", until=idle)
    assert run(["monitor", "study.toml", *words, "--follow"]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_folder_is_locked(plant: Path) -> None:
    refused = pytest.raises(fmuid.InputError, match="is written to by another monitoring")
    with locked(plant / "out", "monitoring"), refused:
        run_following("study.toml", "records", "out", until=idle)


def test_interruption_before_the_first_status_keeps_the_alarm(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any) -> list[str]:
        raise KeyboardInterrupt

    monkeypatch.setattr(following, "_told", interrupted)
    warming(8, to=1.0, fails=0.0, size=3.0).to_csv(plant / "records" / "new.csv", index=False)
    assert run(["monitor", "study.toml", "records", "--follow", "-o", "out", "--no-report"]) == 1
    assert [each["event"] for each in alarms(plant / "out")] == ["raised"]


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
        while time.monotonic() < deadline:
            time.sleep(0.5)
            path = plant / "out" / "monitoring.csv"
            if (plant / "told.txt").exists() and len(pd.read_csv(path)) >= 30:
                break
        process.send_signal(signal.SIGINT)
        said = process.communicate()[0]
    assert process.returncode == 1
    table = pd.read_csv(plant / "out" / "monitoring.csv")
    assert table["window"].tolist() == list(range(30))
    assert [each["event"] for each in alarms(plant / "out")] == ["raised"]
    assert (plant / "told.txt").read_text().startswith("1 raised turns\n")
    assert "Written to" in said
