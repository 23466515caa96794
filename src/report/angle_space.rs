//! The space whose angles decide what a mesh is fit for.
//!
//! A simulator computes with the coordinates of the nodes, so that angles in physical space decide
//! wherever all coordinates are lengths. Units may differ between coordinates; they are brought to one
//! unit first. Where a coordinate is time or the number of a line, only angles in lattice space have a
//! meaning.

use serde::Serialize;

use super::{Quality, Report};
use crate::image::{Geometry, NoAngles};

/// Space whose angles the verdict judges.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "space", content = "reason", rename_all = "lowercase")]
pub enum AngleSpace {
    /// Physical space, as all coordinates are lengths.
    Physical,
    /// Lattice space, as coordinates cannot be compared for this reason.
    Lattice(#[serde(serialize_with = "serialize_reason")] NoAngles),
}

/// Writes the reason as text.
fn serialize_reason<S: serde::Serializer>(
    reason: &NoAngles,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_str(reason)
}

impl AngleSpace {
    /// Returns the space in which the angles of a mesh with this geometry are judged.
    pub fn from_geometry<const D: usize>(geometry: &Geometry<D>) -> Self {
        match geometry.length_scales() {
            Ok(_) => Self::Physical,
            Err(reason) => Self::Lattice(reason),
        }
    }
}

impl Report {
    /// Sets the space in which angles are judged to that of a geometry.
    pub(crate) fn set_angle_space<const D: usize>(&mut self, geometry: &Geometry<D>) {
        self.angle_space = Some(AngleSpace::from_geometry(geometry));
    }

    /// Adds the shapes in physical space.
    pub(crate) fn set_physical_quality(&mut self, quality: Quality) {
        self.quality_physical = Some(Quality {
            space: "physical".into(),
            ..quality
        });
    }

    /// Returns the shapes that decide what the mesh is fit for: those in physical space, if they are
    /// known and have a meaning, else those in lattice space.
    pub(crate) fn judged_quality(&self) -> Option<&Quality> {
        self.quality_physical.as_ref().or(self.quality.as_ref())
    }

    /// Returns the reason why angles in physical space have no meaning, if that is so.
    pub(super) fn no_physical_angles(&self) -> Option<&NoAngles> {
        match &self.angle_space {
            Some(AngleSpace::Lattice(reason)) => Some(reason),
            Some(AngleSpace::Physical) | None => None,
        }
    }
}
