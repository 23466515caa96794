//! How features are asked for, which several verbs do.

use super::options::with_option_name;
use crate::feature;
use crate::feature::PathSeeds;
use crate::job::asked::{Job, What};
use crate::job::settings::Settings;
use crate::{Error, Result, error::cause};

/// The job that a verb's settings make, of which it needs the features.
///
/// # Errors
/// [`Error::Job`] that names the option that is impossible.
pub fn feature_job(settings: Settings) -> Result<Job> {
    Job::try_from(settings).map_err(with_option_name)
}

/// How features are sought for atoms at least `d_min` apart in a lattice space where samples are `step`
/// apart.
///
/// # Errors
/// [`Error::Job`] for points that are not of `D` coordinates.
pub fn detection<const D: usize>(
    job: &Job,
    d_min: f64,
    step: [f64; D],
) -> Result<feature::DetectionOptions<D>> {
    Ok(feature::DetectionOptions {
        kind: job.features.kind(),
        scale: job.features.sigma,
        threshold: job.features.threshold(),
        weights: job.features.weights(),
        seeds: path_seeds(job)?,
        labels: job.features.labels().to_vec(),
        keep_nulls: job.input.keeps_nulls(),
        d_min,
        step,
        ..feature::DetectionOptions::default()
    })
}

/// Points near which paths begin and end.
///
/// # Errors
/// [`Error::Job`] for what is no point of `D` coordinates.
pub fn path_seeds<const D: usize>(job: &Job) -> Result<PathSeeds<D>> {
    let seed = job.seed.0;
    let What::Paths { object, background } = &job.features.what else {
        return Ok(PathSeeds {
            seed,
            ..PathSeeds::default()
        });
    };
    let points = |name: &str, points: &[Vec<f64>]| {
        let point = |point: &Vec<f64>| {
            <[f64; D]>::try_from(point.as_slice()).map_err(|_| {
                let text: Vec<String> = point.iter().map(f64::to_string).collect();
                Error::Job(cause(
                    format!("--{name} {}", text.join(",")),
                    format!("has {} values, not {D}", point.len()),
                    if D == 2 {
                        "give a point X,Y"
                    } else {
                        "give a point X,Y,Z"
                    },
                ))
            })
        };
        points.iter().map(point).collect::<Result<Vec<_>>>()
    };
    Ok(PathSeeds {
        object: points("object", object)?,
        background: points("background", background)?,
        seed,
        ..PathSeeds::default()
    })
}
