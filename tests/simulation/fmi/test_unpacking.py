"""Archives and XML that were made to do harm are refused in one sentence, and what is unpacked is the user's alone."""

from __future__ import annotations

import os
import re
import stat
import struct
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from fmuid.errors import InputError
from fmuid.models import archive as zipped
from fmuid.models import ssv
from fmuid.models.archive import CheckedArchive, unpacked
from fmuid.models.fmu import FMU
from fmuid.models.ssv import read_ssv
from fmuid.runs.apply import apply_result
from tests.support.fmu_texts import FMI2, FMI3, write_fmu
from tests.support.packing import pack, refusal
from tests.support.paths import FMUS
from tests.support.results import result

pytestmark = pytest.mark.usefixtures("cache")

COIL = FMUS / "Coil" / "Coil.fmu"


def changed(path: Path, change: Callable[[bytearray], object]) -> Path:
    """Change the bytes of an archive."""
    content = bytearray(path.read_bytes())
    change(content)
    path.write_bytes(content)
    return path


def headers(content: bytes | bytearray) -> list[int]:
    """Return where the entries of an archive's directory begin."""
    return [found.start() for found in re.finditer(b"PK\x01\x02", content)]


# --- names ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("/etc/evil", "outside"),
        ("//host/evil", "outside"),
        ("a/../../evil", "outside"),
        ("..", "outside"),
        ("a\\..\\evil", "outside"),
        ("\\\\host\\evil", "outside"),
        ("..\\..\\evil", "outside"),
        ("\\evil", "outside"),
        ("C:evil", "outside"),
        ("C:\\evil", "outside"),
        ("a:stream", "outside"),  # of NTFS
        (".. /evil", "outside"),  # Windows drops final spaces and dots
        (".../evil", "outside"),
        ("a\x1b[2Jb", "control character"),
        ("a\nb", "control character"),
        ("", "no name"),
        ("resources/con", "Windows"),
        ("sources/Aux.c", "Windows"),
        ("lpt1 .txt", "Windows"),
        ("a" * 256, "too long"),
        ("ä" * 128, "too long"),
        ("/".join(["folder"] * 200), "too long"),
    ],
)
def test_names_that_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, why: str) -> None:
    monkeypatch.setattr(zipped, "STRICT_NAMES", why == "Windows")
    assert why in refusal(pack(tmp_path / "a.fmu", ("modelDescription.xml", b""), (name, b"evil")))


def test_backslashes_are_separators(tmp_path: Path) -> None:
    """Some tools on Windows pack so; what is applied to such an FMU is packed with slashes."""
    with zipfile.ZipFile(COIL) as coil:
        entries = [(name.replace("/", "\\"), coil.read(name)) for name in coil.namelist()]
    path = pack(tmp_path / "a.fmu", ("resources\\", b""), *entries)
    fmu = FMU(path)
    assert fmu.platforms == FMU(COIL).platforms
    assert fmu.library(fmu.description.interfaces["co-simulation"].identifier).is_file()
    assert sorted(each.name for each in fmu.directory.iterdir()) == [
        "binaries",
        "modelDescription.xml",
        "resources",
        "sources",
    ]
    new = tmp_path / "new.fmu"
    apply_result(result(tmp_path, {"R": (4.25, 0.01)}), path, new)
    assert "binaries/linux64" in {name.rpartition("/")[0] for name in zipfile.ZipFile(new).namelist()}


def test_a_name_that_hides_its_end_is_refused(tmp_path: Path) -> None:
    """After a NUL the rest is shown to nobody; `zipfile` cuts it off."""
    path = pack(tmp_path / "a.fmu", ("modelDescription.xml", b""), ("good#evil", b""))
    path.write_bytes(path.read_bytes().replace(b"good#evil", b"good\0evil"))
    assert "control character" in refusal(path)


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


def test_a_file_packed_twice_is_the_same(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="Duplicate"):
        path = pack(tmp_path / "a.fmu", ("twice", b"1"), ("twice", b"1"))
    assert (unpacked(path, "digest") / "twice").read_bytes() == b"1"


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


def test_a_bomb_that_understates_its_size_is_damaged(tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", ("zeros", bytes(3 * 2**20)))

    def understate(content: bytearray) -> None:
        struct.pack_into("<I", content, headers(content)[0] + 24, 100)

    assert "damaged archive" in refusal(changed(path, understate))


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


def test_entries_that_overlap(tmp_path: Path) -> None:
    """As in Fifield's bombs: two entries of the directory point to one place."""
    path = pack(tmp_path / "a.fmu", ("a", b"x" * 100), ("b", b"x" * 100))

    def point_to_the_first(content: bytearray) -> None:
        struct.pack_into("<I", content, headers(content)[1] + 42, 0)

    assert "overlap" in refusal(changed(path, point_to_the_first))


def test_large_xml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CheckedArchive.read, "__defaults__", (100,))
    with pytest.raises(InputError, match=r"'modelDescription\.xml' is larger than"):
        FMU(write_fmu(tmp_path / "a.fmu", FMI2))
    monkeypatch.setattr(ssv, "LARGEST_XML", 100)
    (tmp_path / "a.ssv").write_bytes(bytes(101))
    with pytest.raises(InputError, match="larger than the limit of 100 bytes"):
        read_ssv(tmp_path / "a.ssv")


# --- how it is packed -------------------------------------------------------------------


def test_encrypted(tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", ("secret", b"x"))

    def encrypt(content: bytearray) -> None:
        content[headers(content)[0] + 8] |= 1

    assert "is encrypted" in refusal(changed(path, encrypt))


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compression(tmp_path: Path, method: int) -> None:
    assert "neither stored nor deflated" in refusal(pack(tmp_path / "a.fmu", ("a", b"x" * 100), method=method))


def test_damaged_content(tmp_path: Path) -> None:
    path = pack(tmp_path / "a.fmu", ("a", bytes(range(256)) * 10))
    for place, length in ((40, 10), (31, 8)):  # a broken stream; a content that is not what its checksum says

        def spoil(content: bytearray, place: int = place, length: int = length) -> None:
            content[place : place + length] = bytes(length)

        assert "damaged archive" in refusal(changed(path, spoil))


def test_an_fmu_for_scheduled_execution_alone_is_refused(tmp_path: Path) -> None:
    text = re.sub(r"<(CoSimulation|ModelExchange) .*/>\n", "", FMI3)
    with pytest.raises(InputError, match="neither Co-Simulation nor Model Exchange"):
        FMU(write_fmu(tmp_path / "a.fmu", text))
