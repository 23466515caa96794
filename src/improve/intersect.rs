//! Finds where edges pass through features.

use super::constraint::NodeConstraint;
use super::feature_planes::{FeaturePlanes, LocalPlane, SAME_SURFACE_COSINE};
use crate::geometry::{dot, sub};

/// Largest distance, in samples, between the middle of an edge and the feature surface that holds
/// both its ends.
const MAX_CHORD_DEVIATION: f64 = 0.4;

/// Returns where the edge between two nodes passes through a feature surface or cuts a corner of
/// it, and the local plane there.
pub fn find_intersection(
    planes: &FeaturePlanes,
    [p, q]: [&NodeConstraint; 2],
    [x, y]: [[f64; 3]; 2],
) -> Option<([f64; 3], LocalPlane)> {
    if p.is_far && q.is_far {
        return None;
    }
    // A chord of a curved surface must stay close to it.
    if let Some(normal) = p.normals().find(|&n| q.shares_surface(n, sub(y, x))) {
        let middle = std::array::from_fn(|k| 0.5 * (x[k] + y[k]));
        let nearby = planes.planes_near(middle);
        if let Some(plane) = nearby.iter().find(|s| {
            s.offset.abs() > MAX_CHORD_DEVIATION
                && dot(s.normal, normal).abs() > SAME_SURFACE_COSINE
        }) {
            return Some((middle, *plane));
        }
        // No other surface is near the ends or between them.
        if p.is_isolated && q.is_isolated && nearby.iter().count() == 1 {
            return None;
        }
    }
    let is_isolated = [p.is_isolated, q.is_isolated];
    planes.intersection(x, y, is_isolated, |end, normal, displacement| {
        [p, q][end].shares_surface(normal, displacement)
    })
}
