//! Advice on meshes of labels: options are tried on a crop of the image around the worst place, and one is
//! recommended that makes the figure of the issue better there and no other figure of the certificate
//! worse.
//!
//! 1. The crop is the largest whose meshes have together at most a fifth of the nodes of the mesh
//!    ([`MAX_TRIAL_SHARE`]), so that trials cost at most a fifth of the job, or [`MIN_TRIAL_NODES`], which take a few
//!    seconds.
//! 2. The crop is meshed with the options of the job, then with each candidate, the most promising first,
//!    until one helps.

use toml::Value;

use super::Params;
use super::mesh_verb::{MeshResult, Outcome, RunOptions, run_from};
use super::spec::{MeshSpec, NominalDistance};
use crate::feature::FeatureKind;
use crate::feature::components::Components;
use crate::geometry::grid_index::{index_at, offset_of};
use crate::image::{ExactLabels, Image, ImageSource, LabelTable};
use crate::lattice::optimise::StopReason;
use crate::progress::{Progress, Stage};
use crate::report::certificate::{Certificate, PartClass, PartIssue, PartIssueKind};
use crate::report::{Advice, Clock, Trial};

/// Largest number of nodes of all trials, as a fraction of those of the mesh.
const MAX_TRIAL_SHARE: f64 = 0.2;

/// Number of nodes that all trials may have in any case.
const MIN_TRIAL_NODES: f64 = 15_000.0;

/// Half the length of the sides of crops, in samples, below which few issues occur in the crop as well. Smaller
/// crops are used only if no larger one is possible.
const MIN_HALF_SIDE: usize = 9;

/// Half the length of the sides of crops that are considered, in samples, the largest first.
const HALF_SIDES: [usize; 8] = [32, 24, 18, 14, 11, 9, 7, 6];

/// Factor by which a candidate makes distances smaller: twice as many cells.
const FINER_DISTANCE: f64 = 0.8;
/// Factor by which the last candidate makes distances smaller: eight times as many cells.
const FINEST_DISTANCE: f64 = 0.5;

/// Smallest distance of the range that replaces a constant distance, as a share of that distance.
const RANGE_SHARE: f64 = 0.4;
/// Approximate number of cells with this range, as a multiple of those with the constant distance.
const RANGE_COST: f64 = 4.0;

/// Least distance between atoms that is tried, in samples.
const MIN_DISTANCE: f64 = 0.7;

/// Standard deviations of the smoothing of labels that are tried, in samples.
const SIGMA: [f64; 2] = [0.7, 0.5];

/// Lengths over which the boundaries of labels are smoothed that are tried, in samples.
const LABEL_SMOOTHING: [f64; 2] = [0.5, 1.0];

/// An option that may help.
struct Candidate {
    option: String,
    /// Number of cells relative to that of the options in use.
    cost: f64,
    change: Change,
}

/// The change that a candidate makes.
enum Change {
    /// Other options.
    Spec(Box<MeshSpec>),
    /// Parts with less than this many samples become part of what surrounds them.
    MinPart(usize),
}

/// Largest number of places at which the issue is looked for.
const MAX_PLACES: usize = 3;

/// Tries options for the worst issue of a mesh, if it is one of the certificate, and adds the advice to the
/// report. The time that this takes counts as measuring.
pub(super) fn advise(
    source: ImageSource<'_, 3>,
    params: &Params<3>,
    outcome: &mut Outcome<3>,
    progress: &mut dyn Progress,
) {
    let Some(issue) = outcome.report.worst_part_issue().cloned() else {
        return;
    };
    let MeshResult::Simplices(annotated) = &outcome.mesh else {
        return;
    };
    let Ok(image) = source.to_image() else {
        return;
    };
    let image = &*image;
    if !can_be_tried(image, params) || outcome.stop == StopReason::Interrupted {
        return;
    }
    let step = outcome.step;
    let to_samples = |x: &[f64; 3]| std::array::from_fn(|k| x[k] / step[k]);
    let nodes: Vec<[f64; 3]> = annotated.mesh.nodes.iter().map(to_samples).collect();
    let mut places = vec![issue.at.clone()];
    if let (PartIssueKind::Pinch, Some(certificate)) = (issue.kind, &outcome.report.certificate) {
        let pinches = &certificate.pinches;
        let others = (1..MAX_PLACES).map(|k| pinches[k * pinches.len() / MAX_PLACES].at.clone());
        places.extend(others);
        places.dedup();
    }
    let mut clock = Clock::new();
    clock.begin(Stage::Measuring);
    let advice = tried_advice(image, params, &nodes, &issue, places, progress);
    clock.end();
    outcome.report.advice = advice;
    for cost in clock.costs() {
        let mut stages = outcome.report.stages.iter_mut();
        if let Some(known) = stages.find(|known| known.stage == cost.stage) {
            known.seconds += cost.seconds;
            known.cpu_seconds += cost.cpu_seconds;
            known.peak_mb = known.peak_mb.max(cost.peak_mb);
        }
    }
}

/// Returns `true` if the options of a job make sense for a crop of its image.
fn can_be_tried(image: &Image<3>, params: &Params<3>) -> bool {
    let spec = &params.spec;
    let is_complete = image.missing.is_empty() && image.dead.is_empty();
    is_complete
        && params.distance_map.is_none()
        && spec.surface.is_empty()
        && spec.well.is_empty()
        && spec.atoms_from.is_none()
        && spec.max_atoms.is_none()
        && spec.trace.is_none()
        && spec.velocity.is_none()
}

/// Looks for the issue at some places, the first in which it occurs in a crop as well, and tries options
/// there. Returns `None` if the job is stopped.
fn tried_advice(
    image: &Image<3>,
    params: &Params<3>,
    nodes: &[[f64; 3]],
    issue: &PartIssue,
    places: Vec<Vec<f64>>,
    progress: &mut dyn Progress,
) -> Option<Advice> {
    let candidates = candidates(params, issue);
    let mut advice = Advice {
        issue: issue.message.clone(),
        option: None,
        at: issue.at.clone(),
        crop: Vec::new(),
        trials: Vec::new(),
    };
    let mut left = MAX_TRIAL_SHARE.max(MIN_TRIAL_NODES / nodes.len().max(1) as f64);
    for (number, at) in places.iter().enumerate() {
        let at: [f64; 3] = at.as_slice().try_into().ok()?;
        let centre = image.geometry.to_index(at)?;
        let boxes = HALF_SIDES.map(|half| crop_box(image.dims(), centre, half));
        let shares = boxes.map(|corners| share_in_box(nodes, corners));
        // The issue may first show at the last place.
        let first_cost = (places.len() - number) as f64;
        let cost_of = |count: usize| -> f64 {
            let costs = candidates
                .iter()
                .take(count)
                .map(|candidate| candidate.cost);
            first_cost + costs.sum::<f64>()
        };
        // As many candidates as possible, in the largest crop.
        let chosen = |least_half: usize| {
            (1..=candidates.len()).rev().find_map(|count| {
                let place = (shares.iter().zip(HALF_SIDES)).position(|(share, half)| {
                    half >= least_half && share * cost_of(count) <= left
                })?;
                Some((place, count))
            })
        };
        let Some((place, count)) = chosen(MIN_HALF_SIDE).or_else(|| chosen(0)) else {
            break;
        };
        left -= shares[place];
        let crop = cropped(image, boxes[place]);
        (advice.at, advice.crop) = (at.to_vec(), crop.dims().to_vec());
        let Some(before) = certificate_of(&crop, params, &params.spec, progress) else {
            continue;
        };
        if !progress.keep_going() {
            return None;
        }
        if !before.figure(issue.kind).is_issue() {
            continue;
        }
        for candidate in candidates.iter().take(count) {
            let trial = tried(candidate, &crop, params, &before, issue.kind, progress);
            let helps = trial.helps;
            advice.trials.push(trial);
            if !progress.keep_going() {
                return None;
            }
            if helps {
                advice.option = Some(candidate.option.clone());
                break;
            }
        }
        break;
    }
    Some(advice)
}

/// Tries a candidate on a crop, whose mesh without it has the certificate `before`.
fn tried(
    candidate: &Candidate,
    crop: &Image<3>,
    params: &Params<3>,
    before: &Certificate,
    kind: PartIssueKind,
    progress: &mut dyn Progress,
) -> Trial {
    let after = match &candidate.change {
        Change::Spec(spec) => certificate_of(crop, params, spec, progress),
        Change::MinPart(size) => without_specks(crop, *size)
            .and_then(|crop| certificate_of(&crop, params, &params.spec, progress)),
    };
    let figure_before = before.figure(kind);
    let figure = after.as_ref().map(|after| after.figure(kind));
    let worse = after
        .as_ref()
        .and_then(|after| after.worse_figure(before, kind));
    Trial {
        option: candidate.option.clone(),
        figure: figure_before.name.to_string(),
        before: figure_before.value,
        after: figure.map(|figure| figure.value),
        worse: worse.map(str::to_owned),
        helps: worse.is_none()
            && figure.is_some_and(|figure| figure.is_better_than(&figure_before)),
    }
}

/// Returns the certificate of a mesh of a crop; `None` if there is no such mesh.
fn certificate_of(
    crop: &Image<3>,
    params: &Params<3>,
    spec: &MeshSpec,
    progress: &mut dyn Progress,
) -> Option<Certificate> {
    let table = LabelTable::from_image(crop)?;
    let mut params = params.clone();
    params.spec = MeshSpec {
        feature: FeatureKind::Labels,
        pad: None,
        topography: None,
        label: (spec.label.iter())
            .filter(|options| table.values.contains(&options.label))
            .cloned()
            .collect(),
        distance: distance_in(spec.distance, crop.dims(), spec.metric.step(&crop.geometry)),
        ..spec.clone()
    };
    let options = RunOptions {
        is_trial: true,
        ..RunOptions::default()
    };
    let mut quiet = Quiet { progress };
    let outcome = run_from(crop.into(), &params, options, &mut quiet).ok()?;
    outcome.report.certificate
}

/// Progress that shows nothing, and stops when the job is stopped.
struct Quiet<'a> {
    progress: &'a mut dyn Progress,
}

impl Progress for Quiet<'_> {
    fn keep_going(&mut self) -> bool {
        self.progress.keep_going()
    }
}

/// Returns a distance that fits into a crop.
fn distance_in<const D: usize>(
    distance: NominalDistance,
    dims: [usize; D],
    step: [f64; D],
) -> NominalDistance {
    let lengths = (0..D).map(|k| (dims[k] as f64 - 1.0) * step[k]);
    let largest = 0.5 * lengths.fold(f64::INFINITY, f64::min);
    match distance {
        NominalDistance::Constant(d) => NominalDistance::Constant(d.min(largest)),
        NominalDistance::Range { min, max } => NominalDistance::Range {
            min: min.min(largest),
            max: max.min(largest),
        },
        // Jobs run with distances in samples.
        NominalDistance::InUnit { .. } => distance,
    }
}

/// Returns the options that may help with an issue, the most promising first. None of them is in use.
fn candidates(params: &Params<3>, issue: &PartIssue) -> Vec<Candidate> {
    let spec = &params.spec;
    if issue.kind == PartIssueKind::Lost && issue.class == Some(PartClass::Speck) {
        // Finer cells follow specks that are rarely wanted.
        let size = issue.samples + 1;
        return vec![Candidate {
            option: format!("--min-part {size}"),
            cost: 1.0,
            change: Change::MinPart(size),
        }];
    }
    let scaled = |d: f64, factor: f64| (100.0 * factor * d).round() / 100.0;
    let [min, max] = spec.distance.limits();
    let with_factor = |factor: f64| {
        let (min, max) = (scaled(min, factor), scaled(max, factor));
        let distance = match spec.distance {
            NominalDistance::Constant(_) => NominalDistance::Constant(min),
            NominalDistance::Range { .. } => NominalDistance::Range { min, max },
            NominalDistance::InUnit { unit, .. } => NominalDistance::InUnit { min, max, unit },
        };
        let option = ("distance", Value::String(distance.to_string()));
        (min >= MIN_DISTANCE).then_some((option, factor.powi(-3)))
    };
    let finer = with_factor(FINER_DISTANCE);
    let range = match spec.distance {
        NominalDistance::Constant(max) if max > MIN_DISTANCE => {
            let min = scaled(max, RANGE_SHARE).max(MIN_DISTANCE);
            let range = NominalDistance::Range { min, max };
            Some((("distance", Value::String(range.to_string())), RANGE_COST))
        }
        _ => None,
    };
    let smoothing = |name: &'static str, size: f64| (name, Value::Float(size));
    let [weak, strong] = LABEL_SMOOTHING.map(|size| smoothing("label-smoothing", size));
    let alone = |(option, cost)| (vec![option], cost);
    let mut choices: Vec<(Vec<(&str, Value)>, f64)> = range.into_iter().map(alone).collect();
    if with_options(spec, std::slice::from_ref(&strong)).is_some() {
        choices.extend(finer.clone().map(alone));
        choices.push((vec![strong], 1.0));
        choices.extend(finer.map(|(option, cost)| (vec![weak, option], cost)));
    } else {
        let [weak, weaker] = SIGMA.map(|size| smoothing("sigma", size));
        choices.extend((finer.clone()).map(|(option, cost)| (vec![weaker, option], cost)));
        choices.push((vec![weak], 1.0));
        choices.extend(finer.map(alone));
    }
    choices.extend(with_factor(FINEST_DISTANCE).map(alone));
    let candidate = |(options, cost): (Vec<(&str, Value)>, f64)| {
        let changed = with_options(spec, &options)?;
        let text = |(name, value): &(&str, Value)| match value {
            Value::String(text) => format!("--{name} {text}"),
            value => format!("--{name} {value}"),
        };
        Some(Candidate {
            option: options.iter().map(text).collect::<Vec<_>>().join(" "),
            cost,
            change: Change::Spec(Box::new(changed)),
        })
    };
    choices.into_iter().filter_map(candidate).collect()
}

/// Returns options with other values of some of them, which have the names of the command line; `None` if
/// there are no such options, if they have these values already, or if they do not fit the others.
fn with_options(spec: &MeshSpec, options: &[(&str, Value)]) -> Option<MeshSpec> {
    let mut table = spec.to_table().ok()?;
    for (name, value) in options {
        if table.get(*name) == Some(value) {
            return None;
        }
        table.insert((*name).to_string(), value.clone());
    }
    table.insert(
        "feature".into(),
        Value::String(FeatureKind::Labels.to_string()),
    );
    let changed: MeshSpec = table.try_into().ok()?;
    changed.validate().ok()?;
    Some(changed)
}

/// Returns the first and the last sample of a crop whose sides are twice `half` long, where the image is as
/// long.
fn crop_box<const D: usize>(dims: [usize; D], centre: [f64; D], half: usize) -> [[usize; D]; 2] {
    let low: [usize; D] = std::array::from_fn(|k| {
        let low = (centre[k].round().max(0.0) as usize).saturating_sub(half);
        low.min(dims[k].saturating_sub(2 * half + 1))
    });
    [
        low,
        std::array::from_fn(|k| (low[k] + 2 * half).min(dims[k] - 1)),
    ]
}

/// Returns the fraction of nodes in a box.
fn share_in_box<const D: usize>(nodes: &[[f64; D]], [low, high]: [[usize; D]; 2]) -> f64 {
    let is_inside =
        |x: &&[f64; D]| (0..D).all(|k| (low[k] as f64..=high[k] as f64).contains(&x[k]));
    nodes.iter().filter(is_inside).count() as f64 / nodes.len().max(1) as f64
}

/// Returns a part of an image, given its first and its last sample.
fn cropped<const D: usize>(image: &Image<D>, [low, high]: [[usize; D]; 2]) -> Image<D> {
    let dims: [usize; D] = std::array::from_fn(|k| high[k] - low[k] + 1);
    let source = |number: usize| {
        let at = index_at(dims, number);
        offset_of(image.dims(), std::array::from_fn(|k| low[k] + at[k]))
    };
    let sources: Vec<usize> = (0..dims.iter().product()).map(source).collect();
    let samples = sources.iter().map(|&i| image.as_slice()[i]).collect();
    let mut geometry = image.geometry.clone();
    geometry.origin = image.geometry.to_physical(low.map(|i| i as f64));
    let mut crop = Image::new(dims, samples, geometry);
    crop.labels = image.labels.as_ref().map(|exact| {
        let values = sources
            .iter()
            .map(|&i| exact.values[exact.indices[i] as usize]);
        ExactLabels::from_integers(values)
    });
    crop
}

/// Returns an image in which parts with less than `size` samples belong to what surrounds them.
fn without_specks<const D: usize>(image: &Image<D>, size: usize) -> Option<Image<D>> {
    let mut table = LabelTable::from_image(image)?;
    let components = Components::from_labels(image.dims(), &table.indices);
    components.absorb(&mut table.indices, |part| part.sample_count >= size);
    let values = table.indices.iter().map(|&n| table.values[n as usize]);
    let samples = values.clone().map(|value| value.as_sample()).collect();
    let mut merged = Image::new(image.dims(), samples, image.geometry.clone());
    merged.labels = image.labels.as_ref().map(|exact| {
        let whole = |&n: &u32| exact.values[n as usize];
        ExactLabels::from_integers(table.indices.iter().map(whole))
    });
    Some(merged)
}
