//! A section on the canvas.

use super::canvas::{Canvas, LETTER_SIZE};
use super::color_key::ColorKey;
use super::color_map::ColorMap;
use super::decorations::{INK_COLOR, format_number, ticks};
use crate::image::geometry::AxisScale;
use crate::model::surface::SurfaceKind;

/// A line of the mesh, in sample indices of a panel.
pub(super) struct PanelLine {
    pub ends: [[f32; 2]; 2],
    /// Kind of feature on which the line lies, if any.
    pub kind: Option<SurfaceKind>,
}

/// Position and scale of a section on the canvas.
pub(super) struct Panel {
    /// Upper left corner, in pixels.
    pub top_left: [f32; 2],
    /// Pixels per sample, horizontally and vertically.
    pub pixels_per_sample: [f32; 2],
    /// Numbers of samples, horizontally and vertically.
    pub dims: [usize; 2],
    /// `true` if the last sample is drawn first, horizontally and vertically.
    pub is_flipped: [bool; 2],
}

impl Panel {
    pub(super) fn pixel(&self, p: [f32; 2]) -> [f32; 2] {
        std::array::from_fn(|k| {
            let last = (self.dims[k] - 1) as f32;
            let p = if self.is_flipped[k] {
                last - p[k]
            } else {
                p[k]
            };
            self.top_left[k] + self.pixels_per_sample[k] * p
        })
    }

    fn size(&self) -> [f32; 2] {
        std::array::from_fn(|k| pixel_extent(self.dims[k], self.pixels_per_sample[k]))
    }

    /// Draws the samples, interpolated linearly.
    pub(super) fn draw_image(
        &self,
        canvas: &mut Canvas,
        color_map: &ColorMap,
        sample: impl Fn(usize, usize) -> f32,
    ) {
        let [width, height] = self.size();
        let last = self.dims.map(|n| n - 1);
        let taps = |pixel: u32, k: usize| {
            let x = ((pixel as f32 + 0.5) / self.pixels_per_sample[k]).clamp(0.0, last[k] as f32);
            let x = if self.is_flipped[k] {
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
                let color = color_map.color(top * (1.0 - v) + bottom * v);
                let [origin_x, origin_y] = self.top_left.map(|c| c as u32);
                canvas.set_pixel(origin_x + column, origin_y + row, color);
            }
        }
    }

    /// Fills a convex polygon, given in sample indices, with the colours of the values at its
    /// corners. Values without a colour leave the image visible.
    pub(super) fn fill_polygon(
        &self,
        canvas: &mut Canvas,
        ring: &[([f32; 2], f64)],
        color: impl Fn(f64) -> Option<[u8; 3]>,
    ) {
        for i in 1..ring.len().saturating_sub(1) {
            let corners = [ring[0], ring[i], ring[i + 1]];
            let [a, b, c] = corners.map(|(p, _)| self.pixel(p));
            // A constant value, such as a cell's number, must not be changed by rounding.
            let is_constant = corners.iter().all(|(_, value)| *value == corners[0].1);
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
                    // Pixels on a side between two triangles belong to both.
                    if u < -1e-4 || v < -1e-4 || u + v > 1.0001 {
                        continue;
                    }
                    let weights = [1.0 - u - v, u, v].map(f64::from);
                    let value = if is_constant {
                        corners[0].1
                    } else {
                        (0..3).map(|k| weights[k] * corners[k].1).sum()
                    };
                    if let Some([r, g, b]) = color(value) {
                        canvas.set_pixel(x, y, [r, g, b, 255]);
                    }
                }
            }
        }
    }

    /// Draws the lines of the mesh; those on features are drawn over the others.
    pub(super) fn draw_mesh_lines(
        &self,
        canvas: &mut Canvas,
        color_key: &ColorKey,
        lines: &[PanelLine],
    ) {
        let thin_width = self.line_width();
        for (kind, width) in [
            (None, thin_width),
            (Some(SurfaceKind::Horizon), 2.0 * thin_width + 0.8),
            (Some(SurfaceKind::Fault), 2.0 * thin_width + 0.8),
        ] {
            let color = match kind {
                None => color_key.edge_color(),
                Some(kind) => opaque_color(color_key.trace_color(kind)),
            };
            let selected = lines.iter().filter(|line| line.kind == kind);
            let ends: Vec<_> = selected.map(|l| l.ends.map(|p| self.pixel(p))).collect();
            canvas.draw_lines(&ends, color, width);
        }
    }

    /// Draws lines that do not belong to the mesh.
    pub(super) fn draw_thick_lines(
        &self,
        canvas: &mut Canvas,
        color: [u8; 3],
        lines: &[[[f32; 2]; 2]],
    ) {
        let ends: Vec<_> = lines.iter().map(|l| l.map(|p| self.pixel(p))).collect();
        canvas.draw_lines(&ends, opaque_color(color), 1.6 * self.line_width() + 0.4);
    }

    /// Returns the width of mesh lines, in pixels.
    fn line_width(&self) -> f32 {
        (0.17 * self.pixels_per_sample[0].min(self.pixels_per_sample[1])).clamp(0.6, 1.2)
    }

    /// Draws the frame with numbers along both axes. `cut_point`, in samples, is the point in which
    /// the other sections meet this one; short lines outside the frame mark it.
    pub(super) fn draw_axes(
        &self,
        canvas: &mut Canvas,
        rulers: [&AxisScale; 2],
        cut_point: Option<[f64; 2]>,
    ) {
        let [width, height] = self.size();
        let [left, top] = self.top_left;
        let (right, bottom) = (left + width, top + height);
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
        let sides: Vec<_> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
        canvas.draw_lines(&sides, INK_COLOR, 1.0);
        if let Some(cut_point) = cut_point {
            let [x, y] = self.pixel(cut_point.map(|c| c as f32));
            // Outside the frame, on the sides without numbers.
            let tick_lines = [[[x, top - 8.0], [x, top]], [[right, y], [right + 8.0, y]]];
            canvas.draw_lines(&tick_lines, INK_COLOR, 2.5);
        }
        let to_pixel = |k: usize, value: f64| {
            let ruler = rulers[k];
            let fraction = (value - ruler.first) / (ruler.last - ruler.first);
            let sample = (fraction * (self.dims[k] - 1) as f64) as f32;
            let mut position = [0.0; 2];
            position[k] = sample;
            self.pixel(position)[k]
        };
        let [across, down] = rulers;
        let label_lengths = [across.first, across.last].map(|v| format_number(v, 1.0).len());
        let label_width = LETTER_SIZE[0] * (label_lengths[0].max(label_lengths[1]) as f32 + 3.0);
        let (values, step) = ticks(across.first, across.last, f64::from(width / label_width));
        for value in values {
            let x = to_pixel(0, value);
            canvas.draw_lines(&[[[x, bottom], [x, bottom + 5.0]]], INK_COLOR, 1.0);
            canvas.draw_text(
                &format_number(value, step),
                [x, bottom + 8.0],
                0.5,
                INK_COLOR,
            );
        }
        let label_position = [0.5 * (left + right), bottom + 10.0 + LETTER_SIZE[1]];
        canvas.draw_text(&across.label, label_position, 0.5, INK_COLOR);
        let (values, step) = ticks(down.first, down.last, f64::from(height / 48.0));
        for value in values {
            let y = to_pixel(1, value);
            canvas.draw_lines(&[[[left - 5.0, y], [left, y]]], INK_COLOR, 1.0);
            let position = [left - 8.0, y - 0.5 * LETTER_SIZE[1]];
            canvas.draw_text(&format_number(value, step), position, 1.0, INK_COLOR);
        }
        canvas.draw_text(
            &down.label,
            [left, top - LETTER_SIZE[1] - 6.0],
            0.5,
            INK_COLOR,
        );
    }
}

/// Returns the number of pixels between the first sample and the last.
pub(super) fn pixel_extent(samples: usize, scale: f32) -> f32 {
    (samples.max(2) - 1) as f32 * scale
}

fn opaque_color([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
}
