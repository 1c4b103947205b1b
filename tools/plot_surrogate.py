#!/usr/bin/python3
"""Draws one surrogate file or two, and points: what `canopy plot` runs, whose --help says what there is to see.

Usage: plot_surrogate.py --output FILE --format png|svg|pdf --show PANEL --line U0,V0,U1,V1 --size WxH --points NAME
                         SURROGATE.json [SURROGATE.json]

With a NAME standard input holds the points: x, y, z in input units as doubles in this machine's order. --line is in
knots, empty for the script's own choice; --size 0x0 likewise. The panels are in tools/pictures. Needs Debian's
python3-matplotlib. The surrogates have been validated by whoever calls. Exit status: 0 drawn, 1 not, 3 FILE cannot be
written, 4 matplotlib is missing; the caller says so.
"""
import argparse
import logging
import os
import sys

try:
    import numpy as np
    import matplotlib
    logging.getLogger("matplotlib").setLevel(logging.CRITICAL)
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from pictures import maps, section, space
except ImportError:
    sys.exit(4)

from pictures.cloud import Cloud
from pictures.style import View, number, plain
from pictures.surface import Surrogate

DOTS = 100  # to an inch
SIZES = {"all": (1500, 1080), "surface": (1100, 850), "gap": (1000, 850), "section": (1500, 620), "trim": (1000, 850)}
SETTINGS = {"svg.fonttype": "none", "svg.hashsalt": "canopy", "axes.formatter.useoffset": False,
            "agg.path.chunksize": 10000}


def arguments():
    parser = argparse.ArgumentParser(allow_abbrev=False)
    for name in ("output", "format", "show", "line", "size", "points"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("surrogates", nargs="+")
    a = parser.parse_args()
    a.line = tuple(map(float, a.line.split(","))) if a.line else None
    a.size = tuple(map(int, a.size.split("x")))
    return a


def headline(view):
    """What is drawn; the points and their gaps; what the file says of its proof."""
    s, cloud = view.surfaces[0], view.cloud
    shape = f"{s.size[0]}×{s.size[1]} coefficients, {s.scalar}"
    if view.sandwich:
        lines = [f"sandwich of {view.names[0]} and {view.names[1]}: {shape}"]
    elif view.comparison:
        lines = [f"A {view.names[0]} and B {view.names[1]}: both {s.side} every point, {shape}"]
    else:
        lines = [f"{view.names[0]}: {s.side} every point, {shape}"]
        if s.windows:
            lines[0] += f", {len(s.windows)} window{'s' * (len(s.windows) > 1)}"
    if cloud is not None:
        lines += points_line(view)
    lines += [proof_line(view)]
    return lines


def points_line(view):
    """How many, how near; and a line of what is to be heeded, if anything is."""
    cloud = view.cloud
    name = plain(os.path.basename(cloud.name)) if cloud.name != "-" else "standard input"
    text = f"{name}: {cloud.count:,} point{'s' * (cloud.count != 1)}, height range {number(cloud.span)}"
    if cloud.gaps[0].count and view.comparison:
        share = view.percent(1.0)
        mean, most = (", ".join(f"{letter} {f'{gap * share:.3g} %' if share else number(gap)}" for letter, gap in
                                zip("AB", gaps)) for gaps in zip(*((g.mean, g.most) for g in cloud.gaps)))
        text += f"; mean gap {mean}; at most {most}"
    elif cloud.gaps[0].count:
        text += "".join(f"; gap{f' {g.surface.side}' * view.sandwich} {maps.with_percent(view, g.mean)} in the mean"
                        for g in cloud.gaps)
        text += "" if view.sandwich else f", {maps.with_percent(view, cloud.gaps[0].most)} at most"
    heed = []
    wrong = max(g.wrong for g in cloud.gaps)
    if wrong:
        heed.append(f"{wrong:,} POINT{'S' * (wrong != 1)} ON THE WRONG SIDE (canopy check is exact)")
    if cloud.outside:
        heed.append(f"{cloud.outside:,} point{'s' * (cloud.outside != 1)} outside the frame, not drawn")
    if cloud.share < 1:
        heed.append(f"{len(cloud.z):,} points kept for drawing, the nearest ones among them")
    return [text, "; ".join(heed)] if heed else [text]


def proof_line(view):
    texts = []
    for name, s in zip("AB" if view.comparison else ("above", "below"), view.surfaces):
        c = s.certificate
        text = "the file has no certificate"
        if c:
            points = f"{c['points']:,.0f} point{'s' * (c['points'] != 1)}"
            text = f"proved for {points}, margin {number(c['margin'] * s.unit)}"
        texts.append(text if len(view.surfaces) == 1 else f"{name}: {text}")
    return "; ".join(dict.fromkeys(texts))


def second_map(view):
    """A map for each surface: two that are compared, with points."""
    return view.comparison and view.cloud is not None


def draw_map(axes, view, which=0):
    if view.cloud is not None and not view.sandwich:
        maps.draw_gap(axes, view, which)
    elif len(view.surfaces) == 2:
        maps.draw_pair(axes, view)
    else:
        maps.draw_height(axes, view)


def lay_out(figure, view, show):
    """The panels asked for."""
    if show == "section":
        section.draw(figure.add_subplot(), view)
    elif show == "surface":
        count = 2 if view.comparison else 1
        for k in range(count):
            space.draw(figure.add_subplot(1, count, k + 1, projection="3d", computed_zorder=False), view, k)
    elif show in ("gap", "trim"):
        count = 2 if second_map(view) or (show == "trim" and view.comparison) else 1
        for k in range(count):
            (draw_map if show == "gap" else maps.draw_trim)(figure.add_subplot(1, count, k + 1), view, k)
    else:
        upper, lower = figure.subfigures(2, 1, height_ratios=(1.5, 1))
        left, right = upper.subfigures(1, 2)
        right.patch.set_visible(False)  # the left one's labels may reach beyond it
        if second_map(view):
            draw_map(left.add_subplot(), view, 0)
        else:
            space.draw(left.add_subplot(projection="3d", computed_zorder=False), view)
        draw_map(right.add_subplot(), view, 1 if second_map(view) else 0)
        section.draw(lower.add_subplot(), view)


def figure_of(view, show, size):
    default = SIZES[show]
    if show in ("gap", "surface", "trim") and view.comparison:
        default = (1600, 800)
    width, height = size if all(size) else default
    scale = min(width / default[0], height / default[1], 1.0)  # a smaller picture is the same, smaller
    dots = DOTS * scale
    figure = plt.figure(figsize=(width / dots, height / dots), dpi=dots, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.06)
    lay_out(figure, view, show)
    figure.suptitle("\n".join(headline(view)), fontsize=12)
    return figure


def main():
    a = arguments()
    pairs = [(Surrogate(path), os.path.basename(path)) for path in a.surrogates]
    if len(pairs) == 2 and (pairs[0][0].side, pairs[1][0].side) == ("below", "above"):
        pairs.reverse()
    surfaces, names = [s for s, _ in pairs], [n for _, n in pairs]
    with np.errstate(all="ignore"), matplotlib.rc_context(SETTINGS):
        cloud = Cloud(a.points, surfaces, sys.stdin.buffer) if a.points else None
        figure = figure_of(View(surfaces, names, cloud, a.line), a.show, a.size)
        try:
            dated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
            figure.savefig(a.output, format=a.format, dpi=figure.dpi if a.format == "png" else 2 * DOTS,
                           metadata=dated.get(a.format))
        except OSError:
            sys.exit(3)


if __name__ == "__main__":
    if not sys.flags.dev_mode:  # whoever calls has one line to say; python3 -X dev shows the rest
        sys.excepthook = lambda *_: None
    main()
