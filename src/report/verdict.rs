//! A report in three lines: is the mesh sound, does it have the features, what is it good for.

use serde::Serialize;

use super::regions;
use super::table::group_digits;
use super::{Fidelity, Quality, Report, Voronoi};
use crate::feature::{FeatureKind, KindOutcome, MIN_FAULT_DIP};

/// Smaller shares of the features covered by faces, or of faces that are on features, are an issue.
const MIN_FEATURE_SHARE: f64 = 0.9;

/// A larger share of the features of one kind that the mesh does not follow is an issue.
const MAX_DROPPED_SHARE: f64 = 0.1;

/// Features whose typical strength is a smaller multiple of the noise may be noise.
const MIN_SIGNAL_TO_NOISE: f32 = 2.5;

/// Ratios of strength to noise above this are not given in figures.
const MAX_SHOWN_RATIO: f32 = 100.0;

/// A larger share of faults that dip as layers do is an issue.
const MAX_GENTLE_FAULT_SHARE: f64 = 0.25;

/// Angles within this distance, in degrees, of 0 or 180 are an issue, unless a smaller target was given.
const DEFAULT_MIN_ANGLE: f64 = 20.0;

/// A share of faces narrower than the least of [`TINY`](super::cell_output::TINY_FACE_RATIOS) that is worth a word.
const MAX_TINY_FACE_SHARE: f64 = 0.01;

/// Parts of labels of fewer samples are no loss, unless nothing else has the label.
const FRAGMENT_SAMPLES: usize = 8;

/// Regions of at least so many samples ...
const MIN_MEASURED_SAMPLES: usize = 50;

/// ... are an issue if their volumes are off by more than this, in percent.
const MAX_VOLUME_ERROR_PERCENT: f64 = 2.0;

/// Contacts of labels that do not touch in the image are an issue if they are larger than this, in square samples.
const MAX_CONTACT_AREA: f64 = 10.0;

/// Interfaces that stray farther from where labels change, in samples, have spikes.
const MAX_INTERFACE_DEVIATION: f64 = 1.5;

/// A distance between atoms below this, in samples, adds no detail of the image, and is not suggested.
const MIN_ATOM_DISTANCE: f64 = 1.0;

/// How good a mesh is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Valid, well shaped, and it has the features.
    Good,
    /// Valid, but there is an issue.
    Fair,
    /// Of no use to a simulator.
    Bad,
}

/// What a newcomer should know of a report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// How good the mesh is.
    pub grade: Grade,
    /// Whether it is valid, and its angles.
    pub mesh: String,
    /// How complete and how credible its features are, and what became of regions.
    pub features: String,
    /// What it is fit for.
    pub fit_for: String,
    /// The worst issue.
    pub issue: Option<String>,
    /// What would help, in words.
    pub suggestion: Option<String>,
    /// The option to type for that, if there is one.
    pub option: Option<String>,
}

/// Something that is not as it should be, and what helps.
struct Issue {
    message: String,
    option: Option<String>,
    suggestion: &'static str,
}

impl Verdict {
    /// Returns the verdict on a report; `None` if it has no figures of a mesh.
    pub fn from_report(report: &Report) -> Option<Self> {
        let check = report.box_check.as_ref();
        let check = check.or(report.voronoi.as_ref().map(|v| &v.check))?;
        let issue = match check.problems.first() {
            Some(problem) => Some(Issue {
                message: problem.clone(),
                option: report.job_options().map(|asked| {
                    let seed = asked["rng-seed"].as_u64().unwrap_or(1);
                    format!("--rng-seed {}", seed + 1)
                }),
                suggestion: "makes the mesh again; other random numbers may avoid it",
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
            Grade::Fair => "viewing, and for simulation if that does not matter",
            Grade::Bad => "nothing but finding out why",
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
        let mut used = format!("{word}: fit for {}", self.fit_for);
        if let Some(issue) = &self.issue {
            used = format!("{word}: {issue}; fit for {}", self.fit_for);
        }
        used += &match (&self.option, &self.suggestion) {
            (Some(option), Some(why)) => format!(". Try {option}: {why}"),
            (None, Some(why)) => format!(". What helps: {why}"),
            _ => String::new(),
        };
        [
            ("mesh", self.mesh.clone()),
            ("features", self.features.clone()),
            ("use", used),
        ]
    }
}

/// Returns the least and the largest angle that shapes have.
fn angle_range(quality: &Quality) -> [f64; 2] {
    [quality.smallest_angle.worst, quality.largest_angle.worst]
}

/// Returns a share as percent, no better than it is.
fn percent(share: f64) -> String {
    match 100.0 * share {
        p if p < 1.0 => format!("{p:.2}"),
        p => format!("{p:.0}"),
    }
}

impl Report {
    /// Returns the report as JSON, with the [`Verdict`] first.
    pub fn to_json(&self) -> serde_json::Value {
        let mut json = serde_json::Map::new();
        let verdict = serde_json::to_value(Verdict::from_report(self));
        json.insert("verdict".into(), verdict.unwrap_or_default());
        if let Ok(serde_json::Value::Object(rest)) = serde_json::to_value(self) {
            json.extend(rest);
        }
        json.into()
    }

    /// Returns the worst issue of a valid mesh.
    fn worst_issue(&self) -> Option<Issue> {
        // What was followed decides on all the rest.
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

    /// Returns the range of the angles, in each space in which they mean something.
    fn angle_summary(&self) -> Option<String> {
        let [least, most] = angle_range(self.quality.as_ref()?);
        let text = format!("angles {least:.0} to {most:.0} degrees");
        Some(match &self.quality_physical {
            Some(quality) => {
                let [least, most] = angle_range(quality);
                format!("{text} in lattice space, {least:.0} to {most:.0} in physical space")
            }
            None => text,
        })
    }

    /// Returns what to say of features, the most important first.
    fn feature_lines(&self) -> Vec<String> {
        let mut said: Vec<String> = self
            .feature_shares()
            .map(|(cover, _)| {
                let percent = (100.0 * cover).floor();
                format!("{percent:.0} % of those that the mesh follows have faces on them")
            })
            .into_iter()
            .collect();
        for outcome in &self.outcomes {
            let KindOutcome {
                kind,
                points,
                dropped: left_out,
                ..
            } = outcome;
            if *points == 0 {
                let count = group_digits(left_out.strong_count() + left_out.weak);
                said.push(format!(
                    "no {kind} are followed; {count} signs of them are too weak or too small"
                ));
                continue;
            }
            if outcome.dropped_share() >= 0.005 {
                let reasons = [
                    (left_out.near_another_surface, "too near stronger ones"),
                    (left_out.in_small_pieces, "in small pieces"),
                    (left_out.in_narrow_parts, "in narrow strips"),
                ];
                let main = reasons.iter().max_by_key(|reason| reason.0);
                let why = main.map_or("", |reason| reason.1);
                let share = percent(outcome.dropped_share());
                said.push(format!(
                    "{share} % of the {kind} found are dropped, most {why}"
                ));
            }
            let weak = left_out.weak as f64 / (left_out.weak + points).max(1) as f64;
            if weak > MAX_DROPPED_SHARE {
                said.push(format!(
                    "{} % of the signs of {kind} are too weak",
                    percent(weak)
                ));
            }
            if let Some(ratio) = outcome.signal_to_noise {
                let ratio = match ratio {
                    r if r > MAX_SHOWN_RATIO => format!("over {MAX_SHOWN_RATIO:.0}"),
                    r => format!("{r:.1}"),
                };
                said.push(format!("{kind} are {ratio} times as strong as noise"));
            }
            if let Some(gentle) = outcome
                .gently_dipping
                .filter(|share| *share > MAX_DROPPED_SHARE)
            {
                said.push(format!(
                    "{} % of the {kind} dip below {MIN_FAULT_DIP:.0} degrees",
                    percent(gentle)
                ));
            }
        }
        if let Some(missing) = &self.missing {
            let all = percent(missing.bridged + missing.without_features);
            let gaps = match missing.without_features {
                0.0 => "in gaps so small that they are bridged".to_string(),
                share => format!("{} % lie in gaps too large for features", percent(share)),
            };
            said.push(format!("{all} % of the samples hold no data, {gaps}"));
        }
        said.extend(self.region_summary());
        said.extend(
            (self.interface_deviation())
                .map(|far| format!("faces between regions up to {far:.1} samples off")),
        );
        said.extend((self.doubt.as_ref()).map(|doubt| format!("doubtful: {}", doubt.question)));
        if said.is_empty() {
            let nothing = self.job_options().is_some() && !self.is_stopped();
            said.push(String::from(match nothing {
                true => "none was found",
                false => "not compared with an image",
            }));
        }
        said
    }

    /// Returns the issue of a mesh of an image in which no feature was found.
    fn no_feature_issue(&self) -> Option<Issue> {
        let asked = self.job_options()?;
        // Without a mesh's measures, nothing is known.
        if self.fidelity.is_some() || self.is_stopped() {
            return None;
        }
        let issue = "no feature was found, so the mesh follows none".to_string();
        if let Some(threshold) = asked["threshold"].as_f64() {
            return Some(Issue {
                message: issue,
                option: Some(format!("--threshold {}", 0.5 * threshold)),
                suggestion: "weaker features count, too",
            });
        }
        let was_sought = |kind: &FeatureKind| {
            asked["feature"] == kind.to_string() || self.outcomes.iter().any(|o| o.kind == *kind)
        };
        let kinds = [FeatureKind::Edges, FeatureKind::Ridges];
        let other = kinds.into_iter().find(|kind| !was_sought(kind));
        Some(Issue {
            message: issue,
            option: other.map(|kind| format!("--feature {kind}")),
            suggestion: "another kind of feature; or a --threshold below the one in the notes",
        })
    }

    /// Returns the least angle that is as it should be.
    fn min_allowed_angle(&self) -> f64 {
        let asked = self
            .job_options()
            .and_then(|asked| asked["min-dihedral"].as_f64());
        asked.map_or(DEFAULT_MIN_ANGLE, |asked| asked.min(DEFAULT_MIN_ANGLE))
    }

    /// Returns the issue of angles with which simulators fail or are slow.
    fn shape_issue(&self, quality: &Quality) -> Option<Issue> {
        let worst = quality.below_20.max(quality.above_160);
        let least = self.min_allowed_angle();
        let [smallest, largest] = angle_range(quality);
        if worst == 0 || (smallest >= least && largest <= 180.0 - least) {
            return None;
        }
        let issue = format!(
            "{} of {} {} have angles below 20 or above 160 degrees",
            group_digits(worst),
            group_digits(quality.cells),
            quality.kind
        );
        let left = |asked: &serde_json::Value| asked["slivers"] == "none";
        if self.job_options().is_some_and(left) {
            return Some(Issue {
                message: issue,
                option: Some("--slivers joe".into()),
                suggestion: "removes slivers",
            });
        }
        let explained = |a: &super::Angles| a.near_acute_line > a.unexplained;
        Some(match quality.angles.as_ref().is_some_and(explained) {
            true => Issue {
                message: format!("{issue}, most where features meet at a small angle"),
                option: self.finer_distance_option(),
                suggestion: "cells there become smaller, and fewer of them poor",
            },
            false => Issue {
                message: issue,
                option: self.finer_distance_option(),
                suggestion: "atoms nearer together have more room between features",
            },
        })
    }

    /// Returns the issue of angles in physical space, if users work in it.
    fn physical_shape_issue(&self) -> Option<Issue> {
        let quality = self.quality_physical.as_ref()?;
        let least = self.min_allowed_angle();
        let [smallest, largest] = angle_range(quality);
        let is_within = smallest >= least && largest <= 180.0 - least;
        (self.used_in_physical_space && !is_within).then(|| Issue {
            message: format!(
                "cells have the shape of the samples, so that angles in physical space are {smallest:.0} to \
                 {largest:.0} degrees"
            ),
            option: Some("--metric shape".into()),
            suggestion: "cells are well shaped in physical space",
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
                suggestion: "makes cells in the world's units, in which simulators compute",
            });
        }
        (voronoi.tiny_faces[0] > MAX_TINY_FACE_SHARE).then(|| Issue {
            message: format!(
                "{:.1} % of the faces are tiny, below a millionth of the mean area",
                100.0 * voronoi.tiny_faces[0]
            ),
            option: Some("--weld 0.001".into()),
            suggestion: "merges nodes that are next to one another",
        })
    }

    /// Returns the issue of features without faces, or of faces off the features.
    fn coverage_issue(&self) -> Option<Issue> {
        let (cover, precision) = self.feature_shares()?;
        if cover < MIN_FEATURE_SHARE {
            return Some(Issue {
                message: format!(
                    "{:.0} % of the features have no face within a sample",
                    (100.0 * (1.0 - cover)).ceil()
                ),
                option: self.finer_distance_option(),
                suggestion: "atoms nearer together reach more of them, with more cells",
            });
        }
        (precision < MIN_FEATURE_SHARE).then(|| Issue {
            message: format!(
                "{:.0} % of the faces on features are off them by more than a sample",
                (100.0 * (1.0 - precision)).ceil()
            ),
            option: self.finer_distance_option(),
            suggestion: "smaller faces follow bends more closely, with more cells",
        })
    }

    /// Returns the issue of features that were found and that the mesh does not follow.
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
            suggestion: "atoms nearer together have room for features that are smaller or nearer to others",
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

    /// Returns the issue of parts of labels that the mesh does not have.
    fn lost_part_issue(&self) -> Option<Issue> {
        let lost = &self.regions.as_ref()?.lost;
        let largest = lost
            .iter()
            .max_by_key(|of_label| of_label.largest_samples)?;
        let whole = lost.iter().any(|lost| lost.is_whole_label);
        if !whole && largest.largest_samples < FRAGMENT_SAMPLES {
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
                Some(_) => "cells of that label become smaller, and the part is kept",
                None => regions::RESAMPLING_ADVICE,
            },
        })
    }

    /// Returns the issue of labels that touch through holes in what lies between them.
    fn hole_issue(&self) -> Option<Issue> {
        let worst = self.regions.as_ref()?.holes.first()?;
        let [a, b] = worst.labels;
        (worst.area > MAX_CONTACT_AREA).then(|| Issue {
            message: format!("what lies between the labels {a} and {b} has holes, over which they touch"),
            option: self.finer_distance_option(),
            suggestion: "cells of the size of what is thin keep it whole; or an image of more samples",
        })
    }

    /// Returns the issue of parts of labels of which much is missing.
    fn damage_issue(&self) -> Option<Issue> {
        let damaged = &self.regions.as_ref()?.damaged;
        let largest = damaged
            .iter()
            .max_by_key(|of_label| of_label.largest_samples)?;
        Some(Issue {
            message: format!(
                "of a part of label {}, {} samples large, more than {:.0} % is missing",
                largest.label,
                group_digits(largest.largest_samples),
                100.0 * regions::MIN_MISSING_SHARE
            ),
            option: largest.remedy(),
            suggestion: match largest.remedy() {
                Some(_) => "cells of that label become smaller, and the part is kept",
                None => regions::RESAMPLING_ADVICE,
            },
        })
    }

    /// Returns the issue of the region whose volume is farthest off that of its samples.
    fn volume_issue(&self) -> Option<Issue> {
        let all = self.regions.as_ref()?.regions.iter();
        let of_size = all.filter(|region| region.samples >= MIN_MEASURED_SAMPLES);
        let worst = of_size.max_by(|a, b| {
            a.volume_error_percent
                .abs()
                .total_cmp(&b.volume_error_percent.abs())
        })?;
        if worst.volume_error_percent.abs() <= MAX_VOLUME_ERROR_PERCENT {
            return None;
        }
        let option = regions::distance_option(worst.label, worst.distance);
        let change = match option {
            Some(_) => "cells of that label become smaller, and follow it",
            None => "a smaller --distance everywhere, or an image of more samples",
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
            suggestion: change,
        })
    }

    /// Returns how far, in samples, interfaces of labels stray from where labels change.
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
            suggestion: "cells that are smaller than what is thin have none",
        })
    }

    /// Returns what the line on features says of regions.
    fn region_summary(&self) -> Option<String> {
        let regions = self.regions.as_ref()?;
        let of_size = regions
            .regions
            .iter()
            .filter(|region| region.samples >= MIN_MEASURED_SAMPLES);
        let worst = of_size
            .map(|region| region.volume_error_percent.abs())
            .fold(0.0, f64::max);
        let lost: usize = regions.lost.iter().map(|lost| lost.parts).sum();
        let said = match lost {
            0 => format!("regions within {worst:.1} % of their volumes"),
            1 => format!("regions within {worst:.1} % of their volumes, a part lost"),
            _ => format!(
                "regions within {worst:.1} % of their volumes, {} parts lost",
                group_digits(lost)
            ),
        };
        let area: f64 = regions.holes.iter().map(|hole| hole.area).sum();
        Some(match area > MAX_CONTACT_AREA {
            true => format!("{said}, holes of {area:.0} square samples between them"),
            false => said,
        })
    }

    /// Returns the issue of a kind of feature that was chosen although the image leaves it open.
    fn doubt_issue(&self) -> Option<Issue> {
        let doubt = self.doubt.as_ref()?;
        let change = if doubt.assumed == FeatureKind::Labels {
            "follows the middle of what is painted; --feature labels confirms solid objects"
        } else {
            "follows the sheets; --feature edges confirms the sides of solid objects"
        };
        Some(Issue {
            message: format!("doubtful: {}", doubt.question),
            option: Some(format!("--feature {}", doubt.other)),
            suggestion: change,
        })
    }

    /// Returns the share of features with faces, and the share of faces on features: of the faces that the mesh
    /// marks as such, if it marks any.
    fn feature_shares(&self) -> Option<(f64, f64)> {
        let Fidelity {
            tagged_faces: claimed,
            on_feature,
            ..
        } = self.fidelity.as_ref()?;
        let found = claimed.as_ref().unwrap_or(on_feature);
        let number = |share: f64| if share.is_finite() { share } else { 0.0 };
        Some((number(found.coverage_one), number(found.precision)))
    }

    /// Returns half the distance that was asked for, unless atoms would be nearer together than samples.
    fn finer_distance_option(&self) -> Option<String> {
        let Some(asked) = self.job_options() else {
            return Some("--distance, smaller".into());
        };
        if asked["seeding"] == "canny" {
            return Some("--seeding fcc".into());
        }
        let text = asked["distance"].as_str().unwrap_or("2.7:8");
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

    /// Returns whether an option is another one than was given.
    fn is_new_option(&self, option: &str) -> bool {
        let Some((name, value)) = option.strip_prefix("--").and_then(|o| o.split_once(' ')) else {
            return true;
        };
        let given = self.job_options().map(|asked| &asked[name]);
        !given.is_some_and(|given| match given {
            serde_json::Value::String(text) => text == value,
            serde_json::Value::Number(number) => value.parse::<f64>().ok() == number.as_f64(),
            serde_json::Value::Array(all) => all.iter().any(|one| one == value),
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::feature::{Doubt, DroppedPoints, MissingData};
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::check::check;
    use crate::report::{FaceMatch, quality};

    /// Of a mesh that is valid, with one figure after the other made poor.
    fn report(cover: f64) -> Report {
        let mesh = kuhn_box([4, 4, 4], 1.0);
        let found = FaceMatch {
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
                on_feature: found,
                tagged_faces: None,
            }),
            ..Report::default()
        }
    }

    #[test]
    fn the_worst_fault_is_named_with_the_option_that_helps() {
        let of = |report: &Report| Verdict::from_report(report).unwrap();
        let good = of(&report(0.97));
        assert_eq!(
            (good.grade, good.issue, good.option),
            (Grade::Good, None, None)
        );
        assert_eq!(good.mesh, "valid; angles 45 to 90 degrees");

        let far = of(&report(0.704));
        assert_eq!(far.grade, Grade::Fair);
        let issue = far.issue.unwrap();
        assert_eq!(issue, "30 % of the features have no face within a sample");
        assert_eq!(far.option.as_deref(), Some("--distance 1.5:4"));

        let mut flat = report(0.7);
        flat.quality.as_mut().unwrap().below_20 = 3;
        flat.quality.as_mut().unwrap().smallest_angle.worst = 12.0;
        let issue = of(&flat).issue.unwrap();
        assert!(issue.starts_with("3 of 384 tetrahedra"), "{issue}");
        flat.parameters = json!({ "slivers": "none" });
        assert_eq!(of(&flat).option.as_deref(), Some("--slivers joe"));

        let mut none = report(1.0);
        none.fidelity = None;
        assert_eq!(of(&none).option.as_deref(), Some("--feature edges"));

        let mut torn = report(1.0);
        let problem = "two cells overlap".to_string();
        torn.box_check
            .as_mut()
            .unwrap()
            .problems
            .push(problem.clone());
        torn.parameters = json!({ "rng-seed": 4 });
        let torn = of(&torn);
        assert_eq!((torn.grade, torn.issue), (Grade::Bad, Some(problem)));
        assert_eq!(torn.option.as_deref(), Some("--rng-seed 5"));
    }

    #[test]
    fn it_leads_table_and_json() {
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
    fn what_is_dropped_or_not_credible_is_said() {
        let of = |report: &Report| Verdict::from_report(report).unwrap();
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
        let with = |outcome: KindOutcome| Report {
            outcomes: vec![outcome],
            ..report(0.97)
        };
        let kept = of(&with(outcome));
        assert_eq!(kept.grade, Grade::Good, "{kept:?}");
        let said = "9 % of the faults found are dropped, most too near stronger ones; 25 % of the signs of faults \
                    are too weak; faults are 6.0 times as strong as noise";
        assert!(kept.features.ends_with(said), "{}", kept.features);

        let mut near = outcome;
        near.dropped.near_another_surface = 100;
        let near = of(&with(near));
        let issue = near.issue.unwrap();
        assert_eq!(issue, "the mesh does not follow 13 % of the faults found");
        assert_eq!(near.option.as_deref(), Some("--distance 1.5:4"));

        for (noise, gentle, words) in [(2.1, 0.1, "2.1 times as strong"), (6.0, 0.6, "60 %")] {
            let doubtful = KindOutcome {
                signal_to_noise: Some(noise),
                gently_dipping: Some(gentle),
                ..outcome
            };
            let issue = of(&with(doubtful)).issue.unwrap();
            assert!(issue.contains(words), "{issue}");
        }

        let gaps = Report {
            missing: Some(MissingData {
                bridged: 0.05,
                without_features: 0.27,
            }),
            ..report(0.97)
        };
        let said = "32 % of the samples hold no data, 27 % lie in gaps too large for features";
        assert!(of(&gaps).features.ends_with(said), "{}", of(&gaps).features);
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
    fn no_option_is_named_that_was_given_or_makes_atoms_denser_than_samples() {
        let mut far = report(0.7);
        far.parameters = json!({ "distance": "1.9:4" });
        assert_eq!(Verdict::from_report(&far).unwrap().option, None);
        let mut none = report(1.0);
        none.fidelity = None;
        for (asked, option) in [
            (json!({ "feature": "edges" }), Some("--feature ridges")),
            (json!({ "feature": "ridges" }), Some("--feature edges")),
            (json!({ "threshold": 0.5 }), Some("--threshold 0.25")),
        ] {
            none.parameters = asked;
            assert_eq!(
                Verdict::from_report(&none).unwrap().option.as_deref(),
                option
            );
        }
        // Edges are what `auto` chose.
        none.parameters = json!({ "feature": "auto" });
        none.outcomes = vec![KindOutcome {
            kind: FeatureKind::Edges,
            points: 0,
            dropped: DroppedPoints::default(),
            signal_to_noise: None,
            gently_dipping: None,
        }];
        let option = Verdict::from_report(&none).unwrap().option;
        assert_eq!(option.as_deref(), Some("--feature ridges"));
        // A doubt about what to follow comes before what came of it.
        far.doubt = Some(Doubt {
            question: "objects may be paint".into(),
            assumed: FeatureKind::Labels,
            other: FeatureKind::Mask,
        });
        let option = Verdict::from_report(&far).unwrap().option;
        assert_eq!(option.as_deref(), Some("--feature mask"));
    }
}
