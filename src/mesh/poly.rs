//! Meshes of polyhedra (polygons in 2-D): every face once, with the cell on either side.
//!
//! ```text
//!            nodes of face f turn anticlockwise      a = face_cells[f][0], its owner
//!    a       seen from b: its normal points          b = face_cells[f][1], a higher number,
//!  -----▶ b  from a to b                                 or a side of the box: SIDE_0 + side
//! ```
//!
//! In 2-D a face is an edge (p, q), and its owner lies to the left of p -> q.

use crate::geometry::dot;
use crate::parallel::prelude::*;

/// Numbers from here on in [`PolyMesh::face_cells`] are sides of the box: `SIDE_0 + 2 axis` is the lower
/// one, `SIDE_0 + 2 axis + 1` the upper one.
pub const FIRST_SIDE: u32 = u32::MAX - 6;

/// The names of the box's sides, in the order of their numbers.
pub const SIDE_NAMES: [&str; 6] = ["xmin", "xmax", "ymin", "ymax", "zmin", "zmax"];

/// Beyond a face on the boundary of a mesh that fills no box.
pub const NO_CELL: u32 = u32::MAX;

/// Lists of numbers, one after the other: list i is `items[offsets[i]..offsets[i + 1]]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lists {
    /// Where each list begins, and where the last one ends.
    pub offsets: Vec<u32>,
    /// What the lists hold.
    pub items: Vec<u32>,
}

impl Default for Lists {
    /// No lists.
    fn default() -> Self {
        Self {
            offsets: vec![0],
            items: Vec::new(),
        }
    }
}

impl Lists {
    /// Number of lists.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// List `i`.
    #[inline]
    pub fn get(&self, i: usize) -> &[u32] {
        &self.items[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }

    /// Puts a list behind the others.
    pub fn push(&mut self, list: impl IntoIterator<Item = u32>) {
        self.items.extend(list);
        self.offsets.push(self.items.len() as u32);
    }
}

/// A mesh of convex cells in one space (lattice or physical; the owner says which), in flat arrays.
///
/// Faces between cells come first, ordered by owner and then by the cell beyond; then the faces on
/// the sides of the box, ordered by owner and side.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PolyMesh<const D: usize> {
    /// Node positions.
    pub nodes: Vec<[f64; D]>,
    /// The nodes of each face, in order round it (two in 2-D).
    pub faces: Lists,
    /// For each face its owner, and the cell or the side of the box beyond it.
    pub face_cells: Vec<[u32; 2]>,
    /// The point that each cell belongs to (its atom).
    pub sites: Vec<[f64; D]>,
    /// The region of each cell.
    pub region: Vec<i32>,
    /// Whether each face lies on a feature of the image.
    pub on_feature: Vec<bool>,
}

/// What is beyond a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaceNeighbour {
    /// Another cell.
    Cell(usize),
    /// A side of the box: 2 axis for the lower one, 2 axis + 1 for the upper one.
    Side(usize),
    /// Nothing that is known.
    Unknown,
}

/// A face as the integral formulas see it: a fan of triangles (one edge in 2-D) round `apex`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceShape<const D: usize> {
    /// The mean of the face's nodes.
    pub apex: [f64; D],
    /// The normal, from the owner to what is beyond, times the area.
    pub area_vector: [f64; D],
    /// The centre of the area; the apex if there is no area.
    pub centroid: [f64; D],
}

impl<const D: usize> FaceShape<D> {
    /// Length of the area vector: the area, as the face is flat.
    pub fn area(&self) -> f64 {
        dot(self.area_vector, self.area_vector).sqrt()
    }
}

impl<const D: usize> PolyMesh<D> {
    /// What is beyond face `f`.
    #[inline]
    pub fn face_neighbour(&self, f: usize) -> FaceNeighbour {
        match self.face_cells[f][1] {
            NO_CELL => FaceNeighbour::Unknown,
            side if side >= FIRST_SIDE => FaceNeighbour::Side((side - FIRST_SIDE) as usize),
            cell => FaceNeighbour::Cell(cell as usize),
        }
    }

    /// The number of faces between cells; they come before the faces on the boundary.
    pub fn inner_face_count(&self) -> usize {
        self.face_cells.partition_point(|c| c[1] < FIRST_SIDE)
    }

    /// The faces of each cell, ascending.
    pub fn faces_of_cells(&self) -> Lists {
        let mut offsets = vec![0u32; self.sites.len() + 1];
        let inside = |c: &[u32; 2]| [Some(c[0]), (c[1] < FIRST_SIDE).then_some(c[1])];
        for cell in self.face_cells.iter().flat_map(inside).flatten() {
            offsets[cell as usize + 1] += 1;
        }
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let mut next = offsets.clone();
        let mut items = vec![0u32; offsets.last().map_or(0, |&n| n as usize)];
        for (f, cells) in self.face_cells.iter().enumerate() {
            for cell in inside(cells).into_iter().flatten() {
                let at = &mut next[cell as usize];
                items[*at as usize] = f as u32;
                *at += 1;
            }
        }
        Lists { offsets, items }
    }

    /// Area, normal and centre of face `f`.
    pub fn face_shape(&self, f: usize) -> FaceShape<D> {
        let nodes = self.faces.get(f);
        let mut apex = [0.0; D];
        for &n in nodes {
            apex = std::array::from_fn(|k| apex[k] + self.nodes[n as usize][k]);
        }
        apex = apex.map(|c| c / nodes.len() as f64);
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
            let part = self.fan_area(apex, nodes[i], nodes[(i + 1) % nodes.len()]);
            area_vector = std::array::from_fn(|k| area_vector[k] + part[k]);
        }
        for i in 0..nodes.len() {
            let (p, q) = (nodes[i], nodes[(i + 1) % nodes.len()]);
            // The signed area of this triangle seen along the face's normal.
            let part = dot(self.fan_area(apex, p, q), area_vector);
            let (p, q) = (self.nodes[p as usize], self.nodes[q as usize]);
            weight += part;
            centroid = std::array::from_fn(|k| {
                centroid[k] + part * (p[k] - apex[k] + q[k] - apex[k]) / 3.0
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

    /// The area vector of the triangle (apex, p, q), or in 2-D of the edge (p, q).
    #[inline]
    pub(super) fn fan_area(&self, apex: [f64; D], p: u32, q: u32) -> [f64; D] {
        let (p, q) = (&self.nodes[p as usize], &self.nodes[q as usize]);
        let mut area = [0.0; D];
        if D == 2 {
            area[0] = q[1] - p[1];
            area[1] = p[0] - q[0];
        } else {
            let u: [f64; D] = std::array::from_fn(|k| p[k] - apex[k]);
            let v: [f64; D] = std::array::from_fn(|k| q[k] - apex[k]);
            for k in 0..D {
                let (a, b) = ((k + 1) % D, (k + 2) % D);
                area[k] = 0.5 * (u[a] * v[b] - u[b] * v[a]);
            }
        }
        area
    }

    /// Volume (area in 2-D) and centroid of a cell, given its faces.
    ///
    /// The cell is a pyramid on every triangle of its faces' fans, with its top in the site. Each
    /// face is the same fan for both cells, so that volumes add up whether it is flat or not.
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
            let mut apex = [0.0; D];
            for &n in nodes {
                apex = std::array::from_fn(|k| apex[k] + self.nodes[n as usize][k]);
            }
            apex = apex.map(|c| c / nodes.len() as f64);
            let from: [f64; D] = std::array::from_fn(|k| apex[k] - site[k]);
            let triangles = if D == 2 { 1 } else { nodes.len() };
            for i in 0..triangles {
                let (p, q) = (nodes[i], nodes[(i + 1) % nodes.len()]);
                let part = sign * dot(from, self.fan_area(apex, p, q)) / D as f64;
                volume += part;
                let (p, q) = (&self.nodes[p as usize], &self.nodes[q as usize]);
                for k in 0..D {
                    let sum = p[k] + q[k] - 2.0 * site[k] + if D == 2 { 0.0 } else { from[k] };
                    moment[k] += part * sum / (D + 1) as f64;
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

    /// Volume (area in 2-D) and centroid of every cell.
    pub fn cell_shapes(&self) -> Vec<(f64, [f64; D])> {
        let faces = self.faces_of_cells();
        (0..self.sites.len())
            .into_par_iter()
            .map(|cell| self.cell_shape(cell, faces.get(cell)))
            .collect()
    }

    /// Assigns every face on the boundary to the side of the box `[low, high]` in which it lies; if it
    /// lies in none (as the top and the base of columns do), to the one that looks the same way.
    pub fn assign_sides(&mut self, low: [f64; D], high: [f64; D]) {
        let longest = (0..D).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        for f in self.inner_face_count()..self.face_cells.len() {
            let normal = self.face_shape(f).area_vector;
            let turned = |side: usize| normal[side / 2] * if side % 2 == 1 { 1.0 } else { -1.0 };
            let off = |side: usize| {
                let plane = if side.is_multiple_of(2) { low } else { high }[side / 2];
                let nodes = self.faces.get(f).iter();
                nodes.fold(0.0, |most: f64, &n| {
                    most.max((self.nodes[n as usize][side / 2] - plane).abs())
                })
            };
            let sides = 0..2 * D;
            let nearest = sides.clone().min_by(|&s, &t| off(s).total_cmp(&off(t)));
            let side = match nearest {
                Some(side) if off(side) > 1e-6 * longest => {
                    sides.max_by(|&s, &t| turned(s).total_cmp(&turned(t)))
                }
                nearest => nearest,
            };
            self.face_cells[f][1] = FIRST_SIDE + side.unwrap_or(0) as u32;
        }
    }

    /// The mesh with every position (nodes and sites) sent through an affine map; `mirrored` says
    /// that the map turns left into right, and so all faces round.
    pub fn mapped(&self, map: impl Fn([f64; D]) -> [f64; D] + Sync, mirrored: bool) -> Self {
        let all = |points: &[[f64; D]]| points.par_iter().map(|&p| map(p)).collect();
        let mut mesh = Self {
            nodes: all(&self.nodes),
            sites: all(&self.sites),
            ..self.clone()
        };
        if mirrored {
            mesh.reverse_faces();
        }
        mesh
    }

    /// Turns all faces round.
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

    /// The box `[0, 2] x [0, 1]^(D-1)`, cut at x = `cut` into two cells whose sites are half a unit
    /// from the cut.
    pub fn two_cells<const D: usize>(cut: f64) -> PolyMesh<D> {
        let xs = [0.0, cut, 2.0];
        let others = 1usize << (D - 1);
        let mut nodes = Vec::new();
        for x in xs {
            for c in 0..others {
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
        let mut put = |nodes: &[u32], cells: [u32; 2]| {
            mesh.faces.push(nodes.iter().copied());
            mesh.face_cells.push(cells);
            mesh.on_feature.push(cells[1] < FIRST_SIDE);
        };
        if D == 2 {
            put(&[2, 3], [0, 1]);
            put(&[1, 0], [0, FIRST_SIDE]);
            put(&[0, 2], [0, FIRST_SIDE + 2]);
            put(&[3, 1], [0, FIRST_SIDE + 3]);
            put(&[4, 5], [1, FIRST_SIDE + 1]);
            put(&[2, 4], [1, FIRST_SIDE + 2]);
            put(&[5, 3], [1, FIRST_SIDE + 3]);
        } else {
            put(&[4, 5, 7, 6], [0, 1]);
            put(&[0, 2, 3, 1], [0, FIRST_SIDE]);
            for (cell, low) in [(0, 0), (1, 4)] {
                if cell == 1 {
                    put(&[8, 9, 11, 10], [1, FIRST_SIDE + 1]);
                }
                put(&[low, low + 4, low + 6, low + 2], [cell, FIRST_SIDE + 2]);
                put(
                    &[low + 1, low + 3, low + 7, low + 5],
                    [cell, FIRST_SIDE + 3],
                );
                put(&[low, low + 1, low + 5, low + 4], [cell, FIRST_SIDE + 4]);
                put(
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
            // Owner's faces point away from its site.
            let site = mesh.sites[mesh.face_cells[f][0] as usize];
            let out: [f64; D] = std::array::from_fn(|k| shape.centroid[k] - site[k]);
            assert!(dot(out, shape.area_vector) > 0.0, "face {f}");
            if let FaceNeighbour::Side(side) = mesh.face_neighbour(f) {
                let (axis, upper) = (side / 2, side % 2 == 1);
                assert!((shape.area_vector[axis] > 0.0) == upper);
                assert_eq!(shape.area(), shape.area_vector[axis].abs());
            }
        }
        assert_eq!(mesh.inner_face_count(), 1);
        assert_eq!(mesh.face_neighbour(0), FaceNeighbour::Cell(1));
        // Twice as wide and mirrored along x.
        let map = |p: [f64; D]| std::array::from_fn(|k| if k == 0 { -2.0 * p[0] } else { p[k] });
        let mirrored = mesh.mapped(map, true);
        assert_eq!(mirrored.cell_shapes()[0].0, 1.5);
    }

    #[test]
    fn volumes_and_centres_of_boxes_are_exact() {
        volumes_and_centres::<2>();
        volumes_and_centres::<3>();
    }
}
