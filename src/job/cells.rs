//! Voronoi cells (a PEBI grid) that conform to features: first the surfaces of these, in an aligned mesh;
//! then sites on either side of every facet; then atoms at rest around them.

use crate::parallel::prelude::*;

use super::equalise::CellEqualiser;
use super::frame::JobDomain;
use super::measure::measure_unless_cancelled;
use super::{
    AnnotatedMesh, BOX_TOLERANCE, MeshResult, MeshScene, MeshSpace, Meshing, Params, StageRunner,
    placement, regions, simplices,
};
use crate::Result;
use crate::comm::WorldComm;
use crate::feature::Features;
use crate::image::{Geometry, ImageSource};
use crate::improve::regions::{SamplePoints, Votes};
use crate::improve::{SliverMethod, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::energy::{Beta, PairwiseEnergy};
use crate::lattice::optimize::{self, StopReason, temperature};
use crate::lattice::partition::OwnedAtoms;
use crate::lattice::seeding::{self, Alignment, Atoms, fixed_atoms};
use crate::mesh::check::{CheckHints, check_cancellable};
use crate::mesh::graph::Graph;
use crate::mesh::poly::{FaceNeighbour, PolyMesh};
use crate::mesh::voronoi::conform::{ConformingSites, FacetSurface};
use crate::progress::{CancelToken, Progress, Stage};
use crate::report::{self, Reference, Report};

/// Evaluations in which atoms come to rest among sites.
const MAX_EVALUATIONS: usize = 15;

/// Rounds in which cells become more alike, ...
const EVENING_ROUNDS: usize = 2;
/// ... then those in which tiny faces are opened, ...
const FACE_OPENING_ROUNDS: usize = 4;
/// ... and at most so many in which nothing but the smallest cells goes.
const MAX_REMOVAL_ROUNDS: usize = 3;

/// The largest distance between the nodes of surfaces, in units of that between atoms: then cells beside
/// surfaces, of which each node has two on either side, are as large as others.
const MAX_SURFACE_SPACING_RATIO: f64 = 1.5;

/// The smallest angle of the mesh whose faces are surfaces, if slivers are left in.
const MIN_SURFACE_ANGLE: f64 = 30.0;

/// Voronoi cells, their figures, the distance between atoms and what the optimiser did.
type VoronoiResult<const D: usize> = (MeshResult<D>, Report, Distance<D>, optimize::OptimizeResult);

/// Cuts Voronoi cells that conform to features, and measures them.
pub(super) fn make_cells<const D: usize>(
    source: ImageSource<'_, D>,
    params: &Params<D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<VoronoiResult<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    let (extent, weld) = (frame.extent, params.spec.weld);
    stages.begin_unless_stopped(Stage::Placing)?;
    let distance = placement::nominal_distance(source, params, features, frame, stages)?
        .into_global(&WorldComm)?;
    let given = placement::fixed_atoms(&distance, Alignment::AlongsideFeatures, frame)?;
    let given = fixed_atoms::validate(&given, extent, &distance, Alignment::AlongsideFeatures)?;
    let surface = feature_surface(params, &distance, features, frame, stages)?;

    stages.begin(Stage::Conforming);
    let mut sites = ConformingSites::new(surface, extent, &given);
    let (mut atoms, rest) =
        relax_around_sites(&sites, &given, params, &distance, features, frame, stages)?;
    stages.begin(Stage::Cutting);
    let mut mesh = cut_even_cells(&mut atoms, &mut sites, &distance, extent, weld, &mut || {
        stages.keep_going()
    })?;
    mesh.on_feature = sites.faces_on_surface(&mesh, atoms.len());
    let numbers = features.labels.as_ref().map(|labelled| {
        let votes = SamplePoints::from_cells(&mesh).votes(labelled);
        let numbers: Vec<u32> = votes.iter().map(Votes::winner).collect();
        let of_label = labelled.regions();
        mesh.region = numbers.iter().map(|&n| of_label[n as usize]).collect();
        // Then what is on features has no holes.
        let parts = |f: usize| match mesh.face_neighbour(f) {
            FaceNeighbour::Cell(other) => numbers[other] != numbers[mesh.face_cells[f][0] as usize],
            _ => false,
        };
        mesh.on_feature = (0..mesh.face_cells.len()).map(parts).collect();
        numbers
    });

    stages.begin(Stage::Measuring);
    let scene = MeshScene {
        extent,
        features,
        distance: &distance,
    };
    let labelled = numbers.is_some().then(|| source.to_image()).transpose()?;
    let report = stages.run_cancellable(|patience| {
        let mut report = measure_cells(&mesh, weld, &scene, source.geometry(), patience);
        report.regions = numbers
            .as_ref()
            .zip(labelled.as_ref())
            .and_then(|(numbers, image)| {
                let (places, step) = (SamplePoints::from_cells(&mesh), features.potential.step);
                let contacts = regions::contacts_of_cells(&mesh, numbers);
                let held = (&places, &contacts);
                regions::report(image, &params.spec.label, held, numbers, step, patience)
            });
        if let Some(voronoi) = &mut report.voronoi {
            voronoi.conforming = Some(sites.covered_share(&mesh, atoms.len()));
        }
        report
    });
    Ok((MeshResult::Voronoi { mesh, weld }, report, distance, rest))
}

/// Cuts the cells of atoms and, behind these, of sites, while atoms move, come and go until cells are more
/// alike; for as long as it may go on.
///
/// # Errors
/// Those of [`Meshing::voronoi_cells`].
pub(crate) fn cut_even_cells<const D: usize>(
    atoms: &mut Atoms<D>,
    sites: &mut ConformingSites<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    weld: f64,
    keep_going: &mut dyn FnMut() -> bool,
) -> Result<PolyMesh<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    let mut mesh = cut_cells(atoms, sites, extent, 0.0)?;
    for round in 0..EVENING_ROUNDS + FACE_OPENING_ROUNDS + MAX_REMOVAL_ROUNDS {
        if !keep_going() {
            break;
        }
        let mut even = CellEqualiser {
            atoms,
            sites,
            mesh: &mesh,
            distance,
            extent,
        };
        if round < EVENING_ROUNDS {
            even.relax();
        } else {
            let equal = !even.remove_small_sites();
            if round < EVENING_ROUNDS + FACE_OPENING_ROUNDS {
                even.open_tiny_faces();
            } else if equal {
                break;
            }
        }
        mesh = cut_cells(atoms, sites, extent, 0.0)?;
    }
    match weld > 0.0 {
        true => cut_cells(atoms, sites, extent, weld),
        false => Ok(mesh),
    }
}

/// The surfaces of features in a box in which no atoms are given.
///
/// # Errors
/// Those of seeding and of the triangulation.
pub(crate) fn feature_surface_in_box<const D: usize>(
    params: &Params<D>,
    distance: &Distance<D>,
    features: &Features<D>,
    (step, extent): ([f64; D], [f64; D]),
    beta: Beta<D>,
    observer: &mut dyn Progress,
) -> Result<FacetSurface<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    let frame = JobDomain {
        step,
        extent,
        beta,
        fixed_atoms: Vec::new(),
        well_paths: Vec::new(),
    };
    let stages = &mut StageRunner::new(observer);
    feature_surface(params, distance, features, &frame, stages)
}

/// The surfaces of features: the faces on them in an aligned mesh that is somewhat coarser than the
/// cells will be, but as fine in the narrowest gaps.
fn feature_surface<const D: usize>(
    params: &Params<D>,
    distance: &Distance<D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<FacetSurface<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    if features.points.is_empty() {
        return Ok(FacetSurface::default());
    }
    let extent = frame.extent;
    let (min, max) = (distance.min(), distance.max());
    let shortest = extent.iter().copied().fold(f64::INFINITY, f64::min);
    let coarser = MAX_SURFACE_SPACING_RATIO.min(0.5 * shortest / max);
    // Where the distance is the same everywhere, nothing tells where surfaces bend or run close.
    let coarse = |d: f64| d * (1.0 + (d - min) / (max - min) * (coarser - 1.0));
    let distance = match distance {
        Distance::Field(field) if max > min => Distance::Field(field.map(coarse)),
        same => same.clone(),
    };
    let distance = DistributedDistance::Global(distance);
    let placed = placement::optimised_lattice(params, distance, &[], features, frame, stages)?;
    let distance = placed.distance.into_global(&WorldComm)?;
    let scene = MeshScene {
        extent,
        features,
        distance: &distance,
    };
    let target = Target {
        min_dihedral: (params.spec.target())
            .map_or(MIN_SURFACE_ANGLE, |target| target.min_dihedral),
        method: SliverMethod::Joe,
    };
    let atoms = placed.atoms.all_gather(&WorldComm)?;
    let joined = MeshSpace::<D>::join(atoms, &scene, None, Some(&target), stages)?;
    let (mut joined, neighbors) = simplices::seal_mesh(joined, &scene, stages)?;
    if let Some(labelled) = &features.labels {
        let angle = Some(target.min_dihedral);
        stages.run_cancellable(|patience| {
            let made = &mut joined.annotated_mesh;
            regions::assign_regions(made, &neighbors, &scene, labelled, angle, patience)
        });
    }
    let AnnotatedMesh {
        mesh,
        feature_faces,
        ..
    } = &joined.annotated_mesh;
    let mut surface = FacetSurface::from_marked(mesh, &neighbors, feature_faces);
    surface.regularise(extent);
    Ok(surface)
}

/// Atoms at rest around the sites, in none of their balls; those `given` stay where they are.
fn relax_around_sites<const D: usize>(
    sites: &ConformingSites<D>,
    given: &[[f64; D]],
    params: &Params<D>,
    distance: &Distance<D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<(Atoms<D>, optimize::OptimizeResult)> {
    let extent = frame.extent;
    let positions = sites.sites();
    let fixed: Vec<[f64; D]> = given.iter().chain(&positions).copied().collect();
    // There is a lattice already, if only one for surfaces: a stop is for what comes after.
    let mut atoms = seeding::seed(
        params.seeding(),
        extent,
        distance,
        &fixed,
        Alignment::AlongsideFeatures,
        Some(&features.potential),
        &CancelToken::never(),
    )?;
    // Fixed atoms are the last, and the sites the last of these.
    let own = atoms.len() - positions.len();
    atoms.positions.truncate(own);
    atoms.kinds.truncate(own);
    let observer = &mut *stages.observer;
    let rest = relax_atoms(
        &mut atoms,
        sites,
        &[],
        distance,
        extent,
        params.spec.rng_seed,
        observer,
    )?;
    if rest.stop == StopReason::Interrupted {
        stages.mark_interrupted();
    }
    Ok((atoms, rest))
}

/// Brings atoms to rest around the sites, and takes out those in balls; only those near `edited` positions,
/// where there are any. Those for which there would be no room stay where they were.
///
/// # Errors
/// Those of the optimiser.
pub(crate) fn relax_atoms<const D: usize>(
    atoms: &mut Atoms<D>,
    sites: &ConformingSites<D>,
    edited: &[([f64; D], f64)],
    distance: &Distance<D>,
    extent: [f64; D],
    seed: u64,
    observer: &mut dyn Progress,
) -> Result<optimize::OptimizeResult> {
    remove_atoms_in_balls(atoms, sites);
    let before = atoms.positions.clone();
    atoms.positions.extend(sites.sites());
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
    let temperature = match edited {
        [] => Vec::new(),
        _ => temperature::temperatures(&atoms.positions, edited),
    };
    let options = optimize::OptimizeOptions {
        seed,
        max_rounds: 1,
        max_evaluations: MAX_EVALUATIONS,
        temperature,
        ..optimize::OptimizeOptions::default()
    };
    let energy = PairwiseEnergy::new(extent, distance, None, Beta::Constant(0.0))?;
    let energy = &mut energy.with_alignment(Alignment::AlongsideFeatures);
    let group = &WorldComm;
    let mut share = OwnedAtoms::from_global(std::mem::take(atoms), group);
    let rest = optimize::optimize_partition(
        &mut share, energy, distance, extent, &options, group, observer,
    )?;
    *atoms = share.all_gather(group)?;
    atoms.positions.truncate(before.len());
    atoms.kinds.truncate(before.len());
    for (x, from) in atoms.positions.iter_mut().zip(before) {
        if !sites.site_region().contains(*x) {
            *x = from;
        }
    }
    remove_atoms_in_balls(atoms, sites);
    Ok(rest)
}

/// Takes out the atoms inside balls, but for fixed ones.
fn remove_atoms_in_balls<const D: usize>(atoms: &mut Atoms<D>, sites: &ConformingSites<D>) {
    let Atoms { positions, kinds } = atoms;
    let stays = |(&x, &kind)| kind == AtomKind::Fixed || sites.is_free(x);
    let stays: Vec<bool> = positions.par_iter().zip(&*kinds).map(stays).collect();
    let mut stay = stays.iter();
    positions.retain(|_| stay.next() == Some(&true));
    let mut stay = stays.iter();
    kinds.retain(|_| stay.next() == Some(&true));
}

/// The cells of atoms, and behind these the cells of sites.
fn cut_cells<const D: usize>(
    atoms: &Atoms<D>,
    sites: &ConformingSites<D>,
    extent: [f64; D],
    weld: f64,
) -> Result<PolyMesh<D>>
where
    MeshSpace<D>: Meshing<D>,
{
    let mut positions = atoms.positions.clone();
    positions.extend(sites.sites());
    MeshSpace::<D>::voronoi_cells(&positions, extent, weld)
}

/// The figures of cells, as far as `patience` lasts: what was not measured to its end is left out.
fn measure_cells<const D: usize>(
    mesh: &PolyMesh<D>,
    weld: f64,
    scene: &MeshScene<'_, D>,
    geometry: &Geometry<D>,
    patience: &CancelToken<'_>,
) -> Report {
    let (features, distance) = (scene.features, scene.distance);
    let step = features.potential.step;
    let graph = Graph::from_poly(mesh);
    let known = CheckHints {
        weld,
        ..CheckHints::default()
    };
    let voronoi = measure_unless_cancelled(patience, || {
        let low = [0.0; D];
        let check = check_cancellable(mesh, known, low, scene.extent, BOX_TOLERANCE, patience);
        let physical = Graph::from_poly(&to_world(mesh, step, geometry));
        let cubes = graph.volume.iter().zip(&graph.site);
        let cubes = cubes.map(|(volume, &x)| volume / distance.value_at(x).powi(D as i32));
        let measured = report::measure_voronoi(check, &graph, &physical);
        report::Voronoi {
            cells_per_cube: Some(graph.volume.len() as f64 / cubes.sum::<f64>()),
            angle_physical: measured
                .angle_physical
                .filter(|_| geometry.has_uniform_units()),
            ..measured
        }
    });
    let fidelity = measure_unless_cancelled(patience, || {
        let reference = Reference::from_features(features);
        let any = !features.points.is_empty();
        any.then(|| cell_fidelity(mesh, step, &reference, patience))
    });
    Report {
        voronoi,
        lattice: Some(report::lattice_of_graph(&graph, |x| distance.value_at(x))),
        fidelity: fidelity.flatten(),
        ..Report::default()
    }
}

/// Fidelity of cells in a lattice space where samples are `step` apart; of no use once `patience` is
/// over.
pub fn cell_fidelity<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    reference: &Reference<'_, D>,
    patience: &CancelToken<'_>,
) -> report::Fidelity {
    let in_samples = mesh.mapped(|x| std::array::from_fn(|k| x[k] / step[k]), false);
    report::fidelity_of_cells_with_cancel(&in_samples, reference, patience)
}

/// Cells in lattice space as cells where the image lies in the world.
pub fn to_world<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    geometry: &Geometry<D>,
) -> PolyMesh<D> {
    mesh.mapped(
        |x| geometry.to_physical(std::array::from_fn(|k| x[k] / step[k])),
        geometry.determinant() < 0.0,
    )
}
