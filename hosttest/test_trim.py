"""The trim and what is free, as a user meets them: `canopy fit --free`, `canopy eval --trim`, `canopy trim`, the picture.

What is covered, the rule of the outline and the bicubic surface are computed here once more from the files alone.
"""

import csv
import json
import math
import random
import sys
import xml.etree.ElementTree
from fractions import Fraction
from pathlib import Path

import pytest

from test_cli import SHARED, canopy, fit, judge, left_behind, needs_scans, refused, write_points

RULES = ("nearest", "straight", "bent")


def holed(tmp_path, name="holed.xyz"):
    """Hills over a disc with a hole in its middle and another at its side."""
    rng = random.Random(3)
    points = []
    while len(points) < 4000:
        x, y = rng.uniform(0, 10), rng.uniform(0, 10)
        if math.hypot(x - 5, y - 5) < 5 and math.hypot(x - 5, y - 5) > 1.8 and math.hypot(x - 9, y - 5) > 1.7:
            points.append((x, y, math.sin(0.7 * x) + 1.2 * math.cos(0.6 * y) + 0.2 * x))
    return write_points(tmp_path / name, points)


def seen(s):
    """Coefficients in whose support a covered knot cell lies."""
    return {(i, j) for h, row in enumerate(s["trim"]) for w, cell in enumerate(row) if cell
            for i in range(max(h - 1, 0), min(h + 3, s["size"][0]))
            for j in range(max(w - 1, 0), min(w + 3, s["size"][1]))}


# -- what is free ------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("options", [(), ("--method", "tight"), ("--field", "4", "--scalar", "fx"), ("--side", "below")],
                         ids=" ".join)
def test_free_coefficients_change_nothing_that_is_covered(tmp_path, options):
    points = holed(tmp_path)
    plain, _ = fit(tmp_path, points, *options, grid="16x15")
    a = json.loads(plain.read_text())
    marks = seen(a)
    reach = [a["coefficients"][i][j] for i, j in marks]
    assert len(marks) < 16 * 15
    heights = canopy("eval", plain, points).stdout
    shapes = set()
    for rule in RULES:
        out, _ = fit(tmp_path, points, *options, "--free", rule, grid="16x15", name=f"{rule}.json")
        b = json.loads(out.read_text())
        assert {k: v for k, v in a.items() if k != "coefficients"} == {k: v for k, v in b.items() if k != "coefficients"}
        for i in range(16):
            for j in range(15):
                assert (i, j) not in marks or a["coefficients"][i][j] == b["coefficients"][i][j]
                assert min(reach) <= b["coefficients"][i][j] <= max(reach)
        assert canopy("eval", out, points).stdout == heights
        assert canopy("check", out, points).returncode == 0
        verdict = judge(out, points)
        assert verdict is None or verdict["wrong_side"] == verdict["outside_frame"] == 0
        shapes.add(out.read_text())
    assert len(shapes) == 3
    assert "tight" in options or plain.read_text() in shapes


def test_any_free_coefficients_do(tmp_path):
    points = holed(tmp_path)
    out, _ = fit(tmp_path, points, grid="16x15")
    s = json.loads(out.read_text())
    marks, before = seen(s), canopy("check", out, points).stdout
    for i in range(16):
        for j in range(15):
            if (i, j) not in marks:
                s["coefficients"][i][j] = -(10 ** 12)
    out.write_text(json.dumps(s))
    assert canopy("check", out, points).stdout == before


def test_straight_second_differences_vanish(tmp_path):
    out, _ = fit(tmp_path, holed(tmp_path), grid="24x24")
    s = json.loads(out.read_text())
    b, marks = s["coefficients"], seen(s)
    span = max(b[i][j] for i, j in marks) - min(b[i][j] for i, j in marks)
    at = lambda i, j: b[min(max(i, 0), 23)][min(max(j, 0), 23)]  # noqa: E731
    free = [(i, j) for i in range(24) for j in range(24) if (i, j) not in marks]
    assert len(free) > 20
    for i, j in free:
        assert abs(at(i - 1, j) + at(i + 1, j) + at(i, j - 1) + at(i, j + 1) - 4 * b[i][j]) < 0.01 * span


def test_free_says_what_it_takes(tmp_path):
    done = canopy("fit", holed(tmp_path), "--grid", "8x8", "--free", "wild")
    assert done.returncode == 64 and "nearest, straight or bent, not 'wild'" in done.stderr


# -- the outline -------------------------------------------------------------------------------------------------------

def shape(trim, h, w):
    """None: outside; (): all of the cell; (a, b): the triangle at its corner (h + a, w + b)."""
    at = lambda h, w: 0 <= h < len(trim) and 0 <= w < len(trim[0]) and trim[h][w] == 1  # noqa: E731
    if at(h, w):
        return ()
    u, v = [a for a in (0, 1) if at(h + 2 * a - 1, w)], [b for b in (0, 1) if at(h, w + 2 * b - 1)]
    return (u[0], v[0]) if len(u) == len(v) == 1 else None


def is_inside(trim, u, v):
    """Inside or on an edge of the trim, exactly; u and v are fractions of knots."""
    for h in range(math.ceil(u) - 1, math.floor(u) + 1):
        for w in range(math.ceil(v) - 1, math.floor(v) + 1):
            if 0 <= h < len(trim) and 0 <= w < len(trim[0]):
                corner = shape(trim, h, w)
                if corner == () or (corner and abs(u - h - corner[0]) + abs(v - w - corner[1]) <= 1):
                    return True
    return False


def polygons(text):
    found = {}
    for row in csv.DictReader(text.splitlines()):
        found.setdefault((int(row["polygon"]), int(row["hole"])), []).append(
            (int(row["u"]), int(row["v"]), float(row["x"]), float(row["y"])))
    return found


def area(corners):
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, corners[1:] + corners[:1])) / 2


def edge_case(tmp_path, trim):
    """A surrogate of 1 x 1 cells from the origin, flat at 5."""
    m, n = len(trim) + 1, len(trim[0]) + 1
    path = tmp_path / "mask.json"
    path.write_text(json.dumps({
        "format": "canopy-surrogate", "version": 1, "side": "above", "scalar": "fx", "unit": 0.5,
        "frame": {"origin": [0, 0, 0], "axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "pitch": [8, 8]}, "size": [m, n],
        "coefficients": [[10] * n for _ in range(m)], "trim": trim}))
    return path


@pytest.mark.parametrize("seed", range(12))
def test_outline_of_any_mask(tmp_path, seed):
    rng = random.Random(seed)
    m, n, density = rng.randint(3, 9), rng.randint(3, 9), rng.uniform(0.2, 0.9)
    trim = [[int(rng.random() < density) for _ in range(n)] for _ in range(m)]
    path = edge_case(tmp_path, trim)
    done = canopy("trim", path)
    assert done.returncode == 0 and done.stdout.startswith("polygon,hole,u,v,x,y\n")
    found = polygons(done.stdout)
    shapes = [shape(trim, h, w) for h in range(m) for w in range(n)]
    assert sum(map(area, found.values())) == sum(1 if s == () else 0.5 for s in shapes if s is not None)
    assert all((area(corners) < 0) == bool(hole) for (_, hole), corners in found.items())
    assert all((x, y) == (4 * u, 4 * v) for corners in found.values() for u, v, x, y in corners)
    places = [(p, q) for p in range(8 * m + 1) for q in range(8 * n + 1)]
    asked = write_points(tmp_path / "asked.xyz", [(p / 2, q / 2, 0) for p, q in places])
    for known in ("cells", "outline", "frame"):
        heights = canopy("eval", "--trim", known, path, asked).stdout.split()
        assert len(heights) == len(places) and set(heights) <= {"5", "nan"}
        for (p, q), height in zip(places, heights):
            u, v = Fraction(p, 8), Fraction(q, 8)
            h, w = min(p // 8, m - 1), min(q // 8, n - 1)
            expected = {"cells": trim[h][w] == 1, "outline": is_inside(trim, u, v), "frame": True}[known]
            assert (height != "nan") == expected, (known, p, q)


def test_closing_and_cleaning_are_asked_for(tmp_path):
    trim = [[1, 1, 1, 0, 0], [1, 0, 1, 0, 0], [1, 1, 1, 0, 0], [0, 0, 0, 0, 0], [0, 0, 0, 0, 1]]
    path = edge_case(tmp_path, trim)
    holes_and_all = lambda *options: [hole for _, hole in polygons(canopy("trim", path, *options).stdout)]  # noqa: E731
    assert sorted(holes_and_all()) == [0, 0, 1]
    assert sorted(holes_and_all("--close")) == [0, 0]
    assert sorted(holes_and_all("--clean")) == [0, 1]
    assert sorted(holes_and_all("--close", "--clean")) == [0]


def test_outline_without_trim_is_the_frame(tmp_path):
    path = edge_case(tmp_path, [[1] * 4] * 5)
    s = json.loads(path.read_text())
    del s["trim"]
    path.write_text(json.dumps(s))
    assert list(polygons(canopy("trim", path).stdout).values()) == [
        [(0, 0, 0.0, 0.0), (5, 0, 20.0, 0.0), (5, 4, 20.0, 16.0), (0, 4, 0.0, 16.0)]]
    s["trim"] = [[0] * 4] * 5
    path.write_text(json.dumps(s))
    assert canopy("trim", path).stdout == "polygon,hole,u,v,x,y\n"


def test_outline_as_a_drawing(tmp_path):
    out, _ = fit(tmp_path, holed(tmp_path), grid="16x15")
    drawing, numbers = tmp_path / "o.svg", tmp_path / "o.csv"
    for to in (drawing, numbers):
        done = canopy("trim", out, "-o", to)
        assert done.returncode == 0 and done.stdout == ""
    assert numbers.read_text() == canopy("trim", out).stdout
    root = xml.etree.ElementTree.parse(drawing).getroot()
    path = root.find(".//{http://www.w3.org/2000/svg}path").get("d")
    found = polygons(numbers.read_text())
    assert path.count("M") == len(found) and path.count("L") == sum(len(c) - 1 for c in found.values())
    assert {hole for _, hole in found} == {0, 1}
    # Every point is inside: the outline holds every covered cell whole.
    points = [tuple(map(float, line.split())) for line in (tmp_path / "holed.xyz").read_text().splitlines()]
    edges = [(a[2:], b[2:]) for c in found.values() for a, b in zip(c, c[1:] + c[:1])]
    for x, y, _ in points[::20]:
        crossings = sum((a[1] <= y) != (b[1] <= y) and
                        a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]) > x for a, b in edges)
        assert crossings % 2 == 1


def test_trim_says_what_is_wrong(tmp_path):
    refused(canopy("trim", tmp_path / "none.json"), "none.json")
    path = edge_case(tmp_path, [[1] * 4] * 5)
    refused(canopy("trim", path, "-o", tmp_path / "no" / "where.csv"), "where.csv")
    assert canopy("trim").returncode == canopy("trim", path, path).returncode == 64
    done = canopy("eval", "--trim", "some", path, path)
    assert done.returncode == 64 and "cells, outline or frame, not 'some'" in done.stderr
    for trim, words in (([[1, 1]] * 5, "as many"), ([[1, 2, 0, 1]] * 5, "something else than 0 and 1"), (7, "rows")):
        s = json.loads(path.read_text())
        s["trim"] = trim
        (tmp_path / "bad.json").write_text(json.dumps(s))
        for command in (("trim",), ("eval", "--trim", "outline")):
            refused(canopy(*command, tmp_path / "bad.json", *([path] if len(command) > 1 else [])), "bad.json", '"trim"')
    assert left_behind(tmp_path, "mask.json", "bad.json")


# -- the picture -------------------------------------------------------------------------------------------------------

def test_picture_has_the_same_outline(tmp_path):
    sys.path.insert(0, str(Path(__file__).parent.parent / "tools"))
    plot = pytest.importorskip("plot_surrogate")
    rng = random.Random(4)
    trim = [[int(rng.random() < 0.6) for _ in range(9)] for _ in range(8)]
    path = edge_case(tmp_path, trim)
    drawn = plot.Surrogate(path)
    steps = {frozenset((tuple(map(int, a)), tuple(map(int, b)))) for a, b in drawn.outline()}
    assert len(steps) == len(drawn.outline())
    expected = set()
    for corners in polygons(canopy("trim", path).stdout).values():
        for a, b in zip(corners, corners[1:] + corners[:1]):
            count = max(abs(b[0] - a[0]), abs(b[1] - a[1]))
            du, dv = (b[0] - a[0]) // count, (b[1] - a[1]) // count
            expected |= {frozenset(((a[0] + k * du, a[1] + k * dv), (a[0] + (k + 1) * du, a[1] + (k + 1) * dv)))
                         for k in range(count)}
    assert steps == expected
    for u, v in ((h + p / 8, w + q / 8) for h in range(8) for w in range(9) for p in (1, 3, 6) for q in (2, 5, 7)):
        assert bool(drawn.covered(u, v)) == is_inside(trim, u, v)


@needs_scans
def test_scans_have_an_outline(tmp_path):
    out, _ = fit(tmp_path, SHARED / "data" / "bun000.xyz", grid="20x20")
    heights = canopy("eval", "--trim", "outline", out, SHARED / "data" / "bun000.xyz").stdout.split()
    assert "nan" not in heights
    found = polygons(canopy("trim", out).stdout)
    assert sum(map(area, found.values())) > 0 and 1 <= len(found) < 20
