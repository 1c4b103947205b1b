#!/usr/bin/python3
"""Finishes an image for an RP2040: fills in the CRC of its boot block and makes the UF2 file for drag and drop.

Usage: tools/uf2.py IMAGE.elf...

The boot block are the first 256 bytes of flash; the boot ROM starts them only if the last four are the CRC of those before
(RP2040 datasheet, 2.8.1.3.1: polynomial 04C11DB7, from all ones, the highest bit first, nothing inverted). It is filled into
the image itself. IMAGE.uf2 holds the same flash in blocks of 256 bytes: https://github.com/microsoft/uf2.
"""

import struct
import sys
from pathlib import Path

FLASH, FLASH_BYTES = 0x10000000, 2 << 20
BOOT_BYTES = 256
PAYLOAD = 256
FAMILY_RP2040 = 0xE48BFF56
FAMILY_PRESENT = 0x2000
MAGICS = 0x0A324655, 0x9E5D5157, 0x0AB16F30
PT_LOAD = 1


class Problem(Exception):
    """Something wrong with the image: shown to the user as it is."""


def crc(data):
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte << 24
        for _ in range(8):
            value = (value << 1 ^ (0x04C11DB7 if value >> 31 else 0)) & 0xFFFFFFFF
    return value


def segments(elf):
    """[(address in flash, offset in the file, bytes)] of what an ELF file loads."""
    if elf[:7] != b"\x7fELF\x01\x01\x01" or struct.unpack_from("<H", elf, 18)[0] != 40:
        raise Problem("not an ELF file for a 32-bit Arm: give what the linker made")
    start, size, count = struct.unpack_from("<I", elf, 28)[0], *struct.unpack_from("<HH", elf, 42)
    found = []
    for index in range(count):
        kind, offset, _, physical, length = struct.unpack_from("<5I", elf, start + index * size)
        if kind != PT_LOAD or length == 0:
            continue
        if not FLASH <= physical <= physical + length <= FLASH + FLASH_BYTES:
            raise Problem(f"loads {physical:#x}, which is not in the flash: link it with linker/rp2040.ld")
        found.append((physical, offset, length))
    return sorted(found)


def place(elf, address):
    """The offset in the file of a flash address."""
    for start, offset, length in segments(elf):
        if start <= address < start + length:
            return offset + address - start
    raise Problem(f"has nothing at {address:#x}: the boot block is missing")


def seal(elf):
    """Fills in the CRC of the boot block."""
    code = bytes(elf[place(elf, FLASH + index)] for index in range(BOOT_BYTES - 4))
    at = place(elf, FLASH + BOOT_BYTES - 4)
    place(elf, FLASH + BOOT_BYTES - 1)
    elf[at:at + 4] = struct.pack("<I", crc(code))


def pages(elf):
    """{address: 256 bytes} of the flash; what an image leaves free in a page is as after erasing."""
    found = {}
    for start, offset, length in segments(elf):
        for index in range(length):
            address = start + index
            page = found.setdefault(address - address % PAYLOAD, bytearray(b"\xff" * PAYLOAD))
            page[address % PAYLOAD] = elf[offset + index]
    return found


def uf2(found):
    blocks = []
    for number, address in enumerate(sorted(found)):
        head = struct.pack("<8I", MAGICS[0], MAGICS[1], FAMILY_PRESENT, address, PAYLOAD, number, len(found), FAMILY_RP2040)
        blocks.append(head + bytes(found[address]) + bytes(476 - PAYLOAD) + struct.pack("<I", MAGICS[2]))
    return b"".join(blocks)


def finish(path):
    elf = bytearray(path.read_bytes())
    seal(elf)
    path.write_bytes(elf)
    path.with_suffix(".uf2").write_bytes(uf2(pages(elf)))


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        print(__doc__.split("\n\n")[1], file=sys.stderr)
        return 64
    assert crc(b"123456789") == 0x0376E6E7  # the published check value of this CRC, CRC-32/MPEG-2
    for name in sys.argv[1:]:
        try:
            finish(Path(name))
        except (Problem, OSError, struct.error) as problem:
            print(f"uf2: {name}: {problem}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
