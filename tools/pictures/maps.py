"""The panels seen along the third axis: gap, thickness, change, height, trim."""
import matplotlib
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import ScaledTranslation

from pictures.style import COVERED, LINE, SURFACES, UNCOVERED, WINDOW, WORST, number

STRETCH = 6        # a frame longer than this many times its width is not drawn to scale
CELL_LINES = 64    # a grid with more cells than this on a side is drawn without their edges


def prepare(axes, view, title):
    (x0, x1), (y0, y1) = view.ends
    axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fc=UNCOVERED, ec="0.5", lw=0.8, zorder=-1))
    axes.set_xlabel(view.names_of_axes()[0])
    axes.set_ylabel(view.names_of_axes()[1])
    x, y = (float(np.ptp(e)) * ticks.factor for e, ticks in zip(view.ends, view.axes))
    axes.set_aspect("equal" if max(x, y) <= STRETCH * min(x, y) else "auto", adjustable="datalim")
    axes.set_xlim(*margin(view.ends[0]))
    axes.set_ylim(*margin(view.ends[1]))
    axes.set_title(title, fontsize=11)


def margin(ends):
    extra = 0.02 * (ends[1] - ends[0])
    return ends[0] - extra, ends[1] + extra


def draw_marks(axes, view, which=0, worst=None):
    """What all maps show: outline, windows, the cross-section, the worst place. Returns a legend's entries."""
    s, entries = view.surfaces[which], []
    edges = s.outline()
    if len(edges):
        x, y = view.place(edges[..., 0], edges[..., 1])
        axes.add_collection(LineCollection(np.stack([x, y], axis=-1), colors=SURFACES[0], linewidths=1.1))
        entries.append(Line2D([], [], color=SURFACES[0], lw=1.1, label="outline of what is covered"))
    for level, low, high in s.windows_at():
        x, y = view.place(np.array([low[0], high[0]]), np.array([low[1], high[1]]))
        axes.add_patch(Rectangle((x[0], y[0]), x[1] - x[0], y[1] - y[0], fill=False, ec=WINDOW, lw=1.8, ls=(0, (4, 2))))
        name = f"window, {('half', 'quarter')[level - 1]} pitch"
        if name not in [e.get_label() for e in entries]:
            entries.append(Line2D([], [], color=WINDOW, lw=1.8, ls=(0, (4, 2)), label=name))
    draw_line(axes, view)
    entries.append(Line2D([], [], color=LINE, lw=1.2, ls="--", label="cross-section A–B"))
    if worst:
        x, y = view.place(worst[0], worst[1])
        axes.plot(x, y, "X", color=WORST, mec="white", ms=10, mew=1.2, zorder=5)
        entries.append(Line2D([], [], color=WORST, marker="X", mec="white", ms=9, lw=0, label=worst[2]))
    return entries


def draw_line(axes, view):
    x, y = view.place(np.array(view.line[0::2]), np.array(view.line[1::2]))
    axes.plot(x, y, color="white", lw=2.4, alpha=0.8)
    axes.plot(x, y, color=LINE, lw=1.2, ls="--")
    box = dict(boxstyle="circle,pad=0.15", fc="white", ec=LINE, lw=0.8)
    for letter, px, py in zip("AB", x, y):
        axes.annotate(letter, (px, py), ha="center", va="center", fontsize=8, bbox=box, zorder=6, annotation_clip=False)


def legend(axes, entries, blank=True):
    if blank:
        entries = [*entries, Patch(fc=UNCOVERED, ec="0.7", label=blank)]
    below = axes.transAxes + ScaledTranslation(0, -0.5, axes.figure.dpi_scale_trans)  # half an inch: the ticks' labels
    axes.legend(handles=entries, loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=below, ncol=2,
                fontsize=8, frameon=False, handlelength=2.2, columnspacing=1.5)


def draw_image(axes, view, values, colours, low, high):
    (x0, x1), (y0, y1) = view.ends
    cover = 1e-9 * max(x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else 1e-9
    limits, aspect = (axes.get_xlim(), axes.get_ylim()), axes.get_aspect()
    image = axes.imshow(values.T, origin="lower", extent=(x0, x1 + cover, y0, y1 + cover), cmap=colours, vmin=low,
                        vmax=high, interpolation="nearest", aspect="auto", zorder=0)
    axes.set_xlim(*limits[0])
    axes.set_ylim(*limits[1])
    axes.set_aspect(aspect, adjustable="datalim")
    return image


def draw_scale(axes, view, image, name, extend="neither"):
    """The colours' scale, beside the map: lengths, and per cent of the points' height range where that is known."""
    bar = axes.figure.colorbar(image, cax=axes.inset_axes([1.03, 0.0, 0.045, 1.0]), extend=extend)
    whole = view.percent(view.height.factor) if name != "height" else None
    unit = view.height.unit
    if whole:
        unit += "; % of the height range"
        bar.formatter = lambda x, _: f"{number(x)} = {x * whole:.3g} %" if x else "0"
        bar.update_ticks()
    bar.ax.tick_params(labelsize=8)
    bar.set_label(f"{name}\n({unit})", fontsize=9)


def gap_limit(view):
    """The end of the scale of gaps: what one tile in two hundred passes. And whether any does."""
    values = [g.map() / view.height.factor for g in view.cloud.gaps]
    known = np.concatenate([v[np.isfinite(v)] for v in values] or [np.zeros(1)])
    high = float(np.quantile(known, 0.995)) if len(known) else 0.0
    return max(high, 1e-3 * (view.high - view.low)), bool(len(known) and known.max() > 1.02 * high)


def draw_gap(axes, view, which=0):
    gaps = view.cloud.gaps[which]
    high, beyond = gap_limit(view)
    prepare(axes, view, gap_title(view, which))
    image = draw_image(axes, view, gaps.map() / view.height.factor, "viridis", 0.0, high)
    worst = gaps.worst and (*gaps.worst[:2], f"largest gap: {with_percent(view, gaps.most)}")
    legend(axes, draw_marks(axes, view, which, worst), "no points")
    draw_scale(axes, view, image, "mean gap of the points in a tile", "max" if beyond else "neither")


def gap_title(view, which):
    name = "gap" if len(view.surfaces) == 1 else f"{'AB'[which]}  {view.names[which]}: gap"
    gaps = view.cloud.gaps[which]
    return f"{name} {with_percent(view, gaps.mean)} in the mean" if gaps.count else f"{name}: no points over the frame"


def with_percent(view, gap):
    share = view.percent(gap)
    return number(gap) if share is None else f"{number(gap)} = {share:.3g} %"


def draw_pair(axes, view):
    """The thickness of a sandwich, or how far the second surface is above the first."""
    a, b = view.lattice
    apart = (a.z - b.z if view.sandwich else b.z - a.z) / view.height.factor
    known = apart[np.isfinite(apart)]
    known = known if len(known) else np.zeros(1)
    least = 1e-3 * (view.high - view.low)
    if view.sandwich:
        low, colours, name = min(0.0, float(known.min())), "viridis", "thickness"
        high = max(float(np.quantile(known, 0.98)), least)
        title = f"thickness, from {number(float(known.min()) * view.height.factor)} to " \
                f"{number(float(known.max()) * view.height.factor)}"
        mark = "thickest here"
    else:
        high = max(float(np.abs(known).max()), least)
        low, colours, name = -high, "PuOr_r", "B above A"
        title = f"B above A: from {number(float(known.min()) * view.height.factor)} to " \
                f"{number(float(known.max()) * view.height.factor)}"
        mark = "largest change"
    prepare(axes, view, title)
    image = draw_image(axes, view, apart, colours, low, high)
    legend(axes, draw_marks(axes, view, 0, view.worst and (*view.worst, mark)), "not covered by both")
    draw_scale(axes, view, image, name, "max" if view.sandwich and known.max() > 1.02 * high else "neither")


def draw_height(axes, view):
    """A surface alone: its height, with lines of equal height."""
    lattice = view.lattice[0]
    z = view.height(lattice.z)
    prepare(axes, view, "height of the surface")
    known = z[np.isfinite(z)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (view.low, view.high)
    image = draw_image(axes, view, z, "cividis", low, high if high > low else low + 1)
    if high > low:
        x, y = view.place(lattice.u, lattice.v)
        axes.contour(x, y, z, levels=9, colors="white", linewidths=0.5, alpha=0.7)
    legend(axes, draw_marks(axes, view), "not covered" if view.frame.trim is not None else None)
    draw_scale(axes, view, image, "height")


def draw_trim(axes, view, which=0):
    """Knot cells: with data, cut along the outline, without."""
    s = view.surfaces[which]
    m, n = s.size[0] - 1, s.size[1] - 1
    covered = np.ones((m, n), bool) if s.trim is None else np.array(s.trim, bool)
    name = "" if len(view.surfaces) == 1 else f"{'AB'[which]}  {view.names[which]}: "
    share = 100 * covered.mean()
    prepare(axes, view, f"{name}{int(covered.sum()):,} of {m * n:,} knot cells hold data ({share:.3g} %)")
    colours = matplotlib.colors.ListedColormap([UNCOVERED, COVERED])
    draw_image(axes, view, covered.astype(float), colours, 0, 1)
    entries = [Patch(fc=COVERED, ec="0.7", label="holds data")]
    if s.trim is not None:
        cover, cut, high_u, high_v = s.cells()
        cells = np.argwhere(cut)
        corner = cells + np.stack([high_u[cut], high_v[cut]], axis=1).astype(int)
        ends = (2 * cells + 1 - corner)  # the corner opposite to the covered one
        others = [np.stack([ends[:, 0], corner[:, 1]], 1), np.stack([corner[:, 0], ends[:, 1]], 1)]
        triangles = np.stack([corner, *others], 1)
        if len(triangles):
            x, y = view.place(triangles[..., 0], triangles[..., 1])
            axes.add_collection(PolyCollection(np.stack([x, y], axis=-1), facecolors="#8ec1e0", edgecolors="none"))
            entries.append(Patch(fc="#8ec1e0", label="cut: inside the outline"))
    if max(m, n) <= CELL_LINES:
        for axis, count in ((0, m), (1, n)):
            for k in range(count + 1):
                u, v = ([k, k], [0, n]) if axis == 0 else ([0, m], [k, k])
                axes.plot(*view.place(np.array(u), np.array(v)), color="white", lw=0.6, zorder=1)
    legend(axes, entries + draw_marks(axes, view, which), "no data: nothing is claimed")
