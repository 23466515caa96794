//! Meshes that files hold, whatever their cells are.

use std::path::Path;

use super::file::Placed;
use crate::Result;
use crate::export::{MeshFile, write_cells_vtu, write_vtu};
use crate::flow::barriers::marks_of_bits;
use crate::io::vtk::DataArray;
use crate::mesh::poly::PolyMesh;
use crate::report::Measured;
use crate::surface::faceted::Faceted;
use crate::surface::{Options, Surfaces, select};

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

/// Groups facets of a mesh into surfaces and closes their gaps, in lattice space.
pub fn group<const D: usize, M: Stored<D>>(
    placed: &Placed<D, M>,
    facets: Vec<[u32; D]>,
    options: &Options,
) -> Surfaces<D> {
    let candidates = select::spanned(&placed.lattice, &facets);
    Surfaces::find(
        placed.lattice.node_positions(),
        facets,
        &candidates,
        options,
    )
}

/// The facets of a mesh that lie on horizons, nodes ascending, sorted.
pub fn horizon_facets<const D: usize, M: Stored<D>>(placed: &Placed<D, M>) -> Vec<[u32; D]> {
    match placed.horizons.as_slice() {
        [] => Vec::new(),
        marks => select::marked(&placed.lattice, marks),
    }
}
