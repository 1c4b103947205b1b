#!/usr/bin/python3
"""Measures canopy and its peers on the same input in one run. Usage: [BUILD=dir] tools/bench/bench.py [--quick] [--page FILE]

Writes build/bench.json and prints its tables. All that is quoted as a multiple of the floor was timed in turns with it
(canopy-bench); peers follow, scene by scene; then the paper's Tables 1 and 2 and the histograms of its Fig. 9. The range
scans are used where they are there, the terrain and the spheres always. --quick takes small scenes and few repeats and
needs no C++ peer: it tests this program. --page puts the tables between the marks of a Markdown file (docs/numbers.md).
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import scipy

sys.dont_write_bytecode = True  # nothing is written outside BUILD
import heuristics  # noqa: E402
import peers  # noqa: E402
import report  # noqa: E402
import tightness  # noqa: E402
from scenes import ROOT, Scene, all_scenes, spheres  # noqa: E402

sys.path.insert(0, str(ROOT / "hosttest"))
import bench_firmware  # noqa: E402

BUILD = Path(os.environ.get("BUILD", "build"))
BUILD = BUILD if BUILD.is_absolute() else ROOT / BUILD
# Table 1 of the paper, and beyond: points, and fits of each of ten configurations (the paper's 20 as far as time allows)
CLOUDS = {10_000: 20, 30_000: 20, 50_000: 20, 100_000: 20, 300_000: 20, 1_000_000: 4, 3_000_000: 2}
GRIDS = [10, 20, 30, 40, 50, 60]  # its Table 2, 30,000 points
IMAGES = ["cycles", "belt", "sandwich", "ray", "query"]  # of the firmware, that count instructions

STARTED = time.monotonic()


def progress(text):
    print(f"[{time.monotonic() - STARTED:5.0f} s] {text}", file=sys.stderr, flush=True)


def output_of(*command):
    try:
        return subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True).stdout.strip()
    except OSError:
        return ""


def machine():
    model = [line.split(":", 1)[1].strip() for line in open("/proc/cpuinfo", encoding="utf-8") if line.startswith("model name")]
    return {"cpu": model[0] if model else platform.machine(), "cores": os.cpu_count(), "load": os.getloadavg()[0],
            "compiler": (output_of("gcc", "--version").splitlines() or [""])[0], "flags": "-O2, one thread",
            "commit": output_of("git", "describe", "--always", "--dirty"), "scipy": scipy.__version__,
            "numpy": np.__version__, "alglib": output_of("dpkg-query", "-W", "-f", "${Version}", "libalglib-dev"),
            "cgal": output_of("dpkg-query", "-W", "-f", "${Version}", "libcgal-dev"),
            "date": datetime.now(timezone.utc).strftime("%Y-%m-%d")}


def ours(scene, scratch, *options):
    """What canopy-bench measures on the scene."""
    path = scratch / f"{scene.name}.ply"
    scene.write(path)
    side = ["--below"] if scene.side == "below" else []
    done = subprocess.run([BUILD / "host" / "canopy-bench", path, "--grid", str(scene.grid), *side, *options], check=True,
                          stdout=subprocess.PIPE, text=True)
    path.unlink()
    return {"scene": scene.name, **json.loads(done.stdout)}


def ours_moving(count, grid, fits):
    """What it measures on the paper's two moving spherical clouds."""
    progress(f"moving clouds: {count:,} points, {grid} x {grid}, 10 x {fits} fits")
    done = subprocess.run([BUILD / "host" / "canopy-bench", "--moving", str(count), "--grid", str(grid), "--fits", str(fits)],
                          check=True, stdout=subprocess.PIPE, text=True)
    return {"scene": "moving", **json.loads(done.stdout)}


def all_peers(scene, floor_us, scratch, quick):
    for cells in (scene.grid - 1, scene.grid):
        yield peers.stairs(scene, floor_us, cells)
    for swap in (False, True):
        yield peers.literal(scene, swap)
    yield peers.both_ways(scene)
    if scene.side == "above":
        yield peers.fitpack(scene, 1 if quick else 3)
        program = BUILD / "host" / "canopy-bench-alglib"
        if program.exists() or not quick:
            yield peers.alglib(scene, program, scratch, 2 if quick else 5)
        program = BUILD / "host" / "canopy-bench-alphawrap"
        if program.exists() or not quick:
            for part in [20] if quick else [20, 50]:
                yield peers.alphawrap(scene, program, scratch, part)
    yield peers.optimum(scene)


def compare(scene, scratch, quick):
    progress(f"{scene.name}, {scene.side}: {len(scene.points):,} points, {scene.grid} x {scene.grid}")
    result = ours(scene, scratch, *(["--rounds", "5"] if quick else ["--seconds", "3"]))
    result["peers"] = []
    for row in all_peers(scene, result["floor"]["median_us"], scratch, quick):
        row["floors"] = 1e3 * row["median_ms"] / result["floor"]["median_us"]
        result["peers"].append(row)
        progress(f"  {row['name']}: {row['median_ms']:.1f} ms, gap {row['mean_gap_pct']:.2f} %")
    return result


def firmware(scratch):
    """Instructions on the emulated board, and flash, RAM and stack of the station's images; {} where there are none."""
    images = BUILD / "mps2_an385"
    stations = [images / f"{name}.elf" for name in ("canopy", "canopy-10x10")]
    if not all(path.exists() for path in stations + [images / f"{name}.elf" for name in IMAGES]):
        return {}
    progress("instructions, sizes and stack of the firmware")
    maps = [path.with_suffix(".map") for path in stations]
    size, stack = scratch / "size.json", scratch / "stack.json"
    for command in ([ROOT / "tools" / "size.py", "--json", size, *maps],
                    [ROOT / "tools" / "stack.py", "--calls", ROOT / "tools" / "calls.txt", "--json", stack, *stations]):
        subprocess.run([sys.executable, *command], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return {**{name: bench_firmware.count(images / f"{name}.elf") for name in IMAGES},
            "size": json.loads(size.read_text(encoding="utf-8")), "stack": json.loads(stack.read_text(encoding="utf-8"))}


def measure(quick):
    scratch = BUILD / "bench"
    scratch.mkdir(parents=True, exist_ok=True)
    result = {"machine": machine(), "quick": quick}
    result["firmware"] = {} if quick else firmware(scratch)  # first: it is quick, and may fail
    scenes = [Scene("spheres", spheres(3000), 8)] if quick else all_scenes()
    scenes += [scene.below() for scene in scenes if scene.name == "bun000" or quick]  # the paper's front and back
    result["scenes"] = [compare(scene, scratch, quick) for scene in scenes]
    result["clouds"] = [ours_moving(count, 20, fits) for count, fits in ({3000: 2} if quick else CLOUDS).items()]
    points, fits, grids = (3000, 2, GRIDS[:1]) if quick else (30_000, 20, GRIDS)
    result["grids"] = [ours_moving(points, grid, fits) for grid in grids]
    progress("the paper's heuristics, read literally")
    result["heuristics"] = heuristics.all_counts(quick)
    result["tightness"] = [] if quick else tightness.against_oracle(BUILD / "host" / "canopy-tightness", scratch, progress)
    result["goals"] = report.goals(result)
    return result


def put_on_page(path, text):
    """Replaces what is between the marks."""
    begin, end = "<!-- begin make bench -->\n", "<!-- end make bench -->"
    page = path.read_text(encoding="utf-8")
    head, rest = page.split(begin, 1)
    tail = rest.split(end, 1)[1]
    path.write_text(head + begin + "\n" + text + "\n" + end + tail, encoding="utf-8")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small scenes, few repeats: a test of this program")
    parser.add_argument("--page", type=Path, help="also put the tables between the marks of this Markdown file")
    parser.add_argument("--json", type=Path, default=BUILD / "bench.json", help="where the numbers go")
    arguments = parser.parse_args()
    result = measure(arguments.quick)
    arguments.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    text = report.text(result)
    print(text)
    if arguments.page:
        put_on_page(arguments.page, text)
    progress(f"wrote {arguments.json}")


if __name__ == "__main__":
    main()
