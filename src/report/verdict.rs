//! Summarises a report in three lines: the validity of the mesh, its features, and its use.

use serde::Serialize;

use super::assumptions::assumptions;
use super::issues::{Issue, angle_range};
use super::table::group_digits;
use super::{Advice, Report};
use crate::feature::{Confidences, FeatureKind, KindOutcome, MIN_FAULT_DIP};
use crate::image::NoAngles;

/// Maximum fraction of the features of one kind that the mesh may drop. More is an issue.
pub(super) const MAX_DROPPED_SHARE: f64 = 0.1;

/// Maximum ratio of strength to noise that is shown as a number.
const MAX_SHOWN_RATIO: f32 = 100.0;

/// Maximum area, in square samples, of contacts between labels that do not touch in the image. More
/// is an issue.
pub(super) const MAX_CONTACT_AREA: f64 = 10.0;

/// Grade of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Valid, well shaped, with the features.
    Good,
    /// Valid, with an issue.
    Fair,
    /// Invalid, or so far from the labels of the image that it is of no use.
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
    /// Assumptions about what neither the files nor the options say.
    pub assumed: Vec<String>,
}

impl Verdict {
    /// Returns the verdict on a report, or `None` if the report has no check of a mesh.
    pub fn from_report(report: &Report) -> Option<Self> {
        let check = report.box_check.as_ref();
        let check = check.or(report.voronoi.as_ref().map(|v| &v.check))?;
        let issue = match check.problems.first() {
            Some(problem) => Some(Issue {
                message: problem.clone(),
                option: (report.job_facts()).map(|job| format!("--rng-seed {}", job.seed + 1)),
                suggestion: "meshes again with other random numbers, which may avoid it",
            }),
            None => report.worst_issue(),
        };
        let grade = if check.passed() {
            report.grade()
        } else {
            Grade::Bad
        };
        let simulation = match report.voronoi {
            Some(_) => "flow simulation with finite volumes",
            None => "simulation with finite elements or finite volumes",
        };
        let fit_for = match grade {
            Grade::Good => match report.no_physical_angles() {
                Some(NoAngles::Time(_)) => {
                    "work in time; simulation needs a mesh in depth (--velocity)"
                }
                Some(_) => "work in these coordinates; simulation needs lengths along all axes",
                None => simulation,
            }
            .to_string(),
            Grade::Fair => match report.unfit_angles() {
                Some(angles) => format!("viewing, but {angles} are unfit for finite elements"),
                None => "viewing, and for simulation if this issue does not matter".into(),
            },
            Grade::Bad => "diagnosis only".into(),
        };
        let mut mesh = vec![String::from(if check.passed() {
            "valid"
        } else {
            "INVALID"
        })];
        mesh.extend(report.angle_summary());
        let (issue, suggestion, option) = match issue {
            // An option that is in use already does not help again.
            Some(Issue { message, .. })
                if report
                    .advice
                    .as_ref()
                    .is_some_and(|advice| advice.issue == message) =>
            {
                let advice = report.advice.as_ref();
                let option = advice.and_then(|advice| advice.option.clone());
                (Some(message), advice.map(Advice::suggestion), option)
            }
            Some(Issue {
                message,
                option: Some(option),
                ..
            }) if !report.is_new_option(&option) => (Some(message), None, None),
            Some(issue) => {
                let suggestion = Some(issue.suggestion).filter(|text| !text.is_empty());
                let suggestion = suggestion.map(str::to_owned);
                (Some(issue.message), suggestion, issue.option)
            }
            None => (None, None, None),
        };
        Some(Self {
            grade,
            mesh: mesh.join("; "),
            features: report.feature_lines().join("; "),
            fit_for,
            issue,
            suggestion,
            option,
            assumed: assumptions(&report.notes),
        })
    }

    /// Returns the three lines, and one with what was assumed if anything was, each with its heading.
    pub(super) fn lines(&self) -> Vec<(&'static str, String)> {
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
        let mut lines = vec![
            ("mesh", self.mesh.clone()),
            ("features", self.features.clone()),
            ("use", text),
        ];
        if !self.assumed.is_empty() {
            lines.push(("assumed", self.assumed.join("; ")));
        }
        lines
    }
}

/// Returns a fraction as text in percent.
pub(super) fn percent(share: f64) -> String {
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

    /// Returns the range of the angles, in each space in which angles are meaningful.
    fn angle_summary(&self) -> Option<String> {
        let [low, high] = angle_range(self.quality.as_ref()?);
        if let Some(quality) = &self.quality_physical {
            let [min, max] = angle_range(quality);
            return Some(format!(
                "angles {min:.0} to {max:.0} degrees in physical space, {low:.0} to {high:.0} counted in samples"
            ));
        }
        let range = format!("angles {low:.0} to {high:.0} degrees");
        Some(match self.no_physical_angles() {
            Some(reason) => format!("{range} counted in samples, as {reason}"),
            None => range,
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
        lines.extend(self.outcomes.iter().filter_map(flat_fault_line));
        let chaotic = self.outcomes.iter().filter_map(|outcome| outcome.chaotic);
        if let Some(share) = chaotic.reduce(f64::max) {
            lines.push(format!(
                "{} % of the image is chaotic (salt, gas, noise), and no features are searched for there",
                percent(share)
            ));
        }
        if let Some(missing) = &self.missing {
            let total = percent(missing.bridged + missing.without_features);
            let gaps = match missing.without_features {
                0.0 => "in gaps so small that they are bridged".to_string(),
                share => format!("{} % lie in gaps too large for features", percent(share)),
            };
            lines.push(format!("{total} % of the samples hold no data, {gaps}"));
        }
        match &self.certificate {
            Some(certificate) => lines.push(certificate.summary()),
            None => lines.extend(self.region_summary()),
        }
        lines.extend((self.interface_deviation()).map(|distance| {
            format!(
                "faces between regions lie up to {distance:.1} samples beside the labels' boundary"
            )
        }));
        lines.extend((self.doubt.as_ref()).map(|doubt| format!("doubtful: {}", doubt.question)));
        if lines.is_empty() {
            let was_compared = self.job_facts().is_some() && !self.is_stopped();
            lines.push(String::from(if was_compared {
                "no feature was found"
            } else {
                "not compared with an image"
            }));
        }
        lines
    }

    /// Returns the statement about regions for the line on features.
    fn region_summary(&self) -> Option<String> {
        let regions = self.regions.as_ref()?;
        let worst = self
            .worst_region()
            .map_or(0.0, |region| region.volume_error_percent.abs());
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
}

/// Returns the statement about faults that are left out because they dip too little.
fn flat_fault_line(outcome: &KindOutcome) -> Option<String> {
    let flat = outcome.below_min_dip?;
    let (faults, are) = match flat.count {
        1 => ("1 fault".to_string(), "is"),
        count => (format!("{} faults", group_digits(count)), "are"),
    };
    let [low, high] = flat.dips.map(|dip| format!("{dip:.0}"));
    let dips = if low == high {
        low
    } else {
        format!("{low} to {high}")
    };
    let velocity = match flat.assumed_velocity {
        Some(velocity) => format!(", with two-way time at {velocity:.0} m/s"),
        None => String::new(),
    };
    Some(format!(
        "{faults} dipping by {dips} degrees {are} left out, the largest of {:.2e} square metres (--min-dip {}{velocity})",
        flat.largest_area, flat.min_dip
    ))
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
    // The names of these options are no plurals.
    let kind = match kind {
        FeatureKind::Canny => "edges".to_string(),
        FeatureKind::Isosurface => "parts of the isosurface".to_string(),
        FeatureKind::Mask => "parts of the mask".to_string(),
        other => other.to_string(),
    };
    if *points == 0 {
        let count = group_digits(dropped.strong_count() + dropped.weak);
        lines.push(format!(
            "no {kind} are followed: {count} points that may lie on some are too weak, or on pieces that are too small"
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
            "{share} % of the {kind} found are not followed, most of it {why}"
        ));
    }
    let weak = dropped.weak as f64 / (dropped.weak + points).max(1) as f64;
    if weak > MAX_DROPPED_SHARE {
        lines.push(format!(
            "{} % of the points that may lie on {kind} are too weak to follow",
            percent(weak)
        ));
    }
    if let Some(ratio) = outcome.signal_to_noise {
        let ratio = match ratio {
            r if r > MAX_SHOWN_RATIO => format!("over {MAX_SHOWN_RATIO:.0}"),
            r => format!("{r:.1}"),
        };
        lines.push(format!(
            "{kind} stand out from noise by a factor of {ratio}"
        ));
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
    if let Some(confidence) = &outcome.confidence {
        lines.extend(confidence_line(&kind, confidence));
    }
    lines
}

/// Returns the statement about the confidence of faults or horizons, if they have one.
fn confidence_line(kind: &str, confidence: &Confidences) -> Option<String> {
    let Confidences {
        surfaces,
        lowest,
        median,
        dropped,
        ..
    } = confidence;
    let mut line = match surfaces {
        0 => String::new(),
        1 => format!("confidence of the {kind} {median:.1}"),
        _ => format!("confidence of the {kind} {median:.1}, the least {lowest:.1}"),
    };
    if *dropped > 0 {
        let separator = if line.is_empty() { "" } else { "; " };
        let count = group_digits(*dropped);
        line += &format!("{separator}{count} {kind} left out by --min-confidence");
    }
    (!line.is_empty()).then_some(line)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::feature::{Doubt, DroppedPoints, FlatFaults, MissingData};
    use crate::image::LabelValue;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::check::check;
    use crate::report::{
        AngleSpace, FaceMatch, Fidelity, GivenSurfaceReport, RegionReport, RegionSummary,
        SurfaceCoverage, VolumeReference, quality,
    };

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
                surfaces: Vec::new(),
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
            below_min_dip: None,
            confidence: None,
            chaotic: None,
        };
        let report_with = |outcome: KindOutcome| Report {
            outcomes: vec![outcome],
            ..report(0.97)
        };
        let verdict = verdict_of(&report_with(outcome));
        assert_eq!(verdict.grade, Grade::Good, "{verdict:?}");
        let expected = "9 % of the faults found are not followed, most of it too near stronger ones; 25 % of the points \
                    that may lie on faults are too weak to follow; faults stand out from noise by a factor of 6.0";
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
    fn grade_is_that_of_the_worst_finding_though_a_doubt_is_named_first() {
        let region = |volume_error_percent: f64| RegionReport {
            label: LabelValue::Whole(1),
            region: 1,
            name: None,
            parts: 1,
            samples: 5000,
            cells: 100,
            volume: 5000.0,
            sample_volume: 5000.0,
            volume_error_percent,
            distance: None,
        };
        let graded = |volume_error_percent: f64, deviation: f64| {
            let mut report = report(0.97);
            report.doubt = Some(Doubt {
                question: "objects may be paint".into(),
                assumed: FeatureKind::Labels,
                other: FeatureKind::Mask,
            });
            report.regions = Some(RegionSummary {
                volume_reference: VolumeReference::Samples,
                regions: [1.0, volume_error_percent, -0.5].map(region).to_vec(),
                holes: Vec::new(),
                lost: Vec::new(),
                damaged: Vec::new(),
            });
            let fidelity = report.fidelity.as_mut().unwrap();
            let mut tagged = fidelity.on_feature.clone();
            tagged.hausdorff = deviation;
            fidelity.tagged_faces = Some(tagged);
            Verdict::from_report(&report).unwrap()
        };
        for (volume_error, deviation, grade) in [
            (-1.0, 0.5, Grade::Fair),
            (20.0, 4.0, Grade::Fair),
            (-79.0, 0.5, Grade::Bad),
            (1.0, 48.9, Grade::Bad),
        ] {
            let verdict = graded(volume_error, deviation);
            assert_eq!(verdict.grade, grade, "{volume_error} {deviation}");
            assert_eq!(
                verdict.issue.as_deref(),
                Some("doubtful: objects may be paint")
            );
            assert_eq!(verdict.option.as_deref(), Some("--feature mask"));
        }
        let lines = graded(-79.0, 0.5).lines();
        assert!(
            lines[2]
                .1
                .starts_with("bad: doubtful: objects may be paint; fit for diagnosis only")
        );
    }

    /// Returns the quality of a mesh whose smallest angle is this, with one cell below 20 degrees.
    fn quality_with_angle(smallest: f64) -> crate::report::Quality {
        let mut quality = report(1.0).quality.unwrap();
        quality.smallest_angle.worst = smallest;
        quality.below_20 = usize::from(smallest < 20.0);
        quality
    }

    #[test]
    fn angles_in_physical_space_decide_wherever_they_have_a_meaning() {
        let mut flat = report(0.97);
        flat.angle_space = Some(AngleSpace::Physical);
        flat.set_physical_quality(quality_with_angle(9.0));
        let verdict = Verdict::from_report(&flat).unwrap();
        assert_eq!(verdict.grade, Grade::Fair);
        assert_eq!(verdict.option.as_deref(), Some("--metric shape"));
        let angles = "angles 9 to 90 degrees in physical space, 45 to 90 counted in samples";
        assert!(verdict.mesh.ends_with(angles), "{}", verdict.mesh);

        // Bad angles in lattice space do not matter where those in physical space are good.
        let mut upright = report(0.97);
        upright.quality = Some(quality_with_angle(9.0));
        upright.set_physical_quality(quality_with_angle(30.0));
        let verdict = Verdict::from_report(&upright).unwrap();
        assert_eq!(verdict.grade, Grade::Good, "{verdict:?}");

        // In time, angles in physical space have no meaning.
        let mut time = report(0.97);
        time.angle_space = Some(AngleSpace::Lattice(NoAngles::Time("ms".into())));
        let verdict = Verdict::from_report(&time).unwrap();
        assert_eq!(verdict.grade, Grade::Good);
        let angles = "angles 45 to 90 degrees counted in samples, as one coordinate is time (ms)";
        assert!(verdict.mesh.ends_with(angles), "{}", verdict.mesh);
        assert!(!verdict.fit_for.contains("finite elements"), "{verdict:?}");
        let json = time.to_json();
        assert_eq!(json["angle_space"]["space"], "lattice");
        assert_eq!(json["angle_space"]["reason"], "one coordinate is time (ms)");
    }

    #[test]
    fn a_remedy_that_is_in_use_is_not_named_again() {
        let mut flat = report(0.97);
        flat.set_physical_quality(quality_with_angle(9.0));
        for metric in ["shape", "physical"] {
            flat.parameters = json!({ "metric": metric });
            let verdict = Verdict::from_report(&flat).unwrap();
            assert!(verdict.issue.is_some());
            assert_eq!(
                (verdict.option, verdict.suggestion),
                (None, None),
                "{metric}"
            );
        }
        let with = |label: &str| Report {
            parameters: json!({ "label": [label] }),
            ..report(0.97)
        };
        let is_new = |label: &str| with(label).is_new_option("--label 5:distance=2");
        assert!(is_new("5:distance=3,name=core") && is_new("4:distance=1"));
        assert!(!is_new("5:name=core,distance=2") && !is_new("5:distance=1.5"));

        // The distance in use counts, and the memory for half of it.
        let mut uncovered = report(0.7);
        uncovered.distance_in_use = Some("2:5".into());
        let option = |report: &Report| Verdict::from_report(report).unwrap().option;
        assert_eq!(option(&uncovered).as_deref(), Some("--distance 1:2.5"));
        uncovered.has_memory_for_finer = false;
        let verdict = Verdict::from_report(&uncovered).unwrap();
        assert_eq!(verdict.option, None);
        assert!(verdict.suggestion.unwrap().contains("memory"));
    }

    #[test]
    fn a_given_surface_without_faces_is_bad_and_one_outside_the_image_is_named() {
        let with = |coverage: f64, outside: f64| {
            let mut report = report(0.97);
            report.given_surfaces = [("top", 0.98, 0.0), ("F1", coverage, outside)]
                .map(|(name, coverage, outside)| GivenSurfaceReport {
                    name: name.into(),
                    outside,
                    coverage: Some(coverage),
                })
                .to_vec();
            Verdict::from_report(&report).unwrap()
        };
        assert_eq!(with(0.9, 0.4).grade, Grade::Good);
        for (coverage, outside, grade, issue) in [
            (
                0.85,
                0.0,
                Grade::Fair,
                "only 85 % of the surface F1 have faces",
            ),
            (
                0.0,
                0.0,
                Grade::Bad,
                "only 0.00 % of the surface F1 have faces",
            ),
            (
                0.95,
                0.6,
                Grade::Fair,
                "60 % of the surface F1 lie outside the image",
            ),
        ] {
            let verdict = with(coverage, outside);
            assert_eq!(
                (verdict.grade, verdict.issue.as_deref()),
                (grade, Some(issue))
            );
        }
    }

    #[test]
    fn found_surfaces_without_any_face_are_counted() {
        let mut report = report(0.97);
        let coverage = |surface: u32, points: usize, covered_points: usize| SurfaceCoverage {
            surface,
            points,
            covered_points,
        };
        let surfaces = &mut report.fidelity.as_mut().unwrap().surfaces;
        *surfaces = vec![
            coverage(1, 900, 890),
            coverage(2, 40, 0),
            coverage(3, 60, 4),
        ];
        let verdict = Verdict::from_report(&report).unwrap();
        assert_eq!(verdict.grade, Grade::Fair);
        let issue = "2 of 3 found surfaces have no face, the largest of 60 samples";
        assert_eq!(verdict.issue.as_deref(), Some(issue));
        // A mesh that lacks most features is of no use.
        let lacking = self::report(0.3);
        assert_eq!(Verdict::from_report(&lacking).unwrap().grade, Grade::Bad);
    }

    #[test]
    fn surfaces_without_contrast_are_counted() {
        let with = |doubtful_share: f64, dropped: usize| {
            let mut report = report(0.97);
            report.outcomes = vec![KindOutcome {
                kind: FeatureKind::Horizons,
                points: 900,
                dropped: DroppedPoints::default(),
                signal_to_noise: None,
                gently_dipping: None,
                below_min_dip: None,
                confidence: Some(Confidences {
                    surfaces: 12,
                    lowest: 0.4,
                    median: 1.9,
                    doubtful: 3,
                    doubtful_share,
                    dropped,
                }),
                chaotic: None,
            }];
            Verdict::from_report(&report).unwrap()
        };
        let few = with(0.05, 0);
        assert_eq!(few.grade, Grade::Good, "{few:?}");
        let expected = "confidence of the horizons 1.9, the least 0.4";
        assert!(few.features.ends_with(expected), "{}", few.features);
        let many = with(0.3, 2);
        assert_eq!(many.grade, Grade::Fair);
        let issue = "3 of 12 horizons have no more contrast in the amplitudes than noise (confidence below 1)";
        assert_eq!(many.issue.as_deref(), Some(issue));
        assert_eq!(many.option.as_deref(), Some("--min-confidence 1"));
        let expected = "2 horizons left out by --min-confidence";
        assert!(many.features.ends_with(expected), "{}", many.features);
    }

    #[test]
    fn flat_faults_and_assumptions_are_named() {
        let mut report = report(0.97);
        report.outcomes = vec![KindOutcome {
            kind: FeatureKind::Faults,
            points: 900,
            dropped: DroppedPoints::default(),
            signal_to_noise: None,
            gently_dipping: None,
            below_min_dip: Some(FlatFaults {
                min_dip: 30.0,
                count: 2,
                largest_area: 1.23e6,
                dips: [17.2, 27.6],
                assumed_velocity: Some(2000.0),
            }),
            confidence: None,
            chaotic: None,
        }];
        report.notes = vec![
            "assumed: depths of F1 are in m".into(),
            "the image has 3 lines".into(),
        ];
        let verdict = Verdict::from_report(&report).unwrap();
        let expected = "2 faults dipping by 17 to 28 degrees are left out, the largest of 1.23e6 square metres (--min-dip 30, \
                        with two-way time at 2000 m/s)";
        assert!(verdict.features.ends_with(expected), "{}", verdict.features);
        assert_eq!(verdict.assumed, ["depths of F1 are in m"]);
        let line = &verdict.lines()[3];
        assert_eq!((line.0, &*line.1), ("assumed", "depths of F1 are in m"));
        let flat = &report.to_json()["outcomes"][0]["below_min_dip"];
        assert_eq!(
            (&flat["count"], &flat["min_dip"]),
            (&json!(2), &json!(30.0))
        );
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
            (json!({ "threshold": "0.5" }), Some("--threshold 0.25")),
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
            below_min_dip: None,
            confidence: None,
            chaotic: None,
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
