"""The station's image on the emulated RP2040: its boot, its wires, the scanner on I2C and what can go wrong with it,
each seen in registers. The emulator is npm's rp2040js and tools/rp2040; faults are set there, not in the firmware."""

import json
import re
import struct
import subprocess
import time

import pytest

import emulator
import stations
from rtu import Client, frame
from running import BUILD, Emulator
from stations import INTRUSION, STALE, VALID, gaps, hills

# runs alone: the board's time is the host's

BOARD = "rp2040_pico"
IMAGES = BUILD / BOARD
READ_IDENTITY = frame(1, bytes([3, 0, 0, 0, 2])).hex()
BOOT_BUDGET = 250_000  # instructions from the reset to the first byte of an answer
NAK, CHECKSUM, BUS = 6, 2, 7  # scanner_failure
WATCHDOG, HARD = 2, 3  # crash_kind
STORE = 4  # command
BIT_US = 1e6 / 115200


def run(image, *options):
    """A run without anybody on its lines: (status, output, what it complains of)."""
    here = IMAGES / "canopy.elf"  # the emulator's modules are beside the board's directory
    command = emulator.argv(BOARD, here, ("null", "null", "null"))
    command[command.index(str(here))] = str(image)
    done = subprocess.run([*command, *options], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=100)
    return done.returncode, done.stdout, done.stderr


# ---- Boot

def first_answer(image):
    """Instructions and microseconds from power-on to the answer of the first request that can be heard."""
    status, output, errors = run(image, "--ask", f"0:{READ_IDENTITY}", "--limit", "5")
    assert status == 0, errors
    return [int(number) for number in re.findall(r"\d+", output)]


@pytest.mark.parametrize("image", ["canopy", "canopy-10x10"])
def test_boot_to_the_first_answer_is_short_and_repeatable(image):
    instructions, micros = first_answer(IMAGES / f"{image}.elf")
    print(f"{image}: {instructions} instructions, {micros} us")
    assert instructions <= BOOT_BUDGET
    assert micros < 1_000_000
    assert first_answer(IMAGES / f"{image}.uf2") == [instructions, micros], "what is dragged onto the board is the same"


def changed_uf2(scratch, change):
    image = bytearray((IMAGES / "canopy.uf2").read_bytes())
    change(image)
    path = scratch / "changed.uf2"
    path.write_bytes(image)
    return path


@pytest.mark.parametrize("byte, bit", [(0, 0), (100, 7), (251, 3), (252, 0), (255, 7)])
def test_a_second_stage_with_a_turned_bit_does_not_start(tmp_path, byte, bit):
    def turn(image):
        image[32 + byte] ^= 1 << bit
    status, output, errors = run(changed_uf2(tmp_path, turn), "--ask", f"0:{READ_IDENTITY}", "--limit", "2")
    assert status == 3 and output == ""
    assert "no second stage" in errors and len(errors.splitlines()) == 1


def test_a_uf2_for_another_chip_is_not_taken(tmp_path):
    def rename(image):
        struct.pack_into("<I", image, 28, 0xE48BFF59)  # RP2350
    status, _, errors = run(changed_uf2(tmp_path, rename))
    assert status == 2 and "not for the RP2040" in errors


# ---- The station between a scanner and a PLC

class Station(stations.Device):
    """canopy-scanner behind the I2C bus, a PLC on line 0."""

    def __init__(self, scratch, *extra, profiles=30, columns=40, image="canopy.elf"):
        self.served_file, scene = scratch / "served.xyz", scratch / "scene.xyz"
        points = [(x, y, z) for y, (_, heights) in enumerate(hills(profiles, columns)) for x, z in enumerate(heights)]
        scene.write_text("".join(f"{x} {y} {z / 100}\n" for x, y, z in points))
        self.count = len(points)
        self.scanner = subprocess.Popen([BUILD / "host" / "canopy-scanner", "--tcp", "127.0.0.1:0", "--unit", "0.01",
                                         "--served", self.served_file, scene],
                                        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            where = self.scanner.stdout.readline().split()[1]
            begun = Emulator(image, scratch, BOARD, extra=["--scanner", where, *extra])
        except BaseException:
            self.scanner.kill()
            raise
        super().__init__(begun, Client(begun.lines[0]))

    def wait(self, name, condition, seconds=12):
        """What is asked while the flash is written is not answered."""
        return super().wait(name, condition, seconds, patient=True)

    def wait_for_start(self, seconds=20):
        return self.wait("heartbeat", lambda _: True, seconds)

    def counters(self):
        return json.loads(self.emulator.order("counters"))

    def served(self):
        """What the simulator says it has shown, in device units."""
        lines = self.served_file.read_text().splitlines()
        return [tuple(round(float(word) * 100) for word in line.split()) for line in lines]

    def check_whole_sweep(self):
        """Every reading there is is in the envelope, and under it."""
        self.wait("points", lambda count: count == self.count, seconds=25)
        assert self.registers["status"] & (VALID | INTRUSION) == VALID
        envelope = self.registers.envelope()
        points = self.served()
        assert len(points) == self.count == envelope["points"]
        assert min(gaps(envelope, points)) >= 0

    def close(self):
        super().close()
        self.scanner.terminate()
        self.scanner.wait()
        self.scanner.stdout.close()


@pytest.fixture
def start(tmp_path):
    """Starts stations, one at a time."""
    started = []

    def make(*extra, **options):
        if started:
            started.pop().close()
        started.append(Station(tmp_path, *extra, **options))
        return started[0]
    yield make
    for station in started:
        station.close()


@pytest.mark.parametrize("image", ["canopy.elf", "canopy-10x10.elf"])
def test_a_sweep_over_i2c_becomes_a_safe_envelope(start, image):
    station = start(image=image)
    station.check_whole_sweep()
    for counter in ("scanner_failure", "lost_bytes", "profiles_missed", "profiles_torn", "i2c_recoveries",
                    "points_rejected"):
        assert station.registers[counter] == 0, counter
    assert station.counters()["resets"] == []


def test_a_scanner_that_holds_the_clock_for_a_while_is_waited_for(start):
    station = start("--fault", "stretch=100")
    station.check_whole_sweep()
    assert station.registers["scanner_failure"] == 0


def test_a_scanner_that_is_not_to_be_reached_is_told_and_taken_when_it_is(start):
    station = start("--fault", "absent")
    seen = 0
    for fault, failure in (("absent", NAK), ("sda-low=forever", BUS), ("nak-byte=2", NAK), ("scl-low=forever", BUS),
                           ("absent", NAK), ("stretch=forever", BUS)):
        station.emulator.order("fault none")
        station.emulator.order(f"fault {fault}")
        station.wait("scanner_failure", lambda why, failure=failure: why == failure)
        seen = station.wait("scan_errors", lambda count, before=seen: count > before)
        assert station.registers["status"] & VALID == 0 and station.registers["sequence"] == 0
    station.wait("sensor_faults", lambda count: count > 0)
    station.emulator.order("fault none")
    station.check_whole_sweep()


def test_another_kind_of_scanner_is_refused(start):
    station = start("--fault", "magic")
    station.wait("profiles_refused", lambda count: count > 1)
    assert station.registers["profiles"] == 0 and station.registers["sequence"] == 0
    assert station.registers["sensor_faults"] > 0
    station.emulator.order("fault none")
    station.check_whole_sweep()


@pytest.mark.parametrize("clocks", [1, 9])
def test_a_device_that_holds_data_low_is_clocked_free_and_that_is_counted(start, clocks):
    station = start("--fault", f"sda-low={clocks}")
    station.check_whole_sweep()
    assert station.registers["i2c_recoveries"] == 1
    assert station.counters()["recoveryClocks"] >= clocks


def test_data_held_low_in_the_middle_of_a_sweep(start):
    station = start(profiles=30, columns=150)  # in two blocks: the simulator goes on only when both were read
    station.wait("profiles", lambda count: count > 3)
    for count in range(1, 4):
        station.emulator.order(f"fault sda-low={count}")
        station.wait("i2c_recoveries", lambda seen, count=count: seen >= count)
    station.check_whole_sweep()


def test_bits_turned_on_the_bus_never_become_readings(start):
    """A bit in each 1009 bytes: the check sum finds them all, what is read again is right."""
    station = start("--fault", "flip=1009", profiles=16, columns=150)
    station.check_whole_sweep()
    assert station.registers["scan_errors"] > 0
    assert station.registers["scanner_failure"] == CHECKSUM


def test_a_scanner_that_goes_away_leaves_a_stale_envelope(start):
    station = start()
    station.check_whole_sweep()
    station.scanner.kill()
    station.wait("status", lambda status: status & STALE, seconds=15)
    assert station.registers["scanner_failure"] == NAK
    assert station.registers["status"] & VALID == 0
    assert station.registers.envelope()["points"] == station.count, "the last envelope stays readable"


# ---- Wires

def read_trace(path):
    """{name: [(microseconds, value), ...]}"""
    changes = {}
    for line in path.read_text().splitlines():
        at, name, value = line.split()
        changes.setdefault(name, []).append((float(at), value))
    return changes


def spans(changes):
    """(from, to) of each time that it was 1."""
    begin = None
    for at, value in changes:
        if value == "1":
            begin = at
        elif begin is not None:
            yield begin, at
            begin = None


def test_the_direction_pin_is_high_exactly_while_the_line_is_driven(start, tmp_path):
    """From before the first start bit to the last stop bit, and no longer than two bits after it."""
    station = start("--trace", str(tmp_path / "trace"))
    for count in (1, 2, 5, 60, 125, 125, 3, 1):
        station.client.read(0, count)
    station.check_whole_sweep()
    station.close()
    changes = read_trace(tmp_path / "trace")
    driven, sending = list(spans(changes["gpio2"])), list(spans(changes["uart0"]))
    assert len(sending) > 20
    longest = 0
    for begin, end in sending:
        around = [span for span in driven if span[0] <= begin and end <= span[1]]
        assert len(around) == 1, (begin, end)
        longest = max(longest, around[0][1] - end)
    print(f"direction pin: at most {longest:.1f} us after the stop bit, in {len(sending)} answers")
    assert longest <= 2 * BIT_US
    for begin, end in driven:
        assert any(begin <= first and last <= end for first, last in sending), "driven without anything to say"


def test_bytes_that_come_while_the_flash_is_written_are_lost_and_counted(start, tmp_path):
    """An erase masks interrupts for 45 ms: a request that comes then is not answered, and the loss is seen."""
    station = start("--flash", str(tmp_path / "flash"))
    station.wait_for_start()
    assert station.registers["lost_bytes"] == 0
    address = station.registers.table["command"]["address"]
    station.client.write(address, [STORE])
    station.emulator.lines[0].sendall(b"\xff" * 1500)
    time.sleep(0.5)
    assert station.wait("lost_bytes", lambda count: count > 0) <= 1500
    assert station.wait("settings_stored", lambda state: state > 1) == 2
    assert station.counters()["erases"] >= 1


# ---- Crashes

@pytest.mark.parametrize("orders, kind, pc", [
    (["jump 0xF0000000"], HARD, 0xF0000000),
    (["write 0x20041ff0 0xe7fe", "jump 0x20041ff0"], WATCHDOG, 0x20041FF0),  # a branch to itself
    (["write 0x20041ff0 0xde00", "jump 0x20041ff0"], HARD, 0x20041FF0),  # undefined
])
def test_a_crash_resets_and_is_told_over_modbus(start, orders, kind, pc):
    station = start()
    station.wait("profiles", lambda count: count > 3)
    for order in orders:
        assert station.emulator.order(order) == ""
    station.wait_for_start()
    assert station.counters()["resets"] == ["watchdog"]
    assert station.registers["crash_kind"] == kind
    assert station.registers["crash_pc"] == pc
    assert station.registers["crash_count"] == 1
    assert station.registers["starts"] == 2
    station.wait("profiles", lambda count: count > 0)


# ---- Stored settings

def settings_pages(flash):
    """Offsets of the pages of stored settings: the last four of the flash."""
    return [len(flash) - 4096 * (4 - page) for page in range(4)]


def test_settings_survive_power_and_one_damaged_copy(start, tmp_path):
    kept = tmp_path / "flash"
    station = start("--flash", str(kept))
    station.wait_for_start()
    assert station.registers["settings_state"] == 0
    table = station.registers.table
    for stale_ms in (1234, 2345):
        station.client.write(table["set_stale_after_ms"]["address"], [0, stale_ms])
        station.client.write(table["command"]["address"], [STORE])
        station.wait("settings_stored", lambda state: state == 2)
        station.wait("settings_generation", lambda number, least=stale_ms // 1000: number >= least)
    station = start("--flash", str(kept), "--keep")
    station.wait_for_start()
    assert station.registers["settings_state"] == 1
    assert station.registers["set_stale_after_ms"] == 2345
    station.close()
    flash = bytearray(kept.read_bytes())
    used = [page for page in settings_pages(flash) if any(byte != 0xFF for byte in flash[page:page + 4096])]
    assert len(used) == 2
    for damaged, state, stale_ms in ((used[:1], 2, 2345), (used[1:], 2, 2345), (used, 3, 5000)):
        broken = bytearray(flash)
        for page in damaged:
            broken[page + 10] ^= 0x10
        kept.write_bytes(broken)
        station = start("--flash", str(kept), "--keep")
        station.wait_for_start()
        assert station.registers["settings_state"] == state
        assert station.registers["set_stale_after_ms"] == stale_ms
        station.close()  # it writes its flash back


def test_power_that_fails_while_storing_leaves_the_old_settings_or_the_new(start, tmp_path):
    """hosttest/test_store_cuts.c cuts at every write; here the chip's own sequence is cut in each of its parts."""
    kept = tmp_path / "flash"

    def store(station, stale_ms):
        table = station.registers.table
        station.client.write(table["set_stale_after_ms"]["address"], [0, stale_ms])
        station.client.write(table["command"]["address"], [STORE])

    station = start("--flash", str(kept))
    station.wait_for_start()
    store(station, 1234)
    station.wait("settings_stored", lambda state: state == 2)
    station.close()
    before, seen = kept.read_bytes(), set()
    for cut in (100, 2000, 4400, 4800, 7000):
        kept.write_bytes(before)
        station = start("--flash", str(kept), "--keep", "--power-cut-after", str(cut))
        station.wait_for_start()
        store(station, 2345)
        assert station.emulator.process.wait(20) == 4
        station = start("--flash", str(kept), "--keep")
        station.wait_for_start()
        assert station.registers["settings_state"] in (1, 2)
        seen.add(station.registers["set_stale_after_ms"])
        station.close()
    assert seen == {1234, 2345}
