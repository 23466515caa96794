//! Atoms at rest become tetrahedra, or triangles in the plane.

use super::canny::smooth_image;
use super::join::{JoinedMesh, cell_neighbours, close_holes};
use super::measure::MeasuredMesh;
use super::regions;
use super::{MeshResult, MeshScene, MeshSpace, Meshing, Params, StageRunner};
use crate::Result;
use crate::comm;
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::volume::Volume;
use crate::image::{Image, ImageSource, ScalarField};
use crate::improve::SliverMethod;
use crate::improve::regions::SamplePoints;
use crate::improve::triangles::relax::{self, Relaxation};
use crate::lattice::seeding::Atoms;
use crate::progress::{CancelToken, Stage};
use crate::report::{Baseline, Report};

/// Joins atoms, improves the mesh, and measures it.
pub(super) fn make_simplices<const D: usize>(
    atoms: Atoms<D>,
    scene: &MeshScene<'_, D>,
    source: ImageSource<'_, D>,
    params: &Params<D>,
    stages: &mut StageRunner<'_>,
) -> Result<(MeshResult<D>, Report)>
where
    MeshSpace<D>: Meshing<D>,
{
    let step = scene.features.potential.step;
    let relaxation = match params.spec.smooth {
        Some(scheme) => Some(relaxation_options(
            &*source.to_image()?,
            scheme,
            params,
            step,
        )),
        None => None,
    };
    let options = params.spec.target();
    comm::ensure_identical("atoms at rest", &atoms)?;
    let (joined, neighbors) = stages.load_or_run("5-improved", |stages| {
        let joined =
            MeshSpace::<D>::join(atoms, scene, relaxation.as_ref(), options.as_ref(), stages)?;
        seal_mesh(joined, scene, stages)
    })?;
    let JoinedMesh {
        annotated_mesh: mut made,
        improvement,
        baseline: rival,
        ..
    } = joined;
    comm::ensure_identical("the mesh", &made)?;
    let numbers = scene.features.labels.as_ref().map(|labelled| {
        let angle = improvement
            .is_some()
            .then_some(params.spec.target())
            .flatten()
            .map(|target| target.min_dihedral);
        stages.run_cancellable(|patience| {
            regions::assign_regions(&mut made, &neighbors, scene, labelled, angle, patience)
        })
    });
    stages.begin(Stage::Measuring);
    let claimed = improvement.is_some().then_some(&*made.feature_faces);
    let labelled = numbers.is_some().then(|| source.to_image()).transpose()?;
    let measured = MeasuredMesh {
        mesh: &made.mesh,
        neighbors: Some(&neighbors),
        tagged_faces: claimed,
        feature_faces: Some(&made.feature_faces),
        scene,
    };
    let report = stages.run_cancellable(|patience| {
        let mut figures = measured.figures(patience)?;
        let judged = figures.angle_assessment.take().unwrap_or_default();
        if let Some(quality) = &mut figures.quality {
            quality.angles = Some(judged.angles.clone());
        }
        let regions = numbers
            .as_ref()
            .zip(labelled.as_ref())
            .and_then(|(numbers, image)| {
                let places = SamplePoints::from_simplices(&made.mesh);
                let contacts = regions::contacts_of_simplices(&made.mesh, &neighbors, numbers);
                let held = (&places, &contacts);
                regions::report(image, &params.spec.label, held, numbers, step, patience)
            });
        let mut report = Report {
            quality: figures.quality,
            box_check: figures.box_check,
            fidelity: figures.fidelity,
            lattice: figures.lattice,
            regions,
            ..Report::default()
        };
        if let Some((mesh, faces)) = rival {
            let other = MeasuredMesh {
                mesh: &mesh,
                neighbors: None,
                tagged_faces: Some(&faces),
                feature_faces: None,
                scene,
            };
            let other = other.figures(patience)?;
            report.baseline = other.quality.map(|quality| Baseline {
                method: SliverMethod::Joe,
                quality,
                fidelity: other.fidelity,
            });
        }
        Ok((report, judged))
    });
    let (report, judged) = report?;
    made.angle_assessment = judged;
    let report = Report {
        improvement,
        ..report
    };
    Ok((MeshResult::Simplices(made), report))
}

/// Closes the holes of what was improved; gives the neighbours of cells besides.
pub(super) fn seal_mesh<const D: usize>(
    mut joined: JoinedMesh<<MeshSpace<D> as Meshing<D>>::Mesh>,
    scene: &MeshScene<'_, D>,
    stages: &mut StageRunner<'_>,
) -> Result<(JoinedMesh<<MeshSpace<D> as Meshing<D>>::Mesh>, Vec<u32>)>
where
    MeshSpace<D>: Meshing<D>,
{
    let JoinedMesh {
        annotated_mesh: made,
        neighbors,
        improvement,
        ..
    } = &mut joined;
    let neighbors = match neighbors.take() {
        Some(neighbors) => neighbors,
        None => cell_neighbours(&made.mesh)?,
    };
    if let Some(improvement) = improvement {
        improvement.sealed = stages.run_cancellable(|patience| {
            let marks = &mut made.feature_faces;
            close_holes(&made.mesh, &neighbors, scene, marks, patience)
        });
    }
    Ok((joined, neighbors))
}

/// How the triangles shall be smoothed.
fn relaxation_options<const D: usize>(
    image: &Image<D>,
    scheme: relax::Scheme,
    params: &Params<D>,
    step: [f64; D],
) -> Relaxation<D> {
    // It is of the plane, and soon done.
    let patience = &CancelToken::never();
    let image = smooth_image(image, step, params.spec.sigma.unwrap_or(1.0), patience);
    let steepness = gradient_magnitude(Volume::new(image.dims, &image.samples), patience);
    Relaxation {
        scheme,
        weight: relax::weight(ScalarField {
            samples: steepness,
            ..image
        }),
        rounds: relax::DEFAULT_ROUNDS,
    }
}
