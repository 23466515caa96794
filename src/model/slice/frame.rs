//! Where a mesh lies, and how its box is drawn.

use serde::Serialize;

use crate::geometry::{dot, to_3d};
use crate::image::Geometry;
use crate::image::geometry::AxisScale;
use crate::store::LatticeSpace;

/// The box of lattice space in the world and in a picture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct BoxFrame {
    /// Where the box begins in the world.
    pub origin: [f64; 3],
    /// Its edges in the world.
    pub edges: [[f64; 3]; 3],
    /// The units of the world's coordinates.
    pub units: [String; 3],
    /// The names of the image's axes.
    pub names: [String; 3],
    /// How many steps of samples the box is wide.
    pub samples: [f64; 3],
    /// How the edges are read off.
    pub rulers: [AxisScale; 3],
    /// By how much each coordinate of the world is enlarged, so that lengths of unlike units are
    /// comparable.
    pub aspect: [f64; 3],
    /// Whether the last coordinate is drawn downwards.
    pub down: bool,
    /// The coordinate that is drawn upright: the last one, unless another is asked for.
    #[serde(skip)]
    pub up_coordinate: usize,
}

impl BoxFrame {
    /// Of a mesh's space; names, and units if the mesh has none, are those of the image if there is one.
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
            // The coordinate that is read off along each axis.
            None => {
                let along = |k| ["x", "y", "z"][geometry.main_coordinate(k)].to_string();
                geometry.names = std::array::from_fn(along);
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

    /// The edges of the box as they are drawn: enlarged, and upright.
    pub(crate) fn display_edges(&self) -> [[f64; 3]; 3] {
        let turned = if self.down { -1.0 } else { 1.0 };
        let order = [
            (self.up_coordinate + 1) % 3,
            (self.up_coordinate + 2) % 3,
            self.up_coordinate,
        ];
        self.edges.map(|edge| {
            let [x, y, z] = order.map(|c| edge[c] * self.aspect[c]);
            [x, y, z * turned]
        })
    }

    /// How an edge of the box is drawn, mostly: 0 from left to right, 1 away from whoever looks, 2 upwards.
    pub(crate) fn display_direction(&self, edge: usize) -> usize {
        let along = self.display_edges()[edge].map(f64::abs);
        (0..2).fold(2, |most, c| if along[c] > along[most] { c } else { most })
    }

    /// How a point of the box, shares in [0, 1], is drawn to whoever looks from a side and from above
    /// (angles in radians): right, up and towards them, from the middle of the box. Each row holds the
    /// share of each edge, and what is added.
    pub(crate) fn projection(&self, side: f64, above: f64) -> [[f64; 4]; 3] {
        let edges = self.display_edges();
        let ((ss, cs), (sa, ca)) = (side.sin_cos(), above.sin_cos());
        let directions = [
            [cs, ss, 0.0],
            [-ss * sa, cs * sa, ca],
            [ss * ca, -cs * ca, sa],
        ];
        directions.map(|direction| {
            let along = edges.map(|edge| dot(edge, direction));
            let middle = 0.5 * along.iter().sum::<f64>();
            [along[0], along[1], along[2], -middle]
        })
    }
}
