//! Images as Python objects.

use std::sync::Arc;

use atomesh::image::formats::{AnyImage, LoadedImage};
use atomesh::image::{ExactLabels, Geometry, Image as Samples};
use numpy::PyReadonlyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyType;

use super::arrays::view;
use crate::parts::numbers;

/// An image: samples, and their position in the world.
#[pyclass(frozen, module = "atomesh._native")]
pub struct Image(pub Arc<AnyImage>);

/// Origin, axes (one per row) and units of an image.
type GeometryArrays = (Vec<f64>, Vec<Vec<f64>>, Vec<String>);

/// The arguments that create an image.
type ImageParts<'py> = (
    Bound<'py, PyAny>,
    GeometryArrays,
    Vec<String>,
    String,
    Option<(Vec<i128>, Bound<'py, PyAny>)>,
    Bound<'py, PyAny>,
    Bound<'py, PyAny>,
);

#[pymethods]
impl Image {
    /// Creates an image from samples of shape (nz, ny, nx) or (ny, nx), x the fastest. `axes[k]` is
    /// the vector from a sample to the next one along axis k, x first.
    ///
    /// `missing` and `dead` flag rows of samples and samples that hold no data.
    #[new]
    #[pyo3(signature = (samples, place, names, encoding, labels, missing=None, dead=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        samples: PyReadonlyArrayDyn<'_, f32>,
        place: GeometryArrays,
        names: Vec<String>,
        encoding: String,
        labels: Option<(Vec<i128>, PyReadonlyArrayDyn<'_, u32>)>,
        missing: Option<Bound<'_, PyAny>>,
        dead: Option<Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let flags = |array: Option<Bound<'_, PyAny>>| match array {
            Some(array) => numbers::<bool>(&array),
            None => Ok(Vec::new()),
        };
        let flags = [flags(missing)?, flags(dead)?];
        let array = samples.as_array();
        let shape: Vec<usize> = array.shape().iter().rev().copied().collect();
        let data = array.iter().copied().collect();
        let labels = labels.map(|(values, index)| {
            let index = index.as_array().iter().copied().collect();
            Arc::new(ExactLabels {
                values,
                indices: index,
            })
        });
        let refuse = |problem: &str| PyValueError::new_err(problem.to_string());
        fn to_loaded<const D: usize>(
            shape: &[usize],
            data: Vec<f32>,
            (origin, axes, units): GeometryArrays,
            names: Vec<String>,
            encoding: String,
            labels: Option<Arc<ExactLabels>>,
            [missing, dead]: [Vec<bool>; 2],
        ) -> Option<LoadedImage<D>> {
            let axes: Option<Vec<[f64; D]>> = axes.into_iter().map(|a| a.try_into().ok()).collect();
            let geometry = Geometry {
                origin: origin.try_into().ok()?,
                axes: axes?.try_into().ok()?,
                names: names.try_into().ok()?,
                units: units.try_into().ok()?,
            };
            let mut image = Samples::new(shape.try_into().ok()?, data, geometry);
            let (count, rows) = (
                image.samples.len(),
                image.samples.len() / image.dims()[0].max(1),
            );
            image.labels = labels.filter(|labels| labels.indices.len() == count);
            let fits = |flags: &[bool], length| flags.is_empty() || flags.len() == length;
            image.missing = Some(missing).filter(|flags| fits(flags, rows))?;
            image.dead = Some(dead).filter(|flags| fits(flags, count))?;
            Some(LoadedImage {
                encoding,
                ..image.into()
            })
        }
        let image =
            py.detach(|| match shape.len() {
                2 => to_loaded(&shape, data, place, names, encoding, labels, flags)
                    .map(AnyImage::Plane),
                3 => to_loaded(&shape, data, place, names, encoding, labels, flags)
                    .map(AnyImage::Space),
                _ => None,
            });
        let problem = "an image has two axes or three, and as many origins, axes, units and names";
        Ok(Self(Arc::new(image.ok_or_else(|| refuse(problem))?)))
    }

    /// Samples of shape (nz, ny, nx) or (ny, nx).
    #[getter]
    fn samples<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let any = slf.as_any().clone();
        match &*slf.get().0 {
            AnyImage::Plane(l) => view(any, l.image.as_slice(), l.image.samples.shape()),
            AnyImage::Space(l) => view(any, l.image.as_slice(), l.image.samples.shape()),
        }
    }

    /// Returns the arguments that create the image.
    fn parts<'py>(slf: &Bound<'py, Self>) -> PyResult<ImageParts<'py>> {
        fn parts<'py, const D: usize>(
            slf: &Bound<'py, Image>,
            loaded: &LoadedImage<D>,
        ) -> PyResult<ImageParts<'py>> {
            let image = &loaded.image;
            let array = |flags: &[bool]| view(slf.as_any().clone(), flags, &[flags.len()]);
            let labels = match &image.labels {
                Some(labels) => {
                    let indices = &labels.indices;
                    let indices = view(slf.as_any().clone(), indices, &[indices.len()])?;
                    Some((labels.values.clone(), indices))
                }
                None => None,
            };
            Ok((
                Image::samples(slf)?,
                slf.get().place(),
                image.geometry.names.to_vec(),
                loaded.encoding.clone(),
                labels,
                array(&image.missing)?,
                array(&image.dead)?,
            ))
        }
        match &*slf.get().0 {
            AnyImage::Plane(loaded) => parts(slf, loaded),
            AnyImage::Space(loaded) => parts(slf, loaded),
        }
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyType>, ImageParts<'py>)> {
        Ok((slf.get_type(), Self::parts(slf)?))
    }

    /// Origin, axes and units of the image.
    #[getter]
    fn place(&self) -> GeometryArrays {
        fn geometry_arrays<const D: usize>(geometry: &Geometry<D>) -> GeometryArrays {
            let axes = geometry.axes.iter().map(|axis| axis.to_vec()).collect();
            (geometry.origin.to_vec(), axes, geometry.units.to_vec())
        }
        match &*self.0 {
            AnyImage::Plane(loaded) => geometry_arrays(&loaded.image.geometry),
            AnyImage::Space(loaded) => geometry_arrays(&loaded.image.geometry),
        }
    }
}
