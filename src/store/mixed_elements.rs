//! Builds polyhedra from cells of several shapes (tetrahedra, hexahedra, wedges, pyramids and
//! prisms in one mesh) and from cells that are lists of faces.

use super::polyhedra::{CellFaces, node_means};
use crate::geometry::{dot, sorted, sub};
use crate::mesh::poly::PolyMesh;
use crate::mesh::renumber::{new_numbers, used_items};

/// VTK's type of polyhedra.
const VTK_POLYHEDRON: i64 = 42;
/// VTK's types of vertices and lines, and of flat cells: triangles, polygons, quadrilaterals.
const VTK_LINE_TYPES: [i64; 4] = [1, 2, 3, 4];
const VTK_FLAT_TYPES: [i64; 3] = [5, 7, 9];

/// Returns the number of corners and the faces of one of VTK's cells of fixed shape.
fn fixed_shape(kind: i64) -> Option<(usize, &'static [&'static [usize]])> {
    Some(match kind {
        10 => (4, &[&[0, 1, 3], &[1, 2, 3], &[2, 0, 3], &[0, 2, 1]]),
        // Voxels have their corners in the order of samples.
        11 => (
            8,
            &[
                &[0, 4, 6, 2],
                &[1, 3, 7, 5],
                &[0, 1, 5, 4],
                &[2, 6, 7, 3],
                &[0, 2, 3, 1],
                &[4, 5, 7, 6],
            ],
        ),
        12 => (
            8,
            &[
                &[0, 4, 7, 3],
                &[1, 2, 6, 5],
                &[0, 1, 5, 4],
                &[3, 7, 6, 2],
                &[0, 3, 2, 1],
                &[4, 5, 6, 7],
            ],
        ),
        13 => (
            6,
            &[
                &[0, 1, 2],
                &[3, 5, 4],
                &[0, 3, 4, 1],
                &[1, 4, 5, 2],
                &[2, 5, 3, 0],
            ],
        ),
        14 => (
            5,
            &[
                &[0, 3, 2, 1],
                &[0, 1, 4],
                &[1, 2, 4],
                &[2, 3, 4],
                &[3, 0, 4],
            ],
        ),
        _ => return None,
    })
}

/// Returns `true` if all cells are of known VTK types and at least one is a solid other than a
/// tetrahedron. Flat cells, lines and vertices may be present.
pub(super) fn are_mixed(types: &[i64]) -> bool {
    let is_solid = |kind: &i64| *kind == VTK_POLYHEDRON || fixed_shape(*kind).is_some();
    let is_known = |kind: &i64| {
        is_solid(kind) || VTK_FLAT_TYPES.contains(kind) || VTK_LINE_TYPES.contains(kind)
    };
    types.iter().all(is_known) && types.iter().any(|kind| is_solid(kind) && *kind != 10)
}

/// A cell of a mesh with several cell types.
pub(super) enum MixedElement<'a> {
    /// A solid of fixed shape, with the corners of its faces.
    Solid(&'static [&'static [usize]]),
    /// A polyhedron, whose faces are stored in another array.
    Polyhedron,
    /// A flat cell with its corners.
    Flat(&'a [u32]),
    /// A line or a vertex.
    Line,
}

/// Returns the kind of a cell, or `None` if it does not have the number of corners of its type.
pub(super) fn mixed_element(kind: i64, corners: &[u32]) -> Option<MixedElement<'_>> {
    if let Some((count, faces)) = fixed_shape(kind) {
        return (corners.len() == count).then_some(MixedElement::Solid(faces));
    }
    Some(match kind {
        VTK_POLYHEDRON => MixedElement::Polyhedron,
        _ if VTK_FLAT_TYPES.contains(&kind) => MixedElement::Flat(corners),
        _ => MixedElement::Line,
    })
}

/// Builds a mesh from solid cells, face by face.
#[derive(Default)]
pub(super) struct SolidAssembler {
    faces: CellFaces,
    count: u32,
}

impl SolidAssembler {
    /// Adds a cell with these faces, each with its nodes in order, in either orientation.
    pub fn add(&mut self, faces: impl IntoIterator<Item = Vec<u32>>) {
        for ring in faces {
            self.faces.push(self.count, &ring);
        }
        self.count += 1;
    }

    /// Returns the mesh, and the old number of each of its nodes; nodes of no cell are removed.
    /// Faces are oriented outwards from their first cell, whatever orientation they had.
    ///
    /// # Errors
    /// Returns the problem if cells use nodes that do not exist or do not match.
    pub fn into_mesh(
        mut self,
        nodes: &[[f64; 3]],
    ) -> std::result::Result<(PolyMesh<3>, Vec<u32>), String> {
        let rings = &mut self.faces.rings;
        if rings.items.iter().any(|&n| n as usize >= nodes.len()) {
            return Err("has a cell with a node that does not exist".into());
        }
        let kept = used_items(nodes.len(), rings.items.iter().copied());
        let new_index = new_numbers(nodes.len(), &kept);
        for n in &mut rings.items {
            *n = new_index[*n as usize];
        }
        let nodes: Vec<[f64; 3]> = kept.iter().map(|&n| nodes[n as usize]).collect();
        let count = self.count as usize;
        let mut mesh = (self.faces.to_mesh::<3>(nodes, count))
            .ok_or("has a face that more than two cells share")?;
        mesh.sites = node_means(&mesh, count);
        orient_outwards(&mut mesh);
        match find_unmatched_face(&mesh) {
            Some([first, second]) => Err(format!(
                "cells {first} and {second} meet with a face of more than three corners in one and a triangle in \
                 the other, so that nothing would pass between them"
            )),
            None => Ok((mesh, kept)),
        }
    }
}

/// Orients all faces outwards from their first cell.
fn orient_outwards(mesh: &mut PolyMesh<3>) {
    for f in 0..mesh.face_cells.len() {
        let ring = mesh.faces.get(f);
        let x = |n: u32| mesh.nodes[n as usize];
        let site = mesh.sites[mesh.face_cells[f][0] as usize];
        // Six times the volume between the site and the face.
        let volume6: f64 = (2..ring.len())
            .map(|k| {
                let [a, b, c] = [ring[0], ring[k - 1], ring[k]].map(|n| sub(x(n), site));
                dot(a, crate::geometry::cross(b, c))
            })
            .sum();
        if volume6 < 0.0 {
            let (begin, end) = (mesh.faces.offsets[f], mesh.faces.offsets[f + 1]);
            mesh.faces.items[begin as usize..end as usize].reverse();
        }
    }
}

/// Returns two cells, one with a quadrilateral face on the boundary, and the other with a triangle
/// that covers a part of it, if there are such cells.
fn find_unmatched_face(mesh: &PolyMesh<3>) -> Option<[u32; 2]> {
    let boundary = mesh.inner_face_count()..mesh.face_cells.len();
    let cell = |f: usize| mesh.face_cells[f][0];
    let sorted_nodes = |f: usize| sorted(mesh.faces.get(f).to_vec());
    let triangles = boundary.clone().filter(|&f| mesh.faces.get(f).len() == 3);
    let triangles: Vec<(Vec<u32>, u32)> =
        sorted(triangles.map(|f| (sorted_nodes(f), cell(f))).collect());
    let larger = boundary.filter(|&f| mesh.faces.get(f).len() == 4);
    larger.into_iter().find_map(|f| {
        let nodes = sorted_nodes(f);
        (0..4).find_map(|omitted| {
            let mut triangle = nodes.clone();
            triangle.remove(omitted);
            let index = triangles
                .binary_search_by(|known| known.0.cmp(&triangle))
                .ok()?;
            Some([cell(f), triangles[index].1])
        })
    })
}
