//! Where edges pass through features.

use super::constraint::NodeConstraint;
use super::feature_planes::{FeaturePlanes, LocalPlane, SAME_SURFACE_COSINE};
use crate::geometry::dot;

/// The middle of an edge between two nodes of a sheet may be off the sheet by this much.
const MAX_CHORD_DEVIATION: f64 = 0.4;

/// Where the edge between two nodes passes through a feature, or cuts a corner of it.
pub fn find_intersection(
    sheets: &FeaturePlanes,
    [p, q]: [&NodeConstraint; 2],
    [x, y]: [[f64; 3]; 2],
) -> Option<([f64; 3], LocalPlane)> {
    if p.is_far && q.is_far {
        return None;
    }
    // A chord of a sheet must not stray from it where the sheet is curved.
    if let Some(normal) = p.normals().find(|&n| q.is_on_surface(n)) {
        let middle = std::array::from_fn(|k| 0.5 * (x[k] + y[k]));
        let near = sheets.planes_near(middle);
        if let Some(sheet) = near.iter().find(|s| {
            s.offset.abs() > MAX_CHORD_DEVIATION
                && dot(s.normal, normal).abs() > SAME_SURFACE_COSINE
        }) {
            return Some((middle, *sheet));
        }
        // No other sheet is near the ends, nor between them.
        if p.is_isolated && q.is_isolated && near.iter().count() == 1 {
            return None;
        }
    }
    sheets.intersection(x, y, [p.is_isolated, q.is_isolated], |end, normal| {
        if end == 0 {
            p.is_on_surface(normal)
        } else {
            q.is_on_surface(normal)
        }
    })
}
