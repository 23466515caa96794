//! Meshes, images and surfaces as Python objects. Their arrays are read-only NumPy arrays without
//! copies.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use atomesh::cli::host::MemoryOutput;
use atomesh::export::SurfaceFile;
use atomesh::files::vtk::{DataArray, Values};
use atomesh::image::formats::{AnyImage, LoadedImage};
use atomesh::image::{ExactLabels, Geometry, Image as Samples};
use atomesh::mesh::Mesh as _;
use atomesh::model::surface::facet_selection::marked_facets;
use atomesh::store::{AnyMesh, CellStreams, FieldValue, MeshFile, Storable, read_any_vtu};
use atomesh::with_mesh;
use numpy::ndarray::{ArrayViewD, IxDyn};
use numpy::{Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString, PyType};
use sha2::{Digest, Sha256};

use crate::errors;
use crate::parts::{MeshParts, Named, data_arrays, misfit, numbers, rows};

/// Returns a NumPy array of data that `owner` holds.
fn view<'py, T: Element>(
    owner: Bound<'py, PyAny>,
    data: &[T],
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let view = ArrayViewD::from_shape(IxDyn(shape), data)
        .map_err(|error| PyValueError::new_err(error.to_string()))?;
    // SAFETY: `data` belongs to a frozen class, which never changes or moves it while the object
    // lives, and the array keeps the object alive. The array becomes read-only before Python code
    // gets it.
    let array = unsafe { PyArrayDyn::borrow_from_array(&view, owner) };
    let array = array.readwrite().make_nonwriteable();
    Ok((*array).clone().into_any())
}

fn values<'py>(owner: &Bound<'py, PyAny>, array: &DataArray) -> PyResult<Bound<'py, PyAny>> {
    let tuples = array.values.len() / array.components.max(1);
    let shape = match array.components {
        1 => vec![tuples],
        components => vec![tuples, components],
    };
    macro_rules! typed_view {
        ($($kind:ident)*) => {
            match &array.values {
                $(Values::$kind(data) => view(owner.clone(), data, &shape),)*
            }
        };
    }
    typed_view!(I8 U8 I16 U16 I32 U32 I64 U64 F32 F64)
}

fn all_values<'py>(
    owner: &Bound<'py, PyAny>,
    arrays: &[DataArray],
) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(owner.py());
    for array in arrays {
        dict.set_item(&array.name, values(owner, array)?)?;
    }
    Ok(dict)
}

fn named_values<'py>(owner: &Bound<'py, PyAny>, arrays: &[DataArray]) -> PyResult<Named<'py>> {
    let named = |array: &DataArray| Ok((array.name.clone(), values(owner, array)?));
    arrays.iter().map(named).collect()
}

/// Returns field values as text and arrays, which keep their types even if they are empty.
fn named_fields<'py>(
    owner: &Bound<'py, PyAny>,
    fields: &[(String, FieldValue)],
) -> PyResult<Named<'py>> {
    let named = |(name, value): &(String, FieldValue)| {
        let value = match value {
            FieldValue::Text(text) => PyString::new(owner.py(), text).into_any(),
            FieldValue::F64s(numbers) => view(owner.clone(), numbers, &[numbers.len()])?,
            FieldValue::Ints(numbers) => view(owner.clone(), numbers, &[numbers.len()])?,
        };
        Ok((name.clone(), value))
    };
    fields.iter().map(named).collect()
}

fn fields<'py>(py: Python<'py>, fields: &[(String, FieldValue)]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, value) in fields {
        match value {
            FieldValue::Text(text) => dict.set_item(name, text)?,
            FieldValue::F64s(numbers) => dict.set_item(name, numbers)?,
            FieldValue::Ints(numbers) => dict.set_item(name, numbers)?,
        }
    }
    Ok(dict)
}

/// A mesh in physical coordinates, with all arrays of its points and cells.
#[pyclass(frozen, module = "atomesh._native")]
pub struct Mesh(pub Arc<AnyMesh>, LazyArrays);

/// Arrays that are computed at their first use.
#[derive(Default)]
struct LazyArrays {
    feature_faces: OnceLock<Vec<u32>>,
    streams: OnceLock<(Vec<u32>, Vec<u64>)>,
}

impl From<AnyMesh> for Mesh {
    fn from(mesh: AnyMesh) -> Self {
        Self(Arc::new(mesh), LazyArrays::default())
    }
}

/// Kind, nodes, cells, point data, cell data and fields of a mesh, as in [`MeshParts`].
type MeshPartsTuple<'py> = (
    &'static str,
    Bound<'py, PyAny>,
    Vec<Bound<'py, PyAny>>,
    Named<'py>,
    Named<'py>,
    Named<'py>,
);

#[pymethods]
impl Mesh {
    /// Creates a mesh from its [`parts`](Self::parts).
    #[new]
    fn new<'py>(
        kind: String,
        nodes: Bound<'py, PyAny>,
        cells: Vec<Bound<'py, PyAny>>,
        point_data: Named<'py>,
        cell_data: Named<'py>,
        fields: Named<'py>,
    ) -> PyResult<Self> {
        let parts = MeshParts {
            kind,
            nodes,
            cells,
            point_data,
            cell_data,
            fields,
        };
        Ok(parts.into_mesh()?.into())
    }

    /// Returns the arguments that create the mesh; see [`MeshParts`].
    fn parts<'py>(slf: &Bound<'py, Self>) -> PyResult<MeshPartsTuple<'py>> {
        let any = slf.as_any();
        let cells = match Self::simplices(slf)? {
            Some(corners) => vec![corners],
            None => {
                let [items, offsets, face_cells, sites] =
                    Self::faces(slf)?.expect("Voronoi cells have faces");
                let (region, on_feature) = match &*slf.get().0 {
                    AnyMesh::Polygons(file) => (&file.mesh.region, &file.mesh.on_feature),
                    AnyMesh::Polyhedra(file) => (&file.mesh.region, &file.mesh.on_feature),
                    _ => unreachable!("simplices have no faces"),
                };
                let region = view(any.clone(), region, &[region.len()])?;
                let on_feature = view(any.clone(), on_feature, &[on_feature.len()])?;
                vec![items, offsets, face_cells, sites, region, on_feature]
            }
        };
        let (point_data, cell_data, fields) = with_mesh!(&*slf.get().0, file => (
            named_values(any, &file.point_data)?,
            named_values(any, &file.cell_data)?,
            named_fields(any, &file.field_data)?,
        ));
        let kind = slf.get().kind();
        Ok((
            kind,
            Self::points(slf)?,
            cells,
            point_data,
            cell_data,
            fields,
        ))
    }

    fn __reduce__<'py>(
        slf: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyType>, MeshPartsTuple<'py>)> {
        Ok((slf.get_type(), Self::parts(slf)?))
    }

    /// Reads a .vtu file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let result = py.detach(|| read_any_vtu(&path));
        let mesh = result.map_err(|error| errors::library_error(py, &error))?;
        Ok(mesh.into())
    }

    /// Writes a .vtu file, which appears complete or not at all.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        fn write_file<const D: usize, M: Storable<D>>(
            path: &std::path::Path,
            file: &MeshFile<M>,
        ) -> atomesh::Result<()> {
            M::write(path, file)
        }
        let result = py.detach(|| with_mesh!(&*self.0, file => write_file(&path, file)));
        result.map_err(|error| errors::library_error(py, &error))
    }

    /// Kind of the cells: "tetra", "triangle", "polyhedron" or "polygon".
    #[getter]
    fn kind(&self) -> &'static str {
        match *self.0 {
            AnyMesh::Triangles(_) => "triangle",
            AnyMesh::Tetrahedra(_) => "tetra",
            AnyMesh::Polygons(_) => "polygon",
            AnyMesh::Polyhedra(_) => "polyhedron",
        }
    }

    #[getter]
    fn n_cells(&self) -> usize {
        with_mesh!(&*self.0, file => file.mesh.len())
    }

    #[getter]
    fn points<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let any = slf.as_any().clone();
        with_mesh!(&*slf.get().0, file => {
            let nodes = file.mesh.nodes();
            let width = nodes.first().map_or(3, |node| node.len());
            view(any, nodes.as_flattened(), &[nodes.len(), width])
        })
    }

    /// Points of each cell; `None` for Voronoi cells.
    #[getter]
    fn simplices<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let any = slf.as_any().clone();
        Ok(Some(match &*slf.get().0 {
            AnyMesh::Triangles(file) => {
                let cells = &file.mesh.triangles;
                view(any, cells.as_flattened(), &[cells.len(), 3])?
            }
            AnyMesh::Tetrahedra(file) => {
                let cells = &file.mesh.tets;
                view(any, cells.as_flattened(), &[cells.len(), 4])?
            }
            _ => return Ok(None),
        }))
    }

    /// Points of all Voronoi cells, one cell after the other, and the end of each cell's points;
    /// `None` for simplices. In the plane, the points are in order around the cell.
    #[getter]
    fn corners<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<[Bound<'py, PyAny>; 2]>> {
        let (mesh, derived) = (&slf.get().0, &slf.get().1);
        let (corners, ends) = match &**mesh {
            AnyMesh::Polygons(file) => derived.streams.get_or_init(|| face_streams(&file.mesh)),
            AnyMesh::Polyhedra(file) => derived.streams.get_or_init(|| face_streams(&file.mesh)),
            _ => return Ok(None),
        };
        let any = slf.as_any();
        Ok(Some([
            view(any.clone(), corners, &[corners.len()])?,
            view(any.clone(), ends, &[ends.len()])?,
        ]))
    }

    /// Faces of Voronoi cells: the points of all faces, the offsets of each face's points, the
    /// cells on both sides, and the sites of cells; `None` for simplices.
    #[getter]
    fn faces<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<[Bound<'py, PyAny>; 4]>> {
        let any = slf.as_any();
        macro_rules! arrays {
            ($mesh:expr, $axes:literal) => {{
                let mesh = $mesh;
                [
                    view(any.clone(), &mesh.faces.items, &[mesh.faces.items.len()])?,
                    view(
                        any.clone(),
                        &mesh.faces.offsets,
                        &[mesh.faces.offsets.len()],
                    )?,
                    view(
                        any.clone(),
                        mesh.face_cells.as_flattened(),
                        &[mesh.face_cells.len(), 2],
                    )?,
                    view(
                        any.clone(),
                        mesh.sites.as_flattened(),
                        &[mesh.sites.len(), $axes],
                    )?,
                ]
            }};
        }
        Ok(match &*slf.get().0 {
            AnyMesh::Polygons(file) => Some(arrays!(&file.mesh, 2)),
            AnyMesh::Polyhedra(file) => Some(arrays!(&file.mesh, 3)),
            _ => None,
        })
    }

    /// Faces on features: triangles, or edges in the plane.
    #[getter]
    fn feature_faces<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        fn feature_corners<const D: usize, M: Storable<D>>(
            file: &MeshFile<M>,
        ) -> (Vec<u32>, usize) {
            let marks = file
                .mesh
                .feature_marks(M::feature_faces(file, false).as_deref());
            let facets = marks.map(|marks| marked_facets(&file.mesh, &marks));
            (facets.unwrap_or_default().into_flattened(), D)
        }
        let width = match *slf.get().0 {
            AnyMesh::Triangles(_) | AnyMesh::Polygons(_) => 2,
            _ => 3,
        };
        let cached = &slf.get().1.feature_faces;
        let facets =
            cached.get_or_init(|| with_mesh!(&*slf.get().0, file => feature_corners(file)).0);
        view(slf.as_any().clone(), facets, &[facets.len() / width, width])
    }

    #[getter]
    fn point_data<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        with_mesh!(&*slf.get().0, file => all_values(slf.as_any(), &file.point_data))
    }

    #[getter]
    fn cell_data<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let any = slf.as_any();
        let dict = with_mesh!(&*slf.get().0, file => all_values(any, &file.cell_data))?;
        let region = match &*slf.get().0 {
            AnyMesh::Polygons(file) => &file.mesh.region,
            AnyMesh::Polyhedra(file) => &file.mesh.region,
            _ => return Ok(dict),
        };
        dict.set_item("region", view(any.clone(), region, &[region.len()])?)?;
        Ok(dict)
    }

    /// Field data, which belongs to the whole mesh.
    #[getter]
    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        with_mesh!(&*self.0, file => fields(py, &file.field_data))
    }
}

fn face_streams<const D: usize>(mesh: &atomesh::mesh::poly::PolyMesh<D>) -> (Vec<u32>, Vec<u64>) {
    let streams = CellStreams::new(mesh);
    (streams.corners, streams.corner_ends)
}

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

/// Returns the SHA-256 of an image's samples, x fastest, as little-endian 32-bit floats.
pub fn hash(image: &AnyImage) -> String {
    let samples = match image {
        AnyImage::Plane(loaded) => loaded.image.as_slice(),
        AnyImage::Space(loaded) => loaded.image.as_slice(),
    };
    let mut hasher = Sha256::new();
    for chunk in samples.chunks(1 << 14) {
        let bytes: Vec<u8> = chunk
            .iter()
            .flat_map(|sample| sample.to_le_bytes())
            .collect();
        hasher.update(&bytes);
    }
    let bytes = hasher.finalize();
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

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
