//! The arrays from which meshes and surfaces are made, for pickles and for subsets of cells.

use atomesh::files::vtk::{DataArray, Values};
use atomesh::mesh::Simplices;
use atomesh::mesh::poly::{FIRST_SIDE, Lists, PolyMesh};
use atomesh::store::{AnyMesh, FieldValue, MeshFile};
use numpy::{Element, PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Arrays or field values by name, in their order.
pub type Named<'py> = Vec<(String, Bound<'py, PyAny>)>;

/// The parts of a mesh.
pub struct MeshParts<'py> {
    /// Kind of the cells, as in `Mesh.kind`.
    pub kind: String,
    /// Node positions, shape (n, 3) or (n, 2).
    pub nodes: Bound<'py, PyAny>,
    /// For simplices the nodes of each cell. For Voronoi cells the nodes of faces, the offsets of
    /// the faces, their cells, the sites, the regions, and whether faces lie on features.
    pub cells: Vec<Bound<'py, PyAny>>,
    pub point_data: Named<'py>,
    pub cell_data: Named<'py>,
    pub fields: Named<'py>,
}

impl MeshParts<'_> {
    /// Creates the mesh.
    ///
    /// # Errors
    /// Returns `TypeError` for arrays of wrong types, and `ValueError` for arrays that do not fit
    /// together.
    pub fn into_mesh(self) -> PyResult<AnyMesh> {
        match self.kind.as_str() {
            "triangle" => {
                let mesh = self.simplices()?;
                self.with_data(mesh).map(AnyMesh::Triangles)
            }
            "tetra" => {
                let mesh = self.simplices()?;
                self.with_data(mesh).map(AnyMesh::Tetrahedra)
            }
            "polygon" => {
                let mesh = self.voronoi_cells()?;
                self.with_data(mesh).map(AnyMesh::Polygons)
            }
            "polyhedron" => {
                let mesh = self.voronoi_cells()?;
                self.with_data(mesh).map(AnyMesh::Polyhedra)
            }
            _ => Err(misfit("the kind of cells")),
        }
    }

    fn simplices<const D: usize, M: Simplices<D>>(&self) -> PyResult<M> {
        let [corners] = self.cells.as_slice() else {
            return Err(misfit("the cells"));
        };
        let nodes = rows::<f64, D>(&self.nodes)?;
        let corners = numbers::<u32>(corners)?;
        let has_whole_cells = corners.len().is_multiple_of(D + 1);
        if !has_whole_cells || corners.iter().any(|&n| n as usize >= nodes.len()) {
            return Err(misfit("the points of cells"));
        }
        Ok(M::from_parts(nodes, corners))
    }

    fn voronoi_cells<const D: usize>(&self) -> PyResult<PolyMesh<D>> {
        let [items, offsets, face_cells, sites, region, on_feature] = self.cells.as_slice() else {
            return Err(misfit("the cells"));
        };
        let mesh = PolyMesh {
            nodes: rows::<f64, D>(&self.nodes)?,
            faces: Lists {
                offsets: numbers(offsets)?,
                items: numbers(items)?,
            },
            face_cells: rows(face_cells)?,
            sites: rows(sites)?,
            region: numbers(region)?,
            on_feature: numbers(on_feature)?,
        };
        let Lists { offsets, items } = &mesh.faces;
        let faces = mesh.face_cells.len();
        let is_inside = |cell: u32| (cell as usize) < mesh.sites.len();
        let fits = offsets.len() == faces + 1
            && offsets.first() == Some(&0)
            && offsets.is_sorted()
            && offsets.last().map(|&end| end as usize) == Some(items.len())
            && items.iter().all(|&n| (n as usize) < mesh.nodes.len())
            && mesh.on_feature.len() == faces
            && mesh.region.len() == mesh.sites.len()
            && (mesh.face_cells.iter())
                .all(|&[a, b]| is_inside(a) && (is_inside(b) || b >= FIRST_SIDE));
        if fits {
            Ok(mesh)
        } else {
            Err(misfit("the faces of cells"))
        }
    }

    fn with_data<const D: usize, M: atomesh::mesh::Mesh<D>>(
        &self,
        mesh: M,
    ) -> PyResult<MeshFile<M>> {
        Ok(MeshFile {
            point_data: data_arrays(&self.point_data, mesh.nodes().len())?,
            cell_data: data_arrays(&self.cell_data, mesh.len())?,
            field_data: field_values(&self.fields)?,
            mesh,
        })
    }
}

/// Returns the error for arrays that do not fit together.
pub fn misfit(part: &str) -> PyErr {
    PyValueError::new_err(format!("{part} do not fit the other arrays"))
}

/// Returns the numbers of an array in C order.
pub fn numbers<T: Element + Copy>(array: &Bound<'_, PyAny>) -> PyResult<Vec<T>> {
    let array: PyReadonlyArrayDyn<'_, T> = array.extract()?;
    Ok(array.as_array().iter().copied().collect())
}

/// Returns the rows of an array of shape (n, N).
pub fn rows<T: Element + Copy, const N: usize>(array: &Bound<'_, PyAny>) -> PyResult<Vec<[T; N]>> {
    let shaped: PyReadonlyArrayDyn<'_, T> = array.extract()?;
    if shaped.shape().get(1..) != Some(&[N]) {
        return Err(misfit("the columns of an array"));
    }
    let numbers = numbers::<T>(array)?;
    Ok(numbers.as_chunks::<N>().0.to_vec())
}

/// Returns arrays with one tuple for each of `count` items.
pub fn data_arrays(named: &Named<'_>, count: usize) -> PyResult<Vec<DataArray>> {
    named
        .iter()
        .map(|(name, array)| data_array(name, array, count))
        .collect()
}

fn data_array(name: &str, array: &Bound<'_, PyAny>, count: usize) -> PyResult<DataArray> {
    macro_rules! first_of {
        ($($type:ident)*) => {
            $(if let Ok(typed) = array.cast::<PyArrayDyn<$type>>() {
                (Values::from(numbers::<$type>(array)?), typed.shape().to_vec())
            } else)* {
                let message = format!("the array {name} has numbers of an unknown type");
                return Err(PyTypeError::new_err(message));
            }
        };
    }
    let (values, shape) = first_of!(i8 u8 i16 u16 i32 u32 i64 u64 f32 f64);
    let components = match shape[..] {
        [length] if length == count => 1,
        [length, components] if length == count && components > 0 => components,
        _ => return Err(misfit(&format!("the tuples of the array {name}"))),
    };
    Ok(DataArray {
        name: name.to_string(),
        components,
        values,
    })
}

fn field_values(named: &Named<'_>) -> PyResult<Vec<(String, FieldValue)>> {
    let convert = |(name, value): &(String, Bound<'_, PyAny>)| {
        let value = if let Ok(text) = value.extract::<String>() {
            FieldValue::Text(text)
        } else if value.cast::<PyArrayDyn<i64>>().is_ok() {
            FieldValue::Ints(numbers(value)?)
        } else {
            FieldValue::F64s(numbers(value)?)
        };
        Ok((name.clone(), value))
    };
    named.iter().map(convert).collect()
}
