"""What all panels share: colours, numbers that a person can read, the view of a picture."""
import math

import numpy as np

# Colours that the colour-blind tell apart (M. Okabe, K. Ito, 2008); maps are viridis, cividis and PuOr for that too
SURFACES = ("#0072b2", "#009e73")
POINT, LINE, WINDOW, WORST = "#d55e00", "#000000", "#cc79a7", "#d55e00"
UNCOVERED, COVERED = "#e5e5e5", "#cfe3f1"
ALIKE = 1000      # axes whose lengths differ more have no common unit
MINUS = "\N{MINUS SIGN}"
EXPONENT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(x):
    """Four digits at most, without an exponent where that reads well."""
    if math.isfinite(x) and x != 0 and not 1e-4 <= abs(x) < 1e6:
        mantissa, power = f"{x:.3e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".")
        return f"{mantissa}·10{str(int(power)).translate(EXPONENT)}".replace("-", MINUS)
    return f"{x:.4g}".replace("-", MINUS) if abs(x) < 1e4 else f"{x:,.0f}".replace("-", MINUS)


def plain(text):
    """A name as it is, for matplotlib, which takes $ for mathematics; long ones lose their middle."""
    text = "".join(c if c.isprintable() else "?" for c in text.encode("utf-8", "replace").decode())
    text = text if len(text) <= 48 else f"{text[:22]}…{text[-22:]}"
    return text.replace("$", r"\$")


class Ticks:
    """Numbers of one axis, near zero and of a size that a tick can show: what is taken off and out stands in the label.

    `size`: how long the axis is, where another has to share its factor."""

    def __init__(self, low, high, size=None):
        size = max(high - low if size is None else size, 1e-12 * max(abs(low), abs(high)), 1e-300)
        self.size = size
        step = 10.0 ** (math.floor(math.log10(size)) + 1)
        self.offset = 0.0
        if max(abs(low), abs(high)) > 200 * size:
            self.offset = float(np.floor(low / step) * step)
        power = 3 * math.floor(math.log10(size) / 3)
        self.power = power if power < -3 or power > 3 else 0
        self.factor = 10.0 ** self.power

    def __call__(self, values):
        return (np.asarray(values, float) - self.offset) / self.factor

    def text(self, value):
        """A place on the axis, to a thousandth of its length, as it is in the file."""
        if self.offset == 0 or self.power < 0:
            return number(value)
        digits = min(max(3 - math.floor(math.log10(self.size)), 0), 9)
        return f"{value:,.{digits}f}".replace("-", MINUS)

    @property
    def unit(self):
        return "input units" if self.power == 0 else f"10{str(self.power).translate(EXPONENT)} input units"

    def label(self, name):
        if self.offset == 0:
            return f"{name} ({self.unit})"
        sign = MINUS if self.offset > 0 else "+"
        return f"{name} {sign} {abs(self.offset):,.10g} ({self.unit})"


class View:
    """The surfaces, the points, and the ticks that all panels have in common."""

    def __init__(self, surfaces, names, cloud, line):
        self.surfaces, self.names, self.cloud = surfaces, [plain(n) for n in names], cloud
        self.frame = s = surfaces[0]
        self.sandwich = len(surfaces) == 2 and surfaces[0].side != surfaces[1].side
        self.comparison = len(surfaces) == 2 and not self.sandwich
        ends = [s.along(a, [0, s.size[a] - 1]) for a in (0, 1)]
        sizes = [float(np.ptp(e)) for e in ends]
        alike = max(sizes) < ALIKE * min(sizes)
        self.axes = [Ticks(float(e[0]), float(e[1]), max(sizes) if alike else size) for e, size in zip(ends, sizes)]
        self.ends = [ticks(e) for ticks, e in zip(self.axes, ends)]
        self.lattice = [Lattice(s) for s in surfaces]
        low, high = self.heights()
        self.height = Ticks(low, high)
        self.low, self.high = (float(self.height(z)) for z in (low, high))
        self.worst = self.find_worst()
        self.chosen = line is not None
        self.line = line if self.chosen else self.find_line()

    def heights(self):
        """The range of what is of interest, with a margin: beside the points a surface may be anywhere."""
        if self.cloud is not None:
            known = [self.cloud.low, self.cloud.high]
            known += [g.worst[2] + g.sign * g.most for g in self.cloud.gaps if g.worst]
        else:
            known = np.concatenate([x.z[np.isfinite(x.z)] for x in self.lattice])
        low, high = (float(np.min(known)), float(np.max(known))) if len(known) else (self.frame.base, self.frame.base)
        size = max(float(np.ptp(self.frame.along(a, [0, self.frame.size[a] - 1]))) for a in (0, 1))
        margin = 0.15 * (high - low) or 0.05 * size or 0.5
        return low - margin, high + margin

    def find_worst(self):
        """(u, v) in knots of the largest gap, thickness or change; None for a surface alone."""
        if self.cloud is not None and not self.sandwich:
            gaps = max(self.cloud.gaps, key=lambda g: g.most)
            return gaps.worst and gaps.worst[:2]
        if len(self.surfaces) == 2:
            apart = np.abs(self.lattice[1].z - self.lattice[0].z)
            if self.cloud is not None and self.cloud.gaps[0].count:
                apart = np.where(self.has_points(self.lattice[0]), apart, np.nan)
            if np.isfinite(apart).any():
                k = np.unravel_index(np.nanargmax(apart), apart.shape)
                return float(self.lattice[0].u[k]), float(self.lattice[0].v[k])
        return None

    def has_points(self, lattice):
        """Where a surface is held by points; in between and beyond it may flare."""
        tiles = np.isfinite(self.cloud.gaps[0].map())
        i, j = (np.minimum((k / (size - 1) * count).astype(int), count - 1)
                for k, size, count in zip((lattice.u, lattice.v), self.frame.size, tiles.shape))
        return tiles[i, j]

    def find_line(self):
        """Along the longer side of the frame, through the worst place or where most is covered."""
        s = self.frame
        m, n = s.size[0] - 1.0, s.size[1] - 1.0
        long = 0 if m * s.pitch[0] >= n * s.pitch[1] else 1
        if self.worst:
            at = self.worst[1 - long]
        else:
            covered = np.isfinite(self.lattice[0].z).sum(axis=long)
            middle = np.abs(np.arange(len(covered)) - (len(covered) - 1) / 2)
            best = np.lexsort((middle, -covered))[0]
            at = best / (len(covered) - 1) * (n if long == 0 else m)
        return (0.0, at, m, at) if long == 0 else (at, 0.0, at, n)

    def place(self, u, v):
        return self.axes[0](self.frame.along(0, u)), self.axes[1](self.frame.along(1, v))

    def names_of_axes(self, short=False):
        names = [self.frame.axis_name(a) for a in (0, 1, 2)]
        if short:
            names = [name.split(" along ")[0] for name in names]
        return [ticks.label(name) for ticks, name in zip((*self.axes, self.height), names)]

    def percent(self, gap):
        """Of the points' height range; None where that is nothing."""
        return 100 * gap / self.cloud.span if self.cloud is not None and self.cloud.span > 0 else None


class Lattice:
    """A surface at evenly spread knots, nan where it is not covered."""

    def __init__(self, surface, steps=129):
        m, n = surface.size
        self.u, self.v = np.meshgrid(np.linspace(0, m - 1, steps), np.linspace(0, n - 1, steps), indexing="ij")
        self.z = np.where(surface.covered(self.u, self.v), surface.height(self.u, self.v), np.nan)
