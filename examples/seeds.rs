//! Compares methods to seed and to optimise lattices, as in tables 2 and 3 of Fernandes & Gattass
//! (2009). Meshes are the Delaunay triangles (tetrahedra) of the atoms without further improvement.
//!
//! ```text
//! cargo run --release --example seeds -- 14                  # two synthetic images
//! cargo run --release --example seeds -- 8 slice.png ...     # your own images, 2-D or 3-D
//! cargo run --release --example seeds -- 8 draw slice.png    # pictures: guide.png, projection.png
//! ```

use std::path::Path;

use atomesh::feature::{self, Features};
use atomesh::image::Image;
use atomesh::image::formats::{self, AnyImage, ReadOptions};
use atomesh::image::synth::{self, SyntheticKind};
use atomesh::lattice::distance::Distance;
use atomesh::lattice::energy::{Beta, Energy, PairwiseEnergy};
use atomesh::lattice::optimise::{self, Method, NoProgress, OptimiseOptions};
use atomesh::lattice::seeding::{self, Alignment, Atoms, Seeding};
use atomesh::mesh::delaunay;
use atomesh::mesh::poly::Lists;
use atomesh::mesh::{Dimension, Simplices, Space};
use atomesh::model::slice::{self, Caption, Overlay, Skeleton};
use atomesh::model::surface::SurfaceKind;
use atomesh::progress::CancelToken;
use atomesh::published::guide::{GuideOptions, draw_lattice};
use atomesh::published::laplacian::{DEFAULT_KAPPA, RegularisedEnergy};
use atomesh::published::{genetic, projection};
use atomesh::report::cost::cpu_seconds;
use atomesh::report::quality;

/// Number of runs with different seeds over which figures are averaged, as in the paper.
const RUNS: u64 = 10;
/// Weight of the image.
const BETA: f64 = 0.5;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((d, images)) = arguments.split_first() else {
        anyhow::bail!("give the distance between atoms, and images");
    };
    let d: f64 = d.parse()?;
    if let [draw, image] = images
        && draw == "draw"
    {
        let AnyImage::Plane(loaded) = formats::read_any(Path::new(image), &ReadOptions::default())?
        else {
            anyhow::bail!("{image} is not a 2-D image");
        };
        return draw_seedings(&loaded.image, d);
    }
    for name in images {
        match formats::read_any(Path::new(name), &ReadOptions::default())? {
            AnyImage::Plane(loaded) => compare_methods(name, &loaded.image, d)?,
            AnyImage::Space(loaded) => compare_methods(name, &loaded.image, d)?,
        }
    }
    if images.is_empty() {
        for (name, kind, dims) in [
            ("faults, a time slice", SyntheticKind::Faults, [384, 352, 1]),
            (
                "amplitudes, a vertical section",
                SyntheticKind::Amplitude,
                [288, 416, 1],
            ),
        ] {
            let options = synth::Options {
                dims,
                ..synth::Options::default()
            };
            compare_methods(name, &synth::make_2d(kind, &options)?.image, d)?;
        }
    }
    Ok(())
}

/// Input of the comparison on one image.
struct Case<'a, const D: usize> {
    features: &'a Features<D>,
    distance: Distance<D>,
    extent: [f64; D],
}

/// Figures of one lattice.
#[derive(Default)]
struct Figures {
    atoms: f64,
    worst: f64,
    mean: f64,
    seconds: f64,
    energy: f64,
}

fn compare_methods<const D: usize>(name: &str, image: &Image<D>, d: f64) -> anyhow::Result<()>
where
    Space<D>: Dimension<D>,
{
    let features = detect_features(image, d)?;
    let case = Case::new(&features, d);
    println!("\n{name}, {:?}, d = {d}\n", image.dims());
    println!("| seeding | moved by | atoms | worst Q | mean Q | CPU ms | energy |");
    println!("|---|---|---|---|---|---|---|");
    for seeding in ["fcc", "refine", "guide", "projection"] {
        for (optimizer, method, kappa) in [
            ("nothing", None, 1.0),
            ("lbfgs", Some(Method::Lbfgs), 1.0),
            ("lbfgs, kappa 0.7", Some(Method::Lbfgs), DEFAULT_KAPPA),
            ("descent", Some(Method::Descent), 1.0),
            ("genetic", Some(genetic::method()), 1.0),
        ] {
            let mut sum = Figures::default();
            for seed in 1..=RUNS {
                let before = cpu_seconds();
                let mut atoms = case.seed(seeding, seed)?;
                let seeded = cpu_seconds();
                if let Some(method) = method {
                    let options = optimise_options(seed).with_method(method, kappa < 1.0);
                    case.move_atoms(&mut atoms, &options, kappa)?;
                }
                let seconds = match method {
                    None => seeded - before,
                    Some(_) => cpu_seconds() - seeded,
                };
                let figures = case.measure(atoms)?;
                sum.atoms += figures.atoms;
                sum.worst += figures.worst;
                sum.mean += figures.mean;
                sum.energy += figures.energy;
                sum.seconds += seconds;
            }
            let runs = RUNS as f64;
            println!(
                "| {seeding} | {optimizer} | {:.0} | {:.3} | {:.3} | {:.0} | {:.1} |",
                sum.atoms / runs,
                sum.worst / runs,
                sum.mean / runs,
                1e3 * sum.seconds / runs,
                sum.energy / runs
            );
        }
    }

    println!(
        "\n| evaluations | genetic: worst Q | mean Q | energy | lbfgs: worst Q | mean Q | energy |"
    );
    println!("|---|---|---|---|---|---|---|");
    // The genetic algorithm evaluates the initial lattice twice, then the children of each
    // generation.
    let children = genetic::POPULATION_SIZE - 1;
    for generations in [0, 1, 2, 4, 8, 16, 32, 64, 128] {
        let evaluations = 2 + generations * children;
        print!("| {evaluations}");
        for method in [genetic::method(), Method::Lbfgs] {
            let mut atoms = case.seed("guide", 1)?;
            if generations > 0 {
                let options = OptimiseOptions {
                    method,
                    tolerance: 1e-9,
                    max_evaluations: evaluations,
                    ..optimise_options(1)
                };
                case.move_atoms(&mut atoms, &options, 1.0)?;
            }
            let figures = case.measure(atoms)?;
            print!(
                " | {:.3} | {:.3} | {:.1}",
                figures.worst, figures.mean, figures.energy
            );
        }
        println!(" |");
    }
    Ok(())
}

fn detect_features<const D: usize>(image: &Image<D>, d: f64) -> anyhow::Result<Features<D>> {
    let options = feature::DetectionOptions {
        d_min: d,
        ..feature::DetectionOptions::default()
    };
    Ok(feature::detect(image, &options)?)
}

/// Draws the seeded atoms, joined to triangles, over the image. Sides between atoms on features are
/// marked.
fn draw_seedings(image: &Image<2>, d: f64) -> anyhow::Result<()> {
    let features = detect_features(image, d)?;
    for seeding in ["guide", "projection"] {
        let nodes = Case::new(&features, d).seed(seeding, 1)?.positions;
        let triangles = delaunay::delaunay_plane(&nodes)?.triangles;
        let sides = triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let sides: Vec<[u32; 2]> = sides.collect();
        let on_feature = |&n: &u32| features.potential.value(nodes[n as usize]) < -0.5;
        let skeleton = Skeleton {
            faces: Lists {
                offsets: (0..=sides.len() as u32).map(|side| 2 * side).collect(),
                items: sides.concat(),
            },
            kinds: sides
                .iter()
                .map(|side| side.iter().all(on_feature).then_some(SurfaceKind::Fault))
                .collect(),
            nodes,
        };
        let overlay = Overlay {
            mesh: skeleton,
            ..Overlay::default()
        };
        slice::draw_plane(image, &overlay, &Caption::default())?
            .write(Path::new(&format!("{seeding}.png")))?;
    }
    Ok(())
}

fn optimise_options<const D: usize>(seed: u64) -> OptimiseOptions<D> {
    OptimiseOptions {
        seed,
        tolerance: 1e-4,
        max_rounds: 1,
        max_evaluations: 60,
        ..OptimiseOptions::default()
    }
}

impl<const D: usize> Case<'_, D>
where
    Space<D>: Dimension<D>,
{
    fn new(features: &Features<D>, d: f64) -> Case<'_, D> {
        Case {
            extent: features.potential.extent(),
            features,
            distance: Distance::Constant(d),
        }
    }

    fn seed(&self, name: &str, seed: u64) -> anyhow::Result<Atoms<D>> {
        let (extent, distance) = (self.extent, &self.distance);
        let (alignment, cancel) = (Alignment::OnFeatures, &CancelToken::never());
        let potential = &self.features.potential.to_dense();
        let guide = |fixed: &[[f64; D]]| {
            let options = GuideOptions {
                alignment,
                seed,
                max_atoms: usize::MAX,
            };
            draw_lattice(extent, distance, potential, fixed, options, cancel)
        };
        let project = |fixed: &[[f64; D]]| {
            projection::project_lattice(extent, distance, potential, fixed, alignment, cancel)
        };
        let seed_regular = |method| seeding::seed(method, extent, distance, &[], alignment, cancel);
        Ok(match name {
            "refine" => seed_regular(Seeding::Refine { seed })?,
            "guide" => seeding::seed_with(extent, distance, &[], alignment, guide)?,
            "projection" => seeding::seed_with(extent, distance, &[], alignment, project)?,
            _ => seed_regular(Seeding::Fcc)?,
        })
    }

    /// Returns the pairwise energy as published.
    fn pairwise_energy(&self) -> anyhow::Result<PairwiseEnergy<'_, D>> {
        let potential = Some(&self.features.potential);
        let beta = Beta::Constant(BETA);
        Ok(PairwiseEnergy::new(
            self.extent,
            &self.distance,
            potential,
            beta,
        )?)
    }

    fn move_atoms(
        &self,
        atoms: &mut Atoms<D>,
        options: &OptimiseOptions<D>,
        kappa: f64,
    ) -> anyhow::Result<()> {
        let pairs = self.pairwise_energy()?.with_auto_stiffness();
        let mut energy: Box<dyn Energy<D>> = if kappa < 1.0 {
            let mobility = atoms.mobility(self.extent);
            let beta = Beta::Constant(BETA);
            let energy = RegularisedEnergy::new(pairs, &self.distance, beta, kappa, mobility)?;
            Box::new(energy)
        } else {
            Box::new(pairs)
        };
        let (distance, extent) = (&self.distance, self.extent);
        optimise::optimise(
            atoms,
            &mut *energy,
            distance,
            extent,
            options,
            &mut NoProgress,
        )?;
        Ok(())
    }

    fn measure(&self, atoms: Atoms<D>) -> anyhow::Result<Figures> {
        let mut gradient = vec![[0.0; D]; atoms.len()];
        let energy = self
            .pairwise_energy()?
            .evaluate(&atoms.positions, &mut gradient)?;
        let count = atoms.len() as f64;
        let mesh = Space::<D>::delaunay(&atoms.positions)?;
        let [worst, mean] = worst_and_mean_quality(&mesh);
        Ok(Figures {
            atoms: count,
            worst,
            mean,
            seconds: 0.0,
            energy,
        })
    }
}

/// Returns the worst and the mean Q = 4 sqrt(3) A / (l1^2 + l2^2 + l3^2) of triangles. For
/// tetrahedra it is the mean ratio, which equals Q in the plane.
fn worst_and_mean_quality<const D: usize>(mesh: &impl Simplices<D>) -> [f64; 2] {
    let quality = quality(mesh);
    [quality.mean_ratio.worst, quality.mean_ratio_mean]
}
