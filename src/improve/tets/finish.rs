//! The mesh at the end: which of its faces lie on features, and what blocks what is still poor.

use crate::parallel::prelude::*;

use super::Improver;
use crate::geometry::{cross, dot, norm, sub};
use crate::improve::Blocked;
use crate::improve::hold::Hold;
use crate::improve::sheets::{FACE_ON_SHEET, SAME_SHEET, Sheets};
use crate::lattice::AtomKind;
use crate::mesh::complex::Complex;
use crate::mesh::quality::dihedral_angles;
use crate::mesh::{FACES, TetMesh};

/// A mesh whose improvement is over.
pub(super) struct Finished {
    pub mesh: TetMesh,
    pub neighbors: Vec<[u32; 4]>,
    pub kinds: Vec<AtomKind>,
    /// The number that each node had while the mesh was improved.
    pub kept: Vec<u32>,
    pub holds: Vec<Hold>,
    pub feature_faces: Vec<u8>,
}

impl Improver<'_> {
    /// The mesh, and what is known of its nodes and faces; `kinds` are those of the first nodes.
    pub(super) fn finish(self, kinds: &[AtomKind]) -> Finished {
        let Self {
            complex,
            holds,
            sheets,
            ..
        } = self;
        let (mesh, neighbors, kept) = complex.into_mesh();
        let kinds = kept
            .iter()
            .map(|&i| match kinds.get(i as usize) {
                Some(&kind) => kind,
                None => match holds[i as usize].axes.count_ones() {
                    0 => AtomKind::Interior,
                    1 => AtomKind::Side,
                    2 => AtomKind::Edge,
                    _ => AtomKind::Corner,
                },
            })
            .collect();
        let holds: Vec<Hold> = kept.iter().map(|&i| holds[i as usize]).collect();
        Finished {
            feature_faces: faces_on_sheets(&mesh, &holds, sheets),
            mesh,
            neighbors,
            kinds,
            kept,
            holds,
        }
    }

    /// Whether nodes lie in one side of the box.
    pub(super) fn in_side(&self, nodes: &[u32]) -> bool {
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
pub(super) fn faces_on_sheets(mesh: &TetMesh, holds: &[Hold], sheets: &Sheets) -> Vec<u8> {
    (0..mesh.tets.len())
        .into_par_iter()
        .map(|t| faces_on_features(mesh, t, holds, sheets))
        .collect()
}

/// Which faces of tetrahedron `t` lie on a feature: their nodes are held by one sheet, they lie along
/// it, and their centroid is on it too.
fn faces_on_features(mesh: &TetMesh, t: usize, holds: &[Hold], sheets: &Sheets) -> u8 {
    let tet = mesh.tets[t];
    if tet.iter().filter(|&&n| holds[n as usize].count > 0).count() < 3 {
        return 0;
    }
    let on_feature = |k: usize| {
        let [a, b, c] = FACES[k].map(|i| tet[i] as usize);
        let [x, y, z] = [a, b, c].map(|n| mesh.nodes[n]);
        let normal = cross(sub(y, x), sub(z, x));
        let length = norm(normal);
        let along = |n: [f64; 3]| dot(n, normal).abs() > SAME_SHEET * length;
        if !holds[a]
            .normals()
            .any(|n| along(n) && holds[b].on(n) && holds[c].on(n))
        {
            return false;
        }
        let centroid = std::array::from_fn(|i| (x[i] + y[i] + z[i]) / 3.0);
        let near = sheets.near(centroid);
        near.iter()
            .any(|s| s.offset.abs() < FACE_ON_SHEET && along(s.normal))
    };
    (0..4)
        .filter(|&k| on_feature(k))
        .fold(0, |bits, k| bits | 1 << k)
}

impl Improver<'_> {
    /// What blocks the tetrahedra below target.
    pub(super) fn blocked(&self) -> Vec<Blocked> {
        let mut poor = self.poor();
        poor.sort_by(|a, b| self.sine_of(*a).total_cmp(&self.sine_of(*b)).then(a.cmp(b)));
        let Complex { nodes, tets, .. } = &self.complex;
        blocked(nodes, tets, &self.holds, &poor)
    }
}

/// What blocks the tetrahedra `poor`, in that order.
pub(super) fn blocked(
    nodes: &[[f64; 3]],
    tets: &[[u32; 4]],
    holds: &[Hold],
    poor: &[u32],
) -> Vec<Blocked> {
    poor.iter()
        .map(|&t| {
            let tet = tets[t as usize];
            let p = tet.map(|n| nodes[n as usize]);
            let holds = tet.map(|n| holds[n as usize]);
            Blocked::new(&p, &dihedral_angles(&p), &holds, 7)
        })
        .collect()
}
