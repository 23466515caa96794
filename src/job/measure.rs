//! Figures of the mesh of a job: quality, validity and fidelity.

use std::borrow::Cow;
use std::ops::Range;

use crate::parallel::prelude::*;

use super::join::MeshScene;
use crate::Result;
use crate::comm::Comm;
use crate::feature::{FeaturePoint, Features};
use crate::files::codec::codec_fields;
use crate::mesh::Simplices;
use crate::mesh::check::{Check, CheckHints, check_cancellable, check_distributed};
use crate::mesh::partition::MeshPartition;
use crate::mesh::view::MeshView;
use crate::progress::CancelToken;
use crate::report::{self, AngleAssessment, Fidelity, LatticeReport, Quality, Reference};

/// Tolerance of the volume of the mesh, and of the flatness of sides, relative to the box.
pub const BOX_TOLERANCE: f64 = 1e-9;

/// A mesh in lattice space, and the features with which it is compared.
pub(super) struct MeasuredMesh<'a, const D: usize, M> {
    pub mesh: &'a M,
    pub neighbors: Option<&'a [u32]>,
    /// The faces that the mesh declares to lie on features, if it declares any.
    pub tagged_faces: Option<&'a [u8]>,
    /// The faces on features, if the figures of the lattice and the acute lines are wanted.
    pub feature_faces: Option<&'a [u8]>,
    pub scene: &'a MeshScene<'a, D>,
}

/// Figures of a mesh that were requested and completely measured.
#[derive(Default)]
pub(super) struct MeshFigures {
    pub angle_assessment: Option<AngleAssessment>,
    pub lattice: Option<LatticeReport>,
    pub quality: Option<Quality>,
    pub box_check: Option<Check>,
    pub fidelity: Option<Fidelity>,
}

codec_fields! { MeshFigures as MeshFigures { angle_assessment, lattice, quality, box_check, fidelity } }

impl MeshFigures {
    /// Takes over the figures that `others` has.
    fn add(&mut self, others: Self) {
        let Self {
            angle_assessment,
            lattice,
            quality,
            box_check,
            fidelity,
        } = others;
        self.angle_assessment = angle_assessment.or(self.angle_assessment.take());
        self.lattice = lattice.or(self.lattice.take());
        self.quality = quality.or(self.quality.take());
        self.box_check = box_check.or(self.box_check.take());
        self.fidelity = fidelity.or(self.fidelity.take());
    }
}

impl<const D: usize, M: Simplices<D>> MeasuredMesh<'_, D, M> {
    /// Measures atoms and angles, shapes, validity and fidelity. Figures that are incomplete when
    /// `cancel` is cancelled are omitted.
    ///
    /// The four tasks take about as long and are mostly serial, so that they run at the same time,
    /// and each rank runs some of them.
    ///
    /// # Errors
    /// Returns the errors of [`report::fidelity`] and of other ranks.
    pub fn figures(&self, comm: &dyn Comm, cancel: &CancelToken<'_>) -> Result<MeshFigures> {
        type MeasureTask<'a> = &'a (dyn Fn() -> Result<MeshFigures> + Sync);
        let tasks: [MeasureTask; 4] = [
            &|| Ok(self.measure_lattice()),
            &|| {
                Ok(MeshFigures {
                    quality: measure_unless_cancelled(cancel, || {
                        report::quality_with_cancel(self.mesh, cancel)
                    }),
                    ..MeshFigures::default()
                })
            },
            &|| {
                Ok(MeshFigures {
                    box_check: measure_unless_cancelled(cancel, || self.check_box(cancel)),
                    ..MeshFigures::default()
                })
            },
            &|| {
                let fidelity = measure_unless_cancelled(cancel, || self.measure_fidelity(cancel));
                Ok(MeshFigures {
                    fidelity: fidelity.transpose()?.flatten(),
                    ..MeshFigures::default()
                })
            },
        ];
        let measure = |range: Range<usize>, emit: &mut dyn FnMut(MeshFigures)| {
            let figures: Vec<_> = tasks[range].par_iter().map(|task| task()).collect();
            figures
                .into_iter()
                .try_for_each(|part| part.map(&mut *emit))
        };
        let mut merged = MeshFigures::default();
        comm.distribute("figures", tasks.len(), measure, &mut |part| {
            merged.add(part)
        })?;
        Ok(merged)
    }

    fn measure_lattice(&self) -> MeshFigures {
        let Some(faces) = self.feature_faces else {
            return MeshFigures::default();
        };
        let (mesh, scene) = (self.mesh, self.scene);
        let at_node = |n: u32| scene.distance.value_at(mesh.nodes()[n as usize]);
        let (assessment, lattice) = rayon::join(
            || report::assess_angles(mesh, faces, scene.extent, at_node),
            || report::measure_lattice(mesh, |x| scene.distance.value_at(x)),
        );
        MeshFigures {
            angle_assessment: Some(assessment),
            lattice: Some(lattice),
            ..MeshFigures::default()
        }
    }

    fn check_box(&self, cancel: &CancelToken<'_>) -> Check {
        let hints = CheckHints {
            neighbors: self.neighbors,
            ..CheckHints::default()
        };
        let (low, high) = ([0.0; D], self.scene.extent);
        check_cancellable(self.mesh, hints, low, high, BOX_TOLERANCE, cancel)
    }

    fn measure_fidelity(&self, cancel: &CancelToken<'_>) -> Result<Option<Fidelity>> {
        let features: &Features<D> = self.scene.features;
        if features.point_counts().points == 0 {
            return Ok(None);
        }
        let reference = Reference::from_features(features);
        let in_samples = mesh_in_samples(self.mesh, features);
        report::fidelity_with_cancel(&*in_samples, &reference, self.tagged_faces, cancel).map(Some)
    }
}

/// Measures a distributed mesh and returns the figures on every rank, as [`MeasuredMesh::figures`]
/// does for a whole mesh.
///
/// The assessment of cells covers only this rank's partition. `tagged_faces` and `feature_faces`
/// have a byte for each tetrahedron of the partition. Each rank has a share of the features, and
/// `near_points` are the feature points near its partition.
///
/// # Errors
/// Returns the errors of [`report::fidelity`] and those of other ranks.
pub(super) fn figures_of_partition(
    partition: &MeshPartition,
    tagged_faces: Option<&[u8]>,
    feature_faces: &[u8],
    scene: &MeshScene<'_, 3>,
    near_points: &[FeaturePoint<3>],
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<MeshFigures> {
    let tagged = report::TaggedFaces::new(&partition.mesh, tagged_faces)?;
    let view = MeshView::from_partition(partition, comm);
    let d = |x: [f64; 3]| scene.distance.value_at(x);
    let at_node = |n: u32| d(partition.mesh.nodes[n as usize]);
    let assessment = report::assess_partition_angles(&view, feature_faces, scene.extent, &at_node)?;
    let lattice = report::lattice_of_partition(&view, d)?;
    let quality =
        measure_on_all_ranks(comm, cancel, || report::quality_of_partition(&view, cancel))?;
    let box_check = measure_on_all_ranks(comm, cancel, || {
        let (low, high) = ([0.0; 3], scene.extent);
        check_distributed(partition, comm, low, high, BOX_TOLERANCE, cancel)
    })?;
    let features = scene.features;
    let fidelity = match features.point_counts().points {
        0 => None,
        _ => measure_on_all_ranks(comm, cancel, || {
            let reference = Reference::from_share(features, near_points);
            let in_samples = mesh_in_samples(&partition.mesh, features);
            let view = view.with_mesh(&*in_samples);
            report::fidelity_of_partition(&view, &reference, tagged, cancel)
        })?,
    };
    Ok(MeshFigures {
        angle_assessment: Some(assessment),
        lattice: Some(lattice),
        quality,
        box_check,
        fidelity,
    })
}

/// Runs `measure` and returns its result, if no rank is cancelled before or after it. All ranks
/// decide together, as `measure` needs all of them.
fn measure_on_all_ranks<T>(
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
    measure: impl FnOnce() -> Result<T>,
) -> Result<Option<T>> {
    let any_cancelled = || -> Result<bool> {
        Ok(comm
            .all_gather("cancellation", cancel.is_cancelled())?
            .contains(&true))
    };
    if any_cancelled()? {
        return Ok(None);
    }
    let figures = measure()?;
    Ok((!any_cancelled()?).then_some(figures))
}

/// Runs `measure` and returns its result, if `cancel` is not cancelled before or after it.
pub(super) fn measure_unless_cancelled<T>(
    cancel: &CancelToken<'_>,
    measure: impl FnOnce() -> T,
) -> Option<T> {
    if cancel.is_cancelled() {
        return None;
    }
    let figures = measure();
    (!cancel.is_cancelled()).then_some(figures)
}

/// Returns a mesh in units of the samples of its features.
fn mesh_in_samples<'a, const D: usize, M: Simplices<D>>(
    mesh: &'a M,
    features: &Features<D>,
) -> Cow<'a, M> {
    scaled_mesh(mesh, features.potential.step.map(|s| 1.0 / s))
}

/// Returns a mesh with each axis scaled.
pub fn scaled_mesh<const D: usize, M: Simplices<D>>(mesh: &M, scale: [f64; D]) -> Cow<'_, M> {
    if scale == [1.0; D] {
        return Cow::Borrowed(mesh);
    }
    let stretch = |x: &[f64; D]| std::array::from_fn(|k| x[k] * scale[k]);
    Cow::Owned(mesh.with_nodes(mesh.nodes().iter().map(stretch).collect()))
}

#[cfg(test)]
#[path = "measure_tests.rs"]
mod tests;
