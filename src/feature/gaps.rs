//! How fine a lattice must be to tell a feature from the next one.
//!
//! From each point of a sheet another one is sought along the normal, both ways. Nearer than the
//! largest distance between atoms, the gap is the distance that they may have there; at a shallow
//! crossing it goes to zero, and the least distance decides. Sheets that cross at more than
//! [`CLEAR`] degrees need no finer lattice: one row of atoms stands on both. Nor does a sheet whose
//! normals scatter in noise, if it is known which points are of one sheet.

use super::FeaturePoint;
use super::by_sample::BySample;
use super::crossing::{Candidate, Voxel, nearest};
use crate::geometry::{dot, sub};
use rayon::prelude::*;

/// Sheets that meet at more than this (degrees) do not run beside one another.
const CLEAR: f32 = 40.0;
/// Within this of a point (samples), what has its normal is of its own sheet ...
const OWN: f32 = 1.5;
/// ... if the normals agree within this (degrees).
const SAME: f32 = 10.0;
/// Points of one sheet are beside one another nearer than this (samples), whatever their normals.
const OWN_SHEET: f32 = 1.0;
/// A point's disc is met by a normal that passes it no farther than this (samples).
const DISC: f32 = 0.9;
/// Distances grow by no more than this for each unit of length.
const GROWTH: f32 = 0.1;
/// Sweeps over all points that carry small distances along sheets.
const SWEEPS: usize = 3;

/// For each point of features, in the order of samples, the distance that atoms may have there in
/// lattice units: from `least` in gaps and at shallow crossings to `most`. `sheet` numbers the sheet of
/// each where normals alone do not tell sheets apart.
pub fn spacing<const D: usize>(
    dims: [usize; D],
    points: &[FeaturePoint<D>],
    sheet: Option<&[u32]>,
    step: [f64; D],
    [least, most]: [f64; 2],
) -> Vec<f32> {
    let (least, most) = (least as f32, most as f32);
    let candidates = in_samples(dims, points, step);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_by_key(|&i| candidates[i as usize].voxel);
    let sorted: Vec<Candidate<D>> = order.iter().map(|&i| candidates[i as usize]).collect();
    let sheets: Option<Vec<u32>> =
        sheet.map(|sheet| order.iter().map(|&i| sheet[i as usize]).collect());
    let grid = BySample::new(dims, &sorted);
    let step = step.map(|h| h as f32);
    let mut spacing: Vec<f32> = (0..sorted.len())
        .into_par_iter()
        .map(|i| gap(&grid, sheets.as_deref(), i, step, most).clamp(least, most))
        .collect();
    if spacing.iter().any(|&d| d < most) {
        for sweep in 0..2 * SWEEPS {
            let count = sorted.len();
            for i in 0..count {
                let i = if sweep % 2 == 0 { i } else { count - 1 - i };
                let c = &sorted[i];
                let mut d = spacing[i];
                grid.each_around(grid.coordinates(c), 1, |j| {
                    let away = sub(sorted[j].position, c.position);
                    let length: f32 = (0..D).map(|k| (away[k] * step[k]).powi(2)).sum();
                    d = d.min(spacing[j] + GROWTH * length.sqrt());
                });
                spacing[i] = d;
            }
        }
    }
    let mut result = vec![0.0; points.len()];
    for (&i, d) in order.iter().zip(spacing) {
        result[i as usize] = d;
    }
    result
}

/// What to say of it.
pub fn note(spacing: &[f32], [least, most]: [f64; 2]) -> String {
    let fine = spacing.iter().filter(|&&d| d < 0.99 * most as f32).count();
    format!(
        "atoms stand {most:.2} apart, and down to {least:.2} where features run close or cross at shallow \
         angles: {:.1} % of the feature points",
        100.0 * fine as f64 / spacing.len().max(1) as f64,
    )
}

/// Points in samples, as candidates of the samples that they are nearest to.
pub(super) fn in_samples<const D: usize>(
    dims: [usize; D],
    points: &[FeaturePoint<D>],
    step: [f64; D],
) -> Vec<Candidate<D>> {
    points
        .iter()
        .map(|p| {
            let position: [f32; D] = std::array::from_fn(|k| p.position[k] / step[k] as f32);
            let normal: [f32; D] = std::array::from_fn(|k| p.normal[k] * step[k] as f32);
            let length = dot(normal, normal).sqrt();
            let at: [usize; D] =
                std::array::from_fn(|k| (nearest(position[k]).max(0) as usize).min(dims[k] - 1));
            Candidate {
                voxel: Voxel::of(dims, at),
                axis: 0,
                position,
                normal: normal.map(|c| c / length),
                strength: p.strength,
            }
        })
        .collect()
}

/// How far, along the normal of a point, the next sheet is, in lattice units; `most` if farther.
fn gap<const D: usize>(
    grid: &BySample<'_, D>,
    sheets: Option<&[u32]>,
    i: usize,
    step: [f32; D],
    most: f32,
) -> f32 {
    let c = &grid.candidates[i];
    let one_sheet = |o: usize| sheets.is_some_and(|sheets| sheets[o] == sheets[i]);
    let clear = CLEAR.to_radians().cos();
    let same = SAME.to_radians().cos();
    // Lattice units along the lattice's own normal that one sample along the samples' normal is.
    let scaled: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k]);
    let unit = 1.0 / dot(scaled, scaled).sqrt();
    let reach = (most / unit).ceil() as i32;
    let mut gap = most;
    for sign in [-1.0, 1.0] {
        for j in 0..=reach {
            let far = sign * j as f32;
            let at: [i32; D] = std::array::from_fn(|k| nearest(c.position[k] + far * c.normal[k]));
            let mut met = false;
            grid.each_around(at, 1, |o| {
                let other = &grid.candidates[o];
                let agree = dot(other.normal, c.normal).abs();
                let away = sub(other.position, c.position);
                let along = dot(away, c.normal);
                let aside = (dot(away, away) - along * along).max(0.0).sqrt();
                let own = (agree >= same && along.abs() < OWN)
                    || (one_sheet(o) && along.abs() < OWN_SHEET);
                if agree >= clear && !own && aside <= DISC && along * sign >= 0.0 {
                    gap = gap.min(along.abs() * unit);
                    met = true;
                }
            });
            if met {
                break;
            }
        }
    }
    gap
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on planes, and the number of the plane of each.
    fn planes(
        dims: [usize; 3],
        planes: &[([f64; 3], [f64; 3])],
    ) -> (Vec<FeaturePoint<3>>, Vec<u32>) {
        let (mut points, mut sheet) = (Vec::new(), Vec::new());
        for (number, &(middle, normal)) in planes.iter().enumerate() {
            let n = crate::geometry::unit(normal);
            for z in 0..dims[2] {
                for y in 0..dims[1] {
                    let p = [0.0, y as f64, z as f64];
                    let x =
                        middle[0] - (n[1] * (p[1] - middle[1]) + n[2] * (p[2] - middle[2])) / n[0];
                    if x >= 0.0 && x <= (dims[0] - 1) as f64 {
                        points.push(FeaturePoint {
                            position: [x as f32, y as f32, z as f32],
                            normal: n.map(|c| c as f32),
                            strength: 1.0,
                        });
                        sheet.push(number as u32 + 1);
                    }
                }
            }
        }
        (points, sheet)
    }

    #[test]
    fn between_parallel_sheets_the_distance_is_the_gap() {
        let dims = [40, 30, 30];
        let x = [1.0, 0.0, 0.0];
        let (points, _) = planes(dims, &[([15.0, 0.0, 0.0], x), ([20.0, 0.0, 0.0], x)]);
        for d in spacing(dims, &points, None, [1.0; 3], [2.0, 8.0]) {
            assert!((d - 5.0).abs() < 1e-3, "{d}");
        }
        // In lattice units, and no less than the least.
        let mut stretched = points.clone();
        stretched.iter_mut().for_each(|p| p.position[0] *= 2.0);
        for d in spacing(dims, &stretched, None, [2.0, 1.0, 1.0], [2.0, 16.0]) {
            assert!((d - 10.0).abs() < 1e-3, "{d}");
        }
        assert!(
            spacing(dims, &points, None, [1.0; 3], [6.0, 8.0])
                .iter()
                .all(|&d| d == 6.0)
        );
    }

    #[test]
    fn at_a_shallow_crossing_it_falls_to_the_least_and_grows_away_from_it() {
        let dims = [60, 100, 12];
        let slope = 20f64.to_radians().tan();
        let middle = [30.0, 50.0, 6.0];
        let (points, _) = planes(
            dims,
            &[(middle, [1.0, 0.0, 0.0]), (middle, [1.0, slope, 0.0])],
        );
        let found = spacing(dims, &points, None, [1.0; 3], [2.5, 8.0]);
        for (p, d) in points.iter().zip(found) {
            let away = f64::from((p.position[1] - 50.0).abs());
            let gap = slope * away;
            if away < 2.0 {
                assert!(d < 2.6, "{away} {d}");
            }
            // Within what the growth along the sheet allows.
            let most = (2.5 + 0.11 * away).clamp(2.5, 8.0);
            assert!(
                f64::from(d) <= most + 0.2 && f64::from(d) >= gap.min(most).min(2.5),
                "{away} {d}"
            );
        }
    }

    #[test]
    fn steep_crossings_and_single_sheets_need_no_finer_lattice() {
        let dims = [60, 60, 12];
        let middle = [30.0, 30.0, 6.0];
        let (points, _) = planes(
            dims,
            &[(middle, [1.0, 0.5, 0.0]), (middle, [1.0, -0.6, 0.0])],
        );
        assert!(
            spacing(dims, &points, None, [1.0; 3], [2.5, 8.0])
                .iter()
                .all(|&d| d == 8.0)
        );
    }

    #[test]
    fn a_sheet_whose_normals_scatter_is_not_beside_itself() {
        let dims = [40, 30, 30];
        let (mut points, sheet) = planes(dims, &[([15.0, 0.0, 0.0], [1.0, 0.0, 0.0])]);
        let mut random = crate::geometry::random::Random::new(5);
        for p in &mut points {
            let mut scatter = |most: f64| random.range(-most, most);
            p.position[0] += scatter(0.25) as f32;
            let normal = [1.0, scatter(0.25), scatter(0.25)];
            p.normal = crate::geometry::unit(normal).map(|c| c as f32);
        }
        let lattice = [2.0, 8.0];
        let found = spacing(dims, &points, Some(&sheet), [1.0; 3], lattice);
        assert!(found.iter().all(|&d| d == 8.0), "{found:?}");
        // The same points as two sheets are a sheet beside another one.
        let two: Vec<u32> = (0..points.len() as u32).map(|i| i % 2).collect();
        let found = spacing(dims, &points, Some(&two), [1.0; 3], lattice);
        assert!(found.iter().any(|&d| d < 8.0));
    }
}
