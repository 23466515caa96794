//! The images among the parameters, converted from two-way time to depth as the image itself.

use super::{Params, Weight};
use crate::Result;
use crate::image::{DepthConversion, Geometry};

impl<const D: usize> Params<D> {
    /// Notes the unit of two-way time of an image, before it is converted to depth.
    pub(crate) fn note_time_unit(&mut self, image: &Geometry<D>) {
        let time = image.time_coordinate();
        self.time_unit = time.map(|c| image.units[c].clone());
    }

    /// Resamples the images among the parameters as the image itself was.
    ///
    /// # Errors
    /// Returns [`Error::Image`] for an image of other dimensions.
    pub(crate) fn convert_to_depth(&mut self, conversion: &DepthConversion<D>) -> Result<()> {
        self.velocities = Some(conversion.velocities().clone());
        if let Some(distances) = &mut self.distance_map {
            conversion.check(distances.dims(), "distance-from")?;
            **distances = conversion.apply(distances, false)?;
        }
        if let Weight::Image(weights) = &mut self.beta {
            conversion.check(weights.dims(), "beta")?;
            **weights = conversion.apply(weights, false)?;
        }
        Ok(())
    }
}
