#!/usr/bin/python3
"""Worst-case stack of firmware images, from the compiler's call graph.

Usage: tools/stack.py --calls tools/calls.txt [--json FILE] IMAGE.elf...

Frames and calls come from the .ci files that GCC leaves beside the objects (-fcallgraph-info=su); which objects are in an
image says the linker's map beside it. Functions without one (the C library's, assembly) are read from the disassembly.
Calls through pointers are resolved by the table of --calls; one that the table does not know is an error, and so are
recursion and frames of unknown size. From reset the deepest path is followed; on top of it come one interrupt (all have
one priority, so they do not nest) and the fault or watchdog exception, each with what the processor pushes. The exit
status is 1 when a stack does not fit the linker's.
"""

import argparse
import json
import re
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

class Arm:
    """What an image of a Cortex-M looks like, disassembled."""

    TOOLS = "arm-none-eabi-"
    PUSH = re.compile(r"\t(v?)(?:push|stmdb\s+sp!,|push\.w)\s*\{(.*?)\}")
    GROW = (re.compile(r"\tsub(?:\.w|w)?\tsp, (?:sp, )?#(\d+)"), re.compile(r"\tstr(?:d)?(?:\.w)?\t.*\[sp, #-(\d+)\]!"))
    POINTER = re.compile(r"\tblx\t(?:r\d+|ip|lr)")
    JUMP = re.compile(r"\t(?:blx?|b(?:eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?)(?:\.[nw])?\t[0-9a-f]+ <([^>+]+)>")

    @staticmethod
    def grows(row):
        """Bytes that an instruction takes from the stack."""
        push = Arm.PUSH.search(row)
        pushed = 4 * sum(registers(part) for part in push.group(2).split(",")) if push else 0
        pushed *= 2 if push and push.group(1) and "d" in push.group(2) else 1
        return pushed + sum(int(found.group(1)) for pattern in Arm.GROW if (found := pattern.search(row)))

    @staticmethod
    def pushed(image):
        """By the processor at an exception: eight words, room for 18 of a floating-point unit that the program may use
        (whether it is filled at once or later), and one to align."""
        return 108 if "Tag_FP_arch" in image.run("readelf", "-A", str(image.path)) else 36

    @staticmethod
    def entries(image):
        """What can interrupt, without reset, from the vector table: [(label, functions, whether the deepest of them
        with all they call, or their own frames one upon the other)]."""
        dump = image.run("objdump", "-s", "-j", ".text", f"--start-address={image.symbols['vectors']:#x}",
                         f"--stop-address={image.symbols['vectors'] + 4 * 48:#x}", str(image.path))
        words = []
        for row in dump.splitlines():
            found = re.match(r"^ [0-9a-f]+((?: [0-9a-f]{8}){1,4})", row)
            if found:
                words += [int.from_bytes(bytes.fromhex(word), "little") for word in found.group(1).split()]
        names = [min(image.by_address.get(word & ~1, {"?"})) for word in words]
        return [("interrupt", set(names[15:]) - {"?"}, True), ("fault or watchdog", set(names[2:15]) - {"?"}, True)]


class RiscV:
    """What an image for RV32 looks like. There the entry pushes, not the processor; one entry is for everything."""

    TOOLS = "riscv64-unknown-elf-"
    GROW = re.compile(r"\tadd(?:i|i16sp)?\tsp,sp,-(\d+)")
    POINTER = re.compile(r"\t(?:jalr|jr)\t(?!.*<)")
    JUMP = re.compile(r"\t(?:j|jal|call|tail|jalr|jr|b\w+)\t.*<([^>+]+)>")

    @staticmethod
    def grows(row):
        found = RiscV.GROW.search(row)
        return int(found.group(1)) if found else 0

    @staticmethod
    def pushed(_):
        return 0  # the entry does it

    @staticmethod
    def entries(image):
        """An interrupt that ends as a crash is the entry's deepest path; a fault may come on top of it, and on that a
        character for a debugger that is not there."""
        record, take = "port/riscv/trap.c:record_crash", "port/riscv/trap.c:take_trap"
        return [("interrupt", {"canopy_trap_entry"}, True), ("fault", {record}, True),
                ("breakpoint of semihosting", {"canopy_trap_entry", take}, False)]


MACHINES = {40: Arm, 243: RiscV}  # e_machine of the ELF header


class Problem(Exception):
    """Something that makes the sum meaningless: shown to the user as it is."""


class Graph:
    """frames: {title: bytes}; edges: {title: set of titles}; pointers: {title: set of source places}."""

    def __init__(self, image):
        self.frames, self.edges, self.pointers, self.problems = {}, {}, {}, []
        for path in linked_objects(image.with_suffix(".map")):
            self.read(path.with_suffix(".ci").read_text())

    def read(self, text):
        for title, label, outside in re.findall(r'^node: \{ title: "(.*?)" label: "(.*?)"( shape : ellipse)? \}', text, re.M):
            if outside:
                continue
            size = re.search(r"(\d+) bytes \((\w+(?:,\w+)?)\)", label)
            if not size:
                continue
            self.frames[title] = int(size.group(1))
            if size.group(2) not in ("static", "dynamic,bounded"):
                self.problems.append(f"{title}: frame of unknown size ({size.group(2)})")
        for source, target, place in re.findall(
                r'^edge: \{ sourcename: "(.*?)" targetname: "(.*?)"(?: label: "(.*?)")? \}', text, re.M):
            if target == "__indirect_call":
                self.pointers.setdefault(source, set()).add(place)
            else:
                self.edges.setdefault(source, set()).add(target)


def linked_objects(link_map):
    """The objects that the linker took for an image, also from its archive, which is thin."""
    text = link_map.read_text(errors="replace")
    paths = {Path(name) for name in re.findall(r"(\S+/obj/\S+\.o)\b", text)}
    return sorted(path for path in paths if path.with_suffix(".ci").exists())


class Table:
    """tools/calls.txt: what a call through a pointer may reach."""

    def __init__(self, path):
        self.calls, self.asm, self.outside, self.used = [], {}, {}, set()
        for number, line in enumerate(path.read_text().splitlines(), 1):
            words = line.split("#")[0].split()
            if not words:
                continue
            if len(words) >= 3 and words[0] == "call" and words[2] == "->":
                where, _, name = words[1].rpartition(":")
                self.calls.append((where, name, words[3:]))
            elif len(words) >= 3 and words[0] == "asm" and words[2] == "->":
                self.asm[words[1]] = words[3:]
            elif len(words) == 3 and words[0] == "outside" and words[2].isdecimal():
                self.outside[words[1]] = int(words[2])
            else:
                raise Problem(f"{path}:{number}: not 'call [file:]name -> function...', 'asm function -> function...' or "
                              "'outside function bytes'")

    def targets(self, place):
        """Functions that the call at file:line:column may reach."""
        file, line, column = place.rsplit(":", 2)
        names = called_names(Path(file), int(line), int(column))
        file = file.removeprefix("./")
        return [target for name in names for target in self.targets_of(file, line, name)]

    def targets_of(self, file, line, name):
        for where, callback, targets in self.calls:
            if callback == name and where in ("", file):
                return targets
        raise Problem(f"{file}:{line}: call through '{name}': tools/calls.txt does not say what it reaches")


@lru_cache(None)
def source_lines(path):
    return path.read_text().splitlines()


def called_names(path, line, column):
    """Members called in the statement that GCC places at line:column; without any, the first name called."""
    lines = source_lines(path)[line - 1:line + 8]
    statement = "\n".join([lines[0][column - 1:], *lines[1:]]).split(";")[0]
    names = re.findall(r"(?:->|\.)\s*(\w+)(?:\[[^\]]*\])?\s*\(", statement) or re.findall(r"(\w+)\W*\(", statement)[:1]
    if not names:
        raise Problem(f"{path}:{line}:{column}: no call found there")
    return sorted(set(names))


class Image:
    """Symbols and disassembly of a linked image."""

    def __init__(self, path):
        self.path = path
        self.machine = MACHINES[int.from_bytes(path.read_bytes()[18:20], "little")]
        self.symbols, self.by_address, self.ends = {}, {}, {}
        for row in self.run("nm", "-S", str(path)).splitlines():
            *place, kind, name = row.split()
            if not place:
                continue
            start = int(place[0], 16)
            self.symbols.setdefault(name, start)
            if kind in "tTwW":
                self.by_address.setdefault(start & ~1, set()).add(name)
                if len(place) == 2:
                    self.ends[name] = (start & ~1) + int(place[1], 16)

    def run(self, tool, *arguments):
        return subprocess.run([self.machine.TOOLS + tool, *arguments], check=True, capture_output=True, text=True).stdout

    @lru_cache(None)
    def disassembled(self):
        """{name: (frame bytes, called names)} for every function, from its instructions. Constants behind the last function
        are disassembled, too: what lies beyond a function's size is none of it."""
        functions, name = {}, None
        for row in self.run("objdump", "-d", "--no-show-raw-insn", str(self.path)).splitlines():
            start = re.match(r"^[0-9a-f]+ <(\S+)>:$", row)
            if start:
                name = start.group(1)
                functions[name] = [0, set()]
            elif name and not self.is_beyond(name, row):
                self.take(functions[name], name, row)
        return functions

    def is_beyond(self, name, row):
        place = re.match(r"^\s*([0-9a-f]+):\t", row)
        return bool(place) and int(place.group(1), 16) >= self.ends.get(name, 1 << 64)

    def instructions(self, name):
        """The same for one function; the disassembly knows only one of the names of an address."""
        functions = self.disassembled()
        aliases = self.by_address.get(self.symbols.get(name, -1) & ~1, set())
        return next((functions[alias] for alias in [name, *sorted(aliases)] if alias in functions), None)

    def take(self, function, name, row):
        function[0] += self.machine.grows(row)
        if self.machine.POINTER.search(row):
            function[1].add("a pointer")
        jump = self.machine.JUMP.search(row)
        if jump and jump.group(1) != name:
            function[1].add(jump.group(1))


def registers(part):
    part = part.strip()
    if "-" in part:
        low, high = (int(name.strip().lstrip("rsd")) for name in part.split("-"))
        return high - low + 1
    return 1


class Stack:
    """The deepest path from any function of one image."""

    def __init__(self, image, graph, table):
        self.image, self.graph, self.table, self.known, self.active = image, graph, table, {}, []
        self.short = {}
        for title in graph.frames:
            self.short.setdefault(title.split(":")[-1], []).append(title)

    def resolve(self, name):
        """A title from a name in the table or in the image."""
        if name in self.graph.frames:
            return name
        titles = [title for title in self.short.get(name, [])]
        if len(titles) > 1:
            raise Problem(f"'{name}' is more than one function: name it as file:{name}, one of {', '.join(titles)}")
        return titles[0] if titles else name

    def frame_and_calls(self, title):
        if title in self.table.outside:
            return self.table.outside[title], set()
        if title not in self.graph.frames:
            found = self.image.instructions(title.split(":")[-1])
            if found is None:
                raise Problem(f"{title}: neither in the call graph nor in the image")
            if "a pointer" in found[1] and title not in self.table.asm:
                raise Problem(f"{title}: calls through a pointer and has no call graph: give it an 'asm' line")
            calls = (found[1] - {"a pointer"}) | set(self.table.asm.get(title, ()))
            return found[0], {self.resolve(name) for name in calls}
        calls = set(self.graph.edges.get(title, ()))
        for place in self.graph.pointers.get(title, ()):
            calls |= {self.resolve(name) for name in self.table.targets(place)}
        if title not in self.table.asm:
            return self.graph.frames[title], calls
        # The compiler does not see what assembly pushes
        pushed = self.image.instructions(title.split(":")[-1])[0]
        return max(self.graph.frames[title], pushed), calls | {self.resolve(name) for name in self.table.asm[title]}

    def is_linked(self, title):
        """Targets of the table that are not in this image cannot be reached. Inlined ones have no symbol and no caller."""
        if ":" in title and title not in self.graph.frames:
            return False  # of a file that is not linked, whatever else has that name
        return title in self.table.outside or title.split(":")[-1] in self.image.symbols

    def deepest(self, title):
        """(bytes, path) of the deepest chain of calls from a function, its own frame included."""
        if title in self.known:
            return self.known[title]
        if title in self.active:
            loop = self.active[self.active.index(title):] + [title]
            raise Problem("recursion: " + " -> ".join(name.split(":")[-1] for name in loop))
        self.active.append(title)
        frame, calls = self.frame_and_calls(title)
        below = max((self.deepest(call) for call in sorted(calls) if self.is_linked(call)), default=(0, []),
                    key=lambda found: found[0])
        self.active.pop()
        self.known[title] = (frame + below[0], [(title, frame)] + below[1])
        return self.known[title]


def measure(path, table):
    """The worst case of an image: {"worst", "size", "parts": {label: bytes}, "chains": [(label, pushed, bytes, chain)]}."""
    image, graph = Image(path), Graph(path)
    if graph.problems:
        raise Problem("\n".join(graph.problems))
    stack = Stack(image, graph, table)
    parts = [("program", 0, stack.deepest(stack.resolve("canopy_reset")))]
    for label, names, deep in image.machine.entries(image):
        titles = [stack.resolve(name) for name in sorted(names)]
        if titles and deep:
            parts.append((label, image.machine.pushed(image), max((stack.deepest(title) for title in titles), key=lambda one: one[0])))
        elif titles:
            frames = [(title, stack.frame_and_calls(title)[0]) for title in titles]
            parts.append((label, image.machine.pushed(image), (sum(size for _, size in frames), frames)))
    return {"worst": sum(pushed + found[0] for _, pushed, found in parts), "size": image.symbols["canopy_stack_size"],
            "parts": {label: pushed + found[0] for label, pushed, found in parts},
            "chains": [(label, pushed, *found) for label, pushed, found in parts]}


def report(path, table):
    result = measure(path, table)
    worst, room = result["worst"], result["size"]
    print(f"{path.stem}: worst-case stack {worst} of {room} bytes, {room - worst} to spare")
    for label, pushed, size, chain in result.pop("chains"):
        print(f"  {label}: {pushed + size}" + (f" ({pushed} of it pushed by the processor)" if pushed else ""))
        for title, frame in chain:
            print(f"    {frame:6} {title.split(':')[-1]}")
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=Path, required=True, help="the table of calls through pointers")
    parser.add_argument("--json", type=Path, help="write the sums there too")
    parser.add_argument("images", nargs="*", type=Path)
    arguments = parser.parse_args()
    try:
        table = Table(arguments.calls)
        results = {path.stem: report(path, table) for path in arguments.images}
    except Problem as problem:
        print(f"stack: {problem}", file=sys.stderr)
        return 1
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + "\n")
    small = [name for name, result in results.items() if result["worst"] > result["size"]]
    for name in small:
        print(f"stack: {name} needs {results[name]['worst']} bytes and has {results[name]['size']}", file=sys.stderr)
    return 1 if small else 0


if __name__ == "__main__":
    sys.exit(main())
