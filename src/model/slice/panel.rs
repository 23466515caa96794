//! A section on the canvas.

use super::canvas::{Canvas, LETTER};
use super::furniture::{INK, number, ticks};
use super::marks::Marks;
use super::shades::Shades;
use crate::image::geometry::Ruler;
use crate::model::surface::Kind;

/// A line of the mesh, in sample indices of a panel.
pub(super) struct Line {
    pub ends: [[f32; 2]; 2],
    /// On which kind of feature.
    pub kind: Option<Kind>,
}

/// Where a section lies on the canvas.
pub(super) struct Panel {
    /// Its upper left corner.
    pub corner: [f32; 2],
    /// Pixels a sample, across and down.
    pub scale: [f32; 2],
    /// Samples across and down.
    pub dims: [usize; 2],
    /// Whether the last sample is drawn first, across and down.
    pub flipped: [bool; 2],
}

impl Panel {
    pub(super) fn pixel(&self, p: [f32; 2]) -> [f32; 2] {
        std::array::from_fn(|k| {
            let last = (self.dims[k] - 1) as f32;
            let p = if self.flipped[k] { last - p[k] } else { p[k] };
            self.corner[k] + self.scale[k] * p
        })
    }

    fn size(&self) -> [f32; 2] {
        std::array::from_fn(|k| extent(self.dims[k], self.scale[k]))
    }

    /// The samples, interpolated linearly.
    pub(super) fn image(
        &self,
        canvas: &mut Canvas,
        shades: &Shades,
        sample: impl Fn(usize, usize) -> f32,
    ) {
        let [width, height] = self.size();
        let last = self.dims.map(|n| n - 1);
        let taps = |pixel: u32, k: usize| {
            let x = ((pixel as f32 + 0.5) / self.scale[k]).clamp(0.0, last[k] as f32);
            let x = if self.flipped[k] {
                last[k] as f32 - x
            } else {
                x
            };
            let low = (x as usize).min(last[k].saturating_sub(1));
            (low, (low + 1).min(last[k]), x - low as f32)
        };
        for row in 0..height.ceil() as u32 {
            let (y0, y1, v) = taps(row, 1);
            for column in 0..width.ceil() as u32 {
                let (x0, x1, u) = taps(column, 0);
                let top = sample(x0, y0) * (1.0 - u) + sample(x1, y0) * u;
                let bottom = sample(x0, y1) * (1.0 - u) + sample(x1, y1) * u;
                let color = shades.color(top * (1.0 - v) + bottom * v);
                let [left, above] = self.corner.map(|c| c as u32);
                canvas.set(left + column, above + row, color);
            }
        }
    }

    /// A convex polygon painted with the values at its corners, which are in sample indices, where they have
    /// a colour.
    pub(super) fn fill(
        &self,
        canvas: &mut Canvas,
        ring: &[([f32; 2], f64)],
        color: impl Fn(f64) -> Option<[u8; 3]>,
    ) {
        for i in 1..ring.len().saturating_sub(1) {
            let corners = [ring[0], ring[i], ring[i + 1]];
            let [a, b, c] = corners.map(|(p, _)| self.pixel(p));
            // A cell's number stays what it is.
            let one = corners.iter().all(|(_, value)| *value == corners[0].1);
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
            if area.abs() < 1e-6 {
                continue;
            }
            let bounds = |k: usize| {
                let low = a[k].min(b[k]).min(c[k]).floor().max(0.0);
                low as u32..a[k].max(b[k]).max(c[k]).ceil() as u32
            };
            for y in bounds(1) {
                for x in bounds(0) {
                    let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                    let u = ((px - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (py - a[1])) / area;
                    let v = ((b[0] - a[0]) * (py - a[1]) - (px - a[0]) * (b[1] - a[1])) / area;
                    // Pixels on a side belong to both.
                    if u < -1e-4 || v < -1e-4 || u + v > 1.0001 {
                        continue;
                    }
                    let shares = [1.0 - u - v, u, v].map(f64::from);
                    let value = match one {
                        true => corners[0].1,
                        false => (0..3).map(|k| shares[k] * corners[k].1).sum(),
                    };
                    if let Some([r, g, b]) = color(value) {
                        canvas.set(x, y, [r, g, b, 255]);
                    }
                }
            }
        }
    }

    /// The lines of the mesh, those on features above the others.
    pub(super) fn lines(&self, canvas: &mut Canvas, marks: &Marks, lines: &[Line]) {
        let thin = self.width();
        for (kind, width) in [
            (None, thin),
            (Some(Kind::Horizon), 2.0 * thin + 0.8),
            (Some(Kind::Fault), 2.0 * thin + 0.8),
        ] {
            let color = match kind {
                None => marks.edges(),
                Some(kind) => opaque(marks.trace(kind)),
            };
            let chosen = lines.iter().filter(|line| line.kind == kind);
            let ends: Vec<_> = chosen.map(|l| l.ends.map(|p| self.pixel(p))).collect();
            canvas.lines(&ends, color, width);
        }
    }

    /// Lines that are not the mesh's.
    pub(super) fn thick(&self, canvas: &mut Canvas, color: [u8; 3], lines: &[[[f32; 2]; 2]]) {
        let ends: Vec<_> = lines.iter().map(|l| l.map(|p| self.pixel(p))).collect();
        canvas.lines(&ends, opaque(color), 1.6 * self.width() + 0.4);
    }

    /// The width of lines of the mesh.
    fn width(&self) -> f32 {
        (0.17 * self.scale[0].min(self.scale[1])).clamp(0.6, 1.2)
    }

    /// The frame, where the other sections cut this one (`cut`, a sample across and down), and numbers
    /// of the world along both axes.
    pub(super) fn axes(&self, canvas: &mut Canvas, rulers: [&Ruler; 2], cut: Option<[f64; 2]>) {
        let [width, height] = self.size();
        let [left, top] = self.corner;
        let (right, bottom) = (left + width, top + height);
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
        let sides: Vec<_> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
        canvas.lines(&sides, INK, 1.0);
        if let Some(cut) = cut {
            let [x, y] = self.pixel(cut.map(|c| c as f32));
            // Outside the frame, where no numbers are.
            let marks = [[[x, top - 8.0], [x, top]], [[right, y], [right + 8.0, y]]];
            canvas.lines(&marks, INK, 2.5);
        }
        let place = |k: usize, value: f64| {
            let ruler = rulers[k];
            let share = (value - ruler.first) / (ruler.last - ruler.first);
            let sample = (share * (self.dims[k] - 1) as f64) as f32;
            let mut at = [0.0; 2];
            at[k] = sample;
            self.pixel(at)[k]
        };
        let [across, down] = rulers;
        let widest = [across.first, across.last].map(|v| number(v, 1.0).len());
        let room = LETTER[0] * (widest[0].max(widest[1]) as f32 + 3.0);
        let (values, step) = ticks(across.first, across.last, f64::from(width / room));
        for value in values {
            let x = place(0, value);
            canvas.lines(&[[[x, bottom], [x, bottom + 5.0]]], INK, 1.0);
            canvas.text(&number(value, step), [x, bottom + 8.0], 0.5, INK);
        }
        let middle = [0.5 * (left + right), bottom + 10.0 + LETTER[1]];
        canvas.text(&across.label, middle, 0.5, INK);
        let (values, step) = ticks(down.first, down.last, f64::from(height / 48.0));
        for value in values {
            let y = place(1, value);
            canvas.lines(&[[[left - 5.0, y], [left, y]]], INK, 1.0);
            let at = [left - 8.0, y - 0.5 * LETTER[1]];
            canvas.text(&number(value, step), at, 1.0, INK);
        }
        canvas.text(&down.label, [left, top - LETTER[1] - 6.0], 0.5, INK);
    }
}

/// Pixels between the first sample and the last.
pub(super) fn extent(samples: usize, scale: f32) -> f32 {
    (samples.max(2) - 1) as f32 * scale
}

fn opaque([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
}
