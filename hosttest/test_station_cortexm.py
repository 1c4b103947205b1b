"""The station's firmware on the emulated board, between a scanner and a PLC that the test plays."""

import math
import time

import pytest

import stations
from rtu import Client, NoAnswer, Patient, Scanner, crc
from running import IMAGES, Emulator
from stations import INTRUSION, STALE, VALID, gaps, hills

# runs alone: the board's time is the host's


class Device(stations.Device):
    def __init__(self, image, scratch, board="mps2_an385"):
        begun = Emulator(image, scratch, board)
        # one that never rests keeps the emulator so busy that it loses time in the middle of frames
        super().__init__(begun, (Client if board == "mps2_an385" else Patient)(begun.lines[1]))
        self.scanner = None

    def scan(self, profiles, **options):
        self.scanner = Scanner(self.emulator.lines[0], profiles, **options)
        self.scanner.start()
        return self.scanner

    def close(self):
        if self.scanner:
            self.scanner.running = False
            self.scanner.join()
        super().close()


@pytest.fixture(params=[("mps2_an385", "canopy"), ("mps2_an385", "canopy-10x10"), ("mps2_an386", "canopy-10x10"),
                        ("mps2_an500", "canopy"), ("mps2_an500", "canopy-10x10")], ids="-".join)
def device(request, tmp_path):
    board, image = request.param
    made = Device(f"{image}.elf", tmp_path, board)
    made.scalar = "fx" if board == "mps2_an385" else "f32"
    yield made
    made.close()


@pytest.fixture(params=["mps2_an386", "mps2_an500"])
def tightening(request, tmp_path):
    """A device that spends its spare time on that."""
    made = Device("canopy-10x10.elf", tmp_path, request.param)
    yield made
    made.close()


@pytest.fixture
def big(tmp_path):
    made = Device("canopy.elf", tmp_path)
    yield made
    made.close()


def test_a_sweep_becomes_a_safe_envelope(device):
    scanner = device.scan(hills(60, 90, missing=lambda i, j: (i + j) % 11 == 0 or 20 < i < 26 and j > 70))
    points = scanner.points()
    device.wait("points", lambda count: count == len(points))
    assert device.registers["status"] & (VALID | INTRUSION) == VALID
    envelope = device.registers.envelope()
    assert envelope["points"] == len(points)
    assert envelope["margin"] >= 0
    assert envelope["scalar"] == {"f32": 0, "fx": 1}[device.scalar]
    found = gaps(envelope, points)
    assert min(found) >= 0
    loosest = {20: 0.25, 10: 0.6}[envelope["grid_m"]]  # ten intervals cannot follow these hills
    assert sum(found) / len(found) < loosest * (max(z for *_, z in points) - min(z for *_, z in points))
    assert device.registers["points_rejected"] == 0
    for counter in ("profiles_missed", "profiles_torn", "profiles_short", "profiles_refused", "lost_bytes"):
        assert device.registers[counter] == 0


def mean_gap(envelope, points):
    found = gaps(envelope, points)
    assert min(found) >= 0
    return float(sum(found) / len(found))


def test_spare_time_makes_it_tighter_and_a_tower_is_seen_at_once(tightening):
    """All along the PLC is answered, and what it reads is safe."""
    low = [(y, [z - 1000 for z in row]) for y, row in hills(30, 40)]
    scanner = Scanner(tightening.emulator.lines[0], low + [(low[12][0], [6000] * 40)])
    scanner.limit = len(low)
    tightening.scanner = scanner
    scanner.start()
    points = scanner.points(len(low))
    tightening.wait("points", lambda count: count == len(points))
    first, best = mean_gap(tightening.registers.envelope(), points), math.inf
    end = time.monotonic() + 30
    while best > 0.85 * first:
        assert time.monotonic() < end, f"mean gap {best} of {first}"
        best = min(best, mean_gap(tightening.registers.envelope(), points))
    assert tightening.client.again < tightening.client.asked / 4
    scanner.limit += 1
    tightening.wait("intrusions", lambda intrusions: intrusions == 40)
    tightening.wait("points", lambda count: count == len(scanner.points()))
    assert tightening.registers["status"] & (VALID | INTRUSION) == VALID
    mean_gap(tightening.registers.envelope(), scanner.points())


def test_the_plc_is_answered_while_the_scanner_is_silent(big):
    big.scan(hills(20, 30))
    big.wait("points", lambda count: count == 600)
    big.scanner.running = False
    big.scanner.join()
    before = big.registers.envelope()
    big.wait("status", lambda status: status & STALE, seconds=15)
    assert big.registers["status"] & VALID == 0
    assert big.registers["age_ms"] > 5000
    assert big.registers["sensor_faults"] == 1
    after = big.registers.envelope()
    assert after["coefficients"] == before["coefficients"], "the last envelope stays readable"
    first = big.registers["heartbeat"]
    assert big.registers["heartbeat"] != first


def test_wrong_checksums_silence_and_short_frames_are_counted_and_overcome(big):
    count = 0

    def mischief(reply):
        nonlocal count
        count += 1
        if count % 7 == 3:
            return reply[:-1] + bytes([reply[-1] ^ 1])
        if count % 11 == 5:
            return None
        if count % 13 == 6:
            return reply[:-3]
        return reply

    scanner = big.scan(hills(12, 60), mischief=mischief)
    big.wait("profiles", lambda profiles: profiles >= 5, seconds=60)
    big.wait("sequence", lambda sequence: sequence > 0)
    assert big.registers["scan_errors"] > 0
    scanner.mischief = lambda reply: reply
    big.wait("publications", lambda publications: publications >= 2)
    envelope = big.registers.envelope()
    assert envelope["points"] % 60 == 0, "a broken profile never enters in part"
    assert big.registers["uptime_s"] >= 1, "never a reset"


def test_noise_on_the_plc_line_is_counted_and_the_next_request_answered(big):
    big.scan(hills(10, 20))
    big.wait("points", lambda count: count == 200)
    errors = big.registers["rx_errors"]
    for noise in (b"\x00", bytes(range(200)), b"\x01\x03\x00\x00\x00", b"\xff" * 600, b"\x01\x03\x00\x00\x00\x02\x00\x00"):
        big.emulator.lines[1].sendall(noise)
        time.sleep(0.15)
    assert big.registers["magic"] == 0x434E5059
    assert big.registers["rx_errors"] > errors
    # an absent neighbour was polled and is silent
    request = b"\x09\x03\x00\x00\x00\x02"
    big.emulator.lines[1].sendall(request + crc(request))
    time.sleep(0.15)
    assert big.registers["magic"] == 0x434E5059


def test_illegal_requests_get_their_exceptions(big):
    for pdu, answer in ((b"\x2a\x00", b"\xaa\x01"), (b"\x03\xff\xf0\x00\x05", b"\x83\x02"),
                        (b"\x03\x00\x00\x00\x7e", b"\x83\x03"), (b"\x06\x00\xb4\x00\x01", b"\x86\x02")):
        assert big.client.exchange(pdu, len(answer)) == answer
    with pytest.raises(NoAnswer):
        Client(big.emulator.lines[1], unit=9, timeout=0.3).read(0, 1)


def test_a_later_higher_reading_is_an_intrusion_until_it_is_covered(big):
    """The scene's box has room for a tower that the first sweep does not show; readings beyond the envelope must be
    flagged before the next publication covers them."""
    low = [(y, [z - 1000 for z in row]) for y, row in hills(30, 40)]
    tower = [(low[12][0], [6000] * 40)]
    scanner = Scanner(big.emulator.lines[0], low + tower)
    scanner.limit = len(low)
    big.scanner = scanner
    scanner.start()
    big.wait("points", lambda count: count == len(scanner.points(len(low))))
    assert big.registers["intrusions"] == 0
    assert min(gaps(big.registers.envelope(), scanner.points(len(low)))) >= 0
    scanner.limit += 1
    big.wait("intrusions", lambda intrusions: intrusions == 40)
    big.wait("points", lambda count: count == len(scanner.points()))
    assert big.registers["status"] & (VALID | INTRUSION) == VALID
    assert min(gaps(big.registers.envelope(), scanner.points())) >= 0


def test_it_sleeps_when_there_is_nothing_to_do(big):
    """Waiting for an interrupt, not spinning: the emulator then takes next to no processor time."""
    big.scan(hills(10, 20))
    big.wait("points", lambda count: count == 200)
    big.scanner.running = False
    big.scanner.join()
    time.sleep(1)
    assert stations.processor_seconds(big, 2) < 0.5


def test_a_restart_command_forgets_the_scene(big):
    big.scan(hills(10, 20))
    big.wait("points", lambda count: count == 200)
    assert big.client.write(big.registers.table["command"]["address"], [2])[0] == 16
    assert big.registers["status"] & VALID == 0
    assert (big.registers["sequence"], big.registers["points"], big.registers["coverage_pct"]) == (0, 0, 0)


def test_the_stack_stays_within_what_the_call_graph_says(big):
    scanner = big.scan(hills(40, 60, missing=lambda i, j: i % 9 == 4))
    big.wait("points", lambda count: count == len(scanner.points()))
    big.registers.envelope()
    big.client.write(big.registers.table["query_x"]["address"], [0, 500, 0, 500])
    assert big.registers["query_sequence"] > 0
    stations.check_stack(big, IMAGES / "canopy.elf")
