"""Modbus RTU over a socket, for tests against firmware: a client, and a profile scanner with the generic map.

Small on purpose and independent of canopy's own engines: tests must not believe the code they test.
"""

import struct
import threading
import time


def crc(data):
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return struct.pack("<H", value)


def frame(unit, pdu):
    body = bytes([unit]) + pdu
    return body + crc(body)


class NoAnswer(Exception):
    pass


class Client:
    """One request at a time; answers are found by their length and CRC."""

    def __init__(self, line, unit=1, timeout=2.0):
        self.line, self.unit, self.timeout = line, unit, timeout

    def exchange(self, pdu, answer_length):
        time.sleep(0.003)  # T3.5
        self.line.sendall(frame(self.unit, pdu))
        self.line.settimeout(self.timeout)
        got, wanted = b"", answer_length + 3
        try:
            while len(got) < wanted:
                got += self.line.recv(512)
                if len(got) >= 5 and got[1] & 0x80:
                    wanted = 5
        except TimeoutError as late:
            raise NoAnswer(f"{len(got)} of {wanted} bytes") from late
        assert crc(got[:-2]) == got[-2:] and got[0] == self.unit
        return got[1:-2]

    def read(self, address, count, function=3):
        """`count` registers as bytes; an exception is an AssertionError that shows it."""
        pdu = self.exchange(struct.pack(">BHH", function, address, count), 2 + 2 * count)
        assert pdu[:2] == bytes([function, 2 * count]), pdu.hex()
        return pdu[2:]

    def write(self, address, values):
        pdu = struct.pack(">BHHB", 16, address, len(values), 2 * len(values)) + struct.pack(f">{len(values)}H", *values)
        return self.exchange(pdu, 5)


FORMATS = {"u16": ">H", "u32": ">I", "i32": ">i", "f32": ">f"}


class Patient(Client):
    """Asks again, as PLCs do: a busy host may hold the board up in the middle of a frame, and then that is silence."""

    def __init__(self, line, unit=1, timeout=2.0):
        super().__init__(line, unit, timeout)
        self.asked = self.again = 0

    def exchange(self, pdu, answer_length):
        self.asked += 1
        for _ in range(2):
            try:
                return super().exchange(pdu, answer_length)
            except NoAnswer:
                self.again += 1
                time.sleep(0.05)
        return super().exchange(pdu, answer_length)


class Registers:
    """Reads by name, by the table of build/registers.json."""

    def __init__(self, client, table):
        self.client, self.table = client, {entry["name"]: entry for entry in table["registers"]}

    def __getitem__(self, name):
        entry = self.table[name]
        return struct.unpack(FORMATS[entry["type"]], self.client.read(entry["address"], entry["words"]))[0]

    def envelope(self):
        """A consistent envelope: everything from `sequence` on, in one hold."""
        first, last = self.table["sequence"]["address"], self.table["coverage_count"]["address"]
        header = self.client.read(first, last - first + 1)
        values = {name: struct.unpack(FORMATS[entry["type"]], header[2 * (entry["address"] - first):][:2 * entry["words"]])[0]
                  for name, entry in self.table.items() if first <= entry["address"] <= last}
        coefficients = []
        count = values["grid_m"] * values["grid_n"]
        for k in range(values["block_count"]):
            words = 2 + 2 * min(61, count - 61 * k)
            block = self.client.read(self.table[f"block_{k}"]["address"], words)
            sequence, *rest = struct.unpack(f">I{words // 2 - 1}i", block)
            assert sequence == values["sequence"], "a block of another envelope"
            coefficients += rest
        values["coefficients"] = coefficients
        return values


class Scanner(threading.Thread):
    """Serves profiles {y: [height or None]} on the generic map. The next profile comes when this one has been read to its
    last register. `mischief` may change or swallow a reply: bytes in, bytes or None out."""

    INVALID = 0xFFFF

    def __init__(self, line, profiles, x_start=0, x_step=100, z_step=1, unit=1, mischief=None):
        super().__init__(daemon=True)
        self.line, self.unit, self.profiles, self.mischief = line, unit, profiles, mischief or (lambda reply: reply)
        self.sequence, self.requests, self.running = 1, 0, True
        self.read_whole = False
        self.limit = len(profiles)  # the last profile that may come
        self.x = [x_start + x_step * i for i in range(len(profiles[0][1]))]
        heights = [z for _, row in profiles for z in row if z is not None]
        low = (min(self.x), min(y for y, _ in profiles), min(heights) * z_step)
        high = (max(self.x), max(y for y, _ in profiles), max(heights) * z_step)
        self.description = struct.pack(">IHHHHiiiHHiiiiiif", 0x434E5053, 1, 7, len(self.x), len(profiles), x_start, x_step, 0,
                                       z_step, 0, *low, *high, 1.0)
        self.z_step = z_step

    def points(self, count=None):
        """The readings of the first `count` profiles, in device units."""
        return [(x, y, z * self.z_step) for y, row in self.profiles[:count] for x, z in zip(self.x, row) if z is not None]

    def profile(self):
        y, row = self.profiles[self.sequence - 1]
        valid = sum(z is not None for z in row)
        words = [self.INVALID if z is None else z for z in row]
        return struct.pack(f">HHiH{len(words)}HH", self.sequence, 7, y, valid, *words, self.sequence)

    def answer(self, pdu):
        function, address, count = struct.unpack(">BHH", pdu)
        if address == 64 and self.read_whole and self.sequence < self.limit:
            self.sequence, self.read_whole = self.sequence + 1, False
        start, data = (0, self.description) if address < 64 else (64, self.profile())
        at = 2 * (address - start)
        if function not in (3, 4) or at + 2 * count > len(data):
            return bytes([function | 0x80, 2])
        self.read_whole = self.read_whole or address >= 64 and at + 2 * count == len(data)
        return bytes([function, 2 * count]) + data[at:at + 2 * count]

    def run(self):
        got = b""
        while self.running:
            self.line.settimeout(0.2)
            try:
                got += self.line.recv(256)
            except (TimeoutError, OSError):
                got = b""
                continue
            while len(got) >= 8:
                request, got = got[:8], got[8:]
                assert crc(request[:6]) == request[6:], request.hex()
                self.requests += 1
                reply = self.mischief(frame(self.unit, self.answer(request[1:6])))
                if reply is not None:
                    time.sleep(0.002)
                    self.line.sendall(reply)
