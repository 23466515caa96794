//! Cells of any kind with a label each, cut into simplices, in the space where samples are one apart.

use std::borrow::Cow;

use crate::geometry::counting_sort::sort_by_group;
use crate::geometry::{NONE, bounding_box, cross, dot, sub, to_3d};
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Mesh, Simplices};
use crate::parallel::prelude::*;

/// Number of layers of samples in one task.
const LAYERS_PER_TASK: usize = 4;

/// Fraction of the height of a simplex by which a sample may lie outside. Positions in files are
/// rounded, so that samples on a side of the box can lie slightly outside all cells.
const OUTSIDE_TOLERANCE: f64 = 1e-4;

/// Fraction of the height of a simplex within which a sample lies on its boundary.
const TOUCH_TOLERANCE: f64 = 1e-9;

/// Calls a function with the facets of a face: triangles, in 2-D edges.
type FacetVisitor<'a, const D: usize> = dyn Fn(usize, &mut dyn FnMut([u32; D])) + Sync + 'a;

/// The cells of a mesh in index space, with the index of the label of each.
pub struct LabelledCells<'a, const D: usize> {
    /// Positions of the nodes, followed by the sites of polyhedra and polygons.
    points: Vec<[f64; D]>,
    /// The corners of the simplices into which the cells are cut, `D + 1` for each.
    corners: Cow<'a, [u32]>,
    /// The first simplex of each cell, and the number of simplices; `None` if each cell is one.
    first_simplex: Option<Vec<u32>>,
    /// Index of the label of each cell.
    pub labels: &'a [u32],
    /// Volume of each cell, in samples.
    pub volumes: Vec<f64>,
    /// Number of faces.
    pub face_count: usize,
    cells_of_face: Box<dyn Fn(usize) -> [u32; 2] + Sync + 'a>,
    visit_facets: Box<FacetVisitor<'a, D>>,
    /// `true` if normals of facets point into the first cell of a face.
    is_mirrored: bool,
}

impl<'a, const D: usize> LabelledCells<'a, D> {
    /// Wraps simplices. `neighbours` has the adjacent cell for each cell and face, and `to_index`
    /// maps a position of the mesh to index space.
    pub fn from_simplices<M: Simplices<D>>(
        mesh: &'a M,
        neighbours: &'a [u32],
        labels: &'a [u32],
        to_index: impl Fn(&[f64; D]) -> [f64; D] + Sync + Send,
    ) -> Self {
        let cells_of_face = move |face: usize| {
            let (cell, beyond) = ((face / (D + 1)) as u32, neighbours[face]);
            // NONE is greater than every number of a cell.
            if beyond > cell {
                [cell, beyond]
            } else {
                [NONE; 2]
            }
        };
        Self {
            points: mesh.nodes().par_iter().map(to_index).collect(),
            corners: Cow::Borrowed(mesh.connectivity()),
            first_simplex: None,
            labels,
            volumes: Vec::new(),
            face_count: mesh.face_count(),
            cells_of_face: Box::new(cells_of_face),
            visit_facets: Box::new(move |face, visit| mesh.facets(face, visit)),
            is_mirrored: false,
        }
        .measured()
    }

    /// Wraps polyhedra or polygons, which are cut into simplices from their sites.
    pub fn from_cells(
        mesh: &'a PolyMesh<D>,
        labels: &'a [u32],
        to_index: impl Fn(&[f64; D]) -> [f64; D] + Sync + Send,
    ) -> Self {
        let (node_count, cell_count) = (mesh.nodes.len(), mesh.sites.len());
        let (mut corners, mut cells) = (Vec::new(), Vec::new());
        for face in 0..mesh.face_count() {
            for (side, &cell) in mesh.face_cells[face].iter().enumerate() {
                if cell as usize >= cell_count {
                    continue;
                }
                mesh.facets(face, |facet| {
                    cells.push(cell as usize);
                    corners.push((node_count + cell as usize) as u32);
                    let begin = corners.len();
                    corners.extend(facet);
                    // All simplices have the same orientation.
                    if side == 1 {
                        corners.swap(begin, begin + 1);
                    }
                });
            }
        }
        let (first_simplex, order) = sort_by_group(cell_count, cells.into_iter());
        let sorted = order.iter();
        let sorted =
            sorted.flat_map(|&s| &corners[(D + 1) * s as usize..(D + 1) * (s as usize + 1)]);
        let positions = mesh.nodes.iter().chain(&mesh.sites);
        let cells_of_face = move |face: usize| {
            let beyond = mesh.face_cells[face][1];
            let beyond = if (beyond as usize) < cell_count {
                beyond
            } else {
                NONE
            };
            [mesh.face_cells[face][0], beyond]
        };
        Self {
            points: positions.map(to_index).collect(),
            corners: sorted.copied().collect(),
            first_simplex: Some(first_simplex),
            labels,
            volumes: Vec::new(),
            face_count: mesh.face_count(),
            cells_of_face: Box::new(cells_of_face),
            visit_facets: Box::new(move |face, visit| mesh.facets(face, visit)),
            is_mirrored: false,
        }
        .measured()
    }

    /// Computes the volumes of the cells, and their orientation.
    fn measured(mut self) -> Self {
        let signed: Vec<f64> = (0..self.labels.len())
            .into_par_iter()
            .map(|cell| self.simplices_of(cell).map(|s| self.signed_volume(s)).sum())
            .collect();
        self.is_mirrored = signed.iter().sum::<f64>() < 0.0;
        self.volumes = signed.into_iter().map(f64::abs).collect();
        self
    }

    /// Returns the simplices of a cell.
    fn simplices_of(&self, cell: usize) -> std::ops::Range<usize> {
        match &self.first_simplex {
            None => cell..cell + 1,
            Some(first) => first[cell] as usize..first[cell + 1] as usize,
        }
    }

    /// Returns the corners of a simplex. The last is a repetition in 2-D.
    fn simplex(&self, s: usize) -> [[f64; D]; 4] {
        let corners = &self.corners[(D + 1) * s..(D + 1) * (s + 1)];
        std::array::from_fn(|k| self.points[corners[k.min(D)] as usize])
    }

    fn signed_volume(&self, s: usize) -> f64 {
        let frame = SimplexFrame::new(&self.simplex(s));
        frame.determinant / if D == 2 { 2.0 } else { 6.0 }
    }

    /// Returns the position of a node in index space.
    #[inline]
    pub fn position(&self, node: u32) -> [f64; D] {
        self.points[node as usize]
    }

    /// Returns the cell of a face and the cell beyond it, `NONE` on the boundary. If two numbers
    /// stand for one face, the second has `NONE` twice.
    #[inline]
    pub fn cells_of_face(&self, face: usize) -> [u32; 2] {
        (self.cells_of_face)(face)
    }

    /// Calls `visit` with the facets of a face. Their normals point out of its first cell.
    pub fn for_each_facet(&self, face: usize, mut visit: impl FnMut([u32; D])) {
        (self.visit_facets)(face, &mut |mut facet| {
            if self.is_mirrored {
                facet.swap(0, 1);
            }
            visit(facet);
        });
    }

    /// Calls `visit` with evenly spread points of a cell, each with the volume for which it stands.
    pub fn for_each_point(&self, cell: usize, mut visit: impl FnMut([f64; D], f64)) {
        for s in self.simplices_of(cell) {
            let (corners, volume) = (self.simplex(s), self.signed_volume(s).abs());
            // The corners of small simplices, moved inwards.
            let (n, inwards) = (POINTS_PER_EDGE, 1.0 / (D + 1) as f64);
            let count = (1..=D).fold(1, |count, k| count * (n - 1 + k) / k);
            let share = volume / count as f64;
            for i in 0..n {
                for j in 0..n - i {
                    let last = if D == 2 { 1 } else { n - i - j };
                    for k in 0..last {
                        let rest = n - 1 - i - j - k;
                        let weights = [rest, i, j, k].map(|w| (w as f64 + inwards) / n as f64);
                        visit(
                            std::array::from_fn(|c| {
                                (0..=D).map(|v| weights[v] * corners[v][c]).sum()
                            }),
                            share,
                        );
                    }
                }
            }
        }
    }

    /// Returns the cell at each sample of an image, and `NONE` where there is none. A sample on a
    /// face between two cells counts for the cell that has its label, if one has.
    pub fn cells_at_samples(&self, dims: [usize; D], label_of_sample: &[u32]) -> Vec<u32> {
        let last = D - 1;
        let layer: usize = dims[..last].iter().product();
        let task_count = dims[last].div_ceil(LAYERS_PER_TASK);
        let simplex_count = self.corners.len() / (D + 1);
        let tasks_of = |s: usize| {
            let [low, high] = bounding_box(&self.simplex(s));
            let first = (low[last] - OUTSIDE_TOLERANCE).ceil().max(0.0);
            let end = (high[last] + OUTSIDE_TOLERANCE).floor();
            if end < first || first >= dims[last] as f64 {
                return 0..0;
            }
            let end = (end as usize).min(dims[last] - 1);
            first as usize / LAYERS_PER_TASK..end / LAYERS_PER_TASK + 1
        };
        let ranges: Vec<std::ops::Range<usize>> =
            (0..simplex_count).into_par_iter().map(tasks_of).collect();
        let mut simplices_of_task: Vec<Vec<u32>> = vec![Vec::new(); task_count];
        for (s, range) in ranges.into_iter().enumerate() {
            for task in range {
                simplices_of_task[task].push(s as u32);
            }
        }
        let cell_of_simplex = |s: u32| match &self.first_simplex {
            None => s,
            Some(first) => (first.partition_point(|&f| f <= s) - 1) as u32,
        };
        let mut cells = vec![NONE; label_of_sample.len()];
        let chunks = cells.par_chunks_mut(layer * LAYERS_PER_TASK).enumerate();
        chunks.for_each(|(task, cells)| {
            let first_sample = task * LAYERS_PER_TASK * layer;
            let mut scores = vec![f64::NEG_INFINITY; cells.len()];
            let mut range = [[0; 2]; 3];
            for &s in &simplices_of_task[task] {
                let corners = self.simplex(s as usize);
                let [low, high] = bounding_box(&corners);
                let mut is_empty = false;
                for k in 0..D {
                    let mut bounds = [0, dims[k]];
                    if k == last {
                        bounds = [task * LAYERS_PER_TASK, (task + 1) * LAYERS_PER_TASK];
                    }
                    let begin = (low[k] - OUTSIDE_TOLERANCE).ceil().max(bounds[0] as f64) as usize;
                    let end = (high[k] + OUTSIDE_TOLERANCE).floor() + 1.0;
                    let end = end.clamp(0.0, bounds[1].min(dims[k]) as f64) as usize;
                    is_empty |= begin >= end;
                    range[k] = [begin, end];
                }
                if is_empty {
                    continue;
                }
                if D == 2 {
                    range[2] = [0, 1];
                }
                let (frame, cell) = (SimplexFrame::new(&corners), cell_of_simplex(s));
                let label = self.labels[cell as usize];
                for z in range[2][0]..range[2][1] {
                    for y in range[1][0]..range[1][1] {
                        let row = if D == 2 {
                            y * dims[0]
                        } else {
                            (z * dims[1] + y) * dims[0]
                        };
                        for x in range[0][0]..range[0][1] {
                            let at = [x as f64, y as f64, z as f64];
                            let depth = frame.depth(std::array::from_fn(|k| at[k]));
                            if depth < -OUTSIDE_TOLERANCE {
                                continue;
                            }
                            let sample = row + x;
                            let score = match depth {
                                d if d < -TOUCH_TOLERANCE => d,
                                _ if label_of_sample[sample] == label => 2.0,
                                _ => 1.0,
                            };
                            let place = sample - first_sample;
                            if score > scores[place] {
                                scores[place] = score;
                                cells[place] = cell;
                            }
                        }
                    }
                }
            }
        });
        cells
    }
}

/// Number of points along an edge of a simplex that stand for its volume.
const POINTS_PER_EDGE: usize = 5;

/// Linear functions that give the barycentric coordinates in a simplex.
struct SimplexFrame<const D: usize> {
    origin: [f64; D],
    /// Gradient of the coordinate of each corner but the first.
    gradients: [[f64; 3]; 3],
    determinant: f64,
}

impl<const D: usize> SimplexFrame<D> {
    fn new(corners: &[[f64; D]; 4]) -> Self {
        let edge = |k: usize| to_3d(sub(corners[k], corners[0]));
        let (a, b) = (edge(1), edge(2));
        let c = if D == 2 { [0.0, 0.0, 1.0] } else { edge(3) };
        let normals = [cross(b, c), cross(c, a), cross(a, b)];
        let determinant = dot(a, normals[0]);
        Self {
            origin: corners[0],
            gradients: normals.map(|normal| normal.map(|x| x / determinant)),
            determinant,
        }
    }

    /// Returns the smallest barycentric coordinate of a position: negative outside the simplex.
    #[inline]
    fn depth(&self, x: [f64; D]) -> f64 {
        let offset = to_3d(sub(x, self.origin));
        let (mut first, mut smallest) = (1.0, f64::INFINITY);
        for gradient in &self.gradients[..D] {
            let coordinate = dot(*gradient, offset);
            first -= coordinate;
            smallest = smallest.min(coordinate);
        }
        // Flat simplices have no coordinates.
        let depth = smallest.min(first);
        if depth.is_finite() {
            depth
        } else {
            f64::NEG_INFINITY
        }
    }
}
