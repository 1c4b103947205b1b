#!/usr/bin/python3
"""The rules of the house that no compiler checks. Usage: tools/rules.py [--archive libcanopy.a]

lib/ includes only what stands below and a handful of freestanding headers; it has no heap, no I/O, no assertion, no name
without the prefix and (read from the compiled archive) no data that changes. Ports, boards, tools and tests are held to
their places too.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# A room of lib/ may include itself and whatever stands on a lower floor. Rooms of one floor do not know each other.
FLOORS = [{"."}, {"num"}, {"spline"}, {"cover", "rbf"}, {"scan", "modbus"}, {"plc"}, {"station"}]
FREESTANDING = {"stdint.h", "stddef.h", "stdbool.h", "string.h", "limits.h", "float.h"}
COLUMNS = 120  # of comments too, which clang-format leaves alone
FLOAT_ONLY = {"math.h"}
FORBIDDEN = re.compile(r"\b(malloc|calloc|realloc|free|alloca|printf|fprintf|snprintf|sprintf|puts|fopen|exit|abort|assert|"
                       r"setjmp|longjmp|errno|time|rand|qsort)\s*\(")
# Where else files may include from, besides their own directory and system headers.
PLACES = {
    "port": ("lib/", "port/", "board.h"),
    "boards": ("lib/", "port/", "boards/", "tools/common/"),
    "tools": ("lib/", "tools/", "port/linux/"),
    "hosttest": ("lib/", "tools/", "port/", "boards/", "hosttest/", "board.h"),
}


def floor_of(room):
    for number, rooms in enumerate(FLOORS):
        if room in rooms:
            return number
    return None


def without_comments(text):
    """The text with comments and strings blanked, line by line."""
    def blank(match):
        return re.sub(r"[^\n]", " ", match.group(0))
    return re.sub(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"', blank, text, flags=re.S)


def includes(text):
    for number, line in enumerate(text.splitlines(), 1):
        found = re.match(r'\s*#\s*include\s+([<"])([^>"]+)[>"]', line)
        if found:
            yield number, found.group(1) == "<", found.group(2)


def check_library_include(path, system, name):
    parts = path.relative_to(ROOT).parts
    room = parts[1] if len(parts) > 2 else "."
    if system:
        if name in FREESTANDING or (name in FLOAT_ONLY and "f32" in path.name):
            return None
        return f"<{name}> is not for lib/: {', '.join(sorted(FREESTANDING))}, and math.h in *_f32 alone"
    if "/" not in name:
        return None if name.startswith("canopy_") else f'"{name}": write it from the top, "lib/..."'
    if not name.startswith("lib/"):
        return f'"{name}": lib/ knows only lib/'
    other = name.split("/")[1] if name.count("/") > 1 else "."
    if other == room:
        return None
    mine, theirs = floor_of(room), floor_of(other)
    if mine is None or theirs is None:
        return f"the room {room if mine is None else other} has no floor in tools/rules.py"
    if theirs >= mine:
        return f'"{name}": {other} does not stand below {room}'
    return None


def check_place(path, name):
    top = path.relative_to(ROOT).parts[0]
    if "/" not in name and (path.parent / name).exists():
        return f'"{name}": write it from the top, "{path.parent.relative_to(ROOT)}/{name}"'
    allowed = PLACES[top]
    if name.startswith(allowed) or name.startswith("canopy_"):
        return None
    return f'"{name}": {top}/ may include {", ".join(allowed)}'


def check_file(path):
    text = path.read_text()
    in_library = path.relative_to(ROOT).parts[0] == "lib"
    for number, system, name in includes(text):
        wrong = check_library_include(path, system, name) if in_library else None if system else check_place(path, name)
        if wrong:
            yield number, wrong
    lines = text.splitlines()
    for number, line in enumerate(without_comments(text).splitlines(), 1):
        found = FORBIDDEN.search(line) if in_library else None
        if found:
            yield number, f"{found.group(1)} is not for lib/"
        if re.search(r"\b(TODO|FIXME|XXX)\b", lines[number - 1]):
            yield number, "unfinished"
        if len(lines[number - 1]) > COLUMNS:
            yield number, f"more than {COLUMNS} columns"


def check_script(path):
    """What the columns and words of a C file are held to, for JavaScript."""
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if re.search(r"\b(TODO|FIXME|XXX)\b", line):
            yield number, "unfinished"
        if len(line) > COLUMNS:
            yield number, f"more than {COLUMNS} columns"


def check_guard(path):
    """A header has a guard that starts with CANOPY_."""
    text = path.read_text()
    guard = re.search(r"^#ifndef (\w+)\n#define (\w+)", text, re.M)
    if not guard or guard.group(1) != guard.group(2) or not guard.group(1).startswith("CANOPY_"):
        yield 1, "no include guard CANOPY_..."


def check_archive(archive):
    """Symbols of the compiled library: prefixed, and nothing in .data or .bss."""
    rows = subprocess.run(["arm-none-eabi-nm", "-A", str(archive)], check=True, capture_output=True, text=True).stdout
    for row in rows.splitlines():
        words = row.split()
        if len(words) < 3:
            continue
        where, kind, name = words[0].rsplit(":", 1)[0], words[-2], words[-1]
        if kind in "dDbBC":
            yield f"{where}: {name} changes while the program runs: lib/ has no globals"
        elif kind in "TRVW" and not name.startswith("canopy_"):
            yield f"{where}: {name} has no prefix canopy_"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--archive", type=Path, help="the library, compiled for the device")
    arguments = parser.parse_args()
    files = [path for top in ("lib", *PLACES) for path in sorted((ROOT / top).rglob("*"))
             if path.suffix in (".c", ".h", ".inc")]
    scripts = [path for top in PLACES for path in sorted((ROOT / top).rglob("*.mjs"))]
    found = [f"{path.relative_to(ROOT)}:{number}: {wrong}" for path in scripts for number, wrong in check_script(path)]
    for path in files:
        checks = list(check_file(path)) + (list(check_guard(path)) if path.suffix == ".h" else [])
        found += [f"{path.relative_to(ROOT)}:{number}: {wrong}" for number, wrong in checks]
    if arguments.archive:
        found += list(check_archive(arguments.archive))
    for line in found:
        print(line)
    print(f"rules: {len(files) + len(scripts)} files, {len(found)} breaches")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
