//! Where the mesh lies, and how it is drawn.

use serde::Serialize;

use crate::geometry::in_space;
use crate::image::geometry::Ruler;
use crate::image::{Geometry, Image};
use crate::store::{Stored, StoredMesh};

/// The box of lattice space in the world and on the screen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Frame {
    /// Where the box begins, and its three edges, in the world.
    pub origin: [f64; 3],
    pub edges: [[f64; 3]; 3],
    /// The units of the world's coordinates.
    pub units: [String; 3],
    /// The names of the image's axes, and how many steps of samples the box is wide.
    pub names: [String; 3],
    pub samples: [f64; 3],
    /// How the edges are read off.
    pub rulers: [Ruler; 3],
    /// By how much each coordinate of the world is enlarged on the screen, so that lengths of unlike
    /// units are comparable.
    pub aspect: [f64; 3],
    /// Whether the last coordinate is drawn downwards.
    pub down: bool,
}

/// Of a mesh; names and units of the image, if it is given.
pub(super) fn of<const D: usize, M: Stored<D>>(
    stored: &StoredMesh<D, M>,
    image: Option<&Image<D>>,
) -> Frame {
    let space = &stored.space;
    let mut geometry = space.geometry.clone();
    if let Some(image) = image {
        geometry.names.clone_from(&image.geometry.names);
        if geometry.units.iter().all(String::is_empty) {
            geometry.units.clone_from(&image.geometry.units);
        }
    }
    let samples: [f64; D] = std::array::from_fn(|k| space.extent[k] / space.step[k]);
    let aspect = geometry.aspect(samples, space.extent);
    let down = geometry.points_down();
    let geometry: Geometry<3> = geometry.in_space();
    let samples: [f64; 3] = in_space(samples);
    Frame {
        origin: geometry.origin,
        edges: std::array::from_fn(|k| geometry.axes[k].map(|step| step * samples[k])),
        rulers: std::array::from_fn(|k| geometry.ruler(k, samples[k])),
        units: geometry.units,
        names: geometry.names,
        samples,
        aspect: std::array::from_fn(|k| aspect.get(k).copied().unwrap_or(1.0)),
        down,
    }
}
