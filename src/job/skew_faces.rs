//! Removes skew faces of Voronoi cells: faces far from the line between the centroids of their cells.
//!
//! Finite-volume programs interpolate between two centroids and take the value for the face between
//! them; OpenFOAM's `checkMesh` refuses a mesh with a skewness above 4. Few faces are that skew (one in
//! ten thousand), and most of them are tiny. The centre of such a face is farther from all sites than
//! its two sites are from each other, so there is mostly room for an atom, whose cell separates the two.
//! Where an atom cannot be, the atoms nearby try some positions. The cells nearby are cut again each time.
//! Where no atom can move, a site of the face is removed.

use super::equalise::{CellEqualiser, MAX_SITE_VOLUME_RATIO};
use super::local_cells::neighbours;
use crate::geometry::sorted_distinct;
use crate::mesh::delaunay::delaunay;
use crate::mesh::poly::{FIRST_SIDE, FaceNeighbour, Lists, PolyMesh};
use crate::mesh::{Dimension, Space};
use crate::parallel::prelude::*;

/// Skewness from which a face is skew. It is below the 4 of `checkMesh`, since coordinates are rounded
/// when they are written.
const MAX_SKEWNESS: f64 = 3.95;

/// A change after which fewer faces are skew: an atom moves, or there is a new one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change<const D: usize> {
    pub atom: Option<usize>,
    pub position: [f64; D],
}

/// The skew faces of cells.
pub(super) struct SkewFaces<'a, const D: usize> {
    equaliser: &'a CellEqualiser<'a, D>,
    mesh: &'a PolyMesh<D>,
    centroids: Vec<[f64; D]>,
    /// The skew faces, ascending.
    faces: Vec<usize>,
    neighbours: Lists,
}

/// The changes that remove skew faces.
pub(super) struct Changes<const D: usize> {
    /// Those for which there is one.
    pub changes: Vec<Change<D>>,
    /// The cells of each other face.
    pub unchanged: Vec<Vec<usize>>,
}

impl<'a, const D: usize> SkewFaces<'a, D>
where
    Space<D>: Dimension<D>,
{
    /// Finds the skew faces; `None` if there are none.
    pub fn find(equaliser: &'a CellEqualiser<'a, D>) -> Option<Self> {
        let mesh = equaliser.mesh;
        let centroids: Vec<[f64; D]> = mesh.cell_shapes().into_iter().map(|s| s.1).collect();
        let is_skew = |&f: &usize| mesh.face_skewness(f, |cell| centroids[cell]) > MAX_SKEWNESS;
        let all = (0..mesh.face_cells.len()).into_par_iter();
        let faces: Vec<usize> = all.filter(is_skew).collect();
        (!faces.is_empty()).then(|| Self {
            equaliser,
            mesh,
            centroids,
            faces,
            neighbours: neighbours(mesh),
        })
    }

    /// Returns a change for each skew face, if there is one. Faces near an earlier change are left for
    /// the next time.
    pub fn changes(&self) -> Changes<D> {
        let best: Vec<Option<Change<D>>> = (self.faces.par_iter())
            .map(|&f| self.new_atom(f).or_else(|| self.move_of_atom(f)))
            .collect();
        let mut is_near_change = vec![false; self.mesh.sites.len()];
        let mut found = Changes {
            changes: Vec::new(),
            unchanged: Vec::new(),
        };
        for (&f, change) in self.faces.iter().zip(best) {
            let own = self.cells_of(f);
            let near = self.with_neighbours(&own);
            if near.iter().any(|&c| is_near_change[c]) {
                continue;
            }
            match change {
                Some(change) => {
                    near.into_iter().for_each(|c| is_near_change[c] = true);
                    found.changes.push(change);
                }
                None => found.unchanged.push(own),
            }
        }
        found
    }

    /// Returns a new atom after which no face near face `f` is skew.
    fn new_atom(&self, f: usize) -> Option<Change<D>> {
        let local = RecutCells::new(self, None, &self.with_neighbours(&self.cells_of(f)));
        let centre = self.mesh.face_shape(f).centroid;
        let positions = self.equaliser.new_positions(centre).into_iter();
        let mut positions = positions.filter(|&x| local.skew_faces(x) == Some(0));
        let position = positions.next()?;
        Some(Change {
            atom: None,
            position,
        })
    }

    /// Returns the first move of an atom near face `f` after which no face around the atom is skew.
    fn move_of_atom(&self, f: usize) -> Option<Change<D>> {
        let own = self.cells_of(f);
        let is_neighbour = |a: usize, b: usize| self.neighbours.get(a).contains(&(b as u32));
        let is_at_face = |&c: &usize| own.iter().all(|&cell| cell == c || is_neighbour(cell, c));
        let mut atoms = self.with_neighbours(&own).into_iter().filter(is_at_face);
        atoms.find_map(|atom| {
            let targets = self.equaliser.targets_of(atom)?;
            let local = RecutCells::new(self, Some(atom), &self.with_neighbours(&[atom]));
            let mut targets = targets.filter(|&target| local.skew_faces(target) == Some(0));
            let position = targets.next()?;
            Some(Change {
                atom: Some(atom),
                position,
            })
        })
    }

    /// Returns the cells of a face.
    fn cells_of(&self, f: usize) -> Vec<usize> {
        let cells = self.mesh.face_cells[f].into_iter();
        cells
            .filter(|&c| c < FIRST_SIDE)
            .map(|c| c as usize)
            .collect()
    }

    /// Returns cells and their neighbours, ascending.
    fn with_neighbours(&self, cells: &[usize]) -> Vec<usize> {
        let adjacent = cells.iter().flat_map(|&c| self.neighbours.get(c));
        sorted_distinct(adjacent.map(|&c| c as usize).chain(cells.iter().copied()))
    }
}

/// Cells that are cut again for each position of one atom.
struct RecutCells<'a, const D: usize> {
    whole: &'a SkewFaces<'a, D>,
    /// The cells that change with the atom's position, and then their neighbours. The atom is none of
    /// them.
    cells: Vec<usize>,
    /// Number of cells that change.
    changing: usize,
}

impl<'a, const D: usize> RecutCells<'a, D>
where
    Space<D>: Dimension<D>,
{
    /// Collects the cells around an atom of the mesh or a new one.
    fn new(whole: &'a SkewFaces<'a, D>, atom: Option<usize>, changing: &[usize]) -> Self {
        let others = |cells: &[usize]| -> Vec<usize> {
            cells.iter().copied().filter(|&c| Some(c) != atom).collect()
        };
        let mut cells = others(changing);
        let beyond = others(&whole.with_neighbours(changing));
        cells.extend(
            beyond
                .into_iter()
                .filter(|c| changing.binary_search(c).is_err()),
        );
        Self {
            whole,
            changing: others(changing).len(),
            cells,
        }
    }

    /// Returns the number of skew faces of the cells that change if the atom is at `x`; `None` if
    /// other cells would change, or if the atom's cell would be much smaller or larger than the
    /// next.
    fn skew_faces(&self, x: [f64; D]) -> Option<usize> {
        let sites = self.cells.iter().map(|&c| self.whole.mesh.sites[c]);
        let sites: Vec<[f64; D]> = [x].into_iter().chain(sites).collect();
        let mesh =
            Space::<D>::voronoi_cells(&sites, self.whole.equaliser.extent, 0.0, &delaunay).ok()?;
        let faces = mesh.faces_of_cells();
        let shapes: Vec<(f64, [f64; D])> = (0..=self.changing)
            .map(|i| mesh.cell_shape(i, faces.get(i)))
            .collect();
        let is_similar = |&f: &u32| match mesh.face_neighbour(f as usize) {
            FaceNeighbour::Cell(other) => shapes.get(other).is_some_and(|shape| {
                let ratio = shape.0 / shapes[0].0;
                ratio.max(1.0 / ratio) <= MAX_SITE_VOLUME_RATIO
            }),
            _ => true,
        };
        if !faces.get(0).iter().all(is_similar) {
            return None;
        }
        let centroid = |i: usize| match shapes.get(i) {
            Some(shape) => shape.1,
            None => self.whole.centroids[self.cells[i - 1]],
        };
        let changes = |f: &usize| mesh.face_cells[*f][0] as usize <= self.changing;
        let is_skew = |f: &usize| mesh.face_skewness(*f, centroid) > MAX_SKEWNESS;
        Some(
            (0..mesh.face_cells.len())
                .filter(changes)
                .filter(is_skew)
                .count(),
        )
    }
}
