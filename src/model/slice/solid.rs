//! What stands in a box, seen from outside: a mesh or an image with a part taken away, surfaces, lines.

use super::axes::axis;
use super::canvas::{Canvas, LETTER};
use super::faces::Faces;
use super::frame::Frame;
use super::furniture::{ABOVE, BELOW, Caption, LEFT, RIGHT};
use super::marks::Marks;
use super::opening::{Opening, sections};
use super::paint::Paint;
use super::raster::{Corner, Raster};
use super::shades::Shades;
use super::shape::{self, Shape};
use super::{Upward, axis_along, blank, check_inside};
use crate::Result;
use crate::image::{Geometry, Image};
use crate::mesh::complex::NONE;
use crate::mesh::poly::Lists;
use crate::model::surface::Kind;
use crate::model::surface::stored::numbered_by_bends;
use crate::store::stored::bounds;
use crate::store::{LatticeSpace, Stored, StoredMesh};

/// From which side and from how far above, in radians: onto a corner, and onto a plane across what runs
/// from left to right, away from whoever looks, and upwards.
const ONTO_CORNER: [f64; 2] = [0.55, 0.42];
const ONTO_PLANE: [[f64; 2]; 3] = [[1.15, 0.36], [0.42, 0.36], [0.42, 0.9]];
/// Width and height of the body, in pixels, at most.
const SIZE: [f64; 2] = [1050.0, 850.0];
/// Of cells and surfaces without a colour of their own.
const PLAIN: [u8; 3] = [222, 228, 235];
/// Half the width of lines on a plane, and of lines in space, in pixels.
const THICK: [f64; 2] = [1.9, 1.4];

/// What is taken away of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Cut {
    /// The corner nearest to whoever looks; of a mesh whole cells, so that surfaces stand out of what is left.
    #[default]
    Corner,
    /// All in front of a plane across this physical coordinate.
    Plane(usize),
}

/// A mesh in space, ready to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    faces: Faces,
    /// Of each surface on which faces lie.
    kinds: Vec<Kind>,
}

impl Body {
    /// Of a mesh.
    ///
    /// # Errors
    /// [`Error::Mesh`](crate::Error::Mesh) if more than two cells share a face.
    pub fn of<M: Stored<3>>(stored: &StoredMesh<3, M>) -> Result<Self> {
        let surfaces = stored
            .marks()
            .map(|marks| numbered_by_bends(stored, &marks));
        let surfaces = surfaces.unwrap_or_default();
        Ok(Self {
            faces: Faces::of(stored, &surfaces.facets)?,
            kinds: surfaces.kinds,
        })
    }

    /// The box itself, as one cell.
    fn of_box() -> Self {
        let nodes = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from));
        let mut rings = Lists::default();
        for [a, b, c] in [[1, 2, 4], [2, 4, 1], [4, 1, 2]] {
            for side in [0, c] {
                rings.push([side, side + a, side + a + b, side + b]);
            }
        }
        Self {
            faces: Faces {
                nodes: nodes.collect(),
                cells: vec![[0, NONE]; rings.len()],
                surfaces: vec![0; rings.len()],
                rings,
                lines: Vec::new(),
                middles: vec![[0.5; 3]],
            },
            kinds: Vec::new(),
        }
    }

    /// The kind of surface on which a face lies, if it lies on one.
    fn kind(&self, face: usize) -> Option<Kind> {
        let surface = (self.faces.surfaces[face] as usize).checked_sub(1)?;
        self.kinds.get(surface).copied()
    }
}

/// What is drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid<'a> {
    /// The box.
    pub space: LatticeSpace<3>,
    /// The image in it.
    pub image: Option<&'a Image<3>>,
    /// The mesh in it.
    pub mesh: Option<Body>,
    /// What the mesh is painted with instead of the image.
    pub paint: Option<Paint>,
    /// Surfaces and lines in it, in physical coordinates.
    pub shapes: Vec<Shape>,
    /// Which way is up; as the image and the mesh have it if not given.
    pub up: Option<Upward>,
    /// What is taken away.
    pub cut: Cut,
    /// Where, in samples; in the middle if not given.
    pub at: Option<[f64; 3]>,
}

impl Solid<'_> {
    /// The box of an image.
    pub fn space_of(dims: [usize; 3], geometry: &Geometry<3>) -> LatticeSpace<3> {
        LatticeSpace {
            extent: dims.map(|n| (n.max(2) - 1) as f64),
            step: [1.0; 3],
            geometry: geometry.clone(),
            by_file: true,
            velocities: None,
        }
    }

    /// The box around shapes, of any size even if they are flat.
    pub fn space_around(shapes: &[Shape]) -> LatticeSpace<3> {
        let points: Vec<[f64; 3]> = shapes.iter().flat_map(Shape::points).collect();
        let (low, high) = bounds(&points);
        let widths: [f64; 3] = std::array::from_fn(|k| high[k] - low[k]);
        let least = 1e-3 * widths.iter().copied().fold(1e-9, f64::max);
        Self::space_of(
            [2; 3],
            &Geometry::with_spacing(low, widths.map(|width| width.max(least))),
        )
    }

    /// Draws it.
    ///
    /// # Errors
    /// [`Error::Job`](crate::Error::Job) if it is cut outside of the image.
    pub fn draw(&self, caption: &Caption) -> Result<Canvas> {
        let mut frame = Frame::of(&self.space, self.image.map(|image| &image.geometry));
        if let Some(up) = self.up {
            (frame.up, frame.down) = (up.coordinate, up.down);
        }
        for (ruler, own) in frame.rulers.iter_mut().zip(&caption.rulers) {
            if let Some(own) = own {
                ruler.clone_from(own);
            }
        }
        let across = match self.cut {
            Cut::Corner => None,
            Cut::Plane(coordinate) => Some(axis_along(&self.space.geometry, coordinate)),
        };
        let [side, above] = match across {
            None => ONTO_CORNER,
            Some(axis) => ONTO_PLANE[frame.drawn_along(axis)],
        };
        let rows = frame.seen_from(side, above);
        let opening = self.opening(&rows, across)?;

        let wide = |row: &[f64; 4]| row[..3].iter().map(|c| c.abs()).sum::<f64>();
        let unit = (SIZE[0] / wide(&rows[0])).min(SIZE[1] / wide(&rows[1]));
        let size = [0, 1].map(|k| (unit * wide(&rows[k])).ceil());
        // Numbers and names of axes stand outside of the body on all sides.
        let longest = (frame.rulers.iter()).fold(0, |most, r| most.max(r.label.chars().count()));
        let left = LEFT.max(0.8 * LETTER[0] * longest as f32);
        let mut canvas = blank(
            size[0] as f32 + left + RIGHT + 40.0,
            size[1] as f32 + ABOVE + BELOW + 50.0,
            caption,
        )?;
        let middle = [
            f64::from(left) + 0.5 * size[0] + 20.0,
            f64::from(ABOVE) + 0.5 * size[1],
        ];
        let shades = self.image.map(|image| Shades::of(image.as_slice()));
        let mut marks = Marks::new(shades, self.paint.as_ref());
        let mut raster = Raster::new(canvas.size(), rows, unit, middle, marks.edges());
        match &self.mesh {
            Some(body) => {
                marks.saw_mesh();
                let whole = self.cut == Cut::Corner;
                self.body(body, &opening, whole, &mut raster, &mut marks);
            }
            None if self.image.is_some() => {
                self.body(&Body::of_box(), &opening, false, &mut raster, &mut marks);
            }
            None => {}
        }
        self.shapes(&mut raster, &mut marks);
        raster.outline();
        raster.put_on(&mut canvas);
        for k in 0..3 {
            axis(&mut canvas, &raster, &frame.rulers[k], k);
        }
        marks.put_on(&mut canvas, caption);
        Ok(canvas)
    }

    /// What is taken away, seen from a side: across all axes, or across one.
    fn opening(&self, rows: &[[f64; 4]; 3], across: Option<usize>) -> Result<Opening> {
        let dims = self.space.dims();
        if let Some(at) = self.at {
            check_inside(dims.map(|n| n.round() as usize), at)?;
        }
        let share = |k: usize| match self.at {
            Some(at) => at[k] / (dims[k] - 1.0),
            None => 0.5,
        };
        let planes = (0..3).filter(|k| across.is_none_or(|axis| axis == *k));
        Ok(Opening {
            planes: planes.map(|k| (k, share(k), rows[2][k] > 0.0)).collect(),
        })
    }

    /// Draws a mesh without its `whole` cells in the opening, or cut at the planes of it.
    fn body(
        &self,
        body: &Body,
        opening: &Opening,
        whole: bool,
        raster: &mut Raster,
        marks: &mut Marks,
    ) {
        let faces = &body.faces;
        let value = |cell: u32, node: u32| match &self.paint {
            Some(paint) => paint.value(cell, node),
            None => 0.0,
        };
        let color = |p: [f64; 3], value: f64| {
            let painted = self.paint.as_ref().and_then(|paint| paint.color(value));
            painted.unwrap_or_else(|| self.sample(p, marks.shades.as_ref()))
        };
        let shown =
            |cell: u32| cell != NONE && !(whole && opening.takes(faces.middles[cell as usize]));
        let mut seen = Vec::new();
        for face in 0..faces.len() {
            let cells = faces.cells[face];
            let inside = cells.map(shown);
            let kind = body.kind(face);
            let of = if inside[0] || !inside[1] {
                cells[0]
            } else {
                cells[1]
            };
            let corner = |&n: &u32| (faces.nodes[n as usize], value(of, n));
            let ring: Vec<Corner> = faces.rings.get(face).iter().map(corner).collect();
            match kind {
                Some(kind) if whole => {
                    let fill = marks.feature(kind);
                    raster.polygon(&ring, &|_, _| Some(fill), 1e-4);
                    seen.push(kind);
                }
                _ if inside[0] != inside[1] => {
                    let kept = |p: [f64; 3]| whole || !opening.takes(p);
                    raster.polygon(&ring, &|p, v| kept(p).then(|| color(p, v)), 0.0);
                }
                _ => {}
            }
        }
        if whole {
            seen.into_iter()
                .for_each(|kind| marks.saw(kind, marks.feature(kind)));
            return;
        }
        for (i, &(k, at, _)) in opening.planes.iter().enumerate() {
            for (_, ring) in sections(faces, k, at, &value) {
                let kept = |p: [f64; 3]| opening.shows(i, p);
                raster.polygon(&ring, &|p, v| kept(p).then(|| color(p, v)), 1e-5);
            }
            for face in 0..faces.len() {
                let Some(kind) = body.kind(face) else {
                    continue;
                };
                let nodes = faces.rings.get(face).iter();
                let ring: Vec<Corner> = nodes.map(|&n| (faces.nodes[n as usize], 0.0)).collect();
                if let Some(ends) = shape::cut(&ring, k, at) {
                    let color = marks.trace(kind);
                    raster.tube(ends.map(|(p, _)| p), color, THICK[0], false, 2e-3);
                    seen.push(kind);
                }
            }
        }
        seen.into_iter()
            .for_each(|kind| marks.saw(kind, marks.trace(kind)));
    }

    /// The colour of the image at a point of the box.
    fn sample(&self, p: [f64; 3], shades: Option<&Shades>) -> [u8; 3] {
        let (Some(image), Some(shades)) = (self.image, shades) else {
            return PLAIN;
        };
        let dims = image.dims();
        let index = std::array::from_fn(|k| p[k] * (dims[k] - 1) as f64);
        let [r, g, b, _] = shades.color(image.linear(index));
        [r, g, b]
    }

    fn shapes(&self, raster: &mut Raster, marks: &mut Marks) {
        let place = |x: [f64; 3]| {
            let at = self.space.to_lattice(x).unwrap_or_default();
            std::array::from_fn(|k| at[k] / self.space.extent[k])
        };
        for (shape, color) in self.shapes.iter().zip(shape::colors(&self.shapes)) {
            for triangle in &shape.triangles {
                let ring = triangle.map(|x| (place(x), 0.0));
                raster.polygon(&ring, &|_, _| Some(color), 2e-4);
            }
            for ends in shape.segments() {
                raster.tube(ends.map(place), color, THICK[1], true, 0.0);
            }
            marks.saw_shape(shape, color);
        }
    }
}
#[cfg(test)]
#[path = "solid_tests.rs"]
mod tests;
