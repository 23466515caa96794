//! Snaps atoms near features onto them, and keeps them apart from each other.

use crate::parallel::prelude::*;

use super::constraint::NodeConstraint;
use super::feature_planes::FeaturePlanes;
use crate::error::Result;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::{bounding_box, distance2, norm, sub, to_3d};
use crate::lattice::AtomKind;
use crate::lattice::halo::OwnedAndGhosts;
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::Atoms;

/// Largest move of an atom, in units of the reach.
const MAX_MOVE_RATIO: f64 = 1.5;
/// Smallest distance between two atoms after snapping, in units of the reach.
const MIN_GAP_RATIO: f64 = 0.1;

/// Moves the atoms within `reach` samples of a feature onto it (onto all features, where several
/// cross). Atoms stay in the sides of the box, and two atoms never come closer than a minimum
/// distance. Returns the number of atoms that moved.
pub fn snap_to_features<const D: usize>(
    positions: &mut [[f64; D]],
    kinds: &[AtomKind],
    extent: [f64; D],
    planes: &FeaturePlanes,
    reach: f64,
) -> usize {
    let halo = OwnedAndGhosts::all(positions.len());
    // Only communication can fail.
    snap_owned(positions, kinds, &halo, extent, planes, reach).unwrap_or(0)
}

/// Returns the width of the halo that [`snap_distributed`] needs: two atoms may each move towards the
/// other.
pub fn snap_halo_width(reach: f64) -> f64 {
    (2.0 * MAX_MOVE_RATIO + 2.0 * MIN_GAP_RATIO) * reach
}

/// Snaps atoms as [`snap_to_features`] does, where each rank owns a part of them. `local` are the
/// owned atoms with a halo of [`snap_halo_width`]. Returns the number of own atoms that moved.
///
/// # Errors
/// Returns an error if another rank fails.
pub fn snap_distributed<const D: usize>(
    owned_atoms: &mut OwnedAtoms<D>,
    local: (OwnedAndGhosts<'_>, Atoms<D>),
    extent: [f64; D],
    planes: &FeaturePlanes,
    reach: f64,
) -> Result<usize> {
    let (
        halo,
        Atoms {
            mut positions,
            kinds,
        },
    ) = local;
    let moved = snap_owned(&mut positions, &kinds, &halo, extent, planes, reach)?;
    (owned_atoms.atoms.positions).copy_from_slice(&positions[halo.owned()]);
    Ok(moved)
}

/// Snaps the owned atoms; ghosts are updated from their owners.
fn snap_owned<const D: usize>(
    positions: &mut [[f64; D]],
    kinds: &[AtomKind],
    halo: &OwnedAndGhosts<'_>,
    extent: [f64; D],
    planes: &FeaturePlanes,
    reach: f64,
) -> Result<usize> {
    let (before, extent) = (positions.to_vec(), to_3d(extent));
    let moved: usize = positions[halo.owned()]
        .par_iter_mut()
        .zip(&kinds[halo.owned()])
        .map(|(x, &kind)| {
            let position = to_3d(*x);
            if planes.is_far(position) || !planes.is_close(position) {
                return 0;
            }
            let mut constraint = NodeConstraint::from_box(position, kind, extent);
            let nearby = planes.planes_near(position);
            for plane in nearby.iter().filter(|s| s.offset.abs() < reach) {
                constraint.add_surface(plane.normal);
            }
            // Snap onto all features if they can be reached, else drop the farthest and try again.
            while constraint.surface_count > 0 {
                let mut trial = constraint;
                if let Some(y) = trial.snap(position, extent, planes)
                    && norm(sub(y, position)) < MAX_MOVE_RATIO * reach
                {
                    *x = std::array::from_fn(|k| y[k]);
                    return 1;
                }
                constraint.surface_count -= 1;
            }
            0
        })
        .sum();
    halo.update_ghosts(positions)?;
    // Two atoms at one position would become one node.
    Ok(moved - enforce_gap(positions, &before, halo, MIN_GAP_RATIO * reach)?)
}

/// Moves owned atoms back that came closer than `gap` to another one, and returns their number.
/// `before` has the original positions, which were all farther apart. Of two atoms that meet, the
/// one with the higher index goes back.
fn enforce_gap<const D: usize>(
    positions: &mut [[f64; D]],
    before: &[[f64; D]],
    halo: &OwnedAndGhosts<'_>,
    gap: f64,
) -> Result<usize> {
    let mut returned = 0;
    // An atom that goes back may meet another that has moved to its old position, so repeat until
    // none meet.
    loop {
        let has_moved = |k: usize| positions[k] != before[k];
        let cells = build_cells(positions, gap);
        let is_too_close = |k: usize| {
            cells.any_near(&positions[k], gap, |other| {
                let is_near = distance2(&positions[k], &positions[other]) < gap * gap;
                other != k && is_near && (other < k || !has_moved(other))
            })
        };
        let returning: Vec<usize> = halo
            .owned()
            .into_par_iter()
            .filter(|&k| has_moved(k) && is_too_close(k))
            .collect();
        if !halo.any("atoms moved back", !returning.is_empty())? {
            return Ok(returned);
        }
        for &k in &returning {
            positions[k] = before[k];
        }
        halo.update_ghosts(positions)?;
        returned += returning.len();
    }
}

/// Returns a grid of the atoms, with about one atom per cell, whose cells are at least `min_size`
/// wide.
fn build_cells<const D: usize>(positions: &[[f64; D]], min_size: f64) -> IncrementalGrid<D> {
    let [low, high] = bounding_box(positions);
    let spans = sub(high, low);
    let wide_spans = spans.iter().filter(|&&s| s > min_size);
    let (axes, volume) = wide_spans.fold((0, 1.0), |(n, volume), s| (n + 1, volume * s));
    let mean_spacing = (volume / positions.len().max(1) as f64).powf(1.0 / f64::from(axes.max(1)));
    let mut grid = IncrementalGrid::new(low, high, min_size.max(mean_spacing));
    for &x in positions {
        grid.add(x);
    }
    grid
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_atoms_that_meet_one_returns_and_may_make_a_third_return() {
        let before = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [9.0, 0.0, 0.0]];
        // Atoms 0 and 1 meet at x = 0.5. Atom 2 has moved to where atom 1 must return.
        let mut positions = [
            [0.5, 0.0, 0.0],
            [0.5, 0.01, 0.0],
            [1.0, 0.0, 0.02],
            [9.5, 0.0, 0.0],
        ];
        let halo = OwnedAndGhosts::all(4);
        assert_eq!(enforce_gap(&mut positions, &before, &halo, 0.1).unwrap(), 2);
        assert_eq!(
            positions,
            [[0.5, 0.0, 0.0], before[1], before[2], [9.5, 0.0, 0.0]]
        );
    }

    #[test]
    fn distributed_snapping_gives_the_result_of_one_rank() {
        use crate::comm::run_threads;
        use crate::feature::FeaturePoint;
        use crate::lattice::distance::Distance;
        use crate::lattice::energy::CHUNK_ATOMS;
        use crate::lattice::seeding::{Alignment, fcc};

        let (extent, d) = ([70.0, 48.0, 45.0], 3.0);
        // Two planes so close that some atoms from both sides meet.
        let plane = |plane_x: f32| {
            (0..=45).flat_map(move |z| {
                (0..=48).map(move |y| FeaturePoint {
                    position: [plane_x - 0.5 * y as f32, y as f32, z as f32],
                    normal: [1.0, 0.5, 0.0].map(|c| c / 1.25f32.sqrt()),
                    strength: 1.0,
                })
            })
        };
        let points: Vec<FeaturePoint<3>> = plane(40.0).chain(plane(42.2)).collect();
        let planes = FeaturePlanes::new(&points, extent, 2.4, 4.0);
        let seeded = fcc(extent, &Distance::Constant(d), &[], Alignment::OnFeatures).unwrap();
        assert!(seeded.len() > 6 * CHUNK_ATOMS);
        let (mut serial, reach) = (seeded.clone(), 0.9 * d);
        let Atoms { positions, kinds } = &mut serial;
        let moved = snap_to_features(positions, kinds, extent, &planes, reach);
        assert!(moved > 300, "{moved}");
        for count in [2, 5] {
            let results = run_threads(count, |comm| {
                let mut owned_atoms = OwnedAtoms::from_global(seeded.clone(), comm);
                let halo_width = snap_halo_width(reach);
                let local = OwnedAndGhosts::with_halo(&owned_atoms, halo_width, comm).unwrap();
                let moved =
                    snap_distributed(&mut owned_atoms, local, extent, &planes, reach).unwrap();
                (owned_atoms.all_gather(comm).unwrap(), moved)
            });
            let total: usize = results.iter().map(|(_, moved)| moved).sum();
            assert_eq!(total, moved, "{count}");
            assert!(results.iter().all(|(atoms, _)| *atoms == serial), "{count}");
        }
    }
}
