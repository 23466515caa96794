//! The option `--velocity`: conversion of two-way time to depth, with one velocity or a file of
//! velocities.

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::image::{self, DepthConversion, Geometry, Image};
use crate::job::spec::NumberOrFile;

use crate::job::MeshSpec;
use crate::store::input::time_warning;

/// Converts an image to depth if a velocity is given. Returns the image, and the conversion if the
/// image was resampled. Values of an image with `is_labels` are not interpolated.
///
/// # Errors
/// Returns [`Error::Image`](crate::Error::Image) for velocities that do not fit the image.
pub fn image_in_depth<const D: usize>(
    image: Image<D>,
    velocity: Option<&NumberOrFile>,
    is_labels: bool,
    console: &Console,
) -> Result<(Image<D>, Option<DepthConversion<D>>)> {
    if let (Some(NumberOrFile::Constant(v)), Ok(time)) = (velocity, image.geometry.two_way_time())
        && time.depth_unit != "m"
    {
        let per_second = (v * time.depth_units_per_metre()).round();
        let unit = time.depth_unit;
        console.note(format!(
            "depth is in {unit}, as x and y are; the velocity is in m/s: {v} m/s are {per_second} {unit}/s"
        ));
    }
    image::image_in_depth(image, velocity, is_labels, &console.reader())
        .map_err(with_option_name::<MeshSpec>)
}

/// Prints a warning if a coordinate is time.
pub fn warn_if_time<const D: usize>(geometry: &Geometry<D>, console: &Console) {
    time_warning(geometry)
        .iter()
        .for_each(|line| console.note(line));
}
