//! The whole job: image in, mesh out. The command line and any other front end call this.
//!
//! [`mesh_image`] works in *lattice space* (sample index times a step per axis); [`to_file`](crate::store::file::to_file) puts
//! the outcome where the image lies in the world. The plane and space are the same code but for how
//! atoms are joined ([`Meshing`]).

pub mod asked;
mod canny;
pub mod cells;
pub(crate) mod horizons;
mod join;
mod pairs;
mod params;
pub mod settings;
mod words;

pub use asked::Job;
pub use cells::{CellsOutcome, voronoi_image};
pub use join::{Meshing, Scene, Space};
pub use params::{Evaluator, FixedAtom, Metric, Params, Spacing, Weight, WellPath};
pub use settings::Settings;

use std::borrow::Cow;

use crate::error::cause;
use crate::feature::{self, Features, gaussian};
use crate::geometry::in_space;
use crate::image::{Field, Geometry, Image};
use crate::improve;
use crate::lattice::AtomKind;
use crate::lattice::distance::{self, Distance};
use crate::lattice::energy::{Beta, Energy, Pairwise, Regularised, Sampled};
use crate::lattice::optimize::{self, Observer, Stop};
use crate::lattice::seeding::wells::{self, Way};
use crate::lattice::seeding::{self, Alignment, Atoms, Seeding};
use crate::mesh::check::check_joined;
use crate::mesh::{Mesh, Simplices};
use crate::report::{Clock, Lattice, Optimisation, Reference, Report, Rival};
use crate::{Error, Result, report};
use join::Joined;

/// A mesh in lattice space, and what led to it.
#[derive(Debug, Clone)]
pub struct Outcome<const D: usize = 3>
where
    Space<D>: Meshing<D>,
{
    /// The mesh; its nodes fill the box `[0, extent]`.
    pub mesh: <Space<D> as Meshing<D>>::Mesh,
    /// For each cell, bit k: its face (edge, in the plane) k, opposite node k, lies on a feature.
    pub feature_faces: Vec<u8>,
    /// What each node may do.
    pub kinds: Vec<AtomKind>,
    /// The far corner of the box.
    pub extent: [f64; D],
    /// Length of one sample along each axis.
    pub step: [f64; D],
    /// What the mesh follows.
    pub features: Features<D>,
    /// Nominal distance between nodes.
    pub distance: Distance<D>,
    /// What the optimiser did in its last pass, and why it stopped.
    pub optimised: optimize::Rest,
    /// Figures of the mesh and of what it cost; where it comes from is for the caller to add.
    pub report: Report,
}

/// The stage from which on a job that is asked to stop still gives a mesh.
pub const OPTIMISING: &str = "moving atoms onto features";

/// How far the volume may be off the box's, and sides from flat, as a share.
pub const BOX_TOLERANCE: f64 = 1e-9;

/// Growth of a variable distance: the bound on |grad d|.
const GROWTH: f64 = 0.1;
/// The widest well, in distances between atoms.
const NARROW: f64 = 0.2;

/// Makes a mesh of an image.
///
/// # Errors
/// The error of the stage that failed: an image that is constant or not finite, a distance that
/// does not fit the box, fixed atoms outside of it or at one place. [`Error::Job`] if the observer
/// asked to stop before there was a lattice.
pub fn mesh_image<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    observer: &mut dyn Observer,
) -> Result<Outcome<D>>
where
    Space<D>: Meshing<D>,
{
    let Settled {
        mut stages,
        extent,
        step,
        features,
        distance,
        mut atoms,
        optimised,
    } = settle(image, params, Alignment::On, observer)?;
    let relaxation = canny::relaxation(image, params, step);

    let scene = Scene {
        extent,
        features: &features,
        distance: &distance,
    };
    if params.seeding == Seeding::Canny {
        let seeded = atoms.len() - params.fixed.len();
        canny::put_onto_features(&mut atoms, seeded, &scene);
    }
    let options = params.min_dihedral.map(|min_dihedral| improve::Target {
        min_dihedral,
        method: params.slivers,
    });
    let Joined {
        mesh,
        neighbors,
        kinds,
        feature_faces,
        improvement,
        rival,
    } = Space::<D>::join(
        atoms,
        &scene,
        relaxation.as_ref(),
        options.as_ref(),
        &mut |stage| {
            stages.begin(stage);
        },
    )?;

    stages.begin("measuring the mesh");
    let claimed = improvement.is_some().then_some(feature_faces.as_slice());
    let neighbors = neighbors.as_deref();
    let mut report = measure(&mesh, neighbors, image.dims(), step, &features, claimed)?;
    report.lattice = Some(Lattice {
        optimisation: (optimised.rounds > 0).then(|| optimisation(&optimised, mesh.nodes().len())),
        ..report::lattice(&mesh, |x| distance.at(x))
    });
    report.improvement = improvement;
    if let Some((mesh, faces)) = rival {
        let other = measure(&mesh, None, image.dims(), step, &features, Some(&faces))?;
        report.rival = other.quality.map(|quality| Rival {
            method: improve::Method::Joe,
            quality,
            fidelity: other.fidelity,
        });
    }
    report.notes.extend(features.notes.iter().cloned());
    stages.clock.end();
    report.stages = stages.clock.costs().to_vec();
    Ok(Outcome {
        mesh,
        feature_faces,
        kinds,
        extent,
        step,
        features,
        distance,
        optimised,
        report,
    })
}

/// Atoms at rest, and what they rest on.
struct Settled<'a, const D: usize> {
    stages: Stages<'a>,
    extent: [f64; D],
    step: [f64; D],
    features: Features<D>,
    distance: Distance<D>,
    atoms: Atoms<D>,
    optimised: optimize::Rest,
}

/// From an image to atoms at rest on its features, or alongside.
fn settle<'a, const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    alignment: Alignment,
    observer: &'a mut dyn Observer,
) -> Result<Settled<'a, D>> {
    check_energy(params, alignment)?;
    let step = params.metric.step(&image.geometry);
    let extent = lattice_extent(image.dims(), step);
    if params.seeding == Seeding::Canny && alignment == Alignment::Alongside {
        return Err(Error::Job(cause(
            "--seeding canny",
            "puts atoms on features, but Voronoi cells need them alongside",
            "use --cells tets, or another seeding",
        )));
    }
    if params.seeding == Seeding::Canny && !params.wells.is_empty() {
        return Err(Error::Job(cause(
            "--seeding canny",
            "decides the distance between atoms, and so knows no wells with their own",
            "give wells as atoms (--atoms-from), or use another seeding",
        )));
    }
    if params.smooth.is_some() && (D != 2 || alignment == Alignment::Alongside) {
        return Err(Error::Job(cause(
            "--smooth",
            "is for the triangles of 2-D images",
            "leave it away",
        )));
    }
    // Before the work: the largest distance must fit, whatever the features are.
    Distance::Constant(params.spacing.max()).validate(extent)?;
    let beta = lattice_beta(&params.beta, image.dims(), step)?;
    let mut fixed = lattice_points(&params.fixed, &image.geometry, step, extent)?;
    let ways = lattice_ways(params, &image.geometry, step, extent)?;

    let mut stages = Stages {
        clock: Clock::new(),
        observer,
    };
    stages.begin_unless_stopped("finding features")?;
    let features = feature::detect(image, &params.feature_options(step))?;

    stages.begin_unless_stopped("placing atoms")?;
    if params.seeding == Seeding::Canny {
        let image = canny::smoothed(image, step, params.sigma.unwrap_or(1.0));
        let (atoms, distance) = seeding::canny::seeded(&features.points, &image, &fixed)?;
        return Ok(Settled {
            stages,
            extent,
            step,
            features,
            distance,
            atoms,
            optimised: canny::AT_REST,
        });
    }
    let mut distance = varying(image, params, &features, step)?;
    if let Some(least) = params.well_distance.filter(|_| !ways.is_empty()) {
        distance = wells::refined(distance, &ways, least, GROWTH, extent)?;
    }
    fixed.extend(wells::atoms(&ways, &distance, extent, alignment)?);
    let mut atoms = seeding::seed(
        params.seeding,
        extent,
        &distance,
        &fixed,
        alignment,
        Some(&features.potential),
    )?;

    stages.begin_unless_stopped(OPTIMISING)?;
    let positions: Vec<[f64; 3]> = atoms.positions.iter().map(|&x| in_space(x)).collect();
    stages.observer.round(0, &positions);
    let optimised = optimise(
        &mut atoms,
        params,
        alignment,
        &features,
        &distance,
        &beta,
        extent,
        stages.observer,
    )?;
    Ok(Settled {
        stages,
        extent,
        step,
        features,
        distance,
        atoms,
        optimised,
    })
}

/// The nominal distance that the parameters ask for.
fn varying<const D: usize>(
    image: &Image<D>,
    params: &Params<D>,
    features: &Features<D>,
    step: [f64; D],
) -> Result<Distance<D>> {
    let field = |image: &Image<D>| Field {
        dims: image.dims(),
        step,
        samples: image.as_slice().to_vec(),
    };
    match params.spacing {
        Spacing::Constant(d) => Ok(Distance::Constant(d)),
        Spacing::FromFeatures { min, max } => distance::from_features(features, min, max, GROWTH),
        Spacing::FromImage { min, max } => distance::from_image(&field(image), min, max, GROWTH),
        Spacing::FromLaplacian { min, max } => {
            distance::from_laplacian(&features.potential, features.sigma, min, max, GROWTH)
        }
        Spacing::OfAtoms { .. } => Err(Error::Job(cause(
            "distance",
            "shall be that of Canny's points, but atoms are placed otherwise",
            "give a distance, or seed by Canny's points",
        ))),
        Spacing::Given { min, max } => match &params.distances {
            Some(given) if given.dims() == image.dims() => {
                distance::from_samples(field(given), min, max, GROWTH)
            }
            given => Err(Error::Job(cause(
                "distances",
                format!(
                    "have dims {:?}, the image {:?}",
                    given.as_ref().map(|image| image.dims()).unwrap_or([0; D]),
                    image.dims()
                ),
                "give one distance per sample of the image",
            ))),
        },
    }
}

/// A potential whose valleys, of width `sigma`, are `factor` times as wide and as deep as before.
fn smoother<const D: usize>(potential: &Field<D>, sigma: f64, factor: f64) -> Field<D> {
    let mut wide = potential.clone();
    // Widths add in quadrature; the depth of a straight valley falls as its width grows.
    let added = sigma * (factor * factor - 1.0).sqrt();
    gaussian::smooth(
        wide.dims,
        &mut wide.samples,
        wide.step.map(|step| added / step),
    );
    for b in &mut wide.samples {
        *b = (*b * factor as f32).clamp(-1.0, 0.0);
    }
    wide
}

/// Shapes, fidelity and validity of a mesh in lattice space.
fn measure<const D: usize, M: Simplices<D>>(
    mesh: &M,
    neighbors: Option<&[u32]>,
    dims: [usize; D],
    step: [f64; D],
    features: &Features<D>,
    claimed: Option<&[u8]>,
) -> Result<Report> {
    let extent = lattice_extent(dims, step);
    let fidelity = match features.points.is_empty() {
        true => None,
        false => {
            let reference = Reference::from_features(features);
            let in_samples = scaled(mesh, step.map(|s| 1.0 / s));
            Some(report::fidelity(&*in_samples, &reference, claimed)?)
        }
    };
    Ok(Report {
        quality: Some(report::quality(mesh)),
        fidelity,
        filling: Some(check_joined(
            mesh,
            neighbors,
            [0.0; D],
            extent,
            BOX_TOLERANCE,
        )),
        ..Report::default()
    })
}

/// A mesh with each axis scaled.
pub fn scaled<const D: usize, M: Simplices<D>>(mesh: &M, scale: [f64; D]) -> Cow<'_, M> {
    if scale == [1.0; D] {
        return Cow::Borrowed(mesh);
    }
    let stretch = |x: &[f64; D]| std::array::from_fn(|k| x[k] * scale[k]);
    let nodes = mesh.nodes().iter().map(stretch).collect();
    Cow::Owned(M::from_parts(nodes, mesh.connectivity().to_vec()))
}

/// The report's lines on the optimiser.
fn optimisation(outcome: &optimize::Rest, atoms: usize) -> Optimisation {
    let per_atom = 1.0 / atoms as f64;
    Optimisation {
        energy_lattice: outcome.parts.lattice * per_atom,
        energy_image: outcome.parts.image * per_atom,
        energy: outcome.energy_after * per_atom,
        evaluations: outcome.evaluations,
        stop: match outcome.stop {
            Stop::Converged => "converged",
            Stop::MaxIterations => "as many rounds as allowed",
            Stop::Interrupted => "interrupted",
        }
        .into(),
    }
}

/// Refuses energies that there are not.
fn check_energy<const D: usize>(params: &Params<D>, alignment: Alignment) -> Result<()> {
    let refuse =
        |option: &str, problem: &str, remedy: &str| Err(Error::Job(cause(option, problem, remedy)));
    let alongside = alignment == Alignment::Alongside;
    let sampled = params.evaluator == Evaluator::Sampled;
    if sampled && alongside {
        return refuse(
            "--potential sampled",
            "has no mirror images, which atoms alongside features need",
            "use the pairwise potential",
        );
    }
    if params.kappa != 1.0 && alongside {
        return refuse(
            "--kappa",
            "is about the neighbours of atoms in a Delaunay mesh, but Voronoi cells are asked for",
            "leave it at 1",
        );
    }
    if params.kappa != 1.0 && sampled {
        return refuse(
            "--kappa",
            "goes with the exact energy, but the sampled potential is asked for",
            "use the pairwise potential",
        );
    }
    Ok(())
}

/// The energy that a job's atoms shall have least of: the same for both evaluators, up to sampling.
fn energy<'a, const D: usize>(
    params: &Params<D>,
    alignment: Alignment,
    mobility: Vec<[f64; D]>,
    potential: &'a Field<D>,
    distance: &'a Distance<D>,
    beta: &Beta<D>,
    extent: [f64; D],
) -> Result<Box<dyn Energy<D> + 'a>> {
    let beta = beta.clone();
    let pairs = |beta| -> Result<Pairwise<'a, D>> {
        let pairs = Pairwise::new(extent, distance, Some(potential), beta)?;
        Ok(pairs.aligned(alignment).uncrowded())
    };
    Ok(match params.evaluator {
        Evaluator::Pairwise if params.kappa != 1.0 => {
            let pairs = pairs(beta.clone())?;
            let energy = Regularised::new(pairs, distance, beta, params.kappa, mobility);
            Box::new(energy?)
        }
        Evaluator::Pairwise => Box::new(pairs(beta)?),
        Evaluator::Sampled => Box::new(Sampled::new(distance, potential, beta).uncrowded()),
    })
}

/// Moves the atoms: passes on smoother and smoother potentials first, if asked for.
fn optimise<const D: usize>(
    atoms: &mut Atoms<D>,
    params: &Params<D>,
    alignment: Alignment,
    features: &Features<D>,
    distance: &Distance<D>,
    beta: &Beta<D>,
    extent: [f64; D],
    observer: &mut dyn Observer,
) -> Result<optimize::Rest> {
    let options = moving(params);
    let mut pass = |potential: &Field<D>| {
        let mut energy = energy(
            params,
            alignment,
            atoms.mobility(extent),
            potential,
            distance,
            beta,
            extent,
        )?;
        optimize::optimize(atoms, &mut *energy, distance, extent, &options, observer)
    };
    for coarse in (1..=params.coarse_passes).rev() {
        let smoother = smoother(&features.potential, features.sigma, f64::from(1 << coarse));
        let outcome = pass(&smoother)?;
        if outcome.stop == Stop::Interrupted {
            return Ok(outcome);
        }
    }
    pass(&features.potential)
}

/// How the atoms of a job are moved.
pub(crate) fn moving<const D: usize>(params: &Params<D>) -> optimize::Effort {
    optimiser(params.seed).with(params.optimizer, params.kappa != 1.0)
}

/// How atoms are moved by default.
pub(crate) fn optimiser(seed: u64) -> optimize::Effort {
    optimize::Effort {
        seed,
        tolerance: 1e-3,
        // Improvement takes over from here: a second round changes neither quality nor fidelity.
        max_rounds: 1,
        max_evaluations: 40,
        ..optimize::Effort::default()
    }
}

/// Tells clock and observer of each stage.
struct Stages<'a> {
    clock: Clock,
    observer: &'a mut dyn Observer,
}

impl Stages<'_> {
    fn begin(&mut self, stage: &str) {
        self.clock.begin(stage);
        self.observer.stage(stage);
    }

    /// Begins a stage before there is a lattice to stop with: a wish to stop ends the job.
    fn begin_unless_stopped(&mut self, stage: &str) -> Result<()> {
        if !self.observer.keep_going() {
            return Err(Error::Job(cause(
                stage,
                "interrupted before there was a lattice",
                "start the job again",
            )));
        }
        self.begin(stage);
        Ok(())
    }
}

/// The far corner of the box in lattice space.
fn lattice_extent<const D: usize>(dims: [usize; D], step: [f64; D]) -> [f64; D] {
    std::array::from_fn(|k| (dims[k].max(1) - 1) as f64 * step[k])
}

/// The weight of the image in lattice space.
pub(crate) fn lattice_beta<const D: usize>(
    weight: &Weight<D>,
    dims: [usize; D],
    step: [f64; D],
) -> Result<Beta<D>> {
    let image = match weight {
        Weight::Constant(beta) => return Ok(Beta::Constant(*beta)),
        Weight::Image(image) => image,
    };
    if image.dims() != dims {
        return Err(Error::Job(cause(
            "beta",
            format!("has dims {:?}, the image {dims:?}", image.dims()),
            "give one weight per sample of the image",
        )));
    }
    Ok(Beta::Field(Field {
        dims,
        step,
        samples: image.as_slice().to_vec(),
    }))
}

/// The ways of wells in lattice space, as far as they lie in the box.
fn lattice_ways<const D: usize>(
    params: &Params<D>,
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
) -> Result<Vec<Way<D>>> {
    let least = params.well_distance.unwrap_or(params.spacing.min());
    let spacing = geometry.spacing();
    let sample = (0..D).fold(f64::INFINITY, |s, k| s.min(spacing[k] / step[k]));
    let mut ways = Vec::new();
    for well in &params.wells {
        let refuse =
            |problem: String, remedy: &str| Err(Error::Seeding(cause(&well.name, problem, remedy)));
        if well.radius >= NARROW * least * sample {
            return refuse(
                format!(
                    "has a radius of {}, but cells are only about {} wide there",
                    well.radius,
                    least * sample
                ),
                "give a smaller radius or a larger distance between atoms",
            );
        }
        let to_lattice = |&x: &[f64; D]| -> Option<[f64; D]> {
            let index = geometry.to_index(x)?;
            Some(std::array::from_fn(|k| index[k] * step[k]))
        };
        let points: Option<Vec<_>> = well.points.iter().map(to_lattice).collect();
        let way = Way {
            name: well.name.clone(),
            points: points.unwrap_or_default(),
        };
        let inside = way.inside(extent);
        if inside.is_empty() {
            let problem = "lies outside the image".to_string();
            return refuse(
                problem,
                "give points inside, in the image's physical coordinates",
            );
        }
        ways.extend(inside);
    }
    Ok(ways)
}

/// Physical points in lattice space; all must lie in the box and apart from one another.
pub(crate) fn lattice_points<const D: usize>(
    points: &[FixedAtom<D>],
    geometry: &Geometry<D>,
    step: [f64; D],
    extent: [f64; D],
) -> Result<Vec<[f64; D]>> {
    let refuse = |k: usize, problem: String, remedy: &str| {
        let FixedAtom { name, position } = &points[k];
        let position = position.map(|c| c.to_string()).join(", ");
        Error::Seeding(cause(
            format!("{name}: fixed atom ({position})"),
            problem,
            remedy,
        ))
    };
    let mut found: Vec<[f64; D]> = Vec::with_capacity(points.len());
    for (k, point) in points.iter().enumerate() {
        let index = geometry.to_index(point.position).ok_or_else(|| {
            refuse(
                k,
                "the image's axes do not span space".into(),
                "correct the image's geometry",
            )
        })?;
        let mut position = [0.0; D];
        for axis in 0..D {
            let x = index[axis] * step[axis];
            // Rounding in the coordinates must not push a point off its side.
            let slack = 1e-6 * extent[axis];
            if !(-slack..=extent[axis] + slack).contains(&x) {
                let index = index.map(|i| (1e3 * i).round() / 1e3);
                return Err(refuse(
                    k,
                    format!("lies outside the image, at sample {index:?} (x first)"),
                    "give points inside, in the image's physical coordinates",
                ));
            }
            position[axis] = x.clamp(0.0, extent[axis]);
        }
        found.push(position);
    }
    let mut order: Vec<usize> = (0..found.len()).collect();
    order.sort_by(|&a, &b| {
        found[a]
            .partial_cmp(&found[b])
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    for pair in order.windows(2) {
        if found[pair[0]] == found[pair[1]] {
            let (first, second) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
            let problem = format!("is at the same place as that of {}", points[first].name);
            return Err(refuse(second, problem, "keep one of the two"));
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_evaluators_have_the_energy_of_crowded_atoms() {
        // Rows of atoms 0.6 d apart: what keeps them from crowding is most of their energy.
        let (d, extent) = (10.0, [60.0, 60.0]);
        let atoms: Vec<[f64; 2]> = (0..49)
            .map(|i| [6.0 * f64::from(i % 7) + 12.0, 6.0 * f64::from(i / 7) + 12.0])
            .collect();
        let potential = Field::from_fn([61, 61], [1.0; 2], |x| -0.01 * x[0]);
        let (distance, beta) = (Distance::Constant(d), Beta::Constant(0.6));
        let [pairwise, sampled] = [Evaluator::Pairwise, Evaluator::Sampled].map(|evaluator| {
            let params = Params {
                evaluator,
                ..Params::default()
            };
            let mobility = vec![[1.0; 2]; atoms.len()];
            let energy = energy(
                &params,
                Alignment::On,
                mobility,
                &potential,
                &distance,
                &beta,
                extent,
            );
            let mut gradient = vec![[0.0; 2]; atoms.len()];
            energy.unwrap().evaluate(&atoms, &mut gradient)
        });
        // On samples both are exact.
        assert!(pairwise > 1.0, "{pairwise}");
        let off = (pairwise - sampled).abs();
        assert!(off < 1e-4 * pairwise, "{pairwise} {sampled}");
    }
}
