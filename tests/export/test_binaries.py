"""Binaries of every platform in an exported FMU."""

from __future__ import annotations

import re
import struct
import subprocess
from pathlib import Path

import fmpy
import fmpy.fmi2

from fmuid.simulation.native.build import compiler_here
from tests.support.exporting import description, members, models
from tests.support.paths import FMUS

# ---- the binaries


@models
def test_binaries_of_every_platform(model: str) -> None:
    files = members(FMUS / model / f"{model}.fmu")
    functions = set(re.findall(rb"\bfmi2\w+(?=TYPE )", files["sources/fmi2Functions.h"]))
    assert len(functions) == 44
    elf = files[f"binaries/linux64/{model}.so"]
    assert elf[:5] == b"\x7fELF\x02"
    assert struct.unpack_from("<H", elf, 18) == (62,)  # x86-64
    versions = {tuple(map(int, v.split(b"."))) for v in re.findall(rb"GLIBC_([\d.]+)\0", elf)}
    assert versions
    assert max(versions) <= (2, 17)
    dll = files[f"binaries/win64/{model}.dll"]
    assert dll[:2] == b"MZ"
    (start,) = struct.unpack_from("<I", dll, 0x3C)
    assert struct.unpack_from("<4sH", dll, start) == (b"PE\0\0", 0x8664)
    mac = files[f"binaries/darwin64/{model}.dylib"]
    for data in (elf, dll, *slices(mac).values()):
        assert all(b"\0" + name + b"\0" in data or b"\0_" + name + b"\0" in data for name in functions)
        for path in (str(Path.home()), str(FMUS.parent), "/tmp", "sources/fmi2.c"):
            assert path.encode() not in data


def slices(data: bytes) -> dict[int, bytes]:
    """Return the parts of a universal Mach-O binary by their CPU type."""
    magic, count = struct.unpack_from(">2I", data)
    assert magic == 0xCAFEBABE
    parts = {}
    for k in range(count):
        cpu, subtype, offset, size, align = struct.unpack_from(">5I", data, 8 + 20 * k)
        assert align == 14
        assert offset % 2**align == 0
        parts[cpu] = data[offset : offset + size]
        assert struct.unpack_from("<3I", parts[cpu]) == (0xFEEDFACF, cpu, subtype)
    return parts


@models
def test_universal_binary_for_intel_and_apple_silicon(model: str) -> None:
    parts = slices(members(FMUS / model / f"{model}.fmu")[f"binaries/darwin64/{model}.dylib"])
    intel, arm = 0x01000007, 0x0100000C
    assert [*parts] == [intel, arm]
    for part in parts.values():
        filetype, count = struct.unpack_from("<2I", part, 12)
        assert filetype == 6  # dylib
        offset, commands = 32, set()
        for _ in range(count):
            command, size = struct.unpack_from("<2I", part, offset)
            commands.add(command)
            offset += size
        if part is parts[arm]:
            assert 0x1D in commands  # a code signature: Apple silicon loads nothing without


def test_sources_rebuild(tmp_path: Path) -> None:
    """The FMU's sources compile as its description says: the listed file, and nothing but the folder around it."""
    fmpy.extract(str(FMUS / "Coil" / "Coil.fmu"), unzipdir=str(tmp_path))
    listed = {file.get("name") for file in description(FMUS / "Coil" / "Coil.fmu").iter("File")}
    assert listed == {"fmi2.c"}
    command = [*compiler_here(), "-Wall", "-Wextra", "-shared", "-fPIC", "fmi2.c", "-o", "x.so"]
    done = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
