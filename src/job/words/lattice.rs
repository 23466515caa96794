//! Settings of how atoms are placed.

use std::path::Path;

use super::{Said, bad, finite};
use crate::Result;
use crate::feature::FeatureKind;
use crate::job::Evaluator;
use crate::job::asked::{
    Apart, BetaFrom, DistanceFrom, LatticeEnergy, LatticeJob, PlacementJob, Start, Wells,
};
use crate::job::params::DEFAULT_DISTANCES;
use crate::job::settings::{SeedingName, Settings};

/// Atoms on Canny's points.
pub(super) fn canny(said: &Said, voronoi: bool) -> Result<PlacementJob> {
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
            "rounds",
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
    Ok(PlacementJob::Canny)
}

fn no_guide(said: &Said) -> Result<()> {
    said.unused(
        &["max-atoms"],
        "applies to atoms that are drawn one by one",
        "use it with seeding guide, or choose a larger distance",
    )
}

/// Atoms on a lattice that moves.
pub(super) fn lattice(
    said: &Said,
    seeding: Option<SeedingName>,
    voronoi: bool,
) -> Result<LatticeJob> {
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
    if settings.rounds == Some(0) {
        let problem = "would not move any atom";
        return Err(bad("rounds", 0, problem, "give 1 or more, or omit it"));
    }
    Ok(LatticeJob {
        apart: apart(settings)?,
        start,
        wells: wells(said)?,
        beta: beta(settings.beta.as_deref())?,
        energy: energy(said, voronoi)?,
        optimizer: settings.optimizer.unwrap_or_default(),
        rounds: settings.rounds,
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
    let [least, most] = DEFAULT_DISTANCES;
    let by_default = format!("{least}:{most}");
    let text = settings.distance.as_deref().unwrap_or(&by_default);
    let from = settings.distance_from.as_deref();
    let range = text.split_once(':');
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
        (Some(_), None | Some("gaps")) => DistanceFrom::Gaps,
        (Some(_), Some("features")) => DistanceFrom::Features,
        (Some(_), Some("image")) => DistanceFrom::Image,
        (Some(_), Some("laplacian")) => DistanceFrom::Laplacian,
        (Some(_), Some(file)) if Path::new(file).is_file() => DistanceFrom::File(file.into()),
        (Some(_), Some(other)) => {
            return Err(bad(
                "distance-from",
                other,
                "is not gaps, features, image, laplacian or a file",
                "give one of these, or an image of distances in samples",
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

fn beta(text: Option<&str>) -> Result<BetaFrom> {
    let Some(text) = text else {
        return Ok(LatticeJob::default().beta);
    };
    match text.parse::<f64>() {
        // At 1 nothing would keep the atoms apart.
        Ok(value) if (0.0..1.0).contains(&value) => Ok(BetaFrom::Constant(value)),
        Ok(_) => Err(bad(
            "beta",
            text,
            "is not at least 0 and below 1",
            "0 ignores the image, 0.5 is the default",
        )),
        Err(_) if Path::new(text).is_file() => Ok(BetaFrom::File(text.into())),
        Err(_) => Err(bad(
            "beta",
            text,
            "is neither a number nor a file",
            "give a number from 0 to 1, or an image of such numbers",
        )),
    }
}
