//! Atoms near features go onto them, no two to one place.

use crate::parallel::prelude::*;

use super::constraint::NodeConstraint;
use super::feature_planes::FeaturePlanes;
use crate::comm::Comm;
use crate::error::Result;
use crate::geometry::incremental_grid::IncrementalGrid;
use crate::geometry::{bounding_box, distance2, norm, sub, to_3d};
use crate::lattice::AtomKind;
use crate::lattice::halo::OwnedAndGhosts;
use crate::lattice::partition::OwnedAtoms;
use crate::lattice::seeding::Atoms;

/// Atoms move so far at most, in units of the reach ...
const MAX_MOVE_RATIO: f64 = 1.5;
/// ... and no two come so near to each other.
const MIN_GAP_RATIO: f64 = 0.1;

/// Moves the atoms within `reach` of a feature onto it (onto all of them, where several cross),
/// never off the box's sides, and no two to one place. Returns how many were moved.
pub fn snap_to_features<const D: usize>(
    positions: &mut [[f64; D]],
    kinds: &[AtomKind],
    extent: [f64; D],
    sheets: &FeaturePlanes,
    reach: f64,
) -> usize {
    let held = OwnedAndGhosts::all(positions.len());
    // Alone nothing fails.
    snap_owned(positions, kinds, &held, extent, sheets, reach).unwrap_or(0)
}

/// The same by several, each of which has a share of the atoms.
///
/// # Errors
/// Those of the others.
pub fn snap_distributed<const D: usize>(
    share: &mut OwnedAtoms<D>,
    extent: [f64; D],
    sheets: &FeaturePlanes,
    reach: f64,
    group: &dyn Comm,
) -> Result<usize> {
    if group.size() == 1 {
        let Atoms { positions, kinds } = &mut share.atoms;
        return Ok(snap_to_features(positions, kinds, extent, sheets, reach));
    }
    // Two may both come nearer to each other.
    let room = (2.0 * MAX_MOVE_RATIO + 2.0 * MIN_GAP_RATIO) * reach;
    let (
        held,
        Atoms {
            mut positions,
            kinds,
        },
    ) = OwnedAndGhosts::with_halo(share, room, group)?;
    let moved = snap_owned(&mut positions, &kinds, &held, extent, sheets, reach)?;
    (share.atoms.positions).copy_from_slice(&positions[held.owned()]);
    Ok(moved)
}

/// The same of those own ones of the atoms held.
fn snap_owned<const D: usize>(
    positions: &mut [[f64; D]],
    kinds: &[AtomKind],
    held: &OwnedAndGhosts<'_>,
    extent: [f64; D],
    sheets: &FeaturePlanes,
    reach: f64,
) -> Result<usize> {
    let (before, extent) = (positions.to_vec(), to_3d(extent));
    let moved: usize = positions[held.owned()]
        .par_iter_mut()
        .zip(&kinds[held.owned()])
        .map(|(x, &kind)| {
            let at = to_3d(*x);
            if sheets.is_far(at) || !sheets.is_close(at) {
                return 0;
            }
            let mut hold = NodeConstraint::from_box(at, kind, extent);
            let near = sheets.planes_near(at);
            for sheet in near.iter().filter(|s| s.offset.abs() < reach) {
                hold.add_surface(sheet.normal);
            }
            // On both features if that can be reached, else on the nearer one.
            while hold.surface_count > 0 {
                let mut trial = hold;
                if let Some(y) = trial.snap(at, extent, sheets)
                    && norm(sub(y, at)) < MAX_MOVE_RATIO * reach
                {
                    *x = std::array::from_fn(|k| y[k]);
                    return 1;
                }
                hold.surface_count -= 1;
            }
            0
        })
        .sum();
    held.update_ghosts(positions)?;
    // Two atoms pulled to one place would be one node.
    Ok(moved - enforce_gap(positions, &before, held, MIN_GAP_RATIO * reach)?)
}

/// Moves own atoms back that came nearer than `gap` to another: `before` holds where each atom was, and
/// there they all were farther apart. Of two that meet, the one of the higher number goes back.
/// Returns how many own ones did.
fn enforce_gap<const D: usize>(
    positions: &mut [[f64; D]],
    before: &[[f64; D]],
    held: &OwnedAndGhosts<'_>,
    gap: f64,
) -> Result<usize> {
    let mut returned = 0;
    // One that goes back may meet another that has come near its old place: look again.
    loop {
        let moved = |k: usize| positions[k] != before[k];
        let cells = build_cells(positions, gap);
        let meets = |k: usize| {
            cells.any_near(&positions[k], gap, |other| {
                let near = distance2(&positions[k], &positions[other]) < gap * gap;
                other != k && near && (other < k || !moved(other))
            })
        };
        let back: Vec<usize> = held
            .owned()
            .into_par_iter()
            .filter(|&k| moved(k) && meets(k))
            .collect();
        let all = held.all_gather("atoms that go back", back.len())?;
        if all.iter().all(|&back| back == 0) {
            return Ok(returned);
        }
        for &k in &back {
            positions[k] = before[k];
        }
        held.update_ghosts(positions)?;
        returned += back.len();
    }
}

/// Atoms in cells, about one in each, which are at least `size` wide.
fn build_cells<const D: usize>(positions: &[[f64; D]], size: f64) -> IncrementalGrid<D> {
    let [low, high] = bounding_box(positions);
    let spans = sub(high, low);
    let wide = spans.iter().filter(|&&s| s > size);
    let (axes, room) = wide.fold((0, 1.0), |(n, room), s| (n + 1, room * s));
    let roomy = (room / positions.len().max(1) as f64).powf(1.0 / f64::from(axes.max(1)));
    let mut scatter = IncrementalGrid::new(low, high, size.max(roomy));
    for &x in positions {
        scatter.add(x);
    }
    scatter
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_that_meet_one_goes_back_and_may_push_a_third() {
        let before = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [9.0, 0.0, 0.0]];
        // 0 and 1 meet at 0.5; 2 has gone to where 1 must return to.
        let mut positions = [
            [0.5, 0.0, 0.0],
            [0.5, 0.01, 0.0],
            [1.0, 0.0, 0.02],
            [9.5, 0.0, 0.0],
        ];
        let held = OwnedAndGhosts::all(4);
        assert_eq!(enforce_gap(&mut positions, &before, &held, 0.1).unwrap(), 2);
        assert_eq!(
            positions,
            [[0.5, 0.0, 0.0], before[1], before[2], [9.5, 0.0, 0.0]]
        );
    }

    #[test]
    fn several_put_their_atoms_onto_features_as_one_does() {
        use crate::comm::run_threads;
        use crate::feature::FeaturePoint;
        use crate::lattice::distance::Distance;
        use crate::lattice::energy::CHUNK_ATOMS;
        use crate::lattice::seeding::{Alignment, fcc};

        let (extent, d) = ([70.0, 48.0, 45.0], 3.0);
        // Two planes so near to each other that some atoms of either side meet.
        let plane = |at: f32| {
            (0..=45).flat_map(move |z| {
                (0..=48).map(move |y| FeaturePoint {
                    position: [at - 0.5 * y as f32, y as f32, z as f32],
                    normal: [1.0, 0.5, 0.0].map(|c| c / 1.25f32.sqrt()),
                    strength: 1.0,
                })
            })
        };
        let points: Vec<FeaturePoint<3>> = plane(40.0).chain(plane(42.2)).collect();
        let sheets = FeaturePlanes::new(&points, extent, 2.4, 4.0);
        let seeded = fcc(extent, &Distance::Constant(d), &[], Alignment::OnFeatures).unwrap();
        assert!(seeded.len() > 6 * CHUNK_ATOMS);
        let (mut alone, reach) = (seeded.clone(), 0.9 * d);
        let Atoms { positions, kinds } = &mut alone;
        let moved = snap_to_features(positions, kinds, extent, &sheets, reach);
        assert!(moved > 300, "{moved}");
        for count in [2, 5] {
            let found = run_threads(count, |group| {
                let mut share = OwnedAtoms::from_global(seeded.clone(), group);
                let moved = snap_distributed(&mut share, extent, &sheets, reach, group).unwrap();
                (share.all_gather(group).unwrap(), moved)
            });
            let all: usize = found.iter().map(|(_, moved)| moved).sum();
            assert_eq!(all, moved, "{count}");
            assert!(found.iter().all(|(atoms, _)| *atoms == alone), "{count}");
        }
    }
}
