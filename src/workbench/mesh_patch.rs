//! The nodes, cells and values that an action changed in a mesh, for those who show it.

use serde_json::{Value, json};

use super::mesh_change::{MeshChange, SimplexChange, SimplexLists};
use crate::files::vtk::DataArray;
use crate::mesh_file::{AnyMesh, MeshFile, with_mesh};

/// The nodes, cells and values of cells that an action changed.
///
/// Cells and nodes keep their numbers, except that the last ones take the numbers of those that are
/// removed. So a picture of the mesh is brought up to date by setting the changed ones, and cutting off
/// those beyond the new counts.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct MeshPatch {
    /// The name of the mesh.
    pub mesh: String,
    /// Number of coordinates of a node; 0 if there is no mesh any more.
    pub dimensions: usize,
    /// Numbers of nodes before and after the action.
    pub node_count: [usize; 2],
    /// Numbers of cells before and after the action.
    pub cell_count: [usize; 2],
    /// Ascending numbers of nodes that moved or are new.
    pub nodes: Vec<u32>,
    /// Their positions, in physical coordinates.
    pub positions: Vec<f64>,
    /// Ascending numbers of cells that have other nodes or are new. Empty for polygons and polyhedra.
    pub cells: Vec<u32>,
    /// Their nodes, `dimensions` + 1 of each cell.
    pub corners: Vec<u32>,
    /// Changes of the values of cells.
    pub cell_arrays: Vec<ArrayPatch>,
    /// Changes of the values of nodes.
    pub node_arrays: Vec<ArrayPatch>,
    /// Names of all arrays that the mesh has with one value of each cell.
    pub cell_array_names: Vec<String>,
    /// Names of all arrays that the mesh has with one value of each node.
    pub node_array_names: Vec<String>,
}

/// Values of cells or nodes that an action changed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ArrayPatch {
    /// The name of the array, such as `region`.
    pub name: String,
    /// Ascending numbers of the cells or nodes.
    pub indices: Vec<u32>,
    /// Their values.
    pub values: Vec<f32>,
}

impl MeshPatch {
    /// Returns what the last exchange of `change` did to the mesh of this name, of which `mesh` is the
    /// present state.
    pub(super) fn new(name: &str, change: &MeshChange, mesh: Option<&AnyMesh>) -> Self {
        let mut patch = Self {
            mesh: name.into(),
            ..Self::default()
        };
        match (change, mesh) {
            (MeshChange::Triangles(change), Some(AnyMesh::Triangles(file))) => {
                patch.add_changes(change, file);
            }
            (MeshChange::Tetrahedra(change), Some(AnyMesh::Tetrahedra(file))) => {
                patch.add_changes(change, file);
            }
            (MeshChange::Other(before), _) => {
                let counts = |mesh: Option<&AnyMesh>| mesh.map_or([0, 0], sizes);
                let [before, after] = [counts(before.as_deref()), counts(mesh)];
                patch.node_count = [before[0], after[0]];
                patch.cell_count = [before[1], after[1]];
                match mesh {
                    Some(AnyMesh::Triangles(file)) => patch.add_all(file),
                    Some(AnyMesh::Tetrahedra(file)) => patch.add_all(file),
                    Some(AnyMesh::Polygons(_)) => patch.dimensions = 2,
                    Some(AnyMesh::Polyhedra(_)) => patch.dimensions = 3,
                    None => {}
                }
            }
            _ => {}
        }
        patch
    }

    /// Adds what a change did to a mesh of simplices.
    fn add_changes<const D: usize, const C: usize, M: SimplexLists<D, C>>(
        &mut self,
        change: &SimplexChange<D, C>,
        file: &MeshFile<M>,
    ) {
        let (nodes, cells) = file.mesh.lists();
        self.node_count = change.nodes.counts(nodes.len());
        self.cell_count = change.cells.counts(cells.len());
        self.nodes = change.nodes.changed(nodes.len());
        self.cells = change.cells.changed(cells.len());
        self.add_lists(file);
        self.add_arrays(
            file,
            |i| change.point_data.changed(i, nodes.len()),
            |i| change.cell_data.changed(i, cells.len()),
        );
    }

    /// Adds a whole mesh of simplices.
    fn add_all<const D: usize, const C: usize, M: SimplexLists<D, C>>(
        &mut self,
        file: &MeshFile<M>,
    ) {
        let (nodes, cells) = file.mesh.lists();
        self.nodes = (0..nodes.len() as u32).collect();
        self.cells = (0..cells.len() as u32).collect();
        self.add_lists(file);
        let (node_indices, cell_indices) = (self.nodes.clone(), self.cells.clone());
        self.add_arrays(file, |_| node_indices.clone(), |_| cell_indices.clone());
    }

    /// Adds the positions of the changed nodes, and the nodes of the changed cells.
    fn add_lists<const D: usize, const C: usize, M: SimplexLists<D, C>>(
        &mut self,
        file: &MeshFile<M>,
    ) {
        let (nodes, cells) = file.mesh.lists();
        self.dimensions = D;
        let position = |&n: &u32| nodes[n as usize];
        self.positions = self.nodes.iter().flat_map(position).collect();
        let corners = |&c: &u32| cells[c as usize];
        self.corners = self.cells.iter().flat_map(corners).collect();
    }

    /// Adds the values of each array at the nodes and cells that changed in it.
    fn add_arrays<M>(
        &mut self,
        file: &MeshFile<M>,
        changed_nodes: impl Fn(usize) -> Vec<u32>,
        changed_cells: impl Fn(usize) -> Vec<u32>,
    ) {
        (self.node_arrays, self.node_array_names) = array_patches(&file.point_data, changed_nodes);
        (self.cell_arrays, self.cell_array_names) = array_patches(&file.cell_data, changed_cells);
    }

    /// Returns how many nodes, cells and values changed, as JSON.
    pub fn to_json(&self) -> Value {
        let arrays = self.cell_arrays.iter();
        let arrays = arrays.map(|array| (array.name.clone(), array.indices.len().into()));
        json!({
            "mesh": self.mesh,
            "nodes": self.node_count,
            "cells": self.cell_count,
            "changed_nodes": self.nodes.len(),
            "changed_cells": self.cells.len(),
            "changed_values": arrays.collect::<serde_json::Map<_, _>>(),
        })
    }
}

/// Returns the values that changed in each array of one value each, and the names of these arrays.
fn array_patches(
    arrays: &[DataArray],
    changed: impl Fn(usize) -> Vec<u32>,
) -> (Vec<ArrayPatch>, Vec<String>) {
    let (mut patches, mut names) = (Vec::new(), Vec::new());
    for (i, array) in arrays.iter().enumerate() {
        if array.components != 1 {
            continue;
        }
        names.push(array.name.clone());
        let indices = changed(i);
        if !indices.is_empty() {
            patches.push(ArrayPatch {
                name: array.name.clone(),
                values: array.values.select_tuples(&indices, 1).to_f32(),
                indices,
            });
        }
    }
    (patches, names)
}

/// Returns the numbers of nodes and cells of a mesh.
fn sizes(mesh: &AnyMesh) -> [usize; 2] {
    use crate::mesh::Mesh;
    with_mesh!(mesh, file => [file.mesh.nodes().len(), file.mesh.len()])
}
