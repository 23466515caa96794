//! The faces that the page's cut can show.

use crate::mesh::complex::NONE;
use crate::model::slice::DrawableFaces;

/// What a page holds of a mesh.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct PageMesh {
    /// Faces, in the order of their first cells in the page.
    pub faces: Vec<u32>,
    /// The cells of these faces, by their number in the page, the lower first.
    pub sides: Vec<[u32; 2]>,
    /// The cells, neighbours near each other, by their number in the mesh.
    pub cells: Vec<u32>,
    /// Between which places of the cut the middle of each of these cells lies.
    pub bins: Vec<[u8; 3]>,
}

/// Between which of the `steps - 1` places of the cut the middle of each cell lies.
fn bins(faces: &DrawableFaces, steps: usize) -> Vec<[u8; 3]> {
    let bin = |x: f64| ((x * steps as f64) as usize).min(steps - 1) as u8;
    faces.cell_centres.iter().map(|m| m.map(bin)).collect()
}

/// Whether a page keeps a face.
fn is_kept(faces: &DrawableFaces, bins: &[[u8; 3]], face: usize) -> bool {
    let [a, b] = faces.cells[face];
    b == NONE || faces.surfaces[face] > 0 || bins[a as usize] != bins[b as usize]
}

/// How many faces a page with so many steps keeps, and how many cells these have.
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
    /// The faces on the boundary, those on features, and those whose cells are parted by one of the
    /// `steps - 1` places, evenly spread along each axis, at which the cut stops.
    pub(super) fn new(faces: &DrawableFaces, steps: usize) -> Self {
        let bins = bins(faces, steps);
        let mut kept: Vec<u32> = (0..faces.len())
            .filter(|&f| is_kept(faces, &bins, f))
            .map(|f| f as u32)
            .collect();

        let mut seen = vec![false; faces.cell_centres.len()];
        for cell in kept.iter().flat_map(|&f| faces.cells[f as usize]) {
            if cell != NONE {
                seen[cell as usize] = true;
            }
        }
        let mut cells: Vec<u32> = (0..seen.len() as u32)
            .filter(|&c| seen[c as usize])
            .collect();
        cells.sort_by_cached_key(|&c| (curve_index(faces.cell_centres[c as usize]), c));
        let mut place = vec![NONE; seen.len()];
        for (at, &cell) in cells.iter().enumerate() {
            place[cell as usize] = at as u32;
        }
        let sides_of = |face: u32| {
            let mut sides = faces.cells[face as usize].map(|cell| match cell {
                NONE => NONE,
                cell => place[cell as usize],
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

/// Where a point of the unit cube lies on a curve on which neighbours are near each other: Morton's.
fn curve_index(point: [f64; 3]) -> u64 {
    let places = point.map(|x| (x * 1024.0) as u64);
    let bit = |b: u32| {
        let bits = (0..3).map(|k| (places[k] >> b & 1) << (3 * b + k as u32));
        bits.sum::<u64>()
    };
    (0..11).map(bit).sum()
}
