"""canopy ray as a user meets it, against a reference that shares nothing with it: the surface from the file's numbers,
looked at in many places along each ray."""

import json
import math
import random

import numpy as np
import pytest

from test_cli import canopy, fit, hills, refused, write_points


class Surface:
    """The surface of a file, in double, from the definition of the format."""

    def __init__(self, path):
        self.file = json.loads(path.read_text())
        frame = self.file["frame"]
        self.axes, self.origin, self.pitch = (np.array(frame[key]) for key in ("axes", "origin", "pitch"))
        self.b = np.pad(np.array(self.file["coefficients"], float) * self.file["lsb"], 1, mode="edge")
        self.size = np.array(self.file["size"])
        self.up = 1 if self.file["side"] == "above" else -1

    def place(self, points):
        """u, v in knots and the height, of points in input units."""
        q = (np.asarray(points) / self.file["unit"] - self.origin) @ self.axes.T
        return q[..., 0] / self.pitch[0], q[..., 1] / self.pitch[1], q[..., 2]

    @staticmethod
    def basis(s):
        r = 1 - s
        return np.stack([r**3, 3 * s**3 - 6 * s**2 + 4, 3 * r**3 - 6 * r**2 + 4, s**3]) / 6

    def height(self, u, v):
        i = np.clip(np.floor(u).astype(int), 0, self.size[0] - 2)
        j = np.clip(np.floor(v).astype(int), 0, self.size[1] - 2)
        wu, wv = self.basis(u - i), self.basis(v - j)
        base = sum(wu[a] * wv[c] * self.b[i + a, j + c] for a in range(4) for c in range(4))
        return base + sum(self.refinement(window, u, v) for window in self.file.get("windows", []))

    def refinement(self, window, u, v):
        """What a window adds: the same spline on its own knots, with nothing outside."""
        fine = 2 ** window["level"]
        d = np.pad(np.array(window["coefficients"], float) * self.file["lsb"], 4)
        x, y = fine * u - window["first"][0] + 4, fine * v - window["first"][1] + 4
        i, j = np.floor(x).astype(int), np.floor(y).astype(int)
        near = (i >= 1) & (i + 2 < d.shape[0]) & (j >= 1) & (j + 2 < d.shape[1])
        i, j = np.where(near, i, 1), np.where(near, j, 1)
        wu, wv = self.basis(x - i), self.basis(y - j)
        sums = sum(wu[a] * wv[c] * d[i + a - 1, j + c - 1] for a in range(4) for c in range(4))
        return np.where(near, sums, 0.0)

    def is_exact(self, u, v):
        """A refined surface is asked as one fine grid, which may stand off in the outermost intervals."""
        return "windows" not in self.file or np.all((np.array([u, v]) >= 1) & (np.array([u, v]) <= self.size - 2))

    def clearance(self, points):
        """Of points on the free side: positive; nan outside the frame."""
        u, v, height = self.place(points)
        inside = (u >= 0) & (v >= 0) & (u <= self.size[0] - 1) & (v <= self.size[1] - 1)
        gap = self.up * (height - self.height(np.clip(u, 0, self.size[0] - 1), np.clip(v, 0, self.size[1] - 1)))
        return np.where(inside, gap, np.nan)

    def range(self):
        return self.b.max() - self.b.min()


def rays_over(surface, count, seed):
    """From around and above (or below) towards the frame, some along the axes."""
    draw = random.Random(seed)
    wide = (surface.size - 1) * surface.pitch
    high = surface.range()
    for k in range(count):
        def at(low, top, z):
            q = np.array([draw.uniform(low, top) * wide[0], draw.uniform(low, top) * wide[1],
                          (surface.b.min() if surface.up < 0 else surface.b.max()) + surface.up * z * high])
            return (q @ surface.axes + surface.origin) * surface.file["unit"]
        start, target = at(-0.5, 1.5, draw.uniform(-0.2, 2)), at(0, 1, draw.uniform(-1, 0.3))
        direction = target - start
        if k % 7 == 0:
            direction = -surface.up * surface.axes[2]
        yield [float(x) for x in start], [float(x) for x in direction * draw.choice([1, 0.001, 37])]


def ask(tmp_path, surrogate, rays, *options):
    path = tmp_path / "rays.txt"
    path.write_text("# rays\n\n" + "".join(" ".join(map(repr, a + b)) + "  # one\n" for a, b in rays))
    done = canopy("ray", surrogate, path, *options)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert len(lines) == len(rays) and all(len(line) == 13 for line in lines)
    return lines


def judge(surface, start, direction, line, last):
    """Free up to the hit, or to t = last; little is left at the hit."""
    start, direction = np.array(start), np.array(direction)
    hit = line[1] != "nan"
    until = float(line[1]) if hit else last
    t = np.linspace(0, until, 4001)[:-1]
    gaps = surface.clearance(start + t[:, None] * direction)
    slack = 1e-9 * (surface.range() + np.abs(surface.place(start)[2]))
    assert not np.any(gaps < -slack), (line, np.nanmin(gaps))
    if not hit:
        assert line[2:] == ["nan"] * 6 + ["-", "-", "nan", "nan", "-"]
        return
    point, normal = np.array(line[2:5], float), np.array(line[5:8], float)
    assert np.allclose(point, start + until * direction, rtol=0, atol=1e-9 * np.abs(point).max())
    u, v, height = surface.place(point)
    i, j, s, r = int(line[8]), int(line[9]), float(line[10]), float(line[11])
    assert abs(i + s - u) < 1e-6 and abs(j + r - v) < 1e-6
    assert line[12] == str(surface.file["trim"][i][j])
    if line[0] == "hit":
        u, v = np.clip(u, 0, surface.size[0] - 1), np.clip(v, 0, surface.size[1] - 1)
        gap = surface.up * (height - surface.height(u, v))
        along = np.abs(surface.axes[2] @ direction) / surface.file["unit"]
        assert -slack < gap, (line, gap)
        assert not surface.is_exact(u, v) or gap < 1e-6 * (surface.range() + along * until), (line, gap)
    assert abs(np.linalg.norm(normal) - 1) < 1e-6
    step = 1e-4  # the normal is orthogonal to the surface's own directions, and points to the free side
    for du, dv in ((step, 0), (0, step)):
        rise = (surface.height(u + du, v + dv) - surface.height(u - du, v - dv)) / 2
        tangent = (np.array([du * surface.pitch[0], dv * surface.pitch[1], rise])) @ surface.axes
        assert not surface.is_exact(u, v) or abs(tangent @ normal) < 1e-3 * np.linalg.norm(tangent)
    assert surface.up * (surface.axes[2] @ normal) > 0


@pytest.mark.parametrize("options", [(), ("--side", "below"), ("--scalar", "fx"), ("--scalar", "fx", "--side", "below"),
                                     ("--dir", "1,2,3"), ("--dir=-1,0,0", "--side", "below"),
                                     ("--refine", "1:5x6"), ("--refine", "1:6x5@2", "--side", "below")])
def test_rays_hit_where_the_surface_is(tmp_path, options):
    points = write_points(tmp_path / "scene.xyz", hills(800, seed=4, scale=10, offset=(500, -30, 8)))
    out, _ = fit(tmp_path, points, *options)
    surface = Surface(out)
    rays = list(rays_over(surface, 120, 7))
    lines = ask(tmp_path, out, rays)
    words = {line[0] for line in lines}
    assert "hit" in words and "miss" in words and words <= {"hit", "miss", "beside", "starts-under", "enters-under"}
    for (start, direction), line in zip(rays, lines):
        far = 4 * np.abs((surface.size - 1) @ surface.pitch + surface.range()) * surface.file["unit"]
        judge(surface, start, direction, line, far / np.linalg.norm(direction))


@pytest.mark.parametrize("side", ["above", "below"])
def test_segments_are_free_or_not(tmp_path, side):
    points = write_points(tmp_path / "scene.xyz", hills(800, seed=5))
    out, _ = fit(tmp_path, points, "--side", side)
    surface = Surface(out)
    rays = [(a, [x + 0.9 * y for x, y in zip(a, b)]) for a, b in rays_over(surface, 120, 8)]
    lines = ask(tmp_path, out, rays, "--occluded")
    assert {line[0] for line in lines} <= {"hit", "free", "starts-under", "enters-under"}
    for (start, end), line in zip(rays, lines):
        judge(surface, start, [y - x for x, y in zip(start, end)], line, 1.0)


def test_one_ray_on_the_command_line(tmp_path):
    points = write_points(tmp_path / "scene.xyz", hills(800))
    out, _ = fit(tmp_path, points)
    above = canopy("ray", out, "--from", "1,1,50", "--dir", "0,0,-1").stdout.split()
    (tmp_path / "one.xyz").write_text("1 1 0\n")
    height = float(canopy("eval", out, tmp_path / "one.xyz").stdout)
    assert above[0] == "hit" and abs(float(above[4]) - height) < 1e-6 and float(above[1]) == pytest.approx(50 - height)
    through = canopy("ray", out, "--from", "1,1,50", "--to", "1,1,25").stdout.split()
    assert through[0] == "hit" and float(through[1]) == pytest.approx((50 - height) / 25)
    assert canopy("ray", out, "--from", "1,1,50", "--to", "1,1,25", "--occluded").stdout.split()[0] == "free"
    assert canopy("ray", out, "--from", "1,1,50", "--to", "1,1,-9", "--occluded").stdout.split()[0] == "hit"
    assert canopy("ray", out, "--from", "1,1,-9", "--dir", "0,0,1").stdout.split()[:2] == ["starts-under", "0"]
    assert canopy("ray", out, "--from=-9,1,-9", "--dir", "1,0,0").stdout.split()[0] == "enters-under"
    assert canopy("ray", out, "--from=-9,1,50", "--dir", "1,0,0").stdout.split()[0] == "miss"
    assert canopy("ray", out, "--from=-9,1,50", "--dir=-1,0,0").stdout.split()[0] == "beside"
    assert canopy("ray", out, "--from=1e300,1,50", "--dir=-1,0,0").stdout.split()[0] == "too-far"
    piped = canopy("ray", out, "-", stdin="1;1;50;0;0;-1\n1,1,50, 0,0,-1\n").stdout.splitlines()
    assert [line.split() for line in piped] == [above, above]


def test_bad_rays(tmp_path):
    points = write_points(tmp_path / "scene.xyz", hills(100))
    out, _ = fit(tmp_path, points, grid="4x4")
    rays = tmp_path / "rays.txt"
    for text, *words in [("1 2 3 4 5\n", ":1:", "column 6", "missing"), ("0 0 9 0 0 -1\n1 2 3 4 5 6 7\n", ":2:", "'7'"),
                         ("1 2 x 4 5 6\n", ":1:", "column 3"), ("1 2 nan 4 5 6\n", ":1:", "column 3"),
                         ("\n1 2 3 0 0 0\n", ":2:", "direction"), ("# none\n", "no rays"),
                         ("1 2 3 4 5 6x\n", ":1:", "'x'")]:
        rays.write_text(text)
        refused(canopy("ray", out, rays), "rays.txt", *words)
    refused(canopy("ray", out, "--from", "1,2", "--dir", "0,0,1"), "--from 1,2")
    refused(canopy("ray", out, "--from", "1,2,3", "--dir", "0,0,0"), "direction")
    refused(canopy("ray", out, tmp_path / "none.txt"), "none.txt")
    refused(canopy("ray", tmp_path / "none.json", rays), "none.json")
    for arguments in [(), (out,), (out, rays, "--from", "1,2,3"), (out, "--from", "1,2,3"), (out, "--dir", "1,2,3"),
                      (out, "--from", "1,2,3", "--dir", "0,0,1", "--occluded"), (out, rays, rays),
                      (out, "--from", "1,2,3", "--dir", "0,0,1", "--to", "1,1,1")]:
        assert canopy("ray", *arguments).returncode == 64, arguments
    assert math.isfinite(len(canopy("ray", "--help").stdout)) and "starts-under" in canopy("ray", "--help").stdout
