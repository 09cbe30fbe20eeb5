"""FMU archives with members of every kind."""

import zipfile
from pathlib import Path

import pytest

from fmuid import InputError
from fmuid.models.archive import unpacked


def pack(path: Path, *entries: tuple[str | zipfile.ZipInfo, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    """Write an archive with entries whose names are taken as they are."""
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries:
            info = name if isinstance(name, zipfile.ZipInfo) else zipfile.ZipInfo("x")
            if isinstance(name, str):
                info.filename = info.orig_filename = name
            archive.writestr(info, content, method)
    return path


def refusal(path: Path) -> str:
    """Unpack an archive that must be refused in one sentence, without a trace of it being left."""
    with pytest.raises(InputError) as caught:
        unpacked(path, "digest")
    sentence = str(caught.value)
    assert sentence.startswith(str(path))
    assert "\n" not in sentence
    folder = Path(__import__("platformdirs").user_cache_dir("fmuid")) / "unpacked"
    assert not folder.exists() or not list(folder.iterdir())
    return sentence


def changed(path: Path, folder: Path, old: str, new: str) -> Path:
    """Return a copy of an FMU with another word in its description."""
    copy = folder / f"{path.stem}-{abs(hash((str(path), old, new)))}.fmu"
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(copy, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "modelDescription.xml":
                assert old.encode() in data
                data = data.replace(old.encode(), new.encode())
            target.writestr(name, data)
    return copy
