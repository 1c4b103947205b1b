"""The Cortex-M port on the emulated board: lines, clock, faults, watchdog, instruction counter."""

import random
import subprocess
import time

import pytest

import bench_firmware
from running import IMAGES, Emulator


class Board(Emulator):
    """The emulator running port.elf, which takes orders on line 0 and echoes line 1."""

    def __init__(self, scratch):
        super().__init__("port.elf", scratch)
        assert self.answer() == "started"

    def answer(self, line=0):
        text = b""
        while not text.endswith(b"\n"):
            text += self.lines[line].recv(1)
        return text.decode().strip()

    def ask(self, order):
        self.lines[0].sendall(order.encode())
        return self.answer()

    def crash(self, order):
        """Gives an order that ends in a reset; returns the console's line and the record the next start finds."""
        self.lines[0].sendall(order.encode())
        assert self.answer(2) == ""
        console = self.answer(2)
        assert self.answer() == "started"
        names = ("kind", "pc", "cfsr", "address", "count")
        record = dict(zip(names, (int(word, 10 if name in ("kind", "count") else 16)
                                  for name, word in zip(names, self.ask("r").split()))))
        return console, record


@pytest.fixture
def board(tmp_path):
    running = Board(tmp_path)
    yield running
    running.close()


def function(name):
    """First and last address of a function of the image."""
    table = subprocess.run(["arm-none-eabi-nm", "-S", str(IMAGES / "port.elf")], check=True, capture_output=True, text=True)
    for row in table.stdout.splitlines():
        words = row.split()
        if words[-1] == name and len(words) == 4:
            start = int(words[0], 16) & ~1
            return range(start, start + int(words[1], 16))
    raise KeyError(name)


def test_line_echoes_every_byte_in_order(board):
    sent = random.Random(1).randbytes(20000)
    got = b""
    for start in range(0, len(sent), 256):
        board.lines[1].sendall(sent[start:start + 256])
        while len(got) < min(start + 256, len(sent)):
            got += board.lines[1].recv(4096)
    assert got == sent
    assert board.ask("l") == "0"
    assert board.ask("q") == "sent"


def test_a_flood_is_echoed_or_counted(board):
    """All at once: what the rings cannot take is counted as lost, byte for byte."""
    flood = bytes(range(250)) * 20
    board.lines[1].sendall(flood)
    board.lines[1].settimeout(1)
    got = b""
    try:
        while len(got) < len(flood):
            got += board.lines[1].recv(4096)
    except TimeoutError:
        pass
    assert len(got) + int(board.ask("l")) == len(flood)


def test_clock_never_goes_back(board):
    assert board.ask("m") == "forward"


def test_clock_keeps_time(board):
    began, first = time.monotonic(), int(board.ask("t"))
    time.sleep(1)
    last, ended = int(board.ask("t")), time.monotonic()
    assert 0.9e6 <= last - first <= (ended - began) * 1e6 + 0.1e6


def test_a_fed_watchdog_does_not_bite(board):
    time.sleep(1.5)  # three periods
    assert board.ask("r") == "none"


@pytest.mark.parametrize("order, kind, place, bit, address", [
    ("a", 5, "fault_by_address", 1 << 9, 0xF0000000),
    ("i", 6, "fault_by_instruction", 1 << 16, 0),
])
def test_fault_says_where_and_survives_the_reset(board, order, kind, place, bit, address):
    console, record = board.crash(order)
    assert record["kind"] == kind
    assert record["pc"] in function(place)
    assert record["cfsr"] & bit
    assert record["address"] == address
    assert console.startswith(f"crash {kind:08x} pc {record['pc']:08x} ")
    assert board.ask("f") == ""
    assert board.ask("r") == "none"


def test_stack_overflow_faults_instead_of_eating_data(board):
    console, record = board.crash("s")
    assert record["kind"] == 4
    assert record["pc"] == 0, "no frame to read"
    assert record["cfsr"] & 1 << 4, "stacking error"
    assert console.startswith("crash 00000004 ")


def test_a_hang_is_ended_by_the_watchdog_and_says_where(board):
    _, record = board.crash("h")
    assert record["kind"] == 2
    assert record["pc"] in function("fault_by_hanging")


def test_faults_are_counted_over_resets(board):
    assert board.crash("i")[1]["count"] == 1
    assert board.ask("f") == ""
    assert board.crash("a")[1]["count"] == 2


def test_instruction_counts_are_right_and_repeatable():
    first = bench_firmware.count(IMAGES / "count.elf")
    assert first == bench_firmware.count(IMAGES / "count.elf")
    assert first["nothing"] <= 80  # the call, and a tick
    for turns in (1000, 100000, 10000000):
        interrupts = 2 * turns / 1e6 * 40
        assert 0 <= first[f"turns_{turns}"] - 2 * turns <= 80 + interrupts
