#!/usr/bin/python3
"""Counts instructions on the emulated board: runs images that print `name value` lines, repeatably.

Usage: hosttest/bench_firmware.py [--json FILE] IMAGE.elf...

QEMU runs each image with -icount shift=0: an instruction is one nanosecond of virtual time, and the image reads it from
its clock with canopy_board_instructions() (port/board.h), on the MPS2 boards 40 instructions a tick. Two runs give the same
numbers.
"""

import argparse
import json
import subprocess
import sys
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
