//! A VTU for GEOS: `attribute` says the region of each cell (from 1 on), and rock has the names that
//! GEOS' own examples give it, so that `fieldsToImport` and `fieldNamesInGEOS` are the same.
//!
//! GEOS itself takes tetrahedra, and prisms; of other polyhedra, only those that it can name.

use std::path::Path;

use crate::Result;
use crate::files::Batch;
use crate::files::vtk::{DataArray, Packing};
use crate::model::reservoir::Model;
use crate::store::polyhedra::add_cells_vtu;
use crate::store::vtu::{MeshFile, add_vtu};

/// The names of porosity and permeability.
const ROCK: [&str; 2] = ["rockPorosity_referencePorosity", "rockPerm_permeability"];

/// Writes the mesh.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if it cannot be written.
pub fn write(model: &Model, batch: &mut Batch, path: &Path) -> Result<()> {
    let region = &model.graph.region;
    let least = region.iter().min().copied().unwrap_or(0);
    let attribute: Vec<i32> = region.iter().map(|r| r - least + 1).collect();
    let mut arrays = vec![DataArray::scalars("attribute", attribute)];
    if let Some(porosity) = &model.porosity {
        arrays.push(DataArray::scalars(ROCK[0], porosity.clone()));
    }
    if let Some(permeability) = &model.permeability {
        let of = |cell: usize| permeability.rock.mobility(cell).0.into_iter().take(3);
        arrays.push(DataArray {
            name: ROCK[1].into(),
            components: 3,
            values: (0..model.len()).flat_map(of).collect::<Vec<f64>>().into(),
        });
    }
    arrays.extend(model.properties.iter().cloned());
    let Some(tets) = &model.tets else {
        return add_cells_vtu(batch, path, &model.mesh, &[], &arrays, &[], Packing::None);
    };
    let file = MeshFile {
        mesh: tets.clone(),
        cell_data: arrays,
        ..MeshFile::default()
    };
    add_vtu(batch, path, &file)
}
