//! Regions of cells from an image of labels that the mesh was not made of.
//!
//! Cells straddle the boundaries of such labels. A cell has the label that fills the largest part of
//! its volume, and the volume of each region is compared with that of its label.

use std::collections::BTreeMap;

use super::averaging::{SamplePositions, for_each_piece_of_cell};
use crate::geometry::grid_index::offset_of;
use crate::image::{Image, LabelTable};
use crate::mesh::poly::PolyMesh;
use crate::parallel::prelude::*;

/// Largest edge, in samples, of a piece of a cell that counts for the label at its centre.
const MAX_PIECE_EDGE_SAMPLES: f64 = 1.5;
/// Largest difference, in percent, between the volumes of a region and of its label that a note does
/// not explain.
const MAX_ERROR_PERCENT: f64 = 1.0;
/// Largest number of regions that the note lists.
const MAX_LISTED_REGIONS: usize = 8;

/// The regions of cells, and their volumes.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionShares {
    /// The region of each cell.
    pub region: Vec<i32>,
    /// For each region its volume in the image, within the mesh, and the volume of its cells.
    pub volumes: BTreeMap<i32, [f64; 2]>,
}

impl RegionShares {
    /// Returns the regions of the cells of a mesh, whose `positions` in the image are given. Of labels
    /// that fill equal parts of a cell, the lowest counts. Outside the image, the labels at its sides
    /// apply.
    pub fn new(mesh: &PolyMesh<3>, positions: &SamplePositions, image: &Image<3>) -> Self {
        let (labels, dims) = (region_numbers(image), image.dims());
        let faces = mesh.faces_of_cells();
        let cell_shares = |cell: usize| {
            let mut shares: Vec<(i32, f64)> = Vec::new();
            let mut add = |volume6: f64, point: [f64; 3]| {
                let volume = volume6 / 6.0;
                let nearest = |k: usize| point[k].round().clamp(0.0, (dims[k] - 1) as f64) as usize;
                let label = labels[offset_of(dims, std::array::from_fn(nearest))];
                match shares.iter_mut().find(|entry| entry.0 == label) {
                    Some(entry) => entry.1 += volume,
                    None => shares.push((label, volume)),
                }
            };
            let faces = faces.get(cell);
            for_each_piece_of_cell(
                mesh,
                positions,
                faces,
                cell,
                MAX_PIECE_EDGE_SAMPLES,
                &mut add,
            );
            shares.sort_unstable_by_key(|entry| entry.0);
            shares
        };
        let cells: Vec<Vec<(i32, f64)>> = (0..mesh.sites.len())
            .into_par_iter()
            .map(cell_shares)
            .collect();
        let mut volumes: BTreeMap<i32, [f64; 2]> = BTreeMap::new();
        let mut region = Vec::with_capacity(cells.len());
        for shares in cells {
            let larger = |best: (i32, f64), &entry: &(i32, f64)| {
                if entry.1 > best.1 { entry } else { best }
            };
            let first = shares.first().copied().unwrap_or_default();
            let winner = shares.iter().fold(first, larger).0;
            for (label, volume) in &shares {
                volumes.entry(*label).or_default()[0] += volume;
                volumes.entry(winner).or_default()[1] += volume;
            }
            region.push(winner);
        }
        Self { region, volumes }
    }

    /// Returns how far the volume of each region is from that of its label, in percent, the largest
    /// difference first.
    fn errors_percent(&self) -> Vec<(i32, f64)> {
        let error = |(&region, [in_image, in_cells]): (&i32, &[f64; 2])| {
            (region, 100.0 * (in_cells / in_image - 1.0))
        };
        let mut errors: Vec<(i32, f64)> = self.volumes.iter().map(error).collect();
        errors.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()).then(a.0.cmp(&b.0)));
        errors
    }

    /// Returns a note on the volumes of the regions. `place` names the image.
    pub fn note(&self, place: &str) -> String {
        let errors = self.errors_percent();
        let is_off = |error: &&(i32, f64)| error.1.abs() > MAX_ERROR_PERCENT;
        let off_count = errors.iter().filter(is_off).count();
        if off_count == 0 {
            return format!(
                "--region: regions have the volumes of their labels in {place} within {MAX_ERROR_PERCENT} %"
            );
        }
        let listed = errors.iter().take(off_count.min(MAX_LISTED_REGIONS));
        let texts: Vec<String> = listed
            .map(|(r, error)| format!("{r}: {error:+.1} %"))
            .collect();
        let others = match off_count.saturating_sub(MAX_LISTED_REGIONS) {
            0 => String::new(),
            count => format!(" and {count} more"),
        };
        format!(
            "--region: the mesh has no faces at the boundaries of the labels in {place}, and regions do not have their \
             volumes ({}{others}); mesh {place} with --feature labels, or with closer atoms",
            texts.join(", ")
        )
    }
}

/// Returns the region number of each sample: its label if all labels are whole numbers of 32 bits, or
/// the nearest whole number.
fn region_numbers(image: &Image<3>) -> Vec<i32> {
    let exact = LabelTable::from_image(image).and_then(|table| {
        let values: Option<Vec<i32>> = table.values.iter().map(|label| label.as_i32()).collect();
        values.map(|values| (values, table.indices))
    });
    match exact {
        Some((values, indices)) => indices.iter().map(|&i| values[i as usize]).collect(),
        None => (image.as_slice().iter())
            .map(|sample| sample.round() as i32)
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::mesh::poly::samples::two_cells;

    /// Returns the regions of the cells of the box [0, 2] x [0, 1]^2, which is cut at x = 1. Label 5
    /// begins at the first sample with x >= `boundary`, label 3 is before it. Samples are .05 apart, the
    /// first at x = `origin`.
    fn shares(origin: f64, boundary: f64) -> RegionShares {
        let mesh = two_cells::<3>(1.0);
        let label = |[x, ..]: [f64; 3]| {
            if x / 20.0 + origin < boundary {
                3.0
            } else {
                5.0
            }
        };
        let image = Image::from_fn([41, 21, 21], Geometry::default(), label);
        let positions = SamplePositions::new(&mesh, image.dims(), |[x, y, z]| {
            [x - origin, y, z].map(|c| 20.0 * c)
        });
        RegionShares::new(&mesh, &positions, &image)
    }

    #[test]
    fn a_cell_has_the_label_of_the_largest_part_of_its_volume() {
        // Samples are .05 apart, so that label 5 begins half of that before its first sample.
        for (boundary, begin, regions) in [
            (0.9, 0.875, [3, 5]),
            (1.3, 1.275, [3, 5]),
            (1.6, 1.575, [3, 3]),
        ] {
            let shares = shares(0.0, boundary);
            assert_eq!(shares.region, regions, "{boundary}");
            assert!((shares.volumes[&3][0] - begin).abs() < 0.01, "{shares:?}");
            assert!(
                (shares.volumes[&5][0] - (2.0 - begin)).abs() < 0.01,
                "{shares:?}"
            );
        }
    }

    #[test]
    fn the_note_says_how_far_volumes_are_off() {
        let note = shares(0.0, 1.3).note("lay.npy");
        // 1 in place of 1.275, and 1 in place of .725.
        assert!(
            note.contains("5: +37.") && note.contains("3: -21."),
            "{note}"
        );
        // Label 5 begins half-way between the samples at x = .975 and x = 1.025.
        let note = shares(0.025, 1.0).note("lay.npy");
        assert!(note.contains("within 1 %"), "{note}");
    }
}
