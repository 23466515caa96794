//! The faces on surfaces that the user gives.
//!
//! Which face lies on which given surface depends on the surface alone, and not on what else is found
//! there: a face of a fault may separate two labels, or lie inside one. Each surface is closed by
//! itself (see [`crate::improve::seal`]), so that it has no hole where others cross it, and no path
//! leads through it.

use super::MeshScene;
use super::horizons::face_names;
use crate::Result;
use crate::feature::FeaturePoint;
use crate::improve::regions::AnchoredNodes;
use crate::mesh::Simplices;
use crate::mesh::complex::NONE;
use crate::mesh::interface::marks_from_bits;
use crate::progress::CancelToken;

/// Returns for each face of a mesh of simplices the index in
/// [`Features::names`](crate::feature::Features::names) of the given surface that it lies on, or
/// [`NONE`]; empty if none are given. `marks` has the faces on all features as bits, and gains the
/// faces that close holes. Of a face on several surfaces, the first name counts.
///
/// # Errors
/// Returns the errors of [`seal`](crate::improve::seal).
pub(super) fn close_given_surfaces<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbours: &[u32],
    scene: &MeshScene<'_, D>,
    marks: &mut [u8],
    cancel: &CancelToken<'_>,
) -> Result<Vec<u32>> {
    let flags: Vec<bool> = marks_from_bits::<D>(marks).collect();
    let mut names = face_names(mesh, &flags, scene.features);
    for (index, name) in (0..).zip(&scene.features.names) {
        let mut own = marks_of_name::<D>(&names, index);
        let points = scene.surface_points(name.number);
        scene.close_holes(mesh, neighbours, &points, &mut own, cancel)?;
        for (face, _) in marks_from_bits::<D>(&own).enumerate().filter(|f| f.1) {
            names[face] = names[face].min(index);
            marks[face / (D + 1)] |= 1 << (face % (D + 1));
        }
    }
    Ok(names)
}

/// Returns the faces of cells with this name as bits.
fn marks_of_name<const D: usize>(names: &[u32], name: u32) -> Vec<u8> {
    let bit = |(k, n): (usize, &u32)| u8::from(*n == name) << k;
    let cells = names.chunks_exact(D + 1);
    cells
        .map(|faces| faces.iter().enumerate().map(bit).sum::<u8>())
        .collect()
}

/// Returns marks with those of all faces that have a name.
pub(super) fn with_named(marks: &[u8], names: &[u32]) -> Vec<u8> {
    let faces_per_cell = names.len() / marks.len().max(1);
    let bit = |(k, name): (usize, &u32)| u8::from(*name != NONE) << k;
    let named = |c: usize| {
        let names = &names[faces_per_cell * c..faces_per_cell * (c + 1)];
        names.iter().enumerate().map(bit).sum::<u8>()
    };
    let marks = marks.iter().enumerate();
    marks.map(|(c, bits)| bits | named(c)).collect()
}

/// Returns the nodes of faces with names, which stay on the given surfaces; `None` if there are none.
pub(super) fn anchored_nodes<const D: usize, M: Simplices<D>>(
    mesh: &M,
    names: &[u32],
    scene: &MeshScene<'_, D>,
) -> Option<AnchoredNodes> {
    let mut is_anchored = vec![false; mesh.nodes().len()];
    let named = (0..names.len()).filter(|&face| names[face] != NONE);
    for n in named.flat_map(|face| mesh.face(face / (D + 1), face % (D + 1))) {
        is_anchored[n as usize] = true;
    }
    let given = scene.features.names.iter();
    let points = given.flat_map(|name| scene.surface_points(name.number));
    let points: Vec<FeaturePoint<D>> = points.collect();
    is_anchored.contains(&true).then(|| AnchoredNodes {
        planes: scene.planes_of(&points),
        is_anchored,
    })
}
