//! The densest regular lattice fitted to a box, for constant d: face-centred cubic (FCC) in 3-D,
//! triangular in 2-D.
//!
//! # FCC
//!
//! The sites of nearest-neighbour distance d are `(i, j, k) h` with `i + j + k` even and `h = d /
//! sqrt 2`, half the edge of its cube. Planes of sites normal to an axis are `h` apart. Each plane
//! is a centred square lattice of nearest-neighbour distance d, and so makes a good side of the
//! box. All eight corners of a box are sites only if the box measures an *even* number of half
//! cells along every axis (an odd number leaves corners out and atoms half a cell from the edges),
//! so the lattice is stretched per axis to the even number that distorts it least. Squeezing along
//! one axis is mild (by `1 / sqrt 2` it makes a body-centred lattice, whose tetrahedra are as
//! good), and so even a box only two d across gets a sound lattice.
//!
//! # Triangular
//!
//! The sites are `(i d/2, j sqrt 3 d/2)` with `i + j` even: rows d/2 times an even number long, an
//! even number of rows, along the axis that distorts the lattice less. The sides across the rows
//! contain the ends of every other row.
//!
//! # Alongside
//!
//! Where atoms keep off the sides ([`Alignment::AlongsideFeatures`]), the number of layers need not
//! be even. The first layer is half a d inside, so that it and its mirror image are d apart.

use crate::geometry::grid_index::index_at;
use std::ops::Range;

use super::Alignment;

/// Returns the positions of the densest lattice of nearest-neighbour distance about `d` that fills
/// the box `[0, extent]`, for `D` of 2 or 3: those of all [`LatticeSites`].
pub fn fit_lattice<const D: usize>(
    extent: [f64; D],
    d: f64,
    alignment: Alignment,
) -> Vec<[f64; D]> {
    let sites = LatticeSites::fit(extent, d, alignment);
    let indices = (0..sites.row_count()).flat_map(|row| sites.row(row));
    indices.map(|site| sites.position(site)).collect()
}

/// The sites of the densest lattice that fills a box, each identified by its index, so that no
/// process has to store all of them.
pub struct LatticeSites<const D: usize> {
    extent: [f64; D],
    axes: [AxisLayers; D],
}

impl<const D: usize> LatticeSites<D> {
    /// Fits a lattice of nearest-neighbour distance about `d` to the box `[0, extent]`, for `D` of
    /// 2 or 3. Every `extent[k]` must be positive.
    pub fn fit(extent: [f64; D], d: f64, alignment: Alignment) -> Self {
        Self {
            extent,
            axes: best_axes(extent, d, alignment),
        }
    }

    /// Returns the count of rows of sites along the first axis.
    pub fn row_count(&self) -> usize {
        self.axes[1..].iter().map(|axis| axis.count + 1).product()
    }

    /// Returns the indices of the sites of a row, which ascend from row to row.
    pub fn row(&self, row: usize) -> std::iter::StepBy<Range<u64>> {
        let (mut rest, mut layer_sum) = (row, 0);
        for axis in &self.axes[1..] {
            layer_sum += rest % (axis.count + 1);
            rest /= axis.count + 1;
        }
        let length = self.axes[0].count as u64 + 1;
        let first = row as u64 * length;
        (first + (layer_sum % 2) as u64..first + length).step_by(2)
    }

    /// Returns the position of a site. Sites on the box's sides have coordinates of exactly `0.0`
    /// or `extent[k]`; with [`Alignment::AlongsideFeatures`] there are none.
    pub fn position(&self, site: u64) -> [f64; D] {
        let layers = index_at(self.axes.map(|axis| axis.count + 1), site as usize);
        std::array::from_fn(|k| {
            let AxisLayers {
                count,
                inset,
                pitch,
            } = self.axes[k];
            if layers[k] == count && inset == 0.0 {
                self.extent[k]
            } else {
                inset + pitch * layers[k] as f64
            }
        })
    }
}

/// Layers of sites along one axis of the box: sites lie at `inset + pitch n`, n up to `count`.
#[derive(Clone, Copy, Default)]
struct AxisLayers {
    count: usize,
    inset: f64,
    pitch: f64,
}

impl AxisLayers {
    /// Divides `length` into layers about `pitch` apart. With [`Alignment::AlongsideFeatures`],
    /// `inset` is left free at both ends. The count of layers is rounded up if `rounds_up`, else
    /// down.
    fn new(length: f64, pitch: f64, inset: Option<f64>, rounds_up: bool) -> Self {
        match inset {
            // Corners are sites only if the count is even.
            None => {
                let below = 2 * (length / (2.0 * pitch)).floor() as usize;
                let count = (below + 2 * usize::from(rounds_up)).max(2);
                Self {
                    count,
                    inset: 0.0,
                    pitch: length / count as f64,
                }
            }
            Some(inset) => {
                let layers = (length / pitch - 2.0 * inset / pitch).max(1.0).floor() as usize;
                let count = layers + usize::from(rounds_up);
                let stretch = length / (count as f64 * pitch + 2.0 * inset);
                Self {
                    count,
                    inset: inset * stretch,
                    pitch: pitch * stretch,
                }
            }
        }
    }
}

/// Returns the counts of layers, and in 2-D the direction of the rows, that distort the lattice
/// least. Distortion is the sum over the kinds of nearest neighbours of `ln(distance / d)^2`.
fn best_axes<const D: usize>(extent: [f64; D], d: f64, alignment: Alignment) -> [AxisLayers; D] {
    // Steps between neighbours, in layers along each axis, are 1 along the axes of the step, and in
    // 2-D also 2 along the rows.
    let mut best = ([AxisLayers::default(); D], f64::INFINITY);
    let orientation_count = if D == 2 { 2 } else { 1 };
    for row_axis in 0..orientation_count {
        let pitch: [f64; D] = std::array::from_fn(|k| {
            d * match (D, k == row_axis) {
                (2, true) => 0.5,
                (2, false) => 0.75f64.sqrt(),
                _ => 0.5f64.sqrt(),
            }
        });
        for choice in 0..1 << D {
            let axes: [AxisLayers; D] = std::array::from_fn(|k| {
                let inset = match alignment {
                    Alignment::OnFeatures => None,
                    // The ends of rows are staggered by half a d: the outer ones are nearer.
                    Alignment::AlongsideFeatures if D == 2 && k == row_axis => Some(0.4 * d),
                    Alignment::AlongsideFeatures => Some(0.5 * d),
                };
                AxisLayers::new(extent[k], pitch[k], inset, choice >> k & 1 == 1)
            });
            let distortion_of = |steps: [f64; D]| {
                let r2: f64 = (0..D).map(|k| (steps[k] * axes[k].pitch).powi(2)).sum();
                (0.5 * (r2 / (d * d)).ln()).powi(2)
            };
            let distortion = if D == 2 {
                let row_step = std::array::from_fn(|k| if k == row_axis { 2.0 } else { 0.0 });
                distortion_of(row_step) + 2.0 * distortion_of([1.0; D])
            } else {
                let plane = |normal| {
                    distortion_of(std::array::from_fn(|k| f64::from(u8::from(k != normal))))
                };
                (0..D).map(plane).sum()
            };
            if distortion < best.1 {
                best = (axes, distortion);
            }
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::AtomKind;
    use crate::lattice::seeding::Atoms;

    /// Returns the smallest and the largest nearest-neighbour distance over d of all atoms.
    fn nearest(positions: &[[f64; 3]], d: f64) -> (f64, f64) {
        let mut range = (f64::INFINITY, 0.0f64);
        for (i, a) in positions.iter().enumerate() {
            let mut nearest2 = f64::INFINITY;
            for (j, b) in positions.iter().enumerate() {
                if i != j {
                    nearest2 = nearest2.min((0..3).map(|k| (a[k] - b[k]).powi(2)).sum());
                }
            }
            range = (
                range.0.min(nearest2.sqrt() / d),
                range.1.max(nearest2.sqrt() / d),
            );
        }
        range
    }

    #[test]
    fn boxes_of_all_sizes_have_exact_corners_and_sound_spacing() {
        let d = 8.0;
        let mut worst_thin = (f64::INFINITY, 0.0f64);
        let mut worst_cube = (f64::INFINITY, 0.0f64);
        let mut worst_wide = (f64::INFINITY, 0.0f64);
        for step in 0..24 {
            let side = d * (2.0 + 0.25 * f64::from(step));
            for (extent, worst) in [
                ([side, 9.7 * d, 10.3 * d], &mut worst_thin),
                ([side, side, side], &mut worst_cube),
                (
                    [side + 6.0 * d, side + 6.4 * d, side + 7.1 * d],
                    &mut worst_wide,
                ),
            ] {
                let atoms =
                    Atoms::from_positions(fit_lattice(extent, d, Alignment::OnFeatures), extent);
                let corners = atoms
                    .kinds
                    .iter()
                    .filter(|&&k| k == AtomKind::Corner)
                    .count();
                assert_eq!(corners, 8, "{extent:?}");
                let range = nearest(&atoms.positions, d);
                *worst = (worst.0.min(range.0), worst.1.max(range.1));
            }
        }
        println!("nearest/d: thin {worst_thin:?}, cubes {worst_cube:?}, wide {worst_wide:?}");
        assert!(worst_thin.0 > 0.85 && worst_thin.1 < 1.06, "{worst_thin:?}");
        assert!(worst_cube.0 > 0.70 && worst_cube.1 < 1.20, "{worst_cube:?}");
        assert!(worst_wide.0 > 0.93 && worst_wide.1 < 1.06, "{worst_wide:?}");
    }

    #[test]
    fn sides_are_centred_squares_with_atoms_on_every_edge() {
        let extent = [40.0, 33.0, 61.5];
        let atoms = Atoms::from_positions(fit_lattice(extent, 5.0, Alignment::OnFeatures), extent);
        let on_edges = atoms.kinds.iter().filter(|&&k| k == AtomKind::Edge).count();
        let counts = best_axes(extent, 5.0, Alignment::OnFeatures).map(|axis| axis.count);
        assert_eq!(
            on_edges,
            counts.iter().map(|n| 4 * (n / 2 - 1)).sum::<usize>()
        );
        let bottom = atoms.positions.iter().filter(|x| x[2] == 0.0).count();
        let top = atoms.positions.iter().filter(|x| x[2] == extent[2]).count();
        assert_eq!(bottom, top);
        assert_eq!(bottom, (counts[0] + 1) * (counts[1] + 1) / 2 + 1);
    }

    #[test]
    fn rectangles_get_a_triangular_lattice_with_exact_corners() {
        for extent in [[100.0, 80.0], [61.0, 97.0], [200.0, 33.0], [20.0, 20.0]] {
            let d = 5.0;
            let atoms =
                Atoms::from_positions(fit_lattice(extent, d, Alignment::OnFeatures), extent);
            let count_kind = |kind| atoms.kinds.iter().filter(|&&k| k == kind).count();
            assert_eq!(count_kind(AtomKind::Corner), 4, "{extent:?}");
            let density = atoms.len() as f64 * d * d * 0.75f64.sqrt() / (extent[0] * extent[1]);
            assert!((0.85..1.4).contains(&density), "{extent:?} {density}");
            for x in &atoms.positions {
                let squares = atoms
                    .positions
                    .iter()
                    .map(|y| crate::geometry::distance2(x, y));
                let mut neighbours: Vec<f64> = squares.map(|r2| r2.sqrt() / d).collect();
                neighbours.sort_by(f64::total_cmp);
                assert!(
                    neighbours[1] > 0.87 && neighbours[1] < 1.13,
                    "{extent:?} {x:?} {}",
                    neighbours[1]
                );
                // Atoms inside have six neighbours.
                if x.iter().zip(extent).all(|(c, l)| *c > d && *c < l - d) {
                    assert!(
                        neighbours[6] < 1.2 && neighbours[7] > 1.4,
                        "{extent:?} {neighbours:?}"
                    );
                }
            }
        }
    }
}
