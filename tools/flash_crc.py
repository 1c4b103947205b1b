#!/usr/bin/python3
"""Puts the CRC-32 of a firmware image's flash where the self-test looks for it.

Usage: tools/flash_crc.py IMAGE.elf...

linker/sections.ld names the first byte of the program, canopy_flash_start, and the word behind the last one, canopy_flash_end.
The CRC (zlib's) of all between them is written into that word, in the image itself. An image without the names is refused: exit 2.
"""

import struct
import sys
import zlib
from pathlib import Path

PT_LOAD, SHT_SYMTAB = 1, 2
FIRST, LAST = "canopy_flash_start", "canopy_flash_end"


class Problem(Exception):
    """Something wrong with the image: shown to the user as it is."""


def segments(elf):
    """[(address of loading, offset in the file, bytes)] of what the image loads, in order."""
    start, size, count = struct.unpack_from("<I", elf, 28)[0], *struct.unpack_from("<HH", elf, 42)
    found = []
    for index in range(count):
        kind, offset, _, address, length = struct.unpack_from("<5I", elf, start + index * size)
        if kind == PT_LOAD and length > 0:
            found.append((address, offset, length))
    return sorted(found)


def symbols(elf, wanted):
    """{name: address} of those names that the image has."""
    start, size, count = struct.unpack_from("<I", elf, 32)[0], *struct.unpack_from("<HH", elf, 46)
    sections = [struct.unpack_from("<10I", elf, start + k * size) for k in range(count)]
    found = {}
    for _, kind, _, _, offset, length, link, *_ in sections:
        for at in range(offset, offset + length, 16) if kind == SHT_SYMTAB else ():
            name, value = struct.unpack_from("<II", elf, at)
            begin = sections[link][4] + name
            text = elf[begin:elf.index(b"\0", begin)].decode()
            if text in wanted:
                found[text] = value
    return found


def spans(elf, first, last):
    """[(offset, bytes)] in the file of the addresses from first to last, without a gap."""
    found, at = [], first
    for address, offset, length in segments(elf):
        if address <= at < address + length and at < last:
            count = min(address + length, last) - at
            found.append((offset + at - address, count))
            at += count
    if at < last:
        raise Problem(f"nothing is loaded at {at:#x}, in the middle of the program: what a chip has there is not known")
    return found


def finish(path):
    elf = bytearray(path.read_bytes())
    if elf[:6] != b"\x7fELF\x01\x01":
        raise Problem("not a 32-bit little-endian ELF file: give what the linker made")
    named = symbols(elf, (FIRST, LAST))
    if len(named) < 2:
        raise Problem(f"has no {FIRST} and {LAST}: link it with linker/sections.ld")
    crc = 0
    for offset, length in spans(elf, named[FIRST], named[LAST]):
        crc = zlib.crc32(elf[offset:offset + length], crc)
    (place, _), = spans(elf, named[LAST], named[LAST] + 4)
    struct.pack_into("<I", elf, place, crc)
    path.write_bytes(elf)


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        print(__doc__.strip(), file=sys.stderr)
        return 64
    for name in sys.argv[1:]:
        try:
            finish(Path(name))
        except (Problem, OSError, struct.error, ValueError) as problem:
            print(f"{name}: {problem}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
