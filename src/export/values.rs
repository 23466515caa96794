//! Collects the values of each cell (regions, rock, other properties) as arrays.

use crate::files::vtk::DataArray;
use crate::model::reservoir::Model;

/// Returns the region, the [rock] and the other properties of each cell, as far as the model has
/// them.
///
/// [rock]: rock_arrays
///
/// `names` are the names of the other properties.
pub fn cell_arrays(model: &Model, names: &[String]) -> Vec<DataArray> {
    let mut arrays = vec![DataArray::scalars("region", model.mesh.region.clone())];
    arrays.extend(rock_arrays(model));
    let first = arrays.len() - model.properties.len();
    for (array, name) in arrays[first..].iter_mut().zip(names) {
        array.name.clone_from(name);
    }
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

/// Returns each component of the arrays of [`cell_arrays`] as a column. `names` are those of all
/// columns.
pub fn scalar_columns(model: &Model, names: &[String]) -> Vec<(String, Vec<f64>)> {
    let columns = cell_arrays(model, &[]).into_iter().flat_map(|array| {
        let (width, values) = (array.components, array.values.to_f64());
        let columns = (0..width).map(|k| values.iter().skip(k).step_by(width).copied().collect());
        columns.collect::<Vec<Vec<f64>>>()
    });
    names.iter().cloned().zip(columns).collect()
}

/// A component of an array of cells.
pub struct PropertyColumn {
    /// The name of the array, with the component if there are several.
    pub name: String,
    /// `true` if the array is the region or the rock of cells.
    pub is_fixed: bool,
}

/// Returns the columns of [`scalar_columns`] without their values.
pub fn property_columns(model: &Model) -> Vec<PropertyColumn> {
    let mut fixed = vec![("region", 1)];
    fixed.extend(model.porosity.iter().map(|_| ("porosity", 1)));
    fixed.extend(model.permeability.iter().map(|_| ("permeability", 6)));
    let given = (model.properties.iter()).map(|array| (array.name.as_str(), array.components));
    let column = |is_fixed| {
        move |(name, width)| {
            let names = component_names(name, width).into_iter();
            names.map(move |name| PropertyColumn { name, is_fixed })
        }
    };
    let fixed = fixed.into_iter().flat_map(column(true));
    fixed.chain(given.flat_map(column(false))).collect()
}

/// Returns the names of the components of an array.
fn component_names(array: &str, width: usize) -> Vec<String> {
    let endings: &[&str] = match width {
        1 => return vec![array.into()],
        3 => &["x", "y", "z"],
        6 => &["xx", "yy", "zz", "xy", "yz", "xz"],
        _ => &[],
    };
    let ending = |k: usize| {
        endings
            .get(k)
            .map_or((k + 1).to_string(), |&e| e.to_string())
    };
    let full_name = |k: usize| format!("{array}_{}", ending(k));
    (0..width).map(full_name).collect()
}
