//! Surfaces as Python objects.

use atomesh::export::SurfaceFile;
use atomesh::files::vtk::DataArray;
use numpy::PyReadonlyArrayDyn;
use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};

use super::arrays::{all_values, named_values, view};
use crate::parts::{Named, data_arrays, misfit, rows};

/// Labelled surfaces, or curves in the plane.
#[pyclass(frozen, module = "atomesh._native")]
pub struct Surfaces {
    points: Vec<[f64; 3]>,
    facets: Vec<u32>,
    /// Number of points of a facet.
    corners: usize,
    start: Vec<usize>,
    names: Vec<String>,
    cell_data: Vec<DataArray>,
}

impl<const D: usize> From<&SurfaceFile<D>> for Surfaces {
    fn from(file: &SurfaceFile<D>) -> Self {
        Self {
            points: file.nodes.clone(),
            facets: file.facets.as_flattened().to_vec(),
            corners: D,
            start: file.surface_starts.clone(),
            names: file.names.clone(),
            cell_data: file.cell_data.clone(),
        }
    }
}

/// The arguments that create surfaces.
type SurfaceParts<'py> = (
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
    Vec<usize>,
    Vec<String>,
    Named<'py>,
);

#[pymethods]
impl Surfaces {
    /// Creates surfaces from their points, the points of their faces, the index of the first face
    /// of each surface with the number of all faces, their names, and the arrays of faces.
    #[new]
    fn new<'py>(
        points: Bound<'py, PyAny>,
        faces: PyReadonlyArrayDyn<'py, u32>,
        start: Vec<usize>,
        names: Vec<String>,
        cell_data: Named<'py>,
    ) -> PyResult<Self> {
        let points = rows::<f64, 3>(&points)?;
        let &[count, corners @ (2 | 3)] = faces.shape() else {
            return Err(misfit("the faces"));
        };
        let facets: Vec<u32> = faces.as_array().iter().copied().collect();
        let fits = facets.iter().all(|&n| (n as usize) < points.len())
            && start.is_sorted()
            && start.first() == Some(&0)
            && start.last() == Some(&count)
            && start.len() == names.len() + 1;
        if !fits {
            return Err(misfit("the faces"));
        }
        Ok(Self {
            points,
            facets,
            corners,
            start,
            names,
            cell_data: data_arrays(&cell_data, count)?,
        })
    }

    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyType>, SurfaceParts<'py>)> {
        let surfaces = slf.get();
        let parts = (
            Self::points(slf)?,
            Self::faces(slf)?,
            surfaces.start.clone(),
            surfaces.names.clone(),
            named_values(slf.as_any(), &surfaces.cell_data)?,
        );
        Ok((slf.get_type(), parts))
    }

    #[getter]
    fn points<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let points = &slf.get().points;
        view(
            slf.as_any().clone(),
            points.as_flattened(),
            &[points.len(), 3],
        )
    }

    /// Points of each face, surface by surface.
    #[getter]
    fn faces<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let surfaces = slf.get();
        let shape = [surfaces.facets.len() / surfaces.corners, surfaces.corners];
        view(slf.as_any().clone(), &surfaces.facets, &shape)
    }

    /// Index of the first face of each surface, and the number of all faces.
    #[getter]
    fn start(&self) -> Vec<usize> {
        self.start.clone()
    }

    #[getter]
    fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    #[getter]
    fn cell_data<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        all_values(slf.as_any(), &slf.get().cell_data)
    }
}
