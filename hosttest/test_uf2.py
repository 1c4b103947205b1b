"""What stands in an RP2040 image: its boot block and UF2 file, judged by code of their own, and that the code which writes
the flash does not need it."""

import binascii
import re
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from running import BUILD

IMAGES = BUILD / "rp2040_pico"
NAMES = ["canopy", "canopy-10x10", "unit_num"]
TOOL = Path(__file__).resolve().parent.parent / "tools" / "uf2.py"
FLASH, RAM = 0x10000000, 0x20000000
BOOT2, PROGRAM, SETTINGS = FLASH, FLASH + 256, FLASH + (2 << 20) - 8192


def tool(name, *arguments):
    return subprocess.run([f"arm-none-eabi-{name}", *map(str, arguments)], check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module", params=NAMES)
def elf(request):
    return IMAGES / f"{request.param}.elf"


def blocks(path):
    data = path.read_bytes()
    assert len(data) % 512 == 0
    return [data[at:at + 512] for at in range(0, len(data), 512)]


def flash_of(path):
    """{address: byte} as a UF2 file says."""
    return {struct.unpack_from("<I", block, 12)[0] + i: byte for block in blocks(path) for i, byte in enumerate(block[32:288])}


def symbols(path):
    return {row.split()[2]: int(row.split()[0], 16) for row in tool("nm", path).splitlines() if len(row.split()) == 3}


def reversed_bits(value, width):
    return int(f"{value:0{width}b}"[::-1], 2)


def crc_of(data):
    """The boot ROM's CRC out of zlib's, which takes the lowest bit first and inverts the result."""
    mirrored = bytes(reversed_bits(byte, 8) for byte in data)
    return reversed_bits(binascii.crc32(mirrored) ^ 0xFFFFFFFF, 32)


def test_each_block_of_the_uf2_is_one_page_of_flash(elf):
    found = blocks(elf.with_suffix(".uf2"))
    addresses = []
    for number, block in enumerate(found):
        first, second, flags, address, size, index, count, family = struct.unpack_from("<8I", block)
        assert (first, second, struct.unpack_from("<I", block, 508)[0]) == (0x0A324655, 0x9E5D5157, 0x0AB16F30)
        assert (flags, size, index, count, family) == (0x2000, 256, number, len(found), 0xE48BFF56)
        assert address % 256 == 0 and block[288:508] == bytes(220)
        addresses.append(address)
    assert addresses == list(range(FLASH, FLASH + 256 * len(found), 256)), "from the start of the flash, without a gap"
    assert addresses[-1] + 256 <= SETTINGS, "stored settings outlive a new program"


def test_the_uf2_holds_what_the_linker_made(elf, tmp_path):
    binary = tmp_path / "image.bin"
    tool("objcopy", "-O", "binary", elf, binary)
    flash = flash_of(elf.with_suffix(".uf2"))
    expected = binary.read_bytes()
    assert bytes(flash[FLASH + i] for i in range(len(expected))) == expected
    assert all(byte == 0xFF for address, byte in flash.items() if address >= FLASH + len(expected))


def test_the_boot_block_has_its_crc(elf):
    assert crc_of(b"123456789") == 0x0376E6E7
    flash = flash_of(elf.with_suffix(".uf2"))
    block = bytes(flash[BOOT2 + i] for i in range(256))
    assert struct.unpack_from("<I", block, 252)[0] == crc_of(block[:252])
    assert any(block[:252])


def test_the_program_begins_with_its_vectors(elf):
    flash, names = flash_of(elf.with_suffix(".uf2")), symbols(elf)
    stack, reset = struct.unpack("<2I", bytes(flash[PROGRAM + i] for i in range(8)))
    assert stack == names["canopy_stack_top"] and stack % 8 == 0
    assert reset == names["canopy_reset"] | 1
    assert names["canopy_stack_limit"] == RAM


def test_ram_keeps_clear_of_the_boot_rom(elf):
    """The ROM's stack and the boot block stand in SRAM 5 at each reset: what survives one must not."""
    sections = [row.split() for row in tool("objdump", "-h", elf).splitlines() if re.match(r"\s+\d+ \.", row)]
    ends = {row[1]: int(row[3], 16) + int(row[2], 16) for row in sections if int(row[3], 16) >= RAM}
    assert ".noinit" in ends
    assert max(ends.values()) <= RAM + 260 * 1024


# ---- Code that runs while there is no flash

def content(elf, section):
    """{address: byte} of a section."""
    rows = re.findall(r"^ ([0-9a-f]+)((?: [0-9a-f]{2,8}){1,4})", tool("objdump", "-s", "-j", section, elf), re.M)
    return {int(at, 16) + i: byte for at, words in rows for i, byte in enumerate(bytes.fromhex(words))}


def outward(elf, section, inside):
    """What the code in `inside` refers to outside of it: branch targets and literals; and the registers it calls through."""
    text = tool("objdump", "-D", "--no-show-raw-insn", "-j", section, f"--start-address={inside.start}",
                f"--stop-address={inside.stop}", elf)
    targets = [int(address, 16) for address in re.findall(r"\t(?:bl?x?|b\w\w)(?:\.[nw])?\t([0-9a-f]+) <", text)]
    places = [int(address, 16) for address in re.findall(r"\tldr\tr\d+, \[pc, #\d+\]\t@ \(([0-9a-f]+)", text)]
    assert all(place in inside for place in places), "a constant outside of the code"
    held = content(elf, section)
    literals = [int.from_bytes(bytes(held[place + i] for i in range(4)), "little") for place in places]
    calls = re.findall(r"\tblx\t(r\d+|ip)", text)
    assert targets or literals or calls, "nothing was read"
    return [value for value in targets if value not in inside] + literals, calls


def words_in_flash(values):
    return [hex(value) for value in values if FLASH <= value < FLASH + 0x05000000]


def test_the_flash_is_written_from_ram():
    """Its instructions and constants are in RAM; it calls what it is given, and nothing else."""
    elf = IMAGES / "conformance.elf"
    names = symbols(elf)
    begin, end = names["canopy_ramfunc_start"], names["canopy_ramfunc_end"]
    assert RAM <= begin < end and begin <= names["write_flash"] < end
    out, calls = outward(elf, ".data", range(begin, end))
    assert out == [], [hex(value) for value in out]
    assert len(calls) == 6, "one for each step"
    assert not any(end <= address < names["canopy_data_end"] for name, address in symbols(elf).items()
                   if name.endswith("_veneer")), "a detour over flash"


def test_the_boot_block_works_wherever_it_is_copied(elf):
    """It branches within itself and names the flash once: where the program begins."""
    out, calls = outward(elf, ".boot2", range(BOOT2, BOOT2 + 252))
    assert words_in_flash(out) == [hex(PROGRAM)]
    assert calls == []


def test_what_calls_the_flash_would_be_seen():
    """The reader above, against a function that stands in flash."""
    elf = IMAGES / "conformance.elf"
    names = symbols(elf)
    begin = names["canopy_board_start"] & ~1
    end = min(address for address in names.values() if begin < address < begin + 0x1000)
    out, _ = outward(elf, ".text", range(begin, end))
    assert words_in_flash(out)


# ---- Bad input of the tool

@pytest.mark.parametrize("content, what", [
    (b"no elf at all, but long enough to be one" * 4, "not an ELF"),
    (b"", "not an ELF"),
])
def test_the_tool_refuses_what_is_no_image(tmp_path, content, what):
    path = tmp_path / "image.elf"
    path.write_bytes(content)
    done = subprocess.run([sys.executable, TOOL, path], capture_output=True, text=True)
    assert done.returncode == 2 and what in done.stderr and str(path) in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not path.with_suffix(".uf2").exists()


def test_the_tool_refuses_the_image_of_another_chip():
    done = subprocess.run([sys.executable, TOOL, BUILD / "mps2_an385" / "canopy.elf"], capture_output=True, text=True)
    assert done.returncode == 2 and "not in the flash" in done.stderr
    assert subprocess.run([sys.executable, TOOL], capture_output=True).returncode == 64


def test_an_image_too_large_fails_and_says_by_how_much(tmp_path):
    source = tmp_path / "large.c"
    source.write_text("const char bulk[3 << 20] = {1};\n"
                      "__attribute__((section(\".boot2.entry\"), used)) void boot2(void) {}\n"
                      "void canopy_reset(void) { __asm volatile(\"\" ::\"r\"(bulk)); }\n")
    root = TOOL.parent.parent
    done = subprocess.run(["arm-none-eabi-gcc", "-mcpu=cortex-m0plus", "-mthumb", "-nostartfiles", "-nostdlib",
                           f"-L{root / 'linker'}", f"-T{root / 'linker' / 'rp2040.ld'}", "-Wl,--defsym=canopy_stack_size=1024",
                           str(source), "-o", str(tmp_path / "large.elf")], capture_output=True, text=True)
    assert done.returncode != 0
    over = re.search(r"region `FLASH' overflowed by (\d+) bytes", done.stderr)
    assert over and 0 < int(over.group(1)) - ((3 << 20) - (2 << 20) + 256 + 8192) < 4096
