//! Finishes the mesh after improvement: determines its faces on features, and what blocks the cells
//! below target.

use crate::improve::constraint::common_sides;
use crate::parallel::prelude::*;

use super::TetImprover;
use crate::geometry::{cross, dot, norm, sub};
use crate::improve::BlockedCell;
use crate::improve::constraint::NodeConstraint;
use crate::improve::feature_planes::{FeaturePlanes, MAX_FACE_OFFSET, SAME_SURFACE_COSINE};
use crate::lattice::AtomKind;
use crate::mesh::complex::Complex;
use crate::mesh::quality::dihedral_angles;
use crate::mesh::{FACES, TetMesh};

/// A mesh after its improvement.
pub(super) struct ImprovedTets {
    pub mesh: TetMesh,
    pub neighbours: Vec<[u32; 4]>,
    pub kinds: Vec<AtomKind>,
    /// Index of each node during the improvement.
    pub old_ids: Vec<u32>,
    pub constraints: Vec<NodeConstraint>,
    pub feature_faces: Vec<u8>,
}

impl TetImprover<'_> {
    /// Returns the mesh with the kinds and constraints of its nodes, and its faces on features.
    /// `kinds` are those of the first nodes; the kinds of the others follow from their constraints.
    pub(super) fn finish(self, kinds: &[AtomKind]) -> ImprovedTets {
        let Self {
            complex,
            constraints,
            planes,
            ..
        } = self;
        let (mesh, neighbours, kept) = complex.into_mesh();
        let kinds = kept
            .iter()
            .map(|&i| match kinds.get(i as usize) {
                Some(&kind) => kind,
                None => match constraints[i as usize].fixed_axes.count_ones() {
                    0 => AtomKind::Interior,
                    1 => AtomKind::Side,
                    2 => AtomKind::Edge,
                    _ => AtomKind::Corner,
                },
            })
            .collect();
        let constraints: Vec<NodeConstraint> =
            kept.iter().map(|&i| constraints[i as usize]).collect();
        ImprovedTets {
            feature_faces: faces_on_surfaces(&mesh, &constraints, planes),
            mesh,
            neighbours,
            kinds,
            old_ids: kept,
            constraints,
        }
    }

    /// Returns `true` if all of the nodes lie in one side of the box whose faces may change.
    pub(super) fn is_in_side(&self, nodes: &[u32]) -> bool {
        self.common_sides(nodes) != 0
    }

    /// Returns the sides of the box in which all of the nodes lie, other than those whose faces do
    /// not change: bit k for a side normal to axis k.
    pub(super) fn common_sides(&self, nodes: &[u32]) -> u8 {
        let points = nodes.iter().map(|&n| self.complex.nodes[n as usize]);
        common_sides(points, self.extent) & !self.frozen_axes
    }
}

/// Returns the faces of every tetrahedron that lie on a feature: bit k for face k (opposite node
/// k).
pub(super) fn faces_on_surfaces(
    mesh: &TetMesh,
    constraints: &[NodeConstraint],
    planes: &FeaturePlanes,
) -> Vec<u8> {
    (0..mesh.tets.len())
        .into_par_iter()
        .map(|t| faces_on_features(mesh, t, constraints, planes))
        .collect()
}

/// Returns the faces of tetrahedron `t` that lie on a feature: one surface holds their nodes, they
/// are parallel to it, and their centroid lies on it, too.
fn faces_on_features(
    mesh: &TetMesh,
    t: usize,
    constraints: &[NodeConstraint],
    planes: &FeaturePlanes,
) -> u8 {
    let tet = mesh.tets[t];
    if tet
        .iter()
        .filter(|&&n| constraints[n as usize].surface_count > 0)
        .count()
        < 3
    {
        return 0;
    }
    let on_feature = |k: usize| {
        let [a, b, c] = FACES[k].map(|i| tet[i] as usize);
        let [x, y, z] = [a, b, c].map(|n| mesh.nodes[n]);
        let normal = cross(sub(y, x), sub(z, x));
        let length = norm(normal);
        let along = |n: [f64; 3]| dot(n, normal).abs() > SAME_SURFACE_COSINE * length;
        if !constraints[a]
            .normals()
            .any(|n| along(n) && constraints[b].is_on_surface(n) && constraints[c].is_on_surface(n))
        {
            return false;
        }
        let centroid = std::array::from_fn(|i| (x[i] + y[i] + z[i]) / 3.0);
        let nearby = planes.planes_near(centroid);
        nearby
            .iter()
            .any(|s| s.offset.abs() < MAX_FACE_OFFSET && along(s.normal))
    };
    (0..4)
        .filter(|&k| on_feature(k))
        .fold(0, |bits, k| bits | 1 << k)
}

impl TetImprover<'_> {
    /// Returns the tetrahedra below target and what may block them, the worst first.
    pub(super) fn blocked_cells(&self) -> Vec<BlockedCell> {
        let mut below_target = self.tets_below_target();
        below_target.sort_by(|a, b| self.sine_of(*a).total_cmp(&self.sine_of(*b)).then(a.cmp(b)));
        let Complex { nodes, tets, .. } = &self.complex;
        blocked_cells(nodes, tets, &self.constraints, &below_target)
    }
}

/// Returns what may block the tetrahedra in `slots`, in that order.
pub(super) fn blocked_cells(
    nodes: &[[f64; 3]],
    tets: &[[u32; 4]],
    constraints: &[NodeConstraint],
    slots: &[u32],
) -> Vec<BlockedCell> {
    slots
        .iter()
        .map(|&t| {
            let tet = tets[t as usize];
            let p = tet.map(|n| nodes[n as usize]);
            let constraints = tet.map(|n| constraints[n as usize]);
            BlockedCell::new(&p, &dihedral_angles(&p), &constraints, 7)
        })
        .collect()
}
