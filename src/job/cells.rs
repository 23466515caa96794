//! Voronoi cells (a PEBI grid) that conform to features.
//!
//! Steps:
//! 1. An aligned mesh is made; its faces on features are the surfaces.
//! 2. Sites are placed on both sides of every facet of the surfaces.
//! 3. Atoms are placed around the sites, and come to rest.
//! 4. The cells of atoms and sites are cut, and become more equal in size.

use crate::parallel::prelude::*;

use super::equalise::CellEqualiser;
use super::job_domain::JobDomain;
use super::measure::measure_unless_cancelled;
use super::mesh_verb::MadeMesh;
use super::named_faces::close_given_surfaces;
use super::placement::seed_atoms;
use super::{
    AnnotatedMesh, BOX_TOLERANCE, JoinAtoms, LatticeParams, MeshResult, MeshScene, StageRunner,
    placement, regions, simplices,
};
use crate::Result;
use crate::comm::Comm;
use crate::feature::{Features, LabelMap, lines_with_cancel};
use crate::geometry::cell_list::CellList;
use crate::geometry::{add_scaled, distance2, dot, to_3d};
use crate::image::{Geometry, ImageSource};
use crate::improve::feature_planes::{LocalPlane, SAME_SURFACE_COSINE};
use crate::improve::regions::{SamplePoints, Votes};
use crate::improve::{self, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, DistributedDistance};
use crate::lattice::energy::{Beta, PairwiseEnergy};
use crate::lattice::halo::SharedLattice;
use crate::lattice::optimise::{self, StopReason, temperature};
use crate::lattice::owned_atoms::OwnedAtoms;
use crate::lattice::seeding::line_atoms::{Projection, line_atoms};
use crate::lattice::seeding::{Alignment, Atoms, fixed_atoms};
use crate::mesh::check::{CheckHints, check_view};
use crate::mesh::complex::NONE;
use crate::mesh::delaunay::{DelaunayKernel, distributed_delaunay};
use crate::mesh::graph::Graph;
use crate::mesh::poly::{FaceNeighbour, PolyMesh};
use crate::mesh::view::MeshView;
use crate::mesh::voronoi::conform::{ConformingSites, FacetSurface};
use crate::mesh::{Dimension, SimplexMesh, Space};
use crate::progress::{CancelToken, Progress, Stage};
use crate::report::certificate::LabelledCells;
use crate::report::{self, Reference, Report};

/// Largest number of energy evaluations in which atoms come to rest among sites.
const MAX_EVALUATIONS: usize = 15;

/// Number of rounds in which cells become more equal in size.
const RELAXATION_ROUNDS: usize = 2;
/// Number of following rounds in which atoms are added in cells next to much smaller ones.
const SPLITTING_ROUNDS: usize = 2;
/// Number of following rounds in which atoms at tiny faces move. In the first of them, atoms are
/// placed between sites that touch in tiny faces.
const FACE_OPENING_ROUNDS: usize = 6;
/// Largest number of final rounds in which only the smallest cells are removed.
const MAX_REMOVAL_ROUNDS: usize = 3;
/// Largest number of rounds, after these, in which skew faces are removed.
const MAX_SKEW_FACE_ROUNDS: usize = 8;

/// Distance, in units of d, within which an atom is at the place of a site.
const SAME_PLACE_DISTANCE: f64 = 1e-3;

/// Largest distance between the nodes of surfaces, in units of the distance between atoms. At this
/// distance, cells at surfaces, where each node has two sites on either side, are as large as other
/// cells.
const MAX_SURFACE_SPACING_RATIO: f64 = 1.5;

/// Target for the smallest angle, in degrees, of the mesh whose faces are the surfaces, if slivers
/// are not removed.
const MIN_SURFACE_ANGLE: f64 = 30.0;

/// Makes Voronoi cells that conform to features, and measures them.
pub(super) fn make_cells<const D: usize>(
    source: ImageSource<'_, D>,
    params: &LatticeParams<'_, D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<MadeMesh<D, SimplexMesh<D>>>
where
    Space<D>: Dimension<D, Mesh: JoinAtoms<D>>,
{
    let (extent, weld) = (frame.extent, params.spec().weld);
    stages.begin_unless_stopped(Stage::Placing)?;
    let distance = placement::nominal_distance(source, params, features, frame, stages)?
        .into_global(stages.comm)?;
    let fixed_atoms = placement::fixed_atoms(&distance, Alignment::AlongsideFeatures, frame)?;
    let fixed_atoms = fixed_atoms::validate(
        &fixed_atoms,
        extent,
        &distance,
        Alignment::AlongsideFeatures,
    )?;
    let surface = feature_surface(params, &distance, features, frame, stages)?;

    stages.begin(Stage::Conforming);
    let mut sites = ConformingSites::new(surface, extent, &fixed_atoms);
    let (mut atoms, optimise_result) = relax_around_sites(
        &sites,
        &fixed_atoms,
        params,
        &distance,
        features,
        frame,
        stages,
    )?;
    stages.begin(Stage::Cutting);
    let mut mesh = cut_even_cells(&mut atoms, &mut sites, &distance, extent, weld, stages)?;
    mesh.on_feature = sites.faces_on_surface(&mesh, atoms.len());
    let face_names = sites.names_of_faces(&mesh, atoms.len());
    let labelled = features.labels.as_ref();
    let label_indices = labelled.map(|labelled| assign_labels(&mut mesh, &face_names, labelled));

    stages.begin(Stage::Measuring);
    let scene = MeshScene {
        extent,
        features,
        distance: &distance,
    };
    let label_image = label_indices
        .is_some()
        .then(|| source.to_image())
        .transpose()?;
    let report = stages.run_cancellable(|cancel| {
        let mut report = measure_cells(&mesh, weld, &scene, source.geometry(), cancel)?;
        let judged = labelled
            .zip(label_image.as_ref())
            .and_then(|(labelled, image)| {
                let spec = params.spec();
                let min_part = spec.min_part_samples();
                regions::JudgedLabels::new(image, labelled, &spec.label, min_part)
            });
        if let (Some(indices), Some(image), Some(judged)) = (&label_indices, &label_image, judged) {
            let step = features.potential.step;
            let to_index = |x: &[f64; D]| std::array::from_fn(|k| x[k] / step[k]);
            let cells = LabelledCells::from_cells(&mesh, indices, to_index);
            let choice = params.spec().cell_choice();
            report.certificate = regions::certificate(image, &judged, &choice, &cells, cancel);
            let (points, contacts) = (
                SamplePoints::from_cells(&mesh),
                regions::contacts_of_cells(&mesh, indices),
            );
            report.regions =
                regions::report(image, judged, &points, &contacts, indices, step, cancel);
            report.name_smoothed_interface();
        }
        if let Some(voronoi) = &mut report.voronoi {
            voronoi.conforming = Some(sites.covered_share(&mesh, atoms.len()));
        }
        Ok::<_, crate::Error>(report)
    })?;
    Ok(MadeMesh {
        periodic_nodes: None,
        mesh: MeshResult::Voronoi { mesh, weld },
        face_names,
        report,
        share: None,
        distance,
        optimise_result: Some(optimise_result),
    })
}

/// Gives each cell the region of most of its samples, and returns the index of its label. The faces
/// on features become the interfaces between labels, which have no holes, and those with names.
fn assign_labels<const D: usize>(
    mesh: &mut PolyMesh<D>,
    face_names: &[u32],
    labelled: &LabelMap<D>,
) -> Vec<u32> {
    let votes = SamplePoints::from_cells(mesh).votes(labelled);
    let label_indices: Vec<u32> = votes.iter().map(Votes::winner).collect();
    let label_regions = labelled.regions();
    mesh.region = label_indices
        .iter()
        .map(|&n| label_regions[n as usize])
        .collect();
    let is_interface = |f: usize| match mesh.face_neighbour(f) {
        FaceNeighbour::Cell(other) => {
            label_indices[other] != label_indices[mesh.face_cells[f][0] as usize]
        }
        _ => false,
    };
    let has_name = |f: usize| face_names.get(f).is_some_and(|&name| name != NONE);
    mesh.on_feature = (0..mesh.face_cells.len())
        .map(|f| is_interface(f) || has_name(f))
        .collect();
    label_indices
}

/// Cuts the cells of atoms and, after these, of sites, while atoms are moved, added and removed
/// until cells are of more equal size. It stops early if the caller stops the job.
///
/// # Errors
/// Returns the errors of [`Dimension::voronoi_cells`].
pub(crate) fn cut_even_cells<const D: usize>(
    atoms: &mut Atoms<D>,
    sites: &mut ConformingSites<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    weld: f64,
    stages: &mut StageRunner<'_>,
) -> Result<PolyMesh<D>>
where
    Space<D>: Dimension<D>,
{
    let comm = stages.comm;
    let mut mesh = cut_cells(atoms, sites, extent, 0.0, comm)?;
    let first_opening = RELAXATION_ROUNDS + SPLITTING_ROUNDS;
    let first_removal = first_opening + FACE_OPENING_ROUNDS;
    let first_skew = first_removal + MAX_REMOVAL_ROUNDS;
    let mut round = 0;
    while round < first_skew + MAX_SKEW_FACE_ROUNDS && stages.keep_going() {
        let mut equaliser = CellEqualiser {
            atoms,
            sites,
            mesh: &mesh,
            distance,
            extent,
        };
        if round < RELAXATION_ROUNDS {
            equaliser.relax();
        } else if round < first_opening {
            equaliser.split_large_cells();
        } else if round < first_skew {
            let is_equal = !equaliser.remove_small_sites();
            if round == first_opening {
                equaliser.separate_sites();
            } else if round < first_removal {
                equaliser.open_tiny_faces();
            } else if is_equal {
                round = first_skew;
                continue;
            }
        } else if !equaliser.remove_skew_faces()
            && (round == first_skew || !equaliser.remove_small_sites())
        {
            break;
        }
        mesh = cut_cells(atoms, sites, extent, 0.0, comm)?;
        round += 1;
    }
    if weld > 0.0 {
        cut_cells(atoms, sites, extent, weld, comm)
    } else {
        Ok(mesh)
    }
}

/// Returns the surfaces of features in a box without fixed atoms.
///
/// # Errors
/// Returns the errors of seeding and of the triangulation.
pub(crate) fn feature_surface_in_box<const D: usize>(
    params: &LatticeParams<'_, D>,
    distance: &Distance<D>,
    features: &Features<D>,
    step: [f64; D],
    extent: [f64; D],
    beta: Beta<D>,
    progress: &mut dyn Progress,
) -> Result<FacetSurface<D>>
where
    Space<D>: Dimension<D, Mesh: JoinAtoms<D>>,
{
    let frame = JobDomain {
        step,
        extent,
        beta,
        fixed_atoms: Vec::new(),
        well_paths: Vec::new(),
    };
    let stages = &mut StageRunner::new(progress);
    feature_surface(params, distance, features, &frame, stages)
}

/// Returns the surfaces of features: the faces on features of an aligned mesh. That mesh is
/// somewhat coarser than the cells, but as fine in the narrowest gaps.
fn feature_surface<const D: usize>(
    params: &LatticeParams<'_, D>,
    distance: &Distance<D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<FacetSurface<D>>
where
    Space<D>: Dimension<D, Mesh: JoinAtoms<D>>,
{
    if features.points.is_empty() {
        return Ok(FacetSurface::default());
    }
    let extent = frame.extent;
    let (min, max) = (distance.min(), distance.max());
    let shortest = extent.iter().copied().fold(f64::INFINITY, f64::min);
    let max_ratio = MAX_SURFACE_SPACING_RATIO.min(0.5 * shortest / max);
    // A constant distance does not show where surfaces bend or run close together.
    let coarsen = |d: f64| d * (1.0 + (d - min) / (max - min) * (max_ratio - 1.0));
    let distance = match distance {
        Distance::Field(field) if max > min => Distance::Field(field.map(coarsen)),
        other => other.clone(),
    };
    let scene = MeshScene {
        extent,
        features,
        distance: &distance,
    };
    let line_atoms =
        stages.run_or_interrupt(Stage::Placing, |cancel| atoms_at_lines(&scene, cancel))?;
    let distance = DistributedDistance::Global(distance);
    let placed =
        placement::optimised_lattice(params, distance, &line_atoms, features, frame, stages)?;
    let distance = placed.distance.into_global(stages.comm)?;
    let scene = MeshScene {
        extent,
        features,
        distance: &distance,
    };
    let target = Target {
        min_dihedral: (params.spec().target())
            .map_or(MIN_SURFACE_ANGLE, |target| target.min_dihedral),
        ..Target::default()
    };
    let atoms = placed.atoms.all_gather(stages.comm)?;
    let joined = SimplexMesh::<D>::join(atoms, &scene, None, Some(&target), None, stages)?;
    let (joined, mut neighbours) = simplices::seal_mesh(joined, &scene, stages)?;
    let mut annotated = joined.annotated_mesh;
    let mut face_names = stages.run_cancellable(|cancel| {
        let marks = &mut annotated.feature_faces;
        close_given_surfaces(&annotated.mesh, &neighbours, &scene, marks, cancel)
    })?;
    let angle = Some(target.min_dihedral);
    stages.run_cancellable(|cancel| {
        let faces = regions::CellFaces {
            neighbours: &mut neighbours,
            names: &mut face_names,
            pinned: &[],
            // Voronoi cells are as large as atoms are apart: small faces would only make them worse.
            opens_pinches: false,
        };
        regions::assign_regions(&mut annotated, faces, &scene, angle, cancel)
    });
    let AnnotatedMesh {
        mesh,
        feature_faces,
        ..
    } = &annotated;
    let mut surface = FacetSurface::from_marked(mesh, &neighbours, feature_faces, &face_names);
    surface.regularise(extent);
    surface.flatten(extent);
    Ok(surface)
}

/// Returns atoms on the lines where surfaces meet and in rows along them, exactly on the surfaces.
///
/// # Errors
/// Returns an [`Error::Interrupted`](crate::Error::Interrupted) if `cancel` is cancelled.
fn atoms_at_lines<const D: usize>(
    scene: &MeshScene<'_, D>,
    cancel: &CancelToken<'_>,
) -> Result<Vec<[f64; D]>> {
    let lines = lines_with_cancel(scene.features, cancel)?;
    if lines.is_empty() {
        return Ok(Vec::new());
    }
    let planes = scene.local_planes();
    let project = |x: [f64; D], normal: [f64; D]| {
        let (x, normal) = (to_3d(x), to_3d(normal));
        let is_same = |plane: &&LocalPlane| dot(plane.normal, normal).abs() > SAME_SURFACE_COSINE;
        let nearby = planes.planes_near(x);
        let plane = nearby.iter().find(is_same)?;
        let point = add_scaled(x, -plane.offset, plane.normal);
        Some(std::array::from_fn(|k| point[k]))
    };
    let project: Projection<'_, D> = &project;
    let project = (D == 3).then_some(project);
    let positions = line_atoms(&lines, scene.extent, scene.distance, project);
    let Atoms {
        mut positions,
        kinds,
    } = Atoms::from_positions(positions, scene.extent);
    let reach = scene.snap_distance();
    improve::snap_to_features(&mut positions, &kinds, scene.extent, &planes, reach);
    Ok(positions)
}

/// Places atoms around the sites, outside their balls, and brings them to rest. Atoms in
/// `fixed_atoms` stay in place.
fn relax_around_sites<const D: usize>(
    sites: &ConformingSites<D>,
    fixed_atoms: &[[f64; D]],
    params: &LatticeParams<'_, D>,
    distance: &Distance<D>,
    features: &Features<D>,
    frame: &JobDomain<D>,
    stages: &mut StageRunner<'_>,
) -> Result<(Atoms<D>, optimise::OptimiseResult)> {
    let extent = frame.extent;
    let positions = sites.sites();
    let fixed: Vec<[f64; D]> = fixed_atoms.iter().chain(&positions).copied().collect();
    // There is a lattice already, if only one for surfaces, so that a stop takes effect after
    // seeding.
    let mut atoms = seed_atoms(
        params,
        extent,
        distance,
        &fixed,
        Alignment::AlongsideFeatures,
        &features.potential,
        &CancelToken::never(),
    )?;
    // Seeding appends fixed atoms, and the sites are the last of these.
    let atom_count = atoms.len() - positions.len();
    atoms.positions.truncate(atom_count);
    atoms.kinds.truncate(atom_count);
    let result = relax_atoms(
        &mut atoms,
        sites,
        distance,
        extent,
        RelaxOptions {
            edited: &[],
            seed: params.spec().rng_seed,
        },
        stages,
    )?;
    if result.stop == StopReason::Interrupted {
        stages.mark_interrupted();
    }
    Ok((atoms, result))
}

/// Options of [`relax_atoms`].
pub(crate) struct RelaxOptions<'a, const D: usize> {
    /// Positions of edits, with d there. If there are any, only atoms near them move.
    pub edited: &'a [([f64; D], f64)],
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Brings atoms to rest around the sites, and removes those in balls. Atoms that would leave the
/// region of sites stay where they were.
///
/// # Errors
/// Returns the errors of the optimiser.
pub(crate) fn relax_atoms<const D: usize>(
    atoms: &mut Atoms<D>,
    sites: &ConformingSites<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    relax: RelaxOptions<'_, D>,
    stages: &mut StageRunner<'_>,
) -> Result<optimise::OptimiseResult> {
    let RelaxOptions { edited, seed } = relax;
    remove_covered_atoms(atoms, sites, distance);
    let previous = atoms.positions.clone();
    atoms.positions.extend(sites.sites());
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
    let temperature = match edited {
        [] => Vec::new(),
        _ => temperature::temperatures(&atoms.positions, edited),
    };
    let options = optimise::OptimiseOptions {
        seed,
        max_rounds: 1,
        max_evaluations: MAX_EVALUATIONS,
        temperature,
        ..optimise::OptimiseOptions::default()
    };
    let energy = PairwiseEnergy::new(extent, distance, None, Beta::Constant(0.0))?;
    let energy = &mut energy.with_alignment(Alignment::AlongsideFeatures);
    let (comm, progress) = (stages.comm, &mut *stages.progress);
    let mut owned = OwnedAtoms::from_global(std::mem::take(atoms), comm);
    let lattice = SharedLattice::new(&mut owned, comm);
    let result =
        optimise::optimise_partition(lattice, energy, distance, extent, &options, progress)?;
    *atoms = owned.all_gather(comm)?;
    atoms.positions.truncate(previous.len());
    atoms.kinds.truncate(previous.len());
    for (x, previous_position) in atoms.positions.iter_mut().zip(previous) {
        if !sites.site_region().contains(*x) {
            *x = previous_position;
        }
    }
    remove_covered_atoms(atoms, sites, distance);
    Ok(result)
}

/// Removes the atoms inside balls and those at the places of sites, except for fixed ones.
fn remove_covered_atoms<const D: usize>(
    atoms: &mut Atoms<D>,
    sites: &ConformingSites<D>,
    distance: &Distance<D>,
) {
    let Atoms { positions, kinds } = atoms;
    let site_positions = sites.sites();
    let grid = CellList::new(&site_positions, distance.min());
    let is_at_site = |x: [f64; D]| {
        let mut is_at_site = false;
        if !site_positions.is_empty() {
            let reach = SAME_PLACE_DISTANCE * distance.min();
            grid.visit_within(x, reach, |i| {
                is_at_site |= distance2(&site_positions[i], &x) < reach * reach;
            });
        }
        is_at_site
    };
    let is_kept = |(&x, &kind)| kind == AtomKind::Fixed || sites.is_free(x) && !is_at_site(x);
    let is_kept: Vec<bool> = positions.par_iter().zip(&*kinds).map(is_kept).collect();
    let mut flags = is_kept.iter();
    positions.retain(|_| flags.next() == Some(&true));
    let mut flags = is_kept.iter();
    kinds.retain(|_| flags.next() == Some(&true));
}

/// Cuts the cells of atoms and, after these, of sites.
fn cut_cells<const D: usize>(
    atoms: &Atoms<D>,
    sites: &ConformingSites<D>,
    extent: [f64; D],
    weld: f64,
    comm: &dyn Comm,
) -> Result<PolyMesh<D>>
where
    Space<D>: Dimension<D>,
{
    let mut positions = atoms.positions.clone();
    positions.extend(sites.sites());
    Space::<D>::voronoi_cells(&positions, extent, weld, &|points| {
        distributed_delaunay(points, DelaunayKernel::Auto, comm)
    })
}

/// Measures cells. Figures that are incomplete when `cancel` is cancelled are omitted.
fn measure_cells<const D: usize>(
    mesh: &PolyMesh<D>,
    weld: f64,
    scene: &MeshScene<'_, D>,
    geometry: &Geometry<D>,
    cancel: &CancelToken<'_>,
) -> Result<Report> {
    let (features, distance) = (scene.features, scene.distance);
    let step = features.potential.step;
    let graph = Graph::from_poly(mesh);
    let hints = CheckHints {
        weld,
        ..CheckHints::default()
    };
    let view = MeshView::from_mesh(mesh);
    let voronoi = measure_unless_cancelled(&view, cancel, || {
        let low = [0.0; D];
        let check = check_view(&view, hints, low, scene.extent, BOX_TOLERANCE, cancel)?;
        let in_one_unit = geometry.in_one_unit();
        let world = to_world(mesh, step, in_one_unit.as_ref().unwrap_or(geometry));
        let physical = Graph::from_poly(&world);
        let cube_counts = graph.volume.iter().zip(&graph.site);
        let cube_counts =
            cube_counts.map(|(volume, &x)| volume / distance.value_at(x).powi(D as i32));
        let measured = report::measure_voronoi(check, &graph, &physical);
        Ok(report::Voronoi {
            cells_per_cube: Some(graph.volume.len() as f64 / cube_counts.sum::<f64>()),
            angle_physical: measured.angle_physical.filter(|_| in_one_unit.is_ok()),
            ..measured
        })
    })?;
    let fidelity = measure_unless_cancelled(&view, cancel, || {
        let reference = Reference::from_features(features);
        let has_features = !features.points.is_empty();
        Ok(has_features.then(|| cell_fidelity(mesh, step, &reference, cancel)))
    })?;
    Ok(Report {
        voronoi,
        lattice: Some(report::lattice_of_graph(&graph, |x| distance.value_at(x))),
        fidelity: fidelity.flatten(),
        ..Report::default()
    })
}

/// Returns the fidelity of cells in a lattice space where samples are `step` apart. The result is
/// meaningless if `cancel` is cancelled.
pub fn cell_fidelity<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    reference: &Reference<'_, D>,
    cancel: &CancelToken<'_>,
) -> report::Fidelity {
    let in_samples = mesh.mapped(|x| std::array::from_fn(|k| x[k] / step[k]), false);
    report::fidelity_of_cells(&in_samples, reference, cancel)
}

/// Returns cells in physical coordinates from cells in lattice space.
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
