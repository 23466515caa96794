//! Conversion of images from two-way time to depth, with one velocity or a volume of velocities.

use std::path::Path;

use super::spec::NumberOrFile;
use super::{Params, Weight};
use crate::error::cause;
use crate::image::formats::{InputOptions, ReadImage};
use crate::image::{DepthConversion, Geometry, Image, Modality, VelocityModel};
use crate::{Error, Result};

/// Reads a volume of velocities. A volume without a position of its own gets that of `time`, the
/// geometry of the image, if `fits` accepts its dimensions.
///
/// # Errors
/// Returns the errors of reading, and [`Error::Image`] for velocities of another dimension.
pub(crate) fn read_velocities<const D: usize>(
    path: &Path,
    time: &Geometry<D>,
    fits: impl Fn([usize; D]) -> bool,
    read: ReadImage<'_>,
) -> Result<VelocityModel<D>> {
    let name = path.display().to_string();
    let mut image: Image<D> = read(path, &InputOptions::default())?
        .into_image()
        .ok_or_else(|| {
            let problem = format!("is not a {D}-D image, but the image in time is {D}-D");
            let remedy = "give velocities with as many axes";
            Error::Image(cause(format!("velocity {name}"), problem, remedy))
        })?;
    if image.geometry == Geometry::default() && fits(image.dims()) {
        image.geometry = time.clone();
    }
    VelocityModel::new(image, &name)
}

/// Converts an image to depth if a velocity is given. Returns the image, and the conversion if the
/// image was resampled. Values of an image with `is_labels` are not interpolated.
///
/// # Errors
/// Returns the errors of reading velocities, and [`Error::Image`] for velocities that do not fit
/// the image.
pub(crate) fn image_in_depth<const D: usize>(
    mut image: Image<D>,
    velocity: Option<&NumberOrFile>,
    is_labels: bool,
    read: ReadImage<'_>,
) -> Result<(Image<D>, Option<DepthConversion<D>>)> {
    match velocity {
        None => Ok((image, None)),
        Some(NumberOrFile::Constant(velocity)) => {
            image.geometry = image.geometry.to_depth(*velocity)?.0;
            Ok((image, None))
        }
        Some(NumberOrFile::File(path)) => {
            let dims = image.dims();
            let velocities = read_velocities(path, &image.geometry, |volume| volume == dims, read)?;
            let conversion = DepthConversion::new(&image, velocities)?;
            let is_labels = is_labels || image.label_evidence(Modality::Survey).is_some();
            Ok((conversion.apply(&image, is_labels)?, Some(conversion)))
        }
    }
}

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
