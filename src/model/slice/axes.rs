//! Draws numbers along the edges of a box.

use super::canvas::{Canvas, LETTER_SIZE};
use super::decorations::{INK_COLOR, format_number, ticks};
use super::raster::Raster;
use crate::geometry::hypot;
use crate::image::geometry::AxisScale;

/// Draws numbers along axis `k`, at one of its four edges: one on the outline of the box, as low
/// and as far to the left as possible.
pub(super) fn draw_axis(canvas: &mut Canvas, raster: &Raster, ruler: &AxisScale, k: usize) {
    let Some([a, b]) = outline_edge(raster, k) else {
        return;
    };
    let centre = raster.pixel([0.5; 3]);
    let direction = [b[0] - a[0], b[1] - a[1]];
    let length = hypot(direction[0].into(), direction[1].into()).max(1.0) as f32;
    let mut outward = [direction[1] / length, -direction[0] / length];
    let middle = [0, 1].map(|i| 0.5 * (a[i] + b[i]));
    if outward[0] * (middle[0] - centre[0]) + outward[1] * (middle[1] - centre[1]) < 0.0 {
        outward = outward.map(|c| -c);
    }
    let half_line = 0.5 * LETTER_SIZE[1];
    // The text ends, begins or is centred at its position, depending on the outward direction.
    let anchor = match outward[0] {
        x if x > 0.35 => 0.0,
        x if x < -0.35 => 1.0,
        _ => 0.5,
    };
    let (values, step) = ticks(ruler.first, ruler.last, f64::from(length / 70.0));
    let longest = values
        .iter()
        .map(|&value| format_number(value, step).len())
        .max();
    let longest = longest.unwrap_or(0);
    for value in values {
        let t = ((value - ruler.first) / (ruler.last - ruler.first)) as f32;
        let position: [f32; 2] = std::array::from_fn(|i| a[i] + t * direction[i]);
        let outward_point = |distance: f32| {
            std::array::from_fn::<f32, 2, _>(|i| position[i] + distance * outward[i])
        };
        canvas.draw_lines(&[[position, outward_point(6.0)]], INK_COLOR, 1.0);
        let [x, y] = outward_point(12.0);
        canvas.draw_text(
            &format_number(value, step),
            [x, y - half_line],
            anchor,
            INK_COLOR,
        );
    }
    let is_steep = direction[1].abs() > 2.0 * direction[0].abs();
    if is_steep {
        let top = if a[1] < b[1] { a } else { b };
        canvas.draw_text(
            &ruler.label,
            [top[0], top[1] - 3.5 * half_line],
            0.5,
            INK_COLOR,
        );
    } else {
        // Place the label beyond the numbers.
        let distance = 38.0 + LETTER_SIZE[0] * longest as f32 * outward[0].abs();
        let position: [f32; 2] = std::array::from_fn(|i| middle[i] + distance * outward[i]);
        canvas.draw_text(
            &ruler.label,
            [position[0], position[1] - half_line],
            anchor,
            INK_COLOR,
        );
    }
}

/// Returns the ends of the edge along axis `k` at which numbers are drawn.
fn outline_edge(raster: &Raster, k: usize) -> Option<[[f32; 2]; 2]> {
    let other_axes = [(k + 1) % 3, (k + 2) % 3];
    let end = |sides: [f64; 2], fraction: f64| {
        let mut p = [0.0; 3];
        p[k] = fraction;
        p[other_axes[0]] = sides[0];
        p[other_axes[1]] = sides[1];
        raster.pixel(p)
    };
    let mut best: Option<(f32, [[f32; 2]; 2])> = None;
    for sides in [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]] {
        // At an edge on the outline, one of the two adjacent sides is visible and the other is not.
        let is_visible =
            [0, 1].map(|i| (sides[i] > 0.5) == (raster.projection[2][other_axes[i]] > 0.0));
        if is_visible[0] == is_visible[1] {
            continue;
        }
        let ends = [end(sides, 0.0), end(sides, 1.0)];
        let is_steep = (ends[1][1] - ends[0][1]).abs() > 2.0 * (ends[1][0] - ends[0][0]).abs();
        let score = if is_steep {
            -ends[0][0] - ends[1][0]
        } else {
            ends[0][1] + ends[1][1]
        };
        if best.is_none_or(|(m, _)| score > m) {
            best = Some((score, ends));
        }
    }
    best.map(|(_, ends)| ends)
}
