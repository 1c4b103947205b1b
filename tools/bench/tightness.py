"""Tight against the optimum on every scene of an oracle file that lies beside the repository (canopy-tightness)."""

import subprocess

from peers import stairs
from scenes import SCANS, Scene, scan, terrain

ORACLE = SCANS / "oracle.json"
# What canopy-tightness prints: gaps as multiples of the optimum's, processor time, the optimum's solver's over it.
COLUMNS = ["optimum_pct", "fast", "after_6", "after_10", "after_16", "end", "iterations", "proved_excess_pct", "near_ms",
           "solver_over_near", "end_ms", "solver_over_end", "wrong", "arena_bytes"]
NAMES = {"bun000": "bun000", "chin": "chin", "rocker-arm": "rocker-arm", "dem": "terrain"}  # as the oracle says, as we say


def one_scene(name, points, program, scratch):
    path = scratch / "tightness.ply"
    Scene(name, points).write(path)
    done = subprocess.run([program, ORACLE, f"{name}={path}"], check=True, stdout=subprocess.PIPE, text=True)
    path.unlink()
    for line in done.stdout.splitlines()[1:]:
        _, grid, side, *values = line.split()
        row = dict(zip(COLUMNS, (float(value.rstrip("%")) for value in values)))
        n = int(grid.split("x")[0])
        steps = stairs(Scene(name, points, n, side), 0, n)["mean_gap_pct"]
        yield {"scene": NAMES[name], "grid": n, "side": side, **row, "stairs": steps / row["optimum_pct"]}


def against_oracle(program, scratch, progress):
    """A row for each scene, grid and side; none without the oracle."""
    if not ORACLE.exists() or not program.exists():
        return []
    rows = []
    for name in NAMES:
        points = terrain() if name == "dem" else scan(name)
        if points is not None:
            progress(f"tight against the oracle: {name}")
            rows += one_scene(name, points, program, scratch)
    return rows
