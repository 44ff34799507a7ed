"""Readers of the symbols of shared libraries: PE (Windows) and Mach-O (macOS)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

FAT_MAGIC, MACHO_MAGIC = 0xCAFEBABE, 0xFEEDFACF
SYMTAB, ID_DYLIB, CODE_SIGNATURE = 0x02, 0x0D, 0x1D  # load commands
EXTERNAL, SECTION, PRIVATE = 0x01, 0x0E, 0x10  # bits of a symbol's type


class Slice(NamedTuple):
    """One processor's library in a universal Mach-O."""

    processor: int
    offset: int
    exponent: int  # it is aligned to two to the power of this
    content: bytes


def text(content: bytes, place: int) -> str:
    """The string that ends with a zero byte."""
    return content[place : content.index(b"\0", place)].decode()


def pe_machine(content: bytes) -> int:
    """The processor of a PE file: 0x8664 is x86-64."""
    head = struct.unpack_from("<I", content, 0x3C)[0]
    assert content[:2] == b"MZ"
    assert content[head : head + 4] == b"PE\0\0"
    return struct.unpack_from("<H", content, head + 4)[0]


def pe_exports(content: bytes) -> set[str]:
    """The names that a 64-bit DLL exports."""
    head = struct.unpack_from("<I", content, 0x3C)[0] + 4
    count, size = (struct.unpack_from("<H", content, head + at)[0] for at in (2, 16))
    optional = head + 20
    assert struct.unpack_from("<H", content, optional)[0] == 0x20B  # PE32+

    def place(address: int) -> int:
        for number in range(count):
            at = optional + size + 40 * number
            start, length, raw = struct.unpack_from("<3I", content, at + 12)
            if start <= address < start + length:
                return address - start + raw
        raise AssertionError(f"no section holds {address:#x}")

    exports = place(struct.unpack_from("<I", content, optional + 112)[0])
    names, addresses = struct.unpack_from("<I4xI", content, exports + 24)
    results = struct.unpack_from(f"<{names}I", content, place(addresses))
    return {text(content, place(name)) for name in results}


def macho_slices(content: bytes) -> list[Slice]:
    """The libraries of a universal Mach-O."""
    magic, count = struct.unpack_from(">2I", content)
    assert magic == FAT_MAGIC
    results = []
    for number in range(count):
        kind, _, offset, size, exponent = struct.unpack_from(">5I", content, 8 + 20 * number)
        results.append(Slice(kind, offset, exponent, content[offset : offset + size]))
    return results


def macho_commands(content: bytes) -> Iterator[tuple[int, int]]:
    """The load commands of a 64-bit Mach-O: kind and place."""
    magic, count = struct.unpack_from("<I12xI", content)
    assert magic == MACHO_MAGIC
    at = 32
    for _ in range(count):
        kind, size = struct.unpack_from("<2I", content, at)
        yield kind, at
        at += size


def macho_exports(content: bytes) -> set[str]:
    """The names of the symbols that a 64-bit Mach-O defines for others."""
    at = dict(macho_commands(content))[SYMTAB]
    symbols, count, strings, _ = struct.unpack_from("<4I", content, at + 8)
    result = set()
    for number in range(count):
        name, kind = struct.unpack_from("<IB", content, symbols + 16 * number)
        if kind & (EXTERNAL | SECTION | PRIVATE) == EXTERNAL | SECTION:
            result.add(text(content, strings + name).removeprefix("_"))
    return result


def macho_name(content: bytes) -> str:
    """The name by which a 64-bit Mach-O is linked."""
    at = dict(macho_commands(content))[ID_DYLIB]
    return text(content, at + struct.unpack_from("<I", content, at + 8)[0])
