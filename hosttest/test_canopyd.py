"""canopyd as a program: real sockets and pseudo-terminals, scanners that fail, PLCs that crowd, arguments that are wrong."""

import contextlib
import fcntl
import itertools
import json
import math
import os
import pty
import random
import re
import resource
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import pytest

from rtu import Client, NoAnswer, Registers

# runs alone: it measures how long PLCs wait

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CANOPY_BUILD", ROOT / "build"))
HOST = BUILD / "host"
REFEREE = ROOT.parent / "shared" / "tools" / "check_surrogate.py"
TABLE = json.loads((BUILD / "registers.json").read_text())
VALID, INTRUSION, STALE = 1, 2, 4


# ---- Programs


class Program:
    """A child that says on standard output when it serves, and everything else on standard error."""

    def __init__(self, scratch, name, *words, until="ready"):
        self.log = scratch / f"{name}-{next(self.numbers)}.log"
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen([str(HOST / name), *map(str, words)], stdin=subprocess.DEVNULL,
                                            stdout=subprocess.PIPE, stderr=log)
        self.said = []
        while not self.said or self.said[-1] != until:
            line = self.process.stdout.readline().decode()
            assert line, f"{name} ended: {self.text()}"
            self.said.append(line.strip())

    numbers = itertools.count()

    def text(self):
        return self.log.read_text()

    def end(self, how=signal.SIGTERM, seconds=10):
        if self.process.poll() is None:
            self.process.send_signal(how)
        try:
            return self.process.wait(seconds)
        finally:
            self.process.kill()
            self.process.stdout.close()


@pytest.fixture
def start(tmp_path):
    """Starts programs and ends them."""
    running = []

    def begin(name, *words, **options):
        running.append(Program(tmp_path, name, *words, **options))
        return running[-1]

    yield begin
    for program in running:
        with contextlib.suppress(subprocess.TimeoutExpired):
            program.end()


def canopyd(start, scanner, *words, modbus="tcp:127.0.0.1:0"):
    """A running daemon and the port of its first TCP listener."""
    daemon = start("canopyd", "--scanner", scanner, "--modbus", modbus, *words)
    assert daemon.said == ["ready"]
    port = re.search(r"listening on tcp:.*:(\d+)\n", daemon.text())
    return daemon, int(port.group(1)) if port else None


def scanner_tcp(start, points, *words, port=0):
    scanner = start("canopy-scanner", points, "--tcp", f"127.0.0.1:{port}", *words)
    return scanner, int(next(line for line in scanner.said if line.startswith("tcp")).rsplit(":", 1)[1])


# ---- Scenes and clients


@pytest.fixture
def scene(tmp_path):
    """A lattice with holes, a cliff and a spike, whose readings are its points."""
    random.seed(5)
    path = tmp_path / "scene.xyz"
    lines = []
    for row, column in itertools.product(range(40), range(60)):
        if (row - 20) ** 2 + (column - 40) ** 2 < 30:
            continue
        z = 40 + 12 * math.sin(row / 6) * math.cos(column / 9) + (25 if column > 30 else 0) + random.random()
        lines.append(f"{column * 0.5} {row * 0.5} {round(z + (30 if (row, column) == (7, 11) else 0), 3)}")
    path.write_text("\n".join(lines) + "\n")
    return path


def points_in(path):
    return sum(1 for line in path.read_text().splitlines() if line)


class Tcp:
    """A Modbus TCP client that believes nothing: the interface that rtu.Registers wants."""

    def __init__(self, port, timeout=5.0):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transaction = 0

    def close(self):
        self.socket.close()

    def take(self, count):
        got = b""
        while len(got) < count:
            more = self.socket.recv(count - len(got))
            if not more:
                raise EOFError
            got += more
        return got

    def exchange(self, pdu, unit=1):
        self.transaction = self.transaction % 65535 + 1
        self.socket.sendall(struct.pack(">HHHB", self.transaction, 0, len(pdu) + 1, unit) + pdu)
        transaction, protocol, length, answered = struct.unpack(">HHHB", self.take(7))
        assert (transaction, protocol, answered) == (self.transaction, 0, unit)
        return self.take(length - 1)

    def read(self, address, count, function=3):
        pdu = self.exchange(struct.pack(">BHH", function, address, count))
        assert pdu[:2] == bytes([function, 2 * count]), pdu.hex()
        return pdu[2:]

    def write(self, address, values):
        return self.exchange(struct.pack(f">BHHB{len(values)}H", 16, address, len(values), 2 * len(values), *values))


def registers(port, **options):
    return Registers(Tcp(port, **options), TABLE)


def wait(plc, name, condition, seconds=20):
    end = time.monotonic() + seconds
    while not condition(value := plc[name]):
        assert time.monotonic() < end, f"{name} stays {value}"
        time.sleep(0.02)
    return value


def shortest(value):
    """The double of the shortest decimal that is this float."""
    for digits in range(1, 10):
        text = f"{value:.{digits - 1}e}"
        if struct.pack(">f", float(text)) == struct.pack(">f", value):
            return float(text)
    return value


def write_surrogate(values, path):
    m, n = values["grid_m"], values["grid_n"]
    rows = values["coefficients"]
    document = {"format": "canopy-surrogate", "version": 1, "side": ["above", "below"][values["side"]],
                "scalar": ["f32", "fx"][values["scalar"]], "unit": shortest(values["unit"]),
                "frame": {"origin": [values[f"origin_{a}"] for a in "xyz"],
                          "axes": [[values[f"axis_{i}{j}"] / 2 ** 30 for j in range(3)] for i in range(3)],
                          "pitch": [values["pitch_u"], values["pitch_v"]]},
                "size": [m, n], "coefficients": [rows[i * n:(i + 1) * n] for i in range(m)], "lsb": values["lsb"],
                "certificate": {"margin": values["margin"] * values["lsb"], "points": values["points"]}}
    path.write_text(json.dumps(document))
    return path


def check_surrogate(surrogate, points):
    """Both judges: ours, and the independent one where it is at hand."""
    ours = subprocess.run([HOST / "canopy", "check", surrogate, points], capture_output=True, text=True, timeout=60)
    assert ours.returncode == 0, ours.stdout + ours.stderr
    if REFEREE.exists():
        theirs = subprocess.run([sys.executable, REFEREE, surrogate, points], capture_output=True, text=True, timeout=120)
        assert theirs.returncode == 0, theirs.stdout + theirs.stderr


class Pty:
    """Two ends of a line: `device` for a program, and a socket-like end for the test."""

    def __init__(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(self.slave)
        self.device = os.ttyname(self.slave)
        self.timeout = None

    def close(self):
        for fd in (self.master, self.slave):
            with contextlib.suppress(OSError):
                os.close(fd)

    def settimeout(self, seconds):
        self.timeout = seconds

    def sendall(self, data):
        os.write(self.master, data)

    def recv(self, count):
        if not select.select([self.master], [], [], self.timeout)[0]:
            raise TimeoutError
        return os.read(self.master, count)


@pytest.fixture
def line():
    made = Pty()
    yield made
    made.close()


# ---- From a scene to an envelope


@pytest.mark.parametrize("side", ["above", "below"])
def test_sweep_in_process_over_tcp(start, scene, tmp_path, side):
    daemon, port = canopyd(start, f"sim:{scene}", "--side", side, "--grid", "12x10")
    plc, count = registers(port), points_in(scene)
    wait(plc, "points", lambda points: points == count)
    assert plc["status"] == VALID and plc["coverage_pct"] >= 95 and plc["points_rejected"] == 0
    values = plc.envelope()
    assert (values["grid_m"], values["grid_n"], values["points"], values["scalar"]) == (12, 10, count, 1)
    check_surrogate(write_surrogate(values, tmp_path / "read.json"), scene)
    assert daemon.end() == 0


def gap_of(values, scene, path):
    done = subprocess.run([HOST / "canopy", "check", write_surrogate(values, path), scene], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    return float(re.search(r"mean gap ([0-9.e+-]+)%", done.stdout).group(1))


@pytest.mark.parametrize("side", ["above", "below"])
def test_spare_time_makes_it_tighter(start, scene, tmp_path, side):
    """With --method tight the same scene's envelope comes again, certified and far nearer."""
    count, path = points_in(scene), tmp_path / "read.json"
    _, port = canopyd(start, f"sim:{scene}", "--side", side, "--grid", "12x10")
    fast = registers(port)
    wait(fast, "points", lambda points: points == count)
    gap = gap_of(fast.envelope(), scene, path)
    daemon, port = canopyd(start, f"sim:{scene}", "--side", side, "--grid", "12x10", "--method", "tight")
    plc = registers(port)
    wait(plc, "points", lambda points: points == count)
    end = time.monotonic() + 20
    while gap_of(values := plc.envelope(), scene, path) > 0.8 * gap:
        assert time.monotonic() < end, "it stays as loose as it was"
    check_surrogate(path, scene)
    assert values["points"] == count and plc["status"] == VALID
    assert daemon.end() == 0


def test_pymodbus_reads_the_same(start, scene):
    from pymodbus.client import ModbusTcpClient
    _, port = canopyd(start, f"sim:{scene}")
    plc, count = registers(port), points_in(scene)
    wait(plc, "points", lambda points: points == count)
    client = ModbusTcpClient("127.0.0.1", port=port)
    assert client.connect()

    class Theirs:
        def read(self, address, words):
            answer = client.read_holding_registers(address, words, slave=1)
            assert not answer.isError(), answer
            return struct.pack(f">{words}H", *answer.registers)

    ours, theirs = plc.envelope(), Registers(Theirs(), TABLE).envelope()
    client.close()
    assert ours == theirs and len(theirs["coefficients"]) == 400


def test_several_servers_serve_one_envelope(start, scene, line, tmp_path):
    daemon, port = canopyd(start, f"sim:{scene}", "--modbus", f"rtu:{line.device},115200,8E1,7", "--modbus",
                           "tcp:[::1]:0" if socket.has_ipv6 and ipv6() else "tcp:127.0.0.2:0")
    plc, count = registers(port), points_in(scene)
    wait(plc, "points", lambda points: points == count)
    serial = Registers(Client(line, unit=7), TABLE)
    assert serial["magic"] == 0x434E5059 and serial["clients"] == 17
    values = serial.envelope()
    assert values == plc.envelope()
    check_surrogate(write_surrogate(values, tmp_path / "read.json"), scene)
    with pytest.raises(NoAnswer):
        Client(line, unit=8, timeout=0.5).read(0, 2)
    assert serial["probe_u32"] == 0x12345678  # and the neighbour's silence did not make it deaf
    assert len(re.findall("listening on|unit 7 on", daemon.text())) == 3


def ipv6():
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
        return True
    except OSError:
        return False


def test_rtu_line_that_goes_and_comes_back(start, scene, tmp_path):
    link = tmp_path / "line"
    first = Pty()
    link.symlink_to(first.device)
    daemon, port = canopyd(start, f"sim:{scene}", "--modbus", f"rtu:{link},115200,8E1,1")
    plc = registers(port)
    assert Client(first).read(0, 2) == b"CNPY"
    first.close()
    end = time.monotonic() + 5
    while "the line has gone" not in daemon.text():
        assert time.monotonic() < end
        assert plc["magic"] == 0x434E5059  # others do not notice
        time.sleep(0.05)
    second = Pty()
    link.unlink()
    link.symlink_to(second.device)
    time.sleep(1.3)
    assert Client(second).read(0, 2) == b"CNPY"
    second.close()
    assert daemon.process.poll() is None


# ---- Scanners on Modbus, through libmodbus


FAULTS = ["--dropouts", "0.1", "--torn", "0.05", "--stale", "0.05", "--lost", "0.02", "--short", "0.03", "--exception", "0.02"]


def test_scanner_over_tcp(start, scene, tmp_path):
    served = tmp_path / "served.xyz"
    scanner, port = scanner_tcp(start, scene, "--served", served, *FAULTS)
    daemon, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port},driver=generic,unit=1")
    plc = registers(plc_port)
    wait(plc, "points", lambda points: points > 1000 and points == points_in(served) and scanner_is_over(scanner), 40)
    assert plc["profiles_torn"] + plc["profiles_short"] > 0 and plc["points_rejected"] == 0
    check_surrogate(write_surrogate(plc.envelope(), tmp_path / "read.json"), served)
    assert daemon.end() == 0 and scanner.end() == 0


def scanner_is_over(scanner):
    return "over" in scanner.text() or "served" in scanner.text()


@pytest.mark.parametrize("form", ["115200,8E1", "38400,8N2"])
def test_scanner_over_rtu(start, scene, tmp_path, form):
    served, device = tmp_path / "served.xyz", tmp_path / "scanner"
    scanner = start("canopy-scanner", scene, "--rtu", f"{device},{form},9", "--served", served, "--bad-crc", "0.02",
                    "--truncate", "0.01", "--silence", "0.01", *FAULTS)
    daemon, port = canopyd(start, f"modbus-rtu:{device},{form},9", "--timeout", "150")
    plc = registers(port)
    wait(plc, "points", lambda points: points > 1000 and points == points_in(served) and scanner_is_over(scanner), 60)
    assert plc["scan_errors"] > 0 and plc["points_rejected"] == 0
    check_surrogate(write_surrogate(plc.envelope(), tmp_path / "read.json"), served)
    assert daemon.end() == 0


def test_scanner_killed_and_restarted(start, scene, tmp_path):
    scanner, port = scanner_tcp(start, scene, "--loop", "--rate", "100")
    daemon, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port}", "--stale-after", "700")
    plc, count = registers(plc_port), points_in(scene)
    wait(plc, "points", lambda points: points > count)
    wait(plc, "status", lambda status: status == VALID)
    scanner.process.kill()
    scanner.process.wait()
    wait(plc, "sensor_faults", lambda faults: faults == 1, 5)
    wait(plc, "status", lambda status: status & STALE and not status & VALID, 5)
    age, sequence, accepted = plc["age_ms"], plc["sequence"], plc["points_accepted"]
    assert len(plc.envelope()["coefficients"]) == 400  # the last good one stays
    time.sleep(0.3)
    assert plc["age_ms"] >= age + 250 and plc["sequence"] == sequence and plc["points_accepted"] == accepted
    scanner_tcp(start, scene, "--loop", "--rate", "100", port=port)
    wait(plc, "sensor_faults", lambda faults: faults == 0, 15)
    wait(plc, "status", lambda status: status == VALID, 15)
    assert plc["points"] > count and plc["points_accepted"] > accepted
    assert daemon.text().count("profiles are coming in") == 2


def test_scanner_that_comes_late(start, scene):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    _, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port}")
    plc = registers(plc_port)
    wait(plc, "sensor_faults", lambda faults: faults == 1)
    assert plc["status"] == STALE and plc["sequence"] == 0 and plc["age_ms"] == 0xFFFFFFFF
    scanner_tcp(start, scene, port=port)
    wait(plc, "points", lambda points: points == points_in(scene))


def test_silent_scanner(start, scene):
    """It answers again after a silence: nothing is lost, the fault comes and goes."""
    _, port = scanner_tcp(start, scene, "--rate", "50", "--loop", "--silence", "1.5+2.5")
    _, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port}", "--timeout", "200")
    plc = registers(plc_port)
    wait(plc, "sensor_faults", lambda faults: faults == 0)
    wait(plc, "sensor_faults", lambda faults: faults == 1)
    before = plc["points_accepted"]
    wait(plc, "sensor_faults", lambda faults: faults == 0)
    wait(plc, "points_accepted", lambda accepted: accepted > before)


def test_another_unit_than_told_is_refused(start, scene):
    _, port = scanner_tcp(start, scene, "--unit", "0.01")
    daemon, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port}", "--unit", "0.02")
    plc = registers(plc_port)
    wait(plc, "profiles", lambda profiles: profiles == 40)
    time.sleep(0.2)
    assert plc["sensor_faults"] == 1 and plc["points_accepted"] == 0 and plc["sequence"] == 0
    assert "its unit is 0.01, not 0.02 as told" in daemon.text()
    _, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port}", "--unit", "0.01")
    wait(registers(plc_port), "sensor_faults", lambda faults: faults in (0, 1))


def test_not_a_scanner_is_refused(start, scene):
    """A canopyd is a Modbus device, too, but no scanner."""
    _, port = canopyd(start, f"sim:{scene}")
    daemon, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port}")
    plc = registers(plc_port)
    wait(plc, "profiles_refused", lambda refused: refused > 0)
    assert plc["sensor_faults"] == 1 and plc["points_accepted"] == 0
    assert "refused" in daemon.text()


# ---- Nothing delays a PLC's answer


def latencies(plc, seconds):
    """Sorted times of reads of the live status, in seconds."""
    times, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        before = time.perf_counter()
        plc.client.read(100, 8)
        times.append(time.perf_counter() - before)
        time.sleep(0.001)
    return sorted(times)


def report(name, times):
    print(f"{name}: {len(times)} reads, median {times[len(times) // 2] * 1e6:.0f} us, "
          f"99 % {times[len(times) * 99 // 100] * 1e6:.0f} us, most {times[-1] * 1e6:.0f} us")


@contextlib.contextmanager
def blocked_sensor(accepting):
    """Takes connections (or leaves them in the queue) and never says a word."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(1)
        kept, running = [], True

        def accept():
            listener.settimeout(0.1)
            while running:
                with contextlib.suppress(OSError):
                    kept.append(listener.accept()[0])

        thread = threading.Thread(target=accept if accepting else lambda: None)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            running = False
            thread.join()
            for connection in kept:
                connection.close()


@pytest.mark.parametrize("accepting", [True, False])
def test_blocked_sensor_delays_no_answer(start, accepting):
    with blocked_sensor(accepting) as port:
        daemon, plc_port = canopyd(start, f"modbus-tcp:127.0.0.1:{port}", "--timeout", "4000")
        plc = registers(plc_port)
        times = latencies(plc, 5)
        report("blocked sensor", times)
        # A coupling would show as waits of seconds; this host's own hiccups stay below that.
        assert times[-1] < 1 and times[len(times) * 99 // 100] < 0.1
        assert plc["sensor_faults"] == 1 and plc["status"] == STALE
        before = time.monotonic()
        assert daemon.end() == 0  # in the middle of a read that hangs
        assert time.monotonic() - before < 3


def test_answers_while_fitting_without_pause(start, scene):
    _, port = canopyd(start, f"sim:{scene},loop", "--grid", "100x100", "--interval", "0", "--refresh", "0")
    plc = registers(port)
    wait(plc, "sequence", lambda sequence: sequence > 0)
    times = latencies(plc, 4)
    report("fitting 100x100", times)
    assert times[-1] < 1 and times[len(times) * 99 // 100] < 0.1


def test_nobody_reads_standard_error(scene, tmp_path):
    """A full pipe stops nothing."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b"x" * 512)
    os.set_blocking(writing, True)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen([HOST / "canopyd", "--scanner", f"sim:{scene}", "--modbus", f"tcp:127.0.0.1:{port}"],
                               stdout=subprocess.PIPE, stderr=writing)
    os.close(writing)
    try:
        assert process.stdout.readline() == b"ready\n"
        plc = registers(port)
        wait(plc, "points", lambda points: points == points_in(scene))
        plc.client.close()
        process.terminate()
        assert process.wait(5) == 0
    finally:
        process.kill()
        process.stdout.close()
        os.close(reading)


# ---- Many clients


def alive(client):
    try:
        return client.read(0, 2) == b"CNPY"
    except (EOFError, OSError):
        return False


def test_eight_clients_and_no_more(start, scene):
    _, port = canopyd(start, f"sim:{scene}", "--idle", "0")
    clients = [Tcp(port) for _ in range(8)]
    assert all(alive(client) for client in clients)
    ninth = Tcp(port)
    assert not alive(ninth)  # all are busy
    end = time.monotonic() + 5.5
    while time.monotonic() < end:
        assert all(alive(client) for client in clients[1:])
        time.sleep(0.2)
    ninth = Tcp(port)
    assert alive(ninth) and not alive(clients[0])  # the idle one made room
    assert all(alive(client) for client in clients[1:])
    for client in clients[2:5]:
        client.close()
    time.sleep(0.1)
    assert all(alive(Tcp(port)) for _ in range(3))


def test_idle_clients_are_dropped(start, scene):
    _, port = canopyd(start, f"sim:{scene}", "--idle", "600")
    idle, trickling, busy = Tcp(port), Tcp(port), Tcp(port)
    for _ in range(10):
        assert alive(busy)
        with contextlib.suppress(OSError):
            trickling.socket.sendall(b"\0")  # bytes, but never a request
        time.sleep(0.1)
    assert not alive(idle) and not alive(trickling) and alive(busy)


def test_holds_are_each_clients_own(start, scene):
    _, port = canopyd(start, f"sim:{scene},loop,rate=200", "--interval", "0", "--refresh", "0")
    slow, fast = registers(port), registers(port)
    wait(fast, "sequence", lambda sequence: sequence > 3)
    first = struct.unpack(">I", slow.client.read(120, 2))[0]
    wait(fast, "sequence", lambda sequence: sequence > first + 3)
    for block in range(7):
        words = 124 if block < 6 else 2 + 2 * (400 - 6 * 61)
        assert struct.unpack(">I", slow.client.read(10000 + 125 * block, words)[:4])[0] == first
    slow.client.close()
    time.sleep(0.05)
    again = registers(port)  # takes the place of the one that left, and nothing of what it held
    assert struct.unpack(">I", again.client.read(10000, 2))[0] > first + 3


def test_garbage_closes_only_its_own_connection(start, scene):
    _, port = canopyd(start, f"sim:{scene}")
    good, bad = registers(port), Tcp(port)
    bad.socket.sendall(b"\x00\x01\x00\x00\xff\xff" + bytes(300))
    with pytest.raises((EOFError, OSError)):
        bad.take(1)
    assert good["magic"] == 0x434E5059 and good["rx_errors"] >= 1
    frames = good["rx_frames"]
    wait(good, "rx_frames", lambda now: now > frames)


def test_pipelined_requests_are_all_answered(start, scene):
    _, port = canopyd(start, f"sim:{scene}")
    client = Tcp(port)
    client.socket.sendall(b"".join(struct.pack(">HHHBBHH", i, 0, 6, 1, 3, 0, 2) for i in range(200)))
    for i in range(200):
        assert client.take(13) == struct.pack(">HHHBBB", i, 0, 7, 1, 3, 4) + b"CNPY"


# ---- Frames and configuration


def test_keeps_to_the_frame_of_a_file(start, scene, tmp_path):
    surrogate = tmp_path / "frame.json"
    fit = subprocess.run([HOST / "canopy", "fit", scene, "--grid", "9x7", "--scalar", "fx", "-o", surrogate],
                         capture_output=True, text=True, timeout=60)
    assert fit.returncode == 0, fit.stderr
    wanted = json.loads(surrogate.read_text())
    scene_part = tmp_path / "part.xyz"
    scene_part.write_text("\n".join(line for line in scene.read_text().splitlines() if float(line.split()[0]) < 20) + "\n")
    _, port = canopyd(start, f"sim:{scene_part}", "--frame", surrogate)
    plc = registers(port)
    wait(plc, "points", lambda points: points == points_in(scene_part))
    values = plc.envelope()
    assert [values["grid_m"], values["grid_n"]] == wanted["size"] == [9, 7]
    assert [values[f"origin_{a}"] for a in "xyz"] == wanted["frame"]["origin"]
    assert [values["pitch_u"], values["pitch_v"]] == wanted["frame"]["pitch"]
    assert shortest(values["unit"]) == wanted["unit"]
    check_surrogate(write_surrogate(values, tmp_path / "read.json"), scene_part)


TURNED = [("--dir", "1,2,3"), ("--dir=-1,0,0",), ("--dir", "0.5,0,-1", "--side", "below"), ("--dir", "1,1,0"),
          ("--dir", "1e-9,0,1"), ("--plane", "0,0,0,10,1,2,0,10,4"), ("--plane", "9,9,9,9,9,10,9,10,9", "--side", "below")]


@pytest.mark.parametrize("options", TURNED, ids=" ".join)
def test_looks_in_any_direction(start, scene, tmp_path, options):
    """Every reading stands in the frame that the registers tell, on the safe side of the surface along its axes."""
    _, port = canopyd(start, f"sim:{scene}", "--grid", "8x9", "--unit", "0.002", *options)
    plc = registers(port)
    wait(plc, "points", lambda points: points == points_in(scene))
    assert plc["points_rejected"] == 0 and plc["status"] & VALID
    values = plc.envelope()
    axes = [[values[f"axis_{i}{k}"] / 2 ** 30 for k in range(3)] for i in range(3)]
    for i, k in itertools.product(range(3), range(3)):
        assert abs(sum(a * b for a, b in zip(axes[i], axes[k])) - (i == k)) < 1e-8
    what, numbers = "=".join(options[:2]).split("=")[:2]
    numbers = [float(number) for number in numbers.split(",")]
    if what == "--plane":
        p, q, r = numbers[:3], numbers[3:6], numbers[6:]
        a, b = [y - x for x, y in zip(p, q)], [y - x for x, y in zip(p, r)]
        numbers = [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]
    length = math.hypot(*numbers)
    assert all(abs(x - y / length) < 1e-8 for x, y in zip(axes[2], numbers))
    check_surrogate(write_surrogate(values, tmp_path / "read.json"), scene)


def test_keeps_to_a_turned_frame(start, scene, tmp_path):
    surrogate = tmp_path / "frame.json"
    subprocess.run([HOST / "canopy", "fit", scene, "--grid", "9x7", "--scalar", "fx", "--dir", "1,-1,2", "-o", surrogate],
                   check=True, capture_output=True, timeout=60)
    wanted = json.loads(surrogate.read_text())
    _, port = canopyd(start, f"sim:{scene}", "--frame", surrogate)
    plc = registers(port)
    wait(plc, "points", lambda points: points == points_in(scene))
    values = plc.envelope()
    assert [values[f"origin_{a}"] for a in "xyz"] == wanted["frame"]["origin"]
    assert [[values[f"axis_{i}{k}"] / 2 ** 30 for k in range(3)] for i in range(3)] == wanted["frame"]["axes"]
    check_surrogate(write_surrogate(values, tmp_path / "read.json"), scene)


def test_points_beside_a_frame_are_counted(start, scene, tmp_path):
    surrogate, part = tmp_path / "frame.json", tmp_path / "part.xyz"
    part.write_text("\n".join(line for line in scene.read_text().splitlines() if float(line.split()[0]) < 20) + "\n")
    subprocess.run([HOST / "canopy", "fit", part, "--grid", "8x8", "--scalar", "fx", "-o", surrogate], check=True,
                   capture_output=True, timeout=60)
    _, port = canopyd(start, f"sim:{scene}", "--frame", surrogate)
    plc = registers(port)
    wait(plc, "points_rejected", lambda rejected: rejected == points_in(scene) - points_in(part))
    wait(plc, "points", lambda points: points == points_in(part))


def test_configuration_file(start, scene, tmp_path):
    config = tmp_path / "canopyd.conf"
    config.write_text(f"# a comment\n\nscanner = sim:{scene}   # and another\r\nmodbus=tcp:127.0.0.1:0\n"
                      "  grid = 6x5\n side = below\nstale-after = 1234\n")
    daemon = start("canopyd", "--config", config, "--grid", "7x8")
    port = int(re.search(r"listening on tcp:.*:(\d+)\n", daemon.text()).group(1))
    plc = registers(port)
    wait(plc, "points", lambda points: points == points_in(scene))
    values = plc.envelope()
    assert (values["grid_m"], values["grid_n"], values["side"]) == (7, 8, 1)  # the command line wins
    assert plc["stale_after_ms"] == 1234


def test_example_configuration(start, scene, tmp_path):
    """The example of the manual works as it stands, but for the scanner and the port."""
    text = (ROOT / "boards" / "linux" / "canopyd.conf").read_text()
    keys = re.findall(r"^#?([a-z-]+) = ", text, re.M)
    help_text = subprocess.run([HOST / "canopyd", "--help"], capture_output=True, text=True, timeout=10).stdout
    options = set(re.findall(r"--([a-z-]+)=", help_text)) - {"config"}
    assert set(keys) == options
    manual = (ROOT / "docs" / "canopyd.md").read_text()
    assert all(f"`{option}`" in manual for option in options)
    config = tmp_path / "canopyd.conf"
    text = re.sub(r"^scanner = .*", f"scanner = sim:{scene}", text, flags=re.M)
    config.write_text(re.sub(r"^modbus = tcp:.*", "modbus = tcp:127.0.0.1:0", text, flags=re.M))
    daemon = start("canopyd", "--config", config)
    assert daemon.end(signal.SIGINT) == 0


# ---- Wrong usage and bad input


GOOD = {"scanner": "sim:SCENE", "modbus": "tcp:127.0.0.1:0"}
USAGE = [
    [], ["--scanner", "sim:SCENE"], ["--modbus", "tcp:127.0.0.1:0"], ["--nonsense"], ["SCENE"], ["--grid"],
    {"scanner": "SCENE"}, {"scanner": "sim:"}, {"scanner": "sim:SCENE,rat=5"}, {"scanner": "sim:SCENE,rate=0"},
    {"scanner": "sim:SCENE,profiles=0"}, {"scanner": "modbus-rtu:/dev/null"}, {"scanner": "modbus-rtu:/dev/null,9601,8E1,1"},
    {"scanner": "modbus-rtu:/dev/null,9600,7E1,1"}, {"scanner": "modbus-rtu:/dev/null,9600,8E1,248"},
    {"scanner": "modbus-tcp:localhost"}, {"scanner": "modbus-tcp:localhost:0"}, {"scanner": "modbus-tcp:localhost:65536"},
    {"scanner": "modbus-tcp:::1:502"}, {"scanner": "i2c:/dev/i2c-1@16"}, {"modbus": "tcp:1"}, {"modbus": "udp:localhost:1"},
    {"modbus": "tcp:127.0.0.1:0,unit=1"}, {"modbus": "rtu:/dev/null,9600,8E1,1,rs232"}, {"side": "left"},
    {"method": "quick"},
]
INPUT = [
    ({"scanner": "sim:/nowhere/points.xyz"}, "/nowhere/points.xyz"), ({"scanner": "sim:DIR"}, "DIR"),
    ({"scanner": "sim:WORDS"}, "WORDS:2"), ({"scanner": "sim:EMPTY"}, "EMPTY"), ({"grid": "3x3"}, "3x3"),
    ({"grid": "100000x100000"}, "100000x100000"), ({"grid": "200x200"}, "200x200"), ({"grid": "twenty"}, "twenty"),
    ({"grid": "100x100", "field": "32"}, "--field 32"), ({"unit": "0"}, "0"), ({"unit": "-1"}, "-1"),
    ({"unit": "nan"}, "nan"), ({"unit": "1e99"}, "1e99"), ({"unit": "1e-12"}, "SCENE"), ({"field": "0"}, "0"),
    ({"field": "33"}, "33"), ({"lines": "3"}, "lines 3"), ({"stale-after": "soon"}, "soon"), ({"frame": "SCENE"}, "SCENE"),
    ({"grid": "100x100", "method": "tight"}, "4096 coefficients, not 100x100"),
    ({"dir": "0,0,0"}, "--dir: '0,0,0'"), ({"dir": "1,2"}, "--dir"), ({"plane": "0,0,0,1,1,1,3,3,3"}, "on a line"),
    ({"plane": "0,0,0,1,1,1"}, "--plane"), ({"plane": "0,0,0,1,0,0,0,1,0", "dir": "0,0,1"}, "give one of them"),
    ({"frame": "SCENE", "dir": "0,0,1"}, "give one of them"),
    ({"frame": "/nowhere.json"}, "/nowhere.json"), ({"modbus": "tcp:192.0.2.1:502"}, "192.0.2.1"),
    ({"modbus": "tcp:no.such.host.invalid:502"}, "no.such.host.invalid"), ({"modbus": "rtu:/dev/null,9600,8E1,1"}, "/dev/null"),
    ({"modbus": "rtu:/nowhere/line,9600,8E1,1"}, "/nowhere/line"),
    ({"scanner": "modbus-rtu:/nowhere/line,9600,8E1,1"}, "/nowhere/line"),
    ({"scanner": "modbus-tcp:localhost:502,driver=laser"}, "driver=laser"), ({"config": "/nowhere.conf"}, "/nowhere.conf"),
]


def run(scene, tmp_path, words):
    (tmp_path / "words.xyz").write_text("1 2 3\none two three\n")
    (tmp_path / "empty.xyz").write_text("")
    if isinstance(words, dict):
        words = [word for key, value in {**GOOD, **words}.items() for word in (f"--{key}", value)]
    places = {"SCENE": scene, "DIR": tmp_path, "WORDS": tmp_path / "words.xyz", "EMPTY": tmp_path / "empty.xyz"}

    def fill(word):
        for name, path in places.items():
            word = word.replace(name, str(path))
        return word

    done = subprocess.run([HOST / "canopyd", *map(fill, words)], capture_output=True, text=True, timeout=20)
    return done, fill


@pytest.mark.parametrize("words", USAGE, ids=str)
def test_wrong_usage(scene, tmp_path, words):
    done, _ = run(scene, tmp_path, words)
    assert done.returncode == 64 and done.stdout == "" and done.stderr.startswith("canopyd: ") or \
        done.returncode == 64 and "--help" in done.stderr, done.stderr


@pytest.mark.parametrize("words,named", INPUT, ids=str)
def test_bad_input(scene, tmp_path, words, named):
    done, fill = run(scene, tmp_path, words)
    lines = done.stderr.splitlines()
    assert done.returncode == 2 and done.stdout == "", done.stderr
    assert len(lines) == 1 and lines[0].startswith("canopyd: ") and fill(named) in lines[0], done.stderr


@pytest.mark.parametrize("text,named", [("grid = 3x3\n", ":1: grid: 3x3"), ("\nside = left\n", ":2: side: 'left'"), ("speed = 9\n", ":1: 'speed'"),
                                        ("scanner\n", ":1: 'scanner'"), ("modbus = \n", ":1: modbus has no value"),
                                        ("scanner = what:ever\n", ":1: scanner: what:ever"), ("config = x\n", ":1: 'config'"),
                                        ("modbus = tcp:127.0.0.1:0\n" * 17, ":17: modbus: ")])
def test_bad_configuration(scene, tmp_path, text, named):
    config = tmp_path / "bad.conf"
    config.write_text(text)
    done, _ = run(scene, tmp_path, ["--scanner", "sim:SCENE", "--modbus", "tcp:127.0.0.1:0", "--config", str(config)])
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and f"{config}{named}" in done.stderr, done.stderr


def test_port_in_use(start, scene, tmp_path):
    _, port = canopyd(start, f"sim:{scene}")
    done, _ = run(scene, tmp_path, {"modbus": f"tcp:127.0.0.1:{port}"})
    assert done.returncode == 2 and f"127.0.0.1:{port}: Address already in use" in done.stderr
    assert len([line for line in done.stderr.splitlines() if line]) == 1


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_ends_on_a_signal(start, scene, how):
    daemon, port = canopyd(start, f"sim:{scene},loop")
    client = Tcp(port)
    assert alive(client)
    assert daemon.end(how, 3) == 0
    assert not alive(client)


def test_too_few_descriptors(scene):
    done = subprocess.run([HOST / "canopyd", "--scanner", f"sim:{scene}", "--modbus", "tcp:127.0.0.1:0"],
                          capture_output=True, text=True, timeout=10,
                          preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (20, 20)))
    assert done.returncode == 2 and "ulimit -n" in done.stderr and len(done.stderr.splitlines()) == 1
