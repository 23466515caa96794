//! Selects the faces that the cutting plane of the page can show.

use crate::mesh::complex::NONE;
use crate::mesh::renumber::{new_numbers, used_items};
use crate::model::slice::DrawableFaces;

/// Part of a mesh that a page holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct PageMesh {
    /// Faces, in the order of their first cells in the page.
    pub faces: Vec<u32>,
    /// Cells on the two sides of each face, by their number in the page, the lower number first.
    pub sides: Vec<[u32; 2]>,
    /// Cells, by their number in the mesh. Neighbours are near each other in this order.
    pub cells: Vec<u32>,
    /// Bin of the centre of each cell along each axis, between two positions of the cutting plane.
    pub bins: Vec<[u8; 3]>,
}

/// Returns the bin of the centre of each cell along each axis. The `steps - 1` positions of the
/// cutting plane divide an axis into `steps` bins.
fn bins(faces: &DrawableFaces, steps: usize) -> Vec<[u8; 3]> {
    let bin = |x: f64| ((x * steps as f64) as usize).min(steps - 1) as u8;
    faces.cell_centres.iter().map(|m| m.map(bin)).collect()
}

/// Returns `true` if a page keeps the face.
fn is_kept(faces: &DrawableFaces, bins: &[[u8; 3]], face: usize) -> bool {
    let [a, b] = faces.cells[face];
    b == NONE || faces.surfaces[face] > 0 || bins[a as usize] != bins[b as usize]
}

/// Returns the number of faces that a page with `steps` steps keeps, and the number of their cells.
pub(super) fn count(faces: &DrawableFaces, steps: usize) -> (usize, usize) {
    let bins = bins(faces, steps);
    let mut seen = vec![false; faces.cell_centres.len() + 1];
    let mut count = 0;
    for face in (0..faces.len()).filter(|&face| is_kept(faces, &bins, face)) {
        count += 1;
        for cell in faces.cells[face] {
            seen[(cell as usize).min(faces.cell_centres.len())] = true;
        }
    }
    let cells = seen[..faces.cell_centres.len()]
        .iter()
        .filter(|&&seen| seen);
    (count, cells.count())
}

impl PageMesh {
    /// Selects the faces on the boundary, the faces on features, and the faces whose two cells are
    /// separated by a position of the cutting plane. There are `steps - 1` such positions, evenly
    /// spread along each axis.
    pub(super) fn new(faces: &DrawableFaces, steps: usize) -> Self {
        let bins = bins(faces, steps);
        let mut kept: Vec<u32> = (0..faces.len())
            .filter(|&f| is_kept(faces, &bins, f))
            .map(|f| f as u32)
            .collect();

        let sides = kept.iter().flat_map(|&f| faces.cells[f as usize]);
        let mut cells = used_items(faces.cell_centres.len(), sides.filter(|cell| *cell != NONE));
        cells.sort_by_cached_key(|&c| (curve_index(faces.cell_centres[c as usize]), c));
        let page_index = new_numbers(faces.cell_centres.len(), &cells);
        let sides_of = |face: u32| {
            let mut sides = faces.cells[face as usize].map(|cell| match cell {
                NONE => NONE,
                cell => page_index[cell as usize],
            });
            sides.sort_unstable();
            sides
        };
        kept.sort_by_cached_key(|&f| (sides_of(f), f));
        Self {
            sides: kept.iter().map(|&f| sides_of(f)).collect(),
            bins: cells.iter().map(|&c| bins[c as usize]).collect(),
            faces: kept,
            cells,
        }
    }
}

/// Returns the index of a point of the unit cube along Morton's curve, on which neighbours are near
/// each other.
fn curve_index(point: [f64; 3]) -> u64 {
    let coordinates = point.map(|x| (x * 1024.0) as u64);
    let bit = |b: u32| {
        let bits = (0..3).map(|k| (coordinates[k] >> b & 1) << (3 * b + k as u32));
        bits.sum::<u64>()
    };
    (0..11).map(bit).sum()
}
