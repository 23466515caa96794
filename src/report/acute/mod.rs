//! Finds acute lines: lines at which two faces, each on a feature or on a side of the box, meet at
//! a small angle. No mesh that contains both faces has larger angles there.
//!
//! A line consists of *ridges*: edges in 3-D, nodes in 2-D. The faces on features around a ridge,
//! and the sides of the box that contain it, are rays in the plane perpendicular to it:
//!
//! ```text
//!      \      / feature       A wedge is the sector between two neighbouring rays, of which
//!       \   /                 one or both are features. It is acute below 30 degrees.
//!    ____\/____ side
//! ```
//!
//! Faces may be marked as feature faces wrongly: both sides of a flat cell, or a single face that
//! sticks out of a feature. Such faces must not explain bad angles. So faces are joined into
//! patches across all ridges that are not acute, and a feature at an acute line must be a patch of
//! a minimum size.
//!
//! - `wedges`: the narrowest wedge at a ridge
//! - `patches`: patches of faces, and their areas
//! - `chains`: wedges chained into lines
//! - `line`: lines and their angles

mod chains;
mod line;
mod patches;
mod wedges;

use super::mesh_faces::MeshFaces;
use crate::files::codec::codec_fields;
use crate::geometry::sorted;
use crate::geometry::union_find::UnionFind;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;
use crate::parallel::prelude::*;

pub(super) use chains::AcuteLines;
pub(super) use line::AcuteEdge;
pub use line::{AcuteLine, AcutePair};
pub(super) use wedges::common_sides;

use chains::chain_lines;
use patches::{large_everywhere, parts_per_unit_area, patch_areas};
use wedges::{Wedge, narrowest_wedge};

/// Face on a feature, seen from one of its ridges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct RidgeFace {
    ridge: [u32; 2],
    face: u32,
    /// Node of the face that is not on the ridge.
    apex: u32,
}

/// Face on a feature at a ridge that several ranks may have. Node numbers are global.
#[derive(Debug, Clone, Copy)]
struct SharedRidgeFace<const D: usize> {
    /// Nodes of the face, ascending, by which faces are ordered, and its global number.
    nodes: [u32; D],
    face: u32,
    /// Positions of the ends of the ridge, d at these ends, and the position of the node of the
    /// face that is not on the ridge.
    ends: [[f64; D]; 2],
    distance: [f64; 2],
    apex: [f64; D],
}

codec_fields! {
    @(const D: usize) SharedRidgeFace<D> as SharedRidgeFace { nodes, face, ends, distance, apex }
}

/// Finds the acute lines of a distributed mesh that fills the box `[0, extent]`. Collective; every
/// rank gets all lines. `surface` has the [faces on features](sorted_feature_faces) that this rank
/// owns, and `distance` returns d at a local node.
///
/// # Errors
/// Returns the communication errors of the view.
pub(super) fn acute_lines<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    surface: &MeshFaces<'_, D>,
    extent: [f64; D],
    distance: &dyn Fn(u32) -> f64,
) -> crate::Result<AcuteLines<D>> {
    let (nodes, faces) = (surface.nodes, &surface.faces);
    let first = view.first_number("faces on features", faces.len())? as u32;
    let mut ridge_faces: Vec<RidgeFace> = (0..)
        .zip(faces)
        .flat_map(|(face, nodes)| (0..D).map(move |k| ridge_face(nodes, face, k)))
        .collect();
    ridge_faces.par_sort_unstable();

    let is_shared = view.shared_mask();
    let mut at_cuts = Vec::new();
    let mut patches = UnionFind::new(faces.len());
    let mut wedges = Vec::new();
    for group in ridge_faces.chunk_by(|a, b| a.ridge == b.ridge) {
        let local_ridge = group[0].ridge;
        let ridge = local_ridge.map(|n| view.global_id(n));
        let position = |n: u32| nodes[n as usize];
        let (ends, d) = (local_ridge.map(position), local_ridge.map(distance));
        if local_ridge.iter().all(|&n| is_shared[n as usize]) {
            let shared_face = |ridge_face: &RidgeFace| SharedRidgeFace {
                nodes: faces[ridge_face.face as usize].map(|n| view.global_id(n)),
                face: first + ridge_face.face,
                ends,
                distance: d,
                apex: position(ridge_face.apex),
            };
            at_cuts.extend((group.iter()).map(|ridge_face| (ridge, shared_face(ridge_face))));
            continue;
        }
        let mut apexes = group
            .iter()
            .map(|ridge_face| (position(ridge_face.apex), first + ridge_face.face));
        match narrowest_wedge(ridge, ends, d, &mut apexes, extent) {
            Some(wedge) => wedges.push(wedge),
            None => (group.windows(2)).for_each(|pair| patches.unite(pair[0].face, pair[1].face)),
        }
    }
    drop(ridge_faces);
    let (cut_wedges, united_faces) = wedges_at_cuts(view, at_cuts, extent)?;
    let parts_per_area = parts_per_unit_area(extent);
    let areas = patch_areas(
        view,
        surface,
        &mut patches,
        first,
        &united_faces,
        parts_per_area,
    )?;
    let local_faces = first..first + faces.len() as u32;
    let is_large = |wedge: &Wedge<D>| {
        let faces = wedge.faces.iter().flatten();
        let mut local = faces.filter(|&face| local_faces.contains(face));
        let area = |&face: &u32| areas[(face - first) as usize] as f64 / parts_per_area;
        local.all(|face| area(face) >= wedge.min_patch_area())
    };
    wedges.retain(is_large);
    let mut wedges = view.concatenate("wedges", wedges)?;
    wedges.extend(large_everywhere(view, cut_wedges, is_large)?);
    wedges.sort_by_key(|wedge| wedge.ridge);
    Ok(chain_lines(wedges))
}

/// Returns the wedges at ridges that several ranks share, on all ranks, and the pairs of faces that
/// continue each other there. `at_cuts` are the local faces at such ridges. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
fn wedges_at_cuts<const D: usize, M>(
    view: &MeshView<'_, D, M>,
    at_cuts: Vec<([u32; 2], SharedRidgeFace<D>)>,
    extent: [f64; D],
) -> crate::Result<(Vec<Wedge<D>>, Vec<[u32; 2]>)> {
    let mut shared = view.collect_by_nodes("ridges at cuts", at_cuts)?;
    shared.sort_unstable_by_key(|face| (face.nodes, face.value.nodes));
    let (mut wedges, mut united_faces) = (Vec::new(), Vec::new());
    for group in shared.chunk_by(|a, b| a.nodes == b.nodes) {
        let (ridge, SharedRidgeFace { ends, distance, .. }) = (group[0].nodes, group[0].value);
        let mut apexes = (group.iter()).map(|face| (face.value.apex, face.value.face));
        match narrowest_wedge(ridge, ends, distance, &mut apexes, extent) {
            Some(wedge) => wedges.push(wedge),
            None => united_faces
                .extend((group.windows(2)).map(|pair| [pair[0].value.face, pair[1].value.face])),
        }
    }
    let wedges = view.concatenate("wedges at cuts", wedges)?;
    let united_faces = view.concatenate("patches at cuts", united_faces)?;
    Ok((wedges, united_faces))
}

/// Returns the faces on features, each with its nodes ascending. `feature_faces` has a byte for
/// each cell, in which bit k marks face k. Faces in a side of the box are omitted, because they
/// belong to that side.
pub(super) fn sorted_feature_faces<const D: usize, M: Simplices<D>>(
    mesh: &M,
    feature_faces: &[u8],
    extent: [f64; D],
) -> Vec<[u32; D]> {
    let mut faces = Vec::new();
    for (c, &bits) in feature_faces
        .iter()
        .enumerate()
        .filter(|(_, bits)| **bits != 0)
    {
        for k in (0..=D).filter(|k| bits >> k & 1 == 1) {
            let face = sorted(mesh.face(c, k));
            let corners = face.map(|n| mesh.nodes()[n as usize]);
            if common_sides(&corners, extent).next().is_none() {
                faces.push(face);
            }
        }
    }
    faces
}

fn ridge_face<const D: usize>(face_nodes: &[u32; D], face: u32, k: usize) -> RidgeFace {
    let node = |i: usize| face_nodes[(k + 1 + i) % D];
    RidgeFace {
        ridge: sorted([node(0), node(D - 2)]),
        face,
        apex: face_nodes[k],
    }
}
