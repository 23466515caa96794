//! A mesh as a body with a corner open: its cells painted with the image, faces on features in their
//! own colours. Drawn by software, so that no graphics card is needed.

use super::canvas::{Canvas, LETTER};
use super::faces::Faces;
use super::frame::Frame;
use super::furniture::{ABOVE, BELOW, Caption, INK, LEFT, RIGHT, number, ticks};
use super::shades::Shades;
use super::{blank, check_inside, furnish};
use crate::Result;
use crate::image::Image;
use crate::image::geometry::Ruler;
use crate::mesh::complex::NONE;
use crate::model::surface::Kind;
use crate::model::surface::stored::numbered;
use crate::store::{Stored, StoredMesh};

/// From which side and from how far above, in radians.
const FROM: [f64; 2] = [0.55, 0.42];
/// Width and height of the body, in pixels, at most.
const SIZE: [f64; 2] = [1050.0, 850.0];
/// Samples a pixel along each axis, for smooth edges.
const FINER: usize = 2;
/// Half the width of edges of cells, in samples.
const EDGE: f64 = 0.75;

/// The mesh of a 3-D image, without the cells whose middle lies nearer to whoever looks than `at` (a
/// sample) along all three axes.
///
/// # Errors
/// [`Error::Job`](crate::Error::Job) if `at` lies outside the image,
/// [`Error::Mesh`](crate::Error::Mesh) if more than two cells share a face.
pub fn solid<M: Stored<3>>(
    image: &Image<3>,
    stored: &StoredMesh<3, M>,
    at: [f64; 3],
    caption: &Caption,
) -> Result<Canvas> {
    let dims = image.dims();
    check_inside(dims, at)?;
    let surfaces = stored.marks().map(|marks| numbered(stored, &marks));
    let surfaces = surfaces.unwrap_or_default();
    let faces = Faces::of(stored, &surfaces.facets)?;
    let mut frame = Frame::of(&stored.space, Some(&image.geometry));
    for (ruler, own) in frame.rulers.iter_mut().zip(&caption.rulers) {
        if let Some(own) = own {
            ruler.clone_from(own);
        }
    }
    let rows = frame.seen_from(FROM[0], FROM[1]);
    let share: [f64; 3] = std::array::from_fn(|k| at[k] / (dims[k].max(2) - 1) as f64);

    let wide = |row: &[f64; 4]| row[..3].iter().map(|c| c.abs()).sum::<f64>();
    let unit = (SIZE[0] / wide(&rows[0])).min(SIZE[1] / wide(&rows[1]));
    let size = [0, 1].map(|k| (unit * wide(&rows[k])).ceil());
    // Numbers and names of axes stand outside of the body on all sides.
    let longest = (frame.rulers.iter()).fold(0, |most, r| most.max(r.label.chars().count()));
    let left = LEFT.max(0.8 * LETTER[0] * longest as f32);
    let above = f64::from(ABOVE);
    let mut canvas = blank(
        size[0] as f32 + left + RIGHT + 40.0,
        size[1] as f32 + ABOVE + BELOW + 50.0,
        caption,
    )?;
    let middle = [
        f64::from(left) + 0.5 * size[0] + 20.0,
        above + 0.5 * size[1],
    ];
    let shades = Shades::of(image.as_slice());
    let mut raster = Raster::new(canvas.size(), rows, unit, middle, shades.mesh());

    let near: [bool; 3] = std::array::from_fn(|k| rows[2][k] > 0.0);
    let shown = |cell: u32| {
        cell != NONE
            && !(0..3).all(|k| {
                let middle = faces.middles[cell as usize][k];
                if near[k] {
                    middle >= share[k]
                } else {
                    middle < share[k]
                }
            })
    };
    let color_of = |p: [f64; 3]| {
        let index = std::array::from_fn(|k| p[k] * (dims[k] - 1) as f64);
        let [r, g, b, _] = shades.color(image.linear(index));
        [r, g, b]
    };
    let mut seen = Vec::new();
    for face in 0..faces.len() {
        let kind = match faces.surfaces[face] {
            0 => None,
            surface => surfaces.kinds.get(surface as usize - 1).copied(),
        };
        let ring = faces.rings.get(face);
        let corners: Vec<[f64; 3]> = ring.iter().map(|&n| faces.nodes[n as usize]).collect();
        let fill = kind.map(|kind| {
            let [r, g, b, _] = match kind {
                Kind::Fault => shades.feature(),
                Kind::Horizon => shades.horizon(),
            };
            [r, g, b]
        });
        let [a, b] = faces.cells[face].map(shown);
        match fill {
            Some(fill) => raster.polygon(&corners, &|_| fill, 1e-4),
            None if a != b => raster.polygon(&corners, &color_of, 0.0),
            None => continue,
        }
        seen.push(kind);
    }
    raster.outline();
    raster.put_on(&mut canvas);
    for k in 0..3 {
        axis(&mut canvas, &raster, &frame.rulers[k], k);
    }
    furnish(&mut canvas, caption, &shades, &seen);
    Ok(canvas)
}

/// Colours and how near they are, [`FINER`] times as many as pixels along each axis.
struct Raster {
    size: [usize; 2],
    colors: Vec<Option<[u8; 3]>>,
    /// How near what is seen is; boxes are drawn into [-1, 1].
    near: Vec<f32>,
    /// From a point of the box to pixels and to how near it is.
    rows: [[f64; 4]; 3],
    /// Edges of cells.
    line: [u8; 4],
}

impl Raster {
    fn new(
        pixels: [u32; 2],
        rows: [[f64; 4]; 3],
        unit: f64,
        middle: [f64; 2],
        line: [u8; 4],
    ) -> Self {
        let size = pixels.map(|n| n as usize * FINER);
        let fine = unit * FINER as f64;
        let depth: f64 = rows[2][..3]
            .iter()
            .map(|c| c.abs())
            .sum::<f64>()
            .max(1e-300);
        let [mut across, mut up, towards] = rows;
        across = across.map(|c| c * fine);
        across[3] += middle[0] * FINER as f64;
        up = up.map(|c| -c * fine);
        up[3] += middle[1] * FINER as f64;
        Self {
            size,
            colors: vec![None; size[0] * size[1]],
            near: vec![f32::NEG_INFINITY; size[0] * size[1]],
            rows: [across, up, towards.map(|c| 2.0 * c / depth)],
            line,
        }
    }

    /// Where a point of the box is seen, and how near.
    fn seen(&self, p: [f64; 3]) -> [f64; 3] {
        self.rows
            .map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3])
    }

    /// Draws a convex polygon with its edges, `nearer` than it is.
    fn polygon(&mut self, ring: &[[f64; 3]], color: &impl Fn([f64; 3]) -> [u8; 3], nearer: f64) {
        for i in 1..ring.len().saturating_sub(1) {
            let drawn = [i == 1, true, i + 2 == ring.len()];
            self.triangle([ring[0], ring[i], ring[i + 1]], drawn, color, nearer);
        }
    }

    /// Draws a triangle, with those of its sides (from each corner to the next) that are edges.
    fn triangle(
        &mut self,
        corners: [[f64; 3]; 3],
        edges: [bool; 3],
        color: &impl Fn([f64; 3]) -> [u8; 3],
        nearer: f64,
    ) {
        let [a, b, c] = corners.map(|p| self.seen(p));
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        if area.abs() < 1e-9 {
            return;
        }
        let length = |p: [f64; 3], q: [f64; 3]| (p[0] - q[0]).hypot(p[1] - q[1]);
        // Height of the triangle above each side, in samples.
        let heights = [(a, b), (b, c), (c, a)].map(|(p, q)| area.abs() / length(p, q).max(1e-9));
        let light = self.light([a, b, c]);
        let bounds = |k: usize| {
            let low = a[k].min(b[k]).min(c[k]).floor().max(0.0) as usize;
            let high = a[k].max(b[k]).max(c[k]).ceil().min(self.size[k] as f64) as usize;
            low..high
        };
        let small = heights.iter().copied().fold(f64::INFINITY, f64::min);
        // Edges fade where cells are small.
        let ink = ((small - 3.0) / 8.0).clamp(0.0, 1.0) * f64::from(self.line[3].max(150)) / 255.0;
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
                if near <= self.near[at] {
                    continue;
                }
                self.near[at] = near;
                // Sides lie opposite the corners c, a and b.
                let beside = [v * heights[0], w * heights[1], u * heights[2]];
                let on_edge = (0..3).any(|k| edges[k] && beside[k] < EDGE);
                let ink = if on_edge { ink } else { 0.0 };
                let p = std::array::from_fn(|k| {
                    w * corners[0][k] + u * corners[1][k] + v * corners[2][k]
                });
                let fill = color(p);
                self.colors[at] = Some(std::array::from_fn(|k| {
                    let lit = (f64::from(fill[k]) * light).min(255.0);
                    (lit + ink * (f64::from(self.line[k]) - lit)) as u8
                }));
            }
        }
    }

    /// How bright a triangle is, lit from above and from the left.
    fn light(&self, [a, b, c]: [[f64; 3]; 3]) -> f64 {
        // Depth is in other units than pixels: as long as the picture is wide.
        let deep = 0.5 * self.size[0] as f64;
        let u = [b[0] - a[0], a[1] - b[1], deep * (b[2] - a[2])];
        let v = [c[0] - a[0], a[1] - c[1], deep * (c[2] - a[2])];
        let normal = crate::geometry::cross(u, v);
        let length = crate::geometry::norm(normal).max(1e-300);
        let towards = [-0.25, 0.35, 0.9];
        0.64 + 0.38 * (crate::geometry::dot(normal, towards) / length).abs()
    }

    /// The edges of the box, where nothing hides them.
    fn outline(&mut self) {
        for k in 0..3 {
            for corner in 0..4 {
                let point = |share: f64| {
                    let mut p = [0.0; 3];
                    p[k] = share;
                    p[(k + 1) % 3] = f64::from(corner & 1);
                    p[(k + 2) % 3] = f64::from(corner >> 1);
                    p
                };
                let (a, b) = (self.seen(point(0.0)), self.seen(point(1.0)));
                let count = (b[0] - a[0]).abs().max((b[1] - a[1]).abs()).ceil().max(1.0);
                for i in 0..=count as usize {
                    let t = i as f64 / count;
                    let [x, y, near] = std::array::from_fn(|j| a[j] + t * (b[j] - a[j]));
                    let (x, y) = (x as usize, y as usize);
                    if x >= self.size[0] || y >= self.size[1] {
                        continue;
                    }
                    let at = y * self.size[0] + x;
                    if near as f32 + 2e-3 >= self.near[at] {
                        self.colors[at] = Some([90, 95, 100]);
                    }
                }
            }
        }
    }

    /// Puts the means of samples on the pixels of a white canvas.
    fn put_on(&self, canvas: &mut Canvas) {
        let count = (FINER * FINER) as u32;
        for y in 0..self.size[1] / FINER {
            for x in 0..self.size[0] / FINER {
                let mut sum = [0u32; 3];
                let mut any = false;
                for at in 0..FINER * FINER {
                    let (row, column) = (y * FINER + at / FINER, x * FINER + at % FINER);
                    let color = self.colors[row * self.size[0] + column];
                    any |= color.is_some();
                    for (sum, c) in sum.iter_mut().zip(color.unwrap_or([255; 3])) {
                        *sum += u32::from(c);
                    }
                }
                if any {
                    let [r, g, b] = sum.map(|c| (c / count) as u8);
                    canvas.set(x as u32, y as u32, [r, g, b, 255]);
                }
            }
        }
    }

    /// The pixel on which a point of the box is seen.
    fn pixel(&self, p: [f64; 3]) -> [f32; 2] {
        let [x, y, _] = self.seen(p);
        [x, y].map(|c| (c / FINER as f64) as f32)
    }
}

/// Numbers along axis `k`: on that of its four edges which is on the outline, low and to the left.
fn axis(canvas: &mut Canvas, raster: &Raster, ruler: &Ruler, k: usize) {
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
        let seen = [0, 1].map(|i| (shares[i] > 0.5) == (raster.rows[2][others[i]] > 0.0));
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
    let half_line = 0.5 * LETTER[1];
    // Text ends, begins or has its middle where it stands, by the way out.
    let anchor = match out[0] {
        x if x > 0.35 => 0.0,
        x if x < -0.35 => 1.0,
        _ => 0.5,
    };
    let (values, step) = ticks(ruler.first, ruler.last, f64::from(long / 70.0));
    for value in values {
        let t = ((value - ruler.first) / (ruler.last - ruler.first)) as f32;
        let at: [f32; 2] = std::array::from_fn(|i| a[i] + t * along[i]);
        let away = |far: f32| std::array::from_fn::<f32, 2, _>(|i| at[i] + far * out[i]);
        canvas.lines(&[[at, away(6.0)]], INK, 1.0);
        let [x, y] = away(12.0);
        canvas.text(&number(value, step), [x, y - half_line], anchor, INK);
    }
    let steep = along[1].abs() > 2.0 * along[0].abs();
    if steep {
        let top = if a[1] < b[1] { a } else { b };
        canvas.text(&ruler.label, [top[0], top[1] - 3.5 * half_line], 0.5, INK);
    } else {
        let at: [f32; 2] = std::array::from_fn(|i| middle[i] + 46.0 * out[i]);
        canvas.text(&ruler.label, [at[0], at[1] - half_line], anchor, INK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::store::MeshFile;

    /// A cube of six tetrahedra over an image that is dark but for a bright half.
    fn picture(at: [f64; 3]) -> Result<Canvas> {
        let samples = (0..1000)
            .map(|i| if i % 10 < 5 { 0.0 } else { 1.0 })
            .collect();
        let image = Image::new([10; 3], samples, Geometry::default());
        let mesh = super::super::tests::cube(9.0);
        let file = MeshFile {
            mesh,
            point_data: Vec::new(),
            cell_data: Vec::new(),
            field_data: Vec::new(),
        };
        let stored = StoredMesh::new(file, "cube")?;
        solid(&image, &stored, at, &Caption::default())
    }

    #[test]
    fn cells_are_painted_with_the_image_and_the_corner_is_open() {
        let whole = picture([9.0, 0.0, 0.0]).unwrap();
        let open = picture([0.0, 9.0, 9.0]).unwrap();
        let count = |canvas: &Canvas, wanted: fn([u8; 3]) -> bool| {
            let [w, h] = canvas.size();
            (100..h - 150)
                .flat_map(|y| (100..w - 150).map(move |x| (x, y)))
                .filter(|&(x, y)| wanted(canvas.color(x, y)))
                .count()
        };
        let dark = count(&whole, |[r, g, b]| r < 40 && g < 40 && b < 40);
        let bright = count(&whole, |[r, g, b]| {
            (150..255).contains(&r) && r == g && g == b
        });
        assert!(dark > 50_000 && bright > 50_000, "{dark} {bright}");
        // Some of its cells have gone.
        assert_ne!(
            count(&open, |c| c == [255; 3]),
            count(&whole, |c| c == [255; 3])
        );
        assert!(picture([10.0, 0.0, 0.0]).is_err());
    }
}
