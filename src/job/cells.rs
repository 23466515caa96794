//! Voronoi cells (a PEBI grid) that conform to features: first the surfaces of these, in an aligned mesh;
//! then sites on either side of every facet; then atoms at rest around them.

use crate::parallel::prelude::*;

use super::even::Even;
use super::frame::Frame;
use super::measure::measured;
use super::{
    BOX_TOLERANCE, Made, Marked, Meshing, Params, Scene, Space, Stages, place, regions, simplices,
};
use crate::Result;
use crate::feature::Features;
use crate::image::{Geometry, Source};
use crate::improve::regions::{Places, Votes};
use crate::improve::{SliverMethod, Target};
use crate::lattice::AtomKind;
use crate::lattice::distance::{Distance, Shared};
use crate::lattice::energy::{Beta, Pairwise};
use crate::lattice::optimize::{self, Stop, temperature};
use crate::lattice::seeding::{self, Alignment, Atoms, fixed};
use crate::lattice::share::OwnAtoms;
use crate::mesh::check::{Known, check_while};
use crate::mesh::graph::Graph;
use crate::mesh::poly::{Beyond, PolyMesh};
use crate::mesh::voronoi::conform::{Conforming, Surface};
use crate::observer::{Observer, Patience, Stage};
use crate::ranks::Ranks;
use crate::report::{self, Reference, Report};

/// Evaluations in which atoms come to rest among sites.
const EVALUATIONS: usize = 15;

/// Rounds in which cells become more alike, ...
const ROUNDS: usize = 2;
/// ... then those in which tiny faces are opened, ...
const OPENINGS: usize = 4;
/// ... and at most so many in which nothing but the smallest cells goes.
const EQUAL: usize = 3;

/// The largest distance between the nodes of surfaces, in units of that between atoms: then cells beside
/// surfaces, of which each node has two on either side, are as large as others.
const COARSER: f64 = 1.5;

/// The smallest angle of the mesh whose faces are surfaces, if slivers are left in.
const ANGLE: f64 = 30.0;

/// Voronoi cells, their figures, the distance between atoms and what the optimiser did.
type Cells<const D: usize> = (Made<D>, Report, Distance<D>, optimize::Rest);

/// Cuts Voronoi cells that conform to features, and measures them.
pub(super) fn made<const D: usize>(
    source: Source<'_, D>,
    params: &Params<D>,
    features: &Features<D>,
    frame: &Frame<D>,
    stages: &mut Stages<'_>,
) -> Result<Cells<D>>
where
    Space<D>: Meshing<D>,
{
    let (extent, weld) = (frame.extent, params.weld);
    stages.begin_unless_stopped(Stage::Placing)?;
    let distance = place::apart(source, params, features, frame, stages)?.into_whole(&Ranks)?;
    let given = place::fixed(&distance, Alignment::Alongside, frame)?;
    let given = fixed::checked(&given, extent, &distance, Alignment::Alongside)?;
    let surface = surface(params, &distance, features, frame, stages)?;

    stages.begin(Stage::Conforming);
    let mut sites = Conforming::new(surface, extent, &given);
    let (mut atoms, rest) = around(&sites, &given, params, &distance, features, frame, stages)?;
    stages.begin(Stage::Cutting);
    let mut mesh = even(&mut atoms, &mut sites, &distance, extent, weld, &mut || {
        stages.keep_going()
    })?;
    mesh.on_feature = sites.faces(&mesh, atoms.len());
    let numbers = features.labels.as_ref().map(|labelled| {
        let votes = Places::of_cells(&mesh).votes(labelled);
        let numbers: Vec<u32> = votes.iter().map(Votes::most).collect();
        let of_label = labelled.regions();
        mesh.region = numbers.iter().map(|&n| of_label[n as usize]).collect();
        // Then what is on features has no holes.
        let parts = |f: usize| match mesh.beyond(f) {
            Beyond::Cell(other) => numbers[other] != numbers[mesh.face_cells[f][0] as usize],
            _ => false,
        };
        mesh.on_feature = (0..mesh.face_cells.len()).map(parts).collect();
        numbers
    });

    stages.begin(Stage::Measuring);
    let scene = Scene {
        extent,
        features,
        distance: &distance,
    };
    let labelled = numbers.is_some().then(|| source.whole()).transpose()?;
    let report = stages.patiently(|patience| {
        let mut report = measure(&mesh, weld, &scene, source.geometry(), patience);
        report.regions = numbers
            .as_ref()
            .zip(labelled.as_ref())
            .and_then(|(numbers, image)| {
                let (places, step) = (Places::of_cells(&mesh), features.potential.step);
                let contacts = regions::contacts_of_cells(&mesh, numbers);
                let held = (&places, &contacts);
                regions::report(image, &params.labels, held, numbers, step, patience)
            });
        if let Some(voronoi) = &mut report.voronoi {
            voronoi.conforming = Some(sites.share(&mesh, atoms.len()));
        }
        report
    });
    Ok((Made::Voronoi { mesh, weld }, report, distance, rest))
}

/// Cuts the cells of atoms and, behind these, of sites, while atoms move, come and go until cells are more
/// alike; for as long as it may go on.
///
/// # Errors
/// Those of [`Meshing::cells`].
pub(crate) fn even<const D: usize>(
    atoms: &mut Atoms<D>,
    sites: &mut Conforming<D>,
    distance: &Distance<D>,
    extent: [f64; D],
    weld: f64,
    keep_going: &mut dyn FnMut() -> bool,
) -> Result<PolyMesh<D>>
where
    Space<D>: Meshing<D>,
{
    let mut mesh = cut(atoms, sites, extent, 0.0)?;
    for round in 0..ROUNDS + OPENINGS + EQUAL {
        if !keep_going() {
            break;
        }
        let mut even = Even {
            atoms,
            sites,
            mesh: &mesh,
            distance,
            extent,
        };
        if round < ROUNDS {
            even.out();
        } else {
            let equal = !even.equalise();
            if round < ROUNDS + OPENINGS {
                even.open();
            } else if equal {
                break;
            }
        }
        mesh = cut(atoms, sites, extent, 0.0)?;
    }
    match weld > 0.0 {
        true => cut(atoms, sites, extent, weld),
        false => Ok(mesh),
    }
}

/// The surfaces of features in a box in which no atoms are given.
///
/// # Errors
/// Those of seeding and of the triangulation.
pub(crate) fn surface_in<const D: usize>(
    params: &Params<D>,
    distance: &Distance<D>,
    features: &Features<D>,
    (step, extent): ([f64; D], [f64; D]),
    beta: Beta<D>,
    observer: &mut dyn Observer,
) -> Result<Surface<D>>
where
    Space<D>: Meshing<D>,
{
    let frame = Frame {
        step,
        extent,
        beta,
        fixed: Vec::new(),
        ways: Vec::new(),
    };
    let stages = &mut Stages::new(observer);
    surface(params, distance, features, &frame, stages)
}

/// The surfaces of features: the faces on them in an aligned mesh that is somewhat coarser than the
/// cells will be, but as fine in the narrowest gaps.
fn surface<const D: usize>(
    params: &Params<D>,
    distance: &Distance<D>,
    features: &Features<D>,
    frame: &Frame<D>,
    stages: &mut Stages<'_>,
) -> Result<Surface<D>>
where
    Space<D>: Meshing<D>,
{
    if features.points.is_empty() {
        return Ok(Surface::default());
    }
    let extent = frame.extent;
    let (min, max) = (distance.min(), distance.max());
    let shortest = extent.iter().copied().fold(f64::INFINITY, f64::min);
    let coarser = COARSER.min(0.5 * shortest / max);
    // Where the distance is the same everywhere, nothing tells where surfaces bend or run close.
    let coarse = |d: f64| d * (1.0 + (d - min) / (max - min) * (coarser - 1.0));
    let distance = match distance {
        Distance::Field(field) if max > min => Distance::Field(field.map(coarse)),
        same => same.clone(),
    };
    let distance = Shared::All(distance);
    let placed = place::lattice(params, distance, &[], features, frame, stages)?;
    let distance = placed.distance.into_whole(&Ranks)?;
    let scene = Scene {
        extent,
        features,
        distance: &distance,
    };
    let target = Target {
        min_dihedral: params.min_dihedral.unwrap_or(ANGLE),
        method: SliverMethod::Joe,
    };
    let atoms = placed.atoms.gathered(&Ranks)?;
    let joined = Space::<D>::join(atoms, &scene, None, Some(&target), stages)?;
    let (mut joined, neighbors) = simplices::sealed(joined, &scene, stages)?;
    if let Some(labelled) = &features.labels {
        let angle = Some(target.min_dihedral);
        stages.patiently(|patience| {
            let made = &mut joined.made;
            regions::of_simplices(made, &neighbors, &scene, labelled, angle, patience)
        });
    }
    let Marked {
        mesh,
        feature_faces,
        ..
    } = &joined.made;
    let mut surface = Surface::of_marked(mesh, &neighbors, feature_faces);
    surface.tidy(extent);
    Ok(surface)
}

/// Atoms at rest around the sites, in none of their balls; those `given` stay where they are.
fn around<const D: usize>(
    sites: &Conforming<D>,
    given: &[[f64; D]],
    params: &Params<D>,
    distance: &Distance<D>,
    features: &Features<D>,
    frame: &Frame<D>,
    stages: &mut Stages<'_>,
) -> Result<(Atoms<D>, optimize::Rest)> {
    let extent = frame.extent;
    let positions = sites.sites();
    let fixed: Vec<[f64; D]> = given.iter().chain(&positions).copied().collect();
    // There is a lattice already, if only one for surfaces: a stop is for what comes after.
    let mut atoms = seeding::seed(
        params.seeding,
        extent,
        distance,
        &fixed,
        Alignment::Alongside,
        Some(&features.potential),
        &Patience::endless(),
    )?;
    // Fixed atoms are the last, and the sites the last of these.
    let own = atoms.len() - positions.len();
    atoms.positions.truncate(own);
    atoms.kinds.truncate(own);
    let observer = &mut *stages.observer;
    let rest = rest(
        &mut atoms,
        sites,
        &[],
        distance,
        extent,
        params.seed,
        observer,
    )?;
    if rest.stop == Stop::Interrupted {
        stages.stopped();
    }
    Ok((atoms, rest))
}

/// Brings atoms to rest around the sites, and takes out those in balls; only those near `edited` positions,
/// where there are any. Those for which there would be no room stay where they were.
///
/// # Errors
/// Those of the optimiser.
pub(crate) fn rest<const D: usize>(
    atoms: &mut Atoms<D>,
    sites: &Conforming<D>,
    edited: &[([f64; D], f64)],
    distance: &Distance<D>,
    extent: [f64; D],
    seed: u64,
    observer: &mut dyn Observer,
) -> Result<optimize::Rest> {
    keep_out(atoms, sites);
    let before = atoms.positions.clone();
    atoms.positions.extend(sites.sites());
    atoms.kinds.resize(atoms.positions.len(), AtomKind::Fixed);
    let temperature = match edited {
        [] => Vec::new(),
        _ => temperature::around(&atoms.positions, edited),
    };
    let options = optimize::Effort {
        seed,
        max_rounds: 1,
        max_evaluations: EVALUATIONS,
        temperature,
        ..optimize::Effort::default()
    };
    let energy = Pairwise::new(extent, distance, None, Beta::Constant(0.0))?;
    let energy = &mut energy.aligned(Alignment::Alongside);
    let group = &Ranks;
    let mut share = OwnAtoms::of(std::mem::take(atoms), group);
    let rest = optimize::optimize_together(
        &mut share, energy, distance, extent, &options, group, observer,
    )?;
    *atoms = share.gathered(group)?;
    atoms.positions.truncate(before.len());
    atoms.kinds.truncate(before.len());
    for (x, from) in atoms.positions.iter_mut().zip(before) {
        if !sites.room().holds(*x) {
            *x = from;
        }
    }
    keep_out(atoms, sites);
    Ok(rest)
}

/// Takes out the atoms inside balls, but for fixed ones.
fn keep_out<const D: usize>(atoms: &mut Atoms<D>, sites: &Conforming<D>) {
    let Atoms { positions, kinds } = atoms;
    let stays = |(&x, &kind)| kind == AtomKind::Fixed || sites.is_free(x);
    let stays: Vec<bool> = positions.par_iter().zip(&*kinds).map(stays).collect();
    let mut stay = stays.iter();
    positions.retain(|_| stay.next() == Some(&true));
    let mut stay = stays.iter();
    kinds.retain(|_| stay.next() == Some(&true));
}

/// The cells of atoms, and behind these the cells of sites.
fn cut<const D: usize>(
    atoms: &Atoms<D>,
    sites: &Conforming<D>,
    extent: [f64; D],
    weld: f64,
) -> Result<PolyMesh<D>>
where
    Space<D>: Meshing<D>,
{
    let mut positions = atoms.positions.clone();
    positions.extend(sites.sites());
    Space::<D>::cells(&positions, extent, weld)
}

/// The figures of cells, as far as `patience` lasts: what was not measured to its end is left out.
fn measure<const D: usize>(
    mesh: &PolyMesh<D>,
    weld: f64,
    scene: &Scene<'_, D>,
    geometry: &Geometry<D>,
    patience: &Patience<'_>,
) -> Report {
    let (features, distance) = (scene.features, scene.distance);
    let step = features.potential.step;
    let graph = Graph::from_poly(mesh);
    let known = Known {
        weld,
        ..Known::default()
    };
    let voronoi = measured(patience, || {
        let low = [0.0; D];
        let check = check_while(mesh, known, low, scene.extent, BOX_TOLERANCE, patience);
        let physical = Graph::from_poly(&to_world(mesh, step, geometry));
        let cubes = graph.volume.iter().zip(&graph.site);
        let cubes = cubes.map(|(volume, &x)| volume / distance.at(x).powi(D as i32));
        let measured = report::voronoi(check, &graph, &physical);
        report::Voronoi {
            cells_per_cube: Some(graph.volume.len() as f64 / cubes.sum::<f64>()),
            angle_physical: measured.angle_physical.filter(|_| geometry.has_angles()),
            ..measured
        }
    });
    let fidelity = measured(patience, || {
        let reference = Reference::from_features(features);
        let any = !features.points.is_empty();
        any.then(|| fidelity(mesh, step, &reference, patience))
    });
    Report {
        voronoi,
        lattice: Some(report::lattice_of_graph(&graph, |x| distance.at(x))),
        fidelity: fidelity.flatten(),
        ..Report::default()
    }
}

/// Fidelity of cells in a lattice space where samples are `step` apart; of no use once `patience` is
/// over.
pub fn fidelity<const D: usize>(
    mesh: &PolyMesh<D>,
    step: [f64; D],
    reference: &Reference<'_, D>,
    patience: &Patience<'_>,
) -> report::Fidelity {
    let in_samples = mesh.mapped(|x| std::array::from_fn(|k| x[k] / step[k]), false);
    report::fidelity_of_cells_while(&in_samples, reference, patience)
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
