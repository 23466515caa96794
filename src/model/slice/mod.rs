//! Pictures of a mesh over its image, as Hale (2001, 2002) shows them: in the plane the whole mesh,
//! in space its sections with three orthogonal planes of samples.
//!
//! - `skeleton`: the faces of any mesh, each once, and where they meet a plane
//! - `canvas`: pixels: images, lines, letters
//! - `shades`: from samples to colours
//!
//! Pictures are drawn in sample indices, the space in which cells are meant to be well shaped; the
//! numbers on the axes are physical coordinates.

mod canvas;
mod shades;
mod skeleton;

pub use canvas::Canvas;
pub(crate) use shades::Shades;
pub use skeleton::Skeleton;

use crate::error::cause;
use crate::image::{Geometry, Image};
use crate::{Error, Result};

/// Width and height of a picture aimed at, in pixels.
const SIZE: [f32; 2] = [1400.0, 1200.0];
/// Most pixels a sample is drawn with, along each axis.
const LARGEST: f32 = 8.0;
/// Space round panels, in pixels: for the numbers on the axes.
const MARGIN: f32 = 64.0;
/// Space between panels.
const GAP: f32 = 76.0;

/// The mesh of a 2-D image over it.
///
/// # Errors
/// [`Error::Image`] for an image too large to draw.
pub fn plane(image: &Image<2>, mesh: &Skeleton<2>) -> Result<Canvas> {
    let [nx, ny] = image.dims();
    let panel = Panel {
        axes: [0, 1],
        place: None,
    };
    let scale = scale_for([nx, ny]);
    let mut canvas = blank(
        extent(nx, scale) + 2.0 * MARGIN,
        extent(ny, scale) + 2.0 * MARGIN,
    )?;
    let shades = Shades::of(image.as_slice());
    let frame = Frame {
        corner: [MARGIN, MARGIN],
        scale,
        dims: [nx, ny],
    };
    frame.image(&mut canvas, &shades, |x, y| image.as_slice()[y * nx + x]);
    let lines: Vec<Line> = mesh
        .edges()
        .map(|([a, b], marked)| Line {
            ends: [a, b].map(|p| p.map(|c| c as f32)),
            marked,
        })
        .collect();
    frame.lines(&mut canvas, &shades, &lines);
    frame.axes(&mut canvas, &image.geometry.in_space(), &panel);
    Ok(canvas)
}

/// The sections of a mesh with the three planes of samples through `at` (sample indices, x first),
/// over the image: the horizontal one on top, the two upright ones below it.
///
/// Upright is the image axis that runs most along the last physical coordinate.
///
/// # Errors
/// [`Error::Job`] if `at` lies outside the image, [`Error::Image`] for an image too large to draw.
pub fn space(image: &Image<3>, mesh: &Skeleton<3>, at: [f64; 3]) -> Result<Canvas> {
    let dims = image.dims();
    for k in 0..3 {
        if !(0.0..=(dims[k] - 1) as f64).contains(&at[k]) {
            return Err(Error::Job(cause(
                format!("slice at sample {at:?}"),
                format!("lies outside the image of {dims:?} samples"),
                "give a point inside the image",
            )));
        }
    }
    let up = upright(&image.geometry);
    // The two others, the faster one across the page.
    let [across, deep] = match up {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let scale = scale_for([dims[across] + dims[deep], dims[deep] + dims[up]]);
    let size = |k: usize| extent(dims[k], scale);
    let mut canvas = blank(
        size(across) + size(deep) + GAP + 2.0 * MARGIN,
        size(deep) + size(up) + GAP + 2.0 * MARGIN,
    )?;
    let shades = Shades::of(image.as_slice());
    let low = MARGIN + size(deep) + GAP;
    let right = MARGIN + size(across) + GAP;
    for ([h, v], corner) in [
        ([across, deep], [MARGIN, MARGIN]),
        ([across, up], [MARGIN, low]),
        ([deep, up], [right, low]),
    ] {
        let normal = 3 - h - v;
        let panel = Panel {
            axes: [h, v],
            place: Some(at),
        };
        let frame = Frame {
            corner,
            scale,
            dims: [dims[h], dims[v]],
        };
        let slice = at[normal].round() as usize;
        let strides = [1, dims[0], dims[0] * dims[1]];
        let samples = image.as_slice();
        frame.image(&mut canvas, &shades, |x, y| {
            samples[slice * strides[normal] + x * strides[h] + y * strides[v]]
        });
        let lines: Vec<Line> = mesh
            .section(normal, at[normal])
            .map(|(ends, marked)| Line {
                ends: ends.map(|p| [p[h] as f32, p[v] as f32]),
                marked,
            })
            .collect();
        frame.lines(&mut canvas, &shades, &lines);
        frame.axes(&mut canvas, &image.geometry, &panel);
    }
    Ok(canvas)
}

/// The image axis that runs most along the last physical coordinate.
fn upright(geometry: &Geometry<3>) -> usize {
    let share = |k: usize| geometry.axes[k][2].abs() / geometry.spacing()[k].max(f64::MIN_POSITIVE);
    (0..2).fold(2, |best, k| if share(k) > share(best) { k } else { best })
}

/// Pixels a sample for so many samples across and down.
fn scale_for(samples: [usize; 2]) -> f32 {
    (0..2).fold(LARGEST, |scale, k| scale.min(SIZE[k] / samples[k] as f32))
}

/// Pixels between the first sample and the last.
fn extent(samples: usize, scale: f32) -> f32 {
    (samples.max(2) - 1) as f32 * scale
}

fn blank(width: f32, height: f32) -> Result<Canvas> {
    Canvas::new(width.ceil() as u32, height.ceil() as u32).ok_or_else(|| {
        Error::Image(cause(
            "picture",
            format!("{width:.0} x {height:.0} pixels cannot be drawn"),
            "give a smaller image",
        ))
    })
}

/// A line of the mesh, in sample indices of a panel.
struct Line {
    ends: [[f32; 2]; 2],
    /// On a feature.
    marked: bool,
}

/// Which axes of the image a panel shows.
struct Panel {
    /// Across the page and down it.
    axes: [usize; 2],
    /// The point through which the panel goes; none for a 2-D image.
    place: Option<[f64; 3]>,
}

/// Where a panel lies on the canvas.
struct Frame {
    corner: [f32; 2],
    /// Pixels a sample.
    scale: f32,
    dims: [usize; 2],
}

impl Frame {
    fn pixel(&self, p: [f32; 2]) -> [f32; 2] {
        [0, 1].map(|k| self.corner[k] + self.scale * p[k])
    }

    fn size(&self) -> [f32; 2] {
        self.dims.map(|n| extent(n, self.scale))
    }

    /// The samples, interpolated linearly.
    fn image(&self, canvas: &mut Canvas, shades: &Shades, sample: impl Fn(usize, usize) -> f32) {
        let [width, height] = self.size();
        let last = self.dims.map(|n| n - 1);
        let taps = |pixel: u32, k: usize| {
            let x = ((pixel as f32 + 0.5) / self.scale).clamp(0.0, last[k] as f32);
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

    /// The lines of the mesh, those on features above the others.
    fn lines(&self, canvas: &mut Canvas, shades: &Shades, lines: &[Line]) {
        let width = (0.17 * self.scale).clamp(0.6, 1.2);
        for (marked, color, width) in [
            (false, shades.mesh(), width),
            (true, shades.feature(), 2.0 * width + 0.8),
        ] {
            let chosen = lines.iter().filter(|line| line.marked == marked);
            let ends: Vec<_> = chosen.map(|l| l.ends.map(|p| self.pixel(p))).collect();
            canvas.lines(&ends, color, width);
        }
    }

    /// The frame, where the other panels cut this one, and the ends of its axes in physical
    /// coordinates.
    fn axes(&self, canvas: &mut Canvas, geometry: &Geometry<3>, panel: &Panel) {
        const INK: [u8; 4] = [40, 40, 40, 255];
        let [width, height] = self.size();
        let [left, top] = self.corner;
        let (right, bottom) = (left + width, top + height);
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom]];
        let sides: Vec<_> = (0..4).map(|k| [corners[k], corners[(k + 1) % 4]]).collect();
        canvas.lines(&sides, INK, 1.0);

        let [h, v] = panel.axes;
        if let Some(at) = panel.place {
            let cut = self.pixel([at[h] as f32, at[v] as f32]);
            let ticks = [
                [[cut[0], top - 7.0], [cut[0], top]],
                [[cut[0], bottom], [cut[0], bottom + 7.0]],
                [[left - 7.0, cut[1]], [left, cut[1]]],
                [[right, cut[1]], [right + 7.0, cut[1]]],
            ];
            canvas.lines(&ticks, INK, 1.5);
        }
        // The physical coordinate that changes most along an axis, at its two ends.
        let ends = |axis: usize, count: usize| {
            let step = geometry.axes[axis];
            let most = (1..3).fold(0, |k, c| if step[c].abs() > step[k].abs() { c } else { k });
            let at = |index: f64| {
                let mut place = panel.place.unwrap_or_default();
                place[axis] = index;
                number(geometry.to_physical(place)[most])
            };
            let unit = match geometry.units[most].as_str() {
                "" => String::new(),
                unit => format!(" [{unit}]"),
            };
            let name = format!("{}{unit}", geometry.names[axis]);
            (at(0.0), name, at((count - 1) as f64))
        };
        let line = canvas::LETTER[1];
        let (first, name, last) = ends(h, self.dims[0]);
        let y = bottom + 9.0;
        canvas.text(&first, [left, y], 0.0, INK);
        canvas.text(&name, [0.5 * (left + right), y + line], 0.5, INK);
        canvas.text(&last, [right, y], 1.0, INK);
        let (first, name, last) = ends(v, self.dims[1]);
        let x = left - 9.0;
        canvas.text(&first, [x, top], 1.0, INK);
        canvas.text(&last, [x, bottom - line], 1.0, INK);
        canvas.text(&name, [left, top - line - 8.0], 0.5, INK);
        if let Some(at) = panel.place {
            // Where the panel is along the axis that it does not show.
            let normal = 3 - h - v;
            let step = geometry.axes[normal];
            let most = (1..3).fold(0, |k, c| if step[c].abs() > step[k].abs() { c } else { k });
            let text = format!(
                "{} {}",
                geometry.names[normal],
                number(geometry.to_physical(at)[most])
            );
            canvas.text(&text, [right, top - line - 8.0], 1.0, INK);
        }
    }
}

/// A coordinate with as many digits as a label has room for.
fn number(value: f64) -> String {
    let digits = match value.abs() {
        a if a >= 1000.0 || value.fract() == 0.0 => 0,
        a if a >= 10.0 => 1,
        _ => 2,
    };
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests;
