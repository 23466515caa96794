//! What stands round a picture: a title, numbers on axes, a bar of colours, a legend.

use super::canvas::{Canvas, LETTER_SIZE};
use crate::image::Geometry;
use crate::image::geometry::AxisScale;

/// What is written and framed with.
pub(super) const INK_COLOR: [u8; 4] = [40, 40, 40, 255];
/// Space above, right of, below and left of what is drawn, in pixels.
pub(super) const TOP_MARGIN: f32 = 78.0;
pub(super) const RIGHT_MARGIN: f32 = 128.0;
pub(super) const BOTTOM_MARGIN: f32 = 92.0;
pub(super) const LEFT_MARGIN: f32 = 92.0;

/// What is written over a picture and beside its bar of colours.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Caption {
    /// The first line; empty for none.
    pub title: String,
    /// The second one.
    pub subtitle: String,
    /// What the image's values are, with their unit.
    pub value_label: String,
    /// How image axes are read off that are not read off by coordinates: line numbers of a survey.
    pub rulers: [Option<AxisScale>; 3],
}

impl Caption {
    /// How image axis `k` is read off, so many samples long.
    pub(super) fn ruler<const D: usize>(
        &self,
        geometry: &Geometry<D>,
        k: usize,
        samples: usize,
    ) -> AxisScale {
        let own = self.rulers[k].clone();
        own.unwrap_or_else(|| geometry.axis_scale(k, (samples - 1) as f64))
    }
}

/// Round numbers from one value to another, at most `most` steps apart, and the step.
pub(super) fn ticks(first: f64, last: f64, most: f64) -> (Vec<f64>, f64) {
    let (low, high) = (first.min(last), first.max(last));
    let rough = (high - low) / most.max(1.0);
    if !(rough > 0.0 && rough.is_finite()) {
        return (vec![low], 1.0);
    }
    let ten = 10f64.powf(rough.log10().floor());
    let round = [1.0, 2.0, 5.0, 10.0].map(|k| k * ten);
    let step = round.into_iter().find(|&s| s >= rough * (1.0 - 1e-9));
    let step = step.unwrap_or(10.0 * ten);
    let from = (low / step - 1e-6).ceil() as i64;
    let to = (high / step + 1e-6).floor() as i64;
    ((from..=to).map(|i| i as f64 * step).collect(), step)
}

/// A multiple of a step, with as many digits as it needs.
pub(super) fn format_number(value: f64, step: f64) -> String {
    let size = value.abs().max(step);
    if !(1e-4..1e9).contains(&size) {
        return format!("{value:.1e}");
    }
    let digits = (-step.log10() - 1e-9).ceil().max(0.0) as usize;
    let text = format!("{value:.digits$}");
    match text
        .trim_start_matches('-')
        .chars()
        .all(|c| "0.".contains(c))
    {
        true => text.trim_start_matches('-').to_string(),
        false => text,
    }
}

/// The same where there is room for few letters.
fn format_short_number(value: f64, step: f64) -> String {
    if value.abs().max(step) < 1e6 || value == 0.0 {
        return format_number(value, step);
    }
    let digits = value.abs().log10().floor() - (step.log10() + 1e-9).floor();
    format!("{value:.*e}", digits.max(0.0) as usize)
}

impl Canvas {
    /// The lines above a picture.
    pub(super) fn draw_caption(&mut self, caption: &Caption) {
        self.draw_text(&caption.title, [LEFT_MARGIN, 12.0], 0.0, INK_COLOR);
        let below = [LEFT_MARGIN, 12.0 + LETTER_SIZE[1] + 2.0];
        self.draw_text(&caption.subtitle, below, 0.0, [90, 90, 90, 255]);
    }

    /// Values from `low` to `high` and their colours, right of a picture.
    pub(super) fn draw_color_bar(
        &mut self,
        name: &str,
        [low, high]: [f64; 2],
        color: impl Fn(f64) -> [u8; 3],
    ) {
        let [width, height] = self.size().map(|n| n as f32);
        let (left, top) = (width - RIGHT_MARGIN + 34.0, TOP_MARGIN);
        let tall = (height - TOP_MARGIN - BOTTOM_MARGIN)
            .clamp(40.0, 260.0)
            .floor();
        for row in 0..tall as u32 {
            let share = 1.0 - f64::from(row) / f64::from(tall - 1.0);
            let [r, g, b] = color(low + share * (high - low));
            for column in 0..18 {
                self.set_pixel(left as u32 + column, top as u32 + row, [r, g, b, 255]);
            }
        }
        let (right, bottom) = (left + 18.0, top + tall);
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
        let sides: Vec<_> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
        self.draw_lines(&sides, INK_COLOR, 1.0);
        // A long name ends at the edge of the picture.
        let room = width - 4.0 - LETTER_SIZE[0] * name.chars().count() as f32;
        let above = [left.min(room), top - LETTER_SIZE[1] - 6.0];
        self.draw_text(name, above, 0.0, INK_COLOR);
        let (values, step) = ticks(low, high, f64::from(tall) / 40.0);
        for value in values {
            let share = ((value - low) / (high - low)).clamp(0.0, 1.0) as f32;
            let y = bottom - share * tall;
            self.draw_lines(&[[[right, y], [right + 4.0, y]]], INK_COLOR, 1.0);
            let at = [right + 7.0, y - 0.5 * LETTER_SIZE[1]];
            self.draw_text(&format_short_number(value, step), at, 0.0, INK_COLOR);
        }
    }

    /// What the colours of lines and faces mean, below a picture: as many as there is room for.
    pub(super) fn draw_legend(&mut self, entries: &[(String, [u8; 3])]) {
        let [width, height] = self.size().map(|n| n as f32);
        let y = height - 0.5 * LETTER_SIZE[1] - 12.0;
        let mut x = LEFT_MARGIN;
        for (i, (name, [r, g, b])) in entries.iter().enumerate() {
            let wide = 30.0 + LETTER_SIZE[0] * (name.chars().count() as f32 + 3.0);
            let rest = format!("and {} more", entries.len() - i);
            let last = i + 1 == entries.len();
            let room = if last {
                0.0
            } else {
                LETTER_SIZE[0] * rest.len() as f32
            };
            if x + wide + room > width {
                return self.draw_text(&rest, [x, y - 0.5 * LETTER_SIZE[1]], 0.0, INK_COLOR);
            }
            self.draw_lines(&[[[x, y], [x + 22.0, y]]], [*r, *g, *b, 255], 4.0);
            self.draw_text(name, [x + 30.0, y - 0.5 * LETTER_SIZE[1]], 0.0, INK_COLOR);
            x += wide;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        for (first, last, most) in [
            (0.0, 9.9, 5.0),
            (-1800.0, -999.0, 7.0),
            (620_197.2, 620_999.1, 4.0),
            (3e-5, 8e-5, 6.0),
            (80.0, 20.0, 3.0),
        ] {
            let (found, step) = ticks(first, last, most);
            assert!(!found.is_empty() && found.len() as f64 <= most + 1.0);
            let leading = step / 10f64.powf((step * 1.0001).log10().floor());
            let round = [1.0, 2.0, 5.0].iter().any(|r| (leading - r).abs() < 1e-9);
            assert!(round, "{step}");
            let (low, high) = (f64::min(first, last), f64::max(first, last));
            let slack = 1e-5 * step;
            assert!(
                found
                    .iter()
                    .all(|t| (low - slack..=high + slack).contains(t))
            );
            assert!(found[0] - step < low && found[found.len() - 1] + step > high);
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
