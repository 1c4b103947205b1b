#!/usr/bin/python3
"""The scene that boards/riscv_virt plays to itself, reading by reading, as the board's sweep.c has it.

Usage: tools/sweep.py READINGS OUT.xyz

Writes the first so many valid readings since the board's start, in the scene's unit, in the order in which the board
has them. Written anew from the description in boards/riscv_virt/sweep.h: what checks the board does not believe it.
"""

import itertools
import sys

COLUMNS, PROFILES = 160, 120
X_STEP, Y_STEP, UNIT = 25, 30, 0.1
WORD = 0xFFFFFFFF
SHADOW = 4
PARTS = [  # sweeps before it is there, column, profile, radius, height
    (0, 40, 30, 30, 900), (0, 115, 40, 40, 700), (0, 70, 90, 32, 1200), (1, 128, 92, 24, 1000), (3, 20, 75, 18, 600)]


def chance(i, j):
    h = (i * 0x9E3779B1 ^ j * 0x85EBCA77) & WORD
    h = (h ^ h >> 15) * 0x2C1B3C6D & WORD
    return h ^ h >> 13


def wave(at, half):
    return half - abs(at % (2 * half) - half)


def dome(part, i, j):
    _, ci, cj, radius, top = part
    left = radius ** 2 - (i - ci) ** 2 - (j - cj) ** 2
    return top * left // radius ** 2 if left > 0 else 0


def height(sweep, j, i):
    """Of column i of profile j in that sweep; None: no reading."""
    parts = [part for part in PARTS if part[0] <= sweep]
    if chance(i, j) % 61 == 0 or any(dome(part, i, j) == 0 < dome(part, i - SHADOW, j) for part in parts):
        return None
    floor = 100 + wave(3 * i + 2 * j, 97) + wave(7 * j + i, 160) + (chance(i, j) >> 28)
    return floor + max(dome(part, i, j) for part in parts)


def sweep_points(sweep):
    return [(X_STEP * i, Y_STEP * j, z) for j in range(PROFILES) for i in range(COLUMNS)
            if (z := height(sweep, j, i)) is not None]


def readings():
    """All valid ones since the start, in device units; without end."""
    settled, last = None, max(part[0] for part in PARTS)
    for sweep in itertools.count():
        if sweep <= last:
            settled = sweep_points(sweep)
        yield from settled


def first(count):
    return list(itertools.islice(readings(), count))


def write(count, path):
    """The first so many readings as a point file, in the scene's unit."""
    with open(path, "w", encoding="ascii") as to:
        for point in first(count):
            to.write(" ".join(f"{coordinate * UNIT:.17g}" for coordinate in point) + "\n")


def main():
    if len(sys.argv) != 3 or not sys.argv[1].isdigit():
        print("usage: tools/sweep.py READINGS OUT.xyz", file=sys.stderr)
        return 64
    try:
        write(int(sys.argv[1]), sys.argv[2])
    except OSError as error:
        print(f"{sys.argv[2]}: {error.strerror}: give a file that can be written", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
