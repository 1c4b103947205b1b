"""Point files of every format, as a user's programs write them: the same points from each, exactly; strictness; and
files that are streamed.

The writers here share nothing with the readers.
"""

import math
import os
import random
import re
import resource
import struct
import subprocess

import numpy as np
import pytest

from test_cli import CANOPY, canopy, hills, refused, write_points

NAN = math.nan

# ----------------------------------------------------------------------------------------------------------------------
# Writers


def lzf(data):
    """LZF with short and long matches, as liblzf writes it: literal runs of up to 32, matches of up to 264 bytes."""
    out, literal, seen, at = bytearray(), bytearray(), {}, 0

    def flush():
        for i in range(0, len(literal), 32):
            run = literal[i : i + 32]
            out.append(len(run) - 1)
            out.extend(run)
        literal.clear()

    while at < len(data):
        key = data[at : at + 3]
        start = seen.get(key)
        seen[key] = at
        if len(key) == 3 and start is not None and at - start <= 8192:
            length = 3
            while length < 264 and at + length < len(data) and data[start + length] == data[at + length]:
                length += 1
            flush()
            distance = at - start - 1
            if length < 9:
                out += bytes([(length - 2) << 5 | distance >> 8, distance & 255])
            else:
                out += bytes([7 << 5 | distance >> 8, length - 9, distance & 255])
            at += length
        else:
            literal.append(data[at])
            at += 1
    flush()
    return bytes(out)


CODES = {("F", 4): "f", ("F", 8): "d", ("I", 1): "b", ("I", 2): "h", ("I", 4): "i", ("I", 8): "q"}
CODES.update({("U", size): CODES["I", size].upper() for size in (1, 2, 4, 8)})


def pcd(points, data="ascii", kind=("F", 8), extra=True, header=None, width=None):
    """A PCD file of points; with `extra`, a colour before them and a histogram of three behind."""
    code = CODES[kind]
    fields = [("rgb", *kind, 1)] * extra + [(c, *kind, 1) for c in "xyz"] + [("fpfh", "U", 1, 3)] * extra
    lines = ["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7"]
    for name, column in (("FIELDS", 0), ("SIZE", 2), ("TYPE", 1), ("COUNT", 3)):
        lines.append(" ".join([name, *(str(f[column]) for f in fields)]))
    width = width or len(points)
    lines += [f"WIDTH {width}", f"HEIGHT {len(points) // width}", "VIEWPOINT 1 2 3 1 0 0 0", f"POINTS {len(points)}"]
    lines.append(f"DATA {data}")
    head = ("\n".join(lines) + "\n").encode()
    head = header(head) if header else head
    rows = [([1] if extra else []) + list(p) + ([7, 8, 9] if extra else []) for p in points]
    if data == "ascii":
        return head + "".join(" ".join(repr(v) for v in row) + "\n" for row in rows).encode()
    layout = [code] * (4 if extra else 3) + ["3B"] * extra
    split = lambda row: row[:4] + [row[4:]] if extra else row
    values = lambda row: [v if isinstance(v, list) else [v] for v in split(row)]
    packed = [[struct.pack("<" + c, *v) for c, v in zip(layout, values(row))] for row in rows]
    if data == "binary":
        return head + b"".join(b"".join(row) for row in packed)
    body = b"".join(b"".join(column) for column in zip(*packed))
    small = lzf(body)
    return head + struct.pack("<II", len(small), len(body)) + small


LAS_RECORD = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67]


def las(whole, scale=(0.001,) * 3, offset=(0.0,) * 3, form=0, minor=2, withheld=(), records=b"", longer=0):
    """A LAS file of whole coordinates."""
    size = 375 if minor == 4 else 235 if minor == 3 else 227
    length = LAS_RECORD[form] + longer
    head = bytearray(size)
    head[:4] = b"LASF"
    head[24:26] = bytes([1, minor])
    struct.pack_into("<HII", head, 94, size, size + len(records), 1 if records else 0)
    struct.pack_into("<BHI", head, 104, form, length, 0 if form >= 6 else len(whole))
    struct.pack_into("<6d", head, 131, *scale, *offset)
    if minor == 4:
        struct.pack_into("<Q", head, 247, len(whole))
    body = bytearray()
    for i, p in enumerate(whole):
        record = bytearray(struct.pack("<3i", *p) + b"\x55" * (length - 12))
        record[15] = (0x80 if form < 6 else 0x04) if i in withheld else 0x02
        body += record
    return bytes(head) + records + bytes(body)


@pytest.fixture
def write(tmp_path):
    def write_file(name, data):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write_file


def surrogate_of(tmp_path, points, *options):
    out = tmp_path / "out.json"
    done = canopy("fit", points, "--grid", "6x5", *options, "-o", out)
    assert done.returncode == 0, done.stderr
    return out.read_text(), done.stdout


# ----------------------------------------------------------------------------------------------------------------------
# PCD


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("extra", [True, False])
@pytest.mark.parametrize("scalar", ["f32", "fx"])
def test_pcd_holds_the_same_points_as_text(tmp_path, write, data, extra, scalar):
    points = list(hills(400))
    want, line = surrogate_of(tmp_path, write_points(tmp_path / "a.xyz", points), "--scalar", scalar)
    got, _ = surrogate_of(tmp_path, write("a.pcd", pcd(points, data, extra=extra)), "--scalar", scalar)
    assert got == want and line.startswith("400 points, ")


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("kind", sorted(CODES))
def test_pcd_of_every_type(tmp_path, write, data, kind):
    draw = random.Random(3)
    low, high = (0, 127) if kind[0] == "U" or kind[1] == 1 else (-3000, 3000)
    points = [[draw.randint(low, high) for _ in "xyz"] for _ in range(60)]
    if kind[0] == "F":
        points = [[float(c) for c in p] for p in points]
    want, _ = surrogate_of(tmp_path, write_points(tmp_path / "a.xyz", points))
    got, _ = surrogate_of(tmp_path, write("a.pcd", pcd(points, data, kind, extra=kind[0] == "F")))
    assert got == want


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_what_was_not_measured_is_no_point_and_is_counted(tmp_path, write, data):
    points = list(hills(60))
    want, _ = surrogate_of(tmp_path, write_points(tmp_path / "a.xyz", points))
    holes = [(NAN, NAN, NAN), (1.0, 2.0, NAN), (math.inf, 0.0, 0.0), (0.0, -math.inf, 0.0)]
    organised = points[:10] + holes[:2] + points[10:] + holes[2:]
    path = write("a.pcd", pcd(organised, data, width=16))
    got, line = surrogate_of(tmp_path, path)
    assert got == want
    assert line.startswith("60 points (4 more in the file were not measured), ")
    done = canopy("check", tmp_path / "out.json", path)
    assert done.returncode == 0 and "60 points (4 more in the file were not measured)," in done.stdout
    done = canopy("eval", tmp_path / "out.json", path)
    assert done.stdout.count("\n") == 60 and "4 more in the file were not measured" in done.stderr


def pcd_faults():
    points = list(hills(20))
    good = pcd(points)
    swap = lambda old, new: good.replace(old, new)
    assert swap(b"x", b"x") == good
    yield "empty", b"", ":0: PCD header without a DATA line"
    yield "no data", good[: good.index(b"DATA")], "PCD header without a DATA line"
    yield "what data", swap(b"DATA ascii", b"DATA binary_big"), ":11: unknown PCD DATA"
    yield "version", swap(b"VERSION 0.7", b"VERSION 0.8"), ":2: PCD VERSION"
    yield "word", swap(b"VIEWPOINT", b"WIEVPOINT"), ":9: unknown PCD header line"
    yield "no z", swap(b"x y z", b"x y w"), "without single fields x, y and z"
    yield "two x", swap(b"x y z", b"x x z"), ":3: a coordinate twice"
    yield "fields twice", swap(b"SIZE", b"FIELDS x y z\nSIZE"), "FIELDS twice"
    yield "count of x", swap(b"COUNT 1 1", b"COUNT 1 2"), "without single fields"
    yield "size", swap(b"SIZE 8", b"SIZE 3"), ":4: bad PCD SIZE"
    yield "sizes", swap(b"SIZE 8", b"SIZE"), ":4: PCD header: give one value"
    yield "more sizes", swap(b"SIZE 8", b"SIZE 8 8"), ":4: PCD header: give one value"
    yield "type", swap(b"TYPE F", b"TYPE G"), ":5: unknown PCD TYPE"
    yield "short float", swap(b"SIZE 8", b"SIZE 2"), "TYPE F and SIZE 1 or 2"
    yield "count", swap(b"COUNT 1", b"COUNT 0"), ":6: bad PCD COUNT"
    yield "large count", swap(b"1 3\nWIDTH", b"1 65537\nWIDTH"), ":6: bad PCD COUNT"
    yield "wide point", swap(b"COUNT 1 1 1 1 3", b"COUNT 60000 1 1 1 3"), "more than 65536 bytes"
    yield "width", swap(b"WIDTH 20", b"WIDTH -1"), ":7: PCD WIDTH"
    yield "points", swap(b"POINTS 20", b"POINTS 21"), "not WIDTH times HEIGHT"
    yield "many", swap(b"WIDTH 20", b"WIDTH 4294967295").replace(b"HEIGHT 1", b"HEIGHT 4294967295").replace(
        b"POINTS 20\n", b""), "not WIDTH times HEIGHT, or beyond"
    yield "truncated", good[: good.rstrip().rindex(b"\n") + 1], "ends after point 19 of 20"
    yield "short line", good[: good.rstrip().rindex(b" ")], ":31: fewer values"
    yield "long line", good.rstrip() + b" 1\n", ":31: more values"
    yield "a word", good.replace(repr(points[4][1]).encode(), b"five"), ":16: 'five' is not a number"
    yield "nothing measured", pcd([(NAN, 0.0, 0.0)] * 5), "no points but such as were not measured"
    binary = pcd(points, "binary")
    yield "truncated binary", binary[:-1], "in point 20 of 20"
    whole = pcd([(1, 2, 2**53 + 2)] * 3, "binary", ("I", 8))
    yield "beyond 2^53", whole, "point 1: 9007199254740994 is beyond 2^53"
    small = pcd(points, "binary_compressed")
    at = small.index(b"compressed\n") + 11
    yield "no sizes", small[: at + 7], "truncated"
    yield "truncated packed", small[:-1], "truncated"
    yield "other size", small[: at + 4] + b"\1" + small[at + 5 :], "packed bytes for"
    many = pcd([(1.0, 2.0, 3.0)] * 10**4, "binary_compressed", extra=False)
    start = many.index(b"compressed\n") + 11
    lie = many[:start] + struct.pack("<I", 100) + many[start + 4 :]
    yield "too large for what is packed", lie, "packed bytes for"
    yield "not packed", small[: at + 8] + b"\xff" * (len(small) - at - 8), "cannot be unpacked"


@pytest.mark.parametrize("data, words", [pytest.param(*c[1:], id=c[0]) for c in pcd_faults()])
def test_bad_pcd(tmp_path, write, data, words):
    out = tmp_path / "no.json"
    refused(canopy("fit", write("bad.pcd", data), "--grid", "6x5", "-o", out), "bad.pcd", words)
    assert not out.exists()


@pytest.mark.parametrize("data", ["binary", "binary_compressed"])
def test_a_pcd_cut_anywhere_is_never_taken(write, data):
    whole = pcd(list(hills(9)), data)
    for length in range(0, len(whole), 7):
        assert canopy("fit", write("cut.pcd", whole[:length]), "--grid", "4x4").returncode == 2


# ----------------------------------------------------------------------------------------------------------------------
# LAS


def whole_points(count, seed=5):
    draw = random.Random(seed)
    return [[draw.randint(-50000, 50000), draw.randint(-30000, 30000), draw.randint(0, 9000)] for _ in range(count)]


VERSIONS = [*((f, 2) for f in range(4)), (0, 0), (1, 1), (4, 3), (5, 3), *((f, 4) for f in range(11))]


@pytest.mark.parametrize("form, minor", VERSIONS)
def test_las_is_whole_numbers_times_scale_plus_offset(tmp_path, write, form, minor):
    scale, offset = (0.001, 0.01, 0.0037), (4.5e5, -17.25, 1e-3)
    whole = whole_points(80)
    points = [[w * s + o for w, s, o in zip(p, scale, offset)] for p in whole]
    want, _ = surrogate_of(tmp_path, write_points(tmp_path / "a.xyz", points))
    data = las(whole, scale, offset, form, minor, records=b"\0" * 54, longer=form % 3)
    got, line = surrogate_of(tmp_path, write("a.las", data))
    assert got == want and line.startswith("80 points, ")


@pytest.mark.parametrize("form, minor", [(3, 2), (6, 4)])
def test_withheld_points_are_deleted_ones(tmp_path, write, form, minor):
    whole = whole_points(80)
    points = [[w * 0.001 for w in p] for i, p in enumerate(whole) if i not in (0, 40, 79)]
    want, _ = surrogate_of(tmp_path, write_points(tmp_path / "a.xyz", points))
    got, line = surrogate_of(tmp_path, write("a.las", las(whole, form=form, minor=minor, withheld=(0, 40, 79))))
    assert got == want and line.startswith("77 points (3 more in the file are withheld), ")


def las_faults():
    good = las(whole_points(10))
    put = lambda at, form, *v: good[:at] + struct.pack("<" + form, *v) + good[at + struct.calcsize("<" + form) :]
    yield "empty", b"", "byte 0: the file ends too early"
    yield "text", b"1 2 3\n" * 100, "does not begin with 'LASF'"
    yield "version", put(24, "BB", 2, 0), "unknown version of LAS"
    yield "minor", put(25, "B", 5), "unknown version of LAS"
    yield "compressed", put(104, "B", 0x80), "compressed (LAZ)"
    yield "format", put(104, "B", 11), "unknown LAS point format"
    yield "record", put(105, "H", 19), "that cannot be"
    yield "header", put(94, "H", 226), "that cannot be"
    yield "data", put(96, "I", 226), "that cannot be"
    yield "far data", put(96, "I", 2**32 - 1), "truncated"
    yield "scale", put(139, "d", 0.0), "scale of zero"
    yield "nan", put(155, "d", NAN), "not finite"
    yield "overflow", put(131, "d", 1e308), "point 1: a coordinate beyond IEEE double"
    yield "count", put(107, "I", 11), "in point 11 of 11"
    yield "truncated", good[:-1], "in point 10 of 10"
    yield "none", put(107, "I", 0), "no points"


@pytest.mark.parametrize("data, words", [pytest.param(*c[1:], id=c[0]) for c in las_faults()])
@pytest.mark.parametrize("ending", ["las", "laz"])
def test_bad_las(tmp_path, write, data, words, ending):
    out = tmp_path / "no.json"
    refused(canopy("fit", write(f"bad.{ending}", data), "--grid", "6x5", "-o", out), f"bad.{ending}", words)
    assert not out.exists()


# ----------------------------------------------------------------------------------------------------------------------
# A format is known by its first bytes, too


@pytest.mark.parametrize("name", ["-", "scan.dat"])
@pytest.mark.parametrize("form", ["pcd", "las", "text"])
def test_formats_are_known_by_their_first_bytes(tmp_path, write, form, name):
    whole = whole_points(50)
    points = [[w * 0.001 for w in p] for p in whole]
    text = "".join(" ".join(map(repr, p)) + "\n" for p in points).encode()
    data = {"pcd": pcd(points, "binary"), "las": las(whole), "text": text}[form]
    path = write("scan.dat", data)
    want, _ = surrogate_of(tmp_path, write("a.xyz", text))
    out = tmp_path / "out.json"
    command = [str(CANOPY), "fit", str(path) if name != "-" else "-", "--grid", "6x5", "-o", str(out)]
    done = subprocess.run(command, input=data, capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert out.read_text() == want


# ----------------------------------------------------------------------------------------------------------------------
# Files that are not held in memory: the same result, for any number of threads


WAYS = [
    ("fast",),
    ("fast below", "--side", "below", "--scalar", "fx"),
    ("field", "--field", "8"),
    ("packed", "--field", "8", "--packed"),
    ("turned", "--dir", "1,2,3", "--scalar", "fx"),
    ("plane", "--plane", "0,0,0,3,0,1,0,2,1"),
    ("filled", "--free", "nearest"),
    ("tight field", "--method", "tight", "--field", "4"),
    ("wide tight field", "--method", "tight", "--field", "4", "--grid", "5x9"),
    ("windows of a field", "--refine", "1", "--field", "4", "--grid", "9x9"),
]


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    path = tmp_path_factory.mktemp("many") / "many.xyz"
    return write_points(path, hills(70000))


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way[0])
def test_what_is_read_again_for_each_pass_gives_the_same_surface(tmp_path, many, way):
    want, line = surrogate_of(tmp_path, many, *way[1:], "--threads", "1")
    for threads in (1, 2, 3, 8):
        got, streamed = surrogate_of(tmp_path, many, *way[1:], "--threads", str(threads), "--memory", "0")
        assert got == want
        assert streamed.split("iterations")[0] == line.split("iterations")[0]
        assert surrogate_of(tmp_path, many, *way[1:], "--threads", str(threads))[0] == want


def test_a_frame_of_another_surface_serves_what_is_not_held(tmp_path, many):
    for options in ((), ("--dir", "1,2,3"), ("--scalar", "fx")):
        first, second = tmp_path / "first.json", tmp_path / "second.json"
        assert canopy("fit", many, "--grid", "6x5", *options, "-o", first).returncode == 0
        lines = []
        for memory in ("100", "0"):
            done = canopy("fit", many, "--grid", "6x5", "--frame", first, "--memory", memory, "-o", second)
            assert done.returncode == 0, done.stderr
            lines.append(second.read_text())
        assert lines[0] == lines[1]


def test_a_sandwich_of_what_is_not_held(tmp_path, many):
    texts = []
    for memory in ("100", "0"):
        done = canopy("sandwich", many, "--grid", "6x5", "--memory", memory, "-o", tmp_path / memory)
        assert done.returncode == 0, done.stderr
        texts.append([(tmp_path / f"{memory}.{side}.json").read_text() for side in ("above", "below")])
    assert texts[0] == texts[1]


def test_what_looks_at_points_one_by_one_says_that_it_takes_a_field(tmp_path, many):
    got, line = surrogate_of(tmp_path, many, "--method", "tight", "--memory", "0")
    want, _ = surrogate_of(tmp_path, many, "--method", "tight", "--field", "16")
    assert got == want and " tight from field 16 (" in line
    assert " from field" not in surrogate_of(tmp_path, many, "--method", "tight")[1]


@pytest.mark.parametrize("scalar", ["f32", "fx"])
def test_lines_of_large_grids_are_fitted_by_threads(tmp_path, many, scalar):
    ways = [surrogate_of(tmp_path, many, "--scalar", scalar, "--grid", "120x100", "--threads", str(threads))[0]
            for threads in (1, 2, 5)]
    assert ways[0] == ways[1] == ways[2]


@pytest.mark.parametrize("threads", ["1", "3"])
def test_standard_input_is_read_again_if_it_is_a_file_and_held_if_it_is_a_pipe(tmp_path, many, threads):
    want, _ = surrogate_of(tmp_path, many)
    out = tmp_path / "out.json"
    command = [str(CANOPY), "fit", "-", "--grid", "6x5", "--memory", "0", "--threads", threads, "-o", str(out)]
    with many.open("rb") as file:
        subprocess.run(command, stdin=file, check=True, timeout=60, stdout=subprocess.DEVNULL)
        assert out.read_text() == want
    subprocess.run(command, input=many.read_bytes(), check=True, timeout=60, stdout=subprocess.DEVNULL)
    assert out.read_text() == want


@pytest.mark.parametrize("memory", ["0", "100"])
def test_bad_lines_of_large_files_have_their_line(tmp_path, many, memory):
    lines = many.read_text().splitlines(True)
    lines[61234] = "1 2\n"
    lines[66000] = "word\n"
    bad = tmp_path / "bad.xyz"
    bad.write_text("".join(lines))
    out = tmp_path / "no.json"
    for threads in ("1", "8"):
        done = canopy("fit", bad, "--grid", "6x5", "--memory", memory, "--threads", threads, "-o", out)
        refused(done, "bad.xyz:61235: 2 columns")
        assert not out.exists()


@pytest.mark.parametrize("option", [("--memory", "-1"), ("--memory", "much"), ("--threads", "0"), ("--threads", "65")])
def test_bad_memory_and_threads(tmp_path, many, option):
    refused(canopy("fit", many, "--grid", "6x5", *option), " ".join(option))


def run_limited(megabytes, *arguments):
    """Runs the command with an address space of so many megabytes."""
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))
    command = [str(CANOPY), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, preexec_fn=limit, timeout=90)


def many_whole_points(count):
    """A LAS file made quickly: points on a paraboloid."""
    record = np.zeros(count, np.dtype([("p", "<i4", 3), ("rest", "u1", 8)]))
    at = np.arange(count, dtype=np.int64)
    record["p"][:, 0], record["p"][:, 1] = at * 7919 % 100003, at * 104729 % 70001
    record["p"][:, 2] = (record["p"][:, 0].astype(np.int64) ** 2 + record["p"][:, 1].astype(np.int64) ** 2) // 10**6
    head = bytearray(las([]))
    struct.pack_into("<I", head, 107, count)
    return bytes(head) + record.tobytes()


@pytest.mark.parametrize("options", [(), ("--scalar", "fx"), ("--method", "tight")], ids=["fast", "unit", "tight"])
def test_memory_does_not_grow_with_the_file(tmp_path, write, options):
    path = write("many.las", many_whole_points(3_000_000))
    fitting = ["fit", path, "--grid", "6x5", "--threads", "1", *options, "-o", tmp_path / "out.json"]
    done = run_limited(32, *fitting, "--memory", "1")
    assert done.returncode == 0 and done.stdout.startswith("3000000 points, "), done.stderr
    if "tight" not in options:
        streamed = (tmp_path / "out.json").read_text()
        assert canopy(*fitting).returncode == 0
        assert (tmp_path / "out.json").read_text() == streamed
    refused(run_limited(32, *fitting), "out of memory")  # 36 MB of points: what is limited would show


def test_progress_is_for_terminals(tmp_path, write):
    path = write("a.las", many_whole_points(1_000_000))
    arguments = ["fit", path, "--grid", "1000x1000", "--field", "20", "--memory", "0"]  # seconds, on any machine
    assert canopy(*arguments).stderr == ""
    terminal, end = os.openpty()
    done = subprocess.run([str(CANOPY), *map(str, arguments)], stdout=subprocess.PIPE, stderr=end, timeout=120)
    os.close(end)
    shown = b""
    try:
        while part := os.read(terminal, 65536):
            shown += part
    except OSError:  # how a terminal ends
        pass
    os.close(terminal)
    assert done.returncode == 0 and done.stdout.count(b"\n") == 1
    steps = shown.decode().split("\r\x1b[K")
    assert steps[0] == "" and steps[-1] == "" and len(steps) > 3
    for step in steps[1:-1]:
        assert re.fullmatch(r"canopy: [a-z ]+ \d{1,3}%( \(\d+ points\))?", step), step


def test_one_point_and_points_at_one_height_are_told_as_such(tmp_path):
    one = write_points(tmp_path / "one.xyz", [(1, 2, 3)])
    flat = write_points(tmp_path / "flat.xyz", [(0, 0, 5), (9, 9, 5)])
    for points, words in ((one, "1 point, "), (flat, "2 points, ")):
        _, line = surrogate_of(tmp_path, points)
        assert line.startswith(words) and "% of one device unit (all points are at one height), " in line
        verdict = canopy("check", tmp_path / "out.json", points).stdout
        assert words in verdict and "% of one device unit (all points are at one height), max " in verdict


@pytest.mark.parametrize("command", [(), ("fit",), ("check",)])
def test_h_is_help(command):
    assert canopy(*command, "-h").stdout == canopy(*command, "--help").stdout != ""


@pytest.mark.parametrize("option, status", [
    (("--grid", "3x3"), 2), (("--field", "99"), 2), (("--dir", "0,0,0"), 2), (("--unit", "0"), 2),
    (("--side", "sideways"), 64), (("--method", "best"), 64), (("--free", "all"), 64), (("--packed",), 64),
])  # fmt: skip
def test_wrong_numbers_are_bad_input_and_wrong_words_wrong_usage(tmp_path, option, status):
    points = write_points(tmp_path / "a.xyz", hills(20))
    assert canopy("fit", points, "--grid", "5x5", *option).returncode == status
