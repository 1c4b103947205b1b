#!/usr/bin/python3
"""How tight can a surface be that knows its scene only through a field of so many bytes?

Usage: fields.py POINTS [--grid N] [--side above|below] [KIND ...]

For each kind of bounded streaming field, all points go into the field, and a linear program (HiGHS) finds the safe
surface with the least mean gap over the points that the field alone can prove: over every covered cell all 16
Bernstein coefficients are at least what the field says. A KIND is a name and its numbers:

    word,Q         Q x Q cells a knot cell, 4 bytes each: lib/cover/field
    half,Q         the same in 2 bytes, rounded up to a 65,536th of the range
    packed,Q       the same in 1 byte: lib/cover/packed
    linear,Q,L     1 byte of equal steps below the knot cell's top, each a 2^L-th of the range
    nibble,Q,L     the same in 4 bits
    planes,Q,S     5 planes a cell, level and S of the range a knot interval up and down either way, 2 bytes each: each
                   lies above the cell's points, so any may be the one that the surface has to be above
    highest,Q,F,K  the K highest of the F x F cells of a cell, 2 bytes each, and one lid on all the others

The optimum from the points themselves, of the same rules, is the unit.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.bench.scenes import Scene  # noqa: E402
from tools.bench.surfaces import Uniform  # noqa: E402

REACH = (-1.0, 2.0)  # of the coefficients, in height ranges
DEFAULT = ["word,4", "half,5", "packed,8", "half,11", "packed,16", "linear,16,10", "nibble,22,6", "planes,5,0.05",
           "highest,4,4,7"]


def blossom(a, b, c):
    """Weights of the four coefficients in the polar form of a knot interval (lib/spline/bezier.h)."""
    pairs, product = a * b + b * c + c * a, a * b * c
    return np.stack([(1 - a) * (1 - b) * (1 - c), 4 - 2 * pairs + 3 * product, 1 + a + b + c + pairs - 3 * product,
                     product], -1) / 6


def bernstein(low, high):
    """(len(low), 4, 4): the four Bernstein coefficients over [low, high] of the interval, from its coefficients."""
    ends = [(low, low, low), (low, low, high), (low, high, high), (high, high, high)]
    return np.stack([blossom(*at) for at in ends], 1)


class Boxes:
    """Parts of knot cells, and the Bernstein coefficients (count, 4, 4) that the surface must reach over each."""

    def __init__(self, grid, cells, rows, columns, bound):
        self.grid = grid
        self.interval = rows // cells, columns // cells
        self.low = rows % cells / cells, columns % cells / cells
        self.width = 1 / cells
        self.bound = np.broadcast_to(np.reshape(bound, (len(rows), *np.shape(bound)[1:], *[1] * (3 - np.ndim(bound)))),
                                     (len(rows), 4, 4))

    def rows(self):
        at = [np.clip(i[:, None] + np.arange(-1, 3), 0, self.grid - 1) for i in self.interval]
        weight = [bernstein(low, low + self.width) for low in self.low]
        values = np.einsum("npi,nqj->npqij", *weight).reshape(-1, 16)
        columns = (at[0][:, :, None] * self.grid + at[1][:, None, :]).reshape(-1, 1, 16).repeat(16, 1).reshape(-1, 16)
        row = np.repeat(np.arange(len(values)), 16)
        return sparse.csr_matrix((values.ravel(), (row, columns.ravel())), shape=(len(values), self.grid ** 2))


def tightest(scene, matrix, bound, chosen):
    """The coefficients of the linear program. Rows join when they are violated: few matter."""
    u, v = (Uniform.columns(t, scene.grid) for t in (scene.u, scene.v))
    cost = np.zeros(scene.grid ** 2)
    np.add.at(cost, (u[0][:, :, None] * scene.grid + v[0][:, None, :]).ravel(),
              (u[1][:, :, None] * v[1][:, None, :]).ravel() / len(scene.z))
    while True:
        x = linprog(cost, A_ub=-matrix[chosen], b_ub=-bound[chosen], bounds=REACH, method="highs-ipm").x
        missing = bound - matrix @ x
        worst = np.argsort(-missing)[:6000]
        worst = worst[missing[worst] > 1e-6]
        if len(worst) == 0:
            return x
        chosen = np.union1d(chosen, worst)


def first_choice(bound, group, depth=24):
    """The highest rows of each group."""
    order = np.lexsort((-bound, group))
    start = np.flatnonzero(np.r_[True, np.diff(group[order]) != 0])
    rank = np.arange(len(order)) - np.repeat(start, np.diff(np.r_[start, len(order)]))
    return order[rank < depth]


def gap_of(scene, x):
    surface = Uniform(x.reshape(scene.grid, scene.grid))
    return float((surface.heights(scene.u, scene.v) - scene.z).mean())


def solve(scene, parts):
    matrix = sparse.vstack([part.rows() for part in parts]).tocsr()
    bound = np.concatenate([part.bound.ravel() for part in parts])
    group = np.concatenate([np.repeat(part.interval[0] * scene.grid + part.interval[1], 16) for part in parts])
    return tightest(scene, matrix, bound, first_choice(bound, group)), matrix


# ---- The kinds

def cells_of(scene, cells):
    last = cells * (scene.grid - 1) - 1
    return [np.minimum((cells * t).astype(int), last) for t in (scene.u, scene.v)]


def highest_of(scene, cells, values):
    count = cells * (scene.grid - 1)
    heights = np.full((count, count), -np.inf)
    np.maximum.at(heights, tuple(cells_of(scene, cells)), values)
    return heights


def from_cells(scene, cells, heights):
    rows, columns = np.nonzero(np.isfinite(heights))
    return Boxes(scene.grid, cells, rows, columns, heights[rows, columns])


def blocks(scene, cells, heights):
    """Heights by knot cell, and the knot cells' tops."""
    split = heights.reshape(scene.grid - 1, cells, scene.grid - 1, cells)
    return split, split.max((1, 3), keepdims=True)


def below_top(scene, cells, step, codes):
    heights = highest_of(scene, cells, scene.z)
    split, top = blocks(scene, cells, heights)
    with np.errstate(invalid="ignore"):
        coded = np.maximum(np.ceil(split / step) * step, np.ceil(top / step) * step - (codes - 1) * step)
    return np.where(np.isfinite(heights), coded.reshape(heights.shape), -np.inf)


def packed(scene, cells):
    heights = highest_of(scene, cells, scene.z)
    split, top = blocks(scene, cells, heights)
    q = 2.0 ** -12  # of a range of 2^24 steps, the finest there is (lib/cover/packed.h)
    fine, medium, coarse = (np.ceil(split / step) * step for step in (q, 4 * q, 16 * q))
    with np.errstate(invalid="ignore"):
        top = np.ceil(top / (16 * q)) * 16 * q
        coded = np.where(top - medium < 128 * q, fine,
                         np.where(top - coarse < 384 * q, medium, np.maximum(coarse, top - 1376 * q)))
    return np.where(np.isfinite(heights), coded.reshape(heights.shape), -np.inf)


def planes(scene, cells, slope):
    """Solves with level lids, then lets every cell choose the plane that is farthest below the surface; three times."""
    row, column = cells_of(scene, cells)
    middle = [(i + 0.5) / cells for i in (row, column)]
    tilts = [(0, 0), (slope, 0), (-slope, 0), (0, slope), (0, -slope)]
    offsets = [highest_of(scene, cells, scene.z - a * (scene.u - middle[0]) - b * (scene.v - middle[1]))
               for a, b in tilts]
    rows, columns = np.nonzero(np.isfinite(offsets[0]))
    along = np.array([-1 / 2, -1 / 6, 1 / 6, 1 / 2]) / cells
    lids = np.stack([offset[rows, columns][:, None, None] + a * along[:, None] + b * along
                     for offset, (a, b) in zip(offsets, tilts)])
    choice = np.zeros(len(rows), int)
    for _ in range(4):
        part = Boxes(scene.grid, cells, rows, columns, lids[choice, np.arange(len(rows))])
        x, matrix = solve(scene, [part])
        choice = ((matrix @ x).reshape(-1, 4, 4) - lids).min((2, 3)).argmax(0)
    return x


def few_highest(scene, cells, finer, keep):
    heights, coarse = highest_of(scene, cells * finer, scene.z), cells * (scene.grid - 1)
    inside = heights.reshape(coarse, finer, coarse, finer).transpose(0, 2, 1, 3).reshape(coarse, coarse, -1)
    lid = -np.sort(-inside, 2)[:, :, keep]
    kept = np.where(inside > lid[:, :, None], inside, -np.inf)
    kept = kept.reshape(coarse, coarse, finer, finer).transpose(0, 2, 1, 3).reshape(heights.shape)
    return solve(scene, [from_cells(scene, cells * finer, kept), from_cells(scene, cells, lid)])[0]


def run(scene, kind):
    """Bytes, and the optimum's coefficients."""
    name, *numbers = kind.split(",")
    cells = int(numbers[0])
    knot_cells = (scene.grid - 1) ** 2
    if name == "planes":
        return knot_cells * cells ** 2 * 10, planes(scene, cells, float(numbers[1]))
    if name == "highest":
        finer, keep = int(numbers[1]), int(numbers[2])
        return knot_cells * cells ** 2 * 2 * (keep + 1), few_highest(scene, cells, finer, keep)
    if name in ("linear", "nibble"):
        step, codes = 2.0 ** -int(numbers[1]), 255 if name == "linear" else 15
        size = cells ** 2 if name == "linear" else (cells ** 2 + 1) // 2
        heights, size = below_top(scene, cells, step, codes), size + 4
    elif name == "packed":
        heights, size = packed(scene, cells), cells ** 2 + 4
    elif name == "half":
        heights, size = np.ceil(highest_of(scene, cells, scene.z) * 65536) / 65536, 2 * cells ** 2
    elif name == "word":
        heights, size = highest_of(scene, cells, scene.z), 4 * cells ** 2
    else:
        sys.exit(f"fields.py: '{kind}' is no kind of field; see --help")
    return knot_cells * size, solve(scene, [from_cells(scene, cells, heights)])[0]


def from_points(scene):
    """The optimum from the points: safe at each, and no pits on half-knot cells that hold some (cover/tighten.h)."""
    u, v = (Uniform.columns(t, scene.grid) for t in (scene.u, scene.v))
    columns = (u[0][:, :, None] * scene.grid + v[0][:, None, :]).reshape(len(scene.z), 16)
    values = (u[1][:, :, None] * v[1][:, None, :]).reshape(len(scene.z), 16)
    row = np.repeat(np.arange(len(scene.z)), 16)
    safe = sparse.csr_matrix((values.ravel(), (row, columns.ravel())), shape=(len(scene.z), scene.grid ** 2))
    pits = from_cells(scene, 2, -highest_of(scene, 2, -scene.z))
    matrix, bound = sparse.vstack([safe, pits.rows()]).tocsr(), np.concatenate([scene.z, pits.bound.ravel()])
    cell = np.r_[np.minimum(scene.u.astype(int), scene.grid - 2) * scene.grid + scene.v.astype(int),
                 np.repeat(pits.interval[0] * scene.grid + pits.interval[1], 16)]
    return tightest(scene, matrix, bound, first_choice(bound, cell))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("points", type=Path)
    parser.add_argument("--grid", type=int, default=20)
    parser.add_argument("--side", choices=["above", "below"], default="above")
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    arguments = parser.parse_intermixed_args()
    scene = Scene(arguments.points.stem, np.loadtxt(arguments.points, usecols=(0, 1, 2)), arguments.grid)
    if arguments.side == "below":
        scene.z = 1 - scene.z
    unit = gap_of(scene, from_points(scene))
    print(f"{scene.name}, {scene.grid}x{scene.grid}, {arguments.side}: {100 * unit:.3f} % of the range from the points")
    for kind in arguments.kinds or DEFAULT:
        start = time.perf_counter()
        size, x = run(scene, kind)
        gap = gap_of(scene, x)
        print(f"{kind:16} {size:7} bytes  gap {100 * gap:6.3f} %  {gap / unit:5.3f} x  ({time.perf_counter() - start:.0f} s)",
              flush=True)


if __name__ == "__main__":
    main()
