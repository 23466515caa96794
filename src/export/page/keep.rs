//! The faces that the page's cut can show.

use super::faces::Faces;
use crate::mesh::complex::NONE;

/// What a page holds of a mesh.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Kept {
    /// Faces, in the order of their first cells in the page.
    pub faces: Vec<u32>,
    /// The cells of these faces, by their number in the page, the lower first.
    pub sides: Vec<[u32; 2]>,
    /// The cells, neighbours near each other, by their number in the mesh.
    pub cells: Vec<u32>,
    /// Between which places of the cut the middle of each of these cells lies.
    pub bins: Vec<[u8; 3]>,
}

impl Kept {
    /// The faces on the boundary, those on features, and those whose cells are parted by one of the
    /// `steps - 1` places, evenly spread along each axis, at which the cut stops.
    pub(super) fn of(faces: &Faces, steps: usize) -> Self {
        let bin = |x: f64| ((x * steps as f64) as usize).min(steps - 1) as u8;
        let bins: Vec<[u8; 3]> = faces.middles.iter().map(|m| m.map(bin)).collect();
        let wanted = |face: usize| {
            let [a, b] = faces.cells[face];
            b == NONE || faces.surfaces[face] > 0 || bins[a as usize] != bins[b as usize]
        };
        let mut kept: Vec<u32> = (0..faces.len())
            .filter(|&f| wanted(f))
            .map(|f| f as u32)
            .collect();

        let mut seen = vec![false; faces.middles.len()];
        for cell in kept.iter().flat_map(|&f| faces.cells[f as usize]) {
            if cell != NONE {
                seen[cell as usize] = true;
            }
        }
        let mut cells: Vec<u32> = (0..seen.len() as u32)
            .filter(|&c| seen[c as usize])
            .collect();
        cells.sort_by_cached_key(|&c| (along_curve(faces.middles[c as usize]), c));
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
fn along_curve(point: [f64; 3]) -> u64 {
    let places = point.map(|x| (x * 1024.0) as u64);
    let bit = |b: u32| {
        let bits = (0..3).map(|k| (places[k] >> b & 1) << (3 * b + k as u32));
        bits.sum::<u64>()
    };
    (0..11).map(bit).sum()
}
