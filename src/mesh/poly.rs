//! Meshes of polyhedra (polygons in 2-D): every face is stored once, with the cell on either side.
//!
//! ```text
//!            nodes of face f turn anticlockwise      a = face_cells[f][0], its owner
//!    a       seen from b: its normal points          b = face_cells[f][1], a higher number,
//!  -----▶ b  from a to b                                 or a side of the box: FIRST_SIDE + side
//! ```
//!
//! In 2-D a face is an edge (p, q), and its owner lies to the left of p -> q. Two cells in a box:
//!
//! ```text
//!  3-----2-----5      face   nodes    face_cells               between
//!  |     |     |      0      (1, 2)   [0, 1]                   cells 0 and 1
//!  |  0  |  1  |      1      (3, 0)   [0, FIRST_SIDE]          cell 0 and the side xmin
//!  |     |     |      2      (0, 1)   [0, FIRST_SIDE + 2]      cell 0 and the side ymin
//!  0-----1-----4      3      (2, 3)   [0, FIRST_SIDE + 3]      cell 0 and the side ymax
//!                     4 to 6: (4, 5), (1, 4), (5, 2), from cell 1 to xmax, ymin and ymax
//! ```

pub use crate::geometry::NONE;
use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{add_scaled, dot, norm, sub};
use crate::parallel::prelude::*;

/// First number in [`PolyMesh::face_cells`] that stands for a side of the box: `FIRST_SIDE + 2
/// axis` is the lower side of an axis, `FIRST_SIDE + 2 axis + 1` the upper side.
pub const FIRST_SIDE: u32 = u32::MAX - 6;

/// Names of the box's sides, in the order of their numbers.
pub const SIDE_NAMES: [&str; 6] = ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax"];

/// Lists of numbers, stored one after the other: list i is `items[offsets[i]..offsets[i + 1]]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lists {
    /// Start of each list, and the end of the last one.
    pub offsets: Vec<u32>,
    /// Contents of the lists.
    pub items: Vec<u32>,
}

impl Default for Lists {
    /// Returns an empty sequence of lists.
    fn default() -> Self {
        Self {
            offsets: vec![0],
            items: Vec::new(),
        }
    }
}

impl Lists {
    /// Returns the number of lists.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Returns `true` if there are no lists.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns list `i`.
    #[inline]
    pub fn get(&self, i: usize) -> &[u32] {
        &self.items[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }

    /// Returns for each of the numbers below `count` the tuples that contain it, ascending.
    pub(super) fn inverse<const N: usize>(count: usize, tuples: &[[u32; N]]) -> Self {
        let numbers = tuples.as_flattened().iter().map(|&n| n as usize);
        let (offsets, mut items) = sort_by_group(count, numbers);
        items.iter_mut().for_each(|item| *item /= N as u32);
        Self { offsets, items }
    }

    /// Appends a list.
    pub fn push(&mut self, list: impl IntoIterator<Item = u32>) {
        self.items.extend(list);
        self.offsets.push(self.items.len() as u32);
    }
}

/// A mesh of convex cells in one space (lattice or physical, as the code that owns it documents),
/// in flat arrays.
///
/// Faces between cells come first, sorted by owner and then by the cell beyond; then come the faces
/// on the sides of the box, sorted by owner and side.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PolyMesh<const D: usize> {
    /// Node positions.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each face, in order (two in 2-D).
    pub faces: Lists,
    /// For each face its owner, and the cell or the side of the box beyond it.
    pub face_cells: Vec<[u32; 2]>,
    /// The site of each cell (its atom).
    pub sites: Vec<[f64; D]>,
    /// The region of each cell.
    pub region: Vec<i32>,
    /// `true` for each face that lies on a feature of the image.
    pub on_feature: Vec<bool>,
}

/// The object on the other side of a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaceNeighbour {
    /// Another cell.
    Cell(usize),
    /// A side of the box: 2 axis for the lower side, 2 axis + 1 for the upper side.
    Side(usize),
    /// The side is not known.
    Unknown,
}

/// Integrals over a face, which is taken as a fan of triangles (in 2-D: one edge) around `apex`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceShape<const D: usize> {
    /// The mean of the face's nodes.
    pub apex: [f64; D],
    /// The normal, from the owner to the cell or side beyond, times the area.
    pub area_vector: [f64; D],
    /// The centroid of the area; `apex` if the area is 0.
    pub centroid: [f64; D],
}

impl<const D: usize> FaceShape<D> {
    /// Returns the length of the area vector, which is the area if the face is flat.
    pub fn area(&self) -> f64 {
        norm(self.area_vector)
    }
}

impl<const D: usize> PolyMesh<D> {
    /// Returns the object on the other side of face `f`.
    #[inline]
    pub fn face_neighbour(&self, f: usize) -> FaceNeighbour {
        match self.face_cells[f][1] {
            NONE => FaceNeighbour::Unknown,
            side if side >= FIRST_SIDE => FaceNeighbour::Side((side - FIRST_SIDE) as usize),
            cell => FaceNeighbour::Cell(cell as usize),
        }
    }

    /// Returns the number of faces between cells. They come before the faces on the boundary.
    pub fn inner_face_count(&self) -> usize {
        self.face_cells.partition_point(|c| c[1] < FIRST_SIDE)
    }

    /// Returns the faces of each cell, ascending.
    pub fn faces_of_cells(&self) -> Lists {
        Lists::inverse(self.sites.len(), &self.face_cells)
    }

    /// Returns the mean of the nodes of face `f`.
    #[inline]
    fn face_apex(&self, f: usize) -> [f64; D] {
        let nodes = self.faces.get(f);
        let mut sum = [0.0; D];
        for &n in nodes {
            sum = std::array::from_fn(|k| sum[k] + self.nodes[n as usize][k]);
        }
        sum.map(|c| c / nodes.len() as f64)
    }

    /// Returns the area, normal and centroid of face `f`.
    pub fn face_shape(&self, f: usize) -> FaceShape<D> {
        let nodes = self.faces.get(f);
        let apex = self.face_apex(f);
        let mut area_vector = [0.0; D];
        let mut centroid = [0.0; D];
        let mut weight = 0.0;
        if D == 2 {
            area_vector = self.fan_area(apex, nodes[0], nodes[1]);
            return FaceShape {
                apex,
                area_vector,
                centroid: apex,
            };
        }
        for i in 0..nodes.len() {
            let triangle = self.fan_area(apex, nodes[i], nodes[(i + 1) % nodes.len()]);
            area_vector = add_scaled(area_vector, 1.0, triangle);
        }
        for i in 0..nodes.len() {
            let (p, q) = (nodes[i], nodes[(i + 1) % nodes.len()]);
            // The signed area of this triangle, seen along the face's normal.
            let weight_part = dot(self.fan_area(apex, p, q), area_vector);
            let (p, q) = (self.nodes[p as usize], self.nodes[q as usize]);
            weight += weight_part;
            centroid = std::array::from_fn(|k| {
                centroid[k] + weight_part * (p[k] - apex[k] + q[k] - apex[k]) / 3.0
            });
        }
        if weight > 0.0 {
            centroid = std::array::from_fn(|k| apex[k] + centroid[k] / weight);
        } else {
            centroid = apex;
        }
        FaceShape {
            apex,
            area_vector,
            centroid,
        }
    }

    /// Returns the area vector of the triangle (apex, p, q), or in 2-D of the edge (p, q).
    #[inline]
    pub(super) fn fan_area(&self, apex: [f64; D], p: u32, q: u32) -> [f64; D] {
        let (p, q) = (&self.nodes[p as usize], &self.nodes[q as usize]);
        let mut area = [0.0; D];
        if D == 2 {
            area[0] = q[1] - p[1];
            area[1] = p[0] - q[0];
        } else {
            let u = sub(*p, apex);
            let v = sub(*q, apex);
            for k in 0..D {
                let (a, b) = ((k + 1) % D, (k + 2) % D);
                area[k] = 0.5 * (u[a] * v[b] - u[b] * v[a]);
            }
        }
        area
    }

    /// Returns the skewness of face `f`, given the centroids of cells, as OpenFOAM's `checkMesh` measures
    /// it: the distance of the face's centroid from the point at which the line between the centroids
    /// of its cells (on the boundary, the normal from the cell's centroid) crosses the face's plane. It
    /// is relative to the face's reach in that direction or, if this is larger, to a fifth of the
    /// distance between the centroids (two fifths of the distance from the boundary).
    pub fn face_skewness(&self, f: usize, centroid: impl Fn(usize) -> [f64; D]) -> f64 {
        let shape = self.face_shape(f);
        let normal = shape.area_vector;
        let owner = centroid(self.face_cells[f][0] as usize);
        let to_face = sub(shape.centroid, owner);
        let height = dot(normal, to_face);
        let (line, min_reach) = match self.face_neighbour(f) {
            FaceNeighbour::Cell(other) => (sub(centroid(other), owner), 0.2),
            _ => (normal.map(|c| c * height / dot(normal, normal)), 0.4),
        };
        let offset = add_scaled(to_face, -height / dot(normal, line), line);
        let distance = norm(offset);
        if distance.is_nan() || distance <= 0.0 {
            return 0.0;
        }
        let along =
            |n: &u32| dot(sub(self.nodes[*n as usize], shape.centroid), offset).abs() / distance;
        let reach = self
            .faces
            .get(f)
            .iter()
            .map(along)
            .fold(min_reach * norm(line), f64::max);
        distance / reach
    }

    /// Returns the volume (area in 2-D) and the centroid of a cell, given its faces.
    ///
    /// The cell is the sum of pyramids with their tops in the site, one on every triangle of its
    /// faces' fans. Both cells of a face use the same fan, so volumes add up exactly even if a face
    /// is not flat.
    pub fn cell_shape(&self, cell: usize, faces: &[u32]) -> (f64, [f64; D]) {
        let site = self.sites[cell];
        let mut volume = 0.0;
        let mut moment = [0.0; D];
        for &f in faces {
            let sign = if self.face_cells[f as usize][0] as usize == cell {
                1.0
            } else {
                -1.0
            };
            let nodes = self.faces.get(f as usize);
            let apex = self.face_apex(f as usize);
            let from_site = sub(apex, site);
            let triangles = if D == 2 { 1 } else { nodes.len() };
            for i in 0..triangles {
                let (p, q) = (nodes[i], nodes[(i + 1) % nodes.len()]);
                let pyramid = sign * dot(from_site, self.fan_area(apex, p, q)) / D as f64;
                volume += pyramid;
                let (p, q) = (&self.nodes[p as usize], &self.nodes[q as usize]);
                for k in 0..D {
                    let sum = p[k] + q[k] - 2.0 * site[k] + if D == 2 { 0.0 } else { from_site[k] };
                    moment[k] += pyramid * sum / (D + 1) as f64;
                }
            }
        }
        let centroid = std::array::from_fn(|k| {
            if volume > 0.0 {
                site[k] + moment[k] / volume
            } else {
                site[k]
            }
        });
        (volume, centroid)
    }

    /// Calls `visit` with the volume (area in 2-D) and the corners of each simplex of which a cell is
    /// the sum, given its faces: see [`cell_shape`](Self::cell_shape).
    pub fn for_each_simplex(
        &self,
        cell: usize,
        faces: &[u32],
        mut visit: impl FnMut(f64, &[[f64; D]]),
    ) {
        let site = self.sites[cell];
        for &f in faces {
            let is_owner = self.face_cells[f as usize][0] as usize == cell;
            let sign = if is_owner { 1.0 } else { -1.0 };
            let nodes = self.faces.get(f as usize);
            let apex = self.face_apex(f as usize);
            let from_site = sub(apex, site);
            let triangles = if D == 2 { 1 } else { nodes.len() };
            for i in 0..triangles {
                let (p, q) = (nodes[i], nodes[(i + 1) % nodes.len()]);
                let volume = sign * dot(from_site, self.fan_area(apex, p, q)) / D as f64;
                let [p, q] = [p, q].map(|n| self.nodes[n as usize]);
                visit(volume, &[site, p, q, apex][..=D]);
            }
        }
    }

    /// Returns the volume (area in 2-D) and the centroid of every cell.
    pub fn cell_shapes(&self) -> Vec<(f64, [f64; D])> {
        let faces = self.faces_of_cells();
        (0..self.sites.len())
            .into_par_iter()
            .map(|cell| self.cell_shape(cell, faces.get(cell)))
            .collect()
    }

    /// Assigns every face on the boundary to the side of the box `[low, high]` in which it lies. A
    /// face that lies in no side (the top and the base of columns) gets the side whose outward
    /// normal is nearest to its own.
    pub fn assign_sides(&mut self, low: [f64; D], high: [f64; D]) {
        for f in self.inner_face_count()..self.face_cells.len() {
            let normal = self.face_shape(f).area_vector;
            let outward_component =
                |side: &usize| normal[side / 2] * if side % 2 == 1 { 1.0 } else { -1.0 };
            let side = self.containing_side(f, low, high).or_else(|| {
                (0..2 * D).max_by(|s, t| outward_component(s).total_cmp(&outward_component(t)))
            });
            self.face_cells[f][1] = FIRST_SIDE + side.unwrap_or(0) as u32;
        }
    }

    /// Assigns every face on the boundary that lies in no other side of the box `[low, high]` to `bent_side`.
    pub fn assign_bent_side(&mut self, bent_side: usize, low: [f64; D], high: [f64; D]) {
        for f in self.inner_face_count()..self.face_cells.len() {
            if self.containing_side(f, low, high).is_none() {
                self.face_cells[f][1] = FIRST_SIDE + bent_side as u32;
            }
        }
    }

    /// Takes the side from every upright face on the boundary that lies in no side of the box
    /// `[low, high]`. Such faces are at faults that offset columns.
    pub fn release_fault_sides(&mut self, low: [f64; D], high: [f64; D]) {
        for f in self.inner_face_count()..self.face_cells.len() {
            if self.is_upright(f) && self.containing_side(f, low, high).is_none() {
                self.face_cells[f][1] = NONE;
            }
        }
    }

    /// Takes the side from every face on the boundary for whose nodes `feature_mark` returns whether it
    /// lies on a feature.
    pub fn release_sides(&mut self, feature_mark: impl Fn(&[u32]) -> Option<bool>) {
        for f in self.inner_face_count()..self.face_cells.len() {
            if let Some(on_feature) = feature_mark(self.faces.get(f)) {
                self.face_cells[f][1] = NONE;
                self.on_feature[f] = on_feature;
            }
        }
    }

    /// Returns the side of the box `[low, high]` in which a face lies, within a millionth of the box.
    fn containing_side(&self, f: usize, low: [f64; D], high: [f64; D]) -> Option<usize> {
        let longest = (0..D).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let max_offset = |side: &usize| {
            let plane = if side.is_multiple_of(2) { low } else { high }[side / 2];
            let nodes = self.faces.get(f).iter();
            nodes.fold(0.0, |max: f64, &n| {
                max.max((self.nodes[n as usize][side / 2] - plane).abs())
            })
        };
        let nearest = (0..2 * D).min_by(|s, t| max_offset(s).total_cmp(&max_offset(t)));
        nearest.filter(|side| max_offset(side) <= 1e-6 * longest)
    }

    /// Returns the mesh after an affine map of all nodes and sites. `mirrored` says that the map
    /// reverses orientation, so that all faces are reversed too.
    pub fn mapped(&self, map: impl Fn([f64; D]) -> [f64; D] + Sync, mirrored: bool) -> Self {
        let map_all = |points: &[[f64; D]]| points.par_iter().map(|&p| map(p)).collect();
        let mut mesh = Self {
            nodes: map_all(&self.nodes),
            sites: map_all(&self.sites),
            ..self.clone()
        };
        if mirrored {
            mesh.reverse_faces();
        }
        mesh
    }

    /// Reverses the orientation of all faces.
    pub(super) fn reverse_faces(&mut self) {
        for range in self.faces.offsets.windows(2) {
            self.faces.items[range[0] as usize..range[1] as usize].reverse();
        }
    }
}

/// Meshes for tests.
#[cfg(test)]
pub(crate) mod samples {
    use super::*;

    /// Returns the box `[0, 2] x [0, 1]^(D-1)`, cut at x = `cut` into two cells whose sites are
    /// half a unit from the cut.
    pub fn two_cells<const D: usize>(cut: f64) -> PolyMesh<D> {
        let xs = [0.0, cut, 2.0];
        let corner_count = 1usize << (D - 1);
        let mut nodes = Vec::new();
        for x in xs {
            for c in 0..corner_count {
                let mut p = [0.0; D];
                p[0] = x;
                for k in 1..D {
                    p[k] = (c >> (k - 1) & 1) as f64;
                }
                nodes.push(p);
            }
        }
        let mut mesh = PolyMesh {
            nodes,
            sites: [cut - 0.5, cut + 0.5]
                .map(|x| {
                    let mut p = [0.5; D];
                    p[0] = x;
                    p
                })
                .to_vec(),
            region: vec![0, 1],
            ..PolyMesh::default()
        };
        let mut add_face = |nodes: &[u32], cells: [u32; 2]| {
            mesh.faces.push(nodes.iter().copied());
            mesh.face_cells.push(cells);
            mesh.on_feature.push(cells[1] < FIRST_SIDE);
        };
        if D == 2 {
            add_face(&[2, 3], [0, 1]);
            add_face(&[1, 0], [0, FIRST_SIDE]);
            add_face(&[0, 2], [0, FIRST_SIDE + 2]);
            add_face(&[3, 1], [0, FIRST_SIDE + 3]);
            add_face(&[4, 5], [1, FIRST_SIDE + 1]);
            add_face(&[2, 4], [1, FIRST_SIDE + 2]);
            add_face(&[5, 3], [1, FIRST_SIDE + 3]);
        } else {
            add_face(&[4, 5, 7, 6], [0, 1]);
            add_face(&[0, 2, 3, 1], [0, FIRST_SIDE]);
            for (cell, low) in [(0, 0), (1, 4)] {
                if cell == 1 {
                    add_face(&[8, 9, 11, 10], [1, FIRST_SIDE + 1]);
                }
                add_face(&[low, low + 4, low + 6, low + 2], [cell, FIRST_SIDE + 2]);
                add_face(
                    &[low + 1, low + 3, low + 7, low + 5],
                    [cell, FIRST_SIDE + 3],
                );
                add_face(&[low, low + 1, low + 5, low + 4], [cell, FIRST_SIDE + 4]);
                add_face(
                    &[low + 2, low + 6, low + 7, low + 3],
                    [cell, FIRST_SIDE + 5],
                );
            }
        }
        mesh
    }
}

#[cfg(test)]
mod tests {
    use super::samples::two_cells;
    use super::*;

    fn volumes_and_centres<const D: usize>() {
        let mesh = two_cells::<D>(0.75);
        let shapes = mesh.cell_shapes();
        for (cell, (volume, x)) in [(0, (0.75, 0.375)), (1, (1.25, 1.375))] {
            let mut centre = [0.5; D];
            centre[0] = x;
            assert!((shapes[cell].0 - volume).abs() < 1e-15, "{shapes:?}");
            assert!((0..D).all(|k| (shapes[cell].1[k] - centre[k]).abs() < 1e-15));
        }
        for f in 0..mesh.face_cells.len() {
            let shape = mesh.face_shape(f);
            // The faces of the owner point away from its site.
            let site = mesh.sites[mesh.face_cells[f][0] as usize];
            let out = sub(shape.centroid, site);
            assert!(dot(out, shape.area_vector) > 0.0, "face {f}");
            if let FaceNeighbour::Side(side) = mesh.face_neighbour(f) {
                let (axis, upper) = (side / 2, side % 2 == 1);
                assert!((shape.area_vector[axis] > 0.0) == upper);
                assert_eq!(shape.area(), shape.area_vector[axis].abs());
            }
        }
        assert_eq!(mesh.inner_face_count(), 1);
        assert_eq!(mesh.face_neighbour(0), FaceNeighbour::Cell(1));
        // The map doubles the width and mirrors along x.
        let map = |p: [f64; D]| std::array::from_fn(|k| if k == 0 { -2.0 * p[0] } else { p[k] });
        let mirrored = mesh.mapped(map, true);
        assert_eq!(mirrored.cell_shapes()[0].0, 1.5);
    }

    #[test]
    fn skewness_is_the_offset_over_the_reach_of_a_face() {
        let mesh = two_cells::<3>(1.0);
        let centroid = |x: f64, offset: f64| [x, 0.5 + offset, 0.5];
        assert_eq!(mesh.face_skewness(0, |c| mesh.cell_shapes()[c].1), 0.0);
        for offset in [-0.4, 0.1, 0.3] {
            // The face is half a unit wide beside its centroid: more than a fifth of the distance 1.
            let skewness = mesh.face_skewness(0, |c| centroid(0.5 + c as f64, offset));
            assert!((skewness - offset.abs() / 0.5).abs() < 1e-15, "{skewness}");
            // At a distance of 10, a fifth of it is 2.
            let skewness = mesh.face_skewness(0, |c| centroid(-4.0 + 10.0 * c as f64, offset));
            assert!((skewness - offset.abs() / 2.0).abs() < 1e-15, "{skewness}");
        }
        // The face at x = 0, seen from a centroid at distance 5.
        let side = (0..mesh.face_cells.len()).find(|&f| mesh.face_shape(f).area_vector[0] < 0.0);
        let skewness = mesh.face_skewness(side.unwrap(), |_| centroid(5.0, 0.3));
        assert!((skewness - 0.3 / 2.0).abs() < 1e-15, "{skewness}");
    }

    #[test]
    fn volumes_and_centres_of_boxes_are_exact() {
        volumes_and_centres::<2>();
        volumes_and_centres::<3>();
    }
}
