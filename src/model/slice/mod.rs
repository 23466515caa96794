//! Pictures of a mesh over its image, as Hale (2001, 2002) shows them: in the plane the whole mesh,
//! in space its sections with three orthogonal planes of samples, or all of it with a corner open.
//!
//! - `skeleton`: the faces of any mesh, each once, and where they meet a plane
//! - `faces`: the same with the cells on either side
//! - `frame`: where a mesh lies, and how its box is drawn
//! - `panel`: a section on the canvas
//! - `solid`: the mesh as a body with a corner open
//! - `furniture`: title, numbers on axes, bar of colours, legend
//! - `canvas`: pixels: lines, letters
//! - `shades`: from samples to colours
//!
//! Lengths of one unit are drawn alike; where coordinates have unlike units, as metres and
//! milliseconds, samples are as far apart along all axes.

mod canvas;
pub(crate) mod faces;
pub(crate) mod frame;
mod furniture;
mod panel;
mod shades;
mod skeleton;
mod solid;

pub use canvas::Canvas;
pub(crate) use faces::Faces;
pub(crate) use frame::Frame;
pub use furniture::Caption;
pub(crate) use shades::Shades;
pub use skeleton::Skeleton;
pub use solid::solid;

use std::path::Path;

use crate::error::{cause, os};
use crate::geometry::norm;
use crate::image::formats::stream::Slabs;
use crate::image::{Geometry, Image};
use crate::model::surface::Kind;
use crate::{Error, Result};
use canvas::LETTER;
use furniture::{ABOVE, BELOW, LEFT, RIGHT};
use panel::{Line, Panel, extent};

/// Width and height of what is drawn, in pixels, aimed at.
const SIZE: [f32; 2] = [1400.0, 1200.0];
/// Most pixels a sample is drawn with, along the axis whose samples are nearest to each other.
const LARGEST: f32 = 8.0;
/// Space between panels.
const GAP: f32 = 106.0;

/// The mesh of a 2-D image over it. Where time or depth is one of the axes it runs down the page.
///
/// # Errors
/// [`Error::Image`] for an image too large to draw.
pub fn plane(image: &Image<2>, mesh: &Skeleton<2>, caption: &Caption) -> Result<Canvas> {
    let dims = image.dims();
    let geometry = &image.geometry;
    let down = upright(geometry);
    let across = 1 - down;
    let apart = apart(geometry, dims);
    let unit = unit_for(
        &apart,
        [
            steps(dims[across]) * apart[across],
            steps(dims[down]) * apart[down],
        ],
    );
    let panel = Panel {
        corner: [LEFT, ABOVE],
        scale: [across, down].map(|k| unit * apart[k]),
        dims: [dims[across], dims[down]],
        flipped: [false, is_flipped(geometry, down)],
    };
    let mut canvas = blank(
        extent(panel.dims[0], panel.scale[0]) + LEFT + RIGHT,
        extent(panel.dims[1], panel.scale[1]) + ABOVE + BELOW,
        caption,
    )?;
    let shades = Shades::of(image.as_slice());
    let strides = [1, dims[0]];
    panel.image(&mut canvas, &shades, |x, y| {
        image.as_slice()[x * strides[across] + y * strides[down]]
    });
    let lines: Vec<Line> = mesh
        .edges()
        .map(|(ends, kind)| Line {
            ends: ends.map(|p| [p[across] as f32, p[down] as f32]),
            kind,
        })
        .collect();
    panel.lines(&mut canvas, &shades, &lines);
    let rulers = [across, down].map(|k| caption.ruler(geometry, k, dims[k]));
    panel.axes(&mut canvas, [&rulers[0], &rulers[1]], None);
    furnish(&mut canvas, caption, &shades, &mesh.kinds);
    Ok(canvas)
}

/// The sections of a mesh with three planes of samples, over the image: the horizontal one on top, the two upright ones below it.
///
/// Upright is the image axis that runs most along the last physical coordinate.
///
/// # Errors
/// [`Error::Image`] for an image too large to draw.
pub fn space(
    image: &Sections,
    geometry: &Geometry<3>,
    mesh: &Skeleton<3>,
    caption: &Caption,
) -> Result<Canvas> {
    let Sections { dims, at, .. } = *image;
    let up = upright(geometry);
    // The two others, the faster one across the page.
    let [across, deep] = match up {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let apart = apart(geometry, dims);
    let wide = |k: usize| steps(dims[k]) * apart[k];
    let unit = unit_for(&apart, [wide(across) + wide(deep), wide(deep) + wide(up)]);
    let size = |k: usize| extent(dims[k], unit * apart[k]);
    let mut canvas = blank(
        size(across) + size(deep) + GAP + LEFT + RIGHT,
        size(deep) + size(up) + GAP + ABOVE + BELOW,
        caption,
    )?;
    let shades = image.shades;
    let rulers: [_; 3] = std::array::from_fn(|k| caption.ruler(geometry, k, dims[k]));
    let low = ABOVE + size(deep) + GAP;
    let right = LEFT + size(across) + GAP;
    for ([h, v], corner) in [
        ([across, deep], [LEFT, ABOVE]),
        ([across, up], [LEFT, low]),
        ([deep, up], [right, low]),
    ] {
        let normal = 3 - h - v;
        let panel = Panel {
            corner,
            scale: [h, v].map(|k| unit * apart[k]),
            dims: [dims[h], dims[v]],
            flipped: [false, v == up && is_flipped(geometry, up)],
        };
        panel.image(&mut canvas, &shades, |x, y| image.sample([h, v], [x, y]));
        let lines: Vec<Line> = mesh
            .section(normal, at[normal])
            .map(|(ends, kind)| Line {
                ends: ends.map(|p| [p[h] as f32, p[v] as f32]),
                kind,
            })
            .collect();
        panel.lines(&mut canvas, &shades, &lines);
        panel.axes(&mut canvas, [&rulers[h], &rulers[v]], Some([at[h], at[v]]));
    }
    furnish(&mut canvas, caption, &shades, &mesh.kinds);
    Ok(canvas)
}

/// What is drawn of an image in space: three planes of its samples.
pub struct Sections {
    dims: [usize; 3],
    /// Where they meet, in samples.
    at: [f64; 3],
    /// Those across each axis, in memory order.
    planes: [Vec<f32>; 3],
    shades: Shades,
}

impl Sections {
    /// The planes of samples through `at` (sample indices, x first), in one pass over an image of so many
    /// samples along each axis, which need not fit into memory.
    ///
    /// # Errors
    /// [`Error::Job`] if `at` lies outside the image; those of reading it, from `place`.
    pub fn of(place: &Path, dims: [usize; 3], slabs: &dyn Slabs, at: [f64; 3]) -> Result<Self> {
        check_inside(dims, at)?;
        let [nx, ny, nz] = dims;
        let slice = at.map(|x| x.round() as usize);
        let stride = Shades::stride(nx * ny * nz);
        let mut planes: [Vec<f32>; 3] = Default::default();
        let (mut looked_at, mut first) = (Vec::new(), 0);
        let gather = &mut |slab: &[f32]| {
            for (k, plane) in slab.chunks(nx * ny).enumerate() {
                let start = (first + k) * nx * ny;
                let skipped = start.next_multiple_of(stride) - start;
                looked_at.extend(plane.iter().skip(skipped).step_by(stride));
                planes[0].extend(plane.iter().skip(slice[0]).step_by(nx));
                planes[1].extend_from_slice(&plane[slice[1] * nx..][..nx]);
                if first + k == slice[2] {
                    planes[2] = plane.to_vec();
                }
            }
            first += slab.len() / (nx * ny);
            Ok(())
        };
        slabs.each(1, gather).map_err(|e| os(place, "read", e))?;
        Ok(Self {
            dims,
            at,
            planes,
            shades: Shades::of_some(looked_at),
        })
    }

    /// The sample of a section that has these indices along two axes.
    fn sample(&self, axes: [usize; 2], index: [usize; 2]) -> f32 {
        let plane = &self.planes[3 - axes[0] - axes[1]];
        let [fast, slow] = if axes[0] < axes[1] { [0, 1] } else { [1, 0] };
        plane[index[fast] + self.dims[axes[fast]] * index[slow]]
    }
}

/// A point, in samples, is in the image.
fn check_inside(dims: [usize; 3], at: [f64; 3]) -> Result<()> {
    if (0..3).all(|k| (0.0..=steps(dims[k]).into()).contains(&at[k])) {
        return Ok(());
    }
    Err(Error::Job(cause(
        format!("slice at sample {at:?}"),
        format!("lies outside the image of {dims:?} samples"),
        "give a point inside the image",
    )))
}

/// Title, bar of colours, and a legend of what there is.
fn furnish(canvas: &mut Canvas, caption: &Caption, shades: &Shades, kinds: &[Option<Kind>]) {
    canvas.caption(caption);
    canvas.color_bar(caption, shades);
    if kinds.is_empty() {
        return;
    }
    let mut entries = vec![("mesh", shades.mesh())];
    if kinds.contains(&Some(Kind::Fault)) {
        let name = match kinds.contains(&Some(Kind::Horizon)) {
            true => "fault",
            false => "feature",
        };
        entries.push((name, shades.feature()));
    }
    if kinds.contains(&Some(Kind::Horizon)) {
        entries.push(("horizon", shades.horizon()));
    }
    canvas.legend(&entries);
}

/// The image axis that runs most along the last physical coordinate.
fn upright<const D: usize>(geometry: &Geometry<D>) -> usize {
    let share =
        |k: usize| geometry.axes[k][D - 1].abs() / geometry.spacing()[k].max(f64::MIN_POSITIVE);
    (0..D - 1).fold(
        D - 1,
        |best, k| if share(k) > share(best) { k } else { best },
    )
}

/// Whether an axis has its last sample on top.
fn is_flipped<const D: usize>(geometry: &Geometry<D>, up: usize) -> bool {
    (geometry.axes[up][D - 1] >= 0.0) != geometry.points_down()
}

/// How far samples are drawn from each other along each axis, in one unit for all.
fn apart<const D: usize>(geometry: &Geometry<D>, dims: [usize; D]) -> [f32; D] {
    let samples = dims.map(|n| steps(n).into());
    let aspect = geometry.aspect(samples, samples);
    geometry
        .axes
        .map(|axis| norm::<D>(std::array::from_fn(|c| axis[c] * aspect[c])) as f32)
}

/// Steps from the first sample to the last.
fn steps(samples: usize) -> f32 {
    (samples.max(2) - 1) as f32
}

/// Pixels for a unit of length of a picture so wide and high.
fn unit_for(apart: &[f32], lengths: [f32; 2]) -> f32 {
    let nearest = apart.iter().copied().fold(f32::INFINITY, f32::min);
    (0..2).fold(LARGEST / nearest, |unit, k| unit.min(SIZE[k] / lengths[k]))
}

fn blank(width: f32, height: f32, caption: &Caption) -> Result<Canvas> {
    // Titles and legends need some width.
    let words = [&caption.title, &caption.subtitle].map(|line| line.chars().count());
    let words = LEFT + LETTER[0] * (words[0].max(words[1]) + 2) as f32;
    let width = width.max(520.0).max(words.min(SIZE[0]));
    Canvas::new(width.ceil() as u32, height.ceil() as u32).ok_or_else(|| {
        Error::Image(cause(
            "picture",
            format!("{width:.0} x {height:.0} pixels cannot be drawn"),
            "give a smaller image",
        ))
    })
}

#[cfg(test)]
mod tests;
