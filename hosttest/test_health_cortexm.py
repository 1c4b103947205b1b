"""Health and settings of the station's firmware on the emulated board, as a PLC sees them."""

import contextlib
import socket
import struct
import time

import pytest

from running import IMAGES
from rtu import NoAnswer
from stations import hills, symbol
from test_station_cortexm import Device

# runs alone: the board's time is the host's

RAM, FLASH, CERTIFICATE = 1, 2, 4
POWER, WATCHDOG, CRASH, COMMAND, OTHER = range(5)
STORE, DEFAULTS, RESET = 4, 5, 6


class Debugger:
    """A debugger's end of the emulator: it stops the processor while it is connected (GDB's remote protocol)."""

    def __init__(self, emulator):
        path = emulator.scratch / "debugger"
        emulator.order(f"gdbserver unix:{path},server=on,wait=off")
        self.line = socket.socket(socket.AF_UNIX)
        self.line.settimeout(10)
        self.line.connect(str(path))
        time.sleep(0.3)
        self.line.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            self.line.recv(4096)  # that it has stopped
        self.line.settimeout(10)
        self.line.sendall(b"+")
        self.ask("qXfer:features:read:target.xml:0,ffb")  # before that no register can be written alone

    def send(self, text):
        self.line.sendall(f"${text}#{sum(text.encode()) % 256:02x}".encode())

    def ask(self, text):
        self.send(text)
        got = b""
        while b"#" not in got[:-2]:
            got += self.line.recv(4096)
        self.line.sendall(b"+")
        return got.decode().lstrip("+")[1:].split("#")[0]

    def jump(self, address):
        """Lets the processor go on somewhere else."""
        assert self.ask(f"Pf={struct.pack('<I', address).hex()}") == "OK"
        self.leave()

    def leave(self):
        self.ask("D")
        self.line.close()


@pytest.fixture
def small(tmp_path):
    made = Device("canopy-10x10.elf", tmp_path)
    yield made
    made.close()


def give(device, code):
    assert device.client.write(device.registers.table["command"]["address"], [code])[0] == 16


def order(device, code):
    give(device, code)
    return device.registers["command_result"]


def wait(device, name, condition, seconds):
    """Patiently: a restart, or a host that holds the emulator up in the middle of a request, costs an answer."""
    end = time.monotonic() + seconds
    while True:
        with contextlib.suppress(NoAnswer):
            if condition(device.registers[name]):
                return
        assert time.monotonic() < end, name
        time.sleep(0.2)


def wait_for_start(device, starts):
    wait(device, "starts", lambda count: count == starts, 20)


def test_every_test_passes_and_the_envelope_is_valid(small):
    assert small.registers["selftests"] == RAM | FLASH | CERTIFICATE
    assert small.registers["selftests_passed"] & CERTIFICATE
    scanner = small.scan(hills(20, 30))
    wait(small, "points", lambda count: count == len(scanner.points()), 40)
    assert small.registers["status"] & 1
    wait(small, "selftests_passed", lambda passed: passed == RAM | FLASH | CERTIFICATE, 90)
    assert small.registers["selftests_failed"] == 0
    assert small.registers["sequence"] > 0
    image = (IMAGES / "canopy-10x10.elf").read_bytes()
    assert struct.pack("<I", small.registers["flash_crc"]) in image, "what the build has put there"
    first = small.registers["ram_passes"]
    assert first >= 1 and small.registers["flash_passes"] >= 1
    scanner.running = False
    scanner.join()
    assert small.registers["scanner_lost_bytes"] == 0
    wait(small, "scanner_failure", lambda why: why == 1, 10)


def test_a_changed_program_publishes_nothing(tmp_path):
    """One bit of a text: nothing notices but the CRC."""
    image = bytearray((IMAGES / "canopy-10x10.elf").read_bytes())
    assert image.count(b" starts after a crash") == 1
    image[image.index(b" starts after a crash") + 4] ^= 1
    (tmp_path / "changed.elf").write_bytes(image)
    device = Device(tmp_path / "changed.elf", tmp_path)
    try:
        scanner = device.scan(hills(20, 30))
        wait(device, "selftests_failed", lambda failed: failed == FLASH, 60)
        assert device.registers["selftests_passed"] & FLASH == 0
        wait(device, "points_accepted", lambda count: count == len(scanner.points()), 40)
        assert device.registers["status"] & 1 == 0
        assert device.registers["sequence"] == 0
        time.sleep(2)
        assert device.registers["status"] & 1 == 0
        assert device.registers["sequence"] == 0
    finally:
        device.close()


def test_a_crash_can_be_read_afterwards(small):
    registers = small.registers
    assert (registers["reset_reason"], registers["starts"], registers["crash_kind"]) == (POWER, 1, 0)
    Debugger(small.emulator).jump(0xE0000000)  # nothing may be executed there
    wait_for_start(small, 2)
    assert registers["reset_reason"] == CRASH
    assert registers["crash_count"] == 1
    assert registers["crash_kind"] in (3, 4), "a hard fault of no kind, or a forbidden address"
    assert registers["crash_pc"] == 0xE0000000
    image = IMAGES / "canopy-10x10.elf"
    assert symbol(image, "canopy_stack_limit") < registers["crash_sp"] < symbol(image, "canopy_stack_top")
    assert registers["selftests_passed"] & CERTIFICATE
    # it stays known, whatever else resets the device
    give(small, RESET)  # the answer leaves first
    wait_for_start(small, 3)
    assert registers["reset_reason"] == COMMAND
    assert (registers["crash_count"], registers["crash_pc"]) == (1, 0xE0000000)
    Debugger(small.emulator).jump(0x50000000)
    wait_for_start(small, 4)
    assert (registers["crash_count"], registers["reset_reason"]) == (2, CRASH)


def test_settings_without_a_memory_for_them(small):
    """The board has no flash: what is written is checked, and cannot be stored."""
    table = small.registers.table
    assert small.registers["settings_state"] == 4
    assert order(small, STORE) == order(small, DEFAULTS) == 2
    for name, value, answer in (("set_plc_unit", 17, 16), ("set_plc_unit", 0, 0x90), ("set_plc_unit", 248, 0x90),
                                ("set_plc_format", 1, 0x90)):
        assert small.client.exchange(struct.pack(">BHHBH", 16, table[name]["address"], 1, 2, value),
                                     5 if answer == 16 else 2)[0] == answer, name
    assert small.registers["set_plc_unit"] == 17
    half = small.client.exchange(struct.pack(">BHH", 6, table["set_plc_baud"]["address"], 0), 2)
    assert half == b"\x86\x02", "half of a value"
    give(small, RESET)
    wait_for_start(small, 2)
    assert small.registers["set_plc_unit"] == 1
