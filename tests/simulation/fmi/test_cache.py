"""The cache of unpacked FMUs: whose it is, what it trusts."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

import pytest

from fmuid.errors import InputError
from fmuid.models.archive import unpacked
from tests.support.packing import pack, refusal

pytestmark = pytest.mark.usefixtures("cache")

posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such permissions")


# --- the cache --------------------------------------------------------------------------


@posix
def test_unpacked_files_are_the_users_alone(tmp_path: Path, cache: Path) -> None:
    old = os.umask(0)
    try:
        folder = unpacked(pack(tmp_path / "a.fmu", ("binaries/linux64/a.so", b"x"), ("empty/", b"")), "digest")
    finally:
        os.umask(old)
    found = [cache / "fmuid", cache / "fmuid" / "unpacked", folder, *folder.rglob("*")]
    assert len(found) == 7
    for path in found:
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


@posix
def test_a_cache_that_others_may_write_is_closed(tmp_path: Path, cache: Path) -> None:
    (cache / "fmuid" / "unpacked").mkdir(parents=True)
    for folder in (cache / "fmuid", cache / "fmuid" / "unpacked"):
        folder.chmod(0o777)
    unpacked(pack(tmp_path / "a.fmu", ("a", b"x")), "digest")
    for folder in (cache / "fmuid", cache / "fmuid" / "unpacked"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@posix
@pytest.mark.parametrize("place", ["fmuid", "fmuid/unpacked", "fmuid/unpacked/digest"])
def test_a_cache_that_leads_elsewhere_is_refused(tmp_path: Path, cache: Path, place: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (cache / place).parent.mkdir(parents=True)
    (cache / place).symlink_to(elsewhere)
    with pytest.raises(InputError, match=r"is a symbolic link.*XDG_CACHE_HOME"):
        unpacked(pack(tmp_path / "a.fmu", ("a", b"x")), "digest")
    assert not list(elsewhere.iterdir())


@posix
def test_a_cache_of_somebody_else_is_refused(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (cache / "fmuid").mkdir(parents=True)
    monkeypatch.setattr("os.geteuid", lambda: os.getuid() + 1)
    with pytest.raises(InputError, match=r"belongs to another user.*XDG_CACHE_HOME"):
        unpacked(pack(tmp_path / "a.fmu", ("a", b"x")), "digest")


def test_what_is_missing_in_the_cache_is_unpacked_again(tmp_path: Path) -> None:
    names = ["binaries/linux64/a.so", "modelDescription.xml", "resources/table.csv", "resources/log.txt"]
    path = pack(tmp_path / "a.fmu", *((name, b"content") for name in names), ("resources/empty/", b""))
    folder = unpacked(path, "digest")
    (folder / names[0]).write_bytes(b"cut")
    (folder / names[1]).unlink()
    (folder / names[2]).unlink()
    (folder / names[3]).write_bytes(b"written by the FMU")
    (folder / "resources" / "empty").rmdir()
    assert unpacked(path, "digest") == folder
    assert [(folder / name).read_bytes() for name in names] == [b"content"] * 3 + [b"written by the FMU"]
    assert (folder / "resources" / "empty").is_dir()
    assert list(folder.parent.iterdir()) == [folder]


def test_a_full_disk_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("os.fdopen", full)
        assert "No space left on device" in refusal(pack(tmp_path / "a.fmu", ("a", b"x")))
