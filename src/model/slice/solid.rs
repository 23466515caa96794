//! A solid view of the contents of a box: a mesh or an image with a part cut away, surfaces and
//! lines.

use super::axes::draw_axis;
use super::box_frame::BoxFrame;
use super::canvas::{Canvas, LETTER_SIZE};
use super::clipping::{ClipPlane, ClipRegion, cell_sections};
use super::color_key::ColorKey;
use super::color_map::ColorMap;
use super::decorations::{BOTTOM_MARGIN, Caption, LEFT_MARGIN, RIGHT_MARGIN, TOP_MARGIN};
use super::faces::DrawableFaces;
use super::paint::Paint;
use super::raster::{Raster, ValuedPoint};
use super::shape::{self, OverlayShape};
use super::{CutMode, axis_along, blank_canvas, check_inside};
use crate::Result;
use crate::geometry::{bounding_box, sub};
use crate::image::{Geometry, Image};
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;
use crate::model::surface::SurfaceKind;
use crate::model::surface::stored_surfaces::surfaces_by_bend;
use crate::option_text::SignedAxis;
use crate::store::{LatticeSpace, Storable, StoredMesh};

/// View angles around the vertical axis and above the horizon, in radians: for a view onto a
/// corner, and for a view onto a plane perpendicular to an edge that runs to the right, away from
/// the viewer, or upwards.
const CORNER_VIEW_ANGLES: [f64; 2] = [0.55, 0.42];
const PLANE_VIEW_ANGLES: [[f64; 2]; 3] = [[1.15, 0.36], [0.42, 0.36], [0.42, 0.9]];
/// Maximum width and height of the body, in pixels.
const MAX_BODY_SIZE: [f64; 2] = [1050.0, 850.0];
/// Colour of cells and surfaces without a colour of their own.
const DEFAULT_COLOR: [u8; 3] = [222, 228, 235];
/// Half the width, in pixels, of lines on a plane and of lines in space.
const LINE_HALF_WIDTHS: [f64; 2] = [1.9, 1.4];

/// A 3-D mesh, ready to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SolidMesh {
    faces: DrawableFaces,
    /// Kind of each surface on which faces lie.
    kinds: Vec<SurfaceKind>,
}

impl SolidMesh {
    /// Creates the drawable form of a mesh.
    ///
    /// # Errors
    /// Returns [`Error::Mesh`](crate::Error::Mesh) if more than two cells share a face.
    pub fn from_stored<M: Storable<3>>(stored: &StoredMesh<3, M>) -> Result<Self> {
        let surfaces = stored
            .feature_marks()
            .map(|marks| surfaces_by_bend(stored, &marks));
        let surfaces = surfaces.unwrap_or_default();
        Ok(Self {
            faces: DrawableFaces::from_mesh(stored, &surfaces.facets)?,
            kinds: surfaces.kinds,
        })
    }

    /// Returns the box itself, as a mesh of one cell.
    fn unit_box() -> Self {
        let nodes = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from));
        let mut rings = Lists::default();
        for [a, b, c] in [[1, 2, 4], [2, 4, 1], [4, 1, 2]] {
            for side in [0, c] {
                rings.push([side, side + a, side + a + b, side + b]);
            }
        }
        Self {
            faces: DrawableFaces {
                nodes: nodes.collect(),
                cells: vec![[0, NONE]; rings.len()],
                surfaces: vec![0; rings.len()],
                rings,
                feature_edges: Vec::new(),
                cell_centres: vec![[0.5; 3]],
            },
            kinds: Vec::new(),
        }
    }

    /// Returns the kind of surface on which a face lies, if any.
    fn face_kind(&self, face: usize) -> Option<SurfaceKind> {
        let surface = (self.faces.surfaces[face] as usize).checked_sub(1)?;
        self.kinds.get(surface).copied()
    }
}

/// Contents and options of a solid view.
#[derive(Debug, Clone, PartialEq)]
pub struct SolidView<'a> {
    /// The box.
    pub space: LatticeSpace<3>,
    /// The image in the box.
    pub image: Option<&'a Image<3>>,
    /// The mesh in the box.
    pub mesh: Option<SolidMesh>,
    /// Colours of the mesh instead of those of the image.
    pub paint: Option<Paint>,
    /// Surfaces and lines in the box, in physical coordinates.
    pub shapes: Vec<OverlayShape>,
    /// The upward direction; `None` takes that of the image and the mesh.
    pub up_direction: Option<SignedAxis>,
    /// The part that is cut away.
    pub cut: CutMode,
    /// Point of the cut, in samples; `None` takes the middle of the box.
    pub cut_point: Option<[f64; 3]>,
}

impl SolidView<'_> {
    /// Returns the box of an image.
    pub fn image_space(dims: [usize; 3], geometry: &Geometry<3>) -> LatticeSpace<3> {
        LatticeSpace {
            extent: dims.map(|n| (n.max(2) - 1) as f64),
            step: [1.0; 3],
            geometry: geometry.clone(),
            bent_side: None,
            is_stored: true,
            velocities: None,
        }
    }

    /// Returns the bounding box of shapes. It has a minimum width along each axis, so that flat
    /// shapes can be drawn.
    pub fn bounding_space(shapes: &[OverlayShape]) -> LatticeSpace<3> {
        let points: Vec<[f64; 3]> = shapes.iter().flat_map(OverlayShape::points).collect();
        let [low, high] = bounding_box(&points);
        let widths = sub(high, low);
        let min_width = 1e-3 * widths.iter().copied().fold(1e-9, f64::max);
        Self::image_space(
            [2; 3],
            &Geometry::with_spacing(low, widths.map(|width| width.max(min_width))),
        )
    }

    /// Draws the view.
    ///
    /// # Errors
    /// Returns [`Error::Job`](crate::Error::Job) if the point of the cut is outside the image, and
    /// [`Error::Image`](crate::Error::Image) if the picture would be too large.
    pub fn draw(&self, caption: &Caption) -> Result<Canvas> {
        let mut frame = BoxFrame::new(&self.space, self.image.map(|image| &image.geometry));
        if let Some(up) = self.up_direction {
            (frame.up_coordinate, frame.down) = (up.axis, !up.is_positive);
        }
        for (ruler, custom) in frame.rulers.iter_mut().zip(&caption.rulers) {
            if let Some(custom) = custom {
                ruler.clone_from(custom);
            }
        }
        let cut_axis = self.cut.coordinate();
        let cut_axis = cut_axis.map(|c| axis_along(&self.space.geometry, c));
        let [azimuth, elevation] = match cut_axis {
            None => CORNER_VIEW_ANGLES,
            Some(axis) => PLANE_VIEW_ANGLES[frame.display_direction(axis)],
        };
        let projection = frame.projection(azimuth, elevation);
        let clip_region = self.clip_region(&projection, cut_axis)?;

        let projected_size = |row: &[f64; 4]| row[..3].iter().map(|c| c.abs()).sum::<f64>();
        let unit = (MAX_BODY_SIZE[0] / projected_size(&projection[0]))
            .min(MAX_BODY_SIZE[1] / projected_size(&projection[1]));
        let size = [0, 1].map(|k| (unit * projected_size(&projection[k])).ceil());
        // Numbers and names of axes are outside the body on all sides.
        let max_label_length =
            (frame.rulers.iter()).fold(0, |max, r| max.max(r.label.chars().count()));
        let left = LEFT_MARGIN.max(0.8 * LETTER_SIZE[0] * max_label_length as f32);
        let mut canvas = blank_canvas(
            size[0] as f32 + left + RIGHT_MARGIN + 40.0,
            size[1] as f32 + TOP_MARGIN + BOTTOM_MARGIN + 50.0,
            caption,
        )?;
        let centre = [
            f64::from(left) + 0.5 * size[0] + 20.0,
            f64::from(TOP_MARGIN) + 0.5 * size[1],
        ];
        let color_map = self
            .image
            .map(|image| ColorMap::from_samples(image.as_slice()));
        let mut color_key = ColorKey::new(color_map, self.paint.as_ref());
        let mut raster = Raster::new(
            canvas.size(),
            projection,
            unit,
            centre,
            color_key.edge_color(),
        );
        match &self.mesh {
            Some(mesh) => {
                color_key.add_mesh();
                let by_whole_cells = self.cut == CutMode::Corner;
                self.draw_mesh(
                    mesh,
                    &clip_region,
                    by_whole_cells,
                    &mut raster,
                    &mut color_key,
                );
            }
            None if self.image.is_some() => {
                self.draw_mesh(
                    &SolidMesh::unit_box(),
                    &clip_region,
                    false,
                    &mut raster,
                    &mut color_key,
                );
            }
            None => {}
        }
        self.draw_shapes(&mut raster, &mut color_key);
        raster.draw_outline();
        raster.copy_to_canvas(&mut canvas);
        for k in 0..3 {
            draw_axis(&mut canvas, &raster, &frame.rulers[k], k);
        }
        color_key.draw_decorations(&mut canvas, caption);
        Ok(canvas)
    }

    /// Returns the part that is cut away for this projection: by planes perpendicular to all axes,
    /// or to one.
    fn clip_region(
        &self,
        projection: &[[f64; 4]; 3],
        cut_axis: Option<usize>,
    ) -> Result<ClipRegion> {
        let dims = self.space.dims();
        if let Some(point) = self.cut_point {
            check_inside(dims.map(|n| n.round() as usize), point)?;
        }
        let fraction = |k: usize| match self.cut_point {
            Some(point) => point[k] / (dims[k] - 1.0),
            None => 0.5,
        };
        let planes = (0..3).filter(|k| cut_axis.is_none_or(|axis| axis == *k));
        Ok(ClipRegion {
            planes: planes
                .map(|axis| ClipPlane {
                    axis,
                    position: fraction(axis),
                    removes_above: projection[2][axis] > 0.0,
                })
                .collect(),
        })
    }

    /// Draws a mesh without the cells whose centres are in the clip region (if `by_whole_cells`),
    /// or cut at the planes of the region.
    fn draw_mesh(
        &self,
        mesh: &SolidMesh,
        clip_region: &ClipRegion,
        by_whole_cells: bool,
        raster: &mut Raster,
        color_key: &mut ColorKey,
    ) {
        let faces = &mesh.faces;
        let value = |cell: u32, node: u32| match &self.paint {
            Some(paint) => paint.value(cell, node),
            None => 0.0,
        };
        let color = |p: [f64; 3], value: f64| {
            let painted = self.paint.as_ref().and_then(|paint| paint.color(value));
            painted.unwrap_or_else(|| self.image_color(p, color_key.color_map.as_ref()))
        };
        let is_shown = |cell: u32| {
            cell != NONE
                && !(by_whole_cells && clip_region.contains(faces.cell_centres[cell as usize]))
        };
        let mut visible_kinds = Vec::new();
        for face in 0..faces.len() {
            let cells = faces.cells[face];
            let are_shown = cells.map(is_shown);
            let kind = mesh.face_kind(face);
            let cell = if are_shown[0] || !are_shown[1] {
                cells[0]
            } else {
                cells[1]
            };
            let corner = |&n: &u32| (faces.nodes[n as usize], value(cell, n));
            let ring: Vec<ValuedPoint> = faces.rings.get(face).iter().map(corner).collect();
            match kind {
                Some(kind) if by_whole_cells => {
                    let fill = color_key.feature_color(kind);
                    raster.draw_polygon(&ring, &|_, _| Some(fill), 1e-4);
                    visible_kinds.push(kind);
                }
                _ if are_shown[0] != are_shown[1] => {
                    let is_kept = |p: [f64; 3]| by_whole_cells || !clip_region.contains(p);
                    raster.draw_polygon(&ring, &|p, v| is_kept(p).then(|| color(p, v)), 0.0);
                }
                _ => {}
            }
        }
        if by_whole_cells {
            visible_kinds
                .into_iter()
                .for_each(|kind| color_key.add_kind(kind, color_key.feature_color(kind)));
            return;
        }
        for (i, plane) in clip_region.planes.iter().enumerate() {
            for (_, ring) in cell_sections(faces, plane.axis, plane.position, &value) {
                let is_kept = |p: [f64; 3]| clip_region.is_on_rim(i, p);
                raster.draw_polygon(&ring, &|p, v| is_kept(p).then(|| color(p, v)), 1e-5);
            }
            for face in 0..faces.len() {
                let Some(kind) = mesh.face_kind(face) else {
                    continue;
                };
                let nodes = faces.rings.get(face).iter();
                let ring: Vec<ValuedPoint> =
                    nodes.map(|&n| (faces.nodes[n as usize], 0.0)).collect();
                if let Some(ends) = shape::cut_polygon(&ring, plane.axis, plane.position) {
                    let color = color_key.trace_color(kind);
                    raster.draw_tube(
                        ends.map(|(p, _)| p),
                        color,
                        LINE_HALF_WIDTHS[0],
                        false,
                        2e-3,
                    );
                    visible_kinds.push(kind);
                }
            }
        }
        visible_kinds
            .into_iter()
            .for_each(|kind| color_key.add_kind(kind, color_key.trace_color(kind)));
    }

    /// Returns the colour of the image at a point of the box.
    fn image_color(&self, p: [f64; 3], color_map: Option<&ColorMap>) -> [u8; 3] {
        let (Some(image), Some(color_map)) = (self.image, color_map) else {
            return DEFAULT_COLOR;
        };
        let dims = image.dims();
        let index = std::array::from_fn(|k| p[k] * (dims[k] - 1) as f64);
        let [r, g, b, _] = color_map.color(image.interpolate_linear(index));
        [r, g, b]
    }

    fn draw_shapes(&self, raster: &mut Raster, color_key: &mut ColorKey) {
        let to_box = |x: [f64; 3]| {
            let position = self.space.to_lattice(x).unwrap_or_default();
            std::array::from_fn(|k| position[k] / self.space.extent[k])
        };
        for (shape, color) in self.shapes.iter().zip(shape::shape_colors(&self.shapes)) {
            for triangle in &shape.triangles {
                let ring = triangle.map(|x| (to_box(x), 0.0));
                raster.draw_polygon(&ring, &|_, _| Some(color), 2e-4);
            }
            for ends in shape.segments() {
                raster.draw_tube(ends.map(to_box), color, LINE_HALF_WIDTHS[1], true, 0.0);
            }
            color_key.add_shape(shape, color);
        }
    }
}
#[cfg(test)]
#[path = "solid_tests.rs"]
mod tests;
