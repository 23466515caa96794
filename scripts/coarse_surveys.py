#!/usr/bin/env python3
"""Finds faults in surveys whose lines are far apart, and compares them with the true ones.

    scripts/coarse_surveys.py ATOMESH [--seeds 1,2] [--spacings 25x25,50x50,100x25] [--options "--fault-evidence network"]

Each survey has layers of random reflectivity (wavelength 52 m, 4 m a sample) that are folded and dip by 4 degrees, and
one fault that throws them by 40 m: dip and strike depend on the seed. Signal-to-noise ratios are 4 and 2 in turn. One line for each survey: the share of the fault within two
cells of a point (recall), the share of the points within two cells of the fault (precision), the number of surfaces
that are no faults, and how far strike and dip of the largest surface deviate (degrees; plane through its points).

Needs NumPy and SciPy. The generator shares no code with `atomesh synth`.
"""
import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

WAVELENGTH = 52.0
VERTICAL_STEP = 4.0
THROW = 40.0
# Extent (metres) along inlines, crosslines and depth, and the smallest number of lines.
EXTENT = (1600.0, 1200.0, 400.0)
MIN_LINES = 24
# Distance (cells) within which a point and the fault match.
TOLERANCE = 2.0


class Survey:
    """Amplitudes of layers with a fault through the middle."""

    def __init__(self, seed, spacing):
        rng = np.random.default_rng(seed)
        self.step = np.array([*spacing, VERTICAL_STEP])
        self.dip = (60.0, 45.0, 75.0)[seed % 3]
        self.strike = (20.0 + 55.0 * seed) % 360
        self.signal_to_noise = (4.0, 2.0)[seed % 2]
        counts = [max(MIN_LINES, int(e / s) + 1) for e, s in zip(EXTENT, self.step)]
        self.half = (np.array(counts) - 1) / 2 * self.step
        axes = [np.arange(n) * s - h for n, s, h in zip(counts, self.step, self.half)]
        x, y, z = np.meshgrid(*axes, indexing="ij")
        dip_azimuth = np.radians(self.strike + 90)
        # East and north components of the direction of dip.
        self.across = np.array([np.sin(dip_azimuth), np.cos(dip_azimuth)])
        heave = THROW / np.tan(np.radians(self.dip))
        is_hanging = self.distance(x, y, z) > 0
        east = x - np.where(is_hanging, heave * self.across[0], 0)
        north = y - np.where(is_hanging, heave * self.across[1], 0)
        depth = z - np.where(is_hanging, THROW, 0)
        azimuth = np.radians(60.0)
        depth = depth - np.tan(np.radians(4.0)) * (east * np.sin(azimuth) + north * np.cos(azimuth))
        for _ in range(2):
            direction, k = rng.uniform(0, 2 * np.pi), 2 * np.pi / rng.uniform(1200, 3000)
            phase = k * (east * np.cos(direction) + north * np.sin(direction)) + rng.uniform(0, 6.3)
            depth = depth + 0.05 / k * np.sin(phase)
        table = np.arange(-1500, 1500, 0.5)
        signal = np.interp(depth, table, self.trace(rng, len(table)))
        noise = gaussian_filter(rng.normal(size=signal.shape), 0.6)
        noise *= signal.std() / noise.std() / self.signal_to_noise
        self.amplitudes = (signal + noise).astype(np.float32)

    @staticmethod
    def trace(rng, count):
        reflectivity, at = np.zeros(count), 0
        while True:
            at += int(2 * (rng.exponential(0.3 * WAVELENGTH) + 0.2 * WAVELENGTH))
            if at >= count:
                break
            reflectivity[at] = rng.normal()
        a = (np.pi * np.arange(-3 * WAVELENGTH, 3 * WAVELENGTH + 0.5, 0.5) / WAVELENGTH) ** 2
        return np.convolve(reflectivity, (1 - 2 * a) * np.exp(-a), "same")

    def distance(self, x, y, z):
        """Returns the horizontal distance from the fault, in metres, positive in the hanging wall."""
        return x * self.across[0] + y * self.across[1] - z / np.tan(np.radians(self.dip))

    def fault_places(self):
        """Returns places on the fault, in metres."""
        along = np.arange(-4000, 4000, self.step[:2].min())
        depths = np.arange(-self.half[2], self.half[2] + 1, 3 * VERTICAL_STEP)
        v, z = (a.ravel() for a in np.meshgrid(along, depths))
        u = z / np.tan(np.radians(self.dip))
        x, y = u * self.across[0] - v * self.across[1], u * self.across[1] + v * self.across[0]
        places = np.stack([x, y, z], 1)
        return places[(np.abs(places) <= self.half).all(1)]


def find(program, survey, options):
    """Returns the points that are found, in metres from the middle, z downwards, and the surface of each."""
    with tempfile.TemporaryDirectory() as folder:
        image, points = Path(folder) / "survey.npy", Path(folder) / "points.csv"
        np.save(image, survey.amplitudes)
        spacing = ",".join(str(s) for s in survey.step[::-1])
        command = [program, "feature", image, "-o", Path(folder) / "b.npy", "--points", points, "--feature", "faults"]
        command += ["--spacing", spacing, "--unit", "m", "--axes", "depth,y,x", "--json", *options]
        json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        rows = np.array([line.split(",") for line in points.read_text().splitlines()[1:]], float).reshape(-1, 10)
    return rows[:, :3] * [1, 1, -1] - survey.half, rows[:, 8]


def plane(points, step):
    """Returns strike and dip, in degrees, of the plane through points, with the least distance in cells."""
    cells = (points - points.mean(0)) / step
    normal = np.linalg.eigh(cells.T @ cells)[1][:, 0] / step
    normal /= np.linalg.norm(normal) * (-1 if normal[2] > 0 else 1)
    return (np.degrees(np.arctan2(normal[0], normal[1])) - 90) % 360, np.degrees(np.arccos(abs(normal[2])))


def judge(survey, points, surface):
    """Returns recall, precision, the number of false surfaces, and the deviations of strike and dip."""
    if len(points) == 0:
        return 0.0, 1.0, 0, None, None
    cell = 1 / np.hypot(*(survey.across / survey.step[:2]))
    is_true = np.abs(survey.distance(*points.T)) <= TOLERANCE * cell
    nearest = cKDTree(points / survey.step).query(survey.fault_places() / survey.step)[0]
    groups = [points[surface == s] for s in np.unique(surface)]
    true = [g for g in groups if (np.abs(survey.distance(*g.T)) <= TOLERANCE * cell).mean() > 0.5]
    strike = dip = None
    if true:
        strike, dip = plane(max(true, key=len), survey.step)
        strike, dip = (strike - survey.strike + 90) % 180 - 90, dip - survey.dip
    return (nearest <= TOLERANCE).mean(), is_true.mean(), len(groups) - len(true), strike, dip


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--spacings", default="12.5x12.5,25x12.5,50x12.5,50x50,100x25,100x50,100x100,150x25")
    parser.add_argument("--options", default="")
    args = parser.parse_args()
    print("spacing      seed  strike/dip  recall precision false  d strike  d dip")
    for spacing in args.spacings.split(","):
        for seed in map(int, args.seeds.split(",")):
            survey = Survey(seed, [float(s) for s in spacing.split("x")])
            result = judge(survey, *find(args.program, survey, args.options.split()))
            deviations = ["    -" if d is None else f"{d:+5.1f}" for d in result[3:]]
            place = f"{survey.strike:3.0f}/{survey.dip:.0f}"
            print(f"{spacing:12} {seed:4}  {place:10}  {result[0]:6.2f} {result[1]:9.2f} {result[2]:5}  {'  '.join(deviations)}", flush=True)


if __name__ == "__main__":
    main()
