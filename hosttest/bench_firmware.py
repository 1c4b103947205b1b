#!/usr/bin/python3
"""Counts instructions on the emulated board: runs images that print `name value` lines, repeatably.

Usage: hosttest/bench_firmware.py [--json FILE] IMAGE.elf...

QEMU runs each image with -icount shift=0: an instruction is one nanosecond of virtual time, and the image reads it from
its clock with canopy_board_instructions() (port/board.h), on the MPS2 boards 40 instructions a tick. Two runs give the same
numbers.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tools"))
import emulator  # noqa: E402  (of tools/)


def count(image, seconds=300):
    """The results of one image, build/<board>/*.elf, as {name: value}. Raises if the image fails or prints nothing."""
    image = Path(image)
    done = subprocess.run(emulator.argv(image.parent.name, image, counting=True), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, timeout=seconds, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{image}: exit status {done.returncode}\n{done.stdout}")
    rows = [line.split() for line in done.stdout.splitlines()]
    results = {row[0]: int(row[1]) for row in rows if len(row) == 2}
    if not results:
        raise RuntimeError(f"{image}: printed no result\n{done.stdout}")
    return results


# Unit 1, on the RP2040's line 0: the eight registers of the live group
REQUEST, PLC_LINE = "01030064000805d3", 0


def boot(image, seconds=60):
    """Instructions of the station from reset to the first answer it can give a PLC. On QEMU's boards to its first step,
    counted in a trace, and the request's own are the caller's to add; the RP2040's emulator asks and counts both."""
    image = Path(image)
    board = image.parent.name
    if board == "rp2040_pico":
        command = [*emulator.argv(board, image, ["null"] * 3), "--ask", f"{PLC_LINE}:{REQUEST}", "--limit", "5"]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=seconds, text=True)
        found = re.search(r"^instructions (\d+)$", done.stdout, re.M)
        if not found:
            raise RuntimeError(f"{image}: no answer\n{done.stdout}")
        return int(found.group(1)), True
    with tempfile.TemporaryDirectory() as scratch:
        trace = Path(scratch) / "trace"
        command = [*emulator.argv(board, image, counting=True), "-singlestep", "-d", "exec,nochain", "-D", str(trace)]
        with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as run:
            try:
                if b"starts" not in run.stdout.readline():
                    raise RuntimeError(f"{image}: does not start")
                time.sleep(0.5)
            finally:
                run.terminate()  # so that it writes its log to the end
        return executed_until(trace, address_of(image, "canopy_device_step")), False


def executed_until(trace, address):
    """Lines of QEMU's log, one an instruction, before the first at an address."""
    count = 0
    with open(trace, encoding="utf-8", errors="replace") as log:
        for row in log:
            found = re.match(r"Trace \d+: \S+ \[[0-9a-f]+/([0-9a-f]+)/", row)
            if found and int(found.group(1), 16) == address:
                return count
            count += found is not None
    raise RuntimeError(f"{address:#x} was not reached")


def address_of(image, function):
    """Of a function of the image, without a Thumb function's lowest bit."""
    symbols = subprocess.run(["nm", str(image)], check=True, stdout=subprocess.PIPE, text=True).stdout
    return int(re.search(rf"^([0-9a-f]+) T {function}$", symbols, re.M).group(1), 16) & ~1


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", help="write all results there too")
    parser.add_argument("images", nargs="+")
    arguments = parser.parse_args()
    results = {}
    for image in arguments.images:
        for name, value in count(image).items():
            print(f"{name:40} {value:14,}")
            results[name] = value
    if arguments.json:
        with open(arguments.json, "w", encoding="utf-8") as file:
            json.dump(results, file, indent=1)
            file.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
