//! The face-centred cubic (FCC) lattice fitted to a box, for constant d.
//!
//! An FCC lattice of nearest-neighbour distance d is the set of sites `(i, j, k) h` with
//! `i + j + k` even and `h = d / sqrt 2`, half the edge of its cube. Planes of sites normal to an
//! axis are `h` apart; every one is a centred square lattice of nearest-neighbour distance d, and so
//! makes a good side of the box. All eight corners of a box are sites only if it measures an *even*
//! number of half cells along every axis (an odd number leaves corners out and atoms half a cell
//! from the edges), so the lattice is stretched per axis to the even number that distorts it least.
//! Squeezing along one axis is mild (by `1 / sqrt 2` it makes a body-centred lattice, whose
//! tetrahedra are as good), and so even a box only two d across gets a sound lattice.

/// Positions of an FCC lattice of nearest-neighbour distance about `d` that fills the box
/// `[0, extent]`; sites on the box's sides have coordinates of exactly `0.0` or `extent[k]`.
/// Every `extent[k]` must be positive.
pub fn fitted(extent: [f64; 3], d: f64) -> Vec<[f64; 3]> {
    let counts = half_cells(extent, d);
    let coordinate = |axis: usize, site: usize| {
        if site == counts[axis] {
            extent[axis]
        } else {
            extent[axis] * site as f64 / counts[axis] as f64
        }
    };
    let mut positions = Vec::with_capacity(counts.iter().map(|n| n + 1).product::<usize>() / 2 + 1);
    for k in 0..=counts[2] {
        for j in 0..=counts[1] {
            for i in ((j + k) % 2..=counts[0]).step_by(2) {
                positions.push([coordinate(0, i), coordinate(1, j), coordinate(2, k)]);
            }
        }
    }
    positions
}

/// The even number of half cells along each axis that distorts the lattice least: the sum over the
/// three kinds of nearest neighbours (in the xy, yz, zx planes) of `ln(distance / d)^2`.
fn half_cells(extent: [f64; 3], d: f64) -> [usize; 3] {
    let half_cell = d / std::f64::consts::SQRT_2;
    let mut best = ([2; 3], f64::INFINITY);
    for choice in 0..8 {
        let counts: [usize; 3] = std::array::from_fn(|k| {
            let below = 2 * (extent[k] / (2.0 * half_cell)).floor() as usize;
            (below + 2 * (choice >> k & 1)).max(2)
        });
        let stretch: [f64; 3] = std::array::from_fn(|k| extent[k] / (counts[k] as f64 * half_cell));
        let distortion = (0..3)
            .map(|k| {
                let (a, b) = (stretch[k], stretch[(k + 1) % 3]);
                (0.5 * ((a * a + b * b) / 2.0).ln()).powi(2)
            })
            .sum();
        if distortion < best.1 {
            best = (counts, distortion);
        }
    }
    best.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::AtomKind;
    use crate::seeding::Atoms;

    /// Nearest-neighbour distances over d, smallest and largest over all atoms.
    fn nearest(positions: &[[f64; 3]], d: f64) -> (f64, f64) {
        let mut range = (f64::INFINITY, 0.0f64);
        for (i, a) in positions.iter().enumerate() {
            let mut least = f64::INFINITY;
            for (j, b) in positions.iter().enumerate() {
                if i != j {
                    least = least.min((0..3).map(|k| (a[k] - b[k]).powi(2)).sum());
                }
            }
            range = (range.0.min(least.sqrt() / d), range.1.max(least.sqrt() / d));
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
                let atoms = Atoms::in_box(fitted(extent, d), extent);
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
        let atoms = Atoms::in_box(fitted(extent, 5.0), extent);
        let on_edges = atoms.kinds.iter().filter(|&&k| k == AtomKind::Edge).count();
        let counts = half_cells(extent, 5.0);
        assert_eq!(
            on_edges,
            counts.iter().map(|n| 4 * (n / 2 - 1)).sum::<usize>()
        );
        let bottom = atoms.positions.iter().filter(|x| x[2] == 0.0).count();
        let top = atoms.positions.iter().filter(|x| x[2] == extent[2]).count();
        assert_eq!(bottom, top);
        assert_eq!(bottom, (counts[0] + 1) * (counts[1] + 1) / 2 + 1);
    }
}
