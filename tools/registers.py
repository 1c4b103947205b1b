#!/usr/bin/python3
"""Makes everything that says what a register is from the one table, lib/plc/registers.csv.

Usage: registers.py [TABLE] --out DIRECTORY   writes gen/canopy_registers.h, gen/canopy_register_table.h,
                                              gen/canopy_settings_table.h, registers.json, registers.csv and registers.md there
       registers.py [TABLE] --page FILE       writes the page for people
       registers.py [TABLE] --check FILE      exit 1 if FILE is not that page

A table that contradicts itself is refused with its line: exit 2. Only Python's standard library is used.
"""
import argparse
import csv
import json
import os
import re
import sys
import zlib

TABLE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "lib", "plc", "registers.csv")
WORDS = {"u16": 1, "u32": 2, "i32": 2, "f32": 2}
ACCESS = ("r", "rw", "w")
GROUPS = ("identity", "live", "envelope", "query", "command", "counters", "health", "settings", "coverage", "blocks", "changes")
SERIES = ("coverage", "blocks", "changes")
WRITABLE = ("query", "command", "settings")
HEADER_WORDS = 64  # lib/plc keeps which header registers a hold has shown in as many bits


class Refused(Exception):
    pass


def need(ok, line, what):
    if not ok:
        raise Refused(f"line {line}: {what}")


class Item:
    """One row: a register, or a series of equal blocks (count > 1 or stride > words)."""

    def __init__(self, line, group, row):
        self.setting = group == "settings" and len(row) > 4 and "w" in row[4]
        columns = 12 if self.setting else 9
        need(len(row) == columns, line, f"{len(row)} columns instead of {columns}")
        address, self.name, self.type, words, self.access, self.unit, scale, self.field, self.doc = row[:9]
        self.line, self.group = line, group
        need(re.fullmatch(r"\d+", address), line, f"address {address!r} is not a number")
        self.address = int(address)
        self.series = self.name.endswith("_*")
        need(re.fullmatch(r"[a-z][a-z0-9_]*", self.name.replace("_*", "_0")), line, f"name {self.name!r}")
        need(self.series == (group in SERIES), line, "series stand in the groups " + " and ".join(SERIES))
        need(self.type in WORDS or self.type == "string", line, f"type {self.type!r}")
        need(self.access in ACCESS, line, f"access {self.access!r}")
        need(self.access == "r" or group in WRITABLE, line, "only " + " and ".join(WRITABLE) + " can be written")
        self.count = 1
        if self.series:
            parts = re.fullmatch(r"(\d+)x(\d+)/(\d+)", words)
            need(parts, line, f"words {words!r} of a series are not COUNTxWORDS/STRIDE")
            self.count, self.words, self.stride = map(int, parts.groups())
            need(0 < self.words <= min(self.stride, 125) and self.count > 0, line, f"no series: {words}")
        else:
            need(re.fullmatch(r"\d+", words), line, f"words {words!r}")
            self.words = self.stride = int(words)
            need(self.words == WORDS.get(self.type, self.words) and 0 < self.words <= 125, line, f"{words} words of {self.type}")
            need(self.type != "string" or self.words > 2, line, "a string has more than 2 words: fewer are taken for a number")
            need(self.field != "", line, "no field")
        power = re.fullmatch(r"2\^(-?\d+)", scale)
        self.scale = 2.0 ** int(power.group(1)) if power else float(scale)
        self.scale = int(self.scale) if self.scale == int(self.scale) else self.scale
        self.scale_text = scale
        if self.setting:
            self.take_range(row[9:])

    def take_range(self, texts):
        need(all(re.fullmatch(r"\d+", t) for t in texts), self.line, "lowest, highest and default are not numbers")
        self.low, self.high, self.default = map(int, texts)
        need(self.type in ("u16", "u32"), self.line, "a setting is u16 or u32")
        need(self.low <= self.default <= self.high < 1 << 16 * self.words, self.line, "not lowest <= default <= highest, or not in the type")
        self.doc += f". {self.low} to {self.high}, {self.default} by default"

    @property
    def end(self):
        return self.address + (self.count - 1) * self.stride + self.words

    def each(self):
        """The registers by name: one, or those of the series."""
        for k in range(self.count):
            yield (self.name.replace("*", str(k)) if self.series else self.name), self.address + k * self.stride

    def canonical(self):
        return f"{self.address},{self.count},{self.stride},{self.name},{self.type},{self.words},{self.access},{self.unit},{self.scale_text}\n"


class Map:
    def __init__(self, path):
        self.version, self.groups, self.items = None, [], []
        with open(path, newline="", encoding="utf-8") as f:
            lines = list(enumerate(f.read().split("\n"), 1))
        for line, text in lines:
            if not text or text.startswith("#"):
                continue
            row = next(csv.reader([text]))
            if row[0] == "@version":
                need(len(row) == 2 and row[1].isdigit(), line, "@version,N")
                self.version = int(row[1])
            elif row[0] == "@group":
                need(len(row) == 4 and row[1] in GROUPS, line, "@group,name,title,text with a name of " + " ".join(GROUPS))
                self.groups.append(row[1:])
            else:
                need(self.groups, line, "a row before the first @group")
                self.items.append(Item(line, self.groups[-1][0], row))
        self.check()
        self.crc = zlib.crc32("".join([f"canopy map {self.version} ABCD\n"] + [i.canonical() for i in self.items]).encode())

    def check(self):
        need(self.version is not None and 0 < self.version < 65536, 1, "no @version")
        need([g[0] for g in self.groups] == list(GROUPS), 1, "the groups are not, in this order, " + " ".join(GROUPS))
        names, end = set(), 0
        for item in self.items:
            need(item.address >= end, item.line, f"{item.name} at {item.address} overlaps what ends at {end}")
            need(item.name not in names, item.line, f"{item.name} stands twice")
            names.add(item.name)
            end = item.end
        need(end <= 65536, self.items[-1].line, "the map ends beyond 65536")
        for name, _, _ in self.groups:
            need(self.of(name), 1, f"group {name} is empty")
            for a, b in zip(self.of(name), self.of(name)[1:]):
                need(a.end == b.address, b.line, f"a gap between {a.name} and {b.name}: a group has none")
        need(all(len(self.of(name)) == 1 for name in SERIES), 1, "a series is alone in its group")
        header = self.of("envelope")
        need(header[0].name == "sequence", header[0].line, "the envelope begins with its sequence")
        need(header[-1].end - header[0].address <= HEADER_WORDS, header[-1].line, f"the envelope has more than {HEADER_WORDS} registers")

    def of(self, group):
        return [i for i in self.items if i.group == group]

    @property
    def end(self):
        return self.items[-1].end

    @property
    def settings(self):
        return [i for i in self.items if i.setting]

    # -- what is written ---------------------------------------------------------------------------------------------

    def constants(self):
        """gen/canopy_registers.h: addresses by name."""
        out = ["// Generated from lib/plc/registers.csv by tools/registers.py.",
               "#ifndef CANOPY_REGISTERS_H", "#define CANOPY_REGISTERS_H", "",
               f"#define CANOPY_MAP_VERSION {self.version}u", f"#define CANOPY_MAP_CRC 0x{self.crc:08X}u",
               f"#define CANOPY_MAP_END {self.end}u  ///< the first address beyond the map", ""]
        for name, title, _ in self.groups:
            items = self.of(name)
            out += [f"// {title}: {items[0].address} to {items[-1].end - 1}"]
            for item in items:
                key = "CANOPY_REGISTER_" + item.name.replace("_*", "_0").upper()
                out.append(f"#define {key} {item.address}u")
                if item.series:
                    stem = "CANOPY_" + item.name.replace("_*", "").upper()
                    out += [f"#define {stem}_STRIDE {item.stride}u", f"#define {stem}_WORDS {item.words}u", f"#define {stem}_MAX {item.count}u"]
            out.append("")
        out.append("// Settings by number: a bit each")
        out += [f"#define CANOPY_SETTING_{item.name.removeprefix('set_').upper()} {k}u" for k, item in enumerate(self.settings)]
        out += [f"#define CANOPY_SETTINGS {len(self.settings)}u", f"#define CANOPY_SETTINGS_BYTES {2 * sum(i.words for i in self.settings)}u", ""]
        return "\n".join(out + ["#endif", ""])

    def settings_table(self):
        """gen/canopy_settings_table.h: what a setting may be."""
        out = ["// Generated from lib/plc/registers.csv by tools/registers.py. For lib/plc/settings.c alone.",
               "#ifndef CANOPY_SETTINGS_TABLE_H", "#define CANOPY_SETTINGS_TABLE_H", "",
               '#include "lib/plc/settings.h"', "", "static const struct canopy_settings_item canopy_settings_items[] = {"]
        for i in self.settings:
            member = i.field.removeprefix("value.")
            out.append(f"    {{{i.low}u, {i.high}u, {i.default}u, offsetof(struct canopy_settings, {member}), {i.words}}},  // {i.name}")
        return "\n".join(out + ["};", "", "#endif", ""])

    def table(self):
        """gen/canopy_register_table.h: how lib/plc serves the groups that are C structs."""
        out = ["// Generated from lib/plc/registers.csv by tools/registers.py. For lib/plc/map.c alone.",
               "#ifndef CANOPY_REGISTER_TABLE_H", "#define CANOPY_REGISTER_TABLE_H", "",
               '#include "lib/plc/map.h"', "", "static const struct canopy_plc_entry canopy_plc_entries[] = {"]
        groups, index = [], 0
        for name, _, _ in self.groups:
            items = [i for i in self.of(name) if not i.series]
            for item in items:
                write = " | CANOPY_PLC_WRITABLE" if "w" in item.access else ""
                out.append(f"    {{offsetof(struct canopy_plc_{name}, {item.field}), {item.words}{write}}},  // {item.address}: {item.name}")
            if items:
                groups.append(f"    {{{items[0].address}, {items[-1].end}, {index}}},  // {name}")
                index += len(items)
        out += ["};", "", "static const struct canopy_plc_group canopy_plc_groups[] = {"] + groups + ["};", "", "enum {"]
        out += [f"    CANOPY_PLC_GROUP_{name.upper()}," for name in GROUPS if name not in SERIES]
        return "\n".join(out + ["    CANOPY_PLC_GROUPS", "};", "", "#endif", ""])

    def json(self):
        registers = [{"name": name, "table": "holding", "address": address, "words": i.words, "type": i.type, "access": i.access,
                      "unit": i.unit, "scale": i.scale, "doc": i.doc} for i in self.items for name, address in i.each()]
        head = {"map_version": self.version, "word_order": "ABCD"}
        body = ",\n".join("    " + json.dumps(r) for r in registers)
        return json.dumps(head)[:-1] + ', "registers": [\n' + body + "\n]}\n"

    def csv(self):
        rows = ["name,table,address,words,type,access,unit,scale,doc"]
        for item in self.items:
            doc = '"' + item.doc.replace('"', '""') + '"'
            rows += [f"{name},holding,{address},{item.words},{item.type},{item.access},{item.unit},{item.scale!r},{doc}" for name, address in item.each()]
        return "\n".join(rows + [""])

    def page(self):
        out = ["# The register map", "",
               "Generated from `lib/plc/registers.csv`; `docs/plc.md` says how to use it.", "",
               f"Map version {self.version}, CRC-32 0x{self.crc:08X}. Addresses are protocol addresses, from 0 (a PLC that counts",
               "from 40001 adds 40001). Function codes 03 and 04 show the same. Word order is ABCD: the high word of a 32-bit",
               f"value stands at the lower address. The map ends at {self.end - 1}; every register in it can be read on every",
               "device, however small its grid.", ""]
        for name, title, text in self.groups:
            out += [f"## {title}", "", text, "", "| address | name | type | access | unit | meaning |", "| --- | --- | --- | --- | --- | --- |"]
            for item in self.of(name):
                kind = f"string, {item.words} registers" if item.type == "string" else item.type
                if item.series:
                    where, label = f"{item.address} + {item.stride} k", f"`{item.name.replace('*', 'k')}`, k = 0 … {item.count - 1}"
                    kind = f"{item.words} registers"
                else:
                    where = str(item.address) if item.words == 1 else f"{item.address}–{item.end - 1}"
                    label = f"`{item.name}`"
                unit = item.unit if item.scale == 1 else f"{item.scale_text.replace('^', ' ^ ')} {item.unit}".strip()
                out.append(f"| {where} | {label} | {kind} | {item.access} | {unit} | {item.doc.replace('|', chr(92) + '|')} |")
            out.append("")
        return "\n".join(out[:-1] + [""])


def store(path, text):
    """Leaves a file alone that already says this, so that nothing is rebuilt for it, but never a stale one."""
    os.makedirs(os.path.dirname(path) or ".", exist_ok=True)
    try:
        with open(path, encoding="utf-8") as f:
            if f.read() == text:
                os.utime(path)
                return
    except OSError:
        pass
    with open(path, "w", encoding="utf-8") as f:
        f.write(text)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="?", default=TABLE)
    parser.add_argument("--out", metavar="DIRECTORY")
    parser.add_argument("--page", metavar="FILE")
    parser.add_argument("--check", metavar="FILE")
    arguments = parser.parse_args()
    try:
        the = Map(arguments.table)
    except (Refused, OSError, ValueError) as error:
        print(f"{arguments.table}: {error}", file=sys.stderr)
        return 2
    if arguments.out:
        for name, text in (("gen/canopy_registers.h", the.constants()), ("gen/canopy_register_table.h", the.table()),
                           ("gen/canopy_settings_table.h", the.settings_table()),
                           ("registers.json", the.json()), ("registers.csv", the.csv()), ("registers.md", the.page())):
            store(os.path.join(arguments.out, name), text)
    if arguments.page:
        store(arguments.page, the.page())
    if arguments.check:
        try:
            with open(arguments.check, encoding="utf-8") as f:
                current = f.read() == the.page()
        except OSError:
            current = False
        if not current:
            print(f"{arguments.check} is out of date: tools/registers.py --page {arguments.check}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
