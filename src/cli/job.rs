//! What shall be done, checked as far as it can be before the image is read.

use std::path::{Path, PathBuf};

use crate::cli::common::feature::{FeatureChoice, feature_scale, feature_weights, threshold};
use crate::cli::common::output::{check_output, same_file};
use crate::cli::options::{
    AlignChoice, CellsChoice, MeshOptions, OptimizerChoice, PotentialChoice, SeedingChoice,
    SliverChoice,
};
use crate::cli::parse::{self, refuse};
use crate::error::cause;
use crate::image::formats::ReadOptions;
use crate::improve::Method;
use crate::improve::triangles::relax::Scheme;
use crate::job::{Evaluator, Metric, Spacing};
use crate::lattice::optimize;
use crate::lattice::seeding::Seeding;
use crate::{Error, Result};

/// A checked job of `atomesh mesh`. What needs the image's geometry (fixed atoms, beta as an
/// image) is checked when that is known.
#[derive(Debug, Clone)]
pub struct MeshJob {
    /// The image to read.
    pub image: PathBuf,
    /// How to read it.
    pub input: ReadOptions,
    /// The mesh to write.
    pub output: PathBuf,
    /// Where the report goes as JSON.
    pub report: Option<PathBuf>,
    /// Where the lattice of each round goes.
    pub trace: Option<PathBuf>,
    /// Where the potential goes.
    pub potential_out: Option<PathBuf>,
    /// Nominal distance.
    pub spacing: Spacing,
    /// Features to follow.
    pub feature: FeatureChoice,
    /// Feature scale, if not automatic.
    pub sigma: Option<f64>,
    /// Feature threshold, if not automatic.
    pub threshold: Option<f32>,
    /// Weights of faults and of horizons.
    pub feature_weights: [f64; 2],
    /// Points of the object, for paths.
    pub object: Vec<String>,
    /// Points of the background.
    pub background: Vec<String>,
    /// File of distances.
    pub distances: Option<PathBuf>,
    /// Weight of the image.
    pub beta: Beta,
    /// File of fixed atoms.
    pub atoms_from: Option<PathBuf>,
    /// Files of wells.
    pub wells: Vec<PathBuf>,
    /// Distance between atoms at wells.
    pub well_distance: Option<f64>,
    /// Voronoi cells of atoms alongside features, instead of a mesh of atoms on them.
    pub voronoi: bool,
    /// Evaluator of the energy.
    pub evaluator: Evaluator,
    /// Weight of the energy between atoms against their Laplacian coordinates.
    pub kappa: f64,
    /// How atoms are moved.
    pub optimizer: optimize::Method,
    /// How atoms are placed.
    pub seeding: Seeding,
    /// Number of passes on a smoother potential.
    pub coarse_passes: usize,
    /// Smallest dihedral angle aimed at, in degrees; `None` leaves slivers in.
    pub min_dihedral: Option<f64>,
    /// How they are removed.
    pub slivers: Method,
    /// Share of the cells' size within which nodes of Voronoi cells are welded.
    pub weld: f64,
    /// How triangles are smoothed, if they shall be.
    pub smooth: Option<Scheme>,
    /// Lattice space.
    pub metric: LatticeSpace,
    /// Seed.
    pub seed: u64,
}

/// The length of a sample along each axis of lattice space, before the number of axes is known.
#[derive(Debug, Clone, PartialEq)]
pub enum LatticeSpace {
    /// 1 each.
    Samples,
    /// The image's spacing.
    Physical,
    /// As given, x first.
    Scales(Vec<f64>),
}

impl LatticeSpace {
    /// For an image of `D` axes.
    ///
    /// # Errors
    /// [`Error::Job`] if that is not the number of scales.
    pub fn metric<const D: usize>(&self) -> Result<Metric<D>> {
        match self {
            Self::Samples => Ok(Metric::Samples),
            Self::Physical => Ok(Metric::Physical),
            Self::Scales(scales) => match scales.as_slice().try_into() {
                Ok(scales) => Ok(Metric::Scales(scales)),
                Err(_) => Err(parse::bad(
                    "--metric",
                    &scales
                        .iter()
                        .map(f64::to_string)
                        .collect::<Vec<_>>()
                        .join(","),
                    &format!("has {} scales, but the image {D} axes", scales.len()),
                    "give one scale an axis",
                )),
            },
        }
    }
}

/// Weight of the image, before its file is read.
#[derive(Debug, Clone, PartialEq)]
pub enum Beta {
    /// The same everywhere.
    Constant(f64),
    /// In this image file.
    File(PathBuf),
}

impl MeshJob {
    /// Checks the options of a job on `image`.
    ///
    /// # Errors
    /// [`Error::Job`] that names the option that is impossible; [`Error::Io`] for an output whose
    /// folder does not exist.
    pub fn new(image: &Path, options: &MeshOptions) -> Result<Self> {
        let output = match &options.output {
            Some(path) => path.clone(),
            None => Path::new(image.file_stem().unwrap_or(image.as_os_str())).with_extension("vtu"),
        };
        let job = Self {
            image: image.to_path_buf(),
            input: options.input.read_options()?,
            output,
            report: options.report.clone(),
            trace: options.trace.clone(),
            potential_out: options.potential_out.clone(),
            spacing: spacing(options)?,
            feature: options.feature.unwrap_or(FeatureChoice::Auto),
            sigma: feature_scale(options.sigma)?,
            threshold: threshold(options.threshold)?,
            feature_weights: feature_weights(options.feature_weights.as_deref())?,
            object: options.object.clone().unwrap_or_default(),
            background: options.background.clone().unwrap_or_default(),
            distances: match spacing(options)? {
                Spacing::Given { .. } => options.distance_from.as_ref().map(PathBuf::from),
                _ => None,
            },
            beta: beta(options.beta.as_deref())?,
            atoms_from: options.atoms_from.clone(),
            wells: options.well.clone().unwrap_or_default(),
            well_distance: well_distance(options)?,
            seeding: seeding(options)?,
            voronoi: voronoi(options)?,
            evaluator: match options.potential {
                Some(PotentialChoice::Sampled) => Evaluator::Sampled,
                _ => Evaluator::Pairwise,
            },
            kappa: kappa(options.kappa.unwrap_or(1.0))?,
            optimizer: options.optimizer.unwrap_or(OptimizerChoice::Lbfgs).into(),
            coarse_passes: coarse_passes(options.coarse_to_fine.unwrap_or(0))?,
            min_dihedral: match options.slivers {
                Some(SliverChoice::None) => None,
                _ => Some(min_dihedral(options.min_dihedral.unwrap_or(30.0))?),
            },
            slivers: match options.slivers {
                Some(SliverChoice::Exude) => Method::Exude,
                _ => Method::Joe,
            },
            weld: weld(options)?,
            smooth: options.smooth.map(Scheme::from),
            metric: lattice_space(options.metric.as_deref().unwrap_or("samples"))?,
            seed: options.rng_seed.unwrap_or(1),
        };
        job.check_files()?;
        Ok(job)
    }

    /// Outputs can be written, have the endings of what they hold, and replace no input and no
    /// other output.
    fn check_files(&self) -> Result<()> {
        let mut inputs = vec![self.image.as_path()];
        inputs.extend(self.atoms_from.as_deref());
        inputs.extend(self.wells.iter().map(PathBuf::as_path));
        if let Beta::File(path) = &self.beta {
            inputs.push(path);
        }
        let outputs = [
            (Some(&self.output), "--output", "vtu"),
            (self.report.as_ref(), "--report", "json"),
            (self.trace.as_ref(), "--trace", "pvd"),
            (self.potential_out.as_ref(), "--potential-out", "vti"),
        ];
        let mut seen: Vec<&Path> = Vec::new();
        for (path, option, ending) in outputs {
            let Some(path) = path else { continue };
            check_output(path, option, &[ending], &inputs)?;
            if seen.iter().any(|other| same_file(other, path)) {
                let place = format!("{option} {}", path.display());
                return Err(Error::Job(cause(
                    place,
                    "is the name of another output, too",
                    "give each output a name of its own",
                )));
            }
            seen.push(path);
        }
        Ok(())
    }
}

/// Largest share of the cells' size within which nodes may be welded: beyond it, cells lose faces that
/// matter.
const MOST_WELDED: f64 = 0.2;

fn weld(options: &MeshOptions) -> Result<f64> {
    let weld = options.weld.unwrap_or(0.0);
    let refuse = |problem: String, remedy: &str| Err(Error::Job(cause("--weld", problem, remedy)));
    if !(0.0..=MOST_WELDED).contains(&weld) {
        let problem = format!("{weld} is not a share between 0 and {MOST_WELDED}");
        return refuse(problem, "give 0.001, say");
    }
    if weld > 0.0 && !voronoi(options)? {
        return refuse(
            "is about Voronoi cells, but tetrahedra or triangles are asked for".into(),
            "give --cells voronoi, or leave it away",
        );
    }
    Ok(weld)
}

/// `--well-distance`, if given: positive, and with wells.
fn well_distance(options: &MeshOptions) -> Result<Option<f64>> {
    let Some(d) = options.well_distance else {
        return Ok(None);
    };
    let (problem, remedy) = match d.is_finite() && d > 0.0 {
        true if options.well.is_some() => return Ok(Some(d)),
        true => ("is given without a well", "add --well FILE.csv"),
        false => ("is not a positive number of samples", "give one above 0"),
    };
    Err(refuse("--well-distance", d, problem, remedy))
}

/// Whether Voronoi cells are wanted: they need atoms alongside features, and strictly inside the box;
/// tetrahedra need atoms on both.
fn voronoi(options: &MeshOptions) -> Result<bool> {
    let alongside = options.align.map(|align| align == AlignChoice::Alongside);
    let cells = options.cells.map(|cells| cells == CellsChoice::Voronoi);
    let voronoi = cells.or(alongside).unwrap_or(false);
    if alongside.is_some_and(|alongside| alongside != voronoi) {
        let problem = if voronoi {
            "puts atoms on features and on the sides of the box, where no Voronoi cell can end"
        } else {
            "keeps atoms off features and off the sides of the box, which tetrahedra must reach"
        };
        return Err(Error::Job(cause(
            "--align",
            problem,
            "use --align on --cells tets, or --align alongside --cells voronoi",
        )));
    }
    if voronoi && options.potential == Some(PotentialChoice::Sampled) {
        return Err(Error::Job(cause(
            "--potential sampled",
            "has no mirror images, which atoms alongside features need",
            "use the pairwise potential",
        )));
    }
    let defaults = MeshOptions::defaults();
    if voronoi
        && (options.slivers, options.min_dihedral) != (defaults.slivers, defaults.min_dihedral)
    {
        return Err(Error::Job(cause(
            "--slivers, --min-dihedral",
            "is about tetrahedra and triangles, but Voronoi cells are asked for",
            "leave it away",
        )));
    }
    Ok(voronoi)
}

fn spacing(options: &MeshOptions) -> Result<Spacing> {
    let defaults = MeshOptions::defaults();
    let given = (&options.distance, &options.distance_from);
    if options.seeding == Some(SeedingChoice::Canny)
        && given != (&defaults.distance, &defaults.distance_from)
    {
        return Err(Error::Job(cause(
            "--distance",
            "with --seeding canny the image and its features decide it",
            "leave it away, or choose another seeding",
        )));
    }
    let text = options.distance.as_deref().unwrap_or("8");
    let from = options.distance_from.as_deref();
    match (parse::distance("--distance", text)?, from) {
        ((d, None), None) => Ok(Spacing::Constant(d)),
        ((min, Some(max)), Some("features")) => Ok(Spacing::FromFeatures { min, max }),
        ((min, Some(max)), Some("image")) => Ok(Spacing::FromImage { min, max }),
        ((min, Some(max)), Some("laplacian")) => Ok(Spacing::FromLaplacian { min, max }),
        ((min, Some(max)), Some(file)) if Path::new(file).is_file() => {
            Ok(Spacing::Given { min, max })
        }
        ((_, Some(_)), Some(other)) => Err(parse::bad(
            "--distance-from",
            other,
            "is neither features, image, laplacian nor a file",
            "give one of these, or an image of distances in samples",
        )),
        ((_, Some(_)), None) => Err(parse::bad(
            "--distance",
            text,
            "says how much the distance varies but not with what",
            "add --distance-from features",
        )),
        ((_, None), Some(_)) => Err(parse::bad(
            "--distance",
            text,
            "is one distance, but --distance-from makes it vary",
            "give MIN:MAX such as 5:15, or drop --distance-from",
        )),
    }
}

fn beta(text: Option<&str>) -> Result<Beta> {
    let text = text.unwrap_or("0.2");
    let Ok(value) = text.parse::<f64>() else {
        let path = Path::new(text);
        return if path.is_file() {
            Ok(Beta::File(path.to_path_buf()))
        } else {
            Err(parse::bad(
                "--beta",
                text,
                "is neither a number nor a file",
                "give a number from 0 to 1, or an image of such numbers",
            ))
        };
    };
    // At 1 nothing would keep the atoms apart.
    if (0.0..1.0).contains(&value) {
        Ok(Beta::Constant(value))
    } else {
        Err(parse::bad(
            "--beta",
            text,
            "is not at least 0 and below 1",
            "0 ignores the image, 0.2 is usual",
        ))
    }
}

fn seeding(options: &MeshOptions) -> Result<Seeding> {
    let seed = options.rng_seed.unwrap_or(1);
    let choice = options.seeding.unwrap_or(SeedingChoice::Fcc);
    if options.max_atoms.is_some() && choice != SeedingChoice::Guide {
        return Err(Error::Job(cause(
            "--max-atoms",
            "is about atoms that are drawn one by one",
            "use it with --seeding guide, or choose a larger --distance",
        )));
    }
    Ok(match choice {
        SeedingChoice::Fcc => Seeding::Regular,
        SeedingChoice::Grown => Seeding::Grown,
        SeedingChoice::Refine => Seeding::Refine { seed },
        SeedingChoice::Guide => Seeding::Guide {
            seed,
            most: options.max_atoms.unwrap_or(usize::MAX),
        },
        SeedingChoice::Projection => Seeding::Projection,
        SeedingChoice::Canny => Seeding::Canny,
    })
}

fn kappa(kappa: f64) -> Result<f64> {
    if (0.0..=1.0).contains(&kappa) {
        Ok(kappa)
    } else {
        Err(refuse(
            "--kappa",
            kappa,
            "is not from 0 to 1",
            "1 leaves Laplacian coordinates out, 0.7 is usual with them",
        ))
    }
}

fn coarse_passes(passes: usize) -> Result<usize> {
    if passes > 8 {
        return Err(parse::bad(
            "--coarse-to-fine",
            &passes.to_string(),
            "is more than 8 passes, each twice as smooth as the next",
            "1 or 2 are usual",
        ));
    }
    Ok(passes)
}

fn min_dihedral(degrees: f64) -> Result<f64> {
    // A regular tetrahedron has 70.5 degrees, but no space is filled with those alone.
    if degrees > 0.0 && degrees <= 60.0 {
        Ok(degrees)
    } else {
        Err(refuse(
            "--min-dihedral",
            degrees,
            "is not above 0 and at most 60 degrees",
            "30 is usual",
        ))
    }
}

fn lattice_space(text: &str) -> Result<LatticeSpace> {
    match text {
        "samples" => Ok(LatticeSpace::Samples),
        "physical" => Ok(LatticeSpace::Physical),
        scales => Ok(LatticeSpace::Scales(parse::scales("--metric", scales)?)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(options: &MeshOptions) -> Result<MeshJob> {
        MeshJob::new(
            Path::new("absent/survey.sgy"),
            &options.over(&MeshOptions::defaults())?,
        )
    }

    #[test]
    fn nothing_typed_is_a_valid_job() {
        let job = job(&MeshOptions::default()).unwrap();
        assert_eq!(job.output, Path::new("survey.vtu"));
        assert_eq!(job.spacing, Spacing::Constant(8.0));
        assert_eq!(job.beta, Beta::Constant(0.5));
        assert_eq!(job.min_dihedral, Some(30.0));
        assert_eq!(job.metric, LatticeSpace::Samples);
        assert_eq!(job.metric.metric::<2>().unwrap(), Metric::Samples);
        assert!(LatticeSpace::Scales(vec![1.0; 3]).metric::<2>().is_err());
    }
}
