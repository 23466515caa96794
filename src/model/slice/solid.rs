//! What stands in a box, seen from outside: a mesh or an image with a part taken away, surfaces, lines.

use super::axes::draw_axis;
use super::canvas::{Canvas, LETTER_SIZE};
use super::clipping::{ClipRegion, cell_sections};
use super::color_key::ColorKey;
use super::color_map::ColorMap;
use super::decorations::{BOTTOM_MARGIN, Caption, LEFT_MARGIN, RIGHT_MARGIN, TOP_MARGIN};
use super::faces::DrawableFaces;
use super::frame::BoxFrame;
use super::paint::Paint;
use super::raster::{Raster, ValuedPoint};
use super::shape::{self, OverlayShape};
use super::{UpDirection, axis_along, blank_canvas, check_inside};
use crate::Result;
use crate::image::{Geometry, Image};
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;
use crate::model::surface::SurfaceKind;
use crate::model::surface::stored_surfaces::surfaces_by_bend;
use crate::store::stored_mesh::bounding_box;
use crate::store::{LatticeSpace, Storable, StoredMesh};

/// From which side and from how far above, in radians: onto a corner, and onto a plane across what runs
/// from left to right, away from whoever looks, and upwards.
const CORNER_VIEW_ANGLES: [f64; 2] = [0.55, 0.42];
const PLANE_VIEW_ANGLES: [[f64; 2]; 3] = [[1.15, 0.36], [0.42, 0.36], [0.42, 0.9]];
/// Width and height of the body, in pixels, at most.
const MAX_BODY_SIZE: [f64; 2] = [1050.0, 850.0];
/// Of cells and surfaces without a colour of their own.
const DEFAULT_COLOR: [u8; 3] = [222, 228, 235];
/// Half the width of lines on a plane, and of lines in space, in pixels.
const LINE_HALF_WIDTHS: [f64; 2] = [1.9, 1.4];

/// What is taken away of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CutMode {
    /// The corner nearest to whoever looks; of a mesh whole cells, so that surfaces stand out of what is left.
    #[default]
    Corner,
    /// All in front of a plane across this physical coordinate.
    Plane(usize),
}

/// A mesh in space, ready to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SolidMesh {
    faces: DrawableFaces,
    /// Of each surface on which faces lie.
    kinds: Vec<SurfaceKind>,
}

impl SolidMesh {
    /// Of a mesh.
    ///
    /// # Errors
    /// [`Error::Mesh`](crate::Error::Mesh) if more than two cells share a face.
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

    /// The box itself, as one cell.
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

    /// The kind of surface on which a face lies, if it lies on one.
    fn face_kind(&self, face: usize) -> Option<SurfaceKind> {
        let surface = (self.faces.surfaces[face] as usize).checked_sub(1)?;
        self.kinds.get(surface).copied()
    }
}

/// What is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct SolidView<'a> {
    /// The box.
    pub space: LatticeSpace<3>,
    /// The image in it.
    pub image: Option<&'a Image<3>>,
    /// The mesh in it.
    pub mesh: Option<SolidMesh>,
    /// What the mesh is painted with instead of the image.
    pub paint: Option<Paint>,
    /// Surfaces and lines in it, in physical coordinates.
    pub shapes: Vec<OverlayShape>,
    /// Which way is up; as the image and the mesh have it if not given.
    pub up_direction: Option<UpDirection>,
    /// What is taken away.
    pub cut: CutMode,
    /// Where, in samples; in the middle if not given.
    pub cut_point: Option<[f64; 3]>,
}

impl SolidView<'_> {
    /// The box of an image.
    pub fn image_space(dims: [usize; 3], geometry: &Geometry<3>) -> LatticeSpace<3> {
        LatticeSpace {
            extent: dims.map(|n| (n.max(2) - 1) as f64),
            step: [1.0; 3],
            geometry: geometry.clone(),
            is_stored: true,
            velocities: None,
        }
    }

    /// The box around shapes, of any size even if they are flat.
    pub fn bounding_space(shapes: &[OverlayShape]) -> LatticeSpace<3> {
        let points: Vec<[f64; 3]> = shapes.iter().flat_map(OverlayShape::points).collect();
        let (low, high) = bounding_box(&points);
        let widths: [f64; 3] = std::array::from_fn(|k| high[k] - low[k]);
        let least = 1e-3 * widths.iter().copied().fold(1e-9, f64::max);
        Self::image_space(
            [2; 3],
            &Geometry::with_spacing(low, widths.map(|width| width.max(least))),
        )
    }

    /// Draws it.
    ///
    /// # Errors
    /// [`Error::Job`](crate::Error::Job) if it is cut outside of the image.
    pub fn draw(&self, caption: &Caption) -> Result<Canvas> {
        let mut frame = BoxFrame::new(&self.space, self.image.map(|image| &image.geometry));
        if let Some(up) = self.up_direction {
            (frame.up_coordinate, frame.down) = (up.coordinate, up.points_down);
        }
        for (ruler, own) in frame.rulers.iter_mut().zip(&caption.rulers) {
            if let Some(own) = own {
                ruler.clone_from(own);
            }
        }
        let across = match self.cut {
            CutMode::Corner => None,
            CutMode::Plane(coordinate) => Some(axis_along(&self.space.geometry, coordinate)),
        };
        let [side, above] = match across {
            None => CORNER_VIEW_ANGLES,
            Some(axis) => PLANE_VIEW_ANGLES[frame.display_direction(axis)],
        };
        let rows = frame.projection(side, above);
        let opening = self.clip_region(&rows, across)?;

        let wide = |row: &[f64; 4]| row[..3].iter().map(|c| c.abs()).sum::<f64>();
        let unit = (MAX_BODY_SIZE[0] / wide(&rows[0])).min(MAX_BODY_SIZE[1] / wide(&rows[1]));
        let size = [0, 1].map(|k| (unit * wide(&rows[k])).ceil());
        // Numbers and names of axes stand outside of the body on all sides.
        let longest = (frame.rulers.iter()).fold(0, |most, r| most.max(r.label.chars().count()));
        let left = LEFT_MARGIN.max(0.8 * LETTER_SIZE[0] * longest as f32);
        let mut canvas = blank_canvas(
            size[0] as f32 + left + RIGHT_MARGIN + 40.0,
            size[1] as f32 + TOP_MARGIN + BOTTOM_MARGIN + 50.0,
            caption,
        )?;
        let middle = [
            f64::from(left) + 0.5 * size[0] + 20.0,
            f64::from(TOP_MARGIN) + 0.5 * size[1],
        ];
        let shades = self
            .image
            .map(|image| ColorMap::from_samples(image.as_slice()));
        let mut marks = ColorKey::new(shades, self.paint.as_ref());
        let mut raster = Raster::new(canvas.size(), rows, unit, middle, marks.edge_color());
        match &self.mesh {
            Some(body) => {
                marks.add_mesh();
                let whole = self.cut == CutMode::Corner;
                self.draw_mesh(body, &opening, whole, &mut raster, &mut marks);
            }
            None if self.image.is_some() => {
                self.draw_mesh(
                    &SolidMesh::unit_box(),
                    &opening,
                    false,
                    &mut raster,
                    &mut marks,
                );
            }
            None => {}
        }
        self.draw_shapes(&mut raster, &mut marks);
        raster.draw_outline();
        raster.copy_to_canvas(&mut canvas);
        for k in 0..3 {
            draw_axis(&mut canvas, &raster, &frame.rulers[k], k);
        }
        marks.draw_decorations(&mut canvas, caption);
        Ok(canvas)
    }

    /// What is taken away, seen from a side: across all axes, or across one.
    fn clip_region(&self, rows: &[[f64; 4]; 3], across: Option<usize>) -> Result<ClipRegion> {
        let dims = self.space.dims();
        if let Some(at) = self.cut_point {
            check_inside(dims.map(|n| n.round() as usize), at)?;
        }
        let share = |k: usize| match self.cut_point {
            Some(at) => at[k] / (dims[k] - 1.0),
            None => 0.5,
        };
        let planes = (0..3).filter(|k| across.is_none_or(|axis| axis == *k));
        Ok(ClipRegion {
            planes: planes.map(|k| (k, share(k), rows[2][k] > 0.0)).collect(),
        })
    }

    /// Draws a mesh without its `whole` cells in the opening, or cut at the planes of it.
    fn draw_mesh(
        &self,
        body: &SolidMesh,
        opening: &ClipRegion,
        whole: bool,
        raster: &mut Raster,
        marks: &mut ColorKey,
    ) {
        let faces = &body.faces;
        let value = |cell: u32, node: u32| match &self.paint {
            Some(paint) => paint.value(cell, node),
            None => 0.0,
        };
        let color = |p: [f64; 3], value: f64| {
            let painted = self.paint.as_ref().and_then(|paint| paint.color(value));
            painted.unwrap_or_else(|| self.image_color(p, marks.color_map.as_ref()))
        };
        let shown = |cell: u32| {
            cell != NONE && !(whole && opening.contains(faces.cell_centres[cell as usize]))
        };
        let mut seen = Vec::new();
        for face in 0..faces.len() {
            let cells = faces.cells[face];
            let inside = cells.map(shown);
            let kind = body.face_kind(face);
            let of = if inside[0] || !inside[1] {
                cells[0]
            } else {
                cells[1]
            };
            let corner = |&n: &u32| (faces.nodes[n as usize], value(of, n));
            let ring: Vec<ValuedPoint> = faces.rings.get(face).iter().map(corner).collect();
            match kind {
                Some(kind) if whole => {
                    let fill = marks.feature_color(kind);
                    raster.draw_polygon(&ring, &|_, _| Some(fill), 1e-4);
                    seen.push(kind);
                }
                _ if inside[0] != inside[1] => {
                    let kept = |p: [f64; 3]| whole || !opening.contains(p);
                    raster.draw_polygon(&ring, &|p, v| kept(p).then(|| color(p, v)), 0.0);
                }
                _ => {}
            }
        }
        if whole {
            seen.into_iter()
                .for_each(|kind| marks.add_kind(kind, marks.feature_color(kind)));
            return;
        }
        for (i, &(k, at, _)) in opening.planes.iter().enumerate() {
            for (_, ring) in cell_sections(faces, k, at, &value) {
                let kept = |p: [f64; 3]| opening.is_on_rim(i, p);
                raster.draw_polygon(&ring, &|p, v| kept(p).then(|| color(p, v)), 1e-5);
            }
            for face in 0..faces.len() {
                let Some(kind) = body.face_kind(face) else {
                    continue;
                };
                let nodes = faces.rings.get(face).iter();
                let ring: Vec<ValuedPoint> =
                    nodes.map(|&n| (faces.nodes[n as usize], 0.0)).collect();
                if let Some(ends) = shape::cut_polygon(&ring, k, at) {
                    let color = marks.trace_color(kind);
                    raster.draw_tube(
                        ends.map(|(p, _)| p),
                        color,
                        LINE_HALF_WIDTHS[0],
                        false,
                        2e-3,
                    );
                    seen.push(kind);
                }
            }
        }
        seen.into_iter()
            .for_each(|kind| marks.add_kind(kind, marks.trace_color(kind)));
    }

    /// The colour of the image at a point of the box.
    fn image_color(&self, p: [f64; 3], shades: Option<&ColorMap>) -> [u8; 3] {
        let (Some(image), Some(shades)) = (self.image, shades) else {
            return DEFAULT_COLOR;
        };
        let dims = image.dims();
        let index = std::array::from_fn(|k| p[k] * (dims[k] - 1) as f64);
        let [r, g, b, _] = shades.color(image.interpolate_linear(index));
        [r, g, b]
    }

    fn draw_shapes(&self, raster: &mut Raster, marks: &mut ColorKey) {
        let place = |x: [f64; 3]| {
            let at = self.space.to_lattice(x).unwrap_or_default();
            std::array::from_fn(|k| at[k] / self.space.extent[k])
        };
        for (shape, color) in self.shapes.iter().zip(shape::shape_colors(&self.shapes)) {
            for triangle in &shape.triangles {
                let ring = triangle.map(|x| (place(x), 0.0));
                raster.draw_polygon(&ring, &|_, _| Some(color), 2e-4);
            }
            for ends in shape.segments() {
                raster.draw_tube(ends.map(place), color, LINE_HALF_WIDTHS[1], true, 0.0);
            }
            marks.add_shape(shape, color);
        }
    }
}
#[cfg(test)]
#[path = "solid_tests.rs"]
mod tests;
