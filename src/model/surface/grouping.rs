//! Options that group faces into surfaces, as values of the command line.

use serde::{Deserialize, Serialize};

use super::Options;
use super::measure::MapAxes;
use crate::error::cause;
use crate::image::Geometry;
use crate::image::stated::ZDirection;
use crate::option_text::SignedAxis;
use crate::{Error, Result};

/// Options that group faces into surfaces, and set their orientation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, clap::Args)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct GroupingOptions {
    /// Largest bend from face to face within a surface, in degrees
    #[arg(
            long,
            value_name = "DEGREES",
            default_value_t = Options::default().max_bend
        )]
    pub max_bend: f64,
    /// The direction that is up: x, y, z or -x, -y, -z in physical coordinates [default: z; y in
    /// 2-D]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<SignedAxis>,
}

impl Default for GroupingOptions {
    fn default() -> Self {
        Self {
            max_bend: Options::default().max_bend,
            up: None,
        }
    }
}

impl GroupingOptions {
    /// Returns the checked options for surfaces of at least `min_area`.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for a bend that is not an angle between 0 and 90 degrees, or a
    /// negative area.
    pub(crate) fn options(&self, min_area: Option<f64>) -> Result<Options> {
        let refuse = |option: String, remedy: &str| {
            Err(Error::Job(cause(option, "is out of range", remedy)))
        };
        if !(self.max_bend > 0.0 && self.max_bend < 90.0) {
            return refuse(
                format!("max-bend {}", self.max_bend),
                "give degrees above 0 and below 90; 25 is the default",
            );
        }
        if let Some(area) = min_area.filter(|a| !(a.is_finite() && *a >= 0.0)) {
            return refuse(format!("min-area {area}"), "give 0 or more square samples");
        }
        Ok(Options {
            max_bend: self.max_bend,
            min_area,
            ..Options::default()
        })
    }

    /// Returns the directions of up, north and east.
    ///
    /// # Errors
    /// Returns [`Error::Job`] for an axis that the mesh does not have.
    pub(crate) fn up_direction<const D: usize>(&self) -> Result<MapAxes<D>> {
        let up = self.up.unwrap_or(SignedAxis {
            axis: D - 1,
            is_positive: true,
        });
        up.check::<D>("up")?;
        Ok(MapAxes::from_axis(up.axis, up.is_positive))
    }

    /// Returns `true` if z of a mesh grows upwards: as the option says, or else its geometry.
    pub(crate) fn is_z_up<const D: usize>(&self, geometry: &Geometry<D>) -> bool {
        match self.up {
            Some(up) => up.is_positive,
            None => geometry.z_direction() != Some(ZDirection::Down),
        }
    }
}
