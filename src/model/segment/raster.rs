//! The cell of a mesh that contains each sample of an image.

use crate::parallel::prelude::*;

use crate::geometry::{norm, unit};
use crate::mesh::Mesh;
use crate::mesh::complex::NONE;

/// Distance, in samples, by which a sample may be outside a face and still count as inside the
/// cell; it covers rounding errors.
const FACE_TOLERANCE: f64 = 1e-6;

/// A convex cell as an intersection of half spaces, with its bounding box.
struct ConvexCell<const D: usize> {
    low: [f64; D],
    high: [f64; D],
    /// Half spaces n . x <= c, as pairs of n and c.
    planes: Vec<([f64; D], f64)>,
}

/// Returns, for each sample (x fastest), the cell of a mesh in lattice space that contains it; the
/// first of several, and `NONE` outside all cells. `cells` is the result of
/// [`Mesh::cells_of_faces`].
pub fn cells_of_samples<const D: usize, F: Mesh<D>>(
    mesh: &F,
    cells: &[[u32; 2]],
    dims: [usize; D],
    step: [f64; D],
) -> Vec<u32> {
    let shapes = convex_cells(mesh, cells, step);
    let slab: usize = dims[..D - 1].iter().product();
    // The cells that reach each section perpendicular to the last axis.
    let last = D - 1;
    let mut cells_of_sections = vec![Vec::new(); dims[last]];
    for (number, cell) in shapes.iter().enumerate() {
        for section in sample_range(cell.low[last], cell.high[last], dims[last]) {
            cells_of_sections[section].push(number as u32);
        }
    }
    let mut cell_of_sample = vec![NONE; slab * dims[last]];
    cell_of_sample
        .par_chunks_mut(slab)
        .zip(cells_of_sections)
        .enumerate()
        .for_each(|(section, (section_cells, numbers))| {
            for number in numbers {
                fill_section(
                    &shapes[number as usize],
                    number,
                    section,
                    dims,
                    section_cells,
                );
            }
        });
    cell_of_sample
}

/// Returns the integers from `low` to `high`, within 0 to `n` - 1.
fn sample_range(low: f64, high: f64, n: usize) -> std::ops::Range<usize> {
    let low = (low - FACE_TOLERANCE).ceil().max(0.0) as usize;
    let high = (high + FACE_TOLERANCE).floor();
    low..if high < 0.0 {
        0
    } else {
        (high as usize).saturating_add(1).min(n)
    }
}

/// Facets smaller than this fraction of the mean area are ignored. Because of rounding errors they
/// have no reliable normal, and a convex cell hardly changes without them.
const MIN_AREA_RATIO: f64 = 1e-6;

/// Returns the half spaces and bounding boxes of all cells, in units of samples.
fn convex_cells<const D: usize, F: Mesh<D>>(
    mesh: &F,
    cells: &[[u32; 2]],
    step: [f64; D],
) -> Vec<ConvexCell<D>> {
    let nodes: Vec<[f64; D]> = mesh
        .nodes()
        .par_iter()
        .map(|p| std::array::from_fn(|k| p[k] / step[k]))
        .collect();
    let (mut area, mut count) = (0.0, 0usize);
    for face in 0..cells.len() {
        mesh.facets(face, |facet| {
            area += normal_and_size(&facet.map(|n| nodes[n as usize])).1;
            count += 1;
        });
    }
    let min_area = MIN_AREA_RATIO * area / count.max(1) as f64;
    let mut shapes: Vec<ConvexCell<D>> = Vec::new();
    for (face, sides) in cells.iter().enumerate() {
        mesh.facets(face, |facet| {
            let corners = facet.map(|n| nodes[n as usize]);
            let (normal, area) = normal_and_size(&corners);
            if area <= min_area {
                return;
            }
            let c = (0..D).map(|k| normal[k] * corners[0][k]).sum::<f64>();
            for (&cell, sign) in sides.iter().zip([1.0, -1.0]) {
                if cell == NONE {
                    continue;
                }
                while shapes.len() <= cell as usize {
                    shapes.push(ConvexCell {
                        low: [f64::INFINITY; D],
                        high: [f64::NEG_INFINITY; D],
                        planes: Vec::with_capacity(D + 1),
                    });
                }
                let shape = &mut shapes[cell as usize];
                for p in &corners {
                    for k in 0..D {
                        shape.low[k] = shape.low[k].min(p[k]);
                        shape.high[k] = shape.high[k].max(p[k]);
                    }
                }
                let plane = (normal.map(|n| sign * n), sign * c);
                // All facets of a flat face share one plane.
                if shape.planes.last() != Some(&plane) {
                    shape.planes.push(plane);
                }
            }
        });
    }
    shapes
}

/// Returns the unit normal and the length of an edge, or the unit normal of a triangle and
/// its area.
fn normal_and_size<const D: usize>(corners: &[[f64; D]; D]) -> ([f64; D], f64) {
    let normal = crate::geometry::normal(corners);
    (unit(normal), norm(normal))
}

/// Assigns the samples of one section that lie in a cell, and in no earlier one, to this cell, row
/// by row.
fn fill_section<const D: usize>(
    cell: &ConvexCell<D>,
    number: u32,
    section: usize,
    dims: [usize; D],
    section_cells: &mut [u32],
) {
    let rows = match D {
        2 => 0..1,
        _ => sample_range(cell.low[1], cell.high[1], dims[1]),
    };
    for row in rows {
        // The coordinates of the row; x is not used.
        let position: [f64; D] = std::array::from_fn(|k| match k {
            0 => 0.0,
            _ if k == D - 1 => section as f64,
            _ => row as f64,
        });
        let (mut low, mut high) = (cell.low[0], cell.high[0]);
        for (normal, c) in &cell.planes {
            let remaining =
                c + FACE_TOLERANCE - (1..D).map(|k| normal[k] * position[k]).sum::<f64>();
            if normal[0] > 0.0 {
                high = high.min(remaining / normal[0]);
            } else if normal[0] < 0.0 {
                low = low.max(remaining / normal[0]);
            } else if remaining < 0.0 {
                high = f64::NEG_INFINITY;
            }
        }
        let range = sample_range(low, high, dims[0]);
        if range.is_empty() {
            continue;
        }
        for sample_cell in
            &mut section_cells[row * dims[0] + range.start..row * dims[0] + range.end]
        {
            if *sample_cell == NONE {
                *sample_cell = number;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::grid_index::index_at;
    use crate::mesh::Simplices;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::poly::samples::two_cells;

    #[test]
    fn every_sample_of_two_boxes_has_its_cell() {
        // [0, 2] x [0, 1]^2 divided at x = 0.75, with 20 samples per unit: sample 15 is on the
        // division.
        let mesh = two_cells::<3>(0.75);
        let face_cells = mesh.cells_of_faces().unwrap();
        let cell_of_sample = cells_of_samples(&mesh, &face_cells, [41, 21, 21], [0.05; 3]);
        for (i, cell) in cell_of_sample.iter().enumerate() {
            assert_eq!(*cell, u32::from(i % 41 > 15), "sample {i}");
        }
        let mesh = two_cells::<2>(0.75);
        let face_cells = mesh.cells_of_faces().unwrap();
        let cell_of_sample = cells_of_samples(&mesh, &face_cells, [41, 21], [0.05; 2]);
        assert!(
            cell_of_sample
                .iter()
                .enumerate()
                .all(|(i, c)| *c == u32::from(i % 41 > 15))
        );
    }

    #[test]
    fn samples_lie_inside_the_tetrahedra_that_they_are_given_to() {
        // A cube of six tetrahedra around its diagonal; samples beyond it belong to no cell.
        let mesh = kuhn_box([1; 3], 10.0);
        let face_cells = mesh.cells_of_faces().unwrap();
        let dims = [13, 11, 12];
        let cell_of_sample = cells_of_samples(&mesh, &face_cells, dims, [1.0; 3]);
        let mut counts = [0; 6];
        for (i, &cell) in cell_of_sample.iter().enumerate() {
            let index = index_at(dims, i);
            assert_eq!(cell == NONE, index.iter().any(|&c| c > 10), "{index:?}");
            if cell == NONE {
                continue;
            }
            counts[cell as usize] += 1;
            let corners = mesh.corners(cell as usize);
            let volume = mesh.volume(cell as usize);
            for k in 0..4 {
                let mut part = corners;
                part[k] = index.map(|c| c as f64);
                assert!(
                    crate::geometry::volume6(&part) / 6.0 > -1e-3 * volume.abs(),
                    "{index:?}"
                );
            }
        }
        assert!(counts.iter().all(|n| (130..400).contains(n)), "{counts:?}");
    }
}
