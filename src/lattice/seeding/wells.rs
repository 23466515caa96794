//! Wells along trajectories: d(x) is reduced near them, and fixed atoms stand along them, d apart.

use super::Alignment;
use crate::error::{Error, Result, cause};
use crate::geometry::distance2;
use crate::image::ScalarField;
use crate::lattice::distance::{Distance, limit_gradient, lower_cell_corners};
use crate::progress::CancelToken;

/// Smallest distance between atoms of two wells, in units of d.
const MIN_WELL_DISTANCE: f64 = 0.7;
/// Distance below which two atoms of one well are at the same place, in units of d.
const SAME_PLACE_RATIO: f64 = 1e-6;
/// A well that ends nearer to a side than this, in units of d, ends on the side (or, where atoms
/// may not be on sides, this far inside).
const SIDE_SNAP_RATIO: f64 = 0.5;
/// Step along a trajectory, in units of d.
const STEP_RATIO: f64 = 0.05;

/// A well's trajectory in lattice space: straight segments between points, or one point.
#[derive(Debug, Clone, PartialEq)]
pub struct WellTrajectory<const D: usize> {
    /// The well's name in error messages.
    pub name: String,
    /// The points of the trajectory.
    pub points: Vec<[f64; D]>,
}

impl<const D: usize> WellTrajectory<D> {
    /// Returns the parts of the trajectory that lie in the box `[0, extent]`, each as a trajectory.
    pub fn clip_to_box(&self, extent: [f64; D]) -> Vec<Self> {
        let is_inside = |x: &[f64; D]| (0..D).all(|k| x[k] >= 0.0 && x[k] <= extent[k]);
        if let [x] = self.points[..] {
            return if is_inside(&x) {
                vec![self.clone()]
            } else {
                Vec::new()
            };
        }
        let mut parts: Vec<Self> = Vec::new();
        let mut is_continued = false;
        for leg in self.points.windows(2) {
            let [a, b] = [leg[0], leg[1]];
            let (mut start, mut end) = (0.0f64, 1.0f64);
            for k in 0..D {
                let speed = b[k] - a[k];
                let [mut enter, mut leave] = [-a[k] / speed, (extent[k] - a[k]) / speed];
                if speed < 0.0 {
                    (enter, leave) = (leave, enter);
                }
                if speed != 0.0 {
                    (start, end) = (start.max(enter), end.min(leave));
                } else if !(0.0..=extent[k]).contains(&a[k]) {
                    end = -1.0;
                }
            }
            if start >= end {
                is_continued = false;
                continue;
            }
            let point_at = |fraction: f64| {
                std::array::from_fn(|k| (a[k] + fraction * (b[k] - a[k])).clamp(0.0, extent[k]))
            };
            if !is_continued {
                let (name, points) = (self.name.clone(), vec![point_at(start)]);
                parts.push(Self { name, points });
            }
            if let Some(part) = parts.last_mut() {
                part.points.push(if end == 1.0 { b } else { point_at(end) });
            }
            is_continued = end == 1.0;
        }
        parts
    }

    /// Returns points along the trajectory, whose spacing grows with d, as `(position, d)`.
    fn sample_points(&self, d: impl Fn([f64; D]) -> f64) -> Vec<([f64; D], f64)> {
        let mut samples: Vec<_> = self.points[..1].iter().map(|&x| (x, d(x))).collect();
        for leg in self.points.windows(2) {
            let length = distance2(&leg[0], &leg[1]).sqrt();
            let mut s = 0.0;
            while s < length {
                let local_d = samples[samples.len() - 1].1;
                s = (s + STEP_RATIO * local_d).min(length);
                let fraction = s / length;
                let x = if s < length {
                    std::array::from_fn(|k| leg[0][k] + fraction * (leg[1][k] - leg[0][k]))
                } else {
                    leg[1]
                };
                samples.push((x, d(x)));
            }
        }
        samples
    }
}

/// Returns `distance`, reduced to at most `well_distance` on the trajectories, and growing away
/// from them by `growth` per lattice unit.
///
/// # Errors
/// Returns [`Error::Distance`] if `well_distance` is not positive or is above every distance.
pub fn refine_near_wells<const D: usize>(
    distance: Distance<D>,
    wells: &[WellTrajectory<D>],
    well_distance: f64,
    growth: f64,
    extent: [f64; D],
    cancel: &CancelToken<'_>,
) -> Result<Distance<D>> {
    if !(well_distance > 0.0 && well_distance <= distance.max()) {
        return Err(Error::Distance(cause(
            "distance at wells",
            format!(
                "{well_distance} is not above 0 and at most {}",
                distance.max()
            ),
            "give fewer samples than the mesh has elsewhere",
        )));
    }
    let min_d = well_distance.min(distance.min());
    let cells = extent.map(|e| (2.0 * e / min_d).ceil().max(1.0) as usize);
    let step: [f64; D] = std::array::from_fn(|k| extent[k] / cells[k] as f64);
    let mut field = ScalarField::from_fn(cells.map(|c| c + 1), step, |x| distance.value_at(x));
    for well in wells {
        // All corners of every cell of the grid that the trajectory passes.
        for (x, _) in well.sample_points(|_| min_d) {
            lower_cell_corners(&mut field, x, well_distance as f32);
        }
    }
    limit_gradient(&mut field, growth, cancel);
    Ok(Distance::Field(field))
}

/// Returns atoms along trajectories in the box, d apart, the first and the last at the ends. Ends
/// within half a d of a side are moved onto it (with [`Alignment::AlongsideFeatures`], to half a d
/// from it).
///
/// # Errors
/// Returns [`Error::Seeding`] if two wells are nearer to each other than 0.7 d, and if a well passes the
/// place of one of its atoms again.
pub fn place_atoms<const D: usize>(
    wells: &[WellTrajectory<D>],
    distance: &Distance<D>,
    extent: [f64; D],
    alignment: Alignment,
) -> Result<Vec<[f64; D]>> {
    let mut atoms: Vec<([f64; D], usize)> = Vec::new();
    for (index, well) in wells.iter().enumerate() {
        let mut well = well.clone();
        let last = well.points.len() - 1;
        for end in [0, last] {
            let x = &mut well.points[end];
            let snap_distance = SIDE_SNAP_RATIO * distance.value_at(*x);
            for k in 0..D {
                let (low, high) = match alignment {
                    Alignment::OnFeatures => (0.0, extent[k]),
                    Alignment::AlongsideFeatures => (snap_distance, extent[k] - snap_distance),
                };
                if x[k] < snap_distance {
                    x[k] = low;
                } else if x[k] > extent[k] - snap_distance {
                    x[k] = high;
                }
            }
        }
        // Atoms are evenly spread along the trajectory measured in units of d.
        let samples = well.sample_points(|x| distance.value_at(x));
        let mut measure = vec![0.0];
        for pair in samples.windows(2) {
            let length = distance2(&pair[0].0, &pair[1].0).sqrt();
            measure.push(measure[measure.len() - 1] + 2.0 * length / (pair[0].1 + pair[1].1));
        }
        let total = measure[measure.len() - 1];
        let count = total.round().max(if total > 0.5 { 1.0 } else { 0.0 }) as usize;
        for i in 0..=count {
            let goal = (total * i as f64 / count.max(1) as f64).min(total);
            let next = measure.partition_point(|m| *m < goal);
            let x = match next.checked_sub(1) {
                None => samples[0].0,
                // Because of rounding, an interpolated position could miss the end.
                _ if i == count => samples[samples.len() - 1].0,
                Some(previous) => {
                    let fraction = (goal - measure[previous]) / (measure[next] - measure[previous]);
                    let (a, b) = (samples[previous].0, samples[next].0);
                    std::array::from_fn(|k| a[k] + fraction * (b[k] - a[k]))
                }
            };
            let too_near = atoms.iter().find(|(other, other_well)| {
                let min_distance = MIN_WELL_DISTANCE * distance.value_at(x);
                wells[*other_well].name != well.name
                    && distance2(other, &x) < min_distance * min_distance
            });
            if let Some((_, other_well)) = too_near {
                return Err(Error::Seeding(cause(
                    format!("wells {} and {}", wells[*other_well].name, well.name),
                    format!(
                        "are nearer to each other than the distance {:.3} between atoms, at {x:?} (lattice)",
                        distance.value_at(x)
                    ),
                    "give a smaller distance at wells, or one of the wells only",
                )
                .with_parameter("well-distance")));
            }
            let is_repeated = atoms.iter().any(|(other, other_well)| {
                let min_distance = SAME_PLACE_RATIO * distance.value_at(x);
                wells[*other_well].name == well.name
                    && distance2(other, &x) < min_distance * min_distance
            });
            if is_repeated {
                return Err(Error::Seeding(cause(
                    format!("well {}", well.name),
                    format!("passes the place {x:?} (lattice) twice"),
                    "correct its points; values that stand for no data are named as in FILE,null=-999.25",
                )));
            }
            atoms.push((x, index));
        }
    }
    Ok(atoms.into_iter().map(|f| f.0).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn well_trajectory<const D: usize>(name: &str, points: &[[f64; D]]) -> WellTrajectory<D> {
        WellTrajectory {
            name: name.into(),
            points: points.to_vec(),
        }
    }

    #[test]
    fn a_well_that_comes_back_is_refused_by_name() {
        let points = [[5.0, 5.0, 1.0], [5.0, 5.0, 9.0], [5.0, 5.0, 1.0]];
        let wells = [well_trajectory("A 1", &points)];
        let (distance, extent) = (Distance::Constant(2.0), [10.0; 3]);
        let error = place_atoms(&wells, &distance, extent, Alignment::OnFeatures).unwrap_err();
        let error = error.to_string();
        assert!(error.starts_with("well A 1: passes the place"), "{error}");
        assert!(error.contains("twice"), "{error}");
    }

    #[test]
    fn trajectories_are_clipped_to_the_box() {
        let extent = [10.0; 3];
        let from_above =
            well_trajectory("A", &[[5.0, 5.0, -20.0], [5.0, 5.0, 4.0], [15.0, 5.0, 4.0]]);
        let parts = from_above.clip_to_box(extent);
        assert_eq!(parts.len(), 1);
        assert_eq!(
            parts[0].points,
            [[5.0, 5.0, 0.0], [5.0, 5.0, 4.0], [10.0, 5.0, 4.0]]
        );
        assert!(
            well_trajectory("B", &[[-5.0, 1.0, 1.0], [-5.0, 1.0, 9.0]])
                .clip_to_box(extent)
                .is_empty()
        );
        let through_twice = well_trajectory(
            "C",
            &[
                [-1.0, 5.0, 5.0],
                [1.0, 5.0, 5.0],
                [1.0, 15.0, 5.0],
                [2.0, 5.0, 5.0],
            ],
        );
        assert_eq!(through_twice.clip_to_box(extent).len(), 2);
    }

    #[test]
    fn atoms_stand_d_apart_and_ends_on_the_sides() {
        let extent = [40.0, 40.0, 40.0];
        let wells = [well_trajectory(
            "A",
            &[[20.0, 20.0, 1.0], [20.0, 20.0, 21.0], [33.0, 20.0, 21.0]],
        )];
        let distance = Distance::Constant(4.0);
        let atoms = place_atoms(&wells, &distance, extent, Alignment::OnFeatures).unwrap();
        assert_eq!(
            (atoms[0], atoms[atoms.len() - 1]),
            ([20.0, 20.0, 0.0], [33.0, 20.0, 21.0])
        );
        let alongside =
            place_atoms(&wells, &distance, extent, Alignment::AlongsideFeatures).unwrap();
        assert_eq!(alongside[0], [20.0, 20.0, 2.0]);
        for pair in atoms.windows(2) {
            // At the corner the trajectory is longer than the straight distance.
            let gap = distance2(&pair[0], &pair[1]).sqrt();
            assert!((2.6..4.6).contains(&gap), "{gap}");
        }
        let close_well = well_trajectory("B", &[[22.0, 20.0, 5.0], [22.0, 20.0, 30.0]]);
        let close_wells = [wells[0].clone(), close_well];
        let message = place_atoms(&close_wells, &distance, extent, Alignment::OnFeatures)
            .unwrap_err()
            .to_string();
        assert!(message.contains("wells A and B: are nearer"), "{message}");
    }

    #[test]
    fn wells_of_any_length_have_an_atom_at_either_end() {
        // For some lengths the fractions do not add up exactly because of rounding.
        for step in 0..2000 {
            let end = [10.0, 11.0 + 0.017 * f64::from(step)];
            let wells = [well_trajectory("A", &[[10.0, 10.0], end])];
            let distance = Distance::Constant(1.7);
            let atoms =
                place_atoms(&wells, &distance, [60.0, 60.0], Alignment::OnFeatures).unwrap();
            assert_eq!((atoms[0], atoms[atoms.len() - 1]), ([10.0, 10.0], end));
        }
    }

    #[test]
    fn distance_falls_at_wells_and_grows_away_from_them() {
        let extent = [60.0, 50.0];
        let wells = [well_trajectory("A", &[[20.0, 25.0]])];
        let distance = refine_near_wells(
            Distance::Constant(8.0),
            &wells,
            2.0,
            0.1,
            extent,
            &CancelToken::never(),
        )
        .unwrap();
        assert!((distance.value_at([20.0, 25.0]) - 2.0).abs() < 1e-6);
        assert!((distance.value_at([40.0, 25.0]) - 4.0).abs() < 0.3);
        let spaced = [well_trajectory("A", &[[20.0, 25.0], [50.0, 25.0]])];
        let graded = refine_near_wells(
            Distance::Constant(8.0),
            &spaced[..],
            2.0,
            0.1,
            extent,
            &CancelToken::never(),
        )
        .unwrap();
        let atoms = place_atoms(&spaced, &graded, extent, Alignment::OnFeatures).unwrap();
        assert_eq!(atoms.len(), 16);
        assert!(
            refine_near_wells(
                Distance::Constant(8.0),
                &wells,
                9.0,
                0.1,
                extent,
                &CancelToken::never()
            )
            .is_err()
        );
    }
}
