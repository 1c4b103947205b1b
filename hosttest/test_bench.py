"""The benchmark on small scenes: that its numbers can be believed, not what they are."""

import json
import os
import re
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

import heuristics  # noqa: E402
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
    assert [len(run["ways"]) for run in runs] == [13, 13, 2, 2] and [run["side"] for run in runs[:2]] == ["above", "below"]
    for run in runs:
        assert all(way["wrong"] == 0 and way["outside"] == 0 and way["margin"] >= 0 for way in run["ways"])
        assert all(pair["wrong"] == 0 and pair["outside"] == 0 and pair["apart_pct"] >= 0 for pair in run.get("pairs", []))


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
        assert ("rays" in way) == (way["field"] == 0 and not way["tight"])
        if "rays" in way:
            rays = way["rays"]
            assert rays["ns_per_ray"] * rays["per_second"] == pytest.approx(1e9) and 0 < rays["most_steps"] <= 12
            assert 10 < rays["hits_pct"] < 100 and 1 < rays["cells_per_ray"] < 20


def test_nothing_is_tighter_than_the_optimum_of_its_space(result):
    """Of smooth surfaces of as many coefficients; the front and the back (side below)."""
    for scene in result[0]["scenes"]:
        rows = {row["name"].split(",")[0]: row for row in scene["peers"]}
        optimum = rows["linear program's optimum (HiGHS)"]["mean_gap_pct"]
        assert 0.9999 * optimum < min(row["mean_gap_pct"] for row in scene["ways"])
        smooth = [row["mean_gap_pct"] for name, row in rows.items() if name.startswith(("the paper", "FITPACK", "ALGLIB"))]
        assert len(smooth) >= 2 and optimum < min(smooth) and rows["stairs"]["wrong"] == 0
        if scene["side"] == "above":
            least_squares = rows["FITPACK least squares"]
            assert least_squares["wrong_unlifted"] > 1000 and least_squares["wrong"] < 10


def test_tight_is_tighter_than_fast_and_stairs_and_says_how_far_it_is_from_the_optimum(result):
    for scene in result[0]["scenes"]:
        ways = {way["name"]: way for way in scene["ways"]}
        rows = [row["mean_gap_pct"] for row in scene["peers"] if row["name"].startswith("stairs")]
        optimum = next(row for row in scene["peers"] if "optimum" in row["name"])["mean_gap_pct"]
        tight = ways["tight f32 from points"]
        assert len(rows) == 2 and tight["mean_gap_pct"] < min(*rows, ways["fast f32 from points"]["mean_gap_pct"])
        assert tight["mean_gap_pct"] <= 1.02 * optimum and 0 <= tight["proved_excess_pct"] < 2
        plain = [ways[f"tight f32 from field {q}"] for q in (4, 8, 16)]
        for coarse, fine in zip(plain, plain[1:]):  # more bytes, nearer
            assert coarse["field_bytes"] < fine["field_bytes"] and coarse["mean_gap_pct"] > fine["mean_gap_pct"]
        for q, way in zip((8, 16), plain[1:]):
            assert 4 * ways[f"tight f32 from field {q}, packed"]["field_bytes"] < 1.1 * way["field_bytes"]


def test_the_papers_experiments_are_counted_whole(result):
    """Tables 1 and 2 and Fig. 9: 10 configurations, each fitted as often as asked; every line is in the histogram."""
    for run in result[0]["clouds"] + result[0]["grids"]:
        assert run["scene"] == "moving" and run["rounds"] == 20
        lines, columns = run["solves"]["lines"], run["solves"]["columns"]
        assert sum(lines) == run["rounds"] * run["grid"][0] and sum(columns) == run["rounds"] * run["grid"][1]
        mean = sum(k * (a + b) for k, (a, b) in enumerate(zip(lines, columns))) / run["rounds"]
        assert mean == pytest.approx(run["ways"][0]["solves"])


def test_uniform_data_does_not_always_take_three_solves_at_most():
    """The paper: "we have never observed more than three". Read literally, 97 of 100 random lines keep to it. This one takes
    four, also when it is moved a little: no tie."""
    heights = np.array([0, -9, -25, -12, 17, 73, 138, 232, 329, 427, 551, 691, 814, 933, 1054, 1164], float)
    draw = np.random.Generator(np.random.PCG64(1))
    assert all(paper.uniform(heights + 1e-3 * draw.standard_normal(16)) == 4 for _ in range(5))
    lines = heuristics.uniform(60, 100)["lines"]
    assert sum(lines.get(k, 0) for k in "123") >= 0.97 * sum(lines.values()) and lines["2"] > 0.8 * sum(lines.values())


def test_scattered_data_takes_more_than_twenty_solves_read_literally():
    """The paper: "almost always 10 or less, occasionally up to 20". With one exchange a solve and sign steps counted that does
    not hold on its own scene; canopy's lines, which exchange every row at once, end at 12 (CANOPY_LINE_SOLVES)."""
    counts = {int(k): v for k, v in heuristics.scattered(30_000, 2)["lines"].items()}
    assert max(counts) > 20 and sum(v for k, v in counts.items() if k > 10) > sum(counts.values()) / 2


def test_the_top_of_a_mesh_is_found_above_every_point():
    """Two triangles above each other and a hole: against the planes they lie in."""
    flat = np.array([[[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 0, 2], [2, 0, 2], [0, 2, 4]]], float)
    x, y = np.array([0.5, 1.5, 3.0, 3.5]), np.array([0.5, 1.0, 0.5, 3.0])
    assert list(peers.tops(flat, x, y)) == pytest.approx([2.5, 1, 1, -np.inf])


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
    for number in range(13):
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


def test_every_claim_of_the_paper_names_tests_that_exist():
    """docs/paper.md: twelve claims, each with tests or rows of the bench that show it."""
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    claims = page.split("\n## ")[1:]
    assert [claim.split(".")[0] for claim in claims[:12]] == [str(k) for k in range(1, 13)]
    for claim in claims[:12]:
        named = re.findall(r"`((?:unit/)?test_\w+\.(?:c|py)):\s([^`]+)`", claim)
        assert named or "- bench, *" in claim
        for file, names in named:
            text = (ROOT / "hosttest" / file).read_text(encoding="utf-8")
            for name in re.findall(r"\w+", names):
                assert re.search(rf"\b{name}\(|\({name}\)|UNIT\({name}", text), f"{file} has no {name}"
    report = (ROOT / "tools" / "bench" / "report.py").read_text(encoding="utf-8")
    for words in ("**Points**", "**Grids**", "**Solves**", "**Tight**", "both sides", "linear: ", "300K moving points",
                  "x the optimum's"):
        assert words in report


@pytest.mark.skipif(not ORACLE.exists(), reason="no oracle beside the repository")
def test_the_optimum_is_the_oracles(tmp_path):
    scene = Scene("spheres", spheres(1500), 8)
    points = tmp_path / "points.xyz"
    np.savetxt(points, scene.points.astype(float), fmt="%.17g")
    done = subprocess.run([sys.executable, ORACLE, points, "--grid", "8x8", "--json"], check=True, capture_output=True, text=True)
    assert peers.optimum(scene)["mean_gap_pct"] == pytest.approx(100 * json.loads(done.stdout)["mean_gap"], abs=1e-4)
