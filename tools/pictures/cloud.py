"""Points as they stream by: every one counts in the numbers, a part of them is kept for drawing."""
import numpy as np

KEPT = 1500000       # points kept for drawing: 48 bytes each
CHUNK = 1 << 18
TILES = 256          # of the gap map, along its longer side
COARSEST = 16
STEP = 64             # tiles come in multiples of it, so that they can be joined
SUPPORTS = 128       # along each side of the frame: places whose nearest point is always kept


def chunks(stream):
    """Arrays of points from doubles in this machine's order."""
    while True:
        data = stream.read(24 * CHUNK)
        if not data:
            return
        yield np.frombuffer(data[:len(data) // 24 * 24], float).reshape(-1, 3)


class Gaps:
    """The distances of one surface to the points on its safe side, and where they are large."""

    def __init__(self, surface, tiles):
        self.surface, self.sign = surface, 1.0 if surface.side == "above" else -1.0
        self.total, self.count, self.wrong = 0.0, 0, 0
        self.most, self.worst = -np.inf, None   # the largest gap, and (u, v, z) of its point
        self.sums, self.counts = np.zeros(tiles), np.zeros(tiles, int)
        # Touching points are off by a rounding of double; `canopy check` is exact, a picture need not be.
        self.doubt = 1e-9 * max(np.abs(surface.b).max() * surface.lsb * surface.unit, abs(surface.base), 1e-300)

    def take(self, u, v, z, tile):
        gap = self.sign * (self.surface.height(u, v) - z)
        if not len(gap):
            return gap
        self.total += float(gap.sum())
        self.count += len(gap)
        self.wrong += int((gap < -self.doubt).sum())
        k = int(np.argmax(gap))
        if gap[k] > self.most:
            self.most, self.worst = float(gap[k]), (float(u[k]), float(v[k]), float(z[k]))
        self.sums += np.bincount(tile, gap, self.sums.size).reshape(self.sums.shape)
        self.counts += np.bincount(tile, minlength=self.sums.size).reshape(self.sums.shape)
        return gap

    @property
    def mean(self):
        return self.total / self.count if self.count else float("nan")

    def map(self):
        """Mean gap in each tile, nan without points: as fine as the points fill it."""
        sums, counts = self.sums, self.counts
        while max(sums.shape) > COARSEST and sparse(counts):
            sums, counts = halved(sums), halved(counts)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(counts > 0, sums / counts, np.nan)


def halved(tiles):
    m, n = (size // 2 for size in tiles.shape)
    return tiles.reshape(m, 2, n, 2).sum((1, 3))


def sparse(counts):
    """Tiles in the midst of points have none, or there is no midst: blocks of 4 x 4 with points all around them."""
    blocks = np.pad(halved(halved(counts)) > 0, 1, constant_values=True)
    m, n = blocks.shape[0] - 2, blocks.shape[1] - 2
    midst = np.all([blocks[i:i + m, j:j + n] for i in range(3) for j in range(3)], axis=0)
    inner = np.repeat(np.repeat(midst, 4, 0), 4, 1)
    return midst.sum() < 0.25 * blocks[1:-1, 1:-1].sum() or (counts[inner] == 0).mean() > 0.08


class Cloud:
    """Points of a stream over the frame that all the surfaces have."""

    def __init__(self, name, surfaces, stream):
        self.name, self.frame = name, surfaces[0]
        self.count = self.outside = 0
        self.low, self.high = np.inf, -np.inf
        lengths = np.array([self.frame.size[a] - 1 for a in (0, 1)]) * self.frame.pitch
        shape = [max(round(TILES * side / lengths.max() / STEP), 1) * STEP for side in lengths]
        self.gaps = [Gaps(s, shape) for s in surfaces]
        self.share, self.random, self.kept = 1.0, np.random.default_rng(1), []
        self.supports = [{} for _ in surfaces]
        for points in chunks(stream):
            self.take(points)
        extra = [np.array(list(s.values())).reshape(-1, 4)[:, :3] for s in self.supports] if self.share < 1 else []
        self.u, self.v, self.z = np.concatenate([*self.kept, *extra] or [np.empty((0, 3))]).T

    @property
    def span(self):
        return self.high - self.low

    def take(self, points):
        u, v, z = self.frame.knots(points)
        self.count += len(z)
        self.low, self.high = min(self.low, float(z.min())), max(self.high, float(z.max()))
        m, n = self.frame.size
        inside = (u >= -1e-9) & (u <= m - 1 + 1e-9) & (v >= -1e-9) & (v <= n - 1 + 1e-9)
        self.outside += int((~inside).sum())
        u, v, z = (np.asarray(c)[inside] for c in (u, v, z))
        for g, supports in zip(self.gaps, self.supports):
            gap = g.take(u, v, z, self.place(u, v, g.sums.shape))
            self.support(supports, gap, u, v, z)
        self.keep(np.stack([u, v, z], axis=1))

    def place(self, u, v, shape):
        """The tile of each point, counted through."""
        m, n = self.frame.size
        i = np.clip((u / (m - 1) * shape[0]).astype(int), 0, shape[0] - 1)
        j = np.clip((v / (n - 1) * shape[1]).astype(int), 0, shape[1] - 1)
        return i * shape[1] + j

    def support(self, supports, gap, u, v, z):
        """The nearest point below each place of a surface, so that thinning does not draw a surface that hangs free."""
        place = self.place(u, v, (SUPPORTS, SUPPORTS))
        order = np.lexsort((gap, place))
        first = order[np.concatenate([[True], np.diff(place[order]) > 0])] if len(order) else order
        for k in first:
            if place[k] not in supports or gap[k] < supports[place[k]][3]:
                supports[place[k]] = (u[k], v[k], z[k], gap[k])

    def keep(self, points):
        self.kept.append(points if self.share == 1 else points[self.random.random(len(points)) < self.share])
        while sum(map(len, self.kept)) > KEPT:
            self.kept = [p[self.random.random(len(p)) < 0.5] for p in self.kept]
            self.share /= 2

    def sample(self, most, where=slice(None)):
        """At most so many of the kept points, evenly drawn: (u, v, z)."""
        chosen = np.stack([self.u, self.v, self.z], axis=1)[where]
        if len(chosen) > most:
            chosen = chosen[np.random.default_rng(2).choice(len(chosen), most, replace=False)]
        return chosen.T
