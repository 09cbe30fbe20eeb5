"""Binaries of every platform in an exported FMU."""

import re
import struct
from pathlib import Path

import pytest

from fmuid.export import export_fmu
from tests.support.exporting import members, models
from tests.support.paths import FMUS

INTEL, ARM = 0x01000007, 0x0100000C


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


def check_binaries(elf: bytes, dll: bytes, macs: dict[int, bytes], functions: set[bytes]) -> None:
    """Check machine types and exported functions, and that no path of this machine is in them."""
    assert elf[:5] == b"\x7fELF\x02"
    assert struct.unpack_from("<H", elf, 18) == (62,)  # x86-64
    versions = {tuple(map(int, v.split(b"."))) for v in re.findall(rb"GLIBC_([\d.]+)\0", elf)}
    assert max(versions) <= (2, 17)
    assert dll[:2] == b"MZ"
    (start,) = struct.unpack_from("<I", dll, 0x3C)
    assert struct.unpack_from("<4sH", dll, start) == (b"PE\0\0", 0x8664)
    assert {*macs} == {INTEL, ARM}
    for cpu, part in macs.items():
        assert struct.unpack_from("<2I", part) == (0xFEEDFACF, cpu)
        filetype, count = struct.unpack_from("<2I", part, 12)
        assert filetype == 6  # dylib
        offset, commands = 32, set()
        for _ in range(count):
            command, size = struct.unpack_from("<2I", part, offset)
            commands.add(command)
            offset += size
        assert cpu == INTEL or 0x1D in commands  # a code signature: Apple silicon loads nothing without
    for data in (elf, dll, *macs.values()):
        assert not [f for f in functions if b"\0" + f + b"\0" not in data and b"\0_" + f + b"\0" not in data]
        for path in (str(Path.home()), str(FMUS.parent), "/tmp", "sources/fmi2.c"):
            assert path.encode() not in data


@models
def test_binaries_of_every_platform(model: str) -> None:
    files = members(FMUS / model / f"{model}.fmu")
    functions = set(re.findall(rb"\bfmi2\w+(?=TYPE )", files["sources/fmi2Functions.h"]))
    assert len(functions) == 44
    elf, dll = (files[f"binaries/{each}"] for each in (f"linux64/{model}.so", f"win64/{model}.dll"))
    check_binaries(elf, dll, slices(files[f"binaries/darwin64/{model}.dylib"]), functions)


@pytest.mark.slow
def test_binaries_of_fmi_3(tmp_path: Path) -> None:
    """All functions of FMI 3.0; the same bytes again from elsewhere."""
    first = export_fmu(FMUS / "Coil" / "Coil.mo", tmp_path / "first.fmu", fmi="3.0")
    (tmp_path / "Moved.mo").write_bytes((FMUS / "Coil" / "Coil.mo").read_bytes())
    assert export_fmu(tmp_path / "Moved.mo", fmi="3.0").read_bytes() == first.read_bytes()
    files = members(first)
    functions = set(re.findall(rb"\bfmi3\w+(?=TYPE\s+fmi3)", files["sources/fmi3Functions.h"]))
    assert len(functions) > 70
    binaries = {name.split("/")[1]: data for name, data in files.items() if name.startswith("binaries/")}
    macs = {INTEL: binaries.pop("x86_64-darwin"), ARM: binaries.pop("aarch64-darwin")}
    check_binaries(binaries.pop("x86_64-linux"), binaries.pop("x86_64-windows"), macs, functions)
    assert not binaries
