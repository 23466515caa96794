//! Atoms projected onto features (Esperanca, Oliveira & Cavalcanti 2008, as described by Fernandes
//! & Gattass 2009).
//!
//! Sites of the densest regular lattice of spacing sqrt(3)/3 d(x) look for the best sample of the
//! image within d(x). Pairs of a site and its sample are processed in the order of the distance
//! between the two, nearest first, and the sample becomes an atom if no atom is nearer than 0.8
//! d(x). In the plane every third site is one of a lattice of spacing d.
//!
//! The description leaves open what happens to sites far from features, all of which have their
//! best sample at distance zero. Here a pair needs a sample at the bottom of a valley, that is, no
//! adjacent sample is lower. When all pairs have been tried, first the sites of the lattice of
//! spacing d, then those of the fine lattice, become atoms at their own positions, if they are
//! free.
//!
//! Sites on edges and sides of the box look along these only, and come first, so that the box is
//! filled.

use crate::geometry::grid_index::{offset_of, strides};
use crate::parallel::prelude::*;

use crate::error::{Error, Result, cause};
use crate::image::ScalarField;
use crate::lattice::distance::Distance;
use crate::lattice::seeding::{
    Alignment, MIN_SITE_DISTANCE, SIDE_MARGIN, SharedBox, densest_lattice, empty_grid, grow,
    side_count,
};
use crate::progress::CancelToken;
use crate::published::guide::potential_range;

/// Spacing of the sites, in units of d: sqrt(3) / 3.
const SITE_SPACING_RATIO: f64 = 0.577_350_269_189_625_8;

/// Returns the positions of a lattice of spacing d(x) that fills the box `[0, extent]`, for `D` of
/// 2 or 3, with atoms on the samples of the features of `potential`, which spans the box: -1 on
/// features, 0 elsewhere. Atoms on sides have coordinates of exactly `0.0` or `extent[k]`. None is
/// nearer than 0.8 d to `fixed` atoms, which are in the box and not in the result.
///
/// # Errors
/// Returns [`Error::Seeding`] if the potential is the same everywhere or
/// does not span the box, and for [`Alignment::AlongsideFeatures`].
pub fn project_lattice<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    potential: &ScalarField<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; D]>> {
    if alignment == Alignment::AlongsideFeatures {
        return Err(Error::Seeding(cause(
            "seeding",
            "projection puts atoms onto features, which the faces of Voronoi cells follow",
            "use another seeding for Voronoi cells",
        )));
    }
    potential_range(potential, extent, "projection")?;
    let sites = regular_lattice(extent, &site_distance(distance), cancel)?;
    let best: Vec<Option<(f64, [f64; D])>> = sites
        .par_iter()
        .map(|&site| {
            if cancel.is_cancelled() {
                None
            } else {
                lowest_sample(potential, extent, site, distance.value_at(site))
            }
        })
        .collect();
    // Nearest first; of two at the same distance, the one that is first in the lattice.
    let mut pairs: Vec<(f64, [f64; D])> = best.into_iter().flatten().collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let pairs: Vec<[f64; D]> = pairs.into_iter().map(|pair| pair.1).collect();
    let coarse = regular_lattice(extent, distance, cancel)?;

    let mut grid = empty_grid([0.0; D], extent, MIN_SITE_DISTANCE * distance.min());
    for &x in fixed {
        grid.add(x);
    }
    // Corners first, then edges, sides, and the inside.
    for rank in (0..=D).rev() {
        for &x in pairs.iter().chain(&coarse).chain(&sites) {
            if side_count(x, extent) != rank || cancel.is_cancelled() {
                continue;
            }
            let d = distance.value_at(x);
            let is_clear = |k: usize| {
                let depth = x[k].min(extent[k] - x[k]);
                depth <= 0.0 || depth >= SIDE_MARGIN * d
            };
            let min_distance = if rank == D { 1e-3 } else { MIN_SITE_DISTANCE };
            if (0..D).all(is_clear) && grid.is_free(&x, min_distance * d) {
                grid.add(x);
            }
        }
    }
    Ok(grid.positions()[fixed.len()..].to_vec())
}

/// Returns a regular lattice whose sites reach the sides of the box.
fn regular_lattice<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; D]>> {
    let alignment = Alignment::OnFeatures;
    Ok(match distance {
        Distance::Constant(d) => densest_lattice::fit_lattice(extent, *d, alignment),
        Distance::Field(_) | Distance::Bricks(_) => {
            let shared_box = SharedBox::of_one_process(extent);
            let atoms = grow::grow_lattice(shared_box, distance, &[], alignment, cancel)?;
            atoms.into_iter().map(|(x, _)| x).collect()
        }
    })
}

/// Scales distances between atoms to distances between sites.
fn site_distance<const D: usize>(distance: &Distance<D>) -> Distance<D> {
    match distance {
        Distance::Constant(d) => Distance::Constant(SITE_SPACING_RATIO * d),
        Distance::Field(field) => Distance::Field(field.map(|d| SITE_SPACING_RATIO * d)),
        // This does not occur: projection needs d everywhere.
        Distance::Bricks(_) => distance.clone(),
    }
}

/// Returns the lowest sample within `radius` of a site and the square of its distance; of several
/// lowest samples the nearest. For a site on a side of the box, only the samples of that side
/// count. Returns `None` if the sample is not the bottom of a valley: if it is not negative, or an
/// adjacent sample is lower.
fn lowest_sample<const D: usize>(
    potential: &ScalarField<D>,
    extent: [f64; D],
    site: [f64; D],
    radius: f64,
) -> Option<(f64, [f64; D])> {
    let ScalarField {
        dims,
        step,
        samples,
    } = potential;
    let is_on_side: [bool; D] = std::array::from_fn(|k| site[k] <= 0.0 || site[k] >= extent[k]);
    // Range of indices along each axis, x first.
    let ends: [[usize; 2]; D] = std::array::from_fn(|k| match (is_on_side[k], site[k] > 0.0) {
        (true, true) => [dims[k] - 1; 2],
        (true, false) => [0; 2],
        (false, _) => {
            let low = ((site[k] - radius) / step[k]).ceil().max(1.0) as usize;
            let high = ((site[k] + radius) / step[k]).min(dims[k] as f64 - 2.0) as usize;
            [low, high]
        }
    });
    if (0..D).any(|k| ends[k][0] > ends[k][1]) {
        return None;
    }
    let coordinate = |k: usize, index: usize| {
        if is_on_side[k] {
            site[k]
        } else {
            index as f64 * step[k]
        }
    };
    let strides = strides(*dims);
    let mut best = (0.0f32, f64::INFINITY, [0; D]);
    let mut index = ends.map(|e| e[0]);
    loop {
        let across2: f64 = (1..D)
            .map(|k| (coordinate(k, index[k]) - site[k]).powi(2))
            .sum();
        let row: usize = (1..D).map(|k| index[k] * strides[k]).sum();
        for (x, &b) in (ends[0][0]..).zip(&samples[row + ends[0][0]..=row + ends[0][1]]) {
            if b > best.0 || b >= 0.0 {
                continue;
            }
            let r2 = across2 + (coordinate(0, x) - site[0]).powi(2);
            if r2 <= radius * radius && (b < best.0 || r2 < best.1) {
                index[0] = x;
                best = (b, r2, index);
            }
        }
        // The next row of the block.
        let Some(k) = (1..D).find(|&k| index[k] < ends[k][1]) else {
            break;
        };
        index[k] += 1;
        for j in 1..k {
            index[j] = ends[j][0];
        }
    }
    let (depth, r2, index) = best;
    let flat = offset_of(*dims, index);
    let is_lowest = |k: usize| {
        is_on_side[k] || depth <= samples[flat - strides[k]].min(samples[flat + strides[k]])
    };
    (depth < 0.0 && (0..D).all(is_lowest))
        .then(|| (r2, std::array::from_fn(|k| coordinate(k, index[k]))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::seeding::grow::tests::varying_distance;
    use crate::lattice::seeding::seed_with;
    use crate::published::guide::tests::{check_atoms_in_valley, valley};

    #[test]
    fn the_lowest_sample_is_found() {
        let extent = [30.0, 20.0, 24.0];
        let mut field = ScalarField::from_fn([31, 21, 25], [1.0; 3], |_| 0.0);
        let mut set =
            |index: [usize; 3], b| field.samples[(index[2] * 21 + index[1]) * 31 + index[0]] = b;
        set([10, 10, 10], -0.5);
        set([14, 10, 10], -1.0);
        set([0, 10, 10], -0.9);
        let find = |site, radius| lowest_sample(&field, extent, site, radius);
        assert_eq!(find([11.0, 10.0, 10.5], 2.0), Some((1.25, [10.0; 3])));
        assert_eq!(
            find([11.0, 10.0, 10.5], 3.5),
            Some((9.25, [14.0, 10.0, 10.0]))
        );
        assert_eq!(find([11.0, 10.0, 14.0], 3.0), None);
        // A site on a side finds samples on that side only; a site inside finds none on sides.
        assert_eq!(find([0.0, 9.0, 10.0], 3.0), Some((1.0, [0.0, 10.0, 10.0])));
        assert_eq!(find([2.0, 10.0, 10.0], 4.0), None);
        assert_eq!(find([0.0, 9.0, 0.0], 11.0), None);
        // A slope is not the bottom of a valley.
        let slope = ScalarField::from_fn([31, 21, 25], [1.0; 3], |x| -x[0] / 30.0);
        assert_eq!(lowest_sample(&slope, extent, [11.0, 10.0, 10.0], 3.0), None);
    }

    fn check<const D: usize>(extent: [f64; D], distance: &Distance<D>, densest: f64) {
        let potential = valley(extent);
        let place_atoms = || {
            let (alignment, cancel) = (Alignment::OnFeatures, &CancelToken::never());
            let project = |fixed: &[[f64; D]]| {
                project_lattice(extent, distance, &potential, fixed, alignment, cancel)
            };
            seed_with(extent, distance, &[], alignment, project).unwrap()
        };
        let atoms = place_atoms();
        check_atoms_in_valley(&atoms, extent, distance, densest);
        assert_eq!(atoms, place_atoms());
    }

    #[test]
    fn a_rectangle_is_filled_features_first() {
        let extent = [120.0, 91.0];
        check(extent, &Distance::Constant(5.0), 0.6);
        check(extent, &varying_distance(extent), 0.6);
    }

    #[test]
    fn a_box_is_filled_features_first() {
        let extent = [60.0, 53.0, 48.0];
        check(extent, &Distance::Constant(5.0), 0.5);
        check(extent, &varying_distance(extent), 0.5);
    }

    #[test]
    fn cells_alongside_are_refused() {
        let (extent, distance) = ([40.0, 30.0], Distance::Constant(5.0));
        let (alignment, cancel) = (Alignment::AlongsideFeatures, &CancelToken::never());
        let potential = valley(extent);
        let refused = project_lattice(extent, &distance, &potential, &[], alignment, cancel);
        assert!(refused.unwrap_err().to_string().contains("onto features"));
    }
}
