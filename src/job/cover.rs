//! Meshes that cover the full voxels of an image, `N h` along an axis of `N` samples, in place of the box
//! through the outermost samples, `(N - 1) h`.
//!
//! ```text
//! samples        |   0   |   1   |   2   |   3   |        the mesh of the samples goes from 0 to 3
//! padded     0 - | - 1 - | - 2 - | - 3 - | - 4 - | - 5    it goes from 0 to 5
//! squeezed       |0   1      2       3      4   5|        the outermost steps are half as long
//! ```
//!
//! The image gets a copy of its outermost samples at every side, is meshed as any other, and the outermost
//! layer of steps is squeezed to half of its thickness. Nothing changes there along the normal of the side, so
//! that interfaces keep their places.

use serde::{Deserialize, Serialize};
use std::sync::Arc;

use super::cell_choice::quality_of_kept;
use super::spec::MeshSpec;
use super::{AnnotatedMesh, MeshResult, Outcome, Params, Weight};
use crate::Result;
use crate::feature::label_map;
use crate::geometry::{add_scaled, distance2, sorted_distinct};
use crate::image::{ExactLabels, Image, LabelTable};
use crate::improve::enlarge_angles;
use crate::lattice::AtomKind;
use crate::mesh::Simplices;
use crate::mesh::check::{BOX_TOLERANCE, check};
use crate::report::{self, RegionSummary};

/// Selects the part of the image that a mesh covers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Cover {
    /// The box through the outermost samples: N - 1 steps along an axis of N samples
    #[default]
    Samples,
    /// The full voxels, or pixels: N steps
    Voxels,
}

/// Returns an image with a copy of its outermost samples at every side.
pub(crate) fn padded<const D: usize>(image: &Image<D>) -> Image<D> {
    let dims = image.dims();
    let padded_dims = dims.map(|n| n + 2);
    let count: usize = padded_dims.iter().product();
    let source: Vec<usize> = (0..count)
        .map(|offset| {
            let (mut rest, mut index, mut stride) = (offset, 0, 1);
            for k in 0..D {
                let at = (rest % padded_dims[k]).saturating_sub(1).min(dims[k] - 1);
                index += at * stride;
                rest /= padded_dims[k];
                stride *= dims[k];
            }
            index
        })
        .collect();
    let samples = image.as_slice();
    let mut geometry = image.geometry.clone();
    for axis in image.geometry.axes {
        geometry.origin = add_scaled(geometry.origin, -1.0, axis);
    }
    let values = source.iter().map(|&i| samples[i]).collect();
    let mut result = Image::new(padded_dims, values, geometry);
    result.label_names.clone_from(&image.label_names);
    result.labels = image.labels.as_ref().map(|labels| {
        Arc::new(ExactLabels {
            values: labels.values.clone(),
            indices: source.iter().map(|&i| labels.indices[i]).collect(),
        })
    });
    if image.dead.is_empty() && image.missing.is_empty() {
        return result;
    }
    let is_set = |flags: &[bool], i: usize| flags.get(i).is_some_and(|flag| *flag);
    let is_dead = |&i: &usize| is_set(&image.dead, i) || is_set(&image.missing, i / dims[0]);
    result.with_dead(source.iter().map(is_dead).collect())
}

/// Returns the position in the padded image of a position in an image with these numbers of samples: the inverse
/// of how the mesh is squeezed.
pub(crate) fn padded_index<const D: usize>(index: [f64; D], dims: [usize; D]) -> [f64; D] {
    std::array::from_fn(|k| {
        let last = dims[k] as f64 - 1.0;
        match index[k] {
            x if x < 0.0 => 2.0 * x + 1.0,
            x if x > last => 2.0 * (x - last) + last + 1.0,
            x => x + 1.0,
        }
    })
}

/// Returns the parameters for the padded image: images of distances and weights are padded, too.
pub(super) fn padded_params<const D: usize>(params: &Params<D>) -> Params<D> {
    let mut params = params.clone();
    if let Some(map) = &mut params.distance_map {
        **map = padded(map);
    }
    if let Weight::Image(image) = &mut params.beta {
        **image = padded(image);
    }
    params
}

/// Squeezes the mesh of a padded image to the voxels of `image`, and measures it again.
pub(super) fn squeeze<const D: usize, M: Simplices<D>>(
    outcome: &mut Outcome<D, M>,
    image: &Image<D>,
    spec: &MeshSpec,
) -> Result<()> {
    let MeshResult::Simplices(annotated) = &mut outcome.mesh else {
        return Ok(());
    };
    let (step, dims, padded_extent) = (outcome.step, image.dims(), outcome.extent);
    let extent: [f64; D] = std::array::from_fn(|k| dims[k] as f64 * step[k]);
    for node in annotated.mesh.parts_mut().0.iter_mut() {
        for k in 0..D {
            let (x, last) = (node[k] / step[k], dims[k] as f64);
            node[k] = if node[k] <= 0.0 {
                0.0
            } else if node[k] >= padded_extent[k] {
                extent[k]
            } else if x < 1.0 {
                0.5 * x * step[k]
            } else if x > last {
                (last + 0.5 * (x - last) - 0.5) * step[k]
            } else {
                (x - 0.5) * step[k]
            };
        }
    }
    enlarge_squeezed_angles(annotated, extent, spec.min_angle());
    outcome.extent = extent;
    outcome.feature_offset = step.map(|s| 0.5 * s);
    outcome.geometry = image.geometry.clone();
    for axis in image.geometry.axes {
        outcome.geometry.origin = add_scaled(outcome.geometry.origin, -0.5, axis);
    }
    let (mesh, offset) = (&annotated.mesh, outcome.feature_offset);
    let distance_at = |x: [f64; D]| outcome.distance.value_at(add_scaled(x, 1.0, offset));
    let faces = &annotated.feature_faces;
    let assessment = report::assess_angles(mesh, faces, extent, |n| {
        distance_at(mesh.nodes()[n as usize])
    });
    annotated.angle_assessment = assessment;
    let kept = outcome.kept_cells.as_deref();
    if outcome.report.quality.is_some() {
        let quality = quality_of_kept(annotated, kept, extent, &distance_at);
        outcome.report.quality = Some(quality);
    }
    if outcome.report.box_check.is_some() {
        outcome.report.box_check = Some(check(mesh, [0.0; D], extent, BOX_TOLERANCE));
    }
    let world = image.geometry.determinant().abs();
    let cell_scale = world / step.iter().product::<f64>();
    if let Some(regions) = &mut outcome.report.regions {
        let merged = label_map::merge_labels(image, &spec.label)?;
        let table = LabelTable::from_image(merged.as_ref().unwrap_or(image));
        let volumes = mesh.volumes();
        let cells = annotated
            .regions
            .iter()
            .zip(volumes.iter().map(|v| v * cell_scale));
        count_whole_voxels(regions, table.as_ref(), cells, world);
    }
    Ok(())
}

/// Moves nodes of cells that were squeezed below an angle, in degrees, so that their angles become larger. Nodes
/// on features stay.
fn enlarge_squeezed_angles<const D: usize, M: Simplices<D>>(
    annotated: &mut AnnotatedMesh<M>,
    extent: [f64; D],
    min_angle: f64,
) {
    let (mesh, kinds) = (&annotated.mesh, &annotated.node_kinds);
    let is_fixed = |n: u32| matches!(kinds[n as usize], AtomKind::Corner | AtomKind::Fixed);
    let mut may_move: Vec<bool> = (0..mesh.nodes().len() as u32)
        .map(|n| !is_fixed(n))
        .collect();
    for (c, marks) in annotated.feature_faces.iter().enumerate() {
        for k in (0..=D).filter(|k| marks >> k & 1 == 1) {
            (mesh.face(c, k).iter()).for_each(|&n| may_move[n as usize] = false);
        }
    }
    let min_sine = min_angle.to_radians().sin();
    let at = |n: u32| &mesh.nodes()[n as usize];
    let (mut moving, mut shortest) = (Vec::new(), f64::INFINITY);
    for c in (0..mesh.len()).filter(|&c| mesh.min_sine(c) < min_sine) {
        let cell = mesh.cell(c);
        moving.extend(cell.iter().copied().filter(|&n| may_move[n as usize]));
        for (i, &a) in cell.iter().enumerate() {
            let others = cell[i + 1..].iter();
            let squares = others.map(|&b| distance2(at(a), at(b)));
            shortest = squares.fold(shortest, |least, square| least.min(square.sqrt()));
        }
    }
    let moving = sorted_distinct(moving);
    enlarge_angles(&mut annotated.mesh, &moving, shortest, extent);
}

/// Counts all samples in full in the report on regions. `cells` has the region and the volume of each cell,
/// and a voxel has the volume `voxel`.
fn count_whole_voxels<'a>(
    regions: &mut RegionSummary,
    table: Option<&LabelTable>,
    cells: impl Iterator<Item = (&'a i32, f64)> + Clone,
    voxel: f64,
) {
    let Some(table) = table else {
        return;
    };
    let mut counts = vec![0; table.values.len()];
    table.indices.iter().for_each(|&n| counts[n as usize] += 1);
    for region in &mut regions.regions {
        let index = table.values.iter().position(|label| *label == region.label);
        let count = index.map_or(0, |index| counts[index]);
        let own = cells
            .clone()
            .filter(|(number, _)| **number == region.region);
        region.samples = count;
        region.volume = own.map(|(_, volume)| volume).sum();
        region.sample_volume = count as f64 * voxel;
        region.volume_error_percent = 100.0 * (region.volume / region.sample_volume - 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Geometry;
    use crate::job::{MeshSpec, run};
    use crate::mesh::Mesh;
    use crate::progress::NoProgress;

    #[test]
    fn a_padded_image_repeats_its_outermost_samples() {
        let geometry = Geometry::with_spacing([10.0, 20.0], [2.0, 3.0]);
        let image = Image::new([3, 2], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], geometry);
        let padded = padded(&image);
        assert_eq!(padded.dims(), [5, 4]);
        let rows: Vec<&[f32]> = padded.as_slice().chunks(5).collect();
        let first = [1.0, 1.0, 2.0, 3.0, 3.0].as_slice();
        let second = [4.0, 4.0, 5.0, 6.0, 6.0].as_slice();
        assert_eq!(rows, [first, first, second, second]);
        assert_eq!(padded.geometry.origin, [8.0, 17.0]);
    }

    /// Meshes two halves of labels with this share of the first axis, and compares all volumes with those
    /// of the voxels.
    fn check_halves<const D: usize>(dims: [usize; D])
    where
        crate::mesh::Space<D>: crate::job::MeshImage<D>,
    {
        let count: usize = dims.iter().product();
        let split = dims[0] / 3;
        let samples = (0..count).map(|i| f32::from(u8::from(i % dims[0] >= split)));
        let spacing = std::array::from_fn(|k| 0.5 + k as f64);
        let geometry = Geometry::with_spacing([7.0; D], spacing);
        let image = Image::new(dims, samples.collect(), geometry);
        let params = Params::new(MeshSpec {
            cover: Cover::Voxels,
            distance: "4".parse().unwrap(),
            feature: crate::feature::FeatureKind::Labels,
            ..MeshSpec::default()
        });
        let outcome = run(&image, &params.unwrap(), &mut NoProgress).unwrap();
        let voxel: f64 = spacing.iter().product();
        let mesh = &outcome.simplices().unwrap().mesh;
        let scale = voxel / outcome.step.iter().product::<f64>();
        let total = mesh.volumes().iter().sum::<f64>() * scale;
        let expected = count as f64 * voxel;
        assert!((total / expected - 1.0).abs() < 1e-12, "{total} {expected}");
        let check = outcome.report.box_check.unwrap();
        assert!(check.passed(), "{:?}", check.problems);
        for region in &outcome.report.regions.unwrap().regions {
            let share = if region.label == 0.0 {
                split
            } else {
                dims[0] - split
            };
            let exact = expected * share as f64 / dims[0] as f64;
            assert!(
                (region.sample_volume / exact - 1.0).abs() < 1e-12,
                "{region:?}"
            );
            assert!(
                (region.volume / exact - 1.0).abs() < 2e-3,
                "{region:?} {exact}"
            );
        }
        for k in 0..D {
            let half = 0.5 * spacing[k];
            assert!((outcome.geometry.origin[k] - (7.0 - half)).abs() < 1e-12);
        }
    }

    #[test]
    fn meshes_of_voxels_have_their_volumes() {
        check_halves([24, 21, 18]);
        check_halves([30, 21]);
    }
}
