//! From [`Settings`] to a [`Job`] and back.
//!
//! A setting that the job has no place for is refused, with the reason, unless it says what is so by
//! default. Errors begin with the setting's name.

use std::path::{Path, PathBuf};

use super::Evaluator;
use super::asked::{
    Apart, Beta, Cells, DistanceFrom, Followed, Job, LatticeEnergy, LatticeJob, LatticeSpace,
    Outputs, Placement, RngSeed, Slivers, Start, StrongKind, Wells, What,
};
use super::settings::{AlignName, CellsName, SeedingName, Settings, SliversName};
use crate::error::cause;
use crate::feature::FeatureKind;
use crate::improve;
use crate::{Error, Result};

/// An error about a setting.
fn bad(name: &str, value: impl std::fmt::Display, problem: &str, remedy: &str) -> Error {
    Error::Job(cause(format!("{name} {value}"), problem, remedy))
}

impl TryFrom<Settings> for Job {
    type Error = Error;

    /// Reads settings; what is absent is as by default.
    ///
    /// # Errors
    /// [`Error::Job`] that begins with the name of the setting that is impossible, or that nothing
    /// would
    /// come of.
    fn try_from(settings: Settings) -> Result<Self> {
        let said = Said::new(settings)?;
        let voronoi = voronoi(&said)?;
        let cells = cells(&said, voronoi)?;
        let placement = match said.settings.seeding {
            Some(SeedingName::Canny) => canny(&said, voronoi)?,
            seeding => Placement::Lattice(lattice(&said, seeding, voronoi)?),
        };
        let features = followed(&said)?;
        let settings = said.settings;
        Ok(Self {
            input: settings.input,
            features,
            placement,
            atoms_from: settings.atoms_from,
            cells,
            metric: match settings.metric.as_deref() {
                None | Some("samples") => LatticeSpace::Samples,
                Some("physical") => LatticeSpace::Physical,
                Some(scales) => LatticeSpace::Scales(axis_scales(scales)?),
            },
            seed: settings.rng_seed.map_or(RngSeed::default(), RngSeed),
            outputs: Outputs {
                mesh: settings.output,
                report: settings.report,
                potential: settings.potential_out,
            },
        })
    }
}

/// What was said, and what would be said by default.
struct Said {
    settings: Settings,
    table: toml::Table,
    by_default: toml::Table,
}

impl Said {
    fn new(settings: Settings) -> Result<Self> {
        Ok(Self {
            table: settings.table()?,
            by_default: Settings::of_defaults().table()?,
            settings,
        })
    }

    /// Refuses settings of these names, where they say something else than is so by default.
    fn unused(&self, names: &[&str], problem: &str, remedy: &str) -> Result<()> {
        for name in names {
            let value = self.table.get(*name);
            if let Some(value) = value.filter(|value| self.by_default.get(*name) != Some(value)) {
                let value = match value {
                    toml::Value::String(text) => text.clone(),
                    other => other.to_string(),
                };
                return Err(bad(name, value, problem, remedy));
            }
        }
        Ok(())
    }
}

/// Whether Voronoi cells are wanted: they need atoms alongside features, and strictly inside the box;
/// tetrahedra need atoms on both.
fn voronoi(said: &Said) -> Result<bool> {
    let alongside = said
        .settings
        .align
        .map(|align| align == AlignName::Alongside);
    let cells = said.settings.cells.map(|cells| cells == CellsName::Voronoi);
    let voronoi = cells.or(alongside).unwrap_or(false);
    if alongside.is_some_and(|alongside| alongside != voronoi) {
        let (value, problem) = if voronoi {
            (
                "on",
                "puts atoms on features and on the sides of the box, where no Voronoi cell can end",
            )
        } else {
            (
                "alongside",
                "keeps atoms off features and off the sides of the box, which tetrahedra must reach",
            )
        };
        let remedy = "place atoms on features for tets, alongside for Voronoi cells";
        return Err(bad("align", value, problem, remedy));
    }
    Ok(voronoi)
}

fn cells(said: &Said, voronoi: bool) -> Result<Cells> {
    let settings = &said.settings;
    if voronoi {
        let of_others = ["slivers", "min-dihedral", "smooth"];
        let problem = "applies to tetrahedra and triangles, but the mesh has Voronoi cells";
        said.unused(&of_others, problem, "omit it, or choose tets")?;
        let weld = settings.weld.unwrap_or(0.0);
        if !(0.0..=MOST_WELDED).contains(&weld) {
            let problem = format!("is not a fraction from 0 to {MOST_WELDED}");
            return Err(bad("weld", weld, &problem, "give 0.001, say"));
        }
        return Ok(Cells::Voronoi { weld });
    }
    let problem = "applies to Voronoi cells, but the mesh has tetrahedra or triangles";
    said.unused(&["weld"], problem, "choose Voronoi cells, or omit it")?;
    let method = match settings.slivers {
        Some(SliversName::None) => None,
        Some(SliversName::Exude) => Some(improve::Method::Exude),
        Some(SliversName::Joe) | None => Some(improve::Method::Joe),
    };
    let slivers = match method {
        None => {
            let problem = "sets a target angle, but no slivers are to be removed";
            said.unused(
                &["min-dihedral"],
                problem,
                "omit it, or have slivers removed",
            )?;
            Slivers::Left
        }
        Some(method) => {
            let min_dihedral = settings.min_dihedral.unwrap_or(30.0);
            // A regular tetrahedron has 70.5 degrees, but no space is filled with those alone.
            if !(min_dihedral > 0.0 && min_dihedral <= 60.0) {
                let problem = "is not above 0 and at most 60 degrees";
                return Err(bad(
                    "min-dihedral",
                    min_dihedral,
                    problem,
                    "30 is the default",
                ));
            }
            Slivers::Removed {
                method,
                min_dihedral,
            }
        }
    };
    Ok(Cells::Simplices {
        slivers,
        smooth: settings.smooth,
    })
}

/// Largest share of the cells' size within which nodes may be welded: beyond it, cells lose faces that
/// matter.
const MOST_WELDED: f64 = 0.2;

/// Atoms on Canny's points.
fn canny(said: &Said, voronoi: bool) -> Result<Placement> {
    if voronoi {
        return Err(bad(
            "seeding",
            "canny",
            "puts atoms on features, but Voronoi cells need them alongside",
            "choose tets, or another seeding",
        ));
    }
    let other = "omit it, or choose another seeding";
    said.unused(
        &["distance", "distance-from"],
        "has no effect with seeding canny: the image and its features determine the distance",
        other,
    )?;
    said.unused(
        &["well", "well-distance"],
        "has a distance of its own, but with seeding canny the image and its features determine it",
        "give wells as fixed atoms, or choose another seeding",
    )?;
    said.unused(
        &[
            "beta",
            "kappa",
            "optimizer",
            "evaluator",
            "coarse-to-fine",
            "trace",
        ],
        "applies to a lattice whose energy is minimised, but with seeding canny no atom moves",
        other,
    )?;
    if said.settings.feature != Some(FeatureKind::Paths) {
        let problem = "sets the random numbers, but seeding canny uses none";
        said.unused(&["rng-seed"], problem, other)?;
    }
    no_guide(said)?;
    Ok(Placement::Canny)
}

fn no_guide(said: &Said) -> Result<()> {
    said.unused(
        &["max-atoms"],
        "applies to atoms that are drawn one by one",
        "use it with seeding guide, or choose a larger distance",
    )
}

fn lattice(said: &Said, seeding: Option<SeedingName>, voronoi: bool) -> Result<LatticeJob> {
    let settings = &said.settings;
    if seeding != Some(SeedingName::Guide) {
        no_guide(said)?;
    }
    let start = match seeding {
        None | Some(SeedingName::Fcc | SeedingName::Canny) => Start::Fcc,
        Some(SeedingName::Grown) => Start::Grown,
        Some(SeedingName::Refine) => Start::Refine,
        Some(SeedingName::Guide) => Start::Guide {
            most: settings.max_atoms,
        },
        Some(SeedingName::Projection) => Start::Projection,
    };
    if voronoi && start == Start::Projection {
        return Err(bad(
            "seeding",
            "projection",
            "puts atoms onto features, which the faces of Voronoi cells follow",
            "choose tets, or another seeding",
        ));
    }
    let coarse_passes = settings.coarse_to_fine.unwrap_or(0);
    if coarse_passes > 8 {
        return Err(bad(
            "coarse-to-fine",
            coarse_passes,
            "is more than 8 passes, each twice as smooth as the next",
            "1 or 2 are typical",
        ));
    }
    Ok(LatticeJob {
        apart: apart(settings)?,
        start,
        wells: wells(said)?,
        beta: beta(settings.beta.as_deref())?,
        energy: energy(said, voronoi)?,
        optimizer: settings.optimizer.unwrap_or_default(),
        coarse_passes,
        trace: settings.trace.clone(),
    })
}

fn energy(said: &Said, voronoi: bool) -> Result<LatticeEnergy> {
    if said.settings.evaluator == Some(Evaluator::Sampled) {
        if voronoi {
            return Err(bad(
                "evaluator",
                "sampled",
                "has no mirror images, which atoms alongside features need",
                "use the pairwise evaluator",
            ));
        }
        let problem = "needs the exact energy, but the sampled evaluator is chosen";
        said.unused(&["kappa"], problem, "use the pairwise evaluator")?;
        return Ok(LatticeEnergy::Sampled);
    }
    if voronoi {
        said.unused(
            &["kappa"],
            "applies to the neighbours of atoms in a Delaunay mesh, but the mesh has Voronoi cells",
            "omit it, or choose tets",
        )?;
    }
    let kappa = said.settings.kappa.unwrap_or(1.0);
    if !(0.0..=1.0).contains(&kappa) {
        let remedy = "1 omits Laplacian coordinates, 0.7 is typical with them";
        return Err(bad("kappa", kappa, "is not from 0 to 1", remedy));
    }
    Ok(LatticeEnergy::Pairwise { kappa })
}

fn wells(said: &Said) -> Result<Option<Wells>> {
    let settings = &said.settings;
    let files = settings.well.clone().unwrap_or_default();
    if files.is_empty() {
        let problem = "is given without a well";
        said.unused(&["well-distance"], problem, "add a well, or omit it")?;
        return Ok(None);
    }
    let distance = settings.well_distance;
    if let Some(d) = distance.filter(|d| !(d.is_finite() && *d > 0.0)) {
        let problem = "is not a positive number of samples";
        return Err(bad("well-distance", d, problem, "give one above 0"));
    }
    Ok(Some(Wells { files, distance }))
}

fn apart(settings: &Settings) -> Result<Apart> {
    let text = settings.distance.as_deref().unwrap_or("8");
    let range = text.split_once(':');
    let from = settings.distance_from.as_deref();
    let (min, max) = match range {
        None => (positive(text, text)?, None),
        Some((min, max)) => (positive(min, text)?, Some(positive(max, text)?)),
    };
    if max.is_some_and(|max| min > max) {
        let problem = "has a minimum above its maximum";
        return Err(bad("distance", text, problem, DISTANCE));
    }
    let by = match (max, from) {
        (None, None) => return Ok(Apart::Everywhere(min)),
        (Some(_), Some("features")) => DistanceFrom::Features,
        (Some(_), Some("image")) => DistanceFrom::Image,
        (Some(_), Some("laplacian")) => DistanceFrom::Laplacian,
        (Some(_), Some(file)) if Path::new(file).is_file() => DistanceFrom::File(file.into()),
        (Some(_), Some(other)) => {
            return Err(bad(
                "distance-from",
                other,
                "is not features, image, laplacian or a file",
                "give one of these, or an image of distances in samples",
            ));
        }
        (Some(_), None) => {
            return Err(bad(
                "distance",
                text,
                "gives the range of the distance, but not what it follows",
                "add a distance-from such as features",
            ));
        }
        (None, Some(from)) => {
            return Err(bad(
                "distance-from",
                from,
                &format!("makes the distance vary, but it is {text} everywhere"),
                "give a distance MIN:MAX such as 5:15, or omit it",
            ));
        }
    };
    let max = max.unwrap_or(min);
    Ok(Apart::Varying { min, max, by })
}

const DISTANCE: &str = "give a positive number of samples such as 8, or MIN:MAX such as 5:15";

/// A distance, in a text that holds it.
fn positive(word: &str, text: &str) -> Result<f64> {
    match finite(word) {
        Some(value) if value > 0.0 => Ok(value),
        Some(_) => Err(bad("distance", text, "is not positive", DISTANCE)),
        None => Err(bad("distance", text, "is not a finite number", DISTANCE)),
    }
}

fn finite(word: &str) -> Option<f64> {
    word.trim().parse().ok().filter(|x: &f64| x.is_finite())
}

fn finites(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(finite).collect()
}

fn beta(text: Option<&str>) -> Result<Beta> {
    let Some(text) = text else {
        return Ok(LatticeJob::default().beta);
    };
    match text.parse::<f64>() {
        // At 1 nothing would keep the atoms apart.
        Ok(value) if (0.0..1.0).contains(&value) => Ok(Beta::Constant(value)),
        Ok(_) => Err(bad(
            "beta",
            text,
            "is not at least 0 and below 1",
            "0 ignores the image, 0.5 is the default",
        )),
        Err(_) if Path::new(text).is_file() => Ok(Beta::File(text.into())),
        Err(_) => Err(bad(
            "beta",
            text,
            "is neither a number nor a file",
            "give a number from 0 to 1, or an image of such numbers",
        )),
    }
}

/// A positive scale for each of two or three axes.
fn axis_scales(text: &str) -> Result<Vec<f64>> {
    let remedy = "give samples, physical, or a positive number per axis such as 1,1,0.2";
    let Some(scales) = finites(text) else {
        return Err(bad("metric", text, "is not made of numbers", remedy));
    };
    if !matches!(scales.len(), 2 | 3) {
        let problem = format!("has {} values, not 2 or 3", scales.len());
        return Err(bad("metric", text, &problem, remedy));
    }
    if scales.iter().any(|scale| *scale <= 0.0) {
        let problem = "has a scale that is not positive";
        return Err(bad("metric", text, problem, remedy));
    }
    Ok(scales)
}

fn followed(said: &Said) -> Result<Followed> {
    let settings = &said.settings;
    if let Some(sigma) = settings.sigma.filter(|s| !(s.is_finite() && *s > 0.0)) {
        let problem = "is not a positive number of samples";
        let remedy = "omit it, or give about the features' thickness";
        return Err(bad("sigma", sigma, problem, remedy));
    }
    if let Some(threshold) = settings.threshold.filter(|t| !t.is_finite()) {
        let remedy = "omit it: the automatic threshold is printed";
        return Err(bad(
            "threshold",
            threshold,
            "is not a finite number",
            remedy,
        ));
    }
    let kind = settings.feature.unwrap_or(FeatureKind::Auto);
    let threshold = settings.threshold;
    if kind != FeatureKind::Paths {
        let problem = "applies to an object whose boundary is followed by paths";
        said.unused(
            &["object", "background"],
            problem,
            "follow paths, or omit it",
        )?;
    }
    let weights = weights(settings.feature_weights.as_deref())?;
    if kind != FeatureKind::FaultsAndHorizons {
        let problem = "weighs faults against horizons, but they are not followed together";
        said.unused(&["feature-weights"], problem, "follow both, or omit it")?;
    }
    if matches!(kind, FeatureKind::Labels | FeatureKind::Paths) {
        let problem = format!("applies to the strength of features, but {kind} have none");
        said.unused(
            &["threshold"],
            &problem,
            "omit it, or follow other features",
        )?;
    }
    let strong = |kind| What::Strong { kind, threshold };
    Ok(Followed {
        sigma: settings.sigma,
        what: match kind {
            FeatureKind::Auto => strong(StrongKind::Auto),
            FeatureKind::Ridges => strong(StrongKind::Ridges),
            FeatureKind::Valleys => strong(StrongKind::Valleys),
            FeatureKind::Edges => strong(StrongKind::Edges),
            FeatureKind::Canny => strong(StrongKind::Canny),
            FeatureKind::Horizons => strong(StrongKind::Horizons),
            FeatureKind::Faults => strong(StrongKind::Faults),
            FeatureKind::Potential => strong(StrongKind::Potential),
            FeatureKind::FaultsAndHorizons => What::FaultsAndHorizons { threshold, weights },
            FeatureKind::Labels => What::Labels,
            FeatureKind::Paths => What::Paths {
                object: points("object", settings.object.as_deref())?,
                background: points("background", settings.background.as_deref())?,
            },
        },
    })
}

/// Two numbers in (0, 1].
fn weights(text: Option<&str>) -> Result<[f64; 2]> {
    let Some(text) = text else {
        return Ok([1.0; 2]);
    };
    match finites(text).as_deref() {
        Some(&[f, h]) if [f, h].iter().all(|w| *w > 0.0 && *w <= 1.0) => Ok([f, h]),
        _ => Err(bad(
            "feature-weights",
            text,
            "is not two numbers above 0 and at most 1",
            "give the weights of faults and horizons, such as 1,0.5",
        )),
    }
}

fn points(name: &str, texts: Option<&[String]>) -> Result<Vec<Vec<f64>>> {
    let point = |text: &String| match finites(text) {
        Some(point) if matches!(point.len(), 2 | 3) => Ok(point),
        _ => Err(bad(name, text, "is not a point", "give a point X,Y")),
    };
    texts.unwrap_or_default().iter().map(point).collect()
}

impl From<Job> for Settings {
    /// All that the job says, what is so by default included.
    fn from(job: Job) -> Self {
        let mut settings = Self {
            output: job.outputs.mesh,
            report: job.outputs.report,
            potential_out: job.outputs.potential,
            atoms_from: job.atoms_from,
            metric: Some(match &job.metric {
                LatticeSpace::Samples => "samples".into(),
                LatticeSpace::Physical => "physical".into(),
                LatticeSpace::Scales(scales) => joined(scales),
            }),
            rng_seed: Some(job.seed.0),
            input: job.input,
            ..Self::default()
        };
        settings.say_features(job.features);
        settings.say_cells(&job.cells);
        match job.placement {
            Placement::Canny => settings.seeding = Some(SeedingName::Canny),
            Placement::Lattice(lattice) => settings.say_lattice(lattice),
        }
        settings
    }
}

/// Numbers with commas between them.
fn joined(numbers: &[f64]) -> String {
    let words: Vec<String> = numbers.iter().map(f64::to_string).collect();
    words.join(",")
}

/// A file's name as a text; one that is no UTF-8 came from no text.
fn file_text(path: PathBuf) -> String {
    path.to_string_lossy().into_owned()
}

impl Settings {
    /// What all jobs have by default: those of a lattice and tetrahedra, and those of cells of the
    /// other kind.
    fn of_defaults() -> Self {
        Self {
            weld: Some(0.0),
            feature_weights: Some("1,1".into()),
            ..Job::default().into()
        }
    }

    fn say_features(&mut self, features: Followed) {
        self.feature = Some(features.kind());
        self.sigma = features.sigma;
        self.threshold = features.threshold();
        let texts = |points: Vec<Vec<f64>>| {
            let texts: Vec<String> = points.iter().map(|point| joined(point)).collect();
            (!texts.is_empty()).then_some(texts)
        };
        match features.what {
            What::FaultsAndHorizons { weights, .. } => {
                self.feature_weights = Some(joined(&weights));
            }
            What::Paths { object, background } => {
                self.object = texts(object);
                self.background = texts(background);
            }
            What::Strong { .. } | What::Labels => {}
        }
    }

    fn say_cells(&mut self, cells: &Cells) {
        match *cells {
            Cells::Voronoi { weld } => {
                self.cells = Some(CellsName::Voronoi);
                self.align = Some(AlignName::Alongside);
                self.weld = Some(weld);
            }
            Cells::Simplices { slivers, smooth } => {
                self.cells = Some(CellsName::Tets);
                self.align = Some(AlignName::On);
                self.smooth = smooth;
                match slivers {
                    Slivers::Left => self.slivers = Some(SliversName::None),
                    Slivers::Removed {
                        method,
                        min_dihedral,
                    } => {
                        self.slivers = Some(match method {
                            improve::Method::Joe => SliversName::Joe,
                            improve::Method::Exude => SliversName::Exude,
                        });
                        self.min_dihedral = Some(min_dihedral);
                    }
                }
            }
        }
    }

    fn say_lattice(&mut self, lattice: LatticeJob) {
        match lattice.apart {
            Apart::Everywhere(d) => self.distance = Some(d.to_string()),
            Apart::Varying { min, max, by } => {
                self.distance = Some(format!("{min}:{max}"));
                self.distance_from = Some(match by {
                    DistanceFrom::Features => "features".into(),
                    DistanceFrom::Image => "image".into(),
                    DistanceFrom::Laplacian => "laplacian".into(),
                    DistanceFrom::File(path) => file_text(path),
                });
            }
        }
        self.seeding = Some(match lattice.start {
            Start::Fcc => SeedingName::Fcc,
            Start::Grown => SeedingName::Grown,
            Start::Refine => SeedingName::Refine,
            Start::Guide { .. } => SeedingName::Guide,
            Start::Projection => SeedingName::Projection,
        });
        if let Start::Guide { most } = lattice.start {
            self.max_atoms = most;
        }
        if let Some(wells) = lattice.wells {
            self.well = Some(wells.files);
            self.well_distance = wells.distance;
        }
        self.beta = Some(match lattice.beta {
            Beta::Constant(beta) => beta.to_string(),
            Beta::File(path) => file_text(path),
        });
        self.evaluator = Some(lattice.energy.evaluator());
        if let LatticeEnergy::Pairwise { kappa } = lattice.energy {
            self.kappa = Some(kappa);
        }
        self.optimizer = Some(lattice.optimizer);
        self.coarse_to_fine = Some(lattice.coarse_passes);
        self.trace = lattice.trace;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(text: &str) -> Result<Job> {
        Job::try_from(toml::from_str::<Settings>(text).unwrap())
    }

    #[test]
    fn nothing_said_is_the_default() {
        assert_eq!(job("").unwrap(), Job::default());
    }

    #[test]
    fn a_job_survives_toml_and_json() {
        for text in [
            "",
            "distance = \"4:9.5\"\ndistance-from = \"laplacian\"\nthreshold = 0.3\nkappa = 0.7",
            "cells = \"voronoi\"\nweld = 0.01\nwell = [\"a.csv\", \"b.csv\"]\nwell-distance = 2",
            "seeding = \"canny\"\nsmooth = \"odt\"\nfeature = \"labels\"\nslivers = \"none\"",
            "feature = \"paths\"\nobject = [\"1,2\", \"-3,4.5\"]\nevaluator = \"sampled\"",
            "feature = \"faults+horizons\"\nfeature-weights = \"1,0.5\"\nmetric = \"1,1,0.2\"",
            "seeding = \"guide\"\nmax-atoms = 50\n[input]\ninline-byte = 9",
        ] {
            let job = job(text).unwrap();
            let written = toml::to_string(&job).unwrap();
            let again: Job = toml::from_str(&written).unwrap();
            assert_eq!(again, job, "{written}");
            let json = serde_json::to_string(&job).unwrap();
            assert_eq!(serde_json::from_str::<Job>(&json).unwrap(), job, "{json}");
        }
    }

    #[test]
    fn what_nothing_would_come_of_is_refused_by_name() {
        for (text, name) in [
            ("seeding = \"canny\"\nbeta = 0.2", "beta"),
            ("seeding = \"canny\"\nkappa = 0.7", "kappa"),
            ("seeding = \"canny\"\noptimizer = \"genetic\"", "optimizer"),
            ("seeding = \"canny\"\nevaluator = \"sampled\"", "evaluator"),
            ("seeding = \"canny\"\ncoarse-to-fine = 1", "coarse-to-fine"),
            ("seeding = \"canny\"\ntrace = \"t.pvd\"", "trace"),
            ("seeding = \"canny\"\ndistance = 5", "distance"),
            ("seeding = \"canny\"\nrng-seed = 5", "rng-seed"),
            ("feature = \"labels\"\nthreshold = 0.5", "threshold"),
            ("feature = \"paths\"\nthreshold = 0.5", "threshold"),
            ("object = [\"1,2\"]", "object"),
            ("background = [\"1,2\"]", "background"),
            ("feature-weights = \"1,0.5\"", "feature-weights"),
            ("slivers = \"none\"\nmin-dihedral = 20", "min-dihedral"),
            ("cells = \"voronoi\"\nmin-dihedral = 20", "min-dihedral"),
            ("cells = \"voronoi\"\nkappa = 0.7", "kappa"),
            ("weld = 0.01", "weld"),
            ("max-atoms = 9", "max-atoms"),
            ("well-distance = 3", "well-distance"),
            ("evaluator = \"sampled\"\nkappa = 0.7", "kappa"),
        ] {
            let error = job(text).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{name} ")), "{text}: {error}");
            assert!(error.contains(": ") && error.contains("; "), "{error}");
        }
        // What is so by default is no offence.
        assert!(job("seeding = \"canny\"\nbeta = 0.5\ndistance = 8").is_ok());
    }

    #[test]
    fn a_record_of_version_0_1_0_is_understood() {
        let record = "distance = \"5\"\nfeature = \"ridges\"\ncells = \"voronoi\"\nbeta = \"0.5\"\n\
                      seeding = \"fcc\"\npotential = \"pairwise\"\nkappa = 1.0\noptimizer = \"lbfgs\"\n\
                      coarse-to-fine = 0\nmin-dihedral = 30.0\nslivers = \"joe\"\nweld = 0.0\n\
                      metric = \"samples\"\nrng-seed = 1\n\n[input]\n";
        assert_eq!(job(record).unwrap().cells, Cells::Voronoi { weld: 0.0 });
    }
}
