//! Figures of the mesh of a job: quality, validity and fidelity.

use std::borrow::Cow;
use std::ops::Range;

use crate::parallel::prelude::*;

use super::MeshScene;
use crate::Result;
use crate::comm::Comm;
use crate::feature::{FeaturePoint, Features};
use crate::files::codec::codec_fields;
use crate::mesh::Simplices;
use crate::mesh::check::{BOX_TOLERANCE, Check, CheckHints, check_view};
use crate::mesh::view::MeshView;
use crate::progress::CancelToken;
use crate::report::{
    self, AngleAssessment, Fidelity, Improvement, LatticeReport, Quality, Reference, Report,
};

/// A mesh in lattice space, and the features with which it is compared.
pub(super) struct MeasuredMesh<'a, const D: usize, M> {
    /// The mesh, or this rank's partition of it.
    pub view: MeshView<'a, D, M>,
    pub neighbours: Option<&'a [u32]>,
    /// The faces that the mesh declares to lie on features, if it declares any.
    pub tagged_faces: Option<&'a [u8]>,
    /// The faces on features, if the figures of the lattice and the acute lines are wanted.
    pub feature_faces: Option<&'a [u8]>,
    pub scene: &'a MeshScene<'a, D>,
    /// The feature points near the mesh or the partition.
    pub near_points: &'a [FeaturePoint<D>],
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

    /// Returns the figures as a report, and the assessment of the angles of each local cell.
    pub fn into_report(self, improvement: Option<Improvement>) -> (Report, AngleAssessment) {
        let assessment = self.angle_assessment.unwrap_or_default();
        let quality = self.quality.map(|quality| Quality {
            angles: Some(assessment.angles.clone()),
            ..quality
        });
        let report = Report {
            quality,
            box_check: self.box_check,
            fidelity: self.fidelity,
            lattice: self.lattice,
            improvement,
            ..Report::default()
        };
        (report, assessment)
    }
}

impl<const D: usize, M: Simplices<D>> MeasuredMesh<'_, D, M> {
    /// Measures atoms and angles, shapes, validity and fidelity. Figures that are incomplete when
    /// `cancel` is cancelled, on any rank, are omitted. The assessment of cells covers only the
    /// local cells.
    ///
    /// All ranks measure their partitions of a distributed mesh together. If each rank has the
    /// whole mesh, each runs some of the five tasks. They are mostly serial, so that they run at
    /// the same time.
    ///
    /// # Errors
    /// Returns the errors of [`report::fidelity`] and of other ranks.
    pub fn figures(&self, comm: &dyn Comm, cancel: &CancelToken<'_>) -> Result<MeshFigures> {
        type MeasureTask<'a> = &'a (dyn Fn() -> Result<MeshFigures> + Sync);
        let (view, scene) = (&self.view, self.scene);
        let tasks: [MeasureTask; 5] = [
            &|| {
                let quality = measure_unless_cancelled(view, cancel, || {
                    report::quality_of_partition(view, cancel)
                })?;
                Ok(MeshFigures {
                    quality,
                    ..MeshFigures::default()
                })
            },
            &|| {
                let hints = CheckHints {
                    neighbours: self.neighbours,
                    ..CheckHints::default()
                };
                let (low, high) = ([0.0; D], scene.extent);
                let box_check = measure_unless_cancelled(view, cancel, || {
                    check_view(view, hints, low, high, BOX_TOLERANCE, cancel)
                })?;
                Ok(MeshFigures {
                    box_check,
                    ..MeshFigures::default()
                })
            },
            &|| {
                Ok(MeshFigures {
                    fidelity: self.measure_fidelity(cancel)?,
                    ..MeshFigures::default()
                })
            },
            &|| {
                let at_node = |n: u32| scene.distance.value_at(view.mesh.nodes()[n as usize]);
                let assess =
                    |faces| report::assess_partition_angles(view, faces, scene.extent, &at_node);
                Ok(MeshFigures {
                    angle_assessment: self.feature_faces.map(assess).transpose()?,
                    ..MeshFigures::default()
                })
            },
            &|| {
                let measure =
                    |_| report::lattice_of_partition(view, |x| scene.distance.value_at(x));
                Ok(MeshFigures {
                    lattice: self.feature_faces.map(measure).transpose()?,
                    ..MeshFigures::default()
                })
            },
        ];
        let mut merged = MeshFigures::default();
        if view.is_partitioned() {
            for task in tasks {
                merged.add(task()?);
            }
            return Ok(merged);
        }
        let measure = |range: Range<usize>, emit: &mut dyn FnMut(MeshFigures)| {
            let figures: Vec<_> = tasks[range].par_iter().map(|task| task()).collect();
            figures
                .into_iter()
                .try_for_each(|part| part.map(&mut *emit))
        };
        comm.distribute("figures", tasks.len(), measure, &mut |part| {
            merged.add(part)
        })?;
        Ok(merged)
    }

    fn measure_fidelity(&self, cancel: &CancelToken<'_>) -> Result<Option<Fidelity>> {
        let (view, features) = (&self.view, self.scene.features);
        if features.point_counts().points == 0 {
            return Ok(None);
        }
        measure_unless_cancelled(view, cancel, || {
            let reference = Reference::from_share(features, self.near_points);
            let in_samples = mesh_in_samples(view.mesh, features);
            let view = view.with_mesh(&*in_samples);
            report::fidelity_of_partition(&view, &reference, self.tagged_faces, cancel)
        })
    }
}

/// Runs `measure` and returns its result, if `cancel` is not cancelled on any rank before or after
/// it. All ranks decide together, as `measure` may need all of them.
pub(super) fn measure_unless_cancelled<T, const D: usize, M>(
    view: &MeshView<'_, D, M>,
    cancel: &CancelToken<'_>,
    measure: impl FnOnce() -> Result<T>,
) -> Result<Option<T>> {
    let any_cancelled = || view.is_any("cancellation", cancel.is_cancelled());
    if any_cancelled()? {
        return Ok(None);
    }
    let figures = measure()?;
    Ok((!any_cancelled()?).then_some(figures))
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
