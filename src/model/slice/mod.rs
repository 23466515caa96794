//! Pictures of a mesh over its image, as Hale (2001, 2002) shows them: in the plane the whole mesh,
//! in space its sections with three orthogonal planes of samples, or all of it with a part taken away.
//!
//! - `skeleton`: the faces of any mesh, each once, and where they meet a plane
//! - `faces`: the same with the cells on either side
//! - `frame`: where a mesh lies, and how its box is drawn
//! - `panel`: a section on the canvas
//! - `paint`: what cells are painted with: an array of the mesh
//! - `shape`: surfaces and lines beside the mesh
//! - `solid`: what stands in a box, seen from outside
//! - `opening`: what is taken away of it, and the cells that a plane cuts
//! - `raster`: near things hide far ones
//! - `axes`: numbers along the edges of a box
//! - `marks`: what colours mean
//! - `furniture`: title, numbers, bar of colours, legend
//! - `canvas`: pixels: lines, letters
//! - `shades`: from samples to colours
//!
//! Lengths of one unit are drawn alike; where coordinates have unlike units, as metres and
//! milliseconds, samples are as far apart along all axes.

mod axes;
mod canvas;
pub(crate) mod faces;
pub(crate) mod frame;
mod furniture;
mod marks;
mod opening;
mod paint;
mod panel;
mod raster;
mod shades;
mod shape;
mod skeleton;
mod solid;

pub use canvas::Canvas;
pub(crate) use faces::Faces;
pub(crate) use frame::Frame;
pub use furniture::Caption;
pub use paint::Paint;
pub(crate) use shades::Shades;
pub use shape::Shape;
pub use skeleton::Skeleton;
pub use solid::{Body, Cut, Solid};

use std::path::Path;

use crate::error::{cause, os};
use crate::geometry::norm;
use crate::image::formats::stream::Slabs;
use crate::image::{Geometry, Image};
use crate::store::{Stored, StoredMesh};
use crate::{Error, Result};
use canvas::LETTER;
use furniture::{ABOVE, BELOW, LEFT, RIGHT};
use marks::Marks;
use panel::{Line, Panel, extent};

/// Width and height of what is drawn, in pixels, aimed at.
const SIZE: [f32; 2] = [1400.0, 1200.0];
/// Most pixels a sample is drawn with, along the axis whose samples are nearest to each other.
const LARGEST: f32 = 8.0;
/// Space between panels.
const GAP: f32 = 106.0;

/// Which way is up in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Upward {
    /// The physical coordinate that is drawn upright.
    pub coordinate: usize,
    /// Whether it grows downwards.
    pub down: bool,
}

/// What is drawn over an image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overlay<const D: usize> {
    /// The mesh.
    pub mesh: Skeleton<D>,
    /// Its cells, and what they are painted with.
    pub painted: Option<Painted>,
    /// Surfaces, where the plane meets them; in the plane lines. In physical coordinates.
    pub shapes: Vec<Shape>,
    /// Which way is up; as the image has it if not given.
    pub up: Option<Upward>,
}

/// Cells with their paint.
#[derive(Debug, Clone, PartialEq)]
pub struct Painted {
    faces: Faces,
    paint: Paint,
}

impl Painted {
    /// Paints the cells of a mesh.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two cells share a face.
    pub fn new<const D: usize, M: Stored<D>>(
        stored: &StoredMesh<D, M>,
        paint: Paint,
    ) -> Result<Self> {
        let faces = Faces::of(stored, &[])?;
        Ok(Self { faces, paint })
    }
}

/// The mesh of a 2-D image over it. Where time or depth is one of the axes it runs down the page.
///
/// # Errors
/// [`Error::Image`] for an image too large to draw.
pub fn plane(image: &Image<2>, over: &Overlay<2>, caption: &Caption) -> Result<Canvas> {
    let dims = image.dims();
    let geometry = &image.geometry;
    let up = over.up.unwrap_or_else(|| upward(geometry));
    let down = axis_along(geometry, up.coordinate);
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
        flipped: [false, is_flipped(geometry, down, up)],
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
    let mut marks = Marks::new(Some(shades), over.painted.as_ref().map(|p| &p.paint));
    if let Some(Painted { faces, paint }) = &over.painted {
        for (face, cells) in faces.cells.iter().enumerate() {
            let corner = |&n: &u32| {
                let p = faces.nodes[n as usize];
                let at = [across, down].map(|k| p[k] as f32 * steps(dims[k]));
                (at, paint.value(cells[0], n))
            };
            let ring: Vec<_> = faces.rings.get(face).iter().map(corner).collect();
            panel.fill(&mut canvas, &ring, |value| paint.color(value));
        }
    }
    let lines: Vec<Line> = over
        .mesh
        .edges()
        .map(|(ends, kind)| Line {
            ends: ends.map(|p| [p[across] as f32, p[down] as f32]),
            kind,
        })
        .collect();
    panel.lines(&mut canvas, &marks, &lines);
    for (shape, color) in over.shapes.iter().zip(shape::colors(&over.shapes)) {
        let place = |[x, y, _]: [f64; 3]| {
            let at = geometry.to_index([x, y]).unwrap_or_default();
            [at[across] as f32, at[down] as f32]
        };
        let lines: Vec<_> = shape.segments().map(|ends| ends.map(place)).collect();
        panel.thick(&mut canvas, color, &lines);
        marks.saw_shape(shape, color);
    }
    let rulers = [across, down].map(|k| caption.ruler(geometry, k, dims[k]));
    panel.axes(&mut canvas, [&rulers[0], &rulers[1]], None);
    marks.saw_all(&over.mesh.kinds);
    marks.put_on(&mut canvas, caption);
    Ok(canvas)
}

/// The sections of a mesh with three planes of samples, over the image: the horizontal one on top, the two upright ones below it.
///
/// Upright is the image axis that runs most along the coordinate that is up.
///
/// # Errors
/// [`Error::Image`] for an image too large to draw.
pub fn space(
    image: &Sections,
    geometry: &Geometry<3>,
    over: &Overlay<3>,
    caption: &Caption,
) -> Result<Canvas> {
    let Sections { dims, at, .. } = *image;
    let upward = over.up.unwrap_or_else(|| upward(geometry));
    let up = axis_along(geometry, upward.coordinate);
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
    let mut marks = Marks::new(Some(shades), over.painted.as_ref().map(|p| &p.paint));
    for (shape, color) in over.shapes.iter().zip(shape::colors(&over.shapes)) {
        marks.saw_shape(shape, color);
    }
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
            flipped: [false, v == up && is_flipped(geometry, up, upward)],
        };
        panel.image(&mut canvas, &shades, |x, y| image.sample([h, v], [x, y]));
        if let Some(Painted { faces, paint }) = &over.painted {
            let share = at[normal] / f64::from(steps(dims[normal]));
            let value = |cell, node| paint.value(cell, node);
            for (_, ring) in opening::sections(faces, normal, share, &value) {
                let place = |p: [f64; 3]| [h, v].map(|k| p[k] as f32 * steps(dims[k]));
                let ring: Vec<_> = ring.iter().map(|&(p, value)| (place(p), value)).collect();
                panel.fill(&mut canvas, &ring, |value| paint.color(value));
            }
        }
        let flat = |ends: [[f64; 3]; 2]| ends.map(|p| [p[h] as f32, p[v] as f32]);
        let lines: Vec<Line> = over
            .mesh
            .section(normal, at[normal])
            .map(|(ends, kind)| Line {
                ends: flat(ends),
                kind,
            })
            .collect();
        panel.lines(&mut canvas, &marks, &lines);
        for (shape, color) in over.shapes.iter().zip(shape::colors(&over.shapes)) {
            let place = |x: [f64; 3]| geometry.to_index(x).unwrap_or_default();
            let lines: Vec<_> = shape.section(normal, at[normal], place).map(flat).collect();
            panel.thick(&mut canvas, color, &lines);
        }
        panel.axes(&mut canvas, [&rulers[h], &rulers[v]], Some([at[h], at[v]]));
    }
    marks.saw_all(&over.mesh.kinds);
    marks.put_on(&mut canvas, caption);
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

/// Up as an image has it: its last physical coordinate.
fn upward<const D: usize>(geometry: &Geometry<D>) -> Upward {
    Upward {
        coordinate: D - 1,
        down: geometry.points_down(),
    }
}

/// The image axis that runs most along a physical coordinate.
fn axis_along<const D: usize>(geometry: &Geometry<D>, coordinate: usize) -> usize {
    let share = |k: usize| {
        geometry.axes[k][coordinate].abs() / geometry.spacing()[k].max(f64::MIN_POSITIVE)
    };
    // Of two that run alike along it that of the same number.
    (0..D).fold(
        coordinate,
        |best, k| {
            if share(k) > share(best) { k } else { best }
        },
    )
}

/// Whether an axis has its last sample on top.
fn is_flipped<const D: usize>(geometry: &Geometry<D>, axis: usize, up: Upward) -> bool {
    (geometry.axes[axis][up.coordinate] >= 0.0) != up.down
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
