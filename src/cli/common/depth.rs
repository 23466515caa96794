//! `--velocity`: depth of two-way time, by one velocity or by a file of them.

use std::path::Path;

use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::error::cause;
use crate::image::formats::InputOptions;
use crate::image::{DepthConversion, Geometry, Image, Modality, VelocityModel};
use crate::job::asked::VelocityFrom;
use crate::job::{Params, Weight};
use crate::store::{self, MeshFile, Storable, StoredMesh};
use crate::{Error, Result};

/// The velocities of a file. Samples that say nowhere where they lie, are those of the image in time, if
/// there are as many (which `fits` says).
fn read_velocity_volume<const D: usize>(
    path: &Path,
    time: &Geometry<D>,
    fits: impl Fn([usize; D]) -> bool,
    console: &Console,
) -> Result<VelocityModel<D>> {
    let name = path.display().to_string();
    let read = console.read_image(path, &InputOptions::default())?;
    let mut image: Image<D> = read.into_image().ok_or_else(|| {
        let problem = format!("is no {D}-D image, but what shall lie in depth is {D}-D");
        let remedy = "give velocities with as many axes";
        Error::Image(cause(format!("--velocity {name}"), problem, remedy))
    })?;
    if image.geometry == Geometry::default() && fits(image.dims()) {
        image.geometry = time.clone();
    }
    VelocityModel::new(image, &name)
}

/// An image in depth, if a velocity is given, and how it was stretched, if it was. `labels` says that its
/// values are known not to be mixed.
///
/// # Errors
/// [`Error::Image`] for velocities that make no depth of it.
pub fn image_in_depth<const D: usize>(
    mut image: Image<D>,
    velocity: Option<&VelocityFrom>,
    labels: bool,
    console: &Console,
) -> Result<(Image<D>, Option<DepthConversion<D>>)> {
    match velocity {
        None => Ok((image, None)),
        Some(VelocityFrom::Constant(velocity)) => {
            image.geometry = image
                .geometry
                .to_depth(*velocity)
                .map_err(with_option_name)?
                .0;
            Ok((image, None))
        }
        Some(VelocityFrom::File(path)) => {
            let dims = image.dims();
            let velocities =
                read_velocity_volume(path, &image.geometry, |own| own == dims, console)?;
            let stretch = DepthConversion::new(&image, velocities).map_err(with_option_name)?;
            let labels = labels || image.label_evidence(Modality::Survey).is_some();
            Ok((stretch.apply(&image, labels)?, Some(stretch)))
        }
    }
}

/// Stretches what a job has a value of for every sample as its image was.
///
/// # Errors
/// [`Error::Image`] for what is not of as many samples.
pub fn params_in_depth<const D: usize>(
    params: &mut Params<D>,
    stretch: Option<&DepthConversion<D>>,
) -> Result<()> {
    let Some(stretch) = stretch else {
        return Ok(());
    };
    if let Some(distances) = &mut params.distance_map {
        stretch.check(distances.dims(), "--distance-from")?;
        **distances = stretch.apply(distances, false)?;
    }
    if let Weight::Image(weights) = &mut params.beta {
        stretch.check(weights.dims(), "--beta")?;
        **weights = stretch.apply(weights, false)?;
    }
    Ok(())
}

/// A mesh from a file, in depth if a velocity is given; `place` names it in errors.
///
/// # Errors
/// Those of [`StoredMesh::new`]; [`Error::Image`] for velocities that make no depth of it.
pub fn mesh_in_depth<const D: usize, M: Storable<D>>(
    file: MeshFile<M>,
    velocity: Option<&VelocityFrom>,
    place: &str,
    console: &Console,
) -> Result<StoredMesh<D, M>> {
    match velocity {
        None => StoredMesh::new(file, place),
        Some(VelocityFrom::Constant(velocity)) => StoredMesh::new(
            store::to_depth(file, *velocity).map_err(with_option_name)?,
            place,
        ),
        Some(VelocityFrom::File(path)) => {
            let mut stored = StoredMesh::new(file, place)?;
            let space = &stored.space;
            let velocities =
                read_velocity_volume(path, &space.geometry, |dims| space.fits_dims(dims), console)?;
            let notes = stored
                .convert_to_depth(&velocities, place)
                .map_err(with_option_name)?;
            notes.iter().for_each(|note| console.note(note));
            Ok(stored)
        }
    }
}

/// Says so if a coordinate is time.
pub fn warn_if_time<const D: usize>(geometry: &Geometry<D>, console: &Console) {
    if let Some(axis) = geometry.time_coordinate() {
        console.note(format_args!(
            "WARNING: {} is time ({}), not depth: dips, volumes and fluxes are not true; give --velocity V (m/s, or a file of velocities)",
            ["x", "y", "z"][axis], geometry.units[axis]
        ));
    }
}
