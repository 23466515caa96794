//! The option `--velocity`: conversion of two-way time to depth, with one velocity or a file of
//! velocities.

use std::path::Path;

use crate::Result;
use crate::cli::common::options::with_option_name;
use crate::cli::console::Console;
use crate::image::formats::InputOptions;
use crate::image::{DepthConversion, Geometry, Image};
use crate::job::depth::{self, read_velocities};
use crate::job::spec::NumberOrFile;
use crate::store::{self, MeshFile, Storable, StoredMesh};

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
    let read = |path: &Path| console.read_image(path, &InputOptions::default());
    depth::image_in_depth(image, velocity, is_labels, &read).map_err(with_option_name)
}

/// Prepares a mesh from a file, and converts it to depth if a velocity is given. `place` names the
/// mesh in errors.
///
/// # Errors
/// Returns the errors of [`StoredMesh::new`], and [`Error::Image`](crate::Error::Image) for
/// velocities that do not fit the mesh.
pub fn mesh_in_depth<const D: usize, M: Storable<D>>(
    file: MeshFile<M>,
    velocity: Option<&NumberOrFile>,
    place: &str,
    console: &Console,
) -> Result<StoredMesh<D, M>> {
    match velocity {
        None => StoredMesh::new(file, place),
        Some(NumberOrFile::Constant(velocity)) => StoredMesh::new(
            store::to_depth(file, *velocity).map_err(with_option_name)?,
            place,
        ),
        Some(NumberOrFile::File(path)) => {
            let mut stored = StoredMesh::new(file, place)?;
            let space = &stored.space;
            let velocities = read_velocities(
                path,
                &space.geometry,
                |dims| space.fits_dims(dims),
                &|path| console.read_image(path, &InputOptions::default()),
            )
            .map_err(with_option_name)?;
            let notes = stored
                .convert_to_depth(&velocities, place)
                .map_err(with_option_name)?;
            notes.iter().for_each(|note| console.note(note));
            Ok(stored)
        }
    }
}

/// Prints a warning if a coordinate is time.
pub fn warn_if_time<const D: usize>(geometry: &Geometry<D>, console: &Console) {
    if let Some(axis) = geometry.time_coordinate() {
        console.note(format_args!(
            "WARNING: {} is time ({}), not depth: dips, volumes and fluxes are not true; give --velocity V (m/s, or a file of velocities)",
            ["x", "y", "z"][axis], geometry.units[axis]
        ));
    }
}
