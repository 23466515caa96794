//! Meshes that files hold, whatever their cells are.

use std::path::Path;

use super::file::Placed;
use crate::Result;
use crate::files::vtk::DataArray;
use crate::mesh::faceted::Faceted;
use crate::mesh::faceted::marks_of_bits;
use crate::mesh::poly::PolyMesh;
use crate::report::Measured;
use crate::store::{MeshFile, write_cells_vtu, write_vtu};

/// A mesh that a file can hold.
pub trait Stored<const D: usize>: Faceted<D> + Sized {
    /// Finds the way back from a file's coordinates; `place` names the file in errors.
    ///
    /// # Errors
    /// As [`Placed::new`].
    fn place(file: MeshFile<Self>, place: &str) -> Result<Placed<D, Self>>;

    /// Which faces of `placed.lattice` lie on features, by number; `None` if the file does not say.
    fn marks(placed: &Placed<D, Self>) -> Option<Vec<bool>>;

    /// Says which region each cell belongs to.
    fn set_regions(file: &mut MeshFile<Self>, regions: Vec<i32>);

    /// Writes a file.
    ///
    /// # Errors
    /// As [`write_vtu`].
    fn write(path: &Path, file: &MeshFile<Self>) -> Result<()>;
}

impl<const D: usize, M: Measured<D>> Stored<D> for M {
    fn place(file: MeshFile<Self>, place: &str) -> Result<Placed<D, Self>> {
        Placed::new(file, place)
    }

    fn marks(placed: &Placed<D, Self>) -> Option<Vec<bool>> {
        let bits = placed.feature_faces.as_deref()?;
        Some(marks_of_bits::<D>(bits).collect())
    }

    fn set_regions(file: &mut MeshFile<Self>, regions: Vec<i32>) {
        let array = DataArray::scalars("region", regions);
        match file.cell_data.iter_mut().find(|a| a.name == array.name) {
            Some(old) => *old = array,
            None => file.cell_data.push(array),
        }
    }

    fn write(path: &Path, file: &MeshFile<Self>) -> Result<()> {
        write_vtu(path, file)
    }
}

impl<const D: usize> Stored<D> for PolyMesh<D> {
    fn place(file: MeshFile<Self>, place: &str) -> Result<Placed<D, Self>> {
        Placed::cells(file, place)
    }

    fn marks(placed: &Placed<D, Self>) -> Option<Vec<bool>> {
        Some(placed.lattice.on_feature.clone())
    }

    fn set_regions(file: &mut MeshFile<Self>, regions: Vec<i32>) {
        file.mesh.region = regions;
    }

    fn write(path: &Path, file: &MeshFile<Self>) -> Result<()> {
        // The mesh itself has them.
        let mut file = file.clone();
        file.field_data.retain(|(name, _)| name != "feature_faces");
        write_cells_vtu(path, &file)
    }
}
