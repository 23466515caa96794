"""Compares meshes of label images with those of CGAL (Mesh_3): `make bench-labels DATA=FOLDER`.

    labels.py ATOMESH CGAL_LABELS FOLDER [--data FOLDER] [--only NAME]

Prints a table in Markdown. Images and meshes are written to FOLDER. All figures come from the tetrahedra and the samples,
in the same way for both meshers:

- angles: the smallest and the largest dihedral angle, and the 1 % quantile of the smallest angles of tetrahedra;
- mean distance: of the area between regions from the boundary of the labels, and of the boundary from this area;
- precision: the share of the area between regions that is within half a sample of the boundary of the labels. The
  boundary consists of the squares between neighbouring samples of different labels;
- coverage: the shares of the centres of these squares within half a sample and one sample of a face between regions;
- truth: if labels come from a field and a level, the share of the area within a quarter of a sample of the level set,
  with the distance approximated by value over slope;
- bends: the mean angle between neighbouring faces between regions, which is large if faces follow the steps of samples;
- volume: the largest relative error of the volume of a region of 2000 samples or more;
- lost: the number of connected parts of eight samples or more without a tetrahedron of their label.

CGAL has the same cell size. The distance of its faces to the boundary is chosen such that the number of tetrahedra is the
same to a few percent.
"""

import argparse
import pathlib
import resource
import subprocess

import numpy as np
from scipy import ndimage

from label_judge import (
    bends,
    dihedrals,
    distance_to_squares,
    distance_to_triangles,
    interface,
    normals_and_areas,
    random_points,
    read_vtu,
    squares,
    triangle_locator,
)

DISTANCES = 0.05, 3.0  # range of the bound on the distance of CGAL's faces to the boundary, in samples
COUNT_TOLERANCE = 0.04  # relative difference of the numbers of tetrahedra
MIN_SAMPLES = 2000  # regions with fewer samples are excluded from the comparison of volumes


def blobs():
    """Returns labels and truth of a rock of two phases: the highest fifth of noise smoothed by 3.5 samples are pores."""
    noise = np.random.default_rng(1).standard_normal((96, 96, 96))
    smooth = ndimage.gaussian_filter(noise, 3.5, mode="wrap")
    level = np.quantile(smooth, 0.8)
    return 1 + (smooth > level), (2, smooth - level)


def brain(data):
    """Returns labels and truth of a part of the MNI152 template: 2 where grey matter is more likely than not, 1 where T1 is
    below a quarter of its largest value, else 3."""
    import nibabel

    load = lambda name: np.asarray(nibabel.load(data / "medical" / name).dataobj, float)
    t1, grey = load("mni_icbm152_t1.nii.gz"), load("mni_icbm152_gm.nii.gz")
    labels = np.where(grey > 0.5 * grey.max(), 2, np.where(t1 < 0.25 * t1.max(), 1, 3))
    part = (slice(20, 116), slice(100, 196), slice(50, 146))
    return labels[part].T, (2, grey[part].T - 0.5 * grey.max())


def ketton(data):
    """Returns labels of 128 samples along each axis of Ketton limestone: 1 for grain, 2 for pore."""
    import tifffile

    return 1 + (tifffile.imread(data / "rock/ketton.tif")[:128, :128, :128] > 127), None


def layers(data):
    """Returns labels, from 1 on, of layers that a fault displaces, computed by GemPy."""
    values = np.load(data / "faultmodel3d_9a/lith_block.npy").ravel()[:125000]
    return np.unique(values.round(), return_inverse=True)[1].reshape(50, 50, 50).T + 1, None


def read_medit(path):
    words = path.read_text().split()

    def block(name, width):
        start = words.index(name)
        count = int(words[start + 1])
        return np.array(words[start + 2 : start + 2 + count * width], float).reshape(count, width)

    tets = block("Tetrahedra", 5).astype(int)
    return block("Vertices", 4)[:, :3], tets[:, :4] - 1, tets[:, 4]


def processor_time(command):
    used = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    before = used()
    result = subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True)
    return used() - before, result.stdout


def distance_to_level_set(points, field):
    """Returns the distances of points to the zero level set of a field, approximated by value over slope."""
    interpolate = lambda values: ndimage.map_coordinates(values, points.T[::-1], order=1)
    slope = np.sqrt(sum(interpolate(part) ** 2 for part in np.gradient(field)))
    return np.abs(interpolate(field)) / np.maximum(slope, 1e-12)


def count_lost(labels, points, tets, region):
    """Returns the number of parts without a tetrahedron whose centre is in them or next to them."""
    middles = points[tets].mean(axis=1).round().astype(int)[:, ::-1]
    middles = np.clip(middles, 0, np.array(labels.shape) - 1)
    lost = 0
    for label in np.unique(labels):
        covered = np.zeros(labels.shape, bool)
        covered[tuple(middles[region == label].T)] = True
        covered = ndimage.binary_dilation(covered)
        parts, count = ndimage.label(labels == label)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        found = np.zeros(count + 1, bool)
        found[np.unique(parts[covered])] = True
        lost += int(((sizes >= 8) & ~found[1:]).sum())
    return lost


def figures(labels, truth, points, tets, region):
    """Returns the figures of a mesh."""
    random = np.random.default_rng(2)
    angles = dihedrals(points, tets)
    faces, sides = interface(tets, region)
    middles, axes, _ = squares(labels)
    normals, areas = normals_and_areas(points, faces)
    positions, chosen = random_points(random, points, faces, areas, 30000)
    truth_share = "-"
    if truth:
        label, field = truth
        distances = distance_to_level_set(positions[(sides[chosen] == label).any(axis=1)], field)
        truth_share = f"{100 * (distances <= 0.25).mean():.1f}"
    precision = distance_to_squares(positions, middles, axes)
    targets = middles[random.choice(len(middles), min(len(middles), 20000), replace=False)]
    coverage = distance_to_triangles(targets, triangle_locator(points, faces))
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    volume = np.abs(np.linalg.det(edges)) / 6
    # Half of a sample on a side of the box is inside the box.
    ends = [np.where((np.arange(n) == 0) | (np.arange(n) == n - 1), 0.5, 1.0) for n in labels.shape]
    weight = np.einsum("i,j,k->ijk", *ends)
    errors = []
    for label in np.unique(labels):
        samples = weight[labels == label].sum()
        if samples >= MIN_SAMPLES:
            errors.append(100 * abs(volume[region == label].sum() / samples - 1))
    return {
        "tetrahedra": f"{len(tets):,}",
        "smallest dihedral angle": f"{angles.min():.1f}",
        "1 % of the tetrahedra below": f"{np.quantile(angles.min(axis=0), 0.01):.1f}",
        "largest dihedral angle": f"{angles.max():.1f}",
        "mean distance from faces to the boundary, and back": f"{precision.mean():.3f}, {coverage.mean():.3f}",
        "precision, 1/2 sample, %": f"{100 * (precision <= 0.5).mean():.1f}",
        "coverage, 1/2 and 1 sample, %": f"{100 * (coverage <= 0.5).mean():.1f}, {100 * (coverage <= 1).mean():.1f}",
        "truth, 1/4 sample, %": truth_share,
        "bends, degrees": f"{bends(normals, faces).mean():.1f}",
        "volumes off by at most, %": f"{max(errors):.2f}",
        "the whole box off by, %": f"{100 * abs(volume.sum() / weight.sum() - 1):.2f}",
        "parts lost": str(count_lost(labels, points, tets, region)),
    }


def compare(name, labels, truth, distance, arguments):
    """Meshes an image with both programs and prints the rows of the table."""
    labels = np.ascontiguousarray(labels, np.uint8)
    folder = arguments.folder
    np.save(folder / f"{name}.npy", labels)
    labels.tofile(folder / f"{name}.raw")
    image, ours, theirs = (folder / f"{name}{end}" for end in (".npy", ".vtu", ".mesh"))
    command = [arguments.atomesh, "mesh", image, "-o", ours, "--feature", "labels", "--distance", distance, "--quiet"]
    seconds, _ = processor_time(command)
    mesh = read_vtu(ours)
    low, high = DISTANCES
    for _ in range(9):
        face_distance = (low * high) ** 0.5
        command = [arguments.cgal, folder / f"{name}.raw", *labels.shape[::-1], distance, face_distance, theirs]
        _, stdout = processor_time(command)
        other = read_medit(theirs)
        ratio = len(other[1]) / len(mesh[1])
        if abs(ratio - 1) < COUNT_TOLERANCE:
            break
        low, high = (face_distance, high) if ratio > 1 else (low, face_distance)
    rows = [figures(labels, truth, *mesh), figures(labels, truth, *other)]
    rows[0]["processor time, CGAL's is 1"] = f"{seconds / float(stdout):.2f}"
    rows[1]["processor time, CGAL's is 1"] = f"1 ({float(stdout):.0f} s)"
    print(f"| **{name}** | {'x'.join(map(str, labels.shape[::-1]))}, d = {distance} | size {distance}, distance {face_distance:.2f} |")
    for figure in rows[0]:
        print(f"| {figure} | {rows[0][figure]} | {rows[1][figure]} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("atomesh", "cgal", "folder"):
        parser.add_argument(name, type=pathlib.Path)
    parser.add_argument("--data", type=pathlib.Path)
    parser.add_argument("--only")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    volumes = {"blobs": (blobs, 3)}
    if arguments.data:
        volumes |= {
            "layers": (lambda: layers(arguments.data), 3),
            "Ketton": (lambda: ketton(arguments.data), 4),
            "brain": (lambda: brain(arguments.data), 3),
        }
    print("| | atomesh | CGAL |\n|---|---|---|")
    for name, (make, distance) in volumes.items():
        if arguments.only in (None, name):
            compare(name, *make(), distance, arguments)


if __name__ == "__main__":
    main()
