"""What a batch refuses before it begins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fmuid.errors import InputError
from fmuid.runs.batch import worker_pool as cluster
from fmuid.runs.batch.worker import difference, versions
from tests.support.coil_batches import NOISE, refused, run, write

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.mark.parametrize(
    ("batch", "words", "told"),
    [
        (NOISE.format(draws=30), ["--max-cases", "29"], "30 cases exceed the limit of 29"),
        ("", [], "no [batch]"),
        ('[batch]\ndata = "nothing/*.csv"\n', [], '"nothing/*.csv" matches no file'),
        (None, ["-o", "first.csv"], "first.csv cannot be made a folder"),
        (None, ["--workers", "0"], "--workers must be a whole number above 0, not 0"),
        (None, ["--workers", "2", "--scheduler", "tcp://127.0.0.1:9"], "exclude each other"),
        (None, ["--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler at tcp://127.0.0.1:9"),
        (None, ["--scheduler", "nonsense"], "no Dask scheduler at nonsense"),
    ],
)
def test_wrong_words(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch, batch: str | None, words: list[str], told: str
) -> None:
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.3)
    monkeypatch.chdir(folder)
    if batch is not None:
        write(folder, batch)
    output = [] if "-o" in words else ["-o", "out"]
    assert told in refused(capsys, "study.toml", *output, *words)
    assert not list(folder.glob("out/cases/*"))


def test_a_folder_without_its_manifest(folder: Path, here: Any, capsys: Any) -> None:
    write(folder, NOISE.format(draws=3))
    here()
    run(folder)
    path = folder / "out" / "batch.json"
    path.unlink()
    assert "cases without batch.json" in refused(capsys, folder / "study.toml", "-o", folder / "out")
    for damaged, told in (
        ("[]", "read failed (no table)"),
        ('{"fmuid": "0.1.0", "stu', "read failed (Unterminated string"),
        ("[" * 100_000, "read failed ("),
        ('{"fmuid": "0.0.9", "study": [], "files": ["a"]}', "made by fmuid 0.0.9, this is "),
    ):
        path.write_text(damaged)
        said = refused(capsys, folder / "study.toml", "-o", folder / "out")
        assert told in said and "--no-resume" in said and "--output" in said


@pytest.mark.parametrize(
    ("name", "other", "told"),
    [
        ("python", "3.11.9.final.0", None),
        ("python", "3.12.1.final.0", "runs python 3.12.1, this machine 3.11.7"),
        ("fmuid", "0.1.1", "runs fmuid 0.1.1, this machine 0.1.0"),
        ("fmuid", None, "has no fmuid. Install fmuid 0.1.0 there"),
        ("numpy", "2.9.0", None),
        ("numpy", "1.26.4", "runs numpy 1.26.4, this machine 2.4.6"),
    ],
)
def test_versions(name: str, other: str | None, told: str | None) -> None:
    mine = {"python": "3.11.7.final.0", "fmuid": "0.1.0", "dask": "2026.8.0", "numpy": "2.4.6", "pandas": "3.1.1"}
    found = difference(mine, mine | {name: other})
    assert found is None if told is None else told in str(found)


class Unlike:
    """Client of a cluster on which one side runs another version."""

    def __init__(self, scheduler: dict[str, str | None], worker: dict[str, str | None]) -> None:
        here = versions()
        workers = {"tcp://a:1": {"packages": here}, "tcp://b:2": {"packages": here | worker}}
        self.found = {"scheduler": {"packages": here | scheduler}, "workers": workers}

    def scheduler_info(self, **_: int) -> dict[str, int]:
        return {"n_workers": 2}

    def get_versions(self, packages: list[str]) -> dict[str, Any]:
        assert packages == ["fmuid"]
        return self.found


def test_a_cluster_with_other_versions() -> None:
    cluster._check(Unlike({}, {}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the worker tcp://b:2 has no fmuid"):
        cluster._check(Unlike({}, {"fmuid": None}), "tcp://s:8786")
    with pytest.raises(InputError, match=r"^the scheduler at tcp://s:8786 runs dask 2020.1.0"):
        cluster._check(Unlike({"dask": "2020.1.0"}, {}), "tcp://s:8786")
