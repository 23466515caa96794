//! The position of a mesh, and the projection of its box.

use serde::Serialize;

use crate::geometry::{dot, to_3d};
use crate::image::Geometry;
use crate::image::geometry::AxisScale;
use crate::store::LatticeSpace;

/// The box of lattice space in physical coordinates and in a picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct BoxFrame {
    /// Physical position of the first corner of the box.
    pub origin: [f64; 3],
    /// Edges of the box in physical coordinates.
    pub edges: [[f64; 3]; 3],
    /// Units of the physical coordinates.
    pub units: [String; 3],
    /// Names of the image's axes.
    pub names: [String; 3],
    /// Number of sample steps along each edge of the box.
    pub samples: [f64; 3],
    /// Scales of the edges: labels and values at both ends.
    pub rulers: [AxisScale; 3],
    /// Factor by which each physical coordinate is enlarged for display, so that lengths in
    /// different units are comparable.
    pub aspect: [f64; 3],
    /// `true` if the last coordinate is drawn downwards.
    pub down: bool,
    /// Coordinate that is drawn vertically: the last one unless another is requested.
    #[serde(skip)]
    pub up_coordinate: usize,
}

impl BoxFrame {
    /// Creates the frame of a mesh's lattice space. The names of axes, and the units if the mesh
    /// has none, are those of `image`, if given.
    pub(crate) fn new<const D: usize>(
        space: &LatticeSpace<D>,
        image: Option<&Geometry<D>>,
    ) -> Self {
        let mut geometry = space.geometry.clone();
        match image {
            Some(image) => {
                geometry.names.clone_from(&image.names);
                if geometry.units.iter().all(String::is_empty) {
                    geometry.units.clone_from(&image.units);
                }
            }
            // Without an image, each axis is named after the coordinate that changes most along it.
            None => {
                let axis_name = |k| ["x", "y", "z"][geometry.main_coordinate(k)].to_string();
                geometry.names = std::array::from_fn(axis_name);
            }
        }
        let samples: [f64; D] = std::array::from_fn(|k| space.extent[k] / space.step[k]);
        let aspect = geometry.display_scale(samples, space.extent);
        let down = geometry.points_down();
        let geometry: Geometry<3> = geometry.to_3d();
        let samples: [f64; 3] = to_3d(samples);
        Self {
            origin: geometry.origin,
            edges: std::array::from_fn(|k| geometry.axes[k].map(|step| step * samples[k])),
            rulers: std::array::from_fn(|k| geometry.axis_scale(k, samples[k])),
            units: geometry.units,
            names: geometry.names,
            samples,
            aspect: std::array::from_fn(|k| aspect.get(k).copied().unwrap_or(1.0)),
            down,
            up_coordinate: 2,
        }
    }

    /// Returns the edges of the box for display: enlarged, and with the vertical coordinate last,
    /// upwards.
    pub(crate) fn display_edges(&self) -> [[f64; 3]; 3] {
        let sign = if self.down { -1.0 } else { 1.0 };
        let order = [
            (self.up_coordinate + 1) % 3,
            (self.up_coordinate + 2) % 3,
            self.up_coordinate,
        ];
        self.edges.map(|edge| {
            let [x, y, z] = order.map(|c| edge[c] * self.aspect[c]);
            [x, y, z * sign]
        })
    }

    /// Returns the main direction of an edge of the box for display: 0 from left to right, 1 away
    /// from the viewer, 2 upwards.
    pub(crate) fn display_direction(&self, edge: usize) -> usize {
        let components = self.display_edges()[edge].map(f64::abs);
        (0..2).fold(2, |best, c| {
            if components[c] > components[best] {
                c
            } else {
                best
            }
        })
    }

    /// Returns the projection for a viewer at these angles (radians). Its rows are the directions
    /// to the right, upwards and towards the viewer, with the origin at the middle of the box. Each
    /// row holds the coefficients of a point of the box, given as fractions in [0, 1] of its three
    /// edges, and a constant.
    pub(crate) fn projection(&self, azimuth: f64, elevation: f64) -> [[f64; 4]; 3] {
        let edges = self.display_edges();
        let ((ss, cs), (sa, ca)) = (azimuth.sin_cos(), elevation.sin_cos());
        let directions = [
            [cs, ss, 0.0],
            [-ss * sa, cs * sa, ca],
            [ss * ca, -cs * ca, sa],
        ];
        directions.map(|direction| {
            let projected = edges.map(|edge| dot(edge, direction));
            let centre_offset = 0.5 * projected.iter().sum::<f64>();
            [projected[0], projected[1], projected[2], -centre_offset]
        })
    }
}
