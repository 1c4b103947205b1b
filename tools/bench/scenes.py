"""The scenes that everything is measured on: float32 triples, the same for all."""

import glob
from fractions import Fraction
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
SCANS = ROOT.parent / "shared" / "data"  # range scans that may not be there
TERRAIN = ["/usr/share/matplotlib/mpl-data/sample_data/jacksboro_fault_dem.npz",
           "/usr/lib/python3/dist-packages/matplotlib/mpl-data/sample_data/jacksboro_fault_dem.npz"]


class Scene:
    """Points, and the same normalised: u, v over the bounding box in [0, n-1], z in [0, 1]; grids are n x n. For the side
    below z is mirrored: what is above everything is wanted of everyone."""

    def __init__(self, name, points, grid=20, side="above"):
        self.name, self.grid, self.side = name, grid, side
        self.points = np.ascontiguousarray(points, dtype=np.float32)
        self.box = self.points.min(0).astype(float), self.points.max(0).astype(float)
        low, high = self.box
        span = np.where(high > low, high - low, 1.0)
        scaled = (self.points.astype(float) - low) / span
        self.u, self.v = (np.ascontiguousarray(scaled[:, a] * (grid - 1)) for a in (0, 1))
        self.z = np.ascontiguousarray(scaled[:, 2] if side == "above" else 1 - scaled[:, 2])

    def exact(self, index):
        """(u, v, z) of one point, normalised without a rounding."""
        low, high = ([Fraction(float(x)) for x in corner] for corner in self.box)
        at = [Fraction(float(x)) for x in self.points[index]]
        scaled = [(a - l) / (h - l) if h > l else Fraction(0) for a, l, h in zip(at, low, high)]
        height = scaled[2] if self.side == "above" else 1 - scaled[2]
        return scaled[0] * (self.grid - 1), scaled[1] * (self.grid - 1), height

    def below(self):
        return Scene(self.name, self.points, self.grid, "below")

    def write(self, path):
        """As a binary PLY, which holds a float32 as it is."""
        header = ("ply\nformat binary_little_endian 1.0\n"
                  f"element vertex {len(self.points)}\n"
                  "property float x\nproperty float y\nproperty float z\nend_header\n")
        with open(path, "wb") as file:
            file.write(header.encode())
            file.write(self.points.astype("<f4").tobytes())


def spheres(count, seed=1):
    """Scattered on two spheres, one higher than the other, with 1 % of radial noise: every side of them."""
    random = np.random.Generator(np.random.PCG64(seed))
    ray = random.standard_normal((count, 3))
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    ray *= 1 + 0.01 * random.standard_normal((count, 1))
    second = random.random(count) < 0.5
    return ray + np.outer(second, [1.6, 0.9, 0.7])


def moving(count, seed):
    """Two spherical clouds somewhere beside each other, as tools/bench/moving.h draws them, from another stream."""
    random = np.random.Generator(np.random.PCG64(seed))
    points = random.standard_normal((count, 3))
    points *= (1 + 0.01 * random.standard_normal((count, 1))) / np.linalg.norm(points, axis=1)[:, None]
    second = np.arange(count) >= int(count * random.uniform(0.3, 0.7))
    radius, centre = random.uniform(0.6, 1.4, 2), random.uniform(-2, 2, 3)
    return points * np.where(second, radius[1], radius[0])[:, None] + np.outer(second, centre)


def terrain():
    """The demo's elevation model (tools/terrain.py): x = 30 column, y = 30 row, z in metres. None if it is not there."""
    found = [path for place in TERRAIN for path in glob.glob(place)]
    if not found:
        return None
    height = np.load(found[0])["elevation"]
    y, x = np.mgrid[:height.shape[0], :height.shape[1]]
    return np.column_stack([30 * x.ravel(), 30 * y.ravel(), height.ravel()])


def scan(name):
    path = SCANS / f"{name}.xyz"
    return np.loadtxt(path, usecols=(0, 1, 2)) if path.exists() else None


def all_scenes():
    """The scenes for the comparison with peers that are there on this machine."""
    found = [("bun000", scan("bun000")), ("chin", scan("chin")), ("terrain", terrain()), ("spheres", spheres(30000))]
    return [Scene(name, points) for name, points in found if points is not None]
