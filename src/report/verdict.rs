//! A report in three lines: is the mesh good, what of it is poor, which option to change.

use serde::Serialize;

use super::regions;
use super::table::grouped;
use super::{Fidelity, Quality, Report, Voronoi};
use crate::feature::FeatureKind;

/// Smaller shares of the features covered by faces, or of faces that are on features, are poor.
const SHARE: f64 = 0.9;

/// A share of faces narrower than the least of [`TINY`](super::cells::TINY) that is worth a word.
const TINY_FACES: f64 = 0.01;

/// Parts of labels of fewer samples are no loss, unless nothing else has the label.
const CRUMB: usize = 8;

/// Regions of at least so many samples ...
const MEASURED: usize = 50;

/// ... are poor if their volumes are off by more than this, in percent.
const OFF_PERCENT: f64 = 2.0;

/// How good a mesh is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Valid, well shaped, and it follows the features.
    Good,
    /// Valid, but something is poor.
    Fair,
    /// Of no use to a simulator.
    Bad,
}

/// What a newcomer should know of a report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// How good the mesh is.
    pub grade: Grade,
    /// The same in words.
    pub good: String,
    /// What is poor, the worst only.
    pub poor: String,
    /// What would help, in words.
    pub change: String,
    /// The option to type for that, if there is one.
    pub option: Option<String>,
}

/// Something poor, and what helps.
struct Fault {
    poor: String,
    option: Option<String>,
    change: &'static str,
}

impl Verdict {
    /// What a report comes to; `None` if it has no figures of a mesh.
    pub fn of(report: &Report) -> Option<Self> {
        let check = report.filling.as_ref();
        let check = check.or(report.voronoi.as_ref().map(|v| &v.check))?;
        let fault = match check.problems.first() {
            Some(problem) => Some(Fault {
                poor: problem.clone(),
                option: report.asked().map(|asked| {
                    let seed = asked["rng-seed"].as_u64().unwrap_or(1);
                    format!("--rng-seed {}", seed + 1)
                }),
                change: "make the mesh again; other random numbers may avoid it",
            }),
            None => report.fault(),
        };
        let grade = match &fault {
            _ if !check.passed() => Grade::Bad,
            Some(_) => Grade::Fair,
            None => Grade::Good,
        };
        let (word, valid) = match grade {
            Grade::Good => ("yes", "valid"),
            Grade::Fair => ("fair", "valid"),
            Grade::Bad => ("no", "INVALID"),
        };
        let mut good = vec![valid.to_string()];
        good.extend(report.quality.as_ref().map(|quality| {
            let [least, most] = [quality.smallest_angle.worst, quality.largest_angle.worst];
            format!("angles {least:.0} to {most:.0} degrees")
        }));
        good.extend(report.matched().map(|(cover, _)| {
            let percent = (100.0 * cover).floor();
            format!("{percent:.0} % of the features have faces on them")
        }));
        good.extend(report.of_regions());
        let (poor, change, option) = match fault {
            Some(fault) => (fault.poor, fault.change.to_string(), fault.option),
            None => (
                "nothing".into(),
                "nothing; a smaller --distance shows more detail, a larger one makes fewer cells"
                    .into(),
                None,
            ),
        };
        Some(Self {
            grade,
            good: format!("{word}: {}", good.join(", ")),
            poor,
            change,
            option,
        })
    }

    /// Its three lines, each with its heading.
    pub(super) fn lines(&self) -> [(&'static str, String); 3] {
        let change = match &self.option {
            Some(option) => format!("{option}: {}", self.change),
            None => self.change.clone(),
        };
        [
            ("good?", self.good.clone()),
            ("poor", self.poor.clone()),
            ("change", change),
        ]
    }
}

impl Report {
    /// The same as JSON, with the [`Verdict`] in front.
    pub fn to_json(&self) -> serde_json::Value {
        let mut json = serde_json::Map::new();
        let verdict = serde_json::to_value(Verdict::of(self));
        json.insert("verdict".into(), verdict.unwrap_or_default());
        if let Ok(serde_json::Value::Object(rest)) = serde_json::to_value(self) {
            json.extend(rest);
        }
        json.into()
    }

    /// What is poor in a valid mesh, the worst first.
    fn fault(&self) -> Option<Fault> {
        self.followed_nothing()
            .or_else(|| self.quality.as_ref().and_then(|q| self.shapes(q)))
            .or_else(|| self.voronoi.as_ref().and_then(|v| self.flow(v)))
            .or_else(|| self.features())
            .or_else(|| self.lost())
            .or_else(|| self.damaged())
            .or_else(|| self.volumes())
            .or_else(|| self.doubtful())
    }

    /// A mesh of an image in which no feature was found.
    fn followed_nothing(&self) -> Option<Fault> {
        let asked = self.asked()?;
        // Without a mesh's measures, nothing is known.
        if self.fidelity.is_some() || self.stopped() {
            return None;
        }
        let kind = match asked["feature"].as_str() {
            Some("edges") => "ridges",
            _ => "edges",
        };
        Some(Fault {
            poor: "no feature was found, so the mesh follows none".into(),
            option: Some(format!("--feature {kind}")),
            change: "another kind of feature; or a lower --threshold",
        })
    }

    /// Angles that no simulator likes.
    fn shapes(&self, quality: &Quality) -> Option<Fault> {
        let worst = quality.below_20.max(quality.above_160);
        if worst == 0 {
            return None;
        }
        let poor = format!(
            "{} of {} {} have angles below 20 or above 160 degrees",
            grouped(worst),
            grouped(quality.cells),
            quality.kind
        );
        let left = |asked: &serde_json::Value| asked["slivers"] == "none";
        if self.asked().is_some_and(left) {
            return Some(Fault {
                poor,
                option: Some("--slivers joe".into()),
                change: "removes slivers",
            });
        }
        let explained = |a: &super::Angles| a.near_acute_line > a.unexplained;
        Some(match quality.angles.as_ref().is_some_and(explained) {
            true => Fault {
                poor: format!("{poor}, most where features meet at a small angle"),
                option: self.finer(),
                change: "cells there become smaller, and fewer of them poor",
            },
            false => Fault {
                poor,
                option: self.finer(),
                change: "atoms nearer together have more room between features",
            },
        })
    }

    /// What flow simulators do not like.
    fn flow(&self, voronoi: &Voronoi) -> Option<Fault> {
        if voronoi.not_positive > 0 {
            return Some(Fault {
                poor: format!(
                    "{} faces have a transmissibility that is not positive",
                    grouped(voronoi.not_positive)
                ),
                option: Some("--metric physical".into()),
                change: "makes cells in the world's units, in which simulators compute",
            });
        }
        (voronoi.tiny_faces[0] > TINY_FACES).then(|| Fault {
            poor: format!(
                "{:.1} % of the faces are tiny, below a millionth of the mean area",
                100.0 * voronoi.tiny_faces[0]
            ),
            option: Some("--weld 0.001".into()),
            change: "merges nodes that are next to one another",
        })
    }

    /// Features without faces, and faces without features.
    fn features(&self) -> Option<Fault> {
        let (cover, precision) = self.matched()?;
        if cover < SHARE {
            return Some(Fault {
                poor: format!(
                    "{:.0} % of the features have no face within a sample",
                    (100.0 * (1.0 - cover)).ceil()
                ),
                option: self.finer(),
                change: "atoms nearer together reach more of them, with more cells",
            });
        }
        (precision < SHARE).then(|| Fault {
            poor: format!(
                "{:.0} % of the faces on features are off them by more than a sample",
                (100.0 * (1.0 - precision)).ceil()
            ),
            option: self.finer(),
            change: "smaller faces follow bends more closely, with more cells",
        })
    }

    /// Parts of labels that the mesh does not have.
    fn lost(&self) -> Option<Fault> {
        let lost = &self.regions.as_ref()?.lost;
        let largest = lost.iter().max_by_key(|of_label| of_label.largest)?;
        let whole = lost.iter().any(|lost| lost.whole);
        if !whole && largest.largest < CRUMB {
            return None;
        }
        let parts: usize = lost.iter().map(|of_label| of_label.parts).sum();
        let parts = match parts {
            1 => "a part of a label is".to_string(),
            parts => format!("{} parts of labels are", grouped(parts)),
        };
        Some(Fault {
            poor: format!(
                "{parts} lost, the largest {} samples of label {}",
                grouped(largest.largest),
                largest.label
            ),
            option: largest.option(),
            change: match largest.option() {
                Some(_) => "cells of that label become smaller, and the part is kept",
                None => regions::RESAMPLE,
            },
        })
    }

    /// Parts of labels of which much is missing.
    fn damaged(&self) -> Option<Fault> {
        let damaged = &self.regions.as_ref()?.damaged;
        let largest = damaged.iter().max_by_key(|of_label| of_label.largest)?;
        Some(Fault {
            poor: format!(
                "of a part of label {}, {} samples large, more than {:.0} % is missing",
                largest.label,
                grouped(largest.largest),
                100.0 * regions::DAMAGED
            ),
            option: largest.option(),
            change: match largest.option() {
                Some(_) => "cells of that label become smaller, and the part is kept",
                None => regions::RESAMPLE,
            },
        })
    }

    /// The region whose volume is farthest off that of its samples.
    fn volumes(&self) -> Option<Fault> {
        let all = self.regions.as_ref()?.regions.iter();
        let of_size = all.filter(|region| region.samples >= MEASURED);
        let worst = of_size.max_by(|a, b| a.off_percent.abs().total_cmp(&b.off_percent.abs()))?;
        if worst.off_percent.abs() <= OFF_PERCENT {
            return None;
        }
        let option = regions::option(worst.label, worst.distance);
        let change = match option {
            Some(_) => "cells of that label become smaller, and follow it",
            None => "a smaller --distance everywhere, or an image of more samples",
        };
        Some(Fault {
            poor: format!(
                "the region of label {} is {:.1} % too {}",
                worst.label,
                worst.off_percent.abs(),
                if worst.off_percent < 0.0 {
                    "small"
                } else {
                    "large"
                }
            ),
            option,
            change,
        })
    }

    /// What to say of regions in the first line.
    fn of_regions(&self) -> Option<String> {
        let regions = self.regions.as_ref()?;
        let of_size = regions
            .regions
            .iter()
            .filter(|region| region.samples >= MEASURED);
        let worst = of_size
            .map(|region| region.off_percent.abs())
            .fold(0.0, f64::max);
        let lost: usize = regions.lost.iter().map(|lost| lost.parts).sum();
        Some(match lost {
            0 => format!("regions within {worst:.1} % of their volumes"),
            1 => format!("regions within {worst:.1} % of their volumes, a part lost"),
            _ => format!(
                "regions within {worst:.1} % of their volumes, {} parts lost",
                grouped(lost)
            ),
        })
    }

    /// A kind of feature that was chosen although the image leaves it open.
    fn doubtful(&self) -> Option<Fault> {
        let doubt = self.doubt.as_ref()?;
        let change = if doubt.assumed == FeatureKind::Labels {
            "follows the middle of what is painted; --feature labels confirms solid objects"
        } else {
            "follows the sheets; --feature edges confirms the sides of solid objects"
        };
        Some(Fault {
            poor: format!("doubtful: {}", doubt.question),
            option: Some(format!("--feature {}", doubt.other)),
            change,
        })
    }

    /// Shares of features with faces and of faces on features: of the faces that the mesh calls so, where
    /// it does.
    fn matched(&self) -> Option<(f64, f64)> {
        let Fidelity {
            claimed,
            on_feature,
            ..
        } = self.fidelity.as_ref()?;
        let found = claimed.as_ref().unwrap_or(on_feature);
        let number = |share: f64| if share.is_finite() { share } else { 0.0 };
        Some((number(found.coverage_one), number(found.precision)))
    }

    /// Half the distance that was asked for.
    fn finer(&self) -> Option<String> {
        let Some(asked) = self.asked() else {
            return Some("--distance, smaller".into());
        };
        if asked["seeding"] == "canny" {
            return Some("--seeding fcc".into());
        }
        let text = asked["distance"].as_str().unwrap_or("2.7:8");
        let half = |number: &str| Some(0.5 * number.trim().parse::<f64>().ok()?);
        let halves: Option<Vec<String>> = text
            .split(':')
            .map(|number| Some(format!("{}", (1000.0 * half(number)?).round() / 1000.0)))
            .collect();
        Some(format!("--distance {}", halves?.join(":")))
    }

    /// The words of the job, if there was one.
    fn asked(&self) -> Option<&serde_json::Value> {
        self.parameters.is_object().then_some(&self.parameters)
    }

    fn stopped(&self) -> bool {
        let stop = self.lattice.as_ref().and_then(|l| l.optimisation.as_ref());
        stop.is_some_and(|o| o.stop.contains("interrupted"))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::mesh::boxes::kuhn_box;
    use crate::mesh::check::check;
    use crate::report::{Match, quality};

    /// Of a mesh that is valid, with one figure after the other made poor.
    fn report(cover: f64) -> Report {
        let mesh = kuhn_box([4, 4, 4], 1.0);
        let found = Match {
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
            filling: Some(check(&mesh, [0.0; 3], [4.0; 3], 1e-9)),
            fidelity: Some(Fidelity {
                reference: "detected".into(),
                feature_points: 100,
                on_feature: found,
                claimed: None,
            }),
            ..Report::default()
        }
    }

    #[test]
    fn the_worst_fault_is_named_with_the_option_that_helps() {
        let of = |report: &Report| Verdict::of(report).unwrap();
        let good = of(&report(0.97));
        assert_eq!((good.grade, good.poor.as_str()), (Grade::Good, "nothing"));
        assert_eq!(good.option, None);
        assert!(
            good.good.starts_with("yes: valid, angles 45 to 90"),
            "{}",
            good.good
        );

        let far = of(&report(0.704));
        assert_eq!(far.grade, Grade::Fair);
        assert_eq!(
            far.poor,
            "30 % of the features have no face within a sample"
        );
        assert_eq!(far.option.as_deref(), Some("--distance 1.5:4"));

        let mut flat = report(0.7);
        flat.quality.as_mut().unwrap().below_20 = 3;
        assert!(
            of(&flat).poor.starts_with("3 of 384 tetrahedra"),
            "{}",
            of(&flat).poor
        );
        flat.parameters = json!({ "slivers": "none" });
        assert_eq!(of(&flat).option.as_deref(), Some("--slivers joe"));

        let mut none = report(1.0);
        none.fidelity = None;
        assert_eq!(of(&none).option.as_deref(), Some("--feature edges"));

        let mut torn = report(1.0);
        let problem = "two cells overlap".to_string();
        torn.filling
            .as_mut()
            .unwrap()
            .problems
            .push(problem.clone());
        torn.parameters = json!({ "rng-seed": 4 });
        let torn = of(&torn);
        assert_eq!((torn.grade, torn.poor), (Grade::Bad, problem));
        assert_eq!(torn.option.as_deref(), Some("--rng-seed 5"));
    }

    #[test]
    fn it_leads_table_and_json() {
        let report = report(0.7);
        let table = report.table();
        let heads: Vec<&str> = table.lines().map(|l| l[..12].trim_end()).collect();
        assert_eq!(heads[..3], ["good?", "poor", "change"]);
        assert!(table.lines().nth(2).unwrap().contains("--distance 1.5:4: "));
        let json = report.to_json();
        assert_eq!(json["verdict"]["grade"], "fair");
        assert_eq!(json["verdict"]["option"], "--distance 1.5:4");
        assert_eq!(json["fidelity"]["feature_points"], 100);
        assert_eq!(Verdict::of(&Report::default()), None);
    }
}
