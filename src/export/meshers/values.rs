//! What is known of each cell, as arrays: regions, rock, other properties.

use crate::files::vtk::DataArray;
use crate::model::reservoir::Model;

/// Region, `porosity`, `permeability` (a symmetric tensor: xx, yy, zz, xy, yz, xz; m^2) and properties of each
/// cell, as far as the model has them.
pub fn of_cells(model: &Model) -> Vec<DataArray> {
    let mut arrays = vec![DataArray::scalars("region", model.mesh.region.clone())];
    if let Some(porosity) = &model.porosity {
        arrays.push(DataArray::scalars("porosity", porosity.clone()));
    }
    if let Some(permeability) = &model.permeability {
        let of = |cell: usize| permeability.rock.mobility(cell).0;
        arrays.push(DataArray {
            name: "permeability".into(),
            components: 6,
            values: (0..model.len()).flat_map(of).collect::<Vec<f64>>().into(),
        });
    }
    arrays.extend(model.properties.iter().cloned());
    arrays
}

/// The names of an array's components.
pub fn components(array: &DataArray) -> Vec<String> {
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
    let named = |k: usize| format!("{}_{}", array.name, ending(k));
    (0..array.components).map(named).collect()
}
