"""The construction of the paper that canopy's `fast` descends from, read literally: a reference for its gap, not for speed.

One exchange at a time, from the points themselves, dense solves; a line that has not ended after SOLVES solves, or whose
matrix is singular, is raised by its largest violation.
"""

import numpy as np
from scipy.linalg import solve_banded

SOLVES = 60
TOLERANCE = 1e-9  # of the height range


def bends(b):
    """Second differences with the end coefficients repeated once."""
    e = np.concatenate([b[:1], b, b[-1:]])
    return e[:-2] - 2 * e[1:-1] + e[2:]


def add_bend(row, i, weight):
    """Adds weight * (b[i-1] - 2 b[i] + b[i+1])."""
    n = len(row)
    row[max(i - 1, 0)] += weight
    row[i] -= 2 * weight
    row[min(i + 1, n - 1)] += weight


class Bound:
    """The lower bound of the spline at the parameters t, as the paper's Lemma 5.1 has it."""

    def __init__(self, t, n):
        self.h = np.minimum(np.floor(t).astype(int), n - 2)
        self.s = t - self.h
        self.left, self.right = (1 - self.s) ** 3 / 6, self.s ** 3 / 6

    def __call__(self, b):
        bend = np.minimum(bends(b), 0)
        return ((1 - self.s) * b[self.h] + self.s * b[self.h + 1]
                + self.left * bend[self.h] + self.right * bend[self.h + 1])

    def row(self, k, signs):
        """Equation of point k, linear once the signs are fixed."""
        row, h = np.zeros(len(signs)), self.h[k]
        row[h] += 1 - self.s[k]
        row[h + 1] += self.s[k]
        for i, weight in ((h, self.left[k]), (h + 1, self.right[k])):
            if signs[i]:
                add_bend(row, i, weight)
        return row


def line(t, y, n):
    """Coefficients above the points (t, y), solves, and whether it ended by itself. Heuristic(sigma, b, lambda)."""
    bound, nearest = Bound(t, n), np.rint(t).astype(int)
    chosen = np.full(n, -1)
    for k in np.argsort(y, kind="stable"):
        chosen[nearest[k]] = k
    signs, best = np.ones(n, bool), None
    for solves in range(1, SOLVES + 1):
        a, rhs = np.zeros((n, n)), np.zeros(n)
        for j in range(n):
            if chosen[j] < 0:
                add_bend(a[j], j, 1.0)
            else:
                a[j], rhs[j] = bound.row(chosen[j], signs), y[chosen[j]]
        try:
            b = np.linalg.solve(a, rhs)
        except np.linalg.LinAlgError:
            break
        violation = y - bound(b)
        worst = int(np.argmax(violation))
        if best is None or violation[worst] < best[0]:
            best = violation[worst], b
        found = bends(b) < 0
        if (found != signs).any():
            signs = found
        elif violation[worst] <= TOLERANCE:
            return b + max(violation[worst], 0), solves, True
        else:
            chosen[nearest[worst]] = worst
    if best is None:
        return np.full(n, y.max()), SOLVES, False
    return best[1] + max(best[0], 0), solves, False


def uniform(heights):
    """Heuristic(sigma, b): solves until the signs repeat, above the polyline through heights at the integers; 0: a cycle."""
    n, signs, seen = len(heights), bends(heights) < 0, set()
    while signs.tobytes() not in seen:
        seen.add(signs.tobytes())
        weight, bands = signs / 6, np.zeros((3, n))
        bands[0, 1:], bands[1], bands[2, :-1] = weight[:-1], 1 - 2 * weight, weight[1:]
        bands[1, [0, -1]] += weight[[0, -1]]
        found = bends(solve_banded((1, 1), bands, heights)) < 0
        if (found == signs).all():
            return len(seen)
        signs = found
    return 0


def surface(scene, swap, counted=None):
    """(coefficients, mean solves a line, most, lines that did not end). Lines along v, then columns along u; or swapped.
    counted: a list of the solves of each line along v that ended (0: it did not), appended to."""
    n, u, v = scene.grid, scene.u, scene.v
    if swap:
        u, v = v, u
    g, held = np.zeros((n, n)), np.zeros((n, n), bool)
    counts, unsettled = [], 0
    for i in range(n):
        near = np.abs(u - i) <= 1
        if near.any():
            g[i], solves, ended = line(v[near], scene.z[near], n)
            counts.append(solves)
            unsettled += not ended
            if counted is not None:
                counted.append(solves if ended else 0)
            for h in np.unique(np.minimum(np.floor(v[near]).astype(int), n - 2)):
                held[i, max(h - 1, 0):h + 3] = True
    b = np.zeros((n, n))
    for j in range(n):
        rows = np.nonzero(held[:, j])[0]
        if len(rows):
            b[:, j], solves, ended = line(rows.astype(float), g[rows, j], n)
            counts.append(solves)
            unsettled += not ended
    return (b.T if swap else b), float(np.mean(counts)), max(counts), unsettled
