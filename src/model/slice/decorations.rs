//! Draws the parts around a picture: title, axis numbers, colour bar and legend.

use super::canvas::{Canvas, LETTER_SIZE};
use crate::image::Geometry;
use crate::image::geometry::AxisScale;

/// Colour of text and frames.
pub(super) const INK_COLOR: [u8; 4] = [40, 40, 40, 255];
/// Space around the drawing, in pixels.
pub(super) const TOP_MARGIN: f32 = 78.0;
pub(super) const RIGHT_MARGIN: f32 = 128.0;
pub(super) const BOTTOM_MARGIN: f32 = 92.0;
pub(super) const LEFT_MARGIN: f32 = 92.0;

/// Texts of a picture and of its axes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Caption {
    /// First line above the picture; may be empty.
    pub title: String,
    /// Second line above the picture; may be empty.
    pub subtitle: String,
    /// Name of the image's values, with their unit.
    pub value_label: String,
    /// Scales of image axes that show other numbers than coordinates, such as line numbers of a
    /// survey.
    pub rulers: [Option<AxisScale>; 3],
}

impl Caption {
    /// Returns the scale of image axis `k`, which has `samples` samples.
    pub(super) fn ruler<const D: usize>(
        &self,
        geometry: &Geometry<D>,
        k: usize,
        samples: usize,
    ) -> AxisScale {
        let custom = self.rulers[k].clone();
        custom.unwrap_or_else(|| geometry.axis_scale(k, (samples - 1) as f64))
    }
}

/// Returns round numbers from `first` to `last` in ascending order, and the step between them. The
/// step is chosen so that at most `max_steps` steps fit.
pub(super) fn ticks(first: f64, last: f64, max_steps: f64) -> (Vec<f64>, f64) {
    let (low, high) = (first.min(last), first.max(last));
    let min_step = (high - low) / max_steps.max(1.0);
    if !(min_step > 0.0 && min_step.is_finite()) {
        return (vec![low], 1.0);
    }
    let power_of_ten = 10f64.powf(min_step.log10().floor());
    let candidates = [1.0, 2.0, 5.0, 10.0].map(|k| k * power_of_ten);
    let step = candidates
        .into_iter()
        .find(|&s| s >= min_step * (1.0 - 1e-9));
    let step = step.unwrap_or(10.0 * power_of_ten);
    let start = (low / step - 1e-6).ceil() as i64;
    let end = (high / step + 1e-6).floor() as i64;
    ((start..=end).map(|i| i as f64 * step).collect(), step)
}

/// Formats a multiple of `step` with as many digits as it needs.
pub(super) fn format_number(value: f64, step: f64) -> String {
    let size = value.abs().max(step);
    if !(1e-4..1e9).contains(&size) {
        return format!("{value:.1e}");
    }
    let digits = (-step.log10() - 1e-9).ceil().max(0.0) as usize;
    let text = format!("{value:.digits$}");
    let unsigned = text.trim_start_matches('-');
    if unsigned.chars().all(|c| "0.".contains(c)) {
        unsigned.to_string()
    } else {
        text
    }
}

/// Formats a multiple of `step` for a place where few letters fit: large numbers are in scientific
/// notation.
fn format_short_number(value: f64, step: f64) -> String {
    if value.abs().max(step) < 1e6 || value == 0.0 {
        return format_number(value, step);
    }
    let digits = value.abs().log10().floor() - (step.log10() + 1e-9).floor();
    format!("{value:.*e}", digits.max(0.0) as usize)
}

impl Canvas {
    /// Draws the lines of text above a picture.
    pub(super) fn draw_caption(&mut self, caption: &Caption) {
        self.draw_text(&caption.title, [LEFT_MARGIN, 12.0], 0.0, INK_COLOR);
        let position = [LEFT_MARGIN, 12.0 + LETTER_SIZE[1] + 2.0];
        self.draw_text(&caption.subtitle, position, 0.0, [90, 90, 90, 255]);
    }

    /// Draws a colour bar for the values from `low` to `high`, to the right of a picture.
    pub(super) fn draw_color_bar(
        &mut self,
        name: &str,
        [low, high]: [f64; 2],
        color: impl Fn(f64) -> [u8; 3],
    ) {
        let [width, height] = self.size().map(|n| n as f32);
        let (left, top) = (width - RIGHT_MARGIN + 34.0, TOP_MARGIN);
        let bar_height = (height - TOP_MARGIN - BOTTOM_MARGIN)
            .clamp(40.0, 260.0)
            .floor();
        for row in 0..bar_height as u32 {
            let fraction = 1.0 - f64::from(row) / f64::from(bar_height - 1.0);
            let [r, g, b] = color(low + fraction * (high - low));
            for column in 0..18 {
                self.set_pixel(left as u32 + column, top as u32 + row, [r, g, b, 255]);
            }
        }
        let (right, bottom) = (left + 18.0, top + bar_height);
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
        let sides: Vec<_> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
        self.draw_lines(&sides, INK_COLOR, 1.0);
        // A name that is too long extends to the left, not beyond the picture.
        let max_left = width - 4.0 - LETTER_SIZE[0] * name.chars().count() as f32;
        let position = [left.min(max_left), top - LETTER_SIZE[1] - 6.0];
        self.draw_text(name, position, 0.0, INK_COLOR);
        let (values, step) = ticks(low, high, f64::from(bar_height) / 40.0);
        for value in values {
            let fraction = ((value - low) / (high - low)).clamp(0.0, 1.0) as f32;
            let y = bottom - fraction * bar_height;
            self.draw_lines(&[[[right, y], [right + 4.0, y]]], INK_COLOR, 1.0);
            let position = [right + 7.0, y - 0.5 * LETTER_SIZE[1]];
            self.draw_text(&format_short_number(value, step), position, 0.0, INK_COLOR);
        }
    }

    /// Draws a legend of the colours of lines and faces below a picture, with as many entries as
    /// fit.
    pub(super) fn draw_legend(&mut self, entries: &[(String, [u8; 3])]) {
        let [width, height] = self.size().map(|n| n as f32);
        let y = height - 0.5 * LETTER_SIZE[1] - 12.0;
        let mut x = LEFT_MARGIN;
        for (i, (name, [r, g, b])) in entries.iter().enumerate() {
            let entry_width = 30.0 + LETTER_SIZE[0] * (name.chars().count() as f32 + 3.0);
            let overflow_text = format!("and {} more", entries.len() - i);
            let last = i + 1 == entries.len();
            let overflow_width = if last {
                0.0
            } else {
                LETTER_SIZE[0] * overflow_text.len() as f32
            };
            if x + entry_width + overflow_width > width {
                return self.draw_text(
                    &overflow_text,
                    [x, y - 0.5 * LETTER_SIZE[1]],
                    0.0,
                    INK_COLOR,
                );
            }
            self.draw_lines(&[[[x, y], [x + 22.0, y]]], [*r, *g, *b, 255], 4.0);
            self.draw_text(name, [x + 30.0, y - 0.5 * LETTER_SIZE[1]], 0.0, INK_COLOR);
            x += entry_width;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        for (first, last, max_steps) in [
            (0.0, 9.9, 5.0),
            (-1800.0, -999.0, 7.0),
            (620_197.2, 620_999.1, 4.0),
            (3e-5, 8e-5, 6.0),
            (80.0, 20.0, 3.0),
        ] {
            let (values, step) = ticks(first, last, max_steps);
            assert!(!values.is_empty() && values.len() as f64 <= max_steps + 1.0);
            let leading = step / 10f64.powf((step * 1.0001).log10().floor());
            let is_round = [1.0, 2.0, 5.0].iter().any(|r| (leading - r).abs() < 1e-9);
            assert!(is_round, "{step}");
            let (low, high) = (f64::min(first, last), f64::max(first, last));
            let tolerance = 1e-5 * step;
            assert!(
                values
                    .iter()
                    .all(|t| (low - tolerance..=high + tolerance).contains(t))
            );
            assert!(values[0] - step < low && values[values.len() - 1] + step > high);
        }
        assert_eq!(ticks(5.0, 5.0, 4.0).0, [5.0]);
    }

    #[test]
    fn numbers_have_the_digits_that_tell_them_apart() {
        assert_eq!(format_number(0.30000000000000004, 0.1), "0.3");
        assert_eq!(format_number(-1200.0, 200.0), "-1200");
        assert_eq!(format_number(-0.0, 0.5), "0.0");
        assert_eq!(format_number(620_250.0, 50.0), "620250");
        assert_eq!(format_number(2e-5, 1e-5), "2.0e-5");
        assert_eq!(format_short_number(620_250.0, 50.0), "620250");
        assert_eq!(format_short_number(-4e7, 2e7), "-4e7");
        assert_eq!(format_short_number(1.25e7, 5e5), "1.25e7");
    }
}
