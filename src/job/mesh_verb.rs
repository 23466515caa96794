//! Runs all stages of a job: image in, mesh out.

use std::sync::Arc;

use super::cell_choice::{check_choice, choose_cells, with_coarse_cells, without_outside};
use super::cover::{self, Cover};
use super::distributed::MakePartition;
use super::given_surfaces::SurfacesInImage;
use super::job_domain::{JobDomain, lattice_extent};
use super::minimisation::optimisation_report;
use super::padding::{Pad, PaddingCells};
use super::placement::{self, PlacedAtoms};
use super::spec::{DEFAULT_DISTANCES, MeshSpec, NominalDistance, Padding};
use super::topography::Topography;
use super::{
    AnnotatedMesh, CellKind, Checkpoint, JoinAtoms, LatticeParams, MeshScene, MeshShare, Metric,
    Params, Spacing, StageRunner, advice, cells, estimate, horizons, live, periodic, simplices,
};
use crate::comm::{Comm, SelfComm};
use crate::error::cause;
use crate::feature::{self, Features, SharedGrid, label_map};
use crate::geometry::statistics::upper_median;
use crate::image::{Geometry, Image, ImageSource, MaskedImage};
use crate::lattice::distance::Distance;
use crate::lattice::optimise::{self, StopReason};
#[cfg(doc)]
use crate::mesh::complex::NONE;
use crate::mesh::interface::marks_from_bits;
use crate::mesh::periodic::{PeriodicNodes, check_periodic};
use crate::mesh::poly::PolyMesh;
use crate::mesh::{Dimension, SimplexMesh, Simplices, Space, TetMesh, TriMesh};
use crate::mesh_file::Provenance;
use crate::progress::{Progress, Stage};
use crate::report::Report;
use crate::{Error, Result};

/// Result of a job, in lattice space.
#[derive(Debug, Clone)]
pub struct Outcome<const D: usize = 3, M = SimplexMesh<D>> {
    /// The mesh; it fills the box `[0, extent]`.
    pub mesh: MeshResult<D, M>,
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis of lattice space.
    pub step: [f64; D],
    /// Position of the mesh's corner in the lattice space of the features and the distance: half a sample
    /// beyond their corner if the mesh covers voxels, else 0.
    pub feature_offset: [f64; D],
    /// Geometry of the image, which maps samples to physical coordinates.
    pub geometry: Geometry<D>,
    /// Cells beyond the image, if the mesh continues there.
    pub padding: Option<PaddingCells<D>>,
    /// The part of the mesh that this rank holds; `None` if it holds the whole mesh.
    pub share: Option<MeshShare>,
    /// The features that the mesh follows.
    pub features: Features<D>,
    /// For each face of the mesh the index in [`Features::names`] of the surface that it lies on, or
    /// `NONE`; empty if no surface has a name.
    pub face_names: Vec<u32>,
    /// The share of each cell that holds data; `None` if all cells are full of data.
    pub live: Option<Vec<f64>>,
    /// The cells that files of the mesh contain, ascending; `None` for all of them.
    pub kept_cells: Option<Vec<u32>>,
    /// The nodes on opposite sides that match; `None` if the mesh is not periodic.
    pub periodic_nodes: Option<PeriodicNodes>,
    /// Nominal distance between atoms; for a part of a mesh, it is known near that part.
    pub distance: Distance<D>,
    /// Result of the optimiser's last pass, if atoms were moved.
    pub optimise_result: Option<optimise::OptimiseResult>,
    /// Provenance that is written into the file; the caller sets it.
    pub provenance: Provenance,
    /// Reason for the end of the job: [`StopReason::Interrupted`] if any stage was stopped.
    pub stop: StopReason,
    /// Figures of the mesh and of its cost; the caller adds the input.
    pub report: Report,
}

/// A mesh of either kind of cells.
#[derive(Debug, Clone)]
pub enum MeshResult<const D: usize = 3, M = SimplexMesh<D>> {
    /// Tetrahedra, or triangles in the plane. The atoms are their nodes.
    Simplices(AnnotatedMesh<M>),
    /// Voronoi cells. The atoms are inside them.
    Voronoi {
        /// The cells.
        mesh: PolyMesh<D>,
        /// Fraction of the cells' size within which nodes are welded.
        weld: f64,
    },
}

impl<const D: usize, M> Outcome<D, M> {
    /// Returns the tetrahedra or triangles, if the mesh has them.
    pub fn simplices(&self) -> Option<&AnnotatedMesh<M>> {
        match &self.mesh {
            MeshResult::Simplices(annotated) => Some(annotated),
            MeshResult::Voronoi { .. } => None,
        }
    }

    /// Returns the Voronoi cells, if the mesh has them.
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
/// let offset = |i: usize| (i % 40) as f64 - 20.0;
/// let disc = (0..40 * 36).map(|i| f32::from(offset(i).hypot((i / 40) as f64 - 18.0) < 11.0));
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
/// Returns the error of the stage that failed: for an image that is constant or has no samples with
/// data, for a distance that does not fit the box, and for fixed atoms outside the box or at the
/// same place; for Voronoi cells also for fixed atoms on a side of the box. Returns
/// [`Error::Interrupted`](crate::Error::Interrupted) if the job is stopped before there is a
/// lattice; [`Progress`] describes the result of a later stop.
pub fn run<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    progress: &mut dyn Progress,
) -> Result<Outcome<D>>
where
    Space<D>: MeshImage<D>,
{
    let image = ImageSource::InMemory(image);
    Space::<D>::run_job(image, params, RunOptions::default(), progress)
}

/// Options of a run that do not change the mesh.
#[derive(Debug, Clone, Copy)]
pub struct RunOptions<'a> {
    /// Folder in which results of stages are stored, and from which those of the same job are
    /// loaded.
    pub checkpoint: Option<&'a Checkpoint>,
    /// `true` if each rank may hold only a part of the mesh, if the mesh is large
    /// ([`Outcome::share`]).
    pub may_partition: bool,
    /// The ranks that share the job; by default this process alone.
    pub comm: &'a dyn Comm,
    /// `true` for a job that tries an option, after which no others are tried.
    pub is_trial: bool,
}

impl Default for RunOptions<'_> {
    fn default() -> Self {
        Self {
            checkpoint: None,
            may_partition: false,
            comm: &SelfComm,
            is_trial: false,
        }
    }
}

/// Makes a mesh of an image that need not be in memory.
///
/// # Errors
/// Returns the errors of [`run`], and [`Error::Io`](crate::Error::Io) if a file cannot be written
/// or read.
pub fn run_from<const D: usize>(
    source: ImageSource<'_, D>,
    params: &Params<D>,
    run_options: RunOptions<'_>,
    progress: &mut dyn Progress,
) -> Result<Outcome<D>>
where
    Space<D>: MeshImage<D>,
{
    Space::<D>::run_job(source, params, run_options, progress)
}

/// A dimension in which images are meshed.
pub trait MeshImage<const D: usize>: Dimension<D> {
    /// Runs a job as [`run_from`] does. It is compiled once with this crate and not again in each
    /// crate that meshes.
    ///
    /// # Errors
    /// Returns the errors of [`run_from`].
    fn run_job(
        source: ImageSource<'_, D>,
        params: &Params<D>,
        run_options: RunOptions<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Outcome<D, Self::Mesh>>;
}

impl MeshImage<2> for Space<2> {
    fn run_job(
        source: ImageSource<'_, 2>,
        params: &Params<2>,
        run_options: RunOptions<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Outcome<2, TriMesh>> {
        run_covering(source, params, run_options, progress)
    }
}

impl MeshImage<3> for Space<3> {
    fn run_job(
        source: ImageSource<'_, 3>,
        params: &Params<3>,
        run_options: RunOptions<'_>,
        progress: &mut dyn Progress,
    ) -> Result<Outcome<3, TetMesh>> {
        let mut outcome = run_covering(source, params, run_options, progress)?;
        if !run_options.is_trial && run_options.comm.size() == 1 {
            advice::advise(source, params, &mut outcome, progress);
        }
        Ok(outcome)
    }
}

/// Runs all stages of a job, for the box through the outermost samples or for full voxels.
fn run_covering<const D: usize, M: JoinAtoms<D> + MakePartition<D> + Pad<D>>(
    source: ImageSource<'_, D>,
    params: &Params<D>,
    run_options: RunOptions<'_>,
    progress: &mut dyn Progress,
) -> Result<Outcome<D, M>>
where
    Space<D>: Dimension<D, Mesh = M>,
{
    if params.spec.cover == Cover::Samples {
        return run_stages(source, params, run_options, progress);
    }
    let image = source.to_image()?;
    let padded_image = cover::padded(&image);
    let padded_source = ImageSource::InMemory(&padded_image);
    let padded_params = cover::padded_params(params);
    let mut outcome = run_stages(padded_source, &padded_params, run_options, progress)?;
    cover::squeeze(&mut outcome, &image, &params.spec)?;
    Ok(outcome)
}

/// Runs all stages of a job.
#[expect(clippy::too_many_lines, reason = "the stages of a job in their order")]
fn run_stages<const D: usize, M: JoinAtoms<D> + MakePartition<D> + Pad<D>>(
    source: ImageSource<'_, D>,
    params: &Params<D>,
    run_options: RunOptions<'_>,
    progress: &mut dyn Progress,
) -> Result<Outcome<D, M>>
where
    Space<D>: Dimension<D, Mesh = M>,
{
    let comm = run_options.comm;
    params.spec.validate()?;
    let params = &*params.with_label_names(source)?;
    let restricted = without_outside(params, source)?;
    let (source, params) = match &restricted {
        Some((image, params)) => (ImageSource::InMemory(image), params),
        None => (source, params),
    };
    let is_partitioned = run_options.may_partition && can_be_partitioned(params, comm);
    let for_job = |checkpoint: &Checkpoint| checkpoint.for_job(source, params, comm);
    let checkpoint = run_options.checkpoint.map(for_job).transpose()?;
    let prepared = PreparedImage::new(source, params)?;
    let source = prepared.source(source);
    if let Some(axes) = params.spec.periodic {
        periodic::check_axes(axes, source, comm)?;
    }
    let (dims, geometry) = (source.dims(), source.geometry());
    let (placed, notes_on_points) = params.with_points_in(geometry, dims)?;
    let params = &*placed.with_metric_for(source)?;
    let step = params.spec.metric.step(geometry);
    let extent = lattice_extent(dims, step);
    let coarse = with_coarse_cells(
        params,
        source,
        lattice_extent(dims, params.spec.metric.lengths(geometry)),
    )?;
    let params = coarse.as_ref().unwrap_or(params);
    let fitted = fitted_params(params, dims, geometry, extent)?;
    let params = fitted.as_ref().unwrap_or(params);
    let distance_in_use = params.spec.distance.to_string();
    let shape_option = shape_option(params, geometry, dims);
    estimate::afford_features(source, params.spec.feature, comm.size())?;
    let lattice = &LatticeParams::new(params, params.spec.metric.unit(geometry));
    afford_lattice(lattice, extent, is_partitioned.then(|| comm.size()))?;
    let frame = JobDomain::new(dims, geometry, lattice)?;

    let mut stages = StageRunner::new(progress)
        .with_comm(comm)
        .with_kernel(params.spec.delaunay)
        .with_checkpoint(checkpoint)
        .with_partitioning(is_partitioned);
    stages.begin_unless_stopped(Stage::Features)?;
    let given = params.surfaces_in_image(geometry, dims)?;
    let topography = Topography::new(params, geometry, dims, step, extent)?;
    let may_distribute = is_partitioned && run_options.checkpoint.is_none();
    let mut features = find_features(
        source,
        lattice,
        step,
        given.as_ref(),
        may_distribute,
        &mut stages,
    )?;
    check_choice(params, &features)?;
    let mut made = make_mesh(source, lattice, &mut features, &frame, &mut stages)?;
    gather_potential(&mut features, &made.mesh, comm)?;
    let (mesh, distance, report) = (&made.mesh, &made.distance, &mut made.report);
    check_validity(report)?;
    (report.distance_in_use, report.shape_option) = (Some(distance_in_use), shape_option);
    suggest_distance(report, &features, distance);
    report.has_memory_for_finer = has_memory_for_finer(mesh, params.spec.cell_kind());
    add_optimisation(report, made.optimise_result.as_ref());
    let live = live::shares_in_job(source, &features, params, mesh, step, made.share.is_some())?;
    add_findings(report, &prepared, &features, live.as_deref());
    let (notes_on_given, outside) = given.map_or_else(Default::default, |g| (g.notes, g.outside));
    report.add_given_surfaces(outside, &features.names);
    let kept_cells = choose_cells(params, mesh, &features, distance, extent, report)?;
    report.notes.extend(params.metric_note.clone());
    let notes = notes_on_points.into_iter().chain(notes_on_given);
    (report.notes).extend(notes.chain(placement::distance_note(source, lattice, &features)?));
    let scene = scene_of(extent, &features, distance);
    let padding = pad(
        params,
        topography.as_ref(),
        mesh,
        &scene,
        geometry,
        report,
        &mut stages,
    )?;
    let (costs, interrupted) = stages.finish();
    report.stages = costs;
    Ok(Outcome {
        stop: stop_reason(made.optimise_result.as_ref(), interrupted),
        mesh: made.mesh,
        extent,
        step,
        feature_offset: [0.0; D],
        geometry: geometry.clone(),
        padding,
        share: made.share,
        features,
        face_names: made.face_names,
        live,
        kept_cells,
        periodic_nodes: made.periodic_nodes,
        distance: made.distance,
        optimise_result: made.optimise_result,
        provenance: Provenance::default(),
        report: made.report,
    })
}

/// Returns `true` if a job with these parameters can be distributed over ranks up to its mesh.
fn can_be_partitioned<const D: usize>(params: &Params<D>, comm: &dyn Comm) -> bool {
    let keeps_all = params.spec.cell_choice().keeps_all();
    let is_plain = params.spec.pad.is_none() && params.spec.cover == Cover::Samples;
    comm.size() > 1 && is_plain && keeps_all && params.spec.cell_kind() == CellKind::Simplices
}

/// Gathers a distributed potential at the nodes of a mesh, as it is written to the mesh file.
fn gather_potential<const D: usize, M: Simplices<D>>(
    features: &mut Features<D>,
    mesh: &MeshResult<D, M>,
    comm: &dyn Comm,
) -> Result<()> {
    if let (true, MeshResult::Simplices(annotated)) = (features.potential.is_distributed, mesh) {
        let nodes = annotated.mesh.nodes();
        features.potential = features.potential.gather_neighbourhood(nodes, 0.0, comm)?;
    }
    Ok(())
}

/// Finds the features of the image, and adds the given surfaces. The potential may be distributed over
/// ranks if `may_distribute`.
fn find_features<const D: usize>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    step: [f64; D],
    given: Option<&SurfacesInImage<D>>,
    may_distribute: bool,
    stages: &mut StageRunner<'_>,
) -> Result<Features<D>> {
    let mut options = params.feature_options(step);
    options.given = given.map(|given| Arc::clone(&given.points));
    options.is_distributed =
        may_distribute && given.is_none() && placement::needs_only_local_potential(params);
    let grid = SharedGrid::new(source.dims(), stages.comm);
    stages.load_or_run("1-features", |stages| {
        stages.run_or_interrupt(Stage::Features, |cancel| {
            feature::detect_with_cancel(source, &options, grid, cancel)
        })
    })
}

/// Makes the report suggest distances below that in use where regions need smaller cells.
fn suggest_distance<const D: usize>(
    report: &mut Report,
    features: &Features<D>,
    distance: &Distance<D>,
) {
    if let Some(regions) = &mut report.regions {
        regions.suggest_below(typical_distance(features, distance));
    }
}

/// Returns the distance between atoms at half of the feature points; `None` if it is not known.
fn typical_distance<const D: usize>(features: &Features<D>, distance: &Distance<D>) -> Option<f64> {
    let constant = match distance {
        Distance::Constant(d) => Some(*d),
        _ => None,
    };
    let mut spacing = features.spacing.clone().unwrap_or_default();
    upper_median(&mut spacing).map(f64::from).or(constant)
}

/// Returns the options that make cells well shaped in physical space. If the image is too thin there
/// for the distance in use, they have a smaller one.
fn shape_option<const D: usize>(
    params: &Params<D>,
    geometry: &Geometry<D>,
    dims: [usize; D],
) -> String {
    let extent = lattice_extent(dims, Metric::Shape.lengths(geometry));
    let limit = 0.5 * extent.into_iter().fold(f64::INFINITY, f64::min);
    // Two digits, rounded down.
    let limit = (10.0 * limit).floor() / 10.0;
    match params.spec.distance {
        NominalDistance::Constant(d) if d > limit => {
            format!("--metric shape --distance {limit}")
        }
        NominalDistance::Range { min, max } if max > limit => {
            format!("--metric shape --distance {}:{limit}", min.min(limit))
        }
        _ => "--metric shape".into(),
    }
}

/// Returns `true` if there is memory for a mesh with half the distance between atoms.
fn has_memory_for_finer<const D: usize, M: Simplices<D>>(
    mesh: &MeshResult<D, M>,
    cells: CellKind,
) -> bool {
    let atoms = match mesh {
        MeshResult::Simplices(annotated) => annotated.mesh.nodes().len(),
        MeshResult::Voronoi { mesh, .. } => mesh.sites.len(),
    };
    let finer_atoms = atoms as f64 * f64::from(1u32 << D);
    estimate::afford(&estimate::estimate_from_atom_count::<D>(finer_atoms, cells)).is_ok()
}

/// Adds the result of the optimiser to the report.
fn add_optimisation(report: &mut Report, result: Option<&optimise::OptimiseResult>) {
    if let (Some(lattice), Some(optimised)) = (&mut report.lattice, result) {
        lattice.optimisation = Some(optimisation_report(optimised, lattice.atoms));
    }
}

/// Returns how far a mesh reaches beyond its image. A topography determines the thickness above it, and gets
/// a note in the report.
fn padding_of(
    given: Option<Padding>,
    topography: Option<&Topography>,
    report: &mut Report,
) -> Option<Padding> {
    let (Some(given), Some(topography)) = (given, topography) else {
        return given;
    };
    report.notes.push(topography.note(given.above));
    Some(Padding {
        above: topography.mean_height(),
        ..given
    })
}

/// Returns the scene of a mesh.
fn scene_of<'a, const D: usize>(
    extent: [f64; D],
    features: &'a Features<D>,
    distance: &'a Distance<D>,
) -> MeshScene<'a, D> {
    MeshScene {
        extent,
        features,
        distance,
    }
}

/// Continues a mesh beyond its image, if the options ask for that.
fn pad<const D: usize, M: Pad<D>>(
    params: &Params<D>,
    topography: Option<&Topography>,
    mesh: &MeshResult<D, M>,
    scene: &MeshScene<'_, D>,
    geometry: &Geometry<D>,
    report: &mut Report,
    stages: &mut StageRunner<'_>,
) -> Result<Option<PaddingCells<D>>> {
    let padding = padding_of(params.spec.pad, topography, report);
    let (Some(padding), MeshResult::Simplices(annotated)) = (padding, mesh) else {
        return Ok(None);
    };
    let (mesh, angle) = (&annotated.mesh, params.spec.min_angle());
    let padded = mesh.pad(&padding, topography, scene, geometry, angle, stages)?;
    Ok(padded.map(|(cells, measured)| {
        report.padding = Some(measured);
        cells
    }))
}

/// Adds what is known of the image, the features and the shares of the cells that hold data to the
/// report.
fn add_findings<const D: usize>(
    report: &mut Report,
    image: &PreparedImage<D>,
    features: &Features<D>,
    live: Option<&[f64]>,
) {
    report.notes.extend(image.notes().cloned());
    add_features(report, features);
    let note_on_live = live.and_then(live::note_on_live_shares);
    report.notes.extend(note_on_live);
}

/// Adds what is known of the features to the report.
fn add_features<const D: usize>(report: &mut Report, features: &Features<D>) {
    report.outcomes.clone_from(&features.outcomes);
    report.missing = features.missing;
    report.doubt.clone_from(&features.doubt);
    report.notes.extend(features.notes.iter().cloned());
}

/// Returns the reason for the end of a job. `is_interrupted` is `true` if any stage was stopped.
fn stop_reason(
    optimise_result: Option<&optimise::OptimiseResult>,
    is_interrupted: bool,
) -> StopReason {
    match optimise_result {
        _ if is_interrupted => StopReason::Interrupted,
        Some(optimised) => optimised.stop,
        None => StopReason::Converged,
    }
}

/// Checks that the largest distance fits the box, whatever the features are. Returns other
/// parameters for a thin image.
///
/// # Errors
/// Returns the errors of [`Distance::validate`] and of [`check_default_distance`].
fn fitted_params<const D: usize>(
    params: &Params<D>,
    dims: [usize; D],
    geometry: &Geometry<D>,
    extent: [f64; D],
) -> Result<Option<Params<D>>> {
    let box_extent = match params.spacing() {
        Spacing::FromCannyAtoms { .. } => extent,
        _ => lattice_extent(dims, params.spec.metric.lengths(geometry)),
    };
    let fitted = params_for_thin_image(params, box_extent);
    let params = fitted.as_ref().unwrap_or(params);
    let labels = params.spec.label.iter();
    let label_distances = labels.filter_map(|options| options.distance);
    let largest = label_distances.fold(params.spacing().max(), f64::max);
    Distance::Constant(largest).validate(box_extent)?;
    check_default_distance(&params.spec, geometry)?;
    Ok(fitted)
}

/// Smallest value, in samples, of the upper limit of the default distance.
const MIN_DEFAULT_DISTANCE: f64 = 2.0;

/// Checks that the default distance, which is meant in samples, is not a small part of one in the unit
/// of the metric: 8 metres where a sample is 10 metres long.
///
/// # Errors
/// Returns an error if its upper limit is less than two samples.
fn check_default_distance<const D: usize>(spec: &MeshSpec, geometry: &Geometry<D>) -> Result<()> {
    let [min, max] = DEFAULT_DISTANCES;
    let unit = spec.metric.unit(geometry);
    if spec.distance != NominalDistance::default() || max >= MIN_DEFAULT_DISTANCE * unit {
        return Ok(());
    }
    Err(Error::Distance(cause(
        "the distance between atoms",
        format!(
            "is {min} to {max} by default, and with --metric {} in units of which a sample has {unit:.3}",
            spec.metric
        ),
        format!(
            "give --distance {:.0}:{:.0}, which is {min} to {max} samples, or leave out --metric",
            min * unit,
            max * unit
        ),
    )))
}

/// An image whose labels are merged and whose missing samples are marked, where that is needed.
struct PreparedImage<const D: usize> {
    merged: Option<Image<D>>,
    marked: Option<MaskedImage<D>>,
}

impl<const D: usize> PreparedImage<D> {
    /// Returns the notes on samples that hold no data.
    fn notes(&self) -> impl Iterator<Item = &String> {
        self.marked.iter().flat_map(|marked| &marked.notes)
    }

    fn new(source: ImageSource<'_, D>, params: &Params<D>) -> Result<Self> {
        let merged = if params.spec.label.is_empty() {
            None
        } else {
            label_map::merge_labels(&*source.to_image()?, &params.spec.label)?
        };
        // Values that mark missing samples must not enter computations on the image.
        let marked = match merged.as_ref().map_or(source, ImageSource::InMemory) {
            ImageSource::InMemory(image)
                if feature::fills_gaps(image, params.spec.feature, params.modality) =>
            {
                image.mark_dead(!params.spec.input.keeps_nulls())?
            }
            // Labels continue where samples are left out, and the cells there are not live.
            ImageSource::InMemory(image) if params.spec.feature.has_labels() => {
                let marked = image.mark_dead(false)?;
                marked.map(|marked| MaskedImage {
                    image: marked.image.filled_from_nearest(),
                    notes: marked.notes,
                })
            }
            _ => None,
        };
        Ok(Self { merged, marked })
    }

    /// Returns the prepared image; `source` is the original.
    fn source<'a>(&'a self, source: ImageSource<'a, D>) -> ImageSource<'a, D> {
        let marked = self.marked.as_ref().map(|marked| &marked.image);
        let image = marked.or(self.merged.as_ref());
        image.map_or(source, ImageSource::InMemory)
    }
}

/// Checks that there is memory for the lattice, if all atoms were at the largest distance;
/// `rank_count` ranks share it, if it is partitioned.
fn afford_lattice<const D: usize>(
    params: &LatticeParams<'_, D>,
    extent: [f64; D],
    rank_count: Option<usize>,
) -> Result<()> {
    if matches!(params.spacing(), Spacing::FromCannyAtoms { .. }) {
        return Ok(());
    }
    let sparsest = Distance::Constant(params.spacing().max());
    let cells = params.spec().cell_kind();
    let mut estimate = estimate::estimate_from_distance(&sparsest, extent, cells);
    if let Some(count) = rank_count {
        let seeding = params.spec().seeding;
        estimate = estimate::estimate_per_rank(estimate, extent, &sparsest, seeding, count);
    }
    estimate::afford(&estimate)
}

/// A mesh, or a rank's part of it, with what is known of it.
pub(super) struct MadeMesh<const D: usize, M> {
    pub mesh: MeshResult<D, M>,
    /// Names of faces, as in [`Outcome::face_names`].
    pub face_names: Vec<u32>,
    pub report: Report,
    /// Which part of the mesh this rank has, if it is partitioned.
    pub share: Option<MeshShare>,
    /// Nodes on opposite sides that match.
    pub periodic_nodes: Option<PeriodicNodes>,
    pub distance: Distance<D>,
    pub optimise_result: Option<optimise::OptimiseResult>,
}

/// Makes a mesh of the kind of cells that the options ask for.
fn make_mesh<const D: usize, M: JoinAtoms<D> + MakePartition<D>>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    features: &mut Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<MadeMesh<D, M>>
where
    Space<D>: Dimension<D, Mesh = M>,
{
    if params.spec().cell_kind() == CellKind::Simplices {
        return join_atoms(source, params, features, frame, stages);
    }
    cells::make_cells(source, params, features, frame, stages)
}

/// Places atoms, joins them and improves the mesh: each rank its part, if possible, or else the
/// whole mesh on each rank. Features that a rank does not need are dropped.
fn join_atoms<const D: usize, M: JoinAtoms<D> + MakePartition<D>>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    features: &mut Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<MadeMesh<D, M>> {
    let (comm, extent) = (stages.comm, frame.extent);
    let PlacedAtoms {
        mut atoms,
        distance,
        optimise_result,
    } = placement::place_atoms(source, params, features, frame, stages)?;
    let partition = if stages.may_partition {
        features.keep_share(comm);
        let outline = distance.outline();
        let scene = MeshScene {
            extent,
            features,
            distance: &outline,
        };
        let target = params.spec().target();
        M::make_partition(&mut atoms, &scene, &distance, target.as_ref(), stages)?
    } else {
        None
    };
    if let Some(partition) = partition {
        features.replace_points(partition.near_points);
        let annotated = partition.annotated_mesh;
        let marks: Vec<bool> = marks_from_bits::<D>(&annotated.feature_faces).collect();
        return Ok(MadeMesh {
            face_names: horizons::face_names(&annotated.mesh, &marks, features),
            mesh: MeshResult::Simplices(annotated),
            report: partition.report,
            share: Some(partition.share),
            periodic_nodes: None,
            distance: partition.distance,
            optimise_result,
        });
    }
    features.gather(comm)?;
    let distance = distance.into_global(comm)?;
    let scene = MeshScene {
        extent,
        features,
        distance: &distance,
    };
    let mut atoms = atoms.all_gather(comm)?;
    let axes = params.periodic_axes();
    let mut sides = axes
        .map(|axes| M::match_sides(std::mem::take(&mut atoms), &scene, params, axes, stages))
        .transpose()?;
    if let Some(sides) = &mut sides {
        atoms = std::mem::take(&mut sides.atoms);
    }
    let made =
        simplices::make_simplices::<D, M>(atoms, &scene, source, params, sides.as_ref(), stages)?;
    let mut report = made.report;
    let mut periodic_nodes = None;
    if let (Some(flags), Some(axes)) = (axes, params.spec().periodic) {
        let AnnotatedMesh { mesh, regions, .. } = &made.annotated;
        let neighbours = simplices::cell_neighbours(mesh)?;
        let (nodes, check) = check_periodic(mesh, &neighbours, regions, extent, flags)?;
        report.notes.push(periodic::note(axes, &check));
        periodic_nodes = Some(nodes);
    }
    Ok(MadeMesh {
        mesh: MeshResult::Simplices(made.annotated),
        face_names: made.face_names,
        report,
        share: None,
        periodic_nodes,
        distance,
        optimise_result,
    })
}

/// Smallest distance, in samples, to which the default is reduced: that of three slices.
const MIN_THIN_DISTANCE: f64 = 1.0;

/// Returns the parameters with the default distance reduced to what a thin image, such as one of a
/// few slices, has room for. Returns `None` if the distance fits, or is not the default.
fn params_for_thin_image<const D: usize>(
    params: &Params<D>,
    box_extent: [f64; D],
) -> Option<Params<D>> {
    let [min, max] = DEFAULT_DISTANCES;
    let largest = 0.5 * box_extent.iter().copied().fold(f64::INFINITY, f64::min);
    let fits = largest >= max || largest < MIN_THIN_DISTANCE;
    if fits || params.spacing() != (Spacing::FromFeatureGaps { min, max }) {
        return None;
    }
    let mut params = params.clone();
    params.spec.distance = if largest > min {
        NominalDistance::Range { min, max: largest }
    } else {
        NominalDistance::Constant(largest)
    };
    Some(params)
}

/// Checks the validity of the mesh. A mesh that was measured and found invalid is an error, not a
/// result.
fn check_validity(report: &Report) -> Result<()> {
    let voronoi_check = report.voronoi.as_ref().map(|cells| &cells.check);
    let check = report.box_check.as_ref().or(voronoi_check);
    match check.and_then(|check| check.problems.first()) {
        None => Ok(()),
        Some(problem) => Err(Error::Mesh(cause(
            "the mesh",
            format!("came out invalid: {problem}"),
            "choose another distance, seeding or seed, and please report it with the image: this is \
             an error in atomesh",
        ))),
    }
}

#[cfg(test)]
#[path = "rank_tests.rs"]
mod rank_tests;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feature::scenes::{ExactSurface, ridge_image};
    use crate::feature::windows::tests::LayeredImage;
    use crate::job::Metric;
    use crate::job::spec::DistanceSource;
    use crate::mesh::check::Check;
    use crate::progress::NoProgress;

    /// Returns an image of a disc with a soft edge; each sample has this side length.
    fn disc(sample: f64) -> Image<2> {
        let off = |i: usize| ((i % 60) as f32 - 30.0).hypot((i / 60) as f32 - 25.0) - 15.0;
        let samples = (0..60 * 50).map(|i| 50.0 - 20.0 * off(i).clamp(-2.0, 2.0));
        let mut geometry = Geometry::default();
        geometry.axes = geometry.axes.map(|axis| axis.map(|a| a * sample));
        Image::new([60, 50], samples.collect(), geometry)
    }

    #[test]
    fn a_mesh_is_the_same_whatever_the_unit_of_length() {
        let make = |sample: f64, metric: Metric, sizes: [f64; 2]| {
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
        let expected = make(1.0, Metric::Samples, sizes);
        // Powers of two, so that nothing is rounded: from micrometres to 10^60.
        for power in [-20, -3, 9, 20, 33, 200] {
            let sample = 2f64.powi(power);
            assert_eq!(make(sample, Metric::Physical, sizes), expected, "{sample}");
        }
        let scales = Metric::Scales(vec![512.0; 2]);
        assert_eq!(make(1.0, scales, sizes.map(|d| 512.0 * d)), expected);
    }

    #[test]
    fn a_distance_that_does_not_fit_is_reported_in_the_units_of_the_user() {
        let params = Params::<2>::new(MeshSpec {
            metric: Metric::Physical,
            distance: NominalDistance::Constant(16_000.0),
            ..MeshSpec::default()
        })
        .unwrap();
        let error = run(&disc(400.0), &params, &mut NoProgress).unwrap_err();
        let message = error.to_string();
        assert!(
            message.contains("shortest side, 19600") && message.contains("at most 9800"),
            "{message}"
        );
    }

    #[test]
    fn the_default_distance_is_refused_where_the_metric_makes_it_a_part_of_a_sample() {
        let run_with = |distance| {
            let spec = MeshSpec {
                metric: Metric::Physical,
                distance,
                ..MeshSpec::default()
            };
            run(&disc(10.0), &Params::new(spec).unwrap(), &mut NoProgress)
        };
        let message = run_with(NominalDistance::default())
            .unwrap_err()
            .to_string();
        assert!(message.contains("--distance 27:80"), "{message}");
        let distance = NominalDistance::Range {
            min: 27.0,
            max: 80.0,
        };
        assert!(run_with(distance).is_ok());
    }

    #[test]
    fn an_image_in_layers_gives_the_mesh_of_one_in_memory() {
        let surfaces = [ExactSurface::plane([1.0, 0.4, 0.2], [22.0; 3])];
        let image = ridge_image([48, 44, 40], &surfaces, 1.5, 0.1);
        let layered = LayeredImage(&image);
        let folder = tempfile::tempdir().unwrap();
        let [in_memory, in_layers] = [
            ImageSource::InMemory(&image),
            ImageSource::Layered(&layered),
        ]
        .map(|source| {
            let params = Params::new(MeshSpec {
                distance: NominalDistance::Constant(7.0),
                ..MeshSpec::default()
            })
            .unwrap();
            let checkpoint = Checkpoint::new(&folder.path().join("kept")).unwrap();
            let run_options = RunOptions {
                checkpoint: Some(&checkpoint),
                ..RunOptions::default()
            };
            let outcome = run_from(source, &params, run_options, &mut NoProgress).unwrap();
            // Stored results of the first run belong to the same job.
            assert!(
                outcome
                    .report
                    .notes
                    .iter()
                    .all(|note| !note.contains("run again"))
            );
            let path = folder.path().join("mesh.vtu");
            outcome.write_with_image(&path, source).unwrap();
            std::fs::read(path).unwrap()
        });
        assert!(in_memory == in_layers);
        // Label detection needs all samples in memory.
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
    fn an_invalid_mesh_is_an_error() {
        let problems = vec!["the triangles fill 4 instead of the box's 5".to_string()];
        let mut report = Report::default();
        assert!(check_validity(&report).is_ok());
        report.box_check = Some(Check::default());
        assert!(check_validity(&report).is_ok());
        report.box_check = Some(Check {
            problems,
            ..Check::default()
        });
        let message = check_validity(&report).unwrap_err().to_string();
        assert!(
            message.contains("fill 4 instead of the box's 5"),
            "{message}"
        );
    }
}
