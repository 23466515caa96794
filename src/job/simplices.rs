//! Makes tetrahedra, or triangles in the plane, from atoms at rest.

use super::canny::smooth_image;
use super::join::{AnnotatedMesh, JoinAtoms, JoinedMesh};
use super::measure::MeasuredMesh;
use super::named_faces::close_given_surfaces;
use super::periodic::MatchedSides;
use super::regions::{self, CellFaces};
use super::{LatticeParams, MeshScene, StageRunner};
use crate::comm::Comm;
use crate::error::cause;
use crate::feature::gradient_magnitude::gradient_magnitude;
use crate::feature::volume::Volume;
use crate::image::{Image, ImageSource, ScalarField};
use crate::improve::SliverMethod;
use crate::improve::regions::SamplePoints;
use crate::lattice::seeding::Atoms;
use crate::mesh::Simplices;
use crate::mesh::view::MeshView;
use crate::progress::{CancelToken, Stage};
use crate::published::relax::{self, Relaxation};
use crate::report::certificate::LabelledCells;
use crate::report::{Baseline, Report, cells_below};
use crate::{Error, Result};

/// A mesh of simplices, the names of its faces, and its report.
pub(super) struct MadeSimplices<M> {
    /// The mesh.
    pub annotated: AnnotatedMesh<M>,
    /// Names of faces, as in [`Outcome::face_names`](super::Outcome::face_names).
    pub face_names: Vec<u32>,
    /// Its report.
    pub report: Report,
}

/// Joins atoms, improves the mesh, and measures it. `sides` are those of a periodic mesh, which has their
/// atoms.
#[expect(
    clippy::too_many_lines,
    reason = "the steps to a measured mesh in their order"
)]
pub(super) fn make_simplices<const D: usize, M: JoinAtoms<D>>(
    atoms: Atoms<D>,
    scene: &MeshScene<'_, D>,
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    sides: Option<&MatchedSides<D>>,
    stages: &mut StageRunner<'_>,
) -> Result<MadeSimplices<M>> {
    let step = scene.features.potential.step;
    let relaxation = (params.spec().smooth)
        .map(|scheme| {
            Ok::<_, Error>(relaxation_options(
                &*source.to_image()?,
                scheme,
                params,
                step,
            ))
        })
        .transpose()?;
    let options = params.spec().target();
    let comm = stages.comm;
    comm.ensure_identical("atoms at rest", &atoms)?;
    let (joined, mut neighbours) = stages.load_or_run("5-improved", |stages| {
        let joined = M::join(
            atoms,
            scene,
            relaxation.as_ref(),
            options.as_ref(),
            sides,
            stages,
        )?;
        seal_mesh(joined, scene, stages)
    })?;
    let JoinedMesh {
        annotated_mesh: mut annotated,
        improvement,
        baseline,
        ..
    } = joined;
    comm.ensure_identical("the mesh", &annotated)?;
    let mut face_names = stages.run_cancellable(|cancel| {
        let marks = &mut annotated.feature_faces;
        close_given_surfaces(&annotated.mesh, &neighbours, scene, marks, cancel)
    })?;
    let target = options.as_ref().filter(|_| improvement.is_some());
    let angle = target.map(|target| target.min_dihedral);
    let pinned = sides.map_or_else(Vec::new, |sides| {
        sides.pinned_labels(&annotated.mesh, &neighbours)
    });
    let faces = CellFaces {
        neighbours: &mut neighbours,
        names: &mut face_names,
        pinned: &pinned,
        opens_pinches: true,
    };
    let label_indices = stages.run_cancellable(|cancel| {
        regions::assign_regions(&mut annotated, faces, scene, angle, cancel)
    });
    if let Some(sides) = sides {
        let nodes = annotated.mesh.nodes();
        sides.release(&mut annotated.node_kinds, nodes, scene.extent);
    }
    stages.begin(Stage::Measuring);
    let label_image = (label_indices.is_some())
        .then(|| source.to_image())
        .transpose()?;
    let measured = MeasuredMesh {
        view: MeshView::from_mesh(&annotated.mesh),
        neighbours: Some(&neighbours),
        tagged_faces: improvement.is_some().then_some(&*annotated.feature_faces),
        feature_faces: Some(&annotated.feature_faces),
        scene,
        near_points: &scene.features.points,
    };
    let (report, assessment) = stages.run_cancellable(|cancel| {
        let figures = measured.figures(comm, cancel)?;
        let (mut report, assessment) = figures.into_report(improvement);
        if let (Some(indices), Some(image)) = (&label_indices, &label_image) {
            let mesh = &annotated.mesh;
            report_labels(
                &mut report,
                mesh,
                &neighbours,
                indices,
                image,
                scene,
                params,
                cancel,
            );
            if let (Some(improvement), Some(target)) = (&mut report.improvement, &options) {
                // Faces between regions are known, and fitted to the labels, only now.
                improvement.below_target_after = cells_below(mesh, target.min_dihedral);
                let marks = &annotated.feature_faces;
                improvement.sealed.compartments = regions::part_count(D + 1, &neighbours, marks);
            }
        }
        report.baseline = match &baseline {
            Some((mesh, faces)) => measure_baseline(mesh, faces, &measured, comm, cancel)?,
            None => None,
        };
        Ok::<_, Error>((report, assessment))
    })?;
    annotated.angle_assessment = assessment;
    Ok(MadeSimplices {
        annotated,
        face_names,
        report,
    })
}

/// Adds the regions and the certificate of a mesh of labels to its report. `indices` has the index of the label
/// of each cell.
#[expect(clippy::too_many_arguments)]
fn report_labels<const D: usize, M: Simplices<D>>(
    report: &mut Report,
    mesh: &M,
    neighbours: &[u32],
    indices: &[u32],
    image: &Image<D>,
    scene: &MeshScene<'_, D>,
    params: &LatticeParams<'_, D>,
    cancel: &CancelToken<'_>,
) {
    let (spec, step) = (params.spec(), scene.features.potential.step);
    let judged = scene.features.labels.as_ref().and_then(|labelled| {
        regions::JudgedLabels::new(image, labelled, &spec.label, spec.min_part_samples())
    });
    let Some(judged) = judged else { return };
    let to_index = |x: &[f64; D]| std::array::from_fn(|k| x[k] / step[k]);
    let cells = LabelledCells::from_simplices(mesh, neighbours, indices, to_index);
    report.certificate = regions::certificate(image, &judged, &spec.cell_choice(), &cells, cancel);
    let points = SamplePoints::from_simplices(mesh);
    let contacts = regions::contacts_of_simplices(mesh, neighbours, indices);
    report.regions = regions::report(image, judged, &points, &contacts, indices, step, cancel);
    report.name_smoothed_interface();
}

/// Measures the mesh of the baseline method as the mesh with which it is compared.
fn measure_baseline<const D: usize, M: Simplices<D>>(
    mesh: &M,
    faces: &[u8],
    measured: &MeasuredMesh<'_, D, M>,
    comm: &dyn Comm,
    cancel: &CancelToken<'_>,
) -> Result<Option<Baseline>> {
    let baseline = MeasuredMesh {
        view: MeshView::from_mesh(mesh),
        neighbours: None,
        tagged_faces: Some(faces),
        feature_faces: None,
        ..*measured
    };
    let figures = baseline.figures(comm, cancel)?;
    Ok(figures.quality.map(|quality| Baseline {
        method: SliverMethod::Joe,
        quality,
        fidelity: figures.fidelity,
    }))
}

/// Closes the holes in the features of an improved mesh. Also returns the neighbours of cells.
pub(super) fn seal_mesh<const D: usize, M: Simplices<D>>(
    mut joined: JoinedMesh<M>,
    scene: &MeshScene<'_, D>,
    stages: &mut StageRunner<'_>,
) -> Result<(JoinedMesh<M>, Vec<u32>)> {
    let JoinedMesh {
        annotated_mesh: annotated,
        neighbours,
        improvement,
        ..
    } = &mut joined;
    let neighbours = match neighbours.take() {
        Some(neighbours) => neighbours,
        None => cell_neighbours(&annotated.mesh)?,
    };
    if let Some(improvement) = improvement {
        improvement.sealed = stages.run_cancellable(|cancel| {
            let marks = &mut annotated.feature_faces;
            let points = &scene.features.points;
            scene.close_holes(&annotated.mesh, &neighbours, points, marks, cancel)
        })?;
    }
    Ok((joined, neighbours))
}

/// Returns for every cell and face, in order, the cell on the other side, or `NONE`.
///
/// # Errors
/// Returns [`Error::Mesh`] if a face belongs to more than two cells.
pub(crate) fn cell_neighbours<const D: usize, M: Simplices<D>>(mesh: &M) -> Result<Vec<u32>> {
    mesh.neighbours().map_err(|face| {
        Error::Mesh(cause(
            format!("face {face:?}"),
            format!("belongs to more than two {}", M::CELLS_NAME),
            "mesh the image again",
        ))
    })
}

/// Returns the options for smoothing triangles.
fn relaxation_options<const D: usize>(
    image: &Image<D>,
    scheme: relax::Scheme,
    params: &LatticeParams<'_, D>,
    step: [f64; D],
) -> Relaxation<D> {
    // Images of the plane are smoothed quickly, so that no cancellation is needed.
    let cancel = &CancelToken::never();
    let image = smooth_image(image, step, params.spec().sigma.unwrap_or(1.0), cancel);
    let gradient = gradient_magnitude(Volume::new(image.dims, &image.samples), cancel);
    Relaxation {
        scheme,
        weight: relax::weight(ScalarField {
            samples: gradient,
            ..image
        }),
        rounds: relax::DEFAULT_ROUNDS,
    }
}
