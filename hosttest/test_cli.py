"""The command `canopy` as a user meets it: results, exit statuses, messages, and what is left behind.

Scenes are made here from a seed. Where ../shared is present, the referee there judges every surrogate as well and the
real scans are fitted.
"""

import itertools
import json
import math
import os
import random
import re
import struct
import subprocess
from fractions import Fraction
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CANOPY_BUILD", "build"))
CANOPY = (BUILD if BUILD.is_absolute() else ROOT / BUILD) / "host" / "canopy"
SHARED = ROOT.parent / "shared"
REFEREE = SHARED / "tools" / "check_surrogate.py"

needs_referee = pytest.mark.skipif(not REFEREE.exists(), reason="no referee beside the repository")
needs_scans = pytest.mark.skipif(not (SHARED / "data" / "bun000.xyz").exists(), reason="no scans beside the repository")


def canopy(*arguments, stdin=None):
    return subprocess.run([str(CANOPY), *map(str, arguments)], input=stdin, capture_output=True, text=True, timeout=120)


def judge(surrogate, points):
    """The referee's verdict, where there is one."""
    if not REFEREE.exists():
        return None
    command = ["/usr/bin/python3", str(REFEREE), str(surrogate), str(points), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode in (0, 1), done.stderr
    return json.loads(done.stdout)


def hills(count, seed=1, scale=1.0, offset=(0.0, 0.0, 0.0)):
    draw = random.Random(seed)
    for _ in range(count):
        x, y = draw.uniform(0, 3), draw.uniform(0, 2)
        z = math.sin(2 * x) * math.cos(3 * y) + 0.05 * draw.random()
        yield tuple(scale * c + o for c, o in zip((x, y, z), offset))


def write_points(path, points, separator=" "):
    path.write_text("".join(separator.join(repr(float(c)) for c in p) + "\n" for p in points))
    return path


@pytest.fixture
def scene(tmp_path):
    return write_points(tmp_path / "scene.xyz", hills(3000))


def fit(tmp_path, points, *options, grid="8x9", name="out.json"):
    out = tmp_path / name
    done = canopy("fit", points, "--grid", grid, *options, "-o", out)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    return out, done.stdout


def refused(done, *words):
    """Exit 2, one line on standard error with these words in it."""
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    assert done.stderr.count("\n") == 1 and done.stderr.startswith("canopy: "), done.stderr
    for word in words:
        assert word in done.stderr, done.stderr


def mean_gap(line):
    return float(line.split("mean gap ")[1].split("%")[0])


def left_behind(tmp_path, *expected):
    """Only these files are there: no output, no temporary file."""
    return sorted(p.name for p in tmp_path.iterdir() if p.name not in expected) == []


# -- fit, check --------------------------------------------------------------------------------------------------------

OPTIONS = [(), ("--side", "below"), ("--scalar", "fx"), ("--scalar", "fx", "--side", "below"), ("--field", "4"),
           ("--field", "4", "--scalar", "fx"), ("--field", "7", "--side", "below"), ("--dir", "1,2,3"),
           ("--dir=-1,0,0", "--scalar", "fx"), ("--dir", "0.3,-0.2,-1", "--scalar", "fx", "--side", "below"),
           ("--dir", "0,1,0"), ("--plane", "1,2,3,4,4,4,0,1,9", "--scalar", "fx"), ("--unit", "0.25"), ("--scalar", "fx", "--unit", "0.01")]


@pytest.mark.parametrize("options", OPTIONS, ids=" ".join)
def test_fit_is_safe(tmp_path, scene, options):
    out, line = fit(tmp_path, scene, *options)
    assert line.startswith("3000 points, 8x9 ")
    done = canopy("check", out, scene)
    assert done.returncode == 0
    assert done.stdout.startswith("safe: 3000 points, 0 on the wrong side, 0 outside"), done.stdout
    verdict = judge(out, scene)
    if verdict:
        assert verdict["wrong_side"] == verdict["outside_frame"] == 0
        assert mean_gap(line) == pytest.approx(100 * verdict["mean_gap"], rel=1e-3)
    document = json.loads(out.read_text())
    assert document["certificate"]["points"] == 3000 and document["certificate"]["margin"] >= 0
    assert left_behind(tmp_path, "scene.xyz", "out.json")


@pytest.mark.parametrize("grid", ["4x4", "4x40", "33x5"])
@pytest.mark.parametrize("scalar", ["f32", "fx"])
@pytest.mark.parametrize("name, points", [
    ("one point", [(3.5, -2.25, 7.125)]),
    ("the origin alone", [(0, 0, 0)]),
    ("all equal", [(1.5, 2.5, -3.5)] * 300),
    ("one column", [(1, 1, z / 7) for z in range(300)]),
    ("one row", [(x / 11, 2, 0) for x in range(300)]),
    ("diagonal", [(t / 9, t / 9, t / 3) for t in range(200)]),
    ("flat", [(x / 10, y / 10, 4) for x in range(20) for y in range(20)]),
    ("cliff", [(x / 10, y / 10, 100 * (x >= 10)) for x in range(20) for y in range(20)]),
    ("spike", [(x / 10, y / 10, 1e6 * (x == y == 7)) for x in range(20) for y in range(20)]),
    ("extreme aspect", [(1e5 * x, 1e-3 * y, x * y) for x in range(20) for y in range(20)]),
    ("far away", [(1e5 + x, -3e5 + y, 5e4 + x * y) for x in range(20) for y in range(20)]),
    ("two corners", [(0, 0, 0), (1, 1, 1)]),
], ids=lambda value: value if isinstance(value, str) else "")
def test_odd_scenes_are_safe(tmp_path, name, points, scalar, grid):
    path = write_points(tmp_path / "odd.xyz", points)
    for side in ("above", "below"):
        out, _ = fit(tmp_path, path, "--scalar", scalar, "--side", side, grid=grid)
        assert canopy("check", out, path).returncode == 0
        verdict = judge(out, path) if grid == "4x40" and side == "above" else None
        if verdict:
            assert verdict["wrong_side"] == verdict["outside_frame"] == 0


@needs_scans
@needs_referee
@pytest.mark.parametrize("name", ["bun000.xyz", "chin.xyz", "rocker-arm.xyz", "bun_zipper.xyzn"])
def test_real_scans(tmp_path, name):
    points = SHARED / "data" / name
    for options in [(), ("--scalar", "fx", "--side", "below"), ("--dir", "1,1,1")]:
        out, line = fit(tmp_path, points, *options, grid="20x20")
        verdict = judge(out, points)
        assert verdict["wrong_side"] == verdict["outside_frame"] == 0
        if name == "bun000.xyz" and not options:
            assert 100 * verdict["mean_gap"] < 4.7


def gap_of(line):
    return float(re.search(r"mean gap ([0-9.e+-]+)%", line).group(1))


@pytest.mark.parametrize("scalar", ["f32", "fx"])
@pytest.mark.parametrize("side", ["above", "below"])
def test_tight_is_tighter_than_fast_and_safe(tmp_path, scene, scalar, side):
    _, fast = fit(tmp_path, scene, "--scalar", scalar, "--side", side)
    out, tight = fit(tmp_path, scene, "--scalar", scalar, "--side", side, "--method", "tight")
    assert re.search(r"tight \(at most [0-9.]+% from the tightest possible\)", tight)
    assert gap_of(tight) < gap_of(fast)
    verdict = judge(out, scene)
    if verdict:
        assert verdict["wrong_side"] == verdict["outside_frame"] == 0


@pytest.mark.parametrize("cells", [4, 7])
@pytest.mark.parametrize("scalar, side", [("f32", "above"), ("f32", "below"), ("fx", "above"), ("fx", "below")])
def test_tight_from_a_field_is_tighter_than_fast_and_safe(tmp_path, scene, scalar, side, cells):
    """Looser than from the points, which know more; still far tighter than fast from the same field."""
    options = ("--scalar", scalar, "--side", side, "--field", cells)
    _, fast = fit(tmp_path, scene, *options)
    out, tight = fit(tmp_path, scene, *options, "--method", "tight")
    _, points = fit(tmp_path, scene, "--scalar", scalar, "--side", side, "--method", "tight")
    claimed = re.search(rf"tight from field {cells} \(at most ([0-9.e-]+)% from the tightest possible\)", tight)
    assert float(claimed.group(1)) < 5
    assert gap_of(points) < gap_of(tight) < 0.8 * gap_of(fast)
    assert canopy("check", out, scene).returncode == 0
    verdict = judge(out, scene)
    if verdict:
        assert verdict["wrong_side"] == verdict["outside_frame"] == 0


@needs_scans
@needs_referee
@pytest.mark.parametrize("side", ["above", "below"])
@pytest.mark.parametrize("name", ["bun000", "chin", "rocker-arm"])
def test_tight_reaches_the_optimum(tmp_path, name, side):
    """Within 2 % of the linear program's, which data/oracle.json has; and what it says of itself is true."""
    optimum = json.loads((SHARED / "data" / "oracle.json").read_text())[f"{name} 20x20 {side}"]["mean_gap"]
    points = SHARED / "data" / f"{name}.xyz"
    out, line = fit(tmp_path, points, "--method", "tight", "--side", side, grid="20x20")
    verdict = judge(out, points)
    assert verdict["wrong_side"] == verdict["outside_frame"] == 0
    assert verdict["mean_gap"] <= 1.02 * optimum
    claimed = float(re.search(r"at most ([0-9.]+)% from", line).group(1)) / 100
    assert verdict["mean_gap"] <= (1 + 1.05 * claimed + 1e-3) * optimum


def test_frame_is_the_smallest_on_the_quantum(tmp_path, scene):
    """Origin and cell edges are whole quanta; a cell less would not hold the points."""
    out, _ = fit(tmp_path, scene, "--scalar", "fx", "--unit", "0.001")
    frame = json.loads(out.read_text())["frame"]
    points = [[round(float(c) / 0.001) for c in line.split()] for line in scene.read_text().splitlines()]
    for axis, size in ((0, 8), (1, 9)):
        low, high = min(p[axis] for p in points), max(p[axis] for p in points)
        cells = (size - 1) * 4
        assert frame["origin"][axis] == low
        assert frame["pitch"][axis] == 4 * max(1, math.ceil((high - low) / cells))


def test_f32_edges_have_24_bits(tmp_path, scene):
    out, _ = fit(tmp_path, scene)
    document = json.loads(out.read_text())
    for axis in (0, 1):
        for k in range((document["size"][axis] - 1) * 4 + 1):
            edge = Fraction(document["frame"]["origin"][axis]) + k * Fraction(document["frame"]["pitch"][axis]) / 4
            assert edge == Fraction(struct.unpack("f", struct.pack("f", float(edge)))[0])


def test_axes_of_a_direction(tmp_path, scene):
    for text, start in (("1,2,3", (1, 0, 0)), ("5,1,1", (0, 1, 0))):
        out, _ = fit(tmp_path, scene, "--dir", text)
        axes = json.loads(out.read_text())["frame"]["axes"]
        d = [float(c) for c in text.split(",")]
        d = [c / math.hypot(*d) for c in d]
        dot = sum(a * b for a, b in zip(d, start))
        x = [s - dot * c for s, c in zip(start, d)]
        x = [c / math.hypot(*x) for c in x]
        y = [d[1] * x[2] - d[2] * x[1], d[2] * x[0] - d[0] * x[2], d[0] * x[1] - d[1] * x[0]]
        for row, expected in zip(axes, (x, y, d)):
            assert row == pytest.approx(expected, abs=2 ** -30)
            assert all(float(c * 2 ** 30).is_integer() for c in row)


def test_axes_of_a_plane(tmp_path, scene):
    """The first axis from the first point to the second, the height axis towards who sees the three anticlockwise."""
    for text, first, normal in (("0,0,0,2,0,0,5,3,0", (1, 0, 0), (0, 0, 1)), ("0,0,0,5,3,0,2,0,0", (5, 3, 0), (0, 0, -1)),
                                ("1,1,1,1,1,3,1,2,1", (0, 0, 1), (-1, 0, 0)), ("0.1,0,0,0,0.1,0,0,0,0.1", (-1, 1, 0), (1, 1, 1))):
        out, _ = fit(tmp_path, scene, "--plane", text, "--scalar", "fx")
        axes = json.loads(out.read_text())["frame"]["axes"]
        for row, expected in ((axes[0], first), (axes[2], normal)):
            assert row == pytest.approx([c / math.hypot(*expected) for c in expected], abs=2 ** -30)
        cross = [axes[2][k - 2] * axes[0][k - 1] - axes[2][k - 1] * axes[0][k - 2] for k in range(3)]
        assert axes[1] == pytest.approx(cross, abs=2 ** -29)
        assert canopy("check", out, scene).returncode == 0


def test_default_unit_of_fx(tmp_path):
    for scale, unit in ((1.0, 1e-5), (0.05, 1e-7), (1234.0, 0.01), (3e7, 100)):
        path = write_points(tmp_path / "p.xyz", [(0, 0, 0), (scale, scale / 2, 0), (scale / 3, 0, scale / 4)])
        out, _ = fit(tmp_path, path, "--scalar", "fx")
        assert json.loads(out.read_text())["unit"] == unit


def test_frame_of_another(tmp_path, scene):
    first, _ = fit(tmp_path, scene, name="first.json")
    few = write_points(tmp_path / "few.xyz", list(hills(500)))
    second, _ = fit(tmp_path, few, "--frame", first, "--side", "below", name="second.json")
    a, b = json.loads(first.read_text()), json.loads(second.read_text())
    assert a["frame"] == b["frame"] and a["unit"] == b["unit"]
    verdict = judge(second, few)
    assert verdict is None or verdict["wrong_side"] == verdict["outside_frame"] == 0
    beyond = write_points(tmp_path / "beyond.xyz", [*hills(10), (9.0, 1.0, 0.0)])
    done = canopy("fit", beyond, "--grid", "8x9", "--frame", first, "-o", tmp_path / "x.json")
    refused(done, "beyond.xyz:11:", "frame")
    refused(canopy("fit", few, "--grid", "9x9", "--frame", first, "-o", tmp_path / "x.json"), "first.json", "8x9")
    untold = canopy("fit", few, "--frame", first, "--side", "below", "-o", tmp_path / "untold.json")
    assert untold.returncode == 0 and (tmp_path / "untold.json").read_bytes() == second.read_bytes()
    (tmp_path / "untold.json").unlink()
    assert not (tmp_path / "x.json").exists()


def test_frame_of_a_turned_one(tmp_path, scene):
    first, _ = fit(tmp_path, scene, "--dir", "1,2,3", "--scalar", "fx", name="first.json")
    for scalar in ("fx", "f32"):
        second, _ = fit(tmp_path, scene, "--frame", first, "--scalar", scalar, name="second.json")
        verdict = judge(second, scene)
        assert verdict is None or verdict["wrong_side"] == verdict["outside_frame"] == 0


def test_frame_of_another_with_every_method(tmp_path):
    """All points at the very edge of a turned frame, and frames whose pitches no float or cell divides."""
    edge = write_points(tmp_path / "edge.xyz", [(1073740032 + 128 * i, 44, -9 + 300 * (i % 2)) for i in range(10)])
    frames = [fit(tmp_path, edge, "--dir=1,-2.2e-8,1.4e-8", grid="9x9", name="turned.json")[0],
              fit(tmp_path, edge, "--field", "7", grid="9x9", name="seven.json")[0],
              fit(tmp_path, edge, "--field", "5", "--scalar", "fx", "--unit", "1", grid="9x9", name="fx.json")[0]]
    for frame, scalar in itertools.product(frames, ("f32", "fx")):
        for options in ((), ("--method", "tight"), ("--field", "8"), ("--side", "below", "--field", "3")):
            out, _ = fit(tmp_path, edge, "--frame", frame, "--scalar", scalar, *options, grid="9x9")
            assert json.loads(out.read_text())["frame"] == json.loads(frame.read_text())["frame"]
            assert canopy("check", out, edge).returncode == 0
            verdict = judge(out, edge)
            assert verdict is None or verdict["wrong_side"] == verdict["outside_frame"] == 0


def test_info_says_what_a_file_holds(tmp_path, scene):
    out, _ = fit(tmp_path, scene, "--dir", "1,2,3", "--scalar", "fx", "--refine", "1")
    told = canopy("info", out).stdout
    file = json.loads(out.read_text())
    for words in ("above all points, fx, unit", "8x9 coefficients", "axes ", "trim ", "certificate  margin",
                  f"{file['certificate']['points']} points"):
        assert words in told, told
    assert told.count("window ") == len(file.get("windows", []))
    heights = [file["unit"] * file["lsb"] * c for row in file["coefficients"] for c in row]
    low, high = re.search(r"coefficients (\S+) to (\S+)", told).groups()
    assert float(low) == pytest.approx(min(heights)) and float(high) == pytest.approx(max(heights))
    refused(canopy("info", tmp_path / "none.json"), "none.json")


def test_no_output_only_prints(tmp_path, scene):
    done = canopy("fit", scene, "--grid", "8x8")
    assert done.returncode == 0 and done.stdout.count("\n") == 1
    assert left_behind(tmp_path, "scene.xyz")


def test_output_replaces_whole_files_only(tmp_path, scene):
    out = tmp_path / "out.json"
    out.write_text("before")
    bad = write_points(tmp_path / "bad.xyz", [])
    refused(canopy("fit", bad, "--grid", "8x8", "-o", out))
    assert out.read_text() == "before"
    fit(tmp_path, scene)
    assert json.loads(out.read_text())["format"] == "canopy-surrogate"
    refused(canopy("fit", scene, "--grid", "8x8", "-o", tmp_path / "no" / "dir.json"), "dir.json", "cannot write")
    refused(canopy("fit", scene, "--grid", "8x8", "-o", tmp_path), "cannot write")
    refused(canopy("fit", scene, "--grid", "8x8", "-o", "-"), "-: cannot write")


# -- check: verdicts of surrogates that are not safe -------------------------------------------------------------------

def random_surrogate(draw, scalar, windows):
    m, n = draw.randint(4, 8), draw.randint(4, 8)
    angle = draw.uniform(0, 6)
    axes = draw.choice([[[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
                        [[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1]]])
    value = (lambda: float(draw.randint(-900, 900))) if scalar == "fx" else (lambda: draw.uniform(-900, 900))
    document = {"format": "canopy-surrogate", "version": 1, "side": draw.choice(["above", "below"]), "scalar": scalar,
                "unit": draw.choice([1, 0.5, 0.01]),
                "frame": {"origin": [draw.uniform(-50, 50) for _ in range(3)], "axes": axes,
                          "pitch": [draw.uniform(10, 90), float(draw.randint(10, 90))]},
                "size": [m, n], "coefficients": [[value() for _ in range(n)] for _ in range(m)],
                "lsb": draw.choice([1, 0.125, 0.1])}
    if windows:
        document["windows"] = [{"level": draw.choice([1, 2]), "first": [draw.randint(-3, 9), draw.randint(-3, 9)],
                                "size": [r, c], "coefficients": [[value() for _ in range(c)] for _ in range(r)]}
                               for r, c in [(draw.randint(1, 5), draw.randint(1, 5)) for _ in range(2)]]
    return document


def device_to_input(s, u, v, height):
    f = s["frame"]
    q = [u * f["pitch"][0], v * f["pitch"][1], height]
    return [s["unit"] * (f["origin"][k] + sum(f["axes"][i][k] * q[i] for i in range(3))) for k in range(3)]


@needs_referee
@pytest.mark.parametrize("scalar", ["f32", "fx"])
@pytest.mark.parametrize("windows", [False, True], ids=["plain", "windows"])
def test_verdicts_are_the_referees(tmp_path, scalar, windows):
    draw = random.Random(f"{scalar}{windows}")
    statuses = set()
    for trial in range(12):
        s = random_surrogate(draw, scalar, windows)
        surrogate = tmp_path / "s.json"
        surrogate.write_text(json.dumps(s))
        m, n = s["size"]
        high = 3000 * s["lsb"] * (1 if s["side"] == "below" else -1)
        reach = 0 if trial % 3 else 0.05  # beside the frame, too, in every third
        points = [device_to_input(s, draw.uniform(-reach, m - 1 + reach), draw.uniform(-reach, n - 1 + reach),
                                  high if trial % 4 == 1 else draw.uniform(-300, 300) * s["lsb"]) for _ in range(400)]
        path = write_points(tmp_path / "p.xyz", points)
        verdict, done = judge(surrogate, path), canopy("check", surrogate, path)
        statuses.add(done.returncode)
        assert done.returncode == (1 if verdict["wrong_side"] or verdict["outside_frame"] else 0)
        wrong, outside = verdict["wrong_side"], verdict["outside_frame"]
        assert f"400 points, {wrong} on the wrong side, {outside} outside" in done.stdout
        if not verdict["outside_frame"]:
            assert mean_gap(done.stdout) == pytest.approx(100 * verdict["mean_gap"], rel=1e-3)
        if verdict["wrong_side"]:
            assert f"first wrong: point {verdict['first_bad'][0] + 1}" in done.stdout
    assert statuses == {0, 1}


def test_one_coefficient_too_low(tmp_path, scene):
    out, _ = fit(tmp_path, scene)
    s = json.loads(out.read_text())
    s["coefficients"][4][4] -= 3 / s["lsb"]
    out.write_text(json.dumps(s))
    done = canopy("check", out, scene)
    assert done.returncode == 1 and done.stdout.startswith("NOT SAFE: 3000 points, ")


def test_ties_are_safe_and_one_unit_is_not(tmp_path):
    s = {"format": "canopy-surrogate", "version": 1, "side": "above", "scalar": "fx", "unit": 1,
         "frame": {"origin": [0, 0, 0], "axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "pitch": [3, 7]}, "size": [5, 5],
         "coefficients": [[36 * ((3 * i + 5 * j) % 7) for j in range(5)] for i in range(5)]}
    surrogate = tmp_path / "s.json"
    surrogate.write_text(json.dumps(s))
    heights = []
    for i in range(5):
        for j in range(5):
            height = sum(w * x * s["coefficients"][min(max(i + a, 0), 4)][min(max(j + c, 0), 4)]
                         for a, w in ((-1, 1), (0, 4), (1, 1)) for c, x in ((-1, 1), (0, 4), (1, 1)))
            heights.append((3 * i, 7 * j, height // 36))
    touching = write_points(tmp_path / "t.xyz", heights)
    assert canopy("check", surrogate, touching).returncode == 0
    x, y, z = heights[7]
    beyond = write_points(tmp_path / "b.xyz", [*heights[:7], (x, y, z + 1), *heights[8:]])
    done = canopy("check", surrogate, beyond)
    assert done.returncode == 1 and " 1 on the wrong side" in done.stdout and "first wrong: point 8" in done.stdout


# -- eval --------------------------------------------------------------------------------------------------------------

def weights(t):
    return [(1 - t) ** 3 / 6, (3 * t ** 3 - 6 * t ** 2 + 4) / 6, (-3 * t ** 3 + 3 * t ** 2 + 3 * t + 1) / 6, t ** 3 / 6]


def surface(s, u, v):
    m, n = s["size"]
    hu, hv = min(int(u), m - 2), min(int(v), n - 2)
    wu, wv = weights(u - hu), weights(v - hv)
    rows = [s["coefficients"][min(max(hu + a - 1, 0), m - 1)] for a in range(4)]
    return s["lsb"] * sum(wu[a] * wv[c] * rows[a][min(max(hv + c - 1, 0), n - 1)] for a in range(4) for c in range(4))


def test_eval(tmp_path, scene):
    out, _ = fit(tmp_path, scene, "--unit", "0.5")
    s = json.loads(out.read_text())
    del s["trim"]
    out.write_text(json.dumps(s))
    points = [(0.3, 0.4, 0), (2.9, 1.9, 5), (1.5, 1.0, -2), (-1, 0, 0), (0, 77, 0)]
    done = canopy("eval", out, write_points(tmp_path / "p.xyz", points))
    lines = done.stdout.splitlines()
    assert done.returncode == 0 and len(lines) == 5 and lines[3:] == ["nan", "nan"]
    for point, line in zip(points[:3], lines):
        device = [struct.unpack("f", struct.pack("f", c / 0.5))[0] for c in point]
        f = s["frame"]
        u, v = ((device[k] - f["origin"][k]) / f["pitch"][k] for k in range(2))
        assert float(line) == pytest.approx(0.5 * (surface(s, u, v) + f["origin"][2]), abs=1e-12)


def test_eval_of_data_is_never_nan_and_never_below(tmp_path, scene):
    for options in ((), ("--scalar", "fx"), ("--field", "4")):
        out, _ = fit(tmp_path, scene, *options)
        heights = canopy("eval", out, scene).stdout.split()
        z = [float(line.split()[2]) for line in scene.read_text().splitlines()]
        assert len(heights) == len(z) and all(float(h) >= c - 1e-5 for h, c in zip(heights, z))


def test_eval_outside_trim(tmp_path):
    points = write_points(tmp_path / "p.xyz", [(x / 10, y / 10, 0) for x in range(11) for y in range(11) if x + y < 8])
    out, _ = fit(tmp_path, points, grid="8x8")
    asked = write_points(tmp_path / "q.xyz", [(0.1, 0.1, 0), (0.69, 0.69, 0)])
    first, second = canopy("eval", out, asked).stdout.split()
    assert math.isfinite(float(first)) and second == "nan"


# -- points ------------------------------------------------------------------------------------------------------------

def test_text_dialects(tmp_path, scene):
    points = list(hills(300))
    plain = write_points(tmp_path / "a.xyz", points)
    out, line = fit(tmp_path, plain)
    expected = out.read_text()
    dialects = {
        "commas.csv": "".join(f"{x!r},{y!r},{z!r},7,word\n" for x, y, z in points),
        "semicolons.csv": "".join(f"{x!r} ; {y!r};{z!r} ;\n" for x, y, z in points),
        "tabs.xyz": "# a comment\n\n" + "".join(f"\t{x!r}\t{y!r} \t{z!r}\t1 2 3\r\n" for x, y, z in points),
        "comments.xyz": "\ufeff#x y z\n   # more\n" + "".join(f"{x:+.17e} {y!r} {z!r}# point\n" for x, y, z in points),
        "open end.txt": "\n".join(f"{x!r} {y!r} {z!r}" for x, y, z in points),
    }
    for name, text in dialects.items():
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        assert fit(tmp_path, path)[0].read_text() == expected, name
    done = canopy("fit", "-", "--grid", "8x9", "-o", out, stdin=plain.read_text())
    assert done.returncode == 0 and out.read_text() == expected


PLY_FORMATS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}


def ply(points, form="ascii", kind="double", extra=True, faces=2):
    """A PLY with an element before, extra properties, lists, and an element behind."""
    code = {"double": "d", "float": "f", "int": "i", "short": "h", "uchar": "B"}[kind]
    header = ["ply", f"format {form} 1.0", "comment made by a test", "obj_info none"]
    if extra:
        header += ["element camera 1", "property float focal", "property list uchar ushort ids"]
    header += [f"element vertex {len(points)}"]
    header += ["property uchar red", "property list uint8 int32 near"] if extra else []
    header += [f"property {kind} {c}" for c in "xyz"]
    header += ["property float32 nx"] if extra else []
    header += [f"element face {faces}", "property list uchar int vertex_indices"] if faces else []
    order = PLY_FORMATS[form]
    body = bytearray()
    rows = []
    if extra:
        rows.append([("f", 1.5), ("B", 2), ("H", 7), ("H", 8)])
    for p in points:
        row = [("B", 200), ("B", 1), ("i", -5)] if extra else []
        row += [(code, c) for c in p]
        row += [("f", 0.5)] if extra else []
        rows.append(row)
    rows += [[("B", 3), ("i", 0), ("i", 1), ("i", 2)]] * faces
    for row in rows:
        if order:
            for c, value in row:
                body += struct.pack(order + c, value)
        else:
            body += (" ".join(repr(value) for _, value in row) + "\n").encode()
    return ("\n".join(header) + "\nend_header\n").encode() + bytes(body)


@pytest.mark.parametrize("form", PLY_FORMATS)
@pytest.mark.parametrize("extra", [False, True], ids=["bare", "extra"])
@pytest.mark.parametrize("kind", ["double", "float", "int", "short", "uchar"])
def test_ply(tmp_path, form, extra, kind):
    points = list(hills(400, scale=50, offset=(60, 60, 60)))
    if kind in ("int", "short", "uchar"):
        points = [tuple(int(c) for c in p) for p in points]
    if kind == "float":
        points = [struct.unpack("fff", struct.pack("fff", *p)) for p in points]
    expected = fit(tmp_path, write_points(tmp_path / "a.xyz", points))[0].read_text()
    path = tmp_path / "a.PLY"
    path.write_bytes(ply(points, form, kind, extra, faces=2 if extra else 0))
    assert fit(tmp_path, path)[0].read_text() == expected


@pytest.mark.parametrize("form", PLY_FORMATS)
def test_ply_element_without_properties(tmp_path, form):
    points = list(hills(50))
    expected = fit(tmp_path, write_points(tmp_path / "a.xyz", points))[0].read_text()
    data = ply(points, form).replace(b"element vertex", b"element void 4000000000\nelement vertex")
    (tmp_path / "a.ply").write_bytes(data)
    assert fit(tmp_path, tmp_path / "a.ply")[0].read_text() == expected


def test_ply_keeps_doubles(tmp_path):
    points = [(1e9 + 0.001 * i, 2e9 - 0.001 * i, 1e9 + 1e-6 * (i * i % 50)) for i in range(100)]
    text = write_points(tmp_path / "a.xyz", points)
    (tmp_path / "a.ply").write_bytes(ply(points, "binary_little_endian"))
    surrogate = tmp_path / "s.json"
    s = {"format": "canopy-surrogate", "version": 1, "side": "above", "scalar": "fx", "unit": 1,
         "frame": {"origin": [999999999, 1999999999, 0], "axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "pitch": [1, 1]},
         "size": [4, 4], "coefficients": [[10 ** 9] * 4] * 4}
    surrogate.write_text(json.dumps(s))
    a, b = canopy("check", surrogate, text), canopy("check", surrogate, tmp_path / "a.ply")
    assert a.returncode == 0 and a.stdout == b.stdout


BAD_TEXT = {
    "empty file": ("", ":0: no points"),
    "only comments": ("# nothing\n\n", ":2: no points"),
    "words": ("1 2 3\nhello world again\n", ":2: 'hello'"),
    "header": ("x,y,z\n1,2,3\n", ":1: 'x'"),
    "two columns": ("1 2 3\n\n4 5\n", ":3: 2 columns"),
    "one column": ("1\n", ":1: 1 column:"),
    "two columns and a comment": ("1 2 # 3\n", ":1: 2 columns"),
    "nan": ("1 2 3\n1 nan 3\n", ":2: 'nan' in column 2 is not finite"),
    "inf": ("1 2 -inf\n", ":1: '-inf' in column 3 is not finite"),
    "1e400": ("1 2 3\n4 1e400 6\n", ":2: '1e400' in column 2 is beyond"),
    "hexadecimal": ("1 0x10 3\n", ":1: '0x10'"),
    "glued": ("1 2 3abc\n", ":1: '3abc'"),
    "empty field": ("1,,3\n", ":1: ''"),
    "decimal commas": ("1 2 3\n1,5 2,5 3,5\n", ":2: two kinds of separator"),
    "decimal commas, semicolons": ("1,5;2,5;3,5\n", ":1: two kinds of separator"),
    "one decimal comma": ("1;2,5;3\n", ":1: two kinds of separator"),
    "a decimal comma at the end": ("1 2 3,5\n", ":1: two kinds of separator"),
    "binary": ("1 2 3\n\0\0\0\n", ":2: a zero byte"),
    "a very long line": ("1 2 3\n" + "x" * 200000, ":2: line longer"),
}


@pytest.mark.parametrize("name", BAD_TEXT)
@pytest.mark.parametrize("command", ["fit", "check", "eval", "plot"])
def test_bad_text(tmp_path, scene, name, command):
    text, expected = BAD_TEXT[name]
    path = tmp_path / "bad.xyz"
    path.write_text(text)
    out = tmp_path / "new.png"
    if command == "fit":
        done = canopy("fit", path, "--grid", "8x8", "-o", out)
    else:
        surrogate, _ = fit(tmp_path, scene)
        done = canopy(command, surrogate, path, *(["-o", out] if command == "plot" else []))
    refused(done, "bad.xyz" + expected)
    assert left_behind(tmp_path, "bad.xyz", "scene.xyz", "out.json")


def bad_ply():
    good = ply([(1, 2, 3), (4, 5, 6), (7, 8, 9)], "binary_little_endian")
    text = ply([(1, 2, 3), (4, 5, 6), (7, 8, 9)])
    header = text.split(b"end_header\n")[0]
    yield "truncated binary", good[:-30 - 26], "ends too early"
    yield "truncated faces", good[:-1], "in face 2 of 2"
    yield "truncated header", good[:60], "end_header"
    yield "truncated text", text[:-20], "truncated"
    yield "no x", text.replace(b"double x", b"double a"), "without x, y and z"
    yield "no vertex", text.replace(b"element vertex", b"element point"), "without x, y and z"
    yield "not a PLY", b"1 2 3\n", "does not begin with 'ply'"
    yield "empty", b"", "empty file"
    yield "unknown type", text.replace(b"property double x", b"property quad x"), "unknown PLY type"
    yield "unknown format", text.replace(b"format ascii", b"format morse"), "unknown PLY format"
    yield "no format", text.replace(b"format ascii 1.0\n", b""), "without a format"
    yield "no vertices", ply([]), "no points"
    yield "a word", text.replace(b"4 5 6", b"4 five 6"), "'five' is not a number"
    yield "nan", text.replace(b"4 5 6", b"4 nan 6"), "'nan' is not finite"
    yield "binary nan", ply([(1, 2, 3), (4, math.nan, 6)], "binary_big_endian"), "point 2: a coordinate is not finite"
    yield "binary inf", ply([(1, 2, 3), (4, math.inf, 6)], "binary_little_endian", "float"), "point 2: a coordinate"
    yield "x twice", text.replace(b"property double y", b"property double x"), "declared twice"
    yield "list x", text.replace(b"property double x", b"property list uchar double x"), "is a list"
    yield "huge count", header.replace(b"vertex 3", b"vertex 99999999999") + b"end_header\n", "element count"
    yield "large count", good.replace(b"vertex 3", b"vertex 4000000000"), "of 4000000000"
    yield "more values", text.replace(b"4 5 6", b"4 5 6 6 6"), "more values"
    yield "fewer values", text.replace(b"4 5 6 0.5", b"4 5"), "fewer values"


@pytest.mark.parametrize("name, data, expected", [pytest.param(*case, id=case[0]) for case in bad_ply()])
def test_bad_ply(tmp_path, name, data, expected):
    path = tmp_path / "bad.ply"
    path.write_bytes(data)
    refused(canopy("fit", path, "--grid", "8x8", "-o", tmp_path / "new.json"), "bad.ply", expected)
    assert left_behind(tmp_path, "bad.ply")


def test_bad_files(tmp_path, scene):
    surrogate, _ = fit(tmp_path, scene)
    out = tmp_path / "new.json"
    (tmp_path / "folder").mkdir()
    for path, words in ((tmp_path / "missing.xyz", ("missing.xyz", "No such file")),
                        (tmp_path / "folder", ("folder", "is a directory")),
                        (tmp_path / "missing.ply", ("missing.ply",))):
        refused(canopy("fit", path, "--grid", "8x8", "-o", out), *words)
        refused(canopy("check", surrogate, path), *words)
        refused(canopy("check", path, scene), str(path.name))
        refused(canopy("eval", surrogate, path), *words)
    refused(canopy("fit", "-", "--grid", "8x8", "-o", out, stdin="1 2\n"), "standard input:1: 2 columns")
    assert not out.exists()


@pytest.mark.parametrize("options, words", [
    (("--grid", "3x3"), ("--grid 3x3", "4")), (("--grid", "100000x100000"), ("--grid 100000x100000", "1024")),
    (("--grid", "8"), ("--grid 8",)), (("--grid", "8x8x8"), ("--grid",)), (("--grid", "-8x8"), ("--grid",)),
    (("--grid", "99999999999999999999x8"), ("--grid",)), (("--unit", "0"), ("--unit 0", "positive")),
    (("--unit", "-1"), ("--unit",)), (("--unit", "nan"), ("--unit",)), (("--unit", "1e400"), ("--unit",)),
    (("--unit", "one"), ("--unit",)), (("--field", "0"), ("--field",)), (("--field", "33"), ("--field 33", "32")),
    (("--dir", "0,0,0"), ("--dir",)), (("--dir", "1,2"), ("--dir",)), (("--dir", "1,nan,0"), ("--dir",)),
    (("--plane", "0,0,0,1,1,1"), ("--plane",)), (("--plane", "0.1,0.2,0.3,0.2,0.4,0.6,0.3,0.6,0.9"), ("--plane", "on a line")),
    (("--plane", "1,1,1,1,1,1,2,3,4"), ("--plane",)),
    (("--scalar", "fx", "--unit", "1e-12"), ("scene.xyz:1:", "overflows 32-bit fixed point", "larger --unit")),
    (("--scalar", "f32", "--unit", "1e-300"), ("scene.xyz:1:", "overflows 32-bit float")),
    (("--frame", "/nowhere/frame.json"), ("/nowhere/frame.json",)),
], ids=lambda value: " ".join(value) if isinstance(value, tuple) and value and value[0].startswith("--") else "")
def test_bad_options(tmp_path, scene, options, words):
    grid = () if "--grid" in options else ("--grid", "8x8")
    refused(canopy("fit", scene, *grid, *options, "-o", tmp_path / "new.json"), *words)
    assert left_behind(tmp_path, "scene.xyz")


def test_overflow_at_the_unit_that_the_extent_asks_for(tmp_path):
    path = write_points(tmp_path / "far.xyz", [(0, 0, 0), (1e-3, 2e-3, 0), (1e-3, 1e-3, 0)])
    fit(tmp_path, path, "--scalar", "fx")
    far = write_points(tmp_path / "far.xyz", [(1e6, 0, 0), (1e6 + 1e-3, 1e-3, 0), (1e6, 1e-3, 0)])
    done = canopy("fit", far, "--grid", "8x8", "--scalar", "fx", "-o", tmp_path / "new.json")
    refused(done, "far.xyz:2:", "overflows")


# -- surrogate files ---------------------------------------------------------------------------------------------------

def broken_surrogates():
    def change(**parts):
        return lambda s: s.update(parts)

    yield "unknown key", change(colour="red"), "colour"
    yield "another format", change(format="stl"), "version 1"
    yield "version 2", change(version=2), "version 1"
    yield "side", change(side="left"), '"side"'
    yield "scalar", change(scalar="f64"), '"scalar"'
    yield "unit 0", change(unit=0), '"unit" is not positive'
    yield "unit text", change(unit="1"), '"unit" is not a finite number'
    yield "unit true", change(unit=True), '"unit"'
    yield "lsb", change(lsb=-1), '"lsb"'
    yield "no size", lambda s: s.pop("size"), '"size" is missing'
    yield "no frame", lambda s: s.pop("frame"), '"frame" is missing'
    yield "no coefficients", lambda s: s.pop("coefficients"), '"coefficients" is missing'
    yield "size 3", change(size=[3, 4]), '"size"'
    yield "size float", change(size=[8.0, 9]), '"size"'
    yield "size of others", change(size=[9, 9]), '"coefficients"'
    yield "huge size", change(size=[100000, 100000]), '"size"'
    yield "short row", lambda s: s["coefficients"][3].pop(), '"coefficients"'
    yield "text in a row", lambda s: s["coefficients"][3].__setitem__(2, "7"), '"coefficients"'
    yield "null in a row", lambda s: s["coefficients"][3].__setitem__(2, None), '"coefficients"'
    yield "frame key", lambda s: s["frame"].update(name="x"), "name"
    yield "pitch 0", lambda s: s["frame"].update(pitch=[0, 1]), '"pitch"'
    yield "pitch of three", lambda s: s["frame"].update(pitch=[1, 1, 1]), '"pitch"'
    yield "origin of two", lambda s: s["frame"].update(origin=[1, 1]), '"origin"'
    yield "left-handed", lambda s: s["frame"].update(axes=[[0, 1, 0], [1, 0, 0], [0, 0, 1]]), '"axes"'
    yield "skew", lambda s: s["frame"].update(axes=[[1, 0.001, 0], [0, 1, 0], [0, 0, 1]]), '"axes"'
    yield "trim too small", change(trim=[[1]]), '"trim"'
    yield "trim of twos", lambda s: s["trim"][0].__setitem__(0, 2), '"trim"'
    yield "windows no list", change(windows={}), '"windows"'
    window = {"level": 1, "first": [0, 0], "size": [1, 1], "coefficients": [[1]]}
    yield "window level", change(windows=[{**window, "level": 3}]), '"level"'
    yield "window key", change(windows=[{**window, "x": 1}]), '"x"'
    yield "window first", change(windows=[{**window, "first": [0, 0.5]}]), '"first"'
    yield "window size", change(windows=[{**window, "size": [1, 2]}]), '"coefficients"'
    yield "certificate key", lambda s: s["certificate"].update(by="me"), "by"


@pytest.mark.parametrize("name, change, expected", [pytest.param(*case, id=case[0]) for case in broken_surrogates()])
def test_broken_surrogates(tmp_path, scene, name, change, expected):
    out, _ = fit(tmp_path, scene)
    s = json.loads(out.read_text())
    change(s)
    out.write_text(json.dumps(s))
    refused(canopy("check", out, scene), "out.json: ", expected)
    refused(canopy("eval", out, scene), "out.json: ", expected)
    refused(canopy("plot", out, scene, "-o", tmp_path / "p.png"), "out.json: ", expected)
    assert left_behind(tmp_path, "scene.xyz", "out.json")


@pytest.mark.parametrize("text", ["", "{", "[]", "{} {}", "7", '{"format": 1}',
                                  '{"format": "canopy-surrogate", "version": 1, "unit": NaN}',
                                  "1e400", '{"version": 1, "version": 1}', "\0"])
def test_not_json(tmp_path, scene, text):
    path = tmp_path / "s.json"
    path.write_text(text)
    refused(canopy("check", path, scene), "s.json")


def test_written_numbers_come_back(tmp_path, scene):
    """17 digits: reading and fitting in the same frame again changes nothing."""
    out, _ = fit(tmp_path, scene, "--dir", "1,2,3")
    s = json.loads(out.read_text())
    assert canopy("check", out, scene).returncode == 0
    out.write_text(json.dumps(s))
    again = canopy("check", out, scene)
    assert again.returncode == 0
    frame = json.loads(fit(tmp_path, scene, "--frame", out, name="b.json")[0].read_text())["frame"]
    assert frame == s["frame"]


def test_coarse_floats_far_from_zero_are_said(tmp_path):
    """Of whole numbers rounding loses nothing, and yet the frame's pitch is coarse."""
    def said(*offset, grid="8x8", scalar="f32"):
        points = write_points(tmp_path / "far.xyz", [tuple(map(round, p)) for p in hills(200, 1, 10.0, offset)])
        return "floats are coarse" in fit(tmp_path, points, "--scalar", scalar, "--unit", "1", grid=grid)[1]
    assert not said(0, 0, 0) and not said(0, 0, 0, grid="200x200") and not said(3000, 0, 0)
    assert said(500000, 5400000, 300) and said(3000, 0, 0, grid="900x900")
    assert not said(500000, 5400000, 300, scalar="fx")


# -- plot, help, usage -------------------------------------------------------------------------------------------------

def has_matplotlib():
    return subprocess.run(["/usr/bin/python3", "-c", "import matplotlib"], capture_output=True).returncode == 0


@pytest.mark.skipif(not has_matplotlib(), reason="no matplotlib")
def test_plot_draws_what_eval_says(tmp_path):
    """The script evaluates the surface itself: windows, axes, unit and all."""
    draw = random.Random(5)
    for windows in (False, True):
        s = random_surrogate(draw, "f32", windows)
        surrogate = tmp_path / "s.json"
        surrogate.write_text(json.dumps(s))
        m, n = s["size"]
        knots = [(draw.uniform(0.01, m - 1.01), draw.uniform(0.01, n - 1.01)) for _ in range(50)]
        points = write_points(tmp_path / "p.xyz", [device_to_input(s, u, v, 0) for u, v in knots])
        code = ("import sys, numpy as np; sys.path.insert(0, sys.argv[1]); from plot_surrogate import Surrogate;"
                "s = Surrogate(sys.argv[2]); u, v, _ = s.knots(np.loadtxt(sys.argv[3]));"
                "print(*s.height(u, v).tolist())")
        drawn = subprocess.run(["/usr/bin/python3", "-c", code, str(ROOT / "tools"), str(surrogate), str(points)],
                               capture_output=True, text=True, check=True).stdout.split()
        told = canopy("eval", surrogate, points).stdout.split()
        assert [float(h) for h in told] == pytest.approx([float(h) for h in drawn], rel=1e-9, abs=1e-9)


def test_help_is_the_manual():
    manuals = {"fit": ("--grid", "--side", "--scalar", "--unit", "--dir", "--field", "--frame", "--output"),
               "check": ("exact", "Exit status"), "eval": ("nan", "17 significant"), "plot": (".svg", "--at", "--show", "--size")}
    for command, words in manuals.items():
        done = canopy(command, "--help")
        assert done.returncode == 0 and not done.stderr
        assert done.stdout.startswith(f"Usage: canopy {command}")
        for word in words:
            assert word in done.stdout
        assert canopy("help", command).stdout == done.stdout
    assert "'fly' is not a command" in canopy("help", "fly").stderr
    assert "canopy COMMAND --help" in canopy("--help").stdout


@pytest.mark.parametrize("arguments", [
    (), ("fly",), ("fit",), ("fit", "a.xyz"), ("fit", "--grid", "8x8"), ("fit", "a.xyz", "b.xyz", "--grid", "8x8"),
    ("fit", "a.xyz", "--grid", "8x8", "--side", "left"), ("fit", "a.xyz", "--grid", "8x8", "--scalar", "f64"),
    ("fit", "a.xyz", "--grid", "8x8", "--method", "magic"), ("fit", "a.xyz", "--grid", "8x8", "--colour"), ("check",),
    ("check", "a.json"), ("check", "a", "b", "c"), ("eval", "a.json"), ("plot", "a.json"), ("plot", "-o", "a.png"),
    ("info",), ("info", "a", "b"),
], ids=" ".join)
def test_wrong_usage(arguments):
    done = canopy(*arguments)
    assert done.returncode == 64 and not done.stdout
    assert "--help" in done.stderr
