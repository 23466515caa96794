//! Patches of faces on features, and their areas.

use super::wedges::Wedge;
use crate::geometry::union_find::UnionFind;
use crate::geometry::{sorted, sorted_distinct};
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;
use crate::report::mesh_faces::MeshFaces;

/// Returns those of the wedges, which all ranks know, that are large on every rank. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
pub fn large_everywhere<const D: usize, M>(
    view: &MeshView<'_, D, M>,
    wedges: Vec<Wedge<D>>,
    is_large: impl Fn(&Wedge<D>) -> bool,
) -> crate::Result<Vec<Wedge<D>>> {
    let is_large: Vec<bool> = wedges.iter().map(is_large).collect();
    let is_large = view.merge_parts("small patches", is_large, |mut all, part| {
        (all.iter_mut().zip(part)).for_each(|(all, part)| *all &= part);
        all
    })?;
    let large = is_large.into_iter().zip(wedges).filter(|(large, _)| *large);
    Ok(large.map(|(_, wedge)| wedge).collect())
}

/// Returns the number of units in which one unit of area is counted: 2^44 per square of the longest
/// side of the box, rounded up to a power of two. Sums of integers do not depend on their order.
pub fn parts_per_unit_area<const D: usize>(extent: [f64; D]) -> f64 {
    let longest = extent.into_iter().fold(f64::MIN_POSITIVE, f64::max);
    (44.0 - (D - 1) as f64 * longest.log2().ceil()).exp2()
}

/// Returns for each local face the area of its patch, in units of which `parts_per_area` make one
/// unit of area. `patches` are the local patches, and `united_faces` the pairs of faces on all
/// ranks that are in one patch. Collective.
///
/// # Errors
/// Returns the communication errors of the view.
pub fn patch_areas<const D: usize, M: Simplices<D>>(
    view: &MeshView<'_, D, M>,
    surface: &MeshFaces<'_, D>,
    patches: &mut UnionFind,
    first: u32,
    united_faces: &[[u32; 2]],
    parts_per_area: f64,
) -> crate::Result<Vec<u64>> {
    let count = surface.faces.len();
    let mut area = vec![0u64; count];
    for face in 0..count {
        let face_area = (parts_per_area * M::face_area(&surface.corners(face))).round();
        area[patches.find(face as u32) as usize] += face_area as u64;
    }
    // Patches that cross partition boundaries, each with one of its faces.
    let local_index = |face: u32| {
        let index = face.checked_sub(first)?;
        ((index as usize) < count).then_some(index)
    };
    let mut cut_faces: Vec<(u32, (u32, u64))> = Vec::new();
    for &face in united_faces.as_flattened() {
        if let Some(index) = local_index(face) {
            let patch = patches.find(index);
            cut_faces.push((face, (first + patch, area[patch as usize])));
        }
    }
    let cut_faces = sorted_distinct(cut_faces);
    let cut_faces = sorted(view.concatenate("areas of patches", cut_faces)?);
    let cut_patches: Vec<(u32, u64)> = sorted_distinct(cut_faces.iter().map(|(_, patch)| *patch));
    let patch_index = |patch: u32| cut_patches.partition_point(|&(other, _)| other < patch) as u32;
    let patch_of_face = |face: u32| {
        let (_, (patch, _)) = cut_faces[cut_faces.partition_point(|&(other, _)| other < face)];
        patch_index(patch)
    };
    let mut sets = UnionFind::new(cut_patches.len());
    for &[a, b] in united_faces {
        sets.unite(patch_of_face(a), patch_of_face(b));
    }
    let mut sums = vec![0; cut_patches.len()];
    for (index, &(_, area)) in (0..).zip(&cut_patches) {
        sums[sets.find(index) as usize] += area;
    }
    for (index, &(patch, _)) in (0..).zip(&cut_patches) {
        if let Some(patch) = local_index(patch) {
            area[patch as usize] = sums[sets.find(index) as usize];
        }
    }
    Ok((0..count as u32)
        .map(|face| area[patches.find(face) as usize])
        .collect())
}
