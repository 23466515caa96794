//! The figures of what a job made.

use std::borrow::Cow;
use std::ops::Range;

use crate::parallel::prelude::*;

use super::join::MeshScene;
use crate::comm::Comm;
use crate::feature::{FeaturePoint, Features};
use crate::files::codec::codec_fields;
use crate::mesh::Simplices;
use crate::mesh::check::{Check, CheckHints, check_cancellable, check_distributed};
use crate::mesh::partition::MeshPartition;
use crate::mesh::view::MeshView;
use crate::progress::CancelToken;
use crate::report::{self, AngleAssessment, Fidelity, LatticeReport, Quality, Reference};
use crate::{Result, comm};

/// How far the volume may be off the box's, and sides from flat, as a share.
pub const BOX_TOLERANCE: f64 = 1e-9;

/// A mesh in lattice space, and what it is compared with.
pub(super) struct MeasuredMesh<'a, const D: usize, M> {
    pub mesh: &'a M,
    pub neighbors: Option<&'a [u32]>,
    /// The faces that it claims to lie on features, if it does.
    pub tagged_faces: Option<&'a [u8]>,
    /// Its faces on features, where its lattice and its acute lines are asked for.
    pub feature_faces: Option<&'a [u8]>,
    pub scene: &'a MeshScene<'a, D>,
}

/// Figures of a mesh: those that were asked for, and measured to their end.
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
    /// Adds what others are.
    fn add(&mut self, others: Self) {
        let Self {
            angle_assessment: judged,
            lattice,
            quality,
            box_check: filling,
            fidelity,
        } = others;
        self.angle_assessment = judged.or(self.angle_assessment.take());
        self.lattice = lattice.or(self.lattice.take());
        self.quality = quality.or(self.quality.take());
        self.box_check = filling.or(self.box_check.take());
        self.fidelity = fidelity.or(self.fidelity.take());
    }
}

impl<const D: usize, M: Simplices<D>> MeasuredMesh<'_, D, M> {
    /// Atoms and angles, shapes, validity and fidelity, as far as `patience` lasts: what was not measured to its end
    /// is left out. They take about as long each, and much of each is for one thread: so they are measured at the same
    /// time, and ranks measure some each.
    ///
    /// # Errors
    /// Those of [`report::fidelity`] and of [`comm::partition`].
    pub fn figures(&self, patience: &CancelToken<'_>) -> Result<MeshFigures> {
        type MeasureTask<'a> = &'a (dyn Fn() -> Result<MeshFigures> + Sync);
        let parts: [MeasureTask; 4] = [
            &|| Ok(self.measure_lattice()),
            &|| {
                Ok(MeshFigures {
                    quality: measure_unless_cancelled(patience, || {
                        report::quality_with_cancel(self.mesh, patience)
                    }),
                    ..MeshFigures::default()
                })
            },
            &|| {
                Ok(MeshFigures {
                    box_check: measure_unless_cancelled(patience, || self.check_box(patience)),
                    ..MeshFigures::default()
                })
            },
            &|| {
                let fidelity =
                    measure_unless_cancelled(patience, || self.measure_fidelity(patience));
                Ok(MeshFigures {
                    fidelity: fidelity.transpose()?.flatten(),
                    ..MeshFigures::default()
                })
            },
        ];
        let measure = |own: Range<usize>, give: &mut dyn FnMut(MeshFigures)| {
            let figures: Vec<_> = parts[own].par_iter().map(|part| part()).collect();
            figures
                .into_iter()
                .try_for_each(|part| part.map(&mut *give))
        };
        let mut all = MeshFigures::default();
        comm::distribute("figures", parts.len(), measure, &mut |part| all.add(part))?;
        Ok(all)
    }

    fn measure_lattice(&self) -> MeshFigures {
        let Some(faces) = self.feature_faces else {
            return MeshFigures::default();
        };
        let (mesh, scene) = (self.mesh, self.scene);
        let at_node = |n: u32| scene.distance.value_at(mesh.nodes()[n as usize]);
        let (judged, lattice) = rayon::join(
            || report::assess_angles(mesh, faces, scene.extent, at_node),
            || report::measure_lattice(mesh, |x| scene.distance.value_at(x)),
        );
        MeshFigures {
            angle_assessment: Some(judged),
            lattice: Some(lattice),
            ..MeshFigures::default()
        }
    }

    fn check_box(&self, patience: &CancelToken<'_>) -> Check {
        let known = CheckHints {
            neighbors: self.neighbors,
            ..CheckHints::default()
        };
        let (low, high) = ([0.0; D], self.scene.extent);
        check_cancellable(self.mesh, known, low, high, BOX_TOLERANCE, patience)
    }

    fn measure_fidelity(&self, patience: &CancelToken<'_>) -> Result<Option<Fidelity>> {
        let features: &Features<D> = self.scene.features;
        if features.point_counts().points == 0 {
            return Ok(None);
        }
        let reference = Reference::from_features(features);
        let in_samples = mesh_in_samples(self.mesh, features);
        report::fidelity_with_cancel(&*in_samples, &reference, self.tagged_faces, patience)
            .map(Some)
    }
}

/// The figures of a mesh that is in pieces, as [`MeasuredMesh::mesh_figures`] has those of a whole one, on every member of the
/// group; `judged.cells` are those of this piece. Of the piece, `claimed` and `feature_faces` have a byte for each
/// tetrahedron; of the features, each has a share, and `near` are the points near the piece.
///
/// # Errors
/// Those of [`report::fidelity`] and of the group.
pub(super) fn figures_of_partition(
    piece: &MeshPartition,
    claimed: Option<&[u8]>,
    feature_faces: &[u8],
    scene: &MeshScene<'_, 3>,
    near: &[FeaturePoint<3>],
    group: &dyn Comm,
    patience: &CancelToken<'_>,
) -> Result<MeshFigures> {
    let claims = report::TaggedFaces::new(&piece.mesh, claimed)?;
    let part = MeshView::from_partition(piece, group);
    let d = |x: [f64; 3]| scene.distance.value_at(x);
    let at_node = |n: u32| d(piece.mesh.nodes[n as usize]);
    let judged = report::assess_partition_angles(&part, feature_faces, scene.extent, &at_node)?;
    let lattice = report::lattice_of_partition(&part, d)?;
    let quality = measure_on_all_ranks(group, patience, || {
        report::quality_of_partition(&part, patience)
    })?;
    let filling = measure_on_all_ranks(group, patience, || {
        let (low, high) = ([0.0; 3], scene.extent);
        check_distributed(piece, group, low, high, BOX_TOLERANCE, patience)
    })?;
    let features = scene.features;
    let fidelity = match features.point_counts().points {
        0 => None,
        _ => measure_on_all_ranks(group, patience, || {
            let reference = Reference::from_share(features, near);
            let in_samples = mesh_in_samples(&piece.mesh, features);
            let part = part.with_mesh(&*in_samples);
            report::fidelity_of_partition(&part, &reference, claims, patience)
        })?,
    };
    Ok(MeshFigures {
        angle_assessment: Some(judged),
        lattice: Some(lattice),
        quality,
        box_check: filling,
        fidelity,
    })
}

/// What `measure` gives, if all of the group have patience from before it until after: it asks the others, who must
/// not be left alone.
fn measure_on_all_ranks<T>(
    group: &dyn Comm,
    patience: &CancelToken<'_>,
    measure: impl FnOnce() -> Result<T>,
) -> Result<Option<T>> {
    let over = || -> Result<bool> {
        Ok(group
            .all_gather("patience", patience.is_cancelled())?
            .contains(&true))
    };
    if over()? {
        return Ok(None);
    }
    let figures = measure()?;
    Ok((!over()?).then_some(figures))
}

/// What `measure` gives, if `patience` lasts from before it until after.
pub(super) fn measure_unless_cancelled<T>(
    patience: &CancelToken<'_>,
    measure: impl FnOnce() -> T,
) -> Option<T> {
    if patience.is_cancelled() {
        return None;
    }
    let figures = measure();
    (!patience.is_cancelled()).then_some(figures)
}

/// A mesh in samples of what it follows.
fn mesh_in_samples<'a, const D: usize, M: Simplices<D>>(
    mesh: &'a M,
    features: &Features<D>,
) -> Cow<'a, M> {
    scaled_mesh(mesh, features.potential.step.map(|s| 1.0 / s))
}

/// A mesh with each axis scaled.
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
