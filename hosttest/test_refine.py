"""`canopy fit --refine`, and grids far from square: safe, what was asked for, and nothing else.

Scenes are made here from a seed. Where ../shared is present, the referee there judges every surrogate as well.
"""

import json

import pytest

from test_cli import canopy, fit, hills, judge, left_behind, mean_gap, refused, scene, write_points  # noqa: F401


def verdict_is_safe(out, points, line):
    done = canopy("check", out, points)
    assert done.returncode == 0, done.stdout
    verdict = judge(out, points)
    if verdict:
        assert verdict["wrong_side"] == verdict["outside_frame"] == 0
        assert mean_gap(line) == pytest.approx(100 * verdict["mean_gap"], rel=1e-3, abs=1e-3)


def heights(surrogate, points):
    done = canopy("eval", surrogate, points)
    assert done.returncode == 0, done.stderr
    return [float(line) for line in done.stdout.split()]


# -- refined -----------------------------------------------------------------------------------------------------------

WHERE = [("1",), ("3@1",), ("2:2x3@2",), ("1:7x8@1",), ("0.5,0.5,2,1.5@2",), ("0.5,0.5,2.4,1.9", "2@2"), ("1@2", "1@1")]
HOW = [(), ("--method", "tight"), ("--scalar", "fx", "--side", "below"), ("--field", "4"),
       ("--field", "8", "--scalar", "fx", "--side", "below"), ("--dir", "0.2,0.1,1", "--unit", "0.5")]


@pytest.mark.parametrize("how", HOW, ids=" ".join)
@pytest.mark.parametrize("where", WHERE, ids=" ".join)
def test_refined_is_safe_and_nearer(tmp_path, scene, where, how):  # noqa: F811
    if "--dir" in how and "," in where[0]:
        where = ("0.5,0.5,1.4,1.2",) + where[1:]  # the axes are turned
    _, plain = fit(tmp_path, scene, *how, name="plain.json")
    out, line = fit(tmp_path, scene, *how, *(word for w in where for word in ("--refine", w)))
    verdict_is_safe(out, scene, line)
    assert mean_gap(line) < mean_gap(plain)
    document = json.loads(out.read_text())
    windows = document["windows"]
    count = 8 * 9 + sum(w["size"][0] * w["size"][1] for w in windows)
    assert f"8x9 with {len(windows)} window{'s' if len(windows) > 1 else ''} ({count} coefficients)" in line
    assert document["certificate"]["margin"] >= 0
    assert all(any(c != 0 for row in w["coefficients"] for c in row) for w in windows)
    assert [w["level"] for w in windows] == sorted(w["level"] for w in windows)


def test_nothing_changes_outside_the_window(tmp_path, scene):  # noqa: F811
    plain, _ = fit(tmp_path, scene, "--scalar", "fx", "--unit", "1e-5", name="plain.json")
    out, _ = fit(tmp_path, scene, "--scalar", "fx", "--unit", "1e-5", "--refine", "0.8,0.5,2.2,1.5@2")
    points = [tuple(map(float, line.split())) for line in scene.read_text().splitlines()]
    before, after = heights(plain, scene), heights(out, scene)
    window = json.loads(out.read_text())["windows"][0]
    frame = json.loads(out.read_text())["frame"]
    low, high = ([(frame["origin"][a] + frame["pitch"][a] / 4 * (window["first"][a] + by[a])) * 1e-5 for a in range(2)]
                 for by in ((-2, -2), [n + 1 for n in window["size"]]))
    # the corners asked for, to half a fine interval
    assert low == pytest.approx([0.8, 0.5], abs=frame["pitch"][0] * 1e-5 / 8)
    assert high == pytest.approx([2.2, 1.5], abs=frame["pitch"][0] * 1e-5 / 8)
    inside = [all(low[a] < p[a] < high[a] for a in range(2)) for p in points]
    assert any(inside) and not all(inside)
    moved = [b - a for a, b in zip(before, after)]
    shift = min(m for m, i in zip(moved, inside) if not i)  # whole steps, over all
    assert abs(shift) < 1e-4
    assert all(m == pytest.approx(shift, abs=1e-12) for m, i in zip(moved, inside) if not i)
    assert min(moved) < -0.01


def test_a_window_of_windows(tmp_path, scene):  # noqa: F811
    """A quarter-pitch window inside a half-pitch one, which is fitted first whatever the order."""
    lines = [fit(tmp_path, scene, *options)[1] for options in (
        ("--refine", "0.4,0.4,2.6,1.7"), ("--refine", "0.8,0.6,2.2,1.5@2", "--refine", "0.4,0.4,2.6,1.7"))]
    assert mean_gap(lines[1]) < mean_gap(lines[0])


def test_as_fine_as_a_finer_grid(tmp_path, scene):  # noqa: F811
    """A window over everything has every surface of the finer grid within it."""
    _, finer = fit(tmp_path, scene, "--method", "tight", grid="15x17")
    _, refined = fit(tmp_path, scene, "--refine", "1:7x8")
    assert mean_gap(refined) < 1.02 * mean_gap(finer)


def test_a_refined_surrogate_lends_its_frame(tmp_path, scene):  # noqa: F811
    first, _ = fit(tmp_path, scene, "--refine", "2", name="first.json")
    out, line = fit(tmp_path, scene, "--frame", str(first), "--refine", "1@2")
    verdict_is_safe(out, scene, line)
    assert json.loads(out.read_text())["frame"] == json.loads(first.read_text())["frame"]


BAD = [("no form", "middle", "give N, N:RxC or X0,Y0,X1,Y1"), ("level 3", "1@3", "@1 for half"), ("level 0", "1@0", "@1"),
       ("no level", "1@", "@1"), ("none", "0", "from 1 to 8"), ("nine", "9", "from 1 to 8"), ("half a size", "1:3", "RxC"),
       ("three numbers", "1,2,3", "X0,Y0,X1,Y1"), ("five numbers", "1,2,3,4,5", "X0"), ("no number", "0,0,1,nan", "X0"),
       ("empty", "", "give N"), ("size nought", "1:0x3", "RxC"),
       ("outside", "5,5,6,6", "not inside the grid: it reaches from "),
       ("partly outside", "1,1,2,2.5", "not inside the grid"), ("left of it", "-1,0.1,1,1", "not inside the grid"),
       ("small", "1,1,1.1,1.1@2", "too small"), ("nothing", "1,1,1,1", "too small"),
       ("larger than the grid", "1:8x8", "7x8 knot intervals")]


@pytest.mark.parametrize("text, words", [pytest.param(*bad[1:], id=bad[0]) for bad in BAD])
def test_bad_windows_are_refused(tmp_path, scene, text, words):  # noqa: F811
    done = canopy("fit", scene, "--grid", "8x9", f"--refine={text}", "-o", tmp_path / "out.json")
    refused(done, f"--refine {text}", words)
    assert left_behind(tmp_path, "scene.xyz")


def test_no_more_windows_than_there_is_room_for(tmp_path, scene):  # noqa: F811
    out, line = fit(tmp_path, scene, "--refine", "8:4x4")
    assert 1 <= len(json.loads(out.read_text())["windows"]) < 8
    flat = write_points(tmp_path / "flat.xyz", [(x / 10, y / 10, 4) for x in range(20) for y in range(20)])
    out, line = fit(tmp_path, flat, "--field", "4", "--refine", "3")  # nothing is to be won
    verdict_is_safe(out, flat, line)


def test_too_many_windows_are_refused(tmp_path, scene):  # noqa: F811
    many = ["--refine=0,0,1,1"] * 9
    refused(canopy("fit", scene, "--grid", "8x9", *many), "at most 8 times")
    refused(canopy("fit", scene, "--grid", "8x9", "--refine=8:2x2", "--refine=0.5,0.5,2,1@2"), "more than 8 windows")


@pytest.mark.parametrize("field, where", [("3", "1"), ("6", "1@2"), ("1", "1")])
def test_a_field_must_hold_the_fine_cells(tmp_path, scene, field, where):  # noqa: F811
    done = canopy("fit", scene, "--grid", "8x9", "--field", field, "--refine", where)
    refused(done, f"--refine {where}: give a --field that is a multiple of {4 if '@2' in where else 2}")


# -- m is not n --------------------------------------------------------------------------------------------------------

EXTREMES = ["4x1024", "1024x4", "4x333", "211x5"]


@pytest.mark.parametrize("grid", EXTREMES)
@pytest.mark.parametrize("how", [(), ("--method", "tight"), ("--field", "2"), ("--field", "3", "--side", "below")],
                         ids=" ".join)
@pytest.mark.parametrize("scalar", ["f32", "fx"])
def test_grids_far_from_square(tmp_path, scene, grid, how, scalar):  # noqa: F811
    out, line = fit(tmp_path, scene, "--scalar", scalar, *how, grid=grid)
    verdict_is_safe(out, scene, line)
    assert json.loads(out.read_text())["size"] == [int(n) for n in grid.split("x")]


@pytest.mark.parametrize("grid", ["1024x4", "4x300"])
def test_grids_far_from_square_are_refined(tmp_path, scene, grid):  # noqa: F811
    out, line = fit(tmp_path, scene, "--refine", "2:3x3@2", "--refine", "1:2x3", grid=grid)
    verdict_is_safe(out, scene, line)


def test_a_scene_and_its_transpose_are_alike(tmp_path):
    points = list(hills(3000))
    one = write_points(tmp_path / "one.xyz", points)
    other = write_points(tmp_path / "other.xyz", [(y, x, z) for x, y, z in points])
    gaps = [mean_gap(fit(tmp_path, points, "--method", "tight", grid=grid)[1])
            for points, grid in ((one, "6x40"), (other, "40x6"))]
    assert gaps[0] == pytest.approx(gaps[1], rel=0.03)
