//! The surface at which the cells above an image end: the ground, or the floor of the sea.

use super::Params;
use super::given_surfaces::FollowedSurface;
use super::padding::vertical_axis;
use crate::error::{Error, Result, cause};
use crate::geometry::bounding_box;
use crate::geometry::box_tree::BoxTree;
use crate::geometry::statistics::lower_quantile;
use crate::image::Geometry;
use crate::image::placing::{Frame, Region};

/// Number of places along each side of the box at which the surface is checked before meshing.
const CHECKED_PLACES: usize = 65;

/// Largest distance of the mesh's top from the surface that is aimed at, relative to the range of heights.
const TOP_TOLERANCE: f64 = 0.03;

/// Share of the checked places whose curvature counts. The others may be edges and errors of the surface.
const CURVATURE_SHARE: f64 = 0.99;

/// Places in a triangle at which its distance from the surface is measured: barycentric coordinates.
const MEASURED_PLACES: [[f64; 3]; 4] = [
    [1.0 / 3.0; 3],
    [0.5, 0.5, 0.0],
    [0.0, 0.5, 0.5],
    [0.5, 0.0, 0.5],
];

/// Largest distance of a point from the triangle that it lies in, relative to the triangle.
const ROUNDING: f64 = 1e-6;

/// A surface above an image, in its lattice space.
pub struct Topography {
    /// The option that names it, for messages.
    option: String,
    geometry: Geometry<3>,
    step: [f64; 3],
    /// The far corner of the image's box.
    extent: [f64; 3],
    /// The vertical axis, and the two others.
    axis: usize,
    plane: [usize; 2],
    /// `true` if the low end of the vertical axis is above.
    is_low_above: bool,
    triangles: Vec<[[f64; 3]; 3]>,
    tree: BoxTree<'static, 2>,
    /// Distances above the image that occur in the box: smallest, mean, largest.
    heights: [f64; 3],
    /// Width of cells with which the mesh's top follows the bends of the surface.
    top_width: f64,
    /// Notes on what was read, assumed and turned in the surfaces.
    notes: Vec<String>,
}

impl Topography {
    /// Creates the topography that the options give for an image; `None` if they give none.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a surface that does not cover the mesh, and one that cuts into the image.
    pub fn new<const D: usize>(
        params: &Params<D>,
        geometry: &Geometry<D>,
        dims: [usize; D],
        step: [f64; D],
        extent: [f64; D],
    ) -> Result<Option<Self>> {
        let surfaces = &params.topography;
        let sides = params.spec.pad.unwrap_or_default().sides;
        let Some(first) = surfaces.first().filter(|_| D == 3) else {
            return Ok(None);
        };
        let frame = params.frame(geometry, dims).in_region(Region::Above);
        let geometry = geometry.to_3d();
        let [step, extent]: [[f64; 3]; 2] =
            [step, extent].map(|v| std::array::from_fn(|k| v.get(k).copied().unwrap_or(1.0)));
        let (axis, is_low_above) = vertical_axis(&geometry);
        let mut topography = Self {
            option: first.option.clone(),
            plane: [[1, 2], [0, 2], [0, 1]][axis],
            geometry,
            step,
            extent,
            axis,
            is_low_above,
            triangles: Vec::new(),
            tree: BoxTree::new(Vec::new(), Vec::new()),
            heights: [0.0; 3],
            top_width: f64::INFINITY,
            notes: Vec::new(),
        };
        topography.set_triangles(surfaces, &frame)?;
        topography.measure(sides)?;
        Ok(Some(topography))
    }

    /// Sets the triangles to those of the surfaces.
    fn set_triangles<const D: usize>(
        &mut self,
        surfaces: &[FollowedSurface],
        frame: &Frame<D>,
    ) -> Result<()> {
        for surface in surfaces {
            let placed = surface.placed(frame)?;
            let (triangles, _) = surface.triangles(&placed.shape, &self.geometry)?;
            self.notes.extend(placed.notes);
            let lattice = |x: [f64; 3]| std::array::from_fn(|k| x[k] * self.step[k]);
            self.triangles
                .extend(triangles.into_iter().map(|t| t.map(lattice)));
        }
        let boxes: Vec<[[f64; 2]; 2]> = (self.triangles.iter())
            .map(|t| bounding_box(t.iter().map(|x| self.plane.map(|k| x[k]))))
            .collect();
        let sets = vec![1; boxes.len()];
        self.tree = BoxTree::new(boxes, sets);
        Ok(())
    }

    /// Measures the heights and bends in the box of the mesh, which reaches `sides` beyond the image.
    fn measure(&mut self, sides: f64) -> Result<()> {
        const N: usize = CHECKED_PLACES;
        let spacing = self.geometry.spacing();
        let margin = self.plane.map(|k| sides / spacing[k] * self.step[k]);
        let length = [0, 1].map(|k| self.extent[self.plane[k]] + 2.0 * margin[k]);
        let steps = length.map(|length| length / (N - 1) as f64);
        let mut heights = Vec::with_capacity(N * N);
        for i in 0..N {
            for j in 0..N {
                let place = [0, 1].map(|k| [i, j][k] as f64 * steps[k] - margin[k]);
                heights.push(self.height_at(place)?);
            }
        }
        let min = heights.iter().copied().fold(f64::INFINITY, f64::min);
        let max = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        self.heights = [min, heights.iter().sum::<f64>() / (N * N) as f64, max];
        let inner = (1..N - 1).flat_map(|i| (1..N - 1).map(move |j| N * i + j));
        let curvature = |n: usize| {
            let along = |stride: usize, step: f64| {
                (heights[n + stride] - 2.0 * heights[n] + heights[n - stride]).abs() / step.powi(2)
            };
            along(N, steps[0]).max(along(1, steps[1]))
        };
        let mut curvatures: Vec<f64> = inner.map(curvature).collect();
        let curvature = lower_quantile(&mut curvatures, CURVATURE_SHARE).unwrap_or(0.0);
        // A chord of length w is at most w^2 / 8 times the curvature from its curve.
        self.top_width = (8.0 * TOP_TOLERANCE * (max - min) / curvature).sqrt();
        if self.top_width.is_nan() {
            self.top_width = f64::INFINITY;
        }
        Ok(())
    }

    /// Returns the distance of a point above the top of the image.
    fn height_of(&self, x: [f64; 3]) -> f64 {
        if self.is_low_above {
            -x[self.axis]
        } else {
            x[self.axis] - self.extent[self.axis]
        }
    }

    /// Returns the coordinate, along the vertical axis, of a point at this distance above the image.
    fn coordinate(&self, height: f64) -> f64 {
        if self.is_low_above {
            -height
        } else {
            self.extent[self.axis] + height
        }
    }

    /// Returns the height of the surface above the top of the image.
    ///
    /// # Errors
    /// Returns [`Error::Job`] where there is no surface, and where it is not above the image.
    fn height_at(&self, place: [f64; 2]) -> Result<f64> {
        let weights = |triangle: usize| {
            let corners = self.triangles[triangle].map(|x| self.plane.map(|k| x[k]));
            barycentric(place, corners).filter(|w| w.iter().all(|w| *w >= -ROUNDING))
        };
        let size = self.extent.iter().copied().fold(0.0, f64::max);
        let limit = (ROUNDING * size).powi(2);
        let square = |triangle: usize| match weights(triangle) {
            Some(_) => 0.0,
            None => f64::INFINITY,
        };
        let found = self.tree.nearest(place, 1, limit, None, square);
        let height = found.and_then(|(triangle, _)| {
            let corners = self.triangles[triangle].map(|x| self.height_of(x));
            let weights = weights(triangle)?;
            Some((0..3).map(|i| weights[i] * corners[i]).sum::<f64>())
        });
        let Some(height) = height else {
            let problem = format!(
                "does not cover the mesh: it has no height at {}",
                self.name(place)
            );
            let remedy = "give a surface that covers the image and its padding on the sides";
            return Err(Error::Job(cause(&self.option, problem, remedy)));
        };
        if height <= 0.0 {
            let problem = format!(
                "cuts into the image at {}, where it is {:.4} below the image's top",
                self.name(place),
                -height * self.length(),
            );
            let remedy = "give a surface above the image, in its coordinates, or crop the image";
            return Err(Error::Job(cause(&self.option, problem, remedy)));
        }
        Ok(height)
    }

    /// Returns the physical coordinates of a place at the top of the image, for messages.
    fn name(&self, place: [f64; 2]) -> String {
        let mut x = [self.coordinate(0.0); 3];
        for (k, value) in self.plane.into_iter().zip(place) {
            x[k] = value;
        }
        let [x, y, _] = self
            .geometry
            .to_physical(std::array::from_fn(|k| x[k] / self.step[k]));
        format!("x {x:.2}, y {y:.2}")
    }

    /// Returns the physical length of a vertical unit of lattice space.
    fn length(&self) -> f64 {
        self.geometry.spacing()[self.axis] / self.step[self.axis]
    }

    /// Returns the mean distance of the surface above the image, in physical units.
    pub fn mean_height(&self) -> f64 {
        self.heights[1] * self.length()
    }

    /// Returns a note on the surface for the report. `above` is the thickness that it replaces.
    pub fn note(&self, above: f64) -> String {
        let [low, _, high] = self.heights.map(|height| height * self.length());
        let mut note = format!("{}: {low:.4} to {high:.4} above the image", self.option);
        if above > 0.0 {
            note += &format!(", which replaces above={above}");
        }
        for text in &self.notes {
            note += &format!(", {text}");
        }
        note
    }

    /// Returns the number of the side of the box that follows the surface.
    pub fn side(&self) -> usize {
        2 * self.axis + usize::from(!self.is_low_above)
    }

    /// Moves the nodes above the image, which end at a flat side at distance `thickness`, so that they end
    /// at the surface: each along its vertical line, in proportion.
    ///
    /// # Errors
    /// Returns [`Error::Job`] where the surface has a hole or cuts into the image.
    pub fn stretch(&self, nodes: &mut [[f64; 3]], thickness: f64) -> Result<()> {
        for x in nodes {
            let flat = self.height_of(*x);
            if flat > 0.0 {
                let fraction = (flat / thickness).min(1.0);
                let height = self.height_at(self.plane.map(|k| x[k]))?;
                x[self.axis] = self.coordinate(fraction * height);
            }
        }
        Ok(())
    }

    /// Returns the largest distance of triangles from the surface, along the vertical axis, in physical units.
    ///
    /// # Errors
    /// Returns [`Error::Job`] where the surface has a hole or cuts into the image.
    pub fn deviation(&self, triangles: impl Iterator<Item = [[f64; 3]; 3]>) -> Result<f64> {
        let mut max: f64 = 0.0;
        for triangle in triangles {
            for weights in MEASURED_PLACES {
                let point: [f64; 3] =
                    std::array::from_fn(|k| (0..3).map(|i| weights[i] * triangle[i][k]).sum());
                let height = self.height_at(self.plane.map(|k| point[k]))?;
                max = max.max((self.height_of(point) - height).abs());
            }
        }
        Ok(max * self.length())
    }

    /// Returns the width of cells with which the mesh's top follows the bends of the surface.
    pub fn top_width(&self) -> f64 {
        self.top_width
    }

    /// Returns the error of a cell that is flat or inverted, of which `x` is a node.
    pub fn steepness_error(&self, x: [f64; 3], count: usize) -> Error {
        let place = self.name(self.plane.map(|k| x[k]));
        let problem = format!("is too steep for the cells at {place}: {count} turn inside out");
        let remedy = "give a smoother surface, or one farther above the image";
        Error::Job(cause(&self.option, problem, remedy))
    }
}

/// Returns the barycentric coordinates of a point; `None` for a triangle without area.
fn barycentric(p: [f64; 2], [a, b, c]: [[f64; 2]; 3]) -> Option<[f64; 3]> {
    let cross = |o: [f64; 2], p: [f64; 2], q: [f64; 2]| {
        (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0])
    };
    let area = cross(a, b, c);
    let [u, v] = [cross(p, b, c) / area, cross(a, p, c) / area];
    (area != 0.0).then_some([u, v, 1.0 - u - v])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::job::spec::NominalDistance;
    use crate::job::{MeshSpec, Outcome, Params, run};
    use crate::mesh::check::{CheckHints, check_with_hints};
    use crate::mesh::complex::{NONE, neighbours};
    use crate::mesh::{FACES, TetMesh};
    use crate::progress::NoProgress;
    use crate::surface_file::interpretation::{PickedShape, PickedSurface};
    use std::f64::consts::TAU;

    /// Number of padded samples on each side of the image.
    const SIDES: f64 = 20.0;

    /// Returns a surface at z = `sign` * `height`(x, y) on a grid that reaches `margin` beyond the image.
    fn grid(margin: f64, sign: f64, height: impl Fn(f64, f64) -> f64) -> FollowedSurface {
        let count = 80;
        let width = (35.0 + 2.0 * margin) / f64::from(count);
        let node = |i: i32, j: i32| {
            let [x, y] = [i, j].map(|i| f64::from(i) * width - margin);
            [x, y, sign * height(x, y)]
        };
        let cells = (0..count).flat_map(|i| (0..count).map(move |j| (i, j)));
        let triangles = cells.flat_map(|(i, j)| {
            let [a, b, c, d] = [
                node(i, j),
                node(i + 1, j),
                node(i + 1, j + 1),
                node(i, j + 1),
            ];
            [[a, b, c], [a, c, d]]
        });
        FollowedSurface {
            option: "topography ground.irap".into(),
            duplicates: Vec::new(),
            coordinates: Default::default(),
            surface: PickedSurface {
                name: "ground".into(),
                is_horizon: Some(true),
                shape: PickedShape::Triangles(triangles.collect()),
                coordinates: Default::default(),
                notes: Vec::new(),
            },
        }
    }

    /// Meshes an image of samples without units, whose z increases downwards.
    fn outcome(padding: &str, surface: FollowedSurface) -> Result<Outcome> {
        let surfaces = [ExactSurface::plane([1.0, 0.4, 0.2], [16.0; 3])];
        let image = ridge_image([36, 34, 32], &surfaces, 1.5, 0.1);
        let spec = MeshSpec {
            distance: NominalDistance::Range { min: 4.0, max: 7.0 },
            pad: Some(padding.parse().unwrap()),
            ..MeshSpec::default()
        };
        let params = Params {
            topography: vec![surface],
            ..Params::new(spec)?
        };
        run(&image, &params, &mut NoProgress)
    }

    /// Checks the mesh, and returns the nodes at its top, the volume of the overburden and the smallest angle.
    fn checked_top(outcome: &Outcome) -> (Vec<[f64; 3]>, f64, f64) {
        let padding = outcome.padding.as_ref().unwrap();
        let mesh = &outcome.simplices().unwrap().mesh;
        let added = padding.connectivity.as_chunks::<4>().0;
        let whole = TetMesh {
            nodes: [&mesh.nodes[..], &padding.nodes].concat(),
            tets: [&mesh.tets[..], added].concat(),
        };
        let hints = CheckHints {
            bent_side: padding.bent_side,
            ..CheckHints::default()
        };
        let (low, high) = (padding.low, padding.high);
        let check = check_with_hints(&whole, hints, low, high, 1e-9);
        assert!(check.passed(), "{check:?}");
        // A hole is found.
        let mut with_hole = whole.clone();
        with_hole.tets.remove(mesh.tets.len() / 2);
        assert!(!check_with_hints(&with_hole, hints, low, high, 1e-9).passed());
        let neighbours = neighbours(whole.nodes.len(), &whole.tets).unwrap();
        let faces = whole
            .tets
            .iter()
            .zip(&neighbours)
            .flat_map(|(tet, around)| {
                let open = (0..4).filter(|&k| around[k] == NONE);
                open.map(|k| FACES[k].map(|i| whole.nodes[tet[i] as usize]))
            });
        let is_flat = |face: &[[f64; 3]; 3]| {
            let is_in = |k: usize, plane: f64| face.iter().all(|x| x[k] == plane);
            (0..2).any(|k| is_in(k, low[k]) || is_in(k, high[k])) || is_in(2, high[2])
        };
        let top: Vec<[f64; 3]> = faces.filter(|face| !is_flat(face)).flatten().collect();
        assert!(top.len() > 100);
        let report = outcome.report.padding.as_ref().unwrap();
        assert_eq!(report.regions[0].name, "overburden");
        (top, report.regions[0].volume, report.smallest_angle.worst)
    }

    #[test]
    fn the_overburden_ends_exactly_at_an_inclined_plane() {
        let height = |x: f64, y: f64| 40.0 + 0.3 * x - 0.2 * y;
        // The sign of z is turned where heights increase upwards.
        for sign in [-1.0, 1.0] {
            let outcome = outcome("below=15,sides=20", grid(20.0, sign, height)).unwrap();
            let (top, volume, angle) = checked_top(&outcome);
            let report = outcome.report.padding.as_ref().unwrap();
            assert!(report.topography_deviation.unwrap() < 1e-6);
            for x in top {
                assert!((x[2] + height(x[0], x[1])).abs() < 1e-6, "{x:?}");
            }
            let area = (35.0 + 2.0 * SIDES) * (33.0 + 2.0 * SIDES);
            let expected = area * height(17.5, 16.5);
            assert!(
                (volume / expected - 1.0).abs() < 1e-9,
                "{volume} {expected}"
            );
            assert!(angle > 12.0, "{angle}");
            let note = outcome.report.notes.last().unwrap();
            assert!(note.starts_with("topography ground.irap: 2"), "{note}");
            assert_eq!(note.contains("with the sign of z turned"), sign > 0.0);
        }
    }

    #[test]
    fn the_volume_below_a_sine_surface_is_analytic() {
        let (length, amplitude) = (50.0, 6.0);
        let height = |x: f64, _: f64| 35.0 + amplitude * (TAU * x / length).sin();
        let outcome = outcome("above=99,sides=20", grid(20.0, -1.0, height)).unwrap();
        let (top, volume, angle) = checked_top(&outcome);
        let report = outcome.report.padding.as_ref().unwrap();
        let deviation = report.topography_deviation.unwrap();
        assert!((0.01..1.5).contains(&deviation), "{deviation}");
        for x in top {
            // The surface is a grid of triangles.
            assert!((x[2] + height(x[0], x[1])).abs() < 0.02, "{x:?}");
        }
        let integral = |x: f64| 35.0 * x - amplitude * length / TAU * (TAU * x / length).cos();
        let width = 33.0 + 2.0 * SIDES;
        let expected = width * (integral(35.0 + SIDES) - integral(-SIDES));
        assert!(
            (volume / expected - 1.0).abs() < 0.01,
            "{volume} {expected}"
        );
        assert!(angle > 12.0, "{angle}");
        let note = outcome.report.notes.last().unwrap();
        assert!(note.contains("which replaces above=99"), "{note}");
    }

    #[test]
    fn surfaces_that_do_not_fit_are_refused_with_the_place() {
        for (surface, expected) in [
            (
                grid(10.0, -1.0, |_, _| 40.0),
                "does not cover the mesh: it has no height at x -20.00, y -20.00; ",
            ),
            (
                // The first of the checked places, 75/64 samples apart, at which x > 30.
                grid(20.0, -1.0, |x, _| 30.0 - x),
                "cuts into the image at x 30.39, y -20.00, where it is 0.3906 below the image's top; ",
            ),
        ] {
            let error = outcome("sides=20", surface).unwrap_err().to_string();
            let expected = format!("topography ground.irap: {expected}");
            assert!(error.starts_with(&expected), "{error}");
            assert_eq!(error.lines().count(), 1);
        }
        let error = outcome("sides=20", grid(20.0, -1.0, |_, _| 5.0)).unwrap_err();
        assert!(
            error
                .to_string()
                .starts_with("pad (overburden): is 5.0000 samples thick")
        );
    }
}
