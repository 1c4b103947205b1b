"""The station's firmware on the emulated RISC-V board: its own scanner, a PLC that the test plays, and what makes the image
right for cores that lack what the emulator has."""

import re
import subprocess
import time
from pathlib import Path

import pytest

import emulator
import stations
import sweep
from rtu import Client, NoAnswer, Patient
from running import BUILD, Emulator
from stations import INTRUSION, VALID, gaps

# runs alone: the board's time is the host's

ROOT = Path(__file__).resolve().parent.parent
IMAGES = BUILD / "riscv_virt"
WHOLE = sweep.PROFILES


class Device(stations.Device):
    def __init__(self, image, scratch, extra=(), heard=True):
        begun = Emulator(image, scratch, board="riscv_virt", extra=extra)
        super().__init__(begun, Patient(begun.lines[0]))
        self.said = self.console(" starts\r\n") if heard else time.sleep(1)  # the line is set up by then

    def console(self, end):
        text = b""
        while not text.endswith(end.encode()):
            text += self.emulator.lines[2].recv(1000)
        return text.decode()

    def envelope(self):
        """One that was not withdrawn while it was read, as each intrusion does."""
        for _ in range(50):
            try:
                envelope = self.registers.envelope()
                if envelope["sequence"] != 0:
                    return envelope
            except AssertionError as torn:
                if "another envelope" not in str(torn):
                    raise
            time.sleep(0.05)
        raise AssertionError("no envelope stands long enough to be read")


@pytest.fixture(params=["canopy.elf", "canopy-10x10.elf"])
def device(request, tmp_path):
    made = Device(request.param, tmp_path)
    yield made
    made.close()


@pytest.fixture
def big(tmp_path):
    made = Device("canopy.elf", tmp_path)
    yield made
    made.close()


def least_gap(envelope, points):
    return min(gaps(envelope, set(points)))


def test_the_scene_is_the_one_that_the_page_describes():
    """What the board plays, counted by hand: if this moves, tools/sweep.py and sweep.c do."""
    first = sweep.sweep_points(0)
    assert len(first) < sweep.COLUMNS * sweep.PROFILES
    assert sweep.first(len(first) + 5) == first + first[:5]
    before, after = set(first), set(sweep.sweep_points(1))
    assert sweep.sweep_points(2) == sweep.sweep_points(1) and max(z for *_, z in after - before) > 900
    assert all(0 <= z <= 2047 for _, _, z in after)


def test_a_sweep_becomes_a_safe_envelope(device):
    device.wait("profiles", lambda count: count >= WHOLE + 10)
    device.wait("points", lambda count: count >= len(sweep.sweep_points(0)))
    envelope = device.envelope()
    points = sweep.first(envelope["points"])
    assert envelope["margin"] >= 0
    assert abs(envelope["unit"] - sweep.UNIT) < 1e-8
    found, heights = gaps(envelope, set(points)), [z for *_, z in points]
    assert min(found) >= 0
    loosest = {20: 0.2, 10: 0.4}[envelope["grid_m"]]
    assert sum(found) / len(found) < loosest * (max(heights) - min(heights))
    assert device.registers["points_rejected"] == 0
    for counter in ("profiles_missed", "profiles_torn", "profiles_short", "profiles_refused", "scan_errors", "lost_bytes"):
        assert device.registers[counter] == 0


def test_a_part_that_comes_later_is_an_intrusion_until_it_is_covered(big):
    big.wait("profiles", lambda count: count >= WHOLE - 10)
    before, envelope = big.registers["intrusions"], big.envelope()
    assert least_gap(envelope, sweep.sweep_points(1)) < 0, "it would be seen if an envelope were too low"
    big.wait("intrusions", lambda count: count > before)
    big.wait("points", lambda count: count >= len(sweep.sweep_points(0)) + len(sweep.sweep_points(1)))
    big.wait("status", lambda status: status & (VALID | INTRUSION) == VALID)
    assert least_gap(big.envelope(), sweep.sweep_points(1)) >= 0


def test_every_envelope_on_the_way_is_safe(big):
    """Half a sweep and the new part's first rows, too: whatever number of readings an envelope says it covers."""
    seen = set()
    while len(seen) < 6:
        big.wait("sequence", lambda sequence: sequence > 0 and sequence not in seen)
        envelope = big.envelope()
        seen.add(envelope["sequence"])
        assert least_gap(envelope, sweep.first(envelope["points"])) >= 0, envelope["points"]


def test_illegal_requests_and_noise(big):
    for pdu, answer in ((b"\x2a\x00", b"\xaa\x01"), (b"\x03\xff\xf0\x00\x05", b"\x83\x02"),
                        (b"\x03\x00\x00\x00\x7e", b"\x83\x03"), (b"\x06\x00\xb4\x00\x01", b"\x86\x02")):
        assert big.client.exchange(pdu, len(answer)) == answer
    with pytest.raises(NoAnswer):
        Client(big.emulator.lines[0], unit=9, timeout=0.3).read(0, 1)
    for noise in (b"\x00", bytes(range(200)), b"\x01\x03\x00\x00\x00", b"\xff" * 600):
        big.emulator.lines[0].sendall(noise)
        time.sleep(0.15)
    assert big.registers["magic"] == 0x434E5059
    assert big.registers["rx_errors"] > 0


def test_it_sleeps_between_profiles(big):
    big.wait("profiles", lambda count: count > 2 * WHOLE + 20)
    assert stations.processor_seconds(big, 2) < 1.2


def test_the_stack_stays_within_what_the_call_graph_says(big):
    big.wait("points", lambda count: count > 5000)
    big.envelope()
    big.client.write(big.registers.table["query_x"]["address"], [0, 500, 0, 500])
    assert big.registers["query_sequence"] > 0
    stations.check_stack(big, IMAGES / "canopy.elf")


def assert_it_works(device):
    try:
        assert device.registers["magic"] == 0x434E5059
        device.wait("points", lambda count: count > 0)
    finally:
        device.close()


def test_a_core_without_memory_protection_starts(tmp_path):
    assert_it_works(Device("canopy.elf", tmp_path, extra=["-cpu", "rv32,pmp=false"]))


def test_without_a_debugger_the_console_is_dropped(tmp_path, monkeypatch):
    """Nobody hears semihosting's breakpoints: they trap, and the program goes on."""
    whole = emulator.BOARDS["riscv_virt"]
    monkeypatch.setitem(emulator.BOARDS, "riscv_virt", lambda *arguments: [
        word for word in whole(*arguments) if not word.startswith(("-semihosting", "enable=on"))])
    assert_it_works(Device("canopy.elf", tmp_path, heard=False))


def test_the_console_says_that_it_starts(big):
    assert re.fullmatch(r"canopy \S+ starts\r\n", big.said)


def test_an_image_too_large_says_by_how_much(tmp_path):
    source = tmp_path / "large.c"
    source.write_text("const char bulk[20000] = {1};\nvoid canopy_reset(void);\n"
                      "void canopy_reset(void) { *(volatile char *)0 = bulk[*(volatile int *)0]; }\n")
    script = (ROOT / "linker/riscv_virt.ld").read_text()
    assert "LENGTH = 256K" in script
    (tmp_path / "small.ld").write_text(script.replace("LENGTH = 256K", "LENGTH = 16K"))
    done = subprocess.run(["riscv64-unknown-elf-gcc", "-march=rv32imac", "-mabi=ilp32", "-misa-spec=2.2",
                           "--specs=picolibc.specs", "-nostartfiles", f"-L{ROOT}/linker", "-Wl,--gc-sections",
                           "-Wl,--defsym=canopy_stack_size=64", f"-T{tmp_path}/small.ld", source, "-o",
                           tmp_path / "large.elf"], capture_output=True, text=True)
    assert done.returncode != 0
    over = re.search(r"region `FLASH' overflowed by (\d+) bytes", done.stderr)
    assert over and 20000 - 16384 <= int(over.group(1)) < 20000 - 16384 + 200, done.stderr
