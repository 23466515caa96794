//! Meshes as Python objects.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use atomesh::mesh::Mesh as _;
use atomesh::model::surface::facet_selection::marked_facets;
use atomesh::store::{AnyMesh, CellStreams, MeshFile, Storable, read_any_vtu, take_cells};
use atomesh::with_mesh;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};

use super::arrays::{all_values, fields, named_fields, named_values, view};
use crate::errors;
use crate::parts::{MeshParts, Named};

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

    /// Returns the mesh of the cells with these numbers, in their order.
    fn take_cells(&self, py: Python<'_>, cells: Vec<u32>) -> PyResult<Self> {
        let take =
            || with_mesh!(&*self.0, file => take_cells(file.clone(), &cells).map(AnyMesh::from));
        let mesh = py.detach(take);
        Ok(mesh
            .map_err(|error| errors::library_error(py, &error))?
            .into())
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
