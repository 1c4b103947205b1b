#!/usr/bin/python3
"""Draws a surrogate file and points: what `canopy plot` runs.

Usage: plot_surrogate.py SURROGATE.json OUT.png NAME [points]

With "points", standard input holds them: x, y, z in input units as doubles in this machine's order. NAME is what the
title calls them. Needs Debian's python3-matplotlib. The surrogate has been validated by whoever calls. Exit status: 0
drawn, 3 OUT.png cannot be written, 4 matplotlib is missing; the caller says so.
"""
import json
import os
import sys

try:
    import numpy as np
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from mpl_toolkits.mplot3d.art3d import Line3DCollection
except ImportError:
    sys.exit(4)

SPACE_POINTS = 12000    # points drawn in space: more hide the surface
SECTION_POINTS = 20000
POINT, SURFACE = "#c2410c", "#1d4ed8"


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

    def labels(self):
        names = "xyz" if self.aligned else ("u", "v", "height")
        return [f"{name} (input units)" for name in names]


def lattice(s, steps=140):
    u, v = np.meshgrid(np.linspace(0, s.size[0] - 1, steps), np.linspace(0, s.size[1] - 1, steps), indexing="ij")
    return u, v, np.where(s.covered(u, v), s.height(u, v), np.nan)


def heights_of_interest(z, cloud):
    """The points' range with a margin, so that a dip where nothing is covered does not flatten the scene."""
    known = z[np.isfinite(z)] if cloud is None else cloud[2]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    margin = 0.2 * (high - low) or 0.5
    return low - margin, high + margin


def draw_space(figure, place, s, cloud, sample):
    axes = figure.add_subplot(place, projection="3d", computed_zorder=False)
    u, v, z = lattice(s)
    x, y = s.along(0, u), s.along(1, v)
    above = s.side == "above"
    low, high = heights_of_interest(z, cloud)
    z = np.where((z >= low) & (z <= high), z, np.nan)
    light = matplotlib.colors.LightSource(azdeg=315, altdeg=50)
    filled = np.where(np.isnan(z), low if above else high, z)
    span = high - low
    shade = light.shade(filled, cmap=plt.get_cmap("Blues_r" if above else "Blues"), blend_mode="soft",
                        vmin=low - (0.0 if above else 0.6 * span), vmax=high + (0.6 * span if above else 0.0),
                        vert_exag=0.7, dx=max(np.ptp(x) / len(x), 1e-300), dy=max(np.ptp(y) / len(y), 1e-300))
    shade[..., 3] = 0.55 if cloud is not None else 1.0
    surface = dict(rstride=1, cstride=1, facecolors=shade, linewidth=0, antialiased=False, shade=False)
    axes.plot_surface(x, y, z, zorder=2, **surface)  # the viewer stands on the surface's side
    if cloud is not None:
        pu, pv, pz = (c[sample] for c in cloud)
        axes.scatter(s.along(0, pu), s.along(1, pv), pz, s=1.2, color=POINT, linewidth=0, depthshade=False,
                     zorder=1)
    draw_outline(axes, s, low, high)
    names = s.labels()
    axes.set_xlabel(names[0], labelpad=6)
    axes.set_ylabel(names[1], labelpad=6)
    axes.set_zlabel(names[2], labelpad=8)
    lengths = np.array([np.ptp(x), np.ptp(y)]) / max(np.ptp(x), np.ptp(y), 1e-300)
    axes.set_box_aspect((max(lengths[0], 0.25), max(lengths[1], 0.25), 0.6), zoom=1.12)
    axes.set_zlim(low, high)
    axes.view_init(elev=28 if above else -28, azim=-60)
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=8)
    caption = "surface" + (f" and points, seen from {s.side}" if cloud is not None else "")
    figure.text(0.22, 0.035, caption, fontsize=11, ha="center")  # below: labels stand where a title would


def draw_outline(axes, s, low, high):
    """The trim's edges on the surface."""
    along = np.linspace(0, 1, 7)[:, None]
    edges = s.outline()
    if not len(edges):
        return
    knots = edges[:, None, 0] * (1 - along) + edges[:, None, 1] * along
    z = np.clip(s.height(knots[..., 0], knots[..., 1]), low, high)
    lines = np.stack([s.along(0, knots[..., 0]), s.along(1, knots[..., 1]), z], axis=-1)
    axes.add_collection3d(Line3DCollection(lines, colors=SURFACE, linewidths=0.9, zorder=3))


def section_at(s, cloud):
    """v of the section: the middle of the points, not on the very edge."""
    if cloud is None:
        return (s.size[1] - 1) / 2
    return float(np.clip(np.median(cloud[1]), 0, s.size[1] - 1))


def draw_section(figure, place, s, cloud):
    axes = figure.add_subplot(place)
    v, half = section_at(s, cloud), 0.1
    u = np.linspace(0, s.size[0] - 1, 1200)
    z = np.where(s.covered(u, np.full_like(u, v)), s.height(u, np.full_like(u, v)), np.nan)
    x = s.along(0, u)
    if cloud is not None:
        near = np.nonzero(np.abs(cloud[1] - v) <= half)[0][:SECTION_POINTS]
        width = 2 * half * s.pitch[1] * s.unit
        axes.plot(s.along(0, cloud[0][near]), cloud[2][near], ".", ms=3, color=POINT,
                  label=f"{len(near)} points in a slab {width:.3g} wide")
    axes.plot(x, z, color=SURFACE, lw=1.6, label=f"surface ({s.side} every point)")
    knots = s.along(0, np.arange(s.size[0]))
    axes.plot(knots, np.full(len(knots), 0.012), "|", color="0.45", ms=7, label="knots",
              transform=axes.get_xaxis_transform())
    names = s.labels()
    axes.set_xlabel(names[0])
    axes.set_ylabel(names[2])
    axes.set_xlim(x[0], x[-1] if x[-1] > x[0] else x[0] + 1)
    axes.margins(y=0.12)
    axes.grid(alpha=0.25)
    axes.legend(loc="best", fontsize=9, framealpha=0.9)
    axes.set_title(f"cross-section at {names[1].split()[0]} = {s.along(1, v):.4g}", fontsize=11)


def headline(s, cloud, name):
    text = f"canopy  {s.size[0]}×{s.size[1]} {s.side}, {s.scalar}"
    if cloud is not None:
        u, v, z = cloud
        inside = (u >= -1e-9) & (u <= s.size[0] - 1 + 1e-9) & (v >= -1e-9) & (v <= s.size[1] - 1 + 1e-9)
        gap = (s.height(u[inside], v[inside]) - z[inside]) * (1 if s.side == "above" else -1)
        span = np.ptp(z) or 1.0
        text += f"   {os.path.basename(name)}: {len(z):,} points"
        if len(gap):
            mean, most = 100 * gap.mean() / span, 100 * gap.max() / span
            text += f", mean gap {mean:.2f} % of the height range, max {most:.1f} %"
        if len(gap) < len(z):
            text += f", {len(z) - len(gap):,} outside the frame"
    return text


def main():
    s, out, name = Surrogate(sys.argv[1]), sys.argv[2], sys.argv[3]
    cloud, sample = None, slice(None)
    if sys.argv[4:] == ["points"]:
        points = np.frombuffer(sys.stdin.buffer.read(), float).reshape(-1, 3)
        cloud = s.knots(points)
        if len(points) > SPACE_POINTS:
            sample = np.random.default_rng(1).choice(len(points), SPACE_POINTS, replace=False)
    figure = plt.figure(figsize=(14, 6.2), dpi=110)
    grid = figure.add_gridspec(1, 2, width_ratios=(1, 1.05), left=0.0, right=0.972, bottom=0.1, top=0.87, wspace=0.22)
    draw_space(figure, grid[0], s, cloud, sample)
    draw_section(figure, grid[1], s, cloud)
    figure.suptitle(headline(s, cloud, name), fontsize=12, fontweight="bold")
    try:
        figure.savefig(out, format="png")
    except OSError:
        sys.exit(3)


if __name__ == "__main__":
    main()
