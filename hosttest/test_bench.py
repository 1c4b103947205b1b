"""The benchmark on small scenes: that its numbers can be believed, not what they are."""

import json
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CANOPY_BUILD", "build"))
BUILD = BUILD if BUILD.is_absolute() else ROOT / BUILD
ORACLE = ROOT.parent / "shared" / "tools" / "lp_oracle.py"
sys.path.insert(0, str(ROOT / "tools" / "bench"))

import paper  # noqa: E402
import peers  # noqa: E402
import surfaces  # noqa: E402
from scenes import Scene, spheres  # noqa: E402


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """One quick run, with a page to put its tables on."""
    place = tmp_path_factory.mktemp("bench")
    page = place / "page.md"
    page.write_text("before\n<!-- begin make bench -->\nold\n<!-- end make bench -->\nafter\n", encoding="utf-8")
    done = subprocess.run([sys.executable, ROOT / "tools" / "bench" / "bench.py", "--quick", "--json", place / "bench.json",
                           "--page", page], env={**os.environ, "BUILD": str(BUILD)}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads((place / "bench.json").read_text(encoding="utf-8")), done.stdout, page.read_text(encoding="utf-8")


def test_no_point_is_on_the_wrong_side_of_ours(result):
    runs = result[0]["scenes"] + result[0]["clouds"] + result[0]["grids"]
    assert len(runs) == 3 and [len(run["ways"]) for run in runs] == [6, 2, 2]
    for run in runs:
        assert all(way["wrong"] == 0 and way["outside"] == 0 and way["margin"] >= 0 for way in run["ways"])


def test_times_are_there_and_their_multiples_fit(result):
    for run in result[0]["scenes"] + result[0]["clouds"] + result[0]["grids"]:
        floor = run["floor"]
        assert 0 < floor["best_us"] <= floor["median_us"] == min(floor["ways_median_us"].values())
        for way in run["ways"]:
            for what in ("fit", "certificate", "whole"):
                assert way[what]["floors"] == pytest.approx(way[what]["median_us"] / floor["median_us"], rel=1e-6)
            assert way["whole"]["median_us"] > way["fit"]["median_us"] + way["certificate"]["median_us"]


def test_rays_are_counted_where_they_were_cast(result):
    for way in result[0]["scenes"][0]["ways"]:
        assert ("rays" in way) == (way["field"] == 0)
        if "rays" in way:
            rays = way["rays"]
            assert rays["ns_per_ray"] * rays["per_second"] == pytest.approx(1e9) and 0 < rays["most_steps"] <= 12
            assert 10 < rays["hits_pct"] < 100 and 1 < rays["cells_per_ray"] < 20


def test_nothing_is_tighter_than_the_optimum_of_its_space(result):
    scene = result[0]["scenes"][0]
    rows = {row["name"].split(",")[0]: row for row in scene["peers"]}
    optimum = rows["linear program's optimum (HiGHS)"]["mean_gap_pct"]
    assert optimum < min(row["mean_gap_pct"] for row in scene["ways"])
    assert optimum < min(row["mean_gap_pct"] for row in rows.values() if "optimum" not in row["name"] and "stairs" not in row["name"])
    assert rows["stairs"]["wrong"] == 0
    assert rows["FITPACK least squares"]["wrong_unlifted"] > 1000 and rows["FITPACK least squares"]["wrong"] < 10


def test_the_tables_are_printed_and_put_on_the_page(result):
    data, printed, page = result
    assert page.startswith("before\n") and page.endswith("after\n") and "old" not in page
    for text in (printed, page):
        assert "fast fx from field 4, lines 4" in text and "FITPACK" in text
        assert all(goal["goal"] in text for goal in data["goals"])


def test_saved_surrogates_are_safe_for_the_command(tmp_path):
    points = tmp_path / "points.ply"
    Scene("spheres", spheres(2000), 7).write(points)
    subprocess.run([BUILD / "host" / "canopy-bench", points, "--grid", "7", "--rounds", "1", "--below", "--save", tmp_path / "s"],
                   check=True, capture_output=True)
    for number in range(6):
        surrogate = tmp_path / f"s-{number}.json"
        assert json.loads(surrogate.read_text(encoding="utf-8"))["side"] == "below"
        assert subprocess.run([BUILD / "host" / "canopy", "check", surrogate, points], capture_output=True).returncode == 0


def some_surfaces(scene):
    """One of each kind with arbitrary coefficients."""
    draw = np.random.Generator(np.random.PCG64(5))
    n = scene.grid
    inner = np.linspace(0, n - 1, n - 2)[1:-1]
    knots = np.concatenate([[0.0] * 4, inner, [n - 1.0] * 4])
    edges = [(i, i + 1, j, j + 1) for j in range(n - 1) for i in range(n - 1)]
    table = np.hstack([np.array(edges, float), draw.standard_normal(((n - 1) ** 2, 16))])
    return [surfaces.Uniform(draw.standard_normal((n, n))), surfaces.Knots(knots, knots, draw.standard_normal((n, n))),
            surfaces.Cells(table)]


def test_double_and_fractions_agree_and_lifting_lifts():
    scene = Scene("spheres", spheres(200), 9)
    for surface in some_surfaces(scene):
        heights = surface.heights(scene.u, scene.v)
        for index in list(range(0, 200, 17)) + [int(scene.u.argmax()), int(scene.v.argmin())]:
            u, v, _ = scene.exact(index)
            assert float(surface.exact(u, v)) == pytest.approx(heights[index], abs=1e-12)
        surface.lift(0.25)
        assert surface.heights(scene.u, scene.v) == pytest.approx(heights + 0.25, abs=1e-12)


def test_a_point_beyond_the_surface_by_less_than_double_can_tell_is_counted():
    scene = Scene("spheres", spheres(100), 6)
    for surface in some_surfaces(scene):
        exact = [surface.exact(*scene.exact(index)[:2]) for index in range(len(scene.z))]

        def moved(index):  # onto the surface, every third one a trifle above it
            return scene.exact(index)[:2] + (exact[index] + (Fraction(1, 10 ** 30) if index % 3 == 0 else 0),)
        near = SimpleNamespace(u=scene.u, v=scene.v, z=np.array([float(x) for x in exact]), exact=moved)
        assert surfaces.count_wrong(surface, near) == 34


def test_the_reference_line_is_above_its_points():
    draw = np.random.Generator(np.random.PCG64(7))
    for _ in range(20):
        t, y = np.sort(draw.uniform(0, 9, 300)), draw.uniform(0, 1, 300)
        b, solves, _ = paper.line(t, y, 10)
        assert 1 <= solves <= paper.SOLVES
        assert (surfaces.Uniform(np.tile(b, (4, 1))).heights(np.ones(300), t) >= y - 1e-9).all()


@pytest.mark.skipif(not ORACLE.exists(), reason="no oracle beside the repository")
def test_the_optimum_is_the_oracles(tmp_path):
    scene = Scene("spheres", spheres(1500), 8)
    points = tmp_path / "points.xyz"
    np.savetxt(points, scene.points.astype(float), fmt="%.17g")
    done = subprocess.run([sys.executable, ORACLE, points, "--grid", "8x8", "--json"], check=True, capture_output=True, text=True)
    assert peers.optimum(scene)["mean_gap_pct"] == pytest.approx(100 * json.loads(done.stdout)["mean_gap"], abs=1e-4)
