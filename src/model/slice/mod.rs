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
mod clipping;
mod color_key;
mod color_map;
mod decorations;
pub(crate) mod faces;
pub(crate) mod frame;
mod paint;
mod panel;
mod raster;
mod shape;
mod skeleton;
mod solid;

pub use canvas::Canvas;
pub(crate) use color_map::ColorMap;
pub use decorations::Caption;
pub(crate) use faces::DrawableFaces;
pub(crate) use frame::BoxFrame;
pub use paint::Paint;
pub use shape::OverlayShape;
pub use skeleton::Skeleton;
pub use solid::{CutMode, SolidMesh, SolidView};

use std::path::Path;

use crate::error::{cause, io_error};
use crate::geometry::norm;
use crate::image::formats::stream::SlabSource;
use crate::image::{Geometry, Image};
use crate::store::{Storable, StoredMesh};
use crate::{Error, Result};
use canvas::LETTER_SIZE;
use color_key::ColorKey;
use decorations::{BOTTOM_MARGIN, LEFT_MARGIN, RIGHT_MARGIN, TOP_MARGIN};
use panel::{Panel, PanelLine, pixel_extent};

/// Width and height of what is drawn, in pixels, aimed at.
const TARGET_SIZE: [f32; 2] = [1400.0, 1200.0];
/// Most pixels a sample is drawn with, along the axis whose samples are nearest to each other.
const MAX_PIXELS_PER_SAMPLE: f32 = 8.0;
/// Space between panels.
const PANEL_GAP: f32 = 106.0;

/// Which way is up in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UpDirection {
    /// The physical coordinate that is drawn upright.
    pub coordinate: usize,
    /// Whether it grows downwards.
    pub points_down: bool,
}

/// What is drawn over an image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overlay<const D: usize> {
    /// The mesh.
    pub mesh: Skeleton<D>,
    /// Its cells, and what they are painted with.
    pub painted_cells: Option<PaintedCells>,
    /// Surfaces, where the plane meets them; in the plane lines. In physical coordinates.
    pub shapes: Vec<OverlayShape>,
    /// Which way is up; as the image has it if not given.
    pub up_direction: Option<UpDirection>,
}

/// Cells with their paint.
#[derive(Debug, Clone, PartialEq)]
pub struct PaintedCells {
    faces: DrawableFaces,
    paint: Paint,
}

impl PaintedCells {
    /// Paints the cells of a mesh.
    ///
    /// # Errors
    /// [`Error::Mesh`] if more than two cells share a face.
    pub fn new<const D: usize, M: Storable<D>>(
        stored: &StoredMesh<D, M>,
        paint: Paint,
    ) -> Result<Self> {
        let faces = DrawableFaces::from_mesh(stored, &[])?;
        Ok(Self { faces, paint })
    }
}

/// The mesh of a 2-D image over it. Where time or depth is one of the axes it runs down the page.
///
/// # Errors
/// [`Error::Image`] for an image too large to draw.
pub fn draw_plane(image: &Image<2>, over: &Overlay<2>, caption: &Caption) -> Result<Canvas> {
    let dims = image.dims();
    let geometry = &image.geometry;
    let up = over.up_direction.unwrap_or_else(|| default_up(geometry));
    let down = axis_along(geometry, up.coordinate);
    let across = 1 - down;
    let apart = sample_spacing(geometry, dims);
    let unit = pixels_per_unit(
        &apart,
        [
            step_count(dims[across]) * apart[across],
            step_count(dims[down]) * apart[down],
        ],
    );
    let panel = Panel {
        top_left: [LEFT_MARGIN, TOP_MARGIN],
        pixels_per_sample: [across, down].map(|k| unit * apart[k]),
        dims: [dims[across], dims[down]],
        is_flipped: [false, is_flipped(geometry, down, up)],
    };
    let mut canvas = blank_canvas(
        pixel_extent(panel.dims[0], panel.pixels_per_sample[0]) + LEFT_MARGIN + RIGHT_MARGIN,
        pixel_extent(panel.dims[1], panel.pixels_per_sample[1]) + TOP_MARGIN + BOTTOM_MARGIN,
        caption,
    )?;
    let shades = ColorMap::from_samples(image.as_slice());
    let strides = [1, dims[0]];
    panel.draw_image(&mut canvas, &shades, |x, y| {
        image.as_slice()[x * strides[across] + y * strides[down]]
    });
    let mut marks = ColorKey::new(Some(shades), over.painted_cells.as_ref().map(|p| &p.paint));
    if let Some(PaintedCells { faces, paint }) = &over.painted_cells {
        for (face, cells) in faces.cells.iter().enumerate() {
            let corner = |&n: &u32| {
                let p = faces.nodes[n as usize];
                let at = [across, down].map(|k| p[k] as f32 * step_count(dims[k]));
                (at, paint.value(cells[0], n))
            };
            let ring: Vec<_> = faces.rings.get(face).iter().map(corner).collect();
            panel.fill_polygon(&mut canvas, &ring, |value| paint.color(value));
        }
    }
    let lines: Vec<PanelLine> = over
        .mesh
        .edges()
        .map(|(ends, kind)| PanelLine {
            ends: ends.map(|p| [p[across] as f32, p[down] as f32]),
            kind,
        })
        .collect();
    panel.draw_mesh_lines(&mut canvas, &marks, &lines);
    for (shape, color) in over.shapes.iter().zip(shape::shape_colors(&over.shapes)) {
        let place = |[x, y, _]: [f64; 3]| {
            let at = geometry.to_index([x, y]).unwrap_or_default();
            [at[across] as f32, at[down] as f32]
        };
        let lines: Vec<_> = shape.segments().map(|ends| ends.map(place)).collect();
        panel.draw_thick_lines(&mut canvas, color, &lines);
        marks.add_shape(shape, color);
    }
    let rulers = [across, down].map(|k| caption.ruler(geometry, k, dims[k]));
    panel.draw_axes(&mut canvas, [&rulers[0], &rulers[1]], None);
    marks.add_kinds(&over.mesh.kinds);
    marks.draw_decorations(&mut canvas, caption);
    Ok(canvas)
}

/// The sections of a mesh with three planes of samples, over the image: the horizontal one on top, the two upright ones below it.
///
/// Upright is the image axis that runs most along the coordinate that is up.
///
/// # Errors
/// [`Error::Image`] for an image too large to draw.
pub fn draw_sections(
    image: &Sections,
    geometry: &Geometry<3>,
    over: &Overlay<3>,
    caption: &Caption,
) -> Result<Canvas> {
    let Sections {
        dims, point: at, ..
    } = *image;
    let upward = over.up_direction.unwrap_or_else(|| default_up(geometry));
    let up = axis_along(geometry, upward.coordinate);
    // The two others, the faster one across the page.
    let [across, deep] = match up {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let apart = sample_spacing(geometry, dims);
    let wide = |k: usize| step_count(dims[k]) * apart[k];
    let unit = pixels_per_unit(&apart, [wide(across) + wide(deep), wide(deep) + wide(up)]);
    let size = |k: usize| pixel_extent(dims[k], unit * apart[k]);
    let mut canvas = blank_canvas(
        size(across) + size(deep) + PANEL_GAP + LEFT_MARGIN + RIGHT_MARGIN,
        size(deep) + size(up) + PANEL_GAP + TOP_MARGIN + BOTTOM_MARGIN,
        caption,
    )?;
    let shades = image.color_map;
    let mut marks = ColorKey::new(Some(shades), over.painted_cells.as_ref().map(|p| &p.paint));
    for (shape, color) in over.shapes.iter().zip(shape::shape_colors(&over.shapes)) {
        marks.add_shape(shape, color);
    }
    let rulers: [_; 3] = std::array::from_fn(|k| caption.ruler(geometry, k, dims[k]));
    let low = TOP_MARGIN + size(deep) + PANEL_GAP;
    let right = LEFT_MARGIN + size(across) + PANEL_GAP;
    for ([h, v], corner) in [
        ([across, deep], [LEFT_MARGIN, TOP_MARGIN]),
        ([across, up], [LEFT_MARGIN, low]),
        ([deep, up], [right, low]),
    ] {
        let normal = 3 - h - v;
        let panel = Panel {
            top_left: corner,
            pixels_per_sample: [h, v].map(|k| unit * apart[k]),
            dims: [dims[h], dims[v]],
            is_flipped: [false, v == up && is_flipped(geometry, up, upward)],
        };
        panel.draw_image(&mut canvas, &shades, |x, y| image.sample([h, v], [x, y]));
        if let Some(PaintedCells { faces, paint }) = &over.painted_cells {
            let share = at[normal] / f64::from(step_count(dims[normal]));
            let value = |cell, node| paint.value(cell, node);
            for (_, ring) in clipping::cell_sections(faces, normal, share, &value) {
                let place = |p: [f64; 3]| [h, v].map(|k| p[k] as f32 * step_count(dims[k]));
                let ring: Vec<_> = ring.iter().map(|&(p, value)| (place(p), value)).collect();
                panel.fill_polygon(&mut canvas, &ring, |value| paint.color(value));
            }
        }
        let flat = |ends: [[f64; 3]; 2]| ends.map(|p| [p[h] as f32, p[v] as f32]);
        let lines: Vec<PanelLine> = over
            .mesh
            .section(normal, at[normal])
            .map(|(ends, kind)| PanelLine {
                ends: flat(ends),
                kind,
            })
            .collect();
        panel.draw_mesh_lines(&mut canvas, &marks, &lines);
        for (shape, color) in over.shapes.iter().zip(shape::shape_colors(&over.shapes)) {
            let place = |x: [f64; 3]| geometry.to_index(x).unwrap_or_default();
            let lines: Vec<_> = shape.section(normal, at[normal], place).map(flat).collect();
            panel.draw_thick_lines(&mut canvas, color, &lines);
        }
        panel.draw_axes(&mut canvas, [&rulers[h], &rulers[v]], Some([at[h], at[v]]));
    }
    marks.add_kinds(&over.mesh.kinds);
    marks.draw_decorations(&mut canvas, caption);
    Ok(canvas)
}

/// What is drawn of an image in space: three planes of its samples.
pub struct Sections {
    dims: [usize; 3],
    /// Where they meet, in samples.
    point: [f64; 3],
    /// Those across each axis, in memory order.
    planes: [Vec<f32>; 3],
    color_map: ColorMap,
}

impl Sections {
    /// The planes of samples through `at` (sample indices, x first), in one pass over an image of so many
    /// samples along each axis, which need not fit into memory.
    ///
    /// # Errors
    /// [`Error::Job`] if `at` lies outside the image; those of reading it, from `place`.
    pub fn new(
        place: &Path,
        dims: [usize; 3],
        slabs: &dyn SlabSource,
        at: [f64; 3],
    ) -> Result<Self> {
        check_inside(dims, at)?;
        let [nx, ny, nz] = dims;
        let slice = at.map(|x| x.round() as usize);
        let stride = ColorMap::stride(nx * ny * nz);
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
        slabs
            .for_each_slab(1, gather)
            .map_err(|e| io_error(place, "read", e))?;
        Ok(Self {
            dims,
            point: at,
            planes,
            color_map: ColorMap::from_selected_samples(looked_at),
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
    if (0..3).all(|k| (0.0..=step_count(dims[k]).into()).contains(&at[k])) {
        return Ok(());
    }
    Err(Error::Job(cause(
        format!("slice at sample {at:?}"),
        format!("lies outside the image of {dims:?} samples"),
        "give a point inside the image",
    )))
}

/// Up as an image has it: its last physical coordinate.
fn default_up<const D: usize>(geometry: &Geometry<D>) -> UpDirection {
    UpDirection {
        coordinate: D - 1,
        points_down: geometry.points_down(),
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
fn is_flipped<const D: usize>(geometry: &Geometry<D>, axis: usize, up: UpDirection) -> bool {
    (geometry.axes[axis][up.coordinate] >= 0.0) != up.points_down
}

/// How far samples are drawn from each other along each axis, in one unit for all.
fn sample_spacing<const D: usize>(geometry: &Geometry<D>, dims: [usize; D]) -> [f32; D] {
    let samples = dims.map(|n| step_count(n).into());
    let aspect = geometry.display_scale(samples, samples);
    geometry
        .axes
        .map(|axis| norm::<D>(std::array::from_fn(|c| axis[c] * aspect[c])) as f32)
}

/// Steps from the first sample to the last.
fn step_count(samples: usize) -> f32 {
    (samples.max(2) - 1) as f32
}

/// Pixels for a unit of length of a picture so wide and high.
fn pixels_per_unit(apart: &[f32], lengths: [f32; 2]) -> f32 {
    let nearest = apart.iter().copied().fold(f32::INFINITY, f32::min);
    (0..2).fold(MAX_PIXELS_PER_SAMPLE / nearest, |unit, k| {
        unit.min(TARGET_SIZE[k] / lengths[k])
    })
}

fn blank_canvas(width: f32, height: f32, caption: &Caption) -> Result<Canvas> {
    // Titles and legends need some width.
    let words = [&caption.title, &caption.subtitle].map(|line| line.chars().count());
    let words = LEFT_MARGIN + LETTER_SIZE[0] * (words[0].max(words[1]) + 2) as f32;
    let width = width.max(520.0).max(words.min(TARGET_SIZE[0]));
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
