#!/usr/bin/python3
"""Counts instructions on the emulated board: runs images that print `name value` lines, repeatably.

Usage: hosttest/bench_firmware.py [--json FILE] IMAGE.elf...

QEMU runs each image with -icount shift=0: an instruction is one nanosecond of virtual time, and the image reads it from
SysTick with canopy_instructions() (port/cortexm/count.h), 40 instructions a tick. Two runs give the same numbers.
"""

import argparse
import json
import subprocess
import sys

QEMU = ["qemu-system-arm", "-M", "mps2-an385", "-display", "none", "-monitor", "none", "-serial", "null", "-serial", "null",
        "-serial", "stdio", "-semihosting-config", "enable=on,target=native", "-icount", "shift=0", "-kernel"]


def count(image, seconds=300):
    """The results of one image as {name: value}. Raises if the image fails or prints nothing."""
    done = subprocess.run(QEMU + [str(image)], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
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
