"""Judges a mesh of a label image by the samples of the image: `label_judge.py IMAGE MESH.vtu`.

Prints tables in Markdown. All figures come from the samples and the tetrahedra, without anything that atomesh computed
besides the mesh and its regions. A part of the image is a set of samples of one label that are
connected face to face. A tetrahedron belongs to the part of its label that the sample at its centre belongs to, or else
the nearest one. Lengths are in samples, except that angles and bends are those of physical space.

- volume: the volume of a part's tetrahedra against its number of samples. Samples on a side of the box count by half,
  unless the mesh covers full voxels (--cover voxels);
- lost: parts whose tetrahedra have less than a quarter of their volume;
- Dice coefficients of the samples of parts and labels, and those in their tetrahedra; samples that changed labels;
- pinches: nodes of two parts that are not neighbours in any of the 26 directions; pairs of such parts of one label whose
  tetrahedra share faces (joined); nodes at which a part touches itself, and nodes at which it has the thickness zero, though
  the parts on both sides may be neighbours elsewhere. Both are counted only further than 1.5 samples from a corner of samples at
  which samples of the part, or those around it, touch at an edge or a corner only;
- Euler number of the surface of each part. In the image it is that with samples connected face to face (6) and that with
  samples connected also at edges and corners (26), and any number between: where samples touch at an edge or a
  corner only, the mesh may go either way. In the mesh, tetrahedra are connected face to face;
- pieces: parts whose tetrahedra are not connected face to face;
- distances: from points on the faces of a part to the squares between its samples and others, and from the centres
  of these squares to the faces. They are measured at random points, so the largest one is a lower bound;
- bends: the angle between neighbouring faces between labels, which is large if faces follow the steps of samples;
- dihedral angles;
- thickness: the distance along the inward normal from points on the faces of a part to its next face. A twentieth of the
  points is below the printed one.

Thick parts have 500 samples or more and are at least three samples thick (nine tenths of them are covered by balls of
radius 2 around samples whose nearest other sample is at least 2 away), thin ones are thinner, small ones have 27 to 499
samples, and specks less.
"""

import argparse
import json
import pathlib

import numpy as np
from scipy import ndimage, sparse
from scipy.spatial import cKDTree
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import mutable, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkStaticCellLocator
from vtkmodules.vtkIOXML import vtkXMLImageDataReader, vtkXMLUnstructuredGridReader

LARGE, SMALL = 500, 27  # numbers of samples from which a part is large, and more than a speck
MIN_THICK_RADIUS = 2.0  # distance from the middle of a part three samples thick to the nearest other sample
MIN_THICK_SHARE = 0.9  # share of a thick part in balls of this radius
MIN_KEPT_SHARE = 0.25  # parts with a smaller share of their volume are lost
MAX_CONTACT_DISTANCE = 1.5  # distance in samples from a contact in the image to the same one in the mesh
POINTS, MIN_POINTS, MAX_POINTS = 60000, 50, 3000  # numbers of points for distances: in all, and of each part
TOLERANCE = 1e-5  # distance in samples within which a sample is in a tetrahedron, or a node on a side of the box
MAX_THICKNESS = 100.0  # beyond it, the thickness is not measured
CHUNK = 4_000_000  # pairs of a sample and a tetrahedron that are tested at a time
CLASSES = "thick", "thin", "small", "speck"


def read_labels(path, spacing=None):
    """Returns the labels of an image as an array [z, y, x], and the matrix that maps an index (x, y, z) to a position."""
    path = pathlib.Path(path)
    if path.suffix == ".npy":
        return np.load(path), np.diag([*(spacing or (1, 1, 1)), 1.0])
    if path.suffix == ".vti":
        reader = vtkXMLImageDataReader()
        reader.SetFileName(str(path))
        reader.Update()
        image = reader.GetOutput()
        values = vtk_to_numpy(image.GetPointData().GetArray(0)).reshape(image.GetDimensions()[::-1])
        step, origin = image.GetSpacing(), image.GetOrigin()
        direction = [[image.GetDirectionMatrix().GetElement(i, j) for j in range(3)] for i in range(3)]
    elif path.suffix in (".tif", ".tiff"):
        import tifffile

        return tifffile.imread(path), np.diag([*(spacing or (1, 1, 1)), 1.0])
    else:
        import SimpleITK

        if path.is_dir():
            reader = SimpleITK.ImageSeriesReader()
            reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(path)))
            image = reader.Execute()
        else:
            image = SimpleITK.ReadImage(str(path))
        values = SimpleITK.GetArrayFromImage(image)
        step, origin = image.GetSpacing(), image.GetOrigin()
        direction = np.reshape(image.GetDirection(), (3, 3))
    matrix = np.eye(4)
    matrix[:3, :3] = np.asarray(direction) * (spacing or step)
    matrix[:3, 3] = origin
    return values, matrix


def read_vtu(path):
    """Returns the nodes, the tetrahedra and their regions."""
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutput()
    tets = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, 4)
    points = vtk_to_numpy(grid.GetPoints().GetData()).astype(float)
    return points, tets, vtk_to_numpy(grid.GetCellData().GetArray("region"))


def dihedrals(points, tets):
    """Returns the six dihedral angles of each tetrahedron, in degrees."""
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


def faces_with_cells(tets):
    """Returns the triangles of a mesh and the two tetrahedra of each. The second is -1 on the surface of the mesh."""
    faces = np.concatenate([np.delete(tets, k, axis=1) for k in range(4)])
    faces.sort(axis=1)
    order = np.lexsort(faces.T[::-1])
    is_first = np.r_[True, (faces[order[1:]] != faces[order[:-1]]).any(axis=1)]
    starts = np.flatnonzero(is_first)
    counts = np.diff(np.r_[starts, len(order)])
    if counts.max() > 2:
        raise SystemExit(f"{(counts > 2).sum()} faces belong to three tetrahedra or more")
    cells = np.full((len(starts), 2), -1)
    cells[:, 0] = order[starts] % len(tets)
    cells[counts == 2, 1] = order[starts[counts == 2] + 1] % len(tets)
    return faces[order[starts]], cells


def interface(tets, region):
    """Returns the triangles between tetrahedra of different regions, and the two regions of each."""
    faces, cells = faces_with_cells(tets)
    sides = region[cells]
    differ = (cells[:, 1] >= 0) & (sides[:, 0] != sides[:, 1])
    return faces[differ], sides[differ]


def bends(normals, faces):
    """Returns the angles, in degrees, between faces that share an edge which no third face has."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [0, 2]], faces[:, [1, 2]]])
    edges.sort(axis=1)
    order = np.lexsort(edges.T)
    starts = np.flatnonzero(np.r_[True, (np.diff(edges[order], axis=0) != 0).any(axis=1)])
    pairs = starts[np.diff(np.r_[starts, len(order)]) == 2]
    one, other = (normals[order[pairs + i] % len(faces)] for i in (0, 1))
    return np.degrees(np.arccos(np.clip(np.abs((one * other).sum(axis=1)), 0, 1)))


def normals_and_areas(points, faces):
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    return normals / lengths[:, None], lengths / 2


def random_points(random, points, faces, areas, count):
    """Returns random points on triangles, evenly by area, and the triangle of each."""
    chosen = random.choice(len(faces), count, p=areas / areas.sum())
    return np.einsum("ij,ijk->ik", random.dirichlet([1, 1, 1], count), points[faces[chosen]]), chosen


def squares(values):
    """Returns the centres (x, y, z), the axes and the two values of the squares between different samples."""
    middles, axes, sides = [], [], []
    for axis in range(3):
        low, high = (np.take(values, range(i, values.shape[2 - axis] - 1 + i), axis=2 - axis) for i in (0, 1))
        where = np.nonzero(low != high)
        centres = np.stack(where[::-1], axis=1).astype(float)
        centres[:, axis] += 0.5
        middles.append(centres)
        axes.append(np.full(len(centres), axis))
        sides.append(np.stack([low[where], high[where]], axis=1))
    return np.concatenate(middles), np.concatenate(axes), np.concatenate(sides)


def distance_to_squares(points, middles, axes):
    """Returns the distances of points to the nearest square."""
    _, nearest = cKDTree(middles).query(points, k=min(12, len(middles)))
    nearest = nearest.reshape(len(points), -1)
    offsets = np.abs(points[:, None] - middles[nearest])
    in_plane = np.maximum(offsets - 0.5, 0)
    is_normal = np.arange(3) == axes[nearest][..., None]
    return np.sqrt((np.where(is_normal, offsets, in_plane) ** 2).sum(axis=2)).min(axis=1)


def triangle_locator(points, faces):
    """Returns an object that finds the nearest triangle, and triangles on a line."""
    nodes, faces = np.unique(faces, return_inverse=True)
    surface, positions, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
    positions.SetData(numpy_to_vtk(np.ascontiguousarray(points[nodes]), deep=True))
    faces = faces.reshape(-1, 3)
    offsets = numpy_to_vtkIdTypeArray(3 * np.arange(len(faces) + 1), deep=True)
    cells.SetData(offsets, numpy_to_vtkIdTypeArray(faces.ravel(), deep=True))
    surface.SetPoints(positions)
    surface.SetPolys(cells)
    locator = vtkStaticCellLocator()
    locator.SetDataSet(surface)
    locator.BuildLocator()
    return locator


def distance_to_triangles(positions, locator):
    """Returns the distances of positions to the nearest triangle."""
    closest, cell, part, square = [0.0] * 3, mutable(0), mutable(0), mutable(0.0)
    distances = []
    for x in positions:
        locator.FindClosestPoint(x, closest, cell, part, square)
        distances.append(square.get() ** 0.5)
    return np.array(distances)


def first_crossings(positions, directions, locator):
    """Returns the distances along directions from points on triangles to the next triangle."""
    t, x, weights, part, cell = mutable(0.0), [0.0] * 3, [0.0] * 3, mutable(0), mutable(0)
    lengths = []
    for start, direction in zip(positions, directions):
        start = start + 1e-4 * direction
        hit = locator.IntersectWithLine(start, start + MAX_THICKNESS * direction, 1e-9, t, x, weights, part, cell)
        lengths.append(MAX_THICKNESS * (t.get() if hit else 1.0))
    return np.array(lengths)


def connected_parts(labels):
    """Returns the number of the part of each sample, and the label of each part."""
    parts, names = np.zeros(labels.shape, int), []
    values, indices = np.unique(labels, return_inverse=True)
    indices = indices.reshape(labels.shape)
    for number, box in enumerate(ndimage.find_objects(indices + 1)):
        inside = indices[box] == number
        found, count = ndimage.label(inside)
        parts[box][inside] = found[inside] - 1 + len(names)
        names += [values[number]] * count
    return parts, np.array(names)


def neighbours(parts):
    """Returns the pairs of parts that are neighbours in any of the 26 directions, each as one number."""
    count = parts.max() + 1
    pairs = [np.arange(0)]
    for step in np.ndindex(3, 3, 3):
        offset = np.array(step) - 1
        if tuple(offset) <= (0, 0, 0):
            continue
        one, other = (
            tuple(slice(max(0, sign * d), n + min(0, sign * d)) for d, n in zip(offset, parts.shape)) for sign in (1, -1)
        )
        a, b = parts[one], parts[other]
        differ = a != b
        pairs.append(np.unique(pair_number(a[differ], b[differ], count)))
    return np.unique(np.concatenate(pairs))


def pair_number(one, other, count):
    return np.minimum(one, other) * count + np.maximum(one, other)


def corner_tables():
    """Returns for each pattern of the eight samples around a corner its share in the Euler number of the set with samples
    connected face to face, in that with samples connected also at edges and corners, and whether
    samples of the set, or those around it, touch at an edge or the corner only."""
    cells = np.array(list(np.ndindex(2, 2, 2)))
    faces, edges, tables = [], [], np.zeros((3, 256))
    for i in range(8):
        for j in range(i):
            if abs(cells[i] - cells[j]).sum() == 1:
                faces.append([i, j])
    for axis in range(3):
        edges += [[k for k in range(8) if cells[k, axis] == side] for side in (0, 1)]
    for pattern in range(1, 256):
        has = [bool(pattern >> k & 1) for k in range(8)]
        is_full = lambda sets: sum(all(has[k] for k in group) for group in sets)
        is_touched = lambda sets: sum(any(has[k] for k in group) for group in sets)
        # Four samples around an edge are a square of centres, and two beside a face an edge of them.
        tables[0, pattern] = sum(has) / 8 - is_full(faces) / 4 + is_full(edges) / 2 - all(has)
        tables[1, pattern] = 1 - is_touched(edges) / 2 + is_touched(faces) / 4 - sum(has) / 8
        links = [(i, j) for i, j in faces if has[i] and has[j]]
        graph = sparse.coo_matrix((np.ones(len(links)), tuple(zip(*links)) or ([], [])), (8, 8))
        is_split = len(set(sparse.csgraph.connected_components(graph, False)[1][has])) > 1
        others = [(i, j) for i, j in faces if not has[i] and not has[j]]
        graph = sparse.coo_matrix((np.ones(len(others)), tuple(zip(*others)) or ([], [])), (8, 8))
        is_split |= len(set(sparse.csgraph.connected_components(graph, False)[1][np.logical_not(has)])) > 1
        is_diagonal = any([has[k] for k in group] in ([1, 0, 0, 1], [0, 1, 1, 0]) for group in edges)
        tables[2, pattern] = is_split or is_diagonal
    return tables


def voxel_euler(parts):
    """Returns the least and the largest Euler number of the surface of each part, the corners at which samples of a
    part, or those around it, touch at an edge or a corner only, and these parts."""
    count = parts.max() + 1
    padded = np.pad(parts, 1, constant_values=-1)
    shape = np.array(padded.shape) - 1
    around = [padded[tuple(slice(s, s + n) for s, n in zip(step, shape))] for step in np.ndindex(2, 2, 2)]
    differs = np.any([a != around[0] for a in around[1:]], axis=0)
    where = np.argwhere(differs)
    around = np.stack([a[differs] for a in around])
    tables = corner_tables()
    low, high = np.zeros(count), np.zeros(count)
    contacts = np.zeros(count, int)
    corners, owners = [], []
    for k in range(8):
        part = around[k]
        is_first = (part >= 0) & ~(around[:k] == part).any(axis=0)
        pattern = ((around == part) << np.arange(8)[:, None]).sum(axis=0)[is_first]
        part = part[is_first]
        six, all_26, is_split = tables[:, pattern]
        low += np.bincount(part, np.minimum(six, all_26), count)
        high += np.bincount(part, np.maximum(six, all_26), count)
        is_contact = is_split > 0
        contacts += np.bincount(part[is_contact], minlength=count)
        corners.append(where[is_first][is_contact][:, ::-1] - 0.5)
        owners.append(part[is_contact])
    euler = np.stack([2 * low, 2 * high], axis=1).round().astype(int)
    return euler, contacts, np.concatenate(corners), np.concatenate(owners)


def parts_of_cells(points, tets, region, parts, names):
    """Returns the part of each tetrahedron, -1 if the image does not have its label."""
    middles = points[tets].mean(axis=1)
    at = np.clip(middles.round().astype(int), 0, np.array(parts.shape)[::-1] - 1)
    cell_parts = parts[tuple(at.T[::-1])]
    wrong = names[cell_parts] != region
    cell_parts[wrong] = -1
    # Only samples next to another label can be the nearest.
    centre = ndimage.minimum_filter(parts, 3) != ndimage.maximum_filter(parts, 3)
    border = np.argwhere(centre)[:, ::-1]
    border_parts = parts[centre]
    for label in np.unique(region[wrong]):
        candidates = np.flatnonzero(names[border_parts] == label)
        if len(candidates):
            chosen = np.flatnonzero(wrong & (region == label))
            _, nearest = cKDTree(border[candidates]).query(middles[chosen])
            cell_parts[chosen] = border_parts[candidates[nearest]]
    return cell_parts


def cells_of_samples(points, tets, shape):
    """Returns the tetrahedron at each sample of an image, -1 where there is none."""
    cells = np.full(shape, -1)
    corners = points[tets]
    inverse = np.linalg.inv(np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2))
    low = np.maximum(np.ceil(corners.min(axis=1) - TOLERANCE), 0).astype(int)
    high = np.minimum(np.floor(corners.max(axis=1) + TOLERANCE), np.array(shape)[::-1] - 1).astype(int)
    sides = np.maximum(high - low + 1, 0)
    totals = np.r_[0, np.cumsum(sides.prod(axis=1))]
    start = 0
    while start < len(tets):
        end = max(start + 1, np.searchsorted(totals, totals[start] + CHUNK, side="right") - 1)
        chosen = np.repeat(np.arange(start, end), np.diff(totals[start : end + 1]))
        within = np.arange(len(chosen)) + totals[start] - totals[chosen]
        x, rest = within % sides[chosen, 0], within // sides[chosen, 0]
        at = low[chosen] + np.stack([x, rest % sides[chosen, 1], rest // sides[chosen, 1]], axis=1)
        inner = np.einsum("ijk,ik->ij", inverse[chosen], at - corners[chosen, 0])
        is_inside = (inner >= -TOLERANCE).all(axis=1) & (inner.sum(axis=1) <= 1 + TOLERANCE)
        cells[tuple(at[is_inside].T[::-1])] = chosen[is_inside]
        start = end
    return cells


def unique_rows(rows):
    """Returns the different rows of an array, and how often each occurs."""
    order = np.lexsort(rows.T[::-1])
    is_first = np.r_[True, (rows[order[1:]] != rows[order[:-1]]).any(axis=1)]
    return rows[order[is_first]], np.diff(np.flatnonzero(np.r_[is_first, True]))


def mesh_euler(tets, cell_parts, faces, cells, count):
    """Returns the Euler number of the surface of each part, whose tetrahedra are connected face to face."""
    is_inner = (cells[:, 1] >= 0) & (cell_parts[cells[:, 0]] == cell_parts[cells[:, 1]])
    outer = faces[cells[:, 1] < 0]
    euler = np.bincount(cell_parts, minlength=count) - np.bincount(cell_parts[cells[is_inner, 0]], minlength=count)
    for size, sign in ((2, 1), (1, -1)):
        corners = [(i, j) for i in range(4) for j in range(i)] if size == 2 else [(i,) for i in range(4)]
        simplices = np.concatenate([np.sort(tets[:, pick], axis=1) for pick in map(list, corners)])
        sides = [(0, 1), (0, 2), (1, 2)] if size == 2 else [(0,), (1,), (2,)]
        rim = np.concatenate([outer[:, pick] for pick in map(list, sides)])
        parts = np.concatenate([np.tile(cell_parts, len(corners)), np.full(len(rim), -2)])
        rows, _ = unique_rows(np.column_stack([np.concatenate([simplices, rim]), parts]))
        # A simplex inside a part belongs to no other part and not to the surface of the mesh.
        _, first, occurrences = np.unique(
            rows[:, 0] if size == 1 else rows[:, 0] * (tets.max() + 1) + rows[:, 1], return_index=True, return_counts=True
        )
        euler += sign * np.bincount(rows[first[occurrences == 1], -1], minlength=count)
    return 2 * euler


def contacts_of_parts(tets, cell_parts, faces, cells, allowed, count):
    """Returns the nodes of parts that are not neighbours in the image with two such parts, the nodes at which a part
    touches itself with that part, and the nodes at which a part has the thickness zero with that part."""
    nodes = np.column_stack([tets.ravel(), np.repeat(cell_parts, 4)])
    rows, _ = unique_rows(nodes)
    pinches = []
    for shift in range(1, len(rows)):
        same = rows[shift:, 0] == rows[:-shift, 0]
        if not same.any():
            break
        one, other = rows[:-shift][same], rows[shift:][same]
        apart = ~np.isin(pair_number(one[:, 1], other[:, 1], count), allowed)
        pinches.append(np.column_stack([one, other[:, 1]])[apart])
    pinches = np.concatenate(pinches) if pinches else np.zeros((0, 3), int)
    # Corners of tetrahedra of one part are linked across faces.
    is_inner = (cells[:, 1] >= 0) & (cell_parts[cells[:, 0]] == cell_parts[cells[:, 1]])
    all_faces, all_cells = faces, cells
    faces, cells = faces[is_inner], cells[is_inner]
    ends = []
    for side in (0, 1):
        corner = (tets[cells[:, side]][:, :, None] == faces[:, None, :]).argmax(axis=1)
        ends.append((4 * cells[:, side, None] + corner).ravel())
    graph = sparse.coo_matrix((np.ones(len(ends[0]), np.int8), ends), (4 * len(tets),) * 2)
    _, group = sparse.csgraph.connected_components(graph, directed=False)
    _, index = np.unique(group, return_index=True)
    rows, counts = unique_rows(nodes[index])
    touches = rows[counts > 1]
    return pinches, touches, holes_in_parts(tets, cell_parts, all_faces, all_cells, group)


def holes_in_parts(tets, cell_parts, faces, cells, group):
    """Returns the nodes, with a part, at which the part is one piece and what surrounds it is not: the part has the thickness
    zero there. `group` has the piece of each corner of a tetrahedron: tetrahedra of a part around a node, connected face to face."""
    is_outer = cells[:, 1] < 0
    is_wall = is_outer | (cell_parts[cells[:, 0]] != cell_parts[cells[:, 1]])
    faces, cells, is_outer = faces[is_wall], cells[is_wall], is_outer[is_wall]
    sides = []
    for side in (0, 1):
        corner = (tets[cells[:, side]][:, :, None] == faces[:, None, :]).argmax(axis=1)
        pieces = group[4 * cells[:, side, None] + corner]
        # The space outside the mesh is one piece.
        sides.append(np.where((side == 1) & is_outer[:, None], -1, pieces))
    links, _ = unique_rows(np.column_stack([faces.ravel(), sides[0].ravel(), sides[1].ravel()]))
    part_of_piece = np.empty(group.max() + 2, int)
    part_of_piece[group], part_of_piece[-1] = np.repeat(cell_parts, 4), -1
    bounds = np.flatnonzero(np.r_[True, np.diff(links[:, 0]) != 0, True])
    holes = []
    for start, end in zip(bounds, bounds[1:]):
        pairs = links[start:end, 1:]
        pieces = np.unique(pairs).tolist()
        if len(pieces) < 3:
            continue
        owners = part_of_piece[pieces].tolist()
        for part in {owner for owner in owners if owner >= 0 and owners.count(owner) == 1}:
            root = {piece: piece for piece, owner in zip(pieces, owners) if owner != part}
            for a, b in pairs.tolist():
                if a in root and b in root and root[a] != root[b]:
                    old, new = root[a], root[b]
                    root = {piece: new if group == old else group for piece, group in root.items()}
            if len(set(root.values())) > 1:
                holes.append([links[start, 0], part])
    return np.array(holes, int).reshape(-1, 2)


def class_of(parts, part, box, samples):
    if samples < LARGE:
        return "small" if samples >= SMALL else "speck"
    # What lies beyond the side of the box is like the samples at it.
    region = tuple(slice(max(0, s.start - 3), s.stop + 3) for s in box)
    inside = np.pad(parts[region] == part, 3, mode="edge")
    depth = ndimage.distance_transform_edt(inside)
    deep = depth >= MIN_THICK_RADIUS
    if not deep.any():
        return "thin"
    near = ndimage.distance_transform_edt(~deep) < MIN_THICK_RADIUS
    return "thick" if (near & inside).sum() >= MIN_THICK_SHARE * inside.sum() else "thin"


def summary(distances, weights=None):
    if not len(distances):
        return None
    mean = lambda values: float(np.average(values, weights=weights))
    return {
        "mean": mean(distances),
        "rms": mean(distances**2) ** 0.5,
        "within_half": mean(distances <= 0.5),
        "within_one": mean(distances <= 1),
        "worst": float(distances.max()),
    }


def part_distances(points, tets, cell_parts, faces, cells, parts, names, box):
    """Returns for each part distances from faces to the squares and from the squares to faces, and the thickness."""
    random = np.random.default_rng(2)
    is_inner = cells[:, 1] >= 0
    sides = cell_parts[cells]
    sides[~is_inner, 1] = -1
    # Faces on the surface of the mesh lie at dropped labels, unless they lie on a side of the box.
    is_side = ((np.abs(points - box[0]) < TOLERANCE) | (np.abs(points - box[1]) < TOLERANCE))[faces].all(axis=1).any(axis=1)
    is_interface = np.where(is_inner, names[sides[:, 0]] != names[sides[:, 1]], ~is_side)
    is_wall = ~is_inner | (sides[:, 0] != sides[:, 1])
    middles, axes, square_parts = squares(parts)
    normals, areas = normals_and_areas(points, faces)
    inward = points[tets[cells[:, 0]]].mean(axis=1) - points[faces[:, 0]]
    normals *= np.sign(np.einsum("ij,ij->i", normals, inward))[:, None]

    def grouped(owners, chosen):
        """Returns, for each part, the numbers of those chosen that it owns."""
        numbers = np.flatnonzero(chosen)
        both = owners[numbers].T.ravel()
        numbers = np.tile(numbers, 2)
        order = np.argsort(both, kind="stable")
        bounds = np.searchsorted(both[order], np.arange(len(names) + 1))
        return [numbers[order[bounds[i] : bounds[i + 1]]] for i in range(len(names))]

    own_faces, own_walls = grouped(sides, is_interface), grouped(sides, is_wall)
    own_squares = grouped(square_parts, np.ones(len(middles), bool))
    total = 2 * len(middles)
    results = []
    for part in range(len(names)):
        result = {"to_squares": np.zeros(0), "to_faces": np.zeros(0), "areas": (0.0, 0.0), "thickness": None}
        results.append(result)
        chosen, targets = own_faces[part], own_squares[part]
        if not len(chosen) or not len(targets):
            continue
        count = int(np.clip(POINTS * len(targets) / total, MIN_POINTS, MAX_POINTS))
        positions, face = random_points(random, points, faces[chosen], areas[chosen], count)
        result["to_squares"] = distance_to_squares(positions, middles[targets], axes[targets])
        some = targets if len(targets) <= count else random.choice(targets, count, replace=False)
        result["to_faces"] = distance_to_triangles(middles[some], triangle_locator(points, faces[chosen]))
        result["areas"] = float(areas[chosen].sum()), float(len(targets))
        number = chosen[face]
        into = normals[number] * np.where(cell_parts[cells[number, 0]] == part, 1, -1)[:, None]
        walls = triangle_locator(points, faces[own_walls[part]])
        result["thickness"] = float(np.quantile(first_crossings(positions, into, walls), 0.05))
    return results


def total_distances(results, key, side):
    """Returns the summary over all parts, weighted by area."""
    values = [result[key] for result in results]
    weights = [np.full(len(v), result["areas"][side] / max(len(v), 1)) for v, result in zip(values, results)]
    return summary(np.concatenate(values), np.concatenate(weights))


def judge(labels, matrix, points, tets, region, dropped=()):
    """Returns the figures of a mesh of an image of labels."""
    world = points
    points = (points - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    size = np.array(labels.shape)[::-1]
    low, high = points.min(axis=0), points.max(axis=0)
    covers_voxels = bool((low < -0.4).any())
    box = np.stack([0 * size, size - 1]) + (np.array([[-0.5], [0.5]]) if covers_voxels else 0)
    parts, names = connected_parts(labels)
    count = len(names)
    is_kept = ~np.isin(names, dropped)
    cell_parts = parts_of_cells(points, tets, region, parts, names)
    is_known = cell_parts >= 0
    if not is_known.any():
        raise SystemExit("no tetrahedron has a label of the image; give the image that was meshed, and a mesh of its labels")
    unknown = sorted(set(region[~is_known].tolist()))
    tets, region, cell_parts = tets[is_known], region[is_known], cell_parts[is_known]

    samples = np.bincount(parts.ravel(), minlength=count)
    ends = [np.where((np.arange(n) == 0) | (np.arange(n) == n - 1), 1.0 if covers_voxels else 0.5, 1.0) for n in labels.shape]
    weights = np.einsum("i,j,k->ijk", *ends)
    sample_volumes = np.bincount(parts.ravel(), weights.ravel(), count)
    volumes = np.abs(np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])) / 6
    part_volumes = np.bincount(cell_parts, volumes, count)
    is_lost = part_volumes < MIN_KEPT_SHARE * sample_volumes

    found = cells_of_samples(points, tets, labels.shape)
    sampled = np.where(found >= 0, cell_parts[found], -1)
    kept = np.bincount(parts[sampled == parts], minlength=count)
    sampled_counts = np.bincount(sampled[sampled >= 0], minlength=count)
    dice = 2 * kept / np.maximum(samples + sampled_counts, 1)
    label_dice, changed = [], 0
    for label in np.unique(names[is_kept]):
        of_label = names == label
        mesh_has, image_has = of_label[sampled] & (sampled >= 0), of_label[parts]
        both = (mesh_has & image_has).sum()
        label_dice.append(2 * both / (mesh_has.sum() + image_has.sum()))
        changed += int(image_has.sum() - both)

    faces, cells = faces_with_cells(tets)
    euler, contacts, contact_corners, contact_parts = voxel_euler(parts)
    euler_in_mesh = mesh_euler(tets, cell_parts, faces, cells, count)
    allowed = neighbours(parts)
    pinches, touches, holes = contacts_of_parts(tets, cell_parts, faces, cells, allowed, count)
    expected = cKDTree(np.column_stack([contact_corners, 1e3 * contact_parts])) if len(contact_corners) else None
    if expected:
        is_far = lambda found: (
            expected.query(np.column_stack([points[found[:, 0]], 1e3 * found[:, 1]]))[0] > MAX_CONTACT_DISTANCE
        )
        touches, holes = (found[is_far(found)] for found in (touches, holes))
    sides = cell_parts[cells]
    is_inner = cells[:, 1] >= 0
    meets = is_inner & (sides[:, 0] != sides[:, 1]) & (names[sides[:, 0]] == names[sides[:, 1]])
    joined = np.setdiff1d(pair_number(sides[meets, 0], sides[meets, 1], count), allowed)
    same = is_inner & (sides[:, 0] == sides[:, 1])
    links = sparse.coo_matrix((np.ones(same.sum(), np.int8), tuple(cells[same].T)), (len(tets),) * 2)
    _, pieces = sparse.csgraph.connected_components(links, directed=False)
    piece_parts = cell_parts[np.unique(pieces, return_index=True)[1]]
    piece_counts = np.bincount(piece_parts, minlength=count)

    distances = part_distances(points, tets, cell_parts, faces, cells, parts, names, box)
    between = is_inner & (region[cells[:, 0]] != region[cells[:, 1]])
    normals, _ = normals_and_areas(world, faces[between])
    angles = dihedrals(world, tets)
    bend = bends(normals, faces[between]) if between.any() else np.zeros(1)

    boxes = ndimage.find_objects(parts + 1)
    firsts = np.unique(parts.ravel(), return_index=True)[1]
    reports = []
    for part in np.argsort(-samples, kind="stable"):
        if not is_kept[part]:
            continue
        low_euler, high_euler = euler[part].tolist()
        reports.append(
            {
                "label": names[part].item(),
                "class": class_of(parts, part, boxes[part], samples[part]),
                "samples": int(samples[part]),
                "first_sample": [int(i) for i in np.unravel_index(firsts[part], parts.shape)[::-1]],
                "volume": float(part_volumes[part]),
                "sample_volume": float(sample_volumes[part]),
                "error_percent": float(100 * (part_volumes[part] / sample_volumes[part] - 1)),
                "is_lost": bool(is_lost[part]),
                "dice": float(dice[part]),
                "pieces": int(piece_counts[part]),
                "euler": [low_euler, high_euler],
                "contacts": int(contacts[part]),
                "mesh_euler": int(euler_in_mesh[part]),
                "wrong_euler": bool(not is_lost[part] and not low_euler <= euler_in_mesh[part] <= high_euler),
                "faces_to_squares": summary(distances[part]["to_squares"]),
                "squares_to_faces": summary(distances[part]["to_faces"]),
                "thickness": distances[part]["thickness"],
            }
        )
    describe = lambda part: [names[part].item(), [int(i) for i in np.unravel_index(firsts[part], parts.shape)[::-1]]]
    of_size = lambda least: [report["dice"] for report in reports if report["samples"] >= least]
    return {
        "tetrahedra": len(tets),
        "covers": "voxels" if covers_voxels else "samples",
        "box_off": None if dropped else float(np.abs(np.stack([low, high]) - box).max()),
        "volume_off_percent": float(100 * (volumes.sum() / sample_volumes[is_kept].sum() - 1)),
        "unknown_labels": unknown,
        "dihedral_min": float(angles.min()),
        "dihedral_1_percent": float(np.quantile(angles.min(axis=0), 0.01)),
        "dihedral_max": float(angles.max()),
        "bend_mean": float(bend.mean()),
        "bend_99_percent": float(np.quantile(bend, 0.99)),
        "faces_to_squares": total_distances(distances, "to_squares", 0),
        "squares_to_faces": total_distances(distances, "to_faces", 1),
        "changed_samples": changed,
        "samples_without_cell": int((found < 0).sum()),
        "label_dice_mean": float(np.mean(label_dice)),
        "label_dice_min": float(np.min(label_dice)),
        "part_dice_mean_50": float(np.mean(of_size(50))) if of_size(50) else None,
        "pinch_nodes": len(np.unique(pinches[:, 0])),
        "pinches": [
            {"at": points[node].round(2).tolist(), "parts": [describe(a), describe(b)]} for node, a, b in pinches[:100]
        ],
        "self_touches": len(touches),
        "touches": [{"at": points[node].round(2).tolist(), "part": describe(part)} for node, part in touches[:100]],
        "hole_nodes": len(holes),
        "holes": [{"at": points[node].round(2).tolist(), "part": describe(part)} for node, part in holes[:100]],
        "joined_pairs": [[describe(n // count), describe(n % count)] for n in joined.tolist()],
        "parts": reports,
    }


def worst(reports, key, largest=True):
    values = [(abs(report[key]), report) for report in reports if report[key] is not None]
    return (max if largest else min)(values, key=lambda value: value[0])[1] if values else None


def class_rows(figures):
    """Returns the rows of the table of parts by size."""
    rows = []
    sizes = [(name, lambda report, name=name: report["class"] == name) for name in CLASSES]
    sizes += [("50 samples or more", lambda report: report["samples"] >= 50)]
    for name, has_size in sizes:
        all_parts = [report for report in figures["parts"] if has_size(report)]
        if not all_parts:
            continue
        kept = [report for report in all_parts if not report["is_lost"]]
        text = lambda report, format: format(report) if report else "-"
        error = lambda report: f"{report['error_percent']:+.2f} (label {report['label']}, {report['samples']:,} samples)"
        share = lambda key: min((r[key]["within_one"] for r in kept if r[key]), default=1.0)
        rows.append(
            [
                name,
                len(all_parts),
                len(all_parts) - len(kept),
                text(worst(kept, "error_percent"), error),
                text(worst(kept, "dice", False), lambda report: f"{report['dice']:.3f}"),
                sum(report["wrong_euler"] for report in kept),
                sum(report["pieces"] > 1 for report in kept),
                f"{100 * share('faces_to_squares'):.1f}, {100 * share('squares_to_faces'):.1f}",
                text(worst(kept, "thickness", False), lambda report: f"{report['thickness']:.2f}"),
            ]
        )
    return rows


def print_tables(figures):
    distances = lambda d: (
        f"{d['mean']:.3f}, {d['rms']:.3f}, {100 * d['within_half']:.1f}, {100 * d['within_one']:.1f}, {d['worst']:.2f}"
        if d
        else "-"
    )
    dice_50, box_off = figures["part_dice_mean_50"], figures["box_off"]
    rows = {
        "tetrahedra": f"{figures['tetrahedra']:,}",
        "the mesh covers; its box is off by": figures["covers"] + ("" if box_off is None else f"; {box_off:.1g}"),
        "total volume off by, %": f"{figures['volume_off_percent']:.2f}",
        "dihedral angles: smallest, 1 % below, largest": ", ".join(
            f"{figures[key]:.1f}" for key in ("dihedral_min", "dihedral_1_percent", "dihedral_max")
        ),
        "bends: mean, 1 % above, degrees": f"{figures['bend_mean']:.1f}, {figures['bend_99_percent']:.1f}",
        "faces to squares: mean, rms, % within 1/2, within 1, worst": distances(figures["faces_to_squares"]),
        "squares to faces": distances(figures["squares_to_faces"]),
        "samples with another label": f"{figures['changed_samples']:,}",
        "Dice of labels: mean, least; of parts from 50 samples: mean": f"{figures['label_dice_mean']:.3f}, "
        f"{figures['label_dice_min']:.3f}; {'-' if dice_50 is None else f'{dice_50:.3f}'}",
        "nodes of parts that are apart": f"{figures['pinch_nodes']}",
        "nodes at which a part touches itself": f"{figures['self_touches']}",
        "nodes at which a part has the thickness zero": f"{figures['hole_nodes']}",
        "pairs of parts of one label joined": f"{len(figures['joined_pairs'])}",
    }
    print("| figure | value |\n|---|---|")
    for name, value in rows.items():
        print(f"| {name} | {value} |")
    heads = ["parts", "number", "lost", "volume, %", "least Dice", "wrong Euler", "in pieces", "within one sample, %", "thickness"]
    print("\n| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in class_rows(figures):
        print("| " + " | ".join(map(str, row)) + " |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("image", type=pathlib.Path)
    parser.add_argument("mesh", type=pathlib.Path)
    parser.add_argument("--spacing", help="distances between samples along x, y and z: A,B,C or one for all")
    parser.add_argument("--drop", default="", help="labels that the mesh leaves out: A,B,...")
    parser.add_argument("--json", type=pathlib.Path, help="file to which all figures are written")
    arguments = parser.parse_args()
    spacing = arguments.spacing and [float(word) for word in arguments.spacing.split(",")]
    spacing = spacing and (spacing * 3)[:3]
    dropped = [float(word) for word in arguments.drop.split(",") if word]
    figures = judge(*read_labels(arguments.image, spacing), *read_vtu(arguments.mesh), dropped)
    print_tables(figures)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
