"""canopy-plc against a device that the test makes up: TCP and RTU, changing envelopes, late and broken answers."""

import contextlib
import json
import os
import random
import select
import socket
import struct
import subprocess
import threading
import time
import tty
from pathlib import Path

import pytest

import rtu

BUILD = Path(os.environ.get("CANOPY_BUILD", Path(__file__).resolve().parent.parent / "build"))
PROGRAM = BUILD / "host" / "canopy-plc"
MAP = json.loads((BUILD / "registers.json").read_text())


class Registers:
    """A device's registers at the addresses of a map."""

    def __init__(self, the_map=MAP):
        self.words, self.items = {}, {item["name"]: item for item in the_map["registers"]}
        for name, value in {"magic": 0x434E5059, "map_version": the_map["map_version"], "probe_u32": 0x12345678,
                            "probe_f32": 1.0, "status": 1, "coverage_pct": 87, "heartbeat": 5, "age_ms": 12}.items():
            self.put(name, value)

    def put(self, name, value):
        item = self.items[name]
        form = {"u16": ">H", "u32": ">I", "i32": ">i", "f32": ">f"}[item["type"]]
        self.put_words(item["address"], struct.pack(form, value))

    def put_words(self, address, data):
        for k, word in enumerate(struct.unpack(f">{len(data) // 2}H", data)):
            self.words[address + k] = word

    def envelope(self, sequence, m=7, n=19, points=1234, unit=0.1, lsb=0.25, scalar=1, side=0, seed=None):
        """Publishes an envelope; returns what its file must be."""
        dice = random.Random(sequence if seed is None else seed)
        coefficients = [dice.randrange(-2 ** 31, 2 ** 31) for _ in range(m * n)]
        cells = [dice.randrange(2) for _ in range((m - 1) * (n - 1))]
        origin, pitch = [-5, 70000, -2 ** 31], [12345, 4000000000]
        axes = [1 << 30, 0, 0, 0, 0, -(1 << 30), 0, 1 << 30, 0]
        values = {"sequence": sequence, "points": points, "scalar": scalar, "side": side, "grid_m": m, "grid_n": n,
                  "unit": unit, "lsb": lsb, "margin": 17, "origin_x": origin[0], "origin_y": origin[1],
                  "origin_z": origin[2], "pitch_u": pitch[0], "pitch_v": pitch[1],
                  "block_count": -(-m * n // 61), "coverage_count": -(-len(cells) // 1952)}
        for name, value in values.items():
            self.put(name, value)
        for k, value in enumerate(axes):
            self.put(f"axis_{k // 3}{k % 3}", value)
        for k in range(values["block_count"]):
            part = coefficients[61 * k:61 * k + 61]
            self.put_words(self.items[f"block_{k}"]["address"], struct.pack(f">I{len(part)}i", sequence, *part))
        for k in range(values["coverage_count"]):
            part = cells[1952 * k:1952 * k + 1952]
            part += [0] * (-len(part) % 16)
            bits = [sum(part[16 * w + b] << b for b in range(16)) for w in range(len(part) // 16)]
            self.put_words(self.items[f"coverage_{k}"]["address"], struct.pack(f">I{len(bits)}H", sequence, *bits))
        return {"format": "canopy-surrogate", "version": 1, "side": ["above", "below"][side],
                "scalar": ["f32", "fx"][scalar], "unit": unit, "size": [m, n], "lsb": lsb,
                "frame": {"origin": origin, "pitch": pitch,
                          "axes": [[a / (1 << 30) for a in axes[3 * r:3 * r + 3]] for r in range(3)]},
                "coefficients": [coefficients[n * r:n * r + n] for r in range(m)],
                "trim": [cells[(n - 1) * r:(n - 1) * (r + 1)] for r in range(m - 1)],
                "certificate": {"margin": 17 * lsb, "points": points}}

    def serve(self, pdu):
        function, address, count = struct.unpack(">BHH", pdu)
        assert function in (3, 4) and 1 <= count <= 125
        return struct.pack(">BB", function, 2 * count) + struct.pack(
            f">{count}H", *(self.words.get(address + k, 0) for k in range(count)))


class Device:
    """Serves registers until closed. `before(device, number, address)` is called before each answer and may change the
    registers; what it returns, if anything, is done instead: a delay in seconds, "silent", "crc" or a PDU."""

    def __init__(self, registers, before=None):
        self.registers, self.before, self.number, self.ending = registers, before, 0, False
        self.requests = []
        self.thread = threading.Thread(target=self.run, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.ending = True
        self.thread.join(10)

    def answer(self, pdu):
        self.number += 1
        self.requests.append(pdu)
        what = self.before(self, self.number, struct.unpack(">H", pdu[1:3])[0]) if self.before else None
        if isinstance(what, bytes):
            return what, None
        return self.registers.serve(pdu), what


class TcpDevice(Device):
    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.settimeout(0.05)
        self.url = f"tcp:127.0.0.1:{self.listener.getsockname()[1]}"

    def run(self):
        while not self.ending:
            with contextlib.suppress(TimeoutError, ConnectionError):
                connection, _ = self.listener.accept()
                self.talk(connection)
        self.listener.close()

    def talk(self, connection):
        connection.settimeout(0.05)
        while not self.ending:
            try:
                head = connection.recv(12, socket.MSG_WAITALL)
            except TimeoutError:
                continue
            if len(head) < 12:
                return
            pdu, what = self.answer(head[7:])
            if isinstance(what, float):
                time.sleep(what)
            if what != "silent":
                connection.sendall(head[:4] + struct.pack(">H", len(pdu) + 1) + head[6:7] + pdu)


class RtuDevice(Device):
    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.ours, self.theirs = os.openpty()
        tty.setraw(self.theirs)
        self.url = f"rtu:{os.ttyname(self.theirs)},115200,8N1,5"

    def __exit__(self, *arguments):
        super().__exit__(*arguments)
        os.close(self.ours)
        os.close(self.theirs)

    def run(self):
        waiting = []  # (time, bytes), in order: a device answers one after the other
        got = b""
        while not self.ending:
            if select.select([self.ours], [], [], 0.002)[0]:
                got += os.read(self.ours, 512)
            while len(got) >= 8:
                frame, got = got[:8], got[8:]
                assert rtu.crc(frame[:-2]) == frame[-2:] and frame[0] == 5
                pdu, what = self.answer(frame[1:-2])
                data = rtu.frame(5, pdu)
                if what == "crc":
                    data = data[:-1] + bytes([data[-1] ^ 1])
                due = time.monotonic() + (what if isinstance(what, float) else 0)
                if what != "silent":
                    waiting.append((max([due] + [at for at, _ in waiting]), data))
            while waiting and waiting[0][0] <= time.monotonic():
                os.write(self.ours, waiting.pop(0)[1])


def plc(device, *arguments, status=0, seconds=60):
    done = subprocess.run([PROGRAM, device if isinstance(device, str) else device.url, *map(str, arguments)],
                          capture_output=True, text=True, timeout=seconds)
    assert done.returncode == status, done
    if status == 2:
        assert len(done.stderr.splitlines()) == 1
    return done.stdout if status == 0 else done.stderr


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out.json"


@pytest.mark.parametrize("kind", [TcpDevice, RtuDevice])
@pytest.mark.parametrize("size", [(4, 4), (7, 19), (20, 20), (50, 50)])
def test_the_file_is_what_the_registers_say(kind, size, out):
    registers = Registers()
    wanted = registers.envelope(3, *size)
    with kind(registers) as device:
        said = plc(device, "read", "-o", out)
    assert json.loads(out.read_text()) == wanted
    assert f"grid {size[0]} x {size[1]}" in said and "points 1234" in said and "coverage 87 %" in said
    counts = [struct.unpack(">H", pdu[3:5])[0] for pdu in device.requests]
    assert max(counts) <= 125
    functions = [pdu[0] for pdu in device.requests]
    assert all(a != b for a, b in zip(functions, functions[1:]))  # a late answer never looks like the next one's


def test_the_referee_reads_the_file(out, tmp_path):
    registers = Registers()
    registers.envelope(1, m=5, n=6, lsb=2.0 ** -10)
    with TcpDevice(registers) as device:
        plc(device, "read", "-o", out)
    points = tmp_path / "points.xyz"
    points.write_text("0 0 0\n")
    checked = subprocess.run([BUILD / "host" / "canopy", "check", out, points], capture_output=True, text=True)
    assert checked.returncode in (0, 1), checked.stderr  # a verdict, not a complaint about the file


@pytest.mark.parametrize("unit, scalar, meant", [
    (0.1, 1, 0.1), (1.0, 1, 1.0), (1e-6, 1, 1e-6), (0.003, 1, 0.003), (0.33333334, 1, 0.33333334),
    (1.0, 0, 1.0), (2.0 ** -20, 0, 2.0 ** -20), (0.1 * 2.0 ** -10, 0, 0.1 * 2.0 ** -10), (25.0, 0, 25.0)])
def test_the_unit_is_the_decimal_that_was_meant(unit, scalar, meant, out):
    registers = Registers()
    registers.envelope(1, unit=unit, scalar=scalar)
    with TcpDevice(registers) as device:
        plc(device, "read", "-o", out)
    assert json.loads(out.read_text())["unit"] == meant


@pytest.mark.parametrize("kind", [TcpDevice, RtuDevice])
def test_an_envelope_that_changes_is_never_mixed(kind, out):
    """A new one is published before each of the first requests, at every place of the read once."""
    registers = Registers()
    wanted = {1: registers.envelope(1, 20, 20)}

    def publish(device, number, _address):
        if number in (6, 9, 13, 18, 24, 31, 32, 33):
            sequence = max(wanted) + 1
            wanted[sequence] = registers.envelope(sequence, 20, 20, points=1234 + sequence)

    with kind(registers, publish) as device:
        said = json.loads(plc(device, "read", "--json", "-o", out))
    assert said["restarts"] >= 4
    assert json.loads(out.read_text()) == wanted[said["sequence"]] and said["sequence"] == max(wanted)


def test_an_envelope_that_never_stands_is_not_written(out):
    registers = Registers()
    registers.envelope(1, 20, 20)
    with TcpDevice(registers, lambda device, number, _: registers.envelope(number, 20, 20) and None) as device:
        assert "changed" in plc(device, "read", "-o", out, "--timeout", "0.5", status=1)
    assert not out.exists()


@pytest.mark.parametrize("kind", [TcpDevice, RtuDevice])
def test_broken_and_late_answers_change_nothing(kind, out):
    """Each fault at each request of a read, with an answer that comes while the next request waits."""
    registers = Registers()
    wanted = registers.envelope(9, 12, 20)
    faults = {TcpDevice: ["silent", 0.15, b"\x83\x04"], RtuDevice: ["silent", "crc", 0.15, 0.25]}[kind]
    for fault in faults:
        for at in range(1, 12):
            def once(_device, number, _address, fault=fault, at=at):
                if number != at:
                    return None
                return bytes([_device.requests[-1][0] | 0x80, 4]) if isinstance(fault, bytes) else fault

            with kind(registers, once) as device:
                plc(device, "read", "-o", out, "--answer-timeout", 100, "--timeout", 20)
            assert json.loads(out.read_text()) == wanted, (fault, at)
            out.unlink()


def test_an_answer_that_comes_while_the_next_request_waits_is_not_its_answer(out):
    """The first answer comes so late that it is taken for the repetition's; then that one's answers the next request."""
    registers = Registers()
    wanted = registers.envelope(9, 12, 20)
    for at in range(1, 11):
        late = {at: 0.15, at + 1: 0.06}
        with RtuDevice(registers, lambda _device, number, _address, late=late: late.get(number)) as device:
            plc(device, "read", "-o", out, "--answer-timeout", 100, "--timeout", 20)
        assert json.loads(out.read_text()) == wanted, at
        out.unlink()


def test_what_is_not_a_canopy_device_is_refused(out):
    cases = [("magic", 7, "no canopy device"), ("probe_u32", 0x56781234, "swaps words"),
             ("probe_f32", 2.0, "word order"), ("map_version", 99, "--map"),
             ("lsb", 0.3, "power of two"), ("unit", -1.0, "positive"),
             ("grid_m", 3, "3 x 19"), ("grid_m", 60000, "60000"), ("side", 2, "side 2"), ("pitch_v", 0, "pitch"),
             ("sequence", 0, "no envelope"), ("status", 3, "intrusion")]
    for name, value, complaint in cases:
        registers = Registers()
        registers.envelope(1)
        registers.put(name, value)
        with TcpDevice(registers) as device:
            assert complaint in plc(device, "read", "-o", out, "--timeout", "0.3", status=1), name
        assert not out.exists()
    with TcpDevice(registers) as device:
        plc(device, "read", "-o", out, "--any")
    assert out.exists()


def test_it_waits_for_points(out):
    registers = Registers()
    registers.envelope(1, points=10)

    def grow(_device, number, _address):
        if number == 20:
            registers.envelope(2, points=5000)

    with TcpDevice(registers, grow) as device:
        plc(device, "read", "-o", out, "--until-points", 5000, "--interval", "0.02", "--timeout", 20)
        assert json.loads(out.read_text())["certificate"]["points"] == 5000
        said = plc(device, "read", "-o", out, "--until-points", 5001, "--timeout", "0.3", status=1)
        assert "5000" in said and "5001" in said


def test_a_stale_envelope_is_read_and_called_so(out):
    registers = Registers()
    registers.envelope(1)
    registers.put("status", 4)
    with TcpDevice(registers) as device:
        assert "status stale" in plc(device, "read", "-o", out)


def test_another_map(out, tmp_path):
    moved = json.loads(json.dumps(MAP))
    moved["map_version"] = 77
    for item in moved["registers"]:
        item["address"] += 321
    path = tmp_path / "registers.json"
    path.write_text(json.dumps(moved))
    registers = Registers(moved)
    wanted = registers.envelope(4, 20, 20)
    with TcpDevice(registers) as device:
        plc(device, "read", "-o", out, "--map", path)
        assert json.loads(out.read_text()) == wanted
        out.unlink()
        for broken in ("{", "[]", "{}", json.dumps({**moved, "word_order": "CDAB"}),
                       json.dumps({**moved, "registers": [r for r in moved["registers"] if r["name"] != "lsb"]}),
                       json.dumps({**moved, "registers": [{**r, "address": r["address"] + (r["name"] == "block_3")}
                                                          for r in moved["registers"]]})):
            path.write_text(broken)
            assert str(path) in plc(device, "read", "-o", out, "--map", path, status=2)
    assert not out.exists()


def test_status(out):
    registers = Registers()
    registers.envelope(6, 20, 20)
    registers.put("rx_errors", 4)
    with RtuDevice(registers) as device:
        lines = dict(line.split(None, 1) for line in plc(device, "status").splitlines() if " " in line.strip())
        said = json.loads(plc(device, "status", "--json"))
    assert lines["magic"] == "434E5059" and lines["status"] == "valid" and lines["rx_errors"].strip() == "4"
    assert lines["unit"].strip() == "0.1" and lines["pitch_v"].split()[0] == "4000000000"
    assert lines["origin_z"].split()[0] == "-2147483648"
    assert said["sequence"] == 6 and said["origin_z"] == -2 ** 31 and said["pitch_v"] == 4000000000
    assert said["rx_errors"] == 4 and abs(said["unit"] - 0.1) < 1e-8 and said["status_text"] == "valid"


def test_watch():
    registers = Registers()
    registers.envelope(1, points=1)

    def grow(_device, number, _address):
        registers.put("heartbeat", number)
        if number == 12:
            registers.envelope(2, points=50)

    with TcpDevice(registers, grow) as device:
        lines = plc(device, "watch", "--json", "--until-points", 50, "--interval", "0.01", "--timeout", 20).splitlines()
        said = [json.loads(line) for line in lines]
        assert said[0]["points"] == 1 and said[-1]["points"] == 50 and len(said) >= 3
        beats = [line["heartbeat"] for line in said]
        assert beats == sorted(set(beats))
        assert len(plc(device, "watch", "--count", 3, "--interval", "0.01").splitlines()) == 3


def test_nobody_there(out):
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        url = f"tcp:127.0.0.1:{closed.getsockname()[1]}"
        plc(url, "read", "-o", out, "--timeout", "0.3", "--retries", 1, status=1)
    plc("rtu:/dev/no-such-line,9600,8E1,1", "status", "--retries", 0, status=1)
    ours, theirs = os.openpty()
    begin = time.monotonic()
    said = plc(f"rtu:{os.ttyname(theirs)},9600,8N1,1", "read", "-o", out, "--timeout", "0.5", "--answer-timeout", 50,
               "--retries", 2, status=1)
    assert "no answer" in said and time.monotonic() - begin < 5
    os.close(ours)
    os.close(theirs)
    assert not out.exists()


def test_wrong_usage_and_bad_input(out, tmp_path):
    for url in ("nowhere", "tcp:host", "rtu:", "rtu:x,17", "rtu:x,9600,9E1", "rtu:x,9600,8E1,0"):
        plc(url, "status", status=2)
    for wrong in (["frobnicate"], ["read"], [], ["read", "-o", "x", "extra"], ["status", "--gap", "x"], ["--nope"]):
        plc("tcp:127.0.0.1:1", *wrong, status=64)
    registers = Registers()
    registers.envelope(1)
    with TcpDevice(registers) as device:
        plc(device, "read", "-o", tmp_path / "no" / "such" / "directory.json", status=2)
