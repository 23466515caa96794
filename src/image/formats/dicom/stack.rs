//! The geometry of a stack of planes, each with its own position.
//!
//! Positions are those of DICOM's patient: left, posterior and superior are positive, in millimetres,
//! which is the convention of ITK, and that of every reader of scans here.

use crate::geometry::{cross, dot, norm, sub, unit};
use crate::image::Geometry;

/// Largest distance of a plane from even spacing, as a share of the spacing.
const MAX_UNEVENNESS: f64 = 0.05;

/// Distance of a plane from even spacing, as a share of the spacing, from which a note says it.
const NOTED_UNEVENNESS: f64 = 0.01;

/// Largest distance of a plane from the common line within the plane, as a share of a sample's size.
const MAX_SIDE_STEP: f64 = 0.25;

/// Largest difference of components of unit vectors that are one direction.
const DIRECTION_TOLERANCE: f64 = 1e-4;

/// Planes closer than this share of the smaller size of a sample are at one place.
const SAME_PLACE: f64 = 1e-3;

/// Shear of a stack, in millimetres per millimetre, from which a note says it.
const NOTED_SHEAR: f64 = 1e-3;

/// Position and orientation of a plane of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Position of the first sample.
    pub position: [f64; 3],
    /// Unit vector from sample to sample within a row.
    pub row: [f64; 3],
    /// Unit vector from row to row.
    pub column: [f64; 3],
    /// Distances between samples within a row, and between rows.
    pub spacing: [f64; 2],
}

impl Place {
    /// Returns the unit vector perpendicular to the plane.
    pub fn normal(&self) -> [f64; 3] {
        unit(cross(self.row, self.column))
    }

    /// Returns the distance of the plane from the origin along its normal.
    fn height(&self, normal: [f64; 3]) -> f64 {
        dot(self.position, normal)
    }

    /// Returns `true` if both planes have the same directions and distances between samples.
    pub fn is_parallel_to(&self, other: &Self) -> bool {
        let differ = |a: [f64; 3], b: [f64; 3]| {
            a.iter()
                .zip(b)
                .any(|(a, b)| (a - b).abs() > DIRECTION_TOLERANCE)
        };
        let same_size = |k: usize| {
            (self.spacing[k] - other.spacing[k]).abs() <= DIRECTION_TOLERANCE * self.spacing[k]
        };
        !differ(self.row, other.row)
            && !differ(self.column, other.column)
            && same_size(0)
            && same_size(1)
    }
}

/// Planes in the order of their positions along the normal.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stack {
    /// For each plane of the stack the number of the plane that was given.
    pub order: Vec<usize>,
    /// Positions of the samples.
    pub geometry: Geometry<3>,
    /// Messages about the positions.
    pub notes: Vec<String>,
}

/// Reason why planes are no stack. Planes have the numbers that were given.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum StackProblem {
    /// Two planes are at one place.
    SamePlace(usize, usize),
    /// Planes are missing between two planes.
    Missing {
        /// How many.
        count: usize,
        /// The planes on both sides.
        between: [usize; 2],
        /// How many are missing in all gaps.
        total: usize,
    },
    /// The distances between planes differ.
    Uneven {
        /// Smallest and largest distance.
        distances: [f64; 2],
        /// The planes on both sides of the largest.
        between: [usize; 2],
    },
    /// A plane lies beside the line of the others, by this distance.
    Beside(usize, f64),
}

/// Orders planes that are parallel to the first one.
///
/// The axis through the stack is the step from plane to plane, which a tilted gantry shears against the
/// normal. A single plane gets `thickness` as its distance to the next.
pub(super) fn stack(places: &[Place], thickness: f64) -> std::result::Result<Stack, StackProblem> {
    let Some(first) = places.first() else {
        return Ok(Stack {
            order: Vec::new(),
            geometry: Geometry::default(),
            notes: Vec::new(),
        });
    };
    let normal = first.normal();
    let height = |k: usize| places[k].height(normal);
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|&a, &b| height(a).total_cmp(&height(b)));
    let sample = first.spacing[0].min(first.spacing[1]);
    for pair in order.windows(2) {
        if height(pair[1]) - height(pair[0]) < SAME_PLACE * sample {
            return Err(StackProblem::SamePlace(
                pair[0].min(pair[1]),
                pair[0].max(pair[1]),
            ));
        }
    }
    let lowest = places[order[0]];
    let mut notes = Vec::new();
    let step = match order[..] {
        [.., last] if order.len() > 1 => {
            let count = (order.len() - 1) as f64;
            sub(places[last].position, lowest.position).map(|x| x / count)
        }
        _ => normal.map(|x| x * thickness),
    };
    check_distances(&order, &height)?;
    let spacing = dot(step, normal);
    let mut largest = 0f64;
    for (k, &plane) in order.iter().enumerate() {
        let even: [f64; 3] = std::array::from_fn(|c| lowest.position[c] + k as f64 * step[c]);
        let offset = sub(places[plane].position, even);
        let along = dot(offset, normal);
        let deviation = norm(sub(offset, normal.map(|x| x * along)));
        if deviation > MAX_SIDE_STEP * sample {
            return Err(StackProblem::Beside(plane, deviation));
        }
        largest = largest.max(along.abs());
    }
    if largest > NOTED_UNEVENNESS * spacing {
        notes.push(format!(
            "slices differ from even spacing ({spacing:.4} mm) by up to {largest:.4} mm, which is not followed"
        ));
    }
    let shear = norm(sub(step, normal.map(|x| x * spacing)));
    if shear > NOTED_SHEAR * spacing {
        notes.push(format!(
            "slices are sheared by {:.2} degrees, as by a tilted gantry: positions follow the shear, no sample is moved",
            (shear / spacing).atan().to_degrees()
        ));
    }
    let [dx, dy] = first.spacing;
    Ok(Stack {
        order,
        geometry: Geometry {
            origin: lowest.position,
            axes: [
                first.row.map(|x| x * dx),
                first.column.map(|x| x * dy),
                step,
            ],
            units: ["mm"; 3].map(String::from),
            ..Geometry::default()
        },
        notes,
    })
}

/// Checks that planes, in this order, are evenly spaced. `height` is their position along the normal.
fn check_distances(
    order: &[usize],
    height: &dyn Fn(usize) -> f64,
) -> std::result::Result<(), StackProblem> {
    if order.len() < 3 {
        return Ok(());
    }
    let gaps: Vec<f64> = (order.windows(2))
        .map(|pair| height(pair[1]) - height(pair[0]))
        .collect();
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    // Of two gaps in the middle, the smaller: the other may span a missing plane.
    let median = sorted[(sorted.len() - 1) / 2];
    let is_even = |gap: f64| (gap - median).abs() <= 2.0 * MAX_UNEVENNESS * median;
    let line = |k: usize| {
        let share = k as f64 / (order.len() - 1) as f64;
        height(order[0]) + share * (height(order[order.len() - 1]) - height(order[0]))
    };
    let mut planes = order.iter().enumerate();
    let is_straight = planes.all(|(k, &p)| (height(p) - line(k)).abs() <= MAX_UNEVENNESS * median);
    if gaps.iter().all(|&gap| is_even(gap)) && is_straight {
        return Ok(());
    }
    // Gaps of whole numbers of spacings are missing planes.
    let multiple = |gap: f64| (gap / median).round().max(1.0);
    let are_missing = gaps
        .iter()
        .all(|&gap| (gap - multiple(gap) * median).abs() <= 2.0 * MAX_UNEVENNESS * median);
    let widest = (0..gaps.len()).fold(0, |best, k| if gaps[k] > gaps[best] { k } else { best });
    let between = [order[widest], order[widest + 1]];
    let count = (multiple(gaps[widest]) - 1.0) as usize;
    if are_missing && count > 0 {
        let total = gaps.iter().map(|&gap| multiple(gap) - 1.0).sum::<f64>() as usize;
        return Err(StackProblem::Missing {
            count,
            between,
            total,
        });
    }
    Err(StackProblem::Uneven {
        distances: [sorted[0], sorted[sorted.len() - 1]],
        between,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns planes at these positions along a normal that is turned about x by 30 degrees, moved by
    /// `tilt` within the plane for each millimetre.
    fn planes(heights: &[f64], tilt: f64) -> Vec<Place> {
        let (s, c) = (0.5, 0.75f64.sqrt());
        heights
            .iter()
            .map(|&t| {
                let (column, normal) = ([0.0, c, s], [0.0, -s, c]);
                Place {
                    position: std::array::from_fn(|k| {
                        [10.0, -20.0, 30.0][k] + t * (normal[k] + tilt * column[k])
                    }),
                    row: [1.0, 0.0, 0.0],
                    column,
                    spacing: [0.5, 0.75],
                }
            })
            .collect()
    }

    fn check(heights: &[f64]) -> std::result::Result<Stack, StackProblem> {
        stack(&planes(heights, 0.0), 1.0)
    }

    #[test]
    fn each_sample_of_a_turned_stack_has_its_position() {
        for tilt in [0.0, 0.3] {
            let heights = [4.0, 0.0, 2.0, -2.0];
            let places = planes(&heights, tilt);
            let stack = stack(&places, 1.0).unwrap();
            assert_eq!(stack.order, [3, 1, 2, 0]);
            for (k, &plane) in stack.order.iter().enumerate() {
                let index = [3.0, 5.0, k as f64];
                let place = places[plane];
                let expected: [f64; 3] = std::array::from_fn(|c| {
                    place.position[c] + 3.0 * 0.5 * place.row[c] + 5.0 * 0.75 * place.column[c]
                });
                let distance = norm(sub(stack.geometry.to_physical(index), expected));
                assert!(distance < 1e-12, "{distance} at {index:?}");
            }
            let is_sheared = stack
                .notes
                .iter()
                .any(|note| note.contains("16.70 degrees"));
            assert_eq!(is_sheared, tilt > 0.0, "{:?}", stack.notes);
        }
    }

    #[test]
    fn missing_uneven_and_repeated_planes_are_told_apart() {
        assert_eq!(
            check(&[0.0, 1.0, 2.0, 5.0, 6.0, 8.0]),
            Err(StackProblem::Missing {
                count: 2,
                between: [2, 3],
                total: 3
            })
        );
        let Err(StackProblem::Uneven { distances, between }) = check(&[0.0, 1.0, 2.0, 3.4, 4.4])
        else {
            panic!("uneven planes are taken as even");
        };
        assert!((distances[1] - 1.4).abs() < 1e-9 && between == [2, 3]);
        // Steps that grow slowly.
        let growing: Vec<f64> = (0..40)
            .map(|k| f64::from(k) * (1.0 + 0.002 * f64::from(k)))
            .collect();
        assert!(matches!(check(&growing), Err(StackProblem::Uneven { .. })));
        assert_eq!(check(&[0.0, 1.0, 1.0]), Err(StackProblem::SamePlace(1, 2)));
        assert!(check(&[0.0, 1.0]).is_ok());
    }

    #[test]
    fn rounded_positions_are_even_with_a_note() {
        // Every 1.25 mm, rounded to tenths.
        let heights: Vec<f64> = (0..50)
            .map(|k| (f64::from(k) * 12.5).round() / 10.0)
            .collect();
        let stack = check(&heights).unwrap();
        assert!(
            stack.notes[0].contains("by up to 0.0490"),
            "{:?}",
            stack.notes
        );
        let spacing = norm(stack.geometry.axes[2]);
        assert!((spacing - 1.25).abs() < 2e-3, "{spacing}");
        let exact: Vec<f64> = (0..50).map(|k| f64::from(k) * 1.25).collect();
        assert!(check(&exact).unwrap().notes.is_empty());
    }

    #[test]
    fn a_plane_beside_the_others_is_no_part_of_their_stack() {
        let mut places = planes(&[0.0, 1.0, 2.0, 3.0], 0.0);
        places[2].position[0] += 0.2;
        let Err(StackProblem::Beside(2, distance)) = stack(&places, 1.0) else {
            panic!("a plane at the side is taken as one of the stack");
        };
        assert!((distance - 0.2).abs() < 1e-9);
    }
}
