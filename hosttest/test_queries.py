"""The questions to surrogate files, as a user asks them: guarantees against exact sampling, and what is refused."""

import json
import math
import random
import struct
from fractions import Fraction
from math import floor

import pytest

from test_cli import canopy, hills, left_behind, refused, write_points

# -- an evaluation that shares nothing with the command ----------------------------------------------------------------


def spline(x):
    x = abs(Fraction(x))
    if x >= 2:
        return Fraction(0)
    return (2 - x) ** 3 / 6 if x >= 1 else (4 - 6 * x * x + 3 * x ** 3) / 6


class Surface:
    """A surrogate in rational numbers: heights in input units from the zero of the input."""

    def __init__(self, path):
        self.file = json.loads(path.read_text())
        frame = self.file["frame"]
        self.unit, self.lsb = Fraction(self.file["unit"]), Fraction(self.file["lsb"])
        self.size = self.file["size"]
        self.pitch = [Fraction(p) for p in frame["pitch"]]
        self.base = [sum(Fraction(a) * Fraction(o) for a, o in zip(axis, frame["origin"])) for axis in frame["axes"]]

    def height(self, u, v):
        """At (u, v) in knot intervals."""
        m, n = self.size
        total = Fraction(0)
        for i in range(max(-1, floor(u) - 1), min(m, floor(u) + 2) + 1):
            for j in range(max(-1, floor(v) - 1), min(n, floor(v) + 2) + 1):
                b = self.file["coefficients"][min(max(i, 0), m - 1)][min(max(j, 0), n - 1)]
                total += Fraction(b) * spline(u - i) * spline(v - j)
        for window in self.file.get("windows", ()):
            total += self.window_height(window, u * 2 ** window["level"], v * 2 ** window["level"])
        return (total * self.lsb + self.base[2]) * self.unit

    @staticmethod
    def window_height(window, u, v):
        total = Fraction(0)
        for i, row in enumerate(window["coefficients"], window["first"][0]):
            if abs(u - i) < 2:
                total += spline(u - i) * sum(Fraction(d) * spline(v - j) for j, d in enumerate(row, window["first"][1]))
        return total

    def at(self, x, axis):
        """An input coordinate along an axis, in knot intervals."""
        return (Fraction(x) / self.unit - self.base[axis]) / self.pitch[axis]

    def place(self, u, axis):
        return (u * self.pitch[axis] + self.base[axis]) * self.unit

    def edge_doubt(self):
        """With refinement windows the outermost intervals are known to 1/48 of what coefficients differ, twice."""
        if not self.file.get("windows"):
            return 0
        grids = [self.file["coefficients"]] + [window["coefficients"] for window in self.file["windows"]]
        most = sum(max(abs(Fraction(b)) for row in grid for b in row) for grid in grids)
        return 2 * most * self.lsb * self.unit / 12

    def edges(self, exact=False):
        edges = [self.place(Fraction(k), axis) for axis in (0, 1) for k in (0, self.size[axis] - 1)]
        return edges if exact else [float(edge) for edge in edges]

    def covers(self, u, v):
        m, n = self.size
        return "trim" not in self.file or self.file["trim"][min(floor(u), m - 2)][min(floor(v), n - 2)] == 1


def lattice(surface, window=None, steps=9):
    """(u, v) over a window of input coordinates, or the frame."""
    u0, u1, v0, v1 = window or surface.edges(exact=True)
    u0, u1 = (min(max(surface.at(x, 0), 0), surface.size[0] - 1) for x in (u0, u1))
    v0, v1 = (min(max(surface.at(x, 1), 0), surface.size[1] - 1) for x in (v0, v1))
    return [(u0 + (u1 - u0) * Fraction(p, steps), v0 + (v1 - v0) * Fraction(q, steps))
            for p in range(steps + 1) for q in range(steps + 1)]


def numbers(line):
    """`name BOUND attained VALUE at U V`"""
    words = line.split()
    assert words[2] == "attained" and words[4] == "at"
    return Fraction(float(words[1])), Fraction(float(words[3])), float(words[5]), float(words[6])


def ask(command, *arguments):
    done = canopy(command, *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


# -- surrogates --------------------------------------------------------------------------------------------------------


def fit(tmp_path, name, *options, points=None, grid="7x9"):
    scene = write_points(tmp_path / f"{name}.xyz", points or hills(1500))
    out = tmp_path / f"{name}.json"
    done = canopy("fit", scene, "--grid", grid, *options, "-o", out)
    assert done.returncode == 0, done.stderr
    return out


def write_surrogate(path, coefficients, **changes):
    m, n = len(coefficients), len(coefficients[0])
    document = {"format": "canopy-surrogate", "version": 1, "side": "above", "scalar": "f32", "unit": 1,
                "frame": {"origin": [0, 0, 0], "axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "pitch": [1, 1]},
                "size": [m, n], "coefficients": coefficients, "lsb": 1}
    frame = changes.pop("frame", {})
    document["frame"].update(frame)
    document.update(changes)
    path.write_text(json.dumps(document))
    return path


def refined(seed, whole=True):
    """Windows in the middle, across two edges, and one that is nothing but an edge."""
    return [{"level": 1, "first": [3, 2], "size": [4, 5], "coefficients": noise(seed, 4, 5, 300, whole)},
            {"level": 2, "first": [-1, -1], "size": [5, 6], "coefficients": noise(seed + 1, 5, 6, 200, whole)},
            {"level": 2, "first": [17, 4], "size": [1, 3], "coefficients": noise(seed + 2, 1, 3, 100, whole)},
            {"level": 1, "first": [9, 11], "size": [2, 2], "coefficients": noise(seed + 3, 2, 2, 900, whole)}]


def noise(seed, m=5, n=6, size=1000, whole=True):
    draw = random.Random(seed)
    return [[draw.randint(-size, size) if whole else draw.uniform(-size, size) for _ in range(n)] for _ in range(m)]


KINDS = {
    "fit": lambda path: fit(path, "s"),
    "fit below in fx": lambda path: fit(path, "s", "--side", "below", "--scalar", "fx"),
    "fit turned": lambda path: fit(path, "s", "--dir", "1,2,3"),
    "noise": lambda path: write_surrogate(path / "s.json", noise(1)),
    "not whole": lambda path: write_surrogate(path / "s.json", noise(2, whole=False), lsb=0.3),
    "far too large": lambda path: write_surrogate(path / "s.json", noise(3, size=10**15), lsb=1e-9, unit=0.1),
    "far away": lambda path: write_surrogate(path / "s.json", noise(4), unit=0.25,
                                             frame={"origin": [1e9, -3e8, 7e7], "pitch": [0.1, 1e5]}),
    "refined": lambda path: write_surrogate(path / "s.json", noise(21), windows=refined(22), lsb=0.5),
    "refined, not whole": lambda path: write_surrogate(path / "s.json", noise(31, whole=False), lsb=0.3,
                                                       windows=refined(32, whole=False)),
    "fit with a window": lambda path: fit(path, "s", "--refine", "1:3x3"),
    "flat": lambda path: write_surrogate(path / "s.json", [[3] * 4] * 4),
}


@pytest.fixture(params=KINDS)
def surrogate(request, tmp_path):
    return KINDS[request.param](tmp_path)


def windows(surface):
    """The frame, a part, a knot line, a point; of input coordinates."""
    u0, u1, v0, v1 = surface.edges()
    part = (u0 + (u1 - u0) * 0.31, u0 + (u1 - u0) * 0.77, v0 + (v1 - v0) * 0.1, v0 + (v1 - v0) * 0.52)
    knot = float(surface.place(Fraction(2), 0))
    return [None, part, (knot, knot, part[2], part[3]), (part[0], part[0], part[2], part[2])]


def option(window):
    return ["--window=" + ",".join(repr(x) for x in window)] if window else []


# -- window ------------------------------------------------------------------------------------------------------------


def test_window_is_a_guarantee(surrogate):
    surface = Surface(surrogate)
    for window in windows(surface):
        highest, lowest = (numbers(line) for line in ask("window", surrogate, *option(window)))
        heights = [surface.height(u, v) for u, v in lattice(surface, window)]
        assert max(heights) <= highest[0] and min(heights) >= lowest[0]
        assert highest[1] <= highest[0] and lowest[1] >= lowest[0]
        # It is tight: two steps, in whichever steps the command counts, and nothing else
        size = max(abs(b) for row in surface.file["coefficients"] for b in row) * surface.lsb * surface.unit
        step = max(5 * surface.lsb * surface.unit, size * Fraction(1, 2**24)) + surface.edge_doubt()
        assert highest[0] - highest[1] <= step and lowest[1] - lowest[0] <= step
        # Attained: at the place, as far as its ten digits tell
        for bound, value, x, y in (highest, lowest):
            u, v = (min(max(surface.at(c, k), 0), surface.size[k] - 1) for k, c in enumerate((x, y)))
            assert abs(surface.height(u, v) - value) <= (abs(bound) + size) * Fraction(1, 10**5) + surface.edge_doubt()


def test_a_flat_surface_is_exact(tmp_path):
    path = write_surrogate(tmp_path / "flat.json", [[3] * 5] * 4, unit=0.5, lsb=2, frame={"origin": [0, 0, 7]})
    for line in ask("window", path):
        bound, value, _, _ = numbers(line)
        assert abs(bound - Fraction(13, 2)) <= 1 and abs(value - Fraction(13, 2)) <= 1
        assert "6.5" in line or "7.5" in line or "5.5" in line


def test_less_budget_is_looser_never_wrong(tmp_path):
    path = write_surrogate(tmp_path / "s.json", noise(9, 12, 12))
    surface = Surface(path)
    truth = [numbers(line) for line in ask("window", path)]
    last = None
    for budget in (0, 1, 60, 121, 130, 10**6):
        lines = ask("window", path, "--budget", budget)
        bounds = [Fraction(float(line.split()[1])) for line in lines]
        assert bounds[0] >= truth[0][1] and bounds[1] <= truth[1][1]
        assert last is None or (bounds[0] <= last[0] and bounds[1] >= last[1])
        last = bounds
        assert ("attained" in lines[0]) == (budget > 0)
    assert last == [truth[0][0], truth[1][0]]
    assert max(surface.height(u, v) for u, v in lattice(surface)) <= truth[0][0]


def test_covered_counts_data_alone(tmp_path):
    spike = [[0] * 8 for _ in range(8)]
    spike[1][1] = 600
    trim = [[0] * 7 for _ in range(7)]
    trim[5][5] = 1
    path = write_surrogate(tmp_path / "s.json", spike, trim=trim)
    assert numbers(ask("window", path)[0])[0] > 200
    assert abs(numbers(ask("window", path, "--covered")[0])[0]) <= 1
    refused(canopy("window", path, "--covered", "--window=0,1,0,1"), "s.json", "--covered")


# -- clearance ---------------------------------------------------------------------------------------------------------


def test_clearance_of_two_is_a_guarantee(tmp_path):
    for seed in range(4):
        a = write_surrogate(tmp_path / "a.json", noise(seed), lsb=0.5)
        b = write_surrogate(tmp_path / "b.json", noise(seed + 50, whole=seed < 2), lsb=[0.5, 0.25, 1, 0.3][seed],
                            side="below")
        first, second = Surface(a), Surface(b)
        for window in windows(first):
            least, most = (numbers(line) for line in ask("clearance", a, b, *option(window)))
            distances = [first.height(u, v) - second.height(u, v) for u, v in lattice(first, window)]
            assert least[0] <= min(distances) and max(distances) <= most[0]
            assert least[0] <= least[1] and most[0] >= most[1] and most[0] - most[1] <= 8


def test_a_sandwich_is_clear(tmp_path):
    points = [(x, y, z) for x, y, z in hills(1000)] + [(x, y, z - 0.5) for x, y, z in hills(1000)]
    above = fit(tmp_path, "above", points=points)
    below = fit(tmp_path, "below", "--side", "below", "--frame", above, points=points)
    least = numbers(ask("clearance", above, below, "--covered")[0])
    assert least[0] > 0
    assert numbers(ask("clearance", below, above, "--covered")[1])[0] == -least[0]


@pytest.mark.parametrize("plane", [(0, 0, 0), (1.5, -2.25, 3), (1e-7, 1e7, -1e12), (-300.1, 0.3, 1e5)])
def test_clearance_to_a_plane_is_a_guarantee(surrogate, plane):
    surface = Surface(surrogate)
    a, b, c = (Fraction(x) for x in plane)
    lines = ask("clearance", surrogate, "--plane=" + ",".join(map(str, plane)))
    least, most = (numbers(line) for line in lines)
    a, b, c = (Fraction(float(x)) for x in plane)
    distances = [surface.height(u, v) - (a * surface.place(u, 0) + b * surface.place(v, 1) + c)
                 for u, v in lattice(surface)]
    assert least[0] <= min(distances) and max(distances) <= most[0]
    assert least[0] <= least[1] and most[0] >= most[1]
    size = max(abs(x) for x in distances) + max(abs(surface.height(u, v)) for u, v in lattice(surface))
    assert most[0] - most[1] <= size * Fraction(1, 10**5) + 12 * surface.lsb * surface.unit + surface.edge_doubt()


DIFFERENT = {"unit": ({"unit": 2}, "units"), "size": ({}, "sizes"), "pitch": ({"frame": {"pitch": [1, 2]}}, "pitches"),
             "axes": ({"frame": {"axes": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]}}, "axes"),
             "origin": ({"frame": {"origin": [0, 0, 1]}}, "origins")}


@pytest.mark.parametrize("command", ["clearance", "volume", "diff"])
@pytest.mark.parametrize("name", DIFFERENT)
def test_different_frames_are_refused(tmp_path, command, name):
    changes, word = DIFFERENT[name]
    a = write_surrogate(tmp_path / "a.json", noise(1))
    b = write_surrogate(tmp_path / "b.json", noise(1, 6, 6) if name == "size" else noise(1), **changes)
    done = canopy(command, a, b)
    refused(done, "a.json", "b.json", word, "--frame")
    assert done.stdout == ""


# -- volume ------------------------------------------------------------------------------------------------------------


def volume_of(*arguments):
    words = ask("volume", *arguments)[0].split()
    assert words[0] == "volume" and words[3] == "area" and words[5] == "cells"
    return Fraction(float(words[1])), Fraction(float(words[2])), float(words[4]), int(words[6])


def integral(surface, window=None):
    """Of the height, exactly: Gauss's rule with 2 points is exact for cubics, on every part of a knot cell."""
    u0, u1, v0, v1 = window or surface.edges(exact=True)
    total = Fraction(0)
    root = Fraction(math.isqrt(10**40 // 3), 10**20) / 1  # 1/sqrt(3), to 20 digits
    n = 4 if surface.file.get("windows") else 1
    for axis_u in parts(surface.at(u0, 0), surface.at(u1, 0), n):
        for axis_v in parts(surface.at(v0, 1), surface.at(v1, 1), n):
            for s in (-1, 1):
                for t in (-1, 1):
                    u, v = (((b + a) + sign * root * (b - a)) / 2 for (a, b), sign in ((axis_u, s), (axis_v, t)))
                    total += surface.height(u, v) * (axis_u[1] - axis_u[0]) * (axis_v[1] - axis_v[0]) / 4
    return total * surface.pitch[0] * surface.pitch[1] * surface.unit**2


def parts(low, high, n):
    """Between the knots of n to an interval."""
    edges = [low] + [Fraction(k, n) for k in range(floor(n * low) + 1, math.ceil(n * high))] + [high]
    return list(zip(edges, edges[1:]))


def test_volume_is_the_integral(surrogate):
    surface = Surface(surrogate)
    for window in windows(surface)[:2]:
        low, high, area, _ = volume_of(surrogate, "--height=0.5", *option(window))
        u0, u1, v0, v1 = window or surface.edges(exact=True)
        true_area = (Fraction(u1) - Fraction(u0)) * (Fraction(v1) - Fraction(v0))
        assert area == pytest.approx(float(true_area), rel=1e-5)
        truth = integral(surface, window) - true_area / 2
        # The window is widened by up to 2^-20 of a knot interval at each edge, the frame is not
        size = max(abs(surface.height(u, v) - Fraction(1, 2)) for u, v in lattice(surface, window)) * true_area
        slack = size * (Fraction(1, 2**17) if window else Fraction(1, 10**12))
        assert low - slack <= truth <= high + slack and low <= high
        assert high - low <= size * Fraction(1, 2**18) + true_area * (surface.lsb * surface.unit + surface.edge_doubt())


def test_volume_of_a_flat_surface_is_exact(tmp_path):
    path = write_surrogate(tmp_path / "flat.json", [[3] * 5] * 4, unit=0.5, lsb=2, frame={"pitch": [4, 8]})
    assert volume_of(path, "--height", "1") == (2 * 6 * 16, 2 * 6 * 16, 96.0, 12)
    assert volume_of(path, "--height", "4")[:2] == (-96, -96)
    assert volume_of(path, "--height", "1", "--window=2,4,0,8")[:2] == (32, 32)


def test_volume_between_two_times(tmp_path):
    before = write_surrogate(tmp_path / "before.json", noise(5), lsb=0.25)
    after = write_surrogate(tmp_path / "after.json", noise(6), lsb=0.5)
    low, high, _, _ = volume_of(after, before)
    truth = integral(Surface(after)) - integral(Surface(before))
    slack = Fraction(1, 10**9)
    assert low - slack <= truth <= high + slack and high - low < slack


# -- diff --------------------------------------------------------------------------------------------------------------


def test_diff_says_what_changed_and_where(tmp_path):
    before, after = noise(7, 8, 8), noise(7, 8, 8)
    after[2][5] += 3000
    after[6][1] -= 1500
    trims = [[[1] * 7 for _ in range(7)] for _ in range(2)]
    trims[0][0][0] = trims[0][0][1] = trims[1][6][6] = 0
    a = write_surrogate(tmp_path / "a.json", before, trim=trims[0])
    b = write_surrogate(tmp_path / "b.json", after, trim=trims[1])
    lines = ask("diff", a, b, "--cells")
    rise, fall = numbers(lines[0]), numbers(lines[1])
    assert lines[0].startswith("rise ") and lines[1].startswith("fall ")
    peak = Fraction(4, 9) * 3000
    assert abs(rise[0] - peak) < 2 and (rise[2], rise[3]) == pytest.approx((2, 5), abs=0.01)
    assert abs(fall[0] + peak / 2) < 2 and (fall[2], fall[3]) == pytest.approx((6, 1), abs=0.01)
    assert lines[2] == "cells: 46 covered in both, 2 gained, 1 lost"
    assert len(lines) == 3 + 49
    words = {(int(line.split()[0]), int(line.split()[1])): line.split()[2:] for line in lines[3:]}
    assert words[0, 0] == ["0", "0", "gained"] and words[6, 6][2] == "lost"  # what has not changed says so exactly
    first, second = Surface(a), Surface(b)
    for (row, column), (low, high, _) in words.items():
        for p in range(4):
            u, v = row + Fraction(p, 3), column + Fraction(3 - p, 3)
            assert Fraction(float(low)) <= second.height(u, v) - first.height(u, v) <= Fraction(float(high))


# -- regrid ------------------------------------------------------------------------------------------------------------


def regrid(tmp_path, surrogate, grid, *options):
    out = tmp_path / "regridded.json"
    done = canopy("regrid", surrogate, "--grid", grid, *options, "-o", out)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    return out, done.stdout


def judge_regrid(old_path, new_path, steps=11):
    """The new surface is on the safe side of the old one at every place of a lattice that is covered."""
    old, new = Surface(old_path), Surface(new_path)
    sign = -1 if old.file["side"] == "below" else 1
    assert new.file["side"] == old.file["side"] and new.file.get("certificate") == old.file.get("certificate")
    for u, v in lattice(new, steps=steps):
        s, t = (old.at(new.place(w, axis), axis) for axis, w in ((0, u), (1, v)))
        if 0 <= s <= old.size[0] - 1 and 0 <= t <= old.size[1] - 1 and old.covers(s, t):
            assert sign * (new.height(u, v) - old.height(s, t)) >= 0, (float(u), float(v))


@pytest.mark.parametrize("options", [(), ("--side", "below"), ("--scalar", "fx"), ("--dir", "1,2,3"),
                                     ("--scalar", "fx", "--side", "below", "--dir", "0,1,0"),
                                     ("--method", "tight")], ids=" ".join)
@pytest.mark.parametrize("grid", ["13x17", "7x33", "5x4", "11x8"])
def test_regrid_stays_safe(tmp_path, options, grid):
    old = fit(tmp_path, "old", *options)
    out, line = regrid(tmp_path, old, grid)
    judge_regrid(old, out)
    assert canopy("check", out, tmp_path / "old.xyz").returncode == 0
    assert line.startswith(f"7x9 -> {grid}, ")
    assert ("knots inserted" in line) == (grid in ("13x17", "7x33"))
    kept = [word for word in options if word not in ("--dir", "1,2,3", "0,1,0", "--method", "tight")]
    again = canopy("fit", tmp_path / "old.xyz", "--grid", grid, *kept, "--frame", out, "-o", tmp_path / "again.json")
    assert again.returncode == 0, again.stderr


def test_knots_inserted_leave_the_inside_alone(tmp_path):
    old_path = write_surrogate(tmp_path / "old.json", noise(11, 6, 7, 10**6))
    old, new = Surface(old_path), Surface(regrid(tmp_path, old_path, "21x25")[0])
    for u in range(1, 4):
        for v in range(2, 6):
            p, q = u + Fraction(1, 3), v - Fraction(2, 7)
            assert 0 <= new.height(4 * p, 4 * q) - old.height(p, q) < 4
    assert new.height(0, 0) != old.height(0, 0)


def test_regrid_of_foreign_coefficients(tmp_path):
    for k, surrogate in enumerate((dict(whole=False), dict(size=10**15))):
        old = write_surrogate(tmp_path / "old.json", noise(12 + k, 8, 8, **surrogate), lsb=0.3, side="below")
        for grid in ("15x15", "6x9"):
            judge_regrid(old, regrid(tmp_path, old, grid)[0])


def test_regrid_tight_is_tighter(tmp_path):
    old = fit(tmp_path, "old")
    distances = []
    for method in ("fast", "tight"):
        out, line = regrid(tmp_path, old, "10x10", "--method", method)
        judge_regrid(old, out)
        distances.append(float(line.split("mean distance ")[1]))
    assert 0 < distances[1] < 0.7 * distances[0]


@pytest.mark.parametrize("grid", ["9x11", "17x21", "17x11", "5x6", "9x9"])
@pytest.mark.parametrize("side", ["above", "below"])
def test_regrid_of_refinement_windows(tmp_path, side, grid):
    some = refined(42)[::3] + refined(52)[:grid == "17x21"]
    old = write_surrogate(tmp_path / "old.json", noise(41), windows=some, side=side)
    out, line = regrid(tmp_path, old, grid)
    judge_regrid(old, out)
    assert "windows" not in json.loads(out.read_text())
    assert ("knots inserted" in line) == (grid in ("9x11", "17x21", "17x11"))


def test_two_files_with_windows_of_their_own(tmp_path):
    a = write_surrogate(tmp_path / "a.json", noise(61), windows=refined(62)[:1])
    b = write_surrogate(tmp_path / "b.json", noise(71), windows=refined(72)[1:2], lsb=0.5)
    first, second = Surface(a), Surface(b)
    lines = ask("diff", a, b, "--cells")
    assert len(lines) == 3 + 4 * 5 and lines[2] == "cells: 20 covered in both, 0 gained, 0 lost"
    for line in lines[3:]:
        row, column, low, high, _ = line.split()
        for p in range(5):
            u, v = int(row) + Fraction(p, 4), int(column) + Fraction(4 - p, 4)
            assert Fraction(float(low)) <= second.height(u, v) - first.height(u, v) <= Fraction(float(high))
    low, high, _, _ = volume_of(a, b)
    truth = integral(first) - integral(second)
    assert low <= truth <= high and high - low < 20 * 40  # the edges' coefficients are known on one side


def test_regrid_of_a_part(tmp_path):
    old = fit(tmp_path, "old")
    u0, u1, v0, v1 = Surface(old).edges()
    box = (u0 + 0.3 * (u1 - u0), u0 + 0.9 * (u1 - u0), v0 + 0.25 * (v1 - v0), v0 + 0.6 * (v1 - v0))
    out, _ = regrid(tmp_path, old, "6x6", "--box=" + ",".join(map(repr, box)))
    judge_regrid(old, out)
    edges = Surface(out).edges()
    assert edges[0] <= box[0] and edges[1] >= box[1] and edges[2] <= box[2] and edges[3] >= box[3]
    assert edges[1] - edges[0] < 1.05 * (box[1] - box[0])


# -- what is refused ---------------------------------------------------------------------------------------------------


BAD = {
    ("window", "--window=1,0,0,1"): "--window", ("window", "--window=0,1,0"): "--window",
    ("window", "--window=0,1,0,nan"): "--window", ("window", "--window=0,1,0,99"): "beyond the frame",
    ("window", "--budget=x"): "--budget", ("clearance", "--plane=1,2"): "--plane",
    ("clearance", "--plane=1,2,inf"): "--plane", ("volume", "--height=high"): "--height",
    ("volume", "--height=1", "--window=-9,1,0,1"): "beyond the frame",
    ("regrid", "--grid=3x9", "-o", "out.json"): "--grid", ("regrid", "--grid=5x2000", "-o", "out.json"): "--grid",
    ("regrid", "--grid=seven", "-o", "out.json"): "--grid",
    ("regrid", "-g5x5", "--box=0,1,5,2", "-o", "out.json"): "--box 0,1,5,2: give",
    ("regrid", "--grid=5x5", "--box=0,1,5,200", "-o", "out.json"): "--box 0,1,5,200: it reaches beyond the frame",
    ("regrid", "--grid=5x5", "-o", "nowhere/out.json"): "nowhere/out.json",
}


@pytest.mark.parametrize("arguments", BAD, ids=" ".join)
def test_bad_input_is_named(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    path = write_surrogate(tmp_path / "s.json", noise(1))
    done = canopy(arguments[0], path, *arguments[1:])
    refused(done, BAD[arguments])
    assert done.stdout == "" and left_behind(tmp_path, "s.json")


@pytest.mark.parametrize("command", [["window"], ["clearance", "--plane=0,0,0"], ["volume", "--height=0"],
                                     ["regrid", "--grid=5x5"]], ids=lambda c: c[0])
def test_bad_files_are_named(tmp_path, command):
    refused(canopy(command[0], tmp_path / "none.json", *command[1:]), "none.json")
    bad = tmp_path / "bad.json"
    bad.write_text("{")
    refused(canopy(command[0], bad, *command[1:]), "bad.json")


def test_nothing_covered_is_said(tmp_path):
    path = write_surrogate(tmp_path / "s.json", noise(1), trim=[[0] * 5] * 4)
    refused(canopy("window", path, "--covered"), "s.json", "covered")
    refused(canopy("regrid", path, "--grid=7x7", "-o", tmp_path / "out.json"), "s.json", "covered")
    assert volume_of(path, "--height=0", "--covered") == (0, 0, 0.0, 0)
    assert left_behind(tmp_path, "s.json")


def test_a_turned_frame_has_one_corner(tmp_path):
    old = fit(tmp_path, "old", "--dir", "1,2,3")
    u0, u1, v0, v1 = Surface(old).edges()
    corner, inside = f"--box={u0!r},{(u0 + u1) / 2!r},{v0!r},{v1!r}", f"--box={(u0 + u1) / 2!r},{u1!r},{v0!r},{v1!r}"
    judge_regrid(old, regrid(tmp_path, old, "6x6", corner)[0])
    refused(canopy("regrid", old, "--grid=6x6", inside), "--box", "corner")


@pytest.mark.parametrize("arguments", [["window"], ["window", "a", "b"], ["clearance", "a"], ["volume", "a"],
                                       ["clearance", "a", "b", "--plane=0,0,0"], ["volume", "a", "b", "--height=0"],
                                       ["volume", "a", "--height=0", "--budget=3"], ["diff", "a"], ["regrid", "a"],
                                       ["diff", "a", "b", "c"]], ids=" ".join)
def test_wrong_usage(arguments):
    assert canopy(*arguments).returncode == 64


def test_the_help_names_every_question():
    words = canopy("--help").stdout
    for command in ("window", "clearance", "volume", "diff", "regrid"):
        assert f"\n  {command} " in words
        manual = canopy(command, "--help")
        assert manual.returncode == 0 and "Exit status" in manual.stdout and "input units" in manual.stdout


# -- gradient and normal -----------------------------------------------------------------------------------------------


def received(surface, point):
    """Where the device sees an input point, in knot intervals: rounded to its numbers."""
    unit = surface.file["unit"]
    if surface.file["scalar"] == "fx":
        device = [round(c / unit) for c in point]
    else:
        device = struct.unpack("3f", struct.pack("3f", *(c / unit for c in point)))
    frame = surface.file["frame"]
    return [sum(Fraction(a) * (Fraction(p) - Fraction(o)) for a, p, o in zip(axis, device, frame["origin"])) / pitch
            for axis, pitch in zip(frame["axes"][:2], surface.pitch)]


def test_normals_are_the_slope(surrogate, tmp_path):
    surface = Surface(surrogate)
    axes, origin = surface.file["frame"]["axes"], surface.file["frame"]["origin"]
    places = lattice(surface, steps=4)
    inputs = [[float(surface.unit * (Fraction(o) + sum(Fraction(axes[a][k]) * w * surface.pitch[a]
                                                       for a, w in ((0, u), (1, v)))))
               for k, o in enumerate(origin)] for u, v in places]
    points = write_points(tmp_path / "p.xyz", inputs)
    lines = ask("eval", surrogate, points, "--normals", "--trim=frame")
    plain = ask("eval", surrogate, points, "--trim=frame")
    assert len(lines) == len(places) == len(plain)
    seen = 0
    for line, height, point in zip(lines, plain, inputs):
        assert line.split()[0] == height
        if height == "nan":
            continue  # rounded beyond the edge
        u, v = received(surface, point)
        gu, gv, *normal = map(float, line.split()[1:])
        tiny = Fraction(1, 10**9)
        for axis, told in ((0, gu), (1, gv)):
            lower, upper = ((max(u - tiny, 0), v), (min(u + tiny, surface.size[0] - 1), v)) if axis == 0 else \
                           ((u, max(v - tiny, 0)), (u, min(v + tiny, surface.size[1] - 1)))
            true = (surface.height(*upper) - surface.height(*lower)) / surface.unit / surface.pitch[axis] \
                / (upper[axis] - lower[axis])
            size = max(abs(Fraction(b)) for row in surface.file["coefficients"] for b in row) * surface.lsb
            assert abs(float(true) - told) <= 1e-4 * abs(float(true)) + 1e-6 * float(size / surface.pitch[axis])
        length = math.sqrt(gu * gu + gv * gv + 1)
        expected = [(axes[2][k] - gu * axes[0][k] - gv * axes[1][k]) / length for k in range(3)]
        assert normal == pytest.approx(expected, abs=1e-12) and math.hypot(*normal) == pytest.approx(1, abs=1e-6)
        seen += 1
    assert seen >= 5
