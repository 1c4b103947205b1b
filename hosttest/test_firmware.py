"""The station's firmware on the emulated board under every fault of its two lines.

Bad input is counted, answered as the protocol says, and never ends in a reset; the last good envelope stays and ages.
"""

import json
import random
import select
import struct
import time

import pytest

from running import BUILD, Emulator
from rtu import Client, Registers, Scanner, crc

# runs alone: the board's time is the host's, and a busy host is slow; so nothing here has to be fast

COLUMNS, PROFILES = 24, 20
VALID, INTRUSION, STALE = 1, 2, 4
PATIENCE = 20


def framed(body):
    return body + crc(body)


def hills(seed=1, more=0):
    """Rows of heights for Scanner: [(y, heights)], three of them missing."""
    chance = random.Random(seed)
    rows = [[200 + 9 * x + 7 * y + chance.randrange(60) + more for x in range(COLUMNS)] for y in range(PROFILES)]
    rows[3][5] = rows[4][5] = rows[11][20] = None
    return [(30 * y, row) for y, row in enumerate(rows)]


READINGS = COLUMNS * PROFILES - 3


def swap_one_bit(reply):
    return reply[:-1] + bytes([reply[-1] ^ 1])


# What a bad scanner makes of its replies.
BAD = {
    "silent": lambda reply: None,
    "wrong crc": swap_one_bit,
    "cut short": lambda reply: reply[:len(reply) // 2],
    "busy": lambda reply: framed(bytes([reply[0], reply[1] | 0x80, 6])),
    "another unit": lambda reply: framed(bytes([2]) + reply[1:-2]),
    "one register": lambda reply: framed(reply[:2] + b"\x02" + reply[3:5]),
    "noise": lambda reply: bytes((73 * i + 11) & 0xFF for i in range(200)),
    "flood": lambda reply: bytes(range(256)) * 40,
}


class Device:
    def __init__(self, scratch, image="canopy.elf", rows=None, **options):
        self.emulator = Emulator(image, scratch)
        self.line, self.said = self.emulator.lines[1], b""
        self.client = Client(self.line, timeout=PATIENCE)
        self.registers = Registers(self.client, json.loads((BUILD / "registers.json").read_text()))
        self.scanner = None
        if rows:
            self.scanner = Scanner(self.emulator.lines[0], rows, x_step=30, **options)
            self.scanner.start()

    def get(self, name):
        return self.registers[name]

    def wait_for(self, what, seconds=60):
        end = time.monotonic() + seconds
        while not what():
            assert time.monotonic() < end, "did not come about"
            time.sleep(0.05)

    def wait_for_points(self, points):
        self.wait_for(lambda: self.get("points") == points)

    def show(self, rows):
        """More profiles behind those that there were; the description stays."""
        self.scanner.profiles = self.scanner.profiles + rows
        self.scanner.limit = len(self.scanner.profiles)

    def exchange(self, frame, patience):
        """What comes back for any bytes: until a pause, or nothing within the patience."""
        self.line.sendall(frame)
        got = b""
        while select.select([self.line], [], [], 0.15 if got else patience)[0]:
            got += self.line.recv(512)
        return got

    def ask(self, body):
        """The PDU that answers a PDU."""
        got = self.exchange(framed(b"\x01" + body), PATIENCE)
        assert got[:1] == b"\x01" and got[-2:] == crc(got[:-2]), got.hex()
        return got[1:-2]

    def assert_alive(self):
        """It answers, and it has not been reset since it was started."""
        assert self.get("probe_u32") == 0x12345678
        console = self.emulator.lines[2]
        while select.select([console], [], [], 0)[0]:
            self.said += console.recv(4096)
        assert self.said.count(b" starts") == 1 and b"crash" not in self.said, self.said

    def close(self):
        if self.scanner:
            self.scanner.running = False
            self.scanner.join()
        self.emulator.close()


@pytest.fixture
def lonely(tmp_path):
    """Without a scanner on its line."""
    device = Device(tmp_path)
    yield device
    device.assert_alive()
    device.close()


@pytest.fixture
def swept(tmp_path):
    """With a whole sweep behind it."""
    device = Device(tmp_path, rows=hills())
    device.wait_for_points(READINGS)
    yield device
    device.assert_alive()
    device.close()


# ---- The PLC's line

def test_identity(lonely):
    assert lonely.get("magic") == 0x434E5059
    assert lonely.get("probe_u32") == 0x12345678
    assert lonely.get("probe_f32") == 1.0
    assert lonely.get("sequence") == 0
    assert lonely.get("status") == STALE


def test_silence_is_the_answer_to_a_wrong_crc(lonely):
    before = lonely.get("rx_errors")
    frame = framed(b"\x01\x03\x00\x00\x00\x02")
    for bit in range(0, 8 * len(frame), 5):
        broken = bytearray(frame)
        broken[bit // 8] ^= 1 << bit % 8
        assert lonely.exchange(bytes(broken), patience=0.3) == b""
        lonely.assert_alive()
    assert lonely.get("rx_errors") > before


def test_short_frames_are_ignored(lonely):
    before = lonely.get("rx_errors")
    frame = framed(b"\x01\x03\x00\x00\x00\x02")
    for length in range(1, len(frame)):
        assert lonely.exchange(frame[:length], patience=0.3) == b""
        lonely.assert_alive()
    assert lonely.get("rx_errors") > before


# Function, address, value and length: Modbus Application Protocol 1.1b3, section 7, and docs/registers.md.
@pytest.mark.parametrize("body, code", [
    (b"\x01\x00\x00\x00\x01", 1), (b"\x05\x00\x00\xff\x00", 1), (b"\x41", 1), (b"\x2b\x0d\x01\x00", 1),
    (b"\x03\xff\xf0\x00\x01", 2), (b"\x03\x00\x60\x00\x01", 2), (b"\x06\x00\x00\x00\x01", 2),
    (b"\x06\x00\xb4\x00\x01", 2), (b"\x10\x00\xb5\x00\x01\x02\x00\x01", 2),
    (b"\x10\x00\xb4\x00\x01\x02\x00\x01", 2), (b"\x03\x00\x00\x00\x00", 3), (b"\x03\x00\x00\x00\x7e", 3),
    (b"\x10\x00\xb4\x00\x02\x03\x00\x00\x00", 3), (b"\x06\x00\xc8\x00\x63", 3), (b"\x03\x00\x00\x00", 3),
    (b"\x03\x00\x00\x00\x01\x00", 3),
])
def test_illegal_requests_get_their_exception(lonely, body, code):
    assert lonely.ask(body) == bytes([body[0] | 0x80, code])
    lonely.assert_alive()


@pytest.mark.parametrize("frame", [framed(b"\x00\x03\x00\x00\x00\x02"), framed(b"\x02\x03\x00\x00\x00\x02"),
                                   framed(b"\x00\x06\x00\xc8\x00\x00")])
def test_what_is_not_for_us_is_not_answered(lonely, frame):
    assert lonely.exchange(frame, patience=0.5) == b""
    lonely.assert_alive()


def test_noise_of_any_length(lonely):
    """After a silence the next request is answered, whatever came before."""
    chance = random.Random(5)
    for length in (1, 7, 64, 255, 256, 257, 700):
        lonely.exchange(chance.randbytes(length), patience=0.4)
        time.sleep(0.2)
        lonely.assert_alive()
    assert lonely.get("rx_errors") > 0


def test_query_and_commands_of_one_port(swept):
    written = swept.client.write(swept.registers.table["query_x"]["address"], [0, 300, 0, 200])
    assert written[0] == 16
    assert swept.get("query_status") == 0
    assert swept.get("query_sequence") == swept.get("sequence")
    # All heights there lie between 200 and 200 + 9 * 24 + 7 * 20 + 60.
    assert 200 < swept.get("query_height") * swept.get("lsb") + swept.get("origin_z") < 1200
    before = swept.get("sequence")
    assert swept.ask(struct.pack(">BHH", 6, swept.registers.table["command"]["address"], 0x0101))[0] == 6
    swept.wait_for(lambda: swept.get("sequence") > before)
    assert (swept.get("command_echo"), swept.get("command_result")) == (0x0101, 1)


# ---- The scanner's line

def test_what_a_sweep_leaves_in_the_counters(swept):
    assert swept.get("readings_invalid") == 3
    assert swept.get("profiles") == PROFILES
    assert swept.get("points_accepted") == READINGS
    envelope = swept.registers.envelope()
    cells = {(min((x - envelope["origin_x"]) // envelope["pitch_u"], 18),
              min((y - envelope["origin_y"]) // envelope["pitch_v"], 18)) for x, y, _ in swept.scanner.points()}
    assert swept.get("coverage_pct") == 100 * len(cells) // 19 ** 2


@pytest.mark.parametrize("how", BAD)
def test_a_bad_scanner_leaves_the_last_envelope(swept, how):
    last, errors, age = swept.registers.envelope(), swept.get("scan_errors"), swept.get("age_ms")
    swept.scanner.mischief = BAD[how]
    swept.wait_for(lambda: swept.get("scan_errors") > errors and swept.get("sensor_faults") == 1)
    swept.wait_for(lambda: swept.get("age_ms") > age + 1500)
    assert swept.registers.envelope() == last
    swept.wait_for(lambda: swept.get("status") == STALE)
    assert swept.get("age_ms") > swept.get("stale_after_ms")
    assert swept.registers.envelope() == last
    # Then it is as if nothing had been.
    swept.scanner.mischief = lambda reply: reply
    swept.show(hills())
    swept.wait_for(lambda: swept.get("sensor_faults") == 0)
    swept.wait_for_points(2 * READINGS)
    assert swept.get("sequence") > last["sequence"]


def test_the_plc_is_answered_while_the_scanner_floods(swept):
    swept.scanner.mischief = BAD["flood"]
    last = swept.registers.envelope()
    for _ in range(100):
        assert swept.get("probe_u32") == 0x12345678
    assert swept.registers.envelope() == last


def test_readings_beside_the_frame_are_rejected(swept):
    last, accepted = swept.registers.envelope(), swept.get("points_accepted")
    swept.show([(y + 100000, row) for y, row in hills()])
    swept.wait_for(lambda: swept.get("points_rejected") == READINGS)
    assert swept.get("points_accepted") == accepted
    assert swept.registers.envelope() == last


def test_readings_beyond_any_envelope_keep_the_status_down(swept):
    last = swept.registers.envelope()
    swept.show([(30 * y, [60000] * COLUMNS) for y in range(PROFILES)])
    swept.wait_for(lambda: swept.get("status") & INTRUSION)
    swept.wait_for(lambda: swept.get("points_rejected") == COLUMNS * PROFILES)
    assert swept.get("status") & (VALID | INTRUSION) == INTRUSION
    assert swept.registers.envelope() == last


def test_a_description_that_makes_no_sense_is_refused(tmp_path):
    device = Device(tmp_path)
    scanner = device.scanner = Scanner(device.emulator.lines[0], hills(), x_step=30)
    scanner.description = scanner.description[:28] + struct.pack(">iii", 1000000, 0, 0) + scanner.description[40:]
    scanner.start()
    device.wait_for(lambda: device.get("profiles_refused") > 1)
    assert (device.get("sensor_faults"), device.get("sequence"), device.get("points_accepted")) == (1, 0, 0)
    device.assert_alive()
    device.close()


def test_another_scene_in_another_unit_begins_anew(swept):
    """The scanner gives way to one with another description, on the same line."""
    other = Scanner(swept.emulator.lines[0], hills(3, more=500), x_step=30)
    other.description = other.description[:-4] + struct.pack(">f", 0.5)
    other.description = other.description[:6] + struct.pack(">H", 8) + other.description[8:]
    profile = other.profile
    other.profile = lambda: profile()[:2] + struct.pack(">H", 8) + profile()[4:]
    swept.scanner.running = False
    swept.scanner.join()
    swept.scanner = other
    other.start()
    swept.wait_for(lambda: swept.get("unit") == 0.5)
    swept.wait_for_points(READINGS)
    assert swept.get("status") & (VALID | INTRUSION) == VALID
