//! Meshes, images and surfaces as Python objects. Their arrays are read-only NumPy arrays without
//! copies.

mod arrays;
mod image;
mod mesh;
mod surfaces;

use std::sync::Arc;

use atomesh::cli::host::MemoryOutput;
use atomesh::image::formats::AnyImage;
use pyo3::prelude::*;

pub use image::{Image, hash};
pub use mesh::Mesh;
pub use surfaces::Surfaces;

/// Converts a result in memory to a Python object.
pub fn to_python<'py>(py: Python<'py>, output: MemoryOutput) -> PyResult<Bound<'py, PyAny>> {
    Ok(match output {
        MemoryOutput::Mesh(mesh) => Bound::new(py, Mesh::from(*mesh))?.into_any(),
        MemoryOutput::Plane(image) => {
            Bound::new(py, Image(Arc::new(AnyImage::Plane(image.into()))))?.into_any()
        }
        MemoryOutput::Space(image) => {
            Bound::new(py, Image(Arc::new(AnyImage::Space(image.into()))))?.into_any()
        }
        MemoryOutput::Curves(file) => Bound::new(py, Surfaces::from(&file))?.into_any(),
        MemoryOutput::Surfaces(file) => Bound::new(py, Surfaces::from(&file))?.into_any(),
    })
}
