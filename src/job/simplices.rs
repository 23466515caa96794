//! Atoms at rest become tetrahedra, or triangles in the plane.

use super::canny::smoothed;
use super::join::{Joined, close_holes, neighbors_of};
use super::measure::Measured;
use super::regions;
use super::{CellKind, Made, Meshing, Params, Scene, Space, Stages};
use crate::error::cause;
use crate::feature::steepness::steepness;
use crate::feature::volume::Volume;
use crate::image::{Field, Image, Source};
use crate::improve::regions::Places;
use crate::improve::triangles::relax::{self, Relaxation};
use crate::improve::{SliverMethod, Target};
use crate::lattice::seeding::Atoms;
use crate::observer::{Patience, Stage};
use crate::ranks;
use crate::report::{Report, Rival};
use crate::{Error, Result};

/// Refuses smoothing where there is nothing to be smoothed.
pub(super) fn check_smoothing<const D: usize>(params: &Params<D>) -> Result<()> {
    if params.smooth.is_some() && (D != 2 || params.cells == CellKind::Voronoi) {
        let (problem, remedy) = ("is for the triangles of 2-D images", "omit it");
        return Err(Error::Job(
            cause("smoothing by the image", problem, remedy).about("smooth"),
        ));
    }
    Ok(())
}

/// What is asked of angles.
pub(super) fn target<const D: usize>(params: &Params<D>) -> Option<Target> {
    params.min_dihedral.map(|min_dihedral| Target {
        min_dihedral,
        method: params.slivers,
    })
}

/// Joins atoms, improves the mesh, and measures it.
pub(super) fn made<const D: usize>(
    atoms: Atoms<D>,
    scene: &Scene<'_, D>,
    source: Source<'_, D>,
    params: &Params<D>,
    stages: &mut Stages<'_>,
) -> Result<(Made<D>, Report)>
where
    Space<D>: Meshing<D>,
{
    let step = scene.features.potential.step;
    let relaxation = match params.smooth {
        Some(scheme) => Some(relaxation(&*source.whole()?, scheme, params, step)),
        None => None,
    };
    let options = target(params);
    ranks::same("atoms at rest", &atoms)?;
    let (joined, neighbors) = stages.kept("5-improved", |stages| {
        let joined = Space::<D>::join(atoms, scene, relaxation.as_ref(), options.as_ref(), stages)?;
        sealed(joined, scene, stages)
    })?;
    let Joined {
        mut made,
        improvement,
        rival,
        ..
    } = joined;
    ranks::same("the mesh", &made)?;
    let numbers = scene.features.labels.as_ref().map(|labelled| {
        let angle = improvement
            .is_some()
            .then_some(params.min_dihedral)
            .flatten();
        stages.patiently(|patience| {
            regions::of_simplices(&mut made, &neighbors, scene, labelled, angle, patience)
        })
    });
    stages.begin(Stage::Measuring);
    let claimed = improvement.is_some().then_some(&*made.feature_faces);
    let labelled = numbers.is_some().then(|| source.whole()).transpose()?;
    let measured = Measured {
        mesh: &made.mesh,
        neighbors: Some(&neighbors),
        claimed,
        feature_faces: Some(&made.feature_faces),
        scene,
    };
    let report = stages.patiently(|patience| {
        let mut figures = measured.figures(patience)?;
        let judged = figures.judged.take().unwrap_or_default();
        if let Some(quality) = &mut figures.quality {
            quality.angles = Some(judged.angles.clone());
        }
        let regions = numbers
            .as_ref()
            .zip(labelled.as_ref())
            .and_then(|(numbers, image)| {
                let places = Places::of_simplices(&made.mesh);
                let contacts = regions::contacts_of_simplices(&made.mesh, &neighbors, numbers);
                let held = (&places, &contacts);
                regions::report(image, &params.labels, held, numbers, step, patience)
            });
        let mut report = Report {
            quality: figures.quality,
            filling: figures.filling,
            fidelity: figures.fidelity,
            lattice: figures.lattice,
            regions,
            ..Report::default()
        };
        if let Some((mesh, faces)) = rival {
            let other = Measured {
                mesh: &mesh,
                neighbors: None,
                claimed: Some(&faces),
                feature_faces: None,
                scene,
            };
            let other = other.figures(patience)?;
            report.rival = other.quality.map(|quality| Rival {
                method: SliverMethod::Joe,
                quality,
                fidelity: other.fidelity,
            });
        }
        Ok((report, judged))
    });
    let (report, judged) = report?;
    made.judged = judged;
    let report = Report {
        improvement,
        ..report
    };
    Ok((Made::Simplices(made), report))
}

/// Closes the holes of what was improved; gives the neighbours of cells besides.
pub(super) fn sealed<const D: usize>(
    mut joined: Joined<<Space<D> as Meshing<D>>::Mesh>,
    scene: &Scene<'_, D>,
    stages: &mut Stages<'_>,
) -> Result<(Joined<<Space<D> as Meshing<D>>::Mesh>, Vec<u32>)>
where
    Space<D>: Meshing<D>,
{
    let Joined {
        made,
        neighbors,
        improvement,
        ..
    } = &mut joined;
    let neighbors = match neighbors.take() {
        Some(neighbors) => neighbors,
        None => neighbors_of(&made.mesh)?,
    };
    if let Some(improvement) = improvement {
        improvement.sealed = stages.patiently(|patience| {
            let marks = &mut made.feature_faces;
            close_holes(&made.mesh, &neighbors, scene, marks, patience)
        });
    }
    Ok((joined, neighbors))
}

/// How the triangles shall be smoothed.
fn relaxation<const D: usize>(
    image: &Image<D>,
    scheme: relax::Scheme,
    params: &Params<D>,
    step: [f64; D],
) -> Relaxation<D> {
    // It is of the plane, and soon done.
    let patience = &Patience::endless();
    let image = smoothed(image, step, params.sigma.unwrap_or(1.0), patience);
    let steepness = steepness(Volume::new(image.dims, &image.samples), patience);
    Relaxation {
        scheme,
        weight: relax::weight(Field {
            samples: steepness,
            ..image
        }),
        rounds: relax::ROUNDS,
    }
}
