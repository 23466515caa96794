#!/usr/bin/env python
"""Makes seismic volumes with known faults, and judges the faults that a detector finds in them.

    scripts/fault_trials.py make SEED SIGNAL_TO_NOISE FOLDER [KIND]
    scripts/fault_trials.py judge FOLDER POINTS.npy...

A volume has layers of random reflectivity, folded and then displaced by three to five faults, planar or
listric, that dip by 45 to 85 degrees and throw the layers by 2 to 20 samples; younger faults displace
older ones. KIND is "faults" (the default), or one of the volumes without faults: "folds", "noise",
"footprint". `make` writes `image.f32` (128 x 128 x 128 samples, the vertical axis fastest) and
`truth.npz`. POINTS.npy has one row for each point: x, y, z in samples, vertical first.

Needs NumPy and SciPy. The generator shares no code and no assumption with `atomesh synth`.
"""
import json
import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.spatial import cKDTree

SIZE = 128
# Period of the wavelet's peak frequency, in samples.
WAVELENGTH = 14.0
# Throw (samples) from which a fault must be found, and from which a point on it is right.
MIN_THROW = 1.5
MIN_TRUE_THROW = 0.5
# Distance (samples) within which a point and a fault match.
TOLERANCE = 1.5


class Fault:
    """A fault surface u = u(v, z), with u across the strike, v along it and z downwards."""

    def __init__(self, rng):
        self.centre = rng.uniform(0.2, 0.8, 2) * SIZE
        strike = rng.uniform(0, 2 * np.pi)
        self.across = np.array([np.cos(strike), np.sin(strike)])
        self.dip = rng.uniform(45, 85)
        # A listric fault loses this many degrees of dip over the volume's height.
        self.loss = rng.uniform(10, 25) if rng.random() < 0.4 and self.dip > 58 else 0.0
        self.bend = rng.uniform(-4, 4)
        self.bend_period = rng.uniform(100, 220)
        self.bend_phase = rng.uniform(0, 2 * np.pi)
        self.throw = rng.uniform(2, 20) * (1 if rng.random() < 0.75 else -1)
        self.has_tips = rng.random() < 0.5
        self.half_length = rng.uniform(50, 110)
        self.middle_depth = rng.uniform(0.3, 0.7) * SIZE

    def dip_at(self, z):
        return np.radians(np.clip(self.dip + self.loss * (0.5 - z / SIZE), 40, 88))

    def offset(self, z):
        """Returns u of the surface at v = 0: the integral of the cotangent of the dip."""
        grid = np.arange(-80, SIZE + 80, 0.5)
        slope = 1 / np.tan(self.dip_at(grid))
        table = np.concatenate([[0], np.cumsum(0.25 * (slope[1:] + slope[:-1]))])
        table -= np.interp(SIZE / 2, grid, table)
        return np.interp(z, grid, table)

    def coordinates(self, x, y):
        dx, dy = x - self.centre[0], y - self.centre[1]
        u = dx * self.across[0] + dy * self.across[1]
        v = -dx * self.across[1] + dy * self.across[0]
        return u, v

    def excess(self, x, y, z):
        """Returns the approximate distance from the surface, positive in the hanging wall."""
        u, v = self.coordinates(x, y)
        bend = self.bend * np.sin(2 * np.pi * v / self.bend_period + self.bend_phase)
        return (u - self.offset(z) - bend) * np.sin(self.dip_at(z))

    def throw_at(self, x, y, z):
        _, v = self.coordinates(x, y)
        if not self.has_tips:
            return np.full(np.broadcast(x, y, z).shape, self.throw)
        r = (v / self.half_length) ** 2 + ((z - self.middle_depth) / self.half_length) ** 2
        return self.throw * np.clip(1 - r, 0, None) ** 1.5

    def undo(self, x, y, z):
        """Returns where each place lay before the fault moved, and its distance and throw."""
        excess = self.excess(x, y, z)
        throw = self.throw_at(x, y, z)
        moved = excess > 0
        back = np.where(moved, throw, 0.0)
        shift = np.where(moved, self.offset(z) - self.offset(z - back), 0.0)
        return (x - shift * self.across[0], y - shift * self.across[1], z - back), excess, throw


def ricker(period):
    t = np.arange(-3 * period // 2, 3 * period // 2 + 1)
    a = (np.pi * t / period) ** 2
    return (1 - 2 * a) * np.exp(-a)


def layers(rng, x, y, z):
    """Returns the reflectivity of folded layers at depths z."""
    fold = np.zeros(np.broadcast(x, y).shape)
    for _ in range(4):
        direction, period = rng.uniform(0, 2 * np.pi), rng.uniform(70, 260)
        height = rng.uniform(0.5, 1.0) * period / 45
        phase = rng.uniform(0, 2 * np.pi)
        k = 2 * np.pi / period
        fold = fold + height * np.sin(k * (x * np.cos(direction) + y * np.sin(direction)) + phase)
    dip = rng.uniform(-0.1, 0.1, 2)
    depth = z + fold * (0.6 + 0.5 * z / SIZE) + dip[0] * (x - 64) + dip[1] * (y - 64)
    fine = 8
    table = np.zeros((SIZE + 240) * fine)
    at = 0.0
    while at < SIZE + 240:
        # Layers of one to twelve samples, a few of them with a larger contrast.
        contrast = rng.choice([-1, 1]) * rng.uniform(0.3, 1.2) * (1.6 if rng.random() < 0.1 else 1)
        table[min(int(at * fine), len(table) - 1)] += contrast
        at += rng.gamma(2.0, 1.8) + 0.8
    table = gaussian_filter1d(table, 0.6 * fine)
    value = np.interp(depth + 120, np.arange(len(table)) / fine, table)
    # Strength varies along the layers.
    wave = 1 + 0.35 * np.sin(x / rng.uniform(20, 60) + depth / rng.uniform(15, 40) + rng.uniform(0, 6))
    return value * wave


def make(seed, signal_to_noise, kind="faults"):
    """Returns the image, points of the true faults with the number of the fault, and the faults."""
    rng = np.random.default_rng(seed)
    x, y, z = np.meshgrid(*[np.arange(SIZE, dtype=float)] * 3, indexing="ij")
    faults = [Fault(rng) for _ in range(rng.integers(3, 6))] if kind == "faults" else []
    points, numbers, throws = [], [], []
    place = (x, y, z)
    for number, fault in enumerate(faults):
        place, excess, throw = fault.undo(*place)
        on = (np.abs(excess) <= 0.5) & (np.abs(throw) >= MIN_TRUE_THROW)
        points.append(np.argwhere(on))
        numbers.append(np.full(on.sum(), number))
        throws.append(np.abs(throw[on]))
    signal = layers(rng, *place)
    wavelet = ricker(WAVELENGTH)
    signal = np.apply_along_axis(lambda t: np.convolve(t, wavelet, "same"), 2, signal)
    if kind == "noise":
        signal *= 0
    else:
        signal /= signal.std()
    if kind == "footprint":
        # Stripes along inlines, as acquisition leaves them, stronger at the top.
        stripes = np.sin(2 * np.pi * np.arange(SIZE) / 8.0) + 0.5 * rng.normal(size=SIZE)
        signal = signal * (1 + 0.35 * stripes[None, :, None] * np.exp(-z / 80))
    white = gaussian_filter(rng.normal(size=x.shape), (0.4, 0.4, 0.4))
    band = np.apply_along_axis(lambda t: np.convolve(t, wavelet, "same"), 2, rng.normal(size=x.shape))
    noise = white / white.std() + band / band.std()
    noise *= 1 / (signal_to_noise * noise.std())
    image = (signal + noise).astype(np.float32)
    if not points:
        return image, np.zeros((0, 3)), np.zeros(0, int), np.zeros(0), faults
    return image, np.concatenate(points), np.concatenate(numbers), np.concatenate(throws), faults


def judge(truth, found):
    """Returns recall, precision, and for each fault its size, throw, dip and recall.

    `truth` has samples on faults, `found` points as rows (x, y, z). A sample near a fault counts
    once, however many points are near it.
    """
    points, numbers, throws = truth["points"], truth["numbers"], truth["throws"]
    precision = 1.0
    if len(found):
        # The samples of the truth lie up to half a sample off the fault.
        near_truth = cKDTree(points).query(found)[0] <= TOLERANCE + 0.5 if len(points) else np.zeros(1)
        precision = near_truth.mean()
    counts = throws >= MIN_THROW
    points, numbers, throws = points[counts], numbers[counts], throws[counts]
    near = np.zeros(len(points), bool)
    if len(found):
        near = cKDTree(found).query(points)[0] <= TOLERANCE + 1e-6
    faults = []
    for number in np.unique(numbers):
        on = numbers == number
        faults.append(
            (
                int(on.sum()),
                round(float(np.median(throws[on])), 1),
                round(float(truth["dips"][number]), 1),
                round(float(near[on].mean()), 3),
            )
        )
    recall = float(near.mean()) if len(points) else 1.0
    return {"recall": recall, "precision": float(precision), "points": len(found), "faults": faults}


def main():
    command = sys.argv[1]
    if command == "make":
        folder = Path(sys.argv[4])
        folder.mkdir(parents=True, exist_ok=True)
        kind = sys.argv[5] if len(sys.argv) > 5 else "faults"
        image, points, numbers, throws, faults = make(int(sys.argv[2]), float(sys.argv[3]), kind)
        image.tofile(folder / "image.f32")
        # The vertical axis is the fastest, and the first.
        dips = [f.dip for f in faults]
        np.savez(folder / "truth.npz", points=points[:, ::-1], numbers=numbers, throws=throws, dips=dips)
    else:
        truth = np.load(Path(sys.argv[2]) / "truth.npz")
        for path in sys.argv[3:]:
            print(json.dumps(judge(truth, np.load(path))))


if __name__ == "__main__":
    main()
