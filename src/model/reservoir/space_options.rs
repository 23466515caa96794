//! Options that place a model in space.

use serde::{Deserialize, Serialize};

use super::case_options::check_positive;
use super::{DepthAxis, MeshPlacement, Model};
use crate::error::cause;
use crate::image::time::metres_per_unit;
use crate::option_text::SignedAxis;
use crate::{Error, Result};

/// Options that convert a mesh's coordinates to metres and depth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SpaceOptions {
    /// Unit of the mesh's coordinates, if it is not the one that the mesh states: m, km, ft, cm,
    /// mm, um or nm. The export is in metres [default: what the mesh states, or m; scans in mm or
    /// less keep their unit where flow is not simulated]
    #[arg(long, value_name = "UNIT")]
    pub length_unit: Option<String>,
    /// The coordinate that is depth, with its sign: -z if z grows upwards, z if it grows downwards,
    /// x ...
    #[arg(
            long,
            value_name = "AXIS",
            default_value_t = SpaceOptions::default().down,
            allow_hyphen_values = true
        )]
    pub down: SignedAxis,
    /// Depth (m) of the mesh's shallowest point [default: from its coordinates]
    #[arg(long, value_name = "DEPTH", allow_hyphen_values = true)]
    pub depth_at_top: Option<f64>,
    /// Velocity (m/s) that converts two-way time to depth
    #[arg(long, value_name = "V", allow_hyphen_values = true)]
    pub velocity: Option<f64>,
    /// Thickness of a 2-D mesh, in the unit of its coordinates [default: 1]
    #[arg(long, value_name = "T")]
    pub thickness: Option<f64>,
}

impl Default for SpaceOptions {
    fn default() -> Self {
        Self {
            length_unit: None,
            down: SignedAxis {
                axis: 2,
                is_positive: false,
            },
            depth_at_top: None,
            velocity: None,
            thickness: None,
        }
    }
}

impl SpaceOptions {
    /// Returns the placement of the mesh that the options describe.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an unknown unit, or for numbers that make no sense.
    pub(crate) fn placement(&self) -> Result<MeshPlacement> {
        let parse_unit = |unit: &String| {
            let place = format!("length-unit {unit}");
            let remedy = "give m, km, ft, cm, mm, um or nm";
            let unknown = || Error::Job(cause(place, "is not a known unit", remedy));
            metres_per_unit(unit).ok_or_else(unknown)
        };
        if let Some(thickness) = self.thickness {
            check_positive("thickness", thickness)?;
        }
        let length = self.length_unit.as_ref().map(parse_unit).transpose()?;
        Ok(MeshPlacement {
            length,
            keeps_unit: false,
            depth_axis: DepthAxis {
                axis: self.down.axis,
                is_downward: self.down.is_positive,
            },
            velocity: self.velocity,
            top: self.depth_at_top,
            thickness: self.thickness.unwrap_or(1.0),
        })
    }
}

/// Checks that depth grows downwards from the surface.
///
/// # Errors
/// Returns [`Error::Export`] for a mesh that reaches above depth 0.
pub(crate) fn check_depth(model: &Model, space: &SpaceOptions) -> Result<()> {
    let depths = (0..model.len()).map(|cell| model.depth(cell));
    let top = depths.fold(f64::INFINITY, f64::min);
    if top >= 0.0 {
        return Ok(());
    }
    Err(Error::Export(
        cause(
            format!("down {}", space.down),
            format!(
                "with depth in this direction, the top of the mesh lies {:.6} m above depth 0",
                -top
            ),
            "give the other direction (--down), or the depth of the mesh's top",
        )
        .with_parameter("depth-at-top"),
    ))
}
