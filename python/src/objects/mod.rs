//! Meshes, images and surfaces as Python objects. Their arrays are read-only NumPy arrays without
//! copies.

mod arrays;
mod image;
mod mesh;
mod surfaces;

use std::sync::Arc;

use atomesh::surface_file::AnySurfaces;
use pyo3::prelude::*;

use crate::memory::Output;
pub use image::{Image, hash};
pub use mesh::Mesh;
pub use surfaces::Surfaces;

/// Converts a result in memory to a Python object.
pub fn to_python(py: Python<'_>, output: Output) -> PyResult<Bound<'_, PyAny>> {
    Ok(match output {
        Output::Mesh(mesh) => Bound::new(py, Mesh::from(mesh))?.into_any(),
        Output::Image(image) => Bound::new(py, Image(Arc::new(image)))?.into_any(),
        Output::Surfaces(AnySurfaces::Curves(file)) => {
            Bound::new(py, Surfaces::from(&file))?.into_any()
        }
        Output::Surfaces(AnySurfaces::Surfaces(file)) => {
            Bound::new(py, Surfaces::from(&file))?.into_any()
        }
    })
}
