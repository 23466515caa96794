//! Issues of a mesh, and the changes that help.

use serde_json::Value;

use super::certificate::PartIssue;
use super::job_facts::JobFacts;
use super::regions;
use super::table::group_digits;
use super::verdict::{MAX_CONTACT_AREA, MAX_DROPPED_SHARE, percent};
use super::{Fidelity, Grade, Quality, RegionReport, Report, Voronoi};
use crate::feature::{
    DOUBTFUL_CONFIDENCE, FeatureKind, KindOutcome, MIN_FAULT_DIP, ThresholdMeaning,
};
use crate::lattice::optimise::StopReason;

/// Minimum fraction of the features that have faces, and of the faces that are on features. Less is
/// an issue.
pub(super) const MIN_FEATURE_SHARE: f64 = 0.9;

/// Minimum ratio of the typical strength of features to the noise. Weaker features may be noise.
const MIN_SIGNAL_TO_NOISE: f32 = 2.5;

/// Maximum fraction of the points of faults, or of horizons, that lie on surfaces whose confidence is
/// doubtful. More is an issue.
const MAX_DOUBTFUL_SHARE: f64 = 0.1;

/// Maximum fraction of faults that dip as gently as layers. More is an issue.
const MAX_GENTLE_FAULT_SHARE: f64 = 0.25;

/// Default minimum distance of angles from 0 and 180 degrees. Closer angles are an issue, unless a
/// smaller target was given.
const DEFAULT_MIN_ANGLE: f64 = 20.0;

/// Angles that are closer to 0 and 180 degrees are worse than any other issue of a mesh of labels.
const MIN_USABLE_ANGLE: f64 = 5.0;

/// Maximum fraction of faces below the first of
/// [`TINY_FACE_RATIOS`](super::cells::TINY_FACE_RATIOS). More is an issue.
const MAX_TINY_FACE_SHARE: f64 = 0.01;

/// Minimum number of samples of a lost part of a label that is an issue, unless the label is lost
/// completely.
const FRAGMENT_SAMPLES: usize = 8;

/// Minimum number of lost parts of labels from which on the image counts as a scan that was taken for labels.
const SCAN_FRAGMENTS: usize = 5000;

/// Minimum number of samples of a region whose volume is checked.
const MIN_MEASURED_SAMPLES: usize = 50;

/// Maximum error of the volume of a region, in percent. More is an issue.
const MAX_VOLUME_ERROR_PERCENT: f64 = 2.0;

/// Maximum deviation of interfaces from the places where labels change, in samples. Interfaces that
/// deviate more have spikes.
const MAX_INTERFACE_DEVIATION: f64 = 1.5;

/// Maximum error of the volume of a region, in percent, of a mesh that is of any use: beyond it, the
/// region is not that of the image.
const MAX_USABLE_VOLUME_ERROR_PERCENT: f64 = 50.0;

/// Minimum fraction of the features, and of each given surface, that has faces in a mesh that is of
/// any use.
const MIN_USABLE_FEATURE_SHARE: f64 = 0.5;

/// Maximum deviation of interfaces, in samples, of a mesh that is of any use: beyond it, interfaces
/// are not those of the image.
const MAX_USABLE_INTERFACE_DEVIATION: f64 = 10.0;

/// Minimum distance between atoms that is suggested, in samples. A smaller one adds no detail of
/// the image.
const MIN_ATOM_DISTANCE: f64 = 1.0;

/// Issue of a mesh, and the change that helps. Without an option and with an empty suggestion, no
/// change is known.
pub(super) struct Issue {
    pub message: String,
    pub option: Option<String>,
    pub suggestion: &'static str,
}

/// Returns the smallest and the largest angle.
pub(super) fn angle_range(quality: &Quality) -> [f64; 2] {
    [quality.smallest_angle.worst, quality.largest_angle.worst]
}

/// Returns the label and the distance of the value of an option `--label`, if it sets one.
fn label_distance(value: &str) -> Option<(&str, f64)> {
    let (label, settings) = value.split_once(':')?;
    let distance = (settings.split(',')).find_map(|setting| setting.strip_prefix("distance="))?;
    Some((label, distance.trim().parse().ok()?))
}

/// Returns the issue of faults or horizons that the amplitudes do not confirm.
fn confidence_issue(outcome: &KindOutcome) -> Option<Issue> {
    let confidence = outcome.confidence.as_ref()?;
    (confidence.doubtful_share > MAX_DOUBTFUL_SHARE).then(|| Issue {
        message: format!(
            "{} of {} {} have no more contrast in the amplitudes than noise (confidence below {DOUBTFUL_CONFIDENCE})",
            group_digits(confidence.doubtful),
            group_digits(confidence.surfaces),
            outcome.kind
        ),
        option: Some(format!("--min-confidence {DOUBTFUL_CONFIDENCE}")),
        suggestion: "leaves them out",
    })
}

impl Report {
    /// Returns the worst issue of a valid mesh.
    pub(super) fn worst_issue(&self) -> Option<Issue> {
        // The kind of feature comes first, because everything else depends on it.
        self.no_feature_issue()
            .or_else(|| self.doubt_issue())
            .or_else(|| self.given_surface_issue())
            .or_else(|| self.part_issue().filter(|_| self.are_angles_usable()))
            .or_else(|| self.shape_issue())
            .or_else(|| self.voronoi.as_ref().and_then(|v| self.flow_issue(v)))
            .or_else(|| self.scan_issue())
            .or_else(|| match self.certificate {
                Some(_) => self.part_issue(),
                None => self.smoothed_issue(),
            })
            .or_else(|| self.noise_issue())
            .or_else(|| self.dropped_feature_issue())
            .or_else(|| self.flat_cell_issue())
    }

    /// Returns the grade of a valid mesh. It is that of the worst finding, which need not be the
    /// [issue that is named](Self::worst_issue).
    pub(super) fn grade(&self) -> Grade {
        let volume_error = self
            .worst_region()
            .map_or(0.0, |region| region.volume_error_percent.abs());
        let is_usable = volume_error <= MAX_USABLE_VOLUME_ERROR_PERCENT
            && match &self.certificate {
                Some(certificate) => certificate.is_usable(),
                None => self.follows_interfaces(),
            };
        let least_cover = self.least_covered_surface().map_or(1.0, |(_, cover)| cover);
        if !is_usable || least_cover < MIN_USABLE_FEATURE_SHARE {
            Grade::Bad
        } else if self.worst_issue().is_some() {
            Grade::Fair
        } else {
            Grade::Good
        }
    }

    /// Returns `true` if interfaces, which are not judged by the samples, are near those of the image, and the
    /// features have faces.
    fn follows_interfaces(&self) -> bool {
        let deviation = self.interface_deviation().unwrap_or_default();
        let cover = self.feature_shares().map_or(1.0, |(cover, _)| cover);
        deviation <= MAX_USABLE_INTERFACE_DEVIATION && cover >= MIN_USABLE_FEATURE_SHARE
    }

    /// Returns the issue of a mesh without any detected feature.
    fn no_feature_issue(&self) -> Option<Issue> {
        let job = self.job_facts()?;
        // Without measures of the mesh, nothing is known.
        if self.fidelity.is_some() || self.is_stopped() {
            return None;
        }
        let issue = "no feature was found, so the mesh follows none".to_string();
        let has_strength = (job.feature)
            .is_none_or(|kind| kind.threshold_meaning() == ThresholdMeaning::MinStrength);
        if let Some(threshold) = job.threshold
            && has_strength
        {
            return Some(Issue {
                message: issue,
                option: Some(format!("--threshold {}", 0.5 * threshold)),
                suggestion: "accepts weaker features, too",
            });
        }
        let was_searched = |kind: &FeatureKind| {
            job.feature == Some(*kind) || self.outcomes.iter().any(|o| o.kind == *kind)
        };
        let kinds = [FeatureKind::Edges, FeatureKind::Ridges];
        let other = kinds.into_iter().find(|kind| !was_searched(kind));
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
        let target = self.job_facts().and_then(|job| job.min_angle);
        target.map_or(DEFAULT_MIN_ANGLE, |requested| {
            requested.min(DEFAULT_MIN_ANGLE)
        })
    }

    /// Returns `true` if some angles of cells are below the minimum allowed angle, or above 180 degrees
    /// less that.
    fn has_bad_angles(&self, quality: &Quality) -> bool {
        let min_allowed = self.min_allowed_angle();
        let [smallest, largest] = angle_range(quality);
        let is_within = smallest >= min_allowed && largest <= 180.0 - min_allowed;
        quality.below_20.max(quality.above_160) > 0 && !is_within
    }

    /// Returns `true` if no angle is so small or so large that simulators fail.
    fn are_angles_usable(&self) -> bool {
        self.judged_quality().is_none_or(|quality| {
            let [smallest, largest] = angle_range(quality);
            smallest >= MIN_USABLE_ANGLE && largest <= 180.0 - MIN_USABLE_ANGLE
        })
    }

    /// Returns the angles with which finite elements fail, in words, if the space that is judged has some.
    pub(super) fn unfit_angles(&self) -> Option<String> {
        let quality = self.judged_quality()?;
        let [smallest, largest] = angle_range(quality);
        let is_unfit = self.has_bad_angles(quality);
        is_unfit.then(|| format!("angles of {smallest:.0} to {largest:.0} degrees"))
    }

    /// Returns `true` if cells are well shaped in lattice space, and badly only in physical space.
    fn are_cells_flat(&self) -> bool {
        let is_bad = |quality: &Option<Quality>| {
            let quality = quality.as_ref();
            quality.is_some_and(|quality| self.has_bad_angles(quality))
        };
        is_bad(&self.quality_physical) && !is_bad(&self.quality)
    }

    /// Returns the issue of angles with which simulators fail or are slow.
    fn shape_issue(&self) -> Option<Issue> {
        let quality = self.judged_quality()?;
        if !self.has_bad_angles(quality) || self.are_cells_flat() {
            return None;
        }
        let issue = format!(
            "{} of {} {} have angles below 20 or above 160 degrees{}",
            group_digits(quality.below_20.max(quality.above_160)),
            group_digits(quality.cells),
            quality.kind,
            if self.quality_physical.is_some() {
                " in physical space"
            } else {
                ""
            }
        );
        if self.job_facts().is_some_and(|job| job.keeps_slivers) {
            return Some(Issue {
                message: issue,
                option: Some("--slivers joe".into()),
                suggestion: "removes slivers",
            });
        }
        if self.quality_physical.is_some() && self.is_new_option(&self.shape_option) {
            return Some(Issue {
                message: issue,
                option: Some(self.shape_option.clone()),
                suggestion: "gives cells a good shape in physical space",
            });
        }
        let angles = self.quality.as_ref().and_then(|q| q.angles.as_ref());
        let is_explained = angles.is_some_and(|a| a.near_acute_line > a.unexplained);
        Some(if is_explained {
            self.issue_for_finer_distance(
                format!("{issue}, most where features meet at a small angle"),
                "makes cells there smaller, and fewer of them bad",
            )
        } else {
            self.issue_for_finer_distance(issue, "smaller cells fit better between features")
        })
    }

    /// Returns the issue of cells that are well shaped in lattice space alone.
    fn flat_cell_issue(&self) -> Option<Issue> {
        let quality = self.quality_physical.as_ref()?;
        let [smallest, largest] = angle_range(quality);
        self.are_cells_flat().then(|| Issue {
            message: format!(
                "samples are flat, and cells have their shape: angles in physical space are {smallest:.0} to {largest:.0} \
                 degrees, {} % of the {} below 20 or above 160",
                percent(quality.below_20.max(quality.above_160) as f64 / quality.cells.max(1) as f64),
                quality.kind
            ),
            option: Some(self.shape_option.clone()),
            suggestion: "gives cells a good shape in physical space",
        })
    }

    /// Returns the issue of Voronoi cells with which flow simulators fail or are slow.
    fn flow_issue(&self, voronoi: &Voronoi) -> Option<Issue> {
        if voronoi.non_positive_connections > 0 {
            return Some(Issue {
                message: format!(
                    "fluid cannot flow through {} faces correctly (their transmissibility is not positive)",
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
            return Some(self.issue_for_finer_distance(
                format!(
                    "{:.0} % of the features have no face within a sample",
                    (100.0 * (1.0 - cover)).ceil()
                ),
                "closer atoms cover more of them, with more cells",
            ));
        }
        (precision < MIN_FEATURE_SHARE).then(|| {
            self.issue_for_finer_distance(
                format!(
                    "{:.0} % of the faces on features are off them by more than a sample",
                    (100.0 * (1.0 - precision)).ceil()
                ),
                "smaller faces follow curved features more closely, with more cells",
            )
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
        Some(self.issue_for_finer_distance(
            format!(
                "the mesh does not follow {} % of the {kind} found",
                percent(worst.dropped_share())
            ),
            "closer atoms can follow features that are smaller or nearer to others",
        ))
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
        if let Some(issue) = self.outcomes.iter().find_map(confidence_issue) {
            return Some(issue);
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

    /// Returns the issue of a scan that was taken for labels.
    fn scan_issue(&self) -> Option<Issue> {
        let lost = &self.regions.as_ref()?.lost;
        let count: usize = lost.iter().map(|of_label| of_label.parts).sum();
        (count >= SCAN_FRAGMENTS).then(|| Issue {
            message: format!(
                "the image has {} parts that are too small for regions: its values look like those of a \
                 scan, not like labels",
                group_digits(count)
            ),
            option: Some("--feature edges".into()),
            suggestion: "follows the edges of a scan; labels are for segmentations",
        })
    }

    /// Returns the worst issue of parts of labels, if nothing else is worse.
    pub(crate) fn worst_part_issue(&self) -> Option<&PartIssue> {
        let issue = self.certificate.as_ref()?.issues.first()?;
        let worst = self.worst_issue()?;
        (worst.message == issue.message).then_some(issue)
    }

    /// Returns the worst issue of the parts of labels, judged by the samples of the image.
    fn part_issue(&self) -> Option<Issue> {
        let issue = self.certificate.as_ref()?.issues.first()?;
        Some(Issue {
            message: issue.message.clone(),
            option: None,
            suggestion: "",
        })
    }

    /// Returns the worst issue of features, and of regions that are not judged by the samples.
    fn smoothed_issue(&self) -> Option<Issue> {
        (self.coverage_issue())
            .or_else(|| self.faceless_surface_issue())
            .or_else(|| self.lost_part_issue())
            .or_else(|| self.damage_issue())
            .or_else(|| self.hole_issue())
            .or_else(|| self.volume_issue())
            .or_else(|| self.spike_issue())
    }

    /// Returns the issue of parts of labels that are not in the mesh.
    fn lost_part_issue(&self) -> Option<Issue> {
        let lost = &self.regions.as_ref()?.lost;
        // Smaller cells for a whole small label cost less than for a tiny part of a large one.
        let worst = lost
            .iter()
            .filter(|lost| lost.is_whole_label || lost.largest_samples >= FRAGMENT_SAMPLES)
            .max_by_key(|lost| (lost.is_whole_label, lost.largest_samples))?;
        let count: usize = lost.iter().map(|of_label| of_label.parts).sum();
        let parts = match count {
            1 => "a part of a label is".to_string(),
            parts => format!("{} parts of labels are", group_digits(parts)),
        };
        let samples = match worst.largest_samples {
            1 => "1 sample".to_string(),
            count => format!("{} samples", group_digits(count)),
        };
        let largest = if worst.is_whole_label {
            format!("all of label {}, {samples}", worst.label)
        } else {
            format!("the largest {samples} of label {}", worst.label)
        };
        Some(Issue {
            message: format!("{parts} lost, {largest}"),
            option: worst.remedy(),
            suggestion: match worst.remedy() {
                Some(_) => "makes cells of that label smaller, which keeps the part",
                None => regions::RESAMPLING_ADVICE,
            },
        })
    }

    /// Returns the issue of labels that touch through holes in the thing between them.
    fn hole_issue(&self) -> Option<Issue> {
        let worst = self.regions.as_ref()?.holes.first()?;
        let [a, b] = worst.labels;
        (worst.area > MAX_CONTACT_AREA).then(|| {
            self.issue_for_finer_distance(
                format!("the labels {a} and {b} touch through holes in the layer between them"),
                "smaller cells keep thin layers closed; or use an image with more samples",
            )
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

    /// Returns the region with the largest volume error.
    pub(super) fn worst_region(&self) -> Option<&RegionReport> {
        let candidates = self.regions.as_ref()?.regions.iter();
        let measured = candidates.filter(|region| region.samples >= MIN_MEASURED_SAMPLES);
        measured.max_by(|a, b| {
            a.volume_error_percent
                .abs()
                .total_cmp(&b.volume_error_percent.abs())
        })
    }

    /// Returns the issue of the region with the largest volume error.
    fn volume_issue(&self) -> Option<Issue> {
        let worst = self.worst_region()?;
        if worst.volume_error_percent.abs() <= MAX_VOLUME_ERROR_PERCENT {
            return None;
        }
        let message = format!(
            "the region of label {} is {:.1} % too {}",
            worst.label,
            worst.volume_error_percent.abs(),
            if worst.volume_error_percent < 0.0 {
                "small"
            } else {
                "large"
            }
        );
        let option = regions::distance_option(worst.label, worst.distance);
        Some(match option.filter(|option| self.is_new_option(option)) {
            Some(option) => Issue {
                message,
                option: Some(option),
                suggestion: "makes cells of that label smaller, so that they follow it",
            },
            None => self.issue_for_finer_distance(message, "smaller cells follow labels better"),
        })
    }

    /// Returns the deviation, in samples, of interfaces from the places where labels change, if it
    /// is too large: from the boundary between samples if the mesh is judged by them.
    pub(super) fn interface_deviation(&self) -> Option<f64> {
        self.regions.as_ref()?;
        let farthest = match &self.certificate {
            Some(certificate) => certificate.faces.as_ref()?.worst,
            None => self.fidelity.as_ref()?.tagged_faces.as_ref()?.hausdorff,
        };
        (farthest.is_finite() && farthest > MAX_INTERFACE_DEVIATION).then_some(farthest)
    }

    /// Returns the issue of interfaces with spikes.
    fn spike_issue(&self) -> Option<Issue> {
        let farthest = self.interface_deviation()?;
        Some(self.issue_for_finer_distance(
            format!("faces between regions have spikes, up to {farthest:.1} samples long"),
            "cells smaller than thin layers have no spikes",
        ))
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
    pub(super) fn feature_shares(&self) -> Option<(f64, f64)> {
        let Fidelity {
            tagged_faces: tagged,
            on_feature,
            ..
        } = self.fidelity.as_ref()?;
        let faces = tagged.as_ref().unwrap_or(on_feature);
        let number = |share: f64| if share.is_finite() { share } else { 0.0 };
        Some((number(faces.coverage_one), number(faces.precision)))
    }

    /// Returns an issue that a smaller distance between atoms helps against, as `suggestion` says. If
    /// the distance in use cannot be halved, the issue says what else helps.
    pub(super) fn issue_for_finer_distance(
        &self,
        message: String,
        suggestion: &'static str,
    ) -> Issue {
        let option = self.finer_distance_option();
        let suggestion = match option {
            Some(_) => suggestion,
            None if !self.has_memory_for_finer => {
                "closer atoms would, but need more memory than there is: use a part of the image"
            }
            None => "atoms are as close as samples: use an image with more samples",
        };
        Issue {
            message,
            option,
            suggestion,
        }
    }

    /// Returns the length of a sample in lattice space, as a mean over all axes.
    fn sample_size(&self) -> f64 {
        let (Some(quality), Some(input)) = (&self.quality, &self.input) else {
            return 1.0;
        };
        let intervals: f64 = input.dims.iter().map(|&n| n as f64 - 1.0).product();
        let size = (quality.volume / intervals).powf(1.0 / input.dims.len() as f64);
        if size.is_finite() { size } else { 1.0 }
    }

    /// Returns the option for half the distance in use, unless atoms would be closer together than
    /// samples or the mesh would not fit into memory.
    fn finer_distance_option(&self) -> Option<String> {
        let Some(job) = self.job_facts() else {
            return Some("--distance, smaller".into());
        };
        if !self.has_memory_for_finer {
            return None;
        }
        if job.has_canny_atoms {
            return Some("--seeding fcc".into());
        }
        let text = self.distance_in_use.as_deref().unwrap_or(job.distance);
        let half = |number: &str| Some(0.5 * number.trim().parse::<f64>().ok()?);
        let halves: Option<Vec<f64>> = text.split(':').map(half).collect();
        let halves = halves?;
        // A rounding error must not forbid a distance of exactly one sample.
        let min_distance = MIN_ATOM_DISTANCE * self.sample_size() * (1.0 - 1e-6);
        if halves.iter().any(|half| *half < min_distance) {
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
    pub(super) fn is_new_option(&self, option: &str) -> bool {
        let Some((name, value)) = option.strip_prefix("--").and_then(|o| o.split_once(' ')) else {
            return true;
        };
        // Both metrics give cells the same shape.
        let is_physical = |metric: &str| metric == "physical" || metric.starts_with("shape");
        if name == "metric" && is_physical(value) {
            return !self.parameters[name].as_str().is_some_and(is_physical);
        }
        if let (true, Some((label, distance))) = ("label" == name, label_distance(value)) {
            let given = self.parameters[name].as_array();
            let given = given.into_iter().flatten().filter_map(|item| item.as_str());
            let mut given = given.filter_map(label_distance);
            let is_given = given.any(|(other, given)| other == label && given <= distance);
            let in_use = self.distance_in_use.as_deref();
            let widest = in_use.and_then(|text| text.rsplit(':').next()?.parse::<f64>().ok());
            return !is_given && !widest.is_some_and(|widest| widest <= distance);
        }
        !match &self.parameters[name] {
            Value::String(text) => text == value,
            Value::Number(number) => value.parse::<f64>().ok() == number.as_f64(),
            Value::Array(values) => values.iter().any(|item| item == value),
            _ => false,
        }
    }

    /// Returns the facts about the job, if there was one.
    pub(super) fn job_facts(&self) -> Option<JobFacts<'_>> {
        JobFacts::from_parameters(&self.parameters)
    }

    pub(super) fn is_stopped(&self) -> bool {
        let stop = self.lattice.as_ref().and_then(|l| l.optimisation.as_ref());
        stop.is_some_and(|o| o.stop == StopReason::Interrupted)
    }
}
