"""The panel in perspective."""
import matplotlib
import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from pictures.style import COVERED, LINE, POINT, SURFACES

POINTS = 12000  # more hide the surface
EDGES = 1500    # an outline with more is no help: the surface is drawn over the whole frame
FILL = ("Blues", "Greens")
TALL = 0.6      # the box's height, where its longer side is 1


def box(view):
    """The sides of the box that is drawn: to scale unless one is very short."""
    lengths = np.array([float(np.ptp(e)) * ticks.factor for e, ticks in zip(view.ends, view.axes)])
    return np.maximum(lengths / lengths.max(), 0.25)


def shades(z, which, above, view, opaque):
    """Colours of a relief lit from the north-west: darker away from the points."""
    low, high = view.low, view.high
    light = matplotlib.colors.LightSource(azdeg=315, altdeg=50)
    filled = np.where(np.isnan(z), low if above else high, z)
    span = high - low
    steps = box(view) / np.array(z.shape)  # lit as it is drawn
    colours = light.shade(filled, cmap=matplotlib.colormaps[FILL[which] + ("_r" if above else "")], blend_mode="soft",
                          vmin=low - (0.0 if above else 0.6 * span), vmax=high + (0.6 * span if above else 0.0),
                          vert_exag=0.8 * TALL / span, dx=steps[0], dy=steps[1])
    colours[..., 3] = opaque
    return colours


def is_ragged(surface):
    return len(surface.outline()) > EDGES


def draw_outline(axes, view, which):
    """The trim's edges on the surface."""
    s = view.surfaces[which]
    edges = s.outline()
    if not len(edges) or len(edges) > EDGES:
        return
    along = np.linspace(0, 1, 7)[:, None]
    knots = edges[:, None, 0] * (1 - along) + edges[:, None, 1] * along
    x, y = view.place(knots[..., 0], knots[..., 1])
    z = np.clip(view.height(s.height(knots[..., 0], knots[..., 1])), view.low, view.high)
    axes.add_collection3d(Line3DCollection(np.stack([x, y, z], axis=-1), colors=SURFACES[which], linewidths=0.9,
                                           zorder=5))


def draw_surface(axes, view, which, above, opaque, zorder):
    lattice = view.lattice[which]
    s = view.surfaces[which]
    z = view.height(s.height(lattice.u, lattice.v) if is_ragged(s) else lattice.z)
    z = np.where((z >= view.low) & (z <= view.high), z, np.nan)
    x, y = view.place(lattice.u, lattice.v)
    axes.plot_surface(x, y, z, rstride=1, cstride=1, facecolors=shades(z, which, above, view, opaque), linewidth=0,
                      antialiased=False, shade=False, zorder=zorder, rasterized=True)
    draw_outline(axes, view, which)


def draw_points(axes, view):
    """Returns how many."""
    u, v, z = view.cloud.sample(POINTS)
    x, y = view.place(u, v)
    axes.scatter(x, y, view.height(z), s=1.2 if len(z) > 50 else 14, color=POINT, linewidth=0, depthshade=False,
                 zorder=2, rasterized=True)
    return len(z)


def draw_line(axes, view):
    """Where the cross-section is: on the upper surface."""
    t = np.linspace(0, 1, 400)
    u0, v0, u1, v1 = view.line
    u, v = u0 + t * (u1 - u0), v0 + t * (v1 - v0)
    s = view.surfaces[0]
    z = view.height(np.where(s.covered(u, v), s.height(u, v), np.nan))
    x, y = view.place(u, v)
    axes.plot(x, y, np.where((z >= view.low) & (z <= view.high), z, np.nan), color=LINE, lw=1.1, zorder=6)


def draw(axes, view, which=0):
    """One surface with the points, seen from its side; or both of a sandwich, seen from above."""
    above = view.surfaces[which].side == "above"
    drawn = 0
    if view.sandwich:
        draw_surface(axes, view, 1, False, 1.0, 1)
    elif view.cloud is None:
        draw_surface(axes, view, which, above, 1.0, 3)
    if view.cloud is not None:
        drawn = draw_points(axes, view)
    if view.sandwich or view.cloud is not None:
        draw_surface(axes, view, which, above, 0.55, 3)  # the viewer stands on the surface's side
    if which == 0:
        draw_line(axes, view)
    names = view.names_of_axes(short=True)
    axes.set_xlabel(names[0], labelpad=7)
    axes.set_ylabel(names[1], labelpad=7)
    axes.set_zlabel(names[2], labelpad=7)
    axes.set_xlim(*view.ends[0])
    axes.set_ylim(*view.ends[1])
    axes.set_zlim(view.low, view.high)
    axes.set_box_aspect((*box(view), TALL), zoom=0.98)
    axes.view_init(elev=28 if above else -28, azim=-60)
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=8)
    # where no axis has its label
    axes.set_title(caption(view, which, drawn), fontsize=11, y=1.0 if above else -0.08)
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color(matplotlib.colors.to_rgba(COVERED, 0.15))


def caption(view, which, drawn):
    if view.sandwich:
        text = "both surfaces"
    else:
        text = "surface" if not view.comparison else f"surface {'AB'[which]}"
    if view.cloud is not None:
        few = f"{drawn:,} of " if drawn < view.cloud.count else ""
        text += f" and {few}{view.cloud.count:,} point{'s' * (view.cloud.count != 1)}"
    if is_ragged(view.surfaces[which]):
        text += ", also where there is no data"
    return f"{text}, seen from {'above' if view.sandwich else view.surfaces[which].side}"
