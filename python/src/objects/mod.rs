//! Meshes, images and surfaces as Python objects. Their arrays are read-only NumPy arrays without
//! copies.

mod arrays;
mod image;
mod mesh;
mod surfaces;

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use atomesh::session::{Objects, Output};
use atomesh::surface_file::AnySurfaces;
use pyo3::prelude::*;

pub use image::Image;
pub use mesh::Mesh;
pub use surfaces::Surfaces;

/// Returns meshes and images by their names.
pub fn by_name(objects: &HashMap<PathBuf, Bound<'_, PyAny>>) -> PyResult<Objects> {
    let mut by_name = Objects {
        keeps_results: true,
        ..Objects::default()
    };
    for (name, object) in objects {
        let name = name.clone();
        if let Ok(mesh) = object.cast::<Mesh>() {
            by_name.meshes.insert(name, Arc::clone(&mesh.get().0));
        } else {
            let image = object.cast::<Image>()?;
            by_name.images.insert(name, Arc::clone(&image.get().0));
        }
    }
    Ok(by_name)
}

/// Converts a result in memory to a Python object.
pub fn to_python(py: Python<'_>, output: Output) -> PyResult<Bound<'_, PyAny>> {
    Ok(match output {
        Output::Mesh(mesh) => Bound::new(py, Mesh::from(mesh))?.into_any(),
        Output::Image(image) => Bound::new(py, Image(Arc::from(image)))?.into_any(),
        Output::Surfaces(AnySurfaces::Curves(file)) => {
            Bound::new(py, Surfaces::from(&file))?.into_any()
        }
        Output::Surfaces(AnySurfaces::Surfaces(file)) => {
            Bound::new(py, Surfaces::from(&file))?.into_any()
        }
    })
}
