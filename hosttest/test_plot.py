"""`canopy plot` as a user meets it: each kind of picture, what it says, and what is refused.

Pictures are looked at as SVG, whose texts are texts: panels by their titles, axes by their labels, numbers against what
the other commands say.
"""

import json
import math
import random
import re
import struct
import subprocess
import xml.etree.ElementTree
from pathlib import Path

import pytest

from test_cli import canopy, fit, hills, left_behind, refused, write_points
from test_cli import scene  # noqa: F401 a fixture

if subprocess.run(["/usr/bin/python3", "-c", "import matplotlib"], capture_output=True).returncode != 0:
    pytest.skip("no matplotlib", allow_module_level=True)

ROOT = Path(__file__).resolve().parent.parent


def texts(path):
    """All there is to read in an SVG, a line each."""
    root = xml.etree.ElementTree.parse(path).getroot()
    return ["".join(e.itertext()).strip() for e in root.iter("{http://www.w3.org/2000/svg}text")]


def read(tmp_path, *arguments, show="gap"):
    """The texts of the picture that these arguments give, a line each. What is in perspective takes longest to draw."""
    out = tmp_path / "picture.svg"
    done = canopy("plot", *arguments, "--show", show, "-o", out)
    assert done.returncode == 0 and not done.stdout and not done.stderr, done.stderr
    found = "\n".join(texts(out))
    assert "nan" not in found
    out.unlink()
    return found


def says(found, *expected):
    for words in expected:
        assert words in found, (words, found)


PANELS = {"surface": "seen from", "gap": "in a tile", "section": "cross-section at", "trim": "knot cells hold data"}


@pytest.mark.parametrize("show", ["all", *PANELS])
def test_the_panels_asked_for_and_no_others(tmp_path, scene, show):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    found = read(tmp_path, out, scene, show=show)
    for panel, words in PANELS.items():
        assert (words in found) == (panel == show or (show == "all" and panel != "trim")), (panel, found)
    says(found, "x (input units)", "out.json: above every point, 8×9 coefficients, f32", "scene.xyz: 3,000 points",
         "proved for 3,000 points")
    if show != "trim":
        says(found, "y (input units)" if show != "section" else "z (input units)")


def test_the_numbers_are_those_of_fit(tmp_path, scene):  # noqa: F811
    for options in ((), ("--side", "below", "--scalar", "fx"), ("--method", "tight", "--refine", "1")):
        out, line = fit(tmp_path, scene, *options, grid="12x12")
        mean, most = (float(re.search(rf"{name} gap (\S+)%", line).group(1)) for name in ("mean", "max"))
        found = read(tmp_path, out, scene)
        drawn = re.search(r"gap \S+ = (\S+) % in the mean, \S+ = (\S+) % at most", found)
        assert [float(x) for x in drawn.groups()] == pytest.approx([mean, most], rel=6e-3)
        assert f"largest gap: {re.search(r'mean, (.*) at most', found).group(1)}" in found
        assert ("window, half pitch" in found) == ("--refine" in options)
        assert f"{'below' if 'below' in options else 'above'} every point" in found


@pytest.mark.parametrize("suffix, begin", [("png", b"\x89PNG\r\n\x1a\n"), ("PNG", b"\x89PNG\r\n\x1a\n"),
                                           ("svg", b"<?xml"), ("pdf", b"%PDF-")])
def test_the_suffix_is_the_format(tmp_path, scene, suffix, begin):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    picture = tmp_path / f"p.{suffix}"
    same = set()
    for _ in range(2):
        assert canopy("plot", out, scene, "--show", "section", "-o", picture).returncode == 0
        same.add(picture.read_bytes())
    assert len(same) == 1 and same.pop().startswith(begin)
    assert left_behind(tmp_path, "scene.xyz", "out.json", picture.name)


@pytest.mark.parametrize("size", ["640x480", "1600x1200"])
def test_sizes(tmp_path, scene, size):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    picture = tmp_path / "p.png"
    assert canopy("plot", out, scene, "-o", picture, "--show", "gap", "--size", size).returncode == 0
    assert list(struct.unpack(">II", picture.read_bytes()[16:24])) == [int(n) for n in size.split("x")]


def test_a_surface_alone(tmp_path, scene):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    found = read(tmp_path, out, show="all")
    says(found, "height of the surface", "cross-section at", "surface, seen from above")
    assert "gap" not in found and "scene" not in found


def pair(tmp_path, points, *options):
    done = canopy("sandwich", points, "--grid", "8x9", *options, "-o", tmp_path / "part")
    assert done.returncode == 0, done.stderr
    return tmp_path / "part.above.json", tmp_path / "part.below.json"


def test_a_sandwich(tmp_path, scene):  # noqa: F811
    above, below = pair(tmp_path, scene)
    found = read(tmp_path, below, above, scene, show="all")
    says(found, "sandwich of part.above.json and part.below.json", "thickness, from", "both surfaces and",
         "surface, above every point", "surface, below every point", "gap above", "gap below",
         "through the thickest place")
    says(read(tmp_path, above, below), "sandwich of part.above.json and part.below.json", "thickness, from")


def test_a_comparison(tmp_path, scene):  # noqa: F811
    fast, line = fit(tmp_path, scene, name="fast.json")
    tight, _ = fit(tmp_path, scene, "--method", "tight", "--frame", fast, name="tight.json")
    found = read(tmp_path, fast, tight, scene, show="all")
    says(found, "A fast.json and B tight.json: both above every point", "A  fast.json: gap", "B  tight.json: gap",
         "A  fast.json, above every point", "B  tight.json, above every point")
    assert "seen from" not in found
    mean = re.search(r"mean gap A (\S+) %, B (\S+) %", found)
    assert float(mean.group(1)) > float(mean.group(2)) > 0
    says(read(tmp_path, fast, tight), "B above A: from")
    says(read(tmp_path, fast, tight, show="section"), "through the largest change")
    assert read(tmp_path, fast, tight, scene, show="trim").count(PANELS["trim"]) == 2
    assert read(tmp_path, fast, tight, show="surface").count(PANELS["surface"]) == 2


def test_where_the_cross_section_is(tmp_path, scene):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    for at, words in (("u=1.25", "at x = 1.25"), ("x=1.25", "at x = 1.25"), ("v=0.5", "at y = 0.5"),
                      ("y=5e-1", "at y = 0.5"), ("0.5,0.5,2.5,1.5", "from A (0.5, 0.5) to B (2.5, 1.5)")):
        found = read(tmp_path, out, scene, "--at", at, show="section")
        says(found, f"cross-section {words}")
        assert "through" not in found
    says(found, "way from A to B (input units)")


def test_the_axes_of_a_turned_frame(tmp_path, scene):  # noqa: F811
    out, _ = fit(tmp_path, scene, "--dir", "1,2,2")
    says(read(tmp_path, out, scene), "u along (0.94, −0.24, −0.24) (input units)", "v along (0.00, 0.71, −0.71)")
    says(read(tmp_path, out, scene, show="section"), "height along (0.33, 0.67, 0.67)")
    out, _ = fit(tmp_path, scene, "--dir", "0,0,-1")
    says(read(tmp_path, out, scene), "x (input units)", "−y (input units)")
    says(read(tmp_path, out, scene, show="section"), "−z (input units)")


@pytest.mark.parametrize("name, points, grid, options, expected", [
    ("one point", [(3.5, -2.25, 7.125)], "4x4", (), ("1 point,", "x − 3.5 (10⁻⁶ input units)")),
    ("one column", [(1, 1, z / 7) for z in range(300)], "6x5", (), ("300 points", "= 50 % in the mean")),
    ("flat", [(i % 20, i // 20, 1) for i in range(400)], "5x7", (), ("gap 0 in the mean", "height range 0")),
    ("a line", [(i / 10, 0, math.sin(i)) for i in range(200)], "8x8", (), ("200 points",)),
    ("far away", list(hills(2000, scale=10.0, offset=(4.5e6, 5.4e6, 300.0))), "9x9",
     ("--scalar", "fx", "--unit", "0.01"), ("x − 4,500,000 (input units)", "y − 5,400,000 (input units)")),
    ("tiny", list(hills(2000, scale=1e-9)), "9x9", (), ("x (10⁻⁹ input units)",)),
    ("vast", list(hills(2000, scale=1e30)), "9x9", (), ("x (10³⁰ input units)",)),
    ("a strip", [(1000 * x, y, z) for x, y, z in hills(2000)], "30x5", (), ("y (input units)",)),
    ("a wide grid", list(hills(1000)), "4x200", (), ("4×200",)),
    ("a large grid", list(hills(3000)), "300x300", (), ("300×300",)),
])
def test_scenes_of_all_kinds(tmp_path, name, points, grid, options, expected):
    path = write_points(tmp_path / "points.xyz", points)
    out, _ = fit(tmp_path, path, *options, grid=grid)
    says(read(tmp_path, out, path), *expected)
    if name in ("one point", "a large grid"):
        says(read(tmp_path, out, path, show="all"), "seen from above",
             "also where there is no data" if name == "a large grid" else "cross-section")


def test_names_are_shown_as_they_are(tmp_path, scene):  # noqa: F811
    points = tmp_path / "a $x_1$ {b} \\frac %s.xyz"
    points.write_text(scene.read_text())
    out, _ = fit(tmp_path, points, name="-ü$.json")
    says(read(tmp_path, out, points), "-ü$.json: above", "a $x_1$ {b} \\frac %s.xyz: 3,000 points")


def test_points_that_are_no_longer_below(tmp_path, scene):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    others = write_points(tmp_path / "others.xyz", [*hills(500), (1.0, 1.0, 9.0), (1.5, 1.0, 8.0), (50.0, 1.0, 0.0)])
    says(read(tmp_path, out, others), "2 POINTS ON THE WRONG SIDE", "1 point outside the frame, not drawn")
    away = write_points(tmp_path / "away.xyz", [(50.0, 1.0, 0.0)])
    says(read(tmp_path, out, away, show="all"), "1 point outside the frame", "no points over the frame")
    assert "WRONG" not in read(tmp_path, out, scene)


def test_large_clouds_are_thinned_and_it_is_said(tmp_path):
    """Numbers are those of all points; the nearest points are always drawn."""
    code = """
import io, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from pictures import cloud
from pictures.surface import Surrogate
s, points = Surrogate(sys.argv[2]), np.loadtxt(sys.argv[3])
whole = cloud.Cloud("all", [s], io.BytesIO(points.tobytes()))
cloud.KEPT, cloud.CHUNK = 200, 500
few = cloud.Cloud("few", [s], io.BytesIO(points.tobytes()))
assert whole.share == 1 and len(whole.z) == 3000 and few.share < 0.1 and len(few.z) < 3000
for name in ("count", "low", "high"):
    assert getattr(whole, name) == getattr(few, name), name
a, b = whole.gaps[0], few.gaps[0]
assert abs(a.mean - b.mean) < 1e-12 and a.most == b.most and a.worst == b.worst
least = lambda c: (s.height(c.u, c.v) - c.z).min()
assert least(whole) == least(few)
"""
    points = write_points(tmp_path / "scene.xyz", hills(3000))
    out, _ = fit(tmp_path, points)
    done = subprocess.run(["/usr/bin/python3", "-c", code, str(ROOT / "tools"), str(out), str(points)],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_standard_input(tmp_path, scene):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    picture = tmp_path / "p.svg"
    done = canopy("plot", out, "-", "-o", picture, stdin=scene.read_text())
    assert done.returncode == 0
    says("\n".join(texts(picture)), "standard input: 3,000 points")


# -- what is refused ---------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", ["p.gif", "p", "png", "p.png.txt", ".json", "p.jpeg", "/dev/stdout"])
def test_another_suffix(tmp_path, scene, name):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    refused(canopy("plot", out, scene, "-o", tmp_path / name), name, ".png, .svg or .pdf")
    assert left_behind(tmp_path, "scene.xyz", "out.json")


@pytest.mark.parametrize("options, words", [
    (("--at", "u"), "--at u: give"), (("--at", "w=1"), "--at w=1: give"), (("--at", "u=one"), "--at u=one: give"),
    (("--at", "u=nan"), "--at u=nan: give"), (("--at", ""), "--at : give"), (("--at", "1,2,3"), "--at 1,2,3: give"),
    (("--at", "1,1,1,1"), "two different points"), (("--at", "u=99"), "outside the frame, whose first axis goes from"),
    (("--at", "y=-1"), "outside the frame, whose second axis"), (("--at", "0.5,0.5,9,1"), "outside the frame"),
    (("--size", "10"), "--size 10: give WxH"), (("--size", "100x900"), "from 200 to 10000"),
    (("--size", "900x100000"), "from 200 to 10000"), (("--size", "-5x7"), "give WxH"),
], ids=lambda x: " ".join(x) if isinstance(x, tuple) else None)
def test_bad_options(tmp_path, scene, options, words):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    refused(canopy("plot", out, scene, *options, "-o", tmp_path / "p.svg"), words)
    assert left_behind(tmp_path, "scene.xyz", "out.json")


def test_what_does_not_go_together(tmp_path, scene):  # noqa: F811
    out, _ = fit(tmp_path, scene)
    other, _ = fit(tmp_path, scene, grid="9x9", name="other.json")
    picture = tmp_path / "p.png"
    refused(canopy("plot", out, other, "-o", picture), "out.json and ", "other.json", "--frame")
    refused(canopy("plot", out, "--show", "gap", "-o", picture), "--show gap", "POINTS")
    refused(canopy("plot", out, tmp_path / "absent.json", "-o", picture), "absent.json")
    refused(canopy("plot", out, tmp_path / "absent.xyz", "-o", picture), "absent.xyz")
    refused(canopy("plot", out, scene, "-o", tmp_path / "absent" / "p.png"), "p.png: cannot write")
    (tmp_path / "full.png").symlink_to("/dev/full")
    refused(canopy("plot", out, scene, "-o", tmp_path / "full.png"), "full.png: cannot write")
    for arguments in ((out, scene, scene), (out, out, out, scene), (out, "--show", "everything")):
        assert canopy("plot", *arguments, "-o", picture).returncode == 64
    assert left_behind(tmp_path, "scene.xyz", "out.json", "other.json", "full.png")


def test_damaged_files_never_end_in_a_traceback(tmp_path, scene):  # noqa: F811
    """Whatever `canopy plot` lets through the script must be able to draw, or fail with one line."""
    out, _ = fit(tmp_path, scene, "--refine", "1")
    good, rng = json.loads(out.read_text()), random.Random(7)
    for k in range(8):
        s = json.loads(json.dumps(good))
        for _ in range(rng.randrange(1, 4)):
            rng.choice([lambda: s.pop("certificate", None), lambda: s.pop("trim", None),
                        lambda: s.update(lsb=rng.choice([0, 1e-300, 1e300, -1, 1e-30])),
                        lambda: s.update(unit=rng.choice([0, 1e-300, 1e300, 1e6])),
                        lambda: s["coefficients"][3].__setitem__(2, rng.choice([1e308, -1e308, 1e18])),
                        lambda: s["frame"].update(pitch=rng.choice([[1e-300, 1], [1e300, 1e300], [1, 0], [1e-9, 1e9]])),
                        lambda: s["frame"].update(origin=[rng.choice([1e300, -1e20, 0]), 0, 0]),
                        lambda: s.update(trim=[[0] * 8] * 7), lambda: s["windows"][0].update(first=[900, -900])])()
        out.write_text(json.dumps(s))
        picture = tmp_path / "p.png"
        done = canopy("plot", out, scene, "--show", rng.choice(["section", "gap", "trim"]), "-o", picture)
        if done.returncode != 0:
            refused(done)
        assert picture.exists() == (done.returncode == 0), (k, done.stderr)
        picture.unlink(missing_ok=True)
        assert not done.stdout
