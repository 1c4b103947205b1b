"""How many solves the paper's two heuristics take when they are read literally: what its Fig. 9 shows, and what it says of
Heuristic(sigma, b) in Section 4. canopy-bench --moving counts canopy's own."""

import numpy as np

import paper
from scenes import Scene, moving


def histogram(solves):
    """{"1": lines that took one solve, ...}; "0": those that did not end."""
    found, counts = np.unique(solves, return_counts=True)
    return {str(k): int(c) for k, c in zip(found, counts)}


def scattered(count, clouds, grid=20):
    """Heuristic(sigma, b, lambda) on the lines of so many clouds of `count` points."""
    solves = []
    for seed in range(clouds):
        paper.surface(Scene("moving", moving(count, seed), grid), False, solves)
    return {"points": count, "grid": grid, "lines": histogram(solves)}


def uniform(n, lines):
    """Heuristic(sigma, b) on random heights: as many scattered, running on, and running on smoothly."""
    draw = np.random.Generator(np.random.PCG64(n))
    heights = draw.standard_normal((lines, n))
    kinds = [heights, np.cumsum(heights, 1), np.cumsum(np.cumsum(heights, 1), 1)]
    return {"n": n, "lines": histogram([paper.uniform(line) for kind in kinds for line in kind])}


def all_counts(quick):
    return {"scattered": [scattered(count, 1 if quick else 10) for count in ([3000] if quick else [30_000, 300_000])],
            "uniform": [uniform(n, 20 if quick else 20_000 // n) for n in ([10] if quick else [10, 20, 60, 200, 1000])]}
