//! An isotropic lattice by Delaunay refinement (Hale 2002): corners and one more point, then
//! repeatedly the centre of the largest circumsphere in units of d, until no circumsphere is larger
//! than a fixed fraction of d.
//!
//! So that the box is filled exactly, its edges come first, evenly divided; then each of its sides,
//! refined in the plane; then the inside. Circumcentres outside the box are not used. No direction
//! is favoured: the image, not the lattice, determines where atoms line up.

use super::{Alignment, side_count};
use crate::error::Result;
use crate::geometry::distance2;
use crate::geometry::random::Random;
use crate::lattice::distance::Distance;
use crate::mesh::delaunay::refine::{refine_plane, refine_space};
use crate::progress::CancelToken;

/// Largest circumradius in the plane, in units of d (Hale 2002).
const MAX_CIRCUMRADIUS_2D: f64 = 0.760;
/// Largest circumradius in space, in units of d (Hale 2002).
const MAX_CIRCUMRADIUS_3D: f64 = 0.803;
/// Smallest distance of an atom on an edge from a fixed atom, in units of d.
const MIN_FIXED_DISTANCE: f64 = 0.8;

/// Returns the positions of an isotropic lattice of spacing d(x) that fills the box `[0, extent]`,
/// for `D` of 2 or 3. Atoms on its sides have coordinates of exactly `0.0` or `extent[k]`. The
/// lattice keeps its distance from `fixed` atoms, which are in the box and not in the result.
/// `seed` chooses the first point inside.
///
/// With [`Alignment::AlongsideFeatures`], all atoms are moved inwards, those of a side by half a d.
///
/// # Errors
/// Returns the errors of [`refine_plane`] and [`refine_space`].
pub fn refine_lattice<const D: usize>(
    extent: [f64; D],
    distance: &Distance<D>,
    fixed: &[[f64; D]],
    alignment: Alignment,
    seed: u64,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; D]>> {
    let mut atoms = fixed.to_vec();
    let corners = faces::<D>(&[]).map(|end| std::array::from_fn(|k| end[k] * extent[k]));
    atoms.extend(corners.filter(|x| !fixed.contains(x)));
    for axis in 0..D {
        for end in faces::<D>(&[axis]) {
            let point_at = |t: f64| -> [f64; D] {
                std::array::from_fn(|k| if k == axis { t } else { end[k] * extent[k] })
            };
            let is_free = |x: &[f64; D]| {
                let radius = MIN_FIXED_DISTANCE * distance.value_at(*x);
                fixed.iter().all(|y| distance2(x, y) >= radius * radius)
            };
            let positions = graded_positions(extent[axis], distance.min(), |t| {
                distance.value_at(point_at(t))
            });
            atoms.extend(positions.into_iter().map(point_at).filter(is_free));
        }
    }
    if D == 3 {
        for normal in 0..D {
            let axes: [usize; 2] = [(normal + 1) % D, (normal + 2) % D];
            for end in faces::<D>(&axes) {
                let level = end[normal] * extent[normal];
                let lift = |x: [f64; 2]| -> [f64; D] {
                    std::array::from_fn(|k| match k {
                        _ if k == normal => level,
                        _ => x[usize::from(k == axes[1])],
                    })
                };
                let on_side = atoms.iter().filter(|x| x[normal] == level);
                let start: Vec<[f64; 2]> = on_side.map(|x| axes.map(|k| x[k])).collect();
                let d = |x| distance.value_at(lift(x));
                let added = refine_plane(
                    &start,
                    axes.map(|k| extent[k]),
                    d,
                    MAX_CIRCUMRADIUS_2D,
                    cancel,
                )?;
                atoms.extend(added.into_iter().map(lift));
            }
        }
    }
    // One random point away from the corners.
    let mut random = Random::new(seed);
    let first = extent.map(|e| e * (0.35 + 0.3 * random.draw()));
    let is_near = |y: &[f64; D]| {
        distance2(&first, y) < (MIN_FIXED_DISTANCE * distance.value_at(first)).powi(2)
    };
    if !atoms.iter().any(is_near) {
        atoms.push(first);
    }
    let added = refine_interior(&atoms, extent, distance, cancel)?;
    atoms.extend(added);
    atoms.drain(..fixed.len());
    if alignment == Alignment::AlongsideFeatures {
        for x in &mut atoms {
            let d = distance.value_at(*x);
            *x = std::array::from_fn(|k| x[k] + d * (0.5 - x[k] / extent[k]));
        }
        let is_free = |x: &[f64; D]| {
            let radius = MIN_FIXED_DISTANCE * distance.value_at(*x);
            fixed.iter().all(|y| distance2(x, y) >= radius * radius)
        };
        atoms.retain(|x| is_free(x) && side_count(*x, extent) == 0);
    }
    Ok(atoms)
}

/// Refines the inside of the box.
fn refine_interior<const D: usize>(
    atoms: &[[f64; D]],
    extent: [f64; D],
    distance: &Distance<D>,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; D]>> {
    // The compiler does not know that `D` is 2 or 3, so coordinates are copied one by one.
    fn cast_dims<const D: usize, const E: usize>(x: [f64; D]) -> [f64; E] {
        std::array::from_fn(|k| x[k])
    }
    if D == 2 {
        let plane: Vec<[f64; 2]> = atoms.iter().map(|x| cast_dims(*x)).collect();
        let d = |x: [f64; 2]| distance.value_at(cast_dims(x));
        let added = refine_plane(&plane, cast_dims(extent), d, MAX_CIRCUMRADIUS_2D, cancel)?;
        return Ok(added.into_iter().map(cast_dims).collect());
    }
    let space: Vec<[f64; 3]> = atoms.iter().map(|x| cast_dims(*x)).collect();
    let d = |x: [f64; 3]| distance.value_at(cast_dims(x));
    let added = refine_space(&space, cast_dims(extent), d, MAX_CIRCUMRADIUS_3D, cancel)?;
    Ok(added.into_iter().map(cast_dims).collect())
}

/// Returns the faces of the unit box that lie along the given axes, by the coordinates (0 or 1)
/// along the other axes.
fn faces<const D: usize>(axes: &[usize]) -> impl Iterator<Item = [f64; D]> {
    (0..1usize << D)
        .filter(move |n| axes.iter().all(|k| n >> k & 1 == 0))
        .map(|n| std::array::from_fn(|k| (n >> k & 1) as f64))
}

/// Returns positions between the ends of a length, evenly spread in units of d(t).
pub(crate) fn graded_positions(length: f64, min_d: f64, d: impl Fn(f64) -> f64) -> Vec<f64> {
    // Count of spacings from the start to each of many points (midpoint rule).
    let piece_count = (8.0 * length / min_d).ceil().max(8.0) as usize;
    let piece = length / piece_count as f64;
    let mut spacings = vec![0.0];
    for n in 0..piece_count {
        spacings.push(spacings[n] + piece / d((n as f64 + 0.5) * piece));
    }
    let count = spacings[piece_count].round().max(1.0);
    let scale = spacings[piece_count] / count;
    let mut n = 0;
    let position = |k: usize| {
        let target = k as f64 * scale;
        while n + 1 < piece_count && spacings[n + 1] < target {
            n += 1;
        }
        (n as f64 + (target - spacings[n]) / (spacings[n + 1] - spacings[n])) * piece
    };
    (1..count as usize).map(position).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::AtomKind;
    use crate::lattice::seeding::grow::tests::{spacing_quantiles, varying_distance};
    use crate::lattice::seeding::{Atoms, Seeding, seed, seed_on_features};

    fn check<const D: usize>(extent: [f64; D], distance: &Distance<D>) -> [f64; 5] {
        let seeding = Seeding::Refine { seed: 1 };
        let atoms = seed_on_features(seeding, extent, distance, &[]).unwrap();
        let count_kind = |kind| atoms.kinds.iter().filter(|&&k| k == kind).count();
        assert_eq!(count_kind(AtomKind::Corner), 1 << D);
        assert!(count_kind(AtomKind::Edge) > 20 && (D == 2 || count_kind(AtomKind::Side) > 100));
        let refined = spacing_quantiles(&atoms, distance);
        let regular = seed_on_features(Seeding::Fcc, extent, distance, &[]).unwrap();
        let regular = spacing_quantiles(&regular, distance);
        println!(
            "{D}-D, {} atoms: nearest / d {refined:.3?}, regular {regular:.3?}",
            atoms.len()
        );
        refined
    }

    #[test]
    fn a_rectangle_is_filled_evenly() {
        let extent = [120.0, 91.0];
        for distance in [Distance::Constant(5.0), varying_distance(extent)] {
            let [min, low, median, high, _] = check(extent, &distance);
            // 0.76 at the circumcentre, where d may be larger by its slope.
            assert!(
                min > 0.70 && low > 0.70 && high < 1.15,
                "{min} {low} {high}"
            );
            assert!((0.76..1.0).contains(&median), "{median}");
        }
    }

    #[test]
    fn a_box_is_filled_evenly() {
        let extent = [60.0, 53.0, 48.0];
        for distance in [Distance::Constant(5.0), varying_distance(extent)] {
            let [min, low, median, high, _] = check(extent, &distance);
            assert!(min > 0.7 && low > 0.74 && high < 1.2, "{min} {low} {high}");
            assert!((0.8..1.0).contains(&median), "{median}");
        }
    }

    #[test]
    fn makes_room_for_fixed_atoms_and_keeps_off_the_sides_alongside() {
        let extent = [80.0, 70.0];
        let distance = Distance::Constant(5.0);
        let fixed = [[31.0, 22.0], [70.0, 12.5]];
        let seeding = Seeding::Refine { seed: 3 };
        for alignment in [Alignment::OnFeatures, Alignment::AlongsideFeatures] {
            let atoms = seed(
                seeding,
                extent,
                &distance,
                &fixed,
                alignment,
                &CancelToken::never(),
            )
            .unwrap();
            assert_eq!(atoms.positions[atoms.len() - 2..], fixed);
            assert!(spacing_quantiles(&atoms, &distance)[0] > 0.65);
            let is_inside = |x: &[f64; 2]| (0..2).all(|k| x[k] > 2.0 && x[k] < extent[k] - 2.0);
            let all_inside = atoms.positions.iter().all(is_inside);
            assert_eq!(all_inside, alignment == Alignment::AlongsideFeatures);
        }
    }

    #[test]
    fn another_seed_gives_another_lattice() {
        let refine_with = |seed| {
            refine_lattice(
                [50.0, 40.0],
                &Distance::Constant(4.0),
                &[],
                Alignment::OnFeatures,
                seed,
                &CancelToken::never(),
            )
        };
        assert_eq!(refine_with(1).unwrap(), refine_with(1).unwrap());
        assert_ne!(refine_with(1).unwrap(), refine_with(2).unwrap());
        assert!(Atoms::from_positions(refine_with(1).unwrap(), [50.0, 40.0]).len() > 100);
    }
}
