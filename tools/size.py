#!/usr/bin/python3
"""Flash and RAM of firmware images, by section, by room and by object, from the linker's maps.

Usage: tools/size.py [--json FILE] IMAGE.map...

RAM is static and includes the stack that the linker script reserves; there is no heap. tools/budget.py holds the sums to
their budgets.
"""

import argparse
import json
import re
import sys
from collections import defaultdict
from pathlib import Path

FLASH = {".boot2", ".boot2_check", ".text", ".ARM.exidx", ".data", ".flash_crc"}
RAM = {".stack", ".data", ".bss", ".noinit"}
OUTPUT = re.compile(r"^(\.\S+)(?:\s+0x([0-9a-f]+)\s+0x([0-9a-f]+))?")
INPUT = re.compile(r"^ (?:(\.\S+|COMMON)\s+)?0x([0-9a-f]+)\s+0x([0-9a-f]+) (\S.*)$")


def joined(lines):
    """The map breaks a line after a long section name: join them again."""
    held = ""
    for line in lines:
        line = line.rstrip("\n")
        if re.fullmatch(r" ?[.\w$*]\S*", line):
            held = line
            continue
        yield (held + " " + line.lstrip() if held and line.startswith("  ") else line)
        held = ""


def owner(path):
    """lib/num/band_fx.c of an object's path below the build directory; the archive of anything foreign."""
    ours = re.search(r"(?:/obj/|\()((?:lib|port|boards|hosttest|gen)/\S+)\.o", path)
    if ours:
        return ours.group(1)
    member = re.search(r"([^/(]+)\.a\((\S+)\.o\)", path)
    if member:
        return f"{member.group(1)}:{member.group(2)}"
    return Path(path).stem


def read(path):
    """{section: bytes} and {owner: {section: bytes}} of a map."""
    text = path.read_text(errors="replace")
    lines = text[text.index("Linker script and memory map"):].splitlines()
    sections, owners, section = {}, defaultdict(lambda: defaultdict(int)), None
    for line in joined(lines):
        output = OUTPUT.match(line)
        if output:
            section = output.group(1)
            if output.group(3) and section in FLASH | RAM:
                sections[section] = int(output.group(3), 16)
            continue
        found = INPUT.match(line)
        if found and section in FLASH | RAM and int(found.group(3), 16) and not found.group(4).startswith("PROVIDE"):
            if found.group(4).endswith((".o", ".o)")):
                owners[owner(found.group(4))][section] += int(found.group(3), 16)
    return sections, owners


def name_objects(owners, archive_members):
    """Members of libcanopy.a are named by their file alone: give them their place back."""
    named = defaultdict(lambda: defaultdict(int))
    for name, parts in owners.items():
        for section, size in parts.items():
            named[archive_members.get(name, name)][section] += size
    return named


def members_of(build):
    """libcanopy:band_fx -> lib/num/band_fx, by the objects that lie in the build directory."""
    lib = build / "obj" / "lib"
    return {f"libcanopy:{path.stem}": f"lib/{path.relative_to(lib).with_suffix('')}" for path in lib.rglob("*.o")}


def room(name):
    parts = name.split("/")
    return "/".join(parts[:2]) if len(parts) > 2 else parts[0].split(":")[0]


def total(parts, kind):
    return sum(size for section, size in parts.items() if section in kind)


def table(title, rows):
    print(f"  {title:44} {'flash':>8} {'ram':>8}")
    for name, flash, ram in sorted(rows, key=lambda row: (-row[1], -row[2], row[0])):
        print(f"    {name:42} {flash:8} {ram:8}")


def report(path):
    sections, owners = read(path)
    owners = name_objects(owners, members_of(path.parent))
    flash, ram = total(sections, FLASH), total(sections, RAM)
    print(f"{path.stem}: flash {flash}, ram {ram} of which stack {sections.get('.stack', 0)}")
    print("  " + ", ".join(f"{name} {size}" for name, size in sections.items()))
    rooms = defaultdict(lambda: [0, 0])
    for name, parts in owners.items():
        rooms[room(name)][0] += total(parts, FLASH)
        rooms[room(name)][1] += total(parts, RAM)
    table("by room", [(name, *sizes) for name, sizes in rooms.items()])
    table("by object", [(name, total(parts, FLASH), total(parts, RAM)) for name, parts in owners.items()])
    result = {"flash": flash, "ram": ram, "sections": sections,
              "objects": {name: {"flash": total(parts, FLASH), "ram": total(parts, RAM)} for name, parts in owners.items()}}
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the same there")
    parser.add_argument("maps", nargs="*", type=Path)
    arguments = parser.parse_args()
    results = {path.stem: report(path) for path in arguments.maps}
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
