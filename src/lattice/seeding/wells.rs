//! Wells along trajectories: d(x) falls near them, and fixed atoms stand along them, d apart.

use super::Alignment;
use crate::error::{Error, Result, cause};
use crate::geometry::distance2;
use crate::image::ScalarField;
use crate::lattice::distance::{Distance, limit_gradient, lower_cell_corners};
use crate::progress::CancelToken;

/// Atoms of two wells nearer than this, in d, are too near.
const MIN_WELL_DISTANCE: f64 = 0.7;
/// A well that ends nearer to a side than this, in d, ends on it (or, where no atoms may be there, this
/// far inside).
const SIDE_SNAP_RATIO: f64 = 0.5;
/// Steps, in d, in which a way is followed.
const STEP_RATIO: f64 = 0.05;

/// A well's way in lattice space: straight legs between points, or one point.
#[derive(Debug, Clone, PartialEq)]
pub struct WellTrajectory<const D: usize> {
    /// What errors call it.
    pub name: String,
    /// Its points.
    pub points: Vec<[f64; D]>,
}

impl<const D: usize> WellTrajectory<D> {
    /// Those parts of the way that lie in the box `[0, extent]`: a way each.
    pub fn clip_to_box(&self, extent: [f64; D]) -> Vec<Self> {
        let holds = |x: &[f64; D]| (0..D).all(|k| x[k] >= 0.0 && x[k] <= extent[k]);
        if let [x] = self.points[..] {
            return if holds(&x) {
                vec![self.clone()]
            } else {
                Vec::new()
            };
        }
        let mut parts: Vec<Self> = Vec::new();
        let mut goes_on = false;
        for leg in self.points.windows(2) {
            let [a, b] = [leg[0], leg[1]];
            let (mut from, mut to) = (0.0f64, 1.0f64);
            for k in 0..D {
                let speed = b[k] - a[k];
                let [mut enter, mut leave] = [-a[k] / speed, (extent[k] - a[k]) / speed];
                if speed < 0.0 {
                    (enter, leave) = (leave, enter);
                }
                if speed != 0.0 {
                    (from, to) = (from.max(enter), to.min(leave));
                } else if !(0.0..=extent[k]).contains(&a[k]) {
                    to = -1.0;
                }
            }
            if from >= to {
                goes_on = false;
                continue;
            }
            let at = |share: f64| {
                std::array::from_fn(|k| (a[k] + share * (b[k] - a[k])).clamp(0.0, extent[k]))
            };
            if !goes_on {
                let (name, points) = (self.name.clone(), vec![at(from)]);
                parts.push(Self { name, points });
            }
            if let Some(part) = parts.last_mut() {
                part.points.push(if to == 1.0 { b } else { at(to) });
            }
            goes_on = to == 1.0;
        }
        parts
    }

    /// Points along the way, their distance growing with d: `(position, d)`.
    fn sample_points(&self, d: impl Fn([f64; D]) -> f64) -> Vec<([f64; D], f64)> {
        let mut found: Vec<_> = self.points[..1].iter().map(|&x| (x, d(x))).collect();
        for leg in self.points.windows(2) {
            let length = distance2(&leg[0], &leg[1]).sqrt();
            let mut s = 0.0;
            while s < length {
                let here = found[found.len() - 1].1;
                s = (s + STEP_RATIO * here).min(length);
                let share = s / length;
                let x = match s < length {
                    true => std::array::from_fn(|k| leg[0][k] + share * (leg[1][k] - leg[0][k])),
                    false => leg[1],
                };
                found.push((x, d(x)));
            }
        }
        found
    }
}

/// `distance`, but at most `least` on the ways, growing away from them by `growth` per lattice unit.
///
/// # Errors
/// [`Error::Distance`] if `least` is not positive or above every distance.
pub fn refine_near_wells<const D: usize>(
    distance: Distance<D>,
    ways: &[WellTrajectory<D>],
    least: f64,
    growth: f64,
    extent: [f64; D],
    patience: &CancelToken<'_>,
) -> Result<Distance<D>> {
    if !(least > 0.0 && least <= distance.max()) {
        return Err(Error::Distance(cause(
            "distance at wells",
            format!("{least} is not above 0 and at most {}", distance.max()),
            "give fewer samples than the mesh has elsewhere",
        )));
    }
    let finest = least.min(distance.min());
    let cells = extent.map(|e| (2.0 * e / finest).ceil().max(1.0) as usize);
    let step: [f64; D] = std::array::from_fn(|k| extent[k] / cells[k] as f64);
    let mut field = ScalarField::from_fn(cells.map(|c| c + 1), step, |x| distance.value_at(x));
    for way in ways {
        // All corners of every cell of the grid that the way passes.
        for (x, _) in way.sample_points(|_| finest) {
            lower_cell_corners(&mut field, x, least as f32);
        }
    }
    limit_gradient(&mut field, growth, patience);
    Ok(Distance::Field(field))
}

/// Atoms along ways in the box, d apart, the first and the last at a way's ends; ends within half a d
/// of a side are put on it (alongside features, half a d from it).
///
/// # Errors
/// [`Error::Seeding`] if two ways are nearer than 0.7 d.
pub fn place_atoms<const D: usize>(
    ways: &[WellTrajectory<D>],
    distance: &Distance<D>,
    extent: [f64; D],
    alignment: Alignment,
) -> Result<Vec<[f64; D]>> {
    let mut found: Vec<([f64; D], usize)> = Vec::new();
    for (number, way) in ways.iter().enumerate() {
        let mut way = way.clone();
        let last = way.points.len() - 1;
        for at in [0, last] {
            let x = &mut way.points[at];
            let room = SIDE_SNAP_RATIO * distance.value_at(*x);
            for k in 0..D {
                let (on, off) = match alignment {
                    Alignment::OnFeatures => (0.0, extent[k]),
                    Alignment::AlongsideFeatures => (room, extent[k] - room),
                };
                if x[k] < room {
                    x[k] = on;
                } else if x[k] > extent[k] - room {
                    x[k] = off;
                }
            }
        }
        // Places at equal shares of the way measured in d.
        let followed = way.sample_points(|x| distance.value_at(x));
        let mut measure = vec![0.0];
        for pair in followed.windows(2) {
            let length = distance2(&pair[0].0, &pair[1].0).sqrt();
            measure.push(measure[measure.len() - 1] + 2.0 * length / (pair[0].1 + pair[1].1));
        }
        let whole = measure[measure.len() - 1];
        let count = whole.round().max(if whole > 0.5 { 1.0 } else { 0.0 }) as usize;
        for i in 0..=count {
            let goal = (whole * i as f64 / count.max(1) as f64).min(whole);
            let at = measure.partition_point(|m| *m < goal);
            let x = match at.checked_sub(1) {
                None => followed[0].0,
                // Rounded, it could lie beside the end.
                _ if i == count => followed[followed.len() - 1].0,
                Some(before) => {
                    let share = (goal - measure[before]) / (measure[at] - measure[before]);
                    let (a, b) = (followed[before].0, followed[at].0);
                    std::array::from_fn(|k| a[k] + share * (b[k] - a[k]))
                }
            };
            let near = found.iter().find(|(other, of)| {
                let most = MIN_WELL_DISTANCE * distance.value_at(x);
                ways[*of].name != way.name && distance2(other, &x) < most * most
            });
            if let Some((_, of)) = near {
                return Err(Error::Seeding(cause(
                    format!("wells {} and {}", ways[*of].name, way.name),
                    format!(
                        "are nearer to each other than the distance {:.3} between atoms, at {x:?} (lattice)",
                        distance.value_at(x)
                    ),
                    "give a smaller distance at wells, or one of the wells only",
                )
                .with_parameter("well-distance")));
            }
            found.push((x, number));
        }
    }
    Ok(found.into_iter().map(|f| f.0).collect())
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
    fn what_is_outside_is_cut_off() {
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
        let ways = [well_trajectory(
            "A",
            &[[20.0, 20.0, 1.0], [20.0, 20.0, 21.0], [33.0, 20.0, 21.0]],
        )];
        let distance = Distance::Constant(4.0);
        let on = place_atoms(&ways, &distance, extent, Alignment::OnFeatures).unwrap();
        assert_eq!(
            (on[0], on[on.len() - 1]),
            ([20.0, 20.0, 0.0], [33.0, 20.0, 21.0])
        );
        let beside = place_atoms(&ways, &distance, extent, Alignment::AlongsideFeatures).unwrap();
        assert_eq!(beside[0], [20.0, 20.0, 2.0]);
        for pair in on.windows(2) {
            // Round the corner the way is longer than the distance.
            let apart = distance2(&pair[0], &pair[1]).sqrt();
            assert!((2.6..4.6).contains(&apart), "{apart}");
        }
        let near = well_trajectory("B", &[[22.0, 20.0, 5.0], [22.0, 20.0, 30.0]]);
        let both = [ways[0].clone(), near];
        let said = place_atoms(&both, &distance, extent, Alignment::OnFeatures)
            .unwrap_err()
            .to_string();
        assert!(said.contains("wells A and B: are nearer"), "{said}");
    }

    #[test]
    fn wells_of_any_length_have_an_atom_at_either_end() {
        // The shares of some lengths do not add up to the whole but for rounding.
        for step in 0..2000 {
            let end = [10.0, 11.0 + 0.017 * f64::from(step)];
            let ways = [well_trajectory("A", &[[10.0, 10.0], end])];
            let distance = Distance::Constant(1.7);
            let on = place_atoms(&ways, &distance, [60.0, 60.0], Alignment::OnFeatures).unwrap();
            assert_eq!((on[0], on[on.len() - 1]), ([10.0, 10.0], end));
        }
    }

    #[test]
    fn distance_falls_at_wells_and_grows_away_from_them() {
        let extent = [60.0, 50.0];
        let ways = [well_trajectory("A", &[[20.0, 25.0]])];
        let distance = refine_near_wells(
            Distance::Constant(8.0),
            &ways,
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
        let on = place_atoms(&spaced, &graded, extent, Alignment::OnFeatures).unwrap();
        assert_eq!(on.len(), 16);
        assert!(
            refine_near_wells(
                Distance::Constant(8.0),
                &ways,
                9.0,
                0.1,
                extent,
                &CancelToken::never()
            )
            .is_err()
        );
    }
}
