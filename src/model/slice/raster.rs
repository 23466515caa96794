//! A picture of what stands in a box, drawn by software, so that no graphics card is needed.

use super::canvas::Canvas;

/// Samples a pixel along each axis, for smooth edges.
const SUPERSAMPLING: usize = 2;
/// Half the width of edges of cells, in samples.
const EDGE_HALF_WIDTH: f64 = 0.75;

/// A corner of a polygon: a point of the box, and the value there.
pub(super) type ValuedPoint = ([f64; 3], f64);

/// Colours and how near they are, [`SUPERSAMPLING`] times as many as pixels along each axis.
pub(super) struct Raster {
    size: [usize; 2],
    colors: Vec<Option<[u8; 3]>>,
    /// How near what is seen is; boxes are drawn into [-1, 1].
    depth_buffer: Vec<f32>,
    /// From a point of the box to pixels and to how near it is.
    pub(super) projection: [[f64; 4]; 3],
    /// Edges of cells.
    edge_color: [u8; 4],
}

impl Raster {
    pub(super) fn new(
        pixels: [u32; 2],
        rows: [[f64; 4]; 3],
        unit: f64,
        middle: [f64; 2],
        edge_color: [u8; 4],
    ) -> Self {
        let size = pixels.map(|n| n as usize * SUPERSAMPLING);
        let fine = unit * SUPERSAMPLING as f64;
        let depth: f64 = rows[2][..3]
            .iter()
            .map(|c| c.abs())
            .sum::<f64>()
            .max(1e-300);
        let [mut across, mut up, towards] = rows;
        across = across.map(|c| c * fine);
        across[3] += middle[0] * SUPERSAMPLING as f64;
        up = up.map(|c| -c * fine);
        up[3] += middle[1] * SUPERSAMPLING as f64;
        Self {
            size,
            colors: vec![None; size[0] * size[1]],
            depth_buffer: vec![f32::NEG_INFINITY; size[0] * size[1]],
            projection: [across, up, towards.map(|c| 2.0 * c / depth)],
            edge_color,
        }
    }

    /// Where a point of the box is seen, and how near.
    pub(super) fn project(&self, p: [f64; 3]) -> [f64; 3] {
        self.projection
            .map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3])
    }

    /// Draws a convex polygon with its edges, `nearer` than it is, where it has a colour.
    pub(super) fn draw_polygon(
        &mut self,
        ring: &[ValuedPoint],
        color: &impl Fn([f64; 3], f64) -> Option<[u8; 3]>,
        nearer: f64,
    ) {
        for i in 1..ring.len().saturating_sub(1) {
            let drawn = [i == 1, true, i + 2 == ring.len()];
            self.draw_triangle([ring[0], ring[i], ring[i + 1]], drawn, color, nearer);
        }
    }

    /// Draws a triangle, with those of its sides (from each corner to the next) that are edges.
    fn draw_triangle(
        &mut self,
        corners: [ValuedPoint; 3],
        edges: [bool; 3],
        color: &impl Fn([f64; 3], f64) -> Option<[u8; 3]>,
        nearer: f64,
    ) {
        let values = corners.map(|(_, value)| value);
        // A cell's number stays what it is.
        let one = values.iter().all(|value| *value == values[0]);
        let corners = corners.map(|(p, _)| p);
        let [a, b, c] = corners.map(|p| self.project(p));
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        if area.abs() < 1e-9 {
            return;
        }
        let length = |p: [f64; 3], q: [f64; 3]| (p[0] - q[0]).hypot(p[1] - q[1]);
        // Height of the triangle above each side, in samples.
        let heights = [(a, b), (b, c), (c, a)].map(|(p, q)| area.abs() / length(p, q).max(1e-9));
        let light = self.brightness([a, b, c]);
        let bounds = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]).floor().max(0.0) as usize;
            let high = a[k].max(b[k]).max(c[k]).ceil().min(self.size[k] as f64) as usize;
            low..high
        };
        let small = heights.iter().copied().fold(f64::INFINITY, f64::min);
        // Edges fade where cells are small.
        let ink = ((small - 3.0) / 8.0).clamp(0.0, 1.0) * f64::from(self.edge_color[3]) / 255.0;
        for y in bounds(1) {
            for x in bounds(0) {
                let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                let u = ((px - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (py - a[1])) / area;
                let v = ((b[0] - a[0]) * (py - a[1]) - (px - a[0]) * (b[1] - a[1])) / area;
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let near = (w * a[2] + u * b[2] + v * c[2] + nearer) as f32;
                let at = y * self.size[0] + x;
                if near <= self.depth_buffer[at] {
                    continue;
                }
                let p = std::array::from_fn(|k| {
                    w * corners[0][k] + u * corners[1][k] + v * corners[2][k]
                });
                let value = match one {
                    true => values[0],
                    false => w * values[0] + u * values[1] + v * values[2],
                };
                let Some(fill) = color(p, value) else {
                    continue;
                };
                self.depth_buffer[at] = near;
                // Sides lie opposite the corners c, a and b.
                let beside = [v * heights[0], w * heights[1], u * heights[2]];
                let on_edge = (0..3).any(|k| edges[k] && beside[k] < EDGE_HALF_WIDTH);
                let ink = if on_edge { ink } else { 0.0 };
                self.colors[at] = Some(std::array::from_fn(|k| {
                    let lit = (f64::from(fill[k]) * light).min(255.0);
                    (lit + ink * (f64::from(self.edge_color[k]) - lit)) as u8
                }));
            }
        }
    }

    /// How bright a triangle is, lit from above and from the left.
    fn brightness(&self, [a, b, c]: [[f64; 3]; 3]) -> f64 {
        // Depth is in other units than pixels: as long as the picture is wide.
        let deep = 0.5 * self.size[0] as f64;
        let u = [b[0] - a[0], a[1] - b[1], deep * (b[2] - a[2])];
        let v = [c[0] - a[0], a[1] - c[1], deep * (c[2] - a[2])];
        let normal = crate::geometry::cross(u, v);
        let length = crate::geometry::norm(normal).max(1e-300);
        let towards = [-0.25, 0.35, 0.9];
        0.64 + 0.38 * (crate::geometry::dot(normal, towards) / length).abs()
    }

    /// Draws a straight tube of a radius in pixels, `nearer` than it is: brighter along its middle if it is
    /// `lit`.
    pub(super) fn draw_tube(
        &mut self,
        [p, q]: [[f64; 3]; 2],
        color: [u8; 3],
        radius: f64,
        lit: bool,
        nearer: f64,
    ) {
        let (a, b) = (self.project(p), self.project(q));
        let radius = radius * SUPERSAMPLING as f64;
        let along = [b[0] - a[0], b[1] - a[1]];
        let squared = along[0] * along[0] + along[1] * along[1];
        let bounds = |k: usize| {
            let low = (a[k].min(b[k]) - radius).floor().max(0.0) as usize;
            let high = (a[k].max(b[k]) + radius).ceil().min(self.size[k] as f64) as usize;
            low..high
        };
        // A pixel's share of the depth of the box.
        let pixel = 1.0 / self.size[0] as f64;
        for y in bounds(1) {
            for x in bounds(0) {
                let from = [x as f64 + 0.5 - a[0], y as f64 + 0.5 - a[1]];
                let t = match squared > 0.0 {
                    true => (from[0] * along[0] + from[1] * along[1]) / squared,
                    false => 0.0,
                }
                .clamp(0.0, 1.0);
                let off = (from[0] - t * along[0]).hypot(from[1] - t * along[1]) / radius;
                if off > 1.0 {
                    continue;
                }
                let round = (1.0 - off * off).sqrt();
                let near = a[2] + t * (b[2] - a[2]) + nearer + radius * pixel * round;
                let at = y * self.size[0] + x;
                if near as f32 <= self.depth_buffer[at] {
                    continue;
                }
                self.depth_buffer[at] = near as f32;
                let light = if lit { 0.55 + 0.6 * round * round } else { 1.0 };
                self.colors[at] = Some(color.map(|c| (f64::from(c) * light).min(255.0) as u8));
            }
        }
    }

    /// The edges of the box, where nothing hides them.
    pub(super) fn draw_outline(&mut self) {
        for k in 0..3 {
            for corner in 0..4 {
                let point = |share: f64| {
                    let mut p = [0.0; 3];
                    p[k] = share;
                    p[(k + 1) % 3] = f64::from(corner & 1);
                    p[(k + 2) % 3] = f64::from(corner >> 1);
                    p
                };
                let (a, b) = (self.project(point(0.0)), self.project(point(1.0)));
                let count = (b[0] - a[0]).abs().max((b[1] - a[1]).abs()).ceil().max(1.0);
                for i in 0..=count as usize {
                    let t = i as f64 / count;
                    let [x, y, near] = std::array::from_fn(|j| a[j] + t * (b[j] - a[j]));
                    let (x, y) = (x as usize, y as usize);
                    if x >= self.size[0] || y >= self.size[1] {
                        continue;
                    }
                    let at = y * self.size[0] + x;
                    if near as f32 + 2e-3 >= self.depth_buffer[at] {
                        self.colors[at] = Some([90, 95, 100]);
                    }
                }
            }
        }
    }

    /// Puts the means of samples on the pixels of a white canvas.
    pub(super) fn copy_to_canvas(&self, canvas: &mut Canvas) {
        let count = (SUPERSAMPLING * SUPERSAMPLING) as u32;
        for y in 0..self.size[1] / SUPERSAMPLING {
            for x in 0..self.size[0] / SUPERSAMPLING {
                let mut sum = [0u32; 3];
                let mut any = false;
                for at in 0..SUPERSAMPLING * SUPERSAMPLING {
                    let (row, column) = (
                        y * SUPERSAMPLING + at / SUPERSAMPLING,
                        x * SUPERSAMPLING + at % SUPERSAMPLING,
                    );
                    let color = self.colors[row * self.size[0] + column];
                    any |= color.is_some();
                    for (sum, c) in sum.iter_mut().zip(color.unwrap_or([255; 3])) {
                        *sum += u32::from(c);
                    }
                }
                if any {
                    let [r, g, b] = sum.map(|c| (c / count) as u8);
                    canvas.set_pixel(x as u32, y as u32, [r, g, b, 255]);
                }
            }
        }
    }

    /// The pixel on which a point of the box is seen.
    pub(super) fn pixel(&self, p: [f64; 3]) -> [f32; 2] {
        let [x, y, _] = self.project(p);
        [x, y].map(|c| (c / SUPERSAMPLING as f64) as f32)
    }
}
