//! The mesh at the end: which of its faces lie on features, and what blocks what is still poor.

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

/// A mesh whose improvement is over.
pub(super) struct ImprovedTets {
    pub mesh: TetMesh,
    pub neighbors: Vec<[u32; 4]>,
    pub kinds: Vec<AtomKind>,
    /// The number that each node had while the mesh was improved.
    pub old_ids: Vec<u32>,
    pub constraints: Vec<NodeConstraint>,
    pub feature_faces: Vec<u8>,
}

impl TetImprover<'_> {
    /// The mesh, and what is known of its nodes and faces; `kinds` are those of the first nodes.
    pub(super) fn finish(self, kinds: &[AtomKind]) -> ImprovedTets {
        let Self {
            complex,
            constraints: holds,
            planes: sheets,
            ..
        } = self;
        let (mesh, neighbors, kept) = complex.into_mesh();
        let kinds = kept
            .iter()
            .map(|&i| match kinds.get(i as usize) {
                Some(&kind) => kind,
                None => match holds[i as usize].fixed_axes.count_ones() {
                    0 => AtomKind::Interior,
                    1 => AtomKind::Side,
                    2 => AtomKind::Edge,
                    _ => AtomKind::Corner,
                },
            })
            .collect();
        let holds: Vec<NodeConstraint> = kept.iter().map(|&i| holds[i as usize]).collect();
        ImprovedTets {
            feature_faces: faces_on_surfaces(&mesh, &holds, sheets),
            mesh,
            neighbors,
            kinds,
            old_ids: kept,
            constraints: holds,
        }
    }

    /// Whether nodes lie in one side of the box.
    pub(super) fn is_in_side(&self, nodes: &[u32]) -> bool {
        self.common_sides(nodes) != 0
    }

    /// The sides in which all of the nodes lie: bit k for those normal to axis k.
    pub(super) fn common_sides(&self, nodes: &[u32]) -> u8 {
        let within = |&k: &usize| {
            let mut at = nodes.iter().map(|&n| self.complex.nodes[n as usize][k]);
            let first = at.next().unwrap_or(f64::NAN);
            (first == 0.0 || first == self.extent[k]) && at.all(|x| x == first)
        };
        (0..3).filter(within).fold(0, |bits, k| bits | 1 << k)
    }
}

/// For every tetrahedron which of its faces lie on a feature: bit k for face k (opposite node k).
pub(super) fn faces_on_surfaces(
    mesh: &TetMesh,
    holds: &[NodeConstraint],
    sheets: &FeaturePlanes,
) -> Vec<u8> {
    (0..mesh.tets.len())
        .into_par_iter()
        .map(|t| faces_on_features(mesh, t, holds, sheets))
        .collect()
}

/// Which faces of tetrahedron `t` lie on a feature: their nodes are held by one sheet, they lie along
/// it, and their centroid is on it too.
fn faces_on_features(
    mesh: &TetMesh,
    t: usize,
    holds: &[NodeConstraint],
    sheets: &FeaturePlanes,
) -> u8 {
    let tet = mesh.tets[t];
    if tet
        .iter()
        .filter(|&&n| holds[n as usize].surface_count > 0)
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
        if !holds[a]
            .normals()
            .any(|n| along(n) && holds[b].is_on_surface(n) && holds[c].is_on_surface(n))
        {
            return false;
        }
        let centroid = std::array::from_fn(|i| (x[i] + y[i] + z[i]) / 3.0);
        let near = sheets.planes_near(centroid);
        near.iter()
            .any(|s| s.offset.abs() < MAX_FACE_OFFSET && along(s.normal))
    };
    (0..4)
        .filter(|&k| on_feature(k))
        .fold(0, |bits, k| bits | 1 << k)
}

impl TetImprover<'_> {
    /// What blocks the tetrahedra below target.
    pub(super) fn blocked_cells(&self) -> Vec<BlockedCell> {
        let mut poor = self.tets_below_target();
        poor.sort_by(|a, b| self.sine_of(*a).total_cmp(&self.sine_of(*b)).then(a.cmp(b)));
        let Complex { nodes, tets, .. } = &self.complex;
        blocked_cells(nodes, tets, &self.constraints, &poor)
    }
}

/// What blocks the tetrahedra `poor`, in that order.
pub(super) fn blocked_cells(
    nodes: &[[f64; 3]],
    tets: &[[u32; 4]],
    holds: &[NodeConstraint],
    poor: &[u32],
) -> Vec<BlockedCell> {
    poor.iter()
        .map(|&t| {
            let tet = tets[t as usize];
            let p = tet.map(|n| nodes[n as usize]);
            let holds = tet.map(|n| holds[n as usize]);
            BlockedCell::new(&p, &dihedral_angles(&p), &holds, 7)
        })
        .collect()
}
