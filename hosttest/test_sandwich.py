"""`canopy sandwich` as a user meets it: two files that are each safe and cross nowhere, and what is said where they do.

Whether they cross is looked at here once more, in fractions: where no difference of coefficients is negative they do
not, elsewhere the B-splines are evaluated at samples.
"""

import json
from fractions import Fraction

import pytest

from test_cli import SHARED, canopy, judge, left_behind, mean_gap, needs_scans, refused, write_points
from test_cli import scene  # noqa: F401 a fixture

SIDES = ("above", "below")


def sandwich(tmp_path, points, *options, grid="8x9", name="pair"):
    done = canopy("sandwich", points, "--grid", grid, *options, "-o", tmp_path / name)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 3 and " above, " in lines[0] and " below, " in lines[1], done.stdout
    assert lines[2].startswith("never crossing: "), done.stdout
    return [tmp_path / f"{name}.{side}.json" for side in SIDES], lines


def weights(s):
    """The four uniform cubic B-splines at s, exact."""
    return [(1 - s) ** 3 / 6, (3 * s ** 3 - 6 * s ** 2 + 4) / 6, (-3 * s ** 3 + 3 * s ** 2 + 3 * s + 1) / 6, s ** 3 / 6]


def difference_is_nowhere_negative(files, per_cell=3):
    above, below = (json.loads(f.read_text()) for f in files)
    assert [above["side"], below["side"]] == ["above", "below"]
    for key in ("unit", "scalar", "frame", "size", "lsb"):
        assert above[key] == below[key]
    m, n = above["size"]
    rows = zip(above["coefficients"], below["coefficients"])
    d = [[Fraction(a) - Fraction(b) for a, b in zip(*row)] for row in rows]
    clip = lambda i, size: min(max(i, 0), size - 1)  # noqa: E731
    steps = [Fraction(k, per_cell) for k in range(per_cell + 1)]
    for h in range(m - 1):
        for w in range(n - 1):
            cell = [[d[clip(h + a, m)][clip(w + b, n)] for b in range(-1, 3)] for a in range(-1, 3)]
            if min(min(row) for row in cell) >= 0:
                continue
            for wu in map(weights, steps):
                for wv in map(weights, steps):
                    assert sum(x * y * c for x, row in zip(wu, cell) for y, c in zip(wv, row)) >= 0, (h, w)


OPTIONS = [(), ("--scalar", "fx"), ("--field", "4"), ("--field", "5", "--scalar", "fx"), ("--method", "tight"),
           ("--method", "tight", "--scalar", "fx"), ("--method", "tight", "--field", "4"), ("--field", "6", "--packed"),
           ("--dir", "1,2,3"), ("--dir", "0.3,-0.2,-1", "--method", "tight"),
           ("--dir=-0.800533,-0.925262,0.79264",),
           ("--dir", "0.3,-0.2,-1", "--scalar", "fx", "--field", "3"), ("--unit", "0.25")]


@pytest.mark.parametrize("options", OPTIONS, ids=" ".join)
def test_both_are_safe_and_never_cross(tmp_path, scene, options):  # noqa: F811
    files, lines = sandwich(tmp_path, scene, *options)
    for file, line in zip(files, lines):
        done = canopy("check", file, scene)
        assert done.returncode == 0, done.stdout
        verdict = judge(file, scene)
        if verdict:
            assert verdict["wrong_side"] == verdict["outside_frame"] == 0
            assert mean_gap(line) == pytest.approx(100 * verdict["mean_gap"], rel=1e-3)
        assert json.loads(file.read_text())["certificate"]["margin"] >= 0
        assert str(file) in line
    difference_is_nowhere_negative(files)
    done = canopy("sandwich", "--check", *files)
    assert done.returncode == 0 and done.stdout.strip() == lines[2]
    assert left_behind(tmp_path, "scene.xyz", *(f.name for f in files))


@pytest.mark.parametrize("method", ["fast", "tight"])
@pytest.mark.parametrize("scalar", ["f32", "fx"])
@pytest.mark.parametrize("name, points", [
    ("one point", [(3.5, -2.25, 7.125)]),
    ("one point far from zero", [(3292.97912, 7801.01409, 3.9868995)]),
    ("one column", [(1, 1, z / 7) for z in range(300)]),
    ("flat", [(x / 10, y / 10, 4) for x in range(20) for y in range(20)]),
    ("one plane", [(x / 8, y / 8, x / 2 + y / 4) for x in range(20) for y in range(20)]),
    ("cliff", [(x / 10, y / 10, 100 * (x >= 10)) for x in range(20) for y in range(20)]),
    ("two floors", [(x / 10, y / 10, z) for x in range(20) for y in range(20) for z in (0, 5)]),
    ("a hole", [(x, y, (x * y) % 7) for x in range(30) for y in range(30) if abs(x - 15) > 6 or abs(y - 15) > 6]),
], ids=lambda x: x if isinstance(x, str) else "")
def test_hard_scenes(tmp_path, name, points, scalar, method):
    file = write_points(tmp_path / "scene.xyz", points)
    files, _ = sandwich(tmp_path, file, "--scalar", scalar, "--method", method, grid="6x5")
    for surrogate in files:
        assert canopy("check", surrogate, file).returncode == 0
    difference_is_nowhere_negative(files)


@pytest.mark.parametrize("grid", ["4x40", "40x4"])
@pytest.mark.parametrize("options", [(), ("--method", "tight"), ("--method", "tight", "--field", "3")], ids=" ".join)
def test_long_grids(tmp_path, scene, grid, options):  # noqa: F811
    files, _ = sandwich(tmp_path, scene, *options, grid=grid)
    for surrogate in files:
        assert canopy("check", surrogate, scene).returncode == 0
    difference_is_nowhere_negative(files)


def test_tight_is_tighter(tmp_path, scene):  # noqa: F811
    _, fast = sandwich(tmp_path, scene, name="fast")
    _, tight = sandwich(tmp_path, scene, "--method", "tight", name="tight")
    for k in range(2):
        assert mean_gap(tight[k]) < 0.8 * mean_gap(fast[k])
        assert "from the tightest possible beside the other" in tight[k]


def test_the_frame_of_another(tmp_path, scene):  # noqa: F811
    first, _ = sandwich(tmp_path, scene, name="first")
    again, _ = sandwich(tmp_path, scene, "--frame", first[0], name="again")
    frames = [json.loads(f.read_text())["frame"] for f in first + again]
    assert frames.count(frames[0]) == 4


def test_without_output_only_lines(tmp_path, scene):  # noqa: F811
    done = canopy("sandwich", scene, "--grid", "8x9")
    assert done.returncode == 0 and done.stdout.count("\n") == 3
    assert left_behind(tmp_path, "scene.xyz")


@needs_scans
def test_real_scans_cross_unless_kept_apart(tmp_path):
    scan = SHARED / "data" / "bun000.xyz"
    naive = [tmp_path / f"naive.{side}.json" for side in SIDES]
    for method in ("fast", "tight"):
        for side, file in zip(SIDES, naive):
            done = canopy("fit", scan, "--grid", "20x20", "--side", side, "--method", method, "-o", file)
            assert done.returncode == 0, done.stderr
        done = canopy("sandwich", "--check", *naive)
        assert done.returncode == 1 and done.stdout.startswith("CROSSING: "), done.stdout
        files, _ = sandwich(tmp_path, scan, "--method", method, grid="20x20")
        for file in files:
            assert canopy("check", file, scan).returncode == 0
        difference_is_nowhere_negative(files, per_cell=2)


# -- --check -----------------------------------------------------------------------------------------------------------

def edited(file, to, change):
    document = json.loads(file.read_text())
    change(document)
    to.write_text(json.dumps(document))
    return to


def test_check_sees_a_crossing_of_one_step(tmp_path, scene):  # noqa: F811
    files, _ = sandwich(tmp_path, scene)
    below = json.loads(files[1].read_text())

    def touch(document):
        document["coefficients"] = [list(row) for row in below["coefficients"]]

    def cross(document):
        touch(document)
        document["coefficients"][3][4] -= 1
    same = edited(files[0], tmp_path / "same.json", touch)
    done = canopy("sandwich", "--check", same, files[1])
    assert done.returncode == 0 and "they touch" in done.stdout
    lower = edited(files[0], tmp_path / "lower.json", cross)
    for order in ((lower, files[1]), (files[1], lower)):
        done = canopy("sandwich", "--check", *order)
        assert done.returncode == 1 and done.stdout.startswith("CROSSING: ") and "u 3, v 4" in done.stdout, done.stdout


def test_check_takes_windows_into_account(tmp_path, scene):  # noqa: F811
    files, _ = sandwich(tmp_path, scene)
    # a dent as deep as the world, of one coefficient at half pitch: between the knots of a level
    dent = {"level": 1, "first": [7, 9], "size": [1, 1], "coefficients": [[-1e9]]}
    dented = edited(files[0], tmp_path / "dented.json", lambda d: d.update(windows=[dent]))
    done = canopy("sandwich", "--check", dented, files[1])
    assert done.returncode == 1 and "u 3.5, v 4.5" in done.stdout, done.stdout
    raised = dict(dent, coefficients=[[1e9]], level=2, first=[13, 18])
    bumped = edited(files[0], tmp_path / "bumped.json", lambda d: d.update(windows=[raised]))
    assert canopy("sandwich", "--check", bumped, files[1]).returncode == 0


@pytest.mark.parametrize("change, words", [
    (lambda d: d["frame"]["origin"].__setitem__(0, 77), ("differ", "one frame")),
    (lambda d: d["frame"]["pitch"].__setitem__(1, 77), ("differ",)),
    (lambda d: d.update(unit=2), ("differ",)),
    (lambda d: d.update(side="above"), ("both are surfaces above", "one below")),
])
def test_what_cannot_be_compared(tmp_path, scene, change, words):  # noqa: F811
    files, _ = sandwich(tmp_path, scene)
    other = edited(files[1], tmp_path / "other.json", change)
    refused(canopy("sandwich", "--check", files[0], other), str(files[0]), str(other), *words)


# -- bad input and usage -----------------------------------------------------------------------------------------------

@pytest.mark.parametrize("text, words", [
    ("1 2\n", ("scene.xyz:1",)), ("", ("scene.xyz",)), ("1 2 nan\n", ("scene.xyz:1",))])
def test_bad_points_leave_nothing_behind(tmp_path, text, words):
    file = tmp_path / "scene.xyz"
    file.write_text(text)
    refused(canopy("sandwich", file, "--grid", "8x8", "-o", tmp_path / "pair"), *words)
    assert left_behind(tmp_path, "scene.xyz")


def test_the_name_may_end_as_the_files_do(tmp_path, scene):  # noqa: F811
    done = canopy("sandwich", scene, "--grid", "8x8", "-o", tmp_path / "pair.json")
    assert done.returncode == 0 and left_behind(tmp_path, "scene.xyz", "pair.above.json", "pair.below.json")


def test_what_cannot_be_written_leaves_nothing_behind(tmp_path, scene):  # noqa: F811
    refused(canopy("sandwich", scene, "--grid", "8x8", "-o", tmp_path / "no" / "pair"), "cannot write")
    refused(canopy("sandwich", scene, "--grid", "8x8", "-o", "-"), "cannot write")
    assert left_behind(tmp_path, "scene.xyz")
    # the second file cannot be written: neither is there, and what stood in the first's place still stands
    (tmp_path / "pair.below.json").mkdir()
    (tmp_path / "pair.above.json").write_text("mine")
    refused(canopy("sandwich", scene, "--grid", "8x8", "-o", tmp_path / "pair"), "pair.below.json", "cannot write")
    assert (tmp_path / "pair.above.json").read_text() == "mine"
    assert left_behind(tmp_path, "scene.xyz", "pair.above.json", "pair.below.json")
    assert list((tmp_path / "pair.below.json").iterdir()) == []


@pytest.mark.parametrize("arguments", [
    ("POINTS",), ("--grid", "8x8"), ("POINTS", "--grid", "8x8", "--side", "above"),
    ("POINTS", "POINTS", "--grid", "8x8"), ("POINTS", "--grid", "8x8", "--method", "loose"),
    ("POINTS", "--grid", "8x8", "--frame", "x.json", "--dir", "1,1,1"),
    ("--check", "POINTS", "POINTS", "--field", "4"), ("--check", "POINTS", "POINTS", "--scalar", "f32"),
    ("--check", "POINTS", "POINTS", "--method", "tight"), ("--check", "POINTS"),
    ("--check", "POINTS", "POINTS", "-o", "x"), ("--check", "POINTS", "POINTS", "--grid", "8x8"),
])
def test_wrong_usage(tmp_path, scene, arguments):  # noqa: F811
    done = canopy("sandwich", *(scene if a == "POINTS" else a for a in arguments))
    assert done.returncode == 64 and done.stdout == ""
    assert left_behind(tmp_path, "scene.xyz")


def test_help_is_the_manual():
    done = canopy("sandwich", "--help")
    assert done.returncode == 0
    for word in ("--grid", "--check", "OUT.above.json", "cross nowhere", "Exit status"):
        assert word in done.stdout
    assert "sandwich" in canopy("--help").stdout
