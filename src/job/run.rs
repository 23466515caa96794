//! The one pass: image in, mesh out.

use super::frame::{JobDomain, lattice_extent};
use super::optimise::optimisation_report;
use super::placement::{self, PlacedAtoms};
use super::spec::{DEFAULT_DISTANCES, NominalDistance};
use super::{
    AnnotatedMesh, CellKind, Checkpoint, MeshScene, MeshShare, MeshSpace, Meshing, Params, Spacing,
    StageRunner, cells, estimate, simplices,
};
use crate::comm::{self, Comm, WorldComm};
use crate::error::cause;
use crate::feature::{self, Features, label_map};
use crate::image::{Geometry, Image, ImageSource};
use crate::lattice::distance::Distance;
use crate::lattice::optimize::{self, StopReason};
use crate::mesh::Mesh;
use crate::mesh::poly::PolyMesh;
use crate::progress::{Progress, Stage};
use crate::report::Report;
use crate::{Error, Result};

/// What a job made, in lattice space, and what led to it.
#[derive(Debug, Clone)]
pub struct Outcome<const D: usize = 3>
where
    MeshSpace<D>: Meshing<D>,
{
    /// The mesh; it fills the box `[0, extent]`.
    pub mesh: MeshResult<D>,
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis.
    pub step: [f64; D],
    /// From samples to the world.
    pub geometry: Geometry<D>,
    /// What of the mesh this rank has; none if it has all.
    pub share: Option<MeshShare>,
    /// What the mesh follows.
    pub features: Features<D>,
    /// Nominal distance between atoms; of a share of a mesh, what is known near it.
    pub distance: Distance<D>,
    /// What the optimiser did in its last pass, where atoms were moved.
    pub optimize_result: Option<optimize::OptimizeResult>,
    /// What it was made from, for whoever reads the file; for the caller to fill in.
    pub provenance: Provenance,
    /// Why the job ended: [`StopPoint::Interrupted`] if any stage was stopped.
    pub stop: StopReason,
    /// Figures of the mesh and of what it cost; where it comes from is for the caller to add.
    pub report: Report,
}

/// What a result can be made again from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Provenance {
    /// All parameters, as the configuration file has them.
    pub parameters: String,
    /// SHA-256 of the input.
    pub input_sha256: String,
}

/// A mesh of either kind of cells.
#[derive(Debug, Clone)]
pub enum MeshResult<const D: usize = 3>
where
    MeshSpace<D>: Meshing<D>,
{
    /// Tetrahedra, triangles in the plane; the atoms are their nodes.
    Simplices(AnnotatedMesh<<MeshSpace<D> as Meshing<D>>::Mesh>),
    /// Voronoi cells; the atoms are within them.
    Voronoi {
        /// The cells.
        mesh: PolyMesh<D>,
        /// Share of the cells' size within which nodes are welded.
        weld: f64,
    },
}

impl<const D: usize> Outcome<D>
where
    MeshSpace<D>: Meshing<D>,
{
    /// The tetrahedra or triangles, if these were asked for.
    pub fn simplices(&self) -> Option<&AnnotatedMesh<<MeshSpace<D> as Meshing<D>>::Mesh>> {
        match &self.mesh {
            MeshResult::Simplices(marked) => Some(marked),
            MeshResult::Voronoi { .. } => None,
        }
    }

    /// The Voronoi cells, if these were asked for.
    pub fn voronoi(&self) -> Option<&PolyMesh<D>> {
        match &self.mesh {
            MeshResult::Simplices(_) => None,
            MeshResult::Voronoi { mesh, .. } => Some(mesh),
        }
    }
}

/// Makes a mesh of an image.
///
/// Voronoi cells of a disc:
///
/// ```
/// use atomesh::image::{Geometry, Image};
/// use atomesh::job::{self, CellKind, MeshSpec, Params};
/// use atomesh::progress::NoProgress;
///
/// let inside = |i: usize| (i % 40) as f64 - 20.0;
/// let disc = (0..40 * 36).map(|i| f32::from(inside(i).hypot((i / 40) as f64 - 18.0) < 11.0));
/// let image = Image::new([40, 36], disc.collect(), Geometry::default());
/// let params = Params::new(MeshSpec {
///     cells: Some(CellKind::Voronoi),
///     distance: "5".parse().unwrap(),
///     ..MeshSpec::default()
/// })?;
/// let outcome = job::run(&image, &params, &mut NoProgress)?;
/// assert!(outcome.report.voronoi.is_some_and(|cells| cells.on_feature > 5));
/// # Ok::<(), atomesh::Error>(())
/// ```
///
/// # Errors
/// The error of the stage that failed: an image that is constant or has no samples with data, a distance that
/// does not fit the box, fixed atoms outside of it or at one place; for Voronoi cells also fixed atoms
/// on a side of the box. [`Error::Interrupted`](crate::Error::Interrupted) if the observer asked to
/// stop before there was a lattice; what a later stop gives, [`Progress`] says.
pub fn run<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    observer: &mut dyn Progress,
) -> Result<Outcome<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    run_from(
        ImageSource::InMemory(image),
        params,
        RunOptions::default(),
        observer,
    )
}

/// How a job goes, which makes no difference to the mesh.
#[derive(Debug, Clone, Copy, Default)]
pub struct RunOptions<'a> {
    /// What stages give is kept there, and what is there of the same job is taken up.
    pub checkpoint: Option<&'a Checkpoint>,
    /// Each rank may have a part of the mesh only, if it is large ([`Outcome::share`]).
    pub may_partition: bool,
}

/// The same of an image that need not be in memory.
///
/// # Errors
/// As [`run`], and [`Error::Io`](crate::Error::Io) if something cannot be kept or read.
pub fn run_from<const D: usize>(
    source: ImageSource<'_, D>,
    params: &Params<D>,
    way: RunOptions<'_>,
    observer: &mut dyn Progress,
) -> Result<Outcome<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    MeshSpace::<D>::run(source, params, way, observer)
}

/// The same, to be compiled in this crate.
pub(super) fn run_precompiled<const D: usize>(
    source: ImageSource<'_, D>,
    params: &Params<D>,
    way: RunOptions<'_>,
    observer: &mut dyn Progress,
) -> Result<Outcome<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    params.spec.validate()?;
    let in_pieces =
        way.may_partition && comm::size() > 1 && params.spec.cell_kind() == CellKind::Simplices;
    let checkpoint = way.checkpoint.map(|kept| kept.for_job(source, params));
    let checkpoint = checkpoint.transpose()?;
    let merged = match params.spec.label.is_empty() {
        true => None,
        false => label_map::merge_labels(&*source.to_image()?, &params.spec.label)?,
    };
    let source = merged.as_ref().map_or(source, ImageSource::InMemory);
    // What is computed of the image's values must not see what stands for missing samples.
    let marked = match source {
        ImageSource::InMemory(image)
            if feature::fills_gaps(image, params.spec.feature, params.modality) =>
        {
            image.mark_dead(!params.spec.input.keeps_nulls())?
        }
        _ => None,
    };
    let source = (marked.as_ref()).map_or(source, |marked| ImageSource::InMemory(&marked.image));
    let (dims, geometry) = (source.dims(), source.geometry());
    let step = params.spec.metric.step(geometry);
    let extent = lattice_extent(dims, step);
    // Before the work: the largest distance must fit, whatever the features are.
    let room = match params.spacing() {
        Spacing::FromCannyAtoms { .. } => extent,
        _ => lattice_extent(dims, params.spec.metric.lengths(geometry)),
    };
    let fitted = params_for_thin_image(params, room);
    let params = fitted.as_ref().unwrap_or(params);
    let wishes = params.spec.label.iter().filter_map(|wish| wish.distance);
    let largest = wishes.fold(params.spacing().max(), f64::max);
    Distance::Constant(largest).validate(room)?;
    estimate::afford_features(source, params.spec.feature)?;
    let params = &*params.in_lattice_units(params.spec.metric.unit(geometry));
    if !matches!(params.spacing(), Spacing::FromCannyAtoms { .. }) {
        // As many as if they were nowhere closer.
        let sparsest = Distance::Constant(params.spacing().max());
        let mut estimate =
            estimate::estimate_from_distance(&sparsest, extent, params.spec.cell_kind());
        if in_pieces {
            estimate = estimate::estimate_per_rank(
                estimate,
                extent,
                &sparsest,
                params.seeding(),
                comm::size(),
            );
        }
        estimate::afford(&estimate)?;
    }
    let frame = JobDomain::new(dims, geometry, params)?;
    let group: &dyn Comm = &WorldComm;

    let mut stages = StageRunner::new(observer)
        .with_checkpoint(checkpoint)
        .with_partitioning(in_pieces);
    stages.begin_unless_stopped(Stage::Features)?;
    let mut options = params.feature_options(step);
    options.is_distributed =
        in_pieces && way.checkpoint.is_none() && placement::needs_only_local_potential(params);
    let mut features = stages.load_or_run("1-features", |stages| {
        stages.run_or_interrupt(Stage::Features, |patience| {
            feature::detect_with_cancel(source, &options, patience)
        })
    })?;
    let (made, mut report, share, distance, optimised) = match params.spec.cell_kind() {
        CellKind::Simplices => {
            let PlacedAtoms {
                mut atoms,
                distance,
                optimize_result: optimised,
            } = placement::place_atoms(source, params, &features, &frame, &mut stages)?;
            let pieces = match in_pieces {
                true => {
                    features.keep_share(group);
                    let outline = distance.outline();
                    let scene = MeshScene {
                        extent,
                        features: &features,
                        distance: &outline,
                    };
                    let target = params.spec.target();
                    let (target, stages) = (target.as_ref(), &mut stages);
                    MeshSpace::<D>::join_distributed(&mut atoms, &scene, &distance, target, stages)?
                }
                false => None,
            };
            let (made, report, share, distance) = match pieces {
                Some(pieces) => {
                    features.replace_points(pieces.near_points);
                    let made = MeshResult::Simplices(pieces.annotated_mesh);
                    (made, pieces.report, Some(pieces.share), pieces.distance)
                }
                None => {
                    features.gather(group)?;
                    let distance = distance.into_global(group)?;
                    let scene = MeshScene {
                        extent,
                        features: &features,
                        distance: &distance,
                    };
                    let atoms = atoms.all_gather(group)?;
                    let (made, report) =
                        simplices::make_simplices(atoms, &scene, source, params, &mut stages)?;
                    (made, report, None, distance)
                }
            };
            (made, report, share, distance, optimised)
        }
        CellKind::Voronoi => {
            let cells = cells::make_cells(source, params, &features, &frame, &mut stages)?;
            let (made, report, distance, rest) = cells;
            (made, report, None, distance, Some(rest))
        }
    };
    if let (true, MeshResult::Simplices(made)) = (features.potential.is_distributed, &made) {
        // What is written has it at nodes.
        features.potential =
            (features.potential).gather_neighbourhood(made.mesh.nodes(), 0.0, group)?;
    }
    if let (Some(lattice), Some(optimised)) = (&mut report.lattice, &optimised) {
        lattice.optimisation = Some(optimisation_report(optimised, lattice.atoms));
    }
    check_validity(&report)?;
    report.outcomes.clone_from(&features.outcomes);
    report.missing = features.missing;
    report.notes.extend(
        marked
            .iter()
            .flat_map(|marked| marked.notes.iter().cloned()),
    );
    report.doubt.clone_from(&features.doubt);
    report.notes.extend(features.notes.iter().cloned());
    report
        .notes
        .extend(placement::distance_note(source, params, &features)?);
    let (costs, interrupted) = stages.finish();
    report.stages = costs;
    let stop = match &optimised {
        _ if interrupted => StopReason::Interrupted,
        Some(optimised) => optimised.stop,
        None => StopReason::Converged,
    };
    Ok(Outcome {
        mesh: made,
        extent,
        step,
        geometry: geometry.clone(),
        share,
        features,
        distance,
        optimize_result: optimised,
        provenance: Provenance::default(),
        stop,
        report,
    })
}

/// Returns the parameters with the default distance as large as a thin image, as of a few slices, has room for;
/// `None` if it fits, or is not the default.
fn params_for_thin_image<const D: usize>(params: &Params<D>, room: [f64; D]) -> Option<Params<D>> {
    let [min, max] = DEFAULT_DISTANCES;
    let most = 0.5 * room.iter().copied().fold(f64::INFINITY, f64::min);
    let fits = most >= max || most < min;
    if fits || params.spacing() != (Spacing::FromFeatureGaps { min, max }) {
        return None;
    }
    let mut params = params.clone();
    params.spec.distance = NominalDistance::Range { min, max: most };
    Some(params)
}

/// The last safety net: a mesh that was measured and found invalid is an error, not a result.
fn check_validity(report: &Report) -> Result<()> {
    let of_cells = report.voronoi.as_ref().map(|cells| &cells.check);
    let check = report.box_check.as_ref().or(of_cells);
    match check.and_then(|check| check.problems.first()) {
        None => Ok(()),
        Some(problem) => Err(Error::Mesh(cause(
            "the mesh",
            format!("came out invalid: {problem}"),
            "choose another distance, seeding or seed; and please report it with the image, for \
             this should never happen",
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::feature::windows::tests::LayeredImage;
    use crate::job::Metric;
    use crate::job::spec::{DistanceSource, MeshSpec};
    use crate::mesh::check::Check;
    use crate::progress::NoProgress;

    /// A disc with a soft edge, whose samples are so long.
    fn disc(sample: f64) -> Image<2> {
        let off = |i: usize| ((i % 60) as f32 - 30.0).hypot((i / 60) as f32 - 25.0) - 15.0;
        let samples = (0..60 * 50).map(|i| 50.0 - 20.0 * off(i).clamp(-2.0, 2.0));
        let mut geometry = Geometry::default();
        geometry.axes = geometry.axes.map(|axis| axis.map(|a| a * sample));
        Image::new([60, 50], samples.collect(), geometry)
    }

    #[test]
    fn a_mesh_is_the_same_whatever_the_unit_of_length() {
        let made = |sample: f64, metric: Metric, sizes: [f64; 2]| {
            let [min, max] = sizes.map(|d| d * sample);
            let params = Params::new(MeshSpec {
                metric,
                distance: NominalDistance::Range { min, max },
                distance_from: DistanceSource::Features,
                ..MeshSpec::default()
            })
            .unwrap();
            let outcome = run(&disc(sample), &params, &mut NoProgress).unwrap();
            let mesh = &outcome.simplices().unwrap().mesh;
            assert!(mesh.triangles.len() > 100, "{sample}");
            (mesh.clone(), outcome.step)
        };
        let sizes = [4.0, 6.0];
        let expected = made(1.0, Metric::Samples, sizes);
        // Powers of two, so that nothing is rounded: from micrometres to 10^60.
        for power in [-20, -3, 9, 20, 33, 200] {
            let sample = 2f64.powi(power);
            assert_eq!(made(sample, Metric::Physical, sizes), expected, "{sample}");
        }
        let scales = Metric::Scales(vec![512.0; 2]);
        assert_eq!(made(1.0, scales, sizes.map(|d| 512.0 * d)), expected);
    }

    #[test]
    fn what_does_not_fit_is_said_in_the_units_of_the_user() {
        let params = Params::<2>::new(MeshSpec {
            metric: Metric::Physical,
            distance: NominalDistance::Constant(16_000.0),
            ..MeshSpec::default()
        })
        .unwrap();
        let error = run(&disc(400.0), &params, &mut NoProgress).unwrap_err();
        let said = error.to_string();
        assert!(
            said.contains("a side of 19600") && said.contains("at most 9800"),
            "{said}"
        );
    }

    #[test]
    fn an_image_in_layers_gives_the_mesh_of_one_in_memory() {
        let sheets = [ExactSurface::plane([1.0, 0.4, 0.2], [22.0; 3])];
        let image = ridge_image([48, 44, 40], &sheets, 1.5, 0.1);
        let by_layers = LayeredImage(&image);
        let folder = tempfile::tempdir().unwrap();
        let [held, in_layers] = [
            ImageSource::InMemory(&image),
            ImageSource::Layered(&by_layers),
        ]
        .map(|source| {
            let params = Params::new(MeshSpec {
                distance: NominalDistance::Constant(7.0),
                ..MeshSpec::default()
            })
            .unwrap();
            let kept = Checkpoint::new(&folder.path().join("kept")).unwrap();
            let way = RunOptions {
                checkpoint: Some(&kept),
                ..RunOptions::default()
            };
            let outcome = run_from(source, &params, way, &mut NoProgress).unwrap();
            // What was kept of the one is of the same job.
            assert!(
                outcome
                    .report
                    .notes
                    .iter()
                    .all(|note| !note.contains("anew"))
            );
            let path = folder.path().join("mesh.vtu");
            outcome.write_with_image(&path, source).unwrap();
            std::fs::read(path).unwrap()
        });
        assert!(held == in_layers);
        // Labels are found with all samples at hand.
        let label = |s: &f32| f32::from(u8::from(*s > 0.5));
        let samples = image.as_slice().iter().map(label).collect();
        let mask = Image::new(image.dims(), samples, Geometry::default());
        let features = run_from(
            ImageSource::Layered(&LayeredImage(&mask)),
            &Params::default(),
            RunOptions::default(),
            &mut NoProgress,
        );
        let notes = features.unwrap().report.notes;
        assert!(notes[0].contains("labels"), "{notes:?}");
    }

    #[test]
    fn an_invalid_mesh_is_no_result() {
        let problems = vec!["the triangles fill 4 instead of the box's 5".to_string()];
        let mut report = Report::default();
        assert!(check_validity(&report).is_ok());
        report.box_check = Some(Check::default());
        assert!(check_validity(&report).is_ok());
        report.box_check = Some(Check {
            problems,
            ..Check::default()
        });
        let said = check_validity(&report).unwrap_err().to_string();
        assert!(said.contains("fill 4 instead of the box's 5"), "{said}");
    }
}
