"""The generator of the register map: what it makes is complete and current, and a wrong table is refused with its line."""
import csv
import io
import json
import os
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "lib/plc/registers.csv"
TOOL = ROOT / "tools/registers.py"

# Names, types and access that clients rely on, whatever else the map grows.
PROMISED = {
    "magic": ("u32", "r"), "map_version": (None, "r"), "firmware_version": (None, "r"), "probe_u32": ("u32", "r"),
    "probe_f32": ("f32", "r"), "heartbeat": (None, "r"), "status": ("u16", "r"), "age_ms": ("u32", "r"),
    "sensor_faults": (None, "r"), "coverage_pct": (None, "r"), "sequence": ("u32", "r"), "points": ("u32", "r"),
    "scalar": ("u16", "r"), "side": ("u16", "r"), "grid_m": ("u16", "r"), "grid_n": ("u16", "r"), "unit": ("f32", "r"),
    "lsb": ("f32", "r"), "margin": ("i32", "r"), "origin_x": ("i32", "r"), "origin_y": ("i32", "r"), "origin_z": ("i32", "r"),
    "pitch_u": ("u32", "r"), "pitch_v": ("u32", "r"), "block_count": ("u16", "r"), "block_0": (None, "r"),
    "coverage_count": ("u16", "r"), "coverage_0": (None, "r"), "query_x": ("i32", "rw"), "query_y": ("i32", "rw"),
    "query_height": ("i32", "r"), "query_status": (None, "r"), "query_sequence": ("u32", "r"), "command": (None, "rw"),
    "command_echo": (None, "r"), "command_result": (None, "r"), "rx_frames": ("u32", "r"), "rx_errors": ("u32", "r"),
    "scan_errors": ("u32", "r"), "points_rejected": ("u32", "r"),
    **{f"axis_{i}{j}": ("i32", "r") for i in range(3) for j in range(3)},
}


def run(*arguments):
    return subprocess.run([sys.executable, str(TOOL), *map(str, arguments)], capture_output=True, text=True)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    directory = tmp_path_factory.mktemp("registers")
    result = run(TABLE, "--out", directory)
    assert result.returncode == 0, result.stderr
    return directory


@pytest.fixture(scope="module")
def document(made):
    return json.loads((made / "registers.json").read_text())


def test_the_page_in_docs_is_current():
    result = run("--check", ROOT / "docs/registers.md")
    assert result.returncode == 0, result.stderr


def test_what_the_build_made_is_current(made):
    build = Path(os.environ.get("BUILD", "build"))
    build = build if build.is_absolute() else ROOT / build
    for name in ("registers.json", "registers.csv", "registers.md", "gen/canopy_registers.h", "gen/canopy_register_table.h",
                 "gen/canopy_settings_table.h"):
        assert (build / name).read_text() == (made / name).read_text(), name


def test_an_outdated_page_is_noticed(made, tmp_path):
    page = tmp_path / "page.md"
    page.write_text((made / "registers.md").read_text() + "\n")
    assert run("--check", page).returncode == 1
    assert run("--check", tmp_path / "absent.md").returncode == 1


def test_json_has_its_schema(document):
    assert set(document) == {"map_version", "word_order", "registers"}
    assert document["word_order"] == "ABCD"
    for item in document["registers"]:
        assert list(item) == ["name", "table", "address", "words", "type", "access", "unit", "scale", "doc"], item
        assert item["table"] == "holding" and item["type"] in ("u16", "u32", "i32", "f32", "string")
        assert item["access"] in ("r", "rw", "w") and isinstance(item["scale"], (int, float))
        assert 0 <= item["address"] and item["address"] + item["words"] <= 65536 and 1 <= item["words"] <= 125


def test_promised_names_are_there(document):
    items = {item["name"]: item for item in document["registers"]}
    assert len(items) == len(document["registers"])
    for name, (kind, access) in PROMISED.items():
        assert items[name]["access"] == access, name
        assert kind in (None, items[name]["type"]), name
    assert items["block_0"]["words"] == 124
    assert items["axis_00"]["scale"] == 2.0 ** -30
    query = [items["query_" + name] for name in ("x", "y", "height", "status", "sequence")]
    assert all(a["address"] + a["words"] == b["address"] for a, b in zip(query, query[1:]))


def test_nothing_overlaps_and_series_are_regular(document):
    end = 0
    for item in document["registers"]:
        assert item["address"] >= end, item["name"]
        end = item["address"] + item["words"]
    for stem in ("block_", "coverage_", "changed_"):
        blocks = [i for i in document["registers"] if i["name"].startswith(stem) and i["name"][len(stem):].isdigit()]
        assert [i["name"] for i in blocks] == [f"{stem}{k}" for k in range(len(blocks))]
        assert {b["address"] - a["address"] for a, b in zip(blocks, blocks[1:])} == {125}


def test_csv_says_the_same(made, document):
    rows = list(csv.DictReader(io.StringIO((made / "registers.csv").read_text())))
    assert len(rows) == len(document["registers"])
    for row, item in zip(rows, document["registers"]):
        assert row["name"] == item["name"] and row["doc"] == item["doc"] and row["type"] == item["type"]
        assert int(row["address"]) == item["address"] and float(row["scale"]) == item["scale"]


def test_the_crc_covers_meaning_but_not_wording(made, tmp_path):
    def crc(text):
        table = tmp_path / "table.csv"
        table.write_text(text)
        assert run(table, "--out", tmp_path).returncode == 0
        return (tmp_path / "gen/canopy_registers.h").read_text().split("CANOPY_MAP_CRC ")[1].split()[0]

    text = TABLE.read_text()
    assert crc(text) == crc(text.replace("since start", "since the start"))
    assert crc(text) != crc(text.replace("336,uptime_s,u32,2,r,s,1,", "336,uptime_s,u32,2,r,ms,1,"))
    assert crc(text) != crc(text.replace("@version,1", "@version,2"))


@pytest.mark.parametrize("old, new, what", [
    ("101,status,", "100,status,", "overlaps"),
    ("101,status,u16,1", "101,status,u16,2", "2 words of u16"),
    ("101,status,u16", "101,status,u17", "type"),
    ("101,status,", "101,heartbeat,", "twice"),
    ("101,status,", "one,status,", "not a number"),
    ("101,status,u16,1,r,", "101,status,u16,1,rw,", "can be written"),
    ("340,cycle_max_us", "342,cycle_max_us", "a gap between cycle_us and cycle_max_us"),
    ("68x124/125", "700x124/125", "beyond 65536"),
    ("269x124/125", "269x126/125", "no series"),
    ("269x124/125", "269", "COUNTxWORDS/STRIDE"),
    ("@version,1", "", "@version"),
    ("@group,query", "@group,questions", "@group"),
    ('line",1,247,1\n505', 'line",1,247\n505', "11 columns instead of 12"),
    ('line",1,247,1\n505', 'line",1,247,x\n505', "are not numbers"),
    ('line",1,247,1\n505', 'line",1,247,0\n505', "not lowest <= default"),
    ('line",1,247,1\n505', 'line",1,65536,1\n505', "not in the type"),
    ("30,revision,string,8", "30,revision,string,2", "more than 2 words"),
    ("506,set_plc_baud,u32,2,rw", "506,set_plc_baud,i32,2,rw", "a setting is u16 or u32"),
    ("500,settings_state,u16,1,r,", "500,settings_state,u16,1,rw,", "9 columns instead of 12"),
])
def test_a_table_that_contradicts_itself_is_refused(tmp_path, old, new, what):
    text = TABLE.read_text()
    assert text.count(old) == 1
    table = tmp_path / "table.csv"
    table.write_text(text.replace(old, new))
    result = run(table, "--out", tmp_path / "out")
    assert result.returncode == 2
    assert what in result.stderr and "line " in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_missing_tables_are_refused(tmp_path):
    result = run(tmp_path / "absent.csv", "--out", tmp_path)
    assert result.returncode == 2 and result.stderr.count("\n") == 1


def test_crc_is_the_usual_one():
    assert zlib.crc32(b"123456789") == 0xCBF43926  # what the page calls CRC-32
