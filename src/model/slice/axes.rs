//! Numbers along the edges of a box.

use super::canvas::{Canvas, LETTER_SIZE};
use super::decorations::{INK_COLOR, format_number, ticks};
use super::raster::Raster;
use crate::image::geometry::AxisScale;

/// Numbers along axis `k`: on that of its four edges which is on the outline, low and to the left.
pub(super) fn draw_axis(canvas: &mut Canvas, raster: &Raster, ruler: &AxisScale, k: usize) {
    let others = [(k + 1) % 3, (k + 2) % 3];
    let end = |shares: [f64; 2], share: f64| {
        let mut p = [0.0; 3];
        p[k] = share;
        p[others[0]] = shares[0];
        p[others[1]] = shares[1];
        raster.pixel(p)
    };
    let mut best: Option<(f32, [[f32; 2]; 2])> = None;
    for shares in [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]] {
        // On the outline one of the two sides at the edge is seen, and one is not.
        let seen = [0, 1].map(|i| (shares[i] > 0.5) == (raster.projection[2][others[i]] > 0.0));
        if seen[0] == seen[1] {
            continue;
        }
        let ends = [end(shares, 0.0), end(shares, 1.0)];
        let steep = (ends[1][1] - ends[0][1]).abs() > 2.0 * (ends[1][0] - ends[0][0]).abs();
        let merit = match steep {
            true => -ends[0][0] - ends[1][0],
            false => ends[0][1] + ends[1][1],
        };
        if best.is_none_or(|(m, _)| merit > m) {
            best = Some((merit, ends));
        }
    }
    let Some((_, [a, b])) = best else { return };
    let centre = raster.pixel([0.5; 3]);
    let along = [b[0] - a[0], b[1] - a[1]];
    let long = along[0].hypot(along[1]).max(1.0);
    let mut out = [along[1] / long, -along[0] / long];
    let middle = [0, 1].map(|i| 0.5 * (a[i] + b[i]));
    if out[0] * (middle[0] - centre[0]) + out[1] * (middle[1] - centre[1]) < 0.0 {
        out = out.map(|c| -c);
    }
    let half_line = 0.5 * LETTER_SIZE[1];
    // Text ends, begins or has its middle where it stands, by the way out.
    let anchor = match out[0] {
        x if x > 0.35 => 0.0,
        x if x < -0.35 => 1.0,
        _ => 0.5,
    };
    let (values, step) = ticks(ruler.first, ruler.last, f64::from(long / 70.0));
    let longest = values
        .iter()
        .map(|&value| format_number(value, step).len())
        .max();
    let longest = longest.unwrap_or(0);
    for value in values {
        let t = ((value - ruler.first) / (ruler.last - ruler.first)) as f32;
        let at: [f32; 2] = std::array::from_fn(|i| a[i] + t * along[i]);
        let away = |far: f32| std::array::from_fn::<f32, 2, _>(|i| at[i] + far * out[i]);
        canvas.draw_lines(&[[at, away(6.0)]], INK_COLOR, 1.0);
        let [x, y] = away(12.0);
        canvas.draw_text(
            &format_number(value, step),
            [x, y - half_line],
            anchor,
            INK_COLOR,
        );
    }
    let steep = along[1].abs() > 2.0 * along[0].abs();
    if steep {
        let top = if a[1] < b[1] { a } else { b };
        canvas.draw_text(
            &ruler.label,
            [top[0], top[1] - 3.5 * half_line],
            0.5,
            INK_COLOR,
        );
    } else {
        // Beyond the numbers.
        let far = 38.0 + LETTER_SIZE[0] * longest as f32 * out[0].abs();
        let at: [f32; 2] = std::array::from_fn(|i| middle[i] + far * out[i]);
        canvas.draw_text(&ruler.label, [at[0], at[1] - half_line], anchor, INK_COLOR);
    }
}
