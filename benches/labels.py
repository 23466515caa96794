"""Our meshes of labelled images beside those of CGAL (Mesh_3): `make bench-labels DATA=FOLDER`.

    labels.py ATOMESH CGAL_LABELS FOLDER [--data FOLDER] [--only NAME]

Prints a table in Markdown. FOLDER takes the images and meshes. What is compared, alike for both meshers, from nothing
but their tetrahedra and the samples:

- angles: the smallest dihedral angle of all, that which 1 % of the tetrahedra stay below, and the largest;
- precision: the share of the area between regions within half a sample of the labels' boundary, which is the squares
  between neighbouring samples of different labels; coverage: the share of these squares' middles within half a
  sample, and within one, of the mesh's faces between regions;
- truth: where labels are a field above a level, the share of the area within a quarter of a sample of where the field
  has that level, by its value over its slope;
- bends: the mean angle between neighbouring faces between regions: large where these follow the stairs of samples;
- volume: by how much that of a region of 2000 samples or more is off that of its samples, the worst;
- lost: connected parts of eight samples or more of which no tetrahedron has the label.

CGAL gets cells as large as ours, and keeps its faces so near to the boundary that it makes as many tetrahedra as we
do, to a few percent.
"""

import argparse
import pathlib
import resource
import subprocess

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import mutable, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkStaticCellLocator
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

DISTANCES = 0.05, 3.0  # CGAL's faces are nearer to the boundary than one between these, in samples
ALIKE = 0.04  # numbers of tetrahedra may differ by so much
FEWEST = 2000  # samples of regions whose volumes are compared


def blobs():
    """Rock of two phases: noise smoothed by 3.5 samples, of which the highest fifth are pores."""
    noise = np.random.default_rng(1).standard_normal((96, 96, 96))
    smooth = ndimage.gaussian_filter(noise, 3.5, mode="wrap")
    level = np.quantile(smooth, 0.8)
    return 1 + (smooth > level), (2, smooth - level)


def brain(data):
    """A part of the MNI152 template: 1 where T1 is below a quarter of its largest value, 2 where grey matter is more
    likely than not, 3 the rest."""
    import nibabel

    load = lambda name: np.asarray(nibabel.load(data / "medical" / name).dataobj, float)
    t1, grey = load("mni_icbm152_t1.nii.gz"), load("mni_icbm152_gm.nii.gz")
    labels = np.where(grey > 0.5 * grey.max(), 2, np.where(t1 < 0.25 * t1.max(), 1, 3))
    part = (slice(20, 116), slice(100, 196), slice(50, 146))
    return labels[part].T, (2, grey[part].T - 0.5 * grey.max())


def ketton(data):
    """128 samples each way of Ketton limestone: 1 grain, 2 pore."""
    import tifffile

    return 1 + (tifffile.imread(data / "rock/ketton.tif")[:128, :128, :128] > 127), None


def layers(data):
    """Layers that a fault offsets, computed by GemPy; named 1 and on."""
    values = np.load(data / "faultmodel3d_9a/lith_block.npy").ravel()[:125000]
    return np.unique(values.round(), return_inverse=True)[1].reshape(50, 50, 50).T + 1, None


def of_vtu(path):
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    tets = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, 4)
    points = vtk_to_numpy(grid.GetPoints().GetData()).astype(float)
    return points, tets, vtk_to_numpy(grid.GetCellData().GetArray("region"))


def of_medit(path):
    words = path.read_text().split()

    def block(name, width):
        at = words.index(name)
        count = int(words[at + 1])
        return np.array(words[at + 2 : at + 2 + count * width], float).reshape(count, width)

    tets = block("Tetrahedra", 5).astype(int)
    return block("Vertices", 4)[:, :3], tets[:, :4] - 1, tets[:, 4]


def processor_time(command):
    used = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    before = used()
    done = subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True)
    return used() - before, done.stdout


def dihedrals(points, tets):
    corners = points[tets]
    normals = []
    for k in range(4):
        a, b, c = (corners[:, i] for i in range(4) if i != k)
        up = np.cross(b - a, c - a)
        up *= np.sign(np.einsum("ij,ij->i", up, corners[:, k] - a))[:, None]
        normals.append(up / np.linalg.norm(up, axis=1)[:, None])
    pairs = [(i, j) for i in range(4) for j in range(i)]
    cosines = [-np.einsum("ij,ij->i", normals[i], normals[j]) for i, j in pairs]
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def interface(tets, region):
    """The triangles between tetrahedra of different regions, and these."""
    faces = np.concatenate([np.delete(tets, k, axis=1) for k in range(4)])
    faces.sort(axis=1)
    order = np.lexsort(faces.T[::-1])
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    one, other = order[1:][same], order[:-1][same]
    regions = np.tile(region, 4)
    parts = regions[one] != regions[other]
    return faces[one[parts]], np.stack([regions[one[parts]], regions[other[parts]]], axis=1)


def bends(normals, faces):
    """The mean angle between faces that share an edge with each other and no third."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [0, 2]], faces[:, [1, 2]]])
    edges.sort(axis=1)
    order = np.lexsort(edges.T)
    starts = np.flatnonzero(np.r_[True, (np.diff(edges[order], axis=0) != 0).any(axis=1)])
    pairs = starts[np.diff(np.r_[starts, len(order)]) == 2]
    one, other = (normals[order[pairs + i] % len(faces)] for i in (0, 1))
    return np.degrees(np.arccos(np.clip(np.abs((one * other).sum(axis=1)), 0, 1))).mean()


def to_truth(at, field):
    """Distances of points to where a field is 0, by its slope."""
    take = lambda values: ndimage.map_coordinates(values, at.T[::-1], order=1)
    slope = np.sqrt(sum(take(part) ** 2 for part in np.gradient(field)))
    return np.abs(take(field)) / np.maximum(slope, 1e-12)


def squares(labels):
    """The middles and axes of the squares between samples of different labels; x, y, z."""
    middles, axes = [], []
    for axis in range(3):
        unlike = np.argwhere(np.diff(labels, axis=2 - axis) != 0)[:, ::-1].astype(float)
        unlike[:, axis] += 0.5
        middles.append(unlike)
        axes.append(np.full(len(unlike), axis))
    return np.concatenate(middles), np.concatenate(axes)


def to_squares(at, middles, axes):
    """Distances of points to the nearest of the squares."""
    _, near = cKDTree(middles).query(at, k=12)
    off = np.abs(at[:, None] - middles[near])
    beside = np.maximum(off - 0.5, 0)
    flat = np.arange(3) == axes[near][..., None]
    return np.sqrt((np.where(flat, off, beside) ** 2).sum(axis=2)).min(axis=1)


def to_triangles(at, points, faces):
    surface = vtkPolyData()
    nodes = vtkPoints()
    nodes.SetData(numpy_to_vtk(points, deep=True))
    cells = vtkCellArray()
    for face in faces:
        cells.InsertNextCell(3, face.tolist())
    surface.SetPoints(nodes)
    surface.SetPolys(cells)
    locator = vtkStaticCellLocator()
    locator.SetDataSet(surface)
    locator.BuildLocator()
    closest, cell, part, square = [0.0] * 3, mutable(0), mutable(0), mutable(0.0)
    distances = []
    for x in at:
        locator.FindClosestPoint(x, closest, cell, part, square)
        distances.append(square.get() ** 0.5)
    return np.array(distances)


def lost(labels, points, tets, region):
    """Parts without a tetrahedron whose middle is in them or beside them."""
    middles = points[tets].mean(axis=1).round().astype(int)[:, ::-1]
    middles = np.clip(middles, 0, np.array(labels.shape) - 1)
    gone = 0
    for label in np.unique(labels):
        here = np.zeros(labels.shape, bool)
        here[tuple(middles[region == label].T)] = True
        here = ndimage.binary_dilation(here)
        parts, count = ndimage.label(labels == label)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        found = np.zeros(count + 1, bool)
        found[np.unique(parts[here])] = True
        gone += int(((sizes >= 8) & ~found[1:]).sum())
    return gone


def judged(labels, truth, points, tets, region):
    random = np.random.default_rng(2)
    angles = dihedrals(points, tets)
    faces, sides = interface(tets, region)
    middles, axes = squares(labels)
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    chosen = random.choice(len(faces), 30000, p=area / area.sum())
    at = np.einsum("ij,ijk->ik", random.dirichlet([1, 1, 1], len(chosen)), corners[chosen])
    near = "-"
    if truth:
        label, field = truth
        off = to_truth(at[(sides[chosen] == label).any(axis=1)], field)
        near = f"{100 * (off <= 0.25).mean():.1f}"
    asked = middles[random.choice(len(middles), min(len(middles), 20000), replace=False)]
    covered = to_triangles(asked, points, faces)
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    volume = np.abs(np.linalg.det(edges)) / 6
    # Samples on the sides of the box are there by half.
    ends = [np.where((np.arange(n) == 0) | (np.arange(n) == n - 1), 0.5, 1.0) for n in labels.shape]
    weight = np.einsum("i,j,k->ijk", *ends)
    off = []
    for label in np.unique(labels):
        samples = weight[labels == label].sum()
        if samples >= FEWEST:
            off.append(100 * abs(volume[region == label].sum() / samples - 1))
    return {
        "tetrahedra": f"{len(tets):,}",
        "smallest dihedral angle": f"{angles.min():.1f}",
        "1 % of the tetrahedra below": f"{np.quantile(angles.min(axis=0), 0.01):.1f}",
        "largest dihedral angle": f"{angles.max():.1f}",
        "precision, 1/2 sample, %": f"{100 * (to_squares(at, middles, axes) <= 0.5).mean():.1f}",
        "coverage, 1/2 and 1 sample, %": f"{100 * (covered <= 0.5).mean():.1f}, {100 * (covered <= 1).mean():.1f}",
        "truth, 1/4 sample, %": near,
        "bends, degrees": f"{bends(normals / area[:, None], faces):.1f}",
        "volumes off by at most, %": f"{max(off):.2f}",
        "the whole box off by, %": f"{100 * abs(volume.sum() / weight.sum() - 1):.2f}",
        "parts lost": str(lost(labels, points, tets, region)),
    }


def compared(name, labels, truth, distance, given):
    labels = np.ascontiguousarray(labels, np.uint8)
    folder = given.folder
    np.save(folder / f"{name}.npy", labels)
    labels.tofile(folder / f"{name}.raw")
    image, ours, theirs = (folder / f"{name}{end}" for end in (".npy", ".vtu", ".mesh"))
    command = [given.atomesh, "mesh", image, "-o", ours, "--feature", "labels", "--distance", distance, "--quiet"]
    seconds, _ = processor_time(command)
    mesh = of_vtu(ours)
    low, high = DISTANCES
    for _ in range(9):
        apart = (low * high) ** 0.5
        command = [given.cgal, folder / f"{name}.raw", *labels.shape[::-1], distance, apart, theirs]
        _, said = processor_time(command)
        other = of_medit(theirs)
        ratio = len(other[1]) / len(mesh[1])
        if abs(ratio - 1) < ALIKE:
            break
        low, high = (apart, high) if ratio > 1 else (low, apart)
    rows = [judged(labels, truth, *mesh), judged(labels, truth, *other)]
    rows[0]["processor time, CGAL's is 1"] = f"{seconds / float(said):.2f}"
    rows[1]["processor time, CGAL's is 1"] = f"1 ({float(said):.0f} s)"
    print(f"| **{name}** | {'x'.join(map(str, labels.shape[::-1]))}, d = {distance} | size {distance}, distance {apart:.2f} |")
    for what in rows[0]:
        print(f"| {what} | {rows[0][what]} | {rows[1][what]} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("atomesh", "cgal", "folder"):
        parser.add_argument(name, type=pathlib.Path)
    parser.add_argument("--data", type=pathlib.Path)
    parser.add_argument("--only")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    volumes = {"blobs": (blobs, 3)}
    if given.data:
        volumes |= {
            "layers": (lambda: layers(given.data), 3),
            "Ketton": (lambda: ketton(given.data), 4),
            "brain": (lambda: brain(given.data), 3),
        }
    print("| | atomesh | CGAL |\n|---|---|---|")
    for name, (made, distance) in volumes.items():
        if given.only in (None, name):
            compared(name, *made(), distance, given)


if __name__ == "__main__":
    main()
