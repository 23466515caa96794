//! Cells of several shapes as polyhedra: tetrahedra, hexahedra, wedges, pyramids and prisms beside each other,
//! and cells that are lists of faces already.

use super::polyhedra::{CellFaces, node_means};
use crate::geometry::{dot, sub};
use crate::mesh::complex::NONE;
use crate::mesh::poly::PolyMesh;

/// VTK's number of a polyhedron.
const VTK_POLYHEDRON: i64 = 42;
/// VTK's numbers of vertices and lines, and of flat cells: triangles, polygons, quadrilaterals.
const VTK_LINE_TYPES: [i64; 4] = [1, 2, 3, 4];
const VTK_FLAT_TYPES: [i64; 3] = [5, 7, 9];

/// The number of corners of one of VTK's cells of fixed shape, and its faces.
fn fixed_shape(kind: i64) -> Option<(usize, &'static [&'static [usize]])> {
    Some(match kind {
        10 => (4, &[&[0, 1, 3], &[1, 2, 3], &[2, 0, 3], &[0, 2, 1]]),
        // Voxels, whose corners are in the order of samples.
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

/// Whether cells of VTK's types are solid, though not all are tetrahedra, perhaps with flat cells, lines and
/// vertices beside them.
pub(super) fn are_mixed(types: &[i64]) -> bool {
    let solid = |kind: &i64| *kind == VTK_POLYHEDRON || fixed_shape(*kind).is_some();
    let known =
        |kind: &i64| solid(kind) || VTK_FLAT_TYPES.contains(kind) || VTK_LINE_TYPES.contains(kind);
    types.iter().all(known) && types.iter().any(|kind| solid(kind) && *kind != 10)
}

/// What a cell of VTK's type is.
pub(super) enum MixedElement<'a> {
    /// A solid of fixed shape: the corners of its faces.
    Solid(&'static [&'static [usize]]),
    /// A polyhedron, whose faces are listed elsewhere.
    Polyhedron,
    /// A flat cell with these corners.
    Flat(&'a [u32]),
    /// Lines and vertices.
    Line,
}

/// What a cell is; `None` if it has not as many corners as cells of its type have.
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

/// Solid cells that are put together face by face.
#[derive(Default)]
pub(super) struct SolidAssembler {
    faces: CellFaces,
    count: u32,
}

impl SolidAssembler {
    /// Adds a cell with these faces, each the nodes round it in either sense.
    pub fn add(&mut self, faces: impl IntoIterator<Item = Vec<u32>>) {
        for ring in faces {
            self.faces.push(self.count, &ring);
        }
        self.count += 1;
    }

    /// The mesh, and for each of its nodes the number that it had: nodes of no cell are left out. Faces show
    /// outwards of their first cell, whatever sense they had.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn into_mesh(
        mut self,
        nodes: &[[f64; 3]],
    ) -> std::result::Result<(PolyMesh<3>, Vec<u32>), String> {
        let rings = &mut self.faces.rings;
        if rings.items.iter().any(|&n| n as usize >= nodes.len()) {
            return Err("has a cell of nodes that it does not have".into());
        }
        let mut place = vec![NONE; nodes.len()];
        rings.items.iter().for_each(|&n| place[n as usize] = 0);
        let mut kept = Vec::new();
        for (n, place) in (0..).zip(&mut place).filter(|(_, place)| **place == 0) {
            *place = kept.len() as u32;
            kept.push(n);
        }
        for n in &mut rings.items {
            *n = place[*n as usize];
        }
        let nodes: Vec<[f64; 3]> = kept.iter().map(|&n: &u32| nodes[n as usize]).collect();
        let count = self.count as usize;
        let mut mesh = (self.faces.into_mesh::<3>(nodes, count))
            .ok_or("has a face that more than two cells share")?;
        mesh.sites = node_means(&mesh, count);
        orient_outwards(&mut mesh);
        match find_unmatched_face(&mesh) {
            Some([one, other]) => Err(format!(
                "cells {one} and {other} meet with a face of more than three corners in one and a triangle in \
                 the other, so that nothing would pass between them"
            )),
            None => Ok((mesh, kept)),
        }
    }
}

/// Turns faces such that they show outwards of their first cell.
fn orient_outwards(mesh: &mut PolyMesh<3>) {
    for f in 0..mesh.face_cells.len() {
        let ring = mesh.faces.get(f);
        let x = |n: u32| mesh.nodes[n as usize];
        let inside = mesh.sites[mesh.face_cells[f][0] as usize];
        // Six times the volume of the face as seen from within.
        let seen: f64 = (2..ring.len())
            .map(|k| {
                let [a, b, c] = [ring[0], ring[k - 1], ring[k]].map(|n| sub(x(n), inside));
                dot(a, crate::geometry::cross(b, c))
            })
            .sum();
        if seen < 0.0 {
            let (begin, end) = (mesh.faces.offsets[f], mesh.faces.offsets[f + 1]);
            mesh.faces.items[begin as usize..end as usize].reverse();
        }
    }
}

/// Two cells of which one has a face, and the other a triangle that is a part of it.
fn find_unmatched_face(mesh: &PolyMesh<3>) -> Option<[u32; 2]> {
    let open = mesh.inner_face_count()..mesh.face_cells.len();
    let cell = |f: usize| mesh.face_cells[f][0];
    let sorted = |f: usize| {
        let mut nodes = mesh.faces.get(f).to_vec();
        nodes.sort_unstable();
        nodes
    };
    let triangles = open.clone().filter(|&f| mesh.faces.get(f).len() == 3);
    let mut triangles: Vec<(Vec<u32>, u32)> = triangles.map(|f| (sorted(f), cell(f))).collect();
    triangles.sort_unstable();
    let larger = open.filter(|&f| mesh.faces.get(f).len() == 4);
    larger.into_iter().find_map(|f| {
        let nodes = sorted(f);
        (0..4).find_map(|left_out| {
            let mut part = nodes.clone();
            part.remove(left_out);
            let at = triangles
                .binary_search_by(|known| known.0.cmp(&part))
                .ok()?;
            Some([cell(f), triangles[at].1])
        })
    })
}
