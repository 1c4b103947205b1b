"""The panel of the cross-section."""
import numpy as np

from pictures.maps import with_percent
from pictures.style import POINT, SURFACES, WORST, number

POINTS = 20000
ENOUGH = 150          # points near the line before the slab is wide enough
SLABS = 0.02, 0.05, 0.1, 0.2, 0.35, 0.5   # its half width, in knot intervals
KNOTS = 120           # more are not marked
MARKER = 3.5


class Section:
    """The line from A to B: places along it in input units."""

    def __init__(self, view, steps=1601):
        s, self.view = view.frame, view
        self.step = np.array([s.pitch[a] * s.unit for a in (0, 1)])
        self.start = np.array(view.line[:2])
        self.way = np.array(view.line[2:]) - self.start
        self.length = float(np.hypot(*(self.way * self.step)))
        self.axis = 0 if self.way[1] == 0 else 1 if self.way[0] == 0 else None
        self.t = np.linspace(0, 1, steps)
        self.u, self.v = (self.start[a] + self.t * self.way[a] for a in (0, 1))

    def x(self, t):
        """What stands on the axis."""
        if self.axis is None:
            return np.asarray(t) * self.length / self.view.axes[0].factor
        along = self.view.frame.along(self.axis, self.start[self.axis] + np.asarray(t) * self.way[self.axis])
        return self.view.axes[self.axis](along)

    def label(self):
        if self.axis is None:
            return f"way from A to B ({self.view.axes[0].unit})"
        return self.view.names_of_axes()[self.axis]

    def where(self):
        s = self.view.frame
        if self.axis is None:
            a, b = ([self.view.axes[k].text(float(s.along(k, p[k]))) for k in (0, 1)]
                    for p in (self.start, self.start + self.way))
            return f"from A ({', '.join(a)}) to B ({', '.join(b)})"
        other = 1 - self.axis
        return f"at {s.axis_name(other)} = {self.view.axes[other].text(float(s.along(other, self.start[other])))}"

    def near(self, u, v):
        """How far along the line, and how far beside it in input units."""
        p = np.stack([u - self.start[0], v - self.start[1]], axis=-1) * self.step
        way = self.way * self.step / self.length
        return p @ way / self.length, np.abs(p[..., 0] * way[1] - p[..., 1] * way[0])


def draw_points(axes, view, section):
    """Those in the narrowest slab that has enough: returns its half width in knot intervals."""
    t, beside = section.near(view.cloud.u, view.cloud.v)
    pitch = float(section.step.mean())
    for half in SLABS:
        near = (beside <= half * pitch) & (t >= -1e-9) & (t <= 1 + 1e-9)
        if near.sum() >= ENOUGH:
            break
    chosen = np.nonzero(near)[0]
    if len(chosen) > POINTS:
        chosen = np.sort(np.random.default_rng(2).choice(chosen, POINTS, replace=False))
    count = f"{len(chosen):,} point{'s' * (len(chosen) != 1)}"
    if view.cloud.share < 1 or len(chosen) < near.sum():
        count += " (a part of all)"
    axes.plot(section.x(t[chosen]), view.height(view.cloud.z[chosen]), ".", ms=MARKER if len(chosen) > 60 else 6,
              color=POINT, mew=0, zorder=3, clip_on=len(chosen) > 60, rasterized=len(chosen) > 2000,
              label=f"{count} within {number(half * pitch)} of the line")
    return half


def draw_surface(axes, view, section, which, half):
    s, colour = view.surfaces[which], SURFACES[which]
    style = "-" if which == 0 or view.sandwich else (0, (5, 1.5))
    inside = s.covered(section.u, section.v)
    z = view.height(s.height(section.u, section.v))
    x = section.x(section.t)
    name = f"{'AB'[which]}  {view.names[which]}" if view.comparison else "surface"
    axes.plot(x, np.where(inside, z, np.nan), color=colour, lw=1.7, ls=style, zorder=4,
              label=f"{name}, {s.side} every point")
    if not inside.all():
        axes.plot(x, np.where(inside, np.nan, z), color=colour, lw=1.0, ls=":", zorder=4,
                  label="its way where there is no data" if which == 0 else None)
    if half:
        draw_slab(axes, view, section, which, half, x)
    return np.where(inside, z, np.nan)


def draw_slab(axes, view, section, which, half, x):
    """Between its lowest and highest over the width of the slab, or points beside the line seem to be beyond it."""
    s = view.surfaces[which]
    m, n = s.size[0] - 1, s.size[1] - 1
    beside = np.array([-section.way[1] * section.step[1], section.way[0] * section.step[0]]) / section.length
    beside = beside * half * float(section.step.mean()) / section.step
    every = slice(None, None, 4)
    z = np.stack([view.height(s.height(np.clip(section.u[every] + k * beside[0], 0, m),
                                       np.clip(section.v[every] + k * beside[1], 0, n))) for k in (-1, -.5, 0, .5, 1)])
    inside = s.covered(section.u[every], section.v[every])
    axes.fill_between(x[every], z.min(0), z.max(0), where=inside, color=SURFACES[which], alpha=0.25, lw=0, zorder=2,
                      label="the surface over that width" if which == 0 else None)


def draw_worst(axes, view, section):
    """The largest gap as a line from the point to the surface, if the cross-section runs through it."""
    if view.cloud is None or view.sandwich or not view.worst:
        return
    gaps = max(view.cloud.gaps, key=lambda g: g.most)
    u, v, z = gaps.worst
    t, beside = section.near(np.array(u), np.array(v))
    if float(beside) > 1e-3 * float(section.step.mean()) or not -1e-6 <= float(t) <= 1 + 1e-6 or gaps.most <= 0:
        return
    x, low, high = float(section.x(t)), float(view.height(z)), float(view.height(z + gaps.sign * gaps.most))
    axes.plot([x, x], [low, high], color=WORST, lw=1.6, marker="_", ms=8, zorder=5, clip_on=False,
              label=f"largest gap: {with_percent(view, gaps.most)}")


def draw_knots(axes, section):
    s = section.view.frame
    if section.axis is None or s.size[section.axis] > KNOTS:
        return
    knots = (np.arange(s.size[section.axis]) - section.start[section.axis]) / section.way[section.axis]
    knots = knots[(knots >= -1e-9) & (knots <= 1 + 1e-9)]
    axes.plot(section.x(knots), np.full(len(knots), 0.012), "|", color="0.45", ms=7, label="knots",
              transform=axes.get_xaxis_transform())


def draw(axes, view):
    section = Section(view)
    half = draw_points(axes, view, section) if view.cloud is not None else None
    lines = [draw_surface(axes, view, section, k, half) for k in range(len(view.surfaces))]
    if view.sandwich:
        axes.fill_between(section.x(section.t), lines[1], lines[0], color="0.5", alpha=0.12, lw=0, zorder=1)
    draw_worst(axes, view, section)
    draw_knots(axes, section)
    ends = section.x(np.array([0.0, 1.0]))
    axes.set_xlim(*ends)
    axes.set_ylim(*limits(view, lines, axes))
    axes.set_xlabel(section.label())
    axes.set_ylabel(view.names_of_axes()[2])
    axes.grid(alpha=0.25)
    for letter, side in (("A", 0.0), ("B", 1.0)):
        axes.annotate(letter, (side, 1.0), xycoords="axes fraction", xytext=(0, 5), textcoords="offset points",
                      ha="center", fontsize=9, bbox=dict(boxstyle="circle,pad=0.15", fc="white", ec="black", lw=0.8))
    axes.legend(loc="center left", bbox_to_anchor=(1.005, 0.5), fontsize=9, frameon=False, markerscale=1.6)
    what = "thickest place" if view.sandwich else "largest gap" if view.cloud is not None else "largest change"
    why = f", through the {what}" if view.worst and not view.chosen else ""
    axes.set_title(f"cross-section {section.where()}{why}", fontsize=11)


def limits(view, lines, axes):
    """What is covered and the points near the line; the rest may leave the picture."""
    known = [z[np.isfinite(z)] for z in lines] + [np.asarray(line.get_ydata(), float) for line in axes.lines
                                                  if line.get_color() == POINT]
    known = np.concatenate(known)
    low, high = (float(known.min()), float(known.max())) if len(known) else (view.low, view.high)
    if view.cloud is not None:  # flares between the points are not what one wants to see
        low, high = max(low, view.low), min(high, view.high)
    margin = 0.08 * (high - low) or 0.5 * (view.high - view.low)
    return low - margin, high + margin
