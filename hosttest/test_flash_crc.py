"""The CRC behind a firmware image is that of the bytes that go into the chip, and a file that is no such image is refused."""

import struct
import subprocess
import zlib
from pathlib import Path

import pytest

from running import BUILD

ROOT = Path(__file__).resolve().parent.parent
TOOL = ROOT / "tools/flash_crc.py"
# where its flash is, and whose tools know it
BOARDS = {"mps2_an385": (0, "arm-none-eabi-"), "rp2040_pico": (0x10000000, "arm-none-eabi-"),
          "riscv_virt": (0x80000000, "riscv64-unknown-elf-")}


def run(*files):
    return subprocess.run([TOOL, *files], capture_output=True, text=True)


def symbols(image, cross):
    table = subprocess.run([cross + "nm", image], check=True, capture_output=True, text=True).stdout
    return {row.split()[-1]: int(row.split()[0], 16) for row in table.splitlines() if len(row.split()) == 3}


@pytest.mark.parametrize("board", BOARDS)
def test_it_is_the_crc_of_what_is_in_the_flash(board, tmp_path):
    image, (base, cross) = BUILD / board / "canopy.elf", BOARDS[board]
    subprocess.run([cross + "objcopy", "-O", "binary", "--gap-fill", "0xA5", image, tmp_path / "flash"], check=True)
    flash = (tmp_path / "flash").read_bytes()
    names = symbols(image, cross)
    first, last = names["canopy_flash_start"], names["canopy_flash_end"]
    program = flash[first - base:last - base]
    assert 30000 < len(program) == last - first
    assert struct.unpack_from("<I", flash, last - base)[0] == zlib.crc32(program)


def test_it_can_be_done_again(tmp_path):
    whole = (BUILD / "mps2_an385/canopy.elf").read_bytes()
    copy = tmp_path / "copy.elf"
    copy.write_bytes(whole)
    assert run(copy).returncode == 0 and copy.read_bytes() == whole
    changed = bytearray(whole)
    changed[changed.index(b" starts after a crash")] ^= 1
    copy.write_bytes(changed)
    assert run(copy).returncode == 0 and copy.read_bytes() not in (whole, bytes(changed))


def test_what_is_no_image_is_refused(tmp_path):
    source, plain = tmp_path / "none.c", tmp_path / "none.elf"
    source.write_text("int main(void) { return 0; }\n")
    subprocess.run(["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-nostdlib", "-Wl,--entry=main", source, "-o", plain],
                   check=True)
    text = tmp_path / "text"
    text.write_text("nothing\n")
    short = tmp_path / "short.elf"
    short.write_bytes((BUILD / "mps2_an385/canopy.elf").read_bytes()[:60])
    for path, what in ((text, "not a 32-bit little-endian ELF file"), (plain, "has no canopy_flash_start"),
                       (short, ""), (tmp_path / "absent", "No such file"), ("/bin/true", "not a 32-bit")):
        before = Path(path).read_bytes() if Path(path).exists() else None
        done = run(path)
        assert done.returncode == 2 and done.stderr.startswith(f"{path}: ") and done.stderr.count("\n") == 1, done
        assert what in done.stderr
        assert before is None or Path(path).read_bytes() == before
    assert run().returncode == 64


def test_a_hole_in_the_program_is_refused(tmp_path):
    """What a chip has where nothing is loaded is not known, so no CRC of it can be."""
    source, script, image = tmp_path / "hole.c", tmp_path / "hole.ld", tmp_path / "hole.elf"
    source.write_text('__attribute__((section(".a"))) const int a = 1; __attribute__((section(".b"))) const int b = 2;\n')
    script.write_text("SECTIONS { .a 0x1000 : { canopy_flash_start = .; KEEP(*(.a)) }\n"
                      ".b 0x9000 : { KEEP(*(.b)) }\n.c (READONLY) : { canopy_flash_end = .; LONG(0) } }\n")
    subprocess.run(["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-nostdlib", "-Wl,--entry=0", f"-T{script}", source,
                    "-o", image], check=True)
    done = run(image)
    assert done.returncode == 2 and "nothing is loaded at 0x1004" in done.stderr, done.stderr
