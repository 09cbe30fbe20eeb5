"""Archives that were made to do harm are refused in one sentence; what is unpacked is the user's alone."""

import os
import re
import stat
import struct
import sys
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from fmuid import FMU, InputError
from fmuid.models import CheckedArchive, read_ssv, ssv
from fmuid.models import archive as zipped
from fmuid.models.archive import unpacked
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.packing import pack, refusal

pytestmark = pytest.mark.usefixtures("cache")


# --- names ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("/etc/evil", "outside"),
        ("a/../../evil", "outside"),
        ("..", "outside"),
        ("a\\..\\evil", "outside"),
        ("\\evil", "outside"),
        ("C:evil", "outside"),
        ("a:stream", "outside"),  # of NTFS
        (".. /evil", "outside"),  # Windows drops final spaces and dots
        ("a\x1b[2Jb", "control character"),
        ("", "no name"),
        ("resources/con", "Windows"),
        ("lpt1 .txt", "Windows"),
        ("ä" * 128, "too long"),
        ("/".join(["folder"] * 200), "too long"),
    ],
)
def test_names_that_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, why: str) -> None:
    monkeypatch.setattr(zipped, "STRICT_NAMES", why == "Windows")
    assert why in refusal(pack(tmp_path / "a.fmu", ("modelDescription.xml", b""), (name, b"evil")))


@pytest.mark.parametrize(
    "names",
    [
        ("a/file", "a/File"),
        ("ä", "a\u0308"),
        ("straße", "STRASSE"),
        ("file", "file."),
        ("same", "same"),
        ("a/b", "a\\b"),
    ],
)
def test_names_of_one_file_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: tuple[str, str]) -> None:
    monkeypatch.setattr(zipped, "STRICT_NAMES", names[0] != names[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of zipfile, to whoever writes that
        path = pack(tmp_path / "a.fmu", (names[0], b"1"), (names[1], b"2"))
    assert "are one file" in refusal(path)


@pytest.mark.parametrize("names", [("a", "a/b"), ("a/b", "a"), ("a", "a/")])
def test_a_file_that_is_a_folder_is_refused(tmp_path: Path, names: tuple[str, str]) -> None:
    assert "both a file and a folder" in refusal(pack(tmp_path / "a.fmu", *((name, b"") for name in names)))


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFBLK, stat.S_IFSOCK])
def test_what_is_no_file_is_refused(tmp_path: Path, kind: int) -> None:
    entry = zipfile.ZipInfo("resources/special")
    entry.external_attr = (kind | 0o777) << 16
    why = "outside" if kind == stat.S_IFLNK else "neither a file nor a folder"
    assert why in refusal(pack(tmp_path / "a.fmu", (entry, b"/etc/passwd")))


# --- sizes ------------------------------------------------------------------------------


def test_a_bomb_is_refused_by_its_ratio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zipped, "LIMITS", replace(zipped.LIMITS, ratio_from=2**20))
    path = pack(tmp_path / "a.fmu", ("zeros", bytes(3 * 2**20)))
    assert path.stat().st_size * zipped.LIMITS.ratio < 3 * 2**20
    assert "200 times its size" in refusal(path)


def test_what_is_read_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the headers say: here they are right, and ignored."""
    monkeypatch.setenv(zipped.LARGEST_TOTAL_VARIABLE, str(3 / 1024))
    monkeypatch.setattr(zipped, "LIMITS", replace(zipped.LIMITS, chunk=2**10))
    path = pack(tmp_path / "a.fmu", *((f"{k}", os.urandom(2**20)) for k in range(4)), method=zipfile.ZIP_STORED)
    with monkeypatch.context() as patched:
        patched.setattr(CheckedArchive, "_check", lambda _: None)
        assert "unpacks to more than 3 MB" in refusal(path)
    assert "unpacks to more than 3 MB" in refusal(path)
    large = pack(tmp_path / "b.fmu", ("large", os.urandom(2**21)), method=zipfile.ZIP_STORED)
    assert "'large' is larger than 1.5 MB" in refusal(large)  # half of what an archive has
    with monkeypatch.context() as patched:
        patched.setenv(zipped.LARGEST_TOTAL_VARIABLE, "0.005")
        assert sorted(p.name for p in unpacked(path, "digest").iterdir()) == ["0", "1", "2", "3"]


@pytest.mark.parametrize(
    ("limit", "words"), [({"entries": 10}, "30 entries"), ({"directory": 1000}, "its directory is larger")]
)
def test_large_directories_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: dict[str, int], words: str
) -> None:
    monkeypatch.setattr(zipped, "LIMITS", replace(zipped.LIMITS, **limit))
    assert words in refusal(pack(tmp_path / "a.fmu", *((str(k), b"") for k in range(30))))


def test_large_xml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CheckedArchive.read, "__defaults__", (100,))
    with pytest.raises(InputError, match=r"'modelDescription\.xml' is larger than"):
        FMU(write_fmu(tmp_path / "a.fmu", FMI2))
    monkeypatch.setattr(ssv, "LARGEST_XML", 100)
    (tmp_path / "a.ssv").write_bytes(bytes(101))
    with pytest.raises(InputError, match="larger than the limit of 100 bytes"):
        read_ssv(tmp_path / "a.ssv")


# --- how it is packed -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "place", "word", "why"),
    [
        (0, 8, "<H1", "is encrypted"),
        (0, 24, "<I100", "damaged archive"),  # a bomb that understates its size
        (1, 42, "<I0", "overlap"),  # as in Fifield's bombs: two entries of the directory point to one place
        (1, 46, "<H0", "control character"),  # after a NUL the rest of the name is shown to nobody
    ],
)
def test_spoilt_directories(tmp_path: Path, entry: int, place: int, word: str, why: str) -> None:
    path = pack(tmp_path / "a.fmu", ("a" * 9, bytes(3 * 2**20)), ("b" * 9, b"x" * 100))
    content = bytearray(path.read_bytes())
    headers = [found.start() for found in re.finditer(b"PK\x01\x02", content)]
    struct.pack_into(word[:2], content, headers[entry] + place, int(word[2:]))
    path.write_bytes(content)
    assert why in refusal(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compression(tmp_path: Path, method: int) -> None:
    assert "neither stored nor deflated" in refusal(pack(tmp_path / "a.fmu", ("a", b"x" * 100), method=method))


def test_an_fmu_for_scheduled_execution_alone_is_refused(tmp_path: Path) -> None:
    text = re.sub(r"<(CoSimulation|ModelExchange) .*/>\n", "", FMI3)
    with pytest.raises(InputError, match="neither Co-Simulation nor Model Exchange"):
        FMU(write_fmu(tmp_path / "a.fmu", text))


posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such permissions")


# --- the cache --------------------------------------------------------------------------


@posix
def test_unpacked_files_are_the_users_alone(tmp_path: Path, cache: Path) -> None:
    old = os.umask(0)
    (cache / "fmuid" / "unpacked").mkdir(parents=True)  # for everybody, so far
    try:
        folder = unpacked(pack(tmp_path / "a.fmu", ("binaries/linux64/a.so", b"x"), ("empty/", b"")), "digest")
    finally:
        os.umask(old)
    found = [cache / "fmuid", cache / "fmuid" / "unpacked", folder, *folder.rglob("*")]
    assert len(found) == 7
    for path in found:
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


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
