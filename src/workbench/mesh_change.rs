//! The difference between two states of a mesh.
//!
//! A change holds what the other state has where the two differ. To apply it, it is exchanged with
//! the mesh: the change then leads back. So one value serves to undo and to redo an action, and takes
//! memory for what differs alone. Numbers are compared by their bits.

use std::sync::Arc;

use crate::files::vtk::{DataArray, Values};
use crate::mesh::{TetMesh, TriMesh};
use crate::mesh_file::{AnyMesh, FieldValue, MeshFile};

/// Values that are compared by their bits: 0 and -0 differ, and a NaN equals itself.
pub(super) trait SameBits: Copy {
    /// Returns `true` if both values have the same bits.
    fn has_bits_of(&self, other: &Self) -> bool;
}

macro_rules! same_bits {
    ($($type:ty),*) => {$(
        impl SameBits for $type {
            fn has_bits_of(&self, other: &Self) -> bool {
                self.to_ne_bytes() == other.to_ne_bytes()
            }
        }
    )*};
}

same_bits!(i8, u8, i16, u16, i32, u32, i64, u64, f32, f64);

impl<T: SameBits, const N: usize> SameBits for [T; N] {
    fn has_bits_of(&self, other: &Self) -> bool {
        self.iter().zip(other).all(|(a, b)| a.has_bits_of(b))
    }
}

/// The difference between two lists.
#[derive(Debug)]
pub(super) struct ListChange<T> {
    /// Number of elements that both lists have.
    common: usize,
    /// Ascending indices of the common elements that differ.
    indices: Vec<u32>,
    /// These elements in the other list.
    others: Vec<T>,
    /// The elements of the other list after the common ones.
    tail: Vec<T>,
}

impl<T: SameBits> ListChange<T> {
    /// Compares a list with its `other` state.
    fn between(list: &[T], other: &[T]) -> Self {
        let common = list.len().min(other.len());
        let differs = |i: &u32| !list[*i as usize].has_bits_of(&other[*i as usize]);
        let indices: Vec<u32> = (0..common as u32).filter(differs).collect();
        Self {
            common,
            others: indices.iter().map(|&i| other[i as usize]).collect(),
            indices,
            tail: other[common..].to_vec(),
        }
    }

    /// Turns the list into its other state, and this into the change that leads back.
    fn exchange(&mut self, list: &mut Vec<T>) {
        for (&i, other) in self.indices.iter().zip(&mut self.others) {
            std::mem::swap(&mut list[i as usize], other);
        }
        let own_tail = list.split_off(self.common);
        list.append(&mut self.tail);
        self.tail = own_tail;
    }

    /// Returns the lengths of the other list and of the present one, which has `len` elements.
    pub(super) fn counts(&self, len: usize) -> [usize; 2] {
        [self.common + self.tail.len(), len]
    }

    /// Returns the indices in the present list, of `len` elements, that the last exchange changed.
    pub(super) fn changed(&self, len: usize) -> Vec<u32> {
        let added = self.common as u32..len as u32;
        self.indices.iter().copied().chain(added).collect()
    }
}

macro_rules! values_change {
    ($($variant:ident $type:ty),*) => {
        /// The difference between the numbers of two arrays of the same type.
        #[derive(Debug)]
        pub(super) enum ValuesChange {
            $($variant(ListChange<$type>),)*
        }

        impl ValuesChange {
            /// Compares numbers with their `other` state; returns `None` if the types differ.
            fn between(values: &Values, other: &Values) -> Option<Self> {
                match (values, other) {
                    $((Values::$variant(values), Values::$variant(other)) => {
                        Some(Self::$variant(ListChange::between(values, other)))
                    })*
                    _ => None,
                }
            }

            /// Exchanges the states, as [`ListChange::exchange`] does. The type must be the same.
            fn exchange(&mut self, values: &mut Values) {
                match (self, values) {
                    $((Self::$variant(change), Values::$variant(values)) => change.exchange(values),)*
                    _ => {}
                }
            }

            /// Returns the indices that the last exchange changed, as [`ListChange::changed`] does.
            fn changed(&self, len: usize) -> Vec<u32> {
                match self {
                    $(Self::$variant(change) => change.changed(len),)*
                }
            }
        }
    };
}

values_change!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64);

/// The difference between two lists of arrays.
#[derive(Debug)]
pub(super) enum ArraysChange {
    /// Numbers of the same arrays.
    Values(Vec<ValuesChange>),
    /// The arrays of the other state, of which some have other names or types.
    Other(Vec<DataArray>),
}

impl ArraysChange {
    fn between(arrays: &[DataArray], other: &[DataArray]) -> Self {
        let has_same_layout = arrays.len() == other.len()
            && (arrays.iter().zip(other))
                .all(|(a, b)| a.name == b.name && a.components == b.components);
        let pairs = || arrays.iter().zip(other);
        let compare =
            |(a, b): (&DataArray, &DataArray)| ValuesChange::between(&a.values, &b.values);
        has_same_layout
            .then(|| pairs().map(compare).collect::<Option<Vec<_>>>())
            .flatten()
            .map_or_else(|| Self::Other(other.to_vec()), Self::Values)
    }

    /// Returns the indices that the last exchange changed in array `i`, of `len` values.
    pub(super) fn changed(&self, i: usize, len: usize) -> Vec<u32> {
        match self {
            Self::Values(changes) => changes[i].changed(len),
            Self::Other(_) => (0..len as u32).collect(),
        }
    }

    fn exchange(&mut self, arrays: &mut Vec<DataArray>) {
        match self {
            Self::Values(changes) => {
                for (change, array) in changes.iter_mut().zip(arrays) {
                    change.exchange(&mut array.values);
                }
            }
            Self::Other(other) => std::mem::swap(other, arrays),
        }
    }
}

/// A mesh of simplices as lists of nodes and cells, which have `C` nodes each.
pub(super) trait SimplexLists<const D: usize, const C: usize> {
    /// Returns the nodes and the cells.
    fn lists(&self) -> (&[[f64; D]], &[[u32; C]]);

    /// Returns the nodes and the cells.
    fn lists_mut(&mut self) -> (&mut Vec<[f64; D]>, &mut Vec<[u32; C]>);
}

macro_rules! simplex_lists {
    ($mesh:ty, $dimensions:literal, $corners:literal, $cells:ident) => {
        impl SimplexLists<$dimensions, $corners> for $mesh {
            fn lists(&self) -> (&[[f64; $dimensions]], &[[u32; $corners]]) {
                (&self.nodes, &self.$cells)
            }

            fn lists_mut(&mut self) -> (&mut Vec<[f64; $dimensions]>, &mut Vec<[u32; $corners]>) {
                (&mut self.nodes, &mut self.$cells)
            }
        }
    };
}

simplex_lists!(TriMesh, 2, 3, triangles);
simplex_lists!(TetMesh, 3, 4, tets);

/// The difference between two states of a mesh of simplices.
#[derive(Debug)]
pub(super) struct SimplexChange<const D: usize, const C: usize> {
    pub(super) nodes: ListChange<[f64; D]>,
    pub(super) cells: ListChange<[u32; C]>,
    pub(super) point_data: ArraysChange,
    pub(super) cell_data: ArraysChange,
    field_data: Vec<(String, FieldValue)>,
}

impl<const D: usize, const C: usize> SimplexChange<D, C> {
    fn between<M: SimplexLists<D, C>>(mesh: &MeshFile<M>, other: &MeshFile<M>) -> Self {
        let ((nodes, cells), (other_nodes, other_cells)) = (mesh.mesh.lists(), other.mesh.lists());
        Self {
            nodes: ListChange::between(nodes, other_nodes),
            cells: ListChange::between(cells, other_cells),
            point_data: ArraysChange::between(&mesh.point_data, &other.point_data),
            cell_data: ArraysChange::between(&mesh.cell_data, &other.cell_data),
            field_data: other.field_data.clone(),
        }
    }

    fn exchange<M: SimplexLists<D, C>>(&mut self, mesh: &mut MeshFile<M>) {
        let (nodes, cells) = mesh.mesh.lists_mut();
        self.nodes.exchange(nodes);
        self.cells.exchange(cells);
        self.point_data.exchange(&mut mesh.point_data);
        self.cell_data.exchange(&mut mesh.cell_data);
        std::mem::swap(&mut self.field_data, &mut mesh.field_data);
    }
}

/// The difference between two states of a mesh, either of which may be that there is no mesh.
#[derive(Debug)]
pub(super) enum MeshChange {
    /// Both are meshes of triangles.
    Triangles(SimplexChange<2, 3>),
    /// Both are meshes of tetrahedra.
    Tetrahedra(SimplexChange<3, 4>),
    /// The other state as a whole.
    Other(Option<Arc<AnyMesh>>),
}

impl MeshChange {
    /// Compares a mesh with its `other` state.
    pub(super) fn between(mesh: &AnyMesh, other: Option<Arc<AnyMesh>>) -> Self {
        match (mesh, other.as_deref()) {
            (AnyMesh::Triangles(mesh), Some(AnyMesh::Triangles(other))) => {
                Self::Triangles(SimplexChange::between(mesh, other))
            }
            (AnyMesh::Tetrahedra(mesh), Some(AnyMesh::Tetrahedra(other))) => {
                Self::Tetrahedra(SimplexChange::between(mesh, other))
            }
            _ => Self::Other(other),
        }
    }

    /// Turns a mesh into its other state, and this into the change that leads back.
    pub(super) fn exchange(&mut self, mesh: &mut Option<Arc<AnyMesh>>) {
        if let Self::Other(other) = self {
            return std::mem::swap(other, mesh);
        }
        match (self, mesh.as_mut().map(Arc::make_mut)) {
            (Self::Triangles(change), Some(AnyMesh::Triangles(mesh))) => change.exchange(mesh),
            (Self::Tetrahedra(change), Some(AnyMesh::Tetrahedra(mesh))) => change.exchange(mesh),
            _ => {}
        }
    }
}
