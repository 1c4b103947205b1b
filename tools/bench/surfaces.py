"""Surfaces of the peers in normalised coordinates, evaluated in double and, where that leaves a doubt, in fractions."""

from fractions import Fraction

import numpy as np

DOUBT = 1e-9  # of the height range: double evaluation of every surface here is better than that


def cells_of(t, n):
    """Knot interval and local parameter of each t in [0, n-1]."""
    h = np.clip(np.floor(t).astype(int), 0, n - 2)
    return h, t - h


class Uniform:
    """Uniform bicubic B-spline whose outermost coefficients are repeated once: the space that canopy works in."""

    def __init__(self, coefficients):
        self.b = np.asarray(coefficients, dtype=float)

    @staticmethod
    def weights(s):
        return [(1 - s) ** 3 / 6, (3 * s ** 3 - 6 * s ** 2 + 4) / 6, (-3 * s ** 3 + 3 * s ** 2 + 3 * s + 1) / 6, s ** 3 / 6]

    @classmethod
    def columns(cls, t, n):
        """Coefficients that shape the surface at t, and their weights: two arrays (len(t), 4)."""
        h, s = cells_of(t, n)
        return np.clip(h[:, None] + np.arange(-1, 3), 0, n - 1), np.stack(cls.weights(s), 1)

    def heights(self, u, v):
        iu, wu = self.columns(u, self.b.shape[0])
        iv, wv = self.columns(v, self.b.shape[1])
        return np.einsum("pa,pb,pab->p", wu, wv, self.b[iu[:, :, None], iv[:, None, :]])

    def exact(self, u, v):
        sides = []
        for t, n in zip((u, v), self.b.shape):
            h = min(int(t), n - 2)
            sides.append([(min(max(h + k - 1, 0), n - 1), w) for k, w in enumerate(self.weights(t - h))])
        return sum(wu * wv * Fraction(self.b[i, j]) for i, wu in sides[0] for j, wv in sides[1])

    def lift(self, by):
        self.b = self.b + by


class Knots:
    """Tensor B-spline of degree 3 as FITPACK gives it: knots of both directions and coefficients."""

    def __init__(self, tu, tv, coefficients):
        self.t = [np.asarray(tu, float), np.asarray(tv, float)]
        self.c = np.asarray(coefficients, float).reshape(len(tu) - 4, len(tv) - 4)

    @staticmethod
    def weights(t, at, h):
        """The four B-splines that are not zero on [t[h], t[h+1]), Cox and de Boor; exact where `at` is a fraction."""
        zero, w = at - at, [at - at + 1]
        for degree in range(1, 4):
            following = [zero] * (degree + 1)
            for r in range(degree):
                left, right = t[h + 1 + r - degree], t[h + 1 + r]
                part = w[r] / (right - left)
                following[r] = following[r] + part * (right - at)
                following[r + 1] = following[r + 1] + part * (at - left)
            w = following
        return w

    def span(self, a, at):
        return np.clip(np.searchsorted(self.t[a], at, side="right") - 1, 3, len(self.t[a]) - 5)

    def heights(self, u, v):
        sides = []
        for a, at in enumerate((u, v)):
            h = self.span(a, at)
            w = np.empty((len(at), 4))
            for interval in np.unique(h):
                here = h == interval
                w[here] = np.stack(self.weights(self.t[a], at[here], interval), 1)
            sides.append((h[:, None] + np.arange(-3, 1), w))
        (iu, wu), (iv, wv) = sides
        return np.einsum("pa,pb,pab->p", wu, wv, self.c[iu[:, :, None], iv[:, None, :]])

    def exact(self, u, v):
        sides = []
        for a, at in enumerate((u, v)):
            t = [Fraction(x) for x in self.t[a]]
            h = max(k for k in range(3, len(t) - 4) if k == 3 or t[k] <= at)
            sides.append(list(zip(range(h - 3, h + 1), self.weights(t, at, h))))
        return sum(wu * wv * Fraction(self.c[i, j]) for i, wu in sides[0] for j, wv in sides[1])

    def lift(self, by):
        self.c = self.c + by


class Cells:
    """One bicubic polynomial a knot cell, as ALGLIB unpacks its spline: rows of 20 doubles, edges first."""

    def __init__(self, table):
        n = round(len(table) ** 0.5)
        self.n = n + 1
        self.c = np.empty((n, n, 4, 4))  # cell u, cell v, power u, power v
        self.c[np.rint(table[:, 0]).astype(int), np.rint(table[:, 2]).astype(int)] = table[:, 4:].reshape(-1, 4, 4)

    def heights(self, u, v):
        (hu, s), (hv, t) = cells_of(u, self.n), cells_of(v, self.n)
        powers = [np.stack([x ** k for k in range(4)], 1) for x in (s, t)]
        return np.einsum("pa,pb,pab->p", *powers, self.c[hu, hv])

    def exact(self, u, v):
        hu, hv = (min(int(x), self.n - 2) for x in (u, v))
        s, t = u - hu, v - hv
        return sum(Fraction(self.c[hu, hv, a, b]) * s ** a * t ** b for a in range(4) for b in range(4))

    def lift(self, by):
        self.c[:, :, 0, 0] += by


class Stairs:
    """The highest point of each of so many cells: not smooth, and what any smooth surface has to be measured against."""

    def __init__(self, scene, cells):
        self.scale, self.cells = cells / (scene.grid - 1), cells
        self.top = np.full((cells, cells), -np.inf)
        np.maximum.at(self.top, self.cell(scene.u, scene.v), scene.z)

    def cell(self, u, v):
        return tuple(cells_of(self.scale * t, self.cells + 1)[0] for t in (u, v))

    def heights(self, u, v):
        return self.top[self.cell(u, v)]


def count_wrong(surface, scene):
    """Points above the surface, in exact arithmetic: fractions where double leaves a doubt."""
    margin = surface.heights(scene.u, scene.v) - scene.z
    wrong = int((margin < -DOUBT).sum())
    for index in np.nonzero(np.abs(margin) <= DOUBT)[0]:
        u, v, z = scene.exact(index)
        wrong += surface.exact(u, v) < z
    return wrong
