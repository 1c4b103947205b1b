"""What every port with an I2C bus promises (docs/conformance.md): transfers as they are heard on the wire, and every fault of it.

The far end is a memory of 256 bytes behind a pointer of one byte, at 50h.
"""

import random

import pytest

from conformance import DONE, HELD, NAK_ADDRESS, NAK_DATA, TIMEOUT, UNSUPPORTED, on, pattern
from conformance import board, keeper, name  # noqa: F401  (fixtures)

MEMORY, NOBODY = 0x50, 0x51
SLACK_US = 2000  # nine clocks and the way to the answer


class Bus:
    def __init__(self, board):
        self.board, self.took_us, self.bytes = board, 0, b""
        self.fault("none")
        self.heard()

    def fault(self, text):
        assert self.board.emulator.order(f"fault {text}") == ""

    def heard(self):
        """What the wire has carried since the last time: tools/rp2040/wire.mjs, note."""
        return self.board.emulator.order("bus").split()

    def recoveries(self):
        return self.board.ask("bus")[1]

    def transfer(self, out=b"", count=0, address=MEMORY, stop=0, timeout_us=100000, out_length=None, away_us=0):
        """How it ended. The bytes of `out` go on counting if out_length says so. Nobody polls for away_us."""
        length = len(out) if out_length is None else out_length
        text = self.board.ask_text("i2c", address, stop, timeout_us, length, count, away_us, out.hex())
        outcome, took_us, refused, stays, *data = text.split()
        assert stays == "1", "the outcome stays until the next start"
        assert refused == "1" or int(outcome) in (HELD, UNSUPPORTED), "one transfer at a time"
        self.took_us, self.bytes = int(took_us), bytes.fromhex(data[0]) if data else b""
        assert self.took_us <= max(timeout_us, away_us) + SLACK_US
        return int(outcome)

    def assert_good(self):
        """All is well again, or still."""
        mark = random.Random(self.took_us).randbytes(3)
        assert self.transfer(b"\x20" + mark) == DONE
        assert self.transfer(b"\x20", 3) == DONE
        assert self.bytes == mark


@pytest.fixture
def bus(board):
    made = Bus(board)
    yield made
    made.fault("none")
    made.assert_good()


with_i2c = on(lambda expected: expected.i2c)


@with_i2c
def test_before_the_first_transfer_there_is_no_outcome(board):
    board.tell("reset")
    board.wait_started()
    assert board.ask("bus") == [UNSUPPORTED, 0]


@with_i2c
def test_transfers_are_what_was_asked_for(bus):
    assert bus.transfer(b"\x10\xaa\xbb\xcc\xdd") == DONE
    assert bus.heard() == ["Sw50", "w10", "waa", "wbb", "wcc", "wdd", "P"]
    assert bus.transfer(b"\x11", 2) == DONE
    assert bus.bytes == b"\xbb\xcc"
    assert bus.heard() == ["Sw50", "w11", "Rr50", "rbb", "rcc", "P"], "repeated START"
    assert bus.transfer(b"\x10", 2, stop=1) == DONE
    assert bus.bytes == b"\xaa\xbb"
    assert bus.heard() == ["Sw50", "w10", "P", "Sr50", "raa", "rbb", "P"], "STOP and START"
    assert bus.transfer(b"", 2) == DONE
    assert bus.bytes == b"\xcc\xdd"
    assert bus.heard() == ["Sr50", "rcc", "rdd", "P"]


@with_i2c
def test_a_probe_asks_the_address_alone_and_writes_nothing(bus):
    assert bus.transfer() == DONE
    heard = bus.heard()
    assert heard[0] in ("Sw50", "Sr50") and heard[-1] == "P"
    assert not [word for word in heard if word.startswith("w")]
    assert bus.transfer(address=NOBODY) == NAK_ADDRESS
    heard = bus.heard()
    assert heard in (["Sw51!", "P"], ["Sr51!", "P"])


@with_i2c
@pytest.mark.parametrize("out, count", [(b"", 1), (b"\x10", 0), (b"\x10\x01", 2), (b"\x10" * 40, 0), (b"", 40)])
@pytest.mark.parametrize("stop", [0, 1])
def test_nobody_at_the_address(bus, out, count, stop):
    assert bus.transfer(out, count, address=NOBODY, stop=stop) == NAK_ADDRESS
    assert bus.heard() == [f"S{'w' if out else 'r'}51!", "P"], "and the bus is free again"
    bus.assert_good()


@with_i2c
@pytest.mark.parametrize("stop", [0, 1])
@pytest.mark.parametrize("length", [1, 4, 30])
def test_a_byte_that_is_refused_ends_the_transfer(bus, length, stop):
    for refused in sorted({1, length // 2 + 1, length}):
        bus.fault(f"nak-byte={refused}")
        out = bytes(0x40 + i for i in range(length))
        assert bus.transfer(out, 2, stop=stop) == NAK_DATA
        heard = bus.heard()
        assert heard == ["Sw50", *(f"w{byte:02x}" for byte in out[:refused - 1]), f"w{out[refused - 1]:02x}!", "P"]
        bus.fault("none")
        bus.assert_good()
        bus.heard()


@with_i2c
@pytest.mark.parametrize("length", [1, 2, 7, 8, 9, 15, 16, 17, 18, 31, 32, 33, 64, 255, 256])
def test_lengths(bus, length):
    """At the edges of FIFOs and counters."""
    assert bus.transfer(b"\x00" + bytes([length & 255]), out_length=1 + length) == DONE
    written = bytes([length & 255, *(i & 255 for i in range(2, length + 1))])
    heard = bus.heard()
    assert heard == ["Sw50", "w00", *(f"w{byte:02x}" for byte in written), "P"]
    bits = 9 * (length + 2)
    assert bus.took_us >= bits * 2.5 * 0.98, "not faster than 400 kHz"
    for stop, away_us in ((0, 0), (1, 0), (0, 2 * 25 * length), (0, 10000)):
        assert bus.transfer(b"\x00", length, stop=stop, away_us=away_us) == DONE, "also when the program is away"
        assert bus.bytes == written
    assert bus.transfer(b"\x00") == DONE
    assert bus.transfer(b"", length) == DONE
    assert bus.bytes == written


@with_i2c
def test_the_longest_transfer(bus):
    most = min(bus.board.expected.i2c, 1030)
    assert bus.transfer(b"\x00\x01", out_length=most) == DONE
    assert bus.transfer(b"\x00", most) == DONE
    assert bus.bytes == (bus.bytes[:256] * 5)[:most], "the memory begins anew behind 256"
    if bus.board.expected.i2c < 65535:
        assert bus.transfer(b"\x00\x01", out_length=bus.board.expected.i2c + 1) == UNSUPPORTED
        assert bus.transfer(b"\x00", bus.board.expected.i2c + 1) == UNSUPPORTED


@with_i2c
def test_an_address_of_more_than_seven_bits_is_unsupported(bus):
    assert bus.transfer(b"\x00", address=0x80) == UNSUPPORTED
    assert bus.heard() == []


# ---- Clocks that are held

@with_i2c
def test_a_device_may_hold_the_clock_for_a_while(bus):
    before = bus.recoveries()
    bus.fault("stretch=300")
    assert bus.transfer(b"\x30\x77", 4) == DONE
    assert bus.took_us >= 300 * 7
    assert bus.recoveries() == before


@with_i2c
@pytest.mark.parametrize("timeout_us", [500, 3000])
@pytest.mark.parametrize("out, count", [(b"\x30\x01\x02", 0), (b"\x30", 3), (b"", 3)])
def test_a_device_that_holds_the_clock_too_long_is_a_timeout(bus, timeout_us, out, count):
    bus.fault(f"stretch={timeout_us}")
    assert bus.transfer(out, count, timeout_us=timeout_us) in (TIMEOUT, HELD)
    assert bus.took_us >= timeout_us
    bus.board.wait(timeout_us)
    bus.fault("none")
    bus.assert_good()


@with_i2c
@pytest.mark.parametrize("out, count", [(250, 0), (1, 250)])
def test_a_transfer_that_takes_longer_than_allowed_is_broken_off(bus, out, count):
    assert bus.transfer(b"\x30", count, out_length=out, timeout_us=1000) == TIMEOUT
    assert bus.took_us >= 1000
    assert bus.heard()[-1] == "P", "and the bus is free"


@with_i2c
@pytest.mark.parametrize("fault", ["stretch=forever", "scl-low=forever"])
def test_a_clock_that_is_held_for_good_is_told(bus, fault):
    before = bus.recoveries()
    bus.fault(fault)
    for _ in range(3):
        assert bus.transfer(b"\x30", 2, timeout_us=2000) == HELD
    assert bus.recoveries() == before, "nine clocks cannot be given"


@with_i2c
def test_a_clock_that_comes_back_in_time_is_waited_for(bus):
    bus.fault("scl-low=3000")
    assert bus.transfer(b"\x20", 2, timeout_us=30000) == DONE


# ---- Data that is held

@with_i2c
@pytest.mark.parametrize("clocks", range(1, 10))
def test_nine_clocks_free_the_data_line_and_are_counted(bus, clocks):
    before = bus.recoveries()
    bus.fault(f"sda-low={clocks}")
    assert bus.transfer(b"\x20", 2) == DONE
    assert bus.recoveries() == before + 1
    bus.assert_good()
    assert bus.recoveries() == before + 1


@with_i2c
def test_a_data_line_that_is_held_for_good_is_told(bus):
    before = bus.recoveries()
    bus.fault("sda-low=forever")
    for out, count in ((b"\x20", 0), (b"", 1), (b"\x20", 1), (b"", 0)):
        assert bus.transfer(out, count, timeout_us=5000) == HELD
    assert bus.recoveries() == before


# ---- The rest of the board meanwhile

@on(lambda expected: expected.i2c and expected.lines > 1)
def test_what_lines_receive_meanwhile_is_not_lost(bus):
    line = bus.board.lines[1]
    for _ in range(5):
        bus.board.tell("i2c", MEMORY, 0, 100000, 600, 0, 0, "0001")
        line.send(pattern(100))
        assert bus.board.numbers()[0] == DONE
        bus.board.wait(20000)  # 100 characters take 9 ms
        assert bus.board.ask("look", 1) == [100, 1, 0]
