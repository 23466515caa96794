//! Draws pictures of a mesh over its image, as Hale (2001, 2002) shows them: the whole mesh in 2-D;
//! in 3-D its sections with three orthogonal planes of samples, or a solid view with a part cut
//! away.
//!
//! - `slice_spec`: all options, as one value
//! - `drawing`: draws what the options ask for
//! - `captions`: the texts above a picture
//! - `skeleton`: the faces of any mesh, each once, and their sections with a plane
//! - `faces`: the faces of any mesh, with the cells on either side
//! - `box_frame`: the position of a mesh, and the projection of its box
//! - `panel`: a section on the canvas
//! - `paint`: an array of the mesh that gives cells their colours
//! - `shape`: surfaces and lines that are drawn with the mesh
//! - `solid`: a solid view of the contents of a box
//! - `clipping`: the part that is cut away, and the sections of cells with a plane
//! - `raster`: triangles and lines with a depth buffer
//! - `axes`: numbers along the edges of a box
//! - `color_key`: the meaning of colours
//! - `decorations`: title, axis numbers, colour bar and legend
//! - `canvas`: pixels, lines and letters
//! - `color_map`: the map from samples to colours
//!
//! Lengths in the same unit are drawn at the same scale. Where coordinates have different units,
//! such as metres and milliseconds, samples are equally far apart along all axes.

mod axes;
pub(crate) mod box_frame;
mod canvas;
mod captions;
mod clipping;
mod color_key;
mod color_map;
mod decorations;
mod drawing;
pub(crate) mod faces;
mod paint;
mod panel;
mod raster;
mod shape;
mod skeleton;
mod slice_spec;
mod solid;

pub(crate) use box_frame::BoxFrame;
pub use canvas::Canvas;
pub(crate) use color_map::ColorMap;
pub use decorations::Caption;
pub use drawing::{InputNames, SliceInput, slice};
pub(crate) use faces::DrawableFaces;
pub use paint::Paint;
pub use shape::OverlayShape;
pub use skeleton::Skeleton;
pub use slice_spec::{CutMode, SliceSpec, View};
pub use solid::{SolidMesh, SolidView};

use std::path::Path;

use crate::error::{cause, io_error};
use crate::geometry::norm;
use crate::image::formats::stream::SlabSource;
use crate::image::{Geometry, Image};
use crate::option_text::SignedAxis;
use crate::store::{Storable, StoredMesh};
use crate::{Error, Result};
use canvas::LETTER_SIZE;
use color_key::ColorKey;
use decorations::{BOTTOM_MARGIN, LEFT_MARGIN, RIGHT_MARGIN, TOP_MARGIN};
use panel::{Panel, PanelLine, pixel_extent};

/// Target for the width and height of the drawing, in pixels.
const TARGET_SIZE: [f32; 2] = [1400.0, 1200.0];
/// Maximum number of pixels per sample, along the axis with the closest samples.
const MAX_PIXELS_PER_SAMPLE: f32 = 8.0;
/// Space between panels, in pixels.
const PANEL_GAP: f32 = 106.0;

/// Objects that are drawn over an image.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Overlay<const D: usize> {
    /// The mesh.
    pub mesh: Skeleton<D>,
    /// The cells of the mesh with their colours.
    pub painted_cells: Option<PaintedCells>,
    /// Surfaces and lines in physical coordinates. In 2-D their lines are drawn, in 3-D the
    /// sections of their surfaces.
    pub shapes: Vec<OverlayShape>,
    /// The upward direction; `None` takes that of the image.
    pub up_direction: Option<SignedAxis>,
}

/// Cells, and the paint that gives them colours.
#[derive(Debug, Clone, PartialEq)]
pub struct PaintedCells {
    faces: DrawableFaces,
    paint: Paint,
}

impl PaintedCells {
    /// Creates the painted cells of a mesh.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`] if more than two cells share a face.
    pub fn new<const D: usize, M: Storable<D>>(
        stored: &StoredMesh<D, M>,
        paint: Paint,
    ) -> Result<Self> {
        let faces = DrawableFaces::from_mesh(stored, &[])?;
        Ok(Self { faces, paint })
    }
}

/// Draws the mesh of a 2-D image over the image. If one of the axes is time or depth, it increases
/// down the page.
///
/// # Errors
/// Returns [`Error::Image`] if the image is too large to draw.
pub fn draw_plane(image: &Image<2>, overlay: &Overlay<2>, caption: &Caption) -> Result<Canvas> {
    let dims = image.dims();
    let geometry = &image.geometry;
    let up = overlay.up_direction.unwrap_or_else(|| default_up(geometry));
    let vertical = axis_along(geometry, up.axis);
    let horizontal = 1 - vertical;
    let spacing = sample_spacing(geometry, dims);
    let scale = pixels_per_unit(
        &spacing,
        [
            step_count(dims[horizontal]) * spacing[horizontal],
            step_count(dims[vertical]) * spacing[vertical],
        ],
    );
    let panel = Panel {
        top_left: [LEFT_MARGIN, TOP_MARGIN],
        pixels_per_sample: [horizontal, vertical].map(|k| scale * spacing[k]),
        dims: [dims[horizontal], dims[vertical]],
        is_flipped: [false, is_flipped(geometry, vertical, up)],
    };
    let mut canvas = blank_canvas(
        pixel_extent(panel.dims[0], panel.pixels_per_sample[0]) + LEFT_MARGIN + RIGHT_MARGIN,
        pixel_extent(panel.dims[1], panel.pixels_per_sample[1]) + TOP_MARGIN + BOTTOM_MARGIN,
        caption,
    )?;
    let color_map = ColorMap::from_samples(image.as_slice());
    let strides = [1, dims[0]];
    panel.draw_image(&mut canvas, &color_map, |x, y| {
        image.as_slice()[x * strides[horizontal] + y * strides[vertical]]
    });
    let mut color_key = ColorKey::new(
        Some(color_map),
        overlay.painted_cells.as_ref().map(|p| &p.paint),
    );
    if let Some(PaintedCells { faces, paint }) = &overlay.painted_cells {
        for (face, cells) in faces.cells.iter().enumerate() {
            let corner = |&n: &u32| {
                let p = faces.nodes[n as usize];
                let position = [horizontal, vertical].map(|k| p[k] as f32 * step_count(dims[k]));
                (position, paint.value(cells[0], n))
            };
            let ring: Vec<_> = faces.rings.get(face).iter().map(corner).collect();
            panel.fill_polygon(&mut canvas, &ring, |value| paint.color(value));
        }
    }
    let lines: Vec<PanelLine> = overlay
        .mesh
        .edges()
        .map(|(ends, kind)| PanelLine {
            ends: ends.map(|p| [p[horizontal] as f32, p[vertical] as f32]),
            kind,
        })
        .collect();
    panel.draw_mesh_lines(&mut canvas, &color_key, &lines);
    for (shape, color) in overlay
        .shapes
        .iter()
        .zip(shape::shape_colors(&overlay.shapes))
    {
        let to_panel = |[x, y, _]: [f64; 3]| {
            let index = geometry.to_index([x, y]).unwrap_or_default();
            [index[horizontal] as f32, index[vertical] as f32]
        };
        let lines: Vec<_> = shape.segments().map(|ends| ends.map(to_panel)).collect();
        panel.draw_thick_lines(&mut canvas, color, &lines);
        color_key.add_shape(shape, color);
    }
    let rulers = [horizontal, vertical].map(|k| caption.ruler(geometry, k, dims[k]));
    panel.draw_axes(&mut canvas, [&rulers[0], &rulers[1]], None);
    color_key.add_kinds(&overlay.mesh.kinds);
    color_key.draw_decorations(&mut canvas, caption);
    Ok(canvas)
}

/// Draws the sections of a mesh with three planes of samples, over the image: the horizontal
/// section on top, and the two vertical ones below it.
///
/// The vertical axis of the page is the image axis that is most nearly parallel to the upward
/// coordinate.
///
/// # Errors
/// Returns [`Error::Image`] if the image is too large to draw.
pub fn draw_sections(
    image: &Sections,
    geometry: &Geometry<3>,
    overlay: &Overlay<3>,
    caption: &Caption,
) -> Result<Canvas> {
    let Sections { dims, point, .. } = *image;
    let up = overlay.up_direction.unwrap_or_else(|| default_up(geometry));
    let up_axis = axis_along(geometry, up.axis);
    // Of the two other axes, the faster one runs across the page.
    let [across, depth_axis] = match up_axis {
        0 => [1, 2],
        1 => [0, 2],
        _ => [0, 1],
    };
    let spacing = sample_spacing(geometry, dims);
    let axis_length = |k: usize| step_count(dims[k]) * spacing[k];
    let scale = pixels_per_unit(
        &spacing,
        [
            axis_length(across) + axis_length(depth_axis),
            axis_length(depth_axis) + axis_length(up_axis),
        ],
    );
    let size = |k: usize| pixel_extent(dims[k], scale * spacing[k]);
    let mut canvas = blank_canvas(
        size(across) + size(depth_axis) + PANEL_GAP + LEFT_MARGIN + RIGHT_MARGIN,
        size(depth_axis) + size(up_axis) + PANEL_GAP + TOP_MARGIN + BOTTOM_MARGIN,
        caption,
    )?;
    let color_map = image.color_map;
    let mut color_key = ColorKey::new(
        Some(color_map),
        overlay.painted_cells.as_ref().map(|p| &p.paint),
    );
    for (shape, color) in overlay
        .shapes
        .iter()
        .zip(shape::shape_colors(&overlay.shapes))
    {
        color_key.add_shape(shape, color);
    }
    let rulers: [_; 3] = std::array::from_fn(|k| caption.ruler(geometry, k, dims[k]));
    let lower_top = TOP_MARGIN + size(depth_axis) + PANEL_GAP;
    let right_left = LEFT_MARGIN + size(across) + PANEL_GAP;
    for ([h, v], corner) in [
        ([across, depth_axis], [LEFT_MARGIN, TOP_MARGIN]),
        ([across, up_axis], [LEFT_MARGIN, lower_top]),
        ([depth_axis, up_axis], [right_left, lower_top]),
    ] {
        let panel = Panel {
            top_left: corner,
            pixels_per_sample: [h, v].map(|k| scale * spacing[k]),
            dims: [dims[h], dims[v]],
            is_flipped: [false, v == up_axis && is_flipped(geometry, up_axis, up)],
        };
        draw_section(
            &mut canvas,
            &panel,
            image,
            geometry,
            overlay,
            &color_key,
            [h, v],
        );
        panel.draw_axes(
            &mut canvas,
            [&rulers[h], &rulers[v]],
            Some([point[h], point[v]]),
        );
    }
    color_key.add_kinds(&overlay.mesh.kinds);
    color_key.draw_decorations(&mut canvas, caption);
    Ok(canvas)
}

/// Draws one section, along the axes `h` and `v`, in its panel.
fn draw_section(
    canvas: &mut Canvas,
    panel: &Panel,
    image: &Sections,
    geometry: &Geometry<3>,
    overlay: &Overlay<3>,
    color_key: &ColorKey,
    [h, v]: [usize; 2],
) {
    let normal = 3 - h - v;
    panel.draw_image(canvas, &image.color_map, |x, y| {
        image.sample([h, v], [x, y])
    });
    if let Some(PaintedCells { faces, paint }) = &overlay.painted_cells {
        let fraction = image.point[normal] / f64::from(step_count(image.dims[normal]));
        let value = |cell, node| paint.value(cell, node);
        for (_, ring) in clipping::cell_sections(faces, normal, fraction, &value) {
            let to_samples = |p: [f64; 3]| [h, v].map(|k| p[k] as f32 * step_count(image.dims[k]));
            let ring: Vec<_> = ring
                .iter()
                .map(|&(p, value)| (to_samples(p), value))
                .collect();
            panel.fill_polygon(canvas, &ring, |value| paint.color(value));
        }
    }
    let to_panel = |ends: [[f64; 3]; 2]| ends.map(|p| [p[h] as f32, p[v] as f32]);
    let lines: Vec<PanelLine> = overlay
        .mesh
        .section(normal, image.point[normal])
        .map(|(ends, kind)| PanelLine {
            ends: to_panel(ends),
            kind,
        })
        .collect();
    panel.draw_mesh_lines(canvas, color_key, &lines);
    for (shape, color) in overlay
        .shapes
        .iter()
        .zip(shape::shape_colors(&overlay.shapes))
    {
        let to_index = |x: [f64; 3]| geometry.to_index(x).unwrap_or_default();
        let lines: Vec<_> = shape
            .section(normal, image.point[normal], to_index)
            .map(to_panel)
            .collect();
        panel.draw_thick_lines(canvas, color, &lines);
    }
}

/// Three orthogonal planes of samples of a 3-D image.
pub struct Sections {
    dims: [usize; 3],
    /// Point in which the planes meet, in samples.
    point: [f64; 3],
    /// For each axis, the samples of the plane perpendicular to it, in memory order.
    planes: [Vec<f32>; 3],
    color_map: ColorMap,
}

impl Sections {
    /// Reads the planes of samples through `point` (sample indices, x first). The image has `dims`
    /// samples and is read in one pass, so that it need not fit into memory. `path` names the image
    /// in errors.
    ///
    /// # Errors
    /// Returns [`Error::Job`] if `point` is outside the image, and the errors of reading it.
    pub fn new(
        path: &Path,
        dims: [usize; 3],
        slabs: &dyn SlabSource,
        point: [f64; 3],
    ) -> Result<Self> {
        check_inside(dims, point)?;
        let [nx, ny, nz] = dims;
        let indices = point.map(|x| x.round() as usize);
        let stride = ColorMap::stride(nx * ny * nz);
        let mut planes: [Vec<f32>; 3] = Default::default();
        let (mut selected, mut first) = (Vec::new(), 0);
        let read_slab = &mut |slab: &[f32]| {
            for (k, plane) in slab.chunks(nx * ny).enumerate() {
                let start = (first + k) * nx * ny;
                let skipped = start.next_multiple_of(stride) - start;
                selected.extend(plane.iter().skip(skipped).step_by(stride));
                planes[0].extend(plane.iter().skip(indices[0]).step_by(nx));
                planes[1].extend_from_slice(&plane[indices[1] * nx..][..nx]);
                if first + k == indices[2] {
                    planes[2] = plane.to_vec();
                }
            }
            first += slab.len() / (nx * ny);
            Ok(())
        };
        slabs
            .for_each_slab(1, read_slab)
            .map_err(|e| io_error(path, "read", e))?;
        Ok(Self {
            dims,
            point,
            planes,
            color_map: ColorMap::from_selected_samples(selected),
        })
    }

    /// Returns the sample with the indices `index` along the two `axes`, in the section parallel to
    /// them.
    fn sample(&self, axes: [usize; 2], index: [usize; 2]) -> f32 {
        let plane = &self.planes[3 - axes[0] - axes[1]];
        let [fast, slow] = if axes[0] < axes[1] { [0, 1] } else { [1, 0] };
        plane[index[fast] + self.dims[axes[fast]] * index[slow]]
    }
}

/// Checks that a point, in samples, is in the image.
fn check_inside(dims: [usize; 3], point: [f64; 3]) -> Result<()> {
    if (0..3).all(|k| (0.0..=step_count(dims[k]).into()).contains(&point[k])) {
        return Ok(());
    }
    Err(Error::Job(cause(
        format!("slice at sample {point:?}"),
        format!("lies outside the image of {dims:?} samples"),
        "give a point inside the image",
    )))
}

/// Returns the upward direction of an image: its last physical coordinate.
fn default_up<const D: usize>(geometry: &Geometry<D>) -> SignedAxis {
    SignedAxis {
        axis: D - 1,
        is_positive: !geometry.points_down(),
    }
}

/// Returns the image axis that is most nearly parallel to a physical coordinate.
fn axis_along<const D: usize>(geometry: &Geometry<D>, coordinate: usize) -> usize {
    let alignment = |k: usize| {
        geometry.axes[k][coordinate].abs() / geometry.spacing()[k].max(f64::MIN_POSITIVE)
    };
    // If several axes are equally parallel, the axis with the number of the coordinate is taken.
    (0..D).fold(coordinate, |best, k| {
        if alignment(k) > alignment(best) {
            k
        } else {
            best
        }
    })
}

/// Returns `true` if the last sample of an axis is at the top.
fn is_flipped<const D: usize>(geometry: &Geometry<D>, axis: usize, up: SignedAxis) -> bool {
    (geometry.axes[axis][up.axis] >= 0.0) == up.is_positive
}

/// Returns the distance between samples along each axis, in a common unit for display.
fn sample_spacing<const D: usize>(geometry: &Geometry<D>, dims: [usize; D]) -> [f32; D] {
    let samples = dims.map(|n| step_count(n).into());
    let aspect = geometry.display_scale(samples, samples);
    geometry
        .axes
        .map(|axis| norm::<f64, D>(std::array::from_fn(|c| axis[c] * aspect[c])) as f32)
}

/// Returns the number of steps from the first sample to the last; at least 1.
fn step_count(samples: usize) -> f32 {
    (samples.max(2) - 1) as f32
}

/// Returns the pixels per unit of length for a picture of this width and height.
fn pixels_per_unit(spacing: &[f32], lengths: [f32; 2]) -> f32 {
    let min_spacing = spacing.iter().copied().fold(f32::INFINITY, f32::min);
    (0..2).fold(MAX_PIXELS_PER_SAMPLE / min_spacing, |scale, k| {
        scale.min(TARGET_SIZE[k] / lengths[k])
    })
}

fn blank_canvas(width: f32, height: f32, caption: &Caption) -> Result<Canvas> {
    // Titles and legends need a minimum width.
    let line_lengths = [&caption.title, &caption.subtitle].map(|line| line.chars().count());
    let text_width =
        LEFT_MARGIN + LETTER_SIZE[0] * (line_lengths[0].max(line_lengths[1]) + 2) as f32;
    let width = width.max(520.0).max(text_width.min(TARGET_SIZE[0]));
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
