//! Collects the values of each cell (regions, rock, other properties) as arrays.

use crate::files::vtk::DataArray;
use crate::model::reservoir::Model;

/// Returns the region, the [rock] and the other properties of each cell, as far as the model has
/// them.
///
/// [rock]: rock_arrays
pub fn cell_arrays(model: &Model) -> Vec<DataArray> {
    let mut arrays = vec![DataArray::scalars("region", model.mesh.region.clone())];
    arrays.extend(rock_arrays(model));
    arrays
}

/// Returns `porosity`, `permeability` (a symmetric tensor: xx, yy, zz, xy, yz, xz; m^2) and the
/// other properties of each cell, as far as the model has them.
pub fn rock_arrays(model: &Model) -> Vec<DataArray> {
    let mut arrays = Vec::new();
    if let Some(porosity) = &model.porosity {
        arrays.push(DataArray::scalars("porosity", porosity.clone()));
    }
    if let Some(permeability) = &model.permeability {
        let tensor = |cell: usize| permeability.rock.mobility(cell).0;
        arrays.push(DataArray {
            name: "permeability".into(),
            components: 6,
            values: (0..model.len())
                .flat_map(tensor)
                .collect::<Vec<f64>>()
                .into(),
        });
    }
    arrays.extend(model.properties.iter().cloned());
    arrays
}

/// Returns the arrays of [`cell_arrays`] with each component as a named column of its own.
pub fn scalar_columns(model: &Model) -> Vec<(String, Vec<f64>)> {
    let columns = cell_arrays(model).into_iter().flat_map(|array| {
        let (width, values) = (array.components, array.values.to_f64());
        let names = component_names(&array).into_iter().enumerate();
        let columns = names.map(|(k, name)| {
            let column = values.iter().skip(k).step_by(width).copied();
            (name, column.collect())
        });
        columns.collect::<Vec<_>>()
    });
    columns.collect()
}

/// Returns the names of the components of an array.
fn component_names(array: &DataArray) -> Vec<String> {
    let endings: &[&str] = match array.components {
        1 => return vec![array.name.clone()],
        3 => &["x", "y", "z"],
        6 => &["xx", "yy", "zz", "xy", "yz", "xz"],
        _ => &[],
    };
    let ending = |k: usize| {
        endings
            .get(k)
            .map_or((k + 1).to_string(), |&e| e.to_string())
    };
    let full_name = |k: usize| format!("{}_{}", array.name, ending(k));
    (0..array.components).map(full_name).collect()
}
