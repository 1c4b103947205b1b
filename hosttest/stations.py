"""A station's firmware under way on an emulated board, its PLC, and its envelopes judged exactly: for every board's tests."""

import json
import math
import os
import subprocess
import time
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

from rtu import NoAnswer, Registers
from running import BUILD

ROOT = Path(__file__).resolve().parent.parent
VALID, INTRUSION, STALE = 1, 2, 4  # of `status`


def hills(count, columns, missing=lambda i, j: False):
    """A scene for rtu.Scanner: `count` profiles of `columns` heights."""
    def height(i, j):
        return round(3000 + 1500 * math.sin(i / 7) * math.cos(j / 5) + (900 if (i * 31 + j * 17) % 97 == 0 else 0))
    return [(250 * i - 4000, [None if missing(i, j) else height(i, j) for j in range(columns)]) for i in range(count)]


def weights(position, pitch, size):
    """The four coefficients of the uniform cubic B-spline at an integer position, and their weights times 6 pitch^3."""
    interval = min(position // pitch, size - 2)
    d, p = position - interval * pitch, pitch
    values = ((p - d) ** 3, 3 * d ** 3 - 6 * d * d * p + 4 * p ** 3,
              p ** 3 + 3 * d * p * p + 3 * d * d * p - 3 * d ** 3, d ** 3)
    return [(min(max(interval - 1 + k, 0), size - 1), value) for k, value in enumerate(values)]


def gaps(envelope, points):
    """S - z at every point, exactly, in device units."""
    m, n, lsb = envelope["grid_m"], envelope["grid_n"], Fraction(envelope["lsb"])
    pu, pv, b = envelope["pitch_u"], envelope["pitch_v"], envelope["coefficients"]
    whole = 36 * pu ** 3 * pv ** 3 * lsb.denominator
    u_weights = lru_cache(None)(lambda x: weights(x - envelope["origin_x"], pu, m))
    v_weights = lru_cache(None)(lambda y: weights(y - envelope["origin_y"], pv, n))
    found = []
    for x, y, z in points:
        v = v_weights(y)
        surface = sum(a * sum(c * b[i * n + j] for j, c in v) for i, a in u_weights(x))
        found.append(Fraction(surface * lsb.numerator, whole) + envelope["origin_z"] - z)
    return found


class Device:
    """What runs, and what its PLC reads of it."""

    def __init__(self, emulator, client):
        self.emulator, self.client = emulator, client
        self.registers = Registers(client, json.loads((BUILD / "registers.json").read_text()))

    def wait(self, name, condition, seconds=40, patient=False):
        """The register's value, once it is as it should be. Patiently: not every request needs an answer meanwhile."""
        end, value = time.monotonic() + seconds, None
        while True:
            try:
                value = self.registers[name]
                if condition(value):
                    return value
            except NoAnswer:
                if not patient:
                    raise
            assert time.monotonic() < end, f"{name} stays {value}"
            time.sleep(0.02)

    def close(self):
        self.emulator.close()


def symbol(image, name):
    """An address in an image, build/<board>/<name>.elf."""
    prefix = "riscv64-unknown-elf-" if image.parent.name.startswith("riscv") else "arm-none-eabi-"
    table = subprocess.run([prefix + "nm", image], check=True, capture_output=True, text=True).stdout
    return next(int(row.split()[0], 16) for row in table.splitlines() if row.split()[-1] == name)


def check_stack(device, image):
    """What has been used of the stack (at start it is filled with a pattern) is within what the call graph says, and the
    device knows it."""
    scratch = device.emulator.scratch
    subprocess.run(["/usr/bin/python3", ROOT / "tools/stack.py", "--calls", ROOT / "tools/calls.txt", "--json",
                    scratch / "stack.json", image], cwd=ROOT, check=True, capture_output=True)
    computed = json.loads((scratch / "stack.json").read_text())[image.stem]["worst"]
    limit, top = symbol(image, "canopy_stack_limit"), symbol(image, "canopy_stack_top")
    used = len(device.emulator.memory(limit, top - limit).lstrip(b"\xc5"))
    print(f"stack: used {used}, computed {computed}")
    assert 300 < used <= computed
    assert device.registers["stack_unused"] == (top - limit - used) // 4 * 4


def processor_seconds(device, seconds):
    """What the emulator takes of the host's processor meanwhile: next to nothing where the program waits for interrupts."""
    def taken():
        words = Path(f"/proc/{device.emulator.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    before = taken()
    time.sleep(seconds)
    return taken() - before
