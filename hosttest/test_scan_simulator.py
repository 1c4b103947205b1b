"""canopy-scanner against masters that are not ours: pymodbus and libmodbus (mbpoll), over pty and TCP, every switch.

# runs alone: it measures wire time
"""

import contextlib
import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import time
from pathlib import Path

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

import rtu

BUILD = Path(os.environ.get("CANOPY_BUILD", Path(__file__).resolve().parent.parent / "build"))
PROGRAM = BUILD / "host" / "canopy-scanner"
HEADER, HEIGHTS, NONE = 64, 69, 0xFFFF
COLUMNS, PROFILES = 40, 12


def height(column, profile):
    return (profile * 977 + column * 61) % 6000


def hole(column, profile):
    return (column * 5 + profile * 3) % 17 == 0


CELLS = [(c, p) for p in range(PROFILES) for c in range(COLUMNS) if not hole(c, p)]


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.xyz"
    path.write_text("".join(f"{c * 7} {p * 3} {height(c, p)}\n" for c, p in CELLS))
    return path


class Scanner:
    """The program under way: what it offers and, after stop, what it said."""

    def __init__(self, scene, *options, unit="1"):
        self.process = subprocess.Popen([PROGRAM, scene, "--unit", unit, "--json", *map(str, options)],
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.rtu = self.tcp = None
        for line in self.process.stdout:
            word, *rest = line.split()
            if word == "rtu":
                self.rtu = rest[0]
            elif word == "tcp":
                host, port = rest[0].rsplit(":", 1)
                self.tcp = (host, int(port))
            elif word == "ready":
                return
        raise AssertionError(self.process.stderr.read())

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        _, errors = self.process.communicate(timeout=10)
        assert self.process.returncode == 0, errors
        self.events = [json.loads(line) for line in errors.splitlines()]
        return self.events[-1]


@contextlib.contextmanager
def scanning(scene, *options, **more):
    scanner = Scanner(scene, *options, **more)
    try:
        yield scanner
    finally:
        if scanner.process.poll() is None:
            scanner.stop()


def words(registers, at, signed=True):
    return struct.unpack(">i" if signed else ">I", struct.pack(">2H", *registers[at:at + 2]))[0]


class Raw:
    """A TCP master of the test's own, that sees every byte."""

    def __init__(self, address):
        self.socket = socket.create_connection(address, timeout=0.25)
        self.transaction = 0

    def ask(self, address, count, function=3, unit=1):
        self.transaction += 1
        pdu = struct.pack(">BHH", function, address, count)
        self.socket.sendall(struct.pack(">HHHB", self.transaction, 0, len(pdu) + 1, unit) + pdu)
        try:
            return self.socket.recv(512)
        except TimeoutError:
            return b""

    def read(self, address, count):
        """The registers, or None for anything that is no valid answer."""
        answer = self.ask(address, count)
        head = struct.pack(">HHHBB", self.transaction, 0, 3 + 2 * count, 1, 3)
        if len(answer) != 9 + 2 * count or answer[:8] != head:
            return None
        return list(struct.unpack(f">{count}H", answer[9:]))

    def profile(self):
        """(header, heights, trailer) with one read each."""
        header = self.read(HEADER, 5)
        rest = self.read(HEIGHTS, COLUMNS + 1)
        return (header, rest[:-1], rest[-1]) if header and rest else None


def sweep(read, columns=COLUMNS, profiles=PROFILES):
    """Every profile that comes on demand, as {y: heights}; the master reads in two blocks."""
    found, last = {}, 0
    for _ in range(profiles):
        header = read(HEADER, 5)
        first = read(HEIGHTS, 25)
        rest = read(HEIGHTS + 25, columns + 1 - 25)
        assert header[0] == last + 1 == rest[-1]
        last = header[0]
        heights = first + rest[:-1]
        assert header[4] == sum(h != NONE for h in heights)
        found[words(header, 2)] = heights
    return found


def check_whole(found, offset):
    for p in range(PROFILES):
        for c in range(COLUMNS):
            assert found[3 * p][c] == (NONE if hole(c, p) else height(c, p) - offset)


def test_description(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--uncertainty", 9) as scanner:
        d = Raw(scanner.tcp).read(0, 28)
    zs = [height(c, p) for c, p in CELLS]
    assert d[0:2] == [0x434E, 0x5053] and d[2] == 1 and d[4:6] == [COLUMNS, PROFILES]
    assert [words(d, k) for k in (6, 8, 10)] == [0, 7, min(zs)] and d[12:14] == [1, 9]
    assert [words(d, k) for k in range(14, 26, 2)] == [0, 0, min(zs), 7 * (COLUMNS - 1), 3 * (PROFILES - 1), max(zs)]
    assert struct.unpack(">f", struct.pack(">2H", *d[26:28]))[0] == 1.0


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_pymodbus_reads_a_whole_sweep(scene, tmp_path, wire):
    link, served = tmp_path / "line", tmp_path / "served.xyz"
    with scanning(scene, "--tcp", "127.0.0.1:0", "--rtu", link, "--served", served) as scanner:
        assert os.path.realpath(link) == scanner.rtu
        client = ModbusTcpClient(*scanner.tcp) if wire == "tcp" else \
            ModbusSerialClient(port=str(link), baudrate=115200, timeout=1)
        assert client.connect()

        def read(address, count):
            answer = client.read_input_registers(address, count, slave=1)
            assert not answer.isError(), answer
            return answer.registers

        offset = words(read(0, 28), 10)
        check_whole(sweep(read), offset)
        assert client.read_holding_registers(HEIGHTS + COLUMNS, 2, slave=1).exception_code == 2  # beyond the map
        assert client.write_register(HEADER, 1, slave=1).exception_code == 2
        client.close()
        end = scanner.stop()
    assert not link.exists() and not link.is_symlink()
    assert end["served"] == len(CELLS) and end["doubtful"] == end["missed"] == 0
    assert [event["event"] for event in scanner.events].count("profile") == PROFILES
    assert scanner.events[-2]["event"] == "over"
    lines = [tuple(map(float, line.split())) for line in served.read_text().splitlines()]
    assert sorted(lines) == sorted((7.0 * c, 3.0 * p, float(height(c, p))) for c, p in CELLS)


@pytest.mark.parametrize("wire", ["tcp", "rtu"])
def test_libmodbus_reads_it(scene, tmp_path, wire):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--rtu", "pty,19200,8N1,7") as scanner:
        where = ["-m", "tcp", "-p", scanner.tcp[1], "-a", "1", scanner.tcp[0]] if wire == "tcp" else \
            ["-m", "rtu", "-b", "19200", "-P", "none", "-a", "7", scanner.rtu]
        command = ["mbpoll", "-0", "-1", "-t", "4", "-r", HEADER, "-c", 46, "-o", 2, *where]
        said = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=20)
    assert said.returncode == 0, said.stdout + said.stderr
    found = {int(k): int(v) & 0xFFFF for k, v in re.findall(r"^\[(\d+)\]:\s+(-?\d+)", said.stdout, re.M)}
    assert found[HEADER] == found[HEIGHTS + COLUMNS] == 1
    zs = [height(c, p) for c, p in CELLS]
    assert [found[HEIGHTS + c] for c in range(COLUMNS)] == [NONE if hole(c, 0) else height(c, 0) - min(zs)
                                                            for c in range(COLUMNS)]


def test_other_units_are_not_answered(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0,9") as scanner:
        raw = Raw(scanner.tcp)
        assert raw.ask(0, 1, unit=8) == b""
        for unit in (9, 0, 255):
            assert len(raw.ask(0, 1, unit=unit)) == 11


def test_the_unit_of_the_scene(tmp_path):
    """The log gives the device's own integers back: rint(p / unit), whatever the unit and however odd the points."""
    path, served = tmp_path / "odd.csv", tmp_path / "served.xyz"
    points = [(0.1 * i * 1.7, -3.3 + 0.013 * (i % 7), 1e3 + math.sin(i) * 0.37) for i in range(300)]
    path.write_text("".join(f"{x},{y},{z}\n" for x, y, z in points))
    with scanning(path, "--tcp", "127.0.0.1:0", "--served", served, unit="0.003") as scanner:
        raw = Raw(scanner.tcp)
        d = raw.read(0, 28)
        unit = struct.unpack(">f", struct.pack(">2H", *d[26:28]))[0]
        assert unit == struct.unpack(">f", struct.pack(">f", 0.003))[0]
        offered = set()
        for _ in range(d[5]):
            header = raw.read(HEADER, 5)
            for at in range(0, d[4] + 1, 100):
                for i, h in enumerate(raw.read(HEIGHTS + at, min(100, d[4] + 1 - at))):
                    if at + i < d[4] and h != NONE:
                        offered.add((words(d, 6) + (at + i) * words(d, 8), words(header, 2), words(d, 10) + h * d[12]))
    logged = {tuple(round(float(v) / 0.003) for v in line.split()) for line in served.read_text().splitlines()}
    assert logged == offered and len(logged) > 100
    low, high = [words(d, k) for k in (14, 16, 18)], [words(d, k) for k in (20, 22, 24)]
    assert [min(p[k] for p in offered) for k in range(3)] == low
    assert [max(p[k] for p in offered) for k in range(3)] == high


@pytest.mark.parametrize("points", [
    [(1, 2, 3)], [(5, 5, 5)] * 9, [(3, i, i * i) for i in range(50)], [(i, 7, -i) for i in range(700)],
    [(-2147483647, 0, 0), (2147483647, 0, 0)], [(0, 0, -2147483647), (10, 10, 2147483647)],
    [(1e30, 0, 0), (2e30, 1, 0)], [(0, 0, 0), (65534, 1, 65535), (1, 65535, 65534)],
    [(-100, -100, -100), (-90, -80, -70), (-95, -85, -70.5)]], ids=range(9))
@pytest.mark.parametrize("options", [(), ("--columns", 1, "--profiles", 1), ("--columns", 3000)], ids=len)
def test_awkward_scenes_stay_in_their_box(tmp_path, points, options):
    path = tmp_path / "scene.xyz"
    path.write_text("".join(f"{x} {y} {z}\n" for x, y, z in points))
    unit = max(1, max(abs(v) for point in points for v in point) / 1e5)
    with scanning(path, "--tcp", "127.0.0.1:0", *options, unit=str(unit)) as scanner:
        raw = Raw(scanner.tcp)
        d, seen = raw.read(0, 28), 0
        for _ in range(min(d[5], 20)):
            header, readings = raw.read(HEADER, 5), []
            for at in range(0, d[4] + 1, 100):
                readings += raw.read(HEIGHTS + at, min(100, d[4] + 1 - at))
            for column, h in enumerate(readings[:-1]):
                if h != NONE:
                    reading = [words(d, 6) + column * words(d, 8), words(header, 2), words(d, 10) + h * d[12]]
                    assert all(words(d, 14 + 2 * k) <= reading[k] <= words(d, 20 + 2 * k) for k in range(3))
                    seen += 1
    assert seen > 0


def test_the_highest_point_of_a_column_is_seen(tmp_path):
    path = tmp_path / "stack.xyz"
    path.write_text("0 0 5\n0 0 9\n0.3 0 7\n100 0 1\n0 100 3\n100 100 4\n")
    with scanning(path, "--tcp", "127.0.0.1:0", "--columns", 2, "--profiles", 2) as scanner:
        raw = Raw(scanner.tcp)
        offset = words(raw.read(0, 28), 10)
        profiles = []
        for _ in range(2):
            raw.read(HEADER, 5)
            profiles.append([h + offset for h in raw.read(HEIGHTS, 3)[:2]])
    assert profiles == [[9, 1], [3, 4]]


# ----------------------------------------------------------------------------------------------------------------------
# Faults of the scanner

def test_noise_and_dropouts(scene):
    def heights(*options):
        with scanning(scene, "--tcp", "127.0.0.1:0", *options) as scanner:
            raw = Raw(scanner.tcp)
            offset = words(raw.read(0, 28), 10)
            found = sweep(raw.read)
        return {(c, p): found[3 * p][c] + offset for c, p in CELLS if found[3 * p][c] != NONE}

    noisy = heights("--noise", 25, "--seed", 3)
    errors = [noisy[c, p] - height(c, p) for c, p in CELLS]
    sigma = math.sqrt(sum(e * e for e in errors) / len(errors))
    assert 20 < sigma < 30 and max(map(abs, errors)) <= 100 and abs(sum(errors) / len(errors)) < 5
    assert heights("--noise", 25, "--seed", 3) == noisy  # the same seed, the same readings
    assert heights("--noise", 25, "--seed", 4) != noisy
    dropped = heights("--dropouts", 0.25)
    assert 0.65 < len(dropped) / len(CELLS) < 0.85
    assert all(dropped[c, p] == height(c, p) for c, p in dropped)


def test_a_box_with_noise_holds_every_reading(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--noise", 500, "--loop") as scanner:
        raw = Raw(scanner.tcp)
        d = raw.read(0, 28)
        for _ in range(5 * PROFILES):
            for h in raw.profile()[1]:
                assert h == NONE or words(d, 18) <= words(d, 10) + h * d[12] <= words(d, 24)


def test_torn(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--torn", 1) as scanner:
        raw = Raw(scanner.tcp)
        header = raw.read(HEADER, 5)
        for k in range(3):  # at one of these reads the next profile takes over
            raw.read(HEIGHTS + 10 * k, 10)
        assert header[0] == 1 and raw.read(HEIGHTS + 30, COLUMNS + 1 - 30)[-1] == 2
        end = scanner.stop()
    assert end["torn"] == 1 and end["served"] == 0


def test_stale(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--stale", 1, "--seed", 2) as scanner:
        raw = Raw(scanner.tcp)
        sequences = []
        for _ in range(60):
            header, _, trailer = raw.profile()
            assert header[0] == trailer
            sequences.append(header[0])
        end = scanner.stop()
    assert end["stale"] > 3
    steps = [b - a for a, b in zip(sequences, sequences[1:])]
    assert steps.count(0) > 20 and -1 in steps and 1 in steps  # the same frame still, and the one before again


def test_lost_and_short(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--lost", 0.5, "--short", 0.5, "--sequence", 65530) as scanner:
        raw = Raw(scanner.tcp)
        taken, wrong, last, gaps = set(), 0, 65529, 0
        while len(taken) < PROFILES:
            header, heights, _ = raw.profile()
            valid = sum(h != NONE for h in heights)
            step = (header[0] - last) % 65535
            gaps += step > 1
            last = header[0]
            if header[4] == valid:
                taken.add(words(header, 2))
            else:
                assert header[4] == valid + 1
                wrong += 1
        end = scanner.stop()
    assert end["short"] == wrong > 0 and end["lost"] == gaps > 0 and end["served"] == len(CELLS)


def test_rate(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--rate", 20) as scanner:
        raw = Raw(scanner.tcp)
        assert raw.profile()[0][0] == 1
        assert raw.read(HEADER, 1) == [1]
        time.sleep(0.3)
        sequence = raw.read(HEADER, 1)[0]
        assert 5 <= sequence <= 12
        time.sleep(1)
        assert raw.read(HEADER, 1) == [PROFILES]  # the end: the last one stands
        end = scanner.stop()
    assert end["missed"] > 0


def test_loop_and_once(scene):
    with scanning(scene, "--tcp", "127.0.0.1:0", "--loop") as scanner:
        raw = Raw(scanner.tcp)
        ys = [words(raw.profile()[0], 2) for _ in range(2 * PROFILES + 1)]
        assert ys == [3 * (k % PROFILES) for k in range(2 * PROFILES + 1)]
        end = scanner.stop()
    assert end["served"] >= 2 * len(CELLS) and not any(e["event"] == "over" for e in scanner.events)
    scanner = Scanner(scene, "--tcp", "127.0.0.1:0", "--once")
    raw = Raw(scanner.tcp)
    sweep(raw.read)
    assert scanner.process.wait(timeout=10) == 0


# ----------------------------------------------------------------------------------------------------------------------
# Faults of the wire

class Line:
    """The pty as the socket that rtu.py wants, with everything that came."""

    def __init__(self, path):
        import tty
        self.file = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.file)
        os.set_blocking(self.file, False)

    def ask(self, address, count, unit=1, seconds=0.25):
        os.write(self.file, rtu.frame(unit, struct.pack(">BHH", 3, address, count)))
        got, end = b"", time.monotonic() + seconds
        while time.monotonic() < end and len(got) < 5 + 2 * count:
            with contextlib.suppress(BlockingIOError):
                got += os.read(self.file, 512)
            time.sleep(0.001)
        return got


def good(frame, count):
    return len(frame) == 5 + 2 * count and rtu.crc(frame[:-2]) == frame[-2:] and frame[1] == 3


def test_the_line_without_faults(scene):
    with scanning(scene, "--rtu", "pty") as scanner:
        line = Line(scanner.rtu)
        assert all(good(line.ask(0, 28), 28) for _ in range(20))
        assert line.ask(0, 28, unit=2) == b""
        assert all(good(line.ask(0, 28), 28) for _ in range(5))  # the absent neighbour has not made it deaf


@pytest.mark.parametrize("switch, seen", [
    ("bad-crc", lambda f: len(f) == 61 and rtu.crc(f[:-2]) != f[-2:]),
    ("truncate", lambda f: 0 < len(f) < 61),
    ("silence", lambda f: f == b""),
    ("exception", lambda f: f == rtu.frame(1, b"\x83\x06")),
    ("garbage", lambda f: len(f) >= 61 and not good(f, 28)),
])
def test_switches_of_the_line(scene, switch, seen):
    with scanning(scene, "--rtu", "pty", f"--{switch}", 1) as scanner:
        line = Line(scanner.rtu)
        for _ in range(6):
            assert seen(line.ask(0, 28))
            time.sleep(0.02)
            with contextlib.suppress(BlockingIOError):
                os.read(line.file, 512)
        end = scanner.stop()
    assert end[switch.replace("-", "_")] == 6
    with scanning(scene, "--rtu", "pty", f"--{switch}", 0.3, "--seed", 11) as scanner:
        line = Line(scanner.rtu)
        frames = [line.ask(0, 28, seconds=0.05) for _ in range(40)]
        assert any(good(f, 28) for f in frames) and any(seen(f) for f in frames)


def test_delay(scene):
    with scanning(scene, "--rtu", "pty", "--delay", "1:120") as scanner:
        line = Line(scanner.rtu)
        begin = time.monotonic()
        assert good(line.ask(0, 28, seconds=1), 28)
        assert 0.12 <= time.monotonic() - begin < 0.4


def test_silent_periods(scene):
    with scanning(scene, "--rtu", "pty", "--silence", "0.4+0.5") as scanner:
        line = Line(scanner.rtu)
        begin, answers = time.monotonic(), []
        while time.monotonic() - begin < 1.4:
            answers.append((time.monotonic() - begin, bool(line.ask(0, 4, seconds=0.04))))
        assert any(there for at, there in answers if at < 0.3)
        assert not any(there for at, there in answers if 0.5 < at < 0.85)
        assert any(there for at, there in answers if at > 1.0)


def test_faults_over_tcp(scene):
    for switch, seen in [("bad-crc", lambda a, raw: len(a) == 65 and a[:4] != struct.pack(">HH", raw.transaction, 0)),
                         ("truncate", lambda a, raw: 0 < len(a) < 65),
                         ("exception", lambda a, raw: a == struct.pack(">HHHBBB", raw.transaction, 0, 3, 1, 0x83, 6)),
                         ("silence", lambda a, raw: a == b"")]:
        with scanning(scene, "--tcp", "127.0.0.1:0", f"--{switch}", 1) as scanner:
            for _ in range(3):
                raw = Raw(scanner.tcp)
                assert seen(raw.ask(0, 28), raw), switch
                if switch == "truncate":
                    assert raw.socket.recv(10) == b""  # and the connection ends


def test_what_was_spoilt_was_not_served(scene):
    """A profile counts as served only when every register was offered whole; asking again makes it good."""
    with scanning(scene, "--tcp", "127.0.0.1:0", "--exception", 0.4, "--seed", 5) as scanner:
        raw = Raw(scanner.tcp)

        def read(address, count):
            while (found := raw.read(address, count)) is None:
                pass
            return found

        sweep(read)
        end = scanner.stop()
    assert end["exception"] > 5 and end["served"] == len(CELLS)
    with scanning(scene, "--tcp", "127.0.0.1:0", "--exception", 1) as scanner:
        raw = Raw(scanner.tcp)
        for _ in range(3):
            assert raw.read(HEADER, 5) is None and raw.read(HEIGHTS, COLUMNS + 1) is None
        assert scanner.stop()["served"] == 0


def test_pace(scene):
    """28 registers at 9600 8N1 are 8 + 61 bytes of 10 bits: 72 ms. Unpaced they take a fraction."""
    def seconds(*options):
        with scanning(scene, "--rtu", "pty,9600,8N1", *options) as scanner:
            line = Line(scanner.rtu)
            begin = time.monotonic()
            for _ in range(5):
                assert good(line.ask(0, 28, seconds=2), 28)
            return (time.monotonic() - begin) / 5

    assert seconds("--pace") >= 69 * 10 / 9600
    assert seconds() < 0.03


def test_the_same_seed_gives_the_same_bytes(scene):
    def bytes_of(seed):
        with scanning(scene, "--rtu", "pty", "--seed", seed, "--noise", 3, "--dropouts", 0.1, "--torn", 0.3, "--stale",
                      0.3, "--lost", 0.3, "--bad-crc", 0.1, "--truncate", 0.1, "--exception", 0.1) as scanner:
            line = Line(scanner.rtu)
            said = b""
            for _ in range(15):
                said += line.ask(HEADER, 30, seconds=0.1) + line.ask(HEADER + 30, 16, seconds=0.1)
            return said

    assert bytes_of(1) == bytes_of(1) != bytes_of(2)


# ----------------------------------------------------------------------------------------------------------------------
# Bad input

def refused(*arguments, status=2, text=None):
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=20)
    assert done.returncode == status, done
    if status == 2:
        assert len(done.stderr.splitlines()) == 1 and done.stdout == ""
    return done.stderr


def test_bad_input(tmp_path, scene):
    bad = tmp_path / "bad.xyz"
    served = tmp_path / "served.xyz"
    tcp = ("--tcp", "127.0.0.1:0", "--served", served)
    for content, where in [("", "bad.xyz"), ("1 2\n", ":1"), ("1 2 3\nword 2 3\n", ":2"), ("1 2 nan\n", ":1"),
                           ("1 2 1e400\n", ":1")]:
        bad.write_text(content)
        assert where in refused(bad, *tcp)
    assert str(tmp_path) in refused(tmp_path, *tcp)
    assert "no-such" in refused(tmp_path / "no-such.xyz", *tcp)
    assert "--unit" in refused(scene, *tcp, "--unit", "1e-9")
    assert "--unit" in refused(scene, *tcp, "--unit", "1e-36")
    assert not served.exists()
    assert "--tcp" in refused(scene, "--tcp", "no.such.host.invalid:1")
    assert str(bad) in refused(scene, "--rtu", bad)  # a plain file is no line and is not replaced
    assert bad.read_text() == "1 2 1e400\n"
    for wrong in (["--torn", "2"], ["--rate", "0"], ["--columns", "5000"], ["--silence", "1+"], ["--delay", "0.5"],
                  ["--rtu", "x,12"], ["--rtu", "x,9600,7E1"], ["--rtu", "x,9600,8E1,248"], ["--tcp", "nowhere"],
                  ["--sequence", "0"], ["--no-such"], ["extra"]):
        refused(scene, *tcp, *wrong, status=64)
    refused(scene, status=64)
    refused("--tcp", "127.0.0.1:0", status=64)


def test_a_link_of_an_earlier_run_is_replaced(scene, tmp_path):
    link = tmp_path / "line"
    link.symlink_to("/dev/pts/0")
    with scanning(scene, "--rtu", link) as scanner:
        assert os.readlink(link) == scanner.rtu
        assert good(Line(str(link)).ask(0, 4), 4)
    assert not link.is_symlink()


def test_a_device_that_is_there_is_opened(scene):
    """As with QEMU's pseudo-terminals: the scanner takes the other end of a line that somebody else has made."""
    import tty
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    for _ in range(2):  # also when it is raw already
        with scanning(scene, "--rtu", f"{os.ttyname(theirs)},9600,8E1,3") as scanner:
            assert scanner.rtu == os.ttyname(theirs)
            os.write(ours, rtu.frame(3, struct.pack(">BHH", 3, 0, 2)))
            time.sleep(0.1)
            assert os.read(ours, 100) == rtu.frame(3, b"\x03\x04CNPS")
    os.close(ours)
    os.close(theirs)
