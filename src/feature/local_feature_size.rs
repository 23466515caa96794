//! How fine a lattice must be to tell a feature from the next one.
//!
//! From each point of a sheet another one is sought along the normal, both ways. Nearer than the
//! largest distance between atoms, the gap is the distance that they may have there; at a shallow
//! crossing it goes to zero, and the least distance decides. Sheets that cross at more than
//! [`MAX_PARALLEL_ANGLE`] degrees need no finer lattice: one row of atoms stands on both. Nor does a sheet whose
//! normals scatter in noise, if it is known which points are of one sheet.

use super::FeaturePoint;
use super::candidate::{Candidate, Voxel, nearest_sample};
use super::voxel_index::CandidateIndex;
use super::windows::layer_len;
use crate::comm::Comm;
use crate::error::Result;
use crate::geometry::{dot, sub};
use crate::parallel::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Sheets that meet at more than this (degrees) do not run beside one another.
const MAX_PARALLEL_ANGLE: f32 = 40.0;
/// Within this of a point (samples), what has its normal is of its own sheet ...
const SAME_SURFACE_RADIUS: f32 = 1.5;
/// ... if the normals agree within this (degrees).
const SAME_SURFACE_ANGLE: f32 = 10.0;
/// Points of one sheet are beside one another nearer than this (samples), whatever their normals.
const MIN_SELF_DISTANCE: f32 = 1.0;
/// A point's disc is met by a normal that passes it no farther than this (samples).
const DISC_RADIUS: f32 = 0.9;
/// Distances grow by no more than this for each unit of length, along sheets.
const MAX_GROWTH_RATE: f32 = 0.1;
/// Layers round those in which gaps end in which there may be something that bounds them.
const EXTRA_HALO_LAYERS: usize = 3;

/// For each point of features, in the order of samples, the distance that atoms may have there in
/// lattice units: from `least` in gaps and at shallow crossings to `most`. `sheet` numbers the sheet of
/// each where normals alone do not tell sheets apart. Each of a group may have the points of some layers.
///
/// # Errors
/// Those of the others.
pub fn spacing<const D: usize>(
    dims: [usize; D],
    points: &[FeaturePoint<D>],
    sheet: Option<&[u32]>,
    step: [f64; D],
    [least, most]: [f64; 2],
    group: &dyn Comm,
) -> Result<Vec<f32>> {
    let near = PointsWithHalo::exchange(dims, points, sheet, step, most, group)?;
    let (least, most) = (least as f32, most as f32);
    let grid = CandidateIndex::new(dims, &near.candidates);
    let step = step.map(|h| h as f32);
    let sheet = sheet.map(|_| &near.surface[..]);
    let gap = |i: usize| match near.is_owned[i] {
        true => gap_width(&grid, sheet, i, step, most).clamp(least, most),
        false => most,
    };
    let mut spacing: Vec<f32> = (0..near.is_owned.len()).into_par_iter().map(gap).collect();
    near.propagate(&grid, &mut spacing, most, step, group)?;
    Ok(near.received_indices[group.rank()]
        .iter()
        .map(|&place| spacing[place as usize])
        .collect())
}

/// The points that those of one of a group may see, sorted by their samples.
struct PointsWithHalo<const D: usize> {
    candidates: Vec<Candidate<D>>,
    /// The number of the sheet of each.
    surface: Vec<u32>,
    /// Which are this one's own.
    is_owned: Vec<bool>,
    /// Where those are that were heard of each of the group: its own in their order.
    received_indices: Vec<Vec<u32>>,
    /// For each of the group its first and last layer; none where the first is greater.
    layers: Vec<[usize; 2]>,
    /// Which of its own each of the group was told of.
    sent_indices: Vec<Vec<u32>>,
}

impl<const D: usize> PointsWithHalo<D> {
    fn exchange(
        dims: [usize; D],
        points: &[FeaturePoint<D>],
        sheet: Option<&[u32]>,
        step: [f64; D],
        most: f64,
        group: &dyn Comm,
    ) -> Result<Self> {
        let mut own = to_candidates(dims, points, step);
        let layers = (own.iter()).fold([usize::MAX, 0], |[low, high], c| {
            let at = c.voxel.index() / layer_len(dims);
            [low.min(at), high.max(at)]
        });
        let layers: Vec<[usize; 2]> = group.all_gather("layers of points", layers)?;
        let finest = step.iter().fold(f64::INFINITY, |a, &h| a.min(h));
        let reach = (most / finest).ceil() as usize + EXTRA_HALO_LAYERS;
        let told = |rank: usize| -> Vec<u32> {
            let sees = |c: &Candidate<D>| is_near_layers(c, dims, layers[rank], reach);
            let numbered = (0u32..).zip(&own);
            match rank == group.rank() {
                true => Vec::new(),
                false => numbered.filter(|(_, c)| sees(c)).map(|n| n.0).collect(),
            }
        };
        let told: Vec<Vec<u32>> = (0..group.size()).map(told).collect();
        let sheet_of = |i: u32| sheet.map_or(0, |sheet| sheet[i as usize]);
        let whole = |&i: &u32| (own[i as usize], sheet_of(i));
        let heard = told.iter().map(|told| told.iter().map(whole).collect());
        let heard: Vec<Vec<(Candidate<D>, u32)>> =
            group.all_to_all("points near layers", heard.collect())?;
        let (mut all, mut sheets, mut from) = (Vec::new(), Vec::new(), Vec::new());
        for (rank, heard) in heard.into_iter().enumerate() {
            from.push(all.len());
            match rank == group.rank() {
                true => {
                    sheets.extend((0..own.len() as u32).map(sheet_of));
                    all.append(&mut own);
                }
                false => heard.into_iter().for_each(|(candidate, sheet)| {
                    all.push(candidate);
                    sheets.push(sheet);
                }),
            }
        }
        from.push(all.len());
        drop(own);
        let mut order: Vec<u32> = (0..all.len() as u32).collect();
        order.sort_by_key(|&i| all[i as usize].voxel);
        let mut place = vec![0; all.len()];
        (0..)
            .zip(&order)
            .for_each(|(at, &i)| place[i as usize] = at);
        let own = from[group.rank()]..from[group.rank() + 1];
        let sorted = |i: &u32| *i as usize;
        Ok(Self {
            candidates: order.iter().map(|i| all[sorted(i)]).collect(),
            surface: order.iter().map(|i| sheets[sorted(i)]).collect(),
            is_owned: order.iter().map(|i| own.contains(&sorted(i))).collect(),
            received_indices: from
                .windows(2)
                .map(|of| place[of[0]..of[1]].to_vec())
                .collect(),
            layers,
            sent_indices: told,
        })
    }

    /// Carries small distances along sheets, from the smallest on: so it makes no difference who has what.
    fn propagate(
        &self,
        grid: &CandidateIndex<'_, D>,
        spacing: &mut [f32],
        most: f32,
        step: [f32; D],
        group: &dyn Comm,
    ) -> Result<()> {
        // None is negative, so that their bits are in the same order.
        let waiting = |i: u32, d: f32| Reverse((d.to_bits(), i));
        let small = (0..).zip(spacing.iter()).filter(|(_, d)| **d < most);
        let mut queue: BinaryHeap<_> = small.map(|(i, &d)| waiting(i, d)).collect();
        let (dims, rank) = (grid.dims, group.rank());
        // Of those that were told, and heard, those in the layers next to the other's.
        let next =
            |place: u32, layers| is_near_layers(&self.candidates[place as usize], dims, layers, 1);
        let mine = |i: u32| self.received_indices[rank][i as usize];
        let pick = |places: Vec<u32>, layers| -> Vec<u32> {
            let places = places.into_iter();
            places.filter(|&place| next(place, layers)).collect()
        };
        let told = self
            .sent_indices
            .iter()
            .zip(&self.layers)
            .map(|(told, layers)| {
                let told = told.iter().map(|&i| mine(i));
                pick(told.collect(), *layers)
            });
        let told: Vec<Vec<u32>> = told.collect();
        let others = (0..group.size()).map(|other| match other == rank {
            true => Vec::new(),
            false => pick(self.received_indices[other].clone(), self.layers[rank]),
        });
        let others: Vec<Vec<u32>> = others.collect();
        loop {
            while let Some(Reverse((bits, i))) = queue.pop() {
                let (from, d) = (&self.candidates[i as usize], spacing[i as usize]);
                if bits > d.to_bits() {
                    continue;
                }
                grid.for_each_around(grid.coordinates(from), 1, |j| {
                    let away = sub(self.candidates[j].position, from.position);
                    let length: f32 = (0..D).map(|k| (away[k] * step[k]).powi(2)).sum();
                    let d = d + MAX_GROWTH_RATE * length.sqrt();
                    if self.is_owned[j] && d < spacing[j] {
                        spacing[j] = d;
                        queue.push(waiting(j as u32, d));
                    }
                });
            }
            let values = told.iter().map(|told| -> Vec<f32> {
                let values = told.iter().map(|&place| spacing[place as usize]);
                values.collect()
            });
            let heard: Vec<Vec<f32>> =
                group.all_to_all("distances beside layers", values.collect())?;
            for (places, heard) in others.iter().zip(heard) {
                for (&place, d) in places.iter().zip(heard) {
                    if d < spacing[place as usize] {
                        spacing[place as usize] = d;
                        queue.push(waiting(place, d));
                    }
                }
            }
            let more: Vec<bool> = group.all_gather("distances to carry on", !queue.is_empty())?;
            if !more.contains(&true) {
                return Ok(());
            }
        }
    }
}

/// Whether a point is in some layers, or in one so many before or behind them.
fn is_near_layers<const D: usize>(
    c: &Candidate<D>,
    dims: [usize; D],
    [first, last]: [usize; 2],
    reach: usize,
) -> bool {
    let at = c.voxel.index() / layer_len(dims);
    first <= last && first <= at + reach && at <= last + reach
}

/// What to say of it.
///
/// # Errors
/// Those of the others of the group.
pub fn spacing_note(spacing: &[f32], [least, most]: [f64; 2], group: &dyn Comm) -> Result<String> {
    let fine = spacing.iter().filter(|&&d| d < 0.99 * most as f32).count();
    let of_all: Vec<[usize; 2]> = group.all_gather("fine points", [fine, spacing.len()])?;
    let [fine, all] = [0, 1].map(|k| of_all.iter().map(|of| of[k]).sum::<usize>());
    Ok(format!(
        "atoms stand {most:.2} apart, and down to {least:.2} where features run close or cross at shallow \
         angles: {:.1} % of the feature points",
        100.0 * fine as f64 / all.max(1) as f64,
    ))
}

/// Points in samples, as candidates of the samples that they are nearest to.
pub(super) fn to_candidates<const D: usize>(
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
            let at: [usize; D] = std::array::from_fn(|k| {
                (nearest_sample(position[k]).max(0) as usize).min(dims[k] - 1)
            });
            Candidate {
                voxel: Voxel::new(dims, at),
                axis: 0,
                position,
                normal: normal.map(|c| c / length),
                strength: p.strength,
            }
        })
        .collect()
}

/// How far, along the normal of a point, the next sheet is, in lattice units; `most` if farther.
fn gap_width<const D: usize>(
    grid: &CandidateIndex<'_, D>,
    sheets: Option<&[u32]>,
    i: usize,
    step: [f32; D],
    most: f32,
) -> f32 {
    let c = &grid.candidates[i];
    let one_sheet = |o: usize| sheets.is_some_and(|sheets| sheets[o] == sheets[i]);
    let clear = MAX_PARALLEL_ANGLE.to_radians().cos();
    let same = SAME_SURFACE_ANGLE.to_radians().cos();
    // Lattice units along the lattice's own normal that one sample along the samples' normal is.
    let scaled: [f32; D] = std::array::from_fn(|k| c.normal[k] / step[k]);
    let unit = 1.0 / dot(scaled, scaled).sqrt();
    let reach = (most / unit).ceil() as i32;
    let mut gap = most;
    for sign in [-1.0, 1.0] {
        for j in 0..=reach {
            let far = sign * j as f32;
            let at: [i32; D] =
                std::array::from_fn(|k| nearest_sample(c.position[k] + far * c.normal[k]));
            let mut met = false;
            grid.for_each_around(at, 1, |o| {
                let other = &grid.candidates[o];
                let agree = dot(other.normal, c.normal).abs();
                let away = sub(other.position, c.position);
                let along = dot(away, c.normal);
                let aside = (dot(away, away) - along * along).max(0.0).sqrt();
                let own = (agree >= same && along.abs() < SAME_SURFACE_RADIUS)
                    || (one_sheet(o) && along.abs() < MIN_SELF_DISTANCE);
                if agree >= clear && !own && aside <= DISC_RADIUS && along * sign >= 0.0 {
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
    use crate::comm::{SelfComm, run_threads};

    fn spacing(
        dims: [usize; 3],
        points: &[FeaturePoint<3>],
        sheet: Option<&[u32]>,
        step: [f64; 3],
        limits: [f64; 2],
    ) -> Vec<f32> {
        super::spacing(dims, points, sheet, step, limits, &SelfComm).unwrap()
    }

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

    #[test]
    fn in_layers_of_their_own_points_ask_for_what_they_do_together() {
        let dims = [60, 40, 120];
        let slope = 20f64.to_radians().tan();
        let middle = [30.0, 20.0, 45.0];
        let (points, sheet) = planes(
            dims,
            &[
                (middle, [1.0, 0.0, 0.0]),
                (middle, [1.0, 0.3 * slope, slope]),
            ],
        );
        let (mut both, limits): (Vec<_>, _) = (points.into_iter().zip(sheet).collect(), [2.5, 8.0]);
        both.sort_by_key(|(p, _)| (p.position[2] as u32, p.position[1] as u32));
        let (points, sheet): (Vec<_>, Vec<_>) = both.into_iter().unzip();
        for sheet in [None, Some(&sheet[..])] {
            let whole = spacing(dims, &points, sheet, [1.0; 3], limits);
            let carried = whole.iter().filter(|d| (2.6..7.9).contains(*d)).count();
            assert!(carried > 1000, "{carried}");
            for count in [2, 3, 40] {
                let parts = run_threads(count, |group| {
                    let own = crate::comm::partition_range(points.len() / 40, group.rank(), count);
                    let own = own.start * 40..own.end * 40;
                    let sheet = sheet.map(|sheet| &sheet[own.clone()]);
                    let own = &points[own];
                    super::spacing(dims, own, sheet, [1.0; 3], limits, group).unwrap()
                });
                assert!(parts.concat() == whole, "{count}");
            }
        }
    }
}
