"""What else could be used, each on the same points: FITPACK, ALGLIB, CGAL, a linear program, the paper read literally, stairs.

Each function returns rows {"name", "best_ms", "median_ms", ...}; a scene of the side below comes mirrored. A fit that is
not safe by itself is lifted by its largest violation, found in double, and then judged in exact arithmetic.
"""

import statistics
import subprocess
import time
import warnings

import numpy as np
from scipy import sparse
from scipy.interpolate import LSQBivariateSpline
from scipy.optimize import linprog

import paper
from surfaces import DOUBT, Cells, Knots, Stairs, Uniform, cells_of, count_wrong


def times(seconds):
    return {"best_ms": 1e3 * min(seconds), "median_ms": 1e3 * statistics.median(seconds), "repeats": len(seconds)}


def judge(name, scene, surface, seconds, **more):
    """A row for a surface; lifts it where it is not safe."""
    missing = float((scene.z - surface.heights(scene.u, scene.v)).max())
    row = {"name": name, **times(seconds), "wrong_unlifted": count_wrong(surface, scene)}
    if row["wrong_unlifted"] > 0:
        surface.lift(max(missing, 0.0))
        row["lift_pct"] = 100 * missing
    gap = surface.heights(scene.u, scene.v) - scene.z
    row.update(mean_gap_pct=100 * float(gap.mean()), max_gap_pct=100 * float(gap.max()),
               wrong=count_wrong(surface, scene), **more)
    return row


def repeat(count, work):
    seconds, result = [], None
    for _ in range(count):
        start = time.process_time()
        result = work()
        seconds.append(time.process_time() - start)
    return seconds, result


def fitpack(scene, repeats):
    """Least squares with as many coefficients as ours: 4 of the n are the ends', the knots between are uniform."""
    n = scene.grid
    knots = np.linspace(0, n - 1, n - 2)[1:-1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rank deficient: cells without points
        seconds, fit = repeat(repeats, lambda: LSQBivariateSpline(scene.u, scene.v, scene.z, knots, knots,
                                                                  bbox=[0, n - 1, 0, n - 1]))
    surface = Knots(*fit.get_knots(), fit.get_coeffs())
    return judge("FITPACK least squares, lifted", scene, surface, seconds)


def alglib(scene, program, scratch, repeats):
    """`program` is canopy-bench-alglib."""
    points, table = scratch / "alglib-points", scratch / "alglib-table"
    np.column_stack([scene.u, scene.v, scene.z]).tofile(points)
    done = subprocess.run([program, points, str(scene.grid), str(repeats), table], check=True, stdout=subprocess.PIPE, text=True)
    *seconds, error = [float(line) for line in done.stdout.split()]
    surface = Cells(np.fromfile(table).reshape(-1, 20))
    mine = float(np.sqrt(np.mean((surface.heights(scene.u, scene.v) - scene.z) ** 2)))
    if abs(mine - error) > 1e-9:
        raise RuntimeError(f"ALGLIB's spline was misread: root mean square error {mine}, it says {error}")
    return judge("ALGLIB least squares, lifted", scene, surface, seconds)


# ---- CGAL's alpha wrapping

def tops(triangles, x, y, across=256):
    """The highest point of any of the triangles (count, 3, 3) above each (x, y); -infinity where there is none."""
    low, high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
    scale = across / np.maximum(high - low, 1e-300)

    def cell(a, t):
        return np.clip(((t - low[a]) * scale[a]).astype(int), 0, across - 1)
    index = cell(0, x) * across + cell(1, y)
    order = np.argsort(index, kind="stable")
    x, y, start = x[order], y[order], np.searchsorted(index[order], np.arange(across * across + 1))
    top = np.full(len(x), -np.inf)
    boxes = [[cell(a, triangles[:, :, a].min(1)), cell(a, triangles[:, :, a].max(1))] for a in (0, 1)]
    for (a, b, c), i0, i1, j0, j1 in zip(triangles, *boxes[0], *boxes[1]):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        rows = [slice(start[i * across + j0], start[i * across + j1 + 1]) for i in range(i0, i1 + 1)] if area else []
        for at in rows:
            s = ((x[at] - a[0]) * (c[1] - a[1]) - (y[at] - a[1]) * (c[0] - a[0])) / area
            t = ((b[0] - a[0]) * (y[at] - a[1]) - (b[1] - a[1]) * (x[at] - a[0])) / area
            height = a[2] + s * (b[2] - a[2]) + t * (c[2] - a[2])
            inside = (s >= -1e-12) & (t >= -1e-12) & (s + t <= 1 + 1e-12)
            top[at] = np.where(inside, np.maximum(top[at], height), top[at])
    result = np.empty_like(top)
    result[order] = top
    return result


def alphawrap(scene, program, scratch, part):
    """`program` is canopy-bench-alphawrap. Its mesh encloses the points; judged is what a viewer along the fitting
    direction sees of it, its highest point above each of them, in double: the offset is far more than that rounds."""
    points, mesh = scratch / "alphawrap-points", scratch / "alphawrap-triangles"
    place = scene.points.astype(float)
    place.tofile(points)
    done = subprocess.run([program, points, str(part), mesh], check=True, stdout=subprocess.PIPE, text=True)
    triangles = np.fromfile(mesh).reshape(-1, 3, 3)
    gap = (tops(triangles, place[:, 0], place[:, 1]) - place[:, 2]) / (place[:, 2].max() - place[:, 2].min())
    return {"name": f"CGAL alpha wrap, alpha = diagonal / {part}, {len(triangles):,} triangles", **times([float(done.stdout)]),
            "mean_gap_pct": 100 * float(gap.mean()), "max_gap_pct": 100 * float(gap.max()), "wrong": int((gap <= DOUBT).sum())}


# ---- The optimum: min mean gap; above every point; no pits; coefficients within one height range of the data's

def blossom(x, y, z):
    """Weights of the four coefficients in the blossom at (x, y, z) of a uniform cubic's segment [0, 1]."""
    w = np.eye(4)
    for at, below in ((x, (-2, -1, 0)), (y, (-1, 0)), (z, (0,))):
        width = len(below)
        a = ((at - np.array(below)) / width)[:, None]
        w = (1 - a) * w[:-1] + a * w[1:]
    return w[0]


# Bernstein coefficients on the lower and the upper half of a knot interval, from the four B-spline coefficients
HALVES = np.array([[blossom(*([low] * (3 - k) + [low + 0.5] * k)) for k in range(4)] for low in (0.0, 0.5)])


def matrix(iu, wu, iv, wv, n):
    """Sparse rows from the tensor product of (rows, 4) indices and weights."""
    columns = iu[:, :, None] * n + iv[:, None, :]
    values = wu[:, :, None] * wv[:, None, :]
    rows = np.repeat(np.arange(len(iu)), 16)
    return sparse.csr_matrix((values.ravel(), (rows, columns.ravel())), shape=(len(iu), n * n))


def safe_rows(scene):
    n = scene.grid
    return matrix(*Uniform.columns(scene.u, n), *Uniform.columns(scene.v, n), n), scene.z


def no_pits_rows(scene):
    """On a half-knot cell with points all 16 Bernstein coefficients are at least the cell's lowest point: between two
    samples the surface must not dive below both."""
    n = scene.grid
    low = np.full((2 * n - 2, 2 * n - 2), np.inf)
    np.minimum.at(low, (cells_of(2 * scene.u, 2 * n - 1)[0], cells_of(2 * scene.v, 2 * n - 1)[0]), scene.z)
    cells = np.argwhere(np.isfinite(low))
    index = np.clip(cells[:, :, None] // 2 + np.arange(-1, 3), 0, n - 1)  # (cells, direction, 4)
    weights = HALVES[cells % 2]                                         # (cells, direction, Bernstein, 4)
    which = np.indices((len(cells), 4, 4)).reshape(3, -1)               # cell, Bernstein in u, Bernstein in v
    rows = matrix(index[which[0], 0], weights[which[0], 0, which[1]],
                  index[which[0], 1], weights[which[0], 1, which[2]], n)
    return rows, low[cells[which[0], 0], cells[which[0], 1]]


def optimum(scene):
    safe, height = safe_rows(scene)
    pits, low = no_pits_rows(scene)
    cost = np.asarray(safe.mean(0)).ravel()
    seconds, result = repeat(1, lambda: linprog(cost, A_ub=-sparse.vstack([safe, pits]), method="highs-ipm",
                                                b_ub=-np.concatenate([height, low]), bounds=(-1, 2)))
    if result.status != 0:
        raise RuntimeError(f"HiGHS: {result.message}")
    surface = Uniform(result.x.reshape(scene.grid, scene.grid))
    return judge("linear program's optimum (HiGHS), lifted", scene, surface, seconds)


# ---- The paper, and stairs

def literal(scene, swap):
    seconds, (b, solves, most, open_lines) = repeat(1, lambda: paper.surface(scene, swap))
    name = f"the paper read literally, lines along {'u' if swap else 'v'} (Python)"
    return judge(name, scene, Uniform(b), seconds, solves=solves, most_solves=most, unsettled=open_lines)


def both_ways(scene):
    """The paper's symmetrised construction: the mean of the two, which is above what both are above."""
    start = time.process_time()
    b = sum(paper.surface(scene, swap)[0] for swap in (False, True)) / 2
    return judge("the paper's, u and v exchanged and averaged (Python)", scene, Uniform(b), [time.process_time() - start])


def stairs(scene, floor_us, cells):
    """Takes what the floor takes: it is the same pass."""
    surface = Stairs(scene, cells)
    gap = surface.heights(scene.u, scene.v) - scene.z
    return {"name": f"stairs, highest point of {cells} x {cells} cells (not smooth)", "best_ms": floor_us / 1e3,
            "median_ms": floor_us / 1e3, "repeats": 0, "mean_gap_pct": 100 * float(gap.mean()),
            "max_gap_pct": 100 * float(gap.max()), "wrong": int((gap < 0).sum())}
