//! From [`Settings`] to a [`Job`] and back.
//!
//! A setting that the job has no place for is refused, with the reason, unless it says what is so by
//! default. Errors begin with the setting's name.
//!
//! - `lattice`: how atoms are placed
//! - `features`: what is followed
//! - `back`: from a job to settings

mod back;
mod features;
mod lattice;

use super::asked::{
    Cells, Job, LatticeSpace, Outputs, PlacementJob, RngSeed, Slivers, VelocityFrom,
};
use super::settings::{AlignName, CellsName, SeedingName, Settings, SliversName};
use crate::error::cause;
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
    /// [`Error::Job`] that begins with the name of the setting that is impossible, or that nothing would
    /// come of.
    fn try_from(settings: Settings) -> Result<Self> {
        let said = Said::new(settings)?;
        let voronoi = voronoi(&said)?;
        let cells = cells(&said, voronoi)?;
        let placement = match said.settings.seeding {
            Some(SeedingName::Canny) => lattice::canny(&said, voronoi)?,
            seeding => PlacementJob::Lattice(lattice::lattice(&said, seeding, voronoi)?),
        };
        let features = features::followed(&said)?;
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
                Some("shape") => LatticeSpace::Shape,
                Some(scales) => LatticeSpace::Scales(axis_scales(scales)?),
            },
            velocity: settings.velocity.map(VelocityFrom::from),
            seed: settings.rng_seed.map_or(RngSeed::default(), RngSeed),
            outputs: Outputs {
                mesh: settings.output,
                report: settings.report,
                potential: settings.potential_out,
                lines: settings.lines,
                page: settings.page,
                surfaces: settings.surfaces,
                checkpoint: settings.checkpoint,
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
        let of_others = ["slivers", "min-dihedral", "smooth", "lines"];
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
        Some(SliversName::Exude) => Some(improve::SliverMethod::Exude),
        Some(SliversName::Joe) | None => Some(improve::SliverMethod::Joe),
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

/// A positive scale for each of two or three axes.
fn axis_scales(text: &str) -> Result<Vec<f64>> {
    let remedy = "give samples, physical, shape, or a positive number per axis such as 1,1,0.2";
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

fn finite(word: &str) -> Option<f64> {
    word.trim().parse().ok().filter(|x: &f64| x.is_finite())
}

fn finites(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(finite).collect()
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
            "velocity = 2400.0",
            "velocity = \"velocities.sgy\"",
            "label = [\"3:distance=4,name=fault\", \"5:into=3\"]",
            "rounds = 5\noptimizer = \"genetic\"",
            "velocity = 2400.0\nmetric = \"samples\"",
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
            ("seeding = \"canny\"\nrounds = 2", "rounds"),
            ("rounds = 0", "rounds"),
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
            ("cells = \"voronoi\"\nlines = \"l.vtp\"", "lines"),
            ("label = [\"3:distance=0\"]", "label"),
            ("seeding = \"canny\"\nlabel = [\"3:distance=2\"]", "label"),
            ("label = [\"3:name=a\", \"3:distance=2\"]", "label"),
            ("label = [\"3:into=4\", \"4:into=5\"]", "label"),
            ("feature = \"edges\"\nlabel = [\"3:distance=2\"]", "label"),
            ("max-atoms = 9", "max-atoms"),
            ("well-distance = 3", "well-distance"),
            ("evaluator = \"sampled\"\nkappa = 0.7", "kappa"),
        ] {
            let error = job(text).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{name} ")), "{text}: {error}");
            assert!(error.contains(": ") && error.contains("; "), "{error}");
        }
        // What is so by default is no offence.
        assert!(job("seeding = \"canny\"\nbeta = 0.5\ndistance = \"2.7:8\"").is_ok());
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
