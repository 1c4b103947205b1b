"""A surrogate file as numbers: heights, what is covered, the outline, places along the frame's axes."""
import json

import numpy as np


class Surrogate:
    """Heights in input units over knots (u, v)."""

    def __init__(self, path):
        with open(path) as file:
            s = json.load(file)
        self.side, self.scalar, self.unit = s["side"], s["scalar"], s["unit"]
        self.size = s["size"]
        self.origin, self.axes = np.array(s["frame"]["origin"], float), np.array(s["frame"]["axes"], float)
        self.pitch, self.lsb = np.array(s["frame"]["pitch"], float), s.get("lsb", 1)
        self.b = np.pad(np.array(s["coefficients"], float), 1, mode="edge")
        self.windows, self.trim = s.get("windows", []), s.get("trim")
        self.certificate = s.get("certificate")
        self.aligned = np.array_equal(self.axes, np.eye(3))
        self.base = float(self.axes[2] @ self.origin) * self.unit

    @staticmethod
    def weights(s):
        return np.stack([(1 - s) ** 3, 3 * s ** 3 - 6 * s ** 2 + 4, -3 * s ** 3 + 3 * s ** 2 + 3 * s + 1, s ** 3]) / 6

    def height(self, u, v):
        hu = np.clip(np.floor(u).astype(int), 0, self.size[0] - 2)
        hv = np.clip(np.floor(v).astype(int), 0, self.size[1] - 2)
        wu, wv = self.weights(u - hu), self.weights(v - hv)
        z = sum(wu[a] * wv[c] * self.b[hu + a, hv + c] for a in range(4) for c in range(4))
        for w in self.windows:
            z = z + self.window(w, u, v)
        return z * self.lsb * self.unit + self.base

    def window(self, w, u, v):
        x, y = u * 2 ** w["level"] - w["first"][0], v * 2 ** w["level"] - w["first"][1]
        d, z = np.pad(np.array(w["coefficients"], float), 3), 0.0
        gu = np.clip(np.floor(x).astype(int), -3, w["size"][0] + 1)
        gv = np.clip(np.floor(y).astype(int), -3, w["size"][1] + 1)
        wu, wv = self.weights(x - gu), self.weights(y - gv)
        inside = (x > -2) & (x < w["size"][0] + 1) & (y > -2) & (y < w["size"][1] + 1)
        for a in range(4):
            for c in range(4):
                i, j = np.clip(gu + a + 2, 0, d.shape[0] - 1), np.clip(gv + c + 2, 0, d.shape[1] - 1)
                z = z + wu[a] * wv[c] * d[i, j]
        return np.where(inside, z, 0.0)

    def cells(self):
        """Which knot cells are covered, which are cut, and at which corner of theirs the cut leaves a triangle inside.

        The rule of lib/cover/trim.h: an uncovered cell is cut where exactly two of its four neighbours are covered and
        share a corner."""
        t = np.pad(np.array(self.trim, bool), 1)
        low_u, high_u, low_v, high_v = t[:-2, 1:-1], t[2:, 1:-1], t[1:-1, :-2], t[1:-1, 2:]
        covered = t[1:-1, 1:-1]
        return covered, ~covered & (low_u ^ high_u) & (low_v ^ high_v), high_u, high_v

    def covered(self, u, v):
        """Inside the trim: covered cells, and the triangles of cells that are cut."""
        if self.trim is None:
            return np.ones(np.broadcast(u, v).shape, bool)
        hu = np.clip(np.floor(u).astype(int), 0, self.size[0] - 2)
        hv = np.clip(np.floor(v).astype(int), 0, self.size[1] - 2)
        covered, cut, high_u, high_v = (cells[hu, hv] for cells in self.cells())
        return covered | (cut & (np.abs(u - hu - high_u) + np.abs(v - hv - high_v) <= 1))

    def outline(self):
        """The trim's edges, each from knot to knot: (edges, 2, 2)."""
        if self.trim is None:
            return np.empty((0, 2, 2))
        covered, cut, high_u, high_v = self.cells()
        outside = np.pad(~covered & ~cut, 1, constant_values=True)
        m, n = covered.shape
        edges = []
        for du, dv, one, two in ((-1, 0, (0, 0), (0, 1)), (1, 0, (1, 0), (1, 1)), (0, -1, (0, 0), (1, 0)),
                                 (0, 1, (0, 1), (1, 1))):
            cells = np.argwhere(covered & outside[1 + du:1 + du + m, 1 + dv:1 + dv + n])
            edges.append(np.stack([cells + one, cells + two], axis=1))
        cells = np.argwhere(cut)
        corner = np.stack([high_u[cut], high_v[cut]], axis=1).astype(int)
        edges.append(np.stack([cells + (1, 0) + corner * (-1, 1), cells + (0, 1) + corner * (1, -1)], axis=1))
        return np.concatenate(edges).astype(float)

    def knots(self, points):
        """(u, v, height in input units) of points in input units, rounded as the device does."""
        p = points / self.unit
        p = p.astype(np.float32).astype(float) if self.scalar == "f32" else np.rint(p)
        q = (p - self.origin) @ self.axes.T
        return q[:, 0] / self.pitch[0], q[:, 1] / self.pitch[1], q[:, 2] * self.unit + self.base

    def along(self, axis, t):
        """Knots along axis 0 or 1 in input units, measured as the points are."""
        return (np.asarray(t) * self.pitch[axis] + float(self.axes[axis] @ self.origin)) * self.unit

    def axis_name(self, axis):
        """What an axis is called: x, y, z where it is one of them, else with its direction."""
        a = self.axes[axis]
        for k, letter in enumerate("xyz"):
            if abs(a[k]) == 1:
                return letter if a[k] > 0 else f"\u2212{letter}"
        direction = ", ".join(f"{c:.2f}".replace("-", "\u2212") for c in a + 0.0)
        return f"{('u', 'v', 'height')[axis]} along ({direction})"

    def windows_at(self):
        """The refinement windows as (level, corner, opposite corner) in knots: where each adds anything."""
        for w in self.windows:
            first, scale = np.array(w["first"], float), 2.0 ** -w["level"]
            yield w["level"], (first - 2) * scale, (first + np.array(w["size"]) + 1) * scale
