"""Compilation of an FMU for all platforms, and its byte-reproducible archive."""

from __future__ import annotations

import hashlib
import importlib.resources
import io
import os
import struct
import subprocess
import tempfile
import uuid
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fmpy
import ziglang  # type: ignore[import-untyped]  # noqa: F401 - run as a module; here to learn whether it is there

from fmuid.errors import FmuidError
from fmuid.export.codegen import header
from fmuid.export.description import build_description, description
from fmuid.export.explicit_model import ExplicitModel
from fmuid.processes import python_command

_LINUX, _WINDOWS, _INTEL, _APPLE = "x86_64-linux-gnu.2.17", "x86_64-windows-gnu", "x86_64-macos", "aarch64-macos"
PLATFORMS: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    "2.0": {"linux64": (".so", (_LINUX,)), "win64": (".dll", (_WINDOWS,)), "darwin64": (".dylib", (_INTEL, _APPLE))},
    "3.0": {
        "x86_64-linux": (".so", (_LINUX,)),
        "x86_64-windows": (".dll", (_WINDOWS,)),
        "x86_64-darwin": (".dylib", (_INTEL,)),
        "aarch64-darwin": (".dylib", (_APPLE,)),
    },
}
"""FMI version -> platform -> extension and compiler targets of its binary."""

# No contraction to fused multiply-add: the same results on every processor.
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-shared", "-s", "-Wall", "-Werror")
_SOURCES = {"2.0": "fmi2.c", "3.0": "fmi3.c"}
_SHARED = ("instance.h", "core.h")
_HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_PAGE = 1 << 14  # bytes of an Apple silicon page, on which slices begin


def build(system: ExplicitModel, fmi: str) -> bytes:
    """Return the FMU of a model; `fmi` is a key of `PLATFORMS`."""
    package, standard = importlib.resources.files("fmuid.export"), Path(fmpy.__file__).parent / "c-code"
    files = {f"sources/{name}": (package / name).read_bytes() for name in (_SOURCES[fmi], *_SHARED)}
    files |= {f"sources/{name}": (standard / name).read_bytes() for name in _HEADERS[fmi]}
    if fmi == "3.0":
        files["sources/buildDescription.xml"] = build_description(system.model.name, _SOURCES[fmi]).encode()

    def generated(guid: str) -> dict[str, bytes]:
        return {
            "modelDescription.xml": description(system, guid, fmi).encode(),
            "sources/model.h": header(system, guid).encode(),
        }

    content = hashlib.sha256(b"".join((files | generated("")).values())).hexdigest()
    files |= generated(f"{{{uuid.uuid5(uuid.NAMESPACE_URL, content)}}}")
    files |= _binaries(system.model.name, files, fmi)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:  # deflate depends on the zlib version
        for name, data in sorted(files.items()):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.create_system, entry.external_attr = 3, 0o100644 << 16
            archive.writestr(entry, data)
    return buffer.getvalue()


def _binaries(name: str, files: dict[str, bytes], fmi: str) -> dict[str, bytes]:
    """Return the binaries of all platforms by path in the FMU."""
    with tempfile.TemporaryDirectory() as directory, ThreadPoolExecutor() as pool:
        for path, data in files.items():
            target = Path(directory) / path
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(data)
        tasks = {
            f"binaries/{platform}/{name}{extension}": [
                pool.submit(_compile, Path(directory), _SOURCES[fmi], target, name + extension) for target in targets
            ]
            for platform, (extension, targets) in PLATFORMS[fmi].items()
        }
        return {path: _universal([task.result() for task in parts]) for path, parts in tasks.items()}


def _compile(directory: Path, source: str, target: str, file: str) -> bytes:
    """Compile for one target, with relative paths: binaries name no machine."""
    folder = directory / target
    folder.mkdir()
    command = python_command("ziglang", "cc", "-target", target, *_FLAGS, f"../sources/{source}", "-o", file)
    if "linux" in target:
        command.append("-lm")
    if "macos" in target:
        command.append(f"-Wl,-install_name,@rpath/{file}")
    environment = {**os.environ, "ZIG_LOCAL_CACHE_DIR": str(folder)}  # deleted with the folder
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise FmuidError(f"the compiler failed for {target}: {done.stderr.strip()}")
    return (folder / file).read_bytes()


def _universal(parts: list[bytes]) -> bytes:
    """Join Mach-O libraries into a universal binary (Mach-O's fat_header)."""
    if len(parts) == 1:
        return parts[0]
    head, body, offset = struct.pack(">2I", 0xCAFEBABE, len(parts)), b"", _PAGE
    for part in parts:
        _, cpu, subtype = struct.unpack_from("<3I", part)
        head += struct.pack(">5I", cpu, subtype, offset, len(part), _PAGE.bit_length() - 1)
        body += part + bytes(-len(part) % _PAGE)
        offset = _PAGE + len(body)
    return head.ljust(_PAGE, b"\0") + body
