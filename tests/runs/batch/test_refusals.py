"""What a batch refuses before it begins."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest

from fmuid.apps.cli import batch as cli_batch
from fmuid.errors import InputError
from fmuid.runs.batch import batch as module
from fmuid.runs.batch import worker as workshop
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.worker import versions
from tests.support.coil_batches import (
    refused,
    run,
    write,
)

pytestmark = pytest.mark.usefixtures("blank_figures")


def test_too_many_cases(folder: Path, capsys: Any) -> None:
    said = refused(capsys, folder / "study.toml", "-o", folder / "out", "--max-cases", "29")
    assert "spans 30 cases, and --max-cases allows 29" in said
    assert not (folder / "out").exists()


def test_no_batch(folder: Path, capsys: Any) -> None:
    said = refused(capsys, write(folder, "") / "study.toml", "-o", folder / "out")
    assert "study.toml has no [batch]: give it" in said


def test_empty_pattern(folder: Path, capsys: Any) -> None:
    write(folder, '[batch]\ndata = "nothing/*.csv"\n')
    assert '"nothing/*.csv" matches no file' in refused(capsys, folder / "study.toml", "-o", folder / "out")


def test_rows_of_nobody(folder: Path, here: Any, capsys: Any) -> None:
    here()
    run(folder)
    (folder / "out" / "batch.json").unlink()
    assert "has cases and no batch.json" in refused(capsys, folder / "study.toml", "-o", folder / "out")
    for spoilt, told in (
        ("[]", "batch.json cannot be read (no table)"),
        ('{"fmuid": "0.1.0", "stu', "batch.json cannot be read (Unterminated string"),
        ("[" * 100_000, "batch.json cannot be read ("),
        ('{"fmuid": "0.0.9", "study": [], "files": ["a"]}', "it was run by fmuid 0.0.9, this is "),
    ):
        (folder / "out" / "batch.json").write_text(spoilt)
        said = refused(capsys, folder / "study.toml", "-o", folder / "out")
        assert told in said and "--no-resume" in said and "--output" in said


def test_output_is_a_file(folder: Path, capsys: Any) -> None:
    said = refused(capsys, folder / "study.toml", "-o", folder / "first.csv")
    assert "first.csv cannot be made a folder" in said


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--workers", "0"], "--workers must be a whole number above 0, not 0"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:9"], "keep one"),
        (["--scheduler", "tcp://127.0.0.1:9"], "there is no Dask scheduler at tcp://127.0.0.1:9"),
        (["--scheduler", "nonsense"], "there is no Dask scheduler at nonsense"),
    ],
)
def test_wrong_cluster(folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch, words: list[str], told: str) -> None:
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.5)
    assert told in refused(capsys, folder / "study.toml", "-o", folder / "out", *words)


def test_differences_of_versions() -> None:
    mine = {"python": "3.11.7.final.0", "fmuid": "0.1.0", "dask": "2026.8.0", "distributed": "2026.8.0"}
    mine |= {"numpy": "2.4.6", "pandas": "3.1.1"}
    for name, other, told in (
        ("python", "3.11.9.final.0", None),
        ("python", "3.12.1.final.0", "runs python 3.12.1, and here it is 3.11.7: install the same on both sides"),
        ("fmuid", "0.1.1", "runs fmuid 0.1.1, and here it is 0.1.0: install the same on both sides"),
        ("fmuid", None, "has no fmuid: install fmuid 0.1.0 there"),
        (
            "distributed",
            "2026.7.0",
            "runs distributed 2026.7.0, and here it is 2026.8.0: install the same on both sides",
        ),
        ("numpy", "2.9.0", None),
        ("numpy", "1.26.4", "runs numpy 1.26.4, and here it is 2.4.6: install the same on both sides"),
        ("pandas", "2.2.0", "runs pandas 2.2.0, and here it is 3.1.1: install the same on both sides"),
    ):
        assert workshop.difference(mine, mine | {name: other}) == told


class Unlike:
    """Stands for a client of a cluster on which one side runs something else."""

    def __init__(self, scheduler: dict[str, str | None], worker: dict[str, str | None]) -> None:
        here = versions()
        self.found = {
            "scheduler": {"packages": here | scheduler},
            "workers": {"tcp://a:1": {"packages": here}, "tcp://b:2": {"packages": here | worker}},
        }

    def scheduler_info(self, **_: int) -> dict[str, int]:
        return {"n_workers": 2}

    def get_versions(self, packages: list[str]) -> dict[str, Any]:
        assert packages == ["fmuid"]
        return self.found


def test_a_cluster_that_is_not_alike() -> None:
    cluster._check(Unlike({}, {}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the worker tcp://b:2 has no fmuid: install fmuid .* there$"):
        cluster._check(Unlike({}, {"fmuid": None}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the scheduler at tcp://s:8786 runs dask 2020.1.0, and here it is"):
        cluster._check(Unlike({"dask": "2020.1.0"}, {}), "tcp://s:8786")


def test_the_command_refuses_what_the_class_refuses() -> None:
    assert inspect.signature(cli_batch.batch).parameters["max_cases"].default == module.MAX_CASES
