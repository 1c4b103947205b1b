#!/usr/bin/python3
"""Measures canopy and its peers on the same input in one run. Usage: [BUILD=dir] tools/bench/bench.py [--quick] [--page FILE]

Writes build/bench.json and prints its tables. All that is quoted as a multiple of the floor was timed in turns with it
(canopy-bench); peers follow, scene by scene. The range scans are used where they are there, the terrain and the spheres
always. --quick takes small scenes and few repeats and needs no C++ peer: it tests this program. --page puts the tables
between the marks of a Markdown file (docs/numbers.md).
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
import peers  # noqa: E402
import report  # noqa: E402
from scenes import ROOT, Scene, all_scenes, spheres  # noqa: E402

sys.path.insert(0, str(ROOT / "hosttest"))
import bench_firmware  # noqa: E402

BUILD = Path(os.environ.get("BUILD", "build"))
BUILD = BUILD if BUILD.is_absolute() else ROOT / BUILD
CLOUDS = [10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000]  # Table 1 of the paper, and beyond
GRIDS = [10, 20, 30, 40, 50, 60]                                   # its Table 2, 30,000 points

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
            "date": datetime.now(timezone.utc).strftime("%Y-%m-%d")}


def ours(scene, scratch, *options):
    """What canopy-bench measures on the scene."""
    path = scratch / f"{scene.name}.ply"
    scene.write(path)
    done = subprocess.run([BUILD / "host" / "canopy-bench", path, "--grid", str(scene.grid), *options], check=True,
                          stdout=subprocess.PIPE, text=True)
    path.unlink()
    return {"scene": scene.name, **json.loads(done.stdout)}


def all_peers(scene, floor_us, scratch, quick):
    yield peers.stairs(scene, floor_us)
    for swap in (False, True):
        yield peers.literal(scene, swap)
    yield peers.fitpack(scene, 1 if quick else 3)
    program = BUILD / "host" / "canopy-bench-alglib"
    if program.exists() or not quick:
        yield peers.alglib(scene, program, scratch, 2 if quick else 5)
    yield peers.optimum(scene)


def compare(scene, scratch, quick):
    progress(f"{scene.name}: {len(scene.points):,} points, {scene.grid} x {scene.grid}")
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
    if not all(path.exists() for path in stations + [images / "cycles.elf", images / "belt.elf"]):
        return {}
    progress("instructions, sizes and stack of the firmware")
    maps = [path.with_suffix(".map") for path in stations]
    size, stack = scratch / "size.json", scratch / "stack.json"
    for command in ([ROOT / "tools" / "size.py", "--json", size, *maps],
                    [ROOT / "tools" / "stack.py", "--calls", ROOT / "tools" / "calls.txt", "--json", stack, *stations]):
        subprocess.run([sys.executable, *command], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return {"instructions": bench_firmware.count(images / "cycles.elf"), "belt": bench_firmware.count(images / "belt.elf"),
            "size": json.loads(size.read_text(encoding="utf-8")), "stack": json.loads(stack.read_text(encoding="utf-8"))}


def measure(quick):
    scratch = BUILD / "bench"
    scratch.mkdir(parents=True, exist_ok=True)
    result = {"machine": machine(), "quick": quick}
    result["firmware"] = {} if quick else firmware(scratch)  # first: it is quick, and may fail
    clouds, grids = (CLOUDS[:1], GRIDS[:1]) if quick else (CLOUDS, GRIDS)
    time_for = ["--rounds", "5"] if quick else ["--seconds", "2"]
    scenes = [Scene("spheres", spheres(3000), 8)] if quick else all_scenes()
    result["scenes"] = [compare(scene, scratch, quick) for scene in scenes]
    result["clouds"] = []
    for count in clouds:
        progress(f"spheres: {count:,} points, 20 x 20")
        result["clouds"].append(ours(Scene(f"spheres-{count}", spheres(count)), scratch, "--points-only", *time_for))
    result["grids"] = []
    for grid in grids:
        progress(f"spheres: 30,000 points, {grid} x {grid}")
        result["grids"].append(ours(Scene(f"spheres-{grid}", spheres(30000), grid), scratch, "--points-only", *time_for))
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
