#!/usr/bin/python3
"""Budgets of the firmware as checked data: what each image may take, what it took when that was last written down.

Usage: tools/budget.py size|stack|cycles [--build DIR] [--board BOARD]... [--table CSV] [--calls FILE] [--renew]
       tools/budget.py boards [--check] [--table CSV] [--readme README.md]

The first form measures the images below DIR, prints a table with each share of its budget and the difference to the last
commit's value, and fails above a budget; --renew writes what was measured into the table. The second writes the README's
table of boards from the values in the table; --check says whether it is up to date.

Quantities: flash, ram (static, with the stack), stack (the worst case, from the call graph), all in bytes; in instructions
boot (from reset to the first answer to a PLC), feed (a point into the field), line (a line of a 20 x 20 refit),
refit_10x10 and refit_20x20 (with certificate and publication), request (the dearest of four Modbus requests), and where
there is float in hardware tight_10x10 and tight_20x20 (an iteration of the tight method).
"""

import argparse
import csv
import io
import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "hosttest")]

import bench_firmware  # noqa: E402
import size as sizes  # noqa: E402
import stack as stacks  # noqa: E402

COLUMNS = ("board", "image", "quantity", "budget", "measured")
KINDS = {"size": ("flash", "ram"), "stack": ("stack",),
         "cycles": ("boot", "feed", "line", "refit_10x10", "refit_20x20", "request", "tight_10x10", "tight_20x20")}
# Of what an image prints: which results, of which the largest counts, and over what they are counted
RESULTS = {"feed": (r"(hills|boxes)_feed_x100", 100), "line": (r"(hills|boxes)_line", 1),
           "refit_10x10": (r"(hills|boxes)_refit_10x10", 1), "refit_20x20": (r"(hills|boxes)_refit", 1),
           "request": (r"request_\w+", 1), "tight_10x10": (r"10x10_iteration", 1), "tight_20x20": (r"20x20_iteration", 1)}


class Problem(Exception):
    """Shown to the user as it is."""


class Table:
    """tools/budget.csv: rows (board, image, quantity) -> [budget, measured]."""

    def __init__(self, text, name):
        self.rows = {}
        rows = list(csv.reader(io.StringIO(text)))
        if not rows or tuple(rows[0]) != COLUMNS:
            raise Problem(f"{name}:1: its columns are not {','.join(COLUMNS)}")
        quantities = {quantity for kind in KINDS.values() for quantity in kind}
        for number, row in enumerate(rows[1:], 2):
            if len(row) != len(COLUMNS) or row[2] not in quantities or not re.fullmatch(r"\d+", row[3]):
                raise Problem(f"{name}:{number}: not board, image, one of {', '.join(sorted(quantities))}, budget, measured")
            if tuple(row[:3]) in self.rows:
                raise Problem(f"{name}:{number}: {' '.join(row[:3])} stands twice")
            self.rows[tuple(row[:3])] = [int(row[3]), float(row[4]) if row[4] else None]

    def write(self, path):
        lines = [",".join(COLUMNS)]
        for key, (budget, measured) in self.rows.items():
            lines.append(",".join([*key, str(budget), "" if measured is None else plain(measured)]))
        path.write_text("\n".join(lines) + "\n")


def plain(value):
    return f"{value:.0f}" if value == int(value) else f"{value:.2f}"


def shown(value):
    return "" if value is None else f"{value:,.0f}" if value == int(value) else f"{value:,.2f}"


def committed(path):
    """The table of the last commit; without one, the file's own."""
    done = subprocess.run(["git", "-C", path.resolve().parent, "show", f"HEAD:./{path.name}"], capture_output=True, text=True)
    return Table(done.stdout if done.returncode == 0 else path.read_text(), path)


# ---- Measuring: each gives {(board, image, quantity): value} for images that are built

def stations(build, board):
    """The station's images; those of other programs have other names."""
    return sorted((build / board).glob("canopy.elf")) + sorted((build / board).glob("canopy-*.elf"))


def measure_size(build, board, _):
    found = {}
    for image in stations(build, board):
        sections, _ = sizes.read(image.with_suffix(".map"))
        found[board, image.stem, "flash"] = sizes.total(sections, sizes.FLASH)
        found[board, image.stem, "ram"] = sizes.total(sections, sizes.RAM)
    return found


def measure_stack(build, board, calls):
    try:
        table, found = stacks.Table(calls), {}
        for image in stations(build, board):
            result = stacks.measure(image, table)
            if result["worst"] > result["size"]:
                raise Problem(f"{board} {image.stem} needs a stack of {result['worst']} bytes and has {result['size']}")
            found[board, image.stem, "stack"] = result["worst"]
        return found
    except stacks.Problem as problem:
        raise Problem(f"{board}: {problem}") from problem


def measure_cycles(build, board, _):
    found = {}
    for program, quantities in (("cycles", KINDS["cycles"][1:6]), ("tight", KINDS["cycles"][6:])):
        image = build / board / f"{program}.elf"
        if not image.exists():
            continue
        counts = bench_firmware.count(image)
        for quantity in quantities:
            pattern, over = RESULTS[quantity]
            values = [value for name, value in counts.items() if re.fullmatch(pattern, name)]
            if not values:
                raise Problem(f"{image} printed no {quantity}")
            found[board, program, quantity] = max(values) / over
    for image in stations(build, board):
        count, with_request = bench_firmware.boot(image)
        found[board, image.stem, "boot"] = count + (0 if with_request else found[board, "cycles", "request"])
    return found


MEASURE = {"size": measure_size, "stack": measure_stack, "cycles": measure_cycles}


def compare(table, last, kind, measured, boards):
    """Prints the table of one kind and returns what is wrong."""
    wrong = []
    expected = [key for key in table.rows if key[2] in KINDS[kind] and (not boards or key[0] in boards)]
    for key in expected:
        if key not in measured:
            wrong.append(f"{' '.join(key)}: has a budget and was not measured")
    print(f"{'board':12} {'image':14} {'quantity':12} {kind:>12} {'budget':>12} {'share':>6} {'since the last commit':>22}")
    for key, value in measured.items():
        if key not in table.rows:
            wrong.append(f"{' '.join(key)}: {shown(value)} and no budget: give it a line in tools/budget.csv")
            continue
        budget, before = table.rows[key][0], last.rows.get(key, (None, None))[1]
        sign = "+" if before is not None and value > before else "-"
        change = "new" if before is None else "" if value == before else sign + shown(abs(value - before))
        print(f"{key[0]:12} {key[1]:14} {key[2]:12} {shown(value):>12} {budget:12,} {100 * value / budget:5.0f}% {change:>22}"
              + ("  OVER BUDGET" if value > budget else ""))
        if value > budget:
            wrong.append(f"{' '.join(key)}: {shown(value)} of {budget:,}, {shown(value - budget)} over its budget")
    return wrong


def check(arguments, kind):
    table, measured = Table(arguments.table.read_text(), arguments.table), {}
    boards = arguments.board or list(dict.fromkeys(key[0] for key in table.rows))
    for board in boards:
        measured |= MEASURE[kind](arguments.build, board, arguments.calls)
    order = list(table.rows)
    measured = dict(sorted(measured.items(), key=lambda item: order.index(item[0]) if item[0] in table.rows else len(order)))
    wrong = compare(table, committed(arguments.table), kind, measured, boards)
    if arguments.renew:
        for key, value in measured.items():
            if key in table.rows:
                table.rows[key][1] = value
        table.write(arguments.table)
    for what in wrong:
        print(f"budget: {what}", file=sys.stderr)
    return 1 if wrong else 0


# ---- The README's table

BEGIN, END = "<!-- make boards -->", "<!-- from tools/budget.csv -->"
NAMES = {"mps2_an385": "Cortex-M3, `mps2_an385`", "mps2_an386": "Cortex-M4F, `mps2_an386`",
         "mps2_an500": "Cortex-M7F, `mps2_an500`", "rp2040_pico": "Cortex-M0+, `rp2040_pico`",
         "riscv_virt": "RV32IMAC, `riscv_virt`"}
SHOWN = (("flash", "flash"), ("RAM with stack", "ram"), ("worst stack", "stack"), ("boot", "boot"))
COUNTED = (("a point", "feed"), ("a line", "line"), ("refit 10 × 10", "refit_10x10"), ("refit 20 × 20", "refit_20x20"),
           ("a request", "request"), ("tight 10 × 10", "tight_10x10"), ("tight 20 × 20", "tight_20x20"))


def short(value, quantity):
    if value is None:
        return ""
    if quantity in ("flash", "ram", "stack"):
        return f"{value / 1024:.1f} KB"
    for unit, size in ((" M", 1e6), (" k", 1e3)):
        if value >= size:
            return f"{value / size:.3g}{unit}"
    return f"{value:.0f}"


def markdown(table):
    boards = list(dict.fromkeys(key[0] for key in table.rows))
    value = lambda board, image, quantity: short(table.rows.get((board, image, quantity), (0, None))[1], quantity)  # noqa: E731
    rows = [["board", *(f"{title}, {grid}" for grid in ("20 × 20", "10 × 10") for title, _ in SHOWN[:3]), "boot"]]
    for board in boards:
        name = NAMES.get(board, f"`{board}`")
        for images, name in ((("canopy", "canopy-10x10"), name), ((None, "canopy-10x10x2"), "… with Q = 2")):
            if (board, images[1], "flash") in table.rows:
                rows.append([name, *(value(board, image, quantity) for image in images for _, quantity in SHOWN[:3]),
                             value(board, images[0] or images[1], "boot")])
    counts = [["instructions", *(title for title, _ in COUNTED)]]
    for board in boards:
        cells = [next((value(board, image, quantity) for image in ("cycles", "tight")
                       if (board, image, quantity) in table.rows), "") for _, quantity in COUNTED]
        if any(cells):
            counts.append([NAMES.get(board, f"`{board}`"), *cells])
    return "\n\n".join("\n".join(["| " + " | ".join(part[0]) + " |", "| --- |" + " --- |" * (len(part[0]) - 1)]
                                 + ["| " + " | ".join(row) + " |" for row in part[1:]]) for part in (rows, counts))


def boards(arguments):
    text = arguments.readme.read_text()
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise Problem(f"{arguments.readme}: no place for the table: one line {BEGIN} and, below it, one {END}")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    wanted = f"{before}{BEGIN}\n{markdown(Table(arguments.table.read_text(), arguments.table))}\n{END}{after}"
    if arguments.check:
        if wanted != text:
            raise Problem(f"{arguments.readme}: its table of boards is not that of {arguments.table}: make boards")
    else:
        arguments.readme.write_text(wanted)
    return 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=[*KINDS, "boards"])
    parser.add_argument("--build", type=Path, default=ROOT / "build")
    parser.add_argument("--board", action="append", help="this one only; more than once: these")
    parser.add_argument("--table", type=Path, default=ROOT / "tools/budget.csv")
    parser.add_argument("--calls", type=Path, default=ROOT / "tools/calls.txt", help="the table of calls through pointers")
    parser.add_argument("--renew", action="store_true", help="write what was measured into the table")
    parser.add_argument("--check", action="store_true", help="write nothing, fail if the README is not up to date")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    arguments = parser.parse_args()
    for name in ("build", "table", "calls", "readme"):
        setattr(arguments, name, getattr(arguments, name).resolve())
    os.chdir(ROOT)  # where the places of the call graph begin
    try:
        return boards(arguments) if arguments.what == "boards" else check(arguments, arguments.what)
    except (Problem, RuntimeError, OSError) as problem:
        print(f"budget: {problem}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
