//! Summarises a report in three lines: the validity of the mesh, its features, and its use.

use serde::Serialize;

use super::regions;
use super::table::group_digits;
use super::{Fidelity, Quality, Report, Voronoi};
use crate::feature::{FeatureKind, KindOutcome, MIN_FAULT_DIP, ThresholdMeaning};

/// Minimum fraction of the features that have faces, and of the faces that are on features. Less is
/// an issue.
const MIN_FEATURE_SHARE: f64 = 0.9;

/// Maximum fraction of the features of one kind that the mesh may drop. More is an issue.
const MAX_DROPPED_SHARE: f64 = 0.1;

/// Minimum ratio of the typical strength of features to the noise. Weaker features may be noise.
const MIN_SIGNAL_TO_NOISE: f32 = 2.5;

/// Maximum ratio of strength to noise that is shown as a number.
const MAX_SHOWN_RATIO: f32 = 100.0;

/// Maximum fraction of faults that dip as gently as layers. More is an issue.
const MAX_GENTLE_FAULT_SHARE: f64 = 0.25;

/// Default minimum distance of angles from 0 and 180 degrees. Closer angles are an issue, unless a
/// smaller target was given.
const DEFAULT_MIN_ANGLE: f64 = 20.0;

/// Maximum fraction of faces below the first of
/// [`TINY_FACE_RATIOS`](super::cells::TINY_FACE_RATIOS). More is an issue.
const MAX_TINY_FACE_SHARE: f64 = 0.01;

/// Minimum number of samples of a lost part of a label that is an issue, unless the label is lost
/// completely.
const FRAGMENT_SAMPLES: usize = 8;

/// Minimum number of samples of a region whose volume is checked.
const MIN_MEASURED_SAMPLES: usize = 50;

/// Maximum error of the volume of a region, in percent. More is an issue.
const MAX_VOLUME_ERROR_PERCENT: f64 = 2.0;

/// Maximum area, in square samples, of contacts between labels that do not touch in the image. More
/// is an issue.
const MAX_CONTACT_AREA: f64 = 10.0;

/// Maximum deviation of interfaces from the places where labels change, in samples. Interfaces that
/// deviate more have spikes.
const MAX_INTERFACE_DEVIATION: f64 = 1.5;

/// Minimum distance between atoms that is suggested, in samples. A smaller one adds no detail of
/// the image.
const MIN_ATOM_DISTANCE: f64 = 1.0;

/// Grade of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Valid, well shaped, with the features.
    Good,
    /// Valid, with an issue.
    Fair,
    /// Invalid, and useless for simulators.
    Bad,
}

/// Summary of a report for new users.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Grade of the mesh.
    pub grade: Grade,
    /// Validity and angles.
    pub mesh: String,
    /// Completeness and credibility of the features, and the state of regions.
    pub features: String,
    /// Suitable use.
    pub fit_for: String,
    /// Worst issue.
    pub issue: Option<String>,
    /// Effect of the change that would help, in words.
    pub suggestion: Option<String>,
    /// Option to type for that change, if there is one.
    pub option: Option<String>,
}

/// Issue of a mesh, and the change that helps.
struct Issue {
    message: String,
    option: Option<String>,
    suggestion: &'static str,
}

impl Verdict {
    /// Returns the verdict on a report, or `None` if the report has no check of a mesh.
    pub fn from_report(report: &Report) -> Option<Self> {
        let check = report.box_check.as_ref();
        let check = check.or(report.voronoi.as_ref().map(|v| &v.check))?;
        let issue = match check.problems.first() {
            Some(problem) => Some(Issue {
                message: problem.clone(),
                option: report.job_options().map(|options| {
                    let seed = options["rng-seed"].as_u64().unwrap_or(1);
                    format!("--rng-seed {}", seed + 1)
                }),
                suggestion: "meshes again with other random numbers, which may avoid it",
            }),
            None => report.worst_issue(),
        };
        let grade = match &issue {
            _ if !check.passed() => Grade::Bad,
            Some(_) => Grade::Fair,
            None => Grade::Good,
        };
        let simulation = match report.voronoi {
            Some(_) => "flow simulation with finite volumes",
            None => "simulation with finite elements or finite volumes",
        };
        let fit_for = match grade {
            Grade::Good => simulation,
            Grade::Fair => "viewing, and for simulation if this issue does not matter",
            Grade::Bad => "nothing but finding the cause",
        };
        let mut mesh = vec![String::from(if check.passed() {
            "valid"
        } else {
            "INVALID"
        })];
        mesh.extend(report.angle_summary());
        let issue = issue.map(|issue| Issue {
            option: issue.option.filter(|option| report.is_new_option(option)),
            ..issue
        });
        let (issue, suggestion, option) = match issue {
            Some(issue) => (
                Some(issue.message),
                Some(issue.suggestion.to_string()),
                issue.option,
            ),
            None => (None, None, None),
        };
        Some(Self {
            grade,
            mesh: mesh.join("; "),
            features: report.feature_lines().join("; "),
            fit_for: fit_for.into(),
            issue,
            suggestion,
            option,
        })
    }

    /// Returns the three lines, each with its heading.
    pub(super) fn lines(&self) -> [(&'static str, String); 3] {
        let word = match self.grade {
            Grade::Good => "good",
            Grade::Fair => "fair",
            Grade::Bad => "bad",
        };
        let mut text = format!("{word}: fit for {}", self.fit_for);
        if let Some(issue) = &self.issue {
            text = format!("{word}: {issue}; fit for {}", self.fit_for);
        }
        text += &match (&self.option, &self.suggestion) {
            (Some(option), Some(why)) => format!(". Try {option}: {why}"),
            (None, Some(why)) => format!(". What helps: {why}"),
            _ => String::new(),
        };
        [
            ("mesh", self.mesh.clone()),
            ("features", self.features.clone()),
            ("use", text),
        ]
    }
}

/// Returns the smallest and the largest angle.
fn angle_range(quality: &Quality) -> [f64; 2] {
    [quality.smallest_angle.worst, quality.largest_angle.worst]
}

/// Returns a fraction as text in percent.
fn percent(share: f64) -> String {
    match 100.0 * share {
        p if p < 1.0 => format!("{p:.2}"),
        p => format!("{p:.0}"),
    }
}

/// Number of the format of reports in JSON; it grows when keys are renamed.
const JSON_FORMAT: u32 = 2;

impl Report {
    /// Returns the report as JSON, with its format number and the [`Verdict`] first.
    pub fn to_json(&self) -> serde_json::Value {
        let mut json = serde_json::Map::new();
        json.insert("format".into(), JSON_FORMAT.into());
        let verdict = serde_json::to_value(Verdict::from_report(self));
        json.insert("verdict".into(), verdict.unwrap_or_default());
        if let Ok(serde_json::Value::Object(fields)) = serde_json::to_value(self) {
            json.extend(fields);
        }
        json.into()
    }

    /// Returns the worst issue of a valid mesh.
    fn worst_issue(&self) -> Option<Issue> {
        // The kind of feature comes first, because everything else depends on it.
        self.no_feature_issue()
            .or_else(|| self.doubt_issue())
            .or_else(|| self.quality.as_ref().and_then(|q| self.shape_issue(q)))
            .or_else(|| self.voronoi.as_ref().and_then(|v| self.flow_issue(v)))
            .or_else(|| self.coverage_issue())
            .or_else(|| self.lost_part_issue())
            .or_else(|| self.damage_issue())
            .or_else(|| self.hole_issue())
            .or_else(|| self.volume_issue())
            .or_else(|| self.spike_issue())
            .or_else(|| self.noise_issue())
            .or_else(|| self.dropped_feature_issue())
            .or_else(|| self.physical_shape_issue())
    }

    /// Returns the range of the angles, in each space in which angles are meaningful.
    fn angle_summary(&self) -> Option<String> {
        let [min, max] = angle_range(self.quality.as_ref()?);
        let text = format!("angles {min:.0} to {max:.0} degrees");
        Some(match &self.quality_physical {
            Some(quality) => {
                let [min, max] = angle_range(quality);
                format!("{text} in lattice space, {min:.0} to {max:.0} in physical space")
            }
            None => text,
        })
    }

    /// Returns the statements about features, the most important first.
    fn feature_lines(&self) -> Vec<String> {
        let mut lines: Vec<String> = self
            .feature_shares()
            .map(|(cover, _)| {
                let percent = (100.0 * cover).floor();
                format!("faces cover {percent:.0} % of the features that the mesh follows")
            })
            .into_iter()
            .collect();
        lines.extend(self.outcomes.iter().flat_map(outcome_lines));
        if let Some(missing) = &self.missing {
            let total = percent(missing.bridged + missing.without_features);
            let gaps = match missing.without_features {
                0.0 => "in gaps so small that they are bridged".to_string(),
                share => format!("{} % lie in gaps too large for features", percent(share)),
            };
            lines.push(format!("{total} % of the samples hold no data, {gaps}"));
        }
        lines.extend(self.region_summary());
        lines.extend(
            (self.interface_deviation())
                .map(|distance| format!("faces between regions up to {distance:.1} samples off")),
        );
        lines.extend((self.doubt.as_ref()).map(|doubt| format!("doubtful: {}", doubt.question)));
        if lines.is_empty() {
            let was_compared = self.job_options().is_some() && !self.is_stopped();
            lines.push(String::from(if was_compared {
                "no feature was found"
            } else {
                "not compared with an image"
            }));
        }
        lines
    }

    /// Returns the issue of a mesh without any detected feature.
    fn no_feature_issue(&self) -> Option<Issue> {
        let options = self.job_options()?;
        // Without measures of the mesh, nothing is known.
        if self.fidelity.is_some() || self.is_stopped() {
            return None;
        }
        let issue = "no feature was found, so the mesh follows none".to_string();
        let kind: Option<FeatureKind> =
            (options["feature"].as_str()).and_then(|name| name.parse().ok());
        let has_strength =
            kind.is_none_or(|kind| kind.threshold_meaning() == ThresholdMeaning::MinStrength);
        if let Some(threshold) = options["threshold"].as_f64()
            && has_strength
        {
            return Some(Issue {
                message: issue,
                option: Some(format!("--threshold {}", 0.5 * threshold)),
                suggestion: "accepts weaker features, too",
            });
        }
        let was_sought = |kind: &FeatureKind| {
            options["feature"] == kind.to_string() || self.outcomes.iter().any(|o| o.kind == *kind)
        };
        let kinds = [FeatureKind::Edges, FeatureKind::Ridges];
        let other = kinds.into_iter().find(|kind| !was_sought(kind));
        Some(Issue {
            message: issue,
            option: other.map(|kind| format!("--feature {kind}")),
            suggestion: if has_strength {
                "looks for another kind of feature; or use a --threshold below the one in the notes"
            } else {
                "looks for another kind of feature"
            },
        })
    }

    /// Returns the minimum allowed angle.
    fn min_allowed_angle(&self) -> f64 {
        let target = self
            .job_options()
            .and_then(|options| options["min-dihedral"].as_f64());
        target.map_or(DEFAULT_MIN_ANGLE, |requested| {
            requested.min(DEFAULT_MIN_ANGLE)
        })
    }

    /// Returns the issue of angles with which simulators fail or are slow.
    fn shape_issue(&self, quality: &Quality) -> Option<Issue> {
        let worst = quality.below_20.max(quality.above_160);
        let min_allowed = self.min_allowed_angle();
        let [smallest, largest] = angle_range(quality);
        if worst == 0 || (smallest >= min_allowed && largest <= 180.0 - min_allowed) {
            return None;
        }
        let issue = format!(
            "{} of {} {} have angles below 20 or above 160 degrees",
            group_digits(worst),
            group_digits(quality.cells),
            quality.kind
        );
        let keeps_slivers = |options: &serde_json::Value| options["slivers"] == "none";
        if self.job_options().is_some_and(keeps_slivers) {
            return Some(Issue {
                message: issue,
                option: Some("--slivers joe".into()),
                suggestion: "removes slivers",
            });
        }
        let explained = |a: &super::Angles| a.near_acute_line > a.unexplained;
        Some(if quality.angles.as_ref().is_some_and(explained) {
            Issue {
                message: format!("{issue}, most where features meet at a small angle"),
                option: self.finer_distance_option(),
                suggestion: "makes cells there smaller, and fewer of them bad",
            }
        } else {
            Issue {
                message: issue,
                option: self.finer_distance_option(),
                suggestion: "smaller cells fit better between features",
            }
        })
    }

    /// Returns the issue of angles in physical space, if users work in it.
    fn physical_shape_issue(&self) -> Option<Issue> {
        let quality = self.quality_physical.as_ref()?;
        let min_allowed = self.min_allowed_angle();
        let [smallest, largest] = angle_range(quality);
        let is_within = smallest >= min_allowed && largest <= 180.0 - min_allowed;
        (self.used_in_physical_space && !is_within).then(|| Issue {
            message: format!(
                "cells have the shape of the samples, so that angles in physical space are {smallest:.0} to \
                 {largest:.0} degrees"
            ),
            option: Some("--metric shape".into()),
            suggestion: "gives cells a good shape in physical space",
        })
    }

    /// Returns the issue of Voronoi cells with which flow simulators fail or are slow.
    fn flow_issue(&self, voronoi: &Voronoi) -> Option<Issue> {
        if voronoi.non_positive_connections > 0 {
            return Some(Issue {
                message: format!(
                    "{} faces have a transmissibility that is not positive",
                    group_digits(voronoi.non_positive_connections)
                ),
                option: Some("--metric physical".into()),
                suggestion: "makes cells in physical units, in which simulators compute",
            });
        }
        (voronoi.tiny_faces[0] > MAX_TINY_FACE_SHARE).then(|| Issue {
            message: format!(
                "{:.1} % of the faces are tiny, below a millionth of the mean area",
                100.0 * voronoi.tiny_faces[0]
            ),
            option: Some("--weld 0.001".into()),
            suggestion: "merges nodes that are very close to each other",
        })
    }

    /// Returns the issue of features without faces, or of tagged faces off the features.
    fn coverage_issue(&self) -> Option<Issue> {
        let (cover, precision) = self.feature_shares()?;
        if cover < MIN_FEATURE_SHARE {
            return Some(Issue {
                message: format!(
                    "{:.0} % of the features have no face within a sample",
                    (100.0 * (1.0 - cover)).ceil()
                ),
                option: self.finer_distance_option(),
                suggestion: "closer atoms cover more of them, with more cells",
            });
        }
        (precision < MIN_FEATURE_SHARE).then(|| Issue {
            message: format!(
                "{:.0} % of the faces on features are off them by more than a sample",
                (100.0 * (1.0 - precision)).ceil()
            ),
            option: self.finer_distance_option(),
            suggestion: "smaller faces follow curved features more closely, with more cells",
        })
    }

    /// Returns the issue of features that were found but that the mesh does not follow.
    fn dropped_feature_issue(&self) -> Option<Issue> {
        let worst = (self.outcomes.iter())
            .max_by(|a, b| a.dropped_share().total_cmp(&b.dropped_share()))?;
        if worst.dropped_share() <= MAX_DROPPED_SHARE {
            return None;
        }
        let kind = worst.kind;
        Some(Issue {
            message: format!(
                "the mesh does not follow {} % of the {kind} found",
                percent(worst.dropped_share())
            ),
            option: self.finer_distance_option(),
            suggestion: "closer atoms can follow features that are smaller or nearer to others",
        })
    }

    /// Returns the issue of features that may not be real.
    fn noise_issue(&self) -> Option<Issue> {
        let gentle = |o: &&KindOutcome| {
            o.gently_dipping
                .is_some_and(|share| share > MAX_GENTLE_FAULT_SHARE)
        };
        if let Some(outcome) = self.outcomes.iter().find(gentle) {
            return Some(Issue {
                message: format!(
                    "{} % of the {} dip below {MIN_FAULT_DIP:.0} degrees, as layers do",
                    percent(outcome.gently_dipping.unwrap_or_default()),
                    outcome.kind
                ),
                option: None,
                suggestion: "compare them with the image (slice)",
            });
        }
        let noisy = |o: &&KindOutcome| {
            o.signal_to_noise
                .is_some_and(|ratio| ratio < MIN_SIGNAL_TO_NOISE)
        };
        let outcome = self.outcomes.iter().find(noisy)?;
        Some(Issue {
            message: format!(
                "the {} are {:.1} times as strong as noise, so that some may be noise",
                outcome.kind,
                outcome.signal_to_noise.unwrap_or_default()
            ),
            option: None,
            suggestion: "compare them with the image (slice), or give a --threshold above the one in the notes",
        })
    }

    /// Returns the issue of parts of labels that are not in the mesh.
    fn lost_part_issue(&self) -> Option<Issue> {
        let lost = &self.regions.as_ref()?.lost;
        let largest = lost
            .iter()
            .max_by_key(|of_label| of_label.largest_samples)?;
        let is_label_lost = lost.iter().any(|lost| lost.is_whole_label);
        if !is_label_lost && largest.largest_samples < FRAGMENT_SAMPLES {
            return None;
        }
        let parts: usize = lost.iter().map(|of_label| of_label.parts).sum();
        let parts = match parts {
            1 => "a part of a label is".to_string(),
            parts => format!("{} parts of labels are", group_digits(parts)),
        };
        Some(Issue {
            message: format!(
                "{parts} lost, the largest {} samples of label {}",
                group_digits(largest.largest_samples),
                largest.label
            ),
            option: largest.remedy(),
            suggestion: match largest.remedy() {
                Some(_) => "makes cells of that label smaller, which keeps the part",
                None => regions::RESAMPLING_ADVICE,
            },
        })
    }

    /// Returns the issue of labels that touch through holes in the thing between them.
    fn hole_issue(&self) -> Option<Issue> {
        let worst = self.regions.as_ref()?.holes.first()?;
        let [a, b] = worst.labels;
        (worst.area > MAX_CONTACT_AREA).then(|| Issue {
            message: format!(
                "the labels {a} and {b} touch through holes in the layer between them"
            ),
            option: self.finer_distance_option(),
            suggestion: "smaller cells keep thin layers closed; or use an image with more samples",
        })
    }

    /// Returns the issue of parts of labels that are largely missing.
    fn damage_issue(&self) -> Option<Issue> {
        let damaged = &self.regions.as_ref()?.damaged;
        let largest = damaged
            .iter()
            .max_by_key(|of_label| of_label.largest_samples)?;
        Some(Issue {
            message: format!(
                "a part of label {} with {} samples lacks more than {:.0} % of its volume",
                largest.label,
                group_digits(largest.largest_samples),
                100.0 * regions::MIN_MISSING_SHARE
            ),
            option: largest.remedy(),
            suggestion: match largest.remedy() {
                Some(_) => "makes cells of that label smaller, which keeps the part",
                None => regions::RESAMPLING_ADVICE,
            },
        })
    }

    /// Returns the issue of the region with the largest volume error.
    fn volume_issue(&self) -> Option<Issue> {
        let candidates = self.regions.as_ref()?.regions.iter();
        let measured = candidates.filter(|region| region.samples >= MIN_MEASURED_SAMPLES);
        let worst = measured.max_by(|a, b| {
            a.volume_error_percent
                .abs()
                .total_cmp(&b.volume_error_percent.abs())
        })?;
        if worst.volume_error_percent.abs() <= MAX_VOLUME_ERROR_PERCENT {
            return None;
        }
        let option = regions::distance_option(worst.label, worst.distance);
        let suggestion = match option {
            Some(_) => "makes cells of that label smaller, so that they follow it",
            None => "use a smaller --distance everywhere, or an image with more samples",
        };
        Some(Issue {
            message: format!(
                "the region of label {} is {:.1} % too {}",
                worst.label,
                worst.volume_error_percent.abs(),
                if worst.volume_error_percent < 0.0 {
                    "small"
                } else {
                    "large"
                }
            ),
            option,
            suggestion,
        })
    }

    /// Returns the deviation, in samples, of interfaces from the places where labels change, if it
    /// is too large.
    fn interface_deviation(&self) -> Option<f64> {
        self.regions.as_ref()?;
        let farthest = self.fidelity.as_ref()?.tagged_faces.as_ref()?.hausdorff;
        (farthest.is_finite() && farthest > MAX_INTERFACE_DEVIATION).then_some(farthest)
    }

    /// Returns the issue of interfaces with spikes.
    fn spike_issue(&self) -> Option<Issue> {
        let farthest = self.interface_deviation()?;
        Some(Issue {
            message: format!("faces between regions have spikes, up to {farthest:.1} samples long"),
            option: self.finer_distance_option(),
            suggestion: "cells smaller than thin layers have no spikes",
        })
    }

    /// Returns the statement about regions for the line on features.
    fn region_summary(&self) -> Option<String> {
        let regions = self.regions.as_ref()?;
        let measured = regions
            .regions
            .iter()
            .filter(|region| region.samples >= MIN_MEASURED_SAMPLES);
        let worst = measured
            .map(|region| region.volume_error_percent.abs())
            .fold(0.0, f64::max);
        let lost: usize = regions.lost.iter().map(|lost| lost.parts).sum();
        let text = match lost {
            0 => format!("regions within {worst:.1} % of their volumes"),
            1 => format!("regions within {worst:.1} % of their volumes, a part lost"),
            _ => format!(
                "regions within {worst:.1} % of their volumes, {} parts lost",
                group_digits(lost)
            ),
        };
        let area: f64 = regions.holes.iter().map(|hole| hole.area).sum();
        Some(if area > MAX_CONTACT_AREA {
            format!("{text}, holes of {area:.0} square samples between them")
        } else {
            text
        })
    }

    /// Returns the issue of a kind of feature that was chosen although the image is ambiguous.
    fn doubt_issue(&self) -> Option<Issue> {
        let doubt = self.doubt.as_ref()?;
        Some(Issue {
            message: format!("doubtful: {}", doubt.question),
            option: Some(format!("--feature {}", doubt.other)),
            suggestion: doubt.other.suggestion_in_doubt()?,
        })
    }

    /// Returns the fraction of the features that have faces, and the fraction of the faces that are
    /// on features. It uses the tagged faces if there are any.
    fn feature_shares(&self) -> Option<(f64, f64)> {
        let Fidelity {
            tagged_faces: tagged,
            on_feature,
            ..
        } = self.fidelity.as_ref()?;
        let faces = tagged.as_ref().unwrap_or(on_feature);
        let number = |share: f64| if share.is_finite() { share } else { 0.0 };
        Some((number(faces.coverage_one), number(faces.precision)))
    }

    /// Returns the option for half the current distance, unless atoms would be closer together than
    /// samples.
    fn finer_distance_option(&self) -> Option<String> {
        let Some(options) = self.job_options() else {
            return Some("--distance, smaller".into());
        };
        if options["seeding"] == "canny" {
            return Some("--seeding fcc".into());
        }
        let text = options["distance"].as_str().unwrap_or("2.7:8");
        let half = |number: &str| Some(0.5 * number.trim().parse::<f64>().ok()?);
        let halves: Option<Vec<f64>> = text.split(':').map(half).collect();
        let halves = halves?;
        if halves.iter().any(|half| *half < MIN_ATOM_DISTANCE) {
            return None;
        }
        let words = halves
            .iter()
            .map(|half| format!("{}", (1000.0 * half).round() / 1000.0));
        Some(format!(
            "--distance {}",
            words.collect::<Vec<_>>().join(":")
        ))
    }

    /// Returns `true` if an option differs from those that were given.
    fn is_new_option(&self, option: &str) -> bool {
        let Some((name, value)) = option.strip_prefix("--").and_then(|o| o.split_once(' ')) else {
            return true;
        };
        let current = self.job_options().map(|options| &options[name]);
        !current.is_some_and(|current| match current {
            serde_json::Value::String(text) => text == value,
            serde_json::Value::Number(number) => value.parse::<f64>().ok() == number.as_f64(),
            serde_json::Value::Array(values) => values.iter().any(|item| item == value),
            _ => false,
        })
    }

    /// Returns the options of the job, if there was one.
    fn job_options(&self) -> Option<&serde_json::Value> {
        self.parameters.is_object().then_some(&self.parameters)
    }

    fn is_stopped(&self) -> bool {
        let stop = self.lattice.as_ref().and_then(|l| l.optimisation.as_ref());
        stop.is_some_and(|o| o.stop.contains("interrupted"))
    }
}

/// Returns statements about how well the features of a kind were found.
fn outcome_lines(outcome: &KindOutcome) -> Vec<String> {
    let mut lines = Vec::new();
    let KindOutcome {
        kind,
        points,
        dropped,
        ..
    } = outcome;
    if *points == 0 {
        let count = group_digits(dropped.strong_count() + dropped.weak);
        lines.push(format!(
            "no {kind} are followed; {count} signs of them are too weak or too small"
        ));
        return lines;
    }
    if outcome.dropped_share() >= 0.005 {
        let reasons = [
            (dropped.near_another_surface, "too near stronger ones"),
            (dropped.in_small_pieces, "in small pieces"),
            (dropped.in_narrow_parts, "in narrow strips"),
        ];
        let main_reason = reasons.iter().max_by_key(|reason| reason.0);
        let why = main_reason.map_or("", |reason| reason.1);
        let share = percent(outcome.dropped_share());
        lines.push(format!(
            "{share} % of the {kind} found are dropped, most {why}"
        ));
    }
    let weak = dropped.weak as f64 / (dropped.weak + points).max(1) as f64;
    if weak > MAX_DROPPED_SHARE {
        lines.push(format!(
            "{} % of the signs of {kind} are too weak",
            percent(weak)
        ));
    }
    if let Some(ratio) = outcome.signal_to_noise {
        let ratio = match ratio {
            r if r > MAX_SHOWN_RATIO => format!("over {MAX_SHOWN_RATIO:.0}"),
            r => format!("{r:.1}"),
        };
        lines.push(format!("{kind} are {ratio} times as strong as noise"));
    }
    if let Some(gentle) = outcome
        .gently_dipping
        .filter(|share| *share > MAX_DROPPED_SHARE)
    {
        lines.push(format!(
            "{} % of the {kind} dip below {MIN_FAULT_DIP:.0} degrees",
            percent(gentle)
        ));
    }
    lines
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::feature::{Doubt, DroppedPoints, MissingData};
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::check::check;
    use crate::report::{FaceMatch, quality};

    /// Returns the report on a valid mesh. Tests then make one measure after the other bad.
    fn report(cover: f64) -> Report {
        let mesh = kuhn_box([4, 4, 4], 1.0);
        let face_match = FaceMatch {
            faces: 10,
            area: 5.0,
            coverage_half: cover,
            coverage_one: cover,
            precision: 1.0,
            hausdorff: 0.5,
            hausdorff_95: 0.5,
            by_gap: Vec::new(),
        };
        Report {
            parameters: json!({ "distance": "3:8" }),
            quality: Some(quality(&mesh)),
            box_check: Some(check(&mesh, [0.0; 3], [4.0; 3], 1e-9)),
            fidelity: Some(Fidelity {
                reference: "detected".into(),
                feature_points: 100,
                on_feature: face_match,
                tagged_faces: None,
            }),
            ..Report::default()
        }
    }

    #[test]
    fn worst_issue_is_named_with_the_option_that_helps() {
        let verdict_of = |report: &Report| Verdict::from_report(report).unwrap();
        let good = verdict_of(&report(0.97));
        assert_eq!(
            (good.grade, good.issue, good.option),
            (Grade::Good, None, None)
        );
        assert_eq!(good.mesh, "valid; angles 45 to 90 degrees");

        let uncovered = verdict_of(&report(0.704));
        assert_eq!(uncovered.grade, Grade::Fair);
        let issue = uncovered.issue.unwrap();
        assert_eq!(issue, "30 % of the features have no face within a sample");
        assert_eq!(uncovered.option.as_deref(), Some("--distance 1.5:4"));

        let mut flat = report(0.7);
        flat.quality.as_mut().unwrap().below_20 = 3;
        flat.quality.as_mut().unwrap().smallest_angle.worst = 12.0;
        let issue = verdict_of(&flat).issue.unwrap();
        assert!(issue.starts_with("3 of 384 tetrahedra"), "{issue}");
        flat.parameters = json!({ "slivers": "none" });
        assert_eq!(verdict_of(&flat).option.as_deref(), Some("--slivers joe"));

        let mut featureless = report(1.0);
        featureless.fidelity = None;
        assert_eq!(
            verdict_of(&featureless).option.as_deref(),
            Some("--feature edges")
        );

        let mut invalid = report(1.0);
        let problem = "two cells overlap".to_string();
        invalid
            .box_check
            .as_mut()
            .unwrap()
            .problems
            .push(problem.clone());
        invalid.parameters = json!({ "rng-seed": 4 });
        let invalid = verdict_of(&invalid);
        assert_eq!((invalid.grade, invalid.issue), (Grade::Bad, Some(problem)));
        assert_eq!(invalid.option.as_deref(), Some("--rng-seed 5"));
    }

    #[test]
    fn verdict_leads_table_and_json() {
        let report = report(0.7);
        let table = report.table();
        let heads: Vec<&str> = table
            .lines()
            .map(|l| l[..12].trim_end())
            .filter(|head| !head.is_empty())
            .collect();
        assert_eq!(heads[..3], ["mesh", "features", "use"]);
        assert!(table.contains("Try --distance 1.5:4: "), "{table}");
        let json = report.to_json();
        assert_eq!(json["verdict"]["grade"], "fair");
        assert_eq!(json["verdict"]["option"], "--distance 1.5:4");
        assert_eq!(json["fidelity"]["feature_points"], 100);
        assert_eq!(Verdict::from_report(&Report::default()), None);
    }

    #[test]
    fn dropped_and_doubtful_features_are_reported() {
        let verdict_of = |report: &Report| Verdict::from_report(report).unwrap();
        let outcome = KindOutcome {
            kind: FeatureKind::Faults,
            points: 900,
            dropped: DroppedPoints {
                near_another_surface: 50,
                in_small_pieces: 40,
                in_narrow_parts: 0,
                weak: 300,
            },
            signal_to_noise: Some(6.0),
            gently_dipping: Some(0.05),
        };
        let report_with = |outcome: KindOutcome| Report {
            outcomes: vec![outcome],
            ..report(0.97)
        };
        let verdict = verdict_of(&report_with(outcome));
        assert_eq!(verdict.grade, Grade::Good, "{verdict:?}");
        let expected = "9 % of the faults found are dropped, most too near stronger ones; 25 % of the signs of faults \
                    are too weak; faults are 6.0 times as strong as noise";
        assert!(verdict.features.ends_with(expected), "{}", verdict.features);

        let mut crowded = outcome;
        crowded.dropped.near_another_surface = 100;
        let crowded = verdict_of(&report_with(crowded));
        let issue = crowded.issue.unwrap();
        assert_eq!(issue, "the mesh does not follow 13 % of the faults found");
        assert_eq!(crowded.option.as_deref(), Some("--distance 1.5:4"));

        for (noise, gentle, expected) in [(2.1, 0.1, "2.1 times as strong"), (6.0, 0.6, "60 %")] {
            let doubtful = KindOutcome {
                signal_to_noise: Some(noise),
                gently_dipping: Some(gentle),
                ..outcome
            };
            let issue = verdict_of(&report_with(doubtful)).issue.unwrap();
            assert!(issue.contains(expected), "{issue}");
        }

        let gaps = Report {
            missing: Some(MissingData {
                bridged: 0.05,
                without_features: 0.27,
            }),
            ..report(0.97)
        };
        let expected = "32 % of the samples hold no data, 27 % lie in gaps too large for features";
        assert!(
            verdict_of(&gaps).features.ends_with(expected),
            "{}",
            verdict_of(&gaps).features
        );
    }

    #[test]
    fn angles_count_in_the_space_that_is_used() {
        let mut flat = report(0.97);
        let mut quality = flat.quality.clone().unwrap();
        quality.smallest_angle.worst = 9.0;
        flat.quality_physical = Some(quality);
        let survey = Verdict::from_report(&flat).unwrap();
        assert_eq!(survey.grade, Grade::Good);
        assert!(
            survey.mesh.ends_with("9 to 90 in physical space"),
            "{}",
            survey.mesh
        );
        flat.used_in_physical_space = true;
        let scan = Verdict::from_report(&flat).unwrap();
        assert_eq!(scan.grade, Grade::Fair);
        assert_eq!(scan.option.as_deref(), Some("--metric shape"));
    }

    #[test]
    fn given_or_too_fine_options_are_not_suggested() {
        let mut uncovered = report(0.7);
        uncovered.parameters = json!({ "distance": "1.9:4" });
        assert_eq!(Verdict::from_report(&uncovered).unwrap().option, None);
        let mut featureless = report(1.0);
        featureless.fidelity = None;
        for (options, option) in [
            (json!({ "feature": "edges" }), Some("--feature ridges")),
            (json!({ "feature": "ridges" }), Some("--feature edges")),
            (json!({ "threshold": 0.5 }), Some("--threshold 0.25")),
        ] {
            featureless.parameters = options;
            assert_eq!(
                Verdict::from_report(&featureless)
                    .unwrap()
                    .option
                    .as_deref(),
                option
            );
        }
        // `auto` chose edges.
        featureless.parameters = json!({ "feature": "auto" });
        featureless.outcomes = vec![KindOutcome {
            kind: FeatureKind::Edges,
            points: 0,
            dropped: DroppedPoints::default(),
            signal_to_noise: None,
            gently_dipping: None,
        }];
        let option = Verdict::from_report(&featureless).unwrap().option;
        assert_eq!(option.as_deref(), Some("--feature ridges"));
        // A doubt about the kind of feature comes before the results.
        uncovered.doubt = Some(Doubt {
            question: "objects may be paint".into(),
            assumed: FeatureKind::Labels,
            other: FeatureKind::Mask,
        });
        let option = Verdict::from_report(&uncovered).unwrap().option;
        assert_eq!(option.as_deref(), Some("--feature mask"));
    }
}
