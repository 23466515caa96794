//! Interfaces of meshes: [`Mesh`] for all meshes, whatever their cells are, and [`Simplices`] for
//! meshes of triangles or tetrahedra.
//!
//! ```text
//!   Mesh<D>        nodes, faces cut into facets, the cells on either side, volumes and centres
//!    ├─ Simplices<D>   corners, neighbours, angles: TriMesh (D = 2), TetMesh (D = 3)
//!    └─ PolyMesh<D>    polygons (D = 2), polyhedra (D = 3)
//! ```

use std::fmt::Debug;
use std::ops::Range;

use crate::parallel::prelude::*;

use super::check::CellChecks;
use super::complex::{self, NONE};
use super::poly::{FaceNeighbour, Lists, PolyMesh};
use super::quality::{self, BLOCK_SIZE, CornerBlock, SimplexShape, SimplexShapeBlock};
use super::{TetMesh, TriMesh, tri};
use crate::error::cause;
use crate::geometry::{cross, hypot, norm, sorted, sub, volume6};
use crate::{Error, Result};

/// A mesh of any cells: triangles or polygons in 2-D, tetrahedra or polyhedra in 3-D.
///
/// Faces are numbered as in [`Connection::face`](super::graph::Connection::face): face k of simplex
/// c is `(D + 1) c + k`, so that a face between two simplices has two numbers. Polyhedra and
/// polygons have one number for each face.
pub trait Mesh<const D: usize>: Clone + Debug + Send + Sync + CellChecks<D> + 'static {
    /// Name of the cells, in the plural.
    const CELLS_NAME: &'static str;
    /// Name of the measure of a cell.
    const VOLUME_NAME: &'static str = if D == 2 { "area" } else { "volume" };
    /// VTK's cell type.
    const VTK_CELL: u8;

    /// Node positions.
    fn nodes(&self) -> &[[f64; D]];

    /// Number of cells.
    fn len(&self) -> usize;

    /// Returns `true` if there are no cells.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the number of face numbers; a face between two simplices counts twice.
    fn face_count(&self) -> usize;

    /// Calls `visit` for each facet of a face: triangles in 3-D, edges in 2-D. Their normals point
    /// out of the face's first cell.
    fn facets(&self, face: usize, visit: impl FnMut([u32; D]));

    /// Returns every face once: its nodes in order, and whether it is marked. `marks` has an entry
    /// for each face number, or is empty.
    fn unique_faces(&self, marks: &[bool]) -> (Lists, Vec<bool>);

    /// Returns for each face number its cell and the cell beyond it, `NONE` on the boundary. If two
    /// numbers stand for one face, the second has `NONE` twice.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if more than two cells share a face.
    fn cells_of_faces(&self) -> Result<Vec<[u32; 2]>>;

    /// Returns the volume (area in 2-D) and the centroid of each cell.
    fn cell_volumes(&self) -> Vec<(f64, [f64; D])>;

    /// Returns only the volumes of [`cell_volumes`](Self::cell_volumes).
    fn volumes(&self) -> Vec<f64> {
        let shapes = self.cell_volumes().into_par_iter();
        shapes.map(|(volume, _)| volume).collect()
    }

    /// Returns the mean over each cell of a value that `value` returns for a simplex, given its
    /// `D + 1` corners. A cell that is no simplex is cut into simplices from its site.
    fn mean_over_simplices(&self, value: impl Fn(&[[f64; D]]) -> f64 + Sync) -> Vec<f64>;

    /// Returns a function from cell to centroid, as in [`cell_volumes`](Self::cell_volumes).
    /// Centroids of simplices are computed on demand, since there may be a hundred million cells.
    fn centres(&self) -> Centres<'_, D>;

    /// Swaps all positions of the mesh with `others`. If one of the two spaces mirrors the other,
    /// every cell is reversed, so that all stay positively oriented.
    fn swap_positions(&mut self, others: &mut Positions<D>, mirrored: bool);

    /// Returns all positions after `map`, or `None` if `map` returns `None` for one of them.
    fn mapped_positions(
        &self,
        map: impl Fn(&[f64; D]) -> Option<[f64; D]> + Sync + Send,
    ) -> Option<Positions<D>>;
}

/// Function that returns the centroid of a cell.
pub type Centres<'a, const D: usize> = Box<dyn Fn(usize) -> [f64; D] + Sync + 'a>;

/// Positions of a mesh in one space.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Positions<const D: usize> {
    /// Node positions.
    pub nodes: Vec<[f64; D]>,
    /// Sites of polyhedra and polygons; empty for simplices.
    pub sites: Vec<[f64; D]>,
}

/// A mesh of D-simplices: triangles in 2-D, tetrahedra in 3-D. Code for this trait works for both.
///
/// Face k of a cell (an edge in 2-D) is the face opposite its node k.
pub trait Simplices<const D: usize>: Mesh<D> {
    /// Name in files of the array with the smallest angle of each cell.
    const MIN_ANGLE_ARRAY: &'static str = if D == 2 { "min_angle" } else { "min_dihedral" };
    /// Name in files of the array with the smallest angle of each cell in physical space.
    const PHYSICAL_ANGLE_ARRAY: &'static str = if D == 2 {
        "min_angle_physical"
    } else {
        "min_dihedral_physical"
    };
    /// Name in files of the array that marks the faces on features: bit k of a cell's byte stands
    /// for the face opposite node k.
    const FEATURE_FACES_ARRAY: &'static str = if D == 2 {
        "feature_edges"
    } else {
        "feature_faces"
    };
    /// The cosines of a cell's angles.
    type Cosines: AsRef<[f64]>;

    /// Creates a mesh from nodes and cells; `corners` has D + 1 node numbers for each cell.
    fn from_parts(nodes: Vec<[f64; D]>, corners: Vec<u32>) -> Self;

    /// Returns a mesh with the same cells and other nodes.
    fn with_nodes(&self, nodes: Vec<[f64; D]>) -> Self;

    /// Returns the node positions and the node numbers, D + 1 for each cell, positively oriented.
    fn parts(&self) -> (&[[f64; D]], &[u32]);

    /// Returns mutable [`parts`](Self::parts).
    fn parts_mut(&mut self) -> (&mut Vec<[f64; D]>, &mut [u32]);

    /// Returns the node numbers, D + 1 for each cell, positively oriented.
    fn connectivity(&self) -> &[u32] {
        self.parts().1
    }

    /// Returns the node numbers of cell `c`.
    fn cell(&self, c: usize) -> &[u32] {
        &self.connectivity()[(D + 1) * c..(D + 1) * (c + 1)]
    }

    /// Returns the node numbers of face `k` of cell `c`, in the cell's order.
    fn face(&self, c: usize, k: usize) -> [u32; D] {
        let cell = self.cell(c);
        std::array::from_fn(|i| cell[i + usize::from(i >= k)])
    }

    /// Returns the signed volume (area in 2-D) of cell `c`.
    fn volume(&self, c: usize) -> f64;

    /// Returns for every cell and face, in order, the cell on its other side, or `NONE`.
    ///
    /// # Errors
    /// Returns the nodes of a face that more than two cells share.
    fn neighbours(&self) -> std::result::Result<Vec<u32>, Vec<u32>>;

    /// Returns the area of a face (in 2-D: the length of an edge).
    fn face_area(face: &[[f64; D]; D]) -> f64;

    /// Measures the shape of cell `c`.
    fn shape(&self, c: usize) -> SimplexShape<Self::Cosines>;

    /// Returns the smallest sine of the angles of cell `c`; negative if the cell is inverted.
    fn min_sine(&self, c: usize) -> f64 {
        let shape = self.shape(c);
        let cosines = shape.cosines.as_ref().iter();
        let max_cosine = cosines.fold(0.0, |max, cosine| cosine.abs().max(max));
        let sine = (1.0 - max_cosine * max_cosine).max(0.0).sqrt();
        if shape.volume > 0.0 { sine } else { -sine }
    }

    /// Measures the shapes of a range of cells, in order.
    fn shapes(&self, cells: Range<usize>, mut visit: impl FnMut(SimplexShape<Self::Cosines>)) {
        for c in cells {
            visit(self.shape(c));
        }
    }
}

impl<const D: usize, M: Simplices<D>> Mesh<D> for M {
    const CELLS_NAME: &'static str = if D == 2 { "triangles" } else { "tetrahedra" };
    const VTK_CELL: u8 = if D == 2 { 5 } else { 10 };

    fn nodes(&self) -> &[[f64; D]] {
        self.parts().0
    }

    fn len(&self) -> usize {
        self.connectivity().len() / (D + 1)
    }

    fn face_count(&self) -> usize {
        self.connectivity().len()
    }

    fn facets(&self, face: usize, mut visit: impl FnMut([u32; D])) {
        let (cell, k) = (face / (D + 1), face % (D + 1));
        let mut facet = self.face(cell, k);
        // Removing a node at an odd position reverses the orientation of the others.
        if k % 2 == 1 {
            facet.swap(0, 1);
        }
        visit(facet);
    }

    fn unique_faces(&self, marks: &[bool]) -> (Lists, Vec<bool>) {
        let mut faces: Vec<([u32; D], bool)> = Vec::with_capacity(self.face_count());
        for index in 0..self.face_count() {
            let face = sorted(self.face(index / (D + 1), index % (D + 1)));
            faces.push((face, !marks.get(index).is_some_and(|mark| *mark)));
        }
        // `false` (marked) sorts first, so deduplication keeps a marked side.
        faces.sort_unstable();
        faces.dedup_by_key(|(face, _)| *face);
        let lists = Lists {
            offsets: (0..=faces.len() as u32).map(|f| D as u32 * f).collect(),
            items: faces.iter().flat_map(|(face, _)| *face).collect(),
        };
        (lists, faces.iter().map(|(_, unmarked)| !unmarked).collect())
    }

    fn cells_of_faces(&self) -> Result<Vec<[u32; 2]>> {
        let neighbours = self.neighbours().map_err(|face| {
            Error::Mesh(cause(
                "mesh",
                format!("more than two {} share the face {face:?}", M::CELLS_NAME),
                "run atomesh validate",
            ))
        })?;
        let cells = neighbours.into_iter().enumerate().map(|(face, beyond)| {
            let cell = (face / (D + 1)) as u32;
            // NONE is greater than every cell number.
            if beyond > cell {
                [cell, beyond]
            } else {
                [NONE; 2]
            }
        });
        Ok(cells.collect())
    }

    fn cell_volumes(&self) -> Vec<(f64, [f64; D])> {
        let centre = self.centres();
        (0..self.len())
            .into_par_iter()
            .map(|c| (self.volume(c), centre(c)))
            .collect()
    }

    fn volumes(&self) -> Vec<f64> {
        (0..self.len())
            .into_par_iter()
            .map(|c| self.volume(c))
            .collect()
    }

    fn mean_over_simplices(&self, value: impl Fn(&[[f64; D]]) -> f64 + Sync) -> Vec<f64> {
        let nodes = self.nodes();
        let value = |c: usize| {
            let mut corners = [[0.0; D]; 4];
            for (corner, &node) in corners.iter_mut().zip(self.cell(c)) {
                *corner = nodes[node as usize];
            }
            value(&corners[..=D])
        };
        (0..self.len()).into_par_iter().map(value).collect()
    }

    fn centres(&self) -> Centres<'_, D> {
        Box::new(|c| {
            let nodes = self.cell(c).iter().map(|&n| self.nodes()[n as usize]);
            nodes.fold([0.0; D], |sum, x| {
                std::array::from_fn(|k| sum[k] + x[k] / (D + 1) as f64)
            })
        })
    }

    fn swap_positions(&mut self, others: &mut Positions<D>, mirrored: bool) {
        let (nodes, corners) = self.parts_mut();
        std::mem::swap(nodes, &mut others.nodes);
        if mirrored {
            reverse_orientation::<D>(corners);
        }
    }

    fn mapped_positions(
        &self,
        map: impl Fn(&[f64; D]) -> Option<[f64; D]> + Sync + Send,
    ) -> Option<Positions<D>> {
        Some(Positions {
            nodes: mapped(self.nodes(), map)?,
            sites: Vec::new(),
        })
    }
}

/// Reverses the orientation of simplices by exchanging the last two nodes of each.
pub fn reverse_orientation<const D: usize>(corners: &mut [u32]) {
    for cell in corners.chunks_exact_mut(D + 1) {
        cell.swap(D - 1, D);
    }
}

fn mapped<const D: usize>(
    points: &[[f64; D]],
    map: impl Fn(&[f64; D]) -> Option<[f64; D]> + Sync + Send,
) -> Option<Vec<[f64; D]>> {
    use crate::parallel::prelude::*;
    points.par_iter().map(map).collect()
}

impl Simplices<3> for TetMesh {
    type Cosines = [f64; 6];

    fn from_parts(nodes: Vec<[f64; 3]>, corners: Vec<u32>) -> Self {
        let tets = corners.as_chunks().0.to_vec();
        Self { nodes, tets }
    }

    fn with_nodes(&self, nodes: Vec<[f64; 3]>) -> Self {
        let tets = self.tets.par_iter().copied().collect();
        Self { nodes, tets }
    }

    fn parts(&self) -> (&[[f64; 3]], &[u32]) {
        (&self.nodes, self.tets.as_flattened())
    }

    fn parts_mut(&mut self) -> (&mut Vec<[f64; 3]>, &mut [u32]) {
        (&mut self.nodes, self.tets.as_flattened_mut())
    }

    fn volume(&self, c: usize) -> f64 {
        volume6(&self.corners(c)) / 6.0
    }

    fn neighbours(&self) -> std::result::Result<Vec<u32>, Vec<u32>> {
        match complex::neighbours(self.nodes.len(), &self.tets) {
            Ok(neighbours) => Ok(neighbours.into_flattened()),
            Err(face) => Err(face.to_vec()),
        }
    }

    fn face_area([a, b, c]: &[[f64; 3]; 3]) -> f64 {
        0.5 * norm(cross(sub(*b, *a), sub(*c, *a)))
    }

    fn shape(&self, c: usize) -> SimplexShape {
        SimplexShape::from_corners(&self.corners(c))
    }

    fn min_sine(&self, c: usize) -> f64 {
        quality::min_sine(&self.corners(c))
    }

    fn shapes(&self, cells: Range<usize>, mut visit: impl FnMut(SimplexShape)) {
        let (mut corners, mut shapes) = (CornerBlock::default(), SimplexShapeBlock::default());
        for block in self.tets[cells].chunks(BLOCK_SIZE) {
            corners.gather(&self.nodes, block);
            shapes.measure(&corners);
            for i in 0..block.len() {
                visit(shapes.get(i));
            }
        }
    }
}

impl Simplices<2> for TriMesh {
    type Cosines = [f64; 3];

    fn from_parts(nodes: Vec<[f64; 2]>, corners: Vec<u32>) -> Self {
        let triangles = corners.as_chunks().0.to_vec();
        Self { nodes, triangles }
    }

    fn with_nodes(&self, nodes: Vec<[f64; 2]>) -> Self {
        let triangles = self.triangles.clone();
        Self { nodes, triangles }
    }

    fn parts(&self) -> (&[[f64; 2]], &[u32]) {
        (&self.nodes, self.triangles.as_flattened())
    }

    fn parts_mut(&mut self) -> (&mut Vec<[f64; 2]>, &mut [u32]) {
        (&mut self.nodes, self.triangles.as_flattened_mut())
    }

    fn volume(&self, c: usize) -> f64 {
        0.5 * tri::double_area(&self.corners(c))
    }

    fn neighbours(&self) -> std::result::Result<Vec<u32>, Vec<u32>> {
        match tri::neighbours(self.nodes.len(), &self.triangles) {
            Ok(neighbours) => Ok(neighbours.into_flattened()),
            Err(edge) => Err(edge.to_vec()),
        }
    }

    fn face_area([a, b]: &[[f64; 2]; 2]) -> f64 {
        hypot(b[0] - a[0], b[1] - a[1])
    }

    fn shape(&self, c: usize) -> SimplexShape<[f64; 3]> {
        let p = self.corners(c);
        SimplexShape {
            cosines: tri::angles(&p).map(|angle| angle.to_radians().cos()),
            mean_ratio: tri::shape_quality(&p),
            radius_edge: tri::radius_edge_ratio(&p),
            volume: 0.5 * tri::double_area(&p),
        }
    }
}

impl<const D: usize> Mesh<D> for PolyMesh<D> {
    const CELLS_NAME: &'static str = if D == 2 { "polygons" } else { "polyhedra" };
    const VTK_CELL: u8 = if D == 2 { 7 } else { 42 };

    fn nodes(&self) -> &[[f64; D]] {
        &self.nodes
    }

    fn len(&self) -> usize {
        self.sites.len()
    }

    fn face_count(&self) -> usize {
        self.face_cells.len()
    }

    fn facets(&self, face: usize, mut visit: impl FnMut([u32; D])) {
        let ring = self.faces.get(face);
        if D == 2 {
            return visit(std::array::from_fn(|k| ring[k]));
        }
        // A fan around the node with the lowest number, which does not depend on the face's
        // orientation.
        let lowest = ring.iter().enumerate().min_by_key(|(_, node)| **node);
        let first = lowest.map_or(0, |(index, _)| index);
        for i in 1..ring.len() - 1 {
            visit(std::array::from_fn(|k| {
                let step = if k == 0 { 0 } else { i + k - 1 };
                ring[(first + step) % ring.len()]
            }));
        }
    }

    fn unique_faces(&self, marks: &[bool]) -> (Lists, Vec<bool>) {
        let marked = |f: usize| marks.get(f).is_some_and(|mark| *mark);
        let count = self.face_cells.len();
        (self.faces.clone(), (0..count).map(marked).collect())
    }

    fn cells_of_faces(&self) -> Result<Vec<[u32; 2]>> {
        let cells = |face: usize| {
            let beyond = match self.face_neighbour(face) {
                FaceNeighbour::Cell(cell) => cell as u32,
                _ => NONE,
            };
            [self.face_cells[face][0], beyond]
        };
        Ok((0..self.face_cells.len()).map(cells).collect())
    }

    fn cell_volumes(&self) -> Vec<(f64, [f64; D])> {
        self.cell_shapes()
    }

    fn mean_over_simplices(&self, value: impl Fn(&[[f64; D]]) -> f64 + Sync) -> Vec<f64> {
        let faces = self.faces_of_cells();
        let mean = |cell: usize| {
            let (mut sum, mut total) = (0.0, 0.0);
            self.for_each_simplex(cell, faces.get(cell), |volume, corners| {
                sum += volume * value(corners);
                total += volume;
            });
            if total == 0.0 { 0.0 } else { sum / total }
        };
        (0..self.sites.len()).into_par_iter().map(mean).collect()
    }

    fn centres(&self) -> Centres<'_, D> {
        let shapes = self.cell_shapes();
        Box::new(move |c| shapes[c].1)
    }

    fn swap_positions(&mut self, others: &mut Positions<D>, mirrored: bool) {
        std::mem::swap(&mut self.nodes, &mut others.nodes);
        std::mem::swap(&mut self.sites, &mut others.sites);
        if mirrored {
            self.reverse_faces();
        }
    }

    fn mapped_positions(
        &self,
        map: impl Fn(&[f64; D]) -> Option<[f64; D]> + Sync + Send,
    ) -> Option<Positions<D>> {
        Some(Positions {
            nodes: mapped(&self.nodes, &map)?,
            sites: mapped(&self.sites, &map)?,
        })
    }
}

/// Converts bits to marks of face numbers: bit k of a cell's byte stands for its face k.
pub fn marks_from_bits<const D: usize>(bits: &[u8]) -> impl Iterator<Item = bool> {
    (bits.iter()).flat_map(|&bits| (0..=D).map(move |k| bits >> k & 1 == 1))
}
