"""The far end of hosttest/firmware/conformance.c on every board: its lines, its orders, and what each board is expected to do.

What stands in BOARDS is what a port promises. A test asks for what the board has and for "unsupported" where it has nothing;
docs/conformance.md says how to add a board.
"""

import os
import pty
import select
import socket
import subprocess
import time
import tty
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from running import BUILD, Emulator

# enum canopy_crash_kind, enum canopy_i2c_outcome and enum canopy_status, written down once more: a change there is a change
# of what others read
WATCHDOG, HARD, MEMORY, BUS, USAGE = 2, 3, 4, 5, 6
PENDING, DONE, NAK_ADDRESS, NAK_DATA, TIMEOUT, ARBITRATION, HELD, UNSUPPORTED = range(8)
STATUS_OK, STATUS_ARGUMENT, STATUS_UNSUPPORTED = "0", "2", "9"

ROOT = Path(__file__).resolve().parent.parent


BELOW_STACK = -1


@dataclass(frozen=True)
class Crash:
    """What a fault leaves: kind, bits of the status that are set, address (or BELOW_STACK), whether the place is known."""
    kind: int
    status: int = 0
    address: int = 0
    place: bool = True


@dataclass(frozen=True)
class Expected:
    lines: int
    emulated: bool = True
    console: int = 2          # which of the emulator's serials shows canopy_board_put; None: not one of them
    sending: bool = True      # `sent` is seen false behind a write; the wire takes time there
    loses: bool = True        # a flood is lost and counted; else the far end is held up
    pace: float = 0.9         # least speed of its clock, as a part of the host's
    exact: int = 0            # how late a sleep may end, us, where the emulator's time is virtual; 0: the host is to blame
    i2c: int = 0              # max_transfer; 0: unsupported
    flash: tuple = (0, 0, 0)  # pages, bytes of one, unit of programming
    watchdog: bool = True
    nowhere: int = 0xF0000000  # an address that nothing answers to
    crashes: dict = field(default_factory=dict)  # kind of fault: Crash; what is not there is not tried
    extra: tuple = ()  # of the emulator: devices, files


# ARMv7-M Architecture Reference Manual, B3.2.15: bits of CFSR
CORTEX_M = {
    "address": Crash(BUS, status=1 << 9, address=0xF0000000),
    "instruction": Crash(USAGE, status=1 << 16),
    "stack": Crash(MEMORY, status=1 << 4, address=BELOW_STACK, place=False),  # the frame could not be stacked
    "hang": Crash(WATCHDOG),
}
MPS2 = Expected(lines=2, crashes=CORTEX_M)

# ARMv6-M Architecture Reference Manual, B1.5: every fault is a HardFault, which does not know why; where its frame cannot be
# pushed the processor locks up, and the watchdog ends that
CORTEX_M0 = {
    "address": Crash(HARD),
    "instruction": Crash(HARD),
    "stack": Crash(WATCHDOG, place=False),
    "hang": Crash(WATCHDOG),
}

# RISC-V Privileged Architecture, 3.1.15: mcause
RISCV = {
    "address": Crash(BUS, status=5, address=0xF0000000),
    "instruction": Crash(USAGE, status=2),
    "stack": Crash(MEMORY, status=7, address=BELOW_STACK),
    "hang": Crash(WATCHDOG, status=1 << 31),
}

BOARDS = {
    "mps2_an385": MPS2,
    "mps2_an386": MPS2,
    "mps2_an500": MPS2,
    "riscv_virt": Expected(lines=1, sending=False, crashes=RISCV),  # its UART takes no time to send
    "rp2040_pico": Expected(lines=2, i2c=65535, flash=(2, 4096, 256), crashes=CORTEX_M0, console=1, pace=0.3, exact=5,
                            extra=("--memory", "80", "--flash", "{scratch}/flash", "--keep")),
    "linux": Expected(lines=2, emulated=False, console=None, sending=False, loses=False, flash=(2, 4096, 1), watchdog=False),
    "template": Expected(lines=0, emulated=False, console=None, sending=False, loses=False, watchdog=False),
}

FAULTS = ("address", "instruction", "stack", "hang")  # in the order of `fault`
PATTERN = bytes(range(ord("!"), ord("!") + 94))


def pattern(count, first=0):
    return bytes(PATTERN[(first + i) % len(PATTERN)] for i in range(count))


class Silence(Exception):
    pass


class Line:
    """One end of a line: a socket, a pty's master or a pipe."""

    def __init__(self, read_fd, write_fd=None):
        self.read_fd, self.write_fd, self.got = read_fd, read_fd if write_fd is None else write_fd, b""

    def send(self, data):
        while data:
            select.select([], [self.write_fd], [])
            data = data[os.write(self.write_fd, data[:1024]):]

    def hear(self, seconds):
        """What has come, or comes within the time; b"" if nothing does."""
        if not self.got and select.select([self.read_fd], [], [], seconds)[0]:
            self.got = os.read(self.read_fd, 65536)
        heard, self.got = self.got, b""
        return heard

    def take(self, count, seconds=20):
        """Exactly so many bytes."""
        taken, end = b"", time.monotonic() + seconds
        while len(taken) < count:
            heard = self.hear(max(0, end - time.monotonic()))
            if not heard:
                raise Silence(f"{len(taken)} of {count} bytes: {taken[-60:]}")
            taken += heard
        self.got = taken[count:]
        return taken[:count]

    def take_line(self, seconds=20):
        text, end = b"", time.monotonic() + seconds
        while b"\n" not in text:
            heard = self.hear(max(0, end - time.monotonic()))
            if not heard:
                raise Silence(f"no end of line: {text[-60:]}")
            text += heard
        line, self.got = text.split(b"\n", 1)
        return line.decode(errors="replace").strip()

    def drain(self):
        while self.hear(0):
            pass


class Running:
    """A board that runs the program. `orders` is the line that orders go to, `lines` its lines."""

    def __init__(self, name, scratch, counting=False):
        self.name, self.expected, self.scratch = name, BOARDS[name], scratch
        self.image = BUILD / name / "conformance.elf"
        self.start(counting)
        try:
            self.wait_started()
        except Silence:
            self.close()
            raise

    def start(self, counting=False):
        for left in self.scratch.glob("line*"):
            left.unlink()  # of the run before the power failed
        extra = [word.format(scratch=self.scratch) for word in self.expected.extra]
        self.emulator = Emulator("conformance.elf", self.scratch, self.name, counting, extra)
        ends = [Line(line.fileno()) for line in self.emulator.lines]
        self.lines, self.orders = ends[:self.expected.lines], ends[0]
        self.console = None if self.expected.console is None else ends[self.expected.console]

    def wait_started(self, seconds=20):
        while self.orders.take_line(seconds) != "started":
            pass

    def tell(self, *order):
        self.orders.send(" ".join(str(word) for word in order).encode() + b"\n")

    def ask_text(self, *order, seconds=20):
        self.tell(*order)
        return self.orders.take_line(seconds)

    def numbers(self, seconds=20):
        return [int(word) for word in self.orders.take_line(seconds).split()]

    def ask(self, *order, seconds=20):
        self.tell(*order)
        return self.numbers(seconds)

    def wait(self, us):
        """So long by the board's own clock."""
        end = self.ask("now")[0] + us
        while self.ask("now")[0] < end:
            time.sleep(0.1)

    def settle(self):
        """As after a start: nothing under way, nothing on the lines. False if it is not there any more."""
        for line in {self.orders, *self.lines}:
            line.drain()
        try:
            self.ask("now", seconds=3)
            if self.ask_text("crash") != "none":
                self.ask_text("forget")
        except (Silence, OSError, ValueError):
            return False
        return True

    def symbol(self, name):
        """The addresses of a function of the image; of a symbol without a size its value alone."""
        table = subprocess.run(["nm", "-S", str(self.image)], check=True, capture_output=True, text=True)
        for words in map(str.split, table.stdout.splitlines()):
            if words[-1] == name:
                start = int(words[0], 16) & ~1
                return range(start, start + (int(words[1], 16) if len(words) == 4 else 1))
        raise KeyError(name)

    def power_off_and_on(self):
        self.close()
        self.start()
        self.wait_started()

    def close(self):
        self.emulator.close()


class Process(Running):
    """A port that runs on the host."""

    def start(self, counting=False):
        self.image = BUILD / f"test/conformance_{self.name}"
        self.ends = [pty.openpty() for _ in range(self.expected.lines)]
        for _, far in self.ends:
            tty.setraw(far)  # what is sent before the port has opened it must not come back
        environment = {**os.environ, "CANOPY_LINES": " ".join(os.ttyname(far) for _, far in self.ends),
                       "CANOPY_FLASH": str(self.scratch / "flash")}
        self.process = subprocess.Popen([str(self.image)], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.lines, self.console = [Line(near) for near, _ in self.ends], None
        self.orders = self.lines[0] if self.lines else Line(self.process.stdout.fileno(), self.process.stdin.fileno())

    def close(self):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()
        for pair in self.ends:
            for end in pair:
                os.close(end)


def start(name, scratch, counting=False):
    return (Running if BOARDS[name].emulated else Process)(name, scratch, counting)


class Keeper:
    """One board runs at a time, and goes on from test to test as long as it answers."""

    def __init__(self, scratch):
        self.scratch, self.running, self.broken = scratch, None, set()

    def board(self, name):
        assert name not in self.broken, "it did not start before"
        if self.running and (self.running.name != name or not self.running.settle()):
            self.stop()
        if not self.running:
            self.broken.add(name)
            self.running = start(name, self.scratch(name))
            self.broken.remove(name)
        return self.running

    def stop(self):
        if self.running:
            self.running.close()
        self.running = None


@pytest.fixture(scope="module")
def keeper(tmp_path_factory):
    made = Keeper(tmp_path_factory.mktemp)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def name(request):
    return request.param


@pytest.fixture
def board(name, keeper):
    return keeper.board(name)


def on(which=lambda expected: True):
    """Runs a test on the boards of which this is true, board by board."""
    return pytest.mark.parametrize("name", [board for board, expected in BOARDS.items() if which(expected)],
                                   indirect=True, scope="module")
