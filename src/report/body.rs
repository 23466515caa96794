//! The size of what a mesh fills, in the units of its coordinates.

use serde::Serialize;

use super::Report;

/// Number of digits of a size that are shown.
const SHOWN_DIGITS: i32 = 4;

/// The size of the box around the cells of a mesh, along the axes of the image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BodySize {
    /// The length along each axis, x first.
    pub lengths: Vec<f64>,
    /// The unit along each axis; empty if it is not known.
    pub units: Vec<String>,
}

impl BodySize {
    /// Returns the size as text, such as `40 x 40 x 45 mm`.
    pub fn text(&self) -> String {
        let numbers = self.lengths.iter().map(|length| rounded(*length));
        let unit = |unit: &str| {
            if unit.is_empty() {
                "(no unit)".to_string()
            } else {
                unit.to_string()
            }
        };
        if self.units.iter().all(|own| *own == self.units[0]) {
            let numbers: Vec<String> = numbers.collect();
            return format!("{} {}", numbers.join(" x "), unit(&self.units[0]));
        }
        let with_units = numbers
            .zip(&self.units)
            .map(|(n, own)| format!("{n} {}", unit(own)));
        with_units.collect::<Vec<_>>().join(" x ")
    }
}

/// Returns a length with four digits.
fn rounded(length: f64) -> String {
    let digits = length.abs().log10().floor();
    if !digits.is_finite() {
        return length.to_string();
    }
    let factor = 10f64.powi(SHOWN_DIGITS - 1 - digits as i32);
    let shown = (length * factor).round() / factor;
    shown.to_string()
}

impl Report {
    /// Returns the line on the size of the mesh, if it is known.
    pub(super) fn body_line(&self) -> Option<String> {
        self.body.as_ref().map(BodySize::text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_four_digits_and_their_units() {
        let text = |lengths: &[f64], units: &[&str]| {
            let units = units.iter().map(|unit| (*unit).to_string()).collect();
            let lengths = lengths.to_vec();
            BodySize { lengths, units }.text()
        };
        assert_eq!(text(&[40.0, 40.0, 45.0], &["mm"; 3]), "40 x 40 x 45 mm");
        assert_eq!(text(&[39.999_99, 0.123_456], &["um"; 2]), "40 x 0.1235 um");
        assert_eq!(text(&[12_345.6, 100.0], &["m", "ms"]), "12350 m x 100 ms");
        assert_eq!(text(&[3.0, 5.0], &["", ""]), "3 x 5 (no unit)");
    }
}
