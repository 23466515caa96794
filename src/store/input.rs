//! The input of functions on a mesh: the mesh, and the images that options name.

use std::path::Path;

use super::{
    self as store, AnyMesh, LatticeSpace, MeshFile, Storable, StoredMesh, without_padding,
};
use crate::error::cause;
use crate::image::formats::{AnyImage, InputOptions, ReadImage, read_with_options};
use crate::image::read_velocities;
use crate::image::time::metres_per_unit;
use crate::image::{Geometry, Image};
use crate::mesh::Simplices;
use crate::option_text::NumberOrFile;
use crate::progress::Progress;
use crate::{Error, Result};

/// A mesh, and how to read the images that options name.
///
/// Any mesh converts to it; images are then read from their files.
pub struct MeshInput<'a> {
    /// The mesh.
    pub mesh: AnyMesh,
    /// The name of the mesh in messages, such as the path of its file.
    pub name: &'a str,
    /// Reads the images that options name.
    pub read_image: ReadImage<'a>,
}

impl From<AnyMesh> for MeshInput<'_> {
    fn from(mesh: AnyMesh) -> Self {
        Self {
            mesh,
            name: "mesh",
            read_image: &read_with_options,
        }
    }
}

impl std::fmt::Debug for MeshInput<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MeshInput")
            .field("name", &self.name)
            .finish_non_exhaustive()
    }
}

/// An image, and its name.
#[derive(Debug, Clone)]
pub struct ImageInput<'a> {
    /// The image.
    pub image: AnyImage,
    /// The name of the image in messages, such as the path of its file.
    pub name: &'a str,
    /// The SHA-256 of its file, if it is known.
    pub sha256: Option<String>,
}

impl From<AnyImage> for ImageInput<'_> {
    fn from(image: AnyImage) -> Self {
        Self {
            image,
            name: "image",
            sha256: None,
        }
    }
}

impl ImageInput<'_> {
    /// Returns the image of a mesh of `D` dimensions.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if it has other dimensions or cannot be used.
    pub(crate) fn checked<const D: usize>(self) -> Result<Image<D>> {
        let image = self.image.into_image().ok_or_else(|| {
            let problem = format!("is not a {D}-D image, but the mesh is {D}-D");
            Error::Image(cause(self.name, problem, "give the image that was meshed"))
        })?;
        image.check(self.name)?;
        Ok(image)
    }

    /// Returns the image of the mesh, whose box it fills.
    ///
    /// # Errors
    /// Returns [`Error::Image`] if it cannot be used or does not fill the box.
    pub(crate) fn fitting<const D: usize>(self, space: &LatticeSpace<D>) -> Result<Image<D>> {
        let name = self.name;
        let image = self.checked()?;
        space.check_image(&image.geometry, image.dims(), name)?;
        Ok(image)
    }
}

/// Prepares a mesh from a file, and converts it to depth if a velocity is given. `name` is that of
/// the mesh in messages.
///
/// # Errors
/// Returns the errors of [`StoredMesh::new`], and [`Error::Image`] for
/// velocities that do not fit the mesh.
pub(crate) fn mesh_in_depth<const D: usize, M: Storable<D>>(
    file: MeshFile<M>,
    velocity: Option<&NumberOrFile>,
    name: &str,
    read_image: ReadImage<'_>,
    progress: &mut dyn Progress,
) -> Result<StoredMesh<D, M>> {
    match velocity {
        None => StoredMesh::new(file, name),
        Some(NumberOrFile::Constant(velocity)) => {
            StoredMesh::new(store::to_depth(file, *velocity)?, name)
        }
        Some(NumberOrFile::File(path)) => {
            let mut stored = StoredMesh::new(file, name)?;
            let space = &stored.space;
            let fits = |dims| space.fits_dims(dims);
            let velocities = read_velocities(path, &space.geometry, fits, read_image)?;
            let notes = stored.convert_to_depth(&velocities, name)?;
            notes.iter().for_each(|note| progress.note(note));
            Ok(stored)
        }
    }
}

/// Returns a warning if a coordinate has a known unit of length other than metres, which flow counts as
/// metres.
pub(crate) fn length_unit_warning<const D: usize>(geometry: &Geometry<D>) -> Option<String> {
    let (unit, metres) = geometry.units.iter().find_map(|unit| {
        let metres = metres_per_unit(unit).filter(|metres| *metres != 1.0)?;
        Some((unit, metres))
    })?;
    Some(format!(
        "WARNING: coordinates are in {unit}, but count as metres: pressures and rates are those of a body {} times as large",
        (1e4 / metres).round() / 1e4
    ))
}

/// Returns the mesh of the image alone, without the cells beyond it, and notes how many it leaves out.
pub(crate) fn image_part<const D: usize, M: Simplices<D>>(
    file: MeshFile<M>,
    progress: &mut dyn Progress,
) -> MeshFile<M> {
    let (file, left_out) = without_padding(file);
    if left_out > 0 {
        progress.note(&format!("leaves out {left_out} cells beyond the image"));
    }
    file
}

/// Reads the image of a mesh, and checks that it fills the mesh's box.
///
/// # Errors
/// Returns [`Error::Image`] or [`Error::Io`] if it cannot be used.
pub(crate) fn read_mesh_image<const D: usize>(
    path: &Path,
    input: &InputOptions,
    space: &LatticeSpace<D>,
    read_image: ReadImage<'_>,
) -> Result<Image<D>> {
    let image = ImageInput {
        image: read_image(path, input)?,
        name: &path.display().to_string(),
        sha256: None,
    };
    image.fitting(space)
}

/// Returns a warning if a coordinate is time.
pub(crate) fn time_warning<const D: usize>(geometry: &Geometry<D>) -> Option<String> {
    let axis = geometry.time_coordinate()?;
    Some(format!(
        "WARNING: {} is time ({}), not depth: dips, volumes and fluxes are not true; give --velocity V (m/s, or a file of velocities)",
        ["x", "y", "z"][axis],
        geometry.units[axis]
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flow_warns_of_units_of_length_other_than_metres() {
        let geometry = |unit: &str| Geometry::<3> {
            units: std::array::from_fn(|_| unit.to_string()),
            ..Geometry::default()
        };
        for unit in ["", "m", "furlong"] {
            assert_eq!(length_unit_warning(&geometry(unit)), None);
        }
        for (unit, factor) in [("mm", "1000"), ("ft", "3.2808"), ("km", "0.001")] {
            let warning = length_unit_warning(&geometry(unit)).unwrap();
            let expected = format!("in {unit}, but count as metres");
            assert!(warning.contains(&expected), "{warning}");
            assert!(
                warning.contains(&format!("a body {factor} times")),
                "{warning}"
            );
        }
    }
}
