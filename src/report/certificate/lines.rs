//! Formats a certificate for the table, and describes its issues.

use super::{
    BoundaryDistances, Certificate, ClassReport, MAX_USABLE_VOLUME_ERROR_PERCENT,
    MIN_USABLE_BOUNDARY_SHARE, PartClass, PartIssue, PartIssueKind, PartReport, Pinch,
};
use crate::report::table::group_digits;

/// Number of pinches that the table shows.
const MAX_SHOWN_PINCHES: usize = 4;

/// Returns a position as a text.
pub(in crate::report) fn place_text(at: &[f64]) -> String {
    let number = |x: &f64| {
        let text = format!("{x:.2}");
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    };
    format!("({})", at.iter().map(number).collect::<Vec<_>>().join(", "))
}

/// Returns a number of samples as a text.
fn samples_text(count: usize) -> String {
    match count {
        1 => "1 sample".to_string(),
        count => format!("{} samples", group_digits(count)),
    }
}

/// Returns the issue of nodes at which parts touch that are no neighbours. `samples` has the sizes of
/// the two parts at the first node.
pub(super) fn pinch_issue(pinch: &Pinch, count: usize, samples: [usize; 2]) -> PartIssue {
    let [a, b] = pinch.labels;
    let between = if a == b {
        format!("two parts of label {a}")
    } else if pinch.are_labels_apart {
        format!("the labels {a} and {b}")
    } else {
        format!("parts of the labels {a} and {b}")
    };
    let nodes = match count {
        1 => "a node".to_string(),
        count => format!("{} nodes", group_digits(count)),
    };
    let at = place_text(&pinch.at);
    PartIssue {
        kind: PartIssueKind::Pinch,
        count,
        label: a,
        samples: samples[0].min(samples[1]),
        class: None,
        value: count as f64,
        message: format!(
            "{between} touch at {at}, where something lies between them in the image ({nodes} of this kind)"
        ),
        at: pinch.at.clone(),
    }
}

/// Returns an issue that `count` parts have, of which this one is the worst.
pub(super) fn part_issue(
    part: &PartReport,
    kind: PartIssueKind,
    count: usize,
    value: f64,
) -> PartIssue {
    let at = match (kind, part.worst_distance()) {
        (PartIssueKind::Volume | PartIssueKind::Boundary, Some((_, at))) => at.to_vec(),
        _ => part.first_sample.clone(),
    };
    let name = part
        .name
        .as_ref()
        .map_or(String::new(), |name| format!(" ({name})"));
    let subject = format!(
        "the part of label {}{name} with {} at {}",
        part.label,
        samples_text(part.samples),
        place_text(&part.first_sample)
    );
    let message = match kind {
        PartIssueKind::Lost => format!("{subject} is lost"),
        PartIssueKind::Volume => format!(
            "{subject} is {:.1} % too {}",
            value.abs(),
            if value < 0.0 { "small" } else { "large" }
        ),
        PartIssueKind::Euler => {
            let [low, high] = part.euler;
            let range = if low == high {
                low.to_string()
            } else {
                format!("{low} to {high}")
            };
            format!(
                "{subject} has a surface with the Euler number {value:.0}, in the image {range}: holes, handles or \
                 pieces are wrong"
            )
        }
        PartIssueKind::Boundary | PartIssueKind::Pinch => format!(
            "{:.0} % of the boundary of {subject} lie more than a sample off",
            (100.0 * (1.0 - value)).ceil()
        ),
    };
    PartIssue {
        kind,
        count,
        label: part.label,
        samples: part.samples,
        class: Some(part.class),
        value,
        message: match count {
            1 => message,
            count => format!("{message}; {} such parts", group_digits(count)),
        },
        at,
    }
}

impl PartClass {
    fn title(self) -> &'static str {
        match self {
            Self::Thick => "thick",
            Self::Thin => "thin",
            Self::Small => "small",
            Self::Speck => "specks",
        }
    }
}

impl Certificate {
    /// Returns `true` if the thick parts of the mesh are those of the image, at least roughly.
    pub(crate) fn is_usable(&self) -> bool {
        let is_usable = |class: &ClassReport| {
            let worst = class.worst_volume.as_ref();
            class.lost == 0
                && worst.is_none_or(|part| {
                    part.volume_error_percent.abs() <= MAX_USABLE_VOLUME_ERROR_PERCENT
                })
                && class.min_boundary_share >= MIN_USABLE_BOUNDARY_SHARE
        };
        let mut classes = self.classes.iter();
        classes.all(|class| class.class != PartClass::Thick || is_usable(class))
    }

    /// Returns what everybody needs to know, in one line.
    pub(crate) fn summary(&self) -> String {
        let mut statements = Vec::new();
        for class in &self.classes {
            let (title, worst) = (class.class.title(), class.worst_volume.as_ref());
            if let (Some(worst), true) = (worst, class.class != PartClass::Speck) {
                let error = worst.volume_error_percent.abs();
                statements.push(format!(
                    "{title} parts of labels within {error:.1} % of their volumes"
                ));
            }
        }
        if self.lost_parts > 0 {
            statements.push(format!(
                "{} of {} parts lost",
                group_digits(self.lost_parts),
                group_digits(self.parts)
            ));
        }
        if self.pinch_count > 0 {
            statements.push(format!(
                "{} nodes at which parts touch that are apart in the image",
                group_digits(self.pinch_count)
            ));
        }
        if statements.is_empty() {
            statements.push("no part of a label is larger than a speck".to_string());
        }
        statements.join(", ")
    }

    /// Returns the lines of the table.
    pub(crate) fn lines(&self) -> Vec<String> {
        let percent = 100.0 * self.changed_samples as f64 / self.samples.max(1) as f64;
        let mut lines = vec![format!(
            "{} of {} samples ({percent:.2} %) lie in cells of another label; {} of {} parts lost",
            group_digits(self.changed_samples),
            group_digits(self.samples),
            group_digits(self.lost_parts),
            group_digits(self.parts)
        )];
        lines.push(format!(
            "{:<30} {:>7} {:>7} {:>7} {:>7}",
            "distance in samples", "mean", "<= 0.5", "<= 1", "worst"
        ));
        let mut row = |title: &str, distances: &Option<BoundaryDistances>| {
            if let Some(d) = distances {
                lines.push(format!(
                    "{title:<30} {:>7.3} {:>7.3} {:>7.3} {:>7.2} at {}",
                    d.mean,
                    d.within_half,
                    d.within_one,
                    d.worst,
                    place_text(&d.worst_at)
                ));
            }
        };
        row("voxels' boundary to faces", &self.boundary);
        row("faces to voxels' boundary", &self.faces);
        lines.push(format!(
            "{:<8} {:>8} {:>7} {:>8} {:>7} {:>7}  worst volume",
            "parts", "in image", "lost", "off", "Euler", "Dice"
        ));
        for class in self.classes.iter().filter(|class| class.parts > 0) {
            let worst = class.worst_volume.as_ref();
            let worst = worst.map_or(String::new(), |part| {
                format!(
                    "{:+.2} % of label {}, {}",
                    part.volume_error_percent,
                    part.label,
                    samples_text(part.samples)
                )
            });
            let dice = class
                .min_dice
                .map_or("-".into(), |dice| format!("{dice:.3}"));
            lines.push(format!(
                "{:<8} {:>8} {:>7} {:>8} {:>7} {dice:>7}  {worst}",
                class.class.title(),
                group_digits(class.parts),
                group_digits(class.lost),
                group_digits(class.off_volume),
                group_digits(class.wrong_euler)
            ));
        }
        if self.stray_cells > 0 {
            lines.push(format!(
                "{} cells have no sample of their label near; their volume is {:.1} samples",
                group_digits(self.stray_cells),
                self.stray_volume
            ));
        }
        for pinch in self.pinches.iter().take(MAX_SHOWN_PINCHES) {
            let [a, b] = pinch.labels;
            lines.push(format!(
                "PINCH: labels {a} and {b} touch at {}, and not in the image",
                place_text(&pinch.at)
            ));
        }
        if self.pinch_count > MAX_SHOWN_PINCHES {
            lines.push(format!(
                "... {} nodes of this kind",
                group_digits(self.pinch_count)
            ));
        }
        lines
    }
}
