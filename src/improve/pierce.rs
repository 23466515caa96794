//! Where edges pass through features.

use super::hold::Hold;
use super::sheets::{SAME_SHEET, Sheet, Sheets};
use crate::geometry::dot;

/// The middle of an edge between two nodes of a sheet may be off the sheet by this much.
const STRAY: f64 = 0.4;

/// Where the edge between two nodes passes through a feature, or cuts a corner of it.
pub fn piercing(
    sheets: &Sheets,
    [p, q]: [&Hold; 2],
    [x, y]: [[f64; 3]; 2],
) -> Option<([f64; 3], Sheet)> {
    if p.far && q.far {
        return None;
    }
    // A chord of a sheet must not stray from it where the sheet is curved.
    if let Some(normal) = p.normals().find(|&n| q.on(n)) {
        let middle = std::array::from_fn(|k| 0.5 * (x[k] + y[k]));
        let near = sheets.near(middle);
        if let Some(sheet) = near
            .iter()
            .find(|s| s.offset.abs() > STRAY && dot(s.normal, normal).abs() > SAME_SHEET)
        {
            return Some((middle, *sheet));
        }
        // No other sheet is near the ends, nor between them.
        if p.alone && q.alone && near.iter().count() == 1 {
            return None;
        }
    }
    sheets.pierced(x, y, [p.alone, q.alone], |end, normal| {
        if end == 0 { p.on(normal) } else { q.on(normal) }
    })
}
