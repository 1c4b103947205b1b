"""The bytes of I2C transfers that people write simulators from: docs/scanners.md and lib/scan/generic.h say the same, and
their check sums are right, by a CRC of our own."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "scanners.md").read_text()
HEADER = (ROOT / "lib" / "scan" / "generic.h").read_text()
TRANSFER = re.compile(r"((?:[0-9A-F]{2} )+)\| ((?:[0-9A-F]{2} ?)+)")


def crc16(data):
    total = 0xFFFF
    for byte in data:
        total ^= byte
        for _ in range(8):
            total = total >> 1 ^ (0xA001 if total & 1 else 0)
    return total.to_bytes(2, "little")


def crc8(data):
    total = 0
    for byte in data:
        total ^= byte
        for _ in range(8):
            total = (total << 1 ^ (0x107 if total & 0x80 else 0)) & 0xFF
    return bytes([total])


def transfers(text):
    return [(bytes.fromhex(written), bytes.fromhex(read)) for written, read in TRANSFER.findall(text)]


def test_check_values():
    assert crc16(b"123456789") == bytes.fromhex("374B")
    assert crc8(b"123456789") == bytes.fromhex("F4")


def test_examples_have_their_check_sums():
    found = transfers(PAGE)
    assert len(found) == 2 and len(transfers(HEADER)) == 1
    for written, read in found + transfers(HEADER):
        length, check = (2, crc16) if len(written) == 5 else (1, crc8)
        assert written[0] | 1 == read[0]
        assert check(written + read[:-length]) == read[-length:]
        if len(written) == 5:
            assert written[3] * 2 == len(read) - 1 - length


def test_the_table_of_bytes_is_the_headers_example():
    rows = re.findall(r"^\| [\d, to]+ \| ((?:0x[0-9A-F]{2} ?)+) \|", PAGE, re.M)
    told = bytes(int(word, 16) for row in rows for word in row.split())
    assert told == b"".join(transfers(HEADER)[0])
    assert f"0x{int.from_bytes(told[-2:], 'little'):04X}" in PAGE
