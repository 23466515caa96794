//! Draws the contents of a box in software with a depth buffer, so that no graphics card is needed.

use super::canvas::Canvas;
use crate::geometry::hypot;

/// Samples per pixel along each axis, for smooth edges.
const SUPERSAMPLING: usize = 2;
/// Half the width of cell edges, in samples of the raster.
const EDGE_HALF_WIDTH: f64 = 0.75;

/// A corner of a polygon: a point of the box, and the value there.
pub(super) type ValuedPoint = ([f64; 3], f64);

/// Colours and depths of samples; there are [`SUPERSAMPLING`] samples per pixel along each axis.
pub(super) struct Raster {
    size: [usize; 2],
    colors: Vec<Option<[u8; 3]>>,
    /// Depth of each sample, larger for nearer points; boxes are drawn into [-1, 1].
    depth_buffer: Vec<f32>,
    /// Projection from a point of the box to raster coordinates and depth.
    pub(super) projection: [[f64; 4]; 3],
    /// Colour of cell edges.
    edge_color: [u8; 4],
}

impl Raster {
    pub(super) fn new(
        pixels: [u32; 2],
        projection: [[f64; 4]; 3],
        pixels_per_unit: f64,
        centre: [f64; 2],
        edge_color: [u8; 4],
    ) -> Self {
        let size = pixels.map(|n| n as usize * SUPERSAMPLING);
        let samples_per_unit = pixels_per_unit * SUPERSAMPLING as f64;
        let depth: f64 = projection[2][..3]
            .iter()
            .map(|c| c.abs())
            .sum::<f64>()
            .max(1e-300);
        let [mut across, mut up, towards_viewer] = projection;
        across = across.map(|c| c * samples_per_unit);
        across[3] += centre[0] * SUPERSAMPLING as f64;
        up = up.map(|c| -c * samples_per_unit);
        up[3] += centre[1] * SUPERSAMPLING as f64;
        Self {
            size,
            colors: vec![None; size[0] * size[1]],
            depth_buffer: vec![f32::NEG_INFINITY; size[0] * size[1]],
            projection: [across, up, towards_viewer.map(|c| 2.0 * c / depth)],
            edge_color,
        }
    }

    /// Returns the raster coordinates and the depth of a point of the box.
    pub(super) fn project(&self, p: [f64; 3]) -> [f64; 3] {
        self.projection
            .map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3])
    }

    /// Draws a convex polygon with its edges, where its values have a colour. `depth_bias` is added
    /// to its depth.
    pub(super) fn draw_polygon(
        &mut self,
        ring: &[ValuedPoint],
        color: &impl Fn([f64; 3], f64) -> Option<[u8; 3]>,
        depth_bias: f64,
    ) {
        for i in 1..ring.len().saturating_sub(1) {
            let is_edge = [i == 1, true, i + 2 == ring.len()];
            self.draw_triangle([ring[0], ring[i], ring[i + 1]], is_edge, color, depth_bias);
        }
    }

    /// Draws a triangle. `edges` flags the sides (from each corner to the next) that are cell
    /// edges.
    fn draw_triangle(
        &mut self,
        corners: [ValuedPoint; 3],
        edges: [bool; 3],
        color: &impl Fn([f64; 3], f64) -> Option<[u8; 3]>,
        depth_bias: f64,
    ) {
        let values = corners.map(|(_, value)| value);
        // A constant value, such as a cell's number, must not be changed by rounding.
        let is_constant = values.iter().all(|value| *value == values[0]);
        let corners = corners.map(|(p, _)| p);
        let [a, b, c] = corners.map(|p| self.project(p));
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        if area.abs() < 1e-9 {
            return;
        }
        let length = |p: [f64; 3], q: [f64; 3]| hypot(p[0] - q[0], p[1] - q[1]);
        // Heights of the triangle above its sides, in samples of the raster.
        let heights = [(a, b), (b, c), (c, a)].map(|(p, q)| area.abs() / length(p, q).max(1e-9));
        let brightness = self.brightness([a, b, c]);
        let bounds = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]).floor().max(0.0) as usize;
            let high = a[k].max(b[k]).max(c[k]).ceil().min(self.size[k] as f64) as usize;
            low..high
        };
        let min_height = heights.iter().copied().fold(f64::INFINITY, f64::min);
        // Edges are fainter where cells are small.
        let edge_alpha =
            ((min_height - 3.0) / 8.0).clamp(0.0, 1.0) * f64::from(self.edge_color[3]) / 255.0;
        for y in bounds(1) {
            for x in bounds(0) {
                let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                let u = ((px - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (py - a[1])) / area;
                let v = ((b[0] - a[0]) * (py - a[1]) - (px - a[0]) * (b[1] - a[1])) / area;
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let depth = (w * a[2] + u * b[2] + v * c[2] + depth_bias) as f32;
                let index = y * self.size[0] + x;
                if depth <= self.depth_buffer[index] {
                    continue;
                }
                let p = std::array::from_fn(|k| {
                    w * corners[0][k] + u * corners[1][k] + v * corners[2][k]
                });
                let value = if is_constant {
                    values[0]
                } else {
                    w * values[0] + u * values[1] + v * values[2]
                };
                let Some(fill) = color(p, value) else {
                    continue;
                };
                self.depth_buffer[index] = depth;
                // The distances from the sides opposite the corners c, a and b.
                let edge_distances = [v * heights[0], w * heights[1], u * heights[2]];
                let on_edge = (0..3).any(|k| edges[k] && edge_distances[k] < EDGE_HALF_WIDTH);
                let alpha = if on_edge { edge_alpha } else { 0.0 };
                self.colors[index] = Some(std::array::from_fn(|k| {
                    let shaded = (f64::from(fill[k]) * brightness).min(255.0);
                    (shaded + alpha * (f64::from(self.edge_color[k]) - shaded)) as u8
                }));
            }
        }
    }

    /// Returns the brightness of a triangle for light from the upper left.
    fn brightness(&self, [a, b, c]: [[f64; 3]; 3]) -> f64 {
        // Converts depths to the unit of pixels: the box is about as deep as the picture is wide.
        let depth_scale = 0.5 * self.size[0] as f64;
        let u = [b[0] - a[0], a[1] - b[1], depth_scale * (b[2] - a[2])];
        let v = [c[0] - a[0], a[1] - c[1], depth_scale * (c[2] - a[2])];
        let normal = crate::geometry::cross(u, v);
        let length = crate::geometry::norm(normal).max(1e-300);
        let light_direction = [-0.25, 0.35, 0.9];
        0.64 + 0.38 * (crate::geometry::dot(normal, light_direction) / length).abs()
    }

    /// Draws a straight tube with a radius in pixels. If `is_shaded`, it is brighter along its
    /// middle. `depth_bias` is added to its depth.
    pub(super) fn draw_tube(
        &mut self,
        [p, q]: [[f64; 3]; 2],
        color: [u8; 3],
        radius: f64,
        is_shaded: bool,
        depth_bias: f64,
    ) {
        let (a, b) = (self.project(p), self.project(q));
        let radius = radius * SUPERSAMPLING as f64;
        let direction = [b[0] - a[0], b[1] - a[1]];
        let length2 = direction[0] * direction[0] + direction[1] * direction[1];
        let bounds = |k: usize| {
            let low = (a[k].min(b[k]) - radius).floor().max(0.0) as usize;
            let high = (a[k].max(b[k]) + radius).ceil().min(self.size[k] as f64) as usize;
            low..high
        };
        // Depth that corresponds to one sample of the raster.
        let pixel = 1.0 / self.size[0] as f64;
        for y in bounds(1) {
            for x in bounds(0) {
                let offset = [x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]];
                let t = if length2 > 0.0 {
                    (offset[0] * direction[0] + offset[1] * direction[1]) / length2
                } else {
                    0.0
                }
                .clamp(0.0, 1.0);
                let relative_distance =
                    hypot(offset[0] - t * direction[0], offset[1] - t * direction[1]) / radius;
                if relative_distance > 1.0 {
                    continue;
                }
                let height = (1.0 - relative_distance * relative_distance).sqrt();
                let depth = a[2] + t * (b[2] - a[2]) + depth_bias + radius * pixel * height;
                let index = y * self.size[0] + x;
                if depth as f32 <= self.depth_buffer[index] {
                    continue;
                }
                self.depth_buffer[index] = depth as f32;
                let brightness = if is_shaded {
                    0.55 + 0.6 * height * height
                } else {
                    1.0
                };
                self.colors[index] =
                    Some(color.map(|c| (f64::from(c) * brightness).min(255.0) as u8));
            }
        }
    }

    /// Draws the edges of the box where nothing hides them.
    pub(super) fn draw_outline(&mut self) {
        for k in 0..3 {
            for corner in 0..4 {
                let point = |fraction: f64| {
                    let mut p = [0.0; 3];
                    p[k] = fraction;
                    p[(k + 1) % 3] = f64::from(corner & 1);
                    p[(k + 2) % 3] = f64::from(corner >> 1);
                    p
                };
                let (a, b) = (self.project(point(0.0)), self.project(point(1.0)));
                let count = (b[0] - a[0]).abs().max((b[1] - a[1]).abs()).ceil().max(1.0);
                for i in 0..=count as usize {
                    let t = i as f64 / count;
                    let [x, y, depth] = std::array::from_fn(|j| a[j] + t * (b[j] - a[j]));
                    let (x, y) = (x as usize, y as usize);
                    if x >= self.size[0] || y >= self.size[1] {
                        continue;
                    }
                    let index = y * self.size[0] + x;
                    if depth as f32 + 2e-3 >= self.depth_buffer[index] {
                        self.colors[index] = Some([90, 95, 100]);
                    }
                }
            }
        }
    }

    /// Averages the samples of each pixel and draws them on a white canvas.
    pub(super) fn copy_to_canvas(&self, canvas: &mut Canvas) {
        let count = (SUPERSAMPLING * SUPERSAMPLING) as u32;
        for y in 0..self.size[1] / SUPERSAMPLING {
            for x in 0..self.size[0] / SUPERSAMPLING {
                let mut sum = [0u32; 3];
                let mut is_covered = false;
                for sample in 0..SUPERSAMPLING * SUPERSAMPLING {
                    let (row, column) = (
                        y * SUPERSAMPLING + sample / SUPERSAMPLING,
                        x * SUPERSAMPLING + sample % SUPERSAMPLING,
                    );
                    let color = self.colors[row * self.size[0] + column];
                    is_covered |= color.is_some();
                    for (sum, c) in sum.iter_mut().zip(color.unwrap_or([255; 3])) {
                        *sum += u32::from(c);
                    }
                }
                if is_covered {
                    let [r, g, b] = sum.map(|c| (c / count) as u8);
                    canvas.set_pixel(x as u32, y as u32, [r, g, b, 255]);
                }
            }
        }
    }

    /// Returns the pixel position of a point of the box.
    pub(super) fn pixel(&self, p: [f64; 3]) -> [f32; 2] {
        let [x, y, _] = self.project(p);
        [x, y].map(|c| (c / SUPERSAMPLING as f64) as f32)
    }
}
